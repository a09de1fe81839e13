//! Changes of colour: where a metamodule can put a cube down in a cell of the other colour, and whole plans with one change.

use super::arm::{Arm, Cube};
use super::connect::{Path, connect, is_free_between};
use crate::manipulation::colour::colour;
use crate::manipulation::load::LoadLimits;
use crate::manipulation::scene::{Foothold, NO_SET, Scene};
use crate::manipulation::terrain::world_cell;
use crate::manipulation::transport::{Answer, ManipulationPlan, Task, plan};
use crate::manipulation::verification::BodyAction;
use crate::manipulation::walking::{Body, Motion, WalkingGround};
use metamorph_core::lattice::Cell;
use metamorph_roombots::Kind;
use metamorph_roombots::database::Table;
use metamorph_roombots::lattice_pose::LatticeRotation;
use std::collections::BTreeSet;

/// The largest distance from the foot, along x or y, of a cell in which a cube can be.
const REACH: i16 = 4;
/// Largest number of places of a change that are tried for one task.
const MAX_PLACES: usize = 24;

/// Grips of a cube in the cells of one height and one colour, seen from the foot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GripCounts {
    /// Poses of the cube within reach: cells times rotations of the head.
    pub candidates: usize,
    /// Of these, those that joint angles reach.
    pub solvable: usize,
    /// Of these, those with angles at which nothing is touched.
    pub free: usize,
    /// The cells of those.
    pub cells: usize,
}

/// A motion that puts a cube down in a cell of the other colour.
#[derive(Clone, Debug, PartialEq)]
pub struct ColourChange {
    /// The cell, seen from the foot.
    pub cell: Cell,
    /// The posture in which the metamodule holds the cube before.
    pub from: u16,
    /// The angles from there until the cube lies in the cell.
    pub lowering: Path,
    /// The angles from there on, with the head empty.
    pub leaving: Path,
    /// The posture at their end.
    pub to: u16,
}

/// Returns the cells at a height, of the colour of the foot or of the other one, that may be within reach.
fn cells(height: i16, is_other: bool) -> impl Iterator<Item = Cell> {
    let side = -REACH..=REACH;
    let all = side.clone().flat_map(move |x| side.clone().map(move |y| Cell::new(x, y, height)));
    all.filter(move |c| (colour(*c) == 1) == is_other)
}

/// Counts the grips of a cube of so many grams.
pub fn grips(kind: Kind, height: i16, is_other: bool, grams: u32) -> GripCounts {
    let arm = Arm::new(kind, Cube::Held, grams, LoadLimits::NOMINAL);
    let mut counts = GripCounts::default();
    for cell in cells(height, is_other).filter(|c| (c.x, c.y, c.z) != (0, 0, 0)) {
        let mut is_free = false;
        for rotation in LatticeRotation::all() {
            let angles = arm.holding(cell, rotation);
            counts.candidates += 1;
            counts.solvable += usize::from(!angles.is_empty());
            let free = angles.iter().any(|q| arm.is_free(q));
            counts.free += usize::from(free);
            is_free |= free;
        }
        counts.cells += usize::from(is_free);
    }
    counts
}

/// Finds changes on an open floor: for each cell of the other colour the first one, and none if no motion was found.
pub fn changes(scene: &Scene, grams: u32, seed: u64) -> Vec<ColourChange> {
    let (table, carry) = (scene.table(), &scene.carry()[0]);
    let kind = table.kind();
    let radians = |p: &u16| table.postures()[usize::from(*p)].posture.radians();
    let (holding, empty) = (carry.main_set(), main_set(table));
    let held = Arm::new(kind, Cube::Held, grams, LoadLimits::NOMINAL);
    let within: Vec<u16> = holding.into_iter().filter(|p| held.is_free(&radians(p))).collect();
    let roots: Vec<Vec<f64>> = within.iter().map(radians).collect();
    let mut found = Vec::new();
    for cell in cells(0, true) {
        let beside = Arm::new(kind, Cube::At(cell), grams, LoadLimits::NOMINAL);
        let away: Vec<u16> = empty.iter().copied().filter(|p| beside.is_free(&radians(p))).collect();
        let ends: Vec<Vec<f64>> = away.iter().map(radians).collect();
        let change = || {
            for rotation in LatticeRotation::all() {
                for q in held.holding(cell, rotation).into_iter().filter(|q| held.is_free(q)) {
                    let Some(lowering) = connect(&held, &roots, &q, seed) else { continue };
                    let Some(mut leaving) = connect(&beside, &ends, &q, seed) else { continue };
                    leaving.reverse();
                    let posture = |of: &[u16], q: &[f64]| of.iter().copied().find(|p| radians(p) == q);
                    let (from, to) = (posture(&within, lowering.first()?), posture(&away, leaving.last()?));
                    if let (Some(from), Some(to)) = (from, to) {
                        return Some(ColourChange { cell, from, lowering, leaving, to });
                    }
                }
            }
            None
        };
        found.extend(change());
    }
    found
}

/// Returns the empty postures that steps connect with the upright one.
fn main_set(table: &Table) -> Vec<u16> {
    let upright = table.find(metamorph_roombots::posture::Posture::zero(table.kind()));
    let upright = upright.expect("invariant: the upright posture is above the floor");
    let reach = table.reach(upright, &metamorph_roombots::database::CellSet::default());
    reach.postures().map(|(posture, _)| posture).collect()
}

