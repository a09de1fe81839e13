//! The thesis's experiment (4.1.3) on the simulated link: a box of four and a chair of six, from
//! random starts, with each kind of metamodule and each strategy.

use metamorph_protocol::counters::Tally;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::metamodule::blueprint::{Blueprint, SeedOrder, box_of_four, chair_of_six};
use metamorph_protocol::metamodule::motions::Motions;
use metamorph_protocol::metamodule::params::{Detector, Floor, Params, Precedence, Setup, Strategy, Teller};
use metamorph_protocol::metamodule::pose::Pose;
use metamorph_protocol::metamodule::start::random_start;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::database::Database;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::director::faults::{Fault, Schedule, Struck};
use metamorph_sim_bridge::director::outcome::{Outcome, Stall};
use metamorph_sim_bridge::director::progress::Stop;
use metamorph_sim_bridge::kernel::sim::{Sim, SimConfig};
use metamorph_sim_bridge::metamodule::director::{MetamoduleDirector, MetamodulePlan};
use metamorph_sim_bridge::metamodule::world::{Deeds, MetamoduleWorld};
use metamorph_sim_bridge::world::invariants::Violation;
use std::sync::{Arc, OnceLock};

const TURN: Span = Span::secs(1);

/// The motion database, built once per process.
pub fn database() -> Arc<Database> {
    static ONCE: OnceLock<Arc<Database>> = OnceLock::new();
    Arc::clone(ONCE.get_or_init(|| Arc::new(Database::build())))
}

fn new_motions(kind: Kind) -> Motions {
    Motions::new(database(), kind).expect("invariant: metamodules have motions")
}

/// The motions of each kind, made once per process.
fn motions(kind: Kind) -> Motions {
    static ONCE: OnceLock<Vec<Motions>> = OnceLock::new();
    let all = ONCE.get_or_init(|| Kind::METAMODULES.map(new_motions).into());
    all[Kind::METAMODULES.iter().position(|k| *k == kind).expect("invariant: a metamodule")].clone()
}

/// What is built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Goal {
    /// Four metamodules.
    Box,
    /// Six.
    Chair,
}

impl Goal {
    /// Both.
    pub const ALL: [Goal; 2] = [Goal::Box, Goal::Chair];

    /// The name used in scenarios.
    pub const fn name(self) -> &'static str {
        match self {
            Goal::Box => "box",
            Goal::Chair => "chair",
        }
    }
    /// Its blueprint, in the middle of the floor.
    pub fn blueprint(self, order: SeedOrder) -> Blueprint {
        let levels = match self {
            Goal::Box => box_of_four(5, 5),
            Goal::Chair => chair_of_six(5, 5),
        };
        Blueprint::new(&levels, order).expect("invariant: the goals are sound")
    }
}

/// One run to be made.
#[derive(Clone, Debug)]
pub struct Assembly {
    /// What everybody shares.
    pub setup: Arc<Setup>,
    /// Where the metamodules start.
    pub start: Vec<Pose>,
    /// The link.
    pub link: LinkModel,
    /// What is broken when.
    pub faults: Vec<(Time, Fault)>,
    /// Probability that a connection fails.
    pub failure: Ratio,
    /// When which goal is built instead.
    pub changes: Vec<(Time, u8)>,
    /// Whether the goal is moved when something that stays is in its way.
    pub relocate: bool,
    /// Whether the run ends when the metamodules find out that nobody can go on.
    pub heed: bool,
    /// The seed.
    pub seed: u64,
}

/// What a run came to.
#[derive(Clone, Debug)]
pub struct Assembled {
    /// How it ended, and when.
    pub outcome: Option<(Time, Outcome)>,
    /// Why it stood still, if it did.
    pub stall: Option<Stall>,
    /// When the metamodules found out that nobody can go on, and who did.
    pub detected: Option<(Time, ModuleId)>,
    /// How often somebody said so.
    pub alarms: u32,
    /// Seeds filled.
    pub filled: usize,
    /// How far the goal was moved.
    pub shift: (i16, i16),
    /// What was broken.
    pub struck: Vec<Struck>,
    /// Invariants broken: the first ones.
    pub violations: Vec<Violation>,
    /// How many in all.
    pub broken: u64,
    /// Message counts.
    pub tally: Tally,
    /// What bodies did.
    pub deeds: Deeds,
    /// Locks refused because two would have met.
    pub prevented: u64,
    /// The trace hash.
    pub trace: u64,
    /// The hash of the final state of all agents.
    pub digest: u64,
    /// Where the bodies are at the end.
    pub poses: Vec<Pose>,
}

