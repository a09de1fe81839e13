//! The link between two hosts over a carrier that loses, doubles, reorders, cuts and restarts: random runs, and all runs
//! within small bounds. Each known defect is found.

mod hostile;
mod pair;

use metamorph_core::defects::HostLinkDefect;
use metamorph_core::time::{Span, Time};
use metamorph_host_link::packet::{Content, Packet, Run};
use metamorph_host_link::{Channel, Config, HostLink, Offered, Output, Refused, State};
use pair::{Pair, Plain, WINDOW};
use proptest::prelude::*;
use proptest::test_runner::{Config as ProptestConfig, TestRunner};
use stateright::{Checker, Model, Property};

/// One step of a run. Numbers are taken modulo what there is.
#[derive(Clone, Copy, Debug)]
enum Step {
    Offer(usize),
    Write(usize, bool, usize),
    Flush(usize),
    Deliver(usize),
    Double(usize),
    Lose(usize),
    Pass(u64),
    /// Time passes while packets are delivered in order.
    Carry(u64),
    Restart(usize),
    Cut(usize, bool),
    Reconnect(usize, bool),
}

fn step() -> impl Strategy<Value = Step> {
    let end = 0..2usize;
    prop_oneof![
        6 => end.clone().prop_map(Step::Offer),
        4 => (end.clone(), any::<bool>(), 1..9usize).prop_map(|(i, bulk, n)| Step::Write(i, bulk, n)),
        4 => end.clone().prop_map(Step::Flush),
        24 => (0..4usize).prop_map(Step::Deliver),
        4 => (0..4usize).prop_map(Step::Double),
        3 => (0..4usize).prop_map(Step::Lose),
        6 => (1..400u64).prop_map(Step::Pass),
        1 => (400..5_000u64).prop_map(Step::Pass),
        2 => (50..5_000u64).prop_map(Step::Carry),
        1 => end.clone().prop_map(Step::Restart),
        1 => (end.clone(), any::<bool>()).prop_map(|(i, cut)| Step::Cut(i, cut)),
        1 => (end, any::<bool>()).prop_map(|(i, up)| Step::Reconnect(i, up)),
    ]
}

fn take(pair: &mut Pair, step: Step) {
    let packets = pair.under_way.len();
    match step {
        Step::Offer(i) => {
            pair.offer(i);
        }
        Step::Write(i, bulk, length) => {
            pair.write(i, if bulk { Channel::Bulk } else { Channel::Stream }, length);
        }
        Step::Flush(i) => pair.flush(i),
        Step::Deliver(_) | Step::Double(_) | Step::Lose(_) if packets == 0 => {}
        Step::Deliver(index) => pair.deliver(index % packets, false),
        Step::Double(index) => pair.deliver(index % packets, true),
        Step::Lose(index) => pair.lose(index % packets),
        Step::Pass(ms) => pair.pass(pair.now + Span::millis(ms)),
        Step::Carry(ms) => pair.carry(Span::millis(ms)),
        Step::Restart(i) => pair.restart(i),
        Step::Cut(i, is_cut) => pair.cut(i, is_cut),
        Step::Reconnect(i, is_up) => pair.reconnect(i, is_up),
    }
}

/// Runs the steps, and returns what broke.
fn broken(defect: Option<HostLinkDefect>, steps: &[Step]) -> Option<&'static str> {
    let mut pair = Pair::up(defect);
    for step in steps {
        take(&mut pair, *step);
        if pair.broken.is_some() {
            return pair.broken;
        }
    }
    pair.settle();
    pair.broken
}

fn runner(cases: u32) -> TestRunner {
    TestRunner::new_with_rng(
        ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() },
        proptest::test_runner::TestRng::deterministic_rng(proptest::test_runner::RngAlgorithm::ChaCha),
    )
}

