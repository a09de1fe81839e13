//! Carries out a schedule of faults: faults of processes become commands, faults of bodies are left to the
//! owner of the world. The same for every family.

use crate::director::commands::{COMMAND_INPUT, Commands};
use crate::director::faults::{Fault, FaultRecord, Origin, Schedule, Scheduled, WorldFault};
use crate::director::link_faults::LinkFault;
use metamorph_core::ids::ModuleId;
use metamorph_core::link::{HostChange, LinkChanges};
use metamorph_core::record::Outside;
use metamorph_core::runtime::Command;
use metamorph_core::time::Time;
use std::collections::{BTreeSet, VecDeque};

/// A schedule and the position in it.
#[derive(Clone, Debug, Default)]
pub struct FaultInjector {
    schedule: Schedule,
    next: usize,
    /// The origin of the fault that is being injected.
    by: Origin,
    paused: BTreeSet<ModuleId>,
    /// The changes of links by commands.
    links: LinkChanges,
    /// When the loss and the partition of the last commands end.
    link_ends: [Option<Time>; 2],
    struck: Vec<FaultRecord>,
    crashed: u64,
    restarted: u64,
    /// Modules whose process was alive when it was last killed: those of a lost host are started elsewhere.
    felled: BTreeSet<ModuleId>,
}

