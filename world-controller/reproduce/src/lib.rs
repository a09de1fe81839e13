//! `metamorph reproduce`: the thesis's experiment with metamodules (4.1.3), repeated many times, beside the
//! printed numbers.
//!
//! It is re-implemented, not reproduced: the text leaves much open, and the nearest reading is used.
//! `published` holds the numbers of the thesis, `compare` sets ours beside them, `fit` tests whether they
//! agree, `claims` judges statements of the thesis by experiments of its own size (`resample`), `recipe`
//! those about seeding, `assumptions` varies what the text leaves open, `text` and `page` show the results.
//! Everything is a sweep. Absent: any setting; `metamorph sweep` has them.

mod assumptions;
mod claims;
pub mod compare;
mod error;
mod fit;
mod page;
pub mod planners;
pub mod published;
mod readings;
mod recipe;
mod resample;
mod text;

use crate::error::ReproduceError;
use clap::ValueEnum;
use compare::{Redrawn, Reproduction, Runs};
use fit::Fit;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::{Json, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_console::terminal::Channel;
use metamorph_experiments::sweep::store::Store;
use metamorph_experiments::sweep::summary::Summary;
use metamorph_experiments::sweep::{Progress, Results, Scenario, SweepError, create_directory, run};
use metamorph_families::metamodule::Metamodules;
use metamorph_processes::family::read_text;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_scenario::grid::{Grid, Seeds};
use metamorph_scenario::settings::Setting;
use metamorph_scenario::{LinkKind, Overrides};
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::escape::Shown;
use metamorph_text::format::{count, many};
use published::{KINDS, STRATEGIES, TABLE_4_1, TABLE_4_2, Table};
use std::num::NonZeroUsize;
use std::path::PathBuf;

/// File name of the page, beside the directories of the sweeps.
const PAGE: &str = "report.html";

/// The experiments.
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
    /// The connection mechanism (2.2.1): positions on a wall that are gripped
    #[value(name = "gripping", alias = "2.2.1")]
    Gripping,
    /// Stoy's experiment (4.1.2): a slab becomes a disc and then a ball; and how safe the published rule is
    Stoy,
    /// Shares of placement, strategy, random numbers of agents and network in the outcome of box and chair (4.1.3)
    Why,
    /// The planner of the 2009 report: four modules from a line to a loop
    #[value(name = "graph-signature")]
    GraphSignature,
    /// Table 6.1 and the planner experiments of 6.3.2: one module on a floor with obstacles
    #[value(name = "on-grid")]
    OnGrid,
    /// The reward map of 4.2.3: failed tries of a metamodule on a floor
    #[value(name = "reward-map")]
    RewardMap,
    /// Plans of the controller beside the strategies by which each metamodule decides for itself
    Planned,
    /// Tables 7.2 and 7.5: parameters of reduced networks of oscillators, and how fast they learn (--gaits)
    #[value(name = "thesis-7")]
    Thesis7,
    /// Experiment 2 of 5.1.4 and figure 5.10: a metamodule crosses a floor under limits of torque
    #[value(alias = "5.10")]
    Torque,
    /// Experiment 1 of 5.1.4: two metamodules transport a cube; figures 5.8 and 5.9
    #[value(aliases = ["5.8", "5.9"])]
    Transport,
    /// Appendix B.3 to B.5: levels and isolation of a table, and the order that follows from them
    #[value(name = "appendix-b")]
    AppendixB,
    /// Appendix C.6: pairing of cubes to modules
    #[value(name = "c.6")]
    Pairing,
    /// Table 8.2: the statistics of the study with people, recomputed
    #[value(name = "8.2")]
    Study,
    /// Appendix E: what an operator costs, with a scripted one
    #[value(name = "e")]
    Operated,
}

