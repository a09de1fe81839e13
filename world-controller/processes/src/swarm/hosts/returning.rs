//! Hosts that come back during a run: each daemon that is not heard is asked again and again to serve the run. One that
//! answers that it does has ended what an earlier daemon there had left, so its agents of before are certain to be dead.

use super::address::Address;
use super::messages::{Answer, Opening};
use super::reach::{MEETING, Reach, Reached};
use metamorph_protocol::ids::HostId;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

/// Time between two questions to one daemon.
const EVERY: Duration = Duration::from_secs(1);

/// Asks daemons, each on a thread of its own.
#[derive(Debug)]
pub struct Returning {
    /// Where the threads put daemons that serve the run again.
    back: Sender<(HostId, Reached)>,
    came_back: Receiver<(HostId, Reached)>,
    /// The hosts that are asked, and whether that is to end.
    asked: BTreeMap<HostId, Arc<AtomicBool>>,
}

impl Returning {
    /// Creates a state in which no daemon is asked.
    pub fn new() -> Returning {
        let (back, came_back) = channel();
        Returning { back, came_back, asked: BTreeMap::new() }
    }

    /// Asks the daemon of a host from now on, unless it is asked already.
    pub fn ask(&mut self, reach: &Arc<Reach>, host: HostId, address: &Address, opening: Opening) {
        if self.asked.contains_key(&host) {
            return;
        }
        let (reach, address, back) = (Arc::clone(reach), address.clone(), self.back.clone());
        let stop = Arc::new(AtomicBool::new(false));
        self.asked.insert(host, Arc::clone(&stop));
        let ask = move || {
            while !stop.load(Ordering::Relaxed) {
                match reach.ask(host, &address, &opening, Duration::ZERO, MEETING) {
                    Ok(reached) if matches!(reached.answer, Answer::Ready(..)) => {
                        // The run may be over.
                        let _ = back.send((host, reached));
                        return;
                    }
                    Ok(_) => {}
                    Err(e) => tracing::debug!("{host} is not back: {e}"),
                }
                std::thread::park_timeout(EVERY);
            }
        };
        if let Err(e) = std::thread::Builder::new().name(format!("return of {host}")).spawn(ask) {
            tracing::warn!("{host} cannot be asked to come back: {e}");
        }
    }

    /// Ceases to ask the daemon of a host, which is heard.
    pub fn cease(&mut self, host: HostId) {
        if let Some(stop) = self.asked.remove(&host) {
            stop.store(true, Ordering::Relaxed);
        }
    }

    /// Returns the next daemon that serves the run again.
    pub fn next(&mut self) -> Option<(HostId, Reached)> {
        let (host, reached) = self.came_back.try_recv().ok()?;
        self.asked.remove(&host);
        Some((host, reached))
    }
}

impl Drop for Returning {
    fn drop(&mut self) {
        self.asked.values().for_each(|stop| stop.store(true, Ordering::Relaxed));
    }
}
