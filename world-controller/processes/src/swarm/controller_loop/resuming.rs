//! The takeover of a swarm whose controller was killed. The new controller calls every live agent, resends
//! the messages that the agent has not taken, and reads what the agent has sent meanwhile from the agent's
//! part of the journal.

use super::ControllerLoop;
use crate::swarm::launcher::{Backend, Found, Launcher, Takeover};
use crate::swarm::outcome::{SwarmError, SwarmOutcome};
use crate::swarm::process::{ControlMessage, Stage};
use crate::swarm::resume::Resumption;
use metamorph_module_agent::journal_file::{JournalError, Reader, agent_part};
use metamorph_module_agent::process::runtime_message::RuntimeMessage;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::record::{Blob, Emitted, Event};
use metamorph_protocol::wire::{Header, Wire};
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::world::World;
use rustix::process::Signal;
use std::path::Path;

impl<W, D, B> ControllerLoop<'_, W, D, B>
where
    W: World,
    D: DirectorPort<W>,
    B: Backend<Launcher: Takeover>,
{
    /// Takes over the agents of the run in `root`, and continues the run to its end.
    pub fn go_on(
        mut self,
        root: &Path,
        epoch: u64,
        from: Resumption<W::Agent>,
    ) -> Result<SwarmOutcome, SwarmError> {
        self.take_over(root, epoch, from);
        self.run_on()
    }

    fn take_over(&mut self, root: &Path, epoch: u64, from: Resumption<W::Agent>) {
        let Resumption { until, agents, latest, mut restarting, finishing, links, counted } = from;
        self.link_changes = links;
        (self.epoch, self.last) = (epoch, until);
        self.finishing = finishing;
        self.outcome.launched = self.processes.len() as u32;
        self.outcome.body_messages = counted.body_messages;
        self.outcome.control_messages = counted.control_messages;
        (self.outcome.restarted, self.outcome.killed) = (counted.restarted, counted.killed);
        for (process, incarnation) in self.processes.iter_mut().zip(latest) {
            process.incarnation = incarnation;
        }
        let wanted = agents.iter().map(|agent| (agent.id, agent.incarnation)).collect();
        let Found { latest, present } = self.launcher.take_over(root, &wanted);
        for (id, incarnation) in latest {
            if let Some(process) = self.processes.get_mut(id.index()) {
                process.incarnation = process.incarnation.max(incarnation);
            }
        }
        for mut agent in agents {
            let begin = RuntimeMessage::Begin { place: agent.place };
            agent.told.push_front(ControlMessage::Runtime(begin));
            let process = &mut self.processes[agent.id.index()];
            process.take_over(agent.incarnation, agent.heard, agent.told);
            process.terminating = agent.terminating;
            process.restart = restarting.remove(&agent.id);
            process.paused = agent.paused;
            let key = (agent.id, agent.incarnation);
            let Some(is_alive) = present.get(&key) else {
                let how = "was not there any more when the run was resumed".to_owned();
                let crashed = !agent.terminating;
                self.ended(key, how, String::new(), crashed);
                continue;
            };
            // The signals of the controller before may not have been sent any more.
            let signals = match (agent.terminating, agent.paused) {
                (true, _) => &[Signal::KILL][..],
                (false, true) => &[Signal::STOP],
                (false, false) => &[Signal::CONT],
            };
            signals.iter().for_each(|signal| self.launcher.signal(key, *signal));
            if agent.terminating || !is_alive {
                continue;
            }
            // An agent that is not called finds out by itself within two seconds.
            if self.connect(agent.id.index()) {
                let now = self.now();
                self.processes[agent.id.index()].call(now);
            }
        }
        restarting.into_iter().for_each(|id| self.relaunch(id.index()));
    }
}

impl<W: World, D: DirectorPort<W>, B: Backend> ControllerLoop<'_, W, D, B> {
    /// Handles the answer of an agent. Outputs that no controller has taken are read from its journal.
    pub(super) fn hear_here(&mut self, header: Header, told: u32, expected: u32) -> bool {
        let i = header.source.index();
        let process = &mut self.processes[i];
        let heard = process.heard;
        if process.stage != Stage::Lost {
            return false;
        }
        if !process.found(expected) {
            self.give_up(i, "knows more than it was told, and was killed");
            return true;
        }
        self.list(i);
        match self.told_by(header, heard, told) {
            Ok(missed) => missed.into_iter().for_each(|told| self.take_missed(header, told)),
            Err(e) => {
                tracing::error!("module {}: {e}", header.source);
                self.give_up(i, "has told what its journal does not hold, and was killed");
            }
        }
        true
    }

    fn told_by(&self, header: Header, heard: u32, told: u32) -> Result<Vec<Emitted>, JournalError> {
        let Some(parts) = &self.options.journal else { return Ok(Vec::new()) };
        let path = agent_part(&parts.dir, header.source, header.incarnation);
        let mut all = Vec::new();
        for record in Reader::open(&path)? {
            if all.len() >= told as usize {
                break;
            }
            if let Event::Step(step) = record?.event {
                all.extend(step.told);
            }
        }
        if all.len() < told as usize {
            return Err(JournalError::Unfit(path, "it ends before what the agent has told".to_owned()));
        }
        Ok(all.into_iter().take(told as usize).skip(heard as usize).collect())
    }

    fn take_missed(&mut self, header: Header, told: Emitted) {
        let now = self.now();
        self.world.advance(now);
        match told {
            Emitted::Act { revision, action } => {
                if let Some(action) = read::<<W::Agent as Agent>::Action>(&action) {
                    self.outcome.body_messages += 1;
                    self.world.act(now, header.source, revision, &action);
                }
            }
            Emitted::Report(report) => {
                if let Some(report) = read::<<W::Agent as Agent>::Report>(&report) {
                    self.outcome.control_messages += 1;
                    self.director.report(now, header.source, report);
                    self.execute(now);
                }
            }
        }
    }
}

fn read<T: Wire>(blob: &Blob) -> Option<T> {
    blob.read().inspect_err(|e| tracing::error!("a journal holds what cannot be read: {e}")).ok()
}
