//! A debug build computes the attraction field and the beacons in two ways and compares the results. These tests cause
//! a difference on purpose, to show that the comparison detects it.

use super::control::Order;
use super::message::{Beacon, Entry, Message};
use super::params::{Params, Setup};
use super::{Cube, Percept};
use metamorph_core::agent::{Agent, Input};
use metamorph_core::goal::{Goal, Growth};
use metamorph_core::ids::{ModuleId, Port, Session};
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::time::{Span, Time};

fn beacon(sequence: u32, distance: u16) -> Beacon {
    let field = [Entry { distance, source: 80, version: 1 }; 4];
    Beacon { sequence, supports: Face::West.bit(), field, ..Beacon::first(ModuleId(1)) }
}

/// Returns a module that has heard a neighbour in the east and has sent its own beacons, and the time.
fn beside_one() -> (Cube, Time) {
    let seed = Cell::new(5, 0, 0);
    let setup = Setup {
        params: Params::scaled(Span::secs(1), Span::millis(10), 100),
        goals: vec![Goal::compile(&[seed], seed, Growth::Solid).expect("one cell is a goal")],
    };
    let mut cube = Cube::first(setup);
    for face in [Face::East, Face::North] {
        let (port, session) = (Port(face as u8), Some(Session(1)));
        cube.handle(Time::ZERO, Input::Contact { port, session });
    }
    hear(&mut cube, Time::ZERO, beacon(1, 32));
    let now = Time::ZERO + Span::secs(2);
    cube.handle(now, Input::<Message, Percept, Order>::Wake);
    (cube, now)
}

fn hear(cube: &mut Cube, now: Time, beacon: Beacon) {
    let (port, message) = (Port(Face::East as u8), Message::Beacon(beacon));
    cube.handle(now, Input::Message { port, message });
}

/// Lets a module hear a beacon without noting what is new in it.
fn hear_secretly(cube: &mut Cube, now: Time, beacon: Beacon) {
    let suspect = cube.own.params().suspect;
    cube.sides.hear(now, suspect, Face::East, beacon);
}

#[test]
fn news_is_followed() {
    let (mut cube, now) = beside_one();
    let before = cube.attraction(Face::Up).0;
    hear(&mut cube, now, beacon(2, 16));
    assert!(cube.attraction(Face::Up).0.distance < before.distance);
}

#[test]
#[should_panic = "a face was left alone and would change"]
fn a_face_that_is_wrongly_left_alone_is_seen() {
    let (mut cube, now) = beside_one();
    hear_secretly(&mut cube, now, beacon(2, 16));
    cube.attraction.invalidate_faces(0);
    cube.handle(now, Input::Wake);
}

#[test]
#[should_panic = "a beacon was not composed and would differ"]
fn a_beacon_that_is_wrongly_not_composed_is_seen() {
    let (mut cube, now) = beside_one();
    // The neighbour in the north is told of blocked corners.
    cube.planner.corners_seen[Face::North.index()] = 1;
    cube.beacons.invalidate_faces(0);
    cube.handle(now + Span::millis(500), Input::Wake);
}
