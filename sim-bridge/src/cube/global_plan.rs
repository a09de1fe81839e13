//! Global plans: the last resort when a broken swarm stands still, or moves without filling a cell, and calls do not help.
//!
//! The director looks for a plan by the rules of any robot: every live module may move over any other, also over a dead one, as
//! long as the body stays connected. Such moves need more than a module can find out from its neighbours. So the director
//! opens the goal once more in a closed epoch ([`Opening::is_closed`]), in which nothing is built and no module moves unless it
//! is called, waits until every live module has reported that epoch, and calls one module after the other
//! ([`Order::Call`]). Afterwards it opens the whole goal, and what stands in it is finalized.
//!
//! *Safety.* A module that has reported the closed epoch never goes back to an earlier one. So nothing moves but the called
//! module, the body is what the director sees, and each move of the plan leaves it connected. The next module is called only
//! when the one before has arrived, or may not start any more; and so is the goal opened. A module that dies stays where it
//! is. One that is started again has not reported, so none is called then; and it listens for longer than a call lasts
//! ([`Params::quarantine`]).
//!
//! [`Opening::is_closed`]: metamorph_protocol::cube::epoch::Opening::is_closed
//! [`Params::quarantine`]: metamorph_protocol::cube::params::Params::quarantine

use crate::cube::calls::{Swarm, ways};
use crate::cube::diagnosis::Known;
use crate::cube::reachability::{PlannedMove, StandstillSnapshot, plan_of_any_robot};
use crate::cube::sequential_plan::plan_one_by_one;
use crate::cube::world::CubeWorld;
use metamorph_protocol::cube::call::Walk;
use metamorph_protocol::cube::control::Order;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::Time;
use std::collections::VecDeque;

/// The largest number of modules of a swarm that is led.
const MODULES: usize = 4_096;
/// The largest number of modules of a swarm for which all arrangements are searched.
const SEARCHED_MODULES: usize = 256;
/// The largest number of arrangements in a search.
const ARRANGEMENTS: usize = 200_000;
/// The largest number of cells in these arrangements together.
const EFFORT: usize = 3_000_000;
/// The largest number of plans for a goal until something breaks.
const MOST_PLANS: u8 = 3;
/// How long to wait until all modules rest and have reported the closed epoch, in moves.
const TO_REST: u64 = 60;
/// The largest number of calls in a row after which the called module has made no step.
const MOST_REFUSED: u8 = 3;

#[derive(Clone, Copy, Debug, Hash)]
struct Segment {
    way: Walk,
    mover: ModuleId,
    /// The latest start of a motion.
    until: Time,
}

/// Phase of the director's work on a global plan.
#[derive(Clone, Debug, Hash)]
enum Phase {
    /// It looks for a plan when all modules rest.
    Waiting,
    /// It carries out what is left of the plan.
    Leading(VecDeque<PlannedMove>),
}

/// The global plans for a goal since something last broke.
#[derive(Clone, Debug, Default, Hash)]
pub(super) struct GlobalPlan {
    /// The goal, and when something last broke.
    of: (u16, Time),
    plans: u8,
    phase: Option<Phase>,
    segment: Option<Segment>,
    /// When the plan is given up if modules still move, or have not reported.
    rest_by: Time,
    /// The number of calls in a row after which the called module has made no step.
    refused: u8,
    /// The number of moves of the run that were led, by calls that are over.
    led: u64,
}

impl GlobalPlan {
    /// Begins a plan for a goal, unless enough have been made or none is found. If modules still move, it is looked for when they
    /// rest. Returns true if a plan is under way.
    pub fn begin(
        &mut self,
        (now, last_fault): (Time, Time),
        goal: u16,
        world: &CubeWorld,
        snapshot: &dyn Fn() -> StandstillSnapshot,
        swarm: Swarm<'_>,
    ) -> bool {
        if self.of != (goal, last_fault) {
            *self = GlobalPlan { of: (goal, last_fault), led: self.led, ..GlobalPlan::default() };
        }
        if self.plans >= MOST_PLANS || swarm.known.len() > MODULES {
            return false;
        }
        self.plans += 1;
        let is_at_rest = is_at_rest(world, swarm);
        self.phase = if is_at_rest { plan(&snapshot()).map(Phase::Leading) } else { Some(Phase::Waiting) };
        if self.phase.is_none() {
            self.plans = MOST_PLANS;
        }
        (self.segment, self.refused) = (None, 0);
        self.rest_by = now + swarm.params.move_time * TO_REST;
        self.is_active()
    }

