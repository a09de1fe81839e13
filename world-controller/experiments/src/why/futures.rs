//! Futures of a run: copies of its past with other random numbers, and how many of them end in a certain way.

use metamorph_families::simulated::SteppedRun;
use metamorph_processes::family::begin;
use metamorph_protocol::time::Time;
use metamorph_report::statistics::Rate;
use metamorph_scenario::Plan;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::rescue::Rescue;
use metamorph_sim_bridge::kernel::change::{Change, ChangeKind};
use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;

/// Number of time steps of a future between two looks at it.
const SLICE: u64 = 8;

/// The end that is looked for in futures.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Sought {
    /// The goal is built.
    Built,
    /// This invariant breaks.
    Broken(String),
}

impl Sought {
    /// Returns true if a run has ended like this.
    fn is_end_of(&self, run: &dyn SteppedRun) -> bool {
        match self {
            Sought::Built => run.outcome() == Outcome::Built,
            Sought::Broken(_) => self.is_broken(run),
        }
    }
    /// Returns true if the invariant that is looked for is broken, as far as the first violations say that are kept.
    fn is_broken(&self, run: &dyn SteppedRun) -> bool {
        match self {
            Sought::Built => false,
            Sought::Broken(name) => run.violations().iter().any(|v| v.invariant.name == *name),
        }
    }
}

/// Which random numbers futures have of their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reseeded {
    /// Those of links.
    Links,
    /// Those of everything that draws as a run proceeds.
    All,
}

/// The question to many futures.
pub struct Question<'a> {
    /// The end that is looked for.
    pub sought: Sought,
    /// The help of the controller in futures; `None` if it is that of the run.
    pub rescue: Option<Rescue>,
    /// Number of threads.
    pub jobs: NonZeroUsize,
    /// Returns true if the answer is no longer wanted.
    pub stop: &'a (dyn Fn() -> bool + Sync),
}

impl Question<'_> {
    /// Carries a future out until its answer is known. Returns it, or `None` if it is no longer wanted.
    fn carry_out(&self, run: &mut dyn SteppedRun) -> Option<bool> {
        let slice = run.time_step() * SLICE;
        loop {
            if (self.stop)() {
                return None;
            }
            // A run ends when it is built, but continues when an invariant breaks.
            let is_over = run.run_until(run.now() + slice);
            if is_over || self.sought.is_broken(run) {
                return Some(self.sought.is_end_of(run));
            }
        }
    }
}

/// How many futures of one point end as is looked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// The number of those that do.
    pub yes: u64,
    /// The number of all.
    pub of: u64,
    /// The lowest number with which a future does.
    pub first_yes: Option<u64>,
    /// The lowest number with which a future does not.
    pub first_no: Option<u64>,
}

impl Tally {
    /// Returns the share with its interval; 0 to 1 without futures.
    pub fn rate(&self) -> Rate {
        Rate::wilson(self.yes, self.of).unwrap_or(Rate { rate: 0.0, low: 0.0, high: 1.0 })
    }
    /// Returns true if all futures end alike.
    pub fn is_unanimous(&self) -> bool {
        self.yes == 0 || self.yes == self.of
    }
    /// Returns yes and all, for comparisons.
    pub fn pair(&self) -> (u64, u64) {
        (self.yes, self.of)
    }
    /// Adds a future with this number.
    pub fn take(&mut self, number: u64, yes: bool) {
        self.of += 1;
        self.yes += u64::from(yes);
        let first = if yes { &mut self.first_yes } else { &mut self.first_no };
        *first = Some(first.map_or(number, |other| other.min(number)));
    }
    /// Adds other futures of the same point.
    pub fn add(&mut self, other: &Tally) {
        let first = |a: Option<u64>, b: Option<u64>| a.into_iter().chain(b).min();
        *self = Tally {
            yes: self.yes + other.yes,
            of: self.of + other.of,
            first_yes: first(self.first_yes, other.first_yes),
            first_no: first(self.first_no, other.first_no),
        };
    }
}

/// An event of a run, and its futures so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Point {
    /// The number of events before it.
    pub events: u64,
    /// The scenario time.
    pub at: Time,
    /// Its futures.
    pub tally: Tally,
}

impl Point {
    /// Returns the changes that make the future with this number.
    pub fn changes(&self, rescue: Option<Rescue>, reseeded: Reseeded, number: u64) -> Vec<Change> {
        let kinds = kinds(rescue, reseeded, number).into_iter();
        kinds.map(|kind| Change { after: self.events, kind }).collect()
    }
}

