//! Carries plans out under `planned`: orders moves as those before them are confirmed, and plans again when a move is
//! not made, a metamodule dies, an obstacle comes or goes, or the goal changes.
//!
//! It plans from what metamodules report. Nothing moves while it plans. A metamodule whose joints are stuck, or that
//! does not make its move in time, is *suspected*: it counts as an obstacle in the next plan. If a plan leaves seeds
//! unfilled although there are metamodules for them, the metamodules decide for themselves, as under `negotiated`,
//! until one more seed is filled; if that is not allowed they rest.
//!
//! Elements come first: transports of all that are not at their goals are planned in the order of the structure's bundles, and
//! steps that do not meet are made at the same time. Then the other seeds are filled, and the metamodules in them grip what
//! faces their heads. While an element is on its way the metamodules are never left to themselves. Of an element whose holder
//! is dead or suspected there is no plan. A living holder that has none puts the element down, so that another one can
//! take it.
//!
//! Planning takes scenario time: its work divided by [`PLANNING_RATE`]. So a run has the same trace on every
//! machine.

use super::members::{Known, Orders};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::{SeedSet, Task};
use metamorph_protocol::metamodule::message::{Instruction, MoveEnd, Order, Status};
use metamorph_protocol::metamodule::params::Setup;
use metamorph_protocol::metamodule::planning::bundles::element_order;
use metamorph_protocol::metamodule::planning::centralized::{
    CentralPlan, PlannedMove, Shortage, bound, plan,
};
use metamorph_protocol::metamodule::planning::cooperative::{Standstill, WORK};
use metamorph_protocol::metamodule::planning::transport::{
    Scenes, TRANSPORT_WORK, TransportAction, TransportStep, facing, is_at_goal, missing_bonds, put_back,
};
use metamorph_protocol::metamodule::planning::transports::{
    ElementNow as PlannedElement, OrderedStep, plan_transports,
};
use metamorph_protocol::metamodule::pose::{Load, Pose};
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Work of planning in one second of scenario time, in placements examined (see `cooperative::search`).
pub const PLANNING_RATE: u64 = 2_000_000;
/// Work of one cooperative search: a number of placements examined. The metamodules that a plan is handed over to
/// search further.
const SEARCH_WORK: usize = WORK / 10;
/// The number of plans in a row, without a seed filled in between, after which the metamodules decide for themselves.
const REPLANS: u32 = 8;

/// Counts of plans and orders in a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlanCounts {
    /// Plans made.
    pub plans: u64,
    /// Moves of the first plan.
    pub first_moves: u64,
    /// The least number of moves that any plan could have taken instead.
    pub bound: u64,
    /// Orders to move.
    pub ordered: u64,
    /// Moves that were not made in time.
    pub late: u64,
    /// Work of planning, in placements examined.
    pub work: u64,
    /// Times that the metamodules were left to decide for themselves.
    pub handed_over: u64,
    /// The largest number of transports under way at a time: from the first order to the end of the last step.
    pub transports_at_most: u64,
}

/// An element as it is now.
#[derive(Clone, Debug)]
pub(super) struct ElementNow {
    pub cells: Vec<Cell>,
    pub holders: Vec<ModuleId>,
}

/// Inputs that determine the plan, of one metamodule that has reported: its pose, whether it fills a seed, and
/// whether its joints are stuck.
type Standing = (ModuleId, Option<(Pose, bool, bool)>);

/// The director's knowledge of the swarm at one time.
pub(super) struct Swarm<'a> {
    pub setup: &'a Arc<Setup>,
    pub scenes: &'a Scenes,
    pub known: &'a [Known],
    pub task: Task,
    pub filled: SeedSet,
    /// The cells of obstacles and of the dead.
    pub stays: Vec<Cell>,
    pub elements: Vec<ElementNow>,
}

