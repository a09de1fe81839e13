//! The force field (thesis 4.1.3): open seeds attract, neighbours push. One mechanism; the three
//! strategies of the thesis differ in [`Repulsion`] only.
//!
//! Everything is an integer: vectors are in units of 1/65536 (so 1.0 is [`ONE`]), so that every
//! build on every machine makes the same choice.

use super::motions::Motions;
use super::params::Repulsion;
use crate::roombots::grid::GridState;

/// 1.0 in the field's units.
pub const ONE: i64 = 1 << 16;

/// A connector of the floor.
pub type Place = (i16, i16);
/// Four times the middle of the four cells of a metamodule, along the floor.
pub type Middle = (i64, i64);

/// What acts on a metamodule in one place: the pull of the open seeds, and the push of the neighbours
/// in range.
///
/// Each seed pulls with 1/distance, and all together with a force of one. The pull is not taken where a
/// stride begins but over all of it, as the difference of distances; and distance is what matters to a
/// metamodule, mainly the number of moves, because its strides are coarse: no kind has one of two cells
/// straight ahead, PAR has none of one. So a stride that overshoots its seed gains nothing.
#[derive(Clone, Debug)]
pub struct Field<'a> {
    motions: &'a Motions,
    at: GridState,
    /// Seeds with their distances and weights, which add up to one.
    seeds: Vec<(Place, i64, i64)>,
    push: (i64, i64),
}

/// The length of a vector, rounded down. Components stay far below 2³¹ here.
fn length(x: i64, y: i64) -> i64 {
    (x.unsigned_abs() * x.unsigned_abs() + y.unsigned_abs() * y.unsigned_abs()).isqrt() as i64
}

/// Two cells for every move, and a quarter of the distance as the crow flies to tell equals apart.
fn distance(motions: &Motions, from: GridState, to: Place) -> i64 {
    let (dx, dy) = (i64::from(to.0) - i64::from(from.x), i64::from(to.1) - i64::from(from.y));
    2 * ONE * i64::from(motions.moves_to(from, to)) + length(dx * ONE, dy * ONE) / 4
}

impl<'a> Field<'a> {
    /// The pull of these seeds on a metamodule that stands at `at`.
    pub fn of_seeds(motions: &'a Motions, at: GridState, seeds: impl Iterator<Item = Place>) -> Field<'a> {
        let weighted = |seed: Place| {
            let far = distance(motions, at, seed);
            (seed, far, ONE * ONE / far.max(1))
        };
        // Whoever stands on a seed's connector does not ask for the way to it.
        let mut seeds: Vec<_> = seeds.filter(|seed| *seed != (at.x, at.y)).map(weighted).collect();
        let sum: i64 = seeds.iter().map(|(_, _, w)| w).sum();
        for (_, _, weight) in &mut seeds {
            *weight = *weight * ONE / sum.max(1);
        }
        Field { motions, at, seeds, push: (0, 0) }
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

    /// What a stride to `to` in `turns` steps is worth: nearer to the seeds, away from neighbours,
    /// short motions first, and at best `home`, to where a seed can be filled from.
    pub fn score(&self, to: GridState, turns: u8, home: bool) -> i64 {
        let gain = |(seed, far, weight): &(Place, i64, i64)| {
            (far - distance(self.motions, to, *seed)) * weight / ONE
        };
        let pull: i64 = self.seeds.iter().map(gain).sum();
        let (dx, dy) = (i64::from(to.x) - i64::from(self.at.x), i64::from(to.y) - i64::from(self.at.y));
        let home = if home { 10 * ONE } else { 0 };
        pull + self.push.0 * dx + self.push.1 * dy - i64::from(turns) * ONE / 100 + home
    }
}

/// A move is made only for a score above this.
pub const WORTH: i64 = ONE / 20;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metamodule::params::Strategy;
    use crate::roombots::Kind;
    use crate::roombots::database::Database;
    use std::sync::Arc;

    fn all() -> Vec<Motions> {
        let database = Arc::new(Database::build());
        Kind::METAMODULES.map(|kind| Motions::new(Arc::clone(&database), kind).unwrap()).into()
    }

    #[test]
    fn strategies_differ_in_how_neighbours_push() {
        let motions = &all()[0];
        let push = |strategy: Strategy, cells: i64| {
            let mut field = Field::of_seeds(motions, GridState::default(), std::iter::empty());
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

    /// Alone on the open grid every kind comes from everywhere to a single seed, each stride nearer
    /// than the one before: no local minimum, no going to and fro.
    #[test]
    fn alone_every_kind_gets_to_its_seed() {
        for motions in all() {
            let landings: Vec<GridState> = motions.table().landings().iter().map(|l| l.state).collect();
            for (x, y, class) in
                [(2, 0, 0), (0, 2, 1), (1, 0, 2), (0, -1, 3), (-7, 5, 0), (12, 12, 1), (40, -3, 2)]
            {
                let mut at = GridState::new(x, y, class);
                let mut far = distance(&motions, at, (0, 0));
                for moves in 0.. {
                    if (at.x, at.y) == (0, 0) {
                        break;
                    }
                    assert!(moves < 30, "{}: {at}", motions.kind());
                    let field = Field::of_seeds(&motions, at, [(0, 0)].into_iter());
                    let best =
                        landings.iter().map(|l| at.then(*l)).max_by_key(|to| field.score(*to, 8, false));
                    assert!(field.score(best.unwrap(), 8, false) > WORTH, "{}: {at}", motions.kind());
                    at = best.unwrap();
                    let now = distance(&motions, at, (0, 0));
                    assert!(now < far, "{}: {at}", motions.kind());
                    far = now;
                }
            }
        }
    }
}
