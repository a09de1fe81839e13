//! Cost of a host link over a network, beside bare zenoh with the same settings, between two sessions of this process:
//! a part of `metamorph bench`.

use super::keys::{Keys, KeysError, make};
use super::session::{Line, Net, SessionError};
use super::settings::{endpoint, key, settings};
use crate::swarm::hosts::address::Address;
use crate::swarm::hosts::carrier::Arrived;
use crate::swarm::hosts::costs::{NetCost as Cost, NetCosts};
use crate::swarm::hosts::node::Secret;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_module_agent::clock::monotonic;
use metamorph_protocol::counters::Class;
use metamorph_protocol::host_link::packet::{Life, Run, Terms};
use metamorph_protocol::host_link::{
    Config, FRAME_WINDOW, HostLink, Offered, Output, Role, State, Timing, total,
};
use metamorph_protocol::ids::{HostId, Incarnation, ModuleId, Port};
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::{self, Decoder, Encoder, Frame, HEADER, Header, Wire, WireError};
use rustix::time::{ClockId, clock_gettime};
use std::io;
use std::net::TcpListener;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;
use thiserror::Error;
use zenoh::Wait;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};

/// Duration of each measurement of throughput in real time.
const MEASUREMENT_TIME: Duration = Duration::from_secs(2);
/// Number of round trips of each measurement of latency.
const TRIPS: u32 = 2_000;
/// Time after which a frame counts as lost on its way, as a network may, and is sent again.
const LOST: Duration = Duration::from_millis(500);
/// Longest time to wait for anything.
const WAIT_MAX: Duration = Duration::from_secs(20);
/// Longest time that an end without work waits.
const IDLE_MAX: Duration = Duration::from_millis(1);
/// Length of a frame in bytes.
const FRAME: usize = 96;
/// Number of frames handed in before the link gets a turn.
const TURN: usize = 256;

/// Why a measurement fails.
#[derive(Debug, Error)]
pub enum NetBenchError {
    /// Keys cannot be made.
    #[error(transparent)]
    Keys(#[from] KeysError),
    /// A session cannot be opened.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// zenoh fails.
    #[error("zenoh: {0}")]
    Zenoh(zenoh::Error),
    /// A file or thread fails.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// Something that was sent does not arrive.
    #[error("{0} did not happen in time")]
    Late(&'static str),
}

/// Measures, with keys and sockets of its own.
///
/// # Errors
/// If a session cannot be opened or nothing arrives.
pub fn measure(directory: &Path) -> Result<NetCosts, NetBenchError> {
    let hosts = [(HostId(0), Vec::new()), (HostId(1), vec!["127.0.0.1".to_owned()])];
    let keys = directory.join("keys");
    make(&keys, &hosts, Duration::from_secs(3_600))?;
    let (near, far) = (Keys::read(&keys, HostId(0))?, Keys::read(&keys, HostId(1))?);
    let (host_link, clock_error_ns) = host_link(&near, &far)?;
    let zenoh = bare(&near, &far)?;
    Ok(NetCosts { host_link, zenoh, clock_error_ns })
}

/// Returns an address that was free a moment ago.
fn address() -> io::Result<Address> {
    let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    Ok(Address::Net { machine: "127.0.0.1".to_owned(), port })
}

fn frame(number: u32) -> Frame {
    let header = Header {
        channel: wire::Channel::Peer,
        kind: 0,
        class: Class::Seed,
        port: Port(0),
        incarnation: Incarnation(0),
        source: ModuleId(0),
        destination: ModuleId(1),
        session: 1,
        sequence: number,
    };
    Frame::seal(header, &Filler)
}

/// A payload that makes a frame of 96 bytes, the mean of what protocols send.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Filler;

impl Wire for Filler {
    fn kind(&self) -> u8 {
        0
    }
    fn encode(&self, out: &mut Encoder) {
        (0..(FRAME - HEADER) / 8).for_each(|word| out.u64(word as u64));
    }
    fn decode(_: u8, _: &mut Decoder<'_>) -> Result<Filler, WireError> {
        Ok(Filler)
    }
}

/// Returns the processor time of this process in seconds.
fn processor_time() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 / 1e9
}

/// One end of a host link over a line.
struct End {
    link: HostLink<Secret>,
    line: Line,
}

impl End {
    fn new(net: &Net, peer: HostId) -> Result<End, NetBenchError> {
        let config = Config {
            host: net.host(),
            peer,
            run: Run(1),
            life: Life(u64::from(net.host().0) + 1),
            terms: Terms { program: 1, build: 1, swarm: 1, room: 1 },
            role: Role::Equal,
            timing: Timing::default(),
            window: FRAME_WINDOW,
            defect: None,
        };
        let mut link = HostLink::new(config, Secret([1, 2]));
        let line = net.line(1, peer)?;
        link.carrier_up(Time(monotonic()));
        Ok(End { link, line })
    }

