//! `metamorph bench`: what the two links cost, with bare mechanisms measured beside them in the same
//! run, so that the ratios hold on any machine.
//!
//! `flood`, `growth` and `chairs` measure the simulated link, `wire`, `swarm` and `churn` the process link; `part` is the
//! other end of a measurement, in a process of its own; `text` shows the results. Deliberately absent:
//! any judgement. Nothing here fails because a machine is slow.

mod busy;
mod chairs;
mod churn;
mod flood;
mod growth;
mod machine;
mod matching;
mod part;
mod swarm;
mod text;
mod wire;

pub use part::{PartError, SUBCOMMAND, part};

use crate::console::escape::{self, Shown};
use crate::console::interrupt::Interrupt;
use crate::console::output::{OutputError, Outputs};
use crate::console::terminal::{Channel, Live};
use crate::run::processes::ProcessError;
use crate::swarm::{RunDirError, SwarmError};
use clap::ValueEnum;
use machine::Machine;
use metamorph_module_agent::transport::TransportError;
use metamorph_module_agent::transport::iceoryx::rendezvous::ChannelError;
use serde::Serialize;
use std::path::PathBuf;
use thiserror::Error;

/// Increased whenever a field of `bench.json` changes its meaning or goes.
const SCHEMA: u32 = 1;

/// What can be measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
pub enum Name {
    /// Hop counts flood a block of up to a million simulated modules, on one thread and on all processors
    Flood,
    /// A slab becomes a ball, with 100 to 10,000 simulated modules
    Growth,
    /// Runs of the thesis's chair in a second, on all processors
    Chairs,
    /// Round trips and throughput between two processes, beside other mechanisms
    Wire,
    /// Swarms of processes: starting, exchanging, memory, idling
    Swarm,
    /// Modules of a swarm of processes die and are started again
    Churn,
}

/// What was asked for.
#[derive(Clone, Debug)]
pub struct Request {
    /// What to measure; everything if nothing is named.
    pub names: Vec<Name>,
    /// The largest number of modules or processes in a row of a table; all rows if left out.
    pub most: Option<u64>,
    /// Where the numbers go.
    pub json: PathBuf,
    /// Whether to say nothing but errors.
    pub quiet: bool,
}