#[test]
fn random_runs_break_nothing() {
    let steps = proptest::collection::vec(step(), 0..150);
    let result = runner(1_500).run(&steps, |steps| {
        let broken = broken(None, &steps);
        prop_assert!(broken.is_none(), "{}", broken.unwrap_or_default());
        Ok(())
    });
    if let Err(error) = result {
        panic!("{error}");
    }
}

/// Defects that take a certain order of several restarts and greetings, which random runs hardly ever have.
const OF_GREETINGS: [HostLinkDefect; 2] = [HostLinkDefect::AnyAttempt, HostLinkDefect::AnyChallenge];

/// Each defect breaks something in a random run.
#[test]
fn random_runs_find_every_defect() {
    for defect in HostLinkDefect::ALL.into_iter().filter(|d| !OF_GREETINGS.contains(d)) {
        let steps = proptest::collection::vec(step(), 0..150);
        let found = runner(3_000).run(&steps, |steps| {
            prop_assert!(broken(Some(defect), &steps).is_none());
            Ok(())
        });
        assert!(found.is_err(), "{defect:?} was not found");
    }
}

/// A model of all runs with a few packets, in which one end has something to send.
struct Bounded {
    defect: Option<HostLinkDefect>,
    depth: usize,
}

/// A state, and what may still happen.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Moment {
    pair: Pair,
    steps: usize,
    frames: u8,
    writes: u8,
    losses: u8,
    doubles: u8,
    restarts: u8,
    wakes: u8,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Choice {
    Send,
    Write,
    Deliver(usize),
    Double(usize),
    Lose(usize),
    Restart(usize),
    Wake,
}

impl Model for Bounded {
    type State = Moment;
    type Action = Choice;

    fn init_states(&self) -> Vec<Moment> {
        let mut pair = Pair::up(self.defect);
        while !pair.under_way.is_empty() {
            pair.deliver(0, false);
        }
        let first =
            Moment { pair, steps: 0, frames: 3, writes: 2, losses: 1, doubles: 1, restarts: 1, wakes: 2 };
        vec![first]
    }

    fn actions(&self, at: &Moment, actions: &mut Vec<Choice>) {
        if at.steps == self.depth || at.pair.broken.is_some() {
            return;
        }
        actions.extend((at.frames > 0).then_some(Choice::Send));
        actions.extend((at.writes > 0).then_some(Choice::Write));
        actions.extend((at.wakes > 0).then_some(Choice::Wake));
        actions.extend((0..2).filter(|_| at.restarts > 0).map(Choice::Restart));
        for i in 0..at.pair.under_way.len() {
            actions.push(Choice::Deliver(i));
            actions.extend((at.doubles > 0).then_some(Choice::Double(i)));
            actions.extend((at.losses > 0).then_some(Choice::Lose(i)));
        }
    }

    fn next_state(&self, at: &Moment, choice: Choice) -> Option<Moment> {
        let mut next = at.clone();
        next.steps += 1;
        match choice {
            Choice::Send => {
                next.frames -= 1;
                next.pair.offer(0);
                next.pair.flush(0);
            }
            Choice::Write => {
                next.writes -= 1;
                next.pair.write(0, Channel::Stream, 2);
            }
            Choice::Deliver(i) => next.pair.deliver(i, false),
            Choice::Double(i) => {
                next.doubles -= 1;
                next.pair.deliver(i, true);
            }
            Choice::Lose(i) => {
                next.losses -= 1;
                next.pair.lose(i);
            }
            Choice::Restart(i) => {
                next.restarts -= 1;
                next.pair.restart(i);
            }
            Choice::Wake => {
                next.wakes -= 1;
                next.pair.wake_next();
            }
        }
        // Packets are a set: their order does not matter, since any may come next.
        next.pair.under_way.sort();
        Some(next)
    }

    fn properties(&self) -> Vec<Property<Bounded>> {
        vec![Property::always("nothing breaks", |_, at: &Moment| at.pair.broken.is_none())]
    }
}

