//! The suite that every driver has to pass. Each check consists of a script and of the observations that are
//! expected, on the simulator, on threads in memory, and on processes over shared memory.
//!
//! `conformance!(make_testbed)` in a test file makes a test of each of them.

use crate::probe::{ProbeOrder, ProbeReport, ProbeWorld};
use crate::script::{Script, Seen};
use crate::testbed::Testbed;
use metamorph_protocol::counters::{Counts, Tally};
use metamorph_protocol::ids::{Incarnation, ModuleId, Port};
use metamorph_protocol::link::{LinkModel, Partition};
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};

/// Makes a test of each check of the suite; the argument is an expression for a testbed.
#[macro_export]
macro_rules! conformance {
    ($bed:expr) => {
        $crate::conformance!($bed;
            delivers_to_the_neighbour_that_is_there,
            delivers_nothing_to_one_that_has_left,
            keeps_the_order_of_each_link,
            a_late_message_is_not_credited_to_a_later_contact,
            actions_carry_what_the_agent_had_sensed,
            counts_what_is_lost,
            tolerates_duplicates,
            refuses_what_was_damaged,
            delays_and_reorders,
            a_partition_cuts_and_heals,
            an_inbox_that_is_full_is_counted,
            a_dead_peer_blocks_no_sender,
            a_restarted_module_is_reachable_in_a_new_session,
            counts_survive_a_kill,
        );
    };
    ($bed:expr; $($check:ident),* $(,)?) => {
        $(#[test]
        fn $check() {
            $crate::conformance::$check(&mut $bed);
        })*
    };
}

const A: ModuleId = ModuleId(0);
const B: ModuleId = ModuleId(1);

/// Runs a script to its end and checks what holds for every run.
fn run(bed: &mut impl Testbed, link: &LinkModel, world: &mut ProbeWorld, script: Script) -> (Script, Counts) {
    let mut script = script;
    let tally = bed.run(link, world, &mut script);
    if let Some(what) = script.gave_up {
        let seen: Vec<_> = script.log.0.iter().rev().take(20).collect();
        panic!("gave up waiting for {what}; last seen, newest first: {seen:#?}");
    }
    adds_up(&tally);
    (script, tally.total())
}

/// Loss is never silent: nothing arrives that was not sent, and every message that was sent has a fate or is
/// in flight.
fn adds_up(tally: &Tally) {
    for (class, counts) in tally.iter() {
        assert!(counts.in_flight() >= 0, "{class}: more fates than messages: {counts:?}");
    }
}

fn clear() -> LinkModel {
    LinkModel::default()
}

/// Sends `rounds` times `size` messages from the first module to the second, without letting the
/// inbox overflow.
fn stream(mut script: Script, rounds: u32, size: u32) -> Script {
    for round in 0..rounds {
        script = script.send(0, 1, round * size, size).settle(0).settle(1);
    }
    script
}

/// The same over links that delay: waits for all messages of a round, so that they never pile up.
fn slow_stream(mut script: Script, rounds: u32, size: u32) -> Script {
    for round in 0..rounds {
        script = script.send(0, 1, round * size, size).until_got(1, 0, ((round + 1) * size) as usize);
    }
    script
}

/// A message reaches the neighbour, by the right port, and no other module.
pub fn delivers_to_the_neighbour_that_is_there(bed: &mut impl Testbed) {
    let script =
        Script::new(3).send(1, 0, 10, 1).send(1, 1, 20, 1).until_got(0, 1, 1).until_got(2, 0, 1).settle(1);
    let (script, counts) = run(bed, &clear(), &mut ProbeWorld::line(3), script);
    assert_eq!(script.log.got(A, Port(1)), [10]);
    assert_eq!(script.log.got(ModuleId(2), Port(0)), [20]);
    assert_eq!(script.log.all_got(), 2);
    assert_eq!((counts.sent, counts.delivered, counts.in_flight()), (2, 2, 0));
    assert_eq!(counts.bytes, 2 * 36);
    for i in 0..3 {
        let born = ProbeReport::Born { incarnation: Incarnation(0), place: i };
        assert!(script.log.has(ModuleId(i), born), "module {i} knows its place");
    }
}

