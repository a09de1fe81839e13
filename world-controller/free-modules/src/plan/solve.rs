//! Drives a planner in slices of work, and makes a plan file of its path.

use super::counts::counts;
use super::document::{
    Answer, Counts, GroundEntry, PLAN, PlanFile, Step as PlannedStep, VERSION, Verdict, What,
};
use super::input::{Structured, configuration_document, shape_document};
use metamorph_protocol::assembly::action::{Action, Connectors, Rules};
use metamorph_protocol::assembly::checker::{PhysicalAction, Physics, World, robot};
use metamorph_protocol::assembly::configuration::Configuration;
use metamorph_protocol::assembly::order;
use metamorph_protocol::assembly::space::{Assembly, Goal, Objective, usual_shapes};
use metamorph_protocol::assembly::standing::Standing;
use metamorph_protocol::assembly::tables::TABLES;
use metamorph_protocol::plan::bidirectional::Bidirectional;
use metamorph_protocol::plan::portfolio::Portfolio;
use metamorph_protocol::plan::search::{Method, Search};
use metamorph_protocol::plan::{Limits, Outcome, Path, Progress, Resource, Step, actions};
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::connector::Connector;
use metamorph_protocol::roombots::posture::Posture;

/// Number of expansions between two looks at the clock.
const SLICE: u64 = 256;

/// A planner, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Planner {
    /// `bidirectional` for a goal with joint values, else `portfolio`
    Auto,
    /// A*: an optimal plan; on reaching --memory, iterative deepening from there
    Astar,
    /// A first plan soon, then better ones (weights 3, 2, 1.5, 1)
    Ara,
    /// Iterative deepening: hardly any memory
    Ida,
    /// From both ends; the goal needs joint values
    Bidirectional,
    /// A* for the proof and beam search for a plan, in turn
    Portfolio,
    /// Of a scenario with elements: the order by AND/OR search, motions level by level; the same as `auto`
    Levels,
    /// Of a scenario with elements: the order of thesis B.5
    Thesis,
}

impl Planner {
    /// Returns the name used on the command line and in answers.
    pub const fn name(self) -> &'static str {
        match self {
            Planner::Auto => "auto",
            Planner::Astar => "astar",
            Planner::Ara => "ara",
            Planner::Ida => "ida",
            Planner::Bidirectional => "bidirectional",
            Planner::Portfolio => "portfolio",
            Planner::Levels => "levels",
            Planner::Thesis => "thesis",
        }
    }
}

/// A planning problem, the planner to solve it, and the limits for that.
#[derive(Clone, Debug)]
pub struct Problem {
    /// Where it begins.
    pub start: Configuration,
    /// Where it ends.
    pub goal: Structured,
    /// The rules that decide which actions are possible.
    pub rules: Rules,
    /// How it stands, in the terms of a plan file; the rules have the same.
    pub ground: Option<GroundEntry>,
    /// Cost function that the plan minimizes.
    pub objective: Objective,
    /// Who plans.
    pub planner: Planner,
    /// The weight of the lower bound in hundredths.
    pub weight: u32,
    /// Memory and work.
    pub limits: Limits,
}

/// Why a search is ended from outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// Its limit of real time is reached.
    Time,
    /// It was interrupted.
    Interrupt,
}

/// Called between slices of a search, with a function that returns the progress so far; the search ends if it returns a
/// reason.
pub type Watch<'w> = dyn FnMut(&dyn Fn() -> Progress) -> Option<Ended> + 'w;

/// How a search ended.
enum Stop {
    Engine(Outcome),
    Outside(Ended),
}

/// Common interface of all planners.
trait Engine {
    fn advance(&mut self, work: u64) -> Step;
    fn progress(&self) -> Progress;
    fn best(&self) -> Option<Path>;
}

impl Engine for Search<Assembly> {
    fn advance(&mut self, work: u64) -> Step {
        Search::advance(self, work)
    }
    fn progress(&self) -> Progress {
        Search::progress(self)
    }
    fn best(&self) -> Option<Path> {
        self.path()
    }
}

