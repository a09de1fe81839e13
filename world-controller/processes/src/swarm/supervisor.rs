//! The launcher of processes on this machine: starts them, sends them signals and notices their ends, on a
//! thread of its own with tokio. It reports to the controller by a queue and by ringing its bell.
//!
//! When its handle is dropped, the supervisor kills the agents that still run. Agents are in process groups
//! of their own, so that Ctrl-C reaches only the controller.

use crate::swarm::launcher::{Event, Found, Launcher, Takeover};
use crate::swarm::outcome::SwarmError;
use crate::swarm::reaper::ReaperThread;
use crate::swarm::reserve::SCARCE;
use crate::swarm::run_dir::{identities, kill, log_directory};
use crate::swarm::signals;
use metamorph_console::shutdown::{Shutdown, Urgency};
use metamorph_module_agent::AgentArgs;
use metamorph_module_agent::journal_file::agent_of;
use metamorph_module_agent::process::start::EXIT_OF_MACHINE;
use metamorph_module_agent::run_dir::counter_file::{AgentCounters, CounterFile};
use metamorph_module_agent::run_dir::identity::Identity;
use metamorph_module_agent::run_dir::run_name::HOME;
use metamorph_module_agent::transport::AgentKey;
use metamorph_module_agent::transport::iceoryx::rendezvous::{self, ChannelError, Notifier, Rendezvous};
use metamorph_module_agent::transport::iceoryx::space;
use rustix::process::{
    Pid, PidfdFlags, Signal, WaitId, WaitIdOptions, kill_process, pidfd_open, pidfd_send_signal, waitid,
};
use signal_hook::consts::{SIGABRT, SIGBUS, SIGILL, SIGKILL, SIGSEGV, SIGXFSZ};
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom};
use std::os::unix::fs::MetadataExt;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc as queue;
use std::sync::{Arc, LazyLock};
use std::thread::JoinHandle;
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;
use tokio::process::{Child, Command};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;
use tokio::task::JoinSet;

/// How agents are started.
#[derive(Clone, Debug)]
pub struct Launch {
    pub program: PathBuf,
    pub args: Vec<OsString>,
    pub root: PathBuf,
    /// The generation of the controller.
    pub generation: u32,
    pub verbose: bool,
    /// The number of processes that the kernel had killed for want of memory before the run ([`oom_kills`]).
    pub oom_kills: u64,
}

/// A task for the supervisor's thread.
#[derive(Debug)]
enum Task {
    Spawn(AgentKey),
    /// A process that an earlier controller has started.
    Adopt(AgentKey, Identity),
    Signal(AgentKey, Signal),
}

/// Number of tasks that may wait. Beyond it the controller blocks, which cannot cause a deadlock, because
/// the supervisor never waits for the controller.
const TASKS: usize = 1_024;
/// Number of signals that may wait for one process.
const SIGNALS: usize = 16;
/// Largest number of bytes from the end of an agent's standard error that are reported.
const TAIL: u64 = 2_048;
/// How the standard library begins to report that an allocation has failed, before it aborts.
const REFUSED: &str = "memory allocation of ";

/// The handle on the supervisor.
#[derive(Debug)]
pub struct Supervisor {
    tasks: Option<mpsc::Sender<Task>>,
    events: queue::Receiver<Event>,
    thread: Option<JoinHandle<()>>,
    reaper: ReaperThread,
    root: PathBuf,
}

