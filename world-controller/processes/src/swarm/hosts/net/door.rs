//! The conversation outside of runs, over a host link of its own: the controller's host asks a daemon for its state, or
//! gives it a share of a run. Both ends prove that they know the token of the site.

use super::session::{DOOR, Line, Net};
use crate::swarm::hosts::carrier::Arrived;
use crate::swarm::hosts::messages::{Answer, Opening, whole_opening, write_opening};
use crate::swarm::hosts::node::{PROGRAM, random};
use metamorph_console::stopwatch::Stopwatch;
use metamorph_module_agent::clock::monotonic;
use metamorph_protocol::host_link::packet::{Life, Proof, Run, Terms};
use metamorph_protocol::host_link::{
    Channel, ClockInterval, Config, FRAME_WINDOW, HostLink, Output, Prover, Refused, Role, State, Timing,
};
use metamorph_protocol::ids::HostId;
use metamorph_protocol::time::{Span, Time};
use ring::hmac;
use std::io;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel};
use std::time::Duration;

/// The time between two greetings, and between two acknowledgements: fast, since people wait for answers.
const EVERY: Span = Span::millis(50);
/// Longest time that a daemon waits before it looks for answers that it has to give.
const ANSWER_WAIT_MAX: Duration = Duration::from_millis(20);
/// Bytes given to the stream in one turn.
const PIECE: usize = 1 << 18;

/// Proofs by HMAC-SHA-256 with the token of the site.
pub struct Token(hmac::Key);

impl Token {
    fn new(token: &[u8]) -> Token {
        Token(hmac::Key::new(hmac::HMAC_SHA256, token))
    }
}

impl Prover for Token {
    fn prove(&self, run: Run, from: (HostId, Life), to: (HostId, Life), number: u64) -> Proof {
        let mut context = hmac::Context::with_key(&self.0);
        for value in [run.0, from.0.0.into(), from.1.0, to.0.0.into(), to.1.0, number] {
            context.update(&value.to_le_bytes());
        }
        let mut proof = [0; 32];
        proof.copy_from_slice(context.sign().as_ref());
        proof
    }
}

/// One end of the conversation.
struct Talk {
    link: HostLink<Token>,
    line: Line,
    heard: Vec<u8>,
    to_say: Vec<u8>,
    /// Why a packet was refused last.
    refused: Option<Refused>,
    /// True if the other end has been heard, and has not proven yet that it knows the token.
    is_greeted: bool,
    /// True if it has left without a proof.
    is_unproven: bool,
}

impl Talk {
    fn new(net: &Net, peer: HostId, build: u64, room: u32) -> io::Result<Talk> {
        let terms = Terms { program: PROGRAM, build, swarm: 0, room };
        let config = Config {
            host: net.host(),
            peer,
            run: Run(DOOR),
            life: Life(random()?.max(1)),
            terms,
            role: Role::Equal,
            timing: Timing { every: EVERY, ..Timing::default() },
            window: FRAME_WINDOW,
            defect: None,
        };
        let line = net.line(DOOR, peer)?;
        let mut link = HostLink::new(config, Token::new(&net.keys().token));
        link.carrier_up(Time(monotonic()));
        Ok(Talk {
            link,
            line,
            heard: Vec::new(),
            to_say: Vec::new(),
            refused: None,
            is_greeted: false,
            is_unproven: false,
        })
    }

    fn say<M: serde::Serialize>(&mut self, message: &M) -> io::Result<()> {
        write_opening(&mut self.to_say, message)
    }

    /// Carries packets for a while at most. Returns true if something has arrived.
    fn turn(&mut self, patience: Duration) -> io::Result<bool> {
        let until_wake = Duration::from_nanos(self.link.wake_at().0.saturating_sub(monotonic()));
        let arrived = self.line.receive(patience.min(until_wake));
        let now = Time(monotonic());
        match &arrived {
            Some(Arrived::Packet(packet)) => match self.link.receive(now, packet) {
                Ok(()) => self.is_greeted = self.link.state() == State::Greeting,
                Err(refused) => self.refused = Some(refused),
            },
            Some(Arrived::Interruption) => self.is_unproven = std::mem::take(&mut self.is_greeted),
            None => {}
        }
        if now >= self.link.wake_at() {
            self.link.wake(now);
        }
        if !self.to_say.is_empty() {
            let piece = &self.to_say[..self.to_say.len().min(PIECE)];
            let taken = self.link.write(now, Channel::Stream, piece);
            self.to_say.drain(..taken);
        }
        while let Some(output) = self.link.poll() {
            match output {
                Output::Packet(packet) => self.line.put(packet)?,
                Output::Bytes(Channel::Stream, bytes) => self.heard.extend(bytes),
                _ => {}
            }
        }
        Ok(arrived.is_some())
    }

    /// Returns true once all that was said has arrived.
    fn is_heard(&self) -> bool {
        self.to_say.is_empty() && self.link.open_bytes(Channel::Stream) == 0
    }
}

/// Why a conversation with a daemon fails.
#[derive(Debug, thiserror::Error)]
pub enum VisitError {
    /// No session, or a failed one.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// It is heard, but not believed.
    #[error("it is refused: {0}")]
    Refused(Refused),
    /// Nothing is heard.
    #[error("it does not answer")]
    Silent,
}

