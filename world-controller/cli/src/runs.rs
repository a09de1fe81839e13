//! The parts that `run`, `resume`, `view` and `render` share: reading a scenario, the page, the reports.

use crate::scenario_args::SimulatedArgs;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::{Json, Output, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_console::terminal::{self, Channel, print_error};
use metamorph_families::free_module::plan_scene::plan_scene;
use metamorph_free_modules::plan::document::PlanFile;
use metamorph_processes::control::{SharedQueue, queue};
use metamorph_processes::family::{self, Recorded, read_file, recorded, scene};
use metamorph_processes::run::PageChannels;
use metamorph_report::human;
use metamorph_report::page::page;
use metamorph_report::schema::Report;
use metamorph_scenario::{LinkKind, Overrides, Plan, quote};
use metamorph_scene::scene::Scene;
use metamorph_scene::shared::Shared;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED, Failure};
use metamorph_text::escape::{Shown, portable};
use metamorph_text::program;
use metamorph_view::http::ServerError;
use metamorph_view::request::{Command, Origin, Request, Source};
use metamorph_view::saved::Subject;
use metamorph_view::server::{Server, Use};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Reads a scenario.
pub fn plan(path: &Path, overrides: &Overrides) -> Result<Plan, Failure> {
    read_file(path, overrides)
        .map_err(|diagnostics| Failure { text: diagnostics.to_string(), exit_code: BAD_USAGE })
}

/// The requested outputs of a run.
pub struct Asked {
    /// The file of `--json`.
    pub json: Option<PathBuf>,
    /// The file of `--html`.
    pub html: Option<PathBuf>,
    /// The journal that holds the run.
    pub journal: Option<PathBuf>,
    /// The port of the page that shows the run, if one does.
    pub view: Option<Option<u16>>,
    /// Whether the page may command the run.
    pub control: bool,
    /// Whether only errors are printed.
    pub quiet: bool,
}

/// Observers of a run: the page during it, the reports afterwards.
pub struct Show {
    json: Json,
    html: Option<Output>,
    view: bool,
    quiet: bool,
    scene: Option<Shared>,
    control: Option<SharedQueue>,
    /// Set by Ctrl-C.
    pub interrupt: Interrupt,
}

impl Show {
    /// Prepares the outputs, and starts the page, if one is wanted.
    pub fn begin(
        plan: &Plan,
        asked: Asked,
        outputs: &mut Outputs,
        interrupt: &Interrupt,
    ) -> Result<Show, Failure> {
        interrupt.begin();
        let Asked { json, html, journal, view, control, quiet } = asked;
        let json = Json::of(json.as_deref(), outputs)?;
        let html = html.map(|file| outputs.writes("--html", &file, OutputKind::Html)).transpose()?;
        let watched = view.is_some() || html.is_some();
        let messages = plan.overrides.link == LinkKind::Sim;
        let scene = watched.then(|| Shared::new(scene(plan, messages)));
        let (operators, control) = control.then(queue).unzip();
        if let Some((scene, port)) = scene.as_ref().zip(view) {
            // Standard output is for the report.
            // What the journal holds, `render` draws; a run that is not recorded can only be repeated.
            let command = match &journal {
                Some(file) => Command::of_file(file),
                None => Command::Run(plan.repeat_with()),
            };
            let origin = Origin { title: plan.title(), seed: plan.seed, command };
            let subject = Subject::new(family::of(plan).shown(plan), origin);
            print_error(&address(scene, subject, port, operators.map_or(Use::Shown, Use::Controlling))?);
        }
        Ok(Show { json, html, view: view.is_some(), quiet, scene, control, interrupt: interrupt.clone() })
    }

    /// Returns the log whose records fill the scene of the page and the HTML report, if either is wanted, and the
    /// commands from the page, if it may give some.
    pub fn channels(&self, plan: &Plan) -> PageChannels {
        let scribe = self.scene.as_ref().map(|scene| family::of(plan).shown(plan).scribe(scene.clone()));
        PageChannels { scribe, control: self.control.clone(), ..PageChannels::default() }
    }

