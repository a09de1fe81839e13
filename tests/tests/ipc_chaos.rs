//! Swarms of real processes that are broken from outside: live modules go on, every loss is reported, and no
//! file is left behind.

use metamorph_module_agent::run_dir::counter_file::CounterFile;
use metamorph_module_agent::transport::iceoryx::inbox::Inbox;
use metamorph_module_agent::transport::iceoryx::outbox::Outbox;
use metamorph_module_agent::transport::iceoryx::rendezvous::Rendezvous;
use metamorph_module_agent::transport::shared_frame::SharedFrame;
use metamorph_module_agent::transport::{Link, SendStatus};
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::{Incarnation, ModuleId, Port};
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::{CONTROLLER, Channel, Frame, Header, Wire};
use metamorph_tests::chaos::{Controller, left_of, signal_to, wait_until};
use metamorph_tests::probe::{ProbeMessage, ProbeOrder, ProbeSetup, ProbeWorld};
use metamorph_tests::script::Script;
use metamorph_tests::testbed::{ProcessBed, Testbed};
use metamorph_world_controller::swarm::{SwarmError, SwarmOptions, clean, run_swarm};
use rustix::process::Signal;
use std::collections::BTreeSet;
use std::sync::mpsc;
use std::time::Duration;

const AGENT: &str = env!("CARGO_BIN_EXE_probe-agent");
const CONTROLLER_PROGRAM: &str = env!("CARGO_BIN_EXE_probe-controller");
const FIRST: Incarnation = Incarnation(0);

fn start(count: u32, chat_ms: u32) -> Controller {
    Controller::start(CONTROLLER_PROGRAM, count, chat_ms, &[AGENT])
}

#[test]
fn an_asked_end_leaves_nothing() {
    let controller = start(6, 5);
    let agents = controller.agents();
    assert_eq!(agents.len(), 6);
    let came_to = controller.finish();
    assert_eq!((came_to["alive"], came_to["crashes"], came_to["interrupted"]), (6, 0, 1));
    assert_eq!((came_to["foreign"], came_to["missing_counters"]), (0, 0));
    assert!(agents.iter().all(|a| !a.is_alive()));
}

#[test]
fn an_agent_killed_from_outside_is_told_apart_and_the_rest_goes_on() {
    let controller = start(5, 5);
    let victim = controller.agent(2, 0);
    signal_to(victim.pid, Signal::KILL);
    wait_until("the victim to be waited for", || {
        !std::path::Path::new(&format!("/proc/{}", victim.pid)).exists()
    });
    let before = CounterFile::read(&controller.root, ModuleId(0), FIRST).unwrap().unwrap();
    wait_until("the others to go on", || {
        let now = CounterFile::read(&controller.root, ModuleId(0), FIRST).unwrap().unwrap();
        now.tally.total().delivered > before.tally.total().delivered + 10
    });
    let came_to = controller.finish();
    assert_eq!((came_to["alive"], came_to["crashes"], came_to["external"]), (4, 0, 1));
    assert_eq!(came_to["missing_counters"], 0, "what the victim had counted is still there");
}

#[test]
fn an_agent_that_breaks_down_is_reported_with_its_last_words() {
    let mut bed = ProcessBed::new(AGENT);
    let mut script = Script::new(2).order(1, ProbeOrder::Panic).until_died(1, 1).settle(0);
    bed.run(&LinkModel::default(), &mut ProbeWorld::line(2), &mut script);
    assert_eq!(script.gave_up, None);
    let [crash] = bed.outcome.crashes.as_slice() else { panic!("{:?}", bed.outcome.crashes) };
    assert_eq!(crash.id, ModuleId(1));
    assert!(crash.stderr_tail.contains("ordered to break down"), "{crash:?}");
    assert_eq!((bed.outcome.alive, bed.outcome.killed), (1, 0));
}

/// An agent whose process hangs is named as the reason why the run says nothing.
#[test]
fn an_agent_that_hangs_is_a_fault_of_the_machine() {
    let mut bed = ProcessBed::new(AGENT);
    bed.options.stop_timeout = Duration::from_secs(1);
    let mut script = Script::new(2).order(1, ProbeOrder::Hang).settle(0);
    bed.run(&LinkModel::default(), &mut ProbeWorld::line(2), &mut script);
    assert_eq!(script.gave_up, None);
    let why = bed.outcome.machine_fault.as_deref().unwrap_or_default();
    assert!(why.contains("module 1 runs") && why.contains("hangs"), "{:?}", bed.outcome);
}