    /// Returns true while a plan is looked for or carried out.
    pub fn is_active(&self) -> bool {
        self.phase.is_some()
    }
    /// Returns the number of moves that were led in the run.
    pub fn led(&self, world: &CubeWorld) -> u64 {
        self.led + self.segment.map_or(0, |segment| segment.made(world) as u64)
    }

    /// Calls the next module when the one before has arrived. Returns false when the plan is over: carried out, or given up.
    pub fn lead(
        &mut self,
        (now, last_fault): (Time, Time),
        world: &CubeWorld,
        snapshot: &dyn Fn() -> StandstillSnapshot,
        swarm: Swarm<'_>,
        commands: &mut VecDeque<Command<Order>>,
    ) -> bool {
        if let Some(segment) = self.segment {
            if !segment.is_over(now, world) {
                return true;
            }
            self.count(segment, world);
            self.segment = None;
            self.rest_by = now + swarm.params.move_time * TO_REST;
        }
        let has_reported = |k: &Known| !k.alive || k.status.is_some_and(|s| s.epoch == swarm.epoch);
        let is_still = || is_at_rest(world, swarm) && swarm.known.iter().all(has_reported);
        if last_fault != self.of.1 || self.refused > MOST_REFUSED || now > self.rest_by {
            self.phase = None;
        } else if is_still() {
            if let Some(Phase::Waiting) = self.phase {
                self.phase = plan(&snapshot()).map(Phase::Leading);
            }
            self.segment = self.next_segment(now, world, swarm);
            if let Some(Segment { way, mover, until }) = self.segment {
                let call = Order::Call { epoch: swarm.epoch, until, way };
                commands.push_back(Command::Order(mover, call));
            } else {
                self.phase = None;
            }
        }
        self.is_active()
    }

    /// Returns the next call; `None` if the plan is carried out, or if the mover is not where the plan has it.
    fn next_segment(&mut self, now: Time, world: &CubeWorld, swarm: Swarm<'_>) -> Option<Segment> {
        let Some(Phase::Leading(moves)) = &mut self.phase else { return None };
        let way = ways(moves.make_contiguous(), &|_| false).next()?;
        let mover = world.body_at(way.from()).filter(|id| swarm.known[id.index()].alive)?;
        Some(Segment { way, mover, until: now + swarm.params.start_within() })
    }

    /// Counts the steps that a called module has made.
    fn count(&mut self, segment: Segment, world: &CubeWorld) {
        let made = segment.made(world);
        if let Some(Phase::Leading(moves)) = &mut self.phase {
            moves.drain(..made.min(moves.len()));
        }
        self.led += made as u64;
        self.refused = if made == 0 { self.refused + 1 } else { 0 };
    }
}

impl Segment {
    /// Returns the number of steps that the called module has made.
    fn made(&self, world: &CubeWorld) -> usize {
        let at = world.cell(self.mover);
        let reached = self.way.cells().enumerate().filter(|(_, cell)| *cell == at).last();
        reached.map_or(0, |(steps, _)| steps)
    }
    /// Returns true if the called module has arrived, or may not start a motion any more.
    fn is_over(&self, now: Time, world: &CubeWorld) -> bool {
        !world.is_moving(self.mover) && (world.cell(self.mover) == self.way.to() || now > self.until)
    }
}

fn is_at_rest(world: &CubeWorld, swarm: Swarm<'_>) -> bool {
    (0..swarm.known.len() as u32).all(|id| !world.is_moving(ModuleId(id)))
}

