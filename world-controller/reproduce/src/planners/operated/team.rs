//! One scripted operator and several swarms that it has to serve, simulated side by side.

use metamorph_families::metamodule::Metamodules;
use metamorph_families::runnable::Runnable;
use metamorph_families::simulated::simulation;
use metamorph_protocol::time::{Span, Time};
use metamorph_scenario::Plan;
use metamorph_sim_bridge::director::commands::{COMMAND_INPUT, Commands};
use metamorph_sim_bridge::director::operator::{Habits, Level, Operator, Scene};
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::team::{Measures, TeamLog};
use metamorph_sim_bridge::kernel::sim::Sim;
use metamorph_sim_bridge::metamodule::director::MetamoduleDirector;
use metamorph_sim_bridge::metamodule::world::MetamoduleWorld;
use metamorph_text::format::percent;
use std::ops::Range;

/// Time of a standstill after which a swarm of a team ends. It is long, since the swarm waits for its operator.
const STALL: Span = Span::secs(1200);
/// Scenario time at which a run ends in any case.
const TIMEOUT: Time = Time(7_200_000_000_000);
/// The operator's number.
const OPERATOR: u16 = 1;

type Swarm = Sim<MetamoduleWorld, MetamoduleDirector>;

/// Swarms and their operator, if they have one.
pub struct Team {
    swarms: Vec<Swarm>,
    operator: Option<Operator>,
}

/// The result of a team.
#[derive(Clone, Debug)]
pub struct TeamResult {
    built: Vec<Option<Time>>,
    commands: u64,
    log: Option<TeamLog>,
    violations: u64,
}

/// The results of several teams.
#[derive(Clone, Debug, Default)]
pub struct Results {
    /// Swarms in all.
    pub swarms: u64,
    /// Those that built their goal.
    pub built: u64,
    /// Interactions.
    pub interactions: u64,
    commands: u64,
    violations: u64,
    /// Of those built (s).
    times: Vec<f64>,
    /// The logs of all teams, one after the other.
    measures: Option<Measures>,
}

impl Team {
    /// Creates a team of a swarm for each seed.
    pub fn new(plan: &Plan, level: Option<Level>, seeds: Range<u64>) -> Team {
        let size = (seeds.end - seeds.start) as usize;
        let first = seeds.start;
        let window = plan.swarm.own::<Metamodules>().setup().params.patience * 3;
        let mut plan = plan.clone();
        if level.is_some() {
            plan.stop.stall = STALL;
            (plan.stop.livelock, plan.stop.timeout) = (STALL * 2, TIMEOUT);
        }
        // A seed without a start has another one instead, as in a sweep of starts that are drawn.
        let with_seed = |seed| plan.with_seed(seed).unwrap_or_else(|_| plan.clone());
        let swarms = seeds.map(|seed| simulation::<Metamodules>(&with_seed(seed))).collect();
        let habits = level.map(|level| Habits { level, ..Habits::usual(window) });
        Team { swarms, operator: habits.map(|habits| Operator::new(habits, size, first)) }
    }

    /// Runs all swarms to their ends.
    pub fn run(mut self) -> TeamResult {
        let mut now = Time::ZERO;
        let mut over = vec![false; self.swarms.len()];
        // The operator's eyes are as fast as a page.
        let step = Span::secs(1);
        while over.iter().any(|over| !over) {
            now = match &self.operator {
                Some(operator) => operator.wake_at().max(now + Span(1)).min(now + step),
                None => now + step * 10,
            };
            for (swarm, over) in self.swarms.iter_mut().zip(&mut over).filter(|(_, over)| !**over) {
                *over = swarm.run_until(now);
            }
            self.attend(now);
        }
        let built = |swarm: &Swarm| {
            swarm
                .director()
                .monitor()
                .outcome()
                .filter(|(_, outcome)| *outcome == Outcome::Built)
                .map(|(at, _)| at)
        };
        TeamResult {
            built: self.swarms.iter().map(built).collect(),
            commands: self.operator.as_ref().map_or(0, |operator| operator.counts().commands),
            log: self.operator.as_ref().map(|operator| operator.log(now)),
            violations: self.swarms.iter().map(|swarm| swarm.violations().1).sum(),
        }
    }

