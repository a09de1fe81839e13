//! One run on several threads, bit by bit the same as on one: where nothing moves and the controller
//! only listens.
//!
//! Every message is on its way for the shortest delay at least. What modules do within a window of that
//! length reaches others only after it, so within a window they are independent. Blocks of modules are
//! dealt out to lanes, a thread for each, and a window has three steps:
//!
//! 1. Each lane carries out its events in their order. It logs them, and posts what they schedule.
//! 2. One thread goes through all logs in the order of a single queue: trace, reports, audits, and the
//!    number that everything posted would have had there.
//! 3. Each lane takes what was posted to it, in the order of these numbers.
//!
//! Deliberately absent: worlds in which modules move. There an action changes what its neighbours sense
//! at the same instant, and audits look at neighbours after every input, so windows would have to end
//! wherever somebody might act. Nor is it checked here that time passes: no message comes within its window.

use super::{AT_HAND, Link, Module, Parcel, Process, Sent, Sim};
use crate::director::port::Direct;
use crate::kernel::queue::Queue;
use crate::kernel::still_world::StillWorld;
use crate::kernel::trace::Trace;
use crate::world::invariants::{self, Invariant, PerClass, Violation};
use metamorph_protocol::agent::{Agent, Input, Output};
use metamorph_protocol::counters::Tally;
use metamorph_protocol::coverage::{self, Mark, hit};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::time::{Span, Time};
use metamorph_protocol::wire::{Never, Wire};
use slab::Slab;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, RwLock, RwLockWriteGuard};

/// Modules of a block; neighbouring blocks belong to different lanes, so that work is shared evenly
/// wherever it is.
const BLOCK: usize = 1 << 9;
/// The number of a wake-up that was scheduled in the window in which it is due, among those of its lane.
const OWN: u64 = 1 << 63;
/// How often a lane looks whether the others have come before it lets other programs run.
const LOOKS: u32 = 4_000;

/// A controller that never gives a command, whatever is reported. It may ask to be woken.
pub trait Listens {}

/// Something scheduled, and its number among all that was scheduled.
struct Numbered<M> {
    number: u64,
    what: What<M>,
}

enum What<M> {
    Arrive(Parcel<M>),
    Wake(ModuleId),
}

/// Something scheduled by the event at this place of the log, the `nth` of what that event scheduled.
struct Posted<M> {
    event: u32,
    nth: u32,
    at: Time,
    what: What<M>,
}

/// An event carried out. Another thread reads it, so it is kept small.
struct Event {
    at: Time,
    number: u64,
    /// For the trace, if a message was delivered; otherwise [`NOTHING`].
    heard: u64,
    who: ModuleId,
    /// How much it scheduled.
    posted: u32,
}

/// No session and kind make this number.
const NOTHING: u64 = u64::MAX;

/// What a lane did in a window. What few events do stands beside the number of the event.
struct Log<A: Agent> {
    events: Vec<Event>,
    reports: Vec<(usize, A::Report)>,
    /// Events of which the last thing that they scheduled is due in the same window.
    wakers: Vec<usize>,
    /// For each event, the number of the first thing that it scheduled.
    numbers: Vec<u64>,
    /// Messages of this lane that are under way, what it has posted included.
    under_way: PerClass,
    /// Counts since the beginning.
    tally: Tally,
    body_messages: u64,
    checked: u64,
}

impl<A: Agent> Log<A> {
    fn new() -> Log<A> {
        Log {
            events: Vec::new(),
            reports: Vec::new(),
            wakers: Vec::new(),
            numbers: Vec::new(),
            under_way: PerClass::default(),
            tally: Tally::default(),
            body_messages: 0,
            checked: 0,
        }
    }
}

type Posts<A> = Vec<Posted<<A as Agent>::Message>>;

/// Something that one thread changes all the time, away from what other threads look at: lines of the
/// cache, in pairs, go from one processor to the other as a whole.
#[repr(align(128))]
struct Apart<T>(T);

/// What lanes have in common.
struct Shared<'a, A: Agent> {
    link: &'a LinkModel,
    lanes: usize,
    logs: Vec<Apart<RwLock<Log<A>>>>,
    /// By the lane that posts, then by the lane it is for.
    boxes: Vec<Apart<Mutex<Posts<A>>>>,
    /// When the next event of each lane is due.
    next: Vec<AtomicU64>,
    meeting: Meeting,
}

