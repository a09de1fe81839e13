//! The layout of the metamodules' messages on the wire.

use super::*;
use crate::metamodule::params::Strategy;
use crate::metamodule::pose::End;
use crate::metamodule::tuning::Tuning;
use metamorph_core::counters::Class;
use metamorph_core::ids::{Incarnation, Port};
use metamorph_core::lattice::Cell;
use metamorph_core::time::Time;
use metamorph_core::wire::{Channel, Frame, HEADER, Header};
use metamorph_roombots::grid::GridState;
use proptest::prelude::*;

fn header(kind: u8) -> Header {
    Header {
        channel: Channel::Peer,
        kind,
        class: Class::Negotiation,
        port: Port(1),
        incarnation: Incarnation(0),
        source: ModuleId(1),
        destination: ModuleId(2),
        session: 3,
        sequence: 4,
    }
}

fn a_pose() -> Pose {
    Pose { end: End::Head, both: true, ..Pose::standing(GridState::new(-2, 5, 3), 0x0102) }
}

fn a_task() -> Task {
    Task { epoch: 2, goal: 1, shift: (-3, 4), ..Task::default() }
}

fn a_state() -> State {
    State {
        id: ModuleId(1),
        sequence: 2,
        pose: a_pose(),
        settled: true,
        stuck: false,
        blocked: true,
        task: a_task(),
        filled: SeedSet(3),
        claim: None,
        unreachable: SeedSet(4),
    }
}

fn round_trip<W: Wire>(message: &W) {
    let frame = Frame::seal(header(message.kind()), message);
    frame.open().unwrap();
    assert_eq!(&frame.message::<W>().unwrap(), message);
}

#[test]
fn everything_survives_the_wire() {
    let p = a_pose();
    let filled = SeedSet(0x8000_0001);
    round_trip(&p);
    for claim in [None, Some(Claim { seed: 31, cost: 7 })] {
        round_trip(&Message::State(State { claim, ..a_state() }));
    }
    let wide = SeedSet(1 << 127 | 1 << 64 | 5);
    round_trip(&Message::State(State {
        filled: wide,
        claim: Some(Claim { seed: 127, cost: 7 }),
        ..a_state()
    }));
    round_trip(&Message::State(State { unreachable: wide, ..a_state() }));
    let segment = Segment { posture: 77, sweep: Sweep(3 << 90) };
    for count in 0..=LEGS as u8 {
        let mut segments = [Segment::default(); LEGS];
        segments[..usize::from(count)].fill(segment);
        let (id, rank) = (ModuleId(3), Rank::of_seed(31).below());
        round_trip(&Message::Path(Path { id, sequence: 9, rank, from: p, segments, count }));
    }
    for end in [MoveEnd::Rests, MoveEnd::Lands, MoveEnd::Settles] {
        let one = Instruction::Move { mover: ModuleId(5), from: p, posture: 0x0304, end };
        for instruction in [Instruction::Over, Instruction::Stay, one] {
            let coordinator = ModuleId(4);
            round_trip(&Message::Directive(Directive { coordinator, sequence: 9, instruction }));
        }
    }
    let rank = Rank::NONE;
    let (origin, token, sweep) = (ModuleId(7), Token(8), Sweep(1 << 127 | 5));
    round_trip(&Message::Request { origin, token, rank, age: Span(u64::MAX), pose: p, sweep, ends: 7 });
    let denials = [Denial::Occupied, Denial::Held, Denial::Younger, Denial::Quarantined].map(Some);
    for denial in denials.into_iter().chain([None]) {
        round_trip(&Message::Response { from: origin, token, denial });
    }
    round_trip(&Message::Release { origin, token, pose: p });
    let load = Load::of_grip(200).unwrap();
    let (grip, let_go) = (BodyAction::Grip(load), BodyAction::LetGo);
    round_trip(&Pose { load, ..p });
    for body_action in [BodyAction::Turn(4031), BodyAction::Attach, BodyAction::Detach, grip, let_go] {
        round_trip(&Action { body_action, not_after: Time(77) });
    }
    use Refusal::{Blocked, Busy, Impossible, Late, Stale};
    for why in [Blocked, Late, Stale, Busy, Impossible] {
        round_trip(&Percept::Refused(why));
    }
    round_trip(&Percept::Done(p));
    round_trip(&Percept::Failed);
    round_trip(&Percept::Misaligned);
    round_trip(&Order::Seeds { task: a_task(), open: SeedSet(6), filled });
    round_trip(&Order::Seeds { task: a_task(), open: wide, filled });
    round_trip(&Order::Seeds { task: a_task(), open: SeedSet(6), filled: wide });
    round_trip(&Order::Obstacle { cell: Cell::new(-3, 4, 1), there: true });
    round_trip(&Order::Dead { id: origin, pose: p });
    round_trip(&Order::Alive { id: origin });
    let steps = Instruction::Move { mover: origin, from: p, posture: 9, end: MoveEnd::Lands };
    let handle = Instruction::Handle { mover: origin, from: p, load };
    for instruction in [Instruction::Over, Instruction::Stay, steps, handle] {
        round_trip(&Order::Instruct { number: 7, instruction });
    }
    for strategy in Strategy::PUBLISHED {
        let (repulsion, precedence) = (strategy.repulsion(), strategy.precedence());
        round_trip(&Order::Tune(Tuning { strategy, repulsion, precedence, settled_repel: false }));
    }
    for (settled, filled) in [(None, filled), (Some(31), filled), (Some(127), wide)] {
        round_trip(&Status {
            pose: p,
            settled,
            prevented: 3,
            waits_for: settled.map(|_| origin),
            unreachable: filled,
            deadlocked: settled.is_some(),
            busy: settled.is_none(),
            stuck: settled.is_some(),
        });
        let answer = settled.map(|s| Counted { metamodules: s.into(), stirs: u32::MAX });
        round_trip(&Message::Probe(Probe { initiator: origin, wave: 5, sequence: 6, answer }));
    }
}

