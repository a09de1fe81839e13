//! Standstills of the local protocol in the course of a run: when each was noticed, and what ended it.
//!
//! A standstill that the controller or an operator resolves does not end the run, but it is a result all the same: without help
//! the run would have ended there. It lasts until modules move again that the controller has not asked to, so a swarm that goes
//! from call to call counts as one standstill.

use crate::director::outcome::Stall;
use crate::director::rescue::Help;
use metamorph_core::time::{Span, Time};

/// The part of the bound of a deadlock after which a time without moves counts as a standstill. Calls begin then, too.
pub const PATIENCE: u64 = 4;
/// The part of the bound of a livelock after which moves without a filled cell count as a standstill.
pub const JAM_PATIENCE: u64 = 2;
/// The largest number of standstills that are kept with their evidence; the rest is counted.
pub const KEPT_MAX: usize = 100;

/// How a standstill ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum StandstillEnd {
    /// Modules moved again by themselves.
    Itself,
    /// Modules moved again after the controller had called some.
    Call,
    /// Modules moved again, or the goal was built, after the controller had led some by a plan for the whole swarm.
    Plan,
    /// The controller moved the goal to another place.
    Relocation,
    /// Modules moved again after an operator had commanded something.
    Operator,
    /// It did not: the run ended first.
    Nothing,
}

impl StandstillEnd {
    /// All ends.
    pub const ALL: [StandstillEnd; 6] = [
        StandstillEnd::Itself,
        StandstillEnd::Call,
        StandstillEnd::Plan,
        StandstillEnd::Relocation,
        StandstillEnd::Operator,
        StandstillEnd::Nothing,
    ];

    /// Returns the name used in reports.
    pub const fn name(self) -> &'static str {
        match self {
            StandstillEnd::Itself => "itself",
            StandstillEnd::Call => "call",
            StandstillEnd::Plan => "plan",
            StandstillEnd::Relocation => "relocation",
            StandstillEnd::Operator => "operator",
            StandstillEnd::Nothing => "nothing",
        }
    }
    /// Returns true if the controller resolved the standstill.
    pub const fn is_rescue(self) -> bool {
        matches!(self, StandstillEnd::Call | StandstillEnd::Plan | StandstillEnd::Relocation)
    }
}

/// A standstill in the course of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StandstillRecord {
    /// Its start, why it came about, the unfilled cells and who waited for whom, when it was noticed.
    pub stall: Stall,
    /// When it was noticed.
    pub noticed: Time,
    /// When it ended; `None` if the run ended first.
    pub until: Option<Time>,
    /// How it ended.
    pub end: StandstillEnd,
    /// True if modules moved, but no cell was filled.
    pub is_jam: bool,
    /// The help of the controller while it lasted.
    pub help: Help,
}

/// The state of a run at an instant, as far as it decides whether the swarm stands still.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Look {
    /// The time.
    pub now: Time,
    /// True if an event is planned that may let modules continue.
    pub is_planned: bool,
    /// The start of the time without moves.
    pub idle_since: Time,
    /// The start of the time without a filled cell.
    pub no_gain_since: Time,
    /// The number of moves completed.
    pub moves: u64,
    /// The number of cells filled.
    pub filled: usize,
    /// The help of the controller so far.
    pub help: Help,
    /// True while the controller leads the swarm by a plan: then only called modules move, and none is finalized.
    pub is_led: bool,
    /// The number of commands so far by which operators helped the swarm.
    pub commands: usize,
}

/// The present standstill.
#[derive(Clone, Copy, Debug)]
struct Present {
    /// How it was when the standstill was noticed.
    begun: Look,
    is_jam: bool,
    /// The index of its record; `None` if that is not kept.
    record: Option<usize>,
}

/// The standstills of a run.
#[derive(Clone, Debug, Default)]
pub struct Standstills {
    kept: Vec<StandstillRecord>,
    counts: [u64; StandstillEnd::ALL.len()],
    present: Option<Present>,
    last: Look,
}

