//! Stoy's experiment as the thesis tells it (4.1.2): a square slab becomes a disc, and the disc a ball. Time and moves over the
//! number of modules, the share of gradient messages, and how safe the published connectivity rule is.

use super::PlannerTable;
use super::sample::{Ratios, interval, resampled};
use super::trials::{Hands, Kept};
use crate::error::ReproduceError;
use crate::{Experiment, Request};
use metamorph_console::interrupt::Interrupt;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_experiments::sweep::SweepError;
use metamorph_experiments::sweep::row::Row;
use metamorph_processes::family::{read_text, simulate};
use metamorph_report::statistics::PowerLaw;
use metamorph_scenario::settings::Setting;
use metamorph_scenario::{LinkKind, Overrides, Plan};
use metamorph_sim_bridge::director::outcome::Outcome;
use serde::{Deserialize, Serialize};

/// Lengths of a side of the slab in modules; it is two modules thick.
const SIDES: [u32; 4] = [9, 13, 18, 23];
/// The seeds of each size at most: the largest runs take seconds.
const SEEDS_MAX: u64 = 20;
/// The seeds of each delay of the published rule at most.
const RULE_SEEDS_MAX: u64 = 300;
/// The times that a message takes, each with its name. All take the same time in a world of synchronous steps. None takes no time:
/// modules that speak in every step may then exchange messages without an end.
const DELAYS: [(&str, &str); 5] = [
    ("1ms", "1 ms each"),
    ("10ms", "10 ms each"),
    ("50ms", "50 ms each"),
    ("5ms..20ms", "5 to 20 ms"),
    ("50ms..200ms", "50 to 200 ms"),
];

/// The result of one run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Run {
    built: bool,
    violations: u64,
    /// Scenario time in moves.
    time: u64,
    moves: u64,
    /// Messages of class gradient, and of all classes.
    gradient: u64,
    messages: u64,
}

/// One run to be carried out.
enum Trial {
    /// Of this size, with this seed.
    Growth(usize, u64),
    /// With messages of this delay, by the published rule.
    Rule(usize, u64),
}

/// Returns the scenario of a size: a slab, a disc of as many cells as two thirds of its modules, and a ball of about as many.
fn growth_text(side: u32) -> String {
    let modules = f64::from(side * side * 2);
    let middle = side / 2;
    let disc = libm::sqrt(modules * 0.96 / 2.0 / std::f64::consts::PI);
    let ball = libm::cbrt(modules * 0.84 * 3.0 / 4.0 / std::f64::consts::PI * 2.0);
    format!(
        "version = 1\nname = \"stoy\"\n[swarm]\nstart = {{ box = {{ min = [0, 0, 0], max = [{0}, {0}, 1] }} }}\nmove_time = \"1s\"\n\
         [[goal]]\nname = \"disc\"\nshape = {{ cylinder = {{ base = [{middle}, {middle}, 0], radius = {disc:.1}, height = 3 }} }}\n\
         seed = [{middle}, {middle}, 0]\ngrowth = \"scaffold\"\n\
         [[goal]]\nname = \"ball\"\nshape = {{ sphere = {{ center = [{middle}, {middle}, 0], radius = {ball:.1} }} }}\ngrowth = \"scaffold\"\n\
         [stop]\ntimeout = \"20000s\"\n",
        side - 1
    )
}

/// The scenario for the published rule: a plate of 7 by 6 modules becomes a scaffolded block.
const RULE: &str = include_str!("stoy.toml");

fn plan(name: &str, text: &str, settings: &[String]) -> Result<Plan, ReproduceError> {
    let setting = |text: &String| Setting { option: "--set", text: text.clone() };
    let overrides = Overrides {
        link: LinkKind::Sim,
        settings: settings.iter().map(setting).collect(),
        ..Overrides::default()
    };
    Ok(read_text(name, text, &overrides).map_err(SweepError::Scenario)?)
}

/// Runs a scenario with a seed; `None` if that was interrupted.
fn run(plan: &Plan, seed: u64, stop: &Interrupt) -> Option<Run> {
    let plan = plan.with_seed(seed).expect("invariant: a start without randomness is possible with any seed");
    let (report, result) = simulate(&plan, Stopwatch::start(), &mut |_, _| !stop.is_set());
    // An interrupted run is no result.
    if result.ended.is_none() && stop.is_set() {
        return None;
    }
    let row = Row::of(&report);
    Some(Run {
        built: row.outcome == Outcome::Built,
        violations: row.violations,
        // A move takes a second.
        time: row.makespan_s.unwrap_or(row.end_s).round() as u64,
        moves: row.moves,
        gradient: row.sent_gradient,
        messages: row.messages(),
    })
}

