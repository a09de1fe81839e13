//! Two ends of a host link and a carrier that loses, doubles, reorders, cuts, and restarts an end; and what must hold.

use metamorph_core::counters::Class;
use metamorph_core::defects::HostLinkDefect;
use metamorph_core::ids::{HostId, Incarnation, ModuleId, Port};
use metamorph_core::lattice::Cell;
use metamorph_core::time::{Span, Time};
use metamorph_core::wire::{self, Frame, Header};
use metamorph_host_link::packet::{Life, Proof, Run, Terms};
use metamorph_host_link::{
    Channel, Config, FrameCounts, HostLink, Offered, Output, Prover, Role, State, Timing, total,
};

/// A proof without a secret: enough to tell lives and numbers apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Plain;

impl Prover for Plain {
    fn prove(&self, run: Run, from: (HostId, Life), to: (HostId, Life), number: u64) -> Proof {
        let mut proof = [0; 32];
        for (i, part) in [run.0 ^ u64::from(from.0.0), from.1.0, to.1.0, number].into_iter().enumerate() {
            proof[i * 8..i * 8 + 8].copy_from_slice(&part.to_le_bytes());
        }
        proof
    }
}

/// Frames and bytes that one start of an end has received from one start of the other.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
struct Heard {
    from: Option<Life>,
    frames: Vec<u32>,
    bytes: [Vec<u8>; 2],
}

/// One end, and what it has sent and heard in its present life.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct End {
    link: HostLink<Plain>,
    heard: Heard,
    /// The bytes written since it is connected to the present start of the other end.
    written: [Vec<u8>; 2],
    has_stopped: bool,
}

/// Two ends and the packets under way.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Pair {
    pub now: Time,
    ends: [End; 2],
    /// Packets with the end that they are for.
    pub under_way: Vec<(usize, Vec<u8>)>,
    cut: [bool; 2],
    lives: u64,
    sent: u32,
    defects: [Option<HostLinkDefect>; 2],
    window: usize,
    /// The first violation.
    pub broken: Option<&'static str>,
}

pub const WINDOW: usize = 3;

impl Pair {
    pub fn new(defect: Option<HostLinkDefect>) -> Pair {
        let mut pair = Pair {
            now: Time(1_000_000_000),
            ends: [0, 1].map(|i| Pair::end(i, 1 + i as u64, defect)),
            under_way: Vec::new(),
            cut: [false; 2],
            lives: 2,
            sent: 0,
            defects: [defect; 2],
            window: WINDOW,
            broken: None,
        };
        for i in 0..2 {
            pair.at(i, |link, now| link.carrier_up(now));
        }
        pair
    }

    fn end(i: usize, life: u64, defect: Option<HostLinkDefect>) -> End {
        let link = HostLink::new(config(i, life, defect), Plain);
        End { link, heard: Heard::default(), written: Default::default(), has_stopped: false }
    }

    /// Calls one end, carries its packets, and checks what it did.
    fn at<T>(&mut self, i: usize, call: impl FnOnce(&mut HostLink<Plain>, Time) -> T) -> T {
        let result = call(&mut self.ends[i].link, self.now);
        while let Some(output) = self.ends[i].link.poll() {
            match output {
                Output::Packet(bytes) if !self.cut[i] => self.under_way.push((1 - i, bytes)),
                Output::Packet(_) => {}
                Output::Frame(frame) => self.heard_frame(i, &frame),
                Output::Bytes(channel, bytes) => self.heard_bytes(i, channel, &bytes),
                Output::Met(life, _) => {
                    // Lives are numbered in the order of time.
                    self.breaks("an earlier life came back", self.ends[i].heard.from >= Some(life));
                    let end = &mut self.ends[i];
                    end.heard = Heard { from: Some(life), ..Heard::default() };
                    end.written = Default::default();
                }
                Output::Changed(state) => self.ends[i].has_stopped |= i == 1 && state == State::Fenced,
            }
        }
        self.check(i);
        result
    }

    fn breaks(&mut self, what: &'static str, is_broken: bool) {
        if is_broken {
            self.broken.get_or_insert(what);
        }
    }

