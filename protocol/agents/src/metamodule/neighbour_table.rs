//! The neighbours in range: their last announcements, which of them are dead, and where obstacles are.

use super::message::State;
use super::pose::Pose;
use metamorph_core::ids::{ModuleId, Port, Session};
use metamorph_core::lattice::Cell;
use std::collections::{BTreeMap, BTreeSet};

/// A neighbour in range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Neighbour {
    pub session: Session,
    /// Its last announced state; `None` if it has not been heard in this session.
    pub state: Option<State>,
    /// Its process is gone: what still arrives in this session was sent before.
    pub certified_dead: bool,
}

impl Neighbour {
    pub fn new(session: Session) -> Neighbour {
        Neighbour { session, state: None, certified_dead: false }
    }
}

/// Returns the entry of a port in a table that grows with the highest port in use.
pub(super) fn slot<T: Clone + Default>(table: &mut Vec<T>, port: Port) -> &mut T {
    if table.len() <= port.index() {
        table.resize(port.index() + 1, T::default());
    }
    &mut table[port.index()]
}

/// All neighbours in range by port, and what else stands around.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
pub(super) struct NeighbourTable {
    /// Grows with the highest port in use.
    ports: Vec<Option<Neighbour>>,
    /// The poses of the bodies whose process is certified dead.
    pub dead: BTreeMap<ModuleId, Pose>,
    /// Cells with something in them that is not a metamodule.
    pub obstacles: BTreeSet<Cell>,
}

impl NeighbourTable {
    pub fn get(&self, port: Port) -> Option<&Neighbour> {
        self.ports.get(port.index())?.as_ref()
    }
    pub fn get_mut(&mut self, port: Port) -> Option<&mut Neighbour> {
        self.ports.get_mut(port.index())?.as_mut()
    }
    /// Returns the port and the entry of the neighbour with this id, if it has been heard.
    pub fn named(&mut self, id: ModuleId) -> Option<(Port, &mut Neighbour)> {
        let is_it = |n: &Neighbour| n.state.is_some_and(|s| s.id == id);
        let at = self.ports.iter().position(|n| n.as_ref().is_some_and(is_it))?;
        Some((Port(at as u8), self.ports.get_mut(at)?.as_mut()?))
    }
    /// Starts a session on a port, or none; forgets all that belonged to the one before.
    pub fn begin(&mut self, port: Port, session: Option<Session>) {
        *slot(&mut self.ports, port) = session.map(Neighbour::new);
    }
    /// All neighbours, by port.
    pub fn iter(&self) -> impl Iterator<Item = (Port, &Neighbour)> {
        self.ports.iter().enumerate().filter_map(|(i, n)| Some((Port(i as u8), n.as_ref()?)))
    }
    /// Iterates over the last announced state of each neighbour that has been heard.
    pub fn states(&self) -> impl Iterator<Item = (Port, &State)> {
        self.iter().filter_map(|(port, n)| Some((port, n.state.as_ref()?)))
    }
    pub fn is_dead(&self, id: ModuleId) -> bool {
        self.dead.contains_key(&id)
    }
    /// Returns true if a neighbour that has not been heard may be alive: there are more unheard neighbours than unheard
    /// dead bodies within the communication range `range` of `own`.
    pub fn any_unheard(&self, own: Pose, range: u16) -> bool {
        let unheard = self.iter().filter(|(_, n)| n.state.is_none()).count();
        let is_heard = |id: ModuleId| self.states().any(|(_, s)| s.id == id);
        unheard
            > self.dead.iter().filter(|(id, pose)| own.is_within(range, **pose) && !is_heard(**id)).count()
    }
}
