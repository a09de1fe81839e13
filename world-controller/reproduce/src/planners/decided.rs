//! The shares of placement, strategy, random numbers of agents and network in whether the swarms of 4.1.3 build box and chair.
//!
//! Each placement has four runs under each strategy: two in which everything that draws is reseeded at the start, and two in which
//! links alone are. The covariance of the two of a pair over placements estimates, without bias, the variance of what both have in common:
//! of the first pair the placement, of the second one also the random numbers of agents. Divided by p(1 − p), the variance of one
//! outcome, it is the share that this decides. The covariance of runs under two strategies estimates what a placement
//! decides under every strategy.

use super::PlannerTable;
use super::sample::{interval, samples};
use super::trials::{Hands, Kept};
use crate::error::ReproduceError;
use crate::{Experiment, Goal, Request};
use metamorph_console::interrupt::Interrupt;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_experiments::sweep::SweepError;
use metamorph_processes::family::{read_text, simulate};
use metamorph_report::plots;
use metamorph_report::statistics::Rate;
use metamorph_scenario::settings::Setting;
use metamorph_scenario::{LinkKind, Overrides, Plan};
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::kernel::change::{Change, ChangeKind};
use metamorph_text::format::percent;

/// The strategies of the thesis.
const STRATEGIES: [&str; 3] = ["greedy", "slope", "step"];
/// The changes of the runs of a placement under a strategy: two in which everything is reseeded, and two in which links are.
const RUNS: [ChangeKind; 4] =
    [ChangeKind::All(1), ChangeKind::All(2), ChangeKind::Links(3), ChangeKind::Links(4)];

/// Whether each run of a placement was built, by strategy and by run.
type Placement = [[bool; RUNS.len()]; STRATEGIES.len()];

/// Runs one placement; `None` if that was interrupted.
fn run(plans: &[Plan], seed: u64, stop: &Interrupt) -> Option<Placement> {
    let mut built = Placement::default();
    for (plan, of_strategy) in plans.iter().zip(&mut built) {
        for (kind, built) in RUNS.into_iter().zip(of_strategy) {
            let mut plan = plan.with_seed(seed).expect("invariant: there is a random start for every seed");
            plan.add_change(Change { after: 0, kind });
            let (report, result) = simulate(&plan, Stopwatch::start(), &mut |_, _| !stop.is_set());
            if result.ended.is_none() && stop.is_set() {
                return None;
            }
            *built = report.outcome == Outcome::Built.name();
        }
    }
    Some(built)
}

/// Sums over placements, from which every share follows.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    placements: f64,
    /// Built runs, by strategy and by run.
    built: [[f64; RUNS.len()]; STRATEGIES.len()],
    /// Placements of which both runs of a pair were built, by strategy: of those with all reseeded, and with links reseeded.
    both: [[f64; 2]; STRATEGIES.len()],
    /// Placements of which the first run under one strategy and the second under another were built, by pair of strategies.
    across: [[f64; STRATEGIES.len()]; STRATEGIES.len()],
}

/// The shares that decide the outcome under one strategy, or under one drawn from all: of the variance of one outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Shares {
    /// The share of built runs.
    built: f64,
    /// The share of the placement; under any strategy, that of its mean over strategies.
    placement: f64,
    /// The share of the strategy, in the mean over placements; 0 under one.
    strategy: f64,
    /// The share of the placement that differs between strategies; 0 under one.
    interplay: f64,
    /// The share of the random numbers of agents.
    agents: f64,
    /// The share of the random numbers of links, also as they combine with the others.
    network: f64,
}