impl Experiment {
    /// Returns the name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Experiment::Table41 => "4.1",
            Experiment::Table42 => "4.2",
            Experiment::Figure45 => "fig4.5",
            Experiment::Gripping => "gripping",
            Experiment::Stoy => "stoy",
            Experiment::Why => "why",
            Experiment::GraphSignature => "graph-signature",
            Experiment::OnGrid => "on-grid",
            Experiment::RewardMap => "reward-map",
            Experiment::Planned => "planned",
            Experiment::Thesis7 => "thesis-7",
            Experiment::Torque => "torque",
            Experiment::Transport => "transport",
            Experiment::AppendixB => "appendix-b",
            Experiment::Pairing => "c.6",
            Experiment::Study => "8.2",
            Experiment::Operated => "e",
        }
    }
    const fn title(self) -> &'static str {
        match self {
            Experiment::Table41 => "Table 4.1: four metamodules build the box",
            Experiment::Table42 => "Table 4.2: six metamodules build the chair",
            Experiment::Figure45 => "Figure 4.5: moves that box and chair need",
            Experiment::Gripping => "Thesis 2.2.1: positions that the connection mechanism grips",
            Experiment::Stoy => "Thesis 4.1.2: Stoy's growth from a seed along gradients",
            Experiment::Why => "Thesis 4.1.3: what decides whether box and chair are built",
            Experiment::GraphSignature => "Report 2009, chapter 5: planning by graph signatures",
            Experiment::OnGrid => "Thesis 6.3.2: a module walks over a floor with obstacles",
            Experiment::RewardMap => "Thesis 4.2.3: the reward map, one metamodule on a floor",
            Experiment::Planned => "Thesis 4.1.3: box and chair, planned centrally and by each metamodule",
            Experiment::Thesis7 => {
                "Thesis, tables 7.2 and 7.5: networks of oscillators, and how fast they learn"
            }
            Experiment::Torque => "Thesis 5.1.4, experiment 2 (figure 5.10): limits of torque",
            Experiment::Transport => "Thesis 5.1.4, experiment 1 (figures 5.8 and 5.9): transport of a cube",
            Experiment::AppendixB => "Thesis B.3 to B.5: the order in which a table is built",
            Experiment::Pairing => "Thesis C.6: pairing of cubes to modules",
            Experiment::Study => "Thesis, table 8.2: F values of the study, recomputed",
            Experiment::Operated => "Thesis, appendix E: what an operator costs",
        }
    }
    const fn goals(self) -> &'static [Goal] {
        match self {
            Experiment::Table41 => &[Goal::Box],
            Experiment::Table42 => &[Goal::Chair],
            Experiment::Figure45 => &[Goal::Box, Goal::Chair],
            _ => &[],
        }
    }
    /// Returns true for those of a planner, which are not sweeps.
    const fn is_of_a_planner(self) -> bool {
        self.goals().is_empty()
    }
}

/// The goal of an experiment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Goal {
    /// Four metamodules.
    Box,
    /// Six.
    Chair,
}

impl Goal {
    /// Both goals.
    pub const ALL: [Goal; 2] = [Goal::Box, Goal::Chair];

    /// Returns its table in the thesis.
    pub const fn table(self) -> &'static Table {
        match self {
            Goal::Box => &TABLE_4_1,
            Goal::Chair => &TABLE_4_2,
        }
    }
    /// Returns its name.
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

/// The arguments of `metamorph reproduce`.
#[derive(Clone, Debug)]
pub struct Request {
    /// The experiments.
    pub experiments: Vec<Experiment>,
    /// Seeds for every kind, strategy and order.
    pub seeds: u64,
    /// Number of threads.
    pub jobs: NonZeroUsize,
    /// The directory for all runs.
    pub out: Option<PathBuf>,
    /// The destination of the results; `-` is standard output.
    pub json: Option<PathBuf>,
    /// The destination of the plot of `why`.
    pub plot: Option<PathBuf>,
    /// Gait files whose learning curves are compared.
    pub gaits: Vec<PathBuf>,
    /// Session logs that are measured beside table 8.2.
    pub studies: Vec<PathBuf>,
    /// True to print errors only.
    pub quiet: bool,
}

