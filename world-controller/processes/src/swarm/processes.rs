//! A swarm of processes on this machine: one per agent over iceoryx2, in a run directory of its own,
//! supervised by a second thread with tokio.

use crate::metrics::Metrics;
use crate::swarm::controller_loop::{ControllerLoop, Services};
use crate::swarm::hosts::{Fleet, Hosts, Inherited, backend};
use crate::swarm::launcher::Backend;
use crate::swarm::links::raise_descriptor_limit;
use crate::swarm::outcome::{SwarmError, SwarmOutcome};
use crate::swarm::pace::Pace;
use crate::swarm::reserve::{self, Reserve};
use crate::swarm::resume::{Adopted, Resumption};
use crate::swarm::run_dir::{RunDir, clean};
use crate::swarm::supervisor::{Launch, Supervisor, oom_kills};
use crate::swarm::watch::Watch;
use crate::swarm::{MODULE_LIMIT, SwarmOptions, catch_signals};
use metamorph_console::shutdown::Shutdown;
use metamorph_module_agent::clock::monotonic;
use metamorph_module_agent::clock::source::FileClock;
use metamorph_module_agent::run_dir::controller_lease::ControllerLease;
use metamorph_module_agent::run_dir::identity::Identity;
use metamorph_module_agent::run_dir::swarm_file::{self, SwarmFile};
use metamorph_module_agent::transport::iceoryx::rendezvous::{Rendezvous, SHARD, set_verbosity};
use metamorph_module_agent::transport::iceoryx::{IceoryxTransport, space};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::HostId;
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::world::World;
use std::fs;
use std::sync::Arc;

/// Number of dead agents of one shard that may wait to be reaped while others are started in their place. A
/// restart beyond it fails, and is reported as a crash with this reason.
const UNREAPED: usize = 1_000;

/// The backend that runs agents as processes on this machine.
enum Processes {}

impl Backend for Processes {
    type Transport = IceoryxTransport;
    type Launcher = Supervisor;
    type Clock = FileClock;
}