impl FaultInjector {
    /// Creates an injector at the start of a schedule.
    pub fn new(schedule: Schedule) -> FaultInjector {
        FaultInjector { schedule, ..FaultInjector::default() }
    }
    /// Returns the number of commands so far by which operators helped the swarm: those that are no faults.
    pub fn commanded(&self) -> usize {
        let helps = |record: &&FaultRecord| {
            let is_fault =
                matches!(record.fault, Fault::Kill(_) | Fault::Pause(_) | Fault::Stick(_) | Fault::Links(_));
            matches!(record.by, Origin::Operator(_)) && !is_fault
        };
        self.struck.iter().filter(helps).count()
    }
    /// Adds the faults of [`Commands`] to the schedule: all, or none if there is an error.
    ///
    /// # Errors
    /// Returns what is wrong with the input: it is of another kind, a fault hits none of `modules` modules and is none of
    /// `world`, it would end a pause that there is not, it steers a module, or its time is past.
    pub fn input(
        &mut self,
        now: Time,
        kind: &str,
        bytes: &[u8],
        modules: usize,
        world: &[&'static WorldFault],
    ) -> Result<(), String> {
        self.input_if(now, kind, bytes, modules, world, |fault| match fault {
            Fault::Steer(..) => Err("modules of this family are not steered".to_owned()),
            _ => Ok(()),
        })
    }
    /// Like [`FaultInjector::input`], for a family with rules of its own: `rule` returns the one that refuses a command.
    ///
    /// # Errors
    /// As there, or what `rule` returns.
    pub fn input_if(
        &mut self,
        now: Time,
        kind: &str,
        bytes: &[u8],
        modules: usize,
        world: &[&'static WorldFault],
        rule: impl Fn(&Fault) -> Result<(), String>,
    ) -> Result<(), String> {
        if kind != COMMAND_INPUT {
            return Err(format!("this director takes no input of kind `{kind}`"));
        }
        let text = String::from_utf8_lossy(bytes);
        let Commands { at, operator, faults } = Commands::parse(&text, world)?;
        if at < now {
            return Err(format!("the time of `{text}` is past"));
        }
        let missing = |fault: &Fault| fault.modules().find(|id| id.index() >= modules);
        if let Some(id) = faults.iter().find_map(missing) {
            return Err(format!("there is no module {id}; they are numbered from 0 to {}", modules - 1));
        }
        faults.iter().try_for_each(rule)?;
        // Faults that are due before these may not have been injected yet.
        let before = self.schedule.iter().skip(self.next).take_while(|other| other.at <= at);
        let mut paused = self.paused.clone();
        for fault in before.map(|scheduled| &scheduled.fault).chain(&faults) {
            match fault {
                Fault::Pause(id) => drop(paused.insert(*id)),
                Fault::Resume(id) if !paused.remove(id) => return Err(format!("module {id} is not paused")),
                _ => {}
            }
        }
        let by = Origin::Operator(operator);
        faults.into_iter().for_each(|fault| self.schedule.insert(self.next, Scheduled { at, fault, by }));
        Ok(())
    }
    /// Schedules a command that takes effect now.
    pub fn command(&mut self, now: Time, fault: Fault, operator: u16) {
        self.schedule.insert(self.next, Scheduled { at: now, fault, by: Origin::Operator(operator) });
    }
    /// Returns the next fault that is due.
    pub fn due(&mut self, now: Time) -> Option<Fault> {
        loop {
            let scheduled = self.schedule.get(self.next).filter(|scheduled| scheduled.at <= now)?;
            self.next += 1;
            self.by = scheduled.by;
            match (scheduled.by, scheduled.fault) {
                // A module that was dead before its host was lost stays dead.
                (Origin::External, Fault::Restart(id)) if !self.felled.remove(&id) => {}
                (_, fault) => return Some(fault),
            }
        }
    }
    /// Returns when the next fault is due.
    pub fn next_at(&self) -> Time {
        self.schedule.get(self.next).map_or(Time::NEVER, |scheduled| scheduled.at)
    }
    /// Returns true if an event is still to come: a fault of the scenario, or the end of a pause or of changed links. Commands
    /// to come do not count, since a run does not know of them before they are given: so a scenario with the commands of a
    /// run is the same run.
    pub fn is_pending(&self) -> bool {
        let mut to_come = self.schedule.iter().skip(self.next);
        to_come.any(|scheduled| !matches!(scheduled.by, Origin::Operator(_)))
            || self.link_ends.iter().any(Option::is_some)
            || !self.paused.is_empty()
    }
    /// Injects the fault that [`FaultInjector::due`] returned last; `effect` describes the state it finds, and `alive` is
    /// true if the process it hits lives.
    pub fn inject<O>(
        &mut self,
        now: Time,
        fault: Fault,
        alive: bool,
        effect: String,
        commands: &mut VecDeque<Command<O>>,
    ) {
        self.struck.push(FaultRecord { at: now, fault, by: self.by, effect });
        match fault {
            Fault::Links(fault) => self.change_links(now, fault, commands),
            Fault::Kill(id) => {
                match alive {
                    true => self.felled.insert(id),
                    false => self.felled.remove(&id),
                };
                commands.push_back(Command::Kill(id));
            }
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
            Fault::Host(host, change) => {
                let effect = match change {
                    HostChange::Down => "its modules are killed",
                    HostChange::Lost => {
                        "it was down for the time of `fence`, and its modules start elsewhere"
                    }
                    HostChange::Back => "modules can be started there",
                };
                if let Some(struck) = self.struck.last_mut() {
                    struck.effect = format!("{host}: {effect}");
                }
                commands.push_back(Command::Host(host, change));
            }
            // The first two hit bodies, the next an agent and the world; the last has happened already.
            Fault::Stick(_)
            | Fault::Unstick(_)
            | Fault::Steer(..)
            | Fault::World(..)
            | Fault::External(_) => {}
        }
    }
    /// Changes the links, and schedules the end of that. The end of an earlier change of the kind no longer counts.
    fn change_links<O>(&mut self, now: Time, fault: LinkFault, commands: &mut VecDeque<Command<O>>) {
        let effect = fault.apply(&mut self.links);
        if let Some(struck) = self.struck.last_mut() {
            struck.effect = effect;
        }
        let end = fault.end().map_or(fault, |(end, _)| end);
        let ends_at = &mut self.link_ends[usize::from(end == LinkFault::PartitionEnds)];
        if let Some(at) = ends_at.take() {
            self.schedule.remove_end(self.next, at, Fault::Links(end));
        }
        if let Some((end, lease)) = fault.end() {
            *ends_at = Some(now + lease);
            let scheduled = Scheduled { at: now + lease, fault: Fault::Links(end), by: self.by };
            self.schedule.insert_end(self.next, scheduled);
        }
        commands.push_back(Command::Links(self.links));
    }
    /// Notes that a process was killed, stopped or continued from outside, that its host was lost, or that a host is back;
    /// `found` describes the state of the process. The modules that are named are started again.
    pub fn external(&mut self, now: Time, id: ModuleId, what: &Outside, found: &str) {
        let (fault, effect) = match what {
            Outside::HostLost { host, restarts, .. } => {
                self.restart_all(now, restarts);
                (Fault::Host(*host, HostChange::Lost), what.to_string())
            }
            Outside::HostBack { host, restarts } => {
                self.restart_all(now, restarts);
                (Fault::Host(*host, HostChange::Back), what.to_string())
            }
            what => (Fault::External(id), format!("{what}; {found}")),
        };
        self.struck.push(FaultRecord { at: now, fault, by: Origin::External, effect });
    }
    fn restart_all(&mut self, now: Time, modules: &[ModuleId]) {
        for id in modules {
            self.felled.insert(*id);
            let restart = Scheduled { at: now, fault: Fault::Restart(*id), by: Origin::External };
            self.schedule.insert(self.next, restart);
        }
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
