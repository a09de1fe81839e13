//! A* and beam search in turn: A* proves a lower bound, beam search finds plans, and A* is given those.

use super::beam::Beam;
use super::search::{Method, OPTIMAL, Search};
use super::{Limits, Outcome, Path, Progress, Space, Step};

/// Beam search gets one part in this many of memory and work.
const SHARE: usize = 4;
/// Number of expansions of one engine before the other one continues.
const EXPANSIONS_PER_TURN: u64 = 64;

/// Both searches under way.
pub struct Portfolio<S: Space> {
    exact: Search<S>,
    /// `None` when it has ended.
    beam: Option<Beam<S>>,
    /// The numbers of states that the beam search has expanded and generated if it has ended.
    ended: Progress,
    beams_turn: bool,
    /// The factor in hundredths within which a plan is good enough.
    weight: u32,
}

impl<S: Space + Clone> Portfolio<S> {
    /// Begins both. They end with a plan that costs at most `weight` hundredths of the proven lower bound.
    pub fn new(space: S, start: &S::State, limits: Limits, weight: u32) -> Portfolio<S> {
        let (memory, work) = (limits.memory / SHARE, limits.work / SHARE as u64);
        let beam = Beam::new(space.clone(), start, Limits { memory, work });
        let limits = Limits { memory: limits.memory - memory, work: limits.work - work };
        let method = Method { deepen: false, ..Method::astar() };
        let exact = Search::new(space, start, limits, method);
        Portfolio { exact, beam: Some(beam), ended: Progress::default(), beams_turn: true, weight }
    }
}

impl<S: Space> Portfolio<S> {
    /// Returns how far both are together.
    pub fn progress(&self) -> Progress {
        let (exact, beam) = (self.exact.progress(), self.beam.as_ref().map_or(self.ended, Beam::progress));
        Progress {
            lower: exact.lower,
            upper: [exact.upper, beam.upper].into_iter().flatten().min(),
            expanded: exact.expanded + beam.expanded,
            generated: exact.generated + beam.generated,
            kept: exact.kept + beam.kept,
            bytes: exact.bytes + beam.bytes,
        }
    }
    /// Returns the best path so far.
    pub fn path(&self) -> Option<Path> {
        self.exact.path()
    }
    /// Works for at least `work` expansions, in whole turns.
    pub fn advance(&mut self, work: u64) -> Step {
        let mut left = work.div_ceil(EXPANSIONS_PER_TURN);
        while left > 0 {
            left -= 1;
            self.beams_turn = !self.beams_turn && self.beam.is_some();
            match &mut self.beam {
                Some(beam) if self.beams_turn => {
                    let before = beam.path().map(|p| p.cost);
                    let step = beam.advance(EXPANSIONS_PER_TURN);
                    if let Some(path) = beam.path().filter(|p| Some(p.cost) != before) {
                        self.exact.know(path.clone());
                    }
                    if step != Step::Running {
                        self.ended = beam.progress();
                        self.beam = None;
                    }
                }
                _ => match (self.exact.advance(EXPANSIONS_PER_TURN), &self.beam) {
                    (Step::Running, _) => {
                        let Progress { lower, upper, .. } = self.exact.progress();
                        if upper.is_some_and(|upper| upper * OPTIMAL <= lower * self.weight)
                            && let Some(path) = self.exact.path()
                        {
                            return Step::Done(Outcome::Solved { path, lower });
                        }
                    }
                    (Step::Done(Outcome::OutOf { resource, lower, .. }), beam) => {
                        // The bound is final, but beam search may still find a plan, or a better one.
                        return match self.exact.path() {
                            Some(path) if path.cost * OPTIMAL <= lower * self.weight => {
                                Step::Done(Outcome::Solved { path, lower })
                            }
                            _ if beam.is_some() => continue,
                            best => Step::Done(Outcome::OutOf { resource, best, lower }),
                        };
                    }
                    (done, _) => return done,
                },
            }
        }
        Step::Running
    }
}
