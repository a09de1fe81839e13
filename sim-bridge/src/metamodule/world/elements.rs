//! Passive elements in the world of metamodules: where they are, who holds them, and what is refused so that none falls.
//!
//! An element rests, or latches of metamodules hold it. The last latch does not open, a closed
//! chain of two holders does not turn, and no step exceeds the limits of torque. A latch needs no power: it stays closed
//! when the process of its metamodule is gone.

use super::drops::odd;
use super::{ActionInProgress, Body, MetamoduleWorld};
use crate::metamodule::invariants::{
    CLOSED_CHAIN, ELEMENT_COLOUR, ELEMENT_HELD, ELEMENT_SPACE, TORQUE, closed_chain, element_colour,
    element_held, element_space, torque,
};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::message::BodyAction;
use metamorph_protocol::metamodule::params::Setup;
use metamorph_protocol::metamodule::pose::{Load, Pose};
use metamorph_protocol::time::Time;
use std::hash::{Hash, Hasher};

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct ElementBody {
    /// Its cells, sorted.
    pub cells: Vec<Cell>,
    /// True if it rests there by itself.
    pub rests: bool,
    /// True from when it is dropped by a fault until it is gripped again.
    pub fallen: bool,
    /// The number of its cells of odd colour. Only a fall changes it.
    pub odd: usize,
}

impl ElementBody {
    /// Creates an element where it lies at the start.
    pub fn new(start: &[Cell]) -> ElementBody {
        ElementBody { cells: start.to_vec(), rests: true, fallen: false, odd: odd(start) }
    }
    /// Puts it into these cells, sorted.
    pub fn set(&mut self, cells: Vec<Cell>, setup: &Setup) {
        if self.cells != cells {
            self.rests = setup.rests(&cells);
            self.cells = cells;
        }
    }
}

/// Hashes the cells only; the other fields follow from them.
impl Hash for ElementBody {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.cells.hash(state);
        if self.fallen {
            self.fallen.hash(state);
        }
    }
}

