//! The choice of gaits while a structure walks.

use metamorph_protocol::free_module::gait::message::Parameters;
use metamorph_protocol::free_module::structure::Joint;
use metamorph_protocol::ids::ModuleId;
use std::collections::{BTreeMap, BTreeSet};

/// A gait: the parameters of every oscillator. Joints without parameters are locked at 0.
pub type Gait = BTreeMap<Joint, Parameters>;

/// Chooses the gaits that a structure tries. A state machine without clock: the same calls give the same gaits.
pub trait Tuner: Send + Sync {
    /// Begins again with these modules dead, after walking with a gait. Returns the first gait to try; `None` if no
    /// joint can move.
    fn begin(&mut self, dead: &BTreeSet<ModuleId>, before: &Gait) -> Option<Gait>;
    /// Returns the speed in mm/s that the gait returned last had when it was learnt, if it was learnt for this failure.
    fn expected(&self) -> Option<f64>;
    /// Takes the speed of the gait returned last, and returns the next one; `None` once enough were tried.
    fn tell(&mut self, speed_mm_s: f64) -> Option<Gait>;
}
