//! The process link between two processes, message by message, beside bare iceoryx2, a Unix socket, a pipe
//! and TCP over the loopback: the same messages of 64 bytes, the same two processes.
//!
//! Polling: both ends spin, on two processors if possible. Waiting: both ends block until they are woken, on
//! one processor, as agents of a large swarm do. The process link includes an agent's whole path: sealing
//! with a checksum, sending, receiving, checking, decoding.

use super::ends::{End, Files, Ours, OursHalf, Raw, RawHalf, ask, seqpacket_pair, system, tcp_pair};
use super::part::{Peer, command};
use super::{BenchError, median};
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::Live;
use metamorph_module_agent::transport::iceoryx::rendezvous;
use metamorph_processes::swarm::RunDir;
use metamorph_report::statistics::quantile;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use serde::Serialize;
use std::fs::File;
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

/// Round trips timed together, because reading the clock costs time too.
const BATCH: u32 = 16;
/// Number of messages sent before the receiver is woken.
const BURST: u32 = 16;
/// Number of turns. In each of them every mechanism is measured once, with two processes of its own: how their memory and
/// processors lie decides as much as the mechanism.
const TURNS: usize = 5;
/// Duration of each of the three measurements of a turn, in real time.
const MEASUREMENT_TIME: Duration = Duration::from_millis(200);
/// Ratio of a turn's round trip to that of the mechanism's fastest turn from which the turn has a bad placement.
const BAD_PLACEMENT: f64 = 1.3;
/// Number of polls after which a spinning end yields; the other end may need the processor. Large enough that on a busy
/// machine both ends sometimes run at the same time.
const SPINS_MAX: u64 = 50_000;
/// Number of polls after which the other process counts as gone: minutes of spinning.
const SILENT_POLLS_MAX: u64 = 1 << 36;

/// The transport of messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mechanism {
    /// The process link.
    Ours,
    /// Bare iceoryx2.
    Iceoryx,
    /// A Unix socket of type SEQPACKET.
    UnixSocket,
    /// A pair of pipes.
    Pipe,
    /// TCP over the loopback, with TCP_NODELAY.
    Tcp,
}

impl Mechanism {
    const ALL: [Mechanism; 5] =
        [Mechanism::Ours, Mechanism::Iceoryx, Mechanism::UnixSocket, Mechanism::Pipe, Mechanism::Tcp];

    pub const fn name(self) -> &'static str {
        match self {
            Mechanism::Ours => "metamorph",
            Mechanism::Iceoryx => "iceoryx2",
            Mechanism::UnixSocket => "unix-seqpacket",
            Mechanism::Pipe => "pipe",
            Mechanism::Tcp => "tcp-loopback",
        }
    }
    /// Returns the mechanism of this name.
    pub fn named(name: &str) -> Option<Mechanism> {
        Mechanism::ALL.into_iter().find(|m| m.name() == name)
    }
}

/// How an end notices a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// By polling.
    Polling,
    /// By being woken.
    Waiting,
}

impl Mode {
    const fn name(self) -> &'static str {
        match self {
            Mode::Polling => "polling",
            Mode::Waiting => "waiting",
        }
    }
    /// Returns the mode of this name.
    pub fn named(name: &str) -> Option<Mode> {
        [Mode::Polling, Mode::Waiting].into_iter().find(|m| m.name() == name)
    }
}

/// The costs of one mechanism in one mode.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Cost {
    /// Round trip in nanoseconds: the median of the turns with a good placement, each of which is the median of many short
    /// series.
    pub round_trip_ns: f64,
    /// Round trip without disturbance: the fastest of all series, in nanoseconds.
    pub undisturbed_ns: f64,
    /// Quantiles of single round trips of these turns, in nanoseconds, with the time that reading the clock takes.
    pub p50_ns: f64,
    pub p99_ns: f64,
    pub p99_9_ns: f64,
    /// Messages per second, one way: the median of these turns.
    pub messages_per_s: f64,
    /// Number of turns, and of those that were left out because of a bad placement.
    pub turns: usize,
    pub bad_placements: usize,
}

