//! Tests of the messages: every one survives the wire, and garbage is refused.

use super::*;
use crate::body::{Move, Percept, Refusal};
use crate::call::{Step, Walk};
use crate::control::{CustodyAnnouncement, CustodyKey, Order, Status};
use crate::epoch::{Epoch, Opening};
use crate::route::MAX_HOPS;
use crate::steering::Steering;
use metamorph_core::counters::Class;
use metamorph_core::ids::{Incarnation, Port, Session};
use metamorph_core::lattice::{Cell, Motion, MotionKind};
use metamorph_core::time::Time;
use metamorph_core::wire::{Channel, Frame, HEADER, Header, PAYLOAD, Wire};
use proptest::prelude::*;

fn header() -> Header {
    Header {
        channel: Channel::Peer,
        kind: 0,
        class: Class::Connectivity,
        port: Port(1),
        incarnation: Incarnation(0),
        source: ModuleId(1),
        destination: ModuleId(2),
        session: 3,
        sequence: 4,
    }
}

fn beacon() -> Beacon {
    let entry = |i: u16| Entry { distance: i, source: u32::from(i) << 8, version: i + 1 };
    Beacon {
        id: ModuleId(0x0102_0304),
        sequence: 5,
        epoch: Epoch::first(1),
        role: Role::Reserve,
        attached: true,
        immobile: false,
        supported_here: true,
        wants_you: false,
        quarantined: true,
        knows_of_death: true,
        spoken: 0x1011,
        final_hops: 3,
        supports: 0b11_0101,
        finals: 0b00_0001,
        filled: 0b00_0011,
        dead: 0b01_0010,
        fixed: 0b00_0010,
        rank: Rank { rooted: Time(0x0C0D), label: 0x0A0B },
        renew: Time(0x0E0F),
        claim: Claim::Parent(Token(0xAABB_CCDD)),
        ack: Some(Token(7)),
        corners: 0b10_0000,
        taken: 0b01_1000,
        subtree: 9,
        field: [entry(1), entry(2), entry(3), Entry::NONE],
    }
}

fn samples() -> Vec<Message> {
    let id = RequestId { origin: ModuleId(9), token: Token(8), number: 7 };
    let route = Route::new(&[Face::Up, Face::West, Face::North]).unwrap();
    let longest = Route::new(&[Face::Down; MAX_HOPS]).unwrap();
    vec![
        Message::Beacon(beacon()),
        Message::Beacon(Beacon { claim: Claim::None, ack: None, role: Role::Final, ..beacon() }),
        Message::Request { id, age: Span(5), hop: 1, ask: Ask::Lock, route: longest },
        Message::Request { id, age: Span(5), hop: 3, ask: Ask::Reserve(Face::South), route },
        Message::Response {
            id,
            hop: 2,
            denial: Some(Denial::Younger),
            blocker: Some(ModuleId(3)),
            co_owners: 0b1100,
            route,
        },
        Message::Response { id, hop: 0, denial: None, blocker: None, co_owners: 0, route },
        Message::Release { origin: ModuleId(9), token: Token(8) },
        Message::Search { id, ttl: 22, dead: 0b10_0001, route, number: 9 },
        Message::Found { id, hop: 2, reached: Reached::Neighbour(Face::East), route, number: 8 },
        Message::Found { id, hop: 1, reached: Reached::Dead(Face::Down), route, number: 7 },
        Message::Found { id, hop: 0, reached: Reached::Root, route: longest, number: u16::MAX },
        Message::Heard { number: 0x1234 },
    ]
}