impl Engine for Portfolio<Assembly> {
    fn advance(&mut self, work: u64) -> Step {
        Portfolio::advance(self, work)
    }
    fn progress(&self) -> Progress {
        Portfolio::progress(self)
    }
    fn best(&self) -> Option<Path> {
        self.path()
    }
}

impl Engine for Bidirectional<Assembly> {
    fn advance(&mut self, work: u64) -> Step {
        Bidirectional::advance(self, work)
    }
    fn progress(&self) -> Progress {
        Bidirectional::progress(self)
    }
    fn best(&self) -> Option<Path> {
        None
    }
}

impl Problem {
    /// Returns the space of the problem.
    pub fn space(&self) -> Assembly {
        let n = self.start.len();
        let goal = match &self.goal {
            Structured::Shape(shape) => Goal::Shape(*shape),
            Structured::Configuration(configuration) => Goal::Configuration(*configuration),
        };
        Assembly::new(n, self.rules.clone(), self.objective, &goal, usual_shapes(n))
    }

    /// Returns the planner that `auto` stands for.
    pub fn chosen(&self) -> Planner {
        match (self.planner, &self.goal, self.objective) {
            (Planner::Auto, Structured::Configuration(_), Objective::Actions) if self.ground.is_none() => {
                Planner::Bidirectional
            }
            (Planner::Auto, ..) => Planner::Portfolio,
            (other, ..) => other,
        }
    }

    /// Solves the problem as far as the limits permit, or until `watch` ends the search.
    pub fn solve(&self, watch: &mut Watch<'_>) -> Answer {
        let space = self.space();
        let planner = self.chosen();
        let (stop, progress, best) = match (planner, &self.goal) {
            (Planner::Bidirectional, Structured::Configuration(goal)) => {
                let search = Bidirectional::new(space.clone(), &self.start, goal, self.limits);
                self.drive(search, watch)
            }
            (Planner::Portfolio, _) => {
                let search = Portfolio::new(space.clone(), &self.start, self.limits, self.weight);
                self.drive(search, watch)
            }
            _ => {
                let weighted = |method: Method| match self.weight {
                    100 => method,
                    weight => Method { weights: vec![weight], ..method },
                };
                let method = match planner {
                    Planner::Ara => Method::anytime(),
                    Planner::Ida => Method::deepening(),
                    _ => weighted(Method::astar()),
                };
                self.drive(Search::new(space.clone(), &self.start, self.limits, method), watch)
            }
        };
        self.answer(&space, planner, stop, progress, best)
    }

    fn drive(&self, mut engine: impl Engine, watch: &mut Watch<'_>) -> (Stop, Progress, Option<Path>) {
        let stop = loop {
            if let Step::Done(outcome) = engine.advance(SLICE) {
                break Stop::Engine(outcome);
            }
            if let Some(ended) = watch(&|| engine.progress()) {
                break Stop::Outside(ended);
            }
        };
        (stop, engine.progress(), engine.best())
    }

