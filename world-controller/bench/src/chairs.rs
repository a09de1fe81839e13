//! Runs per second of the thesis's chair (4.1.3), simulated on all processors, for each strategy: all kinds
//! in turn, consecutive starts, all invariants checked.
//!
//! Absent: the outcomes, which `metamorph reproduce` compares in full.

use super::BenchError;
use super::machine::CpuWatch;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::Live;
use metamorph_processes::family::{read_text, simulate};
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::roombots::Kind;
use metamorph_scenario::{LinkKind, Overrides, Plan};
use metamorph_sim_bridge::director::outcome::Outcome;
use serde::Serialize;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

/// Number of runs of each strategy.
pub const RUNS: u64 = 4_000;

/// The result for one strategy.
#[derive(Debug, Serialize)]
pub struct Row {
    /// Its name.
    pub strategy: String,
    /// Runs, and those that were built.
    pub runs: u64,
    pub built: u64,
    /// Violations of invariants in all runs.
    pub violations: u64,
    /// Concurrent runs.
    pub threads: u64,
    /// Runs per second of real time.
    pub runs_per_s: f64,
    /// Processor time per run in milliseconds.
    pub cpu_ms: f64,
}

/// The sum over some of the runs.
#[derive(Clone, Copy, Default)]
struct Sum {
    built: u64,
    violations: u64,
    cpu_s: f64,
}

/// Measures every strategy.
pub fn measure(runs: u64, live: &mut Live) -> Result<Vec<Row>, BenchError> {
    let threads = thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let mut rows = Vec::new();
    for strategy in Strategy::DISTRIBUTED {
        live.show(|| format!("chairs: {}", strategy.name()));
        let (next, watch) = (AtomicU64::new(0), Stopwatch::start());
        let sums: Result<Vec<Sum>, BenchError> = thread::scope(|scope| {
            let all: Vec<_> = (0..threads).map(|_| scope.spawn(|| labour(strategy, runs, &next))).collect();
            let joined = all.into_iter().map(|thread| thread.join());
            joined
                .map(|sum| sum.unwrap_or_else(|_| Err(BenchError::Wrong("a run panicked".into()))))
                .collect()
        });
        let (sums, elapsed) = (sums?, watch.elapsed().as_secs_f64());
        rows.push(Row {
            strategy: strategy.name().to_owned(),
            runs,
            built: sums.iter().map(|s| s.built).sum(),
            violations: sums.iter().map(|s| s.violations).sum(),
            threads: threads as u64,
            runs_per_s: runs as f64 / elapsed,
            cpu_ms: sums.iter().map(|s| s.cpu_s).sum::<f64>() * 1e3 / runs as f64,
        });
    }
    live.clear();
    Ok(rows)
}

/// Runs one thread.
fn labour(strategy: Strategy, runs: u64, next: &AtomicU64) -> Result<Sum, BenchError> {
    let plans: Result<Vec<Plan>, BenchError> =
        Kind::METAMODULES.into_iter().map(|kind| plan(strategy, kind)).collect();
    let (plans, mut sum, watch) = (plans?, Sum::default(), CpuWatch::start());
    loop {
        let run = next.fetch_add(1, Ordering::Relaxed);
        if run >= runs {
            return Ok(Sum { cpu_s: watch.elapsed().as_secs_f64(), ..sum });
        }
        let (seed, kind) = (run / plans.len() as u64, run as usize % plans.len());
        let plan = plans[kind].with_seed(seed).map_err(|error| BenchError::Wrong(error.to_string()))?;
        let (report, _) = simulate(&plan, Stopwatch::start(), &mut |_, _| true);
        sum.built += u64::from(report.outcome == Outcome::Built.name());
        sum.violations += report.invariants.broken;
    }
}

fn plan(strategy: Strategy, kind: Kind) -> Result<Plan, BenchError> {
    let text = format!(
        "version = 1\n\
         [swarm]\nfamily = \"metamodule\"\nkind = \"{kind}\"\nstart = \"random\"\n\
         floor = {{ min = [0, 0], max = [12, 12] }}\nturn_time = \"1s\"\n\
         [[goal]]\nshape = {{ chair = [5, 5] }}\norder = \"circular\"\n\
         [protocol]\nstrategy = \"{}\"\n\
         [link]\ndelay = \"10ms..100ms\"\n",
        strategy.name()
    );
    let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
    read_text("bench", &text, &overrides).map_err(|diagnostics| BenchError::Wrong(diagnostics.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_strategy_runs_every_kind() {
        let rows = measure(8, &mut Live::new(false)).unwrap();
        assert_eq!(rows.len(), Strategy::DISTRIBUTED.len());
        for row in &rows {
            assert_eq!((row.runs, row.violations), (8, 0), "{row:?}");
            assert!(row.runs_per_s > 0.0 && row.cpu_ms > 0.0, "{row:?}");
        }
        assert_eq!(rows.last().map(|row| row.built), Some(8), "negotiated builds");
    }
}
