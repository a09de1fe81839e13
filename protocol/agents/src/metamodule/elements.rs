//! The passive elements of a swarm: where each lies and goes, and the tables by which metamodules carry it.
//!
//! The tables travel with the setup, so that agents need no floats and all readers have the same ones. A grip is
//! named by its place in [`Elements`]; poses carry it as a [`Load`].

use super::motions::Sweep;
use super::pose::{Load, Pose, to_world};
use super::setup::Setup;
use metamorph_core::lattice::{Cell, Face};
use metamorph_planning::manipulation::carry::{CarryTable, held_by};
use metamorph_planning::manipulation::contact::ElementSweeper;
use metamorph_planning::manipulation::element::{Element, Grip};
use metamorph_planning::manipulation::load::{LoadLimits, LoadTable, Peak};
use metamorph_planning::manipulation::rest::rests;
use metamorph_roombots::Kind;
use metamorph_roombots::database::Database;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::panic::UnwindSafe;
use std::sync::{Arc, LazyLock};
use thiserror::Error;

/// Largest number of elements of a swarm.
pub const MAX_ELEMENTS: usize = 64;
/// Largest number of grips of an element that no metamodule in a seed holds at a goal.
const MAX_LYING_GRIPS: usize = 8;

/// Why elements cannot be carried.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ElementsError {
    /// More grips than a pose can name.
    #[error("the elements have {0} grips that are needed, at most {max} are possible; leave elements out", max = Load::MAX_GRIPS)]
    TooManyGrips(usize),
}

/// An element of a swarm.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PassiveElement {
    /// Its name in the scenario.
    pub name: String,
    /// Its shape.
    pub shape: Element,
    /// Its mass in grams.
    pub grams: u32,
    /// The cells where it lies at the start, sorted.
    pub start: Vec<Cell>,
    /// By goal of the swarm, the cells where it is in the end, sorted. The last ones are those of all later goals.
    pub goals: Vec<Vec<Cell>>,
}

impl PassiveElement {
    /// Returns the cells where it is in the end of a goal of the swarm, sorted.
    pub fn goal(&self, goal: u8) -> &[Cell] {
        self.goals.get(usize::from(goal)).or(self.goals.last()).map_or(&[], Vec::as_slice)
    }
}

/// A grip of an element that metamodules may use.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct ElementGrip {
    element: usize,
    /// The number of its table. Elements of the same shape and mass have the same ones.
    table: usize,
}

/// Motions and torques that are possible with a grip.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct GripTable {
    carry: CarryTable,
    /// The largest torques of each step.
    peaks: Vec<Peak>,
}

/// Makes the tables of grips: of each the shape of the element, its mass in grams, and the grip.
fn make(database: &Database, kind: Kind, grips: &[(Element, u32, Grip)]) -> Vec<GripTable> {
    let (mut sweeper, table) = (ElementSweeper::new(), database.table(kind));
    let mut make = |(_, grams, grip): &(Element, u32, Grip)| {
        let carry = CarryTable::new(database, kind, grip, &mut sweeper);
        let loads = LoadTable::new(table, &carry, Face::Down);
        let peaks = (0..carry.steps().len()).map(|step| loads.peak(step, *grams)).collect();
        GripTable { carry, peaks }
    };
    grips.iter().map(&mut make).collect()
}

type Making = Box<dyn FnOnce() -> Vec<GripTable> + Send + UnwindSafe>;

/// The tables of grips; `None` if there are none. Making them takes up to a second, and a reader of scenarios needs none, so they
/// are made when the first is needed. Clones share them.
#[derive(Clone, Debug)]
struct Tables(Option<Arc<LazyLock<Vec<GripTable>, Making>>>);

impl Tables {
    fn new(make: Making) -> Tables {
        Tables(Some(Arc::new(LazyLock::new(make))))
    }

    fn all(&self) -> &[GripTable] {
        self.0.as_ref().map_or(&[], |made| made.as_slice())
    }
}