impl<A: Agent> Shared<'_, A> {
    fn lane_of(&self, id: ModuleId) -> usize {
        id.index() / BLOCK % self.lanes
    }
    fn log(&self, lane: usize) -> RwLockWriteGuard<'_, Log<A>> {
        self.logs[lane].0.write().expect("invariant: a lane that fails ends the run")
    }
    fn post(&self, from: usize, to: usize) -> MutexGuard<'_, Posts<A>> {
        self.boxes[from * self.lanes + to].0.lock().expect("invariant: a lane that fails ends the run")
    }
}

/// Where lanes wait for each other. Windows are shorter than it takes to wake a thread, so they look.
#[derive(Default)]
struct Meeting {
    come: AtomicUsize,
    rounds: AtomicUsize,
    failed: AtomicBool,
}

impl Meeting {
    fn wait(&self, lanes: usize) {
        let round = self.rounds.load(Ordering::Acquire);
        if self.come.fetch_add(1, Ordering::AcqRel) + 1 == lanes {
            self.come.store(0, Ordering::Release);
            self.rounds.store(round + 1, Ordering::Release);
            return;
        }
        let mut looks = 0;
        while self.rounds.load(Ordering::Acquire) == round {
            assert!(!self.failed.load(Ordering::Relaxed), "another lane of the run has failed");
            looks += 1;
            if looks < LOOKS { std::hint::spin_loop() } else { std::thread::yield_now() }
        }
    }
}

/// Tells the others if its lane panics, for they would wait for ever.
struct Watch<'a>(&'a Meeting);

impl Drop for Watch<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.failed.store(true, Ordering::Relaxed);
        }
    }
}

/// Every so manieth block of modules, what is scheduled for them, and the thread that carries it out.
struct Lane<'a, A: Agent> {
    index: usize,
    modules: Vec<&'a mut [Module<A>]>,
    links: Vec<&'a mut [Link]>,
    queue: Queue<u32>,
    scheduled: Slab<Numbered<A::Message>>,
    /// Messages among what is scheduled.
    messages: PerClass,
}

