//! Carries out the runs of a sweep on several threads.
//!
//! Threads draw run numbers from one counter. A thread keeps the plan of the combination it is in, so
//! that runs of a millisecond cost little more than themselves. Which thread does which run, and when,
//! has no effect on any row. Absent: the order of rows, and what becomes of them (see the parent).

use super::Scenario;
use super::grid::Grid;
use super::row::Row;
use crate::console::interrupt::Interrupt;
use crate::console::stopwatch::Stopwatch;
use crate::family::simulate;
use crate::scenario::Plan;
use crate::scenario::flaw::Flaw;
use metamorph_sim_bridge::director::outcome::Outcome;
use std::collections::BTreeSet;
use std::num::NonZeroUsize;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

/// When nothing happens, the listener hears so after this time.
const PATIENCE: Duration = Duration::from_millis(100);
/// Rows under way; threads that are faster than the disk wait.
const QUEUE: usize = 10_000;

/// What is to be run.
#[derive(Clone, Copy)]
pub struct Work<'a> {
    /// The scenario.
    pub scenario: &'a Scenario,
    /// All runs.
    pub grid: &'a Grid,
    /// The first run to do.
    pub first: u64,
    /// Runs after it that are done already.
    pub done: &'a BTreeSet<u64>,
    /// How many threads do it.
    pub jobs: NonZeroUsize,
    /// Ends it early.
    pub interrupt: &'a Interrupt,
}

/// What the threads have to say.
pub enum News {
    /// This run has ended.
    Row(u64, Box<Row>),
    /// This run made the program panic: a defect of the program.
    Defect(u64),
    /// This run finds no places to start from.
    NoStart(u64, Flaw),
    /// Nothing new for a moment.
    Nothing,
}

/// Runs everything, or until interrupted or `take` fails. Runs that were interrupted are not handed
/// over.
pub fn run<E>(work: Work<'_>, mut take: impl FnMut(News) -> Result<(), E>) -> Result<(), E> {
    let next = AtomicU64::new(work.first);
    let (sender, receiver) = sync_channel(QUEUE);
    thread::scope(|scope| {
        for _ in 0..work.jobs.get() {
            let (sender, next) = (sender.clone(), &next);
            scope.spawn(move || labour(work, next, &sender));
        }
        drop(sender);
        // On an error the receiver is dropped, and every thread ends when it next hands over.
        let receiver = receiver;
        loop {
            match receiver.recv_timeout(PATIENCE) {
                Ok(news) => take(news)?,
                Err(RecvTimeoutError::Timeout) => take(News::Nothing)?,
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            }
        }
    })
}

fn labour(work: Work<'_>, next: &AtomicU64, sender: &SyncSender<News>) {
    let mut plan: Option<(u64, Plan)> = None;
    let since = Stopwatch::start();
    while !work.interrupt.is_set() {
        let run = next.fetch_add(1, Ordering::Relaxed);
        if run >= work.grid.runs() {
            break;
        }
        if work.done.contains(&run) {
            continue;
        }
        let (combination, seed) = (work.grid.combination(run), work.grid.seed(run));
        let plan = match &mut plan {
            Some((of, plan)) if *of == combination => plan,
            other => {
                let read = work.scenario.plan(work.grid, combination);
                let read = read.expect("invariant: every combination was read before the first run");
                &other.insert((combination, read)).1
            }
        };
        let simulate = || {
            let plan = plan.with_seed(seed)?;
            Ok::<Row, Flaw>(Row::of(&simulate(&plan, since, &mut |_, _| !work.interrupt.is_set()).0))
        };
        let news = match catch_unwind(AssertUnwindSafe(simulate)) {
            Ok(Ok(row)) => News::Row(run, Box::new(row)),
            Ok(Err(error)) => News::NoStart(run, error),
            Err(_) => News::Defect(run),
        };
        if matches!(&news, News::Row(_, row) if row.outcome == Outcome::Aborted) {
            break;
        }
        // If nobody listens any more, nobody wants to know more.
        if sender.send(news).is_err() {
            break;
        }
    }
}
