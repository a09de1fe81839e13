//! The force field (thesis 4.1.3): open seeds attract, neighbours push. One mechanism; the three
//! strategies of the thesis differ in [`Repulsion`] only.
//!
//! Everything is an integer: vectors are in units of 1/65536 (so 1.0 is [`ONE`]), so that every
//! build on every machine makes the same choice.

use crate::metamodule::blueprint::{Floor, Seed};
use crate::metamodule::motions::{Middle, Motions};
use crate::metamodule::params::Repulsion;
use crate::metamodule::planning::paths::Ground;
use crate::metamodule::pose::Pose;
use metamorph_core::lattice::Cell;

/// Factor of the field's fixed-point numbers: 1.0 in their unit.
pub const ONE: i64 = 1 << 16;

/// A connector of the floor.
pub type Place = (i16, i16);

/// Forces on a metamodule in one place: the pull of the open seeds, and the push of the neighbours in range.
///
/// Each seed pulls with a weight of 1/distance, and the weights are scaled to a sum of one. The pull on a move is not
/// the force where the move begins, but the distance that the whole move gains. Distances count the remaining moves
/// around everything that does not move ([`distance`]). With straight-line distances, the parts already built would
/// keep almost all metamodules away from the seeds, because moves are coarse: no kind has a move of two cells
/// straight ahead, and PAR has none of one cell. Only the metamodules that move remain as obstacles, and the
/// strategies are about how to deal with those.
pub struct Field<'a> {
    motions: &'a Motions,
    floor: Floor,
    fixed: &'a [Cell],
    at: Pose,
    /// Where moves lead.
    places: Vec<Pose>,
    /// For every seed its weight and what each move gains.
    seeds: Vec<(i64, Vec<i64>)>,
    push: (i64, i64),
}

/// The length of a vector, rounded down. Components stay far below 2³¹ here.
fn length(x: i64, y: i64) -> i64 {
    (x.unsigned_abs() * x.unsigned_abs() + y.unsigned_abs() * y.unsigned_abs()).isqrt() as i64
}

/// Returns the distance to a seed that is `steps` moves away, in cells times [`ONE`]: two cells for every move, plus a
/// quarter of the straight-line distance to break ties.
pub fn distance(steps: u16, from: Pose, to: Place) -> i64 {
    let (dx, dy) = (i64::from(to.0) - i64::from(from.state.x), i64::from(to.1) - i64::from(from.state.y));
    2 * ONE * i64::from(steps) + length(dx * ONE, dy * ONE) / 4
}

/// Bonus of a move to a place from which the seed can be filled: as much as a gain of ten moves.
const FILL_BONUS: i64 = 10 * ONE;

impl<'a> Field<'a> {
    /// A field without seeds and pushes, on a metamodule at `at` whose moves lead to `places`. `fixed` are
    /// the cells that stay taken.
    pub fn new(
        motions: &'a Motions,
        floor: Floor,
        fixed: &'a [Cell],
        at: Pose,
        places: Vec<Pose>,
    ) -> Field<'a> {
        Field { motions, floor, fixed, at, places, seeds: Vec::new(), push: (0, 0) }
    }

    /// Adds the pull of a seed, unless there is no way to it.
    pub fn add_seed(&mut self, seed: Seed) {
        let (motions, at) = (self.motions, self.at);
        let distances = motions.distances(self.floor, seed, self.fixed);
        let here = Ground { motions, floor: self.floor, taken: self.fixed }.lands(at);
        let Some(steps) = distances.steps(at, here) else { return };
        let far = distance(steps, at, seed.foot);
        let gain = |to: &Pose| {
            let steps = distances.steps(*to, motions.rest_bit(to.posture));
            // A place without a way to the seed loses all of the distance.
            let gain = steps.map_or(-far, |s| far - distance(s, *to, seed.foot));
            gain + if steps == Some(0) { FILL_BONUS } else { 0 }
        };
        self.seeds.push((ONE * ONE / far.max(1), self.places.iter().map(gain).collect()));
    }

    /// Adds the push of a neighbour with its middle at `of` on a metamodule with its middle at `on`.
    pub fn add_push(&mut self, repulsion: Repulsion, on: Middle, of: Middle) {
        let (dx, dy) = (on.0 - of.0, on.1 - of.1);
        // Middles are in quarter cells; distances in 1/256 of that, so that rounding does not show.
        let distance = length(dx << 8, dy << 8);
        let range = i64::from(repulsion.range) << 10;
        if distance == 0 || distance >= range {
            return;
        }
        let fading = i64::from(repulsion.decay) * distance / range;
        let strength = i64::from(repulsion.strength) * (1000 - fading) * ONE / 1_000_000;
        self.push.0 += strength * (dx << 8) / distance;
        self.push.1 += strength * (dy << 8) / distance;
    }

    /// Returns the score of the move to the place with this index, which takes `turns` turns of joints: the pull
    /// of the seeds, with a bonus where one can be filled from, plus the push of the neighbours, minus
    /// [`ONE`] / 100 for each turn.
    pub fn score(&self, place: usize, turns: u8) -> i64 {
        let sum: i64 = self.seeds.iter().map(|(weight, _)| weight).sum();
        let pull: i64 = self.seeds.iter().map(|(weight, gains)| gains[place] * weight / sum.max(1)).sum();
        let (to, at) = (self.places[place].state, self.at.state);
        let (dx, dy) = (i64::from(to.x) - i64::from(at.x), i64::from(to.y) - i64::from(at.y));
        pull + self.push.0 * dx + self.push.1 * dy - i64::from(turns) * ONE / 100
    }
}