    /// Lets the operator look and command.
    fn attend(&mut self, now: Time) {
        let Some(operator) = &mut self.operator else { return };
        let pictures: Vec<_> = self.swarms.iter().map(|s| s.director().picture(s.world())).collect();
        let scenes: Vec<&dyn Scene> = pictures.iter().map(|picture| picture as &dyn Scene).collect();
        let acts = operator.step(now, &scenes);
        for act in acts {
            let at = now + Span(1);
            let commands = Commands { at, operator: OPERATOR, faults: vec![act.command] };
            if self.swarms[act.swarm].input(COMMAND_INPUT, commands.to_string().as_bytes()).is_err() {
                operator.refused();
            }
        }
    }
}

impl Results {
    /// Adds up teams.
    pub fn of(teams: impl Iterator<Item = TeamResult>) -> Results {
        let (mut all, mut joined, mut units) = (Results::default(), None::<TeamLog>, 0);
        for team in teams {
            all.swarms += team.built.len() as u64;
            all.times.extend(team.built.iter().flatten().map(|at| at.as_secs_f64()));
            all.commands += team.commands;
            all.violations += team.violations;
            // Each unit keeps its own operator and times: measures compare them with the same unit only.
            if let Some(mut log) = team.log {
                let first = units;
                units += team.built.len() as u32;
                let moved = log.units.into_iter().map(|(unit, mut log_of_it)| {
                    log_of_it.done = log_of_it.done.or(Some(log.end));
                    (unit + first, log_of_it)
                });
                log.units = moved.collect();
                log.interactions.iter_mut().for_each(|i| i.unit += first);
                match &mut joined {
                    None => joined = Some(log),
                    Some(all) => {
                        all.end = all.end.max(log.end);
                        all.units.extend(log.units);
                        all.interactions.extend(log.interactions);
                    }
                }
            }
        }
        all.built = all.times.len() as u64;
        all.measures = joined.map(|log| log.measures());
        all.interactions = all.measures.as_ref().map_or(0, |measures| measures.interactions);
        all
    }

    /// The share of the swarms that built their goal.
    pub fn built_share(&self) -> f64 {
        self.built as f64 / self.swarms.max(1) as f64
    }
    /// The efficiency: goals per second of those that were built.
    pub fn efficiency(&self) -> f64 {
        if self.times.is_empty() {
            f64::NAN
        } else {
            self.times.len() as f64 / self.times.iter().sum::<f64>()
        }
    }
    /// True unless significantly fewer swarms were built than with one swarm (95 %, by normal approximation).
    pub fn built_as_often_as(&self, other: &Results) -> bool {
        let (a, b) = (self.built_share(), other.built_share());
        let variance = a * (1.0 - a) / self.swarms.max(1) as f64 + b * (1.0 - b) / other.swarms.max(1) as f64;
        a + 1.96 * variance.sqrt() >= b
    }
    /// The fan-out that follows from interaction and neglect times; `None` if nothing was to be measured.
    pub fn predicted(&self) -> Option<u64> {
        self.measures.as_ref().and_then(|measures| measures.fan_out)
    }

    /// The row.
    pub fn text(&self) -> String {
        let time = self.times.iter().sum::<f64>() / self.times.len().max(1) as f64;
        let mut text = format!("{} built in {time:.0} s", percent(self.built_share()));
        if let Some(m) = &self.measures {
            let seconds = |ns: Option<f64>| ns.map_or("-".to_owned(), |ns| format!("{:.1}", ns / 1e9));
            let of_each = |n: u64| n as f64 / self.swarms.max(1) as f64;
            text += &format!(
                "; {:.2} interactions and {:.2} commands each, {} failed; IT {} s, NT {} s (median {}), WT {} s, RAD {}, FO {}",
                of_each(m.interactions),
                of_each(self.commands),
                m.failed,
                seconds(m.interaction_mean),
                seconds(m.neglect_mean),
                m.neglect_median.map_or("none".to_owned(), |ns| format!("{:.0}", ns as f64 / 1e9)),
                seconds(m.wait_mean),
                m.attention_demand.map_or("-".to_owned(), |share| format!("{share:.3}")),
                m.fan_out.map_or("unbounded".to_owned(), |n| n.to_string()),
            );
        }
        if self.violations > 0 {
            text += &format!("; {} violations", self.violations);
        }
        text
    }
}
