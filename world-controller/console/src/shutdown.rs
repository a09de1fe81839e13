//! The request to end a swarm early, from the signal handler to the supervisor.

use tokio::sync::watch;

/// The urgency with which a swarm is asked to end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Urgency {
    /// The swarm is not asked to end.
    #[default]
    None,
    /// The swarm is asked to shut down cleanly: agents are asked to stop.
    Asked,
    /// The swarm is asked to end at once: agents are killed.
    Hurried,
}

/// Asks a swarm to end early and cleanly. Clones refer to the same swarm.
#[derive(Clone, Debug)]
pub struct Shutdown(watch::Sender<Urgency>);

impl Shutdown {
    /// Returns a request that has not been made yet.
    pub fn new() -> Shutdown {
        Shutdown(watch::Sender::new(Urgency::None))
    }
    /// Asks the swarm to end; a second call asks it to hurry.
    pub fn request(&self) {
        self.0.send_modify(|urgency| {
            *urgency = if *urgency == Urgency::None { Urgency::Asked } else { Urgency::Hurried };
        });
    }
    /// Returns the current urgency of the request.
    pub fn urgency(&self) -> Urgency {
        *self.0.borrow()
    }
    /// Waits until the urgency is above `known`, and returns it.
    pub async fn beyond(&self, known: Urgency) -> Urgency {
        // Invariant: the sender is `self`, so the channel cannot be closed.
        self.0.subscribe().wait_for(|urgency| *urgency > known).await.map_or(known, |urgency| *urgency)
    }
}

impl Default for Shutdown {
    fn default() -> Shutdown {
        Shutdown::new()
    }
}