impl<A: Agent<Action = Never>> Lane<'_, A> {
    fn put(&mut self, at: Time, number: u64, what: What<A::Message>) {
        if let What::Arrive(parcel) = &what {
            self.messages[parcel.class.index()] += 1;
        }
        // Invariant: 2^32 messages under way would not fit into memory.
        let index = self.scheduled.insert(Numbered { number, what }) as u32;
        self.queue.push(at, index);
    }

    /// Carries out what is due before `horizon`, window by window.
    fn run(&mut self, shared: &Shared<'_, A>, horizon: Time, mut merge: impl FnMut()) {
        loop {
            let next = shared.next.iter().map(|at| at.load(Ordering::Relaxed)).min();
            let first = Time(next.expect("invariant: there is a lane"));
            if first >= horizon {
                return;
            }
            self.window(shared, horizon.min(first + shared.link.delay_min));
            shared.meeting.wait(shared.lanes);
            merge();
            shared.meeting.wait(shared.lanes);
            self.take(shared);
            shared.next[self.index].store(self.queue.next_at().0, Ordering::Relaxed);
            shared.meeting.wait(shared.lanes);
        }
    }

    /// Carries out the events before `end`.
    fn window(&mut self, shared: &Shared<'_, A>, end: Time) {
        let lanes = shared.lanes;
        let mut log = shared.log(self.index);
        let log = &mut *log;
        log.events.clear();
        log.wakers.clear();
        let mut boxes: Vec<_> = (0..lanes).map(|to| shared.post(self.index, to)).collect();
        let mut sent = PerClass::default();
        while self.queue.next_at() < end {
            if self.queue.taken().is_multiple_of(AT_HAND) {
                self.look_ahead(lanes);
            }
            let Some((at, index)) = self.queue.pop() else { break };
            let Numbered { number, what } = self.scheduled.remove(index as usize);
            let id = match &what {
                What::Arrive(parcel) => parcel.to,
                What::Wake(id) => *id,
            };
            let (block, place) = (id.index() / BLOCK / lanes, id.index() % BLOCK);
            let module = &mut self.modules[block][place];
            let links = &mut self.links[block][place * A::PORTS..(place + 1) * A::PORTS];
            let mut event = Event { at, number, heard: NOTHING, who: id, posted: 0 };
            let input = match what {
                What::Wake(_) => {
                    let current = module.wake == at;
                    if current {
                        module.wake = Time::NEVER;
                    }
                    (current && module.process == Process::Running).then_some(Input::Wake)
                }
                What::Arrive(Parcel { session, port, class, message, .. }) => {
                    self.messages[class.index()] -= 1;
                    let current = links[port.index()].contact.map(|c| c.session);
                    let counts = &mut log.tally[class];
                    if module.process == Process::Dead {
                        counts.expired += 1;
                        None
                    } else if current != Some(session) {
                        hit(Mark::DriverExpired);
                        counts.expired += 1;
                        None
                    } else {
                        // That sessions are current, which is what was just asked.
                        log.checked += 1;
                        counts.delivered += 1;
                        event.heard = u64::from(session.0) << 8 | u64::from(message.kind());
                        Some(Input::Message { port, message })
                    }
                }
            };
            if let (Some(input), true) = (input, module.agent.is_some()) {
                let place = log.events.len();
                let mut post = |to: usize, at, what| {
                    boxes[to].push(Posted { event: place as u32, nth: event.posted, at, what });
                    event.posted += 1;
                };
                if let Some(agent) = &mut module.agent {
                    agent.handle(at, input);
                }
                while let Some(output) = module.agent.as_mut().and_then(Agent::poll) {
                    match output {
                        Output::Send { port, class, message } => {
                            let put = |at, parcel: Parcel<A::Message>| {
                                sent[parcel.class.index()] += 1;
                                post(shared.lane_of(parcel.to), at, What::Arrive(parcel));
                            };
                            let link = &mut links[port.index()];
                            let what = Sent { from: id, port, class, message };
                            module.send(shared.link, at, what, link, &mut log.tally, put);
                        }
                        Output::Act(never) => match never {},
                        Output::Report(report) => {
                            log.body_messages += 1;
                            log.reports.push((place, report));
                        }
                    }
                }
                let wake = module.plan_wake(at);
                // What one agent's input may have broken: nothing, in a still world.
                log.checked += 1;
                match wake {
                    Some(wake) if wake < end => {
                        event.posted += 1;
                        self.put(wake, OWN | log.wakers.len() as u64, What::Wake(id));
                        log.wakers.push(place);
                    }
                    Some(wake) => post(self.index, wake, What::Wake(id)),
                    None => {}
                }
            }
            log.events.push(event);
        }
        log.under_way = std::array::from_fn(|class| self.messages[class] + sent[class]);
    }

    /// As [`Sim::look_ahead`].
    fn look_ahead(&self, lanes: usize) {
        let coming = self.queue.coming();
        if coming.len() < AT_HAND {
            return;
        }
        let whom = |from: usize| {
            let events = coming.iter().skip(from).take(AT_HAND);
            events.filter_map(|e| match self.scheduled.get(e.what as usize).map(|s| &s.what) {
                Some(What::Arrive(parcel)) => Some(parcel.to.index()),
                _ => None,
            })
        };
        let mut read = 0;
        for index in whom(AT_HAND) {
            read ^= index as u32;
        }
        for index in whom(0) {
            let (block, place) = (index / BLOCK / lanes, index % BLOCK);
            for link in self.links[block][place * A::PORTS..(place + 1) * A::PORTS].iter().step_by(2) {
                read ^= link.last_arrival.0 as u32;
            }
            read ^= self.modules[block][place].revision.0;
        }
        std::hint::black_box(read);
    }

    /// Takes what was posted to this lane, in the order in which a single thread would have scheduled it.
    fn take(&mut self, shared: &Shared<'_, A>) {
        let logs: Vec<_> = shared
            .logs
            .iter()
            .map(|log| log.0.read().expect("invariant: a lane that fails ends the run"))
            .collect();
        let mut boxes: Vec<_> = (0..shared.lanes).map(|from| shared.post(from, self.index)).collect();
        let mut posts: Vec<_> = boxes
            .iter_mut()
            .zip(&logs)
            .map(|(posts, log)| {
                let number = |p: &Posted<A::Message>| log.numbers[p.event as usize] + u64::from(p.nth);
                posts.drain(..).map(move |p| (number(&p), p)).peekable()
            })
            .collect();
        loop {
            let heads = posts.iter_mut().enumerate().filter_map(|(i, p)| p.peek().map(|(n, _)| (*n, i)));
            let Some((_, first)) = heads.min() else { return };
            if let Some((number, posted)) = posts[first].next() {
                self.put(posted.at, number, posted.what);
            }
        }
    }
}

