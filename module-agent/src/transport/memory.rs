//! The transport within one process: bounded queues between threads, or between agents that one thread steps
//! in turn. Its bounds on frames and senders are those of the transport over shared memory.
//!
//! [`Control`] has the effects of signals on a process: it stops, continues and kills the owner of an inbox,
//! at the next operation of its transport. Not here: ending a thread between two operations.

use crate::clock::monotonic;
use crate::transport::shared_frame::SharedFrame;
use crate::transport::{
    Address, AgentKey, ConnectError, INBOX_DEPTH, INBOX_SPARE, Link, REPORTS_DEPTH, SendStatus, Transport,
    TransportError,
};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use thiserror::Error;

/// The inboxes of one swarm. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct MemoryNetwork {
    inboxes: Arc<Mutex<BTreeMap<Address, Arc<Inbox>>>>,
}

/// Errors of opening a sending end within one process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum MemoryError {
    /// There is no such inbox.
    #[error("{0:?} has no inbox")]
    NoInbox(Address),
    /// The inbox has no free slot for a sender.
    #[error("the inbox of {0:?} has its {1} senders, and takes no more")]
    NoSlot(Address, usize),
}

impl MemoryNetwork {
    /// Creates a network without inboxes.
    pub fn new() -> MemoryNetwork {
        MemoryNetwork::default()
    }

    /// Creates the inbox of one agent that has up to `neighbours` neighbours at a time.
    pub fn agent(&self, agent: AgentKey, neighbours: usize) -> MemoryTransport {
        self.join(Address::Agent(agent), INBOX_DEPTH, neighbours + INBOX_SPARE)
    }

    /// Creates the inbox of the controller of this generation, for any number of agents.
    pub fn controller(&self, generation: u32) -> MemoryTransport {
        self.join(Address::Controller(generation), REPORTS_DEPTH, usize::MAX)
    }

    fn join(&self, address: Address, depth: usize, slots: usize) -> MemoryTransport {
        let inbox = Arc::new(Inbox { depth, slots, state: Mutex::default(), bell: Condvar::new() });
        lock(&self.inboxes).insert(address, Arc::clone(&inbox));
        MemoryTransport { network: self.clone(), address, inbox }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Each change under a lock is complete, even if its thread has panicked since.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[derive(Debug)]
struct Inbox {
    /// Largest number of frames held from one sender.
    depth: usize,
    /// Largest number of senders at a time.
    slots: usize,
    state: Mutex<State>,
    /// Rung when a sender flushes, and when the owner is stopped, continued or killed.
    bell: Condvar,
}

#[derive(Debug, Default)]
struct State {
    frames: VecDeque<(u64, SharedFrame)>,
    senders: BTreeMap<u64, Sender>,
    /// Number of senders so far, the source of their numbers.
    joined: u64,
    rung: bool,
    closed: bool,
    stopped: bool,
    killed: bool,
}

#[derive(Debug)]
struct Sender {
    waiting: usize,
    open: bool,
}

impl State {
    fn pop(&mut self) -> Option<SharedFrame> {
        let (sender, frame) = self.frames.pop_front()?;
        if let Some(found) = self.senders.get_mut(&sender) {
            found.waiting -= 1;
        }
        self.forget(sender);
        Some(frame)
    }

    /// Frees the slot of a sender if it is closed and all of its frames are taken.
    fn forget(&mut self, sender: u64) {
        if self.senders.get(&sender).is_some_and(|s| !s.open && s.waiting == 0) {
            self.senders.remove(&sender);
        }
    }
}

impl Inbox {
    /// Waits while the owner is stopped; fails if it was killed.
    fn pass(&self) -> Result<MutexGuard<'_, State>, TransportError> {
        let mut state = lock(&self.state);
        while state.stopped && !state.killed {
            state = self.bell.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        if state.killed { Err(TransportError::Killed) } else { Ok(state) }
    }

    fn ring(&self) {
        lock(&self.state).rung = true;
        self.bell.notify_all();
    }
}

/// One inbox. It is closed when this is dropped.
#[derive(Debug)]
pub struct MemoryTransport {
    network: MemoryNetwork,
    address: Address,
    inbox: Arc<Inbox>,
}

impl MemoryTransport {
    /// Returns the control over the owner of this inbox.
    pub fn control(&self) -> Control {
        Control { inbox: Arc::clone(&self.inbox) }
    }
}

impl Transport for MemoryTransport {
    type Link = MemoryLink;

    fn connect(&mut self, to: Address) -> Result<MemoryLink, ConnectError> {
        let found = lock(&self.network.inboxes).get(&to).cloned();
        let inbox = found.ok_or_else(|| ConnectError::Unreachable(MemoryError::NoInbox(to).into()))?;
        let mut state = lock(&inbox.state);
        if state.senders.len() >= inbox.slots {
            return Err(ConnectError::NoSlot(MemoryError::NoSlot(to, inbox.slots).into()));
        }
        let sender = state.joined;
        state.joined += 1;
        state.senders.insert(sender, Sender { waiting: 0, open: true });
        drop(state);
        Ok(MemoryLink { from: Arc::clone(&self.inbox), to: inbox, sender, ring: false })
    }

    fn receive(&mut self) -> Result<Option<SharedFrame>, TransportError> {
        Ok(self.inbox.pass()?.pop())
    }

    fn wait(&mut self, timeout: Duration) -> Result<(), TransportError> {
        let nanos = u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX);
        let deadline = monotonic().saturating_add(nanos);
        let mut state = self.inbox.pass()?;
        while !std::mem::take(&mut state.rung) {
            let left = Duration::from_nanos(deadline.saturating_sub(monotonic()));
            if left.is_zero() {
                break;
            }
            let waited = self.inbox.bell.wait_timeout(state, left);
            drop(waited.unwrap_or_else(PoisonError::into_inner));
            state = self.inbox.pass()?;
        }
        Ok(())
    }
}

impl Drop for MemoryTransport {
    fn drop(&mut self) {
        lock(&self.inbox.state).closed = true;
        let mut inboxes = lock(&self.network.inboxes);
        if inboxes.get(&self.address).is_some_and(|found| Arc::ptr_eq(found, &self.inbox)) {
            inboxes.remove(&self.address);
        }
    }
}

/// The sending end towards one inbox.
#[derive(Debug)]
pub struct MemoryLink {
    /// The inbox of the sender: while its owner is stopped or killed, nothing is sent.
    from: Arc<Inbox>,
    to: Arc<Inbox>,
    sender: u64,
    ring: bool,
}

impl Link for MemoryLink {
    fn send(&mut self, frame: SharedFrame) -> SendStatus {
        if self.from.pass().is_err() {
            return SendStatus::Gone;
        }
        let mut state = lock(&self.to.state);
        if state.closed {
            return SendStatus::Gone;
        }
        self.ring = true;
        match state.senders.get_mut(&self.sender) {
            Some(sender) if sender.waiting < self.to.depth => sender.waiting += 1,
            _ => return SendStatus::Full,
        }
        state.frames.push_back((self.sender, frame));
        SendStatus::Sent
    }