#[test]
fn a_stopped_agent_blocks_no_other_and_goes_on_when_continued() {
    let controller = start(3, 2);
    let middle = controller.agent(1, 0);
    signal_to(middle.pid, Signal::STOP);
    let overflowed = |id| {
        let counters = CounterFile::read(&controller.root, ModuleId(id), FIRST).unwrap().unwrap();
        counters.tally.total().overflowed
    };
    wait_until("the stopped inbox to overflow", || overflowed(0) > 50 && overflowed(2) > 50);
    signal_to(middle.pid, Signal::CONT);
    let before = CounterFile::read(&controller.root, ModuleId(1), FIRST).unwrap().unwrap();
    wait_until("the stopped agent to go on", || {
        let now = CounterFile::read(&controller.root, ModuleId(1), FIRST).unwrap().unwrap();
        now.tally.total().delivered > before.tally.total().delivered + 100
    });
    let came_to = controller.finish();
    assert_eq!((came_to["alive"], came_to["crashes"], came_to["foreign"]), (3, 0, 0));
}

/// Garbage, and frames under a false name, are counted separately and have no effect.
#[test]
fn foreign_frames_are_counted_and_change_nothing() {
    let controller = start(3, 5);
    let at = Rendezvous::join(&controller.root).unwrap();
    let mut outbox = Outbox::to_agent(&at, ModuleId(1), FIRST).unwrap();
    let header = Header {
        channel: Channel::Runtime,
        kind: 0,
        class: Class::World,
        port: Port(0),
        incarnation: FIRST,
        source: CONTROLLER,
        destination: ModuleId(1),
        session: 0,
        sequence: u32::MAX,
    };
    let message = ProbeMessage(1);
    assert_eq!(message.kind(), 0);
    let mut frames: Vec<SharedFrame> = [
        // A hello to an agent, out of sequence.
        header,
        // For another module.
        Header { destination: ModuleId(0), ..header },
        // From a module that is not a neighbour, in a valid session or in none.
        Header { channel: Channel::Peer, source: ModuleId(77), session: 1, ..header },
        Header { channel: Channel::Peer, source: ModuleId(0), session: 999, ..header },
    ]
    .iter()
    .map(|h| SharedFrame::new(&Frame::seal(*h, &message), Time::ZERO))
    .collect();
    let mut random = Rng::named(1, "garbage", 0);
    frames.extend((0..40).map(|_| SharedFrame::from_bytes(std::array::from_fn(|_| random.next_u64() as u8))));
    for frame in &frames {
        wait_until("room in the inbox", || {
            let status = outbox.send(*frame);
            outbox.flush();
            status == SendStatus::Sent
        });
    }
    wait_until("the garbage to be counted", || {
        let counters = CounterFile::read(&controller.root, ModuleId(1), FIRST).unwrap().unwrap();
        counters.foreign >= 42
    });
    drop((outbox, at));
    let came_to = controller.finish();
    assert_eq!((came_to["alive"], came_to["crashes"]), (3, 0));
    assert!(came_to["foreign"] >= 42, "{came_to:?}");
}

/// A wait of less than a microsecond ends.
#[test]
fn the_shortest_wait_ends() {
    let controller = start(2, 0);
    let root = controller.root.clone();
    let (sender, ended) = mpsc::channel();
    std::thread::spawn(move || {
        // Ports cannot change threads.
        let at = Rendezvous::join(&root).unwrap();
        let inbox = Inbox::create(&at, ModuleId(77), FIRST, 6).unwrap();
        for nanoseconds in [1, 999, 1_000, 1_999] {
            inbox.wait(Duration::from_nanos(nanoseconds)).unwrap();
        }
        drop((inbox, at));
        sender.send(()).unwrap();
    });
    ended.recv_timeout(Duration::from_secs(60)).expect("the wait is over");
    controller.finish();
}

/// `kill -9` of the controller, with a stopped agent among the others: no process stays, and one cleanup
/// removes the rest. Another live run is not touched.
#[test]
fn a_killed_controller_leaves_no_process_and_cleaning_removes_the_rest() {
    let other = start(2, 5);
    let mut controller = start(5, 5);
    let agents = controller.agents();
    signal_to(agents[3].pid, Signal::STOP);
    controller.signal(Signal::KILL);
    controller.wait();
    wait_until("the agents to end", || agents.iter().all(|a| !a.is_alive()));
    clean().unwrap();
    assert_eq!(left_of(&controller.root), Vec::<std::path::PathBuf>::new());
    assert!(other.agents().iter().all(|a| a.is_alive()));
    let came_to = other.finish();
    assert_eq!((came_to["alive"], came_to["crashes"]), (2, 0));
}

