//! Bounds for a standstill of free modules.

use metamorph_protocol::free_module::reconfiguration::LatticeSetup;
use metamorph_scenario::bounds::{Bounds, Passage};

/// Returns the bounds of a structure of this many modules.
pub fn bounds(setup: &LatticeSetup, modules: usize, passage: Passage) -> Bounds {
    // A step may wait for its whole window, and then a silent module, and what is stuck, are tried again after the
    // patience.
    let usual = setup.patience * 4 + setup.window() * 4;
    // A branch lock is asked along the structure and answered back.
    let copies = modules as u64;
    let late = passage.late * (2 * copies * 8);
    let more_tries = passage.more_tries(2, copies);
    let lost = setup.resend * (more_tries * copies);
    Bounds { stall: usual + late + lost, more_tries }
}