impl Swarm<'_> {
    fn living(&self) -> impl Iterator<Item = (ModuleId, Option<Status>)> {
        let all = (0..).map(ModuleId).zip(self.known);
        all.filter(|(_, known)| known.alive).map(|(id, known)| (id, known.status))
    }
    /// Returns true if a metamodule fills a seed of the present task. Its last report may be about an earlier task.
    fn fills(&self, status: &Status) -> bool {
        let seed = status.settled.and_then(|seed| self.setup.seed(self.task, seed));
        seed.is_some_and(|seed| seed.cells() == self.setup.motions.cells(status.pose))
    }
    /// Returns, for each living metamodule, what a plan depends on: its pose, and whether it fills a seed and is stuck.
    fn standing(&self) -> Vec<Standing> {
        let told = |s: Status| (s.pose, self.fills(&s), s.stuck);
        self.living().map(|(id, status)| (id, status.map(told))).collect()
    }
    fn status(&self, id: ModuleId) -> Option<Status> {
        self.known.get(id.index()).filter(|known| known.alive).and_then(|known| known.status)
    }
    /// Returns the elements that are not at their goals.
    pub fn elements_left(&self) -> impl Iterator<Item = usize> + '_ {
        let is_left = |e: &usize| !is_at_goal(self.setup, self.task.goal, *e, &self.elements[*e].cells);
        let held = |e: &usize| !self.elements[*e].holders.is_empty();
        // One that lies at its goal in the end is released there.
        let lies = |e: &usize| self.setup.elements.lies(*e, self.task.goal);
        (0..self.elements.len()).filter(move |e| is_left(e) || (lies(e) && held(e)))
    }
    /// Returns true if a metamodule holds an element that is not at its goal.
    fn carries(&self, id: ModuleId) -> bool {
        self.elements_left().any(|e| self.elements[e].holders.contains(&id))
    }
    /// Returns the metamodules in seeds that are to grip an element at its goal, their poses and the loads.
    fn missing_bonds(&self) -> Vec<(ModuleId, Pose, Load)> {
        let settled = |(id, status): (ModuleId, Option<Status>)| {
            Some((id, status.filter(|s| self.fills(s) && !s.stuck)?.pose))
        };
        let settled: Vec<(ModuleId, Pose)> = self.living().filter_map(settled).collect();
        let poses: Vec<Pose> = settled.iter().map(|(_, pose)| *pose).collect();
        let missing = missing_bonds(self.setup, self.task.goal, &poses).into_iter();
        missing.map(|(i, load)| (settled[i].0, settled[i].1, load)).collect()
    }
    /// Returns true if all seeds are filled, and all elements are at their goals and gripped by all heads that face them.
    pub fn is_built(&self) -> bool {
        let filled = self.filled.holds(self.setup.goal(self.task).all());
        filled && self.elements_left().next().is_none() && self.missing_bonds().is_empty()
    }
    /// Returns the input of a search: the free metamodules and what stands. Elements do if it is about the seeds; a metamodule in
    /// a seed that still carries one is free.
    fn standstill(&self, of_seeds: bool, suspected: &BTreeSet<ModuleId>) -> (Vec<ModuleId>, Standstill) {
        let (mut ids, mut free, mut fixed) = (Vec::new(), Vec::new(), self.stays.clone());
        for (id, status) in self.living() {
            let Some(status) = status else { continue };
            let is_free = !self.fills(&status) || self.carries(id);
            if is_free && !status.stuck && !suspected.contains(&id) {
                ids.push(id);
                free.push(status.pose);
            } else {
                fixed.extend(self.setup.motions.cells(status.pose));
            }
        }
        fixed.extend(self.elements.iter().filter(|_| of_seeds).flat_map(|e| &e.cells));
        let setup = Arc::clone(self.setup);
        (ids, Standstill { setup, task: self.task, filled: self.filled, free, fixed })
    }
    /// Returns the elements in terms of the free metamodules `ids`.
    fn planned_elements(&self, ids: &[ModuleId]) -> Vec<PlannedElement> {
        let number = |id: &ModuleId| ids.iter().position(|other| other == id);
        let element = |e: &ElementNow| PlannedElement {
            cells: e.cells.clone(),
            holders: e.holders.iter().filter_map(number).collect(),
            is_pinned: e.holders.iter().any(|id| number(id).is_none()),
        };
        self.elements.iter().map(element).collect()
    }
    /// Returns true if the planner finds a transport of an element to its goal.
    pub fn has_transport(&self, element: usize) -> bool {
        let (ids, standstill) = self.standstill(false, &BTreeSet::new());
        let elements = self.planned_elements(&ids);
        plan_transports(&standstill, &elements, &[element], self.scenes).count > 0
    }
    /// Returns true if all living metamodules have reported and none moves.
    fn rests(&self) -> bool {
        self.living().all(|(_, status)| status.is_some_and(|s| !s.busy && !s.pose.both))
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// Metamodules finish what they do; a plan is made when they rest, but not before this time.
    Holding(Time),
    /// A plan is made until this time.
    Planning(Time),
    /// The plan is carried out.
    Moving,
    /// There is nothing to do until something changes: no plan for what was known then fills another seed.
    Resting,
    /// Metamodules decide for themselves until something changes, or the filled seeds are no longer these.
    HandedOver(SeedSet),
}

