//! One host's end of all its links: packets between carriers and host links, frames between the inboxes of this host
//! and other hosts, the bytes of streams, and this host's own counts. Used by daemons and by the controller.

use super::carrier::{Carrier, CarrierEvent, INCOMING};
use super::connection::Connection;
use super::messages::{self, Assignment};
use super::residents::Residents;
use crate::metrics;
use metamorph_module_agent::clock::monotonic;
use metamorph_module_agent::clock::source::{ClockSource, FileClock};
use metamorph_module_agent::run_dir::counter_file::AgentCounters;
use metamorph_module_agent::run_dir::swarm_file;
use metamorph_module_agent::transport::shared_frame::SharedFrame;
use metamorph_module_agent::transport::{Link, SendStatus, Transport};
use metamorph_protocol::counters::{Class, Tally};
use metamorph_protocol::host_link::packet::{Life, Proof, Run, Terms};
use metamorph_protocol::host_link::{
    Channel as Stream, ClockInterval, Config, FRAME_WINDOW, HostLink, Offered, Output, Prover, Role, State,
    Timing,
};
use metamorph_protocol::ids::{HostId, ModuleId};
use metamorph_protocol::link::Hosts;
use metamorph_protocol::time::{Span, Time};
use metamorph_protocol::wire::{Channel, Frame, Header};
use serde::Serialize;
use serde::de::DeserializeOwned;
use siphasher::sip128::{Hasher128, SipHasher24};
use std::collections::{BTreeMap, VecDeque};
use std::hash::Hasher;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

/// The version of the conversation between hosts.
pub const PROGRAM: u32 = 6;
/// Shortest time that a controller may take to get all hosts together before it is heard.
const GRACE_MIN: Span = Span::secs(60);
/// Bytes of a stream that may wait for its window before the owner should say no more.
const BACKLOG: usize = 1 << 20;

/// The secret of a run. Unix sockets in a private directory are what protects it.
#[derive(Clone, Debug)]
pub struct Secret(pub [u64; 2]);

impl Prover for Secret {
    fn prove(&self, run: Run, from: (HostId, Life), to: (HostId, Life), number: u64) -> Proof {
        let mut proof = [0; 32];
        for (part, half) in proof.chunks_exact_mut(16).zip(0u8..) {
            let mut hasher = SipHasher24::new_with_keys(self.0[0], self.0[1]);
            hasher.write_u8(half);
            for value in [run.0, from.0.0.into(), from.1.0, to.0.0.into(), to.1.0, number] {
                hasher.write(&value.to_le_bytes());
            }
            part.copy_from_slice(&hasher.finish128().as_bytes());
        }
        proof
    }
}

/// The link to another host.
#[derive(Debug)]
struct Peer {
    link: HostLink<Secret>,
    /// The open connection and its number.
    carrier: Option<(u64, Box<dyn Carrier>)>,
    /// Bytes for the stream beyond its window.
    outgoing: Vec<u8>,
    incoming: Vec<u8>,
    /// The same for the bulk stream.
    bulk: (Vec<u8>, Vec<u8>),
    /// The scenario time at which the link was last silent.
    healed: Time,
    /// When the carrier was taken into use.
    attached: Time,
}

/// One host's end of all its links.
#[derive(Debug)]
pub struct Node<L> {
    host: HostId,
    hosts: Arc<Hosts>,
    root: PathBuf,
    clock: FileClock,
    peers: BTreeMap<HostId, Peer>,
    carriers: (SyncSender<CarrierEvent>, Receiver<CarrierEvent>),
    opened: u64,
    life: Life,
    /// The hash of the swarm file, on which all hosts of a run have to agree.
    swarm: u64,
    /// The generation of the controller whose inbox this host's is.
    generation: u32,
    /// How long the controller may take to be heard for the first time.
    grace: Span,
    /// Until when this host acts if no successor of the controller is heard, on another machine.
    lease: Option<Time>,
    changes: VecDeque<(HostId, State)>,
    /// The agents of this host.
    pub residents: Residents<L>,
    /// Fates of the frames at this host itself, apart from those on its links.
    tally: Tally,
    foreign: u64,
    crossed: BTreeMap<HostId, Tally>,
    /// Frames that were under way to controllers before this one.
    loose: [u64; Class::ALL.len()],
}

/// Returns the hash of this program's build, as far as its version and size tell it.
pub fn build() -> u64 {
    let size = std::fs::metadata("/proc/self/exe").map_or(0, |exe| exe.len());
    digest(&[metamorph_text::version::version().as_bytes(), &size.to_le_bytes()].concat())
}