/// Returns a plan that fills all goal cells or, if none is found, some of them.
fn plan(snapshot: &StandstillSnapshot) -> Option<VecDeque<PlannedMove>> {
    let (one_by_one, is_whole) = plan_one_by_one(snapshot);
    let modules = snapshot.modules.len().max(1);
    let searched = || plan_of_any_robot(snapshot, (EFFORT / modules).min(ARRANGEMENTS));
    let found = if is_whole || modules > SEARCHED_MODULES { None } else { searched() };
    let plan = found.unwrap_or(one_by_one);
    (!plan.is_empty()).then(|| plan.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::diagnosis::tests::status;
    use crate::cube::reachability::ModuleSnapshot;
    use metamorph_protocol::cube::control::Status;
    use metamorph_protocol::cube::epoch::Epoch;
    use metamorph_protocol::cube::message::Role;
    use metamorph_protocol::cube::params::Params;
    use metamorph_protocol::lattice::Cell;
    use metamorph_protocol::time::Span;

    const OPEN: Epoch = Epoch::first(0);
    const CLOSED: Epoch = match OPEN.reopened() {
        Some(epoch) => epoch,
        None => Epoch::LAST,
    };

    fn swarm<'a>(params: &'a Params, known: &'a [Known]) -> Swarm<'a> {
        Swarm { epoch: CLOSED, params, known }
    }

    fn reported(epoch: Epoch) -> Known {
        let status = Status { epoch, ..status(Role::Reserve, 0, None, false) };
        Known { alive: true, restarted: false, status: Some(status) }
    }

    /// A row that is to become a tower, and its world: the module at its end goes first.
    fn row() -> (StandstillSnapshot, CubeWorld, Params) {
        let module = |x| ModuleSnapshot { cell: Cell::new(x, 0, 0), ..ModuleSnapshot::LIVE };
        let goal: Vec<Cell> = (0..3).map(|z| Cell::new(0, 0, z)).collect();
        let modules: Vec<ModuleSnapshot> = (0..4).map(module).collect();
        let cells: Vec<Cell> = modules.iter().map(|m| m.cell).collect();
        let snapshot = StandstillSnapshot { modules, seed: goal[0], goal, filled: 1, spared_by_live: false };
        let params = Params::scaled(Span::secs(1), Span::millis(10), 100);
        (snapshot, CubeWorld::new(&cells, Span::secs(1), 1), params)
    }

    /// No module is called before all have reported the closed epoch, nor while another call lasts; and a plan
    /// continues until its last call is over, whatever breaks.
    #[test]
    fn modules_are_called_one_at_a_time() {
        let (snapshot, world, params) = row();
        let (mut known, mut global_plan) = (vec![reported(CLOSED); 4], GlobalPlan::default());
        known[1] = reported(OPEN);
        let at = |s| Time::ZERO + Span::secs(s);
        let mut commands = VecDeque::new();
        assert!(global_plan.begin((at(1), at(0)), 0, &world, &|| snapshot.clone(), swarm(&params, &known)));
        let mut lead = |now, fault, known: &[Known]| {
            let goes_on = global_plan.lead(
                (now, fault),
                &world,
                &|| snapshot.clone(),
                swarm(&params, known),
                &mut commands,
            );
            (goes_on, commands.len())
        };
        assert_eq!(lead(at(2), at(0), &known), (true, 0), "a module has not reported");
        known[1] = reported(CLOSED);
        assert_eq!(lead(at(3), at(0), &known), (true, 1));
        assert_eq!(lead(at(4), at(0), &known), (true, 1), "the call lasts");
        assert_eq!(lead(at(5), at(5), &known), (true, 1), "something breaks, and the call lasts");
        let over = at(3) + params.start_within() + Span(1);
        assert_eq!(lead(over, at(5), &known), (false, 1));
        let Some(Command::Order(mover, Order::Call { epoch, until, way })) = commands.pop_front() else {
            panic!("a module is called");
        };
        assert_eq!((mover, way.from(), epoch), (ModuleId(3), snapshot.modules[3].cell, CLOSED));
        assert_eq!(until, at(3) + params.start_within());
    }

    /// Plans are not made forever, nor if no module can go.
    #[test]
    fn plans_are_bounded() {
        let (snapshot, world, params) = row();
        let known = vec![reported(CLOSED); 4];
        let mut global_plan = GlobalPlan::default();
        let mut begins = |fault, snapshot: &StandstillSnapshot| {
            global_plan.begin((Time(9), fault), 0, &world, &|| snapshot.clone(), swarm(&params, &known))
        };
        let begun = (0..9).take_while(|_| begins(Time::ZERO, &snapshot)).count();
        assert_eq!(begun, usize::from(MOST_PLANS));
        assert!(begins(Time(1), &snapshot), "something broke");
        let mut few = snapshot.clone();
        few.modules.iter_mut().for_each(|m| m.alive = m.cell == Cell::default());
        assert!(!begins(Time(2), &few));
    }
}
