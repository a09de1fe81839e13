//! Grants to other modules: to stay, and to keep a cell free, each with a lease.

use super::call::CARRY;
use super::message::RequestId;
use alloc::vec::Vec;
use metamorph_core::ids::{ModuleId, Token};
use metamorph_core::lattice::Face;
use metamorph_core::time::Time;

/// The largest number of locks that one module grants at the same time.
const MAX_LOCKS: usize = 16;

/// A grant: this module stays, and may keep a cell free.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Lock {
    pub id: RequestId,
    pub expires: Time,
    /// The face over which the request was passed on; `None` in the last module of the route.
    pub next: Option<Face>,
    /// The face outside which the cell is kept free.
    pub reserved: Option<Face>,
    /// The `co_owners` that the last module of the route answered with; `None` until all later modules of the route
    /// have granted.
    pub beyond: Option<u8>,
}

/// The attempt that a lock belongs to: its origin and token, and whether the controller asked for it. The controller numbers its
/// requests by itself, so one may have the token of an attempt of the called module.
type Attempt = (ModuleId, Token, bool);

impl Lock {
    fn attempt(&self) -> Attempt {
        (self.id.origin, self.id.token, self.is_of_controller())
    }
    /// Returns true if the controller asked for the lock, and not the module that it is granted to.
    pub fn is_of_controller(&self) -> bool {
        self.id.number == CARRY
    }
}

/// A release that has to be passed on: the face, and the attempt by its origin and token.
pub(super) type Forward = (Face, ModuleId, Token);

/// The locks that a module has granted.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
pub(super) struct LockTable {
    locks: Vec<Lock>,
}

impl LockTable {
    pub fn iter(&self) -> impl Iterator<Item = &Lock> {
        self.locks.iter()
    }
    pub fn find(&self, id: RequestId) -> Option<&Lock> {
        self.locks.iter().find(|l| l.id == id)
    }
    pub fn len(&self) -> usize {
        self.locks.len()
    }
    pub fn is_full(&self) -> bool {
        self.locks.len() == MAX_LOCKS
    }
    /// Returns the module, other than `origin`, for which the cell outside a face is reserved.
    pub fn reserved_for_other(&self, face: Face, origin: ModuleId) -> Option<ModuleId> {
        self.locks.iter().find(|l| l.reserved == Some(face) && l.id.origin != origin).map(|l| l.id.origin)
    }
    /// Returns the faces outside which the cell is reserved for another module than this one.
    pub fn reserved_for_others(&self, than: Option<ModuleId>) -> u8 {
        let others = self.locks.iter().filter(|l| Some(l.id.origin) != than);
        Face::mask(others.filter_map(|l| l.reserved))
    }
    /// Returns the number of reservations.
    pub fn reservation_count(&self) -> usize {
        self.locks.iter().filter(|l| l.reserved.is_some()).count()
    }
    /// Returns a module that holds a lock on this one whose lease has not ended.
    pub fn holder(&self, now: Time) -> Option<ModuleId> {
        self.locks.iter().find(|l| l.expires > now).map(|l| l.id.origin)
    }
    /// Returns when the first lease ends.
    pub fn next_expiry(&self) -> Time {
        self.locks.iter().map(|l| l.expires).min().unwrap_or(Time::NEVER)
    }

    /// Adds a lock. The caller has checked that there is room.
    pub fn grant(&mut self, lock: Lock) {
        self.locks.push(lock);
    }
    /// Drops the lock of a request that was denied further on. Returns false if the rest of the route has granted it since:
    /// then the module that asked may move already, and the lock stays.
    #[must_use]
    pub fn withdraw(&mut self, id: RequestId) -> bool {
        let is_granted = self.find(id).is_some_and(|lock| lock.beyond.is_some());
        if !is_granted {
            self.locks.retain(|l| l.id != id);
        }
        !is_granted
    }
    /// Notes that the rest of a request's route has granted it, and the co-owners that the last module named. Returns false if
    /// this module has no lock of the request any more.
    #[must_use]
    pub fn granted_beyond(&mut self, id: RequestId, co_owners: u8) -> bool {
        let lock = self.locks.iter_mut().find(|l| l.id == id);
        lock.map(|lock| lock.beyond = Some(co_owners)).is_some()
    }
    pub fn clear(&mut self) {
        self.locks.clear();
    }
    /// Drops locks whose lease has ended. Returns true if there were any.
    pub fn expire(&mut self, now: Time) -> bool {
        let before = self.locks.len();
        self.locks.retain(|l| l.expires > now);
        self.locks.len() != before
    }

    /// Drops all locks of every attempt that has a lock selected by `which`, since such an attempt is over. Returns the
    /// releases to pass on.
    pub fn release(&mut self, which: impl Fn(&Lock) -> bool) -> Vec<Forward> {
        let mut forwards: Vec<Forward> = Vec::new();
        let attempts: Vec<Attempt> = self.locks.iter().filter(|l| which(l)).map(Lock::attempt).collect();
        if attempts.is_empty() {
            return forwards;
        }
        self.locks.retain(|l| {
            let over = attempts.contains(&l.attempt());
            if let Some(next) = l.next.filter(|_| over) {
                let forward = (next, l.id.origin, l.id.token);
                if !forwards.contains(&forward) {
                    forwards.push(forward);
                }
            }
            !over
        });
        forwards
    }
}
