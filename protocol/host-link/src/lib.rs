//! The link between the daemons of two hosts, without I/O: bytes of packets and the time in, packets and what they carried
//! out. The carrier may lose, double, reorder and hold back packets; damaged ones are refused by their checksum.
//!
//! A link carries *frames* between modules (at most once, in order, never sent again, losses counted by class) and two
//! *streams* of bytes (in order and without loss as long as both daemons live). A daemon that restarts has another life
//! ([`Life`]): the link to the earlier life has ended permanently, and nothing of it is taken into the next.
//!
//! - [`packet`]: the layout. `frames`, `streams`: the two services. `clock_interval`: how far the clocks differ.
//!
//! The end with the lower host number says hello, the other accepts, and the first confirms. Attempts and challenges are
//! numbered, so that a late packet of an earlier greeting is never taken for part of a later one. Then each end
//! acknowledges what it takes every [`Timing::every`], which also shows that it lives. Not here: the carrier, keys,
//! threads, and what frames mean.

mod clock_interval;
mod config;
mod events;
mod frames;
pub mod packet;
mod session;
mod streams;

pub use clock_interval::ClockInterval;
pub use config::{Config, Prover, Role, Timing};
pub use events::{Channel, Offered, Output, Refused, State};
pub use frames::{BYTE_WINDOW, FRAME_WINDOW, FrameCounts, PerClass};
pub use streams::STREAM_WINDOW;

use metamorph_core::counters::Class;
use metamorph_core::defects::HostLinkDefect;
use metamorph_core::time::Time;
use metamorph_core::wire::Frame;
use packet::{Content, Life, Packet, Proof, Terms};
use session::{Session, Status};
use std::collections::VecDeque;

/// The largest number of lives of the other host that a link remembers as ended. A host that restarts more often is
/// not taken back.
const ENDED_MAX: usize = 64;

/// The numbers of greetings that may still be answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Asked {
    first: u64,
    last: u64,
}

/// A host that has said hello and not confirmed yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Candidate {
    life: Life,
    terms: Terms,
    asked: Asked,
}

/// One end of a link.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct HostLink<P> {
    config: Config,
    prover: P,
    has_carrier: bool,
    /// The link to the present life of the other host.
    session: Option<Session>,
    /// Of the end that says hello: the attempts that may be answered, and when to try again.
    attempts: Option<Asked>,
    greet_at: Time,
    /// Of the other end: who has been accepted.
    candidate: Option<Candidate>,
    /// The latest number given to a greeting.
    number: u64,
    ended: Vec<Life>,
    counts: FrameCounts,
    refused: u64,
    said: State,
    out: VecDeque<OutputItem>,
}

/// An output that has not been polled yet. Packets are encoded when they are.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum OutputItem {
    Packet(Content, Life),
    Frame(Frame),
    Bytes(Channel, Vec<u8>),
    Changed(State),
    Met(Life, Terms),
}

impl<P: Prover> HostLink<P> {
    /// Creates an end whose carrier is not open yet.
    pub fn new(config: Config, prover: P) -> HostLink<P> {
        HostLink {
            config,
            prover,
            has_carrier: false,
            session: None,
            attempts: None,
            greet_at: Time::NEVER,
            candidate: None,
            number: 0,
            ended: Vec::new(),
            counts: FrameCounts::default(),
            refused: 0,
            said: State::Down,
            out: VecDeque::new(),
        }
    }

    /// Returns the state.
    pub fn state(&self) -> State {
        match self.session.as_ref().map(|s| s.status) {
            Some(Status::Up) => State::Up,
            Some(Status::Silent) => State::Silent,
            Some(Status::Fenced) => State::Fenced,
            Some(Status::Closed) => State::Closed,
            None if self.has_carrier => State::Greeting,
            None => State::Down,
        }
    }
    /// Returns the life of this end.
    pub fn life(&self) -> Life {
        self.config.life
    }
    /// Returns the life of the other host that the link is or was connected to.
    pub fn peer_life(&self) -> Option<Life> {
        self.session.as_ref().map(|s| s.life)
    }
    /// Returns what has become of the frames handed in.
    pub fn counts(&self) -> &FrameCounts {
        &self.counts
    }
    /// Returns the number of packets refused.
    pub fn refused(&self) -> u64 {
        self.refused
    }
    /// Returns the number of frames under way.
    pub fn open_frames(&self) -> usize {
        self.session.as_ref().map_or(0, |s| s.frames.open())
    }
    /// Returns the number of bytes of a stream that are not acknowledged.
    pub fn open_bytes(&self, channel: Channel) -> usize {
        self.session.as_ref().map_or(0, |s| s.sender(channel).open())
    }
    /// Returns how far the clock of the other end is ahead, if that is known.
    pub fn clock(&self, now: Time) -> Option<ClockInterval> {
        self.session.as_ref()?.exchanges.interval(now)
    }
    /// Returns until when a ward may act; `None` for other roles and before the first greeting.
    pub fn acts_until(&self) -> Option<Time> {
        let session = self.session.as_ref().filter(|_| self.config.role == Role::Ward)?;
        Some(session.acts_until(&self.config))
    }