/// What goes by the order of a single queue.
struct Merge<'a, D> {
    now: Time,
    scheduled: u64,
    trace: &'a mut Trace,
    director: &'a mut D,
    /// What had been counted before.
    tally: Tally,
    next_audit: Time,
    audit_every: Span,
    audits: u64,
    unbalanced: Vec<Violation>,
}

impl<D> Merge<'_, D> {
    fn window<A>(&mut self, shared: &Shared<'_, A>)
    where
        A: Agent<Place = Cell, Action = Never, Percept = Never>,
        D: Direct<StillWorld<A>>,
    {
        let mut logs: Vec<_> = (0..shared.lanes).map(|lane| shared.log(lane)).collect();
        let mut heads: Vec<Head<'_, A>> = logs.iter_mut().map(|log| Head::of(log)).collect();
        let audits = self.audits;
        while let Some(first) = (0..heads.len()).min_by_key(|lane| heads[*lane].due) {
            let head = &mut heads[first];
            let Some(event) = head.events.get(head.at) else { break };
            self.now = event.at;
            if event.heard != NOTHING {
                self.trace.event(event.at, 1, event.who.0, event.heard);
            }
            head.numbers.push(self.scheduled);
            self.scheduled += u64::from(event.posted);
            while let Some((_, report)) = head.reports.next_if(|(of, _)| *of == head.at) {
                self.director.report(event.at, event.who, report);
            }
            if event.at >= self.next_audit {
                self.audits += 1;
                self.next_audit = event.at + self.audit_every;
            }
            head.go_on();
        }
        drop(heads);
        if self.audits > audits {
            let (mut tally, mut under_way) = (self.tally, PerClass::default());
            for log in &logs {
                tally += log.tally;
                under_way.iter_mut().zip(log.under_way).for_each(|(sum, of)| *sum += of);
            }
            if let Err(what) = invariants::messages_balance(&tally, &under_way) {
                self.unbalanced.push(Violation { invariant: Invariant::MessagesBalance, at: self.now, what });
            }
        }
    }
}

/// The log of a lane, as far as it has been gone through.
struct Head<'a, A: Agent> {
    events: &'a [Event],
    reports: std::iter::Peekable<std::vec::Drain<'a, (usize, A::Report)>>,
    wakers: &'a [usize],
    numbers: &'a mut Vec<u64>,
    /// The event that comes next, and when it came in a single queue: the latest there is, if none does.
    at: usize,
    due: (Time, u64),
}