impl Supervisor {
    /// Starts the supervisor's thread, and the one that reaps.
    ///
    /// # Errors
    /// If a thread or its channels cannot be created.
    pub fn start(launch: Launch, shutdown: Shutdown) -> Result<Supervisor, SwarmError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(SwarmError::Supervisor)?;
        let root = launch.root.clone();
        let (tasks, inbox) = mpsc::channel(TASKS);
        let (sender, events) = queue::channel();
        let (ready, is_ready) = queue::channel();
        let named = tracing::Span::current();
        let thread = std::thread::Builder::new()
            .name("supervisor".into())
            .spawn(move || {
                let _named = named.entered();
                // Channels stay with their thread, so the bell is created here.
                let bell = Bell::new(&launch, sender);
                let _ = ready.send(bell.as_ref().map(drop).map_err(|e| e.to_string()));
                if let Ok(bell) = bell {
                    runtime.block_on(supervise(launch, shutdown, inbox, bell));
                }
            })
            .map_err(SwarmError::Supervisor)?;
        match is_ready.recv() {
            Ok(Ok(())) => {}
            Ok(Err(text)) => return Err(SwarmError::Supervisor(io::Error::other(text))),
            Err(_) => return Err(ended()),
        }
        let reaper = ReaperThread::start(&root)?;
        Ok(Supervisor { tasks: Some(tasks), events, thread: Some(thread), reaper, root })
    }

    fn ask(&self, task: Task) {
        if let Some(tasks) = &self.tasks
            && tasks.blocking_send(task).is_err()
        {
            tracing::error!("the supervisor's thread has ended");
        }
    }
}

fn ended() -> SwarmError {
    SwarmError::Supervisor(io::Error::other("its thread ended"))
}

impl Launcher for Supervisor {
    fn start(&mut self, agent: AgentKey) {
        self.ask(Task::Spawn(agent));
    }

    fn signal(&mut self, agent: AgentKey, signal: Signal) {
        self.ask(Task::Signal(agent, signal));
    }

    fn reap(&mut self, agent: AgentKey) {
        self.reaper.reap(agent);
    }

    fn event(&mut self) -> Result<Option<Event>, SwarmError> {
        match self.events.try_recv() {
            Ok(event) => Ok(Some(event)),
            Err(_) if self.thread.as_ref().is_none_or(JoinHandle::is_finished) => Err(ended()),
            Err(_) => Ok(None),
        }
    }

    fn counters(&self, (id, incarnation): AgentKey) -> Result<Option<AgentCounters>, String> {
        CounterFile::read(&self.root, id, incarnation).map_err(|e| e.to_string())
    }
}

impl Takeover for Supervisor {
    fn take_over(&mut self, root: &Path, wanted: &BTreeSet<AgentKey>) -> Found {
        let mut found = Found::default();
        for (agent, identity) in identities(root).filter_map(|(name, is)| Some((agent_of(&name)?, is))) {
            // Numbers of incarnations that had not begun are used up too.
            found.latest.push(agent);
            if wanted.contains(&agent) {
                found.present.insert(agent, identity.is_alive());
                self.ask(Task::Adopt(agent, identity));
            } else if kill(identity) {
                tracing::debug!("module {} had been started, and was not to take part yet", agent.0);
            }
        }
        found
    }
}

impl Drop for Supervisor {
    fn drop(&mut self) {
        // The closed queue makes the supervisor kill all agents and end.
        self.tasks = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the supervisor's thread panicked");
        }
    }
}

struct Bell {
    notifier: Notifier,
    _service: rendezvous::Wakes,
    _at: Rendezvous,
    sender: queue::Sender<Event>,
}

impl Bell {
    fn new(launch: &Launch, sender: queue::Sender<Event>) -> Result<Bell, ChannelError> {
        let at = Rendezvous::join(&launch.root)?;
        let service = at.open_controller_bell(launch.generation)?;
        Ok(Bell { notifier: rendezvous::ring(&service)?, _service: service, _at: at, sender })
    }
    fn tell(&self, event: Event) {
        if self.sender.send(event).is_ok()
            && let Err(e) = self.notifier.notify()
        {
            tracing::debug!("cannot ring the controller's bell: {e:?}; it looks once a second");
        }
    }
}

/// A process under supervision.
struct Attended {
    signals: mpsc::Sender<Signal>,
    /// Its pid if it is a child of this process; the kernel reports stops of children only.
    child: Option<Pid>,
    halt: Arc<Halt>,
}

/// The cause of a process's stop.
#[derive(Debug, Default)]
struct Halt {
    /// True if the latest of SIGSTOP and SIGCONT that this controller sent was SIGSTOP.
    by_us: AtomicBool,
    /// True if it was stopped by another signal, and this controller has sent no SIGCONT since.
    from_outside: AtomicBool,
}

