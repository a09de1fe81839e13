//! Simulated runs that are recorded, shown and commanded.

use super::PageChannels;
use super::machine::RealMachine;
use crate::control::{CommandQueue, READ_EVERY};
use crate::metrics::Metrics;
use crate::record::journal::JournalSession;
use crate::record::tee::both;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_families::simulated::{SteppedRun, Watch};
use metamorph_protocol::ids::HostId;
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
    if let Some(metrics) = &page.metrics {
        metrics.describe(plan);
        // Processes of this machine have other numbers, and other machines other hosts.
        metrics.begin(&format!("sim.{}", std::process::id()), HostId::CONTROLLER, None);
    }
    let mut stepped = Stepped { run: &mut *run, metrics: page.metrics.as_ref() };
    match page.control {
        None => stepped.until_the_end(watch),
        Some(queue) => stepped.under_control(plan.time_scale, watch, &mut queue.lock()),
    }
    page.metrics.iter().for_each(|metrics| metrics.end(Some(run.progress())));
    let finish = |k: JournalSession| k.finish(run.now(), run.outcome().name(), run.tally(), &[], 0);
    let incomplete = keeping.and_then(finish);
    let (mut report, ran) = conclude(&*run, search, incomplete.clone().into_iter().collect());
    report.incomplete_journal = incomplete;
    (report, ran)
}

/// A run whose metrics are noted after each slice, if they are served.
struct Stepped<'r> {
    run: &'r mut dyn SteppedRun,
    metrics: Option<&'r Metrics>,
}

impl Stepped<'_> {
    /// Runs until a time. Returns true if the run is over.
    fn run_until(&mut self, until: Time) -> bool {
        let is_over = self.run.run_until(until);
        if let Some(metrics) = self.metrics {
            metrics.note_simulated(is_over, || (self.run.now(), *self.run.tally(), self.run.progress()));
        }
        is_over
    }

    /// Runs to the end, or until `watch` returns false.
    fn until_the_end(&mut self, watch: &mut Watch<'_>) {
        let time_step = self.run.time_step();
        // Slices exist for those who look on only; where they end has no effect on the run.
        while watch(self.run.now(), &|| self.run.progress()) && !self.run_until(self.run.now() + time_step) {}
    }

    /// Runs to the end at the pace of the process link, and takes commands meanwhile.
    fn under_control(&mut self, time_scale: f64, watch: &mut Watch<'_>, queue: &mut CommandQueue) {
        let (time_step, clock) = (self.run.time_step(), Stopwatch::start());
        while watch(self.run.now(), &|| self.run.progress()) {
            let passed = clock.elapsed().mul_f64(time_scale);
            let present = Time(u64::try_from(passed.as_nanos()).unwrap_or(u64::MAX));
            let until = present.min(self.run.now() + time_step);
            if self.run_until(until) {
                break;
            }
            queue.hand_in(self.run.now(), |kind, bytes| self.run.input(kind, bytes));
            if until == present {
                queue.wait(READ_EVERY);
            }
        }
        queue.close();
    }
}
