//! Plans what is done next with all elements of a swarm: a transport for each that is not at its goal, and which steps of
//! them can be made at the same time.
//!
//! Transports are planned one after the other, each from where those before it leave everything. A step comes after the
//! one before it in its transport, after the earlier one of its metamodule, and after those whose cells meet its own. So
//! transports that are far from each other are under way at the same time.

use super::transport::{Scenes, Transport, TransportAction, TransportAnswer, TransportStep, plan_transport};
use metamorph_agents::metamodule::elements::is_at_goal;
use metamorph_agents::metamodule::plan::{Aim, Plan};
use metamorph_agents::metamodule::planning::cooperative::Standstill;
use metamorph_agents::metamodule::planning::paths::Ground;
use metamorph_agents::metamodule::pose::{Load, Pose};
use metamorph_core::lattice::Cell;
use metamorph_planning::manipulation::load::Peak;
use metamorph_planning::manipulation::transport::{Refutations, TransportReason};
use std::collections::{BTreeMap, BTreeSet};

/// Largest number of free metamodules of a swarm that is considered as a whole for each transport.
const WHOLE_SWARM_MAX: usize = 6;
/// The most metamodules that are examined at a time in larger swarms: the holders, then the nearest.
const MAX_BODIES: usize = 4;
/// The edges that are taken out in a search that does not examine the whole swarm. One that is not examined may be in
/// the way wherever the others stand. In a swarm of 200 with 50 cubes on 100 x 60 connectors 36 plans take none, and
/// 13 at most 18.
const OF_PART: Refutations = Refutations { exact: 10, most: 40 };

/// An element as it is now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ElementNow {
    /// Its cells, sorted.
    pub cells: Vec<Cell>,
    /// Its holders, by their numbers in [`Standstill::free`].
    pub holders: Vec<usize>,
    /// True if another metamodule holds it as well: one that is dead, or cannot move.
    pub is_pinned: bool,
}

/// A step of the transports.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OrderedStep {
    /// The step.
    pub step: TransportStep,
    /// The element that is brought.
    pub element: usize,
    /// The steps that must be done before, by number.
    pub after: Vec<usize>,
    /// True if the metamodule fills a seed then.
    pub fills: bool,
}

/// The transports of a swarm.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Transports {
    /// The steps.
    pub steps: Vec<OrderedStep>,
    /// The number of transports.
    pub count: usize,
    /// Landings and grips.
    pub connections: u32,
    /// The largest torques while elements are carried.
    pub peak: Peak,
    /// The elements without a transport, and why if there is none.
    pub failed: Vec<(usize, Option<TransportReason>)>,
    /// The number of searches.
    pub searches: usize,
}

/// Plans transports for all elements that are not at their goals, in this order. Elements that are missing in `order` stay
/// where they are.
pub fn plan_transports(
    at: &Standstill,
    elements: &[ElementNow],
    order: &[usize],
    scenes: &Scenes,
) -> Transports {
    let mut course = Schedule {
        at: at.clone(),
        elements: elements.to_vec(),
        seated: vec![false; at.free.len()],
        found: Transports::default(),
        touched: BTreeMap::new(),
        last_of: vec![None; at.free.len()],
    };
    let is_left = |e: &&usize| {
        elements.get(**e).is_some_and(|element| {
            let is_held = !element.holders.is_empty() || element.is_pinned;
            // One that lies at its goal in the end is released there.
            let is_to_be_let_go = is_held && at.setup.elements.lies(**e, at.task.goal);
            is_to_be_let_go || !is_at_goal(&at.setup, at.task.goal, **e, &element.cells)
        })
    };
    for element in order.iter().filter(is_left) {
        course.bring(*element, scenes);
    }
    course.found
}

/// How far the plan is.
struct Schedule {
    /// The standstill, with poses as they will be.
    at: Standstill,
    elements: Vec<ElementNow>,
    /// The metamodules that fill a seed by now.
    seated: Vec<bool>,
    found: Transports,
    /// By cell, the steps that need it.
    touched: BTreeMap<Cell, Vec<usize>>,
    /// By metamodule, its last step.
    last_of: Vec<Option<usize>>,
}

