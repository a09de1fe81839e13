//! Simulated runs that are recorded, shown and commanded.

use super::PageChannels;
use super::machine::RealMachine;
use crate::control::{CommandQueue, READ_EVERY};
use crate::record::journal::JournalSession;
use crate::record::tee::both;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_families::simulated::{SteppedRun, Watch, to_the_end};
use metamorph_protocol::time::Time;
use metamorph_report::run_result::RunResult;
use metamorph_report::schema::Report;
use metamorph_runs::{begin, conclude};
use metamorph_scenario::Plan;

/// The inputs of a simulated run besides its plan.
pub struct Simulation<'w> {
    /// When the program started.
    pub since: Stopwatch,
    /// Called between slices of the run.
    pub watch: &'w mut Watch<'w>,
    /// The journal, if one is written.
    pub keeping: Option<JournalSession>,
    /// The page, if one is shown. Under control, time passes as on the process link.
    pub page: PageChannels,
    /// Whether a standstill is worth a search for what could still have been built.
    pub search: bool,
}

/// Simulates a plan to its end, or until `watch` returns false; also returns the results of world and director.
pub fn simulate(plan: &Plan, simulation: Simulation<'_>) -> (Report, RunResult) {
    let Simulation { since, watch, keeping, page, search } = simulation;
    let log = both(keeping.as_ref().map(JournalSession::log), page.scribe);
    let mut run = begin(plan, RealMachine::since(since), log);
    match page.control {
        None => to_the_end(&mut *run, watch),
        Some(queue) => under_control(&mut *run, plan.time_scale, watch, &mut queue.lock()),
    }
    let finish = |k: JournalSession| k.finish(run.now(), run.outcome().name(), run.tally(), &[], 0);
    let incomplete = keeping.and_then(finish);
    let (mut report, ran) = conclude(&*run, search, incomplete.clone().into_iter().collect());
    report.incomplete_journal = incomplete;
    (report, ran)
}

/// Runs to the end at the pace of the process link, and takes commands meanwhile.
fn under_control(run: &mut dyn SteppedRun, time_scale: f64, watch: &mut Watch<'_>, queue: &mut CommandQueue) {
    let (time_step, clock) = (run.time_step(), Stopwatch::start());
    while watch(run.now(), &|| run.progress()) {
        let passed = clock.elapsed().mul_f64(time_scale);
        let present = Time(u64::try_from(passed.as_nanos()).unwrap_or(u64::MAX));
        let until = present.min(run.now() + time_step);
        if run.run_until(until) {
            break;
        }
        queue.hand_in(run.now(), |kind, bytes| run.input(kind, bytes));
        if until == present {
            queue.wait(READ_EVERY);
        }
    }
    queue.close();
}
