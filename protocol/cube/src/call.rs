//! Calls of the world-controller to one cube: a way over the surface, to a place from which the swarm can continue. The
//! attraction field ends at dead modules, since they pass no distances on; a called module walks past them.
//!
//! A call replaces only the choice of the motion. A module in reserve leaves only if it may, and every motion needs the
//! locks that it always needs. A dead module grants none and needs none, because it does not leave; nor does it pass on a
//! request to the module that a motion over it lands on. So the controller vouches for that one ([`Step::is_vouched`]): it
//! was reported finalized for this goal and never leaves in it; or it is dead, and listens before it moves if it is started
//! again; or it has granted the controller what the mover would have asked for ([`Order::Carry`]). A call with such a grant
//! ends before the grant does, and the mover starts no later than the call ends.
//!
//! In a closed epoch a module moves only if it is called, and the controller calls one after the other. So nothing moves but the
//! called module, the controller knows where each body is, and it vouches for all that the mover would have asked for: the
//! structure stays connected, and supports stay.
//!
//! [`Order::Carry`]: super::control::Order::Carry

use super::Cube;
use super::epoch::Epoch;
use super::message::{Ask, RequestId, Role};
use alloc::boxed::Box;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::ids::{ModuleId, Token};
use metamorph_core::lattice::{Cell, Face, Motion, MotionKind};
use metamorph_core::time::{Span, Time};
use metamorph_core::wire::{Decoder, Encoder, Field, WireError};

/// The largest number of steps of a way; a longer one is called in parts.
pub const MAX_STEPS: usize = 56;
/// The number of a request that the controller makes for a called module; modules count theirs from zero and never get there.
pub(super) const CARRY: u8 = u8::MAX;

/// One motion of a way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Step {
    /// The motion.
    pub motion: Motion,
    /// True if the module that it lands on stays at least until the call ends and the move is over.
    pub is_vouched: bool,
}

impl Step {
    fn pack(self) -> u8 {
        let Motion { kind, support, heading } = self.motion;
        (kind as u8) | (support as u8) << 1 | (heading as u8) << 4 | u8::from(self.is_vouched) << 7
    }
    fn unpack(byte: u8) -> Option<Step> {
        let kind = if byte & 1 == 0 { MotionKind::Slide } else { MotionKind::Convex };
        let (support, heading) = (Face::from_index(byte >> 1 & 7)?, Face::from_index(byte >> 4 & 7)?);
        heading.slot_in(support)?;
        Some(Step { motion: Motion { kind, support, heading }, is_vouched: byte & 0x80 != 0 })
    }
}

/// The steps of a module one after the other, from a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Walk {
    from: Cell,
    len: u8,
    /// The steps, packed; zero behind the last.
    steps: [u8; MAX_STEPS],
}

impl Walk {
    /// Creates a way of at least one step and at most [`MAX_STEPS`].
    pub fn new(from: Cell, steps: &[Step]) -> Option<Walk> {
        if steps.is_empty() || steps.len() > MAX_STEPS {
            return None;
        }
        let mut way = Walk { from, len: steps.len() as u8, steps: [0; MAX_STEPS] };
        for (slot, step) in way.steps.iter_mut().zip(steps) {
            *slot = step.pack();
        }
        Some(way)
    }
    /// Returns the first cell.
    pub fn from(&self) -> Cell {
        self.from
    }
    /// Returns the last cell.
    pub fn to(&self) -> Cell {
        self.after(self.len)
    }
    /// Returns the cell after a number of steps.
    fn after(&self, steps: u8) -> Cell {
        self.steps().take(steps.into()).fold(self.from, |at, step| step.motion.destination(at))
    }
    /// Iterates over the cells in order, from the first one.
    pub fn cells(&self) -> impl Iterator<Item = Cell> {
        (0..=self.len).map(|steps| self.after(steps))
    }
    /// Iterates over the steps in order.
    pub fn steps(&self) -> impl Iterator<Item = Step> + '_ {
        // Invariant: all steps are valid, by `new` and `decode`.
        self.steps[..usize::from(self.len)].iter().filter_map(|byte| Step::unpack(*byte))
    }
}

