//! Executes runs on several threads and delivers the results in the order of their numbers.
//!
//! The threads are not waited for when an exploration ends early: the search that judges a run can take many
//! seconds and belongs to the protocol, which has no clock. Later results are dropped.

use super::draw::draw;
use super::limits::Limits;
use super::{Budget, Ran, Request, run as run_one};
use std::collections::BTreeMap;
use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

/// Largest number of results in the queue.
const QUEUED_MAX: usize = 1_000;
/// Time between checks of the limits while no result arrives.
pub const LOOK: Duration = Duration::from_millis(50);

/// Executes runs 0, 1, 2, … with consecutive seeds from `seed` on until the limits are reached, and passes
/// the number and the result of each to `take`.
pub fn run(seed: u64, request: &Request, limits: &Limits, mut take: impl FnMut(u64, Ran)) {
    let next = Arc::new(AtomicU64::new(0));
    let (sender, receiver) = sync_channel::<(u64, Ran)>(QUEUED_MAX);
    let workers: Vec<_> = (0..request.jobs.get())
        .map(|_| {
            let (sender, next) = (sender.clone(), Arc::clone(&next));
            let (request, limits) = (request.clone(), limits.clone());
            thread::spawn(move || work(seed, &request, &limits, &next, &sender))
        })
        .collect();
    drop(sender);
    let (mut due, mut early) = (0, BTreeMap::new());
    while !limits.end_drawing() {
        match receiver.recv_timeout(LOOK) {
            Ok((number, ran)) => drop(early.insert(number, ran)),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                // All workers have ended, or are about to.
                for worker in workers {
                    worker.join().unwrap_or_else(|panic| resume_unwind(panic));
                }
                break;
            }
        }
        while let Some(ran) = early.remove(&due) {
            take(due, ran);
            due += 1;
        }
    }
    // Results judged in time, after runs that were not.
    early.extend(receiver.try_iter());
    early.into_iter().for_each(|(number, ran)| take(number, ran));
}

fn work(seed: u64, request: &Request, limits: &Limits, next: &AtomicU64, sender: &SyncSender<(u64, Ran)>) {
    while !limits.end_drawing() {
        let number = next.fetch_add(1, Ordering::Relaxed);
        if matches!(request.budget, Budget::Runs(runs) if number >= runs) {
            break;
        }
        let (draft, plan) = draw(seed.wrapping_add(number), request.drawn);
        tracing::info!("seed {}: {}", draft.seed, draft.summary());
        // A run cut short by the limits is dropped; workers end when the receiver is gone.
        let Some(ran) = run_one(&plan, &|| limits.end_drawing()) else { break };
        if sender.send((number, ran)).is_err() {
            break;
        }
    }
}
