//! Experiment 1 of thesis 5.1.4: two metamodules bring a cube to a random place on terrains with missing connectors.

use super::PlannerTable;
use super::sample::Ratios;
use super::trials::{Hands, Kept};
use crate::error::ReproduceError;
use crate::{Experiment, Request};
use metamorph_console::interrupt::Interrupt;
use metamorph_families::metamodule::motion_database;
use metamorph_processes::family::sources;
use metamorph_protocol::manipulation::element::Element;
use metamorph_protocol::manipulation::load::LoadLimits;
use metamorph_protocol::manipulation::scene::Scene;
use metamorph_protocol::manipulation::terrain::Terrain;
use metamorph_protocol::manipulation::transport::{Answer, Task, plan};
use metamorph_protocol::manipulation::walking::WalkingGround;
use metamorph_protocol::manipulation::worlds::TransportWorld;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::roombots::Kind;
use metamorph_text::format::many;
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Number of terrains for each probability, as published.
const PUBLISHED: u64 = 50;
/// Probabilities that a connector exists, in tenths.
const TENTHS: [u32; 4] = [8, 6, 4, 2];
/// The published share of solvable worlds that were solved.
const SOLVED: f64 = 0.97;
/// Weight of the cube in grams. The thesis does not give it.
const GRAMS: u32 = 250;
/// Weights of the lower bound in hundredths. The first finds a plan soon, the second one with fewer connections.
const WEIGHTS: [u32; 2] = [500, 200];

/// The result of one world.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum World {
    Plan {
        /// Of both metamodules.
        connections: u32,
        degrees: u32,
        hand_overs: u32,
        /// True if the first plan that was carried out with all bodies held.
        first: bool,
        /// True if the cube is put down on the way, since no plan was found without.
        put_down: bool,
    },
    /// Proved to have no plan, with the name of the reason.
    Infeasible(String),
    Undecided,
}

impl World {
    /// Plans a world: the cube is always held, as in the thesis; it is put down on the way only where that is undecided.
    fn plan(ground: &WalkingGround<'_>, task: &Task) -> World {
        let (mut answer, mut put_down, mut first) = (plan(ground, task), false, false);
        if matches!(answer, Answer::Undecided { .. }) {
            answer = plan(ground, &Task { puts_down: true, ..task.clone() });
            put_down = true;
        } else if let Answer::Plan(quick) = &answer
            && let Answer::Plan(second) = plan(ground, &Task { weight: WEIGHTS[1], ..task.clone() })
            && second.connections() < quick.connections()
        {
            first = quick.refutations == 0;
            answer = Answer::Plan(second);
        }
        match &answer {
            Answer::Plan(plan) => World::Plan {
                connections: plan.connections(),
                degrees: plan.degrees(),
                hand_overs: plan.hand_overs,
                first: first || plan.refutations == 0,
                put_down,
            },
            Answer::Infeasible(reason) => World::Infeasible(reason.name().to_owned()),
            Answer::Undecided { .. } => World::Undecided,
        }
    }
}

/// Results of the planner over the worlds of one probability.
#[derive(Default)]
struct Outcomes {
    worlds: u64,
    infeasible: BTreeMap<String, u64>,
    undecided: u64,
    first_plans: u64,
    put_down: u64,
    hand_overs: u64,
    /// Of both metamodules, by plan.
    connections: Vec<u32>,
    degrees: u64,
}

impl Outcomes {
    fn add(&mut self, world: World) {
        self.worlds += 1;
        match world {
            World::Plan { connections, degrees, hand_overs, first, put_down } => {
                self.first_plans += u64::from(first);
                self.put_down += u64::from(put_down);
                self.hand_overs += u64::from(hand_overs);
                self.connections.push(connections);
                self.degrees += u64::from(degrees);
            }
            World::Infeasible(reason) => *self.infeasible.entry(reason).or_default() += 1,
            World::Undecided => self.undecided += 1,
        }
    }

    /// Returns the worlds with a plan, and those without a proof that there is none.
    fn planned(&self) -> (u64, u64) {
        let proved: u64 = self.infeasible.values().sum();
        (self.connections.len() as u64, self.worlds - proved)
    }

    fn others(&self) -> String {
        let reasons: Vec<String> =
            self.infeasible.iter().map(|(reason, n)| format!("{reason} {n}")).collect();
        let proved: u64 = self.infeasible.values().sum();
        let reasons = if proved == 0 { String::new() } else { format!(" ({})", reasons.join(", ")) };
        format!(
            "{proved} of {} proved{reasons}, {} undecided; {} first plans held, {} put the cube down on the way",
            many(self.worlds, "world"),
            self.undecided,
            self.first_plans,
            self.put_down,
        )
    }