impl Field for Walk {
    fn put(&self, out: &mut Encoder) {
        out.cell(self.from);
        out.u8(self.len);
        self.steps[..usize::from(self.len)].iter().for_each(|byte| out.u8(*byte));
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<Walk, WireError> {
        let mut way = Walk { from: from.cell()?, len: from.u8()?, steps: [0; MAX_STEPS] };
        let used = usize::from(way.len);
        if !(1..=MAX_STEPS).contains(&used) {
            return Err(WireError::Field("way"));
        }
        for slot in &mut way.steps[..used] {
            *slot = from.u8()?;
            Step::unpack(*slot).ok_or(WireError::Field("step"))?;
        }
        Ok(way)
    }
}

/// A call that a module follows.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Called {
    until: Time,
    way: Walk,
    /// The number of steps made.
    made: u8,
}

impl Called {
    fn next(&self) -> Option<Step> {
        self.way.steps().nth(self.made.into())
    }
}

impl Cube {
    /// Takes a call, if the module stands where it begins. It replaces the call before.
    pub(super) fn on_call(&mut self, now: Time, epoch: Epoch, until: Time, way: Walk) {
        let fits = epoch == self.own.epoch && way.from() == self.own.cell && self.moving.is_none();
        if !fits || until <= now || self.own.role == Role::Final {
            return;
        }
        hit(CoveragePoint::CubeCalled);
        self.abort_attempt(now, None);
        self.planner.end_back_off(now);
        self.called = Some(Box::new(Called { until, way, made: 0 }));
        self.invalidate();
        self.decide_soon(now);
    }

    /// Grants the controller that this module stays and keeps the cell outside a face free for a called module.
    pub(super) fn on_carry(&mut self, now: Time, epoch: Epoch, mover: ModuleId, token: Token, face: Face) {
        if epoch != self.own.epoch {
            return;
        }
        let id = RequestId { origin: mover, token, number: CARRY };
        let is_granted = self.consider(now, id, Span(u64::MAX), (None, true), Ask::Reserve(face)).is_ok();
        if is_granted && self.locks.granted_beyond(id, 0) {
            hit(CoveragePoint::CubeCarries);
        }
    }

    /// Returns the latest request of the controller that is granted.
    pub(super) fn carries_for_call(&self) -> Option<Token> {
        let granted = self.locks.iter().filter(|lock| lock.is_of_controller());
        granted.last().map(|lock| lock.id.token)
    }

    /// Returns the latest start of a motion that is asked for now.
    pub(super) fn latest_start(&self, now: Time, motion: Motion) -> Time {
        let latest = now + self.own.params().start_within();
        let is_vouched = self.own.is_closed || self.sides.is_certified_dead(motion.support);
        self.call_ends().filter(|_| is_vouched).map_or(latest, |ends| ends.min(latest))
    }

    /// Forgets a call that is over, and gives up what was asked for it: a module that the controller has asked to carry stays no
    /// longer.
    pub(super) fn tend_call(&mut self, now: Time) {
        if self.called.take_if(|called| now >= called.until).is_some() {
            self.abort_attempt(now, None);
            self.invalidate();
            self.decide_soon(now);
        }
    }

    /// Counts a step, if the module has arrived where its call leads; ends the call otherwise.
    pub(super) fn on_step(&mut self, cell: Cell) {
        let Some(called) = &mut self.called else { return };
        called.made += 1;
        if called.way.after(called.made) != cell {
            self.called = None;
        }
    }

    /// Returns the end of the call that the module follows.
    pub(super) fn call_ends(&self) -> Option<Time> {
        self.called.as_ref().map(|called| called.until)
    }

    /// Returns true if the module stands at the end of its way, and stays there until the call ends.
    pub(super) fn is_called_here(&self) -> bool {
        self.called.as_ref().is_some_and(|called| called.next().is_none())
    }

