//! `metamorph sweep`: one scenario with many seeds and varied values, on the simulated link.
//!
//! `grid` lists the runs, `pool` executes them, `row` is the result of one, `store` keeps them in a
//! directory, `join` makes one sweep of parts, `summary` and `statistics` aggregate them, `table` and `page` show them (`plots` draws).
//!
//! *Invariant.* Results depend on the scenario, the seeds and the variations only: not on the number of
//! threads, the machine, or interruptions of the sweep. Absent: the process link, where runs are not
//! deterministic and concurrent runs on one machine disturb each other.

pub mod join;
pub mod page;
pub mod plot;
pub mod pool;
pub mod row;
pub mod store;
pub mod summary;
pub mod table;
#[doc(hidden)]
pub mod testing;

use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::{Output, OutputError, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::{Channel, Live};
use metamorph_processes::family::{read_text, sources};
use metamorph_scenario::diagnostics::Diagnostics;
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::grid::{Axis, Grid, GridError, Part, Seeds};
use metamorph_scenario::{LinkKind, Loaded, Overrides, Plan, load, quote};
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED};
use metamorph_text::escape::{Shown, json, portable};
use metamorph_text::format::{count, many, rate, seconds};
use metamorph_text::program;
use page::Context;
use pool::{News, Work};
use std::collections::BTreeSet;
use std::io;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::Duration;
pub use store::create_directory;
use store::{Done, Manifest, Store, StoreError};
use summary::{Summary, Tallies};
use thiserror::Error;

/// File name of the summary.
const SUMMARY: &str = "summary.json";
/// File name of the report.
const PAGE: &str = "report.html";
/// Time between two flushes: at most this much of a sweep is lost if the program is killed.
const FLUSH: Duration = Duration::from_millis(100);

/// Why a sweep failed.
#[derive(Debug, Error)]
pub enum SweepError {
    /// Invalid seeds or variations.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// An invalid scenario.
    #[error(transparent)]
    Scenario(Diagnostics),
    /// A scenario that is invalid with the values of a combination.
    #[error("{diagnostics}\n\nin the combination {values}")]
    Combination {
        /// The problems.
        diagnostics: Diagnostics,
        /// The values.
        values: Box<str>,
    },
    /// The directory.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A file beside the runs cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// Parts cannot be joined.
    #[error(transparent)]
    Join(#[from] join::JoinError),
    /// Signals cannot be caught.
    #[error("cannot listen for Ctrl-C: {0}")]
    Signals(io::Error),
    /// A seed with which the start cannot be drawn.
    #[error("{error}\n  this run alone: {repeat}\n  fix: {}", .error.fix())]
    NoStart {
        /// The command for this run alone.
        repeat: String,
        /// The cause.
        error: Box<ScenarioError>,
    },
    /// A panic in a run.
    #[error("a run made the program panic, which is a defect of the program. To repeat this run alone: {0}")]
    Defect(String),
}

impl CommandError for SweepError {
    fn exit_code(&self) -> u8 {
        match self {
            SweepError::Grid(_)
            | SweepError::Scenario(_)
            | SweepError::Combination { .. }
            | SweepError::NoStart { .. } => BAD_USAGE,
            SweepError::Store(StoreError::Write { .. }) => FAILED,
            SweepError::Store(_) => BAD_USAGE,
            SweepError::Join(error) => error.exit_code(),
            SweepError::Output(error) => error.exit_code(),
            SweepError::Signals(_) | SweepError::Defect(_) => FAILED,
        }
    }
}

/// The text of a scenario, to be read with varied values.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// Its name in messages.
    pub origin: String,
    /// The text.
    pub text: String,
    /// Its changes, in all runs.
    pub overrides: Overrides,
}

impl Scenario {
    /// Returns the plan of a combination, for any seed.
    pub fn plan(&self, grid: &Grid, combination: u64) -> Result<Plan, Diagnostics> {
        read_text(&self.origin, &self.text, &self.changes(grid, combination))
    }

    /// Returns all that is changed in the runs of a combination.
    fn changes(&self, grid: &Grid, combination: u64) -> Overrides {
        let mut overrides = Overrides { link: LinkKind::Sim, ..self.overrides.clone() };
        overrides.settings.extend(grid.settings(combination));
        overrides
    }