/// Makes the table; an interrupted one has the runs so far.
///
/// # Errors
/// If the scenario cannot be read, or the results cannot be kept.
pub fn table(request: &Request, stop: &Interrupt) -> Result<PlannerTable, ReproduceError> {
    let mut table = PlannerTable::new(Experiment::Stoy);
    let growths: Vec<Plan> =
        SIDES.into_iter().map(|side| plan("stoy.toml", &growth_text(side), &[])).collect::<Result<_, _>>()?;
    let rule = |(delay, _): (&str, _)| {
        let settings = ["protocol.connectivity=gradient".to_owned(), format!("link.delay={delay}")];
        plan("plate.toml", RULE, &settings)
    };
    let rules: Vec<Plan> = DELAYS.into_iter().map(rule).collect::<Result<_, _>>()?;
    let mut trials: Vec<(String, Trial)> = Vec::new();
    for seed in 0..request.seeds.min(SEEDS_MAX) {
        trials.extend(
            (0..SIDES.len()).map(|i| (format!("side {}, seed {seed}", SIDES[i]), Trial::Growth(i, seed))),
        );
    }
    for seed in 0..request.seeds.min(RULE_SEEDS_MAX) {
        let named = |i: usize| (format!("delay {}, seed {seed}", DELAYS[i].0), Trial::Rule(i, seed));
        trials.extend((0..DELAYS.len()).map(named));
    }
    let hands = Hands { name: "stoy", jobs: request.jobs, stop, show: !request.quiet };
    let kept = Kept::open(request.out.as_deref(), Experiment::Stoy.name())?;
    let results = kept.complete(&trials, hands, |trial| match trial {
        Trial::Growth(i, seed) => run(&growths[*i], *seed, stop),
        Trial::Rule(i, seed) => run(&rules[*i], *seed, stop),
    })?;
    let (mut of_size, mut of_delay) = (SIDES.map(|_| Vec::new()), DELAYS.map(|_| Vec::new()));
    for ((_, trial), result) in trials.iter().zip(results) {
        let Some(run) = result else { continue };
        match trial {
            Trial::Growth(i, _) => of_size[*i].push(run),
            Trial::Rule(i, _) => of_delay[*i].push(run),
        }
    }
    grown(&mut table, &of_size);
    for ((_, name), runs) in DELAYS.into_iter().zip(&of_delay) {
        let safe = (runs.iter().filter(|r| r.violations == 0).count() as u64, runs.len() as u64);
        table.share(format!("the published rule, delay of messages: {name}: safe"), "proved", safe);
    }
    table.notes = vec![
        "a square slab, two modules thick, becomes a disc and then a ball; seeds and scaffold as in `metamorph run stoy`".to_owned(),
        "one step of the published simulation is one move here; messages take 50 to 200 ms of it, and cubes ask before they move".to_owned(),
        "\"almost linear\" and \"faster than linear\" are statements about figures without numbers".to_owned(),
        "the published rule (`protocol.connectivity = \"gradient\"`): a module leaves when no neighbour's concentration depends on it, and has none from the moment at which it wants to leave. Where all messages take the same time, as in synchronous steps, the later of two modules that hold a third hears in time that the third depends on it now. With different delays it may hear too late. Parents that are registered (`forest`, the default) need no equal delays".to_owned(),
    ];
    Ok(table)
}

/// Adds the rows of the growth.
fn grown(table: &mut PlannerTable, of_size: &[Vec<Run>]) {
    let modules = |i: usize| u64::from(SIDES[i] * SIDES[i] * 2);
    for (i, runs) in of_size.iter().enumerate() {
        let built = (runs.iter().filter(|r| r.built).count() as u64, runs.len() as u64);
        table.share(format!("{} modules: built", modules(i)), "100 %", built);
        let of = |value: fn(&Run) -> u64| Ratios::new(runs.iter().filter(|r| r.built).map(|r| (value(r), 1)));
        table.ratio("  time in moves, mean", "", &of(|r| r.time));
        table.ratio("  moves, mean", "", &of(|r| r.moves));
    }
    let (time, moves) = (exponent(of_size, |r| r.time), exponent(of_size, |r| r.moves));
    for (what, published, found) in [
        ("time grows as N to the power of", "almost 1", time),
        ("moves grow as N to the power of", "above 1", moves),
    ] {
        let Some((exponent, [low, high])) = found else { continue };
        let row = table.row(what, published, format!("{exponent:.2}"));
        row.n = Some(of_size.iter().map(Vec::len).sum::<usize>() as u64);
        row.interval = format!("{low:.2} to {high:.2}");
    }
    let shares = of_size.iter().flatten().map(|r| (100 * r.gradient, r.messages));
    table.ratio("messages that carry gradients, percent", "the majority", &Ratios::new(shares));
}

/// Returns the exponent of the power law that fits best through the means of all sizes, with its 95 % interval over samples of the
/// runs; `None` if a size has no run that was built.
fn exponent(of_size: &[Vec<Run>], value: fn(&Run) -> u64) -> Option<(f64, [f64; 2])> {
    let built = |runs: &Vec<Run>| runs.iter().filter(|r| r.built).map(|r| value(r) as f64).collect();
    let values: Vec<Vec<f64>> = of_size.iter().map(built).collect();
    if values.iter().any(Vec::is_empty) {
        return None;
    }
    let through = |values: &[Vec<f64>]| {
        let sizes = SIDES.iter().map(|side| f64::from(side * side * 2));
        let means = values.iter().map(|v| v.iter().sum::<f64>() / v.len() as f64);
        PowerLaw::of(&sizes.zip(means).collect::<Vec<_>>()).map(|law| law.exponent)
    };
    let exponent = through(&values)?;
    let drawn = resampled(|rng| {
        let mut one = |v: &[f64]| v[rng.below(v.len() as u64) as usize];
        let sample: Vec<Vec<f64>> = values.iter().map(|v| v.iter().map(|_| one(v)).collect()).collect();
        through(&sample).unwrap_or(exponent)
    });
    Some((exponent, interval(&drawn)))
}
