//! The end of a swarm: agents are asked to stop, those that do not are killed, and the counters of all
//! incarnations are added up.

use super::{ControllerLoop, DRAIN, ProcessOf, nanos};
use crate::swarm::launcher::{Backend, Event, Launcher};
use crate::swarm::outcome::{Crash, SwarmError};
use crate::swarm::process::{ControlMessage, Stage};
use metamorph_module_agent::process::runtime_message::RuntimeMessage;
use metamorph_module_agent::transport::Transport;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::Incarnation;
use metamorph_protocol::wire::Channel;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::world::World;
use metamorph_text::format::seconds;
use rustix::process::Signal;
use std::time::Duration;

impl<W: World, D: DirectorPort<W>, B: Backend> ControllerLoop<'_, W, D, B> {
    pub(super) fn stop(&mut self) -> Result<(), SwarmError> {
        self.outcome.end = self.now();
        self.outcome.slowed = self.pace.slowed();
        self.outcome.wall = Duration::from_nanos(self.pace.monotonic().saturating_sub(self.epoch));
        let runs = |s| matches!(s, Stage::Running | Stage::Lost);
        let alive = |p: &&ProcessOf<W, B>| runs(p.stage) && !p.terminating;
        self.outcome.alive = self.processes.iter().filter(alive).count() as u32;
        for i in 0..self.processes.len() {
            let process = &mut self.processes[i];
            let agent = process.key();
            match process.stage {
                Stage::Absent => continue,
                Stage::Starting | Stage::Lost => {
                    // Not up yet, or not found, so it gets no message.
                    process.terminating = true;
                    self.launcher.signal(agent, Signal::KILL);
                }
                _ => {
                    if process.is_stopped() {
                        self.launcher.signal(agent, Signal::CONT);
                    }
                    process.hurry();
                    self.tell(i, ControlMessage::Runtime(RuntimeMessage::Stop));
                }
            }
        }
        let timeout = nanos(self.options.stop_timeout);
        let (mut deadline, mut left) = (self.pace.monotonic() + timeout, usize::MAX);
        let (mut settling, mut dismissed, mut killed, mut hurried) = (false, false, false, false);
        loop {
            if self.hurried && !hurried {
                hurried = true;
                self.kill_at_once();
            }
            self.drain_after_the_end()?;
            // Three steps are left for an agent: to fall silent, to settle, and to end.
            let steps = |p: &ProcessOf<W, B>| match p.stage {
                Stage::Absent => 0,
                Stage::Settled => 1,
                Stage::Silent => 2,
                _ => 3,
            };
            let before = std::mem::replace(&mut left, self.processes.iter().map(steps).sum());
            if left == 0 {
                break;
            }
            if left < before {
                deadline = self.pace.monotonic() + timeout;
            }
            let is_past = |left: usize| self.processes.iter().all(|p| steps(p) < left || p.terminating);
            if !settling && is_past(3) {
                settling = true;
                self.tell_all(Stage::Silent, RuntimeMessage::Stop);
            } else if settling && !dismissed && is_past(2) {
                dismissed = true;
                self.tell_all(Stage::Settled, RuntimeMessage::End);
            }
            self.flush();
            let retry = self.retry_at.unwrap_or(u64::MAX);
            self.wait_until(deadline.min(retry).max(self.pace.monotonic() + 1_000_000))?;
            while let Some(event) = self.launcher.event()? {
                self.ended_after_the_end(event);
            }
            if !killed && self.pace.monotonic() >= deadline {
                killed = true;
                self.kill_the_rest();
            }
        }
        Ok(())
    }

    /// Tells all agents of a stage what is next. Once all are silent they have to settle: an agent that ends takes with it
    /// what it has sent over links that their receivers have not found yet. Then the frames in an inbox are complete, and
    /// its owner can count them and end.
    fn tell_all(&mut self, stage: Stage, message: RuntimeMessage<<W::Agent as Agent>::Place>) {
        for i in 0..self.processes.len() {
            if self.processes[i].stage == stage {
                self.processes[i].hurry();
                self.tell(i, ControlMessage::Runtime(message.clone()));
            }
        }
    }

    /// Notes agents that have fallen silent or settled, and drops all other frames.
    fn drain_after_the_end(&mut self) -> Result<(), SwarmError> {
        for _ in 0..DRAIN * 8 {
            let Some(shared) = self.transport.receive()? else { break };
            let frame = shared.frame();
            let Ok(header) = frame.open() else { continue };
            let silent = header.channel == Channel::Runtime
                && frame.message() == Ok(RuntimeMessage::<<W::Agent as Agent>::Place>::Silent);
            if let Some(process) = self.processes.get_mut(header.source.index())
                && silent
                && header.incarnation == process.incarnation
                && matches!(process.stage, Stage::Up | Stage::Running | Stage::Silent)
            {
                process.fall_silent();
            }
        }
        Ok(())
    }

    fn ended_after_the_end(&mut self, event: Event) {
        let (id, incarnation, how, stderr_tail) = match event {
            Event::Exited { agent: (id, incarnation), how, stderr_tail, .. } => {
                (id, incarnation, how, stderr_tail)
            }
            Event::Shutdown(urgency) => return self.interrupt(urgency),
            Event::SpawnFailed((id, incarnation), e) => {
                (id, incarnation, format!("could not be started: {e}"), String::new())
            }
            Event::HostLost { agents, .. } => {
                for (id, _) in agents {
                    self.processes.get_mut(id.index()).into_iter().for_each(|process| process.end());
                }
                return;
            }
            Event::Stopped(..) | Event::Continued(_) | Event::HostBack(..) => return,
        };
        let at = self.outcome.end;
        let Some(process) = self.processes.get_mut(id.index()) else { return };
        process.end();
        let how = process.verdict.map_or(how, str::to_owned);
        if !process.terminating && how != "exited" {
            self.outcome.crashes.push(Crash { id, incarnation, at, how, stderr_tail });
        }
    }

    /// Kills all agents, as a second signal asked for.
    fn kill_at_once(&mut self) {
        for process in self.processes.iter_mut().filter(|p| p.stage != Stage::Absent) {
            process.terminating = true;
            self.launcher.signal(process.key(), Signal::KILL);
        }
    }

    fn kill_the_rest(&mut self) {
        for process in &mut self.processes {
            if process.stage != Stage::Absent {
                let agent = process.key();
                // An agent that does not even fall silent may have hung long before: then nothing that the swarm did says
                // anything about its protocol.
                if matches!(process.stage, Stage::Up | Stage::Running) && !self.outcome.interrupted {
                    let why = || {
                        let waited = seconds(self.options.stop_timeout.as_secs_f64());
                        format!(
                            "module {} runs, but took no message for {waited}: its process hangs",
                            process.id
                        )
                    };
                    self.outcome.machine_fault.get_or_insert_with(why);
                }
                process.verdict = Some("did not stop in time, and was killed");
                tracing::error!("module {} did not stop in time and is killed", process.id);
                self.launcher.signal(agent, Signal::KILL);
            }
        }
    }

    pub(super) fn read_counters(&mut self) {
        for process in &self.processes {
            for incarnation in (0..=process.incarnation.0).map(Incarnation) {
                let counters = self.launcher.counters((process.id, incarnation));
                self.outcome.count(process.id, incarnation, counters);
            }
        }
    }
}
