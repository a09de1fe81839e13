//! A run on several threads is the run on one: trace, counts, states, what the controller was told.

use metamorph_protocol::agent::{Agent, Birth, Input, InputOf, Output, OutputOf};
use metamorph_protocol::counters::Class;
use metamorph_protocol::counters::Tally;
use metamorph_protocol::coverage::{self, Marks};
use metamorph_protocol::ids::{ModuleId, Port};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::link::{LinkModel, Partition};
use metamorph_protocol::rng::Stream;
use metamorph_protocol::time::{Span, Time};
use metamorph_protocol::wire::Never;
use metamorph_sim_bridge::director::port::{Command, Direct};
use metamorph_sim_bridge::kernel::sim::{Listens, Sim, SimConfig};
use metamorph_sim_bridge::kernel::still_world::StillWorld;
use metamorph_sim_bridge::testing::flood::{Flooded, Hops, Onlooker};
use std::collections::VecDeque;
use std::hash::Hasher;
use std::sync::Arc;

/// Says something now and then, answers some of what it hears, and reports some of it. What it has heard,
/// in which order and when, is its state.
struct Gossip {
    chance: Stream,
    heard: u32,
    ports: Vec<Port>,
    wake: Time,
    left: u8,
    fails: bool,
    out: VecDeque<OutputOf<Gossip>>,
}

impl Gossip {
    fn say(&mut self) {
        if !self.ports.is_empty() {
            let port = self.ports[self.chance.below(self.ports.len() as u64) as usize];
            self.out.push_back(Output::Send { port, class: Class::Seed, message: Hops(self.heard) });
        }
    }
}

impl Agent for Gossip {
    type Setup = ();
    type Place = Cell;
    type Message = Hops;
    type Action = Never;
    type Percept = Never;
    type Order = Never;
    type Report = Hops;
    const PORTS: usize = 6;

    fn new(_: &Arc<()>, birth: Birth<Cell>, now: Time) -> Gossip {
        let chance = Stream::named(birth.seed, "gossip", birth.id.0.into());
        // One whose blocks are not those of the first thread.
        let fails = birth.seed == FAILS && birth.id.0 == 600;
        Gossip { chance, heard: 0, ports: Vec::new(), wake: now, left: 30, fails, out: VecDeque::new() }
    }

    fn handle(&mut self, now: Time, input: InputOf<Gossip>) {
        match input {
            Input::Contact { port, .. } => self.ports.push(port),
            Input::Wake => {
                self.left -= 1;
                assert!(!self.fails || self.left > 20, "this module fails");
                // From at once to several times the delays of the links.
                let pause = Span::millis(5) * self.chance.below(14);
                self.wake = if self.left == 0 { Time::NEVER } else { now + pause };
                self.say();
            }
            Input::Message { port, message } => {
                let mixed = self.heard ^ message.0 ^ now.0 as u32 ^ u32::from(port.0);
                self.heard = mixed.wrapping_mul(0x9E37_79B1).rotate_left(7);
                match self.chance.below(4) {
                    0 => self.say(),
                    1 => self.out.push_back(Output::Report(Hops(self.heard))),
                    _ => {}
                }
            }
            Input::Percept(never) | Input::Order(never) => match never {},
        }
    }

    fn poll(&mut self) -> Option<OutputOf<Gossip>> {
        self.out.pop_front()
    }
    fn wake_at(&self) -> Time {
        self.wake
    }
    fn digest(&self, hasher: &mut dyn Hasher) {
        hasher.write_u32(self.heard);
    }
}

/// The seed with which a module fails.
const FAILS: u64 = 99;

/// Writes down what it is told, and is woken every second.
#[derive(Default)]
struct Scribe {
    told: Vec<(Time, ModuleId, Hops)>,
    woken: u64,
}

impl Listens for Scribe {}

impl Direct<StillWorld<Gossip>> for Scribe {
    fn report(&mut self, now: Time, id: ModuleId, report: Hops) {
        self.told.push((now, id, report));
    }
    fn died(&mut self, _: Time, _: ModuleId) {}
    fn started(&mut self, _: Time, _: ModuleId) {}
    fn wake(&mut self, now: Time, _: &mut StillWorld<Gossip>) {
        self.woken = now.0 / Span::secs(1).0;
    }
    fn wake_at(&self) -> Time {
        if self.woken < 3 { Time::ZERO + Span::secs(1) * (self.woken + 1) } else { Time::NEVER }
    }
    fn poll(&mut self) -> Option<Command<Never>> {
        None
    }
}

/// All that can be seen of a run.
#[derive(Debug, PartialEq)]
struct Seen {
    trace: u64,
    events: u64,
    digest: u64,
    tally: Tally,
    checked: u64,
    body_messages: u64,
    broken: u64,
    marks: Marks,
    now: Time,
    over: bool,
}