fn digest(bytes: &[u8]) -> u64 {
    let mut hasher = SipHasher24::new();
    hasher.write(bytes);
    hasher.finish128().h1
}

/// Returns 64 random bits.
pub fn random() -> io::Result<u64> {
    let mut bytes = [0; 8];
    rustix::rand::getrandom(&mut bytes[..], rustix::rand::GetRandomFlags::empty())?;
    Ok(u64::from_le_bytes(bytes))
}

impl<L: Link> Node<L> {
    /// Creates a host without connections whose run directory is `root`, and whose inbox is that of a controller of this
    /// generation.
    ///
    /// # Errors
    /// If there is no clock page, or no randomness.
    pub fn new(assignment: &Assignment, root: &Path, generation: u32) -> io::Result<Node<L>> {
        let Assignment { host, hosts, .. } = assignment;
        let life = Life(random()?.max(1));
        let others = (0..hosts.len() as u16).map(HostId).filter(|peer| peer != host);
        let swarm = digest(&swarm_file::without_hosts(&assignment.swarm));
        let peers = others.map(|peer| (peer, Peer::new(assignment, peer, life, swarm))).collect();
        Ok(Node {
            host: *host,
            hosts: Arc::clone(hosts),
            root: root.to_owned(),
            clock: FileClock::open(root)?,
            peers,
            carriers: sync_channel(INCOMING),
            opened: 0,
            life,
            swarm,
            generation,
            grace: assignment.silent_and_fence.1.max(GRACE_MIN),
            lease: None,
            changes: VecDeque::new(),
            residents: Residents::new(),
            tally: Tally::default(),
            foreign: 0,
            crossed: BTreeMap::new(),
            loose: [0; Class::ALL.len()],
        })
    }

    /// Keeps the lease that the present controller has given for its successor: a call alone extends nothing, since the
    /// successor may count this host as dead if it is not heard.
    pub fn keep_lease(&mut self) {
        let link = self.peers.get(&HostId::CONTROLLER).map(|peer| &peer.link);
        self.lease = link.and_then(HostLink::acts_until).or(self.lease);
    }

    /// Ends the link to a host permanently, and begins one to its successor. Data on its streams is lost.
    pub fn renew(&mut self, assignment: &Assignment, host: HostId) {
        let now = self.clock.read_page().map_or(Time::ZERO, |page| page.at(monotonic()));
        let successor = Peer { healed: now, ..Peer::new(assignment, host, self.life, self.swarm) };
        let Some(before) = self.peers.insert(host, successor) else { return };
        let (counts, crossed) = (before.link.counts(), self.crossed.entry(host).or_default());
        for class in Class::ALL {
            let i = class.index();
            crossed[class].lost += counts.lost[i];
            self.tally[class].lost += counts.lost[i];
            self.tally[class].overflowed += counts.overflowed[i];
            self.tally[class].expired += counts.expired[i];
            self.loose[i] += counts.unaccounted[i] + counts.open[i];
        }
    }

    /// Returns the scenario time up to which time passes here at least.
    pub fn promised(&self) -> Time {
        self.clock.read_page().map_or(Time::ZERO, |page| page.at(page.until()))
    }

    /// Returns the states of all links and clocks, for metrics.
    pub fn peers(&self) -> BTreeMap<HostId, metrics::Peer> {
        let now = Time(monotonic());
        let peer = |peer: &Peer| metrics::Peer { state: peer.link.state(), clock: peer.link.clock(now) };
        self.peers.iter().map(|(host, one)| (*host, peer(one))).collect()
    }

    /// Returns true if the link to another host is up.
    pub fn is_up(&self, host: HostId) -> bool {
        self.peers.get(&host).is_some_and(|peer| peer.link.state() == State::Up)
    }

    /// Takes a connection to another host into use, in place of the one before.
    ///
    /// # Errors
    /// If it cannot be set up.
    pub fn attach(&mut self, to: HostId, connection: Connection) -> io::Result<()> {
        self.opened += 1;
        let carrier =
            connection.carry(to, self.opened, self.carriers.0.clone(), (&self.root, self.generation))?;
        if let Some(peer) = self.peers.get_mut(&to) {
            let now = Time(monotonic());
            peer.attached = now;
            if peer.carrier.replace((self.opened, Box::new(carrier))).is_some() {
                peer.link.carrier_down(now);
            }
            peer.link.carrier_up(now);
        }
        Ok(())
    }

    /// Iterates over the hosts without a connection.
    pub fn unconnected(&self) -> impl Iterator<Item = HostId> {
        let open = |peer: &Peer| peer.carrier.is_some() || peer.link.state() == State::Closed;
        self.peers.iter().filter(move |(_, peer)| !open(peer)).map(|(id, _)| *id)
    }

