//! Protocols with known defects, and the invariants that find them: a test harness that cannot find a known
//! defect proves nothing about a sound protocol.

use metamorph_protocol::agent::{Agent, Birth, Input, InputOf, Output, OutputOf};
use metamorph_protocol::counters::Class;
use metamorph_protocol::cube::call::{Step, Walk};
use metamorph_protocol::cube::control::{Order, Status};
use metamorph_protocol::cube::epoch::{Epoch, Opening};
use metamorph_protocol::cube::params::Connectivity;
use metamorph_protocol::defects::Defect;
use metamorph_protocol::goal::Growth;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::{Cell, Face, Motion, MotionKind};
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use metamorph_protocol::wire::Never;
use metamorph_sim_bridge::cube::invariants::{
    BODY_CONNECTED, FIELD_LOOP_FREE, HOLDER_DESCENDS, MOVER_HAS_NO_DEPENDANTS, MOVER_SUPPORTED, MOVES_ALONE,
    PARENT_DESCENDS,
};
use metamorph_sim_bridge::cube::world::CubeWorld;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::kernel::sim::{Sim, SimConfig};
use metamorph_sim_bridge::kernel::still_world::StillWorld;
use metamorph_sim_bridge::testing::flood::Hops;
use metamorph_sim_bridge::world::invariants::Invariant;
use metamorph_sim_bridge::world::invariants::{MOVE_WITHIN_LEASE, SESSION_CURRENT, TIME_PASSES};
use metamorph_tests::growth::{Experiment, Ran, ball};
use std::collections::VecDeque;
use std::hash::Hasher;
use std::sync::Arc;

/// Runs an experiment with a defect for a few seeds until an invariant breaks.
fn breaks(invariant: Invariant, seeds: u64, vary: impl Fn(Experiment) -> Experiment) {
    let mut last: Option<Ran> = None;
    for seed in 1..=seeds {
        let mut experiment = vary(Experiment::slab_to_sphere(20, seed));
        experiment.until_broken = true;
        let ran = experiment.run();
        if ran.broke(invariant) {
            return;
        }
        last = Some(ran);
    }
    let seen = last.map(|r| (r.outcome, r.violations.first().cloned()));
    panic!("{invariant} did not break within {seeds} seeds; the last run: {seen:?}");
}

fn defect(mut experiment: Experiment, defect: Defect) -> Experiment {
    experiment.setup.params.defect = Some(defect);
    experiment
}

/// The connection gradient as published is not safe when messages are late.
#[test]
fn the_published_gradient_tears_the_body() {
    breaks(BODY_CONNECTED, 3, |mut e| {
        e.setup.params.connectivity = Connectivity::Gradient;
        e
    });
}

#[test]
fn without_sessions_late_messages_are_accepted() {
    breaks(SESSION_CURRENT, 3, |mut e| {
        e.ignore_sessions = true;
        e
    });
}

#[test]
fn without_a_deadline_a_stopped_module_moves_too_late() {
    breaks(MOVE_WITHIN_LEASE, 6, |e| defect(e.pauses(Span::secs(60)), Defect::NoDeadline));
}

#[test]
fn forgetting_silent_children_lets_parents_leave() {
    breaks(MOVER_HAS_NO_DEPENDANTS, 6, |e| defect(e.pauses(Span::secs(300)), Defect::DropSilentChildren));
}

#[test]
fn adopting_a_parent_that_has_not_agreed_is_found() {
    breaks(PARENT_DESCENDS, 6, |e| defect(e.loss("10%"), Defect::AdoptUnacknowledged));
}

/// A module that hangs on a dead one announces that it holds it.
#[test]
fn holding_the_dead_without_proof_is_found() {
    breaks(HOLDER_DESCENDS, 6, |e| defect(e.loss("10%").crashes(20), Defect::LetGoUnproved));
}

#[test]
fn leaving_in_spite_of_locks_is_found() {
    breaks(MOVER_SUPPORTED, 6, |e| defect(e, Defect::IgnoreLocks));
}

#[test]
fn accepting_old_distances_makes_circles() {
    breaks(FIELD_LOOP_FREE, 3, |e| defect(e, Defect::AcceptStaleValues));
}

/// A director that opens a closed epoch and calls two modules at the same time, without waiting for either.
struct CallsTwo(VecDeque<Command<Order>>);

impl DirectorPort<CubeWorld> for CallsTwo {
    fn report(&mut self, _: Time, _: ModuleId, _: Status) {}
    fn died(&mut self, _: Time, _: ModuleId) {}
    fn started(&mut self, _: Time, _: ModuleId) {}
    fn wake(&mut self, _: Time, _: &mut CubeWorld) {}
    fn wake_at(&self) -> Time {
        Time::NEVER
    }
    fn poll(&mut self) -> Option<Command<Order>> {
        self.0.pop_front()
    }
}

