//! The six contacts of a cube: the session of each, and the last beacon of its neighbour.
//!
//! Questions such as "which neighbours are alive" are asked dozens of times a step, so the answers are kept
//! as masks of faces. *Invariant.* The masks are determined by the other fields and the time of the step; a debug
//! build recomputes and compares them at the start of every step.

use super::epoch::Epoch;
use super::message::{Beacon, Role};
use core::hash::Hash;
use metamorph_core::digest::Portable;
use metamorph_core::ids::{Port, Session};
use metamorph_core::lattice::Face;
use metamorph_core::time::{Span, Time};

/// Sets of faces, a bit for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
struct Masks {
    /// There is a contact.
    touching: u8,
    /// The neighbour has been heard in this session.
    heard: u8,
    /// The neighbour is believed alive.
    live: u8,
    /// The neighbour is alive and can carry a walker.
    supports: u8,
    /// The cell outside can hold a walker: it is empty, or holds one that moves on.
    open: u8,
}

/// The six contacts of a cube.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Sides {
    masks: Masks,
    /// Neighbours that are certified dead.
    certified_dead: u8,
    sessions: [Option<Session>; 6],
    /// When each neighbour was last heard or, if it has not been heard in this session, when the session began; zero if that
    /// followed another session at once.
    heard_at: [Time; 6],
    /// The first instant at which a live neighbour has been silent for too long.
    silent_at: Time,
    /// For each face, the epoch in which the dead neighbour is certified to have been finalized. The certificate counts
    /// even if the neighbour was never heard.
    died_final: [Option<Epoch>; 6],
    /// The last beacon of each neighbour in this session.
    peers: [Option<Beacon>; 6],
}

impl Sides {
    pub fn new() -> Sides {
        Sides {
            masks: Masks { open: 0b11_1111, ..Masks::default() },
            certified_dead: 0,
            sessions: [None; 6],
            heard_at: [Time::ZERO; 6],
            silent_at: Time::NEVER,
            died_final: [None; 6],
            peers: [None; 6],
        }
    }

    /// Feeds one contact into a hash; see `digest`.
    pub fn digest(&self, face: Face, hasher: &mut Portable<'_>) {
        let i = face.index();
        let peer = self.peers[i].as_ref().map(|beacon| (beacon, self.heard_at[i]));
        (self.sessions[i], peer, self.is_certified_dead(face), self.died_final[i]).hash(hasher);
    }
    /// Reads the memory that a beacon from a neighbour will need; see [`Agent::look_ahead`](metamorph_core::agent::Agent).
    pub fn look_ahead(&self, port: Port) -> u64 {
        let peer = self.peers.get(port.index()).and_then(Option::as_ref);
        let peer = peer.map_or(0, |beacon| u64::from(beacon.field[3].source) ^ u64::from(beacon.spoken));
        u64::from(self.masks.heard) ^ self.heard_at[0].0 ^ peer
    }
    pub fn session(&self, face: Face) -> Option<Session> {
        self.sessions[face.index()]
    }
    pub fn is_touching(&self, face: Face) -> bool {
        self.masks.touching & face.bit() != 0
    }
    /// Returns the neighbour on a face, if it has been heard in this session.
    pub fn peer(&self, face: Face) -> Option<&Beacon> {
        self.peers[face.index()].as_ref()
    }
    /// Returns when the neighbour on a face was last heard or, if it was not, when its session began.
    pub fn heard_at(&self, face: Face) -> Time {
        self.heard_at[face.index()]
    }
    pub fn is_certified_dead(&self, face: Face) -> bool {
        self.certified_dead & face.bit() != 0
    }
    pub fn died_final(&self, face: Face) -> Option<Epoch> {
        self.died_final[face.index()]
    }
    fn among(&self, mask: u8, face: Face) -> Option<&Beacon> {
        if mask & face.bit() != 0 { self.peers[face.index()].as_ref() } else { None }
    }
    /// Returns the neighbour on a face, if it is believed alive.
    pub fn live(&self, face: Face) -> Option<&Beacon> {
        self.among(self.masks.live, face)
    }
    /// Returns the neighbour on a face, if it is a live module that can carry a walker.
    pub fn support(&self, face: Face) -> Option<&Beacon> {
        self.among(self.masks.supports, face)
    }
    /// Returns the faces with a contact.
    pub fn touching_mask(&self) -> u8 {
        self.masks.touching
    }
    /// Returns the faces with a live neighbour that can carry a walker.
    pub fn support_mask(&self) -> u8 {
        self.masks.supports
    }
    /// Returns the faces whose neighbour has been heard in this session.
    pub fn heard_mask(&self) -> u8 {
        self.masks.heard
    }
    /// Returns the faces whose neighbour is certified dead.
    pub fn certified_mask(&self) -> u8 {
        self.certified_dead
    }
    /// Returns the faces with a live neighbour.
    pub fn live_mask(&self) -> u8 {
        self.masks.live
    }
    /// Returns the faces outside which the cell can hold a walker.
    pub fn open_mask(&self) -> u8 {
        self.masks.open
    }
    /// Returns the faces whose neighbour is certified dead, or has been heard and is silent.
    pub fn gone(&self) -> u8 {
        self.certified_dead | (self.masks.heard & !self.masks.live)
    }
    /// Returns true if the cell outside a face can hold a walker: it is empty, or holds one that moves on.
    pub fn is_open(&self, face: Face) -> bool {
        self.masks.open & face.bit() != 0
    }
    /// Returns the faces whose neighbour has fallen silent and is not certified dead: modules behind it
    /// cannot be heard either.
    pub fn missed(&self) -> u8 {
        self.masks.heard & !self.masks.live & !self.certified_dead
    }
    /// Returns true if a neighbour has not been heard yet, and is not certified dead.
    pub fn any_unheard(&self) -> bool {
        self.masks.touching & !self.masks.heard & !self.certified_dead != 0
    }

