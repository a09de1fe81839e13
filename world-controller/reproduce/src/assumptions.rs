//! Assumptions about what the thesis leaves open: each varied alone, as a sweep that can be repeated with
//! `metamorph sweep`. Absent: assumptions that need code, see [`NOT_OFFERED`].

use super::compare::Runs;
use super::published::{KINDS, STRATEGIES};
use super::{Goal, Sweeper};
use crate::error::ReproduceError;
use metamorph_protocol::metamodule::blueprint::SeedOrder;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_report::statistics::Rate;
use metamorph_scenario::grid::{Axis, Grid, Seeds};
use metamorph_sim_bridge::director::outcome::Outcome;
use serde::{Deserialize, Serialize};

/// Largest number of seeds of every combination of kind, strategy and order.
const SEEDS_MAX: u64 = 25;
/// Factor by which the number of the experiment's seeds is reduced.
const FEWER: u64 = 40;

/// Assumptions that were not varied, because the program does not support them.
pub const NOT_OFFERED: &str = "starts that are near, far, in slots, on one side or alike; enclosed starts kept; the \
     farther one goes first; noise on every choice; a random segment after a standstill; distance as the \
     crow flies; segments around every body and not only around those at rest; open seeds matched to the nearest \
     metamodules";

/// An assumption varied alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Assumption {
    /// A description.
    pub what: String,
    /// The option of `metamorph sweep` that sets it, in addition to those of the experiment; empty for the
    /// order of the seeds, which the experiment itself varies.
    pub vary: Vec<String>,
    /// The share built, for each goal and strategy.
    pub built: Vec<Built>,
}

/// Runs of a goal and strategy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Built {
    /// `box` or `chair`.
    pub goal: String,
    /// `greedy`, `slope` or `step`.
    pub strategy: String,
    /// Number of runs.
    pub runs: u64,
    /// The share that was built.
    pub built: Option<Rate>,
}

/// A key and its values.
struct Key {
    key: &'static str,
    values: fn(Goal) -> Vec<(&'static str, &'static str)>,
    strategies: &'static [Strategy],
}

const PUSHING: &[Strategy] = &[Strategy::Slope, Strategy::Step];

const KEYS: [Key; 7] = [
    Key {
        key: "protocol.precedence",
        values: |_| {
            vec![
                ("no precedence", "off"),
                ("precedence within 3, for all strategies", "{within=3,by=\"seed-distance\"}"),
                ("precedence within 4, for all strategies", "{within=4,by=\"seed-distance\"}"),
                ("precedence within 5, for all strategies", "{within=5,by=\"seed-distance\"}"),
                ("precedence by number within 4, for all", "{within=4,by=\"id\"}"),
            ]
        },
        strategies: &STRATEGIES,
    },
    Key {
        key: "protocol.settled_repel",
        values: |_| vec![("settled metamodules do not push", "false")],
        strategies: &STRATEGIES,
    },
    Key {
        key: "protocol.repulsion",
        values: |_| {
            vec![
                ("repulsion of strength 2.4 (4 times step's)", "{strength=2400}"),
                ("repulsion of strength 4 (4 times slope's)", "{strength=4000}"),
                ("repulsion within 8 cells", "{range=8}"),
            ]
        },
        strategies: PUSHING,
    },
    Key {
        key: "swarm.floor",
        values: |_| {
            vec![
                ("floor of 9 by 9", "{min=[2,2],max=[10,10]}"),
                ("floor of 17 by 17", "{min=[-2,-2],max=[14,14]}"),
                ("floor of 25 by 25", "{min=[-6,-6],max=[18,18]}"),
            ]
        },
        strategies: &STRATEGIES,
    },
    Key {
        key: "swarm.hearing",
        values: |_| vec![("communication over 9 connectors", "9")],
        strategies: &STRATEGIES,
    },
    Key {
        key: "swarm.count",
        values: |goal| match goal {
            Goal::Box => vec![("one spare metamodule", "5"), ("two spare metamodules", "6")],
            Goal::Chair => vec![("one spare metamodule", "7"), ("two spare metamodules", "8")],
        },
        strategies: &STRATEGIES,
    },
    Key {
        key: "stop.stall",
        values: |_| vec![("a standstill lasts 5 times as long", "600s")],
        strategies: &STRATEGIES,
    },
];

