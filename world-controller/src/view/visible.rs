//! How each family looks: poses and deeds of bodies, what modules report of themselves, what their
//! messages say. Families implement [`Visible`].

use crate::report::message_timeline::Said;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::Span;
use serde::Serialize;

/// Where a body is, as numbers that the page knows how to draw: of a cube its cell; of a metamodule
/// the connector, its quarter turns, the end that holds, whether both do, and the steps of its joints
/// seen from the end that holds.
pub type Stance = Vec<i16>;

/// Something a body does: how long, and what. Of a cube the kind of motion, the side of the support
/// and the heading; of a metamodule what it does, and the stance that follows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Doing {
    /// How long it takes.
    pub takes: Span,
    /// What it is.
    pub what: Vec<i16>,
}

/// What a module tells of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Standing {
    /// Its part: 0 in reserve or free, 1 wandering, 2 finalized or settled.
    pub role: u8,
    /// Bits: 1 attached, 2 immobile, 4 pinned by a dead one, 8 knows a way.
    pub flags: u8,
    /// The goal that it works for; the seed that it fills, if it is a settled metamodule.
    pub place: i32,
    /// Whom it waits for.
    pub waits_for: Option<ModuleId>,
}

/// How an action went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// As it should.
    Done,
    /// It was tried, and the body is where it was.
    Failed,
    /// It was not begun.
    Refused,
}

/// Agents that can be shown.
pub trait Visible: Agent {
    /// Where a body is.
    fn stance(setup: &Self::Setup, place: &Self::Place) -> Stance;
    /// What a body would do from there; none if it cannot.
    fn doing(setup: &Self::Setup, place: &Self::Place, action: &Self::Action) -> Option<Doing>;
    /// How an action went.
    fn fate(percept: &Self::Percept) -> Fate;
    /// What a report tells.
    fn standing(report: &Self::Report) -> Standing;
    /// What a message tells.
    fn said(message: &Self::Message) -> Said;
    /// How far it is to a target, in moves, from what an agent's summary tells; [`FAR`] if it knows of
    /// none.
    fn moves(gradient: Option<u32>) -> u16;
    /// Which goal an order opens, and how far that is moved.
    fn goal(order: &Self::Order) -> Option<(u16, (i16, i16))>;
}
