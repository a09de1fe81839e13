//! The link to one life of the other host: what is under way in both directions, and since when the other end is silent.

use super::clock_interval::ClockExchanges;
use super::frames::{FrameCounts, FrameReceiver, FrameSender};
use super::packet::{Ack, Content, FRAMES_HEADER, HEADER, Life, MAX_PACKET};
use super::streams::{StreamReceiver, StreamSender};
use super::{Channel, Config, Refused, Role};
use metamorph_core::defects::HostLinkDefect;
use metamorph_core::time::{Span, Time};
use metamorph_core::wire::Frame;

/// Number of packets after which an acknowledgement is sent at once.
const PACKETS_PER_ACK: u32 = 64;
/// The largest number of a frame; no run sends as many.
const MAX_NUMBER: u64 = 1 << 62;
/// The bytes of frames in one packet at most.
const BATCH_BYTES: usize = MAX_PACKET - HEADER - FRAMES_HEADER;

/// How it stands with the other end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Status {
    Up,
    Silent,
    Fenced,
    Closed,
}

/// The link to one life of the other host.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Session {
    pub life: Life,
    pub status: Status,
    pub frames: FrameSender,
    received: FrameReceiver,
    /// Frames that have a number and wait for their packet, and when to send them.
    batch: Vec<Frame>,
    batch_bytes: usize,
    batch_at: Time,
    pub stream: StreamSender,
    pub bulk: StreamSender,
    stream_in: StreamReceiver,
    bulk_in: StreamReceiver,
    pub exchanges: ClockExchanges,
    /// The challenge that is confirmed until the other end is heard.
    pub to_confirm: Option<u64>,
    heard_at: Time,
    /// The latest stamp of the other clock, and when it came.
    their_clock: Option<(Time, Time)>,
    /// The latest time of this end's clock that the other end has heard.
    echoed: Time,
    round_trip: Span,
    pub ack_at: Time,
    pub since_ack: u32,
}

impl Session {
    pub fn new(now: Time, life: Life, echoed: Time) -> Session {
        Session {
            life,
            status: Status::Up,
            frames: FrameSender::default(),
            received: FrameReceiver::default(),
            batch: Vec::new(),
            batch_bytes: 0,
            batch_at: Time::NEVER,
            stream: StreamSender::default(),
            bulk: StreamSender::default(),
            stream_in: StreamReceiver::default(),
            bulk_in: StreamReceiver::default(),
            exchanges: ClockExchanges::default(),
            to_confirm: None,
            heard_at: now,
            their_clock: None,
            echoed,
            round_trip: Span::ZERO,
            ack_at: now,
            since_ack: 0,
        }
    }

    /// Returns true if the other end may still be heard.
    pub fn is_open(&self) -> bool {
        matches!(self.status, Status::Up | Status::Silent)
    }
    pub fn sender(&self, channel: Channel) -> &StreamSender {
        match channel {
            Channel::Stream => &self.stream,
            Channel::Bulk => &self.bulk,
        }
    }
    pub fn sender_mut(&mut self, channel: Channel) -> &mut StreamSender {
        match channel {
            Channel::Stream => &mut self.stream,
            Channel::Bulk => &mut self.bulk,
        }
    }

    /// Returns until when a ward may act: counted from a time that the guardian is known to have heard. A ward that hears the guardian
    /// learns nothing about the other direction. The fiftieth is more than both clocks gain or lose.
    pub fn acts_until(&self, config: &Config) -> Time {
        let by_hearing = config.defect == Some(HostLinkDefect::LeaseByHearing);
        let since = if by_hearing { self.heard_at } else { self.echoed };
        since + (config.timing.fence - config.timing.fence / 50)
    }

    /// Returns when this end counts the other as dead, or has to stop.
    pub fn ends_at(&self, config: &Config) -> Time {
        match config.role {
            _ if !self.is_open() => Time::NEVER,
            Role::Guardian => self.heard_at + config.timing.fence,
            Role::Ward => self.acts_until(config),
            Role::Equal => Time::NEVER,
        }
    }

    fn silent_at(&self, config: &Config) -> Time {
        if self.status == Status::Up { self.heard_at + config.timing.silent } else { Time::NEVER }
    }

    /// Returns the time after which a part of a stream counts as lost.
    fn patience(&self, config: &Config) -> Span {
        config.timing.every * 2 + self.round_trip * 2
    }

    /// Returns when something is due, besides greetings.
    pub fn wake_at(&self, config: &Config) -> Time {
        if !self.is_open() {
            return Time::NEVER;
        }
        let patience = self.patience(config);
        let is_up = self.status == Status::Up;
        let repeats = is_up && config.defect != Some(HostLinkDefect::NoRepeat);
        let repeat = self.stream.repeat_at(patience).min(self.bulk.repeat_at(patience));
        let due = self.ack_at.min(self.batch_at).min(self.ends_at(config)).min(self.silent_at(config));
        if repeats { due.min(repeat) } else { due }
    }

    /// Falls silent, is fenced, or repeats streams, if that is due.
    pub fn pass_time(&mut self, now: Time, config: &Config) {
        if now >= self.ends_at(config) {
            self.status = Status::Fenced;
            self.batch.clear();
            (self.batch_bytes, self.batch_at) = (0, Time::NEVER);
        }
        if now >= self.silent_at(config) {
            self.fall_silent();
        }
        if self.status != Status::Up || config.defect == Some(HostLinkDefect::NoRepeat) {
            return;
        }
        let patience = self.patience(config);
        for stream in [&mut self.stream, &mut self.bulk] {
            if now >= stream.repeat_at(patience) {
                stream.repeat();
            }
        }
    }