impl Cost {
    /// Summarises the turns of one mechanism.
    fn of(turns: &[Turn]) -> Cost {
        let fastest = turns.iter().map(|t| t.round_trip_ns).fold(f64::INFINITY, f64::min);
        let good = || turns.iter().filter(|t| t.round_trip_ns <= fastest * BAD_PLACEMENT);
        let mut singles: Vec<f64> = good().flat_map(|t| t.singles_ns.iter().copied()).collect();
        singles.sort_by(f64::total_cmp);
        let at = |q| if singles.is_empty() { 0.0 } else { quantile(&singles, q) };
        Cost {
            round_trip_ns: median(&mut good().map(|t| t.round_trip_ns).collect::<Vec<f64>>()),
            undisturbed_ns: turns.iter().map(|t| t.undisturbed_ns).fold(f64::INFINITY, f64::min),
            p50_ns: at(0.5),
            p99_ns: at(0.99),
            p99_9_ns: at(0.999),
            messages_per_s: median(&mut good().map(|t| t.messages_per_s).collect::<Vec<f64>>()),
            turns: turns.len(),
            bad_placements: turns.len() - good().count(),
        }
    }
}

/// One measurement of one mechanism in one mode, between two processes of its own.
struct Turn {
    /// Median and minimum of the mean round trips of short series.
    round_trip_ns: f64,
    undisturbed_ns: f64,
    /// Round trips timed one by one.
    singles_ns: Vec<f64>,
    messages_per_s: f64,
}

/// The result for one mechanism.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Its name.
    pub mechanism: &'static str,
    /// Costs with polling ends.
    pub polling: Cost,
    /// Costs with waiting ends.
    pub waiting: Cost,
}

/// Measures all mechanisms, while `on` permits.
pub fn measure(live: &mut Live, on: &dyn Fn() -> Result<(), BenchError>) -> Result<Vec<Row>, BenchError> {
    rendezvous::set_verbosity(false);
    let before = sched_getaffinity(None).ok();
    let mut turns: Vec<[Vec<Turn>; 2]> = Mechanism::ALL.map(|_| [Vec::new(), Vec::new()]).into();
    for turn in 1..=TURNS {
        for (mechanism, of) in Mechanism::ALL.into_iter().zip(&mut turns) {
            for (mode, of) in [Mode::Polling, Mode::Waiting].into_iter().zip(of) {
                live.show(|| format!("wire: turn {turn} of {TURNS}, {}, {}", mechanism.name(), mode.name()));
                // The other process inherits the affinity of this one.
                roam(before.as_ref());
                on()?;
                of.push(between_processes(mechanism, mode)?);
            }
        }
    }
    live.clear();
    roam(before.as_ref());
    let rows = Mechanism::ALL.into_iter().zip(&turns).map(|(mechanism, [polling, waiting])| Row {
        mechanism: mechanism.name(),
        polling: Cost::of(polling),
        waiting: Cost::of(waiting),
    });
    Ok(rows.collect())
}

/// Measures how long a message is under way between two waiting agents, in nanoseconds.
#[cfg(feature = "hosts")]
pub fn hop() -> Result<f64, BenchError> {
    rendezvous::set_verbosity(false);
    let before = sched_getaffinity(None).ok();
    let cost = between_processes(Mechanism::Ours, Mode::Waiting);
    roam(before.as_ref());
    Ok(cost?.round_trip_ns / 2.0)
}

/// Lets this process run on the processors that it had before.
fn roam(before: Option<&CpuSet>) {
    if let Some(before) = before {
        // The former affinity was valid.
        let _ = sched_setaffinity(None, before);
    }
}