/// One instruction of the plan, and how far it is.
#[derive(Clone, Debug)]
struct Step {
    id: ModuleId,
    instruction: Instruction,
    /// Steps that must be done before, by their place in the plan.
    after: Vec<usize>,
    /// True if the metamodule fills a seed then.
    fills: bool,
    /// The element that is brought.
    element: Option<usize>,
    /// Where the body is afterwards.
    to: Pose,
    /// When it counts as late; `None` before it is ordered.
    due: Option<Time>,
    done: bool,
}

/// The plan of a swarm, and how far it is carried out.
#[derive(Clone, Debug)]
pub(super) struct PlanExecution {
    stage: Stage,
    steps: Vec<Step>,
    shortage: Option<Shortage>,
    /// The number of the last instruction.
    number: u32,
    disturbed: bool,
    suspected: BTreeSet<ModuleId>,
    /// Plans made since the last seed was filled, or the last element placed.
    replans: u32,
    filled: SeedSet,
    /// The number of elements that are not at their goals.
    left: usize,
    /// The order of the elements for this task.
    order: Option<(Task, Vec<usize>)>,
    /// The knowledge with which the last plan found nothing more to do.
    rested: Vec<Standing>,
    /// Whether metamodules may decide for themselves where there is no plan.
    hands_over: bool,
    /// How long an order and the report of its result are under way at most.
    round_trip: Span,
    pub counts: PlanCounts,
}

impl PlanExecution {
    pub fn new(hands_over: bool, round_trip: Span) -> PlanExecution {
        PlanExecution {
            stage: Stage::Holding(Time::ZERO),
            steps: Vec::new(),
            shortage: None,
            number: 0,
            disturbed: false,
            suspected: BTreeSet::new(),
            replans: 0,
            filled: SeedSet::default(),
            left: 0,
            order: None,
            rested: Vec::new(),
            hands_over,
            round_trip,
            counts: PlanCounts::default(),
        }
    }

    /// Notes that the plan may not fit any more.
    pub fn disturb(&mut self) {
        self.disturbed = true;
    }

    /// Returns when the plan is ready that is being made. All else is checked at every report, and once per turn time.
    pub fn ready_at(&self) -> Time {
        if let Stage::Planning(ready) = self.stage { ready } else { Time::NEVER }
    }

    /// Plans and orders what is due.
    pub fn step(&mut self, now: Time, swarm: &Swarm<'_>, orders: &mut Orders) {
        if std::mem::take(&mut self.disturbed) {
            self.suspected.clear();
            self.replans = 0;
            self.hold(now, swarm, orders);
        }
        if self.filled != swarm.filled {
            (self.filled, self.replans) = (swarm.filled, 0);
        }
        let left = swarm.elements_left().count();
        if left != self.left {
            (self.left, self.replans) = (left, 0);
        }
        match self.stage {
            Stage::Holding(at) => {
                if now >= at && swarm.rests() {
                    self.plan(now, swarm, orders);
                }
            }
            Stage::Planning(ready) => {
                if now >= ready {
                    self.stage = Stage::Moving;
                    self.go_on(now, swarm, orders);
                }
            }
            Stage::Moving => self.go_on(now, swarm, orders),
            Stage::Resting => {
                if self.rested != swarm.standing() {
                    self.hold(now, swarm, orders);
                }
            }
            Stage::HandedOver(filled) => {
                if filled != swarm.filled {
                    self.hold(now, swarm, orders);
                }
            }
        }
    }

    /// Lets all metamodules come to rest.
    fn hold(&mut self, now: Time, swarm: &Swarm<'_>, orders: &mut Orders) {
        let is_free = matches!(self.stage, Stage::HandedOver(_));
        let ordered = |id: ModuleId| self.steps.iter().any(|s| s.id == id && s.due.is_some() && !s.done);
        let moving: Vec<ModuleId> =
            swarm.living().map(|(id, _)| id).filter(|id| is_free || ordered(*id)).collect();
        // An order that is still in transit is not known to have been obeyed.
        let sent = swarm.setup.params.resend + self.round_trip;
        let settles = if moving.is_empty() { Span::ZERO } else { sent };
        moving.into_iter().for_each(|id| self.instruct(id, Instruction::Stay, orders));
        self.steps.clear();
        self.stage = Stage::Holding(now + settles);
    }

    fn instruct(&mut self, id: ModuleId, instruction: Instruction, orders: &mut Orders) {
        self.number += 1;
        orders.push_back(Command::Order(id, Order::Instruct { number: self.number, instruction }));
    }