/// Why something could not be measured.
#[derive(Debug, Error)]
pub enum BenchError {
    /// The numbers cannot be written.
    #[error(transparent)]
    Json(#[from] OutputError),
    /// Something of the system does not work.
    #[error("bench: cannot {0}: {1}")]
    System(&'static str, std::io::Error),
    /// The other process did not do its part.
    #[error("bench: the other process {0}")]
    Part(String),
    /// A signal came.
    #[error("bench: interrupted; nothing is written to {}", .0.display())]
    Interrupted(PathBuf),
    /// Signals cannot be caught.
    #[error("cannot listen for Ctrl-C: {0}")]
    Signals(std::io::Error),
    /// A run did not come to what it should have come to, so that its times mean nothing.
    #[error("bench: {0}")]
    Wrong(String),
    /// A swarm.
    #[error(transparent)]
    Swarm(#[from] SwarmError),
    /// Where processes meet.
    #[error(transparent)]
    RunDir(#[from] RunDirError),
    /// A channel.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// A receiving end.
    #[error(transparent)]
    Inbox(#[from] TransportError),
    /// This program.
    #[error(transparent)]
    Process(#[from] ProcessError),
}

/// `bench.json`.
#[derive(Debug, Serialize)]
pub struct Results {
    /// Tells the file from others.
    format: &'static str,
    /// The version of its layout.
    schema: u32,
    /// The version of this program.
    version: &'static str,
    /// Where it was measured.
    machine: Machine,
    /// A row for each size.
    flood: Vec<flood::Row>,
    /// The rows, and how they grow.
    growth: Option<growth::Growth>,
    /// A row for each strategy.
    chairs: Vec<chairs::Row>,
    /// A row for each mechanism.
    wire: Vec<wire::Row>,
    /// A row for each number of tokens in a ring of processes.
    busy: Vec<busy::Row>,
    /// A row for each size, and what ended the series.
    swarm: Option<swarm::Swarms>,
    /// A swarm in which modules die.
    churn: Option<churn::Churn>,
}

/// Does what was asked for, and gives the exit code.
pub fn bench(request: &Request) -> Result<u8, BenchError> {
    let json = Outputs::new().writes("--json", &request.json)?;
    let wanted = |name| request.names.is_empty() || request.names.contains(&name);
    let most = request.most.unwrap_or(u64::MAX);
    let channel = Channel::beside(false, request.quiet);
    let paint = channel.paint();
    let mut results = Results {
        format: "metamorph-bench",
        schema: SCHEMA,
        version: env!("CARGO_PKG_VERSION"),
        machine: Machine::this(),
        flood: Vec::new(),
        growth: None,
        chairs: Vec::new(),
        wire: Vec::new(),
        busy: Vec::new(),
        swarm: None,
        churn: None,
    };
    channel.say(&text::machine(&results.machine));
    let mut live = Live::new(!request.quiet);
    let interrupt = Interrupt::listen().map_err(BenchError::Signals)?;
    if wanted(Name::Flood) {
        results.flood = flood::measure(most, &mut live)?;
        channel.say(&text::flood(&results.flood, paint));
    }
    if wanted(Name::Growth) {
        let growth = growth::measure(most, &mut live)?;
        channel.say(&text::growth(&growth, paint));
        results.growth = Some(growth);
    }
    if wanted(Name::Chairs) {
        results.chairs = chairs::measure(chairs::RUNS, &mut live)?;
        channel.say(&text::chairs(&results.chairs, paint));
    }
    // From here on there are processes and shared memory.
    interrupt.begin();
    let on = || if interrupt.is_set() { Err(BenchError::Interrupted(request.json.clone())) } else { Ok(()) };
    if wanted(Name::Wire) {
        results.wire = wire::measure(&mut live, &on)?;
        channel.say(&text::wire(&results.wire, paint));
        results.busy = busy::measure(&mut live, &on)?;
        channel.say(&text::busy(&results.busy, paint));
    }
    if wanted(Name::Swarm) {
        // A swarm that is interrupted comes to less than it should.
        let swarms = swarm::measure(most, &mut live).or_else(|e| on().and(Err(e)))?;
        channel.say(&text::swarm(&swarms, paint));
        results.swarm = Some(swarms);
    }
    if wanted(Name::Churn) {
        on()?;
        let churn = churn::measure(if most < 1_000 { 4 } else { 10 }, &mut live);
        let churn = churn.or_else(|e| on().and(Err(e)))?;
        channel.say(&text::churn(&churn, paint));
        results.churn = Some(churn);
    }
    on()?;
    json.write(escape::json(&results) + "\n")?;
    channel.say(&format!("the numbers are in {}", request.json.shown()));
    Ok(0)
}

/// How `y` grows with `x`: the exponent of the power law that fits best, and how well it fits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Fit {
    /// The exponent.
    pub exponent: f64,
    /// The share of the variance of the logarithms that it explains.
    pub r_squared: f64,
}

/// The least-squares line through the logarithms; none for fewer than three points.
pub fn fit(points: &[(f64, f64)]) -> Option<Fit> {
    let logs: Vec<(f64, f64)> =
        points.iter().filter(|(x, y)| *x > 0.0 && *y > 0.0).map(|(x, y)| (x.ln(), y.ln())).collect();
    if logs.len() < 3 {
        return None;
    }
    let n = logs.len() as f64;
    let mean = |f: fn(&(f64, f64)) -> f64| logs.iter().map(f).sum::<f64>() / n;
    let (mx, my) = (mean(|p| p.0), mean(|p| p.1));
    let sum = |f: &dyn Fn(f64, f64) -> f64| logs.iter().map(|(x, y)| f(x - mx, y - my)).sum::<f64>();
    let (xx, xy, yy) = (sum(&|x, _| x * x), sum(&|x, y| x * y), sum(&|_, y| y * y));
    if xx == 0.0 || yy == 0.0 {
        return None;
    }
    Some(Fit { exponent: xy / xx, r_squared: xy * xy / (xx * yy) })
}

/// The median; zero of nothing.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_is_found() {
        let points: Vec<(f64, f64)> =
            [10.0, 100.0, 500.0].iter().map(|x: &f64| (*x, 3.0 * x.powf(1.5))).collect();
        let found = fit(&points).unwrap();
        assert!((found.exponent - 1.5).abs() < 1e-9 && (found.r_squared - 1.0).abs() < 1e-9);
        assert_eq!(fit(&points[..2]), None);
        assert_eq!(fit(&[(1.0, 1.0); 5]), None);
    }
}
