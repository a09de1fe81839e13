//! How attempts to close a connector end: by chance alone, or by the model of the mechanism.

use metamorph_kernel::world::body_queue::BodyQueue;
use metamorph_protocol::roombots::connection::{Attempt, ConnectionModel, Misalignment};

/// How an action ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum ActionEnd {
    /// As intended.
    Done,
    /// Without effect: a joint is stuck, or the grippers did not catch.
    Failed,
    /// Without effect: the connector was too far from its target.
    Misaligned,
}

impl ActionEnd {
    /// Returns the end of an action that fails, or does not.
    pub fn of(fails: bool) -> ActionEnd {
        if fails { ActionEnd::Failed } else { ActionEnd::Done }
    }
}

/// Counts of attempts to close a connector, where a model decides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ConnectionCounts {
    /// Attempts.
    pub attempts: u64,
    /// Those whose connector was out of the tolerances.
    pub misaligned: u64,
    /// Those within the tolerances whose grippers did not catch.
    pub missed: u64,
    /// The largest shift by bending, in micrometres.
    pub largest_shift_um: u32,
}

/// Decides how attempts to close a connector end.
#[derive(Clone, Copy, Debug, Default)]
pub struct Connections {
    model: Option<ConnectionModel>,
    counts: ConnectionCounts,
}

impl Connections {
    /// Creates the judge of a world. Without a model, chance alone decides.
    pub fn new(model: Option<ConnectionModel>) -> Connections {
        Connections { model, counts: ConnectionCounts::default() }
    }
    /// Returns the counts so far; `None` without a model.
    pub fn counts(&self) -> Option<ConnectionCounts> {
        self.model.map(|_| self.counts)
    }
    /// Decides about an attempt. `bent` returns how far bending takes the connector from its target.
    pub fn attempt<P>(
        &mut self,
        queue: &mut BodyQueue<P>,
        bent: impl FnOnce(&ConnectionModel) -> Misalignment,
    ) -> ActionEnd {
        let Some(model) = &self.model else { return ActionEnd::of(queue.draw_failure()) };
        let misalignment = bent(model);
        let (failure, rng) = queue.chances();
        self.counts.attempts += 1;
        self.counts.largest_shift_um = self.counts.largest_shift_um.max(misalignment.shift_um);
        match model.attempt(&misalignment, failure, rng) {
            Attempt::Connected => ActionEnd::Done,
            Attempt::Failed => {
                self.counts.missed += 1;
                ActionEnd::Failed
            }
            Attempt::OutOfTolerance => {
                self.counts.misaligned += 1;
                ActionEnd::Misaligned
            }
        }
    }
}
