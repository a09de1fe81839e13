//! Carries out what the relaxed search found, with the bodies of all metamodules as obstacles.

use super::handover::PosturePair;
use super::scene::{Foothold, Hold, Transfer};
use super::task::Task;
use super::terrain::world_cell;
use super::walking::{Body, Motion, WalkingGround, Walks, degrees_of};
use metamorph_core::lattice::Cell;
use metamorph_roombots::posture::Posture;
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

/// Largest number of pairs of postures that are tried for a hand-over.
const MAX_PAIRS: usize = 40;
/// Largest number of sites that are tried for the retreat of a metamodule.
const MAX_SITES: usize = 6;
/// Largest number of retreats that are kept of a situation.
const MAX_KEPT: usize = 8;
/// Least distance in cells between the feet of a metamodule that went away and the other one.
const APART: u32 = 5;

/// Action of the body of a metamodule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BodyAction {
    /// It moves.
    Move(Motion),
    /// Its head grips the element.
    Grip {
        /// The grip.
        grip: u8,
    },
    /// Its head releases the element.
    LetGo,
}

/// An action of a metamodule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MoverAction {
    /// The metamodule, from 0.
    pub mover: usize,
    /// The action of its body.
    pub body_action: BodyAction,
}

/// Where everything is, and what led there.
#[derive(Clone)]
pub struct Situation<'a> {
    ground: &'a WalkingGround<'a>,
    /// All metamodules.
    pub bodies: Vec<Body>,
    /// The metamodule that holds the element, and its grip.
    holder: Option<(usize, u8)>,
    /// The cells of the element, sorted.
    element: Vec<Cell>,
    /// Cells that nothing may enter.
    fixed: &'a [Cell],
    /// The actions so far.
    pub actions: Vec<MoverAction>,
    /// The cache of walks from here; clones share it.
    known: Rc<RefCell<Known<'a>>>,
}

/// Cache of the walks from a situation.
#[derive(Default)]
struct Known<'a> {
    /// By metamodule.
    walks: BTreeMap<usize, Rc<Walks<'a>>>,
    /// The situations in which a metamodule has gone away from another, on the way to a foothold.
    away: BTreeMap<(usize, usize, Option<Foothold>), Vec<Situation<'a>>>,
}

