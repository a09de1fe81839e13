//! Carries a schedule of faults out: what hits processes becomes commands, what hits bodies is done
//! by whoever has the world. The same for every family of units.

use crate::director::faults::{Fault, Schedule, Struck};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::record::Outside;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::Time;
use std::collections::{BTreeSet, VecDeque};

/// A schedule on its way through.
#[derive(Clone, Debug, Default)]
pub struct Injector {
    schedule: Schedule,
    next: usize,
    paused: BTreeSet<ModuleId>,
    struck: Vec<Struck>,
    crashed: u64,
    restarted: u64,
}

impl Injector {
    /// Nothing has struck yet.
    pub fn new(schedule: Schedule) -> Injector {
        Injector { schedule, ..Injector::default() }
    }
    /// The next fault that is due.
    pub fn due(&mut self, now: Time) -> Option<Fault> {
        let (_, fault) = self.schedule.get(self.next).filter(|(at, _)| *at <= now)?;
        self.next += 1;
        Some(fault)
    }
    /// When the next fault is due.
    pub fn next_at(&self) -> Time {
        self.schedule.get(self.next).map_or(Time::NEVER, |(at, _)| at)
    }
    /// Whether something is still to come: a fault, or the end of a pause.
    pub fn is_pending(&self) -> bool {
        self.next < self.schedule.len() || !self.paused.is_empty()
    }
    /// A fault strikes, and finds what `effect` says; `alive` is whether the process it hits lives.
    pub fn strike<O>(
        &mut self,
        now: Time,
        fault: Fault,
        alive: bool,
        effect: String,
        commands: &mut VecDeque<Command<O>>,
    ) {
        self.struck.push(Struck { at: now, fault, effect });
        match fault {
            Fault::Kill(id) => commands.push_back(Command::Kill(id)),
            Fault::Pause(id) => {
                self.paused.insert(id);
                commands.push_back(Command::Pause(id));
            }
            Fault::Resume(id) => {
                self.paused.remove(&id);
                commands.push_back(Command::Resume(id));
            }
            Fault::Restart(id) => {
                if alive {
                    commands.push_back(Command::Kill(id));
                }
                self.restarted += 1;
                commands.push_back(Command::Restart(id));
            }
            // The first two hit bodies, the next two cells; the last has happened already.
            Fault::Stick(_)
            | Fault::Unstick(_)
            | Fault::Block(_)
            | Fault::Unblock(_)
            | Fault::External(_) => {}
        }
    }
    /// Something outside the run has done this to a process, and found it in the state that `found` says.
    pub fn external(&mut self, now: Time, id: ModuleId, what: &Outside, found: &str) {
        let effect = format!("{what}; {found}");
        self.struck.push(Struck { at: now, fault: Fault::External(id), effect });
    }
    /// A process is gone.
    pub fn died(&mut self, id: ModuleId) {
        self.crashed += 1;
        self.paused.remove(&id);
    }
    /// What each fault did.
    pub fn struck(&self) -> &[Struck] {
        &self.struck
    }
    /// How many processes died, and how many were started again.
    pub fn crashed_and_restarted(&self) -> (u64, u64) {
        (self.crashed, self.restarted)
    }
}
