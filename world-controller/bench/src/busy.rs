//! A busy swarm: tokens circulate in a ring of processes that share the processors; each process receives,
//! forwards, and waits to be woken. The process link beside a Unix socket.
//!
//! With one token, the only work is to wake the next process: the cost of waking is measured. With many, a
//! process that runs finds several, and wakes the next one once for all of them; a socket takes two system
//! calls for each.

use super::ends::{End, Files, OursHalf, ask, seqpacket_pair, system};
use super::part::{Peer, command};
use super::wire::{Mechanism, Mode, standard_streams};
use super::{BenchError, median};
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::Live;
use metamorph_processes::swarm::RunDir;
use metamorph_text::format::many;
use serde::Serialize;
use std::os::fd::OwnedFd;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

/// Number of processes in the ring.
const MEMBERS: u32 = 50;
/// Tokens in the ring.
const TOKENS: [u32; 3] = [1, 50, 500];
/// Duration of a measurement in real time.
const MEASUREMENT_TIME: Duration = Duration::from_secs(1);
/// Number of repetitions of a measurement.
const REPETITIONS: usize = 3;

/// The result for one number of tokens.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Number of processes and of tokens.
    pub members: u32,
    pub tokens: u32,
    /// Tokens forwarded per second by all members together.
    pub ours_per_s: f64,
    pub unix_socket_per_s: f64,
}

/// Measures all numbers of tokens, while `on` permits.
pub fn measure(live: &mut Live, on: &dyn Fn() -> Result<(), BenchError>) -> Result<Vec<Row>, BenchError> {
    let mut rows = Vec::new();
    for tokens in TOKENS {
        live.show(|| format!("busy: {MEMBERS} processes, {}", many(u64::from(tokens), "token")));
        let (mut ours, mut socket) = (Vec::new(), Vec::new());
        // Alternating, so that other load affects both.
        for _ in 0..REPETITIONS {
            on()?;
            ours.push(ring(Mechanism::Ours, tokens)?);
            socket.push(ring(Mechanism::UnixSocket, tokens)?);
        }
        let (ours_per_s, unix_socket_per_s) = (median(&mut ours), median(&mut socket));
        rows.push(Row { members: MEMBERS, tokens, ours_per_s, unix_socket_per_s });
    }
    live.clear();
    Ok(rows)
}

/// Measures the tokens forwarded per second.
fn ring(mechanism: Mechanism, tokens: u32) -> Result<f64, BenchError> {
    let dir = RunDir::create()?;
    let root = dir.root().to_str().ok_or_else(|| BenchError::Part("has no root".to_owned()))?.to_owned();
    let mut members: Vec<Peer> = Vec::new();
    let mut start = |id: u32, from: Stdio, to: Stdio| -> Result<(), BenchError> {
        let (id, next) = (id.to_string(), ((id + 1) % MEMBERS).to_string());
        let mut member = command(&["ring", mechanism.name(), &root, &id, &next])?;
        // Members that report the end of the ring are ignored.
        let child = member.stdin(from).stdout(to).stderr(Stdio::null()).spawn();
        members.push(Peer(child.map_err(system("start another process of this program"))?));
        Ok(())
    };
    let mut end: Box<dyn End> = if mechanism == Mechanism::Ours {
        let half = OursHalf::create(dir.root(), 0)?;
        (1..MEMBERS).try_for_each(|id| start(id, Stdio::null(), Stdio::null()))?;
        Box::new(half.join_patiently(1)?)
    } else {
        let first = seqpacket_pair().map_err(system("make a socket"))?;
        let mut from: OwnedFd = first.1;
        for id in 1..MEMBERS {
            let next = seqpacket_pair().map_err(system("make a socket"))?;
            start(id, from.into(), next.0.into())?;
            from = next.1;
        }
        Box::new(Files::new(from.into(), first.0.into(), Mode::Waiting)?)
    };
    // Once around, so that all members are up.
    pass(end.as_mut(), 1)?;
    let mut around = 0;
    while around == 0 {
        around = take_all(end.as_mut(), mechanism)?;
    }
    pass(end.as_mut(), tokens)?;
    let (watch, mut passed) = (Stopwatch::start(), 0u64);
    while watch.elapsed() < MEASUREMENT_TIME {
        let taken = take_all(end.as_mut(), mechanism)?;
        pass(end.as_mut(), taken)?;
        passed += u64::from(taken);
    }
    Ok(passed as f64 * f64::from(MEMBERS) / watch.elapsed().as_secs_f64())
}

/// Runs a member of the ring, until it is killed.
pub fn member(mechanism: Mechanism, root: &str, id: u32, next: u32) -> Result<(), BenchError> {
    let mut end: Box<dyn End> = match mechanism {
        Mechanism::Ours => Box::new(OursHalf::create(Path::new(root), id)?.join_patiently(next)?),
        _ => Box::new(standard_streams(Mode::Waiting)?),
    };
    loop {
        let taken = take_all(end.as_mut(), mechanism)?;
        pass(end.as_mut(), taken)?;
    }
}

/// Receives all messages that are there and returns their number; if there are none, waits and returns 0. On
/// a Unix socket, blocks for a single message instead.
fn take_all(end: &mut dyn End, mechanism: Mechanism) -> Result<u32, BenchError> {
    if mechanism == Mechanism::UnixSocket {
        return Ok(u32::from(end.take()?.is_some()));
    }
    let mut taken = 0;
    while end.take()?.is_some() {
        taken += 1;
    }
    if taken == 0 {
        end.wait()?;
    }
    Ok(taken)
}

fn pass(end: &mut dyn End, tokens: u32) -> Result<(), BenchError> {
    for _ in 0..tokens {
        while !end.put(ask::SWALLOW)? {
            // The next member has to run before there is room.
            end.ring();
            std::thread::yield_now();
        }
    }
    end.ring();
    Ok(())
}
