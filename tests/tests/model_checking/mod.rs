//! Small swarms of cubes, checked exhaustively within stated bounds: the real agents in the real world, and
//! every run with a given number of faults. `model.rs` states what that covers.
//!
//! The quick tests take seconds; the larger ones are run with `cargo test -p metamorph-tests
//! model_checking:: -- --ignored --nocapture`. Each prints the number of states visited.

mod controller;
mod model;

use controller::Controller;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::cube::Cube;
use metamorph_protocol::cube::control::{Order, Status};
use metamorph_protocol::cube::epoch::Epoch;
use metamorph_protocol::cube::message::Role;
use metamorph_protocol::cube::params::{Connectivity, Params, Setup};
use metamorph_protocol::defects::Defect;
use metamorph_protocol::goal::{Goal, Growth};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::{Cell, Face};
use metamorph_protocol::metamodule::Metamodule;
use metamorph_protocol::metamodule::blueprint::{Blueprint, Seed, SeedOrder};
use metamorph_protocol::metamodule::params::{Floor, Strategy};
use metamorph_protocol::metamodule::start::random_start;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::cube::diagnosis::Known;
use metamorph_sim_bridge::cube::registrar::Registrar;
use metamorph_sim_bridge::cube::world::CubeWorld;
use metamorph_sim_bridge::kernel::audited::Audited;
use metamorph_sim_bridge::metamodule::world::MetamoduleWorld;
use metamorph_sim_bridge::world::World;
use metamorph_tests::metamodules::{Assembly, Goal as Shape};
use model::{BUILT, BUILT_IN_TIME, Bounds, Budget, SAFE, SwarmModel};
use stateright::{Checker, HasDiscoveries, Model};
use std::collections::VecDeque;
use std::hash::Hash;
use std::sync::Arc;

/// The duration of a move in units of a twentieth of a move, which is the unit of all times here.
const MOVE: Span = Span(20);
const DELAY: Span = Span(4);

/// Returns a model of `count` metamodules on a small floor, and as many upright seeds in a row.
fn metamodules_of(count: u8, strategy: Strategy, budget: Budget) -> SwarmModel<MetamoduleWorld> {
    let seed = |i: u8| Seed { foot: (2, 1 + 2 * i16::from(i)), directions: [Face::Up; 3] };
    let levels: Vec<Vec<Seed>> = (0..count).map(|i| vec![seed(i)]).collect();
    let assembly = Assembly::new(Shape::Box, Kind::Srs, strategy, SeedOrder::AtOnce, 1).decentralised();
    let mut setup = (*assembly.setup).clone();
    setup.floor = Floor { min: (0, 0), max: (6, 6) };
    setup.goals = vec![Blueprint::new(&levels, SeedOrder::AtOnce).expect("invariant: the seeds are sound")];
    let start = random_start(&setup, count.into(), 1).expect("invariant: the floor has room");
    let setup = Arc::new(setup);
    let params = setup.params;
    SwarmModel {
        controller: (),
        world: MetamoduleWorld::new(Arc::clone(&setup), &start, 1),
        setup,
        seed: 1,
        bounds: Bounds {
            budget,
            delay: Span::millis(50),
            late: vec![params.turn_time, params.lease],
            pauses: vec![params.turn_time, params.lease],
            horizon: Time::ZERO + params.lease * 20,
            dead: None,
        },
        done: |metamodule: &Metamodule| metamodule.settled().is_some(),
        needed: count.into(),
    }
}

/// A controller that certifies the deaths of cubes and forwards which modules hold the dead.
#[derive(Clone, Hash)]
struct Certifying {
    registrar: Registrar,
    known: Vec<Known>,
    seed: Cell,
}

impl Controller<CubeWorld> for Certifying {
    fn died(&mut self, now: Time, id: ModuleId) {
        self.known[id.index()].alive = false;
        self.registrar.died(now, id);
    }
    fn started(&mut self, id: ModuleId) {
        self.known[id.index()] = Known { alive: true, restarted: true, status: None };
        self.registrar.started(id);
    }
    fn report(&mut self, id: ModuleId, report: &Status) {
        self.known[id.index()].status = Some(*report);
        self.registrar.has_news(id, report);
    }
    fn orders(&mut self, now: Time, world: &CubeWorld) -> Vec<(ModuleId, Order)> {
        let mut commands = VecDeque::new();
        self.registrar.tell(now, world, &self.known, Epoch::default(), self.seed, &mut commands);
        let orders = commands.into_iter().filter_map(|command| match command {
            Command::Order(id, order) => Some((id, order)),
            _ => None,
        });
        orders.collect()
    }
}