    /// Completes the page, and writes the reports. Returns the exit code of the run.
    pub fn end(self, plan: &Plan, report: &Report, journal: Option<&Path>) -> Result<u8, Failure> {
        let Show { json, html, view, quiet, scene, interrupt, .. } = self;
        if let Some(scene) = &scene {
            finish(scene, plan, report, journal);
        }
        let channel = Channel::beside(json.is_out(), quiet);
        // The terminal repeats the command as typed here; files may be read elsewhere.
        let here = Report { repeat: plan.repeat_here(), ..report.clone() };
        channel.say(&human(&here, plan.swarm.words(), channel.paint()));
        // Write each, even if another fails.
        let written = json.write(report);
        if let (Some(file), Some(scene)) = (&html, &scene) {
            let scene = scene.lock();
            let (width, bins) = scene.bins();
            file.write(page(report, plan, width, bins, picture(&scene, plan).as_deref()))?;
        }
        written?;
        if view {
            interrupt.wait();
        }
        if let (Some(why), Some(file)) = (&report.incomplete_journal, journal) {
            return Err(IncompleteJournal { file: file.to_owned(), why: why.clone() }.into());
        }
        let outcome = Outcome::ALL.into_iter().find(|o| o.name() == report.outcome);
        Ok(outcome.map_or(FAILED, Outcome::exit_code))
    }
}

/// Returns a picture of a scene at its end, as SVG; `None` if it cannot be drawn.
fn picture(scene: &Scene, plan: &Plan) -> Option<String> {
    let origin = Origin { title: plan.title(), seed: plan.seed, command: Command::Run(plan.repeat_with()) };
    let swarm = family::of(plan).shown(plan);
    let source = Source { scene, swarm: &*swarm, origin: &origin, trace: scene.trace_hash() };
    let request = Request::of_query("").ok()?;
    let style = request.style(false);
    let drawn = source.time(request.at).and_then(|end| source.figure(&request, &style, end).still(end));
    match drawn {
        Ok(picture) => Some(picture.svg()),
        Err(error) => {
            tracing::debug!("the report has no picture: {error}");
            None
        }
    }
}

/// The run has ended, and its journal is not whole.
#[derive(Debug, Error)]
#[error("--journal {}: {why}\n  fix: make room on that disk, or raise the limit of the size of files (`ulimit -f`), and run again", .file.shown())]
struct IncompleteJournal {
    file: PathBuf,
    why: String,
}

impl CommandError for IncompleteJournal {}

/// Serves a scene, and returns the text with its addresses.
pub fn address(
    scene: &Shared,
    subject: Subject,
    port: Option<u16>,
    admitted: Use,
) -> Result<String, ServerError> {
    let server = Server::start(scene.clone(), subject, port, admitted)?;
    let control = server.controlling_address().map(|address| format!("\nto command the run, open {address}"));
    Ok(format!("open {} in a browser{}\nCtrl-C ends it", server.address(), control.unwrap_or_default()))
}

/// Completes a scene with the report. The scene of a run of processes lacks their messages, which only the
/// journal contains, so it is replaced by the scene of the journal if there is one.
fn finish(scene: &Shared, plan: &Plan, report: &Report, journal: Option<&Path>) {
    if plan.overrides.link == LinkKind::Ipc
        && let Some(journal) = journal
    {
        match recorded(journal) {
            Ok(Recorded { scene: mut whole, damage: None, .. }) => {
                // First complete the scene: a page stops asking once a run is over.
                whole.finish(report.clone());
                return scene.replace(whole);
            }
            Ok(Recorded { damage: Some(damage), .. }) => {
                tracing::warn!("the page shows no messages: {damage}")
            }
            Err(error) => tracing::warn!("the page shows no messages: {error}"),
        }
    }
    scene.lock().finish(report.clone());
}

/// Shows a plan step by step, until a signal asks the program to end.
pub fn view_plan(plan: &PlanFile, port: Option<u16>, interrupt: &Interrupt) -> Result<(), Failure> {
    let words = std::env::args().skip(1).map(quote);
    let repeat =
        std::iter::once(quote(program::name().to_owned())).chain(words).collect::<Vec<_>>().join(" ");
    let (scene, bodies) = plan_scene(plan, repeat.clone())?;
    let origin = Origin { title: "plan".to_owned(), seed: 0, command: Command::Run(repeat) };
    interrupt.begin();
    // Standard output is for the answer.
    print_error(&address(&Shared::new(scene), Subject::new(Box::new(bodies), origin), port, Use::Shown)?);
    interrupt.wait();
    Ok(())
}

/// Waits until a signal asks the program to end. Returns at once if standard output has failed, since the
/// page's address was not printed then.
pub fn wait_for_end(interrupt: &Interrupt) {
    if terminal::failure().is_none() {
        interrupt.wait();
    }
}

/// Returns where a run comes from that is read from a file, with what is changed in it.
pub fn origin(plan: &Plan, file: &Path, simulated: &SimulatedArgs) -> Origin {
    let options = simulated.options().into_iter().map(quote).collect();
    let command = Command::Render { source: quote(portable(file)), options };
    Origin { title: plan.title(), seed: plan.seed, command }
}
