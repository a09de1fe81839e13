//! Ends a run cleanly when something else fills the shared memory, before its processes die of the shortage.
//! The memory that its end needs comes from the reserve.

use super::ControllerLoop;
use crate::swarm::launcher::Backend;
use metamorph_module_agent::transport::SpaceShortage;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::world::World;

/// Time between two checks (ns).
const EVERY: u64 = 500_000_000;

impl<W: World, D: DirectorPort<W>, B: Backend> ControllerLoop<'_, W, D, B> {
    pub(super) fn look_at_space(&mut self) {
        let now = self.pace.monotonic();
        if now.saturating_sub(self.looked) < EVERY {
            return;
        }
        self.looked = now;
        if let Err(shortage) = self.reserve.check() {
            self.run_short(shortage);
        }
    }

    pub(super) fn run_short(&mut self, shortage: SpaceShortage) {
        self.reserve.release();
        if self.outcome.shortage.is_none() {
            tracing::error!("the run ends: {shortage}");
            self.outcome.shortage = Some(shortage.to_string());
        }
        self.outcome.interrupted = true;
        self.finishing = true;
    }
}
