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
mod resume;
mod run_dir;
mod signals;
mod supervise;

pub use agents::Letter;
pub use links::descriptor_limit;
pub use meter::Meter;
pub use outcome::{Crash, SwarmError, SwarmOutcome};
pub use resume::{Adopted, Counted, NotResumable, Resumption, TakenOver, adopt};
pub use run_dir::{CleanError, CleanReport, RunDir, RunDirError, clean};
pub use supervise::Shutdown;

use crate::swarm::burials::Burials;
use crate::swarm::conduct::Conductor;
use crate::swarm::links::raise_descriptor_limit;
use crate::swarm::supervise::{Launch, Supervisor};
use metamorph_module_agent::clock::{Speed, monotonic};
use metamorph_module_agent::inbox::Inbox;
use metamorph_module_agent::process::Identity;
use metamorph_module_agent::rendezvous::{Rendezvous, SHARD, set_verbosity};
use metamorph_module_agent::run_name::HOME;
use metamorph_module_agent::seat::Seat;
use metamorph_module_agent::swarm_file::SwarmFile;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::link::LinkModel;
use metamorph_sim_bridge::direct::Direct;
use metamorph_sim_bridge::world::World;
use rustix::fs::statvfs;
use std::ffi::OsString;
use std::path::PathBuf;
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
    /// How fast scenario time passes.
    pub speed: Speed,
    /// What links do to messages.
    pub link: LinkModel,
    /// Whether agents log to this process's standard error. Otherwise it is kept, and the end of it
    /// reported for agents that crash.
    pub verbose: bool,
    /// Asks the swarm to end before its director does.
    pub shutdown: Shutdown,
    /// Whether SIGINT, SIGTERM and SIGHUP ask the swarm to end.
    pub catch_signals: bool,
    /// The directory that agents write their parts of the journal to, if one is kept.
    pub journal: Option<PathBuf>,
    /// How long agents wait for a controller to come back after theirs was killed. Zero without a
    /// journal, from which alone it could.
    pub patience: Duration,
    /// Where the run's directory is, as soon as it has one; for whoever looks on.
    pub root: Arc<OnceLock<PathBuf>>,
    /// How long all agents together may take to start.
    pub setup_timeout: Duration,
    /// How long agents may take to stop before they are killed.
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
            link: LinkModel::default(),
            verbose: false,
            shutdown: Shutdown::new(),
            catch_signals: false,
            journal: None,
            patience: Duration::ZERO,
            root: Arc::default(),
            setup_timeout: Duration::from_secs(120),
            stop_timeout: Duration::from_secs(10),
        }
    }
}

/// The most modules of one run on one machine; pids and descriptors end soon after.
pub const MODULE_LIMIT: usize = 16_000;

/// Dead agents of one shard that may wait to be buried while others are started in their place. A restart
/// beyond that fails, and is reported as a crash that says so.
const UNBURIED: usize = 1_000;
/// Bytes of shared memory for each agent, and for the run; twice what was measured.
const SPACE: (u64, u64) = (200 << 10, 8 << 20);

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
    raise_descriptor_limit(count as u64)?;
    set_verbosity(options.verbose);
    let begun = monotonic();
    if let Err(e) = clean() {
        tracing::warn!("what earlier runs left behind could not be removed: {e}");
    }
    check_space(count as u64)?;
    // Dropped in reverse: first the supervisor, which ends all processes, then channels, then files.
    let dir = RunDir::create()?;
    options.root.get_or_init(|| dir.root().to_owned());
    SwarmFile {
        count: count as u32,
        seed: options.seed,
        speed: options.speed,
        link: options.link.clone(),
        journal: options.journal.clone(),
        patience: u32::try_from(options.patience.as_millis()).unwrap_or(u32::MAX),
        setup,
    }
    .write(dir.root())?;
    let seat = take_seat(&dir, 0)?;
    let at = Rendezvous::join(dir.root())?;
    let (inbox, supervisor) = attach(options, &dir, &at, seat, count)?;
    let burials = Burials::start(dir.root())?;
    let conductor = Conductor::new(options, &dir, &at, inbox, supervisor, burials, world, director, begun);
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
    let (count, begun) = (world.len(), monotonic());
    raise_descriptor_limit(count as u64)?;
    set_verbosity(options.verbose);
    let Adopted { dir, epoch } = adopted;
    options.root.get_or_init(|| dir.root().to_owned());
    let before = Seat::read(dir.root()).map_err(SwarmError::Identity)?;
    let at = Rendezvous::join(dir.root())?;
    // First the channels, then the seat: whoever finds the new controller can reach it.
    let next = Seat { generation: before.generation + 1, ..before };
    let (inbox, supervisor) = attach(options, &dir, &at, next, count)?;
    take_seat(&dir, next.generation)?;
    let burials = Burials::start(dir.root())?;
    let conductor = Conductor::new(options, &dir, &at, inbox, supervisor, burials, world, director, begun);
    conductor.go_on(epoch, resumption)
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
    let launch = Launch {
        program: options.program.clone(),
        args: options.program_args.clone(),
        root: dir.root().to_owned(),
        generation: seat.generation,
        verbose: options.verbose,
        catch_signals: options.catch_signals,
    };
    Ok((inbox, Supervisor::start(launch, options.shutdown.clone())?))
}

/// Shared memory that runs out kills whoever touches it next, so it is looked at beforehand;
/// containers often have 64 MB of it.
fn check_space(agents: u64) -> Result<(), SwarmError> {
    let needed = agents * SPACE.0 + SPACE.1;
    match statvfs(HOME) {
        Ok(fs) if fs.f_bavail.saturating_mul(fs.f_frsize) < needed => {
            let available = fs.f_bavail.saturating_mul(fs.f_frsize);
            Err(SwarmError::Space { needed: needed >> 20, available: available >> 20 })
        }
        Ok(_) => Ok(()),
        Err(e) => Err(SwarmError::NoSharedMemory(e.into())),
    }
}
