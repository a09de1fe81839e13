//! The answer of `metamorph structure`, as JSON.

use crate::plan::connected::Connected;
use metamorph_protocol::free_module::limbs::Partition;
use metamorph_protocol::free_module::network::{
    Lags, Limb, Morphology, Network, NetworkKind, NoOscillators, Role,
};
use metamorph_protocol::free_module::structure::Joint;
use metamorph_protocol::ids::ModuleId;
use metamorph_text::format::digits;
use serde::Serialize;

/// The version of the JSON output.
pub const SCHEMA: u32 = 1;

/// A structure, analysed. Joints are numbers: `3 * module + joint`, with joint 0, 1, 2 for q1, q2, q3.
#[derive(Debug, Serialize)]
pub struct Answer {
    schema: u32,
    /// The name or the file.
    pub structure: String,
    /// The hash by which agents and gait files know the structure, as 16 hexadecimal digits.
    pub fingerprint: String,
    /// The number of modules.
    pub modules: usize,
    /// The number of connections.
    pub connections: usize,
    /// Modules whose joints do not move.
    pub passive: Vec<ModuleId>,
    /// True if there is a body, cyclic or linear.
    pub has_body: bool,
    /// Body and limbs.
    pub partition: Partition,
    /// The limbs with their articulations.
    pub limbs: Vec<Limb>,
    /// The spines.
    pub spines: Vec<Joint>,
    /// The articulations.
    pub roles: Vec<(Joint, Role)>,
    /// Groups of symmetric limbs, as indices of `limbs`.
    pub symmetric: Vec<Vec<usize>>,
    /// All networks.
    pub networks: Vec<Counts>,
    /// The one asked for.
    pub network: Chosen,
    /// Remarks.
    pub notes: Vec<String>,
}

/// The size of a network.
#[derive(Debug, Serialize)]
pub struct Counts {
    /// Its kind.
    pub kind: NetworkKind,
    /// Joints with an oscillator.
    pub oscillators: usize,
    /// Coupled pairs.
    pub couplings: usize,
    /// Different amplitudes, which is the number of different offsets.
    pub groups: usize,
    /// Parameters with a lag for each coupling, as in the thesis.
    pub parameters_thesis_lags: usize,
    /// Parameters with lags of a spanning tree only.
    pub parameters_tree_lags: usize,
}

/// A network with its couplings.
#[derive(Debug, Serialize)]
pub struct Chosen {
    /// Its kind.
    pub kind: NetworkKind,
    /// Joints with an oscillator.
    pub oscillators: Vec<Joint>,
    /// For each the number of the amplitude and offset that it uses.
    pub group: Vec<usize>,
    /// Coupled pairs, and whether their lag belongs to the spanning tree.
    pub couplings: Vec<(Joint, Joint, bool)>,
}

impl Answer {
    /// Analyses a structure.
    ///
    /// # Errors
    /// Refuses one without a joint that moves.
    pub fn of(name: &str, read: &Connected, kind: NetworkKind) -> Result<Answer, NoOscillators> {
        let structure = &read.structure;
        let morphology = Morphology::of(structure);
        let counts = |kind| morphology.network(kind).map(|network| Counts::of(kind, &network));
        let network = morphology.network(kind)?;
        let has_body = morphology.partition.has_body();
        let tree = network.couplings.iter().zip(&network.tree);
        Ok(Answer {
            schema: SCHEMA,
            structure: name.to_owned(),
            fingerprint: digits(structure.fingerprint()),
            modules: structure.modules().count(),
            connections: structure.connections().len(),
            passive: structure.modules().filter(|m| !structure.is_active(*m)).collect(),
            has_body,
            networks: NetworkKind::ALL.into_iter().map(counts).collect::<Result<_, _>>()?,
            network: Chosen {
                kind,
                couplings: tree.map(|((a, b), tree)| (*a, *b, *tree)).collect(),
                oscillators: network.oscillators,
                group: network.group,
            },
            notes: notes(read, has_body),
            roles: morphology.roles().into_iter().collect(),
            partition: morphology.partition,
            limbs: morphology.limbs,
            spines: morphology.spines,
            symmetric: morphology.symmetric,
        })
    }
}

impl Counts {
    fn of(kind: NetworkKind, network: &Network) -> Counts {
        Counts {
            kind,
            oscillators: network.oscillators.len(),
            couplings: network.couplings.len(),
            groups: network.groups(),
            parameters_thesis_lags: network.parameters(Lags::Thesis),
            parameters_tree_lags: network.parameters(Lags::Tree),
        }
    }
}

fn notes(read: &Connected, has_body: bool) -> Vec<String> {
    let mut notes = Vec::new();
    if !has_body {
        notes.push("no body was found: reduced networks are the full one".to_owned());
    }
    let twice = read.structure.joined_twice();
    notes.extend(twice.iter().map(|(a, b)| {
        format!("modules {a} and {b} have more than one connection; body and limbs count them as one edge")
    }));
    let has_ring = read.structure.connections().len() >= read.structure.modules().count();
    if has_ring && read.joints_deg.is_none() {
        notes.push("without joints_deg it is not known whether the ring closes".to_owned());
    }
    notes
}