    /// The content of a frame is its number among all of the run, and the life that sent it.
    fn heard_frame(&mut self, i: usize, frame: &Frame) {
        let header = frame.open().expect("the link delivers sound frames");
        let (number, life) = (header.sequence, u64::from(header.session));
        let heard = &mut self.ends[i].heard;
        let is_late = heard.frames.last().is_some_and(|last| number <= *last);
        let is_foreign = heard.from != Some(Life(life));
        heard.frames.push(number);
        self.breaks("a frame came twice, or after a later one", is_late);
        self.breaks("a frame of another life came", is_foreign);
    }

    fn heard_bytes(&mut self, i: usize, channel: Channel, bytes: &[u8]) {
        self.ends[i].heard.bytes[channel as usize].extend(bytes);
        let (here, there) = (&self.ends[i], &self.ends[1 - i]);
        // Bytes of an end that has restarted since cannot be compared any more.
        let is_same = here.heard.from == Some(there.life()) && there.link.peer_life() == Some(here.life());
        let (heard, written) = (&here.heard.bytes[channel as usize], &there.written[channel as usize]);
        let is_broken = is_same && !written.starts_with(heard);
        self.breaks("a stream has a gap, or bytes came twice", is_broken);
    }

    fn check(&mut self, i: usize) {
        let link = &self.ends[i].link;
        let counts: &FrameCounts = link.counts();
        let open = total(&counts.open);
        let checks = [
            ("the counts of frames do not add up", !counts.balance()),
            ("frames under way are miscounted", open != link.open_frames() as u64),
            ("more frames are under way than the window allows", link.open_frames() > self.window),
        ];
        let (guardian, ward) = (&self.ends[0], &self.ends[1]);
        let is_condemned =
            guardian.link.state() == State::Fenced && guardian.link.peer_life() == Some(ward.life());
        let acts = ward.link.acts_until().is_some_and(|until| self.now < until) && !ward.has_stopped;
        let mine = ward.link.peer_life() == Some(guardian.life());
        for (what, is_broken) in checks {
            self.breaks(what, is_broken);
        }
        self.breaks("a ward acts although its guardian counts it as dead", is_condemned && acts && mine);
    }

    pub fn state(&self, i: usize) -> State {
        self.ends[i].link.state()
    }

    pub fn offer(&mut self, i: usize) -> Offered {
        self.sent += 1;
        let header = Header {
            channel: wire::Channel::Peer,
            kind: 0,
            class: Class::ALL[self.sent as usize % Class::ALL.len()],
            port: Port(0),
            incarnation: Incarnation(0),
            source: ModuleId(0),
            destination: ModuleId(1),
            session: self.ends[i].life().0 as u32,
            sequence: self.sent,
        };
        let frame = Frame::seal(header, &Cell::default());
        self.at(i, |link, now| link.offer(now, &frame))
    }

    pub fn write(&mut self, i: usize, channel: Channel, length: usize) {
        let start = self.ends[i].written[channel as usize].len();
        let bytes: Vec<u8> = (start..start + length).map(|at| (at * 7 + at / 251) as u8).collect();
        // Written down first, because the other end cannot hear them before.
        let taken = self.at(i, |link, now| link.write(now, channel, &bytes));
        self.ends[i].written[channel as usize].extend(&bytes[..taken]);
    }

    pub fn flush(&mut self, i: usize) {
        self.at(i, |link, now| link.flush(now));
    }

    /// Delivers a packet; it stays under way if it is doubled.
    pub fn deliver(&mut self, index: usize, stays: bool) {
        let (to, bytes) = if stays { self.under_way[index].clone() } else { self.under_way.remove(index) };
        // Late packets are refused, as they have to be.
        let _ = self.at(to, |link, now| link.receive(now, &bytes));
    }

    /// Takes the latest packet of this kind off the carrier, and returns it with the end that it is for.
    pub fn hold_back(&mut self, kind: u8) -> (usize, Vec<u8>) {
        // The kind is the seventh byte of a packet.
        let index = self.under_way.iter().rposition(|(_, bytes)| bytes[6] == kind);
        self.under_way.remove(index.expect("such a packet is under way"))
    }

    /// Delivers what was held back.
    pub fn release(&mut self, held: (usize, Vec<u8>)) {
        self.under_way.push(held);
        self.deliver(self.under_way.len() - 1, false);
    }

    pub fn lose(&mut self, index: usize) {
        self.under_way.remove(index);
    }