impl Standstills {
    /// Returns the standstills that were kept with their evidence, in order: the first [`KEPT_MAX`].
    pub fn kept(&self) -> &[StandstillRecord] {
        &self.kept
    }
    /// Returns how many standstills ended in each way, in the order of [`StandstillEnd::ALL`]. One that still lasts counts as
    /// ended by nothing.
    pub fn counts(&self) -> [u64; StandstillEnd::ALL.len()] {
        let mut counts = self.counts;
        counts[StandstillEnd::Nothing as usize] += u64::from(self.present.is_some());
        counts
    }
    /// Returns the help of the controller in the whole run.
    pub fn help(&self) -> Help {
        self.last.help
    }
    /// Returns true while a standstill lasts.
    pub fn is_present(&self) -> bool {
        self.present.is_some()
    }

    /// Ends the present standstill if it is over. Returns the time since which modules stand still if another one is to be
    /// noticed now: the caller then hands its evidence to [`Standstills::begin`]. `stall` and `livelock` are the bounds that end
    /// a run.
    pub fn look(&mut self, look: Look, stall: Span, livelock: Span) -> Option<Time> {
        self.last = look;
        if let Some(Present { begun, is_jam, .. }) = self.present {
            let helped = look.help.since(begun.help).moves();
            let moved_alone = look.moves.saturating_sub(begun.moves) > helped;
            let has_gained = look.filled > begun.filled;
            // A cell that a called module fills does not show that the others continue.
            let is_over = if is_jam { has_gained } else { moved_alone || (has_gained && helped == 0) };
            if is_over && !look.is_led {
                self.resolve(look.now);
            }
            return None;
        }
        let is_idle = look.now.since(look.idle_since) > stall / PATIENCE;
        let is_jammed = look.now.since(look.no_gain_since) > livelock / JAM_PATIENCE;
        let is_noticed = !look.is_planned && !look.is_led && (is_idle || is_jammed);
        is_noticed.then_some(if is_idle { look.idle_since } else { look.no_gain_since })
    }

    /// Begins a standstill with its evidence, at the time of the last look.
    pub fn begin(&mut self, stall: Stall) {
        let begun = self.last;
        let is_jam = stall.since < begun.idle_since;
        let record = (self.kept.len() < KEPT_MAX).then_some(self.kept.len());
        self.present = Some(Present { begun, is_jam, record });
        if record.is_some() {
            let (noticed, help) = (begun.now, Help::default());
            let end = StandstillEnd::Nothing;
            self.kept.push(StandstillRecord { stall, noticed, until: None, end, is_jam, help });
        }
    }

    /// Ends the present standstill, if there is one: modules continue, or the goal is built.
    pub fn resolve(&mut self, now: Time) {
        let Some(Present { begun, record, .. }) = self.present.take() else { return };
        let help = self.last.help.since(begun.help);
        let end = match help {
            Help { led: 1.., .. } => StandstillEnd::Plan,
            Help { called: 1.., .. } => StandstillEnd::Call,
            _ if self.last.commands > begun.commands => StandstillEnd::Operator,
            _ => StandstillEnd::Itself,
        };
        self.ended((begun, record), end, now);
    }

    /// Ends the present standstill, if there is one, because the controller moved the goal.
    pub fn relocate(&mut self, now: Time) {
        if let Some(Present { begun, record, .. }) = self.present.take() {
            self.ended((begun, record), StandstillEnd::Relocation, now);
        }
    }

    fn ended(&mut self, (begun, record): (Look, Option<usize>), end: StandstillEnd, now: Time) {
        self.counts[end as usize] += 1;
        if let Some(record) = record.and_then(|at| self.kept.get_mut(at)) {
            (record.until, record.end, record.help) = (Some(now), end, self.last.help.since(begun.help));
        }
    }

