//! The bodies of a swarm of any family, for views and exports.

use super::parts::Part;
use super::scene_builder::{SceneBuilder, Shared};
use super::visible::{Stage, Visible, Words};
use metamorph_protocol::record::Blob;
use metamorph_protocol::time::Span;
use metamorph_sim_bridge::kernel::recording::Log;
use std::sync::{Arc, Mutex};

/// The bodies of a swarm at the start of its run.
pub struct Bodies<A: Visible> {
    /// The setup that all agents share.
    pub setup: Arc<A::Setup>,
    /// The place of each body.
    pub places: Vec<A::Place>,
}

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

impl<A: Visible<Place: 'static> + 'static> ShownSwarm for Bodies<A> {
    fn words(&self) -> &'static Words {
        &A::WORDS
    }
    fn stage(&self) -> Stage {
        A::stage(&self.setup)
    }
    fn answer_within(&self) -> Option<Span> {
        A::answer_within(&self.setup)
    }
    fn start(&self) -> Vec<(Vec<Part>, String)> {
        self.places.iter().map(|place| (A::at_rest(&self.setup, place), A::whereabouts(place))).collect()
    }
    fn parts(&self, place: &Blob) -> Option<Vec<Part>> {
        let parts = A::at_rest(&self.setup, &place.read().ok()?);
        (!parts.is_empty()).then_some(parts)
    }
    fn scribe(self: Box<Self>, scene: Shared) -> Log {
        Log::new(Arc::new(Mutex::new(SceneBuilder { bodies: *self, scene })))
    }
}