fn send(end: &mut dyn End, mode: Mode, message: u32) -> Result<(), BenchError> {
    let mut tries = 0;
    while !end.put(message)? {
        match mode {
            Mode::Waiting => {
                end.ring();
                std::thread::yield_now();
            }
            Mode::Polling => look_again(tries),
        }
        if tries > SILENT_POLLS_MAX {
            return Err(BenchError::Part("does not receive any more".to_owned()));
        }
        tries += 1;
    }
    Ok(())
}

fn look_again(looks: u64) {
    if looks.is_multiple_of(SPINS_MAX) { std::thread::yield_now() } else { std::hint::spin_loop() }
}

fn receive(end: &mut dyn End, mode: Mode) -> Result<u32, BenchError> {
    for looks in 1..SILENT_POLLS_MAX {
        if let Some(message) = end.take()? {
            return Ok(message);
        }
        match mode {
            Mode::Waiting => end.wait()?,
            Mode::Polling => look_again(looks),
        }
    }
    Err(BenchError::Part("does not answer any more".to_owned()))
}

/// Runs the other process of a measurement: echoes or discards each message, or ends, as the message asks.
pub fn echo(mechanism: Mechanism, mode: Mode, root: &str) -> Result<(), BenchError> {
    stay_on(mode, 1);
    rendezvous::set_verbosity(false);
    let mut end: Box<dyn End> = match mechanism {
        Mechanism::Ours => Box::new(Ours::open(Path::new(root), 1, mode)?),
        Mechanism::Iceoryx => Box::new(Raw::open(Path::new(root), 1)?),
        Mechanism::UnixSocket | Mechanism::Pipe | Mechanism::Tcp => Box::new(standard_streams(mode)?),
    };
    loop {
        match receive(end.as_mut(), mode)? {
            ask::ECHO => {
                send(end.as_mut(), mode, ask::ECHO)?;
                if mode == Mode::Waiting {
                    end.ring();
                }
            }
            ask::STOP => return Ok(()),
            _ => {}
        }
    }
}

/// Returns standard input and output as an end.
pub fn standard_streams(mode: Mode) -> Result<Files, BenchError> {
    let file = |fd: std::io::Result<OwnedFd>| fd.map(File::from).map_err(system("take over a descriptor"));
    let (from, to) = (std::io::stdin(), std::io::stdout());
    let (from, to) = (from.as_fd().try_clone_to_owned(), to.as_fd().try_clone_to_owned());
    Files::new(file(from)?, file(to)?, mode)
}

fn between_processes(mechanism: Mechanism, mode: Mode) -> Result<Turn, BenchError> {
    let dir = RunDir::create()?;
    let root = dir.root().to_str().ok_or_else(|| BenchError::Part("has no root".to_owned()))?.to_owned();
    let mut peer = command(&["echo", mechanism.name(), mode.name(), &root])?;
    let start = |peer: &mut std::process::Command| {
        peer.spawn().map(Peer).map_err(system("start another process of this program"))
    };
    let pair = |a: OwnedFd, b: OwnedFd| Files::new(File::from(a), File::from(b), mode);
    let (_peer, mut end): (Peer, Box<dyn End>) = match mechanism {
        Mechanism::Ours => {
            let mut half = OursHalf::create(dir.root(), 0)?;
            let peer = start(peer.stdout(Stdio::null()))?;
            half.wait_for_hello(mode)?;
            (peer, Box::new(half.join(1, mode)?))
        }
        Mechanism::Iceoryx => {
            let half = RawHalf::create(dir.root(), 0)?;
            let peer = start(peer.stdout(Stdio::null()))?;
            (peer, Box::new(half.join(1)?))
        }
        Mechanism::Pipe => {
            let (theirs, ours_to) = std::io::pipe().map_err(system("make a pipe"))?;
            let (ours_from, theirs_to) = std::io::pipe().map_err(system("make a pipe"))?;
            let peer = start(peer.stdin(theirs).stdout(theirs_to))?;
            (peer, Box::new(pair(ours_from.into(), ours_to.into())?))
        }
        Mechanism::UnixSocket | Mechanism::Tcp => {
            let (ours, theirs) = if mechanism == Mechanism::Tcp { tcp_pair() } else { seqpacket_pair() }
                .map_err(system("make a socket"))?;
            let copy = |fd: &OwnedFd| fd.try_clone().map_err(system("copy a descriptor"));
            let peer = start(peer.stdin(copy(&theirs)?).stdout(theirs))?;
            (peer, Box::new(pair(copy(&ours)?, ours)?))
        }
    };
    stay_on(mode, 0);
    let cost = exchange(end.as_mut(), mode)?;
    send(end.as_mut(), mode, ask::STOP)?;
    end.ring();
    Ok(cost)
}