/// Least score for which a move is made, in moves gained: 0.05.
pub const WORTH: i64 = ONE / 20;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metamodule::blueprint::chair_of_six;
    use crate::metamodule::params::Strategy;
    use metamorph_roombots::Kind;
    use metamorph_roombots::database::Database;
    use metamorph_roombots::grid::GridState;
    use metamorph_roombots::posture::Posture;
    use std::sync::Arc;

    #[test]
    fn strategies_differ_in_how_neighbours_push() {
        let motions = Motions::new(Arc::new(Database::build()), Kind::Srs).unwrap();
        let floor = Floor { min: (0, 0), max: (12, 12) };
        let at = Pose::standing(GridState::new(6, 6, 0), 0);
        let push = |strategy: Strategy, cells: i64| {
            let mut field = Field::new(&motions, floor, &[], at, Vec::new());
            field.add_push(strategy.repulsion(), (0, 0), (-4 * cells, 0));
            assert_eq!(field.push.1, 0);
            field.push.0
        };
        for cells in 1..6 {
            assert_eq!(push(Strategy::Greedy, cells), 0);
        }
        let [near, far] = [1, 3].map(|c| push(Strategy::Slope, c));
        assert_eq!((near, far), (ONE * 3 / 4, ONE / 4));
        assert_eq!(push(Strategy::Step, 1), push(Strategy::Step, 3));
        assert_eq!(push(Strategy::Step, 1), ONE * 600 / 1000);
        assert_eq!([Strategy::Slope, Strategy::Step].map(|s| push(s, 4)), [0, 0]);
    }

    /// Alone, every kind comes from everywhere to every seed of the chair, in their order, around what
    /// is built already: no local minimum, no going to and fro.
    #[test]
    fn alone_every_kind_gets_to_every_seed() {
        let database = Arc::new(Database::build());
        let floor = Floor { min: (0, 0), max: (12, 12) };
        let seeds: Vec<Seed> = chair_of_six(5, 5).into_iter().flatten().collect();
        for kind in Kind::METAMODULES {
            let motions = Motions::new(Arc::clone(&database), kind).unwrap();
            let zero = motions.table().find(Posture::zero(kind)).unwrap();
            for (built, seed) in seeds.iter().enumerate() {
                let fixed: Vec<Cell> = seeds[..built].iter().flat_map(|s| s.cells()).collect();
                let ground = Ground { motions: &motions, floor, taken: &fixed };
                for (x, y, class) in [(2, 2, 0), (10, 1, 1), (6, 11, 2), (11, 7, 3)] {
                    let state = GridState::new(x, y, class);
                    let mut at = Pose::standing(state, zero);
                    let mut steps = 0;
                    while at.foot() != seed.foot || ground.filling(at, *seed).is_none() {
                        let reach = ground.reach(at);
                        let landed = reach.landings.iter();
                        let (turns, places): (Vec<u8>, Vec<Pose>) =
                            landed.filter_map(|l| Some((l.turns, ground.landed(at, l.posture)?))).unzip();
                        let mut field = Field::new(&motions, floor, &fixed, at, places.clone());
                        field.add_seed(*seed);
                        let best = (0..places.len()).max_by_key(|i| field.score(*i, turns[*i])).unwrap();
                        assert!(field.score(best, turns[best]) > WORTH, "{kind}: {at:?}");
                        at = places[best];
                        steps += 1;
                        assert!(steps < 12, "{kind}: {at:?}");
                    }
                }
            }
        }
    }
}
