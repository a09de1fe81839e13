//! Actions of the modules of a configuration: attach, detach, and turn a joint by one step (report 2009, chapter 3).

use super::collision::{Collision, Model, Turning};
use super::configuration::{Configuration, Links, MAX_MODULES, Module, Pair, at_hemispheres};
use super::ground::{Ground, Turn};
use super::tables::{TABLES, Vec3, add, sub};
use metamorph_core::defects::PlanningDefect;
use serde::{Deserialize, Serialize};

/// An action. Modules and connectors are numbered as in the configuration that it is applied to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Action {
    /// Two connectors that face each other begin to hold.
    Attach(Pair),
    /// A connection ends.
    Detach(Pair),
    /// A joint turns by one step, 120° or 90°.
    Turn {
        /// The module.
        module: u8,
        /// The joint, from 0.
        joint: u8,
        /// True for the positive direction.
        positive: bool,
    },
}

/// Which connectors can make a connection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Connectors {
    /// All, as in the report.
    #[default]
    All,
    /// One of the two must be C0X or C3X, as on the hardware.
    Active,
}

impl Connectors {
    /// Returns true if two connectors can connect.
    pub fn allow(self, pair: Pair) -> bool {
        let active = |c: u8| matches!(c, 0 | 7);
        self == Connectors::All || active(pair.a.1) || active(pair.b.1)
    }
}

/// The rules of a configuration's actions.
#[derive(Clone, Debug)]
pub struct Rules {
    /// Which connectors can make a connection.
    pub connectors: Connectors,
    /// The collision rule of turns.
    pub collision: Collision,
    /// The restrictions by the ground; `None` in free assembly.
    pub ground: Option<Ground>,
    /// A defect that a test has injected.
    defect: Option<PlanningDefect>,
}

/// The configuration that is expanded, with what is the same for all its actions.
struct Around<'a> {
    configuration: &'a Configuration,
    rules: &'a Rules,
    cells: [[Vec3; 2]; MAX_MODULES],
    connections: Vec<Pair>,
    links: Links,
}

impl Rules {
    /// Creates the rules of a collision model.
    pub fn new(connectors: Connectors, model: Model) -> Rules {
        Rules { connectors, collision: Collision::new(model), ground: None, defect: None }
    }
    /// Returns the same rules on the ground.
    pub fn on(self, ground: Ground) -> Rules {
        Rules { ground: Some(ground), ..self }
    }
    /// Returns the same rules with a defect, for tests.
    #[doc(hidden)]
    pub fn with(self, defect: PlanningDefect) -> Rules {
        let mut rules = Rules { defect: Some(defect), ..self };
        rules.collision.ignores_own_half = defect == PlanningDefect::IgnoreOwnHalf;
        rules
    }
    /// Visits all successors of a configuration, in a fixed order: attachments and detachments by pair, then turns by
    /// module, joint and direction.
    pub fn expand(&self, configuration: &Configuration, mut visit: impl FnMut(Action, &Configuration)) {
        let mut facing = Vec::with_capacity(2 * configuration.len());
        configuration.facing(|pair| facing.push(pair));
        let held = |pair: &&Pair| configuration.is_held(**pair);
        let connections: Vec<Pair> = facing.iter().filter(held).copied().collect();
        let links = Links::of(configuration.len(), connections.iter().copied());
        let tree = connections.len() < configuration.len();
        let mut next = *configuration;
        for pair in &facing {
            if !configuration.is_held(*pair) {
                let free =
                    [pair.a, pair.b].iter().all(|(m, c)| !configuration.modules()[usize::from(*m)].holds(*c));
                if free && self.connectors.allow(*pair) {
                    next.set(*pair, true);
                    visit(Action::Attach(*pair), &next);
                    next.set(*pair, false);
                }
            } else if (!tree && is_redundant(configuration, &connections, *pair))
                || self.defect == Some(PlanningDefect::DetachBridges)
            {
                next.set(*pair, false);
                // A loop that opens leaves its load to single joints.
                if self.ground.is_none_or(|ground| ground.check(&next).is_ok()) {
                    visit(Action::Detach(*pair), &next);
                }
                next.set(*pair, true);
            }
        }
        let mut cells = [[[0; 3]; 2]; MAX_MODULES];
        for (i, m) in configuration.modules().iter().enumerate() {
            cells[i] = m.cells();
        }
        let around = Around { configuration, rules: self, cells, connections, links };
        for module in 0..configuration.len() as u8 {
            let at = at_hemispheres(&around.links, &around.connections, module);
            for joint in 0..3_u8 {
                let moving = moving_side(&at, joint);
                let in_loops = self.defect == Some(PlanningDefect::TurnInLoops);
                let Some(moving) = moving.or_else(|| in_loops.then(|| behind(&at, joint))) else { continue };
                for positive in [false, true] {
                    if let Some(next) = around.turned(module, joint, positive, moving) {
                        visit(Action::Turn { module, joint, positive }, &next);
                    }
                }
            }
        }
    }