impl Sums {
    fn of<'p>(placements: impl Iterator<Item = &'p Placement>) -> Sums {
        let mut sums = Sums::default();
        for placement in placements {
            sums.placements += 1.0;
            for (s, runs) in placement.iter().enumerate() {
                for (sum, built) in sums.built[s].iter_mut().zip(runs) {
                    *sum += f64::from(*built);
                }
                for (sum, pair) in sums.both[s].iter_mut().zip(runs.chunks(2)) {
                    *sum += f64::from(pair.iter().all(|built| *built));
                }
                for (sum, other) in sums.across[s].iter_mut().zip(placement) {
                    *sum += f64::from(runs[0] && other[1]);
                }
            }
        }
        sums
    }

    /// Returns the unbiased covariance of two kinds of runs: of which `both` were built together, and `a` and `b` alone.
    fn covariance(&self, both: f64, a: f64, b: f64) -> f64 {
        (both - a * b / self.placements) / (self.placements - 1.0).max(1.0)
    }
    fn share_built(&self, s: usize) -> f64 {
        self.built[s].iter().sum::<f64>() / (self.placements * RUNS.len() as f64)
    }
    /// Returns the variances of what the two runs of each pair have in common.
    fn common(&self, s: usize) -> [f64; 2] {
        let pair =
            |i: usize| self.covariance(self.both[s][i], self.built[s][2 * i], self.built[s][2 * i + 1]);
        [pair(0), pair(1)]
    }

    /// Returns the shares under one strategy; `None` if all runs end alike.
    fn under(&self, s: usize) -> Option<Shares> {
        let built = self.share_built(s);
        let variance = built * (1.0 - built);
        if variance <= 0.0 {
            return None;
        }
        let [placement, and_agents] = self.common(s).map(|common| common / variance);
        let (agents, network) = (and_agents - placement, 1.0 - and_agents);
        Some(Shares { built, placement, agents, network, ..Shares::default() })
    }

    /// Returns the shares under one of the strategies that is drawn; `None` if all runs end alike.
    fn under_any(&self) -> Option<Shares> {
        let n = STRATEGIES.len();
        let mean = |of: &dyn Fn(usize) -> f64| (0..n).map(of).sum::<f64>() / n as f64;
        let built = mean(&|s| self.share_built(s));
        let variance = built * (1.0 - built);
        if variance <= 0.0 {
            return None;
        }
        let of_strategies = mean(&|s| (self.share_built(s) - built).powi(2));
        let pairs = (0..n).flat_map(|s| (0..n).filter(move |other| *other != s).map(move |other| (s, other)));
        let alike =
            pairs.map(|(s, o)| self.covariance(self.across[s][o], self.built[s][0], self.built[o][1]));
        let alike = alike.sum::<f64>() / (n * (n - 1)) as f64;
        let [of_each, and_agents] = [0, 1].map(|i| mean(&|s| self.common(s)[i]));
        // The variance of the mean over strategies.
        let placement = (of_each + (n - 1) as f64 * alike) / n as f64;
        Some(Shares {
            built,
            placement: placement / variance,
            strategy: of_strategies / variance,
            interplay: (of_each - placement) / variance,
            agents: (and_agents - of_each) / variance,
            network: 1.0 - (of_strategies + and_agents) / variance,
        })
    }
}

/// Makes the table; an interrupted one has the placements so far.
///
/// # Errors
/// If the results cannot be kept.
pub fn table(request: &Request, stop: &Interrupt) -> Result<PlannerTable, ReproduceError> {
    let mut table = PlannerTable::new(Experiment::Why);
    let plan = |(goal, strategy): (Goal, &str)| {
        let setting = Setting { option: "--set", text: format!("protocol.strategy={strategy}") };
        let overrides = Overrides { link: LinkKind::Sim, settings: vec![setting], ..Overrides::default() };
        read_text(goal.name(), goal.text(), &overrides).map_err(SweepError::Scenario)
    };
    let mut plans: Vec<Vec<Plan>> = Vec::new();
    for goal in Goal::ALL {
        let of_goal = STRATEGIES.into_iter().map(|strategy| plan((goal, strategy)));
        plans.push(of_goal.collect::<Result<_, _>>()?);
    }
    let named =
        |seed: u64| move |(i, goal): (usize, Goal)| (format!("{}, seed {seed}", goal.name()), (i, seed));
    let trials: Vec<(String, (usize, u64))> =
        (0..request.seeds).flat_map(|seed| Goal::ALL.into_iter().enumerate().map(named(seed))).collect();
    let hands = Hands { name: "why", jobs: request.jobs, stop, show: !request.quiet };
    let kept = Kept::open(request.out.as_deref(), Experiment::Why.name())?;
    let results = kept.complete(&trials, hands, |(goal, seed)| run(&plans[*goal], *seed, stop))?;
    for (i, goal) in Goal::ALL.into_iter().enumerate() {
        let of_goal = trials.iter().zip(&results).filter(|((_, (of, _)), _)| *of == i);
        let placements: Vec<Placement> = of_goal.filter_map(|(_, result)| *result).collect();
        if placements.len() > 1 {
            add(&mut table, goal, &placements);
        }
    }
    table.notes = vec![
        "shares of the variance of one outcome, built or not. A share near 0 may be estimated as less than 0".to_owned(),
        "placement: of two runs of one placement in which everything that draws is reseeded at the start, the covariance over placements. Agents: of two runs in which links alone are, the covariance over placements, less that. Network: the rest".to_owned(),
        "any strategy: one of the three is drawn. The share of the placement is then that of its mean over strategies, and the rest of it, by which strategies differ, the interplay".to_owned(),
        "the first messages of agents, sent as they start, have the delays of the seed in all runs".to_owned(),
        "intervals by the bootstrap over placements".to_owned(),
    ];
    Ok(table)
}

