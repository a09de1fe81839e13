//! The bodies of a swarm of any family, for views and exports.

use super::parts::Part;
use super::shared::Shared;
use super::visible::{Stage, Words};
use metamorph_core::record::Blob;
use metamorph_core::time::Span;
use metamorph_kernel::kernel::recording::Log;

/// A swarm to be shown, of any family.
pub trait ShownSwarm {
    /// Returns the words of the family.
    fn words(&self) -> &'static Words;
    /// Returns the scene of the run.
    fn stage(&self) -> Stage;
    /// Returns how long a module that asks the operator waits for an answer; `None` if none asks.
    fn answer_within(&self) -> Option<Span>;
    /// Returns the parts of each body at the start, and a description of its place.
    fn start(&self) -> Vec<(Vec<Part>, String)>;
    /// Returns the parts of a body at rest at a recorded place; `None` if the record cannot be decoded.
    fn parts(&self, place: &Blob) -> Option<Vec<Part>>;
    /// Returns a log that builds a scene from the records of the run.
    fn scribe(self: Box<Self>, scene: Shared) -> Log;
}