    /// Reads the scenario with every combination.
    pub fn check(&self, grid: &Grid) -> Result<(), SweepError> {
        for combination in 0..grid.combinations() {
            self.plan(grid, combination).map_err(|diagnostics| match grid.values(combination).len() {
                0 => SweepError::Scenario(diagnostics),
                _ => SweepError::Combination {
                    diagnostics,
                    values: options(grid, combination, "--vary").into(),
                },
            })?;
        }
        Ok(())
    }

    /// Returns the manifest that identifies a sweep of this scenario.
    pub fn manifest(&self, grid: &Grid) -> Manifest {
        let plan = self.plan(grid, 0).ok();
        let mut manifest = Manifest::new(&self.name(), &self.text, self.overrides.options(), grid);
        if let Some(plan) = plan {
            (manifest.title, manifest.description) = (plan.title(), plan.description);
        }
        manifest
    }

    /// Returns the scenario's name for output that is passed on.
    pub fn name(&self) -> String {
        portable(Path::new(&self.origin))
    }

    /// Returns the command that repeats one run.
    pub fn repeat(&self, grid: &Grid, run: u64) -> String {
        let (file, seed) = (quote(self.origin.clone()), grid.seed(run));
        let program = quote(program::name().to_owned());
        let command = format!("{program} run {file} --link sim --seed {seed}");
        let changes = self.changes(grid, grid.combination(run)).options();
        std::iter::once(command).chain(changes.into_iter().map(quote)).collect::<Vec<_>>().join(" ")
    }
}

/// Returns the page of the results of a sweep.
fn page_of(manifest: &Manifest, summary: &Summary) -> String {
    let context = Context {
        title: &manifest.title,
        description: manifest.description.as_deref(),
        scenario: &manifest.text,
        command: &command_of(manifest, manifest.scenario.clone()),
    };
    page::page(summary, &context)
}

/// Returns the command that gives the same results from the file of this name.
fn command_of(manifest: &Manifest, file: String) -> String {
    let Manifest { grid, options, .. } = manifest;
    let mut words = vec![quote(program::name().to_owned()), "sweep".to_owned(), quote(file)];
    words.extend(["--seeds".to_owned(), grid.seeds.to_string()]);
    words.extend(grid.vary.iter().flat_map(|v| ["--vary".to_owned(), quote(v.to_string())]));
    words.extend(options.iter().cloned().map(quote));
    words.join(" ")
}

/// Formats a combination as options.
fn options(grid: &Grid, combination: u64, option: &str) -> String {
    let settings = grid.settings(combination);
    settings.into_iter().map(|s| format!("{option} {}", quote(s.text))).collect::<Vec<_>>().join(" ")
}

/// The arguments of `metamorph sweep`, as typed.
#[derive(Clone, Debug)]
pub struct Request {
    /// The scenario file.
    pub scenario: PathBuf,
    /// The seeds: `A..B`.
    pub seeds: String,
    /// The varied keys: `KEY=VALUE,VALUE`.
    pub vary: Vec<String>,
    /// The changes of the scenario, in all runs.
    pub overrides: Overrides,
    /// Number of threads.
    pub jobs: NonZeroUsize,
    /// The directory for the results.
    pub out: Option<PathBuf>,
    /// True to resume the sweep in the directory, or to begin it there.
    pub resume: bool,
    /// The part of the runs to execute: `I/N`.
    pub part: Option<String>,
    /// True to print errors only.
    pub quiet: bool,
}