/// Modules at both ends of a row are called at once, in a closed epoch.
#[test]
fn calling_two_modules_at_once_is_found() {
    let row: Vec<Cell> = (0..5).map(|x| Cell::new(x, 0, 0)).collect();
    let experiment = Experiment::slab_to_sphere(4, 1);
    let epoch = Epoch::first(0).reopened().unwrap();
    let goal = Order::Goal(Opening { epoch, opened: Time::ZERO, is_closed: true });
    let call = |from: Cell, support, heading| {
        let motion = Motion { kind: MotionKind::Convex, support, heading };
        let way = Walk::new(from, &[Step { motion, is_vouched: false }]).unwrap();
        Order::Call { epoch, until: Time::ZERO + Span::secs(9), way }
    };
    let ids = || (0..row.len() as u32).map(ModuleId);
    let calls = [
        (ModuleId(0), call(row[0], Face::East, Face::Up)),
        (ModuleId(4), call(row[4], Face::West, Face::Up)),
    ];
    let orders = ids().map(|id| (id, goal)).chain(calls).map(|(id, order)| Command::Order(id, order));
    let director = CallsTwo(orders.collect());
    let config = SimConfig {
        setup: Arc::new(experiment.setup),
        link: LinkModel::default(),
        seed: 1,
        audit_every: Span::secs(9),
        ignore_sessions: false,
    };
    let mut sim = Sim::new(config, CubeWorld::new(&row, Span::secs(1), 1), director);
    sim.run_until(Time::ZERO + Span::secs(9));
    let broken: Vec<Invariant> = sim.violations().0.iter().map(|v| v.invariant).collect();
    assert!(broken.contains(&MOVES_ALONE), "{broken:?}");
}

/// The rule that suffices for scaffolds walls in cells of a solid.
#[test]
fn any_lower_neighbour_is_not_enough_for_solids() {
    let walled_in = (1..=3).any(|seed| {
        let mut experiment = Experiment::slab_to_sphere(20, seed);
        experiment.setup.goals = vec![ball(20, Growth::Solid)];
        !defect(experiment, Defect::AnyLowerOnSolids).run().built()
    });
    assert!(walled_in, "every solid was built by the wrong rule");
}

/// Answers every message.
struct Echo(Option<OutputOf<Echo>>);

impl Agent for Echo {
    type Setup = ();
    type Place = Cell;
    type Message = Hops;
    type Action = Never;
    type Percept = Never;
    type Order = Never;
    type Report = Hops;
    const PORTS: usize = 6;

    fn new(_: &Arc<()>, _: Birth<Cell>, _: Time) -> Echo {
        Echo(None)
    }
    fn handle(&mut self, _: Time, input: InputOf<Echo>) {
        let say = |port, hops| Some(Output::Send { port, class: Class::Seed, message: Hops(hops) });
        self.0 = match input {
            Input::Contact { port, .. } => say(port, 0),
            Input::Message { port, message } => say(port, message.0.wrapping_add(1)),
            _ => None,
        };
    }
    fn poll(&mut self) -> Option<OutputOf<Echo>> {
        self.0.take()
    }
    fn wake_at(&self) -> Time {
        Time::NEVER
    }
    fn digest(&self, _: &mut dyn Hasher) {}
}

/// A director that does nothing.
struct Bystander;

impl DirectorPort<StillWorld<Echo>> for Bystander {
    fn report(&mut self, _: Time, _: ModuleId, _: Hops) {}
    fn died(&mut self, _: Time, _: ModuleId) {}
    fn started(&mut self, _: Time, _: ModuleId) {}
    fn wake(&mut self, _: Time, _: &mut StillWorld<Echo>) {}
    fn wake_at(&self) -> Time {
        Time::NEVER
    }
    fn poll(&mut self) -> Option<Command<Never>> {
        None
    }
}

/// No time passes in such a run, so it could not be stopped from outside.
#[test]
fn answers_without_end_end_a_run() {
    let ran = |delay: Span| {
        let link = LinkModel { delay_min: delay, delay_max: delay, ..LinkModel::default() };
        let audit_every = Span::secs(1);
        let config = SimConfig { setup: Arc::new(()), link, seed: 1, audit_every, ignore_sessions: false };
        let mut sim = Sim::new(config, StillWorld::<Echo>::new([2, 2, 1]), Bystander);
        let over = sim.run_until(Time::ZERO + Span::secs(2));
        (over, sim.violations().0.iter().map(|v| v.invariant).collect::<Vec<_>>())
    };
    assert_eq!(ran(Span::millis(1)), (false, vec![]));
    assert_eq!(ran(Span::ZERO), (true, vec![TIME_PASSES]));
}
