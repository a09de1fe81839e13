//! The inputs without which a run would have ended otherwise: each input that the decisive event follows from is withheld alone, and the
//! futures after the instant are counted again.
//!
//! All else is as it was up to the instant: the copy has the random numbers of the run until then, and its own from there on. The
//! environment may do all of it: lose a message, or let a process sleep.

use super::futures::{Futures, Oracle, Point, Question, Reseeded, Tally};
use super::past::{PastInput, causes};
use super::search::{Decided, Direction};
use super::subject::Subject;
use metamorph_families::simulated::SteppedRun;
use metamorph_protocol::time::{Span, Time};
use metamorph_report::statistics::fisher;
use metamorph_report::two_samples::holm;
use metamorph_scenario::Plan;
use metamorph_sim_bridge::kernel::change::{Change, ChangeKind};
use std::cmp::Reverse;

/// Largest number of inputs that are withheld.
const INPUTS: usize = 48;
/// Number of time steps before the instant, or of the stretch, within which inputs are withheld: a lease is shorter.
const STEPS: u64 = 8;
/// Number of futures without each input at first.
const FIRST: u64 = 25;
/// Number of futures without an input that may be decisive.
const MORE: u64 = 200;
/// Largest probability, adjusted for the number of inputs, with which an input without effect is named.
const LEVEL: f64 = 0.05;
/// Largest number of inputs that are named.
const NAMED: usize = 5;

/// An input that was withheld.
pub struct Withheld {
    /// The input.
    pub input: PastInput,
    /// The change that withholds it.
    pub change: Change,
    /// The point after the instant in the run without it, and its futures.
    pub after: Point,
    /// The probability of a difference as large by chance, adjusted for the number of inputs (Fisher, Holm).
    pub p: f64,
}

/// The inputs that were withheld.
pub struct Decision {
    /// Those that decided, the one with the largest effect first.
    pub named: Vec<Withheld>,
    /// Number of all.
    pub withheld: usize,
    /// True if that was stopped before all were.
    pub is_cut_short: bool,
}

/// Withholds the inputs that the end of an interval follows from, one at a time. Returns `None` if there is no interval.
pub fn decide(
    subject: &Subject,
    question: &Question<'_>,
    of_run: &Futures<'_>,
    decided: &Decided,
) -> Option<Decision> {
    let (before, after) = decided.ends()?;
    let direction = subject.direction();
    let whole = direction.change(&before.tally, &after.tally).by;
    let run = of_run.run_at(before.events);
    let time_step = run.time_step();
    let since = Time(after.at.0.saturating_sub((time_step * STEPS).0)).min(before.at);
    // The same instant without any change: other events of the instant count for nothing.
    let mut control = Without::of(question, &subject.plan, run, None, after.at);
    control.carry_out(MORE)?;
    let control = control.point.tally;
    let inputs = causes(&subject.plan, after.events - 1, since, INPUTS);
    let (all, mut tried) = (inputs.len(), Vec::new());
    for input in inputs {
        let run = of_run.run_at(input.events);
        let mut without = Without::of(question, &subject.plan, run, Some((&input, time_step)), after.at);
        if without.carry_out(FIRST).is_none() {
            break;
        }
        // More if the whole change may be restored.
        let may_decide = restored(direction, &control, &without.point.tally).1 >= whole / 2.0;
        if may_decide && without.carry_out(MORE).is_none() {
            break;
        }
        if let Some(change) = without.change {
            tried.push(Withheld { input, change, after: without.point, p: 1.0 });
        }
    }
    let withheld = tried.len();
    let p = tried.iter().map(|one| fisher(one.after.tally.pair(), control.pair()).unwrap_or(1.0));
    let p: Vec<f64> = holm(&p.collect::<Vec<_>>());
    tried.iter_mut().zip(p).for_each(|(one, p)| one.p = p);
    let effect = |one: &Withheld| restored(direction, &control, &one.after.tally).0;
    tried.retain(|one| one.p <= LEVEL && effect(one) >= whole / 2.0);
    // Of equal effects the latest input; shares of up to 200 futures differ by more than a thousandth.
    tried.sort_by_key(|one| Reverse(((effect(one) * 1e3) as i64, one.input.events)));
    tried.truncate(NAMED);
    Some(Decision { named: tried, withheld, is_cut_short: withheld < all })
}

/// Returns by how much the share is restored without an input: the estimate, and the upper end of its interval.
fn restored(direction: Direction, after: &Tally, without: &Tally) -> (f64, f64) {
    let change = direction.change(without, after);
    (change.by, change.high)
}

/// The futures of a run without one of its inputs, from an instant on.
struct Without<'a> {
    /// The change that withholds the input; `None` if none is withheld.
    change: Option<Change>,
    futures: Futures<'a>,
    point: Point,
}

impl<'a> Without<'a> {
    /// Carries a run of this plan out up to the instant; without an input, before whose event it is. A process sleeps for a time
    /// step beyond the time of the input.
    fn of(
        question: &'a Question<'a>,
        plan: &Plan,
        mut run: Box<dyn SteppedRun>,
        input: Option<(&PastInput, Span)>,
        until: Time,
    ) -> Without<'a> {
        let mut plan = plan.clone();
        let change = input.map(|(input, time_step)| {
            let kind = match input.message() {
                Some(name) => ChangeKind::Lose(name),
                None => ChangeKind::Sleep(input.who.0, input.at().since(run.now()) + time_step),
            };
            run.change(kind)
        });
        change.into_iter().for_each(|change| plan.add_change(change));
        run.run_until(until);
        let mut futures = Futures::new(&plan, until, question, Reseeded::Links);
        let point = futures.keep(&*run);
        Without { change, futures, point }
    }

    /// Carries futures out until there are `count`.
    fn carry_out(&mut self, count: u64) -> Option<()> {
        let numbers = self.point.tally.of + 1..count + 1;
        let new = self.futures.count(&self.point, numbers)?;
        self.point.tally.add(&new);
        Some(())
    }
}
