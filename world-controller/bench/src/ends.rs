//! Both ends of the mechanisms that `bench wire` compares: a pair of files (sockets, pipes), bare iceoryx2, and the
//! process link.

use super::BenchError;
use super::wire::Mode;
use iceoryx2::prelude::{Node, NodeBuilder, ServiceName, SignalHandlingMode, ipc};
use metamorph_console::stopwatch::Stopwatch;
use metamorph_module_agent::run_dir::run_name::RunName;
use metamorph_module_agent::transport::iceoryx::inbox::Inbox;
use metamorph_module_agent::transport::iceoryx::outbox::Outbox;
use metamorph_module_agent::transport::iceoryx::rendezvous::{self, Rendezvous};
use metamorph_module_agent::transport::shared_frame::SharedFrame;
use metamorph_module_agent::transport::{INBOX_DEPTH, Link, SendStatus};
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::{Incarnation, ModuleId, Port};
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::{Channel, Decoder, Encoder, Frame, Header, Wire, WireError};
use rustix::net::{AddressFamily, SocketFlags, SocketType, socketpair};
use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::os::fd::OwnedFd;
use std::path::Path;
use std::time::Duration;

/// Bytes of a message.
const SIZE: usize = 64;
/// Time to wait for the other process to start, at most.
const START: Duration = Duration::from_secs(20);

/// Requests that a message carries to the other end.
pub mod ask {
    /// Code of a request to send a message back.
    pub const ECHO: u32 = 1;
    /// Code of a request to discard the message.
    pub const SWALLOW: u32 = 2;
    /// Code of a request to end the process.
    pub const STOP: u32 = 3;
}

/// One end of a connection between two processes.
pub trait End {
    /// Sends one message; returns false if there is no room now.
    fn put(&mut self, ask: u32) -> Result<bool, BenchError>;
    /// Wakes the other end.
    fn ring(&mut self);
    /// Receives one message, if there is one.
    fn take(&mut self) -> Result<Option<u32>, BenchError>;
    /// Blocks until there may be a message.
    fn wait(&mut self) -> Result<(), BenchError>;
}

pub fn system<E: Into<std::io::Error>>(what: &'static str) -> impl Fn(E) -> BenchError {
    move |e| BenchError::System(what, e.into())
}

pub fn seqpacket_pair() -> std::io::Result<(OwnedFd, OwnedFd)> {
    Ok(socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None)?)
}

pub fn tcp_pair() -> std::io::Result<(OwnedFd, OwnedFd)> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
    let ours = TcpStream::connect(listener.local_addr()?)?;
    let (theirs, _) = listener.accept()?;
    ours.set_nodelay(true)?;
    theirs.set_nodelay(true)?;
    Ok((ours.into(), theirs.into()))
}

/// Two files, or one for both directions.
pub struct Files {
    from: File,
    to: File,
    taken: [u8; SIZE],
    have: usize,
}

impl Files {
    pub fn new(from: File, to: File, mode: Mode) -> Result<Files, BenchError> {
        for file in [&from, &to] {
            let flags = rustix::fs::fcntl_getfl(file).map_err(system("ask for the flags of a descriptor"))?;
            let mut wanted = flags;
            wanted.set(rustix::fs::OFlags::NONBLOCK, mode == Mode::Polling);
            rustix::fs::fcntl_setfl(file, wanted).map_err(system("set the flags of a descriptor"))?;
        }
        Ok(Files { from, to, taken: [0; SIZE], have: 0 })
    }
}

impl End for Files {
    fn put(&mut self, ask: u32) -> Result<bool, BenchError> {
        let mut message = [0; SIZE];
        message[..4].copy_from_slice(&ask.to_le_bytes());
        let mut sent = 0;
        while sent < SIZE {
            match self.to.write(&message[sent..]) {
                Ok(n) => sent += n,
                Err(e) if e.kind() == ErrorKind::WouldBlock && sent == 0 => return Ok(false),
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
                Err(e) => return Err(BenchError::System("write to the other process", e)),
            }
        }
        Ok(true)
    }
    fn ring(&mut self) {}
    fn take(&mut self) -> Result<Option<u32>, BenchError> {
        match self.from.read(&mut self.taken[self.have..]) {
            Ok(0) => Err(BenchError::Part("has gone".to_owned())),
            Ok(n) => {
                self.have += n;
                if self.have < SIZE {
                    return Ok(None);
                }
                self.have = 0;
                let [a, b, c, d, ..] = self.taken;
                Ok(Some(u32::from_le_bytes([a, b, c, d])))
            }
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(None),
            Err(e) => Err(BenchError::System("read from the other process", e)),
        }
    }
    fn wait(&mut self) -> Result<(), BenchError> {
        // Reading blocks anyway.
        Ok(())
    }
}