    /// Returns the next motion of the call, if the module may ask for it: its support is live, or known to be dead.
    pub(super) fn called_motion(&self) -> Option<Motion> {
        let step = self.called.as_ref()?.next()?;
        let motion = step.motion;
        if self.own.is_closed {
            return Some(motion);
        }
        let is_certain = motion.kind == MotionKind::Convex || step.is_vouched;
        let needs_none = self.sides.is_certified_dead(motion.support) && is_certain;
        (needs_none || self.sides.support(motion.support).is_some()).then_some(motion)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Order;
    use crate::epoch::Opening;
    use crate::message::Message;
    use crate::params::{Params, Setup};
    use crate::steering::Steering;
    use metamorph_core::agent::{Agent, Input, Output};
    use metamorph_core::goal::{Goal, Growth};
    use metamorph_core::ids::{Port, Session};
    use metamorph_core::wire::{HEADER, PAYLOAD, Wire};

    const HERE: Epoch = Epoch::first(0);

    fn step(kind: MotionKind, is_vouched: bool) -> Step {
        Step { motion: Motion { kind, support: Face::Down, heading: Face::East }, is_vouched }
    }

    /// Returns the first motion of a module in reserve at the origin that touches one dead module only, below it,
    /// and is called over it.
    fn first_motion(is_certified: bool, step: Step, epoch: Epoch, from: Cell) -> Option<Motion> {
        first_action(is_certified, step, epoch, from, Span::secs(99)).map(|action| action.motion)
    }

    /// Returns the latest start of the first motion of a module called for this long.
    fn latest_start(step: Step, lasts: Span) -> Time {
        first_action(true, step, HERE, Cell::default(), lasts).unwrap().not_after
    }

    fn first_action(
        is_certified: bool,
        step: Step,
        epoch: Epoch,
        from: Cell,
        lasts: Span,
    ) -> Option<super::super::Move> {
        let seed = Cell::new(0, 9, 0);
        let goal = Goal::compile(&[seed, Cell::new(0, 10, 0)], seed, Growth::Solid).unwrap();
        let params = Params::scaled(Span::secs(1), Span::millis(10), 100);
        let mut cube = Cube::first(Setup { params, goals: vec![goal] });
        let (port, session, now) = (Port(Face::Down as u8), Session(1), Time::ZERO + Span::secs(9));
        cube.handle(now, Input::Contact { port, session: Some(session) });
        if is_certified {
            let died = Time::ZERO + Span::secs(1);
            cube.handle(
                now,
                Input::Order(Order::Condemn { port, session, epoch: HERE, finalized: false, died }),
            );
        }
        let way = Walk::new(from, &[step]).unwrap();
        cube.handle(now, Input::Order(Order::Call { epoch, until: now + lasts, way }));
        std::iter::from_fn(|| cube.poll()).find_map(|output| match output {
            Output::Act(action) => Some(action),
            _ => None,
        })
    }

    #[test]
    fn a_motion_over_the_dead_needs_a_certificate_and_a_landing_that_stays() {
        let (around, onto) = (step(MotionKind::Convex, false), step(MotionKind::Slide, true));
        let here = Cell::default();
        assert_eq!(first_motion(true, around, HERE, here), Some(around.motion));
        assert_eq!(first_motion(true, onto, HERE, here), Some(onto.motion));
        assert_eq!(first_motion(true, step(MotionKind::Slide, false), HERE, here), None);
        assert_eq!(first_motion(false, around, HERE, here), None, "the neighbour may be alive");
        assert_eq!(first_motion(true, around, HERE.next_goal(), here), None, "the call is for another goal");
        assert_eq!(first_motion(true, around, HERE, Cell::new(0, 0, 1)), None, "it begins elsewhere");
    }

    /// In a closed epoch a module moves only if it is called, and then it asks none; in others it asks its neighbour.
    #[test]
    fn a_module_moves_in_a_closed_epoch_when_it_is_called() {
        let seed = Cell::new(0, 9, 0);
        let goal = Goal::compile(&[seed, Cell::new(0, 10, 0)], seed, Growth::Solid).unwrap();
        let params = Params::scaled(Span::secs(1), Span::millis(10), 100);
        let step = step(MotionKind::Convex, false);
        let moves = |is_closed, is_called| {
            let mut cube = Cube::first(Setup { params: params.clone(), goals: vec![goal.clone()] });
            let (epoch, now) = (HERE.reopened().unwrap(), Time::ZERO + Span::secs(9));
            let until = now + Span::secs(5);
            let session = Some(Session(1));
            // The neighbour has not been heard, so it grants nothing.
            cube.handle(now, Input::Contact { port: Port(Face::Down as u8), session });
            cube.handle(now, Input::Order(Order::Goal(Opening { epoch, opened: now, is_closed })));
            let steering = Steering::GoTo(Cell::new(5, 0, 0));
            cube.handle(now, Input::Order(Order::Steer { steering, until }));
            if is_called {
                let way = Walk::new(Cell::default(), &[step]).unwrap();
                cube.handle(now, Input::Order(Order::Call { epoch, until, way }));
            }
            let actions = std::iter::from_fn(|| cube.poll()).filter_map(|output| match output {
                Output::Act(action) => Some((action.motion, action.not_after <= until)),
                _ => None,
            });
            actions.last()
        };
        assert_eq!(moves(true, true), Some((step.motion, true)));
        assert_eq!(moves(true, false), None);
        assert_eq!(moves(false, true), None, "others may move");
    }

    /// A module that is asked to carry a called one stays and keeps the cell free, and says so.
    #[test]
    fn carriers_stay_until_their_grant_ends() {
        let seed = Cell::new(0, 9, 0);
        let goal = Goal::compile(&[seed, Cell::new(0, 10, 0)], seed, Growth::Solid).unwrap();
        let params = Params::scaled(Span::secs(1), Span::millis(10), 100);
        let lasts = params.keep_for();
        let mut cube = Cube::first(Setup { params, goals: vec![goal] });
        let (mover, token, face, now) = (ModuleId(4), Token(1), Face::Up, Time::ZERO + Span::secs(9));
        let mut carries = |now, input| {
            cube.handle(now, input);
            let reports = std::iter::from_fn(|| cube.poll()).filter_map(|output| match output {
                Output::Report(status) => Some(status.carries),
                _ => None,
            });
            (reports.last(), cube.locks.reserved_for_other(face, ModuleId(5)))
        };
        let order = |epoch| Input::Order(Order::Carry { epoch, mover, token, face });
        assert_eq!(carries(now, order(HERE.next_goal())), (Some(None), None), "it is for another goal");
        assert_eq!(carries(now, order(HERE)), (Some(Some(token)), Some(mover)));
        let (port, release) = (Port(Face::East as u8), Message::Release { origin: mover, token });
        carries(now, Input::Contact { port, session: Some(Session(1)) });
        let after = carries(now, Input::Message { port, message: release });
        assert_eq!(after.1, Some(mover), "the attempt of the same number is the mover's own");
        assert_eq!(carries(now + lasts, Input::Wake), (Some(None), None));
    }

    /// A motion onto a module that the controller has asked starts before that module's grant ends, or not at all.
    #[test]
    fn a_vouched_motion_starts_before_the_call_ends() {
        let step = step(MotionKind::Slide, true);
        let until = |lasts| latest_start(step, Span::secs(lasts)).since(Time::ZERO + Span::secs(9));
        assert_eq!(until(2), Span::secs(2));
        assert!((Span::secs(2)..Span::secs(99)).contains(&until(99)), "it is the end of its own locks");
    }

    #[test]
    fn ways_are_bounded_and_checked() {
        let steps = vec![step(MotionKind::Convex, false); MAX_STEPS];
        let way = Walk::new(Cell::new(1, 2, 3), &steps).unwrap();
        assert_eq!(way.steps().collect::<Vec<Step>>(), steps);
        assert_eq!(Walk::new(Cell::default(), &[]), None);
        assert_eq!(Walk::new(Cell::default(), &[steps[0]; MAX_STEPS + 1]), None);
        let order = Order::Call { epoch: HERE, until: Time(2), way };
        assert!(order.wire_len() <= HEADER + PAYLOAD);
        // A heading along the support is no motion.
        let motion = Motion { heading: Face::Down, ..steps[0].motion };
        assert_eq!(Step::unpack(Step { motion, is_vouched: false }.pack()), None);
    }
}
