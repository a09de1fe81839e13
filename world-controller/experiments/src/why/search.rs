//! The search for the instant at which the end of a run was decided: a curve of shares over the run, and then halving of the interval
//! with the largest change.
//!
//! The share of futures with the same end is a martingale along the run: it need not move steadily, and each single step of it is
//! the influence of one event. So the largest change is sought, not the point at which a threshold is crossed.

use super::futures::{Oracle, Point, Tally};
use metamorph_report::two_samples::{Difference, newcombe};
use std::ops::Range;

/// Number of points of the curve.
const POINTS: u64 = 12;
/// Number of futures at each point of the curve before anything is compared.
const FIRST: u64 = 25;
/// Number of futures at each point of the curve in the end.
const WHOLE: u64 = 100;
/// Numbers of futures at the ends and in the middle of an interval that is halved: more if the fewer do not decide.
const CLOSER: [u64; 5] = [50, 100, 200, 400, 800];
/// Numbers of the futures that confirm an interval. The search has not seen them, so they do not favour the interval that it chose.
const CONFIRMING: Range<u64> = 1_000_000..1_000_200;
/// Largest share at which an end counts as excluded: the whole interval is below it.
pub const EXCLUDED: f64 = 0.1;

/// The direction in which futures change towards the end of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Fewer end as is looked for: they are built no longer.
    Falls,
    /// More do: they break an invariant.
    Rises,
}

impl Direction {
    /// Returns the change from one point to another, positive in this direction.
    pub fn change(self, a: &Tally, b: &Tally) -> Difference {
        let (from, to) = match self {
            Direction::Falls => (b, a),
            Direction::Rises => (a, b),
        };
        newcombe(from.pair(), to.pair()).unwrap_or(Difference { by: 0.0, low: -1.0, high: 1.0 })
    }
    /// Returns true if the end of the run is almost certain: the whole interval is.
    pub fn is_decided(self, tally: &Tally) -> bool {
        match self {
            Direction::Falls => tally.rate().high < EXCLUDED,
            Direction::Rises => tally.rate().low > 1.0 - EXCLUDED,
        }
    }
    fn is_open(self, tally: &Tally) -> bool {
        match self {
            Direction::Falls => tally.rate().rate > 0.5,
            Direction::Rises => tally.rate().rate < 0.5,
        }
    }
}

/// The result of a search.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SearchResult {
    /// The points of the curve, in their order in time; the last is where the end began.
    pub curve: Vec<Point>,
    /// When the end was decided.
    pub decided: Decided,
    /// True if the search was stopped.
    pub is_cut_short: bool,
}

/// When the end of a run was decided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decided {
    /// By one event: the point before it and that after it.
    Instant(Point, Point),
    /// In the course of a stretch, of which no part holds half of the change.
    Stretch(Point, Point),
    /// At the start: almost no future of the whole run ends otherwise.
    AtStart,
    /// Not at all, up to the point where the end began.
    NotYet,
    /// Too few futures for an answer.
    Unknown,
}

impl Decided {
    /// Returns both ends of the interval, if there is one.
    pub fn ends(&self) -> Option<(&Point, &Point)> {
        match self {
            Decided::Instant(a, b) | Decided::Stretch(a, b) => Some((a, b)),
            Decided::AtStart | Decided::NotYet | Decided::Unknown => None,
        }
    }
}

/// Searches for the instant: a coarse curve, the interval with the largest change, its halves, and then the rest of the curve.
pub fn search(oracle: &mut dyn Oracle, direction: Direction) -> SearchResult {
    let curve = oracle.points(POINTS);
    let mut search = Search { oracle, direction };
    let mut found = SearchResult { curve, decided: Decided::Unknown, is_cut_short: true };
    let Ok(decided) = search.decide(&mut found.curve) else { return found };
    (found.decided, found.is_cut_short) = decided;
    // Points without enough futures are seen in their numbers.
    let _ = search.carry_out(&mut found.curve, WHOLE);
    found
}

/// The search was stopped.
struct Stopped;

struct Search<'o> {
    oracle: &'o mut dyn Oracle,
    direction: Direction,
}