    /// Makes a plan from what has been reported.
    fn plan(&mut self, now: Time, swarm: &Swarm<'_>, orders: &mut Orders) {
        if swarm.elements_left().next().is_some() {
            return self.plan_elements(now, swarm, orders);
        }
        let (ids, mut standstill) = swarm.standstill(true, &self.suspected);
        let bonds = swarm.missing_bonds();
        if !bonds.is_empty() {
            return self.plan_bonds(now, bonds);
        }
        let CentralPlan { moves, shortage, work } = plan(&standstill, SEARCH_WORK);
        if self.counts.plans == 0 {
            self.counts.first_moves = moves.iter().filter(|m| m.lands).count() as u64;
            self.counts.bound = u64::from(bound(&standstill));
        }
        self.counts.plans += 1;
        self.counts.work += work as u64;
        self.replans += 1;
        self.shortage = shortage;
        let motions = &swarm.setup.motions;
        let step = |PlannedMove { body, from, posture, lands, fills, after }: PlannedMove| {
            // A metamodule in a seed grips what faces its head, if the others let it turn there.
            let posture = match fills {
                Some(_) if !lands => {
                    let taken = standstill.taken_around(&[body]);
                    facing(swarm.setup, swarm.task.goal, from, posture, &taken)
                }
                _ => posture,
            };
            let turned = Pose { posture, ..from };
            let to = if lands { motions.turned_around(turned)? } else { turned };
            standstill.free[body] = to;
            let mover = ids[body];
            let end = MoveEnd::of(lands, fills.is_some());
            let instruction = Instruction::Move { mover, from, posture, end };
            let fills = fills.is_some();
            Some(Step { id: mover, instruction, after, fills, element: None, to, due: None, done: false })
        };
        // Invariant: a move that lands ends where the free end is on a connector, so none is left out.
        self.steps = moves.into_iter().filter_map(step).collect();
        if self.steps.is_empty() {
            return self.run_out(now, swarm, orders);
        }
        self.stage = Stage::Planning(now + Span((work as u64).saturating_mul(1_000_000_000) / PLANNING_RATE));
    }

    /// Plans how the elements are brought to their goals.
    fn plan_elements(&mut self, now: Time, swarm: &Swarm<'_>, orders: &mut Orders) {
        let (ids, standstill) = swarm.standstill(false, &self.suspected);
        let elements = swarm.planned_elements(&ids);
        if self.order.as_ref().is_none_or(|(task, _)| *task != swarm.task) {
            self.order = Some((swarm.task, element_order(swarm.setup, swarm.task)));
        }
        let order = self.order.as_ref().map(|(_, order)| order.clone()).unwrap_or_default();
        self.shortage = None;
        self.counts.plans += 1;
        self.replans += 1;
        let found = plan_transports(&standstill, &elements, &order, swarm.scenes);
        self.counts.work += TRANSPORT_WORK as u64 * found.searches as u64;
        if found.steps.is_empty() {
            // Another metamodule may bring an element to its goal.
            let holders = swarm.elements_left().filter(|e| !elements[*e].is_pinned);
            let mut holders = holders.filter_map(|e| match elements[e].holders.as_slice() {
                [holder] => Some((e, *holder)),
                _ => None,
            });
            let put = holders.find_map(|(element, body)| Some((element, put_back(&standstill, body)?)));
            return match put {
                Some((element, steps)) => self.follow(now, &ids, in_a_row(element, steps), 1),
                None => self.run_out(now, swarm, orders),
            };
        }
        if self.counts.plans == 1 {
            self.counts.first_moves = u64::from(found.connections);
        }
        self.follow(now, &ids, found.steps, found.searches);
    }

    /// Carries the steps of transports out, which took so many searches to plan.
    fn follow(&mut self, now: Time, ids: &[ModuleId], steps: Vec<OrderedStep>, searches: usize) {
        let step = |OrderedStep { step, element, after, fills }: OrderedStep| {
            let (id, TransportStep { from, to, .. }) = (ids[step.body], step);
            let turns = |posture, lands| {
                let end = MoveEnd::of(lands, fills);
                Instruction::Move { mover: id, from, posture, end }
            };
            let instruction = match step.action {
                TransportAction::Turn(posture) => turns(posture, false),
                TransportAction::Land(posture) => turns(posture, true),
                TransportAction::Handle(load) => Instruction::Handle { mover: id, from, load },
            };
            Step { id, instruction, after, fills, element: Some(element), to, due: None, done: false }
        };
        self.steps = steps.into_iter().map(step).collect();
        let work = TRANSPORT_WORK as u64 * searches as u64;
        self.stage = Stage::Planning(now + Span(work * 1_000_000_000 / PLANNING_RATE));
    }

