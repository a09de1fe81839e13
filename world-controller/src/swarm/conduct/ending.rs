//! How a swarm ends: everyone is told to stop, who does not is killed, and what all lives have
//! counted is added up.

use super::{Conductor, DRAIN, nanos};
use crate::swarm::agents::{Letter, Process, Stage};
use crate::swarm::outcome::{Crash, SwarmError};
use crate::swarm::supervise::{Event, Task};
use metamorph_module_agent::clock::monotonic;
use metamorph_module_agent::process::control_message::Runtime;
use metamorph_module_agent::run_dir::counter_file::Ledger;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::Incarnation;
use metamorph_protocol::wire::Channel;
use metamorph_sim_bridge::director::port::Direct;
use metamorph_sim_bridge::world::World;
use rustix::process::Signal;
use std::time::Duration;

impl<W: World, D: Direct<W>> Conductor<'_, W, D> {
    pub(super) fn stop(&mut self) -> Result<(), SwarmError> {
        self.outcome.end = self.now();
        self.outcome.slowed = self.pace.slowed();
        self.outcome.wall = Duration::from_nanos(monotonic().saturating_sub(self.epoch));
        let lives = |s| matches!(s, Stage::Running | Stage::Lost);
        let alive = |p: &&Process<W::Agent>| lives(p.stage) && !p.condemned;
        self.outcome.alive = self.processes.iter().filter(alive).count() as u32;
        for i in 0..self.processes.len() {
            let process = &mut self.processes[i];
            let life = (process.id, process.incarnation);
            match process.stage {
                Stage::Absent => continue,
                Stage::Starting | Stage::Lost => {
                    // Not up yet, or not found, so it cannot be told.
                    process.condemned = true;
                    self.supervisor.ask(Task::Signal(life, Signal::KILL));
                }
                _ => {
                    if process.is_stopped() {
                        self.supervisor.ask(Task::Signal(life, Signal::CONT));
                    }
                    process.hurry();
                    self.tell(i, Letter::Runtime(Runtime::Stop));
                }
            }
        }
        let timeout = nanos(self.options.stop_timeout);
        let (mut deadline, mut left) = (monotonic() + timeout, usize::MAX);
        let (mut dismissed, mut killed, mut hurried) = (false, false, false);
        loop {
            if self.hurried && !hurried {
                hurried = true;
                self.kill_at_once();
            }
            self.drain_after_the_end()?;
            // An agent has two steps to go: to fall silent, and to end.
            let steps = |p: &Process<W::Agent>| match p.stage {
                Stage::Absent => 0,
                Stage::Silent => 1,
                _ => 2,
            };
            let before = std::mem::replace(&mut left, self.processes.iter().map(steps).sum());
            if left == 0 {
                break;
            }
            if left < before {
                deadline = monotonic() + timeout;
            }
            if !dismissed && self.processes.iter().all(|p| steps(p) < 2 || p.condemned) {
                dismissed = true;
                self.dismiss();
            }
            self.flush();
            let retry = self.retry_at.unwrap_or(u64::MAX);
            self.wait_until(deadline.min(retry).max(monotonic() + 1_000_000))?;
            while let Some(event) = self.supervisor.event() {
                self.ended(event);
            }
            if !killed && monotonic() >= deadline {
                killed = true;
                self.kill_the_rest();
            }
            if self.supervisor.is_gone() {
                return Err(SwarmError::Supervisor(std::io::Error::other("its thread ended")));
            }
        }
        Ok(())
    }

    /// Nobody sends any more: what is in an inbox now stays there, and its owner can count it and end.
    fn dismiss(&mut self) {
        for i in 0..self.processes.len() {
            if self.processes[i].stage == Stage::Silent {
                self.processes[i].hurry();
                self.tell(i, Letter::Runtime(Runtime::End));
            }
        }
    }

    /// Hears which agents have fallen silent; what else they still have to say nobody listens to.
    fn drain_after_the_end(&mut self) -> Result<(), SwarmError> {
        for _ in 0..DRAIN * 8 {
            let Some(packet) = self.inbox.receive()? else { break };
            let frame = packet.frame();
            let Ok(header) = frame.open() else { continue };
            let silent = header.channel == Channel::Runtime
                && frame.message() == Ok(Runtime::<<W::Agent as Agent>::Place>::Silent);
            if let Some(process) = self.processes.get_mut(header.source.index())
                && silent
                && header.incarnation == process.incarnation
                && matches!(process.stage, Stage::Up | Stage::Running)
            {
                process.fall_silent();
            }
        }
        Ok(())
    }

    fn ended(&mut self, event: Event) {
        let (id, incarnation, how, stderr_tail) = match event {
            Event::Exited { life: (id, life), how, stderr_tail, .. } => (id, life, how, stderr_tail),
            Event::Shutdown(urgency) => return self.interrupt(urgency),
            Event::SpawnFailed((id, life), e) => {
                (id, life, format!("could not be started: {e}"), String::new())
            }
            Event::Stopped(..) | Event::Continued(_) => return,
        };
        let at = self.outcome.end;
        let Some(process) = self.processes.get_mut(id.index()) else { return };
        process.bury();
        let how = process.verdict.map_or(how, str::to_owned);
        if !process.condemned && how != "exited" {
            self.outcome.crashes.push(Crash { id, incarnation, at, how, stderr_tail });
        }
    }

    /// Kills everybody, as was asked for by a second signal.
    fn kill_at_once(&mut self) {
        for process in self.processes.iter_mut().filter(|p| p.stage != Stage::Absent) {
            process.condemned = true;
            self.supervisor.ask(Task::Signal((process.id, process.incarnation), Signal::KILL));
        }
    }

    fn kill_the_rest(&mut self) {
        for process in &mut self.processes {
            if process.stage != Stage::Absent {
                let life = (process.id, process.incarnation);
                process.verdict = Some("did not stop in time, and was killed");
                tracing::error!("module {} did not stop in time and is killed", process.id);
                self.supervisor.ask(Task::Signal(life, Signal::KILL));
            }
        }
    }

    pub(super) fn read_ledgers(&mut self) {
        for process in &self.processes {
            for life in 0..=process.incarnation.0 {
                let account = Ledger::read(self.dir.root(), process.id, Incarnation(life));
                self.outcome.count(process.id, Incarnation(life), account.map_err(|e| e.to_string()));
            }
        }
    }
}
