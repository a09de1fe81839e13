//! Breaking swarms of real processes from outside: a controller in a process of its own, and what
//! it leaves in shared memory.

use metamorph_module_agent::pid_directory;
use metamorph_module_agent::run_dir::identity::Identity;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use rustix::process::{Pid, Signal, kill_process};
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc;
use std::time::Duration;

/// No test waits longer for anything.
const WATCHDOG: Duration = Duration::from_secs(120);
/// How often a condition is looked at that nothing announces.
const LOOK: Duration = Duration::from_millis(20);

/// Waits until `condition` holds; panics with `what` if it never does.
pub fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    for _ in 0..WATCHDOG.as_millis() / LOOK.as_millis() {
        if condition() {
            return;
        }
        std::thread::park_timeout(LOOK);
    }
    panic!("waited in vain for {what}");
}

/// A controller in a process of its own. Killed when dropped, and what it leaves is removed.
#[derive(Debug)]
pub struct Controller {
    child: Child,
    lines: mpsc::Receiver<String>,
    /// The directory of its run.
    pub root: PathBuf,
}

impl Controller {
    /// Starts a controller of `count` probes and waits until they all talk to each other.
    pub fn start(program: &str, count: u32, chat_ms: u32, agent: &[&str]) -> Controller {
        let mut child = Command::new(program)
            .args([count.to_string(), chat_ms.to_string()])
            .args(agent)
            .stdout(Stdio::piped())
            .spawn()
            .expect("the controller starts");
        let stdout = child.stdout.take().expect("it is piped");
        let (sender, lines) = mpsc::channel();
        std::thread::spawn(move || {
            for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    break;
                }
            }
        });
        let mut controller = Controller { child, lines, root: PathBuf::new() };
        let line = controller.lines.recv_timeout(WATCHDOG);
        assert_eq!(line.as_deref(), Ok("ready"), "the swarm came up");
        controller.root = root_of(controller.pid()).expect("a run has a directory with its owner");
        controller
    }

    /// The controller's process.
    pub fn pid(&self) -> i32 {
        self.child.id() as i32
    }

    /// The process of a module.
    pub fn agent(&self, id: u32, incarnation: u16) -> Identity {
        agent_of(&self.root, id, incarnation).expect("an agent has a pid file")
    }

    /// All agents that ever said who they are.
    pub fn agents(&self) -> Vec<Identity> {
        let files = fs::read_dir(pid_directory(&self.root)).into_iter().flatten().flatten();
        files.filter_map(|f| fs::read_to_string(f.path()).ok()?.parse().ok()).collect()
    }

    /// Sends a signal to the controller.
    pub fn signal(&self, signal: Signal) {
        signal_to(self.child.id() as i32, signal);
    }

    /// Waits for the controller's end.
    pub fn wait(&mut self) -> ExitStatus {
        let mut status = None;
        wait_until("the controller to end", || {
            status = self.child.try_wait().expect("a child can be waited for");
            status.is_some()
        });
        status.expect("it was just there")
    }

    /// Asks for a clean end, and returns what the swarm came to.
    pub fn finish(mut self) -> BTreeMap<String, u64> {
        self.signal(Signal::TERM);
        assert!(self.wait().success(), "the controller ended well");
        let lines = std::iter::from_fn(|| self.lines.recv_timeout(WATCHDOG).ok());
        let pair = |line: String| {
            let (name, value) = line.split_once('=')?;
            Some((name.to_owned(), value.parse().ok()?))
        };
        let result = lines.filter_map(pair).collect();
        assert_eq!(left_of(&self.root), Vec::<PathBuf>::new(), "a clean end leaves nothing");
        result
    }
}

impl Drop for Controller {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = metamorph_world_controller::swarm::clean();
    }
}

/// The directory of the run that a process controls, once there is one.
pub fn root_of(controller: i32) -> Option<PathBuf> {
    let owner = |root: &Path| fs::read_to_string(root.join("owner")).ok()?.parse::<Identity>().ok();
    let mut roots = fs::read_dir("/dev/shm").ok()?.flatten().map(|e| e.path());
    roots.find(|root| owner(root).is_some_and(|o| o.pid == controller))
}

/// The process of a module of a run, once it has said who it is.
pub fn agent_of(root: &Path, id: u32, incarnation: u16) -> Option<Identity> {
    let (id, incarnation) = (ModuleId(id), Incarnation(incarnation));
    let path = pid_directory(root).join(format!("{id}.{incarnation}"));
    fs::read_to_string(path).ok()?.parse().ok()
}

/// Sends a signal to a process that the test knows to be alive.
pub fn signal_to(pid: i32, signal: Signal) {
    let pid = Pid::from_raw(pid).expect("a pid is not 0");
    kill_process(pid, signal).expect("the process is there and ours");
}

/// Everything in shared memory that belongs to a run.
pub fn left_of(root: &Path) -> Vec<PathBuf> {
    let name = root.file_name().and_then(OsStr::to_str).expect("a run has a name");
    let entries = fs::read_dir("/dev/shm").expect("it can be listed").flatten();
    let of_run = |e: &fs::DirEntry| e.file_name().to_str().is_some_and(|n| n.starts_with(name));
    entries.filter(of_run).map(|e| e.path()).collect()
}