/// Returns the same model with a controller.
fn certified(model: SwarmModel<CubeWorld>) -> SwarmModel<CubeWorld, Certifying> {
    let SwarmModel { controller: (), setup, world, seed, bounds, done, needed } = model;
    let known = vec![Known { alive: true, ..Known::default() }; world.len()];
    let registrar = Registrar::default();
    let controller = Certifying { registrar, known, seed: setup.goals[0].seed() };
    SwarmModel { controller, setup, world, seed, bounds, done, needed }
}

/// Returns a model of cubes in the start cells that are to fill the goal cells; the first of these is the
/// seed.
fn cubes(start: &[[i16; 3]], goal: &[[i16; 3]], budget: Budget) -> SwarmModel<CubeWorld> {
    let seed = Cell::from(goal[0]);
    let mut cells: Vec<Cell> = goal.iter().copied().map(Cell::from).collect();
    cells.sort_unstable();
    let setup = Setup {
        params: Params::scaled(MOVE, DELAY, 32),
        goals: vec![Goal::compile(&cells, seed, Growth::Solid).expect("invariant: the goal is connected")],
    };
    let start: Vec<Cell> = start.iter().copied().map(Cell::from).collect();
    SwarmModel {
        controller: (),
        setup: Arc::new(setup),
        world: CubeWorld::new(&start, MOVE, 1),
        seed: 1,
        bounds: Bounds {
            budget,
            delay: DELAY,
            // Less than a move, more than one, and longer than a grant lasts.
            late: vec![Span(7), Span(31), Span(171)],
            pauses: vec![Span(31), Span(171)],
            horizon: Time(2_000),
            dead: None,
        },
        done: |cube: &Cube| cube.role() == Role::Final,
        needed: goal.len(),
    }
}

/// The relevant results of an exploration.
struct Found {
    complete: bool,
    unsafe_run: Option<String>,
    late_run: Option<String>,
    built: bool,
}

/// Explores breadth first, so that the run found is a shortest one; up to `most` states.
#[allow(clippy::print_stdout, reason = "the counts are a result of the test")]
fn explore<W, C>(name: &str, model: SwarmModel<W, C>, most: usize) -> Found
where
    W: Audited + Clone + Hash + Send + Sync + 'static,
    W::Agent: Clone + Hash + Send + Sync,
    C: Controller<W> + 'static,
    <W::Agent as Agent>::Message: Hash + Send + Sync,
    <W::Agent as Agent>::Order: Hash + Send + Sync,
    <W::Agent as Agent>::Percept: Send + Sync,
{
    let budget = model.bounds.budget;
    let checker = model
        .checker()
        .target_state_count(most)
        .finish_when(HasDiscoveries::AnyOf([SAFE].into()))
        .spawn_bfs()
        .join();
    let run = |property| {
        checker.discovery(property).map(|path| {
            let (end, steps) = (path.last_state().clone(), path.into_actions());
            format!("{end:?} after {steps:?}")
        })
    };
    let found = Found {
        complete: checker.state_count() < most,
        unsafe_run: run(SAFE),
        late_run: run(BUILT_IN_TIME),
        built: checker.discovery(BUILT).is_some(),
    };
    let (unique, all, depth) = (checker.unique_state_count(), checker.state_count(), checker.max_depth());
    println!("{name}: {unique} states, {all} steps, depth {depth}, {budget:?}");
    found
}

/// Asserts that every run within the budget is safe, and builds the goal in time unless a module crashed.
fn holds<W, C>(name: &str, model: SwarmModel<W, C>)
where
    W: Audited + Clone + Hash + Send + Sync + 'static,
    W::Agent: Clone + Hash + Send + Sync,
    C: Controller<W> + 'static,
    <W::Agent as Agent>::Message: Hash + Send + Sync,
    <W::Agent as Agent>::Order: Hash + Send + Sync,
    <W::Agent as Agent>::Percept: Send + Sync,
{
    let found = explore(name, model, 5_000_000);
    assert_eq!(found.unsafe_run, None, "{name}");
    assert_eq!(found.late_run, None, "{name}");
    assert!(found.built && found.complete, "{name}");
}