/// Returns the number of seeds for each combination, given the number in the experiment.
pub const fn seeds(of_experiment: u64) -> u64 {
    let fewer = of_experiment.div_ceil(FEWER);
    if fewer < SEEDS_MAX { fewer } else { SEEDS_MAX }
}

/// Returns the axes of kinds, strategies and orders.
pub fn axes(strategies: &[Strategy]) -> Vec<Axis> {
    let axis = |key: &str, values: Vec<&str>| Axis {
        key: key.to_owned(),
        values: values.into_iter().map(str::to_owned).collect(),
    };
    vec![
        axis("swarm.kind", KINDS.iter().map(|k| k.name()).collect()),
        axis("protocol.strategy", strategies.iter().map(|s| s.name()).collect()),
        axis("goal.0.order", SeedOrder::ALL.iter().map(|o| o.name()).collect()),
    ]
}

/// Runs a sweep for each assumption and each goal of `runs`. The effect of the order of seeds is taken from
/// `runs` themselves.
pub fn vary(
    runs: &Runs,
    seeds_of_experiment: u64,
    sweeper: &mut Sweeper<'_>,
) -> Result<Vec<Assumption>, ReproduceError> {
    let goals: Vec<Goal> = runs.of.iter().map(|(goal, _)| *goal).collect();
    let mut all = orders(runs, &goals);
    let seeds = Seeds { from: 0, until: seeds(seeds_of_experiment) };
    for Key { key, values, strategies } in KEYS {
        let first = all.len();
        for goal in &goals {
            let axis = Axis {
                key: key.to_owned(),
                values: values(*goal).iter().map(|(_, v)| (*v).to_owned()).collect(),
            };
            let mut vary = axes(strategies);
            vary.push(axis);
            let summary = sweeper.run(*goal, goal.text(), None, &Grid::new(seeds, vary)?)?;
            for (i, (what, value)) in values(*goal).into_iter().enumerate() {
                if all.len() <= first + i {
                    all.push(Assumption { what: what.to_owned(), vary: Vec::new(), built: Vec::new() });
                }
                let assumption = &mut all[first + i];
                let option = format!("{key}={value}");
                if !assumption.vary.contains(&option) {
                    assumption.vary.push(option);
                }
                for strategy in strategies {
                    let some = summary
                        .combinations
                        .iter()
                        .filter(|c| c.values[1] == strategy.name() && c.values[3] == value);
                    let (built, runs) =
                        some.fold((0, 0), |(b, n), c| (b + c.ended(Outcome::Built), n + c.runs));
                    assumption.built.push(of(*goal, *strategy, built, runs));
                }
            }
        }
    }
    Ok(all)
}

fn of(goal: Goal, strategy: Strategy, built: u64, runs: u64) -> Built {
    Built {
        goal: goal.name().to_owned(),
        strategy: strategy.name().to_owned(),
        runs,
        built: Rate::wilson(built, runs),
    }
}

/// Returns the effect of the order of seeds, from the runs of the experiment itself.
fn orders(runs: &Runs, goals: &[Goal]) -> Vec<Assumption> {
    let one = |order: SeedOrder| {
        let pairs = goals.iter().flat_map(|g| STRATEGIES.map(|s| (*g, s)));
        let built = pairs.map(|(goal, strategy)| {
            let ours = runs.pooled(|g, _, s, o| g == goal && s == strategy.name() && o == order.name());
            of(goal, strategy, ours.built, ours.runs)
        });
        Assumption { what: format!("order {}", order.name()), vary: Vec::new(), built: built.collect() }
    };
    SeedOrder::ALL.into_iter().map(one).collect()
}
