//! Cubes growing a sphere out of a slab on the simulated link: the experiment of most tests of the protocol,
//! in many variations.

use crate::hosts;
use metamorph_protocol::counters::Tally;
use metamorph_protocol::cube::params::{Params, Setup};
use metamorph_protocol::goal::{Goal, Growth};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::link::{ClockOffset, LinkModel};
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::shape::{Radius, Shape};
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::cube::audit::audit_every;
use metamorph_sim_bridge::cube::director::Director;
use metamorph_sim_bridge::cube::world::{CubeWorld, MotionCounts};
use metamorph_sim_bridge::director::faults::{Fault, Schedule};
use metamorph_sim_bridge::director::outcome::{Outcome, Stall};
use metamorph_sim_bridge::director::progress::{Stage, Stop};
use metamorph_sim_bridge::director::rescue::Rescue;
use metamorph_sim_bridge::kernel::sim::{Sim, SimConfig};
use metamorph_sim_bridge::world::invariants::{Invariant, Violation};
use std::collections::BTreeSet;
use std::sync::Arc;

const MOVE: Span = Span::secs(1);

/// The configuration of one run.
#[derive(Clone, Debug)]
pub struct Experiment {
    /// The initial cells of the modules.
    pub start: Vec<Cell>,
    /// The parameters and goals.
    pub setup: Setup,
    /// The link.
    pub link: LinkModel,
    /// The faults and their times.
    pub faults: Vec<(Time, Fault)>,
    /// The probability that a move fails.
    pub failure: Ratio,
    /// The seed of the run.
    pub seed: u64,
    /// True if messages are accepted in whatever session they were sent.
    pub ignore_sessions: bool,
    /// True if the run ends as soon as an invariant has broken.
    pub until_broken: bool,
}

/// The result of a run.
#[derive(Clone, Debug)]
pub struct Ran {
    /// The outcome and its time.
    pub outcome: Option<(Time, Outcome)>,
    /// The standstill, if there was one.
    pub stall: Option<Stall>,
    /// The first violations of invariants.
    pub violations: Vec<Violation>,
    /// The total number of violations.
    pub broken: u64,
    /// Message counts.
    pub tally: Tally,
    /// The counts of moves.
    pub motions: MotionCounts,
    /// The results of the goals.
    pub stages: Vec<Stage>,
    /// The trace hash.
    pub trace: u64,
    /// The hash of the final state of all agents.
    pub digest: u64,
    /// The hash of the sampled states.
    pub state: u64,
}

impl Ran {
    /// Returns true if the goal was built.
    pub fn built(&self) -> bool {
        matches!(self.outcome, Some((_, Outcome::Built)))
    }
    /// Returns true if this invariant broke.
    pub fn broke(&self, invariant: Invariant) -> bool {
        self.violations.iter().any(|v| v.invariant == invariant)
    }
}

/// Returns a square slab, one module thick.
pub fn slab(side: i16) -> Vec<Cell> {
    Shape::Box { min: Cell::new(0, 0, 0), max: Cell::new(side - 1, side - 1, 0) }
        .cells()
        .expect("invariant: a box has cells")
}

/// Returns the goal for the largest ball around the middle of a slab that has at most three quarters as many
/// cells as the slab has modules.
pub fn ball(side: i16, growth: Growth) -> Goal {
    let (center, most) = (Cell::new(side / 2, side / 2, 0), side as usize * side as usize * 3 / 4);
    (1..)
        .map(|radius| {
            let cells = Shape::Sphere { center, radius: Radius::cells(radius) }.cells();
            Goal::compile(&cells.expect("invariant: a ball has cells"), center, growth)
                .expect("invariant: a ball is connected")
        })
        .take_while(|goal| goal.len() <= most)
        .last()
        .expect("invariant: a ball of radius one fits")
}

impl Experiment {
    /// Returns the experiment of a slab of `side²` modules that becomes a sphere, without faults. Links take
    /// 50 to 200 ms, a move 1 s.
    pub fn slab_to_sphere(side: i16, seed: u64) -> Experiment {
        let (delay_min, delay_max) = (Span::millis(50), Span::millis(200));
        let params = Params::scaled(MOVE, delay_max, 4 * (side as u16 * 3));
        Experiment {
            start: slab(side),
            setup: Setup { params, goals: vec![ball(side, Growth::Scaffold)] },
            link: LinkModel { delay_min, delay_max, ..LinkModel::default() },
            faults: Vec::new(),
            failure: Ratio::ZERO,
            seed,
            ignore_sessions: false,
            until_broken: false,
        }
    }

