//! A swarm of processes: one per agent, over shared memory, with this process as its controller.
//!
//! [`run_swarm`] drives any world and any director with real processes, real time and real
//! signals. The calling thread owns the world, the director and all channels (they cannot change
//! threads); a second thread supervises processes with tokio. Absent: decisions about the run, which
//! are the director's, and knowledge of which family of units it runs.

mod agents;
mod burials;
mod conduct;
mod links;
mod meter;
mod outcome;
mod pace;
mod reserve;
mod resume;
mod run_dir;
mod signals;
mod supervise;
mod watch;

use crate::console::shutdown::Shutdown;
pub use agents::Letter;
pub use links::descriptor_limit;
pub use meter::Meter;
pub use outcome::{Crash, SwarmError, SwarmOutcome};
pub use pace::{FULL, Slowed};
pub use resume::{Adopted, Counted, NotResumable, Resumption, TakenOver, adopt};
pub use run_dir::{CleanError, CleanReport, RunDir, RunDirError, clean};
pub use watch::{SUBCOMMAND as WATCH, watch};

use crate::console::interrupt::Interrupt;
use crate::swarm::burials::Burials;
use crate::swarm::conduct::Conductor;
use crate::swarm::links::raise_descriptor_limit;
use crate::swarm::pace::Pace;
use crate::swarm::reserve::Reserve;
use crate::swarm::supervise::{Launch, Supervisor};
use crate::swarm::watch::Watch;
use metamorph_module_agent::clock::{Speed, monotonic};
use metamorph_module_agent::journal_file::Parts;
use metamorph_module_agent::run_dir::controller_lease::Seat;
use metamorph_module_agent::run_dir::identity::Identity;
use metamorph_module_agent::run_dir::swarm_file::SwarmFile;
use metamorph_module_agent::transport::iceoryx::inbox::Inbox;
use metamorph_module_agent::transport::iceoryx::rendezvous::{Rendezvous, SHARD, set_verbosity};
use metamorph_module_agent::transport::iceoryx::space;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::time::Span;
use metamorph_sim_bridge::director::port::Direct;
use metamorph_sim_bridge::world::World;
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::atomic::AtomicU32;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// How a swarm is run.
#[derive(Clone, Debug)]
pub struct SwarmOptions {
    /// The program of the agents.
    pub program: PathBuf,
    /// What comes before an agent's own arguments, such as the name of a subcommand.
    pub program_args: Vec<OsString>,
    /// The seed of the run.
    pub seed: u64,
    /// How fast scenario time passes, unless agents cannot keep up.
    pub speed: Speed,
    /// By how much scenario time agents may be late before time passes more slowly. It should be small
    /// against what the protocol waits for.
    pub tolerance: Span,
    /// The present speed in parts of [`FULL`]; for whoever looks on.
    pub share: Arc<AtomicU32>,
    /// What links do to messages.
    pub link: LinkModel,
    /// Whether agents log to this process's standard error. Otherwise it is kept, and the end of it
    /// reported for agents that crash.
    pub verbose: bool,
    /// Asks the swarm to end before its director does.
    pub shutdown: Shutdown,
    /// Whether SIGINT, SIGTERM and SIGHUP ask the swarm to end, see [`Interrupt`].
    pub catch_signals: bool,
    /// A program and its arguments that carry out [`watch`]: it removes what this process leaves in shared
    /// memory if it is killed. Without it, the next run does.
    pub watcher: Option<(PathBuf, Vec<OsString>)>,
    /// Where agents write their parts of the journal, if one is kept.
    pub journal: Option<Parts>,
    /// How long agents wait for a controller to come back after theirs was killed. Zero without a
    /// journal, from which alone it could.
    pub patience: Duration,
    /// Where the run's directory is, as soon as it has one; for whoever looks on.
    pub root: Arc<OnceLock<PathBuf>>,
    /// How long it may take until one more agent has started.
    pub setup_timeout: Duration,
    /// How long it may take until one more agent has stopped, before the rest are killed.
    pub stop_timeout: Duration,
}

impl SwarmOptions {
    /// Agents of this program; real time, perfect links, nothing caught.
    pub fn new(program: PathBuf) -> SwarmOptions {
        SwarmOptions {
            program,
            program_args: Vec::new(),
            seed: 0,
            speed: Speed::REAL,
            tolerance: Span::millis(100),
            share: Arc::default(),
            link: LinkModel::default(),
            verbose: false,
            shutdown: Shutdown::new(),
            catch_signals: false,
            watcher: None,
            journal: None,
            patience: Duration::ZERO,
            root: Arc::default(),
            setup_timeout: Duration::from_secs(120),
            stop_timeout: Duration::from_secs(30),
        }
    }
}

/// The most modules of one run on one machine; pids and descriptors end soon after.
pub const MODULE_LIMIT: usize = 16_000;

