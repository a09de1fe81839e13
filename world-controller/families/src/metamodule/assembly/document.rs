//! The answer of `metamorph plan SCENARIO` as JSON.

use super::Planned;
use metamorph_protocol::manipulation::structure::assembly::{Failure, StructureAnswer, StructurePlan};
use metamorph_protocol::manipulation::structure::isolation::{CELL, Rank};
use metamorph_protocol::manipulation::structure::{Reason, Structure};
use metamorph_protocol::metamodule::blueprint::Task;
use metamorph_protocol::plan::and_or::{Items, RemovalRefusal};
use serde::Serialize;

/// Whether there is a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum AssemblyVerdict {
    /// There is one.
    Plan,
    /// There is none, which is proved.
    Infeasible,
    /// None was found.
    Undecided,
}

/// The answer of `metamorph plan SCENARIO`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AssemblyDocument {
    /// Whether there is a plan.
    pub verdict: AssemblyVerdict,
    /// The kind of the metamodules.
    pub kind: String,
    /// The planner: `levels` or `thesis`.
    pub planner: &'static str,
    /// The bundles in the order in which they are placed; empty without a plan.
    pub bundles: Vec<BundleEntry>,
    /// Sums and maxima over all bundles; absent without a plan.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub totals: Option<Totals>,
    /// Why there is no plan; absent with one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failure: Option<FailureEntry>,
    /// The order of thesis B.5; with the planner `thesis`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub thesis_order: Vec<RankEntry>,
}

/// A bundle that is placed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BundleEntry {
    /// Names of the seeds and elements that the bundle places.
    pub items: Vec<String>,
    /// The bundles, from 1, that must be placed before.
    pub after: Vec<usize>,
    /// The metamodules that move, in the order of their first motion.
    pub metamodules: Vec<usize>,
    /// Hand-overs of elements.
    pub hand_overs: u32,
    /// Landings and grips.
    pub connections: u32,
    /// Steps of joints.
    pub turns: u32,
    /// The sum of their angles in degrees.
    pub degrees: u32,
    /// The largest torque on outer joints with an element, in Nm.
    pub peak_outer_nm: f64,
    /// The largest torque on middle joints with an element, in Nm.
    pub peak_middle_nm: f64,
}

/// Sums and maxima over all bundles.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Totals {
    /// Hand-overs of elements.
    pub hand_overs: u32,
    /// Landings and grips.
    pub connections: u32,
    /// The least number of connections of any plan.
    pub connections_lower: u32,
    /// Steps of joints.
    pub turns: u32,
    /// The sum of their angles in degrees.
    pub degrees: u32,
    /// The largest torque on outer joints with an element, in Nm.
    pub peak_outer_nm: f64,
    /// The largest torque on middle joints with an element, in Nm.
    pub peak_middle_nm: f64,
    /// Bundles that were taken out of the search, since they could not be placed.
    pub refutations: usize,
}

/// Why there is no plan.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FailureEntry {
    /// A name.
    pub reason: String,
    /// A sentence.
    pub text: String,
    /// The smallest set of items from which nothing can be taken away, if the search ended there.
    pub standing: Vec<String>,
    /// Each bundle of that set, with the reason why it cannot be taken away.
    pub refusals: Vec<RefusalEntry>,
}

/// A bundle that cannot be taken away.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RefusalEntry {
    /// The bundle.
    pub items: Vec<String>,
    /// The name of the reason.
    pub reason: String,
    /// True if it is proved that the bundle cannot be taken away; false if no way was found.
    pub proved: bool,
}

/// A kinematic chain as thesis B.5 sorts it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RankEntry {
    /// The items.
    pub items: Vec<String>,
    /// The highest level.
    pub level: u32,
    /// The mean degree centrality, in cells.
    pub isolation: f64,
    /// True if the chain is taken; false if a metamodule or an element of it has been taken before.
    pub taken: bool,
}

/// Names items of a structure.
struct Names<'a>(&'a Planned<'a>);

impl Names<'_> {
    fn structure(&self) -> &Structure {
        &self.0.structure
    }
    fn piece(&self, piece: usize) -> String {
        self.0.swarm.setup.elements.all()[piece].name.clone()
    }
    fn items(&self, items: Items) -> Vec<String> {
        let seed = |seat: usize| {
            let seeds = self.0.swarm.setup.seeds(Task::default());
            let foot = seeds.map(|(_, seed)| seed.foot).nth(seat).unwrap_or_default();
            format!("seed ({}, {})", foot.0, foot.1)
        };
        let seats = self.structure().seats_in(items).map(seed);
        seats.chain(self.structure().pieces_in(items).map(|p| self.piece(p))).collect()
    }
    fn reason(&self, reason: Reason) -> String {
        match reason {
            Reason::NotHeld(piece) | Reason::TooHeavy(piece) => {
                format!("{}: {}", reason.name(), self.piece(piece))
            }
            _ => reason.name().to_owned(),
        }
    }
}