/// Agents whose parent is not the controller are not killed by the kernel with it; they detect its end.
#[test]
fn agents_behind_a_wrapper_notice_that_their_controller_is_gone() {
    let shell = ["/bin/sh", "-c", "\"$0\" \"$@\"; exit $?", AGENT];
    let mut controller = Controller::start(CONTROLLER_PROGRAM, 2, 5, &shell);
    let agents = controller.agents();
    controller.signal(Signal::KILL);
    controller.wait();
    wait_until("the agents to end by themselves", || agents.iter().all(|a| !a.is_alive()));
}

/// Agents that do not notice, because they are stopped, are ended by a cleanup.
#[test]
fn cleaning_ends_agents_that_cannot_end_by_themselves() {
    let shell = ["/bin/sh", "-c", "\"$0\" \"$@\"; exit $?", AGENT];
    let mut controller = Controller::start(CONTROLLER_PROGRAM, 2, 5, &shell);
    let agents = controller.agents();
    for agent in &agents {
        signal_to(agent.pid, Signal::STOP);
    }
    controller.signal(Signal::KILL);
    controller.wait();
    clean().unwrap();
    wait_until("the agents to be gone", || agents.iter().all(|a| !a.is_alive()));
    assert_eq!(left_of(&controller.root), Vec::<std::path::PathBuf>::new());
}

fn try_swarm(options: &SwarmOptions) -> Result<(), SwarmError> {
    let (mut world, mut script) = (ProbeWorld::line(2), Script::new(2));
    run_swarm(options, &ProbeSetup::default(), &mut world, &mut script).map(drop)
}

#[test]
fn a_swarm_that_cannot_start_gives_the_reason() {
    let error = try_swarm(&SwarmOptions::new("/no/such/program".into())).unwrap_err();
    assert!(matches!(error, SwarmError::Spawn { .. }), "{error}");

    let shell = |script: &str| SwarmOptions {
        program_args: vec!["-c".into(), script.into()],
        ..SwarmOptions::new("/bin/sh".into())
    };
    let error = try_swarm(&shell("echo no way >&2; exit 3")).unwrap_err();
    let text = error.to_string();
    assert!(text.contains("exited with code 3") && text.contains("no way"), "{text}");

    let mut silent = shell("exec sleep 1000");
    silent.setup_timeout = Duration::from_millis(300);
    let error = try_swarm(&silent).unwrap_err();
    assert!(matches!(error, SwarmError::SetupTimeout { missing: 2, count: 2, .. }), "{error}");

    let none = run_swarm(
        &SwarmOptions::new(AGENT.into()),
        &ProbeSetup::default(),
        &mut ProbeWorld::new(0),
        &mut Script::new(0),
    );
    assert!(matches!(none, Err(SwarmError::Size(0))));
}

/// A panic in the world or the director ends the swarm, too.
#[test]
fn a_panic_of_the_controller_ends_all_processes() {
    let own_agents = || {
        let me = std::process::id().to_string();
        let stat = |e: std::fs::DirEntry| std::fs::read_to_string(e.path().join("stat")).ok();
        let entries = std::fs::read_dir("/proc").unwrap().flatten();
        let parents = entries.filter_map(stat).filter(|s| s.contains("(panic-probe"));
        parents.filter(|s| s.rsplit_once(") ").is_some_and(|(_, r)| r.split(' ').nth(1) == Some(&me))).count()
    };
    let dir = tempfile::tempdir().unwrap();
    // Under a name of its own, to be told from the agents of other tests.
    let program = dir.path().join("panic-probe");
    std::fs::copy(AGENT, &program).unwrap();
    let seen = std::sync::Arc::new(std::sync::atomic::AtomicUsize::new(0));
    let counted = seen.clone();
    let result = std::panic::catch_unwind(move || {
        let mut script = Script::new(2).world(move |_| {
            counted.store(own_agents(), std::sync::atomic::Ordering::Relaxed);
            panic!("the world ends");
        });
        run_swarm(&SwarmOptions::new(program), &ProbeSetup::default(), &mut ProbeWorld::line(2), &mut script)
            .map(drop)
    });
    assert!(result.is_err());
    assert_eq!(seen.load(std::sync::atomic::Ordering::Relaxed), 2);
    assert_eq!(own_agents(), 0);
}