impl PartialEq for Tables {
    fn eq(&self, other: &Tables) -> bool {
        let are_shared = self.0.as_ref().zip(other.0.as_ref()).is_some_and(|(a, b)| Arc::ptr_eq(a, b));
        are_shared || self.all() == other.all()
    }
}

impl Eq for Tables {}

impl Serialize for Tables {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.all().serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Tables {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Tables, D::Error> {
        let read = Vec::deserialize(deserializer)?;
        Ok(Tables::new(Box::new(move || read)))
    }
}

/// The elements of a swarm and their grips.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Elements {
    all: Vec<PassiveElement>,
    grips: Vec<ElementGrip>,
    tables: Tables,
    /// By element and goal of the swarm, whether it is not held there.
    lying: Vec<Vec<bool>>,
    limits: LoadLimits,
}

impl Elements {
    /// No elements.
    pub const NONE: Elements = Elements {
        all: vec![],
        grips: vec![],
        tables: Tables(None),
        lying: vec![],
        limits: LoadLimits::NOMINAL,
    };

    /// Describes the tables of all elements. Of each, the grips are those that a metamodule in one of the `heads` of a goal
    /// has when the element is where that goal has it, since tables of large elements have hundreds of kilobytes each. An
    /// element that is not held at any goal has its first eight grips.
    pub fn new(
        database: &Arc<Database>,
        kind: Kind,
        all: Vec<PassiveElement>,
        heads: &[Vec<Pose>],
        limits: LoadLimits,
    ) -> Result<Elements, ElementsError> {
        let (mut grips, mut lying, table) = (Vec::new(), Vec::new(), database.table(kind));
        let mut known: Vec<(Element, u32, Grip)> = Vec::new();
        for (element, passive) in all.iter().enumerate() {
            let every = passive.shape.grips();
            let is_held = |grip: &Grip, goal: u8| {
                heads.get(usize::from(goal)).into_iter().flatten().any(|head| {
                    let placement = table.postures()[usize::from(head.posture)].posture.placement();
                    held_by(&placement, grip)
                        .is_some_and(|cells| in_world(*head, &cells) == passive.goal(goal))
                })
            };
            let goals = 0..heads.len() as u8;
            lying.push(goals.clone().map(|goal| !every.iter().any(|grip| is_held(grip, goal))).collect());
            let mut used: Vec<&Grip> =
                every.iter().filter(|grip| goals.clone().any(|goal| is_held(grip, goal))).collect();
            if used.is_empty() {
                used = every.iter().take(MAX_LYING_GRIPS).collect();
            }
            for grip in used {
                let same = |(shape, grams, other): &(Element, u32, Grip)| {
                    (shape, *grams, other) == (&passive.shape, passive.grams, grip)
                };
                let number = known.iter().position(same).unwrap_or(known.len());
                if number == known.len() {
                    known.push((passive.shape.clone(), passive.grams, grip.clone()));
                }
                grips.push(ElementGrip { element, table: number });
            }
        }
        let database = Arc::clone(database);
        let tables = Tables::new(Box::new(move || make(&database, kind, &known)));
        match grips.len() {
            n if n > Load::MAX_GRIPS => Err(ElementsError::TooManyGrips(n)),
            _ => Ok(Elements { all, grips, tables, lying, limits }),
        }
    }

    /// Returns true if no metamodule in a seed of a goal holds the element there: it lies there in the end.
    pub fn lies(&self, element: usize, goal: u8) -> bool {
        let of_goals = self.lying.get(element).map_or(&[][..], Vec::as_slice);
        of_goals.get(usize::from(goal)).or(of_goals.last()).copied().unwrap_or(false)
    }