impl Schedule {
    fn bring(&mut self, element: usize, scenes: &Scenes) {
        if self.elements[element].is_pinned {
            return self.found.failed.push((element, None));
        }
        let holders = self.elements[element].holders.clone();
        // Of several holders one keeps the element, and the others release it.
        let candidates: Vec<Option<usize>> = match holders.as_slice() {
            [] => vec![None],
            holders => holders.iter().copied().map(Some).collect(),
        };
        let mut reason = None;
        for holder in candidates {
            let let_go: Vec<usize> = holders.iter().copied().filter(|h| Some(*h) != holder).collect();
            let (groups, refutations) = self.groups_for(element, holder);
            for bodies in groups {
                let mut standstill = self.standstill(element, &bodies);
                for body in let_go.iter().filter_map(|h| bodies.iter().position(|b| b == h)) {
                    standstill.free[body].load = Load::NONE;
                }
                let cells = &self.elements[element].cells;
                let lies = self.at.setup.elements.lies(element, self.at.task.goal);
                let goal = self.goal_of(element);
                let transport = Transport { element, cells, goal, lies, refutations };
                let answer = plan_transport(&standstill, &transport, scenes);
                self.found.searches += 1;
                match answer {
                    TransportAnswer::Plan(plan) => {
                        let mut steps: Vec<TransportStep> = let_go.iter().map(|h| self.let_go(*h)).collect();
                        let of_all = |step: TransportStep| TransportStep { body: bodies[step.body], ..step };
                        steps.extend(plan.steps.into_iter().map(of_all));
                        self.found.count += 1;
                        self.found.connections += plan.connections;
                        self.found.peak = self.found.peak.max(plan.peak);
                        return self.follow(element, steps, !lies);
                    }
                    TransportAnswer::Infeasible(why) => reason = Some(why),
                    TransportAnswer::Undecided => {}
                }
            }
        }
        self.found.failed.push((element, reason.filter(|_| self.elements[element].holders.len() <= 1)));
    }

    fn goal_of(&self, element: usize) -> &[Cell] {
        self.at.setup.elements.all()[element].goal(self.at.task.goal)
    }

    fn let_go(&self, body: usize) -> TransportStep {
        let from = self.at.free[body];
        let to = Pose { load: Load::NONE, ..from };
        TransportStep { body, from, to, action: TransportAction::Handle(Load::NONE) }
    }

    /// Returns the groups of metamodules that a transport may use, to be tried in this order, and the edges that may be taken
    /// out in each search. A group has the one that keeps the element, its other holders, and some that hold nothing: all of
    /// a small swarm; of a larger one those nearest to the element, or those nearest to its goal, where one that is not looked
    /// at is in the way most likely.
    fn groups_for(&self, element: usize, holder: Option<usize>) -> (Vec<Vec<usize>>, Refutations) {
        let of = &self.elements[element];
        let near = |pose: &Pose, cells: &[Cell]| {
            let (x, y) = pose.foot();
            cells.iter().map(|c| c.x.abs_diff(x) + c.y.abs_diff(y)).min().unwrap_or(0)
        };
        let free: Vec<usize> = (0..self.at.free.len())
            .filter(|i| !self.seated[*i])
            .filter(|i| self.at.free[*i].load == Load::NONE || of.holders.contains(i))
            .collect();
        if free.len() <= WHOLE_SWARM_MAX {
            return (vec![free], Refutations::DEFAULT);
        }
        let nearest = |first: &[Cell], second: &[Cell]| {
            let mut group = free.clone();
            group.sort_by_key(|i| {
                let pose = &self.at.free[*i];
                let is_holder = Some(*i) == holder || of.holders.contains(i);
                (!is_holder, near(pose, first) + near(pose, second) / 2, *i)
            });
            group.truncate(MAX_BODIES.max(of.holders.len()));
            group.sort_unstable();
            group
        };
        let goal = self.goal_of(element);
        let mut groups = vec![nearest(&of.cells, goal), nearest(goal, &of.cells)];
        groups.dedup();
        (groups, OF_PART)
    }

