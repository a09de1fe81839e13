//! Recovers the state of a run from the controller's part of its journal: world and director by re-executing
//! the controller's records, and what each agent was sent.
//!
//! The agents' records are not needed, so only one file is read.

use super::engine::Engine;
use crate::record::journal::{Blob, Damage, Event, Record};
use crate::swarm::{ControlMessage, Counted, TakenOver};
use metamorph_families::runnable::AgentOf;
use metamorph_families::runnable::Runnable;
use metamorph_module_agent::process::runtime_message::RuntimeMessage;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::link::LinkChanges;
use metamorph_protocol::runtime::{Command, Sensed};
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::Wire;
use metamorph_scenario::Plan;
use std::collections::{BTreeMap, BTreeSet};
use thiserror::Error;

/// The state of a run at the end of the controller's records.
pub struct Recovered<R: Runnable> {
    /// The world.
    pub world: R::World,
    /// The director.
    pub director: R::Director,
    /// Faults recorded so far.
    pub struck: usize,
    /// Scenario time of the last record.
    pub until: Time,
    /// Incarnations alive at that time.
    pub agents: Vec<TakenOver<AgentOf<R>>>,
    /// The latest incarnation of each module.
    pub latest: Vec<Incarnation>,
    /// Modules that are dead and due for a restart.
    pub restarting: BTreeSet<ModuleId>,
    /// True if the director had ended the run.
    pub finishing: bool,
    /// Changes of the director to the links between modules.
    pub links: LinkChanges,
    /// The controller's counts.
    pub counted: Counted,
}

/// The reason why the controller's records do not reproduce the state of the run.
#[derive(Debug, Error)]
pub enum RecoverError {
    /// They cannot be read.
    #[error(transparent)]
    Damaged(#[from] Damage),
    /// A record does not match.
    #[error("record {number} of the controller, at {at}: {what}")]
    Different {
        /// The number of the record, from 1.
        number: u64,
        /// Time of the record.
        at: Time,
        /// Description of the difference.
        what: String,
    },
}

/// Re-executes the controller's records.
pub fn recover<R: Runnable>(
    swarm: &R,
    plan: &Plan,
    records: impl Iterator<Item = Result<Record, Damage>>,
) -> Result<Recovered<R>, RecoverError> {
    let mut engine = Engine::new(swarm, plan);
    engine.follow_no_agents();
    let mut notes = Notes::<AgentOf<R>> {
        agents: BTreeMap::new(),
        latest: vec![Incarnation(0); plan.swarm.len()],
        restarting: BTreeSet::new(),
        finishing: false,
        links: LinkChanges::default(),
        counted: Counted::default(),
    };
    for record in records {
        let record = record?;
        let number = engine.done().records + 1;
        engine
            .carry_out(&record)
            .and_then(|()| notes.take(&record.event))
            .map_err(|what| RecoverError::Different { number, at: record.at, what })?;
    }
    let until = engine.done().until;
    let (world, director, struck) = engine.into_parts();
    let Notes { agents, latest, restarting, finishing, links, counted } = notes;
    let agents = agents.into_values().collect();
    Ok(Recovered { world, director, struck, until, agents, latest, restarting, finishing, links, counted })
}

/// State of the agents' processes according to the controller's records.
struct Notes<A: Agent> {
    agents: BTreeMap<ModuleId, TakenOver<A>>,
    latest: Vec<Incarnation>,
    restarting: BTreeSet<ModuleId>,
    finishing: bool,
    links: LinkChanges,
    counted: Counted,
}

impl<A: Agent> Notes<A> {
    fn take(&mut self, event: &Event) -> Result<(), String> {
        match event {
            Event::Start { id, incarnation, place } => {
                self.restarting.remove(id);
                self.counted.restarted += u32::from(*incarnation > Incarnation(0));
                if let Some(latest) = self.latest.get_mut(id.index()) {
                    *latest = *incarnation;
                }
                let changes = Some(self.links).filter(|links| !links.is_none());
                let told = changes.map(|links| ControlMessage::Runtime(RuntimeMessage::Links(links)));
                let begun = TakenOver {
                    id: *id,
                    incarnation: *incarnation,
                    place: read(place)?,
                    heard: 0,
                    told: told.into_iter().collect(),
                    terminating: false,
                    paused: false,
                };
                self.agents.insert(*id, begun);
            }
            Event::Died { id } => {
                self.agents.remove(id);
            }
            Event::Act { id, .. } => {
                self.counted.body_messages += 1;
                self.heard(*id);
            }
            Event::Report { id, .. } => {
                self.counted.control_messages += 1;
                self.heard(*id);
            }
            Event::Sensed { id, sensed } => {
                let letter = match sensed {
                    Sensed::Percept(percept) => ControlMessage::Percept(read(percept)?),
                    Sensed::Contact { port, revision, contact } => {
                        ControlMessage::Runtime(RuntimeMessage::Contact {
                            port: *port,
                            revision: *revision,
                            contact: *contact,
                        })
                    }
                };
                self.counted.body_messages += u64::from(self.tell(*id, letter));
            }
            Event::Command(wanted) => self.want(wanted)?,
            _ => {}
        }
        Ok(())
    }

    fn want(&mut self, wanted: &Command<Blob>) -> Result<(), String> {
        match wanted {
            Command::Kill(id) => {
                if let Some(incarnation) = self.agents.get_mut(id) {
                    self.counted.killed += u32::from(!incarnation.terminating);
                    incarnation.terminating = true;
                }
            }
            Command::Pause(id) | Command::Resume(id) => {
                if let Some(incarnation) = self.agents.get_mut(id) {
                    incarnation.paused = matches!(wanted, Command::Pause(_));
                }
            }
            Command::Restart(id) => {
                if self.agents.get(id).is_none_or(|incarnation| incarnation.terminating) {
                    self.restarting.insert(*id);
                }
            }
            Command::Order(id, order) => {
                let letter = ControlMessage::Order(read(order)?);
                self.counted.control_messages += u64::from(self.tell(*id, letter));
            }
            Command::Finish => self.finishing = true,
            // The hosts of a run note it in their own files.
            Command::Host(..) => {}
            Command::Links(changes) => {
                self.links = *changes;
                let all: Vec<ModuleId> = self.agents.keys().copied().collect();
                for id in all {
                    self.tell(id, ControlMessage::Runtime(RuntimeMessage::Links(*changes)));
                }
            }
        }
        Ok(())
    }

    fn heard(&mut self, id: ModuleId) {
        if let Some(incarnation) = self.agents.get_mut(&id) {
            incarnation.heard += 1;
        }
    }

    /// Notes a message of the controller to a module, and returns true if the module has a process. As in the
    /// controller loop, nothing is sent to an agent that is about to be killed.
    fn tell(&mut self, id: ModuleId, letter: ControlMessage<A>) -> bool {
        let Some(incarnation) = self.agents.get_mut(&id) else { return false };
        if !incarnation.terminating {
            incarnation.told.push_back(letter);
        }
        true
    }
}

fn read<T: Wire>(blob: &Blob) -> Result<T, String> {
    blob.read().map_err(|e| format!("{blob:?} cannot be read: {e}"))
}
