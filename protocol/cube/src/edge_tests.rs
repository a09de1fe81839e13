//! A support tells the walkers on it which cells over its edges are taken. These tests show that they are told in time, and
//! that a walker who was not told loses no more than a back-off.

use super::Cube;
use super::message::{Ask, Beacon, Denial, Entry, Message, RequestId, Role};
use super::params::{Params, Setup};
use super::route::Route;
use metamorph_core::agent::{Agent, Input, Output};
use metamorph_core::goal::{Goal, Growth};
use metamorph_core::ids::{ModuleId, Port, Session, Token};
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::time::{Span, Time};

/// The walker that is told.
const TOLD: Face = Face::West;
/// The cell over the edge.
const CORNER: Face = Face::Up;

struct Bench {
    cube: Cube,
    now: Time,
    heard: u32,
}

impl Bench {
    fn new() -> Bench {
        let seed = Cell::new(9, 0, 0);
        let setup = Setup {
            params: Params::scaled(Span::secs(1), Span::millis(10), 100),
            goals: vec![Goal::compile(&[seed], seed, Growth::Solid).unwrap()],
        };
        Bench { cube: Cube::first(setup), now: Time::ZERO, heard: 0 }
    }

    fn contact(&mut self, face: Face, begins: bool) {
        let session = begins.then_some(Session(1));
        self.cube.handle(self.now, Input::Contact { port: Port(face as u8), session });
    }

    fn says(&mut self, face: Face, message: Message) {
        self.cube.handle(self.now, Input::Message { port: Port(face as u8), message });
    }

    /// Lets a neighbour send a beacon.
    fn hears(&mut self, face: Face, set: impl Fn(&mut Beacon)) {
        self.heard += 1;
        let mut beacon = Beacon { sequence: self.heard, ..Beacon::first(ModuleId(1 + face as u32)) };
        set(&mut beacon);
        self.says(face, Message::Beacon(beacon));
    }

    /// Lets a walker arrive on a face.
    fn carries(&mut self, face: Face) {
        self.contact(face, true);
        self.hears(face, |b| (b.role, b.supported_here) = (Role::Walker, true));
    }

    /// Lets time pass, and returns what the last beacon over a face said about cells over edges.
    fn tells(&mut self, face: Face) -> Option<u8> {
        self.now += self.cube.own.params().heartbeat;
        self.cube.handle(self.now, Input::Wake);
        self.told(face)
    }

    /// Returns what the last beacon over a face said about cells over edges, since the module was last asked.
    fn told(&mut self, face: Face) -> Option<u8> {
        let outputs = std::iter::from_fn(|| self.cube.poll());
        let told = outputs.filter_map(|output| match output {
            Output::Send { port, message: Message::Beacon(b), .. } if port == Port(face as u8) => {
                Some(b.taken)
            }
            _ => None,
        });
        told.last()
    }

    /// Returns the latest request that the module has sent, if there is any.
    fn asked(&mut self) -> Option<(RequestId, Route)> {
        self.cube.sent().into_iter().rev().find_map(|(_, message)| match message {
            Message::Request { id, route, .. } => Some((id, route)),
            _ => None,
        })
    }
}

#[test]
fn walkers_are_told_of_others_over_the_edge() {
    let mut bench = Bench::new();
    bench.carries(TOLD);
    assert_eq!(bench.tells(TOLD), Some(0));
    bench.carries(CORNER);
    assert_eq!(bench.tells(TOLD), Some(CORNER.bit()));
    assert_eq!(bench.tells(TOLD), Some(CORNER.bit()), "a lost beacon is repeated");
    bench.contact(CORNER, false);
    assert_eq!(bench.tells(TOLD), Some(0));
}

/// A walker decides when it hears the first beacon at a new place.
#[test]
fn newcomers_are_told_with_the_first_beacon() {
    let mut bench = Bench::new();
    bench.carries(CORNER);
    bench.tells(TOLD);
    bench.contact(TOLD, true);
    assert_eq!(bench.told(TOLD), Some(CORNER.bit()));
}