#[test]
fn a_shutdown_ends_a_swarm_that_is_not_done() {
    let options = SwarmOptions::new(AGENT.into());
    let shutdown = options.shutdown.clone();
    let mut script = Script::new(2)
        .command(Command::Pause(ModuleId(1)))
        .world(move |_| shutdown.request())
        .until("an event that never comes", |_| false);
    let outcome = run_swarm(&options, &ProbeSetup::default(), &mut ProbeWorld::line(2), &mut script).unwrap();
    assert!(outcome.interrupted && outcome.crashes.is_empty());
    assert_eq!((outcome.alive, outcome.launched), (2, 2));
}

/// Runs a long series of kills, restarts, pauses and changes of contacts under traffic: all live modules go
/// on, and the counts are balanced.
fn storm(count: u32, rounds: u32, seed: u64) -> ProcessBed {
    let mut random = Rng::named(seed, "storm", 0);
    let chat = ProbeOrder::Chat(metamorph_protocol::time::Span::millis(3));
    let mut script = Script::new(count);
    for id in 0..count {
        script = script.order(id, chat);
    }
    let mut starts = vec![1; count as usize];
    let mut paused = BTreeSet::new();
    for _ in 0..rounds {
        let id = random.below(count.into()) as u32;
        let module = ModuleId(id);
        script = match random.below(4) {
            0 | 1 => {
                paused.remove(&id);
                starts[id as usize] += 1;
                let times = starts[id as usize];
                script
                    .command(Command::Kill(module))
                    // Some restarts come before the death is known, some after.
                    .command(Command::Restart(module))
                    .until_started(id, times)
                    .order(id, chat)
            }
            2 => {
                paused.insert(id);
                script.command(Command::Pause(module))
            }
            _ => {
                paused.remove(&id);
                script.command(Command::Resume(module)).settle(id)
            }
        };
        // A module that runs, so that traffic goes on between the faults.
        if let Some(runs) = (0..count).find(|i| !paused.contains(i)) {
            script = script.settle(runs);
        }
    }
    for id in 0..count {
        script = script.command(Command::Resume(ModuleId(id))).settle(id);
    }
    let mut bed = ProcessBed::new(AGENT);
    let model = LinkModel { loss: Ratio::new(1, 20).expect("a probability"), ..LinkModel::default() };
    let tally = bed.run(&model, &mut ProbeWorld::line(count), &mut script);
    assert_eq!(script.gave_up, None);
    let restarts = starts.iter().map(|l| l - 1).sum::<usize>() as u32;
    let outcome = &bed.outcome;
    assert_eq!(outcome.crashes, []);
    assert_eq!((outcome.alive, outcome.restarted, outcome.killed), (count, restarts, restarts));
    assert_eq!((outcome.foreign, outcome.missing_counters.len()), (0, 0));
    for (class, counts) in tally.iter() {
        assert!(counts.in_flight() >= 0, "{class} {counts:?}");
    }
    let total = tally.total();
    assert!(total.delivered > 0 && total.lost > 0, "{total:?}");
    bed
}

#[test]
fn a_storm_of_kills_restarts_and_pauses() {
    storm(12, 60, 1);
}

/// Takes a while: `cargo test --release -p metamorph-tests ipc_chaos:: -- --ignored --nocapture`.
#[test]
#[ignore = "takes half a minute of both cores"]
fn a_long_storm_over_many() {
    let bed = storm(100, 1_500, 2);
    println!("{:#?}", bed.outcome);
}

/// A neighbour is restarted far more often than an inbox has places: those of dead incarnations are released.
#[test]
fn dead_incarnations_release_their_places() {
    const RESTARTS: u32 = 40;
    let module = ModuleId(1);
    let mut script = Script::new(2);
    for number in 1..=RESTARTS {
        // With the first message the neighbour takes a place.
        script = script.send(1, 0, number, 1).until_got(0, 1, number as usize);
        script = script.command(Command::Kill(module)).until_died(1, number as usize);
        script = script.command(Command::Restart(module)).until_started(1, number as usize + 1);
    }
    let mut script = script.settle(0);
    let mut bed = ProcessBed::new(AGENT);
    bed.run(&LinkModel::default(), &mut ProbeWorld::line(2), &mut script);
    assert_eq!(script.gave_up, None);
    assert_eq!(script.log.got(ModuleId(0), Port(1)), (1..=RESTARTS).collect::<Vec<_>>());
    assert_eq!((bed.outcome.alive, bed.outcome.killed, bed.outcome.restarted), (2, RESTARTS, RESTARTS));
    assert_eq!((bed.outcome.crashes.len(), bed.outcome.foreign), (0, 0));
}
