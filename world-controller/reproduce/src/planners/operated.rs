//! The cost of an operator (thesis, appendix E): the strategies with and without a scripted operator, and the number of
//! swarms that one operator serves.

mod team;

use super::PlannerTable;
use super::trials::in_parallel;
use crate::error::ReproduceError;
use crate::{Experiment, Goal, Request};
use metamorph_console::interrupt::Interrupt;
use metamorph_experiments::sweep::SweepError;
use metamorph_processes::family::read_text;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_report::statistics::Rate;
use metamorph_scenario::settings::Setting;
use metamorph_scenario::{LinkKind, Overrides, Plan};
use metamorph_sim_bridge::director::operator::Level;
use metamorph_text::format::{count, percent};
use std::collections::BTreeMap;
use std::convert::Infallible;
use team::{Results, Team};

/// The share of the seeds that are run: an operator is attended to for much longer than a run takes without.
const OF_SEEDS: u64 = 10;
/// The numbers of swarms of one operator.
const SIZES: [u64; 6] = [1, 2, 4, 8, 16, 32];
/// The share of the efficiency with one swarm that counts as the same.
const EFFICIENT: f64 = 0.9;

/// Faults and settings of a run.
#[derive(Clone, Copy)]
struct Trouble {
    name: &'static str,
    settings: &'static [&'static str],
    faults: &'static str,
}

/// The reading of the thesis under which `greedy` was measured without an operator: metamodules do not let each other go
/// first.
const LOCKS_ALONE: &str = "nothing breaks, locks on swept cells alone";

const TROUBLES: [Trouble; 4] = [
    Trouble { name: "nothing breaks", settings: &[], faults: "" },
    Trouble {
        name: "one crash, one spare",
        settings: &["swarm.count=7", "protocol.relocate=true"],
        faults: "\n[[fault]]\ncrash = { count = 1, between = \"0s..90s\" }\n",
    },
    Trouble { name: "5 % of connections fail", settings: &["swarm.failed_connections=5%"], faults: "" },
    Trouble {
        name: LOCKS_ALONE,
        settings: &["protocol.precedence=off", "protocol.settled_repel=false"],
        faults: "",
    },
];

/// Targets of this project, each with the result found here: appendix E has no figures.
#[derive(Default)]
struct Targets {
    rows: Vec<(String, String, String)>,
}

/// Makes the table; an interrupted one has the rows so far.
///
/// # Errors
/// If the scenario cannot be read.
pub fn table(request: &Request, stop: &Interrupt) -> Result<PlannerTable, ReproduceError> {
    let mut table = PlannerTable::new(Experiment::Operated);
    let mut targets = Targets::default();
    let workers = Workers { request, stop };
    for trouble in &TROUBLES {
        table.row(format!("one swarm, {}", trouble.name), "", "");
        // That reading is of the published strategies.
        let is_read = |s: &Strategy| s.is_published() || trouble.name != LOCKS_ALONE;
        for strategy in Strategy::DISTRIBUTED.into_iter().filter(is_read) {
            let plan = plan(strategy, trouble)?;
            for level in [None, Some(Level::Full), Some(Level::Shared)] {
                let Some(found) = workers.teams(&plan, level, 1) else { return Ok(table) };
                let name = level.map_or("no operator", Level::name);
                table.row(format!("  {}, {name}", strategy.name()), "", found.text());
                targets.judge(strategy, level, trouble, &found);
            }
        }
    }
    for trouble in &TROUBLES[..2] {
        table.row(format!("several swarms, operator `shared`, {}", trouble.name), "", "");
        for strategy in Strategy::DISTRIBUTED {
            let plan = plan(strategy, trouble)?;
            let (mut first, mut most) = (None, 0);
            let (mut curve, mut predicted) = (Vec::new(), None);
            for size in SIZES {
                let Some(found) = workers.teams(&plan, Some(Level::Shared), size) else { return Ok(table) };
                let alone: &Results = first.get_or_insert_with(|| found.clone());
                predicted = predicted.or(found.predicted());
                let (built, efficiency) = (found.built_share(), found.efficiency() / alone.efficiency());
                if most + 1 >= size || most * 2 == size {
                    let holds = efficiency >= EFFICIENT && found.built_as_often_as(alone);
                    most = if holds { size } else { most };
                }
                curve.push(format!("{size}: {} built, {:.2}", percent(built), efficiency));
            }
            let predicted = predicted.map_or("unbounded".to_owned(), |fan_out| fan_out.to_string());
            let measured = if most == SIZES[5] { format!("{most} or more") } else { most.to_string() };
            table.row(
                format!("  {}", strategy.name()),
                "",
                format!("fan-out predicted {predicted}, measured {measured} ({})", curve.join("; ")),
            );
            targets.fan_out(strategy, trouble, most);
        }
    }
    table.row("targets", "", "");
    for (what, target, found) in targets.rows {
        table.row(what, "", found).target = target;
    }
    table.notes = vec![
        "appendix E has measures and no figures, so that nothing published stands beside ours; targets were set before the \
         runs, from tables 4.1 and 4.2 and from the argument for `negotiated`"
            .to_owned(),
        format!("{} swarms for each row, or as many as one operator has; kind SRS, the chair of six", count(request.seeds.div_ceil(OF_SEEDS))),
        "IT, NT, WT as in thesis E.2.2, with the swarm as the unit; NT by Kaplan and Meier; it is productive if any \
         metamodule of it has made progress within three moves"
            .to_owned(),
        "several swarms: the efficiency relative to one swarm; a swarm ends by a standstill of 1200 s only".to_owned(),
        "the operator is a program: looks every 1 s, notices in 0.5 to 2 s, thinks for 1 to 4 s, acts in 0.5 to 1.5 s"
            .to_owned(),
    ];
    Ok(table)
}