/// Nothing is gained by waiting for a walker that cannot move on; and a module in reserve plans no motion in such a hurry.
#[test]
fn only_walkers_are_told_and_only_of_those_that_move_on() {
    let mut bench = Bench::new();
    bench.carries(TOLD);
    bench.contact(CORNER, true);
    bench.hears(CORNER, |b| (b.role, b.immobile) = (Role::Walker, true));
    assert_eq!(bench.tells(TOLD), Some(0));
    bench.hears(CORNER, |b| b.role = Role::Walker);
    assert_eq!(bench.tells(TOLD), Some(CORNER.bit()));
    bench.hears(TOLD, |b| b.role = Role::Reserve);
    assert_eq!(bench.tells(TOLD), Some(0));
}

#[test]
fn walkers_are_told_of_reservations_for_others() {
    let told = |origin: Face| {
        let mut bench = Bench::new();
        bench.carries(TOLD);
        bench.carries(Face::East);
        let id = RequestId { origin: ModuleId(1 + origin as u32), token: Token(1), number: 0 };
        let route = Route::new(&[origin.opposite()]).unwrap();
        let ask = Ask::Reserve(CORNER);
        bench.says(origin, Message::Request { id, age: Span::ZERO, hop: 1, ask, route });
        let before = bench.tells(TOLD);
        bench.says(origin, Message::Release { origin: id.origin, token: id.token });
        (before, bench.tells(TOLD))
    };
    assert_eq!(told(Face::East), (Some(CORNER.bit()), Some(0)));
    assert_eq!(told(TOLD), (Some(0), Some(0)), "its own reservation is not in its way");
}

/// Returns a walker on a support below it, from which a distance is known in every direction.
fn walker() -> Bench {
    let mut bench = Bench::new();
    bench.contact(Face::Down, true);
    (bench.cube.own.role, bench.cube.own.support) = (Role::Walker, Some(Face::Down));
    bench
}

/// Tells a walker which cells over the edges of its support are taken.
fn tell(bench: &mut Bench, taken: u8) {
    bench.hears(Face::Down, |b| {
        (b.taken, b.field) = (taken, [Entry { distance: 32, source: 80, version: 1 }; 4]);
    });
}

#[test]
fn a_walker_asks_when_it_is_told_that_a_cell_is_free() {
    let mut bench = walker();
    tell(&mut bench, super::attraction::beside(Face::Down));
    assert_eq!(bench.asked(), None);
    // It has not been denied, so it does not back off.
    tell(&mut bench, super::attraction::beside(Face::Down) & !Face::East.bit());
    assert!(bench.asked().is_some());
}

/// Denies a walker the cell that it has asked for.
fn deny(bench: &mut Bench) {
    let Some((id, route)) = bench.asked() else { unreachable!("it asks for a free cell") };
    let (denial, blocker) = (Some(Denial::Occupied), Some(ModuleId(9)));
    bench.says(Face::Down, Message::Response { id, hop: 0, denial, blocker, co_owners: 0, route });
}

/// A walker that was denied a cell asks for it as soon as it is told that it is free.
#[test]
fn a_walker_backs_off_no_longer_than_the_cell_is_taken() {
    let mut bench = walker();
    tell(&mut bench, 0);
    deny(&mut bench);
    tell(&mut bench, super::attraction::beside(Face::Down));
    assert_eq!(bench.asked(), None);
    tell(&mut bench, super::attraction::beside(Face::Down) & !Face::East.bit());
    assert!(bench.asked().is_some());
}

/// A walker that has not been told that a cell is taken is denied it, and asks again after a back-off.
#[test]
fn a_lost_hint_costs_a_back_off() {
    let mut bench = walker();
    tell(&mut bench, 0);
    deny(&mut bench);
    assert_eq!(bench.asked(), None);
    let longest = bench.now + bench.cube.own.params().longest_back_off();
    while bench.asked().is_none() {
        bench.now = bench.cube.wake_at();
        assert!(bench.now <= longest, "it does not ask again");
        bench.cube.handle(bench.now, Input::Wake);
    }
}
