//! The simulated link with a minimal agent: hop counts flood a dense block from a corner.
//!
//! Every size runs in a process of its own, to measure its memory. As lower bounds, the same process also
//! runs the flood over the bare queue, and over the heap of the standard library, without agents, links,
//! counters or a trace.

use super::machine::{CpuWatch, peak_memory};
use super::{BenchError, part};
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::Live;
use metamorph_protocol::counters::Class;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::kernel::queue::Queue;
use metamorph_sim_bridge::kernel::sim::{Sim, SimConfig};
use metamorph_sim_bridge::kernel::still_world::StillWorld;
use metamorph_sim_bridge::testing::flood::{Flooded, Onlooker};
use metamorph_sim_bridge::world::World;
use metamorph_text::format::many;
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::hint::black_box;
use std::sync::Arc;

/// Modules along a side.
const SIDES: [u16; 4] = [10, 22, 47, 100];
/// The shortest and the longest delay. They differ by so little that a path with more hops is never the
/// faster one, so that hop counts are exact.
const DELAY: (Span, Span) = (Span::millis(100), Span(100_300_000));
/// Smallest number of messages to deliver; small blocks are flooded repeatedly.
const DELIVERED_MIN: u64 = 1_000_000;

/// The result for one size.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// Modules along a side, and in all.
    pub side: u16,
    pub modules: u64,
    /// Messages delivered in one flood: exactly `2E − (N − 1)`.
    pub messages: u64,
    /// Floods measured.
    pub floods: u64,
    /// Processor time per message in nanoseconds, with trace hash, counters and agent.
    pub ns_per_message: f64,
    /// The same in real time, which other load increases.
    pub wall_ns_per_message: f64,
    /// Messages per second of processor time.
    pub messages_per_s: f64,
    /// Trace events per second of processor time.
    pub events_per_s: f64,
    /// Processor time to set up, in seconds.
    pub setup_s: f64,
    /// Peak memory, minus that of the empty process; and the same per module.
    pub peak_bytes: u64,
    pub bytes_per_module: f64,
    /// Lower bound: processor time per message with the bare queue of the simulator, in nanoseconds.
    pub queue_ns: f64,
    /// The same with the heap of the standard library.
    pub heap_ns: f64,
    /// The trace hash, the same for floods of one size everywhere.
    pub trace_hash: String,
}

/// Measures all sizes up to `most` modules.
pub fn measure(most: u64, live: &mut Live) -> Result<Vec<Row>, BenchError> {
    let sides = SIDES.into_iter().filter(|side| u64::from(*side).pow(3) <= most);
    sides
        .map(|side| {
            live.show(|| format!("flood: {} along a side", many(side as u64, "module")));
            let text = part::output(&["flood", &side.to_string()])?;
            live.clear();
            serde_json::from_str(&text).map_err(|e| BenchError::Part(format!("printed invalid JSON: {e}")))
        })
        .collect()
}

/// A finished flood.
struct Flood {
    setup_s: f64,
    cpu_s: f64,
    wall_s: f64,
    messages: u64,
    /// Events in the trace.
    events: u64,
    trace: u64,
}

/// Runs one flood.
fn flood(side: u16) -> Result<Flood, BenchError> {
    let modules = u64::from(side).pow(3);
    let watch = CpuWatch::start();
    let world = StillWorld::<Flooded>::new([side; 3]);
    let expected = 2 * world.contacts() - (modules - 1);
    let link = LinkModel { delay_min: DELAY.0, delay_max: DELAY.1, ..LinkModel::default() };
    let config =
        SimConfig { setup: Arc::new(()), link, seed: 1, audit_every: Span::secs(1), ignore_sessions: false };
    let mut sim = Sim::new(config, world, Onlooker::default());
    let setup_s = watch.elapsed().as_secs_f64();
    let before = sim.trace().events();
    let (watch, clock) = (CpuWatch::start(), Stopwatch::start());
    sim.run_until(Time(u64::MAX - 1));
    let (cpu_s, wall_s) = (watch.elapsed().as_secs_f64(), clock.elapsed().as_secs_f64());
    let messages = sim.tally()[Class::Gradient].delivered;
    if messages != expected || sim.violations().1 != 0 || !distances_are_exact(&sim) {
        return Err(BenchError::Wrong(format!(
            "the flood of {side}³ modules had {messages} messages instead of {expected}, or wrong distances"
        )));
    }
    let events = sim.trace().events() - before;
    Ok(Flood { setup_s, cpu_s, wall_s, messages, events, trace: sim.trace().value() })
}

