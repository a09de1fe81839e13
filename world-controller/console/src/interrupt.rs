//! SIGINT (Ctrl-C), SIGTERM and SIGHUP. Before a command calls [`Interrupt::begin`], the first signal ends
//! the program. Afterwards the first signal asks the command to shut down cleanly, with a partial report, and
//! the second asks it to hurry; in both cases the program returns from `main`, so that everything temporary
//! is removed.
//!
//! A SIGHUP that is ignored when the program starts (`nohup`) stays ignored.

use crate::shutdown::Shutdown;
use crate::terminal::print_error;
use metamorph_kernel::director::outcome::Outcome;
use metamorph_module_agent::run_dir::identity::survive_file_limits;
use nix::sys::signal::{SigSet, Signal};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level::signal_name;
use std::fs;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// The requests by signals that the program end. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct Interrupt(Arc<Bell>);

#[derive(Debug, Default)]
struct Bell {
    /// Mirrors `Desk::signals > 0`, to be read without the lock.
    rung: AtomicBool,
    desk: Mutex<Desk>,
    ring: Condvar,
}

#[derive(Debug, Default)]
struct Desk {
    /// True once [`Interrupt::begin`] has been called.
    begun: bool,
    signals: u32,
    /// Swarms that the request is passed on to.
    swarms: Vec<Shutdown>,
}

/// The instance of this process.
static LISTENING: Mutex<Option<Interrupt>> = Mutex::new(None);

impl Interrupt {
    /// Listens for signals on a thread of its own. All calls return the same instance.
    pub fn listen() -> io::Result<Interrupt> {
        let mut listening = LISTENING.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(interrupt) = &*listening {
            return Ok(interrupt.clone());
        }
        survive_file_limits()?;
        let wanted = [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|s| *s != SIGHUP || !is_ignored(*s));
        let unblocked: SigSet = wanted.clone().filter_map(|signal| Signal::try_from(signal).ok()).collect();
        let mut signals = Signals::new(wanted)?;
        let interrupt = Interrupt::default();
        let receiver = interrupt.clone();
        let thread = std::thread::Builder::new().name("signals".into());
        thread.spawn(move || {
            // Blocked signals are inherited; a process delivers one to a thread that does not block it.
            if let Err(error) = unblocked.thread_unblock() {
                tracing::warn!("signals that are blocked stay so: {error}");
            }
            signals.forever().for_each(|signal| receiver.take(signal));
        })?;
        *listening = Some(interrupt.clone());
        Ok(interrupt)
    }

    /// Declares that from now on a signal must let the command shut down cleanly instead of ending the
    /// program. Does not return if a signal came before.
    pub fn begin(&self) {
        self.desk().begun = true;
    }

    /// Passes all requests to end on to a swarm, also those made before this call.
    pub fn pass_on(&self, swarm: &Shutdown) {
        let mut desk = self.desk();
        (0..desk.signals).for_each(|_| swarm.request());
        desk.swarms.push(swarm.clone());
    }

    /// Asks the command to end, as a signal does.
    pub fn request(&self) {
        self.0.rung.store(true, Ordering::Relaxed);
    }

    /// Returns true if the command is asked to end.
    pub fn is_set(&self) -> bool {
        self.0.rung.load(Ordering::Relaxed)
    }

    /// Blocks until the command is asked to end.
    pub fn wait(&self) {
        let rung = self.0.ring.wait_while(self.desk(), |desk| desk.signals == 0);
        drop(rung.unwrap_or_else(PoisonError::into_inner));
    }

    fn take(&self, signal: i32) {
        let name = signal_name(signal).unwrap_or("a signal");
        let mut desk = self.desk();
        desk.signals = desk.signals.saturating_add(1);
        self.0.rung.store(true, Ordering::Relaxed);
        if !desk.begun {
            // Keep the lock, so that nothing begins meanwhile.
            say(&format!("metamorph: ended by {name}; there is nothing to undo"));
            #[allow(clippy::disallowed_methods, reason = "nothing temporary is owned before `begin`")]
            std::process::exit(Outcome::Aborted.exit_code().into());
        }
        match desk.signals {
            1 => say(&format!("metamorph: {name}: ending, and removing what is temporary")),
            2 => say(&format!("metamorph: {name} again: ending at once")),
            _ => {}
        }
        desk.swarms.iter().for_each(Shutdown::request);
        self.0.ring.notify_all();
    }

    fn desk(&self) -> MutexGuard<'_, Desk> {
        self.0.desk.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Prints a message on standard error; on a terminal, in place of the progress line.
fn say(text: &str) {
    use std::io::IsTerminal as _;
    let fresh = if std::io::stderr().is_terminal() { "\r\x1b[2K" } else { "" };
    print_error(&format!("{fresh}{text}"));
}

/// Returns true if this process was started with the signal ignored.
fn is_ignored(signal: i32) -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok())
        .is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}
