//! Recording wrappers around a world of cubes and a director: what of a run is written down, and in which order.

use super::world::CubeWorld;
use metamorph_kernel::director::port::DirectorPort;
use metamorph_kernel::kernel::recording::{Log, RecordedDirector, RecordedWorld};
use metamorph_kernel::world::World;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::cube::Cube;
use metamorph_protocol::cube::body::Move;
use metamorph_protocol::ids::{ModuleId, Revision};
use metamorph_protocol::lattice::{Cell, Face, Motion, MotionKind};
use metamorph_protocol::record::{Blob, Event, Record, Sink};
use metamorph_protocol::runtime::{Command, Sensed};
use metamorph_protocol::time::{Span, Time};
use std::sync::{Arc, Mutex};

#[derive(Default)]
struct Kept(Vec<Event>);

impl Sink for Kept {
    fn put(&mut self, record: &Record) {
        self.0.push(record.event.clone());
    }
    fn commit(&mut self) {}
}

/// Takes inputs of kind `known`.
struct Listening(Vec<Vec<u8>>);

impl DirectorPort<CubeWorld> for Listening {
    fn report(&mut self, _: Time, _: ModuleId, _: <Cube as Agent>::Report) {}
    fn died(&mut self, _: Time, _: ModuleId) {}
    fn started(&mut self, _: Time, _: ModuleId) {}
    fn wake(&mut self, _: Time, _: &mut CubeWorld) {}
    fn input(&mut self, _: Time, kind: &str, bytes: &[u8]) -> Result<(), String> {
        if kind != "known" {
            return Err(kind.to_owned());
        }
        self.0.push(bytes.to_owned());
        Ok(())
    }
    fn wake_at(&self) -> Time {
        Time::NEVER
    }
    fn poll(&mut self) -> Option<Command<<Cube as Agent>::Order>> {
        None
    }
}

#[test]
fn accepted_inputs_are_recorded() {
    let log = Arc::new(Mutex::new(Kept::default()));
    let mut director = RecordedDirector::new(Listening(Vec::new()), Log::new(log.clone()));
    assert_eq!(director.input(Time(1), "known", &[1, 2]), Ok(()));
    assert_eq!(director.input(Time(2), "other", &[3]), Err("other".to_owned()));
    assert_eq!(director.inner().0, [vec![1, 2]]);
    assert_eq!(log.lock().unwrap().0, [Event::Input { kind: "known".into(), bytes: vec![1, 2] }]);
}

/// Starts and ends of actions are in the records of inputs, in the order of the world, whenever it is
/// polled.
#[test]
fn starts_and_ends_of_actions_are_recorded() {
    let log = Arc::new(Mutex::new(Kept::default()));
    let cells = [[0, 0, 0], [1, 0, 0], [0, 0, 1]].map(Cell::from);
    let mut world = RecordedWorld::new(CubeWorld::new(&cells, Span::secs(1), 1), Log::new(log.clone()));
    let motion = Motion { kind: MotionKind::Slide, support: Face::Down, heading: Face::East };
    let action = Move { motion, not_after: Time::NEVER };
    let mover = ModuleId(2);
    let revision = Revision(1);
    world.act(Time::ZERO, mover, revision, &action);
    world.act(Time::ZERO, mover, revision, &action);
    world.advance(Time(999_999_999));
    world.advance(Time(1_000_000_000));
    let there = Blob::of(&Cell::new(1, 0, 1));
    let log = log.lock().unwrap();
    let seen = log.0.iter().map(|event| match event {
        Event::Act { id: ModuleId(2), begun, .. } => Ok(*begun),
        Event::Advance { ended } => Err(ended.clone()),
        other => panic!("{other:?}"),
    });
    assert_eq!(seen.collect::<Vec<_>>(), [Ok(true), Ok(false), Err(vec![(mover, there)])]);
    drop(log);
    let polled: Vec<_> = std::iter::from_fn(|| world.poll()).collect();
    let percepts = polled.iter().filter(|(_, sensed)| matches!(sensed, Sensed::Percept(_)));
    assert_eq!(percepts.count(), 2, "the refusal and the arrival");
}