impl Assembled {
    /// Whether the goal was built.
    pub fn built(&self) -> bool {
        matches!(self.outcome, Some((_, Outcome::Built)))
    }
    /// What is comparable with the thesis's count of collisions: locks refused and actions refused by
    /// the interlock.
    pub fn collisions(&self) -> u64 {
        self.prevented + self.deeds.blocked
    }
}

impl Assembly {
    /// As many metamodules as seeds, on a floor of 13 × 13 with the goal in the middle; links take 10
    /// to 100 ms, a step of a joint and a connection 1 s.
    pub fn new(goal: Goal, kind: Kind, strategy: Strategy, order: SeedOrder, seed: u64) -> Assembly {
        let delay = Span::millis(100);
        let setup = Setup {
            params: Params::scaled(strategy, TURN, delay),
            floor: Floor { min: (0, 0), max: (12, 12) },
            goals: vec![goal.blueprint(order)],
            motions: motions(kind),
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
            heed: false,
            seed,
        }
    }

    /// Messages are lost with this probability.
    pub fn loss(mut self, p: &str) -> Assembly {
        self.link.loss = p.parse().expect("invariant: tests name probabilities");
        self
    }
    /// Connections fail with this probability.
    pub fn failed_connections(mut self, p: &str) -> Assembly {
        self.failure = p.parse().expect("invariant: tests name probabilities");
        self
    }
    /// So many metamodules more than seeds.
    pub fn spares(mut self, spares: usize) -> Assembly {
        let count = self.setup.goals[0].seeds().len() + spares;
        self.start = random_start(&self.setup, count, self.seed).expect("invariant: the floor has room");
        self
    }
    /// The goal is moved when something that stays is in its way.
    pub fn relocating(mut self) -> Assembly {
        self.relocate = true;
        self
    }
    /// From then on this is built instead.
    pub fn change(mut self, at: Time, goal: Goal, order: SeedOrder) -> Assembly {
        let mut setup = (*self.setup).clone();
        setup.goals.push(goal.blueprint(order));
        self.changes.push((at, setup.goals.len() as u8 - 1));
        self.setup = Arc::new(setup);
        self
    }
    /// Nothing has been worked out before: the motions keep answers, and these have been asked nothing.
    pub fn with_new_motions(mut self) -> Assembly {
        let mut setup = (*self.setup).clone();
        setup.motions = new_motions(setup.kind());
        self.setup = Arc::new(setup);
        self
    }
    /// This fault strikes.
    pub fn fault(mut self, at: Time, fault: Fault) -> Assembly {
        self.faults.push((at, fault));
        self
    }
    /// Open seeds are learnt from neighbours, not from the controller.
    pub fn decentralised(mut self) -> Assembly {
        let mut setup = (*self.setup).clone();
        setup.params.teller = Teller::Neighbours;
        self.setup = Arc::new(setup);
        self
    }

    /// Which of two close together goes first, instead of what the strategy stands for.
    pub fn precedence(mut self, precedence: Option<Precedence>) -> Assembly {
        let mut setup = (*self.setup).clone();
        setup.params.precedence = precedence;
        self.setup = Arc::new(setup);
        self
    }
    /// Whether settled metamodules push.
    pub fn settled_repel(mut self, settled_repel: bool) -> Assembly {
        let mut setup = (*self.setup).clone();
        setup.params.settled_repel = settled_repel;
        self.setup = Arc::new(setup);
        self
    }
    /// The metamodules find out among themselves that nobody can go on.
    pub fn detecting(mut self) -> Assembly {
        let mut setup = (*self.setup).clone();
        let metamodules = self.start.len() as u16;
        setup.params.detector = Some(Detector { after: setup.params.patience, metamodules });
        self.setup = Arc::new(setup);
        self
    }

    /// Runs it.
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
            heed: self.heed,
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
            outcome: sim.director().outcome(),
            stall: sim.director().stall().cloned(),
            detected: sim.director().detected(),
            alarms: sim.director().alarms(),
            filled: sim.director().progress().filled,
            shift: sim.director().task().shift,
            struck: sim.director().struck().to_vec(),
            violations: violations.to_vec(),
            broken,
            tally: *sim.tally(),
            deeds: sim.world().deeds(),
            prevented: sim.director().prevented(),
            trace: sim.trace().value(),
            digest: sim.agents_hash(),
            poses: (0..self.start.len() as u32).map(|id| sim.world().pose(ModuleId(id))).collect(),
        }
    }
}