    /// Returns the home of a module; a number that no module has belongs to the controller's host.
    pub fn home(&self, id: ModuleId) -> HostId {
        self.hosts.home_of(id).unwrap_or(HostId::CONTROLLER)
    }

    /// Returns true if this host's daemon must not act any longer: the controller may count it as dead, or has left before
    /// the link was up.
    pub fn has_to_stop(&self) -> bool {
        self.peers.get(&HostId::CONTROLLER).is_some_and(|peer| match peer.link.acts_until().or(self.lease) {
            Some(end) => Time(monotonic()) >= end,
            None => peer.carrier.is_none() || Time(monotonic()) >= peer.attached + self.grace,
        })
    }

    /// Returns the scenario time before which nothing arrived in time because the link was silent: that is no lateness of
    /// agents.
    pub fn healed(&self, of: HostId) -> Time {
        self.peers.get(&of).map_or(Time::ZERO, |peer| peer.healed)
    }

    /// Sends a message to another host on the stream.
    pub fn tell<M: Serialize>(&mut self, to: HostId, message: &M) {
        if let Some(peer) = self.peers.get_mut(&to) {
            messages::push(&mut peer.outgoing, message);
        }
    }

    /// Sends a message to another host on the bulk stream, which gets what the stream leaves. Returns false if too much
    /// waits.
    pub fn tell_in_bulk<M: Serialize>(&mut self, to: HostId, message: &M) -> bool {
        let Some(peer) = self.peers.get_mut(&to).filter(|peer| peer.bulk.0.len() < BACKLOG) else {
            return false;
        };
        messages::push(&mut peer.bulk.0, message);
        true
    }

    /// Returns the next message from another host on the bulk stream.
    ///
    /// # Errors
    /// If its bytes hold no message.
    pub fn hear_in_bulk<M: DeserializeOwned>(&mut self, from: HostId) -> io::Result<Option<M>> {
        self.peers.get_mut(&from).map_or(Ok(None), |peer| messages::pop(&mut peer.bulk.1))
    }

    /// True if all that was said to another host on the bulk stream has arrived.
    pub fn is_bulk_through(&self, to: HostId) -> bool {
        let is_through = |peer: &Peer| peer.bulk.0.is_empty() && peer.link.open_bytes(Stream::Bulk) == 0;
        self.peers.get(&to).is_none_or(is_through)
    }

    /// True if so much waits for the stream that no more should be said for now.
    pub fn is_behind(&self, to: HostId) -> bool {
        self.peers.get(&to).is_some_and(|peer| peer.outgoing.len() > BACKLOG)
    }

    /// Returns the next message from another host.
    ///
    /// # Errors
    /// If its bytes hold no message.
    pub fn hear<M: DeserializeOwned>(&mut self, from: HostId) -> io::Result<Option<M>> {
        self.peers.get_mut(&from).map_or(Ok(None), |peer| messages::pop(&mut peer.incoming))
    }

    /// Returns the next change of a link's state.
    pub fn next_change(&mut self) -> Option<(HostId, State)> {
        self.changes.pop_front()
    }

    /// Returns the hosts of the run, with the present homes of modules.
    pub fn hosts(&self) -> &Hosts {
        &self.hosts
    }

    /// Gives modules other homes.
    pub fn change_homes<T>(&mut self, change: impl FnOnce(&mut Hosts) -> T) -> T {
        change(Arc::make_mut(&mut self.hosts))
    }

    /// Forwards a frame of an agent of this host to the receiver or its host. Returns false if it is for no agent: then it is
    /// for the controller of this host.
    pub fn forward<T: Transport<Link = L>>(&mut self, transport: &mut T, shared: &SharedFrame) -> bool {
        let frame = shared.frame();
        let Ok(header) = frame.open() else {
            let damaged = shared.damaged_class();
            if let Some(class) = damaged {
                // A link between hosts refuses damaged frames.
                self.tally[class].refused += 1;
            }
            return damaged.is_some();
        };
        if header.channel != Channel::Peer {
            return false;
        }
        let of_ours = |id| self.hosts.is_home(id, self.host);
        let home = self.hosts.home_of(header.destination).filter(|_| of_ours(header.source));
        if home == Some(self.host) {
            // The receiver has moved here since its sender was started.
            self.post(transport, &header, *shared);
            return true;
        }
        let Some((home, peer)) = home.and_then(|home| Some((home, self.peers.get_mut(&home)?))) else {
            self.foreign += 1;
            return true;
        };
        let counts = &mut self.crossed.entry(home).or_default()[header.class];
        counts.sent += 1;
        counts.bytes += frame.wire_len() as u64;
        // The link counts what becomes of it.
        let (Offered::Queued | Offered::Overflowed | Offered::Lost | Offered::Expired) =
            peer.link.offer(Time(monotonic()), &frame);
        true
    }