impl Halt {
    /// Notes a signal that has just been sent.
    fn sent(&self, signal: Signal) {
        if signal == Signal::STOP || signal == Signal::CONT {
            self.by_us.store(signal == Signal::STOP, Ordering::Relaxed);
        }
        if signal == Signal::CONT {
            self.from_outside.store(false, Ordering::Relaxed);
        }
    }
}

/// Reports children that were stopped or continued from outside. Checks all of them only if the kernel says
/// that there is one, so that ends of processes cost one call each.
fn look_for_stops(processes: &BTreeMap<AgentKey, Attended>, bell: &Bell) {
    let what = WaitIdOptions::STOPPED | WaitIdOptions::CONTINUED | WaitIdOptions::NOHANG;
    // An error says that there are no children.
    if !matches!(waitid(WaitId::All, what | WaitIdOptions::NOWAIT), Ok(Some(_))) {
        return;
    }
    for (agent, Attended { child, halt, .. }) in processes {
        let Some(pid) = *child else { continue };
        let Ok(Some(status)) = waitid(WaitId::Pid(pid), what) else { continue };
        // The kernel reports a stop only while it lasts, so a stop that this controller has ended does not
        // count as one from outside.
        if status.stopped() && !halt.by_us.load(Ordering::Relaxed) {
            halt.from_outside.store(true, Ordering::Relaxed);
            bell.tell(Event::Stopped(*agent, status.stopping_signal().unwrap_or_default()));
        } else if status.continued() && halt.from_outside.swap(false, Ordering::Relaxed) {
            bell.tell(Event::Continued(*agent));
        }
    }
}

async fn supervise(launch: Launch, shutdown: Shutdown, mut tasks: mpsc::Receiver<Task>, bell: Bell) {
    let mut processes: BTreeMap<AgentKey, Attended> = BTreeMap::new();
    let mut changes = signal(SignalKind::child()).inspect_err(|e| {
        tracing::warn!("agents that are stopped from outside will not be noticed: {e}");
    });
    let mut ends = JoinSet::new();
    let mut told = Urgency::None;
    loop {
        tokio::select! {
            task = tasks.recv() => match task {
                Some(Task::Spawn(agent)) => match spawn(&launch, agent) {
                    Ok(child) => {
                        let (signals, inbox) = mpsc::channel(SIGNALS);
                        let halt = Arc::<Halt>::default();
                        let pid = child.id().and_then(|pid| Pid::from_raw(pid as i32));
                        processes.insert(agent, Attended { signals, child: pid, halt: halt.clone() });
                        ends.spawn(attend(agent, child, inbox, halt));
                    }
                    Err(e) => bell.tell(Event::SpawnFailed(agent, e)),
                },
                Some(Task::Adopt(agent, identity)) => {
                    let (signals, inbox) = mpsc::channel(SIGNALS);
                    processes.insert(agent, Attended { signals, child: None, halt: Arc::default() });
                    ends.spawn(attend_adopted(agent, identity, inbox));
                }
                Some(Task::Signal(agent, signal)) => {
                    // A process that has ended needs no signals.
                    if let Some(process) = processes.get(&agent) {
                        let _ = process.signals.send(signal).await;
                    }
                }
                None => break,
            },
            Some(end) = ends.join_next() => {
                // Invariant: `attend` neither panics nor is aborted.
                let Ok((agent, status)) = end else { continue };
                processes.remove(&agent);
                bell.tell(exited(&launch, agent, status));
            }
            () = next_change(changes.as_mut().ok()) => look_for_stops(&processes, &bell),
            urgency = shutdown.beyond(told), if told < Urgency::Hurried => {
                told = urgency;
                bell.tell(Event::Shutdown(urgency));
            }
        }
    }
    for process in processes.values() {
        let _ = process.signals.send(Signal::KILL).await;
    }
    while ends.join_next().await.is_some() {}
}