impl Search<'_> {
    /// Returns when the end was decided, and whether the search for it was stopped.
    fn decide(&mut self, curve: &mut [Point]) -> Result<(Decided, bool), Stopped> {
        let open = self.open_part(curve)?;
        let curve = &mut curve[..open];
        self.compare(curve)?;
        if let Some(decided) = self.at_an_end(curve) {
            return Ok((decided, false));
        }
        let steps = curve.windows(2).map(|ends| self.direction.change(&ends[0].tally, &ends[1].tally).by);
        // The first of several that are equal.
        let largest =
            steps.enumerate().fold((0, f64::MIN), |most, step| if step.1 > most.1 { step } else { most });
        Ok(self.halve([curve[largest.0], curve[largest.0 + 1]]))
    }

    /// Returns the number of points up to the first at which the end is decided, or of all, with futures of each. Nothing changes
    /// after that one, and futures that stand still take the longest.
    fn open_part(&mut self, curve: &mut [Point]) -> Result<usize, Stopped> {
        for (i, point) in curve.iter_mut().enumerate() {
            self.carry_out([&mut *point], FIRST)?;
            if point.tally.is_unanimous() {
                self.carry_out([&mut *point], WHOLE)?;
            }
            if self.direction.is_decided(&point.tally) {
                return Ok(i + 1);
            }
        }
        Ok(curve.len())
    }

    /// Carries out futures of every point until there are `count` of each.
    fn carry_out<'p>(
        &mut self,
        points: impl IntoIterator<Item = &'p mut Point>,
        count: u64,
    ) -> Result<(), Stopped> {
        for point in points {
            // Numbers of futures begin at 1.
            let numbers = point.tally.of + 1..count + 1;
            if !numbers.is_empty() {
                let new = self.oracle.count(point, numbers).ok_or(Stopped)?;
                point.tally.add(&new);
            }
        }
        Ok(())
    }

    /// Carries out more futures of the points between which the change may be the largest, and of the start and the end.
    fn compare(&mut self, curve: &mut [Point]) -> Result<(), Stopped> {
        let steps: Vec<Difference> =
            curve.windows(2).map(|ends| self.direction.change(&ends[0].tally, &ends[1].tally)).collect();
        let least = steps.iter().map(|step| step.low).fold(0.0, f64::max);
        let last = curve.len() - 1;
        let may_be_largest = |i: usize| steps.get(i).is_some_and(|step| step.high >= least && step.by > 0.0);
        let wanted = |i: usize| i == 0 || i == last || may_be_largest(i) || may_be_largest(i - 1);
        self.carry_out(
            curve.iter_mut().enumerate().filter(|(i, _)| wanted(*i)).map(|(_, point)| point),
            WHOLE,
        )
    }

    /// Returns the answer if the start decided everything, or nothing has been decided.
    fn at_an_end(&self, curve: &[Point]) -> Option<Decided> {
        let (first, last) = (curve.first()?.tally, curve.last()?.tally);
        if self.direction.is_decided(&first) {
            return Some(Decided::AtStart);
        }
        let is_unchanged = curve.len() < 2 || self.direction.change(&first, &last).low <= 0.0;
        (is_unchanged && (curve.len() < 2 || self.direction.is_open(&last))).then_some(Decided::NotYet)
    }

    /// Halves an interval as long as one half of it holds at least half of the change of the first one, down to one event. Returns
    /// the narrowest that new futures confirm, and whether that was stopped.
    fn halve(&mut self, ends: [Point; 2]) -> (Decided, bool) {
        let whole = self.direction.change(&ends[0].tally, &ends[1].tally).by;
        let mut intervals = vec![ends];
        let mut is_stopped = false;
        while let Some(ends) = intervals.last().copied().filter(|[a, b]| a.events + 1 < b.events) {
            match self.half(ends, whole) {
                Ok(Some(half)) => intervals.push(half),
                Ok(None) => break,
                Err(Stopped) => {
                    is_stopped = true;
                    break;
                }
            }
        }
        let last = intervals[intervals.len() - 1];
        // Stopped while it confirms: as the search left it.
        self.confirmed(intervals, whole)
            .map_or((Decided::Stretch(last[0], last[1]), true), |d| (d, is_stopped))
    }

    /// Returns the half of an interval that holds at least half of a change; `None` if neither does.
    fn half(&mut self, [mut a, mut b]: [Point; 2], whole: f64) -> Result<Option<[Point; 2]>, Stopped> {
        let mut middle = self.oracle.point(u64::midpoint(a.events, b.events));
        for count in CLOSER {
            // Of a point all of whose futures end alike more say little, and those that stand still take long.
            let is_open = |point: &&mut Point| point.tally.of < WHOLE || !point.tally.is_unanimous();
            self.carry_out([&mut a, &mut middle, &mut b].into_iter().filter(is_open), count)?;
            let halves = [[a, middle], [middle, b]];
            let changes = halves.map(|[from, to]| self.direction.change(&from.tally, &to.tally));
            let larger = usize::from(changes[1].by > changes[0].by);
            let half = halves[larger];
            // Neither half holds half of the change, whatever more futures would say.
            if changes[larger].high < whole / 2.0 {
                break;
            }
            // Clearly the larger one: else two halves that are alike would be told apart by chance.
            let (larger, other) = (changes[larger], changes[1 - larger]);
            if larger.by >= whole / 2.0 && larger.low > other.by.max(0.0) {
                return Ok(Some(half));
            }
        }
        Ok(None)
    }

    /// Returns the last of nested intervals in which new futures find a change as large, with these futures.
    fn confirmed(&mut self, mut intervals: Vec<[Point; 2]>, whole: f64) -> Result<Decided, Stopped> {
        while let Some([mut a, mut b]) = intervals.pop() {
            for point in [&mut a, &mut b] {
                point.tally = self.oracle.count(point, CONFIRMING).ok_or(Stopped)?;
            }
            let found = self.direction.change(&a.tally, &b.tally);
            if found.low > 0.0 && (found.high >= whole / 2.0 || intervals.is_empty()) {
                let is_event = a.events + 1 == b.events;
                return Ok(if is_event { Decided::Instant(a, b) } else { Decided::Stretch(a, b) });
            }
        }
        // New futures find no change at all.
        Ok(Decided::NotYet)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::rng::Rng;
    use metamorph_protocol::time::Time;

    /// Futures of which a share ends as is looked for that depends on the event.
    struct Drawn<F> {
        share: F,
        events: u64,
        seed: u64,
        /// Futures that may still be carried out.
        left: u64,
    }

    impl<F: Fn(u64) -> f64> Oracle for Drawn<F> {
        fn points(&mut self, count: u64) -> Vec<Point> {
            (0..count).map(|i| self.point(self.events * i / (count - 1))).collect()
        }
        fn point(&mut self, events: u64) -> Point {
            Point { events, at: Time(events), tally: Tally::default() }
        }
        fn count(&mut self, point: &Point, numbers: Range<u64>) -> Option<Tally> {
            let mut tally = Tally::default();
            for number in numbers {
                self.left = self.left.checked_sub(1)?;
                let mut random = Rng::named(self.seed ^ number, "future", point.events);
                tally.take(
                    number,
                    (random.below(1 << 32) as f64) < (self.share)(point.events) * 2f64.powi(32),
                );
            }
            Some(tally)
        }
    }

    fn found(seed: u64, direction: Direction, share: impl Fn(u64) -> f64) -> SearchResult {
        let mut oracle = Drawn { share, events: 10_000, seed, left: u64::MAX };
        search(&mut oracle, direction)
    }

    #[test]
    fn one_event_that_decides_is_found() {
        for seed in 0..20 {
            let at = 1_000 + 371 * seed;
            let fall = found(seed, Direction::Falls, |e| if e <= at { 0.4 } else { 0.0 });
            let Decided::Instant(a, b) = fall.decided else { panic!("seed {seed}: {fall:?}") };
            assert_eq!((a.events, b.events), (at, at + 1), "seed {seed}");
            assert_eq!((a.tally.of, b.tally.of), (200, 200));
            assert!((a.tally.rate().rate - 0.4).abs() < 0.15 && b.tally.yes == 0 && !fall.is_cut_short);
            assert!(fall.curve.iter().all(|point| point.tally.of == 100));
            let rise = found(seed, Direction::Rises, |e| if e <= at { 0.1 } else { 1.0 });
            let Decided::Instant(a, b) = rise.decided else { panic!("seed {seed}: {rise:?}") };
            assert_eq!((a.events, b.events), (at, at + 1), "seed {seed}");
        }
    }

    /// The event is found beside a gradual fall that is larger in all, but not in any interval.
    #[test]
    fn the_largest_step_is_found_beside_a_slope() {
        for seed in 0..20 {
            let share = |e: u64| 0.9 - 0.4 * (e as f64 / 10_000.0) - if e > 6_283 { 0.4 } else { 0.0 };
            let Decided::Instant(a, _) = found(seed, Direction::Falls, share).decided else {
                panic!("seed {seed}")
            };
            assert_eq!(a.events, 6_283, "seed {seed}");
        }
    }

    #[test]
    fn what_erodes_is_a_stretch() {
        for seed in 0..20 {
            let slope = |e: u64| 0.9 - 0.9 * (e as f64 / 10_000.0);
            let found = found(seed, Direction::Falls, slope);
            let Decided::Stretch(a, b) = found.decided else { panic!("seed {seed}: {found:?}") };
            assert!(b.events - a.events > 100, "seed {seed}: {} to {}", a.events, b.events);
        }
    }

    #[test]
    fn ends_are_the_start_or_open() {
        for seed in 0..20 {
            assert_eq!(found(seed, Direction::Falls, |_| 0.01).decided, Decided::AtStart, "seed {seed}");
            assert_eq!(found(seed, Direction::Rises, |_| 0.99).decided, Decided::AtStart, "seed {seed}");
            assert_eq!(found(seed, Direction::Falls, |_| 0.95).decided, Decided::NotYet, "seed {seed}");
        }
    }

    /// Futures that do not depend on the event have no instant: at most a few of a hundred runs seem to.
    #[test]
    fn chance_is_rarely_taken_for_a_decision() {
        let is_instant =
            |seed: &u64| matches!(found(*seed, Direction::Falls, |_| 0.3).decided, Decided::Instant(..));
        let instants = (0..100).filter(is_instant).count();
        assert!(instants <= 5, "{instants} of 100");
        let is_open = |seed: &u64| found(*seed, Direction::Falls, |_| 0.3).decided == Decided::NotYet;
        let open = (0..100).filter(is_open).count();
        assert!(open >= 90, "{open} of 100");
    }

    #[test]
    fn a_stopped_search_says_so() {
        for left in [0, 100, 300, 500, 900] {
            let share = |e: u64| if e <= 5_000 { 0.5 } else { 0.0 };
            let mut oracle = Drawn { share, events: 10_000, seed: 1, left };
            let found = search(&mut oracle, Direction::Falls);
            assert!(found.is_cut_short, "{left}: {found:?}");
            assert!(!matches!(found.decided, Decided::Instant(..)), "{left}");
        }
    }
}