/// Messages to a module that has left expire and are counted so; the module that takes its place receives its
/// own only.
pub fn delivers_nothing_to_one_that_has_left(bed: &mut impl Testbed) {
    let mut world = ProbeWorld::new(3);
    let script = Script::new(3)
        .join((0, 1), (1, 0))
        .send(0, 1, 1, 1)
        .until_got(1, 0, 1)
        .part((0, 1), (1, 0))
        .send(0, 1, 2, 5)
        .settle(0)
        .join((0, 1), (2, 0))
        .send(0, 1, 9, 1)
        .until_got(2, 0, 1)
        .settle(1);
    let (script, counts) = run(bed, &clear(), &mut world, script);
    assert_eq!(script.log.got(B, Port(0)), [1]);
    assert_eq!(script.log.got(ModuleId(2), Port(0)), [9]);
    assert_eq!((counts.sent, counts.delivered, counts.expired), (7, 2, 5));
}

/// What is sent over one link arrives in the order in which it was sent.
pub fn keeps_the_order_of_each_link(bed: &mut impl Testbed) {
    let model = LinkModel { delay_max: Span::millis(3), ..clear() };
    for model in [clear(), model] {
        let script = slow_stream(Script::new(2), 20, 20);
        let (script, counts) = run(bed, &model, &mut ProbeWorld::line(2), script);
        assert_eq!(script.log.got(B, Port(0)), (0..400).collect::<Vec<_>>());
        assert_eq!((counts.sent, counts.delivered), (400, 400));
    }
}

/// Two modules part while messages are in flight, and meet again: the old messages do not arrive.
pub fn a_late_message_is_not_credited_to_a_later_contact(bed: &mut impl Testbed) {
    let model = LinkModel { delay_min: Span::millis(300), delay_max: Span::millis(300), ..clear() };
    let script = Script::new(2)
        .join((0, 1), (1, 0))
        .send(0, 1, 1, 3)
        .settle(0)
        .part((0, 1), (1, 0))
        .join((0, 1), (1, 0))
        .send(0, 1, 7, 1)
        .until_got(1, 0, 1);
    let (script, counts) = run(bed, &model, &mut ProbeWorld::new(2), script);
    assert_eq!(script.log.got(B, Port(0)), [7]);
    assert_eq!((counts.sent, counts.delivered, counts.expired), (4, 1, 3));
}

/// A body knows which contact changes its agent had heard of when it acted.
pub fn actions_carry_what_the_agent_had_sensed(bed: &mut impl Testbed) {
    let felt = |token| {
        move |log: &crate::script::Log| {
            log.0.iter().any(|(_, s)| matches!(s, Seen::Report(_, ProbeReport::Felt(f)) if f.token == token))
        }
    };
    let script = Script::new(2)
        .join((0, 1), (1, 0))
        .order(0, ProbeOrder::Touch(1))
        .until("the answer of a body", felt(1))
        .part((0, 1), (1, 0))
        .order(0, ProbeOrder::Touch(2))
        .until("the answer of a body", felt(2));
    let (script, counts) = run(bed, &clear(), &mut ProbeWorld::new(2), script);
    for token in [1, 2] {
        let felt = crate::probe::Felt { token, current: true };
        assert!(script.log.has(A, ProbeReport::Felt(felt)), "touch {token} was decided on what holds");
    }
    assert_eq!(counts, Counts::default(), "what bodies say are not protocol messages");
}

