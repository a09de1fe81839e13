//! Tests of messages and agents; those of agents and bodies together are in `sim-bridge`.

use super::agent::LatticeModule;
use super::message::*;
use super::place::{LatticePlace, configuration};
use super::*;
use metamorph_core::agent::{Agent, Birth, Input, Output};
use metamorph_core::ids::{Incarnation, ModuleId, Port, Session};
use metamorph_core::lattice::Cell;
use metamorph_core::time::Time;
use metamorph_core::wire::{PAYLOAD, Wire, WireError, from_payload, payload};
use metamorph_planning::assembly::named;
use std::sync::Arc;

fn comes_back<W: Wire>(all: &[W]) {
    for message in all {
        let bytes = payload(message);
        assert!(bytes.len() <= PAYLOAD);
        assert_eq!(&from_payload::<W>(message.kind(), &bytes).unwrap(), message);
        if let Some((_, short)) = bytes.split_last() {
            assert_eq!(from_payload::<W>(message.kind(), short), Err(WireError::Length), "{message:?}");
        }
        assert!(from_payload::<W>(99, &bytes).is_err());
    }
}

const PLACE: LatticePlace =
    LatticePlace { cell: Cell::new(-3, 4, 500), rotation: 23, posture: 35, closed: 0x3ff };
const STEP: StepName = StepName { epoch: 70_000, index: 300, attempt: 3 };

#[test]
fn messages_come_back_as_they_were() {
    let action_counts = [
        LatticeBodyAction::Attach(9),
        LatticeBodyAction::Detach(0),
        LatticeBodyAction::Turn { joint: 2, positive: true },
    ];
    comes_back(&[PLACE, LatticePlace::default()]);
    comes_back(&action_counts.map(|body_action| LatticeAction {
        step: STEP,
        body_action,
        not_after: Time(7),
    }));
    let step = |body_action| LatticeOrder::Step {
        step: STEP,
        body_action,
        expect: (35, 0x3ff),
        not_after: Time::NEVER,
    };
    comes_back(&[
        LatticeOrder::Hold { epoch: 9 },
        step(action_counts[0]),
        step(action_counts[1]),
        step(action_counts[2]),
    ]);
    let swing = Swing { pivot: Cell::new(1, -2, 3), axis: [1, -1, 1], degrees: -120 };
    comes_back(&[
        LatticePercept::Done(PLACE),
        LatticePercept::Failed,
        LatticePercept::Refused(LatticeRefusal::Impossible),
        LatticePercept::Carried(swing),
        LatticePercept::Settled { place: PLACE, moved: false },
    ]);
    let status = LatticeStatus {
        epoch: 8,
        place: PLACE,
        busy: true,
        last: None,
        prevented: 9,
        waits_for: Some(ModuleId(3)),
    };
    let last = |result| LatticeStatus { last: Some((STEP, result)), ..status };
    comes_back(&[status, last(Ok(())), last(Err(Failure::Late)), last(Err(Failure::Connection))]);
    let response = |denial| LockMessage::Response(denial);
    let what = [
        LockMessage::Request,
        LockMessage::Release,
        response(None),
        response(Some((LatticeDenial::Changed, ModuleId(1)))),
    ];
    comes_back(&what.map(|what| LatticeMessage { origin: ModuleId(2), token: 9, what }));
}

#[test]
fn impossible_fields_are_refused() {
    let wrong = |place: LatticePlace| from_payload::<LatticePlace>(16, &payload(&place));
    assert_eq!(wrong(LatticePlace { rotation: 24, ..PLACE }), Err(WireError::Field("rotation")));
    assert_eq!(wrong(LatticePlace { posture: 36, ..PLACE }), Err(WireError::Field("posture")));
    assert_eq!(wrong(LatticePlace { closed: 0x400, ..PLACE }), Err(WireError::Field("connectors")));
    let turn = LatticeAction {
        step: STEP,
        body_action: LatticeBodyAction::Turn { joint: 3, positive: false },
        not_after: Time(0),
    };
    assert_eq!(
        from_payload::<LatticeAction>(turn.kind(), &payload(&turn)),
        Err(WireError::Field("body_action"))
    );
}

#[test]
fn places_are_those_of_planner_and_checker() {
    let start = named::line(&[1, 2, 3]).unwrap();
    let places: Vec<LatticePlace> = start.modules().iter().map(LatticePlace::of).collect();
    assert_eq!(configuration(&places).unwrap(), start);
    for place in &places {
        assert_eq!(LatticePlace::of_robot(&place.robot(), place.closed), *place);
    }
}

fn module(incarnation: u16) -> LatticeModule {
    module_with(incarnation, None)
}

fn module_with(incarnation: u16, defect: Option<Defect>) -> LatticeModule {
    let setup = Arc::new(LatticeSetup { defect, ..LatticeSetup::scaled(Span::secs(1), Span::millis(100)) });
    let incarnation = Incarnation(incarnation);
    let birth =
        Birth { id: ModuleId(5), incarnation, place: LatticePlace::default(), seed: 1, born: Time::ZERO };
    LatticeModule::new(&setup, birth, Time::ZERO)
}

fn outputs(agent: &mut LatticeModule) -> Vec<Output<LatticeMessage, LatticeAction, LatticeStatus>> {
    std::iter::from_fn(|| agent.poll()).collect()
}

fn acts(outputs: &[Output<LatticeMessage, LatticeAction, LatticeStatus>]) -> Vec<StepName> {
    let act = |o: &Output<_, LatticeAction, _>| if let Output::Act(a) = o { Some(a.step) } else { None };
    outputs.iter().filter_map(act).collect()
}