/// Runs a swarm until its director finishes it or a shutdown is asked for, and leaves nothing behind: no
/// process, no shared memory, no file. Leftovers of this user's earlier, killed runs are removed first.
///
/// Blocks for the whole run, so it must not be called from asynchronous code. A panic in the world or the
/// director ends the swarm on its way out.
///
/// # Errors
/// If the swarm cannot be started, or its controller cannot continue.
pub fn run_swarm<W, D>(
    options: &SwarmOptions,
    setup: &<W::Agent as Agent>::Setup,
    world: &mut W,
    director: &mut D,
) -> Result<SwarmOutcome, SwarmError>
where
    W: World,
    D: DirectorPort<W>,
{
    let count = world.len();
    if count == 0 || count > MODULE_LIMIT {
        return Err(SwarmError::Size(count));
    }
    let begun = begin(options, count)?;
    if let Err(e) = clean() {
        tracing::warn!("what earlier runs left behind could not be removed: {e}");
    }
    // Dropped after the controller loop, which ends all processes and closes their channels.
    let mut dir = RunDir::create()?;
    watch_over(&mut dir, options)?;
    let hosts = options.link.hosts.as_ref().filter(|hosts| hosts.len() > 1);
    let here = hosts.map_or(count, |hosts| hosts.modules(HostId::CONTROLLER).count());
    let mut reserve = Reserve::take(dir.root(), here as u64)?;
    options.root.get_or_init(|| dir.root().to_owned());
    let run = dir.name().to_string();
    let _named = begin_named(options, &run, &dir).entered();
    SwarmFile {
        run,
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
    let clock = FileClock::create(dir.root(), Time::ZERO).map_err(SwarmError::Clock)?;
    let pace = pace(options, clock)?;
    let lease = acquire_lease(&dir, 0)?;
    reserve.release_own();
    let fleet = hosts.map(|hosts| Fleet::muster(options, hosts, count, &dir)).transpose()?;
    let launch = launch(options, &dir, lease.generation);
    let (transport, launcher) = attach(launch, &options.shutdown, &dir, count, fleet.is_some())?;
    let Some(fleet) = fleet else {
        let services = Services::<Processes> { launcher, transport, pace, reserve, dir: Some(&dir) };
        return settled(options, ControllerLoop::new(options, services, world, director, begun).run());
    };
    let new = Inherited::new(fleet);
    let (transport, launcher) = backend(new, (transport, launcher), dir.root(), lease.generation, options)?;
    let services = Services::<Hosts> { launcher, transport, pace, reserve, dir: Some(&dir) };
    settled(options, ControllerLoop::new(options, services, world, director, begun).run())
}

/// Begins the metrics of a run, and returns the span that names it in the log.
fn begin_named(options: &SwarmOptions, run: &str, dir: &RunDir) -> tracing::Span {
    if let Some(metrics) = &options.metrics {
        metrics.begin(run, HostId::CONTROLLER, Some(dir.root()));
    }
    options.run.get_or_init(|| run.to_owned());
    tracing::error_span!("run", run, host = %HostId::CONTROLLER)
}

/// Reads what metrics say of a run from its directory, before that is removed.
fn settled(
    options: &SwarmOptions,
    ran: Result<SwarmOutcome, SwarmError>,
) -> Result<SwarmOutcome, SwarmError> {
    options.metrics.iter().for_each(Metrics::settle);
    ran
}

/// Resumes a swarm whose controller was killed, in the state recovered from its journal. Otherwise like
/// [`run_swarm`].
///
/// # Errors
/// If the swarm cannot be taken over, or its controller cannot continue.
pub fn resume_swarm<W, D>(
    options: &SwarmOptions,
    adopted: Adopted,
    resumption: Resumption<W::Agent>,
    world: &mut W,
    director: &mut D,
) -> Result<SwarmOutcome, SwarmError>
where
    W: World,
    D: DirectorPort<W>,
{
    let count = world.len();
    let begun = begin(options, count)?;
    let Adopted { mut dir, epoch, lock } = adopted;
    watch_over(&mut dir, options)?;
    options.root.get_or_init(|| dir.root().to_owned());
    let swarm = fs::read(swarm_file::path(dir.root())).unwrap_or_default();
    let run = swarm_file::run_of(&swarm).unwrap_or_else(|| dir.name().to_string());
    let _named = begin_named(options, &run, &dir).entered();
    let generation = match lock {
        // The directory is new; only the first controller of a run has generation 0.
        Some(_) => 1,
        None => ControllerLease::read(dir.root()).map_err(SwarmError::Identity)?.generation + 1,
    };
    let is_divided = options.link.hosts.as_ref().is_some_and(|hosts| hosts.len() > 1);
    let wanted = resumption.agents.iter().map(|agent| (agent.id, agent.incarnation)).collect();
    let parts = options.journal.as_ref().map(|parts| parts.dir.as_path());
    let mut inherited = is_divided.then(|| Fleet::take_over(dir.root(), &wanted, parts)).transpose()?;
    let clock = match (&mut inherited, &lock) {
        (Some(inherited), Some(_)) => {
            inherited.has_moved = true;
            // No host is ahead of the controller.
            FileClock::create(dir.root(), inherited.time.max(resumption.until))
        }
        _ => FileClock::open_writable(dir.root()),
    };
    let pace = pace(options, clock.map_err(SwarmError::Clock)?)?;
    // First the channels, then the lease: an agent that finds the new controller can reach it.
    let (transport, launcher) =
        attach(launch(options, &dir, generation), &options.shutdown, &dir, count, is_divided)?;
    acquire_lease(&dir, generation)?;
    let (reserve, root) = (Reserve::left(dir.root()), dir.root());
    let Some(inherited) = inherited else {
        let services = Services::<Processes> { launcher, transport, pace, reserve, dir: Some(&dir) };
        let controller = ControllerLoop::new(options, services, world, director, begun);
        return settled(options, controller.go_on(root, epoch, resumption));
    };
    let (transport, launcher) = backend(inherited, (transport, launcher), root, generation, options)?;
    let services = Services::<Hosts> { launcher, transport, pace, reserve, dir: Some(&dir) };
    let controller = ControllerLoop::new(options, services, world, director, begun);
    settled(options, controller.go_on(root, epoch, resumption))
}

/// Prepares this process to control a swarm. Returns the time of CLOCK_MONOTONIC at which the run was asked
/// for (ns).
fn begin(options: &SwarmOptions, count: usize) -> Result<u64, SwarmError> {
    catch_signals(options)?;
    raise_descriptor_limit(count as u64)?;
    set_verbosity(options.verbose);
    Ok(monotonic())
}

fn pace(options: &SwarmOptions, clock: FileClock) -> Result<Pace<FileClock>, SwarmError> {
    Pace::new(clock, options.speed, options.tolerance, Arc::clone(&options.share)).map_err(SwarmError::Clock)
}

fn watch_over(dir: &mut RunDir, options: &SwarmOptions) -> Result<(), SwarmError> {
    let Some((program, args)) = &options.watcher else { return Ok(()) };
    let watch = Watch::start(program, args, dir.root()).map_err(SwarmError::Watcher)?;
    dir.keep(watch);
    Ok(())
}

/// Takes the lease of a run.
///
/// # Errors
/// If this process has no identity, or the lease cannot be written.
pub fn acquire_lease(dir: &RunDir, generation: u32) -> Result<ControllerLease, SwarmError> {
    let controller = Identity::own().map_err(SwarmError::Identity)?;
    let lease = ControllerLease { controller, generation };
    lease.acquire(dir.root()).map_err(SwarmError::Identity)?;
    Ok(lease)
}

fn launch(options: &SwarmOptions, dir: &RunDir, generation: u32) -> Launch {
    Launch {
        program: options.program.clone(),
        args: options.program_args.clone(),
        root: dir.root().to_owned(),
        generation,
        verbose: options.verbose,
        oom_kills: oom_kills(),
    }
}

/// Joins a run as the controller of its agents, of which there are at most `count`. With `egress` its inbox also
/// takes frames to agents of other hosts.
///
/// # Errors
/// If a channel or a thread cannot be created.
pub fn attach(
    launch: Launch,
    shutdown: &Shutdown,
    dir: &RunDir,
    count: usize,
    egress: bool,
) -> Result<(IceoryxTransport, Supervisor), SwarmError> {
    let shards = (count as u32).div_ceil(SHARD);
    let senders = count.min(SHARD as usize) + UNREAPED;
    let at = Rendezvous::join(dir.root())?;
    let transport = IceoryxTransport::controller(at, launch.generation, shards, senders, egress)?;
    space::allocate(dir.name()).map_err(reserve::refused_own)?;
    Ok((transport, Supervisor::start(launch, shutdown.clone())?))
}
