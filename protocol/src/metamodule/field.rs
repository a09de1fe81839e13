//! The force field (thesis 4.1.3): open seeds attract, neighbours push. One mechanism; the three
//! strategies of the thesis differ in [`Repulsion`] only.
//!
//! Everything is an integer: vectors are in units of 1/65536 (so 1.0 is [`ONE`]), so that every
//! build on every machine makes the same choice.

use super::params::Repulsion;

/// 1.0 in the field's units.
pub const ONE: i64 = 1 << 16;

/// A force along the floor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct Force {
    /// Along +x.
    pub x: i64,
    /// Along +y.
    pub y: i64,
}

/// Four times the middle of the four cells of a metamodule, along the floor.
pub type Middle = (i64, i64);

/// The length of a vector, rounded down. Components stay far below 2³¹ here.
fn length(x: i64, y: i64) -> i64 {
    (x.unsigned_abs() * x.unsigned_abs() + y.unsigned_abs() * y.unsigned_abs()).isqrt() as i64
}

impl Force {
    /// The pull of seeds at these feet on a metamodule with its foot at `at`, scaled to length one:
    /// each seed pulls with 1/distance.
    pub fn attraction(at: (i16, i16), seeds: impl Iterator<Item = (i16, i16)>) -> Force {
        let mut sum = Force::default();
        for seed in seeds {
            let (dx, dy) = (i64::from(seed.0) - i64::from(at.0), i64::from(seed.1) - i64::from(at.1));
            let square = dx * dx + dy * dy;
            if square > 0 {
                sum.x += dx * ONE / square;
                sum.y += dy * ONE / square;
            }
        }
        match length(sum.x, sum.y) {
            0 => Force::default(),
            n => Force { x: sum.x * ONE / n, y: sum.y * ONE / n },
        }
    }

    /// Adds the push of a neighbour with its middle at `of` on a metamodule with its middle at `on`.
    pub fn push(&mut self, repulsion: Repulsion, on: Middle, of: Middle) {
        let (dx, dy) = (on.0 - of.0, on.1 - of.1);
        // Middles are in quarter cells; distances in 1/256 of that, so that rounding does not show.
        let distance = length(dx << 8, dy << 8);
        let range = i64::from(repulsion.range) << 10;
        if distance == 0 || distance >= range {
            return;
        }
        let fading = i64::from(repulsion.decay) * distance / range;
        let strength = i64::from(repulsion.strength) * (1000 - fading) * ONE / 1_000_000;
        self.x += strength * (dx << 8) / distance;
        self.y += strength * (dy << 8) / distance;
    }

    /// The score of moving the foot from `at` to `to` in `turns` steps: along the force, short ways
    /// first, not away from a seed that is close, and at best onto a seed.
    pub fn score(self, at: (i16, i16), to: (i16, i16), turns: u8, seeds: &[(i16, i16)]) -> i64 {
        let (dx, dy) = (i64::from(to.0) - i64::from(at.0), i64::from(to.1) - i64::from(at.1));
        let mut score = self.x * dx + self.y * dy - i64::from(turns) * ONE / 100;
        let away = |seed: &(i16, i16)| {
            let from = |p: (i16, i16)| {
                let (x, y) = (i64::from(p.0) - i64::from(seed.0), i64::from(p.1) - i64::from(seed.1));
                length(x * ONE, y * ONE)
            };
            let (before, after) = (from(at), from(to));
            if before < 4 * ONE { (after - before).max(0) } else { 0 }
        };
        score -= seeds.iter().map(away).max().unwrap_or(0);
        if seeds.contains(&to) {
            score += 10 * ONE;
        }
        score
    }
}

/// A move is made only for a score above this.
pub const WORTH: i64 = ONE / 20;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metamodule::params::Strategy;

    #[test]
    fn attraction_has_length_one_and_points_to_the_nearest_most() {
        let pull = Force::attraction((0, 0), [(10, 0)].into_iter());
        assert_eq!(pull, Force { x: ONE, y: 0 });
        let two = Force::attraction((0, 0), [(2, 0), (0, 6)].into_iter());
        assert!((length(two.x, two.y) - ONE).abs() < 4, "{two:?}");
        assert_eq!(two.x / two.y, 3);
        // Seeds on opposite sides cancel; a seed underfoot does not pull.
        assert_eq!(Force::attraction((0, 0), [(3, 0), (-3, 0), (0, 0)].into_iter()), Force::default());
    }

    #[test]
    fn strategies_differ_in_how_neighbours_push() {
        let push = |strategy: Strategy, cells: i64| {
            let mut force = Force::default();
            force.push(strategy.repulsion(), (0, 0), (-4 * cells, 0));
            force.x
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

    #[test]
    fn prefers_seeds_and_does_not_leave_them() {
        let seeds = [(4, 0)];
        let pull = Force::attraction((2, 0), seeds.into_iter());
        let score = |to, turns| pull.score((2, 0), to, turns, &seeds);
        assert!(score((4, 0), 9) > score((3, 0), 1));
        assert!(score((3, 0), 1) > score((3, 0), 5));
        assert!(score((1, 0), 1) < 0 && score((3, 0), 1) > WORTH);
    }
}
