//! The way of an operator's commands into a run in progress: a bounded queue that the driver reads between two events.
//! A command is validated and stamped by the director, recorded in the journal, and acknowledged after that.

use metamorph_console::stopwatch::wait_until;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::director::commands::COMMAND_INPUT;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use thiserror::Error;
use tokio::sync::oneshot;

/// Number of requests that can wait for the driver.
const WAITING: usize = 256;
/// Number of requests handled between two events.
const AT_ONCE: usize = 16;
/// The longest time that a driver waits without reading the queue.
pub const READ_EVERY: Duration = Duration::from_millis(20);

/// Commands that are given together.
#[derive(Debug)]
struct Request {
    operator: u16,
    commands: Vec<String>,
    answer: oneshot::Sender<Result<Time, String>>,
}

/// The reason why commands do not reach a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Unreachable {
    /// The run has ended.
    #[error("the run is over")]
    Over,
    /// Too many requests wait.
    #[error("{WAITING} requests wait; try again later")]
    Full,
}

/// The answer to a request: the time at which its commands take effect, or why they are refused.
pub type Answer = oneshot::Receiver<Result<Time, String>>;

/// The operator's end of the queue.
#[derive(Clone, Debug)]
pub struct Operators(SyncSender<Request>);

impl Operators {
    /// Gives commands to the run, all or none. The answer comes when the driver has taken them.
    ///
    /// # Errors
    /// If the run is over, or too many requests wait.
    pub fn give(&self, operator: u16, commands: Vec<String>) -> Result<Answer, Unreachable> {
        let (answer, answered) = oneshot::channel();
        match self.0.try_send(Request { operator, commands, answer }) {
            Ok(()) => Ok(answered),
            Err(TrySendError::Full(_)) => Err(Unreachable::Full),
            Err(TrySendError::Disconnected(_)) => Err(Unreachable::Over),
        }
    }
}

/// The driver's end of the queue.
#[derive(Debug)]
pub struct CommandQueue {
    requests: Receiver<Request>,
    /// The first request, if the driver was woken by it.
    first: Option<Request>,
    /// The time of the latest commands.
    last: Time,
}

/// The driver's end, shared with the options of a run.
#[derive(Clone, Debug)]
pub struct SharedQueue(Arc<Mutex<CommandQueue>>);

impl SharedQueue {
    /// Returns the queue.
    pub fn lock(&self) -> MutexGuard<'_, CommandQueue> {
        // A panic of a driver ends the run.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Creates a queue.
pub fn queue() -> (Operators, SharedQueue) {
    let (sender, requests) = sync_channel(WAITING);
    let queue = CommandQueue { requests, first: None, last: Time::ZERO };
    (Operators(sender), SharedQueue(Arc::new(Mutex::new(queue))))
}

impl CommandQueue {
    /// Hands waiting requests to `input`, which is that of a director with its journal, and answers them. Each is
    /// stamped a nanosecond after `now` and after those before it, so that it meets nothing else: a scenario with the
    /// same commands at the same times makes the same run.
    pub fn hand_in(&mut self, now: Time, mut input: impl FnMut(&str, &[u8]) -> Result<(), String>) {
        for _ in 0..AT_ONCE {
            let Some(request) = self.first.take().or_else(|| self.requests.try_recv().ok()) else { return };
            let at = now.max(self.last) + Span(1);
            let Request { operator, commands, answer } = request;
            let text = format!("at {} ns by operator {operator}: {}", at.0, commands.join("; "));
            let taken = input(COMMAND_INPUT, text.as_bytes());
            if taken.is_ok() {
                self.last = at;
            }
            // An operator that does not wait for the answer any more asks again.
            let _ = answer.send(taken.map(|()| at));
        }
    }

    /// Waits for a request, at most this long.
    pub fn wait(&mut self, longest: Duration) {
        if self.first.is_some() {
            return;
        }
        match self.requests.recv_timeout(longest) {
            Ok(request) => self.first = Some(request),
            Err(RecvTimeoutError::Timeout) => {}
            // Time passes without operators, too.
            Err(RecvTimeoutError::Disconnected) => {
                wait_until(longest, || false);
            }
        }
    }

    /// Ends the queue with the run: waiting and later requests are answered so.
    pub fn close(&mut self) {
        (self.first, self.requests) = (None, sync_channel(0).1);
    }
}
