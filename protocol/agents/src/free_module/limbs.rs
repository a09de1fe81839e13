//! The body and limb finder (BLF, thesis 7.4.1).
//!
//! The thesis disagrees with itself on the least size of a cycle; here a cycle component has at least 3 modules, and one
//! of 2 is a bridge. One rule is ours: a part that touches two connected parts of the body is a link between them and
//! belongs to the body. By the thesis's rule alone a ring and a fork would be two bodies with a limb in between.

use super::graph::Graph;
use super::structure::Structure;
use metamorph_core::ids::ModuleId;
use serde::Serialize;
use std::collections::BTreeSet;

/// The division of a structure into body and limbs. Every module is in exactly one part: in the cyclic body, in the
/// linear body or in one limb. All lists are in increasing order.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Partition {
    /// The biconnected components of the graph of modules.
    pub biconnected: Vec<Vec<ModuleId>>,
    /// Modules of cycles without which the others fall apart.
    pub cyclic: Vec<ModuleId>,
    /// Modules of bridges without which the others are more than two parts.
    pub selected: Vec<ModuleId>,
    /// The selected modules and the shortest paths between them, with the links, without the cyclic body.
    pub linear: Vec<ModuleId>,
    /// The limbs, in the order of their least modules.
    pub limbs: Vec<Vec<ModuleId>>,
    /// Parts between two connected parts of the body; they are in the linear body.
    pub links: Vec<Vec<ModuleId>>,
}

impl Partition {
    /// Returns true if a body was found. A chain, a ring and a ring with one tail have none.
    pub fn has_body(&self) -> bool {
        !(self.cyclic.is_empty() && self.linear.is_empty())
    }
}

/// Divides a structure into body and limbs. Without a body, there are no limbs either.
pub fn partition(structure: &Structure) -> Partition {
    let graph = structure.graph();
    let biconnected = graph.biconnected();
    let cyclic = cyclic_body(&graph, &biconnected);
    let selected = selected(&graph, &biconnected);
    let mut linear = backbone(&graph, &selected);
    linear.retain(|m| !cyclic.contains(m));
    let body: BTreeSet<usize> = cyclic.union(&linear).copied().collect();
    let (mut limbs, mut links) = (Vec::new(), Vec::new());
    if !body.is_empty() {
        let parts = graph.induced(&body).parts();
        for part in graph.without(&body).parts() {
            let touches = |body: &Vec<usize>| {
                part.iter().any(|m| graph.neighbours(*m).iter().any(|n| body.binary_search(n).is_ok()))
            };
            let touched = parts.iter().filter(|body| touches(body)).count();
            if touched > 1 { links.push(part) } else { limbs.push(part) }
        }
    }
    linear.extend(links.iter().flatten());
    Partition {
        biconnected: biconnected.into_iter().map(ids).collect(),
        cyclic: ids(cyclic),
        selected: ids(selected),
        linear: ids(linear),
        limbs: limbs.into_iter().map(ids).collect(),
        links: links.into_iter().map(ids).collect(),
    }
}

fn ids(modules: impl IntoIterator<Item = usize>) -> Vec<ModuleId> {
    modules.into_iter().map(|m| ModuleId(m as u32)).collect()
}

/// Returns the modules of cycle components without which the others are at least two parts.
fn cyclic_body(graph: &Graph, biconnected: &[Vec<usize>]) -> BTreeSet<usize> {
    let splits = |cycle: &Vec<usize>| graph.without(&cycle.iter().copied().collect()).parts().len() >= 2;
    biconnected.iter().filter(|c| c.len() >= 3 && splits(c)).flatten().copied().collect()
}

/// Returns the articulation points of bridges without which the others are more than two parts.
fn selected(graph: &Graph, biconnected: &[Vec<usize>]) -> BTreeSet<usize> {
    let bridges = biconnected.iter().filter(|c| c.len() == 2);
    let ends: BTreeSet<usize> = bridges.flatten().copied().collect();
    // More than two parts: such a module is an articulation point.
    ends.into_iter().filter(|m| graph.without(&BTreeSet::from([*m])).parts().len() > 2).collect()
}

/// Returns the selected modules and a shortest path between every two of them, searched from the smaller one.
fn backbone(graph: &Graph, selected: &BTreeSet<usize>) -> BTreeSet<usize> {
    let mut all = selected.clone();
    for from in selected {
        let search = graph.search(*from);
        // Invariant: a structure is connected, so every module can be reached.
        selected.range(from + 1..).for_each(|to| all.extend(search.path(*to)));
    }
    all
}