/// Answers how the futures of points of a run end.
pub trait Oracle {
    /// Returns this number of points at equal distances in time, without futures: the first before all events, the last where the
    /// end began. Points at the same event are one.
    fn points(&mut self, count: u64) -> Vec<Point>;
    /// Returns the point after this number of events, without futures.
    fn point(&mut self, events: u64) -> Point;
    /// Counts the futures of a point that are reseeded with these numbers. Returns `None` if that was stopped; results depend on no
    /// clock, since futures that were carried out then do not count.
    fn count(&mut self, point: &Point, numbers: Range<u64>) -> Option<Tally>;
}

/// The futures of a run, carried out on several threads.
pub struct Futures<'a> {
    plan: Plan,
    /// When the end began.
    until: Time,
    question: &'a Question<'a>,
    reseeded: Reseeded,
    /// The run at points, by the number of events; empty if it has no copy, so that futures are carried out from the start.
    pasts: BTreeMap<u64, Box<dyn SteppedRun>>,
}

impl<'a> Futures<'a> {
    /// Creates the futures of a run of this plan.
    pub fn new(plan: &Plan, until: Time, question: &'a Question<'a>, reseeded: Reseeded) -> Futures<'a> {
        Futures { plan: plan.clone(), until, question, reseeded, pasts: BTreeMap::new() }
    }

    /// Keeps a copy of a run, and returns where it is.
    pub fn keep(&mut self, run: &dyn SteppedRun) -> Point {
        let (events, at) = (run.events(), run.now());
        if let Ok(copy) = run.fork() {
            self.pasts.insert(events, copy);
        }
        Point { events, at, tally: Tally::default() }
    }

    /// Returns the run after this number of events, at the time of the last of them.
    pub fn run_at(&self, events: u64) -> Box<dyn SteppedRun> {
        // Of the same number, a past may have been kept at a later time, before the next event.
        let past = self.pasts.range(..events).next_back().and_then(|(_, run)| run.fork().ok());
        let mut run = past.unwrap_or_else(|| begin(&self.plan));
        while run.events() < events && run.step() {}
        run
    }

    /// Returns the future of a point with this number.
    fn future(&self, point: &Point, number: u64) -> Box<dyn SteppedRun> {
        let kinds = kinds(self.question.rescue, self.reseeded, number);
        if let Some(mut run) = self.pasts.get(&point.events).and_then(|run| run.fork().ok()) {
            for kind in kinds {
                run.change(kind);
            }
            return run;
        }
        let mut plan = self.plan.clone();
        kinds.into_iter().for_each(|kind| plan.add_change(Change { after: point.events, kind }));
        begin(&plan)
    }
}

impl Oracle for Futures<'_> {
    fn points(&mut self, count: u64) -> Vec<Point> {
        let mut run = begin(&self.plan);
        let mut points = vec![self.keep(&*run)];
        for i in 1..count {
            run.run_until(Time((u128::from(self.until.0) * u128::from(i) / u128::from(count - 1)) as u64));
            if points.last().is_none_or(|last| last.events < run.events()) {
                points.push(self.keep(&*run));
            }
        }
        points
    }

    fn point(&mut self, events: u64) -> Point {
        let run = self.run_at(events);
        self.keep(&*run)
    }

    fn count(&mut self, point: &Point, numbers: Range<u64>) -> Option<Tally> {
        let (next, stopped) = (AtomicU64::new(numbers.start), AtomicBool::new(false));
        let work = || {
            let mut tally = Tally::default();
            loop {
                let number = next.fetch_add(1, Ordering::Relaxed);
                if number >= numbers.end || stopped.load(Ordering::Relaxed) {
                    return tally;
                }
                let mut run = self.future(point, number);
                match self.question.carry_out(&mut *run) {
                    None => stopped.store(true, Ordering::Relaxed),
                    Some(yes) => tally.take(number, yes),
                }
            }
        };
        let mut all = Tally::default();
        thread::scope(|scope| {
            let workers: Vec<_> = (0..self.question.jobs.get()).map(|_| scope.spawn(work)).collect();
            for worker in workers {
                all.add(&worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
            }
        });
        (!stopped.into_inner()).then_some(all)
    }
}

fn kinds(rescue: Option<Rescue>, reseeded: Reseeded, number: u64) -> Vec<ChangeKind> {
    let reseeded = match reseeded {
        Reseeded::Links => ChangeKind::Links(number),
        Reseeded::All => ChangeKind::All(number),
    };
    rescue.map(ChangeKind::Rescue).into_iter().chain([reseeded]).collect()
}