const PAIR: [[i16; 3]; 2] = [[0, 0, 0], [1, 0, 0]];
/// Two modules on either side of the seed, for one cell above it.
const RIVALS: [[i16; 3]; 3] = [[0, 0, 0], [1, 0, 0], [-1, 0, 0]];
const ROW: [[i16; 3]; 3] = [[0, 0, 0], [1, 0, 0], [2, 0, 0]];
const PLATE: [[i16; 3]; 4] = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]];
const TWO_HIGH: [[i16; 3]; 2] = [[0, 0, 0], [0, 0, 1]];
const TOWER: [[i16; 3]; 3] = [[0, 0, 0], [0, 0, 1], [0, 0, 2]];

fn budget(set: impl Fn(&mut Budget)) -> Budget {
    let mut budget = Budget::default();
    set(&mut budget);
    budget
}

fn change<C>(mut model: SwarmModel<CubeWorld, C>, set: impl Fn(&mut Params)) -> SwarmModel<CubeWorld, C> {
    set(&mut Arc::make_mut(&mut model.setup).params);
    model
}

#[test]
fn lost_messages() {
    holds("a pair", cubes(&PAIR, &TWO_HIGH, budget(|b| b.lost = 3)));
    holds("rivals", cubes(&RIVALS, &TWO_HIGH, budget(|b| b.lost = 2)));
    holds("a row", cubes(&ROW, &TOWER, budget(|b| b.lost = 1)));
    holds("a plate", cubes(&PLATE, &TOWER, budget(|b| b.lost = 1)));
}

#[test]
fn doubled_and_late_messages() {
    holds("a pair", cubes(&PAIR, &TWO_HIGH, budget(|b| (b.lost, b.doubled, b.late) = (1, 0, 1))));
    holds("rivals", cubes(&RIVALS, &TWO_HIGH, budget(|b| b.late = 1)));
    holds("a row", cubes(&ROW, &TOWER, budget(|b| b.late = 1)));
    holds("a row", cubes(&ROW, &TOWER, budget(|b| b.doubled = 1)));
}

#[test]
fn stopped_and_crashed_processes() {
    holds("a row", cubes(&ROW, &TOWER, budget(|b| b.paused = 1)));
    holds("a row", cubes(&ROW, &TOWER, budget(|b| b.crashed = 1)));
    holds("rivals", cubes(&RIVALS, &TWO_HIGH, budget(|b| (b.crashed, b.restarted) = (1, 1))));
}

/// A dead module stays held, whenever it dies and its neighbours hear of it.
#[test]
fn custody_of_the_dead() {
    holds("a row", certified(cubes(&ROW, &TOWER, budget(|b| b.crashed = 1))));
    holds("a plate", certified(cubes(&PLATE, &TOWER, budget(|b| b.crashed = 1))));
}

/// Four modules, of which the second has just died: the first is the seed below it, and the others touch the dead one only. One
/// stands on it and slides onto the other on its way down, which may leave as well.
fn around_the_dead(budget: Budget) -> SwarmModel<CubeWorld, Certifying> {
    let start = [[0, 0, -1], [0, 0, 0], [1, 0, 0], [0, 0, 1]];
    let goal = [[0, 0, -1], [1, 0, -1], [2, 0, -1]];
    let mut model = change(cubes(&start, &goal, budget), |p| {
        // As short as they may be: a beacon comes in time, and a slide begins soon after the death.
        p.suspect = p.heartbeat + DELAY * 2;
        p.survey_after = MOVE;
    });
    model.bounds.dead = Some((ModuleId(1), Time(1), Time(12)));
    model.bounds.pauses = (1..=10).map(|i| MOVE * i).chain([Span(400)]).collect();
    certified(model)
}

/// A slide from a dead module ends on one that stays, although it was not asked: also if a process is stopped or restarted, or
/// an order is late.
#[test]
fn surveys_over_the_dead() {
    for budget in [budget(|b| b.paused = 1), budget(|b| b.restarted = 1), budget(|b| b.late = 1)] {
        let found = explore("around the dead", around_the_dead(budget), 5_000_000);
        assert_eq!(found.unsafe_run, None);
        assert!(found.built && found.complete);
    }
}

