//! How a run ends when something else fills the shared memory: in order, with what is held back for that, before
//! its processes die of it.

use super::Conductor;
use crate::swarm::reserve::SCARCE;
use metamorph_module_agent::clock::monotonic;
use metamorph_module_agent::transport::iceoryx::space::{self, Full};
use metamorph_sim_bridge::director::port::Direct;
use metamorph_sim_bridge::world::World;

/// Nanoseconds between two looks.
const EVERY: u64 = 500_000_000;

impl<W: World, D: Direct<W>> Conductor<'_, W, D> {
    pub(super) fn look_at_space(&mut self) {
        let now = monotonic();
        if now.saturating_sub(self.looked) < EVERY {
            return;
        }
        self.looked = now;
        if let Err(full) = space::require(SCARCE) {
            self.run_short(full);
        }
    }

    pub(super) fn run_short(&mut self, full: Full) {
        self.reserve.release();
        if self.outcome.shortage.is_none() {
            tracing::error!("the run ends: {full}");
            self.outcome.shortage = Some(full.to_string());
        }
        self.outcome.interrupted = true;
        self.finishing = true;
    }
}
