//! The thesis's experiment (4.1.3) on the simulated link: a box of four and a chair of six, from
//! random starts, with each kind of metamodule and each strategy.

use crate::hosts;
use metamorph_protocol::counters::Tally;
use metamorph_protocol::defects::Defect;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::link::{ClockOffset, LinkModel};
use metamorph_protocol::metamodule::blueprint::{Blueprint, SeedOrder, box_of_four, chair_of_six};
use metamorph_protocol::metamodule::elements::Elements;
use metamorph_protocol::metamodule::motions::Motions;
use metamorph_protocol::metamodule::params::{
    Detector, Floor, Params, Precedence, SeedAuthority, Setup, Strategy,
};
use metamorph_protocol::metamodule::pose::Pose;
use metamorph_protocol::metamodule::start::random_start;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::database::Database;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::director::faults::{Fault, FaultRecord, Schedule};
use metamorph_sim_bridge::director::outcome::{Outcome, Stall};
use metamorph_sim_bridge::director::progress::Stop;
use metamorph_sim_bridge::kernel::sim::{Sim, SimConfig};
use metamorph_sim_bridge::metamodule::director::{MetamoduleDirector, MetamodulePlan};
use metamorph_sim_bridge::metamodule::world::{ActionCounts, MetamoduleWorld};
use metamorph_sim_bridge::world::invariants::Violation;
use std::sync::{Arc, OnceLock};

const TURN: Span = Span::secs(1);

/// Returns the motion database, built once per process.
pub fn database() -> Arc<Database> {
    static ONCE: OnceLock<Arc<Database>> = OnceLock::new();
    Arc::clone(ONCE.get_or_init(|| Arc::new(Database::build())))
}

fn new_motions(kind: Kind) -> Motions {
    Motions::new(database(), kind).expect("invariant: metamodules have motions")
}

/// Returns the motions of a kind, computed once per process.
fn motions(kind: Kind) -> Motions {
    static ONCE: OnceLock<Vec<Motions>> = OnceLock::new();
    let all = ONCE.get_or_init(|| Kind::METAMODULES.map(new_motions).into());
    all[Kind::METAMODULES.iter().position(|k| *k == kind).expect("invariant: a metamodule")].clone()
}

/// The goal of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Goal {
    /// Four metamodules.
    Box,
    /// Six metamodules.
    Chair,
}

impl Goal {
    /// All goals.
    pub const ALL: [Goal; 2] = [Goal::Box, Goal::Chair];

    /// Returns the name used in scenarios.
    pub const fn name(self) -> &'static str {
        match self {
            Goal::Box => "box",
            Goal::Chair => "chair",
        }
    }
    /// Returns its blueprint, in the middle of the floor.
    pub fn blueprint(self, order: SeedOrder) -> Blueprint {
        let levels = match self {
            Goal::Box => box_of_four(5, 5),
            Goal::Chair => chair_of_six(5, 5),
        };
        Blueprint::new(&levels, order).expect("invariant: the goals are sound")
    }
}

/// The configuration of one run.
#[derive(Clone, Debug)]
pub struct Assembly {
    /// The setup that all metamodules share.
    pub setup: Arc<Setup>,
    /// The initial poses.
    pub start: Vec<Pose>,
    /// The link.
    pub link: LinkModel,
    /// The faults and their times.
    pub faults: Vec<(Time, Fault)>,
    /// The probability that a connection fails.
    pub failure: Ratio,
    /// Changes of the goal and their times.
    pub changes: Vec<(Time, u8)>,
    /// True if the goal is moved when a permanent obstacle is in its way.
    pub relocate: bool,
    /// True if the run ends when the metamodules detect a standstill.
    pub follow: bool,
    /// The seed of the run.
    pub seed: u64,
}