impl MetamoduleWorld {
    /// Returns the cells of an element, sorted.
    pub fn element(&self, element: usize) -> &[Cell] {
        self.elements.get(element).map_or(&[], |e| &e.cells)
    }
    /// Returns the number of elements.
    pub fn elements(&self) -> usize {
        self.elements.len()
    }
    /// Returns the metamodules whose latch on an element is closed.
    pub fn holders(&self, element: usize) -> impl Iterator<Item = ModuleId> + '_ {
        let holds = move |body: &Body| self.setup.elements.of(body.pose.load) == Some(element);
        let all = (0..).map(ModuleId).zip(&self.bodies);
        all.filter(move |(_, body)| holds(body)).map(|(id, _)| id)
    }
    /// Returns the cells of all elements that rest.
    pub fn resting(&self) -> impl Iterator<Item = Cell> + '_ {
        let rest = (0..self.elements.len()).filter(|e| self.holders(*e).next().is_none());
        rest.flat_map(|e| self.element(e)).copied()
    }

    /// Returns the elements that a metamodule does not hold and that are in one of these cells.
    pub(super) fn element_in(&self, id: ModuleId, cells: &[Cell]) -> Option<Cell> {
        let own = self.setup.elements.of(self.bodies[id.index()].pose.load);
        let foreign = self.elements.iter().enumerate().filter(|(e, _)| Some(*e) != own);
        foreign.flat_map(|(_, element)| &element.cells).find(|c| cells.contains(c)).copied()
    }

    /// Returns true if another metamodule than `id` holds the element, and has not begun to let it go.
    fn has_other_holder(&self, id: ModuleId, element: usize) -> bool {
        let lets_go = |of: &Body| of.under_way.as_ref().is_some_and(|u| u.body_action == BodyAction::LetGo);
        self.holders(element).any(|other| other != id && !lets_go(&self.bodies[other.index()]))
    }
    /// Returns true if the element must not move: another metamodule than `id` holds it or is gripping it.
    fn is_fastened(&self, id: ModuleId, element: usize) -> bool {
        let grips = |of: &Body| match of.under_way {
            Some(ActionInProgress { body_action: BodyAction::Grip(load), .. }) => {
                self.setup.elements.of(load) == Some(element)
            }
            _ => false,
        };
        let gripping = (0..).map(ModuleId).zip(&self.bodies).any(|(other, body)| other != id && grips(body));
        gripping || self.holders(element).any(|other| other != id)
    }
    /// Returns true if another metamodule holds the element that `id` holds.
    pub(super) fn is_shared(&self, id: ModuleId) -> bool {
        let element = self.setup.elements.of(self.bodies[id.index()].pose.load);
        element.is_some_and(|element| self.holders(element).any(|other| other != id))
    }
    fn rests(&self, element: usize) -> bool {
        self.elements.get(element).is_some_and(|e| e.rests)
    }

    /// Judges a step with an element: where it leads and the cells that it needs.
    pub(super) fn judge_carry(&self, id: ModuleId, to: u16) -> Option<(Pose, Vec<Cell>)> {
        let pose = self.bodies[id.index()].pose;
        let element = self.setup.elements.of(pose.load)?;
        let step = self.setup.carried_step(pose, to)?;
        let allowed = step.peak.within(self.setup.elements.limits()) && !self.is_fastened(id, element);
        allowed.then_some((Pose { posture: to, ..pose }, step.cells))
    }

    /// Judges gripping: the element must be where the load would be, and no holder may be turning.
    pub(super) fn judge_grip(&self, id: ModuleId, load: Load) -> Option<(Pose, Vec<Cell>)> {
        let body = &self.bodies[id.index()];
        let loaded = Pose { load, ..body.pose };
        let (element, cells) = self.setup.held(loaded)?;
        let turns = |of: &Body| of.under_way.is_some();
        let still = !self.holders(element).any(|other| turns(&self.bodies[other.index()]));
        let is_empty = body.pose.load == Load::NONE && !body.pose.both;
        (is_empty && still && cells == self.element(element)).then(|| (loaded, body.cells.to_vec()))
    }

    /// Judges letting go: another metamodule must hold the element, or it must rest.
    pub(super) fn judge_let_go(&self, id: ModuleId) -> Option<(Pose, Vec<Cell>)> {
        let body = &self.bodies[id.index()];
        let element = self.setup.elements.of(body.pose.load)?;
        let is_safe = self.has_other_holder(id, element) || self.rests(element);
        is_safe.then(|| (Pose { load: Load::NONE, ..body.pose }, body.cells.to_vec()))
    }

    /// Counts what a refusal has prevented.
    pub(super) fn count_prevented(&mut self, id: ModuleId, body_action: BodyAction) {
        let pose = self.bodies[id.index()].pose;
        match body_action {
            BodyAction::LetGo if pose.load != Load::NONE => self.action_counts.drops_prevented += 1,
            BodyAction::Turn(number) => {
                let to = self.setup.motions.graph().step(pose.posture, number).map(|(to, _)| to);
                let step = to.and_then(|to| self.setup.carried_step(pose, to));
                let too_much = step.is_some_and(|s| !s.peak.within(self.setup.elements.limits()));
                self.action_counts.overloads_prevented += u64::from(too_much);
            }
            _ => {}
        }
    }

    /// Counts the elements that are held and not at a goal.
    pub(super) fn count_carried(&mut self) {
        let is_held = |e: &usize| self.holders(*e).next().is_some();
        let all = self.setup.elements.all().iter().enumerate();
        let away = all.filter(|(e, passive)| passive.goals.iter().all(|goal| goal != self.element(*e)));
        let under_way = away.filter(|(e, _)| is_held(e)).count() as u64;
        self.action_counts.under_way_at_most = self.action_counts.under_way_at_most.max(under_way);
    }

    /// Moves the element along with its holder.
    pub(super) fn carry_along(&mut self, id: ModuleId) {
        if let Some((element, cells)) = self.setup.held(self.bodies[id.index()].pose) {
            self.elements[element].set(cells, &self.setup);
            let was_fallen = std::mem::replace(&mut self.elements[element].fallen, false);
            self.action_counts.recovered += u64::from(was_fallen);
        }
    }

    /// Checks the elements: all invariants that have one as their subject.
    pub(super) fn check_elements(&mut self, now: Time) {
        for element in 0..self.elements.len() {
            self.check_element(now, element);
        }
    }

    fn check_element(&mut self, now: Time, element: usize) {
        let ElementBody { cells, rests: _, fallen, odd: expected } = &self.elements[element];
        let passive = &self.setup.elements.all()[element];
        let holders: Vec<&Body> = self.holders(element).map(|id| &self.bodies[id.index()]).collect();
        let in_place = |of: &&Body| {
            let anchored = of.grips[of.pose.end as usize];
            anchored && self.setup.held(of.pose).is_some_and(|(_, held)| held == *cells)
        };
        let rests = *fallen || (holders.is_empty() && self.setup.rests(cells));
        let held = element_held(&holders.iter().map(in_place).collect::<Vec<_>>(), rests);
        let turning =
            |of: &&&Body| of.under_way.as_ref().is_some_and(|u| matches!(u.body_action, BodyAction::Turn(_)));
        let chain = closed_chain(holders.len(), holders.iter().filter(turning).count());
        let kept = element_colour((passive.start.len(), *expected), (cells.len(), odd(cells)));
        let bodies = self.bodies.iter().flat_map(|b| b.cells);
        let others = self.elements.iter().enumerate().filter(|(e, _)| *e != element);
        let others = others.flat_map(|(_, e)| e.cells.iter().copied());
        let space = element_space(cells, bodies.chain(others).chain(self.obstacles.iter().copied()));
        let name = passive.name.clone();
        let found =
            [(ELEMENT_HELD, held), (CLOSED_CHAIN, chain), (ELEMENT_COLOUR, kept), (ELEMENT_SPACE, space)];
        for (invariant, result) in found {
            if let Err(what) = result {
                self.queue.violate(invariant, now, format!("{name}: {what}"));
            }
        }
    }

    /// Checks the torque of a step that has begun.
    pub(super) fn check_torque(&mut self, now: Time, id: ModuleId) {
        let body = &self.bodies[id.index()];
        let Some(under_way) = &body.under_way else { return };
        let step = self.setup.carried_step(body.pose, under_way.to.posture);
        let limits = self.setup.elements.limits();
        let is_step = matches!(under_way.body_action, BodyAction::Turn(_)) && body.pose.load != Load::NONE;
        if is_step && let Err(what) = torque(step.map(|s| s.peak), limits) {
            self.queue.violate(TORQUE, now, format!("module {id}: {what}"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{act_of, setup, upright};
    use super::*;
    use crate::connections::ActionEnd;
    use metamorph_kernel::world::invariants::Invariant;
    use metamorph_protocol::manipulation::load::LoadLimits;
    use metamorph_protocol::metamodule::elements::{Elements, PassiveElement};
    use metamorph_protocol::metamodule::message::{Percept, Refusal};
    use metamorph_protocol::metamodule::params::Setup;
    use std::sync::{Arc, LazyLock};

    const IMPOSSIBLE: Percept = Percept::Refused(Refusal::Impossible);

    /// A cube that a metamodule at (6, 6) can pick up; its goal is on the head of an upright one there.
    static CUBE: LazyLock<Arc<Setup>> = LazyLock::new(|| with_cube(250, LoadLimits::NOMINAL));

    fn with_cube(grams: u32, limits: LoadLimits) -> Arc<Setup> {
        let mut setup = (*setup()).clone();
        let head = upright(&setup, 6, 6);
        let goal = vec![Cell::new(6, 6, 4)];
        let made = |setup: &Setup, start: Vec<Cell>| {
            let (shape, name) = ("cube".parse().unwrap(), "cube".to_owned());
            let cube = PassiveElement { name, shape, grams, start, goals: vec![goal.clone()] };
            Elements::new(setup.motions.database(), setup.kind(), vec![cube], &[vec![head]], limits).unwrap()
        };
        setup.elements = made(&setup, goal.clone());
        let start = held(&setup, picking(&setup));
        setup.elements = made(&setup, start);
        Arc::new(setup)
    }

    fn load() -> Load {
        Load::of_grip(0).unwrap()
    }

    fn held(setup: &Setup, pose: Pose) -> Vec<Cell> {
        setup.held(Pose { load: load(), ..pose }).unwrap().1
    }

    /// Returns a pose at (6, 6) in which the cube is on the floor, and from which a step with the cube leads on.
    fn picking(setup: &Setup) -> Pose {
        let poses = (0..setup.motions.table().postures().len() as u16)
            .map(|posture| Pose { posture, ..upright(setup, 6, 6) });
        let picks = |pose: &Pose| {
            let cells = setup.held(Pose { load: load(), ..*pose }).map(|(_, cells)| cells);
            cells.is_some_and(|cells| cells[0].z == 0) && step(setup, *pose).is_some()
        };
        poses.into_iter().find(picks).unwrap()
    }

    /// Returns a step with the cube.
    fn step(setup: &Setup, pose: Pose) -> Option<BodyAction> {
        let loaded = Pose { load: load(), ..pose };
        let carry = setup.elements.carry(load())?;
        let to = (0..carry.postures() as u16).find(|to| setup.carried_step(loaded, *to).is_some())?;
        Some(BodyAction::Turn(setup.carried_step(loaded, to)?.number))
    }

    fn fired(world: &mut MetamoduleWorld) -> Vec<Invariant> {
        world.take_violations().into_iter().map(|v| v.invariant).collect()
    }

    /// A world in which metamodule 0 holds the cube where it lies.
    fn gripped(setup: &Arc<Setup>) -> MetamoduleWorld {
        let mut world = MetamoduleWorld::new(Arc::clone(setup), &[picking(setup), upright(setup, 1, 1)], 1);
        assert!(
            matches!(act_of(&mut world, 0, BodyAction::Grip(load())), Percept::Done(p) if p.load == load())
        );
        world
    }

    #[test]
    fn an_element_is_gripped_carried_and_put_down_again() {
        let mut world = gripped(&CUBE);
        assert_eq!(world.holders(0).collect::<Vec<_>>(), [ModuleId(0)]);
        let start = world.element(0).to_vec();
        // It rests, so it may be released; nothing else may be done with an end that holds it.
        assert_eq!(act_of(&mut world, 0, BodyAction::Attach), IMPOSSIBLE);
        assert_eq!(act_of(&mut world, 0, BodyAction::Grip(load())), IMPOSSIBLE);
        let carry = step(&CUBE, world.pose(ModuleId(0))).unwrap();
        assert!(matches!(act_of(&mut world, 0, carry), Percept::Done(_)));
        assert_ne!(world.element(0), start, "it moves along");
        assert_eq!(world.element(0), held(&CUBE, world.pose(ModuleId(0))));
        if world.element(0) != start {
            assert_eq!(act_of(&mut world, 0, BodyAction::LetGo), IMPOSSIBLE, "it would fall");
            assert_eq!(world.action_counts().drops_prevented, 1);
        }
        let back = step(&CUBE, world.pose(ModuleId(0))).unwrap();
        assert!(matches!(act_of(&mut world, 0, back), Percept::Done(_)) || world.action_counts().carries > 0);
        assert_eq!(fired(&mut world), []);
    }

    #[test]
    fn an_element_is_in_the_way_of_bodies_and_obstacles() {
        let setup = &*CUBE;
        let mut world = MetamoduleWorld::new(Arc::clone(setup), &[picking(setup)], 1);
        let cell = world.element(0)[0];
        assert!(!world.block(cell));
        assert!(world.element_in(ModuleId(0), &[cell]).is_some());
        assert_eq!(world.resting().collect::<Vec<_>>(), [cell]);
        act_of(&mut world, 0, BodyAction::Grip(load()));
        assert!(world.element_in(ModuleId(0), &[cell]).is_none() && world.resting().next().is_none());
    }

    #[test]
    fn two_holders_do_not_turn_and_one_of_them_lets_go() {
        let mut world = gripped(&CUBE);
        // The second one is said to hold the cube, too.
        let other = world.pose(ModuleId(0));
        world.bodies[1].pose = other;
        let carry = step(&CUBE, other).unwrap();
        assert_eq!(act_of(&mut world, 0, carry), IMPOSSIBLE);
        assert!(matches!(act_of(&mut world, 0, BodyAction::LetGo), Percept::Done(p) if p.load == Load::NONE));
        assert_eq!((world.action_counts().hand_overs, world.action_counts().let_go), (1, 1));
        fired(&mut world);
    }

    #[test]
    fn a_step_over_the_limits_of_torque_is_refused() {
        let weak = LoadLimits { outer: 1, middle: 1 };
        let mut world = gripped(&with_cube(250, weak));
        let carry = step(&CUBE, world.pose(ModuleId(0))).unwrap();
        assert_eq!(act_of(&mut world, 0, carry), IMPOSSIBLE);
        assert_eq!(world.action_counts().overloads_prevented, 1);
    }

    /// Each invariant fires when the world is spoilt behind the back of the interlock.
    #[test]
    fn invariants_of_elements_fire_in_the_world() {
        let spoilt = |spoil: fn(&mut MetamoduleWorld)| {
            let mut world = gripped(&CUBE);
            assert_eq!(fired(&mut world), []);
            spoil(&mut world);
            world.check_elements(Time::ZERO);
            fired(&mut world)
        };
        let falls = |world: &mut MetamoduleWorld| {
            world.elements[0].cells[0].z += 2;
            world.bodies[0].pose.load = Load::NONE;
        };
        assert_eq!(spoilt(falls), [ELEMENT_HELD]);
        assert_eq!(spoilt(|world| world.bodies[0].grips = [false; 2]), [ELEMENT_HELD]);
        let elsewhere = |world: &mut MetamoduleWorld| world.elements[0].cells[0] = Cell::new(1, 1, 1);
        assert!(spoilt(elsewhere).contains(&ELEMENT_SPACE));
        let odd = |world: &mut MetamoduleWorld| world.elements[0].cells[0].z += 1;
        assert!(spoilt(odd).contains(&ELEMENT_COLOUR));
        let turns = |world: &mut MetamoduleWorld| {
            let pose = world.bodies[0].pose;
            world.bodies[1].pose = pose;
            let body_action = BodyAction::Turn(0);
            world.bodies[0].under_way =
                Some(ActionInProgress { to: pose, claimed: Vec::new(), body_action, end: ActionEnd::Done });
        };
        assert!(spoilt(turns).contains(&CLOSED_CHAIN));
        let mut world = gripped(&CUBE);
        let pose = world.bodies[0].pose;
        let to = Pose { posture: pose.posture, ..pose };
        let body_action = BodyAction::Turn(0);
        world.bodies[0].under_way =
            Some(ActionInProgress { to, claimed: Vec::new(), body_action, end: ActionEnd::Done });
        world.check_torque(Time::ZERO, ModuleId(0));
        assert_eq!(fired(&mut world), [TORQUE]);
    }
}
