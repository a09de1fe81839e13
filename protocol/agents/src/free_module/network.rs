//! Articulations of a structure, and networks of oscillators on its joints (thesis 7.4, 7.5).
//!
//! The full network (FO) has an oscillator per joint. The reduced one (BLF) has one per articulation: spine, hip, knee
//! and ankle; all other joints are locked at 0. With symmetry (SYM, BLF-SYM) oscillators of symmetric limbs share
//! amplitude and offset, never lags; hips in the body are not shared.

use super::graph::Graph;
use super::limbs::{Partition, partition};
use super::structure::{JOINTS, Joint, Structure};
use super::symmetry::{Levels, groups};
use metamorph_core::ids::ModuleId;
use metamorph_core::names;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use thiserror::Error;

/// Which joints have oscillators, and which of these share parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NetworkKind {
    /// An oscillator per joint.
    Fo,
    /// An oscillator per articulation.
    Blf,
    /// An oscillator per articulation; symmetric limbs share.
    BlfSym,
    /// An oscillator per joint; symmetric limbs share.
    Sym,
}

names!(NetworkKind { Fo => "fo", Blf => "blf", BlfSym => "blf-sym", Sym => "sym" });

impl NetworkKind {
    const fn is_reduced(self) -> bool {
        matches!(self, NetworkKind::Blf | NetworkKind::BlfSym)
    }
    const fn is_symmetric(self) -> bool {
        matches!(self, NetworkKind::Sym | NetworkKind::BlfSym)
    }
}

impl fmt::Display for NetworkKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Which lags are parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Lags {
    /// Those of a spanning tree of the couplings. The others follow, so that lags around a cycle add up to 0.
    Tree,
    /// Those of all couplings, as in the thesis. Lags that do not add up pull the phases apart.
    Thesis,
}

/// The part that a joint plays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// One per connected part of the linear body.
    Spine,
    /// Between body and limb.
    Hip,
    /// In the middle of a limb.
    Knee,
    /// Between knee and pod.
    Ankle,
}

names!(Role { Spine => "spine", Hip => "hip", Knee => "knee", Ankle => "ankle" });

/// The articulations of a limb.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Limb {
    /// Its modules.
    pub modules: Vec<ModuleId>,
    /// The hip; `None` if no joint on the way to the pod moves. It may belong to several limbs.
    pub hip: Option<Joint>,
    /// The knee, if the limb is long enough and the module moves.
    pub knee: Option<Joint>,
    /// The ankle, likewise.
    pub ankle: Option<Joint>,
    /// The joint of the limb that is farthest from the hip.
    pub pod: Joint,
    /// Labels of connections by their distance from the body; see [`Levels`].
    pub labels: Vec<Vec<u64>>,
}

/// A structure with body, limbs and articulations: all that networks are made from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Morphology {
    structure: Structure,
    joints: Graph,
    /// Body and limbs.
    pub partition: Partition,
    /// The limbs, in the order of the partition.
    pub limbs: Vec<Limb>,
    /// The spines, in increasing order.
    pub spines: Vec<Joint>,
    /// Groups of symmetric limbs, as indices into `limbs`.
    pub symmetric: Vec<Vec<usize>>,
    levels: Vec<Levels>,
}

impl Morphology {
    /// Analyses a structure.
    pub fn of(structure: &Structure) -> Morphology {
        let partition = partition(structure);
        let levels: Vec<Levels> = partition.limbs.iter().map(|l| Levels::of(structure, l)).collect();
        let mut of = Morphology {
            structure: structure.clone(),
            joints: structure.joint_graph(),
            symmetric: groups(&partition, &levels),
            limbs: Vec::new(),
            spines: Vec::new(),
            partition,
            levels,
        };
        of.limbs = (0..of.levels.len()).filter_map(|i| of.limb(i)).collect();
        of.spines = of.find_spines();
        of
    }

    fn moves(&self, joint: Joint) -> bool {
        self.structure.is_active(joint.module())
    }