    /// Lets time pass until `until`, waking both ends when they ask for it.
    pub fn pass(&mut self, until: Time) {
        for _ in 0..10_000 {
            let next = self.ends.iter().map(|end| end.link.wake_at()).min().unwrap_or(Time::NEVER);
            if next > until {
                break;
            }
            self.now = self.now.max(next);
            for i in 0..2 {
                if self.ends[i].link.wake_at() <= self.now {
                    self.at(i, |link, now| link.wake(now));
                }
            }
        }
        self.now = self.now.max(until);
    }

    /// Lets time pass while neither end is called and no packet is delivered; then one end looks what is due.
    pub fn look_late(&mut self, i: usize, late: Span) {
        self.now += late;
        self.at(i, |link, now| link.wake(now));
    }

    /// Lets time pass until an end wakes.
    pub fn wake_next(&mut self) {
        let next = self.ends.iter().map(|end| end.link.wake_at()).min().unwrap_or(Time::NEVER);
        if next < Time::NEVER {
            self.pass(next);
        }
    }

    /// Kills an end and starts it again.
    pub fn restart(&mut self, i: usize) {
        self.lives += 1;
        self.ends[i] = Pair::end(i, self.lives, self.defects[i]);
        self.at(i, |link, now| link.carrier_up(now));
    }

    /// Cuts one direction, or heals it.
    pub fn cut(&mut self, i: usize, is_cut: bool) {
        self.cut[i] = is_cut;
    }

    /// Breaks the carrier's connection at one end, or opens it again.
    pub fn reconnect(&mut self, i: usize, is_up: bool) {
        self.at(i, |link, now| if is_up { link.carrier_up(now) } else { link.carrier_down(now) });
    }

    /// Lets time pass while packets are delivered in order, each within 50 ms.
    pub fn carry(&mut self, span: Span) {
        let end = self.now + span;
        while self.now < end {
            while !self.under_way.is_empty() {
                self.deliver(0, false);
            }
            self.pass(end.min(self.now + Span::millis(50)));
        }
    }

    /// Carries everything in order until nothing is open. Fails what has not arrived although both ends are up.
    pub fn settle(&mut self) {
        self.cut = [false; 2];
        for i in 0..2 {
            self.reconnect(i, true);
        }
        self.carry(Span::secs(10));
        for i in 0..2 {
            let (here, there) = (&self.ends[i], &self.ends[1 - i]);
            if here.link.state() != State::Up || there.link.state() != State::Up {
                continue;
            }
            let counts = here.link.counts();
            let is_open = here.link.open_frames() > 0
                || here.link.open_bytes(Channel::Stream) > 0
                || here.link.open_bytes(Channel::Bulk) > 0;
            let is_short = here.written != there.heard.bytes;
            let is_miscounted = total(&counts.taken) < there.heard.frames.len() as u64;
            self.breaks("something stays open for ever", is_open);
            self.breaks("a stream is not complete", is_short);
            self.breaks("fewer frames are counted as taken than have been", is_miscounted);
        }
    }

    fn met(&self) -> bool {
        (0..2).all(|i| self.state(i) == State::Up)
    }

    /// Returns a pair of which both ends are up.
    pub fn up(defect: Option<HostLinkDefect>) -> Pair {
        let mut pair = Pair::new(defect);
        for _ in 0..20 {
            while !pair.under_way.is_empty() {
                pair.deliver(0, false);
            }
            if pair.met() {
                return pair;
            }
            pair.wake_next();
        }
        panic!("the ends do not meet: {:?} {:?}", pair.state(0), pair.state(1));
    }
}

/// Returns the configuration of one end.
pub fn config(i: usize, life: u64, defect: Option<HostLinkDefect>) -> Config {
    Config {
        host: HostId(i as u16),
        peer: HostId(1 - i as u16),
        run: Run(7),
        life: Life(life),
        terms: Terms { program: 1, build: 2, swarm: 3, room: 4 },
        role: [Role::Guardian, Role::Ward][i],
        timing: Timing { silent: Span::secs(1), fence: Span::secs(3), ..Timing::default() },
        window: WINDOW,
        defect,
    }
}

impl End {
    fn life(&self) -> Life {
        self.link.life()
    }
}
