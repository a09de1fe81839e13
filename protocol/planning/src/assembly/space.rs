//! Configurations of free modules as a space to search.

use super::action::{Action, Rules};
use super::canonical::Detail;
use super::configuration::{Configuration, MAX_MODULES};
use super::kept_edges::KeptEdges;
use super::shape::{Bar, Shape};
use super::shape_distance::ShapeDistance;
use super::shape_graph::{Change, Prices};
use super::tables::Vec3;
use crate::plan::table;
use crate::plan::{Cost, Space};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Quantity that a plan minimizes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Objective {
    /// Actions: attachments, detachments and steps of joints (report 5.2.4).
    #[default]
    Actions,
    /// Attachments and detachments (thesis 3.2.2).
    Connections,
    /// Steps of joints.
    Turns,
    /// Attachments: everything between two of them is one move (thesis 5.1.4).
    Moves,
}

impl Objective {
    /// Returns the costs of actions.
    pub const fn prices(self) -> Prices {
        let (attach, detach, turn) = match self {
            Objective::Actions => (1, 1, 1),
            Objective::Connections => (1, 1, 0),
            Objective::Turns => (0, 0, 1),
            Objective::Moves => (1, 0, 0),
        };
        Prices { attach, detach, turn }
    }
}

impl Action {
    /// Returns what the action does to a shape.
    pub const fn change(&self) -> Change {
        match self {
            Action::Attach(_) => Change::Attach,
            Action::Detach(_) => Change::Detach,
            Action::Turn { .. } => Change::Turn,
        }
    }
}

/// Where a plan should end.
#[derive(Clone, Debug)]
pub enum Goal {
    /// In any configuration of a shape.
    Shape(Shape),
    /// In one configuration.
    Configuration(Configuration),
    /// Nowhere: the space is counted.
    None,
}

/// Returns the usual number of shapes whose distance to the goal is computed: for up to four modules all.
pub const fn usual_shapes(modules: usize) -> usize {
    if modules <= 4 { 20_000 } else { 30_000 }
}

/// The space of configurations of free modules, towards a goal.
#[derive(Clone, Debug)]
pub struct Assembly {
    modules: usize,
    rules: Rules,
    prices: Prices,
    detail: Detail,
    /// The key of the goal; true if it is the key of a shape, false if it is that of a configuration.
    goal: Option<(bool, Vec<u8>)>,
    distance: Option<Arc<ShapeDistance>>,
    kept: Option<KeptEdges>,
    /// The sorted distances between the cells of the goal (see [`spectrum`]).
    spectrum: Vec<u16>,
}

/// Returns the distances between all pairs of cells of a shape, sorted. They are equal for shapes that fill the same
/// cells, and similar for shapes that fill nearly the same.
fn spectrum(shape: &Shape) -> Vec<u16> {
    let cells: Vec<Vec3> = shape.bars().iter().flat_map(Bar::cells).collect();
    let apart = |a: &Vec3, b: &Vec3| (0..3).map(|i| u16::from(a[i].abs_diff(b[i]))).sum::<u16>();
    let pairs = cells.iter().enumerate().flat_map(|(i, a)| cells[..i].iter().map(move |b| apart(a, b)));
    let mut distances: Vec<u16> = pairs.collect();
    distances.sort_unstable();
    distances
}

impl Assembly {
    /// Creates the space. Shapes farther from the goal than the nearest `shapes` have a constant bound.
    pub fn new(modules: usize, rules: Rules, objective: Objective, goal: &Goal, shapes: usize) -> Assembly {
        let prices = objective.prices();
        let (key, shape) = match goal {
            Goal::None => (None, None),
            Goal::Shape(shape) => (Some((true, shape.canonical())), Some(*shape)),
            Goal::Configuration(configuration) => {
                let mut key = vec![0; Detail::Joints.key_width(configuration.len())];
                Detail::Joints.key(configuration, &mut key);
                (Some((false, key)), Some(Shape::of(configuration)))
            }
        };
        let by_shape = key.as_ref().is_some_and(|(by_shape, _)| *by_shape);
        let alike = rules.connectors == super::action::Connectors::All;
        let detail = match rules.ground {
            Some(_) => Detail::Place,
            None if by_shape && alike => Detail::Frames,
            None => Detail::Joints,
        };
        let distance = shape.map(|shape| Arc::new(ShapeDistance::to(&shape, prices, shapes)));
        let kept = shape.map(|shape| KeptEdges::to(&shape, prices));
        let spectrum = shape.map_or(Vec::new(), |shape| spectrum(&shape));
        Assembly { modules, rules, prices, detail, goal: key, distance, kept, spectrum }
    }
    /// Returns the same space with states told apart in all detail.
    pub fn in_full(self) -> Assembly {
        let detail = if self.rules.ground.is_some() { Detail::Place } else { Detail::Joints };
        Assembly { detail, ..self }
    }
    /// Returns the same space without the kept-edges bound.
    pub fn by_shape_only(self) -> Assembly {
        Assembly { kept: None, ..self }
    }
    /// Returns what states are told apart by.
    pub fn detail(&self) -> Detail {
        self.detail
    }
    /// Returns the number of modules.
    pub fn modules(&self) -> usize {
        self.modules
    }
    /// Returns the rules.
    pub fn rules(&self) -> &Rules {
        &self.rules
    }
    /// Returns the distances of shapes, if there is a goal.
    pub fn distance(&self) -> Option<&ShapeDistance> {
        self.distance.as_deref()
    }
}

impl Space for Assembly {
    type State = Configuration;
    type Action = Action;
    fn key_width(&self) -> usize {
        self.detail.key_width(self.modules)
    }
    fn key(&self, configuration: &Configuration, key: &mut [u8]) {
        self.detail.key(configuration, key);
    }
    fn state(&self, key: &[u8]) -> Configuration {
        self.detail.configuration(key)
    }
    fn expand(&self, configuration: &Configuration, visit: &mut impl FnMut(Action, Cost, &Configuration)) {
        self.rules.expand(configuration, |action, next| {
            visit(action, self.prices.of(action.change()), next);
        });
    }
    fn lower(&self, configuration: &Configuration) -> Option<Cost> {
        let Some(distance) = &self.distance else { return Some(0) };
        let by_shape = distance.of(&Shape::of(configuration))?;
        let by_edges = self.kept.as_ref().map_or(0, |kept| kept.of(configuration));
        Some(by_shape.max(by_edges))
    }
    fn is_goal(&self, configuration: &Configuration) -> bool {
        let mut key = [0; 2 + 6 * MAX_MODULES];
        match &self.goal {
            None => false,
            Some((true, goal)) => {
                let key = &mut key[..goal.len()];
                Shape::of(configuration).key(key);
                key == goal
            }
            Some((false, goal)) => {
                let key = &mut key[..goal.len()];
                Detail::Joints.key(configuration, key);
                key == goal
            }
        }
    }
    fn guide(&self, configuration: &Configuration) -> u32 {
        let gaps = spectrum(&Shape::of(configuration)).into_iter().zip(&self.spectrum);
        gaps.map(|(own, goal)| u32::from(own.abs_diff(*goal))).sum()
    }
    fn class(&self, configuration: &Configuration) -> u64 {
        let mut key = [0; Shape::key_width(MAX_MODULES)];
        let key = &mut key[..Shape::key_width(self.modules)];
        Shape::of(configuration).key(key);
        table::hash(key)
    }
    fn bytes(&self) -> usize {
        self.distance.as_ref().map_or(0, |d| d.bytes())
    }
}