    /// Notes that the carrier is open.
    pub fn carrier_up(&mut self, now: Time) {
        self.has_carrier = true;
        self.greet_at = if self.greets() { now } else { Time::NEVER };
        self.wake(now);
    }

    /// Notes that the carrier has closed.
    pub fn carrier_down(&mut self, now: Time) {
        self.has_carrier = false;
        if let Some(session) = &mut self.session {
            session.fall_silent();
        }
        self.wake(now);
    }

    /// Hands in a frame for the other end.
    pub fn offer(&mut self, now: Time, frame: &Frame) -> Offered {
        let class = frame.claimed_class().index();
        self.counts.offered[class] += 1;
        let (fate, count) = match self.state() {
            State::Up => (Offered::Queued, &mut self.counts.open),
            State::Silent => (Offered::Lost, &mut self.counts.lost),
            _ => (Offered::Expired, &mut self.counts.expired),
        };
        let session = self.session.as_mut().filter(|_| fate == Offered::Queued);
        let has_room = session.is_none_or(|session| session.queue(now, frame, &self.config));
        let (fate, count) =
            if has_room { (fate, count) } else { (Offered::Overflowed, &mut self.counts.overflowed) };
        count[class] += 1;
        self.send_batch(now, false);
        fate
    }

    /// Hands in bytes of a stream. Returns how many are taken: fewer than given if too many are not acknowledged.
    pub fn write(&mut self, now: Time, channel: Channel, bytes: &[u8]) -> usize {
        let taken = match self.session.as_mut().filter(|s| s.is_open()) {
            Some(session) => session.sender_mut(channel).write(bytes),
            None => 0,
        };
        self.send_streams(now);
        taken
    }

    /// Sends what waits for others to share its packet.
    pub fn flush(&mut self, now: Time) {
        self.send_batch(now, true);
    }

    /// Says goodbye.
    pub fn close(&mut self, now: Time) {
        self.flush(now);
        if let Some(session) = self.session.as_mut().filter(|s| s.is_open()) {
            session.status = Status::Closed;
            let life = session.life;
            self.out.push_back(OutputItem::Packet(Content::Bye, life));
            session.frames.give_up(&mut self.counts);
        }
        self.has_carrier = false;
        self.tell_state();
    }

    /// Takes a packet.
    ///
    /// # Errors
    /// If the packet is damaged, foreign, late or impossible; it has no effect then.
    pub fn receive(&mut self, now: Time, bytes: &[u8]) -> Result<(), Refused> {
        let taken = self.take(now, bytes);
        self.refused += u64::from(taken.is_err());
        self.wake(now);
        taken
    }

    /// Does what is due.
    pub fn wake(&mut self, now: Time) {
        if let Some(session) = &mut self.session {
            session.pass_time(now, &self.config);
            if session.status == Status::Fenced {
                session.frames.give_up(&mut self.counts);
            }
        }
        self.greet(now);
        self.send_batch(now, false);
        self.send_streams(now);
        self.acknowledge(now);
        self.tell_state();
    }

    /// Returns when to call [`HostLink::wake`].
    pub fn wake_at(&self) -> Time {
        if !self.has_carrier {
            return self.session.as_ref().map_or(Time::NEVER, |s| s.ends_at(&self.config));
        }
        let session = self.session.as_ref().map_or(Time::NEVER, |s| s.wake_at(&self.config));
        if self.is_greeting() { session.min(self.greet_at) } else { session }
    }

    /// Returns the next output, in order.
    pub fn poll(&mut self) -> Option<Output> {
        Some(match self.out.pop_front()? {
            OutputItem::Packet(content, peer_life) => {
                let Config { host: from, peer: to, run, life, .. } = self.config;
                Output::Packet(Packet { from, to, run, life, peer_life, content }.encode())
            }
            OutputItem::Frame(frame) => Output::Frame(frame),
            OutputItem::Bytes(channel, bytes) => Output::Bytes(channel, bytes),
            OutputItem::Changed(state) => Output::Changed(state),
            OutputItem::Met(life, terms) => Output::Met(life, terms),
        })
    }

    /// Returns true for the end that says hello.
    fn greets(&self) -> bool {
        self.config.host < self.config.peer
    }

    /// Returns true while hellos are sent: until the other end is heard, and while it is silent, since it may have
    /// restarted.
    fn is_greeting(&self) -> bool {
        self.greets() && self.session.as_ref().is_none_or(|s| s.status != Status::Up)
    }