    /// Returns the joints of modules as nodes.
    fn joints_of<'a>(&self, modules: impl IntoIterator<Item = &'a ModuleId>) -> BTreeSet<usize> {
        let three = |m: &ModuleId| (0..JOINTS).map(move |j| (*m, j)).collect::<Vec<_>>();
        modules.into_iter().flat_map(three).map(|(m, j)| Joint::new(m, j).index()).collect()
    }

    fn limb(&self, index: usize) -> Option<Limb> {
        let modules = &self.partition.limbs[index];
        let ends = self.structure.connections().iter().flat_map(|c| [*c, c.reversed()]);
        let bases = ends.filter(|c| !modules.contains(&c.a) && modules.contains(&c.b));
        // Invariant: a structure is connected, so a limb touches the body.
        let [of_body, of_limb] = bases.map(|c| c.joints()).min()?;
        let in_body = self.partition.linear.contains(&of_body.module()) && self.moves(of_body);
        let from = if in_body { of_body } else { of_limb };
        let mut nodes = self.joints_of(modules);
        nodes.insert(from.index());
        let search = self.joints.induced(&nodes).search(from.index());
        let (pod, _) = search.farthest();
        let path: Vec<Joint> = search.path(pod).into_iter().map(joint).collect();
        // The joints of a passive module do not move: the hip is then the first joint beyond that does.
        let start = path.iter().position(|j| self.moves(*j));
        let path = &path[start.unwrap_or(path.len() - 1)..];
        let (length, middle) = (path.len() - 1, (path.len() - 1) / 2);
        let articulation = |there: bool, at: usize| Some(path[at]).filter(|j| there && self.moves(*j));
        Some(Limb {
            modules: modules.clone(),
            hip: start.map(|_| path[0]),
            knee: articulation(length >= 3, middle),
            ankle: articulation(length >= 3 && length - middle >= 3, middle + (length - middle) / 2),
            pod: joint(pod),
            labels: self.levels[index].labels.clone(),
        })
    }

    /// Returns for each connected part of the linear body the joint that is no hip and has the least eccentricity.
    fn find_spines(&self) -> Vec<Joint> {
        let linear = self.partition.linear.iter().map(|m| m.index()).collect();
        let hips = self.hips();
        let spine = |part: Vec<usize>| {
            let modules: Vec<ModuleId> = part.into_iter().map(|m| ModuleId(m as u32)).collect();
            let nodes = self.joints_of(&modules);
            let graph = self.joints.induced(&nodes);
            let free = nodes.into_iter().filter(|n| self.moves(joint(*n)) && !hips.contains(&joint(*n)));
            free.min_by_key(|n| (graph.search(*n).farthest().1, *n)).map(joint)
        };
        self.structure.graph().induced(&linear).parts().into_iter().filter_map(spine).collect()
    }

    /// Returns the hips, each once, in increasing order.
    pub fn hips(&self) -> Vec<Joint> {
        self.limbs.iter().filter_map(|l| l.hip).collect::<BTreeSet<_>>().into_iter().collect()
    }

    /// Returns the articulations with their roles.
    pub fn roles(&self) -> BTreeMap<Joint, Role> {
        let spines = self.spines.iter().map(|s| (*s, Role::Spine));
        let of_limbs = self
            .limbs
            .iter()
            .flat_map(|l| [(l.hip, Role::Hip), (l.knee, Role::Knee), (l.ankle, Role::Ankle)].into_iter());
        spines.chain(of_limbs.filter_map(|(joint, role)| Some((joint?, role)))).collect()
    }

    /// Returns the articulations that have an oscillator in a network of this kind; none in a full network.
    pub fn articulations(&self, kind: NetworkKind) -> BTreeMap<Joint, Role> {
        if kind.is_reduced() && self.partition.has_body() { self.roles() } else { BTreeMap::new() }
    }

    /// Makes a network. A structure without a body has no reduced network, and gets the full one.
    ///
    /// # Errors
    /// Refuses a structure without a joint that moves.
    pub fn network(&self, kind: NetworkKind) -> Result<Network, NoOscillators> {
        let reduced = kind.is_reduced() && self.partition.has_body();
        let (oscillators, couplings) = if reduced { self.reduced() } else { self.full() };
        if oscillators.is_empty() {
            return Err(NoOscillators);
        }
        let shared = if kind.is_symmetric() { self.shared(reduced) } else { Vec::new() };
        let mut group: Vec<usize> = (0..oscillators.len()).collect();
        for alike in shared {
            let places: Vec<usize> = alike.iter().filter_map(|j| oscillators.binary_search(j).ok()).collect();
            if let Some(first) = places.iter().min() {
                places.iter().for_each(|p| group[*p] = *first);
            }
        }
        // From the least members of groups to consecutive numbers.
        let firsts: Vec<usize> = (0..group.len()).filter(|i| group[*i] == *i).collect();
        let group = group.iter().map(|g| firsts.partition_point(|f| f < g)).collect();
        let tree = spanning_tree(&oscillators, &couplings);
        Ok(Network { oscillators, couplings, group, tree })
    }

    fn full(&self) -> (Vec<Joint>, Vec<(Joint, Joint)>) {
        let oscillators = self.joints.nodes().map(joint).filter(|j| self.moves(*j)).collect();
        let edges = self.joints.edges().map(|(a, b)| (joint(a), joint(b)));
        (oscillators, edges.filter(|(a, b)| self.moves(*a) && self.moves(*b)).collect())
    }

    fn reduced(&self) -> (Vec<Joint>, Vec<(Joint, Joint)>) {
        let hips = self.hips();
        let mut couplings = pairs(&self.spines);
        couplings.extend(pairs(&hips));
        for hip in &hips {
            let search = self.joints.search(hip.index());
            let nearest = self.spines.iter().min_by_key(|s| (search.distance(s.index()), **s));
            couplings.extend(nearest.map(|spine| (*hip, *spine)));
        }
        for limb in &self.limbs {
            let chain: Vec<Joint> = [limb.hip, limb.knee, limb.ankle].into_iter().flatten().collect();
            couplings.extend(chain.windows(2).map(|w| (w[0], w[1])));
        }
        (self.roles().into_keys().collect(), couplings)
    }

    /// Returns sets of joints that share amplitude and offset.
    fn shared(&self, reduced: bool) -> Vec<Vec<Joint>> {
        let mut all = Vec::new();
        for group in &self.symmetric {
            if !reduced {
                let length = group.iter().map(|i| self.levels[*i].joints.len()).min().unwrap_or(0);
                all.extend((0..length).map(|k| group.iter().map(|i| self.levels[*i].joints[k]).collect()));
                continue;
            }
            let limbs = || group.iter().map(|i| &self.limbs[*i]);
            let own_hip = |l: &Limb| l.hip.filter(|h| l.modules.contains(&h.module()));
            all.push(limbs().filter_map(own_hip).collect());
            all.push(limbs().filter_map(|l| l.knee).collect());
            all.push(limbs().filter_map(|l| l.ankle).collect());
        }
        all
    }
}