    /// Returns the input of the planner for one element: these metamodules are free, everything else stays.
    fn standstill(&self, element: usize, bodies: &[usize]) -> Standstill {
        let mut fixed = self.at.fixed.clone();
        let others = self.at.free.iter().enumerate().filter(|(i, _)| !bodies.contains(i));
        fixed.extend(others.flat_map(|(_, pose)| self.at.setup.motions.cells(*pose)));
        let others = self.elements.iter().enumerate().filter(|(e, _)| *e != element);
        fixed.extend(others.flat_map(|(_, e)| &e.cells));
        let free = bodies.iter().map(|i| self.at.free[*i]).collect();
        Standstill { free, fixed, ..self.at.clone() }
    }

    /// Adds the steps of a transport. With `fills` the last one ends in a seed.
    fn follow(&mut self, element: usize, steps: Vec<TransportStep>, fills: bool) {
        let last = steps.len().saturating_sub(1);
        let first = self.found.steps.len();
        for (i, step) in steps.into_iter().enumerate() {
            let number = first + i;
            let needed = self.cells_of(element, &step);
            let mut after: BTreeSet<usize> =
                needed.iter().flat_map(|c| self.touched.get(c)).flatten().copied().collect();
            after.extend(self.last_of[step.body]);
            after.extend(number.checked_sub(1).filter(|_| i > 0));
            for cell in needed {
                self.touched.entry(cell).or_default().push(number);
            }
            self.last_of[step.body] = Some(number);
            self.make(element, &step);
            let fills = fills && i == last;
            self.seated[step.body] |= fills;
            if let Some(seed) = self.seed_of(step.to).filter(|_| fills) {
                self.at.filled = self.at.filled.with(seed);
            }
            let after = after.into_iter().collect();
            self.found.steps.push(OrderedStep { step, element, after, fills });
        }
    }

    fn seed_of(&self, pose: Pose) -> Option<u8> {
        let cells = self.at.setup.motions.cells(pose);
        Some(self.at.setup.seeds(self.at.task).find(|(_, seed)| seed.cells() == cells)?.0)
    }

    /// Notes that a step has been made.
    fn make(&mut self, element: usize, step: &TransportStep) {
        self.at.free[step.body] = step.to;
        let of = &mut self.elements[element];
        if let TransportAction::Handle(load) = step.action {
            of.holders.retain(|h| *h != step.body);
            of.holders.extend((load != Load::NONE).then_some(step.body));
        }
        if let Some((_, cells)) = self.at.setup.held(step.to).filter(|(e, _)| *e == element) {
            of.cells = cells;
        }
    }

    /// Returns the cells that a step needs, with those where body and element are before and after it.
    fn cells_of(&self, element: usize, step: &TransportStep) -> BTreeSet<Cell> {
        let setup = &self.at.setup;
        let mut cells: BTreeSet<Cell> = setup.occupied(step.from).chain(setup.occupied(step.to)).collect();
        match step.action {
            TransportAction::Handle(_) => cells.extend(&self.elements[element].cells),
            TransportAction::Turn(posture) if step.from.load != Load::NONE => {
                cells.extend(setup.carried_step(step.from, posture).map(|s| s.cells).unwrap_or_default());
            }
            TransportAction::Turn(posture) | TransportAction::Land(posture) => {
                let others = self.at.free.iter().enumerate().filter(|(i, _)| *i != step.body);
                let others = others.flat_map(|(_, pose)| setup.motions.cells(*pose));
                let elements = self.elements.iter().flat_map(|e| e.cells.iter().copied());
                let taken: Vec<Cell> = self.at.fixed.iter().copied().chain(others).chain(elements).collect();
                let ground = Ground { motions: &setup.motions, floor: setup.floor, taken: &taken };
                let way = Plan::to(&ground, step.from, posture, Aim::Shift);
                cells.extend(way.iter().flat_map(|plan| plan.cells(setup)));
            }
        }
        cells
    }
}