    /// Lets metamodules in seeds grip the elements that face their heads.
    fn plan_bonds(&mut self, now: Time, bonds: Vec<(ModuleId, Pose, Load)>) {
        self.counts.plans += 1;
        self.replans += 1;
        let step = |(id, from, load): (ModuleId, Pose, Load)| {
            let instruction = Instruction::Handle { mover: id, from, load };
            let to = Pose { load, ..from };
            let after = Vec::new();
            Step { id, instruction, after, fills: true, element: None, to, due: None, done: false }
        };
        self.steps = bonds.into_iter().map(step).collect();
        self.stage = Stage::Planning(now);
    }

    /// Notes which moves have been made, and orders those that may be made now.
    fn go_on(&mut self, now: Time, swarm: &Swarm<'_>, orders: &mut Orders) {
        let allowed = swarm.setup.params.lease + self.round_trip;
        let mut late = None;
        for step in self.steps.iter_mut().filter(|s| !s.done) {
            let Some(due) = step.due else { continue };
            let status = swarm.status(step.id);
            let is_there = status.is_some_and(|s| s.pose == step.to && !s.busy);
            step.done = is_there && (!step.fills || status.is_some_and(|s| swarm.fills(&s)));
            if !step.done && status.is_some_and(|s| s.stuck) {
                late = Some(step.id);
            } else if !step.done && now >= due {
                match status.is_some_and(|s| s.busy) {
                    true => step.due = Some(now + allowed),
                    false => late = Some(step.id),
                }
            }
        }
        if let Some(id) = late {
            self.counts.late += 1;
            self.suspected.insert(id);
            return if self.replans < REPLANS {
                self.hold(now, swarm, orders)
            } else {
                self.run_out(now, swarm, orders)
            };
        }
        if self.steps.iter().all(|s| s.done) {
            return self.run_out(now, swarm, orders);
        }
        let is_due =
            |step: &Step| step.due.is_none() && step.after.iter().all(|before| self.steps[*before].done);
        let due: Vec<usize> = (0..self.steps.len()).filter(|i| is_due(&self.steps[*i])).collect();
        if due.is_empty() {
            return;
        }
        for i in due {
            let step = &mut self.steps[i];
            step.due = Some(now + allowed);
            let (id, instruction) = (step.id, step.instruction);
            self.counts.ordered += 1;
            self.instruct(id, instruction, orders);
        }
        let of = |is_it: fn(&&Step) -> bool| -> BTreeSet<usize> {
            self.steps.iter().filter(is_it).filter_map(|step| step.element).collect()
        };
        let (begun, left) = (of(|step| step.due.is_some()), of(|step| !step.done));
        let under_way = begun.intersection(&left).count() as u64;
        self.counts.transports_at_most = self.counts.transports_at_most.max(under_way);
    }

    /// Decides what to do where the plan has ended and seeds are left.
    fn run_out(&mut self, now: Time, swarm: &Swarm<'_>, orders: &mut Orders) {
        let was_carried_out = !self.steps.is_empty() && self.steps.iter().all(|s| s.done);
        self.steps.clear();
        (self.stage, self.rested) = (Stage::Resting, swarm.standing());
        if swarm.is_built() {
            return;
        }
        if was_carried_out && !swarm.elements.is_empty() {
            // The plan was for one element, for grips or for the seeds; there is another part.
            self.stage = Stage::Holding(now);
            return;
        }
        if !self.suspected.is_empty() && self.replans < REPLANS {
            // The obstacle may be gone, or the joints may turn again.
            self.suspected.clear();
            self.stage = Stage::Holding(now + swarm.setup.params.patience * u64::from(self.replans));
        } else if self.hands_over
            && swarm.elements.is_empty()
            && !matches!(self.shortage, Some(Shortage::NoWay(_)))
        {
            self.counts.handed_over += 1;
            self.stage = Stage::HandedOver(swarm.filled);
            let all: Vec<ModuleId> = swarm.living().map(|(id, _)| id).collect();
            all.into_iter().for_each(|id| self.instruct(id, Instruction::Over, orders));
        }
    }
}

/// Returns the steps of one element that come one after the other.
fn in_a_row(element: usize, steps: Vec<TransportStep>) -> Vec<OrderedStep> {
    let ordered = |(i, step): (usize, TransportStep)| {
        let after = i.checked_sub(1).into_iter().collect();
        OrderedStep { step, element, after, fills: false }
    };
    steps.into_iter().enumerate().map(ordered).collect()
}
