//! The interface between a family and the pictures of its runs: families implement [`Visible`].

use crate::scene_builder::SceneBuilder;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::record::Blob;
use metamorph_protocol::time::Span;
use metamorph_report::message_timeline::MessageLabel;
use metamorph_scene::bodies::ShownSwarm;
use metamorph_scene::parts::{Motion, Part};
use metamorph_scene::shared::Shared;
use metamorph_scene::visible::{ActionOutcome, GoalView, ModuleView, Stage, Words};
use metamorph_sim_bridge::kernel::recording::Log;
use std::sync::{Arc, Mutex};

/// Agents that can be shown.
pub trait Visible: Agent {
    /// The words of the family.
    const WORDS: Words;

    /// Returns the setting of a run.
    fn stage(setup: &Self::Setup) -> Stage;
    /// Returns the parts of a body at rest. Their number and order never change.
    fn at_rest(setup: &Self::Setup, place: &Self::Place) -> Vec<Part>;
    /// Returns the motion of an action and the place after it; `None` if it cannot begin at `place`.
    fn motion(
        setup: &Self::Setup,
        place: &Self::Place,
        action: &Self::Action,
    ) -> Option<(Motion, Self::Place)>;
    /// Returns the motion of a body that another one begins to carry, and its place afterwards, if that is what a percept
    /// says. By default bodies do not carry each other.
    fn carried(
        _setup: &Self::Setup,
        _place: &Self::Place,
        _percept: &Self::Percept,
    ) -> Option<(Motion, Self::Place)> {
        None
    }
    /// Returns the cell of a body; of one with several cells, the one at the connector that holds it.
    fn cell(place: &Self::Place) -> Cell;
    /// Describes the place of a body.
    fn whereabouts(place: &Self::Place) -> String;
    /// Returns the outcome that a percept reports.
    fn fate(percept: &Self::Percept) -> ActionOutcome;
    /// Returns the state that a report contains.
    fn standing(report: &Self::Report) -> ModuleView;
    /// Returns the label of a message.
    fn said(setup: &Self::Setup, message: &Self::Message) -> MessageLabel;
    /// Returns the distance to a target in moves, from the gradient of an agent's summary; [`FAR`] if it
    /// knows of none.
    ///
    /// [`FAR`]: metamorph_report::message_timeline::FAR
    fn moves(gradient: Option<u32>) -> u16;
    /// Returns the goal that an order opens; `None` for other orders.
    fn goal(order: &Self::Order) -> Option<GoalView>;

    /// Returns how long a module that asks the operator waits for an answer; `None` if none asks.
    fn answer_within(_: &Self::Setup) -> Option<Span> {
        None
    }
    /// Returns the cells of all passive elements at the start.
    fn elements(_: &Self::Setup) -> Vec<Vec<Cell>> {
        Vec::new()
    }
    /// Returns the passive element that a body holds, by its number, and the cells where it is.
    fn held(_: &Self::Setup, _: &Self::Place) -> Option<(usize, Vec<Cell>)> {
        None
    }

    /// Returns the parts of a body: at rest, or after a share of the time of an action.
    fn parts(setup: &Self::Setup, place: &Self::Place, action: Option<(&Self::Action, f64)>) -> Vec<Part> {
        let mut parts = Self::at_rest(setup, place);
        if let Some((action, fraction)) = action
            && let Some((motion, _)) = Self::motion(setup, place, action)
        {
            motion.carry(&mut parts, fraction);
        }
        parts
    }
}

/// The bodies of a swarm at the start of its run.
pub struct Bodies<A: Visible> {
    /// The setup that all agents share.
    pub setup: Arc<A::Setup>,
    /// The place of each body.
    pub places: Vec<A::Place>,
    /// Contacts that do not follow from the places, for [`Stage::contacts`].
    pub contacts: Vec<(ModuleId, ModuleId)>,
}

impl<A: Visible<Place: 'static> + 'static> ShownSwarm for Bodies<A> {
    fn words(&self) -> &'static Words {
        &A::WORDS
    }
    fn stage(&self) -> Stage {
        Stage { contacts: self.contacts.clone(), ..A::stage(&self.setup) }
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