/// Completes when a child of this process has ended, stopped or continued.
async fn next_change(changes: Option<&mut tokio::signal::unix::Signal>) {
    match changes {
        Some(changes) => drop(changes.recv().await),
        None => std::future::pending().await,
    }
}

fn log_path(launch: &Launch, (id, incarnation): AgentKey) -> PathBuf {
    log_directory(&launch.root).join(format!("{id}.{incarnation}"))
}

/// Returns the file from which a program is started. The file of the program that runs may have been replaced or deleted since, as
/// by an update; then agents are started from the running program itself, so that all of a run are of one build.
fn startable(program: &Path) -> &Path {
    /// The program that runs, as the kernel keeps it.
    const RUNNING: &str = "/proc/self/exe";
    static OWN: LazyLock<Option<PathBuf>> = LazyLock::new(|| std::env::current_exe().ok());
    let file = |path: &Path| fs::metadata(path).ok().map(|file| (file.dev(), file.ino()));
    let is_own = OWN.as_deref() == Some(program);
    if is_own && file(program) != file(Path::new(RUNNING)) { Path::new(RUNNING) } else { program }
}

/// Starts an agent by fork and exec; a bare `fork` would break shared memory.
///
/// iceoryx2 does not mark its files to be closed on exec, and an agent would inherit all that the controller
/// has open at the time, thousands in a large swarm. So all files are marked here.
fn spawn(launch: &Launch, agent: AgentKey) -> io::Result<Child> {
    let (root, verbose) = (launch.root.clone(), launch.verbose);
    let args = AgentArgs { root, id: agent.0, incarnation: agent.1, verbose };
    let stderr =
        if launch.verbose { Stdio::inherit() } else { File::create(log_path(launch, agent))?.into() };
    close_fds::set_fds_cloexec_threadsafe(3, &[]);
    Command::new(startable(&launch.program))
        .args(&launch.args)
        .args(args.to_command_line())
        .process_group(0)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(stderr)
        .kill_on_drop(true)
        .spawn()
}

/// Waits for the end of a process and passes on signals. A process that has been waited for gets no more
/// signals, so that they cannot hit a reused pid.
async fn attend(
    agent: AgentKey,
    mut child: Child,
    mut signals: mpsc::Receiver<Signal>,
    halt: Arc<Halt>,
) -> (AgentKey, io::Result<ExitStatus>) {
    loop {
        tokio::select! {
            status = child.wait() => return (agent, status),
            Some(signal) = signals.recv() => {
                let pid = child.id().and_then(|pid| Pid::from_raw(pid as i32));
                match pid.map(|pid| kill_process(pid, signal)) {
                    Some(Err(e)) => tracing::warn!("cannot signal module {}: {e}", agent.0),
                    Some(Ok(())) => halt.sent(signal),
                    None => {}
                }
            }
        }
    }
}

/// Like [`attend`] for a process that is not a child. Its exit status is unknown; its end counts as an exit.
async fn attend_adopted(
    agent: AgentKey,
    identity: Identity,
    mut signals: mpsc::Receiver<Signal>,
) -> (AgentKey, io::Result<ExitStatus>) {
    let ended = Ok(ExitStatus::from_raw(0));
    let fd = identity.as_pid().ok_or(rustix::io::Errno::SRCH);
    let fd = match fd.and_then(|pid| pidfd_open(pid, PidfdFlags::NONBLOCK)) {
        Ok(fd) => fd,
        Err(rustix::io::Errno::SRCH) => return (agent, ended),
        Err(e) => return (agent, Err(e.into())),
    };
    // The descriptor was opened before the identity is checked: from then on the process is fixed.
    if !identity.is_alive() {
        return (agent, ended);
    }
    #[allow(deprecated, reason = "sound here: an owned descriptor stays what it is; the successor is unsafe")]
    let fd = match AsyncFd::with_interest(fd, Interest::READABLE) {
        Ok(fd) => fd,
        Err(e) => return (agent, Err(e)),
    };
    loop {
        tokio::select! {
            over = fd.readable() => return (agent, over.and(ended)),
            Some(signal) = signals.recv() => {
                if let Err(e) = pidfd_send_signal(fd.get_ref(), signal) {
                    tracing::warn!("cannot signal module {}: {e}", agent.0);
                }
            }
        }
    }
}

