//! How a swarm ends: everyone is told to stop, who does not is killed, and what all lives have
//! counted is added up.

use super::{Conductor, DRAIN, nanos};
use crate::swarm::agents::{Letter, Process, Stage};
use crate::swarm::outcome::{Crash, SwarmError};
use crate::swarm::supervise::{Event, Task};
use metamorph_module_agent::clock::monotonic;
use metamorph_module_agent::ledger::Ledger;
use metamorph_module_agent::runtime::Runtime;
use metamorph_protocol::ids::Incarnation;
use metamorph_sim_bridge::direct::Direct;
use metamorph_sim_bridge::world::World;
use rustix::process::Signal;
use std::time::Duration;

impl<W: World, D: Direct<W>> Conductor<'_, W, D> {
    pub(super) fn stop(&mut self) -> Result<(), SwarmError> {
        self.outcome.end = self.now();
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
        let deadline = monotonic() + nanos(self.options.stop_timeout);
        let mut killed = false;
        while self.processes.iter().any(|p| p.stage != Stage::Absent) {
            self.flush();
            self.drain_after_the_end()?;
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

    /// Makes room for agents that still have something to say; nobody listens any more.
    fn drain_after_the_end(&mut self) -> Result<(), SwarmError> {
        for _ in 0..DRAIN * 8 {
            if self.inbox.receive()?.is_none() {
                break;
            }
        }
        Ok(())
    }

    fn ended(&mut self, event: Event) {
        let Event::Exited { life: (id, incarnation), how, stderr_tail, .. } = event else { return };
        let at = self.outcome.end;
        let Some(process) = self.processes.get_mut(id.index()) else { return };
        process.bury();
        let how = process.verdict.map_or(how, str::to_owned);
        if !process.condemned && how != "exited" {
            self.outcome.crashes.push(Crash { id, incarnation, at, how, stderr_tail });
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
                match Ledger::read(self.dir.root(), process.id, Incarnation(life)) {
                    Ok(Some(account)) => {
                        self.outcome.tally += account.tally;
                        self.outcome.foreign += account.foreign;
                        self.outcome.wakes += account.wakes;
                        self.outcome.unrecorded += account.unrecorded;
                        self.outcome.accounts.push((process.id, Incarnation(life), account.tally));
                    }
                    // Killed before it had started.
                    Ok(None) => {}
                    Err(e) => self.outcome.missing_ledgers.push(e.to_string()),
                }
            }
        }
    }
}
