//! Link-state database: the newest statement of every module, from which an agent knows the structure.

use super::message::{Docked, LinkState};
use crate::free_module::structure::{Connection, Structure};
use metamorph_core::digest::Portable;
use metamorph_core::ids::{Incarnation, ModuleId};
use metamorph_roombots::connector::Connector;
use siphasher::sip::SipHasher13;
use std::collections::BTreeMap;
use std::hash::{Hash, Hasher};

/// The newest link state of every module; at most as many as modules have numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LinkStates {
    of: BTreeMap<ModuleId, LinkState>,
    /// The latest incarnation of a module that the controller has declared dead.
    dead: BTreeMap<ModuleId, Incarnation>,
}

impl LinkStates {
    /// Takes a statement. Returns true if it is news.
    pub fn learn(&mut self, link: LinkState) -> bool {
        let known = self.of.get(&link.module);
        let is_news = known.is_none_or(|known| link.is_newer_than(known));
        if is_news {
            self.of.insert(link.module, link);
        }
        is_news
    }
    /// Takes the controller's word that an incarnation of a module is dead. Returns true if it is news.
    pub fn bury(&mut self, module: ModuleId, incarnation: Incarnation) -> bool {
        let before = self.dead.get(&module).copied();
        self.dead.insert(module, before.unwrap_or_default().max(incarnation));
        before.is_none_or(|before| incarnation > before)
    }
    fn is_dead(&self, link: &LinkState) -> bool {
        self.dead.get(&link.module).is_some_and(|dead| *dead >= link.incarnation)
    }
    /// Iterates over all statements, beginning after this module and around the end.
    pub fn after(&self, module: ModuleId) -> impl Iterator<Item = &LinkState> {
        let later = self.of.range(ModuleId(module.0 + 1)..);
        later.chain(self.of.range(..=module)).map(|(_, link)| link)
    }

    /// Returns a hash of all statements, and of which modules are dead.
    pub fn fingerprint(&self) -> u64 {
        let mut hasher = SipHasher13::new();
        let mut portable = Portable::new(&mut hasher);
        for link in self.of.values() {
            (link.module, link.incarnation, link.number, self.is_dead(link)).hash(&mut portable);
            for docked in &link.docking.0 {
                docked.map(|d| (d.peer, d.connector as u8, d.rotation)).hash(&mut portable);
            }
        }
        drop(portable);
        hasher.finish()
    }

    /// Returns the structure, in which the dead are passive, if every docked module has stated the same connection and all are connected.
    pub fn structure(&self) -> Option<Structure> {
        let mut connections = Vec::new();
        for link in self.of.values() {
            for (at, docked) in Connector::ALL.into_iter().zip(link.docking.0) {
                let Some(docked) = docked else { continue };
                let back = self.of.get(&docked.peer)?.docking.0[docked.connector as usize];
                let expected = Docked { peer: link.module, connector: at, rotation: docked.rotation };
                if back != Some(expected) {
                    return None;
                }
                let Docked { peer, connector, rotation } = docked;
                let connection = Connection { a: link.module, at, b: peer, to: connector, rotation };
                if (link.module, at) < (peer, connector) {
                    connections.push(connection);
                }
            }
        }
        let members = self.of.values().map(|link| (link.module, !self.is_dead(link))).collect();
        Structure::of(&members, &connections).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::free_module::gait::message::Docking;
    use crate::free_module::named;

    fn statements(structure: &Structure) -> Vec<LinkState> {
        structure
            .modules()
            .map(|m| LinkState {
                module: m,
                incarnation: Incarnation(0),
                number: 1,
                docking: Docking::of(structure, m),
            })
            .collect()
    }

    #[test]
    fn all_statements_together_are_the_structure() {
        let mut quad = named::structure("quad5-unsym").unwrap();
        quad.set_passive(ModuleId(3));
        let mut known = LinkStates::default();
        assert!(known.bury(ModuleId(3), Incarnation(0)) && !known.bury(ModuleId(3), Incarnation(0)));
        for (i, link) in statements(&quad).into_iter().enumerate() {
            assert_eq!(known.structure(), None, "{i} statements");
            assert!(known.learn(link) && !known.learn(link));
        }
        assert_eq!(known.structure(), Some(quad.clone()));
        // A later incarnation of the dead module is alive.
        let reborn = LinkState { incarnation: Incarnation(1), ..statements(&quad)[3] };
        assert!(known.learn(reborn));
        assert_eq!(known.structure(), named::structure("quad5-unsym"));
    }

    #[test]
    fn newer_statements_count_and_contradictions_do_not() {
        let quad = named::structure("quad5-sym").unwrap();
        let mut known = LinkStates::default();
        assert!(statements(&quad).into_iter().all(|link| known.learn(link)));
        let before = known.fingerprint();
        let undocked = LinkState { number: 2, docking: Docking::default(), ..statements(&quad)[4] };
        assert!(known.learn(undocked));
        assert_ne!(known.fingerprint(), before);
        assert_eq!(known.structure(), None, "module 0 still states the connection");
        let old = LinkState { number: 1, ..undocked };
        assert!(!known.learn(old));
        assert!(known.learn(LinkState { incarnation: Incarnation(1), number: 0, ..undocked }));
    }
}
