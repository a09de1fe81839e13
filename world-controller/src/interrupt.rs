//! Ctrl-C and SIGTERM: the first asks a run to end with a partial report, the second ends the
//! program at once.

use metamorph_sim_bridge::outcome::Outcome;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use tokio::signal::unix::{SignalKind, signal};

/// Whether somebody wants the run to end.
#[derive(Clone, Debug, Default)]
pub struct Interrupt(Arc<Bell>);

#[derive(Debug, Default)]
struct Bell {
    rung: AtomicBool,
    quiet: Mutex<()>,
    ring: Condvar,
}

impl Interrupt {
    /// Listens for signals from now on, on a thread of its own.
    pub fn listen() -> io::Result<Interrupt> {
        let interrupt = Interrupt::default();
        let flag = interrupt.clone();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (mut ctrl_c, mut terminate) = {
            let _entered = runtime.enter();
            (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?)
        };
        std::thread::Builder::new().name("signals".into()).spawn(move || {
            runtime.block_on(async {
                loop {
                    tokio::select! { _ = ctrl_c.recv() => {}, _ = terminate.recv() => {} }
                    if flag.0.rung.swap(true, Ordering::Relaxed) {
                        std::process::exit(Outcome::Aborted.exit_code().into());
                    }
                    let _quiet = flag.0.quiet.lock().unwrap_or_else(PoisonError::into_inner);
                    flag.0.ring.notify_all();
                }
            })
        })?;
        Ok(interrupt)
    }

    /// Whether the run shall end.
    pub fn is_set(&self) -> bool {
        self.0.rung.load(Ordering::Relaxed)
    }
    /// Comes back when the run shall end.
    pub fn wait(&self) {
        let quiet = self.0.quiet.lock().unwrap_or_else(PoisonError::into_inner);
        let rung = self.0.ring.wait_while(quiet, |()| !self.is_set());
        drop(rung.unwrap_or_else(PoisonError::into_inner));
    }
}
