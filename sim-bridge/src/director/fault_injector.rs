//! Carries out a schedule of faults: faults of processes become commands, faults of bodies are left to the
//! owner of the world. The same for every family.

use crate::director::faults::{Fault, FaultRecord, Schedule};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::record::Outside;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::Time;
use std::collections::{BTreeSet, VecDeque};

/// The kind of [`DirectorPort::input`](super::port::DirectorPort::input) that is a fault: its text and its time in
/// nanoseconds, such as `kill 7@2000000001`.
pub const FAULT_INPUT: &str = "fault";

/// A schedule and the position in it.
#[derive(Clone, Debug, Default)]
pub struct FaultInjector {
    schedule: Schedule,
    next: usize,
    paused: BTreeSet<ModuleId>,
    struck: Vec<FaultRecord>,
    crashed: u64,
    restarted: u64,
}

impl FaultInjector {
    /// Creates an injector at the start of a schedule.
    pub fn new(schedule: Schedule) -> FaultInjector {
        FaultInjector { schedule, ..FaultInjector::default() }
    }
    /// Adds a fault to the schedule.
    ///
    /// # Errors
    /// Returns what is wrong with the input: it is of another kind, it names no fault of one of `modules` modules, or
    /// its time is past.
    pub fn input(&mut self, now: Time, kind: &str, bytes: &[u8], modules: usize) -> Result<(), String> {
        if kind != FAULT_INPUT {
            return Err(format!("this director takes no input of kind `{kind}`"));
        }
        let text = String::from_utf8_lossy(bytes);
        let (fault, at) = text.rsplit_once('@').ok_or_else(|| format!("`{text}` has no time"))?;
        let at = at
            .parse()
            .ok()
            .map(Time)
            .filter(|at| *at >= now)
            .ok_or_else(|| format!("the time of `{text}` is past"))?;
        let fault: Fault = fault.parse()?;
        match fault.module() {
            Some(id) if id.index() >= modules => {
                Err(format!("there is no module {id}; they are numbered from 0 to {}", modules - 1))
            }
            _ => {
                self.schedule.insert(self.next, at, fault);
                Ok(())
            }
        }
    }
    /// Returns the next fault that is due.
    pub fn due(&mut self, now: Time) -> Option<Fault> {
        let (_, fault) = self.schedule.get(self.next).filter(|(at, _)| *at <= now)?;
        self.next += 1;
        Some(fault)
    }
    /// Returns when the next fault is due.
    pub fn next_at(&self) -> Time {
        self.schedule.get(self.next).map_or(Time::NEVER, |(at, _)| at)
    }
    /// Returns true if an event is still to come: a fault, or the end of a pause.
    pub fn is_pending(&self) -> bool {
        self.next < self.schedule.len() || !self.paused.is_empty()
    }
    /// Injects a fault; `effect` describes the state it finds, and `alive` is true if the process it hits
    /// lives.
    pub fn inject<O>(
        &mut self,
        now: Time,
        fault: Fault,
        alive: bool,
        effect: String,
        commands: &mut VecDeque<Command<O>>,
    ) {
        self.struck.push(FaultRecord { at: now, fault, effect });
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
            // The first two hit bodies, the next the world; the last has happened already.
            Fault::Stick(_) | Fault::Unstick(_) | Fault::World(..) | Fault::External(_) => {}
        }
    }
    /// Notes that a process was killed, stopped or continued from outside; `found` describes its state.
    pub fn external(&mut self, now: Time, id: ModuleId, what: &Outside, found: &str) {
        let effect = format!("{what}; {found}");
        self.struck.push(FaultRecord { at: now, fault: Fault::External(id), effect });
    }
    /// Notes that a process has ended.
    pub fn died(&mut self, id: ModuleId) {
        self.crashed += 1;
        self.paused.remove(&id);
    }
    /// Returns the effects of the faults so far.
    pub fn struck(&self) -> &[FaultRecord] {
        &self.struck
    }
    /// Returns how many processes died, and how many were restarted.
    pub fn crashed_and_restarted(&self) -> (u64, u64) {
        (self.crashed, self.restarted)
    }
}