    /// Returns true if there are none.
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }
    /// Returns the elements.
    pub fn all(&self) -> &[PassiveElement] {
        &self.all
    }
    /// Returns the limits of torque.
    pub fn limits(&self) -> LoadLimits {
        self.limits
    }
    /// Returns the number of the element that a load is; `None` without a load, or if there is no such grip.
    pub fn of(&self, load: Load) -> Option<usize> {
        Some(self.grips.get(load.grip()?)?.element)
    }
    /// Returns the loads that are this element.
    pub fn loads_of(&self, element: usize) -> Vec<Load> {
        let of = |(i, grip): (usize, &ElementGrip)| (grip.element == element).then(|| Load::of_grip(i))?;
        self.grips.iter().enumerate().filter_map(of).collect()
    }
    /// Returns the carry table of a load.
    pub fn carry(&self, load: Load) -> Option<&CarryTable> {
        Some(&self.table(load)?.carry)
    }
    /// Returns the largest torques during a step with a load.
    pub fn peak(&self, load: Load, step: usize) -> Option<Peak> {
        self.table(load)?.peaks.get(step).copied()
    }
    fn table(&self, load: Load) -> Option<&GripTable> {
        self.tables.all().get(self.grips.get(load.grip()?)?.table)
    }
}

/// Returns the cells, given in the foot frame of a pose, in the world, sorted.
fn in_world(pose: Pose, cells: &[Cell]) -> Vec<Cell> {
    let mut cells: Vec<Cell> = cells.iter().map(|cell| to_world(pose.state, *cell)).collect();
    cells.sort_unstable();
    cells
}

/// A step of a joint with an element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CarriedStep {
    /// The number of the step in the motion database.
    pub number: u16,
    /// The cells that metamodule and element sweep.
    pub cells: Vec<Cell>,
    /// The largest torques.
    pub peak: Peak,
}

impl Setup {
    /// Returns true if an element in these cells rests on the floor, so that it may be released.
    pub fn rests(&self, cells: &[Cell]) -> bool {
        rests(cells, |c| self.floor.has(c.x, c.y))
    }

    /// Returns the element that a pose holds, and its cells, sorted.
    pub fn held(&self, pose: Pose) -> Option<(usize, Vec<Cell>)> {
        let element = self.elements.of(pose.load)?;
        let cells = self.elements.carry(pose.load)?.held(pose.posture)?;
        Some((element, in_world(pose, cells)))
    }

    /// Returns the cells of a metamodule and of the element that it holds.
    pub fn occupied(&self, pose: Pose) -> impl Iterator<Item = Cell> + use<> {
        let held = self.held(pose).map(|(_, cells)| cells).unwrap_or_default();
        self.motions.cells(pose).into_iter().chain(held)
    }

    /// Returns the step to a posture with the element that a pose holds; `None` if there is no such step.
    pub fn carried_step(&self, pose: Pose, to: u16) -> Option<CarriedStep> {
        let carry = self.elements.carry(pose.load)?;
        let step = carry.step_between(pose.posture, to)?;
        let number = self.motions.graph().number_of_step(pose.posture, to)?;
        let cells = carry.resolve(&carry.steps()[step].swept).map(|c| to_world(pose.state, c)).collect();
        Some(CarriedStep { number, cells, peak: self.elements.peak(pose.load, step)? })
    }

    /// Returns the cells of the lock of a motion that begins in `pose` and ends in posture `ends`. A motion with an
    /// element is one step, whose cells are in the carry table, as they do not fit a frame.
    pub fn lock_cells(&self, pose: Pose, sweep: Sweep, ends: u16) -> impl Iterator<Item = Cell> + '_ {
        let carried = self.carried_step(pose, ends).map(|step| step.cells).unwrap_or_default();
        self.motions.swept(pose.state, sweep).chain(carried)
    }

    /// Returns the loads by which a metamodule in `pose` can grip the element `element`, which is in `cells`.
    pub fn loads_at(&self, pose: Pose, element: usize, cells: &[Cell]) -> Option<Load> {
        let mut loads = self.elements.loads_of(element).into_iter();
        loads.find(|load| self.held(Pose { load: *load, ..pose }).is_some_and(|(_, held)| held == cells))
    }
}

/// Returns true if these cells are those of an element in the end of a goal.
pub fn is_at_goal(setup: &Setup, goal: u8, element: usize, cells: &[Cell]) -> bool {
    setup.elements.all().get(element).is_some_and(|passive| passive.goal(goal) == cells)
}