/// A plan that brings a cube into a cell of the other colour.
#[derive(Clone, Debug, PartialEq)]
pub struct ColourPlan {
    /// On the lattice, until the cube is held where the change begins.
    pub before: ManipulationPlan,
    /// The metamodule that makes the change, and where it stands.
    pub by: (usize, Foothold),
    /// The number of the change.
    pub change: usize,
    /// On the lattice, from where the cube lies then.
    pub after: ManipulationPlan,
}

/// Plans a task whose goal has the other colour, with one of these changes; `None` if no plan was found. The places
/// nearest to the start of the cube are tried first.
pub fn plan_with_change(
    ground: &WalkingGround<'_>,
    task: &Task,
    changes: &[ColourChange],
) -> Option<ColourPlan> {
    let scene = ground.scene();
    let (start, goal) = (*task.start.first()?, *task.goal.first()?);
    let mut places = Vec::new();
    for foothold in (0..scene.footholds().len() as Foothold).filter(|f| ground.exists(*f)) {
        for (number, change) in changes.iter().enumerate() {
            let cell = world_cell(scene.pose(foothold), change.cell);
            if scene.holding(foothold, 0)[usize::from(change.from)] != NO_SET && is_on_floor(scene, cell) {
                let far = cell.manhattan(start) + cell.manhattan(goal);
                places.push((far, cell.manhattan(start), foothold, number));
            }
        }
    }
    places.sort_unstable();
    let spread = places.len().div_ceil(MAX_PLACES).max(1);
    let near = places.iter().take(MAX_PLACES).chain(places.iter().step_by(spread));
    near.into_iter()
        .find_map(|(.., foothold, number)| with_change(ground, task, *foothold, (*number, &changes[*number])))
}

fn is_on_floor(scene: &Scene, cell: Cell) -> bool {
    let there = [2 * cell.x, 2 * cell.y, 0];
    scene.terrain().connectors().iter().any(|c| c.half == there)
}

fn with_change(
    ground: &WalkingGround<'_>,
    task: &Task,
    foothold: Foothold,
    (number, change): (usize, &ColourChange),
) -> Option<ColourPlan> {
    let scene = ground.scene();
    let cell = world_cell(scene.pose(foothold), change.cell);
    let held = scene.held(foothold, 0, change.from)?;
    let ends = Some(vec![scene.body(foothold, change.from)]);
    let bring = Task { goal: held, ends, puts_down: true, ..task.clone() };
    let Answer::Plan(mut before) = plan(ground, &bring) else { return None };
    let mut bodies = moved(task.bodies.clone(), &before);
    let mover = before
        .actions
        .iter()
        .rev()
        .find_map(|a| matches!(a.body_action, BodyAction::Grip { .. }).then_some(a.mover))?;
    // The same cells may be filled by several postures, which turns of the head distinguish.
    let carry = &scene.carry()[0];
    let others = (0..bodies.len()).filter(|i| *i != mover);
    let others: BTreeSet<Cell> = others
        .flat_map(|i| scene.body(bodies[i].foothold, bodies[i].posture))
        .chain(task.fixed.clone())
        .collect();
    let blocked = carry.set(|c| others.contains(&world_cell(scene.pose(foothold), c)));
    let passes =
        |step: usize| !carry.steps()[step].swept.meets(&blocked) && scene.is_within_limits(foothold, 0, step);
    for (step, to) in carry.path(bodies[mover].posture, change.from, passes)? {
        let degrees = crate::manipulation::walking::degrees_of(usize::from(carry.steps()[step].joint));
        let body_action = BodyAction::Move(Motion::Turn { to, degrees });
        before.actions.push(crate::manipulation::verification::MoverAction { mover, body_action });
    }
    let inverse = scene.pose(foothold).inverse();
    let near: Vec<Cell> = others.iter().map(|c| world_cell(inverse, *c)).collect();
    let kind = scene.table().kind();
    let is_clear = |cube: Cube, path: &Path| {
        let arm = Arm::new(kind, cube, 0, LoadLimits::NOMINAL).among(near.clone());
        path.windows(2).all(|pair| is_free_between(&arm, &pair[0], &pair[1]))
    };
    if !is_clear(Cube::Held, &change.lowering) || !is_clear(Cube::At(change.cell), &change.leaving) {
        return None;
    }
    bodies[mover] = Body { foothold, posture: change.to };
    let rest = Task { bodies, start: vec![cell], held_by: None, puts_down: true, ..task.clone() };
    match plan(ground, &rest) {
        Answer::Plan(after) => Some(ColourPlan { before, by: (mover, foothold), change: number, after }),
        _ => None,
    }
}

/// Returns where the metamodules stand after a plan.
fn moved(mut bodies: Vec<Body>, plan: &ManipulationPlan) -> Vec<Body> {
    for action in &plan.actions {
        match action.body_action {
            BodyAction::Move(Motion::Turn { to, .. }) => bodies[action.mover].posture = to,
            BodyAction::Move(Motion::Land(body)) => bodies[action.mover] = body,
            BodyAction::Grip { .. } | BodyAction::LetGo => {}
        }
    }
    bodies
}