/// A conversation of the controller's host with a daemon.
pub struct Visit(Talk);

impl Visit {
    /// Begins a conversation.
    ///
    /// # Errors
    /// If the daemon does not answer in time, or does not prove what it has to.
    pub fn begin(net: &Net, to: HostId, build: u64, patience: Duration) -> Result<Visit, VisitError> {
        let mut talk = Talk::new(net, to, build, 0)?;
        let begun = Stopwatch::start();
        while talk.link.state() != State::Up {
            let Some(left) = patience.checked_sub(begun.elapsed()) else {
                return Err(talk.refused.map_or(VisitError::Silent, VisitError::Refused));
            };
            talk.turn(left)?;
            if let Some(why @ (Refused::Proof | Refused::Terms(_))) = talk.refused {
                return Err(VisitError::Refused(why));
            }
        }
        Ok(Visit(talk))
    }

    /// Says something, and returns the answer.
    ///
    /// # Errors
    /// If there is none in time, or it cannot be read.
    pub fn ask(&mut self, opening: &Opening, patience: Duration) -> Result<Answer, VisitError> {
        let Visit(talk) = self;
        talk.say(opening)?;
        let mut heard = Stopwatch::start();
        loop {
            if let Some(answer) = whole_opening(&mut talk.heard)? {
                return Ok(answer);
            }
            let before = talk.link.open_bytes(Channel::Stream) + talk.to_say.len();
            talk.turn(ANSWER_WAIT_MAX)?;
            // A large share takes its time, as long as it gets on.
            if talk.link.open_bytes(Channel::Stream) + talk.to_say.len() != before {
                heard = Stopwatch::start();
            }
            if heard.elapsed() > patience || talk.link.state() == State::Closed {
                return Err(VisitError::Silent);
            }
        }
    }

    /// Exchanges clock stamps for a while, and returns how far the daemon's clock is ahead.
    ///
    /// # Errors
    /// If the session has ended.
    pub fn clock(&mut self, patience: Duration) -> Result<Option<ClockInterval>, VisitError> {
        let begun = Stopwatch::start();
        while let Some(left) = patience.checked_sub(begun.elapsed()) {
            self.0.turn(left)?;
        }
        Ok(self.0.link.clock(Time(monotonic())))
    }
}

impl Drop for Visit {
    fn drop(&mut self) {
        self.0.link.close(Time(monotonic()));
        let _ = self.0.turn(Duration::ZERO);
    }
}

/// A daemon's way to answer an opening.
pub struct Reply(Sender<Answer>);

impl Reply {
    /// Answers.
    ///
    /// # Errors
    /// If the daemon ends.
    pub fn say(&self, answer: Answer) -> io::Result<()> {
        self.0.send(answer).map_err(|_| io::Error::from(io::ErrorKind::BrokenPipe))
    }
}

/// An opening that has arrived, and the way to answer it.
pub type Knock = (Opening, Reply);

/// Serves conversations until the receiver of openings is gone. One begins when the one before has ended, or when another
/// life of the controller's host is heard.
pub fn serve(net: &Arc<Net>, build: u64, room: u32, openings: &SyncSender<Knock>) -> io::Result<()> {
    let mut talk = Talk::new(net, HostId::CONTROLLER, build, room)?;
    let (mut life, mut answer): (Option<Life>, Option<Receiver<Answer>>) = (None, None);
    loop {
        talk.turn(ANSWER_WAIT_MAX)?;
        if let Some(refused) = talk.refused.take() {
            tracing::warn!("a packet from {} is refused: {refused}", HostId::CONTROLLER);
        }
        if std::mem::take(&mut talk.is_unproven) {
            let who = HostId::CONTROLLER;
            tracing::warn!("{who} is refused: it has greeted this host and left without proving the token");
        }
        if talk.link.peer_life() != life {
            life = talk.link.peer_life();
            (talk.heard, talk.to_say, answer) = (Vec::new(), Vec::new(), None);
        }
        match whole_opening::<Opening>(&mut talk.heard) {
            Ok(Some(opening)) => {
                let (sender, receiver) = channel();
                answer = Some(receiver);
                if openings.send((opening, Reply(sender))).is_err() {
                    return Ok(());
                }
            }
            Ok(None) => {}
            Err(e) => {
                tracing::warn!("what {} says is refused: {e}", HostId::CONTROLLER);
                talk.heard.clear();
                talk.link.close(Time(monotonic()));
            }
        }
        if let Some(waiting) = &answer {
            match waiting.recv_timeout(Duration::ZERO) {
                Ok(said) => talk.say(&said)?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => answer = None,
            }
        }
        let is_over = matches!(talk.link.state(), State::Closed | State::Fenced);
        let is_left = talk.link.state() == State::Silent && talk.is_heard();
        if is_over || is_left {
            // Lives that have ended are remembered by the link, so the next conversation gets a new one.
            drop(talk);
            talk = Talk::new(net, HostId::CONTROLLER, build, room)?;
            (life, answer) = (None, None);
        }
    }
}
