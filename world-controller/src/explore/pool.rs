//! Carries runs out on several threads and hands them over in the order of their numbers.

use super::draw::draw;
use super::{Budget, Ran, Request, run as run_one};
use crate::interrupt::Interrupt;
use crate::stopwatch::Stopwatch;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;

/// Results under way.
const QUEUE: usize = 1_000;

/// Runs number 0, 1, 2, … with the seeds from `seed` on, until the budget is used up.
pub fn run(seed: u64, request: &Request, interrupt: &Interrupt, mut take: impl FnMut(u64, Ran)) {
    let (next, since) = (AtomicU64::new(0), Stopwatch::start());
    let goes_on = |number: u64| match request.budget {
        Budget::Runs(runs) => number < runs,
        Budget::Time(time) => since.elapsed() < time,
    };
    let (sender, receiver) = sync_channel::<(u64, Ran)>(QUEUE);
    let labour = |sender: SyncSender<(u64, Ran)>| {
        while !interrupt.is_set() {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if !goes_on(number) {
                break;
            }
            let (draft, plan) = draw(seed.wrapping_add(number), request.family);
            tracing::info!("seed {}: {}", draft.seed, draft.summary());
            let Some(ran) = run_one(&plan, interrupt) else { break };
            // If nobody listens any more, nobody wants to know more.
            if sender.send((number, ran)).is_err() {
                break;
            }
        }
    };
    thread::scope(|scope| {
        for _ in 0..request.jobs.get() {
            let (sender, labour) = (sender.clone(), &labour);
            scope.spawn(move || labour(sender));
        }
        drop(sender);
        let (mut due, mut early) = (0, BTreeMap::new());
        for (number, ran) in receiver {
            early.insert(number, ran);
            while let Some(ran) = early.remove(&due) {
                take(due, ran);
                due += 1;
            }
        }
        // Behind a run that was interrupted.
        early.into_iter().for_each(|(number, ran)| take(number, ran));
    });
}
