//! Runs of the thesis's experiment by name: goal, kind, strategy, order of seeds, seed, and variation. Many
//! are run at once; each with a wrong result is printed with the command that repeats it alone.
//!
//! The expected result depends on the strategy: those of the thesis deadlock, and only have to be safe and to
//! give a reason; `negotiated` has to build, unless something that it needs is lost for good.

use crate::metamodules::{Assembled, Assembly, Goal};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::SeedOrder;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::director::faults::{Fault, Target};
use metamorph_sim_bridge::metamodule::faults::{OBSTACLE, OBSTACLE_GONE};
use std::collections::BTreeMap;
use std::fmt;
use std::panic::catch_unwind;
use std::str::FromStr;
use std::sync::Mutex;
use std::thread;

/// A difficulty that is added to a run.
#[derive(Debug)]
pub struct Variation {
    /// The name.
    pub name: &'static str,
    /// True if something is lost for good, so that the goal may be beyond any protocol.
    pub harms: bool,
    vary: fn(&Case, Assembly) -> Assembly,
}

/// All variations. Targets and times are drawn from the seed.
pub const VARIATIONS: [Variation; 13] = [
    Variation { name: "plain", harms: false, vary: |_, a| a },
    Variation { name: "decentralised", harms: false, vary: |_, a| a.decentralised() },
    Variation { name: "loss", harms: false, vary: |_, a| a.loss("10%") },
    Variation { name: "failed-connections", harms: false, vary: |_, a| a.failed_connections("5%") },
    Variation { name: "restart", harms: false, vary: restart },
    Variation { name: "long-pause", harms: false, vary: long_pause },
    Variation { name: "passing-obstacles", harms: false, vary: |_, a| obstacles(a, 60) },
    // Longer than the director's limit of a standstill.
    Variation { name: "lasting-obstacles", harms: false, vary: |_, a| obstacles(a, 180) },
    Variation { name: "change", harms: false, vary: change },
    Variation { name: "relocation", harms: false, vary: relocation },
    Variation { name: "stuck-joint", harms: true, vary: stuck_joint },
    Variation { name: "crash", harms: true, vary: |c, a| crash(c, a.spares(1).relocating()) },
    Variation {
        name: "everything",
        harms: true,
        vary: |c, a| crash(c, a.spares(1).relocating().decentralised().loss("5%").failed_connections("5%")),
    },
];

impl Variation {
    /// Returns the variation with this name.
    pub fn named(name: &str) -> Option<&'static Variation> {
        const ALL: &[Variation] = &VARIATIONS;
        ALL.iter().find(|v| v.name == name)
    }
}

fn seconds(s: u64) -> Time {
    Time::ZERO + Span::secs(s)
}

/// Draws the target of a fault, and its time within the first minute.
fn victim(case: &Case, of: &Assembly) -> (ModuleId, u64) {
    let mut rng = Rng::named(case.seed, "victim", 0);
    (ModuleId(rng.below(of.start.len() as u64) as u32), rng.below(60))
}

fn restart(case: &Case, assembly: Assembly) -> Assembly {
    let (id, at) = victim(case, &assembly);
    assembly.fault(seconds(at), Fault::Restart(id))
}

/// Adds a pause that is longer than any metamodule waits for another.
fn long_pause(case: &Case, assembly: Assembly) -> Assembly {
    let (id, at) = victim(case, &assembly);
    let patience = assembly.setup.params.patience;
    let (from, until) = (seconds(at), seconds(at) + patience * 6);
    assembly.fault(from, Fault::Pause(id)).fault(until, Fault::Resume(id))
}

/// Adds an obstacle half-way between each start and the goal, and one on a seed, for a while.
fn obstacles(assembly: Assembly, stay: u64) -> Assembly {
    let seeds = assembly.setup.goals[0].seeds();
    let seed = seeds[0].foot;
    let half = |from: (i16, i16)| Cell::new((from.0 + seed.0) / 2, (from.1 + seed.1) / 2, 0);
    let mut cells: Vec<Cell> = assembly.start.iter().map(|pose| half(pose.foot())).collect();
    cells.push(Cell::new(seed.0, seed.1, 0));
    let come = |a: Assembly, cell: &Cell| a.fault(seconds(3), Fault::World(&OBSTACLE, Target::Cell(*cell)));
    let go = |a: Assembly, cell: &Cell| {
        a.fault(seconds(3 + stay), Fault::World(&OBSTACLE_GONE, Target::Cell(*cell)))
    };
    let there = cells.iter().fold(assembly, come);
    cells.iter().fold(there, go)
}

