//! What a family of modules has to say so that its runs can be shown. Families implement
//! [`Visible`].

use super::parts::{Motion, Part};
use crate::report::message_timeline::MessageLabel;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::Span;
use serde::Serialize;

/// What a module tells of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct ModuleView {
    /// Its part, a number of [`Words::roles`].
    pub role: u8,
    /// Bits: 1 attached, 2 immobile, 4 pinned by a dead one, 8 knows a way.
    pub flags: u8,
    /// The goal that it works for, or the number of the target that it fills: see [`Targets`].
    pub place: i32,
    /// Whom it waits for.
    pub waits_for: Option<ModuleId>,
}

/// The role of a module that fills a target.
pub const FILLS: u8 = 2;

/// How an action went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActionOutcome {
    /// As it should.
    Done,
    /// It was tried, and the body is where it was.
    Failed,
    /// It was not begun.
    Refused,
}

/// The colour of a role; those of dead, paused and silent modules are the same in all families.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Colour {
    /// Has nothing to do.
    Idle,
    /// On its way.
    Active,
    /// Where it stays.
    Done,
}

/// A part that modules of a family can have.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Role {
    /// As in the summary of an agent.
    pub name: &'static str,
    /// How modules with it are painted.
    pub colour: Colour,
    /// What the legend calls it.
    pub legend: &'static str,
    /// What is said of one module; `{}` stands for [`ModuleView::place`].
    pub about: &'static str,
}

/// What things of a family are called where they are shown, and how its bodies are best seen.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Words {
    /// A module, with a capital letter.
    pub module: &'static str,
    /// Several modules.
    pub modules: &'static str,
    /// The place that a module fills.
    pub target: &'static str,
    /// What a goal is made of.
    pub targets: &'static str,
    /// What the way to a target is counted in: one, and several.
    pub distance: [&'static str; 2],
    /// What bodies do, as it is counted.
    pub actions: &'static str,
    /// The first level of a goal, and the last one.
    pub levels: [&'static str; 2],
    /// The parts that modules can have; that of number [`FILLS`] is had by modules that fill a target.
    pub roles: [Role; 3],
    /// The role that a module which moves is painted in, if it does not tell of that role itself.
    pub moving_role: Option<u8>,
    /// Parts are drawn this much smaller, so that neighbours are told apart.
    pub scale: f64,
    /// The same while messages are shown, if bodies hide what is between them.
    pub scale_among_messages: Option<f64>,
}

/// What modules fill.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Targets {
    /// Each cell of a goal, by the module whose body is in it. A module says for which goal it is final; a dead
    /// body that rests there fills a cell, too.
    Cells,
    /// Groups of so many cells. A module says the number of the one that it fills.
    Groups(usize),
}

/// A rectangle of connectors, both corners included.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Floor {
    /// The corner with the smallest coordinates.
    pub min: [i16; 2],
    /// The corner with the largest.
    pub max: [i16; 2],
    /// How far up bodies on it reach, in cells.
    pub headroom: i16,
}

/// Where a run takes place.
#[derive(Clone, Debug)]
pub struct Stage {
    /// How long a typical action takes.
    pub time_step: Span,
    /// The cells of each goal with their levels. Those of a group stand together.
    pub goals: Vec<Vec<(i16, i16, i16, u16)>>,
    /// What modules fill.
    pub targets: Targets,
    /// What bodies stand on, if not on each other.
    pub floor: Option<Floor>,
}

/// Agents that can be shown.
pub trait Visible: Agent {
    /// The words of the family.
    const WORDS: Words;

    /// Where a run takes place.
    fn stage(setup: &Self::Setup) -> Stage;
    /// The parts of a body at rest. A body has the same parts in the same order all the time.
    fn at_rest(setup: &Self::Setup, place: &Self::Place) -> Vec<Part>;
    /// How an action moves the parts, and where the body is then; `None` if it cannot begin there.
    fn motion(
        setup: &Self::Setup,
        place: &Self::Place,
        action: &Self::Action,
    ) -> Option<(Motion, Self::Place)>;
    /// Says where a body is.
    fn whereabouts(place: &Self::Place) -> String;
    /// How an action went.
    fn fate(percept: &Self::Percept) -> ActionOutcome;
    /// What a report tells.
    fn standing(report: &Self::Report) -> ModuleView;
    /// What a message tells.
    fn said(message: &Self::Message) -> MessageLabel;
    /// How far it is to a target, in moves, from what an agent's summary tells; [`FAR`] if it knows of
    /// none.
    ///
    /// [`FAR`]: crate::report::message_timeline::FAR
    fn moves(gradient: Option<u32>) -> u16;
    /// Which goal an order opens, and how far that is moved.
    fn goal(order: &Self::Order) -> Option<(u16, (i16, i16))>;

    /// The parts of a body: at rest, or after a share of the time of an action.
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