/// Executes the request, and returns the exit code.
pub fn sweep(request: &Request) -> Result<u8, SweepError> {
    let Loaded { origin, text } = load(sources(), &request.scenario).map_err(SweepError::Scenario)?;
    let scenario = Scenario { origin, text, overrides: request.overrides.clone() };
    let vary = request.vary.iter().map(|text| Axis::parse(text)).collect::<Result<Vec<_>, _>>()?;
    let grid = Grid::new(Seeds::parse(&request.seeds)?, vary)?;
    let part = request.part.as_deref().map_or(Ok(Part::WHOLE), Part::parse)?;
    scenario.check(&grid)?;
    let manifest = scenario.manifest(&grid).of_part(part);
    let mut outputs = Outputs::new();
    outputs.reads("the scenario", Path::new(&scenario.origin));
    for file in scenario.plan(&grid, 0).map(|plan| plan.files).unwrap_or_default() {
        outputs.reads("a file that the scenario names,", &file);
    }
    let mut tallies = Tallies::new(&grid);
    let interrupt = Interrupt::listen().map_err(SweepError::Signals)?;
    interrupt.begin();
    let (store, done) = match &request.out {
        None => (None, Done::default()),
        Some(dir) => {
            let (store, done) = if request.resume {
                Store::resume(dir, &manifest, |run, row| tallies.add(grid.combination(run), row))?
            } else {
                (Store::create(dir, &manifest)?, Done::default())
            };
            (Some(store), done)
        }
    };
    // A part has runs only; the rest is of the whole, and is written when all parts are joined.
    let of_whole = request.out.as_deref().filter(|_| part.is_whole());
    let results = of_whole.map(|dir| Results::of(dir, &mut outputs)).transpose()?;
    let since = Stopwatch::start();
    let before = done.runs();
    let jobs = request.jobs;
    let progress = Progress { store, done, tallies, part };
    let tallies = run(&scenario, &grid, progress, jobs, &interrupt, !request.quiet)?;
    let mut summary = tallies.summary(&scenario.name(), &grid);
    summary.runs_planned = part.runs(&grid);
    if let Some(results) = &results {
        results.write(&manifest, &summary)?;
    }
    let channel = if request.quiet { Channel::Quiet } else { Channel::Out };
    let new = summary.runs - before;
    let took = since.elapsed().as_secs_f64();
    channel.say(&format!(
        "{}\n  {} in {} on {}, {}\n{}",
        table::table(&summary, channel.paint()),
        many(new, "run"),
        seconds(took),
        many(jobs.get() as u64, "thread"),
        rate(new, took),
        ending(request, part, &command_of(&manifest, scenario.origin.clone()), &summary),
    ));
    Ok(match () {
        () if summary.runs < summary.runs_planned => Outcome::Aborted.exit_code(),
        () if summary.violations > 0 => Outcome::Unsafe.exit_code(),
        () => 0,
    })
}

/// Joins the parts in these directories into a new or empty one, and returns the exit code.
///
/// # Errors
/// See [`join::join`].
pub fn join_parts(parts: &[PathBuf], out: &Path, quiet: bool) -> Result<u8, SweepError> {
    let summary = join::join(parts, out)?;
    let channel = if quiet { Channel::Quiet } else { Channel::Out };
    channel.say(&format!(
        "{}\n  {} of {}\n  every run and a report are in {}",
        table::table(&summary, channel.paint()),
        many(summary.runs, "run"),
        many(parts.len() as u64, "part"),
        out.shown()
    ));
    Ok(if summary.violations > 0 { Outcome::Unsafe.exit_code() } else { 0 })
}

/// Says where the results are, and how to resume if some are missing.
fn ending(request: &Request, part: Part, command: &str, summary: &Summary) -> String {
    let missing = summary.runs_planned - summary.runs;
    let of_part = if part.is_whole() { String::new() } else { format!(" --part {part}") };
    match (&request.out, missing) {
        (None, 0) => "  nothing is kept; --out DIR keeps every run".to_owned(),
        (None, n) => {
            format!("  interrupted: {} not done, and nothing is kept without --out DIR", many(n, "run"))
        }
        (Some(dir), 0) if part.is_whole() => format!("  every run and a report are in {}", dir.shown()),
        (Some(dir), 0) => format!(
            "  the runs of the part {part} are in {}; join all {} with  {} sweep --join DIR... --out DIR",
            dir.shown(),
            count(part.of()),
            program::name()
        ),
        (Some(dir), n) => format!(
            "  interrupted: {} still to be done, everything else is kept\n  resume with  {command}{of_part} --out {} --resume",
            many(n, "run"),
            quote(dir.display().to_string())
        ),
    }
}

/// The files beside the runs.
#[derive(Debug)]
pub struct Results {
    summary: Output,
    page: Output,
}

impl Results {
    /// Registers the files in this directory. Whether they can be written is checked now, not after all the
    /// runs.
    pub fn of(dir: &Path, outputs: &mut Outputs) -> Result<Results, OutputError> {
        let summary = outputs.writes("--out", &dir.join(SUMMARY), OutputKind::Json)?;
        Ok(Results { summary, page: outputs.writes("--out", &dir.join(PAGE), OutputKind::Html)? })
    }

    /// Writes the summary and the page.
    pub fn write(&self, manifest: &Manifest, summary: &Summary) -> Result<(), OutputError> {
        self.summary.write(json(summary) + "\n")?;
        self.page.write(page_of(manifest, summary))
    }
}