fn check(defect: Option<HostLinkDefect>, depth: usize) -> (usize, bool) {
    let checker = Bounded { defect, depth }.checker().spawn_bfs().join();
    (checker.unique_state_count(), checker.discovery("nothing breaks").is_some())
}

#[test]
fn all_short_runs_break_nothing() {
    let (states, is_broken) = check(None, 7);
    println!("{states} states");
    assert!(!is_broken && states > 1_000, "{states} states");
}

#[test]
#[ignore = "takes a minute"]
fn all_longer_runs_break_nothing() {
    let (states, is_broken) = check(None, 9);
    println!("{states} states");
    assert!(!is_broken, "{states} states");
}

/// Defects that a few steps suffice to show.
#[test]
fn short_runs_find_defects() {
    for defect in [HostLinkDefect::TakeDoubled, HostLinkDefect::SkipGaps, HostLinkDefect::CountLossTwice] {
        assert!(check(Some(defect), 7).1, "{defect:?}");
    }
}

const HELLO: u8 = 1;
const ACCEPT: u8 = 2;
const CONFIRM: u8 = 3;

/// Delivers one greeting from hello to confirm.
fn greet(pair: &mut Pair) {
    for kind in [HELLO, ACCEPT, CONFIRM] {
        let packet = pair.hold_back(kind);
        pair.release(packet);
    }
}

/// The accept of a life that has ended comes after its successor has been met.
#[test]
fn a_late_accept_is_refused() {
    for (defect, broken) in [(None, None), (Some(OF_GREETINGS[0]), Some("an earlier life came back"))] {
        let mut pair = Pair::up(defect);
        pair.restart(1);
        pair.pass(pair.now + Span::millis(1_300));
        let hello = pair.hold_back(HELLO);
        pair.release(hello);
        let late = pair.hold_back(ACCEPT);
        pair.restart(1);
        pair.under_way.clear();
        pair.pass(pair.now + Span::millis(300));
        greet(&mut pair);
        assert_eq!((pair.broken, pair.state(0), pair.state(1)), (None, State::Up, State::Up));
        pair.release(late);
        assert_eq!(pair.broken, broken, "{defect:?}");
    }
}

/// Hello and confirmation of a life that has ended come after its successor has been met.
#[test]
fn a_late_confirmation_is_refused() {
    for (defect, broken) in [(None, None), (Some(OF_GREETINGS[1]), Some("an earlier life came back"))] {
        let mut pair = Pair::up(defect);
        pair.under_way.clear();
        pair.restart(0);
        let hello = pair.hold_back(HELLO);
        pair.release(hello.clone());
        let accept = pair.hold_back(ACCEPT);
        pair.release(accept);
        let late = pair.hold_back(CONFIRM);
        pair.pass(pair.now + Span::millis(10));
        pair.restart(0);
        greet(&mut pair);
        assert_eq!((pair.broken, pair.state(1)), (None, State::Up));
        pair.release(hello);
        pair.release(late);
        assert_eq!(pair.broken, broken, "{defect:?}");
    }
}

/// A change of one end's configuration, and why the other refuses it.
type Disagreement = (fn(&mut Config), Refused);

/// Both ends have to run the same program on the same swarm, and know the secret.
#[test]
fn ends_that_do_not_agree_refuse_each_other() {
    let changes: [Disagreement; 4] = [
        (|c| c.terms.program = 9, Refused::Terms("they run different versions of the program")),
        (|c| c.terms.build = 9, Refused::Terms("they run different builds of the program")),
        (|c| c.terms.swarm = 9, Refused::Terms("they have different swarm files")),
        (|c| c.run = Run(9), Refused::Foreign),
    ];
    for (change, expected) in changes {
        let mut config = pair::config(1, 2, None);
        change(&mut config);
        let now = Time(1);
        let (mut here, mut there) =
            (HostLink::new(pair::config(0, 1, None), Plain), HostLink::new(config, Plain));
        here.carrier_up(now);
        there.carrier_up(now);
        let hello = std::iter::from_fn(|| here.poll()).find_map(|output| match output {
            Output::Packet(bytes) => Some(bytes),
            _ => None,
        });
        assert_eq!(there.receive(now, &hello.expect("the first end says hello")), Err(expected));
        assert_eq!((there.state(), there.refused()), (State::Greeting, 1));
    }
}

