//! The election in the world of cubes, where the same protocol written in Python (`deploy/python/examples`) makes the
//! same run: its test has the same hashes.

use metamorph_protocol::agent::{Agent, Birth, Input, InputOf, Output, OutputOf};
use metamorph_protocol::cube::body::{Move, Percept};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use metamorph_protocol::wire::Never;
use metamorph_sim_bridge::cube::bodies::CubeBodies;
use metamorph_sim_bridge::cube::world::CubeWorld;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::kernel::sim::{Sim, SimConfig};
use metamorph_tutorial::leader::{Leader, Lowest, Setup};
use std::hash::Hasher;
use std::sync::Arc;

/// The agent of the tutorial in the body of a cube, which it never moves.
struct InCube(Leader);

impl Agent for InCube {
    type Setup = Setup;
    type Place = Cell;
    type Message = Lowest;
    type Action = Move;
    type Percept = Percept;
    type Order = Never;
    type Report = Lowest;
    const PORTS: usize = 6;

    fn new(setup: &Arc<Setup>, birth: Birth<Cell>, now: Time) -> InCube {
        InCube(Leader::new(setup, birth, now))
    }
    fn handle(&mut self, now: Time, input: InputOf<InCube>) {
        let input = match input {
            Input::Contact { port, session } => Input::Contact { port, session },
            Input::Message { port, message } => Input::Message { port, message },
            Input::Wake => Input::Wake,
            Input::Percept(percept) => panic!("nothing moves: {percept:?}"),
            Input::Order(never) => match never {},
        };
        self.0.handle(now, input);
    }
    fn poll(&mut self) -> Option<OutputOf<InCube>> {
        Some(match self.0.poll()? {
            Output::Send { port, class, message } => Output::Send { port, class, message },
            Output::Report(report) => Output::Report(report),
            Output::Act(never) => match never {},
        })
    }
    fn wake_at(&self) -> Time {
        self.0.wake_at()
    }
    fn digest(&self, hasher: &mut dyn Hasher) {
        self.0.digest(hasher);
    }
}

/// Ends the run when all modules name module 0.
struct Agreed {
    named: Vec<Option<ModuleId>>,
    finish: Option<Command<Never>>,
}

impl DirectorPort<CubeBodies<InCube>> for Agreed {
    fn report(&mut self, _: Time, id: ModuleId, Lowest(lowest): Lowest) {
        self.named[id.index()] = Some(lowest);
        if self.named.iter().all(|named| *named == Some(ModuleId(0))) {
            self.finish = Some(Command::Finish);
        }
    }
    fn died(&mut self, _: Time, _: ModuleId) {}
    fn started(&mut self, _: Time, _: ModuleId) {}
    fn wake(&mut self, _: Time, _: &mut CubeBodies<InCube>) {}
    fn wake_at(&self) -> Time {
        Time::NEVER
    }
    fn poll(&mut self) -> Option<Command<Never>> {
        self.finish.take()
    }
}

#[test]
fn the_election_in_cubes_has_the_hashes_of_its_twin_in_python() {
    for (loss, hash) in
        [(Ratio::ZERO, "b10d646b43a185e1"), (Ratio::new(1, 20).expect("a probability"), "9fac05619f5dba9f")]
    {
        let cells: Vec<Cell> = (0..10).flat_map(|x| (0..10).map(move |y| Cell::new(x, y, 0))).collect();
        let world = CubeBodies::new(CubeWorld::new(&cells, Span::secs(1), 1));
        let config = SimConfig {
            setup: Arc::new(Setup { repeat: Span::millis(500) }),
            link: LinkModel {
                delay_min: Span::millis(10),
                delay_max: Span::millis(50),
                loss,
                ..LinkModel::default()
            },
            seed: 1,
            audit_every: Span::secs(20),
            ignore_sessions: false,
        };
        let mut sim = Sim::new(config, world, Agreed { named: vec![None; 100], finish: None });
        assert!(sim.run_until(Time(60_000_000_000)), "they did not agree within a minute");
        assert_eq!(format!("{:016x}", sim.trace().value()), hash, "loss {loss}");
        assert_eq!(sim.violations().1, 0);
    }
}