#[test]
fn every_message_survives_the_wire_and_knows_its_length() {
    for message in samples() {
        let frame = Frame::seal(header(), &message);
        assert!(frame.open().is_ok());
        assert_eq!(frame.message::<Message>(), Ok(message));
        assert_eq!(frame.wire_len(), message.wire_len(), "{message:?}");
    }
    for percept in [Percept::Arrived(Cell::new(1, 2, 3)), Percept::Failed, Percept::Refused(Refusal::Late)] {
        assert_eq!(Frame::seal(header(), &percept).message::<Percept>(), Ok(percept));
    }
    let condemn = Order::Condemn {
        port: Port(5),
        session: Session(6),
        epoch: Epoch::first(1),
        finalized: true,
        died: Time(8),
    };
    let custody = CustodyAnnouncement {
        dead: Cell::new(1, -2, 3),
        died: Time(9),
        epoch: Epoch::first(1),
        holder: CustodyKey::new(Cell::new(1, -2, 4), false, Time(9), Cell::new(0, 0, 0)),
    };
    let steer = |steering| Order::Steer { steering, until: Time(9) };
    let commands = [Steering::Release, Steering::Hold, Steering::GoTo(Cell::new(-1, 2, 3))].map(steer);
    let step = Step {
        motion: Motion { kind: MotionKind::Slide, support: Face::Up, heading: Face::North },
        is_vouched: true,
    };
    let way = Walk::new(Cell::new(-1, 0, 2), &[step; 3]).unwrap();
    let call = Order::Call { epoch: Epoch::first(1), until: Time(9), way };
    let carry =
        Order::Carry { epoch: Epoch::first(1), mover: ModuleId(7), token: Token(8), face: Face::West };
    let again = Opening { epoch: Epoch::first(3).reopened().unwrap(), opened: Time(8), is_closed: true };
    let goals = [Order::Goal(Opening::of(Epoch::first(3), Time(7))), Order::Goal(again)];
    for order in goals.into_iter().chain([condemn, Order::Custody(custody), call, carry]).chain(commands) {
        assert!(order.wire_len() <= HEADER + PAYLOAD);
        assert_eq!(Frame::seal(header(), &order).message::<Order>(), Ok(order));
    }
    let motion = Motion { kind: MotionKind::Convex, support: Face::Down, heading: Face::East };
    let action = Move { motion, not_after: Time(77) };
    assert_eq!(Frame::seal(header(), &action).message::<Move>(), Ok(action));
}

/// The layout is part of the format: these bytes change only together with the wire version.
#[test]
fn golden_beacon() {
    let bytes = Frame::seal(header(), &Message::Beacon(beacon())).as_bytes().to_owned();
    let expected: [u8; 85] = [
        4,
        3,
        2,
        1,
        5,
        0,
        0,
        0,
        1,
        0,
        0b1101_0100,
        0x35,
        0x01,
        0x03,
        0x12,
        0x02,
        0x11,
        0x10,
        0x0B,
        0x0A,
        0x0D,
        0x0C,
        0,
        0,
        0,
        0,
        0,
        0,
        0x0F,
        0x0E,
        0,
        0,
        0,
        0,
        0,
        0,
        3,
        2,
        0xDD,
        0xCC,
        0xBB,
        0xAA,
        1,
        7,
        0,
        0,
        0,
        0x20,
        0x18,
        9,
        0,
        0,
        0,
        1,
        0,
        0,
        1,
        0,
        0,
        2,
        0,
        2,
        0,
        0,
        2,
        0,
        0,
        3,
        0,
        3,
        0,
        0,
        3,
        0,
        0,
        4,
        0,
        0xFF,
        0xFF,
        0,
        0,
        0,
        0,
        0,
        0,
    ];
    assert_eq!(bytes[HEADER..HEADER + 85], expected);
}

#[test]
fn routes_are_bounded() {
    assert!(Route::new(&[]).is_none() && Route::new(&[Face::Up; MAX_HOPS + 1]).is_none());
    let mut route = Route::new(&[Face::Up]).unwrap();
    for _ in 1..MAX_HOPS {
        route = route.then(Face::East).unwrap();
    }
    assert!(route.then(Face::East).is_none());
    assert_eq!(route.faces().count(), MAX_HOPS);
}

proptest! {
    /// Decoding any bytes in shared memory refuses them or returns a message that encodes to the very
    /// same bytes: no content is lost or accepted unchecked.
    #[test]
    fn garbage_is_refused_or_encodes_to_the_same_bytes(kind in 0u8..8, payload in proptest::collection::vec(any::<u8>(), 0..=96)) {
        let mut frame = Frame::seal(header(), &Message::Release { origin: ModuleId(0), token: Token(0) }).as_bytes().to_owned();
        frame[2] = kind;
        frame[5] = payload.len() as u8;
        frame[HEADER..HEADER + payload.len()].copy_from_slice(&payload);
        if let Ok(message) = Frame::from_bytes(frame).message::<Message>() {
            let again = Frame::seal(header(), &message);
            prop_assert_eq!(&again.as_bytes()[HEADER..HEADER + payload.len()], &payload[..]);
        }
        let _ = Frame::from_bytes(frame).message::<Percept>();
        let _ = Frame::from_bytes(frame).message::<Order>();
        let _ = Frame::from_bytes(frame).message::<Status>();
        let _ = Frame::from_bytes(frame).message::<Move>();
    }

    /// The same with one flipped bit of a valid message.
    #[test]
    fn a_flipped_bit_never_panics(sample in 0usize..10, bit in 0u64..1024) {
        let mut frame = Frame::seal(header(), &samples()[sample]);
        frame.flip(bit);
        prop_assert!(frame.open().is_err());
        let _ = frame.message::<Message>();
    }
}