/// The result of a run.
#[derive(Clone, Debug)]
pub struct Assembled {
    /// The outcome and its time.
    pub outcome: Option<(Time, Outcome)>,
    /// The standstill, if there was one.
    pub stall: Option<Stall>,
    /// When the metamodules detected a standstill, and which one did.
    pub detected: Option<(Time, ModuleId)>,
    /// How often a metamodule has reported a standstill.
    pub alarms: u32,
    /// The number of seeds filled.
    pub filled: usize,
    /// How far the goal was moved.
    pub shift: (i16, i16),
    /// The faults injected.
    pub struck: Vec<FaultRecord>,
    /// The first violations of invariants.
    pub violations: Vec<Violation>,
    /// The total number of violations.
    pub broken: u64,
    /// Message counts.
    pub tally: Tally,
    /// The counts of actions.
    pub action_counts: ActionCounts,
    /// The number of locks refused because two metamodules would have met.
    pub prevented: u64,
    /// The trace hash.
    pub trace: u64,
    /// The hash of the final state of all agents.
    pub digest: u64,
    /// The final poses.
    pub poses: Vec<Pose>,
}

impl Assembled {
    /// Returns true if the goal was built.
    pub fn built(&self) -> bool {
        matches!(self.outcome, Some((_, Outcome::Built)))
    }
    /// Returns the number that corresponds to the thesis's count of collisions: locks refused and actions
    /// refused by the interlock.
    pub fn collisions(&self) -> u64 {
        self.prevented + self.action_counts.blocked
    }
}

impl Assembly {
    /// Creates an experiment with as many metamodules as seeds, on a floor of 13 × 13 with the goal in the
    /// middle; links take 10 to 100 ms, a step of a joint and a connection 1 s.
    pub fn new(goal: Goal, kind: Kind, strategy: Strategy, order: SeedOrder, seed: u64) -> Assembly {
        let delay = Span::millis(100);
        let setup = Setup {
            params: Params::scaled(strategy, TURN, delay),
            floor: Floor { min: (0, 0), max: (12, 12) },
            goals: vec![goal.blueprint(order)],
            motions: motions(kind),
            elements: Elements::NONE,
        };
        let count = setup.goals[0].seeds().len();
        let start = random_start(&setup, count, seed).expect("invariant: the floor has room");
        Assembly {
            setup: Arc::new(setup),
            start,
            link: LinkModel { delay_min: Span::millis(10), delay_max: delay, ..LinkModel::default() },
            faults: Vec::new(),
            failure: Ratio::ZERO,
            changes: Vec::new(),
            relocate: false,
            follow: false,
            seed,
        }
    }

    /// Sets the probability that a message is lost.
    pub fn loss(mut self, p: &str) -> Assembly {
        self.link.loss = p.parse().expect("invariant: tests name probabilities");
        self
    }
    /// Sets the probability that a connection fails.
    pub fn failed_connections(mut self, p: &str) -> Assembly {
        self.failure = p.parse().expect("invariant: tests name probabilities");
        self
    }
    /// Adds spare metamodules.
    pub fn spares(mut self, spares: usize) -> Assembly {
        let count = self.setup.goals[0].seeds().len() + spares;
        self.start = random_start(&self.setup, count, self.seed).expect("invariant: the floor has room");
        self
    }
    /// Lets the goal be moved when a permanent obstacle is in its way.
    pub fn relocating(mut self) -> Assembly {
        self.relocate = true;
        self
    }
    /// Replaces the goal at this time.
    pub fn change(mut self, at: Time, goal: Goal, order: SeedOrder) -> Assembly {
        let mut setup = (*self.setup).clone();
        setup.goals.push(goal.blueprint(order));
        self.changes.push((at, setup.goals.len() as u8 - 1));
        self.setup = Arc::new(setup);
        self
    }
    /// Replaces the motions, which cache the answers of earlier searches, by new ones with empty caches.
    pub fn with_new_motions(mut self) -> Assembly {
        let mut setup = (*self.setup).clone();
        setup.motions = new_motions(setup.kind());
        self.setup = Arc::new(setup);
        self
    }
    /// Adds a fault.
    pub fn fault(mut self, at: Time, fault: Fault) -> Assembly {
        self.faults.push((at, fault));
        self
    }
    /// Lets metamodules learn open seeds from neighbours, not from the controller.
    pub fn decentralised(mut self) -> Assembly {
        let mut setup = (*self.setup).clone();
        setup.params.seed_authority = SeedAuthority::Neighbours;
        self.setup = Arc::new(setup);
        self
    }