/// Replaces the goal when part of the first one stands.
fn change(case: &Case, assembly: Assembly) -> Assembly {
    let (_, at) = victim(case, &assembly);
    match case.goal {
        Goal::Box => assembly.spares(2).change(seconds(20 + at), Goal::Chair, case.order),
        Goal::Chair => assembly.change(seconds(20 + at), Goal::Box, case.order),
    }
}

/// Adds a permanent obstacle on the last seed.
fn relocation(_: &Case, assembly: Assembly) -> Assembly {
    let seeds = assembly.setup.goals[0].seeds();
    let (x, y) = seeds[seeds.len() - 1].foot;
    assembly.relocating().fault(seconds(3), Fault::World(&OBSTACLE, Target::Cell(Cell::new(x, y, 0))))
}

fn stuck_joint(case: &Case, assembly: Assembly) -> Assembly {
    let assembly = assembly.spares(1);
    let (id, at) = victim(case, &assembly);
    assembly.fault(seconds(at), Fault::Stick(id))
}

fn crash(case: &Case, assembly: Assembly) -> Assembly {
    let (id, at) = victim(case, &assembly);
    assembly.fault(seconds(at), Fault::Kill(id))
}

/// A run by name.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// The goal.
    pub goal: Goal,
    /// The kind of metamodules.
    pub kind: Kind,
    /// Their strategy.
    pub strategy: Strategy,
    /// The order of seeds.
    pub order: SeedOrder,
    /// The seed.
    pub seed: u64,
    /// The variation.
    pub variation: &'static Variation,
}

/// The environment variable that names the run to be repeated.
pub const REPEAT: &str = "METAMORPH_CASE";

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Case { goal, kind, strategy, order, seed, variation } = self;
        let parts = [goal.name(), kind.name(), strategy.name(), order.name()].join("/");
        write!(f, "{parts}/{seed}/{}", variation.name)
    }
}

impl FromStr for Case {
    type Err = String;

    fn from_str(text: &str) -> Result<Case, String> {
        let form =
            || format!("`{text}` names no run; one is for example box/SRS/negotiated/circular/17/plain");
        let parts: Vec<&str> = text.split('/').collect();
        let [goal, kind, strategy, order, seed, variation] = parts[..] else { return Err(form()) };
        Ok(Case {
            goal: Goal::ALL.into_iter().find(|g| g.name() == goal).ok_or_else(form)?,
            kind: Kind::METAMODULES.into_iter().find(|k| k.name() == kind).ok_or_else(form)?,
            strategy: Strategy::ALL.into_iter().find(|s| s.name() == strategy).ok_or_else(form)?,
            order: SeedOrder::ALL.into_iter().find(|o| o.name() == order).ok_or_else(form)?,
            seed: seed.parse().map_err(|_| form())?,
            variation: Variation::named(variation).ok_or_else(form)?,
        })
    }
}

impl Case {
    /// Returns every kind and both goals under a variation; the orders take turns over the seeds.
    pub fn all(
        strategy: Strategy,
        variation: &'static Variation,
        seeds: std::ops::Range<u64>,
    ) -> impl Iterator<Item = Case> {
        let of = move |seed: u64| {
            let pairs = Goal::ALL.into_iter().flat_map(|g| Kind::METAMODULES.map(|k| (g, k)));
            pairs.enumerate().map(move |(i, (goal, kind))| {
                let order = SeedOrder::ALL[(seed as usize + i) % SeedOrder::ALL.len()];
                Case { goal, kind, strategy, order, seed, variation }
            })
        };
        seeds.flat_map(of)
    }

    /// Returns the experiment of the run.
    pub fn assembly(&self) -> Assembly {
        let plain = Assembly::new(self.goal, self.kind, self.strategy, self.order, self.seed);
        (self.variation.vary)(self, plain)
    }

    /// Returns what is wrong with a result.
    fn complaint(&self, ran: &Assembled) -> Option<String> {
        let lost = self.variation.harms && ran.stall.as_ref().is_some_and(|s| s.reason.is_infeasible());
        let must_build = !self.strategy.is_published() && !lost;
        if ran.broken > 0 {
            return Some(format!("{} invariants broke, the first: {:?}", ran.broken, ran.violations.first()));
        }
        match ran.outcome {
            None => Some("it did not end".to_owned()),
            Some(_) if ran.built() => None,
            Some((at, outcome)) if must_build => Some(format!("{outcome} at {at}: {:?}", ran.stall)),
            Some((at, outcome)) => {
                ran.stall.is_none().then(|| format!("{outcome} at {at}, without a reason"))
            }
        }
    }

    /// Returns the command that repeats the run alone.
    fn command(&self) -> String {
        let release = if cfg!(debug_assertions) { "" } else { "--release " };
        format!(
            "{REPEAT}={self} cargo test {release}-p metamorph-tests the_named_run -- --ignored --nocapture"
        )
    }

