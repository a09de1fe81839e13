//! The command `view`.

use crate::runs::{address, origin, plan, wait_for_end};
use crate::scenario_args::SimulatedArgs;
use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::interrupt::Interrupt;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::{Live, print_error, print_out};
use metamorph_processes::family::{self, Recorded, recorded, run_simulated, scene};
use metamorph_processes::record::journal::JournalFailure;
use metamorph_processes::run::PageChannels;
use metamorph_scenario::shipped::is_scenario;
use metamorph_scene::shared::Shared;
use metamorph_text::command_error::Failure;
use metamorph_view::saved::Subject;
use metamorph_view::server::Use;
use std::path::PathBuf;

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph run swarm --journal run.journal
  metamorph view run.journal               show a recorded run
  metamorph view chair --seed 7            simulate a scenario, and show it
  metamorph view run.journal --port 8080   at a port that is forwarded from another machine
  metamorph run swarm --view               show processes while they run

The address of the page is printed; open it in a browser of this machine. It works without a network,
listens on the loopback interface only, and admits only requests with the complete address. `?` on the
page lists its keys. Ctrl-C ends it.

Exit codes:
  0  the page was shown until Ctrl-C, SIGTERM or SIGHUP
  1  the program itself failed, for example because no port was free
  2  the command line or the scenario is wrong, or the file is not a journal of this version
  9  the journal is damaged; what comes before the damage was shown until Ctrl-C";

/// Arguments of `view`.
#[derive(Debug, Args)]
pub struct ViewArgs {
    /// A journal that `run --journal` wrote; or a scenario (a file whose name ends in .toml or .json, `-` for standard input, or a name that
    /// `metamorph scenarios` lists), which is simulated and shown
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// What is simulated.
    #[command(flatten)]
    pub simulated: SimulatedArgs,
    /// The port of the page's address, for example one that is forwarded; default: any free one
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub port: Option<u16>,
    /// Let other pages of this machine show the page in a frame, for example a notebook
    #[arg(long)]
    pub embed: bool,
}

/// Shows a journal, or a scenario that is simulated meanwhile.
fn view(args: &ViewArgs, since: Stopwatch, interrupt: &Interrupt) -> Result<u8, Failure> {
    let admitted = if args.embed { Use::InFrames } else { Use::Shown };
    if !is_scenario(family::sources(), &args.file) {
        args.simulated.must_be_left_out()?;
        let Recorded { plan, scene, damage } = recorded(&args.file)?;
        for trouble in scene.troubles() {
            print_error(&format!("note: {trouble}"));
        }
        interrupt.begin();
        let subject =
            Subject::new(family::of(&plan).shown(&plan), origin(&plan, &args.file, &args.simulated));
        print_out(&address(&Shared::new(scene), subject, args.port, admitted)?);
        wait_for_end(interrupt);
        return damage.map_or(Ok(0), |damage| Err(JournalFailure::from(damage).into()));
    }
    let plan = plan(&args.file, &args.simulated.overrides())?;
    let scene = Shared::new(scene(&plan, true));
    interrupt.begin();
    let subject = Subject::new(family::of(&plan).shown(&plan), origin(&plan, &args.file, &args.simulated));
    print_out(&address(&scene, subject, args.port, admitted)?);
    let scribe = Some(family::of(&plan).shown(&plan).scribe(scene.clone()));
    let page = PageChannels { scribe, ..PageChannels::default() };
    let report = run_simulated(&plan, interrupt, &mut Live::new(true), since, None, page);
    scene.lock().finish(report);
    wait_for_end(interrupt);
    Ok(0)
}

/// The command.
pub static COMMAND: CommandOf<ViewArgs> = CommandOf {
    name: "view",
    group: Some(Group::Look),
    about: "Show a run in the browser: in 3D, with a timeline",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, call| view(&args, call.since, call.interrupt),
};