    /// Takes note that the run ends while the present standstill, if there is one, still lasts.
    pub fn close(&mut self) {
        if let Some(Present { begun, record: Some(at), .. }) = self.present {
            self.kept[at].help = self.last.help.since(begun.help);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::director::reason::NO_PATH;

    const STALL: Span = Span::secs(40);
    const LIVELOCK: Span = Span::secs(200);

    fn at(s: u64) -> Time {
        Time::ZERO + Span::secs(s)
    }
    fn stall(since: Time) -> Stall {
        let (reason, open, waiting) = (NO_PATH, Vec::new(), Vec::new());
        Stall { since, reason, text: "", open, wait_cycle: Vec::new(), waiting, detected: None, proof: None }
    }
    /// Looks each second from one time to another, and returns when a standstill was noticed.
    fn follow(standstills: &mut Standstills, from: u64, to: u64, look: impl Fn(u64) -> Look) -> Vec<u64> {
        let mut noticed = Vec::new();
        for s in from..to {
            if let Some(since) = standstills.look(Look { now: at(s), ..look(s) }, STALL, LIVELOCK) {
                standstills.begin(stall(since));
                noticed.push(s);
            }
        }
        noticed
    }
    fn ends(standstills: &Standstills) -> Vec<(StandstillEnd, Option<Time>)> {
        standstills.kept().iter().map(|record| (record.end, record.until)).collect()
    }

    #[test]
    fn one_that_ends_by_itself_is_counted() {
        let mut standstills = Standstills::default();
        let look = |s| Look {
            moves: u64::from(s >= 20),
            idle_since: at(if s < 20 { 0 } else { s }),
            ..Look::default()
        };
        assert_eq!(follow(&mut standstills, 0, 30, look), [11]);
        assert_eq!(ends(&standstills), [(StandstillEnd::Itself, Some(at(20)))]);
        assert_eq!(standstills.counts(), [1, 0, 0, 0, 0, 0]);
    }

    /// Called modules move and fill cells: that is one standstill, until another one moves.
    #[test]
    fn it_lasts_until_a_module_moves_that_was_not_called() {
        let mut standstills = Standstills::default();
        let look = |s: u64| {
            let called = s.saturating_sub(15).min(5);
            let help = Help { called, led: 0 };
            Look { moves: called + u64::from(s >= 40), filled: called as usize, help, ..Look::default() }
        };
        assert_eq!(follow(&mut standstills, 0, 41, look), [11]);
        assert_eq!(ends(&standstills), [(StandstillEnd::Call, Some(at(40)))]);
        assert_eq!(standstills.kept()[0].help, Help { called: 5, led: 0 });
    }

    #[test]
    fn a_plan_ends_it_when_the_goal_is_built() {
        let mut standstills = Standstills::default();
        let led = |s: u64| Help { called: 1, led: s.saturating_sub(20) };
        let look = |s| Look { moves: led(s).moves(), help: led(s), is_led: s > 20, ..Look::default() };
        follow(&mut standstills, 0, 30, look);
        standstills.resolve(at(30));
        assert_eq!(ends(&standstills), [(StandstillEnd::Plan, Some(at(30)))]);
        assert_eq!(standstills.help(), Help { called: 1, led: 9 });
    }

    #[test]
    fn moves_that_fill_nothing_are_one_too() {
        let mut standstills = Standstills::default();
        let filled = |s| usize::from(s >= 150);
        let look = |s| Look {
            moves: s,
            idle_since: at(s),
            no_gain_since: at(0),
            filled: filled(s),
            ..Look::default()
        };
        assert_eq!(follow(&mut standstills, 0, 151, look), [101]);
        assert!(standstills.kept()[0].is_jam);
        assert_eq!(ends(&standstills), [(StandstillEnd::Itself, Some(at(150)))]);
    }

    #[test]
    fn planned_events_and_operators_are_told_apart() {
        let mut standstills = Standstills::default();
        assert_eq!(follow(&mut standstills, 0, 60, |_| Look { is_planned: true, ..Look::default() }), []);
        let look = |s| Look { commands: usize::from(s > 70), moves: u64::from(s > 80), ..Look::default() };
        assert_eq!(follow(&mut standstills, 60, 82, look), [60]);
        assert_eq!(ends(&standstills), [(StandstillEnd::Operator, Some(at(81)))]);
        // The last one lasts until the run ends.
        follow(&mut standstills, 82, 99, |_| Look { moves: 1, ..Look::default() });
        standstills.close();
        assert_eq!(standstills.counts(), [0, 0, 0, 0, 1, 1]);
    }

    /// The evidence is kept of the first ones only, and all are counted.
    #[test]
    fn what_is_kept_is_bounded() {
        let mut standstills = Standstills::default();
        let stands = 12;
        let count = KEPT_MAX as u64 + 5;
        let look = |s: u64| {
            let since = at(s / stands * stands);
            Look { moves: s / stands, idle_since: since, no_gain_since: since, ..Look::default() }
        };
        follow(&mut standstills, 0, count * stands + 1, look);
        assert_eq!((standstills.kept().len(), standstills.counts()), (KEPT_MAX, [count, 0, 0, 0, 0, 0]));
    }
}