    /// Sets the probability that a message is lost.
    pub fn loss(mut self, p: &str) -> Experiment {
        self.link.loss = p.parse().expect("invariant: tests name probabilities");
        self
    }

    /// Crashes this share of the modules, drawn from the seed, within the first minute.
    pub fn crashes(mut self, percent: usize) -> Experiment {
        let count = self.start.len() as u64;
        let mut rng = Rng::named(self.seed, "crashes", 0);
        let mut victims = BTreeSet::new();
        while victims.len() < self.start.len() * percent / 100 {
            victims.insert(rng.below(count) as u32);
        }
        for id in victims {
            self.faults.push((Time(rng.below(60_000_000_000)), Fault::Kill(ModuleId(id))));
        }
        self
    }

    /// Stops every module once, at some time of the first minute, for up to `longest`.
    pub fn pauses(mut self, longest: Span) -> Experiment {
        let mut rng = Rng::named(self.seed, "pauses", 0);
        for id in (0..self.start.len() as u32).map(ModuleId) {
            let from = Time(rng.below(60_000_000_000));
            self.faults.push((from, Fault::Pause(id)));
            self.faults.push((from + Span(1 + rng.below(longest.0)), Fault::Resume(id)));
        }
        self
    }

    /// Restarts this share of the modules without their memory, at some time of the first minute.
    pub fn restarts(mut self, percent: u64) -> Experiment {
        let mut rng = Rng::named(self.seed, "restarts", 0);
        for id in (0..self.start.len() as u32).map(ModuleId) {
            if rng.below(100) < percent {
                self.faults.push((Time(rng.below(60_000_000_000)), Fault::Restart(id)));
            }
        }
        self
    }

    /// Divides the modules among hosts with these clocks, and tells the protocol how far they differ.
    pub fn hosts(mut self, clocks: &[ClockOffset]) -> Experiment {
        hosts::divide(&mut self.link, self.start.len(), clocks);
        self.setup.params.skew = self.link.hosts.as_ref().map_or(Span::ZERO, |hosts| hosts.skew());
        self
    }

    /// Cuts every pair of hosts again and again in the first two minutes, for up to `longest`.
    pub fn host_cuts(mut self, longest: Span) -> Experiment {
        hosts::cut_again_and_again(&mut self.link, self.seed, Time::ZERO + MOVE * 120, longest);
        self
    }

    /// Returns the run at its start.
    pub fn sim(self) -> Sim<CubeWorld, Director> {
        let setup = Arc::new(self.setup);
        let world = CubeWorld::new(&self.start, MOVE, self.seed);
        let stop = Stop {
            timeout: Time(20_000_000_000_000),
            stall: MOVE * 400,
            livelock: MOVE * 1_600,
            planned_until: Time::ZERO,
        };
        let schedule = Schedule::new(self.faults);
        let director = Director::new(
            Arc::clone(&setup),
            self.start.len(),
            schedule,
            stop,
            self.failure,
            Rescue::default(),
        );
        let config = SimConfig {
            setup,
            link: self.link,
            seed: self.seed,
            audit_every: audit_every(MOVE),
            ignore_sessions: self.ignore_sessions,
        };
        Sim::new(config, world, director)
    }

    /// Runs the experiment to its end.
    pub fn run(self) -> Ran {
        let until_broken = self.until_broken;
        let mut sim = self.sim();
        while !sim.run_until(sim.now() + MOVE * 10) {
            if until_broken && sim.violations().1 > 0 {
                break;
            }
        }
        let (violations, broken) = sim.violations();
        Ran {
            outcome: sim.director().monitor().outcome(),
            stall: sim.director().monitor().stall().cloned(),
            violations: violations.to_vec(),
            broken,
            tally: *sim.tally(),
            motions: sim.world().motions(),
            stages: sim.director().stages().to_vec(),
            trace: sim.trace().value(),
            digest: sim.agents_hash(),
            state: sim.hashes().states,
        }
    }
}
