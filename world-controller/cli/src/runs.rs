//! The commands that run a scenario or show a run: `run`, `resume` and `view`.

use crate::render::origin;
use crate::resume::ResumeArgs;
use crate::run::RunArgs;
use crate::view::ViewArgs;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::{Json, Output, Outputs};
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::{self, Channel, Live, print_error, print_out};
use metamorph_families::free_module::plan_scene::plan_scene;
use metamorph_free_modules::plan::document::PlanFile;
use metamorph_processes::control::{Operators, SharedQueue, queue};
use metamorph_processes::family::{self, Recorded, families, read_file, recorded, run_simulated, scene};
use metamorph_processes::record::journal::{
    JournalError, JournalFailure, JournalSession, exit_code, parts_of,
};
use metamorph_processes::run::PageChannels;
use metamorph_processes::run::processes::{self, Processes};
use metamorph_report::human;
use metamorph_report::page::page;
use metamorph_report::schema::Report;
use metamorph_scenario::shipped::is_scenario;
use metamorph_scenario::{LinkKind, Overrides, Plan, quote};
use metamorph_scene::shared::Shared;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED, Failure};
use metamorph_view::http::ServerError;
use metamorph_view::request::{Command, Origin};
use metamorph_view::saved::Subject;
use metamorph_view::server::Server;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The journal cannot be created.
#[derive(Debug, Error)]
#[error("--journal: {0}")]
struct NoJournal(JournalError);

impl CommandError for NoJournal {
    fn exit_code(&self) -> u8 {
        exit_code(&self.0)
    }
}

/// Reads a scenario.
pub fn plan(path: &Path, overrides: &Overrides) -> Result<Plan, Failure> {
    read_file(path, overrides)
        .map_err(|diagnostics| Failure { text: diagnostics.to_string(), exit_code: BAD_USAGE })
}

/// Runs a scenario.
pub fn run(args: RunArgs, since: Stopwatch, interrupt: &Interrupt) -> Result<u8, Failure> {
    let hosts = args.plan.hosts.as_ref().and_then(|hosts| hosts.file.clone());
    let (path, overrides) = args.plan.into();
    let plan = plan(&path, &overrides)?;
    let mut outputs = Outputs::new();
    outputs.reads("the scenario", Path::new(&plan.origin));
    plan.files.iter().for_each(|file| outputs.reads("a file that the scenario names,", file));
    if let Some(file) = &args.journal {
        // The journal is written during the run; only its permission is checked here.
        outputs.writes("--journal", file)?;
    }
    let asked = Asked {
        json: args.json,
        html: args.html,
        journal: args.journal.clone(),
        view: args.view,
        control: args.control,
        quiet: args.quiet,
    };
    let show = Show::begin(&plan, asked, &mut outputs, interrupt)?;
    let mut live = Live::new(!args.quiet);
    let begin = match overrides.link {
        LinkKind::Sim => JournalSession::simulated,
        LinkKind::Ipc => JournalSession::of_processes,
    };
    let keeping = args.journal.as_deref().map(|file| begin(file, &plan)).transpose();
    let keeping = keeping.map_err(NoJournal)?;
    let page = show.channels(&plan);
    let report = match overrides.link {
        LinkKind::Sim => run_simulated(&plan, &show.interrupt, &mut live, since, keeping, page),
        LinkKind::Ipc => {
            let (patience, live) = (args.patience, &mut live);
            let processes = Processes { live, since, keeping, patience, hosts, page };
            family::of(&plan).run_processes(&plan, processes)?
        }
    };
    drop(live);
    show.end(&plan, &report, args.journal.as_deref())
}

/// Resumes a run whose controller was killed.
pub fn resume(args: ResumeArgs, since: Stopwatch, interrupt: &Interrupt) -> Result<u8, Failure> {
    let mut left = processes::left_behind(families(), &args.file)?;
    left.elsewhere = args.hosts;
    let plan = left.plan.clone();
    let mut outputs = Outputs::new();
    outputs.reads("the scenario", Path::new(&plan.origin));
    plan.files.iter().for_each(|file| outputs.reads("a file that the scenario names,", file));
    outputs.reads_directory("a part of the journal,", &parts_of(&args.file));
    outputs.writes("the journal", &args.file)?;
    let asked = Asked {
        json: args.json,
        html: args.html,
        journal: Some(args.file.clone()),
        view: args.view,
        control: args.control,
        quiet: args.quiet,
    };
    let show = Show::begin(&plan, asked, &mut outputs, interrupt)?;
    let mut live = Live::new(!args.quiet);
    let report = family::of(&plan).resume(left, &mut live, since, show.channels(&plan))?;
    drop(live);
    show.end(&plan, &report, Some(&args.file))
}

/// The requested outputs of a run.
struct Asked {
    json: Option<PathBuf>,
    html: Option<PathBuf>,
    journal: Option<PathBuf>,
    view: bool,
    control: bool,
    quiet: bool,
}

