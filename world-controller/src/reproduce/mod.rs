//! `metamorph reproduce`: the thesis's experiment with metamodules (4.1.3), many times over, beside
//! the numbers that it printed.
//!
//! `published` holds those, `compare` sets ours beside them, `text` and `page` show both. The runs are
//! a sweep for each goal, over kinds, strategies and orders. Deliberately absent: any setting. What
//! could be chosen otherwise is listed with the results, and `metamorph sweep` runs it.

pub mod compare;
mod page;
pub mod published;
mod text;

use crate::interrupt::Interrupt;
use crate::sweep::grid::{Axis, Grid, Seeds};
use crate::sweep::store::Store;
use crate::sweep::{Progress, Scenario, SweepError, create_directory, run, write, write_results};
use crate::terminal::{Channel, print_out};
use crate::wording::{count, many};
use clap::ValueEnum;
use compare::{Reproduction, Runs};
use metamorph_protocol::metamodule::blueprint::SeedOrder;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_sim_bridge::outcome::Outcome;
use published::KINDS;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

/// The page, beside the directories of the sweeps.
const PAGE: &str = "report.html";

/// What can be reproduced.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
pub enum Experiment {
    /// Table 4.1: collisions and deadlocks of four metamodules that build the box
    #[value(name = "4.1")]
    Table41,
    /// Table 4.2: collisions and deadlocks of six metamodules that build the chair
    #[value(name = "4.2")]
    Table42,
    /// Figure 4.5: moves that box and chair need
    #[value(name = "fig4.5")]
    Figure45,
}

impl Experiment {
    /// The name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Experiment::Table41 => "4.1",
            Experiment::Table42 => "4.2",
            Experiment::Figure45 => "fig4.5",
        }
    }
    const fn title(self) -> &'static str {
        match self {
            Experiment::Table41 => "Table 4.1: four metamodules build the box",
            Experiment::Table42 => "Table 4.2: six metamodules build the chair",
            Experiment::Figure45 => "Figure 4.5: moves that box and chair need",
        }
    }
    const fn goals(self) -> &'static [Goal] {
        match self {
            Experiment::Table41 => &[Goal::Box],
            Experiment::Table42 => &[Goal::Chair],
            Experiment::Figure45 => &[Goal::Box, Goal::Chair],
        }
    }
}

/// What is built.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Goal {
    /// Four metamodules.
    Box,
    /// Six.
    Chair,
}

impl Goal {
    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Goal::Box => "box",
            Goal::Chair => "chair",
        }
    }
    const fn text(self) -> &'static str {
        match self {
            Goal::Box => include_str!("box.toml"),
            Goal::Chair => include_str!("chair.toml"),
        }
    }
}

/// What was asked for.
#[derive(Clone, Debug)]
pub struct Request {
    /// Which experiments.
    pub experiments: Vec<Experiment>,
    /// Seeds for every kind, strategy and order.
    pub seeds: u64,
    /// How many threads.
    pub jobs: NonZeroUsize,
    /// Where every run goes.
    pub out: Option<PathBuf>,
    /// Where the numbers go; `-` is standard output.
    pub json: Option<PathBuf>,
    /// Whether to say nothing but errors.
    pub quiet: bool,
}

/// Does what was asked for, and gives the exit code.
pub fn reproduce(request: &Request) -> Result<u8, SweepError> {
    let mut experiments = request.experiments.clone();
    experiments.sort_unstable();
    experiments.dedup();
    let to_stdout = request.json.as_deref() == Some(Path::new("-"));
    let json = request.json.as_deref().filter(|_| !to_stdout);
    if let Some(file) = json {
        // Found out now, and not after all the runs.
        let opened = std::fs::OpenOptions::new().append(true).create(true).open(file);
        opened.map_err(|error| SweepError::Json { path: file.into(), error })?;
    }
    if let Some(dir) = &request.out {
        create_directory(dir)?;
    }
    let grid = grid(request.seeds)?;
    let interrupt = Interrupt::listen().map_err(SweepError::Signals)?;
    let mut runs = Runs { of: Vec::new() };
    for goal in [Goal::Box, Goal::Chair] {
        if experiments.iter().any(|e| e.goals().contains(&goal)) {
            runs.of.push((goal, sweep(goal, request, &grid, &interrupt)?));
        }
    }
    let all = runs.reproduction(&experiments, request.seeds);
    if let Some(dir) = &request.out {
        write(&dir.join(PAGE), &page::page(&all))?;
    }
    let text = serde_json::to_string_pretty(&all)
        .expect("invariant: it is made of plain values, text keys and finite numbers");
    if to_stdout {
        print_out(&text);
    }
    if let Some(file) = json {
        write(file, &(text + "\n"))?;
    }
    let channel = Channel::beside(to_stdout, request.quiet);
    channel.say(&text::text(&all, channel.paint()));
    channel.say(&ending(request, &all));
    Ok(match () {
        () if all.runs < all.runs_planned => Outcome::Aborted.exit_code(),
        () if all.violations > 0 => Outcome::Unsafe.exit_code(),
        () => 0,
    })
}

/// All kinds with all strategies and all orders.
fn grid(seeds: u64) -> Result<Grid, SweepError> {
    let axis = |key: &str, values: Vec<&str>| Axis {
        key: key.to_owned(),
        values: values.into_iter().map(str::to_owned).collect(),
    };
    let vary = vec![
        axis("swarm.kind", KINDS.iter().map(|k| k.name()).collect()),
        axis("protocol.strategy", Strategy::ALL.iter().map(|s| s.name()).collect()),
        axis("goal.0.order", SeedOrder::ALL.iter().map(|o| o.name()).collect()),
    ];
    Ok(Grid::new(Seeds { from: 0, until: seeds }, vary)?)
}

fn sweep(
    goal: Goal,
    request: &Request,
    grid: &Grid,
    interrupt: &Interrupt,
) -> Result<crate::sweep::summary::Summary, SweepError> {
    // With a directory the scenario is a file in it, so that the commands in the results work.
    let file = request.out.as_ref().map(|dir| dir.join(goal.name()).with_extension("toml"));
    let origin = file.as_ref().map_or_else(|| format!("{}.toml", goal.name()), |f| f.display().to_string());
    let scenario = Scenario { origin, text: goal.text().to_owned() };
    let mut store = None;
    let dir = request.out.as_ref().map(|dir| dir.join(goal.name()));
    if let (Some(file), Some(dir)) = (&file, &dir) {
        write(file, goal.text())?;
        store = Some(Store::create(dir, &scenario.manifest(grid))?);
    }
    let tallies = run(&scenario, grid, Progress::new(grid, store), request.jobs, interrupt, !request.quiet)?;
    let summary = tallies.summary(&scenario.origin, grid);
    if let Some(dir) = &dir {
        write_results(dir, &scenario, grid, &summary)?;
    }
    Ok(summary)
}

fn ending(request: &Request, all: &Reproduction) -> String {
    let missing = all.runs_planned - all.runs;
    let interrupted = match missing {
        0 => String::new(),
        n => format!("  interrupted: {} of {} missing here\n", count(n), many(all.runs_planned, "run")),
    };
    let place = match &request.out {
        Some(dir) => format!("  every run and a report are in {}", dir.display()),
        None => "  nothing is kept; --out DIR keeps every run and a report".to_owned(),
    };
    interrupted + &place
}
