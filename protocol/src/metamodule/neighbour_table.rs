//! Whom a metamodule hears: where they are, what they have been granted.

use super::message::{State, Way};
use super::motions::{Motions, Sweep};
use super::pose::Pose;
use crate::coverage::{Mark, hit};
use crate::ids::{ModuleId, Port, Session, Token};
use crate::lattice::Cell;
use crate::time::Time;

/// A lock granted to a neighbour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Grant {
    /// The neighbour's attempt.
    pub token: Token,
    /// Where it began.
    pub pose: Pose,
    /// What it sweeps.
    pub sweep: Sweep,
    /// The posture at its end.
    pub ends: u16,
    /// Until when it holds, at most.
    pub until: Time,
}

/// A neighbour in hearing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Peer {
    /// The session.
    pub session: Session,
    /// What it told last.
    pub state: Option<State>,
    /// Where it means to go, if it has told.
    pub way: Option<Way>,
    /// What it has been granted.
    pub grant: Option<Grant>,
    /// Its process is gone: what still arrives in this session was sent before.
    pub condemned: bool,
    /// Its latest attempt that is over. Requests of it or earlier ones are late copies.
    pub over: Token,
}

impl Peer {
    /// A neighbour that has said nothing yet.
    pub fn new(session: Session) -> Peer {
        Peer { session, state: None, way: None, grant: None, condemned: false, over: Token(0) }
    }
}

/// All neighbours in hearing, by port.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Peers(Vec<Option<Peer>>);

impl Peers {
    /// Nobody yet, on so many ports.
    pub fn new(ports: usize) -> Peers {
        Peers(vec![None; ports])
    }
    /// Who is on a port.
    pub fn get_mut(&mut self, port: Port) -> Option<&mut Peer> {
        self.0.get_mut(port.index())?.as_mut()
    }
    /// Whoever has said that it is this one, and its port.
    pub fn named(&mut self, id: ModuleId) -> Option<(Port, &mut Peer)> {
        let is_it = |p: &Peer| p.state.is_some_and(|s| s.id == id);
        let at = self.0.iter().position(|p| p.as_ref().is_some_and(is_it))?;
        Some((Port(at as u8), self.0.get_mut(at)?.as_mut()?))
    }
    /// Who is on a port from now on.
    pub fn set(&mut self, port: Port, peer: Option<Peer>) {
        if let Some(slot) = self.0.get_mut(port.index()) {
            *slot = peer;
        }
    }
    /// All of them.
    pub fn iter(&self) -> impl Iterator<Item = (Port, &Peer)> {
        self.0.iter().enumerate().filter_map(|(i, p)| Some((Port(i as u8), p.as_ref()?)))
    }
    /// Forgets grants that have run out. Says when the next one does.
    pub fn expire(&mut self, now: Time) -> Time {
        let mut next = Time::NEVER;
        for peer in self.0.iter_mut().flatten() {
            match peer.grant {
                Some(grant) if grant.until <= now => {
                    hit(Mark::MetaGrantExpired);
                    peer.grant = None;
                }
                Some(grant) => next = next.min(grant.until),
                None => {}
            }
        }
        next
    }
    /// Cells that neighbours have been granted.
    pub fn granted<'a>(&'a self, motions: &'a Motions) -> impl Iterator<Item = Cell> + 'a {
        let grants = self.iter().filter_map(|(_, peer)| peer.grant);
        grants.flat_map(|g| motions.swept(g.pose.state, g.sweep))
    }
}