impl<'a, A: Agent> Head<'a, A> {
    fn of(log: &'a mut Log<A>) -> Head<'a, A> {
        log.numbers.clear();
        log.numbers.reserve(log.events.len());
        let (reports, numbers) = (log.reports.drain(..).peekable(), &mut log.numbers);
        let mut head =
            Head { events: &log.events, reports, wakers: &log.wakers, numbers, at: 0, due: (Time::NEVER, 0) };
        head.find_due();
        head
    }
    fn go_on(&mut self) {
        self.at += 1;
        self.find_due();
    }
    fn find_due(&mut self) {
        self.due = self.events.get(self.at).map_or((Time::NEVER, u64::MAX), |e| {
            if e.number & OWN == 0 {
                return (e.at, e.number);
            }
            // Whoever scheduled it came earlier in the same log, and it was the last that it scheduled.
            let waker = self.wakers[(e.number ^ OWN) as usize];
            (e.at, self.numbers[waker] + u64::from(self.events[waker].posted) - 1)
        });
    }
}

impl<A, D> Sim<StillWorld<A>, D>
where
    A: Agent<Place = Cell, Action = Never, Percept = Never> + Send,
    A::Message: Send,
    A::Report: Send + Sync,
    D: Direct<StillWorld<A>> + Listens,
{
    /// The same as [`Sim::run_until`], on so many threads, this one included. What differs is the time
    /// that it takes: threads wait for each other thousands of times a second, so it is longer where they
    /// have no processor each. With a journal, or without a shortest delay, it is one thread.
    pub fn run_on(&mut self, threads: usize, until: Time) -> bool {
        let link = &self.config.link;
        if threads < 2 || link.delay_min == Span::ZERO || self.log.is_some() || self.config.ignore_sessions {
            return self.run_until(until);
        }
        loop {
            // Before the controller is woken, that is; and what is due at the end is done by one.
            let horizon = self.director.wake_at().min(until);
            self.run_before(threads, horizon);
            if horizon == until || self.run_until(horizon) {
                return self.run_until(until);
            }
        }
    }

    /// Carries out everything before `horizon`.
    fn run_before(&mut self, threads: usize, horizon: Time) {
        let config = &self.config;
        let mut scheduled = 0;
        let (mut modules, mut links): (Vec<Vec<_>>, Vec<Vec<_>>) = Default::default();
        modules.resize_with(threads, Vec::new);
        links.resize_with(threads, Vec::new);
        for (block, part) in self.modules.chunks_mut(BLOCK).enumerate() {
            modules[block % threads].push(part);
        }
        for (block, part) in self.links.chunks_mut(BLOCK * A::PORTS).enumerate() {
            links[block % threads].push(part);
        }
        let shared = Shared {
            link: &config.link,
            lanes: threads,
            logs: (0..threads).map(|_| Apart(RwLock::new(Log::new()))).collect(),
            boxes: (0..threads * threads).map(|_| Apart(Mutex::default())).collect(),
            next: (0..threads).map(|_| AtomicU64::new(0)).collect(),
            meeting: Meeting::default(),
        };
        let mut lanes: Vec<Apart<Lane<'_, A>>> = modules
            .into_iter()
            .zip(links)
            .enumerate()
            .map(|(index, (modules, links))| {
                let queue = Queue::new(config.link.delay_max);
                Apart(Lane {
                    index,
                    modules,
                    links,
                    queue,
                    scheduled: Slab::new(),
                    messages: PerClass::default(),
                })
            })
            .collect();
        while let Some((at, event)) = self.queue.pop() {
            let what = match event {
                super::Event::Arrive(index) => What::Arrive(self.parcels.remove(index as usize)),
                super::Event::Wake(id) => What::Wake(id),
            };
            let id = match &what {
                What::Arrive(parcel) => parcel.to,
                What::Wake(id) => *id,
            };
            lanes[shared.lane_of(id)].0.put(at, scheduled, what);
            scheduled += 1;
        }
        for (Apart(lane), next) in lanes.iter_mut().zip(&shared.next) {
            next.store(lane.queue.next_at().0, Ordering::Relaxed);
        }
        let mut merge = Merge {
            now: self.now,
            scheduled,
            trace: &mut self.trace,
            director: &mut self.director,
            tally: self.tally,
            next_audit: self.next_audit,
            audit_every: config.audit_every,
            audits: 0,
            unbalanced: Vec::new(),
        };
        std::thread::scope(|scope| {
            let (Apart(first), others) = lanes.split_first_mut().expect("invariant: there is a lane");
            let shared = &shared;
            let others: Vec<_> = others
                .iter_mut()
                .map(|Apart(lane)| {
                    scope.spawn(move || {
                        let _watch = Watch(&shared.meeting);
                        lane.run(shared, horizon, || ());
                        coverage::take()
                    })
                })
                .collect();
            let _watch = Watch(&shared.meeting);
            first.run(shared, horizon, || merge.window(shared));
            for other in others {
                coverage::add(other.join().expect("invariant: a lane that fails ends the run"));
            }
        });
        let Merge { now, next_audit, audits, unbalanced, .. } = merge;
        (self.now, self.next_audit) = (now, next_audit);
        self.checked += audits;
        for log in &shared.logs {
            let log = log.0.read().expect("invariant: a lane that fails ends the run");
            self.tally += log.tally;
            self.body_messages += log.body_messages;
            self.checked += log.checked;
        }
        // What is due later goes back into one queue, in order.
        let mut left = Vec::new();
        for Apart(lane) in &mut lanes {
            while let Some((at, index)) = lane.queue.pop() {
                let Numbered { number, what } = lane.scheduled.remove(index as usize);
                left.push((at, number, what));
            }
        }
        drop(lanes);
        left.sort_by_key(|(at, number, _)| (*at, *number));
        self.queue = Queue::new(self.config.link.delay_max);
        for (at, _, what) in left {
            let event = match what {
                What::Arrive(parcel) => super::Event::Arrive(self.parcels.insert(parcel) as u32),
                What::Wake(id) => super::Event::Wake(id),
            };
            self.queue.push(at, event);
        }
        unbalanced.into_iter().for_each(|v| self.note(v));
    }
}
