//! A thread that reaps dead agents ([`NodeReaper`]), so that launches and the controller loop need not wait.

use crate::swarm::outcome::SwarmError;
use metamorph_module_agent::pid_file;
use metamorph_module_agent::transport::AgentKey;
use metamorph_module_agent::transport::iceoryx::reaper::NodeReaper;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Time without a death after which the files of dead agents are removed.
const QUIET: Duration = Duration::from_millis(500);
/// Number of ports of dead agents whose files are removed together: one search finds the files of all.
const TOGETHER: usize = 1_000;

/// The handle on the thread.
#[derive(Debug)]
pub struct ReaperThread {
    dead: Option<Sender<AgentKey>>,
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl ReaperThread {
    /// Starts the thread for the run in `root`.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub fn start(root: &Path) -> Result<ReaperThread, SwarmError> {
        let reaper = NodeReaper::of(root).map_err(|e| SwarmError::Supervisor(io::Error::other(e)))?;
        let (dead, waiting) = channel();
        let over = Arc::new(AtomicBool::new(false));
        let work = Work { reaper, root: root.to_owned(), waiting, over: Arc::clone(&over) };
        let thread = std::thread::Builder::new().name("reaper".into()).spawn(move || work.run());
        Ok(ReaperThread { dead: Some(dead), over, thread: Some(thread.map_err(SwarmError::Supervisor)?) })
    }

    /// Queues an incarnation that has ended for the thread to reap.
    pub fn reap(&self, agent: AgentKey) {
        if let Some(dead) = &self.dead
            && dead.send(agent).is_err()
        {
            tracing::error!("the reaper's thread has ended");
        }
    }
}

impl Drop for ReaperThread {
    fn drop(&mut self) {
        // All other files are removed with the run.
        self.over.store(true, Ordering::Relaxed);
        self.dead = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the reaper's thread panicked");
        }
    }
}

struct Work {
    reaper: NodeReaper,
    root: PathBuf,
    waiting: Receiver<AgentKey>,
    over: Arc<AtomicBool>,
}

impl Work {
    fn run(mut self) {
        while !self.over.load(Ordering::Relaxed) {
            let next = if self.reaper.waiting() == 0 {
                self.waiting.recv().map_err(|_| RecvTimeoutError::Disconnected)
            } else if self.reaper.waiting() >= TOGETHER {
                Err(RecvTimeoutError::Timeout)
            } else {
                self.waiting.recv_timeout(QUIET)
            };
            let done = match next {
                Ok(agent) => self.reap(agent),
                Err(RecvTimeoutError::Timeout) => self.reaper.clear(),
                Err(RecvTimeoutError::Disconnected) => return,
            };
            if let Err(e) = done {
                tracing::debug!("what a dead agent held could not be given back: {e}");
            }
        }
    }

    fn reap(&mut self, (id, incarnation): AgentKey) -> io::Result<()> {
        let text = std::fs::read_to_string(pid_file(&self.root, id, incarnation))?;
        // An agent that died before it joined leaves nothing.
        text.lines().nth(1).and_then(|line| line.parse().ok()).map_or(Ok(()), |m| self.reaper.reap(m))
    }
}