/// Measures one size, in this process.
pub fn row(side: u16) -> Result<Row, BenchError> {
    let empty = peak_memory();
    let modules = u64::from(side).pow(3);
    let mut all: Vec<Flood> = Vec::new();
    let delivered = |all: &[Flood]| all.iter().map(|f| f.messages).sum::<u64>();
    while delivered(&all) < DELIVERED_MIN || all.len() < 2 {
        all.push(flood(side)?);
    }
    let peak_bytes = peak_memory().saturating_sub(empty);
    let (first, floods) = (&all[0], all.len() as u64);
    let (messages, trace) = (first.messages, first.trace);
    let sum = |f: fn(&Flood) -> f64| all.iter().map(f).sum::<f64>();
    let (cpu, delivered) = (sum(|f| f.cpu_s), delivered(&all) as f64);
    Ok(Row {
        side,
        modules,
        messages,
        floods,
        ns_per_message: cpu * 1e9 / delivered,
        wall_ns_per_message: sum(|f| f.wall_s) * 1e9 / delivered,
        messages_per_s: delivered / cpu,
        events_per_s: sum(|f| f.events as f64) / cpu,
        setup_s: sum(|f| f.setup_s) / floods as f64,
        peak_bytes,
        bytes_per_module: peak_bytes as f64 / modules as f64,
        queue_ns: floor(side, messages, Queue::new(DELAY.1), Queue::push, Queue::pop),
        heap_ns: floor(side, messages, Heap::default(), Heap::push, Heap::pop),
        trace_hash: format!("{trace:016x}"),
    })
}

fn distances_are_exact<D>(sim: &Sim<StillWorld<Flooded>, D>) -> bool
where
    D: metamorph_sim_bridge::director::port::DirectorPort<StillWorld<Flooded>>,
{
    let corner = Cell::new(0, 0, 0);
    sim.agents().iter().all(|(id, agent)| agent.hops() == Some(sim.world().place(id).manhattan(corner)))
}

/// The heap of the standard library, in the order of the queue.
#[derive(Default)]
struct Heap {
    heap: BinaryHeap<Reverse<(Time, u64, u32)>>,
    number: u64,
}

impl Heap {
    fn push(&mut self, at: Time, what: u32) {
        self.number += 1;
        self.heap.push(Reverse((at, self.number, what)));
    }
    fn pop(&mut self) -> Option<(Time, u32)> {
        self.heap.pop().map(|Reverse((at, _, what))| (at, what))
    }
}

/// Measures the processor time per message of a flood over a bare queue, in nanoseconds.
fn floor<Q>(
    side: u16,
    messages: u64,
    mut queue: Q,
    push: fn(&mut Q, Time, u32),
    pop: fn(&mut Q) -> Option<(Time, u32)>,
) -> f64 {
    let n = u32::from(side);
    let mut known = vec![false; n.pow(3) as usize];
    let mut stream = Rng::named(1, "floor", 0);
    let spread = (DELAY.1 - DELAY.0).0 + 1;
    let watch = CpuWatch::start();
    let mut seen = 0u64;
    push(&mut queue, Time::ZERO, 0);
    while let Some((at, id)) = pop(&mut queue) {
        seen += 1;
        if std::mem::replace(&mut known[id as usize], true) {
            continue;
        }
        for step in [n * n, n, 1] {
            let along = id / step % n;
            let mut send = |to: u32| push(&mut queue, at + DELAY.0 + Span(stream.below(spread)), to);
            if along + 1 < n {
                send(id + step);
            }
            if along > 0 {
                send(id - step);
            }
        }
    }
    black_box(seen);
    // Without agents the sender of a message is unknown: the flood also goes back there.
    debug_assert!(seen > messages);
    watch.elapsed().as_secs_f64() * 1e9 / seen as f64
}