/// Lost messages are counted as lost.
pub fn counts_what_is_lost(bed: &mut impl Testbed) {
    let model = LinkModel { loss: "30%".parse().expect("a probability"), ..clear() };
    let script = stream(Script::new(2), 20, 20).settle(1);
    let (script, counts) = run(bed, &model, &mut ProbeWorld::line(2), script);
    assert_eq!(counts.sent, 400);
    assert!((60..180).contains(&counts.lost), "{counts:?}");
    assert_eq!(counts.delivered as usize, script.log.all_got());
    assert_eq!((counts.sent, counts.in_flight()), (counts.delivered + counts.lost, 0));
}

/// Duplicates arrive and are counted as such.
pub fn tolerates_duplicates(bed: &mut impl Testbed) {
    let model = LinkModel { duplicate: "1/2".parse().expect("a probability"), ..clear() };
    let script = stream(Script::new(2), 20, 10).settle(1);
    let (script, counts) = run(bed, &model, &mut ProbeWorld::line(2), script);
    assert!((60..140).contains(&counts.duplicated), "{counts:?}");
    assert_eq!(counts.delivered, counts.sent + counts.duplicated);
    let mut got = script.log.got(B, Port(0));
    got.dedup();
    assert_eq!(got, (0..200).collect::<Vec<_>>(), "every message arrived, copies behind their originals");
}

/// Damaged messages are refused and counted, and never arrive as something else.
pub fn refuses_what_was_damaged(bed: &mut impl Testbed) {
    let model = LinkModel { corrupt: "1/4".parse().expect("a probability"), ..clear() };
    let mut script = stream(Script::new(2), 20, 20).settle(1);
    // A damaged class makes a message count as one of another class: only the sum adds up.
    let tally = bed.run(&model, &mut ProbeWorld::line(2), &mut script);
    assert_eq!(script.gave_up, None);
    let counts = tally.total();
    assert!((50..150).contains(&counts.refused), "{counts:?}");
    assert_eq!((counts.sent, counts.in_flight()), (counts.delivered + counts.refused, 0));
    let got = script.log.got(B, Port(0));
    assert!(got.is_sorted() && got.iter().all(|n| *n < 400));
}

/// Messages that are held back arrive later than others, and all arrive.
pub fn delays_and_reorders(bed: &mut impl Testbed) {
    let model = LinkModel {
        delay_min: Span::millis(1),
        delay_max: Span::millis(5),
        reorder: "1/5".parse().expect("a probability"),
        ..clear()
    };
    let script = slow_stream(Script::new(2), 10, 20);
    let (script, counts) = run(bed, &model, &mut ProbeWorld::line(2), script);
    let mut got = script.log.got(B, Port(0));
    assert!(!got.is_sorted(), "nothing was reordered");
    got.sort_unstable();
    assert_eq!(got, (0..200).collect::<Vec<_>>());
    assert_eq!((counts.sent, counts.in_flight()), (200, 0));
}

/// Nothing passes between two sides while they are cut off; afterwards everything does.
pub fn a_partition_cuts_and_heals(bed: &mut impl Testbed) {
    let until = Time::ZERO + Span::millis(1_500);
    let cut = Partition { from: Time::ZERO, until, side: vec![A] };
    let model = LinkModel { partitions: vec![cut], ..clear() };
    let script = Script::new(3)
        .send(0, 1, 1, 4)
        .send(2, 0, 50, 1)
        .until_got(1, 1, 1)
        .pass(Span::millis(1_600))
        .send(0, 1, 7, 1)
        .until_got(1, 0, 1);
    let (script, counts) = run(bed, &model, &mut ProbeWorld::line(3), script);
    assert_eq!(script.log.got(B, Port(0)), [7]);
    assert_eq!((counts.sent, counts.lost, counts.delivered), (6, 4, 2));
}