/// The layout is part of the format: these bytes change only together with its version.
#[test]
fn golden_request() {
    let message = Message::Request {
        origin: ModuleId(7),
        token: Token(0x0A0B),
        rank: Rank(0x0304),
        age: Span(9),
        pose: a_pose(),
        sweep: Sweep(0x0102 | 0x03 << 120),
        ends: 0x0506,
    };
    let bytes = Frame::seal(header(17), &message).as_bytes().to_owned();
    assert_eq!(
        &bytes[HEADER..HEADER + 44],
        &[
            7, 0, 0, 0, 0x0B, 0x0A, 0, 0, 4, 3, 9, 0, 0, 0, 0, 0, 0, 0, 0xFE, 0xFF, 5, 0, 15, 0, 2, 1, 2, 1,
            0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 3, 6, 5
        ]
    );
    assert_eq!(message.wire_len(), HEADER + 44);
}

#[test]
fn golden_state() {
    let bytes = Frame::seal(header(16), &Message::State(a_state())).as_bytes().to_owned();
    assert_eq!(
        &bytes[HEADER..HEADER + 34],
        &[
            1, 0, 0, 0, 2, 0, 0, 0, 0xFE, 0xFF, 5, 0, 15, 0, 2, 1, 5, 2, 0, 1, 0xFD, 0xFF, 4, 0, 3, 0, 0, 0,
            255, 0, 4, 0, 0, 0
        ]
    );
}

proptest! {
    /// Any bytes in shared memory are either refused or a message that encodes to the same.
    #[test]
    fn no_bytes_make_the_reader_panic(kind in 14u8..24, bytes in proptest::array::uniform32(any::<u8>())) {
        let mut cells = [0u8; Frame::SIZE];
        cells[HEADER..HEADER + 32].copy_from_slice(&bytes);
        for length in 0..=32u8 {
            cells[5] = length;
            cells[2] = kind;
            let frame = Frame::from_bytes(cells);
            if let Ok(message) = frame.message::<Message>() {
                prop_assert_eq!(message.wire_len(), HEADER + usize::from(length));
            }
            let _ = (frame.message::<Action>(), frame.message::<Percept>());
            let _ = (frame.message::<Order>(), frame.message::<Status>(), frame.message::<Pose>());
        }
    }
}