fn plan(strategy: Strategy, trouble: &Trouble) -> Result<Plan, ReproduceError> {
    let text = Goal::Chair.text().to_owned() + trouble.faults;
    let fixed = ["swarm.kind=SRS".to_owned(), format!("protocol.strategy={}", strategy.name())];
    let settings = fixed.into_iter().chain(trouble.settings.iter().map(|&text| text.to_owned()));
    let settings = settings.map(|text| Setting { option: "--set", text }).collect();
    let overrides = Overrides { link: LinkKind::Sim, settings, ..Overrides::default() };
    Ok(read_text("chair.toml", &text, &overrides).map_err(SweepError::Scenario)?)
}

/// Threads that run teams.
struct Workers<'a> {
    request: &'a Request,
    stop: &'a Interrupt,
}

impl Workers<'_> {
    /// Runs teams of `size` swarms each, as many swarms as seeds; `None` if that was interrupted.
    fn teams(&self, plan: &Plan, level: Option<Level>, size: u64) -> Option<Results> {
        let teams: Vec<u64> = (0..self.request.seeds.div_ceil(OF_SEEDS).div_ceil(size)).collect();
        // Sums of floating point depend on the order.
        let mut results = BTreeMap::new();
        let run = |team: &u64| Some(Team::new(plan, level, team * size..(team + 1) * size).run());
        let Ok(()) = in_parallel::<_, _, Infallible>(&teams, (self.request.jobs, self.stop), run, |ended| {
            results.extend(ended);
            Ok(())
        });
        (results.len() == teams.len()).then(|| Results::of(results.into_values()))
    }
}

impl Targets {
    fn judge(&mut self, strategy: Strategy, level: Option<Level>, trouble: &Trouble, found: &Results) {
        let rate = |successes: u64, trials: u64| {
            let interval = Rate::wilson(successes, trials);
            interval.map_or("-".to_owned(), |r| {
                format!("{} ({} to {})", percent(r.rate), percent(r.low), percent(r.high))
            })
        };
        let is_other_reading = trouble.name == LOCKS_ALONE;
        if trouble.settings.is_empty() || is_other_reading {
            let built = rate(found.built, found.swarms);
            let target = match (strategy, level) {
                (Strategy::Greedy, None) => Some("8 %"),
                (Strategy::Greedy, Some(Level::Shared)) => Some("at least 95 %"),
                (Strategy::Slope | Strategy::Step, Some(Level::Shared)) => Some("at least 99 %"),
                _ => None,
            };
            let name = level.map_or("no operator", Level::name);
            self.rows.extend(target.map(|target| {
                let reading = if is_other_reading { ", locks alone" } else { "" };
                let what = format!("  {} builds, {name}{reading}", strategy.name());
                (what, target.to_owned(), built)
            }));
            if strategy == Strategy::Negotiated && level == Some(Level::Shared) && !is_other_reading {
                let found = format!("{} in {} runs", found.interactions, count(found.swarms));
                self.rows.push(("  negotiated needs interventions".to_owned(), "0".to_owned(), found));
            }
        }
    }
    fn fan_out(&mut self, strategy: Strategy, trouble: &Trouble, most: u64) {
        if strategy == Strategy::Negotiated && !trouble.faults.is_empty() {
            let what = "  fan-out of negotiated, one crash each".to_owned();
            self.rows.push((what, "at least 32".to_owned(), most.to_string()));
        }
    }
}
