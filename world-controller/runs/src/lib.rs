//! Runs as functions: a text and a seed go in, a report and a scene come out.
//!
//! Nothing here, and in no crate below, asks the operating system: files come from a [`Sources`], real time and processors from
//! a [`Machine`], and threads are the caller's.

use metamorph_families::simulated::{self, Machine, SteppedRun, Watch};
use metamorph_families::{families, of, with_all_parts};
use metamorph_report::run_result::RunResult;
use metamorph_report::schema::Report;
use metamorph_scenario::diagnostics::Diagnostics;
use metamorph_scenario::{self as scenario, Overrides, Plan};
use metamorph_scene::beginning::Heading;
use metamorph_scene::command_forms;
use metamorph_scene::scene::Scene;
use metamorph_sim_bridge::kernel::recording::Log;
use metamorph_text::sources::Sources;
use std::path::Path;
use std::sync::Arc;

/// Reads and checks a scenario: a file of `sources`, or the name of one that ships with the program.
///
/// # Errors
/// All problems of the scenario.
pub fn read_file(
    sources: &'static dyn Sources,
    path: &Path,
    overrides: &Overrides,
) -> Result<Plan, Diagnostics> {
    scenario::read_file(families(sources), path, overrides)
}

/// Reads and checks the text of a scenario; `origin` names it in messages.
///
/// # Errors
/// All problems of the scenario.
pub fn read_text(
    sources: &'static dyn Sources,
    origin: &str,
    text: &str,
    overrides: &Overrides,
) -> Result<Plan, Diagnostics> {
    scenario::read_text(families(sources), origin, text, overrides)
}

/// Creates the scene of a plan before its run. `messages` says whether messages will be shown.
pub fn scene(plan: &Plan, messages: bool) -> Scene {
    let family = of(plan);
    let heading = Heading { commands: command_forms::of(plan, family), ..Heading::of(plan) };
    Scene::new(heading, &*family.shown(plan), messages)
}

/// Begins a simulated run that is carried out in steps; it is recorded in the log, if one is given.
pub fn begin(plan: &Plan, machine: Arc<dyn Machine>, log: Option<Log>) -> Box<dyn SteppedRun> {
    of(plan).begin(plan, machine, log)
}

/// Simulates a plan to its end, or until `watch` returns false; also returns the results of world and
/// director. Standstills are not searched for what could still have been built.
pub fn simulate(plan: &Plan, machine: Arc<dyn Machine>, watch: &mut Watch<'_>) -> (Report, RunResult) {
    let mut run = begin(plan, machine, None);
    simulated::to_the_end(&mut *run, watch);
    conclude(&*run, false, Vec::new())
}

/// Returns the report of a run with these notes, and the results of world and director. `search` says whether a standstill
/// is searched for what could still have been built.
pub fn conclude(run: &dyn SteppedRun, search: bool, notes: Vec<String>) -> (Report, RunResult) {
    let (report, result) = run.conclude(search, notes);
    (with_all_parts(report), result)
}
