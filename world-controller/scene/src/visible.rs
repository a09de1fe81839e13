//! The vocabulary of pictures: states, roles, words, goals and the floor of a family. Families implement the trait `Visible`
//! of `metamorph_families` with it.

use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::Cell;
use metamorph_core::time::Span;
use serde::Serialize;

/// The state that a module reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct ModuleView {
    /// Its role, an index of [`Words::roles`].
    pub role: u8,
    /// Bits: 1 attached, 2 immobile, 4 pinned by a dead module, 8 knows a path, 16 asks the operator.
    pub flags: u8,
    /// The goal that it works for, or the number of the target that it fills: see [`Targets`].
    pub place: i32,
    /// The module that it waits for.
    pub waits_for: Option<ModuleId>,
}

/// Code of the role of a module that fills a target, an index of [`Words::roles`].
pub const FILLS: u8 = 2;

/// Why a connector has not closed that was out of the tolerances.
pub const MISALIGNED: &str = "its connector is too far from its target";

/// The outcome of an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActionOutcome {
    /// It succeeded.
    Done,
    /// It failed for this reason, which is empty if none is known; the body is where it was.
    Failed(&'static str),
    /// It was refused and has not begun.
    Refused,
    /// The action of another body, which carried this one, has succeeded.
    Carried,
}

/// The colour of a role; dead, paused and silent modules have the same colours in all families.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Colour {
    /// Without a task.
    Idle,
    /// On its way.
    Active,
    /// At its final place.
    Done,
}

/// A role of modules of a family.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Role {
    /// Its name in the summary of an agent.
    pub name: &'static str,
    /// The colour of modules in it.
    pub colour: Colour,
    /// Its name in the legend.
    pub legend: &'static str,
    /// The text about one module; `{}` stands for [`ModuleView::place`].
    pub about: &'static str,
}

/// The words of a family in views, and how its bodies are best drawn.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Words {
    /// A module, with a capital letter.
    pub module: &'static str,
    /// Several modules.
    pub modules: &'static str,
    /// The place that a module fills.
    pub target: &'static str,
    /// The elements of a goal.
    pub targets: &'static str,
    /// The unit of the distance to a target: one, and several.
    pub distance: [&'static str; 2],
    /// The counted actions of bodies.
    pub actions: &'static str,
    /// The first level of a goal, and the last one.
    pub levels: [&'static str; 2],
    /// The roles of modules; [`FILLS`] is the role of modules that fill a target.
    pub roles: [Role; 3],
    /// The colour role of a module that moves, unless it reports that role itself.
    pub moving_role: Option<u8>,
    /// Scale of drawn parts, below 1 so that neighbours can be distinguished.
    pub scale: f64,
    /// Scale while messages are shown, if bodies hide what is between them.
    pub scale_among_messages: Option<f64>,
}

/// The targets that modules fill.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Targets {
    /// Each cell of a goal, filled by the body in it. A module reports the goal for which it is finalized; a
    /// dead body that rests in a cell fills it too.
    Cells,
    /// Groups of this many cells. A module reports the number of the group that it fills.
    Groups(usize),
}

/// A rectangle of connectors, both corners included.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Floor {
    /// The corner with the smallest coordinates.
    pub min: [i16; 2],
    /// The corner with the largest.
    pub max: [i16; 2],
    /// The height that bodies on it reach, in cells.
    pub headroom: i16,
}

/// The setting of a run.
#[derive(Clone, Debug)]
pub struct Stage {
    /// The duration of a typical action.
    pub time_step: Span,
    /// The cells of each goal with their levels. Those of a group are adjacent in the list.
    pub goals: Vec<Vec<(i16, i16, i16, u16)>>,
    /// The targets that modules fill.
    pub targets: Targets,
    /// The floor; `None` if bodies stand on each other.
    pub floor: Option<Floor>,
    /// Contacts that do not follow from the places of bodies, and so are drawn as lines.
    pub contacts: Vec<(ModuleId, ModuleId)>,
}

/// The goal that is built, and where.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GoalView {
    /// Its number; [`GoalView::NONE`] if none is built.
    pub number: u16,
    /// How many quarters it is turned from x to y, about the cell (0, 0).
    pub quarters: u8,
    /// How far it is moved after that, along x and y.
    pub shift: (i16, i16),
}

impl GoalView {
    /// The number that no goal has.
    pub const NONE: u16 = u16::MAX;

    /// Returns where a cell of the goal is.
    pub fn place(&self, (x, y, z): (i16, i16, i16)) -> Cell {
        let (x, y) = (0..self.quarters).fold((x, y), |(x, y), _| (-y, x));
        Cell::new(x + self.shift.0, y + self.shift.1, z)
    }
}
