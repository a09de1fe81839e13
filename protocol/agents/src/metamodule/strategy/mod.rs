//! Strategies: what a free metamodule does next. `force_field`, `greedy_policy` and `precedence` are the
//! published ones, which decide again each time; `negotiated` has a state of its own; `planned` does as the
//! world-controller orders.

pub(super) mod context;
pub mod force_field;
pub(super) mod greedy_policy;
pub(super) mod negotiated;
mod planned;
mod precedence;

use super::message::{Directive, Instruction, Path, Rank};
use super::params::Strategy;
use super::plan::Plan;
use super::view::{Advertised, View};
use context::{Context, Decision};
use metamorph_core::digest::Portable;
use metamorph_core::ids::Port;
use metamorph_core::time::Time;
use negotiated::Negotiated;
use planned::Planned;

/// A strategy with its state.
#[derive(Clone, Debug, Hash)]
pub(super) enum Policy {
    /// The published strategies, which differ in their parameters only.
    ForceField,
    Negotiated(Box<Negotiated>),
    Planned(Box<Planned>),
}

impl Policy {
    pub fn new(strategy: Strategy) -> Policy {
        match strategy {
            Strategy::Greedy | Strategy::Slope | Strategy::Step => Policy::ForceField,
            Strategy::Negotiated => Policy::Negotiated(Box::new(Negotiated::new())),
            Strategy::Planned => Policy::Planned(Box::new(Planned::new())),
        }
    }
    /// Feeds the state into a hash; see `digest`.
    pub fn digest(&self, hasher: &mut Portable<'_>) {
        match self {
            // One order for all strategies.
            Policy::ForceField => Negotiated::new().digest(hasher),
            Policy::Negotiated(n) => n.digest(hasher),
            Policy::Planned(p) => p.digest(hasher),
        }
    }
    pub fn negotiated(&self) -> Option<&Negotiated> {
        match self {
            Policy::ForceField => None,
            Policy::Negotiated(n) => Some(n),
            Policy::Planned(p) => Some(&p.negotiated),
        }
    }
    fn negotiated_mut(&mut self) -> Option<&mut Negotiated> {
        match self {
            Policy::ForceField => None,
            Policy::Negotiated(n) => Some(n),
            Policy::Planned(p) => Some(&mut p.negotiated),
        }
    }

    pub fn advertised(&self) -> Advertised {
        self.negotiated().map_or(Advertised::default(), Negotiated::advertised)
    }
    /// The rank of what the metamodule does.
    pub fn rank(&self) -> Rank {
        self.negotiated().map_or(Rank::NONE, Negotiated::rank)
    }
    /// The way that it has announced.
    pub fn announced(&self) -> Option<Path> {
        self.negotiated().and_then(Negotiated::announced)
    }
    /// Returns true if a motion was chosen because it blocks no other metamodule, but would do so by what is known now.
    pub fn objects_to(&self, v: View<'_>, plan: &Plan) -> bool {
        let holds = |n: &Negotiated| n.is_non_blocking(v, plan.ends);
        plan.non_blocking && !self.negotiated().is_none_or(holds)
    }

    /// Decides what to do next. `next_expiry` is when the next grant to a neighbour ends.
    pub fn look(&mut self, cx: &mut Context<'_>, next_expiry: Time) -> Decision {
        match self {
            Policy::ForceField => greedy_policy::look(cx.v, next_expiry),
            Policy::Negotiated(n) => n.look(cx, next_expiry),
            Policy::Planned(p) => p.look(cx, next_expiry),
        }
    }
    /// Returns the motion by which it grips an element or releases it now, settled or not.
    pub fn handling(&self, v: View<'_>) -> Option<Plan> {
        match self {
            Policy::ForceField | Policy::Negotiated(_) => None,
            Policy::Planned(p) => p.handling(v),
        }
    }
    /// Drops all intentions: the metamodule moves no more, for now or permanently.
    pub fn retire(&mut self, cx: &mut Context<'_>) {
        if let Some(n) = self.negotiated_mut() {
            n.retire(cx);
        }
    }
    /// Takes the operator's answer to a request: it is to continue by itself.
    pub fn on_answer(&mut self) {
        if let Some(n) = self.negotiated_mut() {
            n.on_answer();
        }
    }
    /// Starts over: there is another task.
    pub fn on_task(&mut self, cx: &mut Context<'_>) {
        match self {
            Policy::ForceField => {}
            Policy::Negotiated(n) => n.on_task(cx),
            Policy::Planned(p) => p.on_task(cx),
        }
    }
    /// A motion of the plan has ended well; `moved` if the metamodule stands on another connector now.
    pub fn on_motion(&mut self, moved: bool) {
        if let Some(n) = self.negotiated_mut() {
            n.on_motion(moved);
        }
    }
    /// Forgets what was heard on a port: the neighbour there has changed, died, or gone out of range.
    pub fn forget(&mut self, port: Port) {
        if let Some(n) = self.negotiated_mut() {
            n.forget(port);
        }
    }
    /// Resends the current announcement.
    pub fn repeat(&mut self, cx: &mut Context<'_>) {
        if let Some(n) = self.negotiated_mut() {
            n.repeat(cx);
        }
    }
    /// Notes the way of a neighbour. Returns whether that is news.
    pub fn hear_path(&mut self, v: View<'_>, port: Port, path: Path) -> bool {
        self.negotiated_mut().is_some_and(|n| n.hear_path(v, port, path))
    }
    /// Notes what a neighbour orders. Returns whether that is news.
    pub fn hear_directive(&mut self, v: View<'_>, port: Port, directive: Directive) -> bool {
        self.negotiated_mut().is_some_and(|n| n.hear_directive(v, port, directive))
    }
    /// Takes an instruction of the world-controller. Returns whether that is news.
    pub fn hear_order(&mut self, cx: &mut Context<'_>, number: u32, instruction: Instruction) -> bool {
        match self {
            Policy::ForceField | Policy::Negotiated(_) => false,
            Policy::Planned(p) => p.hear(cx, number, instruction),
        }
    }
}