/// Executes the request, and returns the exit code.
pub fn reproduce(request: &Request) -> Result<u8, ReproduceError> {
    let mut experiments = request.experiments.clone();
    experiments.sort_unstable();
    experiments.dedup();
    if request.plot.is_some() && experiments != [Experiment::Why] {
        return Err(ReproduceError::OfWhy);
    }
    let of_planners: Vec<Experiment> = experiments.iter().copied().filter(|e| e.is_of_a_planner()).collect();
    if !of_planners.is_empty() {
        let keeps_trials =
            matches!(*of_planners, [Experiment::Stoy | Experiment::Why | Experiment::Transport]);
        if of_planners.len() < experiments.len() || (request.out.is_some() && !keeps_trials) {
            return Err(ReproduceError::NotTogether(of_planners[0].name()));
        }
        return planners::reproduce(&of_planners, request);
    }
    let mut outputs = Outputs::new();
    let page = match &request.out {
        Some(dir) => {
            create_directory(dir)?;
            Some(outputs.writes("--out", &dir.join(PAGE), OutputKind::Html)?)
        }
        None => None,
    };
    let json = Json::of(request.json.as_deref(), &mut outputs)?;
    let all = measure(&experiments, request, &mut outputs)?;
    if let Some(page) = &page {
        page.write(page::page(&all))?;
    }
    json.write(&all)?;
    let channel = Channel::beside(json.is_out(), request.quiet);
    channel.say(&text::text(&all, channel.paint()));
    channel.say(&ending(request, &all));
    Ok(match () {
        () if all.runs < all.runs_planned => Outcome::Aborted.exit_code(),
        () if all.violations > 0 => Outcome::Unsafe.exit_code(),
        () => 0,
    })
}

/// Runs everything requested.
fn measure(
    experiments: &[Experiment],
    request: &Request,
    outputs: &mut Outputs,
) -> Result<Reproduction, ReproduceError> {
    let grid = grid(request.seeds, &Strategy::DISTRIBUTED)?;
    let interrupt = Interrupt::listen().map_err(SweepError::Signals)?;
    interrupt.begin();
    let mut sweeper = Sweeper { request, outputs, interrupt: &interrupt, runs: 0, planned: 0, violations: 0 };
    let (mut runs, mut locks) = (Runs { of: Vec::new() }, Runs { of: Vec::new() });
    let goals: Vec<Goal> =
        Goal::ALL.into_iter().filter(|g| experiments.iter().any(|e| e.goals().contains(g))).collect();
    for goal in &goals {
        runs.of.push((*goal, sweeper.run(*goal, goal.text(), Some(""), &grid)?));
    }
    for goal in &goals {
        let text = goal.text().replace("[protocol]\n", LOCKS_ONLY);
        let of_published = self::grid(request.seeds, &STRATEGIES)?;
        locks.of.push((*goal, sweeper.run(*goal, &text, Some("-locks"), &of_published)?));
    }
    let assumptions = assumptions::vary(&runs, request.seeds, &mut sweeper)?;
    let of_seeding = match experiments.contains(&Experiment::Table42) {
        true => recipe::claims(request.seeds, &mut sweeper)?,
        false => Vec::new(),
    };
    let redrawn = redrawn(&goals, request.seeds)?;
    let mut all = runs.reproduction(experiments, request.seeds);
    all.fits.push(Fit::of(
        "locks on swept cells alone",
        "no precedence; settled ones do not repel (how greedy, slope and step were run before)",
        &locks,
    ));
    (all.assumptions, all.redrawn) = (assumptions, redrawn);
    if let Some(table) = all.experiments.iter_mut().find(|e| e.name == Experiment::Table42.name()) {
        table.claims.extend(of_seeding);
        table.claims.push(claims::other_types());
    }
    (all.runs, all.runs_planned, all.violations) = (sweeper.runs, sweeper.planned, sweeper.violations);
    Ok(all)
}

/// The reading without precedence, as the beginning of `[protocol]`.
const LOCKS_ONLY: &str = "[protocol]\nprecedence = \"off\"\nsettled_repel = false\n";