    /// Takes what has arrived and sends what waits. Returns the number of frames that came.
    fn turn(&mut self, patience: Duration) -> io::Result<u64> {
        let mut taken = self.send()?;
        let patience = if taken > 0 { Duration::ZERO } else { patience };
        let mut arrived = self.line.receive(patience);
        while let Some(Arrived::Packet(packet)) = arrived {
            let _ = self.link.receive(Time(monotonic()), &packet);
            taken += self.send()?;
            arrived = self.line.receive(Duration::ZERO);
        }
        let now = Time(monotonic());
        if now >= self.link.wake_at() {
            self.link.wake(now);
        }
        Ok(taken + self.send()?)
    }

    /// Sends what waits. Returns the number of frames that have come meanwhile.
    fn send(&mut self) -> io::Result<u64> {
        self.link.flush(Time(monotonic()));
        let mut taken = 0;
        while let Some(output) = self.link.poll() {
            match output {
                Output::Packet(packet) => self.line.put(packet)?,
                Output::Frame(_) => taken += 1,
                _ => {}
            }
        }
        Ok(taken)
    }
}

fn host_link(near: &Keys, far: &Keys) -> Result<(Cost, u64), NetBenchError> {
    let address = address()?;
    let far = Net::new(far.clone(), Some(&address))?;
    let near = Net::new(near.clone(), None)?;
    near.dial(&[address])?;
    let mut there = End::new(&far, HostId(0))?;
    let mut here = End::new(&near, HostId(1))?;
    let (is_over, echoes) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(true)));
    let (over, echo) = (Arc::clone(&is_over), Arc::clone(&echoes));
    let answering = std::thread::spawn(move || -> io::Result<()> {
        while !over.load(Ordering::Relaxed) {
            let taken = there.turn(IDLE_MAX)?;
            for number in (0..taken as u32).filter(|_| echo.load(Ordering::Relaxed)) {
                let _ = there.link.offer(Time(monotonic()), &frame(number));
            }
            if taken > 0 {
                there.turn(Duration::ZERO)?;
            }
        }
        Ok(())
    });
    let measured = drive(&mut here, &echoes);
    is_over.store(true, Ordering::Relaxed);
    let ended = answering.join().map_err(|_| io::Error::other("a thread has failed"))?;
    let measured = measured?;
    ended?;
    Ok(measured)
}

fn drive(here: &mut End, echoes: &AtomicBool) -> Result<(Cost, u64), NetBenchError> {
    let begun = Stopwatch::start();
    while here.link.state() != State::Up {
        here.turn(IDLE_MAX)?;
        if begun.elapsed() > WAIT_MAX {
            return Err(NetBenchError::Late("the greeting of a host link"));
        }
    }
    let mut trips = Vec::new();
    let begun = Stopwatch::start();
    while trips.len() < TRIPS as usize {
        let sent = Stopwatch::start();
        let _ = here.link.offer(Time(monotonic()), &frame(trips.len() as u32));
        let mut has_come = false;
        while !has_come && sent.elapsed() < LOST {
            has_come = here.turn(IDLE_MAX)? > 0;
        }
        if has_come {
            trips.push(sent.elapsed());
        } else if begun.elapsed() > WAIT_MAX {
            return Err(NetBenchError::Late("the answer to a frame"));
        }
    }
    echoes.store(false, Ordering::Relaxed);
    let (before, taken, begun) = (processor_time(), total(&here.link.counts().taken), Stopwatch::start());
    let mut number = 0;
    while begun.elapsed() < MEASUREMENT_TIME {
        let room = FRAME_WINDOW - here.link.open_frames();
        for _ in 0..room.min(TURN) {
            number += 1;
            if here.link.offer(Time(monotonic()), &frame(number)) != Offered::Queued {
                break;
            }
        }
        here.turn(if room == 0 { IDLE_MAX } else { Duration::ZERO })?;
    }
    let (real, processor) = (begun.elapsed().as_secs_f64(), processor_time() - before);
    let frames = (total(&here.link.counts().taken) - taken) as f64;
    let cost = cost(frames, real, processor, &mut trips);
    let clock = here.link.clock(Time(monotonic()));
    Ok((cost, clock.map_or(u64::MAX, |clock| clock.error())))
}