/// A message whose frame has 64 bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Note {
    ask: u32,
    rest: [u32; (SIZE - metamorph_protocol::wire::HEADER) / 4 - 1],
}

impl Wire for Note {
    fn kind(&self) -> u8 {
        0
    }
    fn encode(&self, out: &mut Encoder) {
        out.u32(self.ask);
        self.rest.into_iter().for_each(|n| out.u32(n));
    }
    fn decode(_: u8, from: &mut Decoder<'_>) -> Result<Note, WireError> {
        let mut note = Note { ask: from.u32()?, rest: [0; _] };
        for n in &mut note.rest {
            *n = from.u32()?;
        }
        Ok(note)
    }
}

/// The receiving half of the process link.
pub struct OursHalf {
    inbox: Inbox,
    at: Rendezvous,
    me: u32,
}

impl OursHalf {
    pub fn create(root: &Path, me: u32) -> Result<OursHalf, BenchError> {
        let at = Rendezvous::join(root)?;
        Ok(OursHalf { inbox: Inbox::create(&at, ModuleId(me), Incarnation(0), 1)?, at, me })
    }
    /// Waits for the first message of the other end, which it sends once it is connected.
    pub fn wait_for_hello(&mut self, mode: Mode) -> Result<(), BenchError> {
        let since = Stopwatch::start();
        while self.inbox.receive()?.is_none() {
            if mode == Mode::Waiting {
                self.inbox.wait(Duration::from_millis(10))?;
            }
            if since.elapsed() > START {
                return Err(BenchError::Part("does not start".to_owned()));
            }
        }
        Ok(())
    }
    /// Joins a waiting peer that may not have started yet.
    pub fn join_patiently(self, peer: u32) -> Result<Ours, BenchError> {
        let since = Stopwatch::start();
        loop {
            match Outbox::to_agent(&self.at, ModuleId(peer), Incarnation(0)) {
                Ok(outbox) => return Ok(self.with(outbox, peer, Mode::Waiting)),
                Err(e) if e.is_absent() && since.elapsed() < START => {
                    self.inbox.wait(Duration::from_millis(10))?;
                }
                Err(e) => return Err(e.into()),
            }
        }
    }
    pub fn join(self, peer: u32, mode: Mode) -> Result<Ours, BenchError> {
        let outbox = Outbox::to_agent(&self.at, ModuleId(peer), Incarnation(0))?;
        Ok(self.with(outbox, peer, mode))
    }
    fn with(self, outbox: Outbox, peer: u32, mode: Mode) -> Ours {
        Ours { inbox: self.inbox, outbox, me: self.me, peer, sequence: 0, mode, _at: self.at }
    }
}

/// The process link, as an agent uses it.
pub struct Ours {
    inbox: Inbox,
    outbox: Outbox,
    me: u32,
    peer: u32,
    sequence: u32,
    mode: Mode,
    // Last, so that all ports are dropped before the process leaves the run.
    _at: Rendezvous,
}

impl Ours {
    pub fn open(root: &Path, me: u32, mode: Mode) -> Result<Ours, BenchError> {
        let mut end = OursHalf::create(root, me)?.join(0, mode)?;
        end.put(ask::SWALLOW)?;
        end.ring();
        Ok(end)
    }
}

impl End for Ours {
    fn put(&mut self, ask: u32) -> Result<bool, BenchError> {
        let note = Note { ask, rest: [0; _] };
        let header = Header {
            channel: Channel::Peer,
            kind: 0,
            class: Class::Gradient,
            port: Port(0),
            incarnation: Incarnation(0),
            source: ModuleId(self.me),
            destination: ModuleId(self.peer),
            session: 1,
            sequence: self.sequence,
        };
        self.sequence = self.sequence.wrapping_add(1);
        let frame = SharedFrame::new(&Frame::seal(header, &note), Time::ZERO);
        Ok(self.outbox.send(frame) == SendStatus::Sent)
    }
    fn ring(&mut self) {
        self.outbox.flush();
    }
    fn take(&mut self) -> Result<Option<u32>, BenchError> {
        let Some(shared) = self.inbox.receive()? else { return Ok(None) };
        let frame = shared.frame();
        let fits = frame.open().is_ok_and(|h| h.destination == ModuleId(self.me) && h.session == 1);
        match frame.message::<Note>() {
            Ok(note) if fits => Ok(Some(note.ask)),
            _ => Err(BenchError::Part("sent a damaged frame".to_owned())),
        }
    }
    fn wait(&mut self) -> Result<(), BenchError> {
        debug_assert_eq!(self.mode, Mode::Waiting);
        Ok(self.inbox.wait(Duration::from_secs(1))?)
    }
}