    /// Carries packets, frames and bytes that wait, in both directions.
    pub fn turn<T: Transport<Link = L>>(&mut self, transport: &mut T) {
        let now = Time(monotonic());
        let cut = self.cut_off();
        // Looked at first: all that had arrived before an end is among the events.
        let is_over = |peer: &Peer| peer.carrier.as_ref().is_some_and(|(_, carrier)| carrier.is_over());
        let over: Vec<HostId> =
            self.peers.iter().filter(|(_, peer)| is_over(peer)).map(|(id, _)| *id).collect();
        for _ in 0..INCOMING {
            let Ok(event) = self.carriers.1.try_recv() else { break };
            self.take(now, event, &cut);
        }
        for (_, peer) in self.peers.iter_mut().filter(|(host, _)| over.contains(host)) {
            peer.carrier = None;
            peer.link.carrier_down(now);
        }
        let mut frames = Vec::new();
        let time = self.clock.read_page().map_or(Time::ZERO, |page| page.at(now.0));
        for (id, peer) in &mut self.peers {
            if peer.link.state() == State::Silent {
                peer.healed = time;
            }
            peer.carry(now, cut.contains(id), |output| match output {
                Output::Frame(frame) => frames.push((*id, frame)),
                Output::Changed(state) => self.changes.push_back((*id, state)),
                _ => {}
            });
        }
        frames.iter().for_each(|(from, frame)| self.deliver(transport, *from, frame, time));
    }

    /// Returns the hosts to which the scenario cuts the link at present.
    fn cut_off(&self) -> Vec<HostId> {
        if self.peers.keys().all(|peer| self.hosts.link(self.host, *peer).partitions.is_empty()) {
            return Vec::new();
        }
        let (Ok(page), now) = (self.clock.read_page(), monotonic()) else { return Vec::new() };
        if page.speed_at(now).is_none() {
            // Scenario time stands still, as at the end of a run.
            return Vec::new();
        }
        let time = page.at(now);
        self.peers.keys().copied().filter(|peer| self.hosts.is_cut(self.host, *peer, time)).collect()
    }

    fn take(&mut self, now: Time, event: CarrierEvent, cut: &[HostId]) {
        let (CarrierEvent::Packet { from, number, .. } | CarrierEvent::Interrupted { from, number }) = event;
        let is_current = |peer: &&mut Peer| peer.carrier.as_ref().is_some_and(|(n, _)| *n == number);
        let Some(peer) = self.peers.get_mut(&from).filter(is_current) else { return };
        match event {
            CarrierEvent::Packet { .. } if cut.contains(&from) => {}
            CarrierEvent::Packet { packet, .. } => {
                if let Err(refused) = peer.link.receive(now, &packet) {
                    tracing::warn!("a packet from {from} is refused: {refused}");
                }
            }
            CarrierEvent::Interrupted { .. } => {
                peer.link.carrier_down(now);
                peer.link.carrier_up(now);
            }
        }
    }

    /// Puts a frame from another host into the inbox of an agent of this one. A host is believed only about its own
    /// modules.
    fn deliver<T: Transport<Link = L>>(
        &mut self,
        transport: &mut T,
        from: HostId,
        frame: &Frame,
        time: Time,
    ) {
        let Some(header) = frame.open().ok().filter(|header| header.channel == Channel::Peer) else {
            self.foreign += 1;
            tracing::warn!("a message from {from} is refused: it is not between agents");
            return;
        };
        if !self.hosts.is_home(header.source, from) {
            // A host forwards frames of its own agents only; one of them may have moved there a moment ago.
            self.tally[header.class].refused += 1;
            tracing::warn!("a message from {from} is refused: its sender is not at home there");
            return;
        }
        self.post(transport, &header, SharedFrame::new(frame, time));
    }

    /// Puts a frame into the inbox of an agent of this host.
    fn post<T: Transport<Link = L>>(&mut self, transport: &mut T, header: &Header, frame: SharedFrame) {
        let counts = &mut self.tally[header.class];
        match self.residents.deliver(transport, header.destination, frame) {
            SendStatus::Sent => {}
            SendStatus::Full => counts.overflowed += 1,
            SendStatus::Gone => counts.expired += 1,
        }
    }

    /// Returns how far the clock of another host is ahead, if that is known.
    pub fn clock_of(&self, host: HostId) -> Option<ClockInterval> {
        self.peers.get(&host)?.link.clock(Time(monotonic()))
    }