/// Without turns, the module that is landed on leaves meanwhile; with one colour, it slides away in the same slot.
#[test]
fn missing_turns_are_found() {
    for defect in [Defect::IgnoreTurns, Defect::OneColour] {
        let model = around_the_dead(budget(|b| b.paused = 1));
        let found = explore(&format!("{defect:?}"), change(model, |p| p.defect = Some(defect)), 200_000);
        let run = found.unsafe_run.expect("the checker does not see that the landing leaves");
        println!("{run}");
    }
}

/// Metamodules and as many seeds, without a controller.
#[test]
fn metamodules() {
    let negotiated = |count, budget| metamodules_of(count, Strategy::Negotiated, budget);
    holds("two metamodules", negotiated(2, budget(|b| b.lost = 2)));
    holds("two metamodules", negotiated(2, budget(|b| (b.late, b.doubled) = (1, 1))));
    holds("two metamodules", negotiated(2, budget(|b| b.paused = 1)));
    holds("three metamodules", negotiated(3, budget(|b| b.lost = 1)));
}

/// The thesis's strategies guarantee safety only; they may come to a standstill.
#[test]
fn the_force_field_is_safe() {
    for strategy in Strategy::PUBLISHED {
        let found = explore(strategy.name(), metamodules_of(2, strategy, budget(|b| b.lost = 2)), 20_000);
        assert_eq!(found.unsafe_run, None);
        assert!(found.complete && (found.built || found.late_run.is_some()));
    }
}

/// The connection gradient as published is torn by one crash among four.
#[test]
fn the_published_gradient_is_found_wrong() {
    let model = cubes(&PLATE, &TOWER, budget(|b| b.crashed = 1));
    let found = explore("gradient", change(model, |p| p.connectivity = Connectivity::Gradient), 20_000);
    let run = found.unsafe_run.expect("the checker does not see a body torn");
    assert!(run.contains("body-connected"), "{run}");
    holds("the same with the forest", cubes(&PLATE, &TOWER, budget(|b| b.crashed = 1)));
}

/// A stopped module moves after the grants that it relies on have ended.
#[test]
fn a_missing_deadline_is_found() {
    let model =
        change(cubes(&ROW, &TOWER, budget(|b| b.paused = 1)), |p| p.defect = Some(Defect::NoDeadline));
    let found = explore("no deadline", model, 20_000);
    let run = found.unsafe_run.expect("the checker does not see a late move");
    assert!(run.contains("move-within-lease"), "{run}");
}

/// The same with orders that overtake each other, and with modules that are started again.
#[test]
#[ignore = "minutes"]
fn custody_with_larger_budgets() {
    holds("a row", certified(cubes(&ROW, &TWO_HIGH, budget(|b| (b.crashed, b.restarted) = (1, 1)))));
    holds("a row", certified(cubes(&ROW, &TWO_HIGH, budget(|b| (b.crashed, b.late) = (1, 1)))));
    holds("a row", certified(cubes(&ROW, &TWO_HIGH, budget(|b| b.crashed = 2))));
    holds("a plate", certified(cubes(&PLATE, &TWO_HIGH, budget(|b| b.crashed = 2))));
    holds("a plate", certified(cubes(&PLATE, &TWO_HIGH, budget(|b| (b.crashed, b.lost) = (1, 1)))));
}

#[test]
#[ignore = "minutes"]
fn larger_budgets() {
    holds("a pair", cubes(&PAIR, &TWO_HIGH, budget(|b| (b.lost, b.doubled, b.late) = (1, 1, 1))));
    holds("rivals", cubes(&RIVALS, &TWO_HIGH, budget(|b| (b.lost, b.doubled, b.late) = (1, 1, 1))));
    holds("a row", cubes(&ROW, &TOWER, budget(|b| b.lost = 3)));
    holds("a row", cubes(&ROW, &TOWER, budget(|b| b.late = 2)));
    holds("a row", cubes(&ROW, &TOWER, budget(|b| (b.paused, b.lost) = (1, 1))));
    holds("a plate", cubes(&PLATE, &TOWER, budget(|b| b.late = 1)));
    holds("a plate", cubes(&PLATE, &TOWER, budget(|b| b.paused = 1)));
    holds("a plate", cubes(&PLATE, &TOWER, budget(|b| (b.crashed, b.restarted) = (1, 1))));
}