    fn with_command(&self, what: &str) -> String {
        format!("{self}: {what}\n  {}", self.command())
    }

    /// Runs it, and returns the result and what is wrong with it.
    pub fn run(&self) -> (Assembled, Option<String>) {
        let ran = self.assembly().run();
        let complaint = self.complaint(&ran).map(|what| self.with_command(&what));
        (ran, complaint)
    }
}

/// Totals of the runs of one strategy under one variation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sum {
    /// The number of runs.
    pub runs: u64,
    /// The number of runs that built the goal.
    pub built: u64,
    /// The number of invariants broken.
    pub broken: u64,
    /// The moves of the runs that built.
    pub moves: u64,
    /// The messages of the runs that built.
    pub messages: u64,
}

impl Sum {
    fn add(&mut self, ran: &Assembled) {
        self.runs += 1;
        self.broken += ran.broken;
        if ran.built() {
            self.built += 1;
            self.moves += ran.action_counts.moves;
            self.messages += ran.tally.total().sent;
        }
    }
}

impl fmt::Display for Sum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mean = |sum: u64| sum as f64 / self.built.max(1) as f64;
        let Sum { runs, built, broken, .. } = self;
        write!(f, "{built} of {runs} built, {broken} invariants broken; ")?;
        write!(f, "{:.1} moves and {:.0} messages each", mean(self.moves), mean(self.messages))
    }
}

/// Results of many runs: totals by strategy and variation, and failures.
#[derive(Debug, Default)]
pub struct Came {
    /// The totals, by strategy and variation.
    pub sums: BTreeMap<(Strategy, &'static str), Sum>,
    /// The failures, with the commands that repeat them.
    pub complaints: Vec<String>,
}

/// Runs all cases on two threads. The results do not depend on the assignment to threads.
pub fn run_all(cases: impl Iterator<Item = Case> + Send) -> Came {
    let (cases, came) = (Mutex::new(cases), Mutex::new(Came::default()));
    let next = || cases.lock().expect("invariant: no thread panics while it takes a case").next();
    let work = || {
        while let Some(case) = next() {
            // A panic has printed its place; what is missing is the name of the run.
            let ran = catch_unwind(|| case.run());
            let mut came = came.lock().expect("invariant: no thread panics while it adds a result");
            match ran {
                Ok((ran, complaint)) => {
                    came.sums.entry((case.strategy, case.variation.name)).or_default().add(&ran);
                    came.complaints.extend(complaint);
                }
                Err(_) => came.complaints.push(case.with_command("it panicked")),
            }
        }
    };
    thread::scope(|scope| {
        scope.spawn(work);
        work();
    });
    let mut came = came.into_inner().expect("invariant: no thread panics while it adds a result");
    came.complaints.sort();
    came
}

/// Runs all cases, prints the totals, and fails if any run has failed.
pub fn check_all(cases: impl Iterator<Item = Case> + Send) -> Came {
    let came = run_all(cases);
    #[allow(clippy::print_stdout, reason = "shown only on failure or with --nocapture")]
    for ((strategy, variation), sum) in &came.sums {
        println!("{} {variation}: {sum}", strategy.name());
    }
    assert!(came.complaints.is_empty(), "{}", came.complaints.join("\n"));
    came
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_have_names() {
        let text = "chair/PER/step/at-once/12/long-pause";
        assert_eq!(text.parse::<Case>().unwrap().to_string(), text);
        for wrong in ["", "chair/PER/step/at-once/12", "chair/PER/step/at-once/-1/plain", "a/b/c/d/1/plain"] {
            assert!(wrong.parse::<Case>().unwrap_err().contains("for example box/SRS"), "{wrong}");
        }
        let example = "box/SRS/negotiated/circular/17/plain";
        assert_eq!(example.parse::<Case>().unwrap().to_string(), example);
    }

    /// The result is judged under every variation: no run passes unchecked.
    #[test]
    fn an_unbuilt_goal_is_a_failure() {
        let case: Case = "box/SRS/negotiated/circular/1/plain".parse().unwrap();
        let (mut ran, complaint) = case.run();
        assert_eq!(complaint, None);
        ran.broken = 1;
        assert!(case.complaint(&ran).unwrap().contains("invariants broke"));
        ran.broken = 0;
        let (at, _) = ran.outcome.unwrap();
        ran.outcome = Some((at, metamorph_sim_bridge::director::outcome::Outcome::Deadlock));
        assert!(case.complaint(&ran).unwrap().starts_with("deadlock at"));
        let published = Case { strategy: Strategy::Step, ..case };
        assert!(published.complaint(&ran).unwrap().ends_with("without a reason"));
        assert!(case.command().contains(&format!("{REPEAT}=box/SRS/negotiated/circular/1/plain cargo test")));
    }
}
