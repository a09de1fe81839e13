//! Experiment 1 of thesis 5.1.4: two metamodules bring a cube to a random place on terrains with missing connectors.

use super::PlannerTable;
use crate::Experiment;
use metamorph_console::interrupt::Interrupt;
use metamorph_families::metamodule::motion_database;
use metamorph_processes::family::sources;
use metamorph_protocol::manipulation::element::Element;
use metamorph_protocol::manipulation::load::LoadLimits;
use metamorph_protocol::manipulation::scene::Scene;
use metamorph_protocol::manipulation::terrain::Terrain;
use metamorph_protocol::manipulation::transport::{Answer, Task, TransportReason, plan};
use metamorph_protocol::manipulation::walking::WalkingGround;
use metamorph_protocol::manipulation::worlds::TransportWorld;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::roombots::Kind;
use metamorph_text::format::{count, percent};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Number of terrains for each probability, as published.
const PUBLISHED: u64 = 50;
/// Probabilities that a connector exists, in tenths.
const TENTHS: [u32; 4] = [8, 6, 4, 2];
/// Weight of the cube in grams. The thesis does not give it.
const GRAMS: u32 = 250;
/// Weights of the lower bound in hundredths. The first finds a plan soon, the second one with fewer connections.
const WEIGHTS: [u32; 2] = [500, 200];

/// Results of the planner over the worlds of one probability.
#[derive(Default)]
struct Outcomes {
    worlds: u64,
    infeasible: BTreeMap<TransportReason, u64>,
    undecided: u64,
    first_plans: u64,
    /// Plans in which the cube is put down on the way, since none was found without.
    put_down: u64,
    hand_overs: u64,
    /// Of both metamodules, by plan.
    connections: Vec<u32>,
    degrees: u64,
}

impl Outcomes {
    fn add(&mut self, answer: &Answer) {
        self.worlds += 1;
        match answer {
            Answer::Plan(plan) => {
                self.first_plans += u64::from(plan.refutations == 0);
                self.hand_overs += u64::from(plan.hand_overs);
                self.connections.push(plan.connections());
                self.degrees += u64::from(plan.degrees());
            }
            Answer::Infeasible(reason) => *self.infeasible.entry(*reason).or_default() += 1,
            Answer::Undecided { .. } => self.undecided += 1,
        }
    }

    /// Plans a world: the cube is always held, as in the thesis; it is put down on the way only where that is undecided.
    fn plan(&mut self, ground: &WalkingGround<'_>, task: &Task) {
        let mut answer = plan(ground, task);
        if matches!(answer, Answer::Undecided { .. }) {
            answer = plan(ground, &Task { puts_down: true, ..task.clone() });
            self.put_down += u64::from(matches!(answer, Answer::Plan(_)));
        } else if let Answer::Plan(first) = &answer
            && let Answer::Plan(second) = plan(ground, &Task { weight: WEIGHTS[1], ..task.clone() })
            && second.connections() < first.connections()
        {
            self.first_plans += u64::from(first.refutations == 0 && second.refutations > 0);
            answer = Answer::Plan(second);
        }
        self.add(&answer);
    }

    fn solved(&self) -> String {
        let (planned, proved) = (self.connections.len() as u64, self.infeasible.values().sum::<u64>());
        let reasons: Vec<String> =
            self.infeasible.iter().map(|(reason, n)| format!("{} {n}", reason.name())).collect();
        let reasons = if proved == 0 { String::new() } else { format!(" ({})", reasons.join(", ")) };
        format!(
            "{} of {} worlds not proved infeasible; {proved} proved{reasons}, {} undecided; {} first plans held, {} put the cube down on the way",
            percent(planned as f64 / (self.worlds - proved).max(1) as f64),
            count(self.worlds),
            self.undecided,
            self.first_plans,
            self.put_down,
        )
    }

    fn moves(&self) -> String {
        let plans = self.connections.len().max(1) as f64;
        let mean = f64::from(self.connections.iter().sum::<u32>()) / plans;
        let mut sorted = self.connections.clone();
        sorted.sort_unstable();
        let at = |i: usize| sorted.get(i).map_or(0.0, |n| f64::from(*n) / 2.0);
        format!(
            "{:.1} mean, {:.1} median, {:.1} largest; {:.1} hand-overs a task",
            mean / 2.0,
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

/// Makes the table.
pub fn table(seeds: u64, stop: &Interrupt) -> PlannerTable {
    let mut table = PlannerTable::new(Experiment::Transport);
    let database = Arc::new(motion_database::database(sources()));
    let cube: Element = "cube".parse().expect("invariant: the cube is a named element");
    for kind in Kind::METAMODULES {
        let scene =
            Scene::new(database.clone(), kind, &cube, GRAMS, LoadLimits::NOMINAL, Terrain::experiment());
        for tenths in TENTHS {
            let mut outcomes = Outcomes::default();
            let probability = Ratio::new(tenths, 10).expect("invariant: tenths are at most ten");
            for seed in (0..seeds.min(PUBLISHED)).take_while(|_| !stop.is_set()) {
                let world = TransportWorld::draw(&scene, probability, seed);
                let ground = WalkingGround::new(&scene, |connector| world.exists(connector));
                outcomes.plan(&ground, &world.task(WEIGHTS[0]));
            }
            let (solved, moves) = match tenths {
                2 => ("left out", ""),
                _ => ("around 97 % of \"solvable\" worlds", "11 on average over all p"),
            };
            let at = format!("{kind}, p = 0.{tenths}");
            table.row(format!("{at}: solved"), solved, outcomes.solved());
            table.row(format!("{at}: moves of one metamodule (5.8)"), moves, outcomes.moves());
            table.row(format!("{at}: displacement (5.9)"), "almost constant", outcomes.displacement());
        }
    }
    table.notes = vec![
        "every world ends in a plan that was carried out with all bodies as obstacles, in a proof that there is none with lattice angles, or undecided".to_owned(),
        "thesis 5.1.4 says that fewer connectors need more moves, 5.2 that they need fewer and larger ones".to_owned(),
        "walls at right angles only (α = π/2); places of the planes, starts, mass and kind are ours, since the thesis does not give them".to_owned(),
        "goals have the colour of the start: with lattice angles the others cannot be reached".to_owned(),
    ];
    table
}
