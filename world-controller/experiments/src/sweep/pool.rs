//! Executes the runs of a sweep on several threads.
//!
//! Threads take run numbers from one counter. A thread keeps the plan of its current combination, so that
//! short runs have little overhead. Which thread executes which run, and when, has no effect on any row.
//! Absent: the order of rows, and what is done with them (see the parent).

use super::Scenario;
use super::row::Row;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_processes::family::simulate;
use metamorph_scenario::Plan;
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::grid::{Grid, Part};
use metamorph_sim_bridge::director::outcome::Outcome;
use std::collections::BTreeSet;
use std::num::NonZeroUsize;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

/// Time after which the receiver is notified that nothing happened.
const PATIENCE: Duration = Duration::from_millis(100);
/// Largest number of rows in the queue; threads that are faster than the disk wait.
const QUEUED_MAX: usize = 10_000;

/// The runs to execute.
#[derive(Clone, Copy)]
pub struct Work<'a> {
    /// The scenario.
    pub scenario: &'a Scenario,
    /// All runs of the sweep.
    pub grid: &'a Grid,
    /// The part of them to execute.
    pub part: Part,
    /// The first run to execute.
    pub first: u64,
    /// Later runs that are already done.
    pub done: &'a BTreeSet<u64>,
    /// Number of threads.
    pub jobs: NonZeroUsize,
    /// The request to end early.
    pub interrupt: &'a Interrupt,
}

/// A message of the threads.
pub enum News {
    /// This run has ended.
    Row(u64, Box<Row>),
    /// This run panicked: a defect of the program.
    Defect(u64),
    /// The start places of this run cannot be drawn.
    NoStart(u64, ScenarioError),
    /// No news within the interval.
    Nothing,
}

/// Executes the runs until all are done, the sweep is interrupted, or `take` fails. Interrupted runs are not
/// delivered.
pub fn run<E>(work: Work<'_>, mut take: impl FnMut(News) -> Result<(), E>) -> Result<(), E> {
    let next = AtomicU64::new(work.first);
    let (sender, receiver) = sync_channel(QUEUED_MAX);
    thread::scope(|scope| {
        for _ in 0..work.jobs.get() {
            let (sender, next) = (sender.clone(), &next);
            scope.spawn(move || labour(work, next, &sender));
        }
        drop(sender);
        // On an error the receiver is dropped, and every thread ends at its next delivery.
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
        if !work.part.has(work.grid, run) || work.done.contains(&run) {
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
            Ok::<Row, ScenarioError>(Row::of(&simulate(&plan, since, &mut |_, _| !work.interrupt.is_set()).0))
        };
        let news = match catch_unwind(AssertUnwindSafe(simulate)) {
            Ok(Ok(row)) => News::Row(run, Box::new(row)),
            Ok(Err(error)) => News::NoStart(run, error),
            Err(_) => News::Defect(run),
        };
        if matches!(&news, News::Row(_, row) if row.outcome == Outcome::Aborted) {
            break;
        }
        // The receiver is gone: end.
        if sender.send(news).is_err() {
            break;
        }
    }
}
