//! The ways of phases: along shortest paths from each oscillator to the modules of those coupled with it.

use crate::free_module::network::Network;
use crate::free_module::structure::{Joint, Structure};
use metamorph_core::ids::{ModuleId, Port};
use std::collections::{BTreeMap, BTreeSet};

/// Forwarding table of one module for the phases of all oscillators. Modules that know the same structure compute
/// consistent tables.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Routes {
    /// The ports by which a phase leaves.
    onward: BTreeMap<Joint, BTreeSet<Port>>,
}

impl Routes {
    /// Returns the routes through a module.
    pub fn of(structure: &Structure, network: &Network, module: ModuleId) -> Routes {
        let graph = structure.graph();
        let mut receivers: BTreeMap<Joint, BTreeSet<ModuleId>> = BTreeMap::new();
        for (a, b) in &network.couplings {
            for (from, to) in [(a, b), (b, a)] {
                receivers.entry(*from).or_default().insert(to.module());
            }
        }
        let mut routes = Routes::default();
        for (oscillator, receivers) in receivers {
            let search = graph.search(oscillator.module().index());
            for receiver in receivers {
                let path = search.path(receiver.index());
                let next = path.windows(2).find(|step| step[0] == module.index()).map(|step| step[1]);
                let port = next.and_then(|next| port(structure, module, ModuleId(next as u32)));
                routes.onward.entry(oscillator).or_default().extend(port);
            }
        }
        routes
    }

    /// Returns the ports by which the phase of an oscillator leaves this module.
    pub fn onward(&self, oscillator: Joint) -> impl Iterator<Item = Port> + '_ {
        self.onward.get(&oscillator).into_iter().flatten().copied()
    }
}

/// Returns the first port of a module to another.
fn port(structure: &Structure, from: ModuleId, to: ModuleId) -> Option<Port> {
    let ends = structure.connections().iter().flat_map(|c| [*c, c.reversed()]);
    ends.filter(|c| (c.a, c.b) == (from, to)).map(|c| Port(c.at as u8)).min()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::free_module::named;
    use crate::free_module::network::{Morphology, NetworkKind};

    /// Every phase arrives once in every module that needs it, and nowhere else than on the way.
    #[test]
    fn every_phase_reaches_all_that_are_coupled_with_it() {
        for name in named::NAMES {
            let structure = named::structure(name).unwrap();
            for kind in NetworkKind::ALL {
                let network = Morphology::of(&structure).network(kind).unwrap();
                let routes: Vec<Routes> =
                    structure.modules().map(|m| Routes::of(&structure, &network, m)).collect();
                for oscillator in &network.oscillators {
                    let mut reached = BTreeSet::from([oscillator.module()]);
                    let mut edge = vec![oscillator.module()];
                    while let Some(module) = edge.pop() {
                        for port in routes[module.index()].onward(*oscillator) {
                            let docked =
                                super::super::message::Docking::of(&structure, module).0[port.index()];
                            let next = docked.unwrap().peer;
                            assert!(reached.insert(next), "{name} {kind}: {oscillator} twice at {next}");
                            edge.push(next);
                        }
                    }
                    let coupled = network.couplings.iter().filter_map(|(a, b)| match oscillator {
                        o if o == a => Some(b.module()),
                        o if o == b => Some(a.module()),
                        _ => None,
                    });
                    assert!(coupled.into_iter().all(|m| reached.contains(&m)), "{name} {kind}: {oscillator}");
                }
            }
        }
    }
}