    fn answer(
        &self,
        space: &Assembly,
        planner: Planner,
        stop: Stop,
        progress: Progress,
        best: Option<Path>,
    ) -> Answer {
        let (path, lower, ended_by, impossible) = match stop {
            Stop::Engine(Outcome::Solved { path, lower }) => (Some(path), lower, None, false),
            Stop::Engine(Outcome::Impossible { .. }) => (None, progress.lower, None, true),
            Stop::Engine(Outcome::OutOf { resource, best, lower }) => {
                let name = match resource {
                    Resource::Memory => "memory",
                    Resource::Work => "work",
                    Resource::Cost => "cost",
                };
                (best, lower, Some(name), false)
            }
            Stop::Outside(Ended::Time) => (best, progress.lower, Some("time"), false),
            Stop::Outside(Ended::Interrupt) => (best, progress.lower, Some("interrupt"), false),
        };
        let cost = path.as_ref().map(|p| p.cost);
        let lower = cost.map_or(lower, |c| lower.min(c));
        let verdict = match cost {
            Some(cost) if cost == lower => Verdict::Optimal,
            Some(_) => Verdict::Bounded,
            None if impossible => Verdict::Impossible,
            None => Verdict::Undecided,
        };
        let name = planner.name().to_owned();
        let done = path.and_then(|p| actions(space, &self.start, &p.keys));
        let planned = done.map(|done| self.plan_file(&done, cost.unwrap_or(0), lower, &name, &progress));
        Answer {
            verdict,
            ended_by: ended_by.map(str::to_owned),
            planner: name,
            cost,
            lower,
            factor: cost.map(|c| if c == lower { 1.0 } else { f64::from(c) / f64::from(lower.max(1)) }),
            counts: planned.as_ref().map(|(_, counts)| *counts),
            progress,
            plan: planned.map(|(plan, _)| plan),
        }
    }

    /// Makes the file of a plan. Its fingerprints are those of the checker's world, followed without checks.
    fn plan_file(
        &self,
        done: &[Action],
        cost: u32,
        lower: u32,
        planner: &str,
        progress: &Progress,
    ) -> (PlanFile, Counts) {
        let order = order::of(&self.rules, &self.start, done);
        let mut at = self.start;
        let mut steps = Vec::new();
        for (action, after) in done.iter().zip(order.after.clone()) {
            let next = self.rules.apply(&at, *action).expect("invariant: the search followed this action");
            steps.push(PlannedStep {
                what: What::of(physical(*action)),
                after,
                from: format!("{:016x}", world(&at).fingerprint()),
                to: format!("{:016x}", world(&next).fingerprint()),
            });
            at = next;
        }
        let plan = PlanFile {
            format: PLAN.to_owned(),
            version: VERSION,
            start: configuration_document(&self.start),
            goal: match &self.goal {
                Structured::Shape(shape) => shape_document(shape),
                Structured::Configuration(configuration) => configuration_document(configuration),
            },
            objective: self.objective,
            collision: self.rules.collision.model(),
            connectors: self.rules.connectors,
            ground: self.ground,
            actions: steps,
            cost,
            lower,
            planner: planner.to_owned(),
            expanded: progress.expanded,
        };
        (plan, counts(done, &order))
    }
}

/// Returns the configuration as the checker sees it.
pub fn world(configuration: &Configuration) -> World {
    let t = &**TABLES;
    let robots = configuration.modules().iter().map(|m| {
        let posture = Posture::from_code(Kind::Single, m.posture.into());
        let steps = posture.steps().try_into().expect("invariant: a module has three joints");
        robot(m.cell.map(i16::from), t.rotations[usize::from(m.rotation)], &steps)
    });
    let held = configuration.connections().into_iter().map(|p| (place(p.a), place(p.b)));
    World { robots: robots.collect(), held: held.collect() }
}

fn place((module, connector): (u8, u8)) -> (usize, Connector) {
    (module.into(), Connector::ALL[usize::from(connector)])
}

/// Returns the action as the checker sees it.
pub fn physical(action: Action) -> PhysicalAction {
    match action {
        Action::Attach(p) => PhysicalAction::Attach(place(p.a), place(p.b)),
        Action::Detach(p) => PhysicalAction::Detach(place(p.a), place(p.b)),
        Action::Turn { module, joint, positive } => {
            PhysicalAction::Turn(module.into(), joint.into(), positive)
        }
    }
}

/// Returns what a plan is checked against. `start` is where it begins.
pub fn physics(plan: &PlanFile, start: &World) -> Physics {
    let standing = plan.ground.map(|g| Standing {
        held: (g.module, if g.head { 3 } else { 0 }),
        floor: g.floor.then(|| start.lowest()),
        gravity: g.gravity,
    });
    Physics { collision: plan.collision, active: plan.connectors == Connectors::Active, standing }
}