/// Adds the rows of a goal.
fn add(table: &mut PlannerTable, goal: Goal, placements: &[Placement]) {
    type Of = fn(&Shares) -> f64;
    let parts: [(&str, Of); 6] = [
        ("built", |s| s.built),
        ("decided by placement", |s| s.placement),
        ("by strategy", |s| s.strategy),
        ("by both together (interplay)", |s| s.interplay),
        ("by random numbers of agents", |s| s.agents),
        ("by the network", |s| s.network),
    ];
    let any = STRATEGIES.len();
    let shares = |sums: &Sums, s: usize| if s == any { sums.under_any() } else { sums.under(s) };
    let whole = Sums::of(placements.iter());
    let samples = samples(|rng| {
        let one = |_| &placements[rng.below(placements.len() as u64) as usize];
        Sums::of((0..placements.len()).map(one))
    });
    for s in 0..=any {
        let name = STRATEGIES.get(s).map_or("any strategy", |name| name);
        for (i, (part, of)) in parts.into_iter().enumerate() {
            // One strategy has neither.
            if s < any && (i == 2 || i == 3) {
                continue;
            }
            let drawn = samples.iter().filter_map(|sums| shares(sums, s).as_ref().map(of));
            let mut drawn: Vec<f64> = drawn.collect();
            drawn.sort_unstable_by(f64::total_cmp);
            let [low, high] = interval(&drawn);
            let Some(share) = shares(&whole, s).as_ref().map(of) else { continue };
            let what = if i == 0 { format!("{}, {name}: {part}", goal.name()) } else { format!("  {part}") };
            let within = |share: f64| share.clamp(0.0, 1.0);
            let rate = Rate { rate: within(share), low: within(low), high: within(high) };
            let label = what.trim().to_owned();
            table.plotted.push(plots::Row { label, begins: i == 0, value: Some(rate) });
            let row = table.row(what, "", percent(share));
            row.n = Some(placements.len() as u64);
            row.interval = format!("{} to {}", percent(low), percent(high));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::rng::Rng;

    /// Placements whose outcome follows from known parts: each is drawn with `chance` out of 100, and all must hold.
    fn drawn(n: u64, outcome: impl Fn(&mut Rng, usize) -> [bool; 4]) -> Sums {
        let placements: Vec<Placement> = (0..n)
            .map(|i| {
                let mut built = Placement::default();
                for (s, of) in built.iter_mut().enumerate() {
                    // The same placement under every strategy.
                    *of = outcome(&mut Rng::named(i, "placement", 0), s);
                }
                built
            })
            .collect();
        Sums::of(placements.iter())
    }

    fn close(share: f64, expected: f64) {
        assert!((share - expected).abs() < 0.03, "{share} is not {expected}");
    }

    #[test]
    fn what_the_placement_decides_alone_is_its_share() {
        let sums = drawn(20_000, |placement, _| [placement.below(100) < 40; 4]);
        for shares in [sums.under(0), sums.under(2), sums.under_any()].map(Option::unwrap) {
            close(shares.built, 0.4);
            close(shares.placement, 1.0);
            close(shares.network + shares.agents + shares.strategy + shares.interplay, 0.0);
        }
    }

    #[test]
    fn what_is_drawn_for_each_run_is_the_share_of_the_network() {
        let sums = drawn(20_000, |run, s| {
            for _ in 0..s {
                run.next_u64();
            }
            [0; 4].map(|_| run.below(100) < 30)
        });
        let shares = sums.under(1).unwrap();
        close(shares.network, 1.0);
        close(shares.placement, 0.0);
    }

    /// Half of the placements cannot be built; the others are by three of four runs.
    #[test]
    fn mixed_parts_are_told_apart() {
        let sums = drawn(40_000, |random, _| {
            let possible = random.below(2) == 0;
            [0; 4].map(|_| possible && random.below(4) < 3)
        });
        let shares = sums.under(0).unwrap();
        // p = 3/8; the variance of the placement's expectation is (3/8)², that of an outcome 15/64.
        close(shares.built, 0.375);
        close(shares.placement, 9.0 / 15.0);
        close(shares.network, 6.0 / 15.0);
    }

    #[test]
    fn random_numbers_of_agents_are_those_that_links_do_not_reseed() {
        let sums = drawn(40_000, |random, _| {
            let [first, second, own] = [0; 3].map(|_| random.below(2) == 0);
            [first, second, own, own]
        });
        let shares = sums.under(0).unwrap();
        close(shares.agents, 1.0);
        close(shares.placement, 0.0);
    }

    #[test]
    fn a_strategy_that_always_builds_is_told_from_the_placement() {
        // One of three strategies always builds, the others never: p = 1/3, all of it decided by the strategy.
        let sums = drawn(1_000, |_, s| [s == 1; 4]);
        close(sums.under_any().unwrap().strategy, 1.0);
        assert_eq!(sums.under(0), None, "all runs end alike");
        // Each placement can be built either under one strategy or under the two others: the mean over strategies is 1/3 or 2/3.
        let sums = drawn(20_000, |random, s| [(random.below(2) == 0) == (s == 1); 4]);
        let shares = sums.under_any().unwrap();
        close(shares.placement, 1.0 / 9.0);
        close(shares.interplay, 8.0 / 9.0);
    }
}