    /// Returns how long the owner may wait before the next turn.
    pub fn wait(&self) -> Duration {
        let at = self.peers.values().map(|peer| peer.link.wake_at().0).min().unwrap_or(u64::MAX);
        Duration::from_nanos(at.saturating_sub(monotonic()))
    }

    /// Returns true if no frame to another host is under way.
    pub fn is_drained(&self) -> bool {
        self.peers.values().all(|peer| peer.link.open_frames() == 0 || peer.link.state() != State::Up)
    }

    /// Returns what this host and its links have counted.
    pub fn account(&self) -> AgentCounters {
        let mut counters = AgentCounters {
            tally: self.tally,
            foreign: self.foreign,
            loose: self.loose,
            closed: true,
            ..AgentCounters::default()
        };
        for counts in self.peers.values().map(|peer| peer.link.counts()) {
            for class in Class::ALL {
                let (i, tally) = (class.index(), &mut counters.tally[class]);
                tally.lost += counts.lost[i];
                tally.overflowed += counts.overflowed[i];
                tally.expired += counts.expired[i];
                // Under way to a host that is gone: perhaps taken.
                counters.loose[i] += counts.unaccounted[i] + counts.open[i];
            }
        }
        counters
    }

    /// Returns the protocol messages that went to each other host.
    pub fn crossed(&self) -> BTreeMap<HostId, Tally> {
        let mut crossed = self.crossed.clone();
        for (id, peer) in &self.peers {
            let (Some(tally), counts) = (crossed.get_mut(id), peer.link.counts()) else { continue };
            for class in Class::ALL {
                tally[class].lost += counts.lost[class.index()];
            }
        }
        crossed
    }

    /// Ends the link to a host that is lost: messages to it have expired from now on.
    pub fn give_up(&mut self, host: HostId) {
        if let Some(peer) = self.peers.get_mut(&host) {
            peer.link.close(Time(monotonic()));
            peer.carrier = None;
        }
    }

    /// Says goodbye to all hosts and ends the connections.
    pub fn close(&mut self) {
        let now = Time(monotonic());
        for peer in self.peers.values_mut() {
            peer.link.close(now);
            peer.send(false, |_| ());
            peer.carrier = None;
        }
    }
}

impl Peer {
    fn new(assignment: &Assignment, peer: HostId, life: Life, swarm: u64) -> Peer {
        let Assignment { host, run, secret, build, silent_and_fence: (silent, fence), .. } = assignment;
        let role = match (*host, peer) {
            (HostId::CONTROLLER, _) => Role::Guardian,
            (_, HostId::CONTROLLER) => Role::Ward,
            _ => Role::Equal,
        };
        let terms = Terms { program: PROGRAM, build: *build, swarm, room: u32::MAX };
        let timing = Timing { silent: *silent, fence: *fence, batch: Span(0), ..Timing::default() };
        let config = Config {
            host: *host,
            peer,
            run: Run(*run),
            life,
            terms,
            role,
            timing,
            window: FRAME_WINDOW,
            defect: None,
        };
        let link = HostLink::new(config, Secret(*secret));
        Peer {
            link,
            carrier: None,
            outgoing: Vec::new(),
            incoming: Vec::new(),
            bulk: Default::default(),
            healed: Time::ZERO,
            attached: Time::ZERO,
        }
    }

    /// Gives the link its turn and the carrier its packets.
    fn carry(&mut self, now: Time, is_cut: bool, mut other: impl FnMut(Output)) {
        if now >= self.link.wake_at() {
            self.link.wake(now);
        }
        if !self.outgoing.is_empty() {
            let taken = self.link.write(now, Stream::Stream, &self.outgoing);
            self.outgoing.drain(..taken);
        }
        if !self.bulk.0.is_empty() {
            let taken = self.link.write(now, Stream::Bulk, &self.bulk.0);
            self.bulk.0.drain(..taken);
        }
        self.link.flush(now);
        self.send(is_cut, &mut other);
    }

    fn send(&mut self, is_cut: bool, mut other: impl FnMut(Output)) {
        while let Some(output) = self.link.poll() {
            match output {
                Output::Packet(packet) => {
                    if let Some((_, carrier)) = self.carrier.as_mut().filter(|_| !is_cut) {
                        carrier.send(packet);
                    }
                }
                Output::Bytes(Stream::Stream, bytes) => self.incoming.extend(bytes),
                Output::Bytes(Stream::Bulk, bytes) => self.bulk.1.extend(bytes),
                output => other(output),
            }
        }
    }
}