/// Returns all kinds with these strategies and all orders.
fn grid(seeds: u64, strategies: &[Strategy]) -> Result<Grid, ReproduceError> {
    Ok(Grid::new(Seeds { from: 0, until: seeds }, assumptions::axes(strategies))?)
}

/// Executes sweeps, and adds up their runs.
struct Sweeper<'a> {
    request: &'a Request,
    outputs: &'a mut Outputs,
    interrupt: &'a Interrupt,
    runs: u64,
    planned: u64,
    violations: u64,
}

impl Sweeper<'_> {
    /// Runs a scenario over a grid. If `kept` is given and the request names an output directory, all runs are
    /// written to a directory in it whose name is that of the goal followed by `kept`.
    fn run(
        &mut self,
        goal: Goal,
        text: &str,
        kept: Option<&str>,
        grid: &Grid,
    ) -> Result<Summary, ReproduceError> {
        let Request { out, jobs, quiet, .. } = self.request;
        let name = format!("{}{}", goal.name(), kept.unwrap_or_default());
        let out = out.as_ref().filter(|_| kept.is_some());
        // The scenario is also written to the directory, so that the commands in the results work.
        let file = out.map(|dir| dir.join(&name).with_extension("toml"));
        let origin = file.as_ref().map_or_else(|| format!("{name}.toml"), |f| f.display().to_string());
        let scenario = Scenario { origin, text: text.to_owned(), overrides: Overrides::default() };
        let manifest = scenario.manifest(grid);
        let (mut store, mut results) = (None, None);
        let dir = out.map(|dir| dir.join(&name));
        if let (Some(file), Some(dir)) = (&file, &dir) {
            self.outputs.writes("--out", file, OutputKind::Any)?.write(text)?;
            store = Some(Store::create(dir, &manifest)?);
            results = Some(Results::of(dir, self.outputs)?);
        }
        let tallies = run(&scenario, grid, Progress::new(grid, store), *jobs, self.interrupt, !quiet)?;
        let summary = tallies.summary(&scenario.name(), grid);
        if let Some(results) = &results {
            results.write(&manifest, &summary)?;
        }
        self.runs += summary.runs;
        self.planned += summary.runs_planned;
        self.violations += summary.violations;
        Ok(summary)
    }
}

/// Starts examined at most to count those redrawn.
const MOST_STARTS: u64 = 200;

/// Counts the starts of the experiment that were redrawn because a metamodule was enclosed.
fn redrawn(goals: &[Goal], seeds: u64) -> Result<Vec<Redrawn>, ReproduceError> {
    let mut all = Vec::new();
    for goal in goals {
        for kind in KINDS {
            let settings = vec![Setting { option: "--set", text: format!("swarm.kind={}", kind.name()) }];
            let overrides = Overrides { link: LinkKind::Sim, settings, ..Overrides::default() };
            let plan = read_text(goal.name(), goal.text(), &overrides).map_err(SweepError::Scenario)?;
            let (mut drawn, mut shut_in) = (0, 0);
            for seed in 0..seeds.min(MOST_STARTS) {
                // A seed without a start has already ended the sweep.
                let placed = plan.with_seed(seed);
                if let Some(m) = placed.as_ref().ok().and_then(|plan| plan.swarm.of::<Metamodules>()) {
                    drawn += 1 + u64::from(m.redrawn);
                    shut_in += u64::from(m.redrawn);
                }
            }
            let (goal, kind) = (goal.name().to_owned(), kind.name().to_owned());
            all.push(Redrawn { goal, kind, drawn, shut_in });
        }
    }
    Ok(all)
}

fn ending(request: &Request, all: &Reproduction) -> String {
    let missing = all.runs_planned - all.runs;
    let interrupted = match missing {
        0 => String::new(),
        n => format!("  interrupted: {} of {} missing here\n", count(n), many(all.runs_planned, "run")),
    };
    let place = match &request.out {
        Some(dir) => format!("  every run and a report are in {}", dir.shown()),
        None => "  nothing is kept; --out DIR keeps every run and a report".to_owned(),
    };
    interrupted + &place
}