/// Makes the document of an answer.
pub fn document(planned: &Planned<'_>) -> AssemblyDocument {
    let names = Names(planned);
    let verdict = match &planned.answer {
        StructureAnswer::Plan(_) => AssemblyVerdict::Plan,
        StructureAnswer::Infeasible(_) => AssemblyVerdict::Infeasible,
        StructureAnswer::Undecided(_) => AssemblyVerdict::Undecided,
    };
    let (bundles, totals, failure) = match &planned.answer {
        StructureAnswer::Plan(assembly) => {
            let bundles = bundles(assembly, &names);
            let totals = totals(assembly, &bundles);
            (bundles, Some(totals), None)
        }
        StructureAnswer::Infeasible(failure) | StructureAnswer::Undecided(failure) => {
            (Vec::new(), None, Some(failure_entry(failure, &names)))
        }
    };
    let rank = |rank: &Rank, taken: bool| RankEntry {
        items: names.items(rank.items),
        level: rank.level,
        isolation: rank.isolation as f64 / CELL as f64,
        taken,
    };
    let order = planned.thesis.iter().flat_map(|o| o.chains.iter().map(|c| rank(c, o.taken.contains(c))));
    AssemblyDocument {
        verdict,
        kind: planned.swarm.setup.kind().name().to_owned(),
        planner: if planned.thesis.is_some() { "thesis" } else { "levels" },
        bundles,
        totals,
        failure,
        thesis_order: order.collect(),
    }
}

/// Converts µNm to Nm.
fn newton_metres(torque: u32) -> f64 {
    f64::from(torque) / 1e6
}

fn bundles(assembly: &StructurePlan, names: &Names<'_>) -> Vec<BundleEntry> {
    let entry = |placed: &metamorph_protocol::manipulation::structure::assembly::PlacedBundle| {
        let mut metamodules: Vec<usize> = Vec::new();
        for action in &placed.actions {
            if !metamodules.contains(&action.mover) {
                metamodules.push(action.mover);
            }
        }
        let (turns, degrees) = placed.turns();
        BundleEntry {
            items: names.items(placed.items),
            after: placed.after.iter().map(|i| i + 1).collect(),
            metamodules,
            hand_overs: placed.hand_overs,
            connections: placed.connections(),
            turns,
            degrees,
            peak_outer_nm: newton_metres(placed.peak.outer),
            peak_middle_nm: newton_metres(placed.peak.middle),
        }
    };
    assembly.bundles.iter().map(entry).collect()
}

fn totals(assembly: &StructurePlan, bundles: &[BundleEntry]) -> Totals {
    let sum = |of: fn(&BundleEntry) -> u32| bundles.iter().map(of).sum();
    let most = |of: fn(&BundleEntry) -> f64| bundles.iter().map(of).fold(0.0, f64::max);
    Totals {
        hand_overs: sum(|b| b.hand_overs),
        connections: sum(|b| b.connections),
        connections_lower: assembly.lower,
        turns: sum(|b| b.turns),
        degrees: sum(|b| b.degrees),
        peak_outer_nm: most(|b| b.peak_outer_nm),
        peak_middle_nm: most(|b| b.peak_middle_nm),
        refutations: assembly.refutations,
    }
}

fn failure_entry(failure: &Failure, names: &Names<'_>) -> FailureEntry {
    let entry = |reason: &str, text: String| FailureEntry {
        reason: reason.to_owned(),
        text,
        standing: Vec::new(),
        refusals: Vec::new(),
    };
    match failure {
        Failure::Colour(piece) => entry(
            "colour",
            format!(
                "{} has cells of the other colour at its goal; no lattice motion leads there",
                names.piece(*piece)
            ),
        ),
        Failure::TooFew => entry("too-few", "there are fewer metamodules than seeds".to_owned()),
        Failure::Unstable(reason) => {
            entry("unstable", format!("the finished structure does not stand: {}", names.reason(*reason)))
        }
        Failure::Stuck(stuck) => {
            let refusal = |(items, refusal): &(Items, RemovalRefusal<Reason>)| RefusalEntry {
                items: names.items(*items),
                reason: names.reason(refusal.reason),
                proved: refusal.is_proved,
            };
            FailureEntry {
                standing: names.items(stuck.standing),
                refusals: stuck.refusals.iter().map(refusal).collect(),
                ..entry("stuck", "nothing can be taken away from what stands".to_owned())
            }
        }
        Failure::LeftOver(pieces) => {
            let left: Vec<String> = pieces.iter().map(|p| names.piece(*p)).collect();
            let text = format!(
                "{} left over: the metamodules that could bring it are taken without it",
                left.join(", ")
            );
            entry("left-over", text)
        }
        Failure::NotPlaced { bundle, reason } => entry(
            "not-placed",
            format!("{} cannot be placed: {}", names.items(*bundle).join(" + "), names.reason(*reason)),
        ),
        Failure::Work => entry("work", "the work of the search has ended".to_owned()),
    }
}