fn exited(launch: &Launch, agent: AgentKey, status: io::Result<ExitStatus>) -> Event {
    let signal = status.as_ref().ok().and_then(ExitStatusExt::signal);
    let code = status.as_ref().ok().and_then(ExitStatus::code);
    let mut stderr_tail = if launch.verbose { String::new() } else { tail(&log_path(launch, agent)) };
    // A backtrace may follow; with `verbose` it is not known why it aborted, and an abort may be a defect of the agent.
    let refused = stderr_tail.lines().find(|line| signal == Some(SIGABRT) && line.starts_with(REFUSED));
    let is_refused = refused.is_some();
    if let Some(line) = refused {
        stderr_tail = line.to_owned();
    }
    let of_machine = is_refused
        || code == Some(i32::from(EXIT_OF_MACHINE))
        || signal.is_some_and(|s| is_of_machine(launch, s));
    let how = match status {
        Err(e) => format!("could not be waited for: {e}"),
        Ok(_) => match (code, signal) {
            (Some(0), _) => "exited".to_owned(),
            // Its own report may have found no room, as standard error is in shared memory too.
            (Some(code), _) if is_scarce() => {
                format!("exited with code {code}, while shared memory ({HOME}) is full,")
            }
            (Some(code), _) => format!("exited with code {code}"),
            (None, Some(_)) if is_refused => {
                "aborted, because it may map no more memory (ulimit -v),".to_owned()
            }
            (None, Some(SIGKILL)) if of_machine => {
                "was killed by the kernel, because memory has run out,".to_owned()
            }
            (None, Some(signal)) => killed_by(signal),
            (None, None) => "ended".to_owned(),
        },
    };
    if code == Some(0) && !stderr_tail.is_empty() {
        // Its log ends with the run; that of one that crashes is in the report.
        tracing::warn!(module = agent.0.0, "its log ended with: {}", stderr_tail.trim());
    }
    Event::Exited { agent, how, signal, of_machine, stderr_tail }
}

/// Returns true if the kernel ended a process by this signal for want of memory, or because of a bad address or instruction.
fn is_of_machine(launch: &Launch, signal: i32) -> bool {
    match signal {
        SIGBUS | SIGSEGV | SIGILL => true,
        SIGKILL => oom_kills() > launch.oom_kills,
        _ => false,
    }
}

/// Returns the number of processes that the kernel has killed since the system started because memory had run out; 0 where it does
/// not count them.
pub fn oom_kills() -> u64 {
    let all = std::fs::read_to_string("/proc/vmstat").unwrap_or_default();
    let count = |line: &str| line.strip_prefix("oom_kill ")?.trim().parse().ok();
    all.lines().find_map(count).unwrap_or_default()
}

fn is_scarce() -> bool {
    space::require(SCARCE).is_err()
}

/// Describes the end of a process by a signal. SIGBUS and SIGXFSZ are described by the resource that ran out.
fn killed_by(signal: i32) -> String {
    match signal {
        SIGBUS if is_scarce() => {
            format!("died of SIGBUS: shared memory ({HOME}) is full")
        }
        SIGBUS => format!("died of SIGBUS: shared memory ({HOME}) was full, or a file in it was cut"),
        SIGXFSZ => "died of SIGXFSZ: a file grew beyond the limit of file sizes (ulimit -f)".to_owned(),
        _ => format!("was killed by {}", signals::name(signal)),
    }
}

fn tail(path: &Path) -> String {
    let read = || -> io::Result<Vec<u8>> {
        let mut file = File::open(path)?;
        let length = file.metadata()?.len();
        file.seek(SeekFrom::Start(length.saturating_sub(TAIL)))?;
        let mut bytes = Vec::new();
        file.take(TAIL).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    read().map(|b| String::from_utf8_lossy(&b).into_owned()).unwrap_or_else(|e| format!("({e})"))
}