/// The inbox of a stopped module fills up; messages that do not fit are counted, and later ones arrive again
/// once the module goes on.
pub fn an_inbox_that_is_full_is_counted(bed: &mut impl Testbed) {
    let script = Script::new(2)
        .command(Command::Pause(B))
        .send(0, 1, 0, 5_000)
        .settle(0)
        .command(Command::Resume(B))
        .until_got(1, 0, 1)
        .settle(1)
        .send(0, 1, 9_000, 1)
        .until("a message after the flood", |log| log.got(B, Port(0)).contains(&9_000));
    let (script, counts) = run(bed, &clear(), &mut ProbeWorld::line(2), script);
    assert!(counts.overflowed > 0, "{counts:?}");
    assert_eq!((counts.sent, counts.in_flight()), (5_001, 0));
    assert_eq!(counts.delivered as usize, script.log.all_got());
    assert!(script.log.got(B, Port(0)).is_sorted());
}

/// Sending to a dead module does not block, and every message has a counted fate.
pub fn a_dead_peer_blocks_no_sender(bed: &mut impl Testbed) {
    let script = Script::new(3)
        .command(Command::Kill(B))
        .until_died(1, 1)
        .send(0, 1, 0, 500)
        .send(2, 0, 0, 500)
        .settle(0)
        .settle(2);
    let (script, counts) = run(bed, &clear(), &mut ProbeWorld::line(3), script);
    assert_eq!(script.log.all_got(), 0);
    assert_eq!((counts.sent, counts.delivered), (1_000, 0));
    assert_eq!(script.log.count(Seen::Died(B)), 1);
}

/// A restarted module has no memory, a new session with each neighbour, and is reachable again.
pub fn a_restarted_module_is_reachable_in_a_new_session(bed: &mut impl Testbed) {
    let script = Script::new(2)
        .send(0, 1, 1, 1)
        .until_got(1, 0, 1)
        .command(Command::Kill(B))
        .until_died(1, 1)
        .send(0, 1, 2, 3)
        .settle(0)
        .command(Command::Restart(B))
        .until_started(1, 2)
        .until("the new session", |log| {
            let (a, b) = (log.sessions(A, Port(1)), log.sessions(B, Port(0)));
            let reborn = ProbeReport::Born { incarnation: Incarnation(1), place: 1 };
            log.has(B, reborn) && a.last() == b.last()
        })
        .send(0, 1, 8, 1)
        .until("a message to the new incarnation", |log| log.got(B, Port(0)).contains(&8))
        .send(1, 0, 9, 1)
        .until_got(0, 1, 1);
    let (script, counts) = run(bed, &clear(), &mut ProbeWorld::line(2), script);
    assert_eq!(
        script.log.got(B, Port(0)),
        [1, 8],
        "no message to the incarnation before arrives in the new one"
    );
    assert_eq!(script.log.got(A, Port(1)), [9]);
    assert_eq!((counts.sent, counts.delivered), (6, 3));
    let mut sessions = script.log.sessions(A, Port(1));
    sessions.dedup();
    let distinct: std::collections::BTreeSet<_> = sessions.iter().collect();
    assert_eq!(distinct.len(), sessions.len(), "no session comes back");
}

/// What a module had counted is not lost when it is killed.
pub fn counts_survive_a_kill(bed: &mut impl Testbed) {
    let script = Script::new(2)
        .send(0, 1, 0, 20)
        .until_got(1, 0, 20)
        .command(Command::Kill(A))
        .until_died(0, 1)
        .command(Command::Restart(A))
        .until_started(0, 2)
        .until("the new session", |log| {
            log.has(A, ProbeReport::Born { incarnation: Incarnation(1), place: 0 })
                && log.sessions(A, Port(1)).last() == log.sessions(B, Port(0)).last()
        })
        .send(0, 1, 20, 20)
        .until_got(1, 0, 40);
    let (script, counts) = run(bed, &clear(), &mut ProbeWorld::line(2), script);
    assert_eq!(script.log.got(B, Port(0)), (0..40).collect::<Vec<_>>());
    assert_eq!((counts.sent, counts.delivered), (40, 40));
}