impl<'a> Situation<'a> {
    /// Creates the situation at the start of a task.
    pub fn new(ground: &'a WalkingGround<'a>, task: &'a Task) -> Situation<'a> {
        Situation {
            ground,
            bodies: task.bodies.clone(),
            holder: task.held_by.map(|(holder, grip)| (usize::from(holder), grip)),
            element: task.start.clone(),
            fixed: &task.fixed,
            actions: Vec::new(),
            known: Rc::default(),
        }
    }

    /// Returns the situation after a metamodule has walked to the element and gripped it, by the first of `holds` to which
    /// there is a path.
    pub fn picked_up(&self, receiver: usize, holds: &[(Hold, u16)]) -> Option<Situation<'a>> {
        let others = (0..self.bodies.len()).filter(|i| *i != receiver);
        let before = std::iter::once(self.clone()).chain(others.flat_map(|i| self.away(i, receiver, None)));
        let try_all = |at: Situation<'a>| {
            holds.iter().take(MAX_PAIRS).find_map(|(hold, posture)| {
                let to = Body { foothold: hold.foothold, posture: *posture };
                Some(at.walked(receiver, to)?.gripped(receiver, hold.grip))
            })
        };
        before.into_iter().find_map(try_all)
    }

    /// Returns the situation after the holder has handed the element over to `receiver` at foothold `to`. In order:
    /// the holder carries the element to the place and the receiver comes; the receiver comes first and raises its
    /// head afterwards; the receiver first goes out of the way.
    pub fn handed_over(&self, receiver: usize, to: Foothold, way: &Transfer) -> Option<Situation<'a>> {
        let (holder, _) = self.holder?;
        let pairs = self.ground.scene().pairs(self.bodies[holder].foothold, to, way);
        let pairs = spread(&pairs);
        let taken_over = |at: &Situation<'a>, pair: &PosturePair| {
            at.carried(pair.holder)?
                .walked(receiver, Body { foothold: to, posture: pair.receiver })
                .map(|s| s.gripped(receiver, way.receiver.0))
        };
        let of = |at: Situation<'a>| pairs.iter().find_map(|pair| taken_over(&at, pair));
        let upright = self.upright(to);
        of(self.clone())
            .or_else(|| of(self.walked(receiver, upright)?))
            .or_else(|| self.away(receiver, holder, Some(to)).into_iter().find_map(of))
    }

    /// Returns the situation after the holder has carried the element to its goal, in the first of `holds` to which there is
    /// a path.
    pub fn placed(&self, holds: &[(Hold, u16)]) -> Option<Situation<'a>> {
        let (holder, _) = self.holder?;
        let others = (0..self.bodies.len()).filter(|i| *i != holder);
        let before = std::iter::once(self.clone()).chain(others.flat_map(|i| self.away(i, holder, None)));
        let mut before = before.chain(std::iter::once_with(|| self.all_away(holder)));
        before.find_map(|at| holds.iter().find_map(|(_, posture)| at.carried(*posture)))
    }

    /// Returns the situation after the holder has put the element down in the first of these postures to which there is a path.
    pub fn put_down(&self, postures: &[u16]) -> Option<Situation<'a>> {
        let (holder, _) = self.holder?;
        let others = (0..self.bodies.len()).filter(|i| *i != holder);
        let before = std::iter::once(self.clone()).chain(others.flat_map(|i| self.away(i, holder, None)));
        let before = before.chain(std::iter::once_with(|| self.all_away(holder)));
        let mut ends = before
            .into_iter()
            .flat_map(|at| postures.iter().filter_map(|posture| at.carried(*posture)).collect::<Vec<_>>());
        let mut after = ends.next()?;
        after.known = Rc::default();
        after.holder = None;
        after.actions.push(MoverAction { mover: holder, body_action: BodyAction::LetGo });
        Some(after)
    }

    /// Returns the situation after a metamodule has walked to the first of `bodies` to which there is a path. If there is none,
    /// one of the others goes out of the way before.
    pub fn arrived(&self, mover: usize, bodies: &[Body]) -> Option<Situation<'a>> {
        let others = (0..self.bodies.len()).filter(|i| *i != mover);
        let before = std::iter::once(self.clone()).chain(others.flat_map(|i| self.away(i, mover, None)));
        let arrives = |at: Situation<'a>| bodies.iter().take(MAX_PAIRS).find_map(|to| at.walked(mover, *to));
        before.into_iter().find_map(arrives)
    }

    fn upright(&self, foothold: Foothold) -> Body {
        let table = self.ground.scene().table();
        let posture = table.find(Posture::zero(table.kind()));
        Body { foothold, posture: posture.expect("invariant: the upright posture is above the floor") }
    }

    /// Returns the situations in which a metamodule has gone to a site away from `other`, those with the least detour to
    /// `next` first.
    fn away(&self, mover: usize, other: usize, next: Option<Foothold>) -> Vec<Situation<'a>> {
        let key = (mover, other, next);
        if let Some(known) = self.known.borrow().away.get(&key) {
            return known.clone();
        }
        let away = self.find_away(mover, other, next);
        let kept = &mut self.known.borrow_mut().away;
        if kept.len() < MAX_KEPT {
            kept.insert(key, away.clone());
        }
        away
    }

    fn find_away(&self, mover: usize, other: usize, next: Option<Foothold>) -> Vec<Situation<'a>> {
        let (scene, at) = (self.ground.scene(), self.bodies[mover]);
        let foot = |f: Foothold| world_cell(scene.pose(f), Cell::default());
        let middle = foot(self.bodies[other].foothold);
        let stand = (at.foothold, scene.empty(at.foothold)[usize::from(at.posture)]);
        let upright_set = |f: Foothold| scene.empty(f)[usize::from(self.upright(f).posture)];
        let distances = self.ground.distances(stand);
        let onwards = next.map(|f| self.ground.distances((f, upright_set(f))));
        let mut sites: Vec<(u16, Foothold)> = (0..scene.footholds().len() as Foothold)
            .filter(|f| foot(*f).manhattan(middle) >= APART)
            .filter_map(|f| {
                let site = (f, upright_set(f));
                let onwards = onwards.as_ref().map_or(Some(0), |d| d.get(&site).copied())?;
                Some((distances.get(&site)? + onwards, f))
            })
            .collect();
        sites.sort_unstable();
        let tried = sites.into_iter().take(MAX_SITES);
        tried.filter_map(|(_, f)| self.walked(mover, self.upright(f))).collect()
    }

    /// Returns the situation in which all others, as far as they can, have gone to a site away from `other`.
    fn all_away(&self, other: usize) -> Situation<'a> {
        let others = (0..self.bodies.len()).filter(|i| *i != other);
        others.fold(self.clone(), |at, i| at.away(i, other, None).into_iter().next().unwrap_or(at))
    }

    /// Returns the cells that a metamodule must not enter.
    fn obstacles(&self, mover: usize) -> BTreeSet<Cell> {
        let others = (0..self.bodies.len()).filter(|i| *i != mover);
        let scene = self.ground.scene();
        let mut cells: BTreeSet<Cell> =
            others.flat_map(|i| scene.body(self.bodies[i].foothold, self.bodies[i].posture)).collect();
        if self.holder.is_none_or(|(holder, _)| holder != mover) {
            cells.extend(&self.element);
        }
        cells.extend(self.fixed);
        cells
    }

    fn walks(&self, mover: usize) -> Rc<Walks<'a>> {
        let new = || Rc::new(Walks::new(self.ground, self.obstacles(mover), self.bodies[mover]));
        Rc::clone(self.known.borrow_mut().walks.entry(mover).or_insert_with(new))
    }

    /// Returns the same situation, to be changed: walks from there are others.
    fn before_change(&self) -> Situation<'a> {
        Situation { known: Rc::default(), ..self.clone() }
    }

    fn walked(&self, mover: usize, to: Body) -> Option<Situation<'a>> {
        let walks = self.walks(mover);
        if !walks.fits(to) {
            return None;
        }
        let motions = walks.find(to)?;
        let mut after = self.before_change();
        after.bodies[mover] = to;
        after.actions.extend(
            motions.into_iter().map(|motion| MoverAction { mover, body_action: BodyAction::Move(motion) }),
        );
        Some(after)
    }

    fn carried(&self, to: u16) -> Option<Situation<'a>> {
        let ((mover, grip), scene) = (self.holder?, self.ground.scene());
        let Body { foothold, posture } = self.bodies[mover];
        let (carry, pose) = (&scene.carry()[usize::from(grip)], scene.pose(foothold));
        let obstacles = self.obstacles(mover);
        let blocked = carry.set(|cell| {
            let cell = world_cell(pose, cell);
            scene.terrain().is_blocked(cell) || obstacles.contains(&cell)
        });
        let passes = |step: usize| {
            !carry.steps()[step].swept.meets(&blocked) && scene.is_within_limits(foothold, grip, step)
        };
        let path = carry.path(posture, to, passes)?;
        let mut after = self.before_change();
        after.bodies[mover].posture = to;
        after.element = scene.held(foothold, grip, to)?;
        after.actions.extend(path.into_iter().map(|(step, to)| {
            let degrees = degrees_of(usize::from(carry.steps()[step].joint));
            MoverAction { mover, body_action: BodyAction::Move(Motion::Turn { to, degrees }) }
        }));
        Some(after)
    }

    /// The metamodule grips the element, and the one that held it releases it.
    fn gripped(mut self, receiver: usize, grip: u8) -> Situation<'a> {
        self.known = Rc::default();
        self.actions.push(MoverAction { mover: receiver, body_action: BodyAction::Grip { grip } });
        if let Some((mover, _)) = self.holder.replace((receiver, grip)) {
            self.actions.push(MoverAction { mover, body_action: BodyAction::LetGo });
        }
        self
    }
}

/// Returns at most [`MAX_PAIRS`] pairs, evenly spread.
fn spread(pairs: &[PosturePair]) -> Vec<PosturePair> {
    let step = pairs.len().div_ceil(MAX_PAIRS).max(1);
    pairs.iter().step_by(step).copied().collect()
}