    /// Returns true if a neighbour has not been heard for longer than `patience` since its session began, and is not certified
    /// dead.
    pub fn any_unheard_for(&self, now: Time, patience: Span) -> bool {
        let unheard = self.masks.touching & !self.masks.heard & !self.certified_dead;
        Face::in_mask(unheard).any(|f| now.since(self.heard_at[f.index()]) > patience)
    }

    /// Begins a session, or ends it if `session` is `None`; forgets everything about the previous neighbour. A session that follows
    /// another one at once is with a neighbour that has restarted. It counts as one that has been unheard for long, since
    /// others may slide from its body ([`Sides::any_unheard_for`]).
    pub fn begin(&mut self, now: Time, face: Face, session: Option<Session>) {
        let i = face.index();
        let is_restarted = self.sessions[i].is_some() && session.is_some();
        self.sessions[i] = session;
        self.peers[i] = None;
        self.heard_at[i] = if is_restarted { Time::ZERO } else { now };
        self.died_final[i] = None;
        self.certified_dead &= !face.bit();
        let m = &mut self.masks;
        m.touching = if session.is_some() { m.touching | face.bit() } else { m.touching & !face.bit() };
        m.heard &= !face.bit();
        self.update(face);
    }

    /// Stores the beacon of the neighbour on a face.
    pub fn hear(&mut self, now: Time, suspect: Span, face: Face, beacon: Beacon) {
        self.peers[face.index()] = Some(beacon);
        self.heard_at[face.index()] = now;
        self.masks.heard |= face.bit();
        self.masks.live |= face.bit();
        self.update(face);
        self.watch(suspect);
    }

    /// Notes that the neighbour on a face is certified dead, and the epoch in which it was finalized, if it
    /// was.
    pub fn certify_dead(&mut self, face: Face, died_final: Option<Epoch>) {
        self.certified_dead |= face.bit();
        self.died_final[face.index()] = died_final;
        self.update(face);
    }

    /// Brings the masks to the time of a step: neighbours that have been silent for too long are
    /// suspected dead.
    pub fn pass_time(&mut self, now: Time, suspect: Span) {
        if now >= self.silent_at {
            for face in Face::ALL {
                if now.since(self.heard_at[face.index()]) > suspect {
                    self.masks.live &= !face.bit();
                    self.update(face);
                }
            }
            self.watch(suspect);
        }
        debug_assert_eq!(self.masks, self.masks_anew(now, suspect));
    }

    /// Recomputes the masks of one face.
    fn update(&mut self, face: Face) {
        let (bit, m) = (face.bit(), &mut self.masks);
        m.live &= m.heard & !self.certified_dead;
        let peer = self.peers[face.index()].as_ref().filter(|_| m.live & bit != 0);
        let carries = peer.is_some_and(|b| b.role != Role::Walker);
        let moves_on = peer.is_some_and(|b| b.role == Role::Walker && !b.immobile);
        m.supports = if carries { m.supports | bit } else { m.supports & !bit };
        m.open = if moves_on || m.touching & bit == 0 { m.open | bit } else { m.open & !bit };
    }

    fn watch(&mut self, suspect: Span) {
        let first = Face::in_mask(self.masks.live).map(|f| self.heard_at[f.index()]).min();
        self.silent_at = first.map_or(Time::NEVER, |at| at + suspect + Span(1));
    }

    fn masks_anew(&self, now: Time, suspect: Span) -> Masks {
        let mut masks = Masks::default();
        for face in Face::ALL {
            let (i, bit) = (face.index(), face.bit());
            let touching = self.sessions[i].is_some();
            let silent = now.since(self.heard_at[i]) > suspect;
            let live = self.peers[i].as_ref().filter(|_| !silent && self.certified_dead & bit == 0);
            let is_walker = |b: &Beacon| b.role == Role::Walker;
            masks.touching |= if touching { bit } else { 0 };
            masks.heard |= if self.peers[i].is_some() { bit } else { 0 };
            masks.live |= if live.is_some() { bit } else { 0 };
            masks.supports |= if live.is_some_and(|b| !is_walker(b)) { bit } else { 0 };
            let open = !touching || live.is_some_and(|b| is_walker(b) && !b.immobile);
            masks.open |= if open { bit } else { 0 };
        }
        masks
    }
}