/// Dead agents of one shard that may wait to be buried while others are started in their place. A restart
/// beyond that fails, and is reported as a crash that says so.
const UNBURIED: usize = 1_000;
/// Runs a swarm until its director finishes it or a shutdown is asked for, and leaves nothing
/// behind: no process, no shared memory, no file. What earlier runs of this user left when they
/// were killed is removed first.
///
/// Blocks for the whole run, so it must not be called from asynchronous code. A panic in the world
/// or the director ends the swarm on its way out.
pub fn run_swarm<W, D>(
    options: &SwarmOptions,
    setup: &<W::Agent as Agent>::Setup,
    world: &mut W,
    director: &mut D,
) -> Result<SwarmOutcome, SwarmError>
where
    W: World,
    D: Direct<W>,
{
    let count = world.len();
    if count == 0 || count > MODULE_LIMIT {
        return Err(SwarmError::Size(count));
    }
    let begun = begin(options, count)?;
    if let Err(e) = clean() {
        tracing::warn!("what earlier runs left behind could not be removed: {e}");
    }
    // Dropped in reverse: first the supervisor, which ends all processes, then channels, then files.
    let mut dir = RunDir::create()?;
    watch_over(&mut dir, options)?;
    let mut reserve = Reserve::take(dir.root(), count as u64)?;
    options.root.get_or_init(|| dir.root().to_owned());
    SwarmFile {
        count: count as u32,
        seed: options.seed,
        speed: options.speed,
        tolerance: options.tolerance,
        link: options.link.clone(),
        journal: options.journal.clone(),
        patience: u32::try_from(options.patience.as_millis()).unwrap_or(u32::MAX),
        setup,
    }
    .write(dir.root())?;
    let share = Arc::clone(&options.share);
    let pace =
        Pace::create(dir.root(), options.speed, options.tolerance, share).map_err(SwarmError::Clock)?;
    let seat = take_seat(&dir, 0)?;
    reserve.release_own();
    let at = Rendezvous::join(dir.root())?;
    let (inbox, supervisor) = attach(options, &dir, &at, seat, count)?;
    let burials = Burials::start(dir.root())?;
    let mut conductor =
        Conductor::new(options, &dir, &at, inbox, supervisor, burials, pace, world, director, begun);
    conductor.reserve = reserve;
    conductor.run()
}

/// Goes on with a swarm whose controller was killed, from what its journal says of it. Otherwise the
/// same as [`run_swarm`].
pub fn resume_swarm<W, D>(
    options: &SwarmOptions,
    adopted: Adopted,
    resumption: Resumption<W::Agent>,
    world: &mut W,
    director: &mut D,
) -> Result<SwarmOutcome, SwarmError>
where
    W: World,
    D: Direct<W>,
{
    let count = world.len();
    let begun = begin(options, count)?;
    let Adopted { mut dir, epoch } = adopted;
    watch_over(&mut dir, options)?;
    options.root.get_or_init(|| dir.root().to_owned());
    let before = Seat::read(dir.root()).map_err(SwarmError::Identity)?;
    let share = Arc::clone(&options.share);
    let pace = Pace::adopt(dir.root(), options.speed, options.tolerance, share).map_err(SwarmError::Clock)?;
    let at = Rendezvous::join(dir.root())?;
    // First the channels, then the seat: whoever finds the new controller can reach it.
    let next = Seat { generation: before.generation + 1, ..before };
    let (inbox, supervisor) = attach(options, &dir, &at, next, count)?;
    take_seat(&dir, next.generation)?;
    let burials = Burials::start(dir.root())?;
    let mut conductor =
        Conductor::new(options, &dir, &at, inbox, supervisor, burials, pace, world, director, begun);
    conductor.reserve = Reserve::left(dir.root());
    conductor.go_on(epoch, resumption)
}

/// What comes before a swarm has anything. Returns when that was.
fn begin(options: &SwarmOptions, count: usize) -> Result<u64, SwarmError> {
    if options.catch_signals {
        let interrupt = Interrupt::listen().map_err(SwarmError::Signals)?;
        interrupt.begin();
        interrupt.pass_on(&options.shutdown);
    }
    raise_descriptor_limit(count as u64)?;
    set_verbosity(options.verbose);
    Ok(monotonic())
}

fn watch_over(dir: &mut RunDir, options: &SwarmOptions) -> Result<(), SwarmError> {
    let Some((program, args)) = &options.watcher else { return Ok(()) };
    let watch = Watch::start(program, args, dir.root()).map_err(SwarmError::Watcher)?;
    dir.keep(watch);
    Ok(())
}

fn take_seat(dir: &RunDir, generation: u32) -> Result<Seat, SwarmError> {
    let controller = Identity::own().map_err(SwarmError::Identity)?;
    let seat = Seat { controller, generation };
    seat.write(dir.root()).map_err(SwarmError::Identity)?;
    Ok(seat)
}

fn attach(
    options: &SwarmOptions,
    dir: &RunDir,
    at: &Rendezvous,
    seat: Seat,
    count: usize,
) -> Result<(Inbox, Supervisor), SwarmError> {
    let shards = (count as u32).div_ceil(SHARD);
    let senders = count.min(SHARD as usize) + UNBURIED;
    let inbox = Inbox::create_for_controller(at, seat.generation, shards, senders)?;
    space::allocate(dir.name()).map_err(reserve::refused_own)?;
    let launch = Launch {
        program: options.program.clone(),
        args: options.program_args.clone(),
        root: dir.root().to_owned(),
        generation: seat.generation,
        verbose: options.verbose,
    };
    Ok((inbox, Supervisor::start(launch, options.shutdown.clone())?))
}