    /// Returns the next number of a greeting. It is the time, so that it also dates the greeting.
    fn next_number(&mut self, now: Time) -> u64 {
        self.number = now.0.max(self.number + 1);
        self.number
    }

    fn greet(&mut self, now: Time) {
        if !self.has_carrier || !self.is_greeting() || now < self.greet_at {
            return;
        }
        let attempt = self.next_number(now);
        let first = self.attempts.map_or(attempt, |asked| asked.first);
        self.attempts = Some(Asked { first, last: attempt });
        self.greet_at = now + self.config.timing.every;
        let hello = Content::Hello { attempt, terms: self.config.terms };
        self.out.push_back(OutputItem::Packet(hello, Life::UNKNOWN));
    }

    fn send_batch(&mut self, now: Time, at_once: bool) {
        let carrier = self.has_carrier;
        let Some(session) = &mut self.session else { return };
        // Without a carrier the frames are lost, which their numbers show later.
        if let Some(frames) = session.take_batch(now, at_once).filter(|_| carrier) {
            self.out.push_back(OutputItem::Packet(frames, session.life));
        }
    }

    fn send_streams(&mut self, now: Time) {
        let Some(session) = self.session.as_mut().filter(|s| self.has_carrier && s.status == Status::Up)
        else {
            return;
        };
        while let Some((offset, bytes)) = session.stream.next_part(now) {
            self.out.push_back(OutputItem::Packet(Content::Stream { offset, bytes }, session.life));
        }
        while let Some((offset, bytes)) = session.bulk.next_part(now) {
            self.out.push_back(OutputItem::Packet(Content::Bulk { offset, bytes }, session.life));
        }
    }

    fn acknowledge(&mut self, now: Time) {
        let Some(session) = self.session.as_mut().filter(|s| self.has_carrier && s.is_open()) else { return };
        if now < session.ack_at {
            return;
        }
        session.ack_at = now + self.config.timing.every;
        session.since_ack = 0;
        if let Some(challenge) = session.to_confirm {
            let Config { host, peer, run, life, .. } = self.config;
            let proof = self.prover.prove(run, (host, life), (peer, session.life), challenge);
            self.out.push_back(OutputItem::Packet(Content::Confirm { challenge, proof }, session.life));
        }
        if session.frames.open() > 0 {
            // Tells of frames at the end that may be lost.
            let first = session.frames.next();
            let frames = Content::Frames { first, frames: Vec::new() };
            self.out.push_back(OutputItem::Packet(frames, session.life));
        }
        self.out.push_back(OutputItem::Packet(Content::Ack(session.ack(now)), session.life));
    }

    fn tell_state(&mut self) {
        let state = self.state();
        if std::mem::replace(&mut self.said, state) != state {
            self.out.push_back(OutputItem::Changed(state));
        }
    }

    fn take(&mut self, now: Time, bytes: &[u8]) -> Result<(), Refused> {
        let packet = Packet::decode(bytes)?;
        let Config { host, peer, run, life, .. } = self.config;
        if (packet.from, packet.to, packet.run) != (peer, host, run) {
            return Err(Refused::Foreign);
        }
        let may_be_unknown = matches!(packet.content, Content::Hello { .. });
        let is_for_us = packet.peer_life == life || (may_be_unknown && packet.peer_life == Life::UNKNOWN);
        let trusts = self.config.defect == Some(HostLinkDefect::TrustAnyLife);
        if !trusts && (!is_for_us || self.ended.contains(&packet.life)) {
            return Err(Refused::OtherLife);
        }
        match packet.content {
            Content::Hello { terms, .. } if self.greets() => self.check(&terms).and(Err(Refused::WrongWay)),
            Content::Hello { attempt, terms } => self.on_hello(now, packet.life, attempt, terms),
            Content::Accept { attempt, challenge, terms, proof } => {
                self.on_accept(now, packet.life, attempt, challenge, terms, proof)
            }
            Content::Confirm { challenge, proof } => self.on_confirm(now, packet.life, challenge, proof),
            content => self.on_content(now, packet.life, content),
        }
    }

    fn check(&self, theirs: &Terms) -> Result<(), Refused> {
        let ours = &self.config.terms;
        match () {
            () if ours.program != theirs.program => {
                Err(Refused::Terms("they run different versions of the program"))
            }
            () if ours.build != theirs.build => {
                Err(Refused::Terms("they run different builds of the program"))
            }
            () if ours.swarm != theirs.swarm => Err(Refused::Terms("they have different swarm files")),
            () => Ok(()),
        }
    }