fn see<A, D>(sim: &Sim<StillWorld<A>, D>, over: bool) -> Seen
where
    A: Agent<Place = Cell, Action = Never, Percept = Never>,
    D: Direct<StillWorld<A>>,
{
    Seen {
        trace: sim.trace().value(),
        events: sim.trace().events(),
        digest: sim.agents_hash(),
        tally: *sim.tally(),
        checked: sim.checked(),
        body_messages: sim.body_messages(),
        broken: sim.violations().1,
        marks: coverage::take(),
        now: sim.now(),
        over,
    }
}

fn config(link: LinkModel, seed: u64) -> SimConfig<Gossip> {
    SimConfig { setup: Arc::new(()), link, seed, audit_every: Span::millis(300), ignore_sessions: false }
}

/// Links of every kind. Where all delays are the same, whole waves come at one instant.
fn links() -> Vec<(&'static str, LinkModel)> {
    let delays = |min, max| LinkModel {
        delay_min: Span::millis(min),
        delay_max: Span::millis(max),
        ..LinkModel::default()
    };
    let percent = |n: u32| format!("{n}%").parse().expect("a share");
    let evils = LinkModel {
        loss: percent(5),
        duplicate: percent(10),
        reorder: percent(10),
        corrupt: percent(5),
        ..delays(10, 100)
    };
    let cut = Partition {
        from: Time::ZERO + Span::millis(100),
        until: Time::ZERO + Span::millis(700),
        side: (0..700).map(ModuleId).collect(),
    };
    vec![
        ("any delay", delays(10, 100)),
        ("one delay", delays(20, 20)),
        ("no delay", delays(0, 0)),
        ("everything goes wrong", evils.clone()),
        ("for a while", LinkModel { harmless_from: Some(Time::ZERO + Span::millis(500)), ..evils.clone() }),
        ("cut in two", LinkModel { partitions: vec![cut], ..evils }),
    ]
}

/// More modules than a lane has at a time, so that there is one for each of three threads.
const SIDES: [u16; 3] = [17, 11, 13];

fn gossip(link: &LinkModel, seed: u64, threads: usize, stops: &[u64]) -> (Vec<Seen>, Scribe) {
    coverage::take();
    let mut sim = Sim::new(config(link.clone(), seed), StillWorld::new(SIDES), Scribe::default());
    let mut seen = Vec::new();
    for stop in stops.iter().map(|ms| Time::ZERO + Span::millis(*ms)) {
        let over = sim.run_on(threads, stop);
        seen.push(see(&sim, over));
    }
    let Scribe { told, woken } = sim.director();
    (seen, Scribe { told: told.clone(), woken: *woken })
}

#[test]
fn a_run_is_the_same_on_any_number_of_threads() {
    for (name, link) in links() {
        for seed in 1..3 {
            // Stopped in the middle of a window, and at an instant at which much is due.
            let stops = [1, 333, 340, 1_000, 60_000];
            let (one, by_one) = gossip(&link, seed, 1, &stops);
            let end = one.last().unwrap();
            assert!(end.over && end.events > 10_000, "{name}: {end:?}");
            assert!(by_one.told.len() > 1_000 && by_one.woken == 3, "{name}");
            for threads in [2, 3] {
                let (many, by_many) = gossip(&link, seed, threads, &stops);
                assert_eq!(one, many, "{name}, seed {seed}, {threads} threads");
                assert_eq!(by_one.told, by_many.told, "{name}, seed {seed}, {threads} threads");
            }
        }
    }
}

#[test]
fn a_flood_is_the_same_on_any_number_of_threads() {
    for sides in [[2, 1, 1], [12, 12, 12], [3, 40, 40]] {
        let link =
            LinkModel { delay_min: Span::millis(100), delay_max: Span::millis(101), ..LinkModel::default() };
        let run = |threads| {
            coverage::take();
            let config = SimConfig {
                setup: Arc::new(()),
                link: link.clone(),
                seed: 1,
                audit_every: Span::secs(1),
                ignore_sessions: false,
            };
            let mut sim = Sim::new(config, StillWorld::<Flooded>::new(sides), Onlooker::default());
            let over = sim.run_on(threads, Time(u64::MAX - 1));
            (see(&sim, over), sim.director().know)
        };
        let one = run(1);
        assert_eq!(one.1, sides.iter().map(|n| u64::from(*n)).product::<u64>());
        for threads in [2, 3] {
            assert_eq!(run(threads), one, "{sides:?}, {threads} threads");
        }
    }
}

/// Threads that wait for one that has failed fail too, instead of waiting for ever.
#[test]
#[should_panic(expected = "lane")]
fn a_failing_agent_ends_the_run() {
    let link = LinkModel { delay_min: Span::millis(10), delay_max: Span::millis(20), ..LinkModel::default() };
    gossip(&link, FAILS, 2, &[60_000]);
}
