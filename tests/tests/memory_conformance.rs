//! The conformance suite on threads over queues in memory, and what only such a swarm can show: how a thread
//! that breaks down is reported, and that a run ends when it is asked to.

use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::Span;
use metamorph_tests::probe::{ProbeOrder, ProbeSetup, ProbeWorld};
use metamorph_tests::script::{Script, Seen};
use metamorph_tests::testbed::MemoryBed;
use metamorph_world_controller::swarm::{SwarmOptions, run_in_memory};
use std::path::PathBuf;
use std::sync::Arc;

metamorph_tests::conformance!(MemoryBed::new());

fn options() -> SwarmOptions {
    SwarmOptions::new(PathBuf::new())
}

/// A thread that panics is a crash with what it said, and the others go on.
#[test]
fn a_thread_that_breaks_down_is_reported_and_the_others_go_on() {
    let mut script =
        Script::new(3).order(1, ProbeOrder::Panic).until_died(1, 1).send(0, 1, 1, 3).settle(0).settle(2);
    let setup = Arc::new(ProbeSetup::default());
    let outcome = run_in_memory(&options(), &setup, &mut ProbeWorld::line(3), &mut script).unwrap();
    assert_eq!(script.gave_up, None);
    let [crash] = &outcome.crashes[..] else { panic!("{:?}", outcome.crashes) };
    assert_eq!((crash.id, crash.how.as_str()), (ModuleId(1), "panicked"));
    assert!(crash.stderr_tail.contains("ordered to break down"), "{crash:?}");
    assert_eq!((outcome.alive, outcome.unclosed, outcome.tally.total().sent), (2, 1, 3));
}

/// A run that is asked to end does so in order, with all of its agents.
#[test]
fn a_run_ends_when_it_is_asked_to() {
    let options = options();
    let shutdown = options.shutdown.clone();
    let chat = ProbeOrder::Chat(Span::millis(1));
    let mut script = Script::new(40)
        .order(0, chat)
        .order(39, chat)
        .world(move |_| shutdown.request())
        .until("the end", |_| false);
    let setup = Arc::new(ProbeSetup::default());
    let outcome = run_in_memory(&options, &setup, &mut ProbeWorld::line(40), &mut script).unwrap();
    assert!(outcome.interrupted);
    assert_eq!((outcome.alive, outcome.unclosed, outcome.crashes.len()), (40, 0, 0));
    assert_eq!(script.log.count(Seen::Died(ModuleId(0))), 0);
    assert_eq!(outcome.tally.total().in_flight(), outcome.left.iter().sum::<u64>() as i64);
}