    fn moves(&self) -> String {
        let plans = self.connections.len().max(1) as f64;
        let mut sorted = self.connections.clone();
        sorted.sort_unstable();
        let at = |i: usize| sorted.get(i).map_or(0.0, |n| f64::from(*n) / 2.0);
        format!(
            "median {:.1}, largest {:.1}; {:.1} hand-overs a task",
            at(sorted.len() / 2),
            at(sorted.len().saturating_sub(1)),
            self.hand_overs as f64 / plans
        )
    }

    /// Returns the mean joint motion between two connections.
    fn displacement(&self) -> String {
        let moves = f64::from(self.connections.iter().sum::<u32>().max(1));
        format!("{:.0}° a move", self.degrees as f64 / moves)
    }
}

/// One world to be planned.
type Trial = (Kind, u32, u64);

/// Makes the table; an interrupted one has the worlds so far.
///
/// # Errors
/// If the results cannot be kept.
pub fn table(request: &Request, stop: &Interrupt) -> Result<PlannerTable, ReproduceError> {
    let mut table = PlannerTable::new(Experiment::Transport);
    let database = Arc::new(motion_database::database(sources()));
    let cube: Element = "cube".parse().expect("invariant: the cube is a named element");
    let scenes: Vec<(Kind, Scene)> = (Kind::METAMODULES.into_iter())
        .map(|kind| {
            let terrain = Terrain::experiment();
            (kind, Scene::new(database.clone(), kind, &cube, GRAMS, LoadLimits::NOMINAL, terrain))
        })
        .collect();
    // Seeds come last, so that an interrupted experiment has as many worlds of each kind and probability.
    let mut trials: Vec<(String, Trial)> = Vec::new();
    for seed in 0..request.seeds.min(PUBLISHED) {
        for kind in Kind::METAMODULES {
            trials.extend(TENTHS.map(|p| (format!("{kind}, p = 0.{p}, seed {seed}"), (kind, p, seed))));
        }
    }
    let hands = Hands { name: "transport", jobs: request.jobs, stop, show: !request.quiet };
    let kept = Kept::open(request.out.as_deref(), Experiment::Transport.name())?;
    let results = kept.complete(&trials, hands, |(kind, tenths, seed)| {
        let (_, scene) = scenes.iter().find(|(of, _)| of == kind).expect("invariant: every kind has a scene");
        let probability = Ratio::new(*tenths, 10).expect("invariant: tenths are at most ten");
        let world = TransportWorld::draw(scene, probability, *seed);
        let ground = WalkingGround::new(scene, |connector| world.exists(connector));
        Some(World::plan(&ground, &world.task(WEIGHTS[0])))
    })?;
    let mut cells: BTreeMap<(Kind, Reverse<u32>), Outcomes> = BTreeMap::new();
    for ((_, (kind, tenths, _)), world) in trials.iter().zip(results) {
        if let Some(world) = world {
            cells.entry((*kind, Reverse(*tenths))).or_default().add(world);
        }
    }
    let mut dense = (0, 0);
    for ((kind, Reverse(tenths)), outcomes) in &cells {
        let at = format!("{kind}, p = 0.{tenths}");
        let (printed, moves) = match tenths {
            2 => ("left out", ""),
            _ => ("around 97 % of \"solvable\" worlds", "11 on average over all p"),
        };
        let planned = outcomes.planned();
        let row = table.share(format!("{at}: solved, of those not proved infeasible"), printed, planned);
        if *tenths != 2 {
            row.against_share(planned, SOLVED);
            dense = (dense.0 + planned.0, dense.1 + planned.1);
        }
        table.row("  others", "", outcomes.others());
        let lengths = Ratios::new(outcomes.connections.iter().map(|n| (u64::from(*n), 2)));
        table.ratio("  moves of one metamodule (5.8), mean", moves, &lengths);
        table.row("    others", "", outcomes.moves());
        table.row("  displacement (5.9)", "almost constant", outcomes.displacement());
    }
    let printed = "around 97 % of \"solvable\" worlds";
    table.share("all kinds, p from 0.4 to 0.8: solved", printed, dense).against_share(dense, SOLVED);
    table.notes = vec![
        "every world ends in a plan that was carried out with all bodies as obstacles, in a proof that there is none with lattice angles, or undecided".to_owned(),
        "p: exact binomial test of 97 %; how many worlds the published share is of, and what \"solvable\" is there, is not said. Ours: not proved infeasible".to_owned(),
        "thesis 5.1.4 says that fewer connectors need more moves, 5.2 that they need fewer and larger ones".to_owned(),
        "walls at right angles only (α = π/2); places of the planes, starts, mass and kind are ours, since the thesis does not give them".to_owned(),
        "goals have the colour of the start: with lattice angles the others cannot be reached".to_owned(),
        "all 800 worlds: `metamorph reproduce transport --out DIR`; with the same DIR it continues where it was interrupted".to_owned(),
    ];
    Ok(table)
}
