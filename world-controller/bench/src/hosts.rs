//! A host link between two sessions on this machine beside bare zenoh with the same settings: frames a second, processor
//! time for each, one way when idle, and how well the clocks are known.

use super::{BenchError, median};

use metamorph_console::terminal::Live;
#[cfg(feature = "hosts")]
use metamorph_processes::swarm::measure_net;
use metamorph_processes::swarm::{NetCost, NetCosts};
use metamorph_text::paint::Paint;
use serde::Serialize;

/// Number of rounds; their medians are shown.
#[cfg(feature = "hosts")]
const ROUNDS: usize = 5;

/// The results.
#[derive(Clone, Debug, Serialize)]
pub struct HostCosts {
    /// Each round.
    pub rounds: Vec<NetCosts>,
    /// Frames a second over a host link for each put of bare zenoh.
    pub frames_ratio: f64,
    /// Processor time for a frame over a host link, for each put of bare zenoh.
    pub processor_ratio: f64,
    /// One way over a host link, for one of bare zenoh.
    pub one_way_ratio: f64,
    /// One hop between two waiting agents on a host, in nanoseconds; the median of the rounds.
    pub hop_ns: f64,
    /// One way over a host link with a hop before and one after it, for bare zenoh with the same hops: what an agent sees.
    pub between_agents_ratio: f64,
}

/// Measures. Without links between machines there is nothing to measure.
#[cfg(not(feature = "hosts"))]
pub fn measure(
    _: &mut Live,
    _: &dyn Fn() -> Result<(), BenchError>,
) -> Result<Option<HostCosts>, BenchError> {
    Ok(None)
}

/// Measures, while `on` permits.
#[cfg(feature = "hosts")]
pub fn measure(
    live: &mut Live,
    on: &dyn Fn() -> Result<(), BenchError>,
) -> Result<Option<HostCosts>, BenchError> {
    let (mut rounds, mut hops) = (Vec::new(), Vec::new());
    for round in 0..ROUNDS {
        on()?;
        live.show(|| format!("hosts: round {} of {ROUNDS}", round + 1));
        let directory = tempfile::tempdir().map_err(|e| BenchError::System("make a directory", e))?;
        rounds.push(measure_net(directory.path()).map_err(|e| BenchError::Wrong(e.to_string()))?);
        hops.push(super::wire::hop()?);
    }
    live.clear();
    Ok(Some(HostCosts::of(rounds, hops)))
}

#[cfg_attr(not(feature = "hosts"), allow(dead_code, reason = "there is nothing to measure"))]
impl HostCosts {
    fn of(rounds: Vec<NetCosts>, mut hops: Vec<f64>) -> HostCosts {
        let hop_ns = median(&mut hops);
        let ratio = |of: &dyn Fn(&NetCost) -> f64| {
            let mut ratios: Vec<f64> = rounds.iter().map(|r| of(&r.host_link) / of(&r.zenoh)).collect();
            median(&mut ratios)
        };
        HostCosts {
            frames_ratio: ratio(&|cost| cost.frames_per_s),
            processor_ratio: ratio(&|cost| cost.processor_ns),
            one_way_ratio: ratio(&|cost| cost.one_way_ns),
            between_agents_ratio: ratio(&|cost| cost.one_way_ns + 2.0 * hop_ns),
            hop_ns,
            rounds,
        }
    }
}

/// Describes the results.
pub fn text(costs: &HostCosts, paint: Paint) -> String {
    let of = |get: &dyn Fn(&NetCosts) -> f64| {
        let mut values: Vec<f64> = costs.rounds.iter().map(get).collect();
        median(&mut values)
    };
    let row = |name: &str, get: &dyn Fn(&NetCost) -> f64, scale: f64, ratio: f64| {
        let (ours, bare) = (of(&|r| get(&r.host_link)) / scale, of(&|r| get(&r.zenoh)) / scale);
        format!("  {name:<34}{ours:>12.1}{bare:>12.1}{ratio:>9.2}\n")
    };
    let mut out = format!(
        "{}  a host link beside bare zenoh, both with mutual TLS over the loopback; medians of {} rounds\n",
        paint.strong("hosts"),
        costs.rounds.len()
    );
    out += &format!("  {:<34}{:>12}{:>12}{:>9}\n", "", "host link", "zenoh", "ratio");
    out += &row("thousand frames of 96 bytes a second", &|c| c.frames_per_s, 1e3, costs.frames_ratio);
    out += &row("processor time of both ends (µs)", &|c| c.processor_ns, 1e3, costs.processor_ratio);
    out += &row("one way, idle (µs)", &|c| c.one_way_ns, 1e3, costs.one_way_ratio);
    let tail = |name: &str, get: &dyn Fn(&NetCost) -> f64| {
        let ratio = of(&|r| get(&r.host_link) / get(&r.zenoh));
        row(name, get, 1e3, ratio)
    };
    out += &tail("one way, 99 % (µs)", &|c| c.one_way_p99_ns);
    out += &tail("one way, 99.9 % (µs)", &|c| c.one_way_p999_ns);
    let with_hops = |c: &NetCost| c.one_way_ns + 2.0 * costs.hop_ns;
    out += &row("between two agents, idle (µs)", &with_hops, 1e3, costs.between_agents_ratio);
    let clock = of(&|r| r.clock_error_ns as f64) / 1e6;
    out + &format!("  the other clock is known to {clock:.2} ms")
}