fn exchange(end: &mut dyn End, mode: Mode) -> Result<Turn, BenchError> {
    let mut round_trip = |n: u32| -> Result<Duration, BenchError> {
        let watch = Stopwatch::start();
        for _ in 0..n {
            send(end, mode, ask::ECHO)?;
            if mode == Mode::Waiting {
                end.ring();
            }
            receive(end, mode)?;
        }
        Ok(watch.elapsed())
    };
    round_trip(BATCH * 8)?;
    let mut series = |n: u32| -> Result<Vec<f64>, BenchError> {
        let (whole, mut times) = (Stopwatch::start(), Vec::new());
        while whole.elapsed() < MEASUREMENT_TIME {
            times.push(round_trip(n)?.as_secs_f64() * 1e9 / f64::from(n));
        }
        Ok(times)
    };
    let (singles_ns, mut batches) = (series(1)?, series(BATCH)?);
    let round_trip_ns = median(&mut batches);
    // Sorted by now.
    let undisturbed_ns = batches.first().copied().unwrap_or(round_trip_ns);
    let watch = Stopwatch::start();
    let mut sent = 1u32;
    while watch.elapsed() < MEASUREMENT_TIME {
        for _ in 0..BURST {
            send(end, mode, ask::SWALLOW)?;
        }
        sent += BURST;
        if mode == Mode::Waiting {
            end.ring();
        }
    }
    send(end, mode, ask::ECHO)?;
    if mode == Mode::Waiting {
        end.ring();
    }
    receive(end, mode)?;
    Ok(Turn {
        round_trip_ns,
        undisturbed_ns,
        singles_ns,
        messages_per_s: f64::from(sent) / watch.elapsed().as_secs_f64(),
    })
}

/// Pins polling ends to two processors, waiting ends to one.
fn stay_on(mode: Mode, end: usize) {
    let Ok(allowed) = sched_getaffinity(None) else { return };
    let all: Vec<usize> = (0..CpuSet::MAX_CPU).filter(|cpu| allowed.is_set(*cpu)).collect();
    let wanted = if mode == Mode::Polling { end } else { 0 };
    if let Some(cpu) = all.get(wanted.min(all.len().saturating_sub(1))) {
        let mut one = CpuSet::new();
        one.set(*cpu);
        // If this fails, the system chooses.
        let _ = sched_setaffinity(None, &one);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_with_a_bad_placement_is_counted_and_left_out() {
        let turn = |ns: f64| Turn {
            round_trip_ns: ns,
            undisturbed_ns: ns - 1.0,
            singles_ns: (0..1_000).map(|i| ns + f64::from(i)).collect(),
            messages_per_s: 1e9 / ns,
        };
        let cost = Cost::of(&[turn(500.0), turn(1_500.0), turn(600.0), turn(700.0)]);
        assert_eq!((cost.turns, cost.bad_placements), (4, 2));
        assert_eq!((cost.round_trip_ns, cost.undisturbed_ns, cost.messages_per_s), (600.0, 499.0, 2e6));
        assert!((1_040.0..=1_060.0).contains(&cost.p50_ns), "{}", cost.p50_ns);
        assert!(cost.p99_ns < cost.p99_9_ns && cost.p99_9_ns <= 1_599.0);
    }
}