    /// Returns the configuration after an action, `None` if it is not possible.
    pub fn apply(&self, configuration: &Configuration, action: Action) -> Option<Configuration> {
        let mut found = None;
        self.expand(configuration, |a, next| {
            if a == action {
                found = Some(*next);
            }
        });
        found
    }
}

fn is_redundant(configuration: &Configuration, connections: &[Pair], pair: Pair) -> bool {
    let rest = connections.iter().copied().filter(|p| *p != pair);
    Links::of(configuration.len(), rest).is_connected()
}

/// Returns the modules behind a joint, or `None` if a loop locks it.
fn moving_side(at: &[u16; 4], joint: u8) -> Option<u16> {
    let split = usize::from(joint) + 1;
    let front = at[..split].iter().fold(0, |all, m| all | m);
    let behind = behind(at, joint);
    (front & behind == 0).then_some(behind)
}

fn behind(at: &[u16; 4], joint: u8) -> u16 {
    at[usize::from(joint) + 1..].iter().fold(0, |all, m| all | m)
}

impl Around<'_> {
    /// Returns the configuration after a turn that moves the modules of `moving` and the module's own part behind the
    /// joint; `None` if something is in the way.
    fn turned(&self, module: u8, joint: u8, positive: bool, moving: u16) -> Option<Configuration> {
        let t = &**TABLES;
        let own = usize::from(module);
        let m = self.configuration.modules()[own];
        let (posture, way) = (usize::from(m.posture), usize::from(positive));
        let turn = t.times(
            t.times(m.rotation, t.turn[posture][usize::from(joint)][way]),
            t.inverse[usize::from(m.rotation)],
        );
        let pivot = self.cells[own][usize::from(joint == 2)];
        let mut next = *self.configuration;
        next.modules_mut()[own].posture = t.turned[posture][usize::from(joint)][way];
        let mut placed = self.cells;
        if joint == 0 {
            placed[own] = next.modules()[own].cells();
        }
        let mut rest = moving;
        while rest != 0 {
            let i = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            placed[i] = self.cells[i].map(|c| add(pivot, t.rotate(turn, sub(c, pivot))));
            let to: &mut Module = &mut next.modules_mut()[i];
            to.cell = placed[i][0];
            to.rotation = t.times(turn, to.rotation);
        }
        let len = self.configuration.len();
        let still = self.links.all() & !moving & !(1 << own);
        if overlaps(&placed[..len], own, joint, moving, still) {
            return None;
        }
        let swept = Turning {
            cells: &self.cells[..len],
            module: own,
            joint,
            positive,
            frame: t.times(m.rotation, t.hemisphere[posture][usize::from(joint)]),
            moving,
        };
        if !self.rules.collision.is_free(&swept) {
            return None;
        }
        let turn = Turn { module: own, joint, positive, behind: moving };
        let model = self.rules.collision.model();
        match &self.rules.ground {
            None => Some(next),
            Some(ground) => ground.after(self.configuration, &next, &turn, model),
        }
    }
}

/// Returns true if after a turn a cube that moved shares its cell with one that did not.
fn overlaps(placed: &[[Vec3; 2]], own: usize, joint: u8, moving: u16, still: u16) -> bool {
    let in_set = |set: u16, i: usize| set & 1 << i != 0;
    // The module's own cubes: behind the first joint only the second one moves from its cell.
    let own_moves = joint == 0;
    for (i, cells) in placed.iter().enumerate().filter(|(i, _)| in_set(moving, *i)) {
        debug_assert_ne!(i, own);
        for (j, others) in placed.iter().enumerate().filter(|(j, _)| in_set(still, *j)) {
            debug_assert_ne!(i, j);
            if cells.iter().any(|c| others.contains(c)) {
                return true;
            }
        }
        let fixed = if own_moves { &placed[own][..1] } else { &placed[own][..] };
        if cells.iter().any(|c| fixed.contains(c)) {
            return true;
        }
    }
    own_moves
        && placed.iter().enumerate().any(|(j, cells)| in_set(still, j) && cells.contains(&placed[own][1]))
}