/// Observers of a run: the page during it, the reports afterwards.
struct Show {
    json: Json,
    html: Option<Output>,
    view: bool,
    quiet: bool,
    scene: Option<Shared>,
    control: Option<SharedQueue>,
    interrupt: Interrupt,
}

impl Show {
    fn begin(
        plan: &Plan,
        asked: Asked,
        outputs: &mut Outputs,
        interrupt: &Interrupt,
    ) -> Result<Show, Failure> {
        interrupt.begin();
        let Asked { json, html, journal, view, control, quiet } = asked;
        let json = Json::of(json.as_deref(), outputs)?;
        let html = html.map(|file| outputs.writes("--html", &file)).transpose()?;
        let watched = view || html.is_some();
        let messages = plan.overrides.link == LinkKind::Sim;
        let scene = watched.then(|| Shared::new(scene(plan, messages)));
        let (operators, control) = control.then(queue).unzip();
        if let Some(scene) = scene.as_ref().filter(|_| view) {
            // Standard output is for the report.
            // What the journal holds, `render` draws; a run that is not recorded can only be repeated.
            let command = match &journal {
                Some(file) => Command::of_file(file),
                None => Command::Run(plan.repeat_with()),
            };
            let origin = Origin { title: plan.title(), seed: plan.seed, command };
            let subject = Subject::new(family::of(plan).shown(plan), origin);
            print_error(&address(scene, subject, None, operators)?);
        }
        Ok(Show { json, html, view, quiet, scene, control, interrupt: interrupt.clone() })
    }

    /// Returns the log whose records fill the scene of the page and the HTML report, if either is wanted, and the
    /// commands from the page, if it may give some.
    fn channels(&self, plan: &Plan) -> PageChannels {
        let scribe = self.scene.as_ref().map(|scene| family::of(plan).shown(plan).scribe(scene.clone()));
        PageChannels { scribe, control: self.control.clone(), ..PageChannels::default() }
    }

    fn end(self, plan: &Plan, report: &Report, journal: Option<&Path>) -> Result<u8, Failure> {
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
            file.write(page(report, plan, width, bins))?;
        }
        written?;
        if view {
            interrupt.wait();
        }
        let outcome = Outcome::ALL.into_iter().find(|o| o.name() == report.outcome);
        Ok(outcome.map_or(FAILED, Outcome::exit_code))
    }
}

/// Serves a scene, and returns the text with its addresses.
fn address(
    scene: &Shared,
    subject: Subject,
    port: Option<u16>,
    operators: Option<Operators>,
) -> Result<String, ServerError> {
    let server = Server::start(scene.clone(), subject, port, operators)?;
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

/// Shows a journal, or a scenario that is simulated meanwhile.
pub fn view(args: &ViewArgs, since: Stopwatch, interrupt: &Interrupt) -> Result<u8, Failure> {
    if !is_scenario(family::sources(), &args.file) {
        let Recorded { plan, scene, damage } = recorded(&args.file)?;
        for trouble in scene.troubles() {
            print_error(&format!("note: {trouble}"));
        }
        interrupt.begin();
        let subject =
            Subject::new(family::of(&plan).shown(&plan), origin(&plan, &args.file, &args.simulated));
        print_out(&address(&Shared::new(scene), subject, args.port, None)?);
        wait_for_end(interrupt);
        return damage.map_or(Ok(0), |damage| Err(JournalFailure::from(damage).into()));
    }
    let plan = plan(&args.file, &args.simulated.overrides())?;
    let scene = Shared::new(scene(&plan, true));
    interrupt.begin();
    let subject = Subject::new(family::of(&plan).shown(&plan), origin(&plan, &args.file, &args.simulated));
    print_out(&address(&scene, subject, args.port, None)?);
    let scribe = Some(family::of(&plan).shown(&plan).scribe(scene.clone()));
    let page = PageChannels { scribe, ..PageChannels::default() };
    let report = run_simulated(&plan, interrupt, &mut Live::new(true), since, None, page);
    scene.lock().finish(report);
    wait_for_end(interrupt);
    Ok(0)
}

/// Shows a plan step by step, until a signal asks the program to end.
pub fn view_plan(plan: &PlanFile, port: Option<u16>, interrupt: &Interrupt) -> Result<(), Failure> {
    let words = std::env::args().skip(1).map(quote);
    let repeat = std::iter::once("metamorph".to_owned()).chain(words).collect::<Vec<_>>().join(" ");
    let (scene, bodies) = plan_scene(plan, repeat.clone())?;
    let origin = Origin { title: "plan".to_owned(), seed: 0, command: Command::Run(repeat) };
    interrupt.begin();
    // Standard output is for the answer.
    print_error(&address(&Shared::new(scene), Subject::new(Box::new(bodies), origin), port, None)?);
    interrupt.wait();
    Ok(())
}

/// Waits until a signal asks the program to end. Returns at once if standard output has failed, since the
/// page's address was not printed then.
fn wait_for_end(interrupt: &Interrupt) {
    if terminal::failure().is_none() {
        interrupt.wait();
    }
}
