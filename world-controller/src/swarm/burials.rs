//! A thread that buries dead agents ([`Undertaker`]), so that neither launches nor the conductor wait for it.

use crate::swarm::outcome::SwarmError;
use crate::swarm::supervise::Life;
use metamorph_module_agent::pid_file;
use metamorph_module_agent::transport::iceoryx::reaper::Undertaker;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Without a death for so long, the files of the dead are removed.
const QUIET: Duration = Duration::from_millis(500);
/// Ports of the dead whose files are removed together: looking for them costs as much for one as for all.
const TOGETHER: usize = 1_000;

/// The conductor's handle on the thread.
#[derive(Debug)]
pub struct Burials {
    dead: Option<Sender<Life>>,
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Burials {
    /// Starts the thread for the run in `root`.
    pub fn start(root: &Path) -> Result<Burials, SwarmError> {
        let undertaker = Undertaker::of(root).map_err(|e| SwarmError::Supervisor(io::Error::other(e)))?;
        let (dead, waiting) = channel();
        let over = Arc::new(AtomicBool::new(false));
        let work = Work { undertaker, root: root.to_owned(), waiting, over: Arc::clone(&over) };
        let thread = std::thread::Builder::new().name("undertaker".into()).spawn(move || work.run());
        Ok(Burials { dead: Some(dead), over, thread: Some(thread.map_err(SwarmError::Supervisor)?) })
    }

    /// A life is over. Few wait: new lives find no place before old ones are buried.
    pub fn bury(&self, life: Life) {
        if let Some(dead) = &self.dead
            && dead.send(life).is_err()
        {
            tracing::error!("the undertaker's thread has ended");
        }
    }
}

impl Drop for Burials {
    fn drop(&mut self) {
        // What is left is removed with the run.
        self.over.store(true, Ordering::Relaxed);
        self.dead = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the undertaker's thread panicked");
        }
    }
}

struct Work {
    undertaker: Undertaker,
    root: PathBuf,
    waiting: Receiver<Life>,
    over: Arc<AtomicBool>,
}

impl Work {
    fn run(mut self) {
        while !self.over.load(Ordering::Relaxed) {
            let next = if self.undertaker.waiting() == 0 {
                self.waiting.recv().map_err(|_| RecvTimeoutError::Disconnected)
            } else if self.undertaker.waiting() >= TOGETHER {
                Err(RecvTimeoutError::Timeout)
            } else {
                self.waiting.recv_timeout(QUIET)
            };
            let done = match next {
                Ok(life) => self.bury(life),
                Err(RecvTimeoutError::Timeout) => self.undertaker.clear(),
                Err(RecvTimeoutError::Disconnected) => return,
            };
            if let Err(e) = done {
                tracing::debug!("what a dead agent held could not be given back: {e}");
            }
        }
    }

    fn bury(&mut self, (id, life): Life) -> io::Result<()> {
        let text = std::fs::read_to_string(pid_file(&self.root, id, life))?;
        // Whoever died before it had joined has left nothing.
        text.lines().nth(1).and_then(|line| line.parse().ok()).map_or(Ok(()), |m| self.undertaker.bury(m))
    }
}
