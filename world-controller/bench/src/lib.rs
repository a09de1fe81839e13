//! `metamorph bench`: measures what the two links cost, with bare mechanisms beside them in the same run, so
//! that the ratios hold on any machine.
//!
//! `flood`, `growth`, `pyramid`, `chairs` and `gait` measure the simulated link, `wire`, `swarm` and `churn` the process link;
//! `part` is the other process of a measurement; `text` shows the results. Absent: any judgement. Nothing
//! here fails because a machine is slow.

mod bottleneck;
mod busy;
mod chairs;
mod churn;
mod ends;
mod flood;
mod gait;
mod growth;
mod hosts;
mod machine;
mod matching;
mod part;
mod swarm;
mod text;
mod walking;
mod wire;

pub use part::{SUBCOMMAND, part};

use clap::ValueEnum;
use growth::Shape;
use machine::Machine;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::{OutputError, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_console::terminal::{Channel, Live};
use metamorph_module_agent::transport::TransportError;
use metamorph_module_agent::transport::iceoryx::rendezvous::ChannelError;
use metamorph_processes::run::processes::ProcessError;
use metamorph_processes::swarm::{RunDirError, SwarmError};
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::command_error::{CommandError, FAILED};
use metamorph_text::escape::{self, Shown};
use serde::Serialize;
use std::path::PathBuf;
use thiserror::Error;

/// Version of `bench.json`, increased when a field changes its meaning or is removed.
pub const SCHEMA: u32 = 2;

/// The measurements.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
pub enum Name {
    /// Hop counts flood a block of up to a million simulated modules
    Flood,
    /// A slab becomes a ball, with 100 to 10,000 simulated modules
    Growth,
    /// Pyramids are built upon plates, with 245 to 13,335 simulated modules
    Pyramid,
    /// Runs of the thesis's chair per second, on all processors
    Chairs,
    /// Structures that walk: simulated time by processor time, messages, learners
    Gait,
    /// Round trips and throughput between two processes, beside other mechanisms
    Wire,
    /// Swarms of processes: starting, exchanging, memory, idling
    Swarm,
    /// Modules of a swarm of processes die and are restarted
    Churn,
    /// A link between machines beside bare zenoh; only in a program built with links between machines
    Hosts,
}

/// The arguments of `metamorph bench`.
#[derive(Clone, Debug)]
pub struct Request {
    /// The measurements; all if empty.
    pub names: Vec<Name>,
    /// The largest number of modules or processes measured; no limit if `None`.
    pub most: Option<u64>,
    /// The seed of the runs of growth and pyramids.
    pub seed: u64,
    /// The destination of the results.
    pub json: PathBuf,
    /// True to print errors only.
    pub quiet: bool,
}

/// Why a measurement failed.
#[derive(Debug, Error)]
pub enum BenchError {
    /// The numbers cannot be written.
    #[error(transparent)]
    Json(#[from] OutputError),
    /// A system call failed.
    #[error("bench: cannot {0}: {1}")]
    System(&'static str, std::io::Error),
    /// The other process failed.
    #[error("bench: the other process {0}")]
    Part(String),
    /// A signal arrived.
    #[error("bench: interrupted; nothing is written to {}", .0.display())]
    Interrupted(PathBuf),
    /// Signals cannot be caught.
    #[error("cannot listen for Ctrl-C: {0}")]
    Signals(std::io::Error),
    /// A run had an unexpected result, so that its times are meaningless.
    #[error("bench: {0}")]
    Wrong(String),
    /// A swarm failed.
    #[error(transparent)]
    Swarm(#[from] SwarmError),
    /// The run directory failed.
    #[error(transparent)]
    RunDir(#[from] RunDirError),
    /// A channel failed.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// An inbox failed.
    #[error(transparent)]
    Inbox(#[from] TransportError),
    /// This executable cannot be found.
    #[error(transparent)]
    Process(#[from] ProcessError),
}

impl CommandError for BenchError {
    fn exit_code(&self) -> u8 {
        match self {
            BenchError::Json(error) => error.exit_code(),
            BenchError::Interrupted(_) => Outcome::Aborted.exit_code(),
            _ => FAILED,
        }
    }
}

/// The contents of `bench.json`.
#[derive(Debug, Serialize)]
pub struct Results {
    /// Identifies the file format.
    format: &'static str,
    /// The version of its layout.
    schema: u32,
    /// The version of this program.
    version: &'static str,
    /// The machine.
    machine: Machine,
    /// A row for each size.
    flood: Vec<flood::Row>,
    /// The rows, and how they grow.
    growth: Option<growth::Growth>,
    /// The same for pyramids, upon solid and upon porous plates.
    pyramid: Vec<growth::Growth>,
    /// A row for each strategy.
    chairs: Vec<chairs::Row>,
    /// A row for each structure that walks, and for each learner.
    gait: Option<gait::Gaits>,
    /// A row for each mechanism.
    wire: Vec<wire::Row>,
    /// A row for each number of tokens in a ring of processes.
    busy: Vec<busy::Row>,
    /// A row for each size, and what ended the series.
    swarm: Option<swarm::Swarms>,
    /// A swarm in which modules die.
    churn: Option<churn::Churn>,
    /// A link between machines, if the program has them.
    hosts: Option<hosts::HostCosts>,
}

/// Executes the request, and returns the exit code.
pub fn bench(request: &Request) -> Result<u8, BenchError> {
    let json = Outputs::new().writes("--json", &request.json, OutputKind::Json)?;
    let wanted = |name| request.names.is_empty() || request.names.contains(&name);
    let most = request.most.unwrap_or(u64::MAX);
    let channel = Channel::beside(false, request.quiet);
    let paint = channel.paint();
    let mut results = Results {
        format: "metamorph-bench",
        schema: SCHEMA,
        version: metamorph_text::version::version(),
        machine: Machine::this(),
        flood: Vec::new(),
        growth: None,
        pyramid: Vec::new(),
        chairs: Vec::new(),
        gait: None,
        wire: Vec::new(),
        busy: Vec::new(),
        swarm: None,
        churn: None,
        hosts: None,
    };
    channel.say(&text::machine(results.version, &results.machine));
    let mut live = Live::new(!request.quiet);
    let interrupt = Interrupt::listen().map_err(BenchError::Signals)?;
    if wanted(Name::Flood) {
        results.flood = flood::measure(most, &mut live)?;
        channel.say(&text::flood(&results.flood, paint));
    }
    let tell = |run: &growth::Run| channel.say(&text::grown(run));
    if wanted(Name::Growth) {
        let growth = growth::measure(Shape::Ball, (most, request.seed), &mut live, &tell)?;
        channel.say(&text::growth(&growth, paint));
        results.growth = Some(growth);
    }
    if wanted(Name::Pyramid) {
        for plate in [Shape::SolidPlate, Shape::PorousPlate] {
            let pyramid = growth::measure(plate, (most, request.seed), &mut live, &tell)?;
            channel.say(&text::growth(&pyramid, paint));
            results.pyramid.push(pyramid);
        }
    }
    if wanted(Name::Chairs) {
        results.chairs = chairs::measure(chairs::RUNS, &mut live)?;
        channel.say(&text::chairs(&results.chairs, paint));
    }
    if wanted(Name::Gait) {
        let gaits = gait::measure(most, &mut live)?;
        channel.say(&text::gaits(&gaits, paint));
        results.gait = Some(gaits);
    }
    // From here on there are processes and shared memory to remove.
    interrupt.begin();
    let on = || if interrupt.is_set() { Err(BenchError::Interrupted(request.json.clone())) } else { Ok(()) };
    if wanted(Name::Wire) {
        results.wire = wire::measure(&mut live, &on)?;
        channel.say(&text::wire(&results.wire, paint));
        results.busy = busy::measure(&mut live, &on)?;
        channel.say(&text::busy(&results.busy, paint));
    }
    if wanted(Name::Swarm) {
        // An interrupted swarm reports an unexpected result.
        let swarms = swarm::measure(most, &mut live).or_else(|e| on().and(Err(e)))?;
        channel.say(&text::swarm(&swarms, paint));
        results.swarm = Some(swarms);
    }
    if wanted(Name::Churn) {
        on()?;
        let churn = churn::measure(if most < 1_000 { 4 } else { 10 }, &mut live);
        let churn = churn.or_else(|e| on().and(Err(e)))?;
        channel.say(&text::churn(&churn, paint));
        results.churn = Some(churn);
    }
    if wanted(Name::Hosts) {
        results.hosts = hosts::measure(&mut live, &on)?;
        match &results.hosts {
            Some(costs) => channel.say(&hosts::text(costs, paint)),
            None => channel.say("hosts  not measured: this program is built without links between machines"),
        }
    }
    on()?;
    json.write(escape::json(&results) + "\n")?;
    channel.say(&format!("the numbers are in {}", request.json.shown()));
    Ok(0)
}

/// Returns the median; zero if empty.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