    pub fn fall_silent(&mut self) {
        if self.status == Status::Up {
            self.status = Status::Silent;
        }
    }

    /// Notes that the other end has been heard. Returns true if it was silent before, or not confirmed.
    /// `weight` is what it brought, beyond one packet, in sixty-fourths of what makes an acknowledgement due.
    pub fn hear(&mut self, now: Time, weight: u32, config: &Config) -> bool {
        self.heard_at = self.heard_at.max(now);
        self.since_ack += 1 + weight;
        if self.since_ack >= PACKETS_PER_ACK {
            self.ack_at = now;
        }
        let is_new = self.to_confirm.take().is_some() || self.status == Status::Silent;
        if self.status == Status::Silent {
            self.status = Status::Up;
            if config.defect != Some(HostLinkDefect::NoRepeat) {
                self.stream.repeat();
                self.bulk.repeat();
            }
        }
        is_new
    }

    /// Gives a frame a number and queues it. Returns false if too many are under way.
    pub fn queue(&mut self, now: Time, frame: &Frame, config: &Config) -> bool {
        let unbounded = config.defect == Some(HostLinkDefect::IgnoreWindow);
        if !unbounded && !self.frames.has_room(frame, config.window) {
            return false;
        }
        self.frames.add(frame);
        if self.batch.is_empty() {
            self.batch_at = now + config.timing.batch;
        }
        self.batch_bytes += frame.wire_len();
        self.batch.push(*frame);
        true
    }

    /// Returns the frames of one packet, if it is full or due.
    pub fn take_batch(&mut self, now: Time, at_once: bool) -> Option<Content> {
        if !self.is_open() {
            // They have been given up with all others under way.
            self.batch.clear();
            (self.batch_bytes, self.batch_at) = (0, Time::NEVER);
            return None;
        }
        let is_full = self.batch_bytes > BATCH_BYTES - Frame::SIZE;
        if self.batch.is_empty() || !(at_once || is_full || now >= self.batch_at) {
            return None;
        }
        let first = self.frames.next() - self.batch.len() as u64;
        let frames = std::mem::take(&mut self.batch);
        (self.batch_bytes, self.batch_at) = (0, Time::NEVER);
        Some(Content::Frames { first, frames })
    }

    /// Takes the frames of a packet, and returns those that are new.
    pub fn take_frames(
        &mut self,
        first: u64,
        frames: &[Frame],
        config: &Config,
    ) -> Result<Vec<Frame>, Refused> {
        if first > MAX_NUMBER {
            return Err(Refused::Impossible);
        }
        let takes_all = config.defect == Some(HostLinkDefect::TakeDoubled);
        let numbered = (first..).zip(frames);
        let taken = numbered.filter(|(number, frame)| self.received.take(*number, frame) || takes_all);
        let taken = taken.map(|(_, frame)| *frame).collect();
        self.received.skip_to(first + frames.len() as u64);
        Ok(taken)
    }

    /// Takes a part of a stream, and returns the bytes that come next.
    pub fn take_bytes(&mut self, channel: Channel, offset: u64, bytes: &[u8], config: &Config) -> Vec<u8> {
        let receiver = match channel {
            Channel::Stream => &mut self.stream_in,
            Channel::Bulk => &mut self.bulk_in,
        };
        if config.defect == Some(HostLinkDefect::SkipGaps) && offset > receiver.taken() {
            receiver.skip_to(offset);
        }
        receiver.take(offset, bytes)
    }

    /// Returns an acknowledgement.
    pub fn ack(&self, now: Time) -> Ack {
        Ack {
            stream: self.stream_in.taken(),
            bulk: self.bulk_in.taken(),
            expected: self.received.expected(),
            taken: *self.received.taken(),
            clock: now,
            echo: self.their_clock,
        }
    }

    /// Takes an acknowledgement.
    pub fn take_ack(
        &mut self,
        now: Time,
        ack: &Ack,
        counts: &mut FrameCounts,
        config: &Config,
    ) -> Result<(), Refused> {
        if ack.echo.is_some_and(|(echo, heard)| echo > now || heard > ack.clock) {
            return Err(Refused::Impossible);
        }
        // Checked before anything is changed.
        let is_sent = self.stream.has_sent(ack.stream) && self.bulk.has_sent(ack.bulk);
        if !is_sent || !self.frames.acknowledge(ack.expected, &ack.taken, counts) {
            return Err(Refused::Impossible);
        }
        if config.defect == Some(HostLinkDefect::CountLossTwice) {
            counts.lost[0] += ack.expected.saturating_sub(ack.taken.iter().sum());
        }
        self.stream.acknowledge(ack.stream, now);
        self.bulk.acknowledge(ack.bulk, now);
        // An acknowledgement that was overtaken has nothing new.
        if self.their_clock.is_none_or(|(latest, _)| latest < ack.clock) {
            self.their_clock = Some((ack.clock, now));
        }
        if let Some((echo, heard)) = ack.echo {
            self.echoed = self.echoed.max(echo);
            self.exchanges.add(echo, heard, ack.clock, now);
            self.round_trip = now.since(echo) - ack.clock.since(heard);
        }
        Ok(())
    }
}