    /// Sets the rule of precedence between close metamodules, instead of that of the strategy.
    pub fn precedence(mut self, precedence: Option<Precedence>) -> Assembly {
        let mut setup = (*self.setup).clone();
        setup.params.precedence = precedence;
        self.setup = Arc::new(setup);
        self
    }
    /// Sets whether settled metamodules repel.
    pub fn settled_repel(mut self, settled_repel: bool) -> Assembly {
        let mut setup = (*self.setup).clone();
        setup.params.settled_repel = settled_repel;
        self.setup = Arc::new(setup);
        self
    }
    /// Lets the metamodules detect a standstill among themselves.
    pub fn detecting(mut self) -> Assembly {
        let mut setup = (*self.setup).clone();
        let metamodules = self.start.len() as u16;
        setup.params.detector = Some(Detector { after: setup.params.patience, metamodules });
        self.setup = Arc::new(setup);
        self
    }

    /// Divides the metamodules among hosts with these clocks, whose links are cut again and again for up to `longest` in
    /// the first 200 steps.
    pub fn hosts(mut self, clocks: &[ClockOffset], longest: Span) -> Assembly {
        hosts::divide(&mut self.link, self.start.len(), clocks);
        hosts::cut_again_and_again(&mut self.link, self.seed, Time::ZERO + TURN * 200, longest);
        let mut setup = (*self.setup).clone();
        setup.params.skew = self.link.hosts.as_ref().map_or(Span::ZERO, |hosts| hosts.skew());
        self.setup = Arc::new(setup);
        self
    }
    /// Gives the protocol a defect.
    pub fn defect(mut self, defect: Option<Defect>) -> Assembly {
        let mut setup = (*self.setup).clone();
        setup.params.defect = defect;
        self.setup = Arc::new(setup);
        self
    }

    /// Runs the experiment to its end.
    pub fn run(self) -> Assembled {
        let world = MetamoduleWorld::new(Arc::clone(&self.setup), &self.start, self.seed);
        let stop = Stop {
            timeout: Time::ZERO + TURN * 50_000,
            stall: TURN * 120,
            livelock: TURN * 2_000,
            planned_until: Time::ZERO,
        };
        let plan = MetamodulePlan {
            schedule: Schedule::new(self.faults),
            stop,
            failure: self.failure,
            changes: self.changes,
            relocate: self.relocate,
            follow: self.follow,
            hands_over: true,
            round_trip: Span::ZERO,
            operator: None,
            level: Default::default(),
            scenes: Default::default(),
        };
        let director = MetamoduleDirector::new(Arc::clone(&self.setup), self.start.len(), plan);
        let config = SimConfig {
            setup: self.setup,
            link: self.link,
            seed: self.seed,
            audit_every: TURN * 20,
            ignore_sessions: false,
        };
        let mut sim = Sim::new(config, world, director);
        while !sim.run_until(sim.now() + TURN * 1_000) {}
        let (violations, broken) = sim.violations();
        Assembled {
            outcome: sim.director().monitor().outcome(),
            stall: sim.director().monitor().stall().cloned(),
            detected: sim.director().detected(),
            alarms: sim.director().alarms(),
            filled: sim.director().progress().filled,
            shift: sim.director().task().shift,
            struck: sim.director().monitor().struck().to_vec(),
            violations: violations.to_vec(),
            broken,
            tally: *sim.tally(),
            action_counts: sim.world().action_counts(),
            prevented: sim.director().prevented(),
            trace: sim.trace().value(),
            digest: sim.agents_hash(),
            poses: (0..self.start.len() as u32).map(|id| sim.world().pose(ModuleId(id))).collect(),
        }
    }
}