type Svc = ipc::Service;
type Bytes = [u8; SIZE];
type Frames = iceoryx2::service::port_factory::publish_subscribe::PortFactory<Svc, Bytes, ()>;
type Bell = iceoryx2::service::port_factory::event::PortFactory<Svc>;

/// Bare iceoryx2, in the configuration of the process link.
pub struct RawHalf {
    subscriber: iceoryx2::port::subscriber::Subscriber<Svc, Bytes, ()>,
    listener: iceoryx2::port::listener::Listener<Svc>,
    node: Node<Svc>,
}

pub struct Raw {
    subscriber: iceoryx2::port::subscriber::Subscriber<Svc, Bytes, ()>,
    listener: iceoryx2::port::listener::Listener<Svc>,
    publisher: iceoryx2::port::publisher::Publisher<Svc, Bytes, ()>,
    notifier: iceoryx2::port::notifier::Notifier<Svc>,
    _node: Node<Svc>,
}

fn iceoryx<E: std::fmt::Debug>(what: &'static str) -> impl Fn(E) -> BenchError {
    move |e| BenchError::System(what, std::io::Error::other(format!("{e:?}")))
}

impl RawHalf {
    /// Opens the channel and the bell of one end, in the configuration of the process link.
    fn channels(node: &Node<Svc>, end: u32) -> Result<(Frames, Bell), BenchError> {
        let name = |text: String| ServiceName::new(&text).map_err(iceoryx("name a channel"));
        let frames = node
            .service_builder(&name(format!("raw/{end}"))?)
            .publish_subscribe::<Bytes>()
            .max_subscribers(1)
            .subscriber_max_buffer_size(INBOX_DEPTH)
            .history_size(0)
            .enable_safe_overflow(false)
            .open_or_create()
            .map_err(iceoryx("make a channel"))?;
        let bell = node.service_builder(&name(format!("rawbell/{end}"))?).event().open_or_create();
        Ok((frames, bell.map_err(iceoryx("make a bell"))?))
    }
    pub fn create(root: &Path, me: u32) -> Result<RawHalf, BenchError> {
        let run = RunName::of_root(root).map_err(iceoryx("name the run"))?;
        let node = NodeBuilder::new()
            .config(&rendezvous::config(&run))
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Svc>()
            .map_err(iceoryx("join the run"))?;
        let (frames, bell) = RawHalf::channels(&node, me)?;
        Ok(RawHalf {
            subscriber: frames.subscriber_builder().create().map_err(iceoryx("attach to a channel"))?,
            listener: bell.listener_builder().create().map_err(iceoryx("attach to a bell"))?,
            node,
        })
    }
    pub fn join(self, peer: u32) -> Result<Raw, BenchError> {
        use iceoryx2::port::backpressure_strategy::BackpressureStrategy;
        let (frames, bell) = RawHalf::channels(&self.node, peer)?;
        let publisher = frames
            .publisher_builder()
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(iceoryx("attach to a channel"))?;
        let notifier = bell.notifier_builder().create().map_err(iceoryx("attach to a bell"))?;
        let RawHalf { subscriber, listener, node } = self;
        Ok(Raw { subscriber, listener, publisher, notifier, _node: node })
    }
}

impl Raw {
    pub fn open(root: &Path, me: u32) -> Result<Raw, BenchError> {
        RawHalf::create(root, me)?.join(0)
    }
}

impl End for Raw {
    fn put(&mut self, ask: u32) -> Result<bool, BenchError> {
        let mut message = [0; SIZE];
        message[..4].copy_from_slice(&ask.to_le_bytes());
        Ok(self.publisher.send_copy(message).is_ok_and(|receivers| receivers > 0))
    }
    fn ring(&mut self) {
        // An end that is not woken polls again after a second.
        let _ = self.notifier.notify();
    }
    fn take(&mut self) -> Result<Option<u32>, BenchError> {
        let sample = self.subscriber.receive().map_err(iceoryx("receive"))?;
        Ok(sample.map(|s| u32::from_le_bytes([s[0], s[1], s[2], s[3]])))
    }
    fn wait(&mut self) -> Result<(), BenchError> {
        self.listener.timed_wait(|_| {}, Duration::from_secs(1)).map(drop).map_err(iceoryx("wait"))
    }
}