fn order(epoch: u32, index: u16) -> LatticeOrder {
    let step = StepName { epoch, index, attempt: 0 };
    LatticeOrder::Step {
        step,
        body_action: LatticeBodyAction::Attach(7),
        expect: (0, 0),
        not_after: Time::NEVER,
    }
}

/// A repeated order is answered and not carried out again; one of an earlier epoch is ignored.
#[test]
fn orders_are_taken_once_and_in_order() {
    let mut agent = module(0);
    let mut hand = |input| {
        agent.handle(Time(1), input);
        outputs(&mut agent)
    };
    let taken = hand(Input::Order(order(2, 0)));
    assert_eq!(acts(&taken).len(), 1);
    assert_eq!(acts(&hand(Input::Order(order(2, 0)))), []);
    let done = LatticePlace { closed: 1 << 7, ..LatticePlace::default() };
    hand(Input::Percept(LatticePercept::Done(done)));
    let again = hand(Input::Order(order(2, 0)));
    let result = |o: &Output<_, _, LatticeStatus>| matches!(o, Output::Report(s) if s.last.is_some_and(|l| l.1 == Ok(())));
    assert!(acts(&again).is_empty() && again.iter().any(result), "{again:?}");
    assert!(hand(Input::Order(order(1, 4))).is_empty());
    // The state is no longer the one for which this was planned.
    let stale = hand(Input::Order(order(3, 1)));
    let result = |o: &Output<_, _, LatticeStatus>| matches!(o, Output::Report(s) if s.last.is_some_and(|l| l.1 == Err(Failure::Stale)));
    assert!(acts(&stale).is_empty() && stale.iter().any(result), "{stale:?}");
}

/// An action that an earlier incarnation began may end after the restart. It is not the step that has been ordered
/// since.
#[test]
fn the_end_of_an_earlier_action_is_not_that_of_a_new_step() {
    for (percept, expected) in [
        (
            LatticePercept::Done(LatticePlace { posture: 1, ..LatticePlace::default() }),
            Some(Err(Failure::Stale)),
        ),
        (LatticePercept::Failed, None),
    ] {
        let mut agent = module(1);
        agent.handle(Time(1), Input::Order(order(4, 0)));
        agent.handle(Time(2), Input::Percept(percept));
        let outputs = outputs(&mut agent);
        let reported =
            outputs.iter().rev().find_map(|o| if let Output::Report(s) = o { Some(s) } else { None });
        assert_eq!(reported.and_then(|s| s.last).map(|last| last.1), expected);
        assert_eq!(acts(&outputs), []);
    }
}

/// An agent that follows the plan before carries out its orders, which the test above does not permit.
#[test]
fn an_agent_that_follows_old_plans_is_found() {
    let after_hold = |defect| {
        let mut agent = module_with(0, defect);
        agent.handle(Time(1), Input::Order(LatticeOrder::Hold { epoch: 2 }));
        agent.handle(Time(2), Input::Order(order(1, 0)));
        acts(&outputs(&mut agent)).len()
    };
    assert_eq!((after_hold(None), after_hold(Some(Defect::FollowOldPlans))), (0, 1));
}

fn request(origin: u32, token: u32) -> Input<LatticeMessage, LatticePercept, LatticeOrder> {
    let message = LatticeMessage { origin: ModuleId(origin), token, what: LockMessage::Request };
    Input::Message { port: Port(0), message }
}

fn answers(outputs: &[Output<LatticeMessage, LatticeAction, LatticeStatus>]) -> Vec<LockMessage> {
    let sent = |o: &Output<LatticeMessage, _, _>| {
        if let Output::Send { message, .. } = o { Some(message.what) } else { None }
    };
    outputs.iter().filter_map(sent).collect()
}

/// A module has one branch lock at a time, keeps still for it, and grants none for a lease after a restart.
#[test]
fn branch_locks_exclude_each_other() {
    let denied = |why| vec![LockMessage::Response(Some((why, ModuleId(5))))];
    let mut agent = module(0);
    let mut hand = |at: u64, input| {
        agent.handle(Time(at), input);
        outputs(&mut agent)
    };
    hand(0, Input::Contact { port: Port(0), session: Some(Session(1)) });
    assert_eq!(answers(&hand(1, request(1, 1))), [LockMessage::Response(None)]);
    assert_eq!(answers(&hand(2, request(2, 1))), denied(LatticeDenial::Held));
    assert_eq!(acts(&hand(3, Input::Order(order(1, 0)))), []);
    let release = LatticeMessage { origin: ModuleId(1), token: 1, what: LockMessage::Release };
    // Its own step begins as soon as the lock is over, and is in the way of the next one.
    assert_eq!(acts(&hand(4, Input::Message { port: Port(0), message: release })).len(), 1);
    assert_eq!(answers(&hand(5, request(2, 2))), denied(LatticeDenial::Busy));

    let mut restarted = module(1);
    outputs(&mut restarted);
    restarted.handle(Time(0), Input::Contact { port: Port(0), session: Some(Session(2)) });
    restarted.handle(Time(1), request(1, 1));
    assert_eq!(answers(&outputs(&mut restarted)), denied(LatticeDenial::Quarantined));
    let lease = LatticeSetup::scaled(Span::secs(1), Span::millis(100)).lease;
    restarted.handle(Time::ZERO + lease, request(1, 2));
    assert_eq!(answers(&outputs(&mut restarted)), [LockMessage::Response(None)]);
}