/// The progress of a sweep.
pub struct Progress {
    /// The store of the runs, if they are kept.
    pub store: Option<Store>,
    /// Runs done before.
    pub done: Done,
    /// Counts of the first runs, as many as `done.count`. Those of `done.ahead` are counted in their turn.
    pub tallies: Tallies,
    /// The part of the runs to execute.
    pub part: Part,
}

impl Progress {
    /// Returns the progress of a sweep that has not begun.
    pub fn new(grid: &Grid, store: Option<Store>) -> Progress {
        Progress { store, done: Done::default(), tallies: Tallies::new(grid), part: Part::WHOLE }
    }
}

/// Executes all remaining runs, or until interrupted. Every completed run is kept and counted.
pub fn run(
    scenario: &Scenario,
    grid: &Grid,
    progress: Progress,
    jobs: NonZeroUsize,
    interrupt: &Interrupt,
    show: bool,
) -> Result<Tallies, SweepError> {
    let Progress { mut store, done, mut tallies, part } = progress;
    let already: BTreeSet<u64> = done.ahead.keys().copied().collect();
    let work = Work { scenario, grid, part, first: done.before, done: &already, jobs, interrupt };
    let (mut ended, begun, all) = (done.count, done.runs(), part.runs(grid));
    let (mut next, mut waiting) = (part.next(grid, done.before), done.ahead);
    let (since, mut live, mut flushed) = (Stopwatch::start(), Live::new(show), Stopwatch::start());
    pool::run(work, |news| {
        match news {
            News::Row(run, row) => {
                waiting.insert(run, *row);
            }
            News::Defect(run) => return Err(SweepError::Defect(scenario.repeat(grid, run))),
            News::NoStart(run, error) => {
                let (repeat, error) = (scenario.repeat(grid, run), Box::new(error));
                return Err(SweepError::NoStart { repeat, error });
            }
            News::Nothing => {}
        }
        while let Some(row) = waiting.remove(&next) {
            tallies.add(grid.combination(next), &row);
            if let Some(store) = &mut store {
                store.write(next, &row)?;
            }
            (next, ended) = (part.next(grid, next + 1), ended + 1);
        }
        if flushed.elapsed() > FLUSH
            && let Some(store) = &mut store
        {
            store.flush()?;
            flushed = Stopwatch::start();
        }
        live.show(|| {
            bar(begun, ended + waiting.len() as u64, all, tallies.totals().1, since.elapsed().as_secs_f64())
        });
        Ok(())
    })?;
    drop(live);
    // After an interruption, runs that other threads completed after the first missing one.
    for (run, row) in waiting {
        tallies.add(grid.combination(run), &row);
        if let Some(store) = &mut store {
            store.write(run, &row)?;
        }
    }
    if let Some(store) = &mut store {
        store.flush()?;
    }
    Ok(tallies)
}

/// Formats the progress line of runs: those done before this command and now, all, violations, and the time taken in seconds.
pub fn bar(begun: u64, now: u64, all: u64, violations: u64, took: f64) -> String {
    const WIDTH: u64 = 10;
    let filled = (now * WIDTH / all.max(1)) as usize;
    let mut line = format!(
        "[{:·<width$}] {:>3}%  {} of {}",
        "#".repeat(filled),
        now * 100 / all.max(1),
        count(now),
        many(all, "run"),
        width = WIDTH as usize
    );
    if violations > 0 {
        line += &format!("  {}", many(violations, "violation"));
    }
    if now > begun {
        line += &format!("  {} left", seconds((all - now) as f64 * took / (now - begun) as f64));
    }
    line + "  " + &rate(now - begun, took)
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_scenario::grid::MAX_RUNS;

    #[test]
    fn the_line_says_how_far_a_sweep_has_come() {
        assert_eq!(
            bar(0, 500, 1_000, 0, 10.0),
            "[#####·····]  50%  500 of 1,000 runs  10.0 s left  50 a second"
        );
        assert_eq!(bar(7, 7, 1_000, 1, 0.0), "[··········]   0%  7 of 1,000 runs  1 violation  0 a second");
        let most = bar(0, MAX_RUNS - 1, MAX_RUNS, MAX_RUNS, 1e9);
        assert!(most.split("  ").take(4).collect::<Vec<_>>().join("  ").chars().count() < 80, "{most}");
    }
}