    fn on_hello(&mut self, now: Time, life: Life, attempt: u64, terms: Terms) -> Result<(), Refused> {
        // The present life says hello again when it has not heard this end; acknowledgements will reach it.
        if self.peer_life() == Some(life) {
            return Ok(());
        }
        let checked = self.check(&terms);
        let challenge = self.next_number(now);
        if checked.is_ok() {
            let known = self.candidate.filter(|c| c.life == life).map(|c| c.asked.first);
            let asked = Asked { first: known.unwrap_or(challenge), last: challenge };
            self.candidate = Some(Candidate { life, terms, asked });
        }
        // An end with other terms gets an answer too, which says why it is refused; what it confirms was not asked for.
        let Config { host, peer, run, .. } = self.config;
        let proof = self.prover.prove(run, (host, self.config.life), (peer, life), attempt);
        let accept = Content::Accept { attempt, challenge, terms: self.config.terms, proof };
        self.out.push_back(OutputItem::Packet(accept, life));
        checked
    }

    fn on_accept(
        &mut self,
        now: Time,
        life: Life,
        attempt: u64,
        challenge: u64,
        terms: Terms,
        proof: Proof,
    ) -> Result<(), Refused> {
        let takes_any = self.config.defect == Some(HostLinkDefect::AnyAttempt);
        let is_asked = |asked: &Asked| (asked.first..=asked.last).contains(&attempt);
        if !takes_any && !self.attempts.as_ref().is_some_and(is_asked) {
            return Err(Refused::Unasked);
        }
        self.check(&terms)?;
        let Config { host, peer, run, .. } = self.config;
        if proof != self.prover.prove(run, (peer, life), (host, self.config.life), attempt) {
            return Err(Refused::Proof);
        }
        if self.peer_life() != Some(life) {
            self.meet(now, life, Time(attempt), terms)?;
        }
        if let Some(session) = &mut self.session {
            session.to_confirm = Some(challenge);
            session.ack_at = now;
        }
        Ok(())
    }

    fn on_confirm(&mut self, now: Time, life: Life, challenge: u64, proof: Proof) -> Result<(), Refused> {
        if self.peer_life() == Some(life) {
            return Ok(());
        }
        let takes_any = self.config.defect == Some(HostLinkDefect::AnyChallenge);
        let is_asked = |c: &Candidate| {
            c.life == life && (takes_any || (c.asked.first..=c.asked.last).contains(&challenge))
        };
        let candidate = self.candidate.filter(is_asked).ok_or(Refused::Unasked)?;
        let Config { host, peer, run, .. } = self.config;
        if proof != self.prover.prove(run, (peer, life), (host, self.config.life), challenge) {
            return Err(Refused::Proof);
        }
        self.candidate = None;
        self.meet(now, life, Time(challenge), candidate.terms)
    }

    /// Begins the link to another life of the other host; `echoed` is when this end sent what that life has answered.
    fn meet(&mut self, now: Time, life: Life, echoed: Time, terms: Terms) -> Result<(), Refused> {
        if self.ended.len() == ENDED_MAX {
            return Err(Refused::OtherLife);
        }
        if let Some(mut old) = self.session.take() {
            old.frames.give_up(&mut self.counts);
            self.ended.push(old.life);
        }
        self.attempts = None;
        self.session = Some(Session::new(now, life, echoed));
        self.out.push_back(OutputItem::Met(life, terms));
        Ok(())
    }

    fn on_content(&mut self, now: Time, life: Life, content: Content) -> Result<(), Refused> {
        let trusts = self.config.defect == Some(HostLinkDefect::TrustAnyLife);
        let session = self.session.as_mut().filter(|s| s.life == life || trusts).ok_or(Refused::OtherLife)?;
        if !session.is_open() {
            return Err(Refused::Ended);
        }
        let weight = content.weight();
        match content {
            Content::Frames { first, frames } => {
                for frame in session.take_frames(first, &frames, &self.config)? {
                    self.out.push_back(OutputItem::Frame(frame));
                }
            }
            Content::Stream { offset, bytes } => {
                let bytes = session.take_bytes(Channel::Stream, offset, &bytes, &self.config);
                self.out.extend((!bytes.is_empty()).then_some(OutputItem::Bytes(Channel::Stream, bytes)));
            }
            Content::Bulk { offset, bytes } => {
                let bytes = session.take_bytes(Channel::Bulk, offset, &bytes, &self.config);
                self.out.extend((!bytes.is_empty()).then_some(OutputItem::Bytes(Channel::Bulk, bytes)));
            }
            Content::Ack(ack) => session.take_ack(now, &ack, &mut self.counts, &self.config)?,
            Content::Bye => {
                session.status = Status::Closed;
                session.frames.give_up(&mut self.counts);
            }
            // Greetings are taken before.
            Content::Hello { .. } | Content::Accept { .. } | Content::Confirm { .. } => {}
        }
        if session.hear(now, weight, &self.config) {
            self.attempts = None;
        }
        Ok(())
    }
}

/// Returns the sum over all classes.
pub fn total(counts: &PerClass) -> u64 {
    Class::ALL.iter().map(|class| counts[class.index()]).sum()
}