fn cost(frames: f64, real: f64, processor: f64, trips: &mut [Duration]) -> Cost {
    trips.sort_unstable();
    let one_way = |thousandths: usize| {
        let trip = trips.get((trips.len() * thousandths / 1_000).min(trips.len().saturating_sub(1)));
        trip.copied().unwrap_or_default().as_nanos() as f64 / 2.0
    };
    Cost {
        frames_per_s: frames / real,
        processor_ns: processor * 1e9 / frames.max(1.0),
        one_way_ns: one_way(500),
        one_way_p99_ns: one_way(990),
        one_way_p999_ns: one_way(999),
    }
}

/// A session with the same settings, and nothing else on it.
fn session(keys: &Keys, listen: &[String], connect: &[String]) -> Result<zenoh::Session, NetBenchError> {
    let text = settings(keys, listen, connect).to_string();
    let config = zenoh::Config::from_json5(&text).map_err(NetBenchError::Zenoh)?;
    zenoh::open(config).wait().map_err(NetBenchError::Zenoh)
}

fn publisher(
    session: &zenoh::Session,
    (from, to): (&str, &str),
    service: &str,
    congestion: CongestionControl,
    express: bool,
) -> Result<Publisher<'static>, NetBenchError> {
    let publisher = session.declare_publisher(key("1", from, to, service));
    let publisher = publisher.congestion_control(congestion).priority(Priority::Data).express(express);
    publisher.wait().map_err(NetBenchError::Zenoh)
}

fn bare(near: &Keys, far: &Keys) -> Result<Cost, NetBenchError> {
    let endpoint: Vec<String> = endpoint(&address()?).into_iter().collect();
    let far = session(far, &endpoint, &[])?;
    let near = session(near, &[], &endpoint)?;
    let counted = Arc::new(AtomicU64::new(0));
    let count = Arc::clone(&counted);
    let back = publisher(&far, ("h2", "h1"), "a", CongestionControl::Drop, true)?;
    let answer = far.declare_subscriber(key("*", "h1", "h2", "a")).callback(move |sample| {
        let _ = back.put(sample.payload().to_bytes().into_owned()).wait();
    });
    answer.background().wait().map_err(NetBenchError::Zenoh)?;
    let taken = far.declare_subscriber(key("*", "h1", "h2", "p"));
    let taken = taken.callback(move |_| {
        count.fetch_add(1, Ordering::Relaxed);
    });
    taken.background().wait().map_err(NetBenchError::Zenoh)?;
    let (sender, answers) = sync_channel(1);
    let heard = near.declare_subscriber(key("*", "h2", "h1", "a"));
    let heard = heard.callback(move |_| {
        let _ = sender.try_send(());
    });
    heard.background().wait().map_err(NetBenchError::Zenoh)?;
    let ping = publisher(&near, ("h1", "h2"), "a", CongestionControl::Drop, true)?;
    let bytes = frame(0).as_bytes()[..FRAME].to_vec();
    let mut trips = trips(&ping, &bytes, &answers)?;
    let puts = publisher(&near, ("h1", "h2"), "p", CongestionControl::Block, false)?;
    let (before, begun, mut sent) = (processor_time(), Stopwatch::start(), 0);
    while begun.elapsed() < MEASUREMENT_TIME {
        puts.put(bytes.clone()).wait().map_err(NetBenchError::Zenoh)?;
        sent += 1;
    }
    while counted.load(Ordering::Relaxed) < sent {
        if begun.elapsed() > MEASUREMENT_TIME + WAIT_MAX {
            return Err(NetBenchError::Late("the arrival of what was put"));
        }
        std::thread::park_timeout(IDLE_MAX);
    }
    let (real, processor) = (begun.elapsed().as_secs_f64(), processor_time() - before);
    Ok(cost(sent as f64, real, processor, &mut trips))
}

fn trips(ping: &Publisher<'_>, bytes: &[u8], answers: &Receiver<()>) -> Result<Vec<Duration>, NetBenchError> {
    let once = |patience| -> Result<Option<Duration>, NetBenchError> {
        let begun = Stopwatch::start();
        ping.put(bytes.to_vec()).wait().map_err(NetBenchError::Zenoh)?;
        Ok(answers.recv_timeout(patience).ok().map(|()| begun.elapsed()))
    };
    let begun = Stopwatch::start();
    // Until the sessions are connected, nothing comes back.
    while once(Duration::from_millis(50))?.is_none() {
        if begun.elapsed() > WAIT_MAX {
            return Err(NetBenchError::Late("the connection of two sessions"));
        }
    }
    let (begun, mut trips) = (Stopwatch::start(), Vec::new());
    while trips.len() < TRIPS as usize {
        match once(LOST)? {
            Some(trip) => trips.push(trip),
            None if begun.elapsed() > WAIT_MAX => return Err(NetBenchError::Late("the answer to a put")),
            None => {}
        }
    }
    Ok(trips)
}