    fn flush(&mut self) {
        if std::mem::take(&mut self.ring) {
            self.to.ring();
        }
    }
}

impl Drop for MemoryLink {
    fn drop(&mut self) {
        let mut state = lock(&self.to.state);
        if let Some(sender) = state.senders.get_mut(&self.sender) {
            sender.open = false;
        }
        state.forget(self.sender);
    }
}

/// Control over the owner of an inbox from outside.
#[derive(Clone, Debug)]
pub struct Control {
    inbox: Arc<Inbox>,
}

impl Control {
    /// Stops the owner: the next operation of its transport blocks until it is continued.
    pub fn stop(&self) {
        lock(&self.inbox.state).stopped = true;
        self.inbox.ring();
    }

    /// Continues the owner.
    pub fn resume(&self) {
        lock(&self.inbox.state).stopped = false;
        self.inbox.ring();
    }

    /// Kills the owner: from now on no operation of its transport succeeds, and its inbox takes nothing.
    pub fn kill(&self) {
        {
            let mut state = lock(&self.inbox.state);
            (state.killed, state.closed) = (true, true);
        }
        self.inbox.ring();
    }

    /// True if the owner was killed.
    pub fn is_killed(&self) -> bool {
        lock(&self.inbox.state).killed
    }

    /// Wakes the owner.
    pub fn wake(&self) {
        self.inbox.ring();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::ids::{Incarnation, ModuleId};
    use metamorph_protocol::wire::Frame;
    use std::thread;

    const LONG: Duration = Duration::from_secs(60);

    fn key(id: u32) -> AgentKey {
        (ModuleId(id), Incarnation(0))
    }
    fn frame(n: u8) -> SharedFrame {
        SharedFrame::from_bytes([n; Frame::SIZE])
    }
    fn first(frame: Option<SharedFrame>) -> Option<u8> {
        frame.map(|f| f.frame().as_bytes()[0])
    }

    #[test]
    fn an_inbox_holds_a_bounded_number_of_frames_of_each_sender_in_order() {
        let network = MemoryNetwork::new();
        let (mut a, mut b) = (network.agent(key(0), 1), network.agent(key(1), 1));
        let to = Address::Agent(key(1));
        let (mut one, mut other) = (a.connect(to).unwrap(), a.connect(to).unwrap());
        for n in 0..INBOX_DEPTH as u8 {
            assert_eq!(one.send(frame(n)), SendStatus::Sent);
        }
        assert_eq!((one.send(frame(99)), other.send(frame(100))), (SendStatus::Full, SendStatus::Sent));
        // The frames of a closed sender still arrive, and then free its slot.
        drop(one);
        assert_eq!(lock(&b.inbox.state).senders.len(), 2);
        let taken: Vec<u8> = std::iter::from_fn(|| first(b.receive().unwrap())).collect();
        assert_eq!(taken, (0..INBOX_DEPTH as u8).chain([100]).collect::<Vec<_>>());
        assert_eq!(lock(&b.inbox.state).senders.len(), 1);
    }

    #[test]
    fn an_inbox_takes_a_bounded_number_of_senders() {
        let network = MemoryNetwork::new();
        let (mut a, _b) = (network.agent(key(0), 2), network.agent(key(1), 2));
        let mut links: Vec<_> =
            (0..2 + INBOX_SPARE).map(|_| a.connect(Address::Agent(key(1))).unwrap()).collect();
        assert!(matches!(a.connect(Address::Agent(key(1))), Err(ConnectError::NoSlot(_))));
        links.pop();
        assert!(a.connect(Address::Agent(key(1))).is_ok());
    }

    #[test]
    fn a_receiver_that_is_gone_is_told_from_one_that_never_was() {
        let network = MemoryNetwork::new();
        let mut a = network.agent(key(0), 1);
        let unreachable = a.connect(Address::Agent(key(1)));
        assert!(matches!(unreachable, Err(ConnectError::Unreachable(_))), "{unreachable:?}");
        let b = network.agent(key(1), 1);
        let mut link = a.connect(Address::Agent(key(1))).unwrap();
        assert_eq!(link.send(frame(1)), SendStatus::Sent);
        drop(b);
        assert_eq!(link.send(frame(2)), SendStatus::Gone);
        // The next incarnation has an inbox of its own.
        let _next = network.agent(key(1), 1);
        assert_eq!(link.send(frame(3)), SendStatus::Gone);
    }

    #[test]
    fn flushing_wakes_the_receiver_and_is_not_lost_before_it_waits() {
        let network = MemoryNetwork::new();
        let (mut a, mut b) = (network.agent(key(0), 1), network.agent(key(1), 1));
        let mut link = a.connect(Address::Agent(key(1))).unwrap();
        link.flush();
        b.wait(Duration::from_millis(1)).unwrap();
        link.send(frame(1));
        link.flush();
        b.wait(LONG).unwrap();
        assert_eq!(first(b.receive().unwrap()), Some(1));
        thread::scope(|scope| {
            let woken = scope.spawn(|| {
                b.wait(LONG).unwrap();
                first(b.receive().unwrap())
            });
            link.send(frame(2));
            link.flush();
            assert_eq!(woken.join().unwrap(), Some(2));
        });
    }

    #[test]
    fn a_stopped_owner_takes_nothing_until_it_is_continued_or_killed() {
        let network = MemoryNetwork::new();
        let (mut a, mut b) = (network.agent(key(0), 1), network.agent(key(1), 1));
        let control = b.control();
        let mut link = a.connect(Address::Agent(key(1))).unwrap();
        control.stop();
        thread::scope(|scope| {
            let taken = scope.spawn(|| {
                let taken = b.receive().unwrap();
                (first(taken), b)
            });
            // Sent at a time when the receiver cannot have looked.
            assert_eq!(link.send(frame(7)), SendStatus::Sent);
            control.resume();
            let (taken, mut b) = taken.join().unwrap();
            assert_eq!(taken, Some(7));
            let mut back = b.connect(Address::Agent(key(0))).unwrap();
            control.stop();
            control.kill();
            assert!(matches!(b.receive(), Err(TransportError::Killed)));
            assert!(matches!(b.wait(LONG), Err(TransportError::Killed)));
            assert_eq!((link.send(frame(8)), back.send(frame(9))), (SendStatus::Gone, SendStatus::Gone));
        });
        assert_eq!(first(a.receive().unwrap()), None);
    }
}