fn joint(node: usize) -> Joint {
    Joint(node as u16)
}

fn pairs(joints: &[Joint]) -> Vec<(Joint, Joint)> {
    let after = |i: usize| joints[i + 1..].iter().map(move |b| (joints[i], *b));
    (0..joints.len()).flat_map(after).collect()
}

/// Returns for each coupling whether it joins oscillators that those before it do not.
fn spanning_tree(oscillators: &[Joint], couplings: &[(Joint, Joint)]) -> Vec<bool> {
    let mut part: BTreeMap<Joint, usize> = oscillators.iter().enumerate().map(|(i, j)| (*j, i)).collect();
    let joins = |(a, b): &(Joint, Joint)| {
        let (a, b) = (part[a], part[b]);
        part.values_mut().filter(|p| **p == b).for_each(|p| *p = a);
        a != b
    };
    couplings.iter().map(joins).collect()
}

/// No module of the structure can move a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("no joint moves: all modules are passive")]
pub struct NoOscillators;

/// Oscillators on joints, and their couplings.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Network {
    /// The joints with an oscillator, in increasing order.
    pub oscillators: Vec<Joint>,
    /// Coupled pairs. A lag is the phase of the second less that of the first.
    pub couplings: Vec<(Joint, Joint)>,
    /// For each oscillator the number of the amplitude and offset that it uses.
    pub group: Vec<usize>,
    /// For each coupling whether it is part of the spanning tree.
    pub tree: Vec<bool>,
}

impl Network {
    /// Returns the number of different amplitudes, which is that of offsets.
    pub fn groups(&self) -> usize {
        self.group.iter().max().map_or(0, |g| g + 1)
    }
    /// Returns the number of lags that are parameters.
    pub fn lags(&self, lags: Lags) -> usize {
        match lags {
            Lags::Tree => self.tree.iter().filter(|t| **t).count(),
            Lags::Thesis => self.couplings.len(),
        }
    }
    /// Returns the number of parameters: amplitudes, offsets and lags.
    pub fn parameters(&self, lags: Lags) -> usize {
        2 * self.groups() + self.lags(lags)
    }
}