#[test]
fn a_wrong_proof_is_refused() {
    let mut pair = Pair::up(None);
    pair.under_way.clear();
    pair.restart(0);
    let (to, bytes) = pair.hold_back(HELLO);
    pair.release((to, bytes));
    let (to, bytes) = pair.hold_back(ACCEPT);
    let mut packet = Packet::decode(&bytes).expect("a sound packet");
    let Content::Accept { proof, .. } = &mut packet.content else { panic!("an accept") };
    proof[0] ^= 1;
    pair.release((to, packet.encode()));
    assert_eq!((pair.state(0), pair.broken), (State::Greeting, None));
    pair.release((to, bytes));
    assert_eq!((pair.state(0), pair.broken), (State::Up, None));
}

#[test]
fn what_does_not_fit_into_the_window_overflows() {
    let mut pair = Pair::up(None);
    let fates: Vec<Offered> = (0..WINDOW + 1).map(|_| pair.offer(0)).collect();
    assert_eq!(fates[..WINDOW], [Offered::Queued; WINDOW]);
    assert_eq!(fates[WINDOW], Offered::Overflowed);
}

/// One direction is cut for longer than the fence: the ward stops before its guardian counts it as dead.
#[test]
fn a_cut_in_either_direction_ends_the_ward_first() {
    for direction in 0..2 {
        let mut pair = Pair::up(None);
        pair.cut(direction, true);
        let mut stopped = None;
        for _ in 0..200 {
            pair.carry(Span::millis(50));
            if pair.state(1) == State::Fenced {
                stopped.get_or_insert(pair.now);
            }
            if pair.state(0) == State::Fenced {
                break;
            }
        }
        assert!(stopped.is_some() && pair.state(0) == State::Fenced, "direction {direction}");
        assert_eq!(pair.broken, None);
    }
}

/// A cut that ends in time loses frames, counted, and nothing of the stream.
#[test]
fn a_short_cut_heals() {
    let mut pair = Pair::up(None);
    pair.cut(0, true);
    pair.cut(1, true);
    pair.write(0, Channel::Stream, 100_000);
    assert_eq!(pair.offer(0), Offered::Queued);
    pair.pass(pair.now + Span::millis(1_500));
    assert_eq!((pair.state(0), pair.state(1)), (State::Silent, State::Silent));
    assert_eq!(pair.offer(0), Offered::Lost);
    pair.settle();
    assert_eq!((pair.broken, pair.state(0), pair.state(1)), (None, State::Up, State::Up));
}

/// The process of the ward is held up while nothing reaches it: at its first look it ends, however late that is, and not a moment
/// before its lease is over.
#[test]
fn a_ward_that_looks_late_ends_only_after_its_lease() {
    for (late, is_over) in [(2_000, false), (2_800, false), (3_000, true), (3_600_000, true)] {
        let mut pair = Pair::up(None);
        pair.look_late(1, Span::millis(late));
        assert_eq!(pair.state(1) == State::Fenced, is_over, "{late} ms late");
        assert_eq!(pair.broken, None);
    }
}

/// The same of the guardian, which waits for the whole fence.
#[test]
fn a_guardian_that_looks_late_waits_for_the_fence() {
    for (late, is_over) in [(2_000, false), (2_900, false), (3_100, true), (3_600_000, true)] {
        let mut pair = Pair::up(None);
        pair.look_late(0, Span::millis(late));
        assert_eq!(pair.state(0) == State::Fenced, is_over, "{late} ms late");
    }
}
