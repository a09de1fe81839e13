//! The start of a swarm: processes in batches, hellos, then the clock; and how a restarted process joins a
//! run that is under way.

use super::{ControllerLoop, nanos};
use crate::swarm::launcher::{Backend, Event, Launcher};
use crate::swarm::outcome::SwarmError;
use crate::swarm::process::{ControlMessage, Process, Stage};
use crate::swarm::resume::write_run;
use crate::swarm::run_dir::RunDirError;
use crate::swarm::signals::is_from_outside;
use metamorph_module_agent::process::runtime_message::RuntimeMessage;
use metamorph_module_agent::process::start::begin_journal;
use metamorph_module_agent::run_dir::controller_lease::make_resumable;
use metamorph_module_agent::transport::AgentKey;
use metamorph_protocol::ids::Incarnation;
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::world::World;
use std::time::Duration;

/// Number of processes that start at the same time; more would only compete.
const STARTING: usize = 32;

impl<W: World, D: DirectorPort<W>, B: Backend> ControllerLoop<'_, W, D, B> {
    pub(super) fn set_up(&mut self) -> Result<(), SwarmError> {
        let timeout = nanos(self.options.setup_timeout);
        let mut deadline = self.begun + timeout;
        let count = self.processes.len();
        let (mut next, mut up) = (0, 0);
        while up < count && !self.finishing {
            while next < count && next - up < STARTING {
                self.reserve.release_one();
                self.launch(next, Incarnation(0));
                self.outcome.launched += 1;
                next += 1;
            }
            self.wait_until(deadline)?;
            while let Some(event) = self.launcher.event()? {
                match event {
                    Event::SpawnFailed(agent, e) => return Err(self.spawn_error(agent, e.to_string())),
                    // Its agent has not begun, so the director does not know of it yet.
                    Event::Stopped(..) | Event::Continued(_) => {}
                    Event::HostBack(host, restarts) => self.back_early.push((host, restarts)),
                    Event::HostLost { host, why, agents, restarts } => {
                        agents.iter().for_each(|agent| self.processes[agent.0.index()].end());
                        self.lost_early.push(((host, why), agents, restarts));
                    }
                    Event::Exited { agent, how, stderr_tail, of_machine: true, .. } => {
                        self.processes[agent.0.index()].end();
                        self.launcher.reap(agent);
                        self.end_for_agent(agent.0, &how, &stderr_tail);
                    }
                    Event::Exited { agent, how, signal: Some(signal), .. } if is_from_outside(signal) => {
                        self.processes[agent.0.index()].end();
                        self.killed_early.push((agent, signal, how));
                    }
                    Event::Exited { agent, how, stderr_tail, .. } => {
                        return Err(SwarmError::DiedEarly { id: agent.0, how, stderr_tail });
                    }
                    Event::Shutdown(urgency) => self.interrupt(urgency),
                }
            }
            self.drain()?;
            // One that was started and is absent was killed, and is not waited for.
            let is_ready = |p: &&Process<_, _>| matches!(p.stage, Stage::Up | Stage::Absent);
            let before = std::mem::replace(&mut up, self.processes[..next].iter().filter(is_ready).count());
            if up > before {
                deadline = self.pace.monotonic() + timeout;
            }
            if up < count && self.pace.monotonic() >= deadline {
                let seconds = self.options.setup_timeout.as_secs();
                return Err(SwarmError::SetupTimeout { missing: count - up, count, seconds });
            }
        }
        // Links to all agents, so that the first orders need not wait for them. Each takes memory, so what an agent
        // needs for its contacts is released for it, and the rest of that only when all links are there.
        for i in 0..self.processes.len() {
            if self.processes[i].stage == Stage::Up && self.links.too_many(count) == 0 {
                self.reserve.release_one();
                self.connect(i);
            }
        }
        self.reserve.release_most();
        Ok(())
    }

    pub(super) fn launch(&mut self, i: usize, incarnation: Incarnation) {
        self.processes[i].launch(incarnation);
        self.launcher.start(self.processes[i].key());
    }

    fn spawn_error(&self, (id, _): AgentKey, cause: String) -> SwarmError {
        SwarmError::Spawn { id, program: self.options.program.clone(), cause }
    }

    /// Sends every agent its place, then its contacts; with the first tick after that the clock starts.
    pub(super) fn begin(&mut self) -> Result<(), SwarmError> {
        self.epoch = self.pace.monotonic();
        self.outcome.setup = Duration::from_nanos(self.epoch - self.begun);
        if let (Some(parts), Some(dir)) = (&self.options.journal, self.dir)
            && !self.options.patience.is_zero()
        {
            let root = dir.root();
            write_run(&parts.dir, root, self.epoch)
                .and_then(|()| make_resumable(root))
                .map_err(|e| RunDirError::Create(parts.dir.clone(), e))?;
        }
        for i in 0..self.processes.len() {
            let id = self.processes[i].id;
            self.world.start(Time::ZERO, id, Incarnation(0));
        }
        for i in 0..self.processes.len() {
            if self.processes[i].stage != Stage::Absent {
                self.send_begin(i);
            }
        }
        self.forward_sensed();
        for i in 0..self.processes.len() {
            let id = self.processes[i].id;
            self.director.started(Time::ZERO, id);
            self.execute(Time::ZERO);
        }
        // The run knows of them only now.
        for (agent, signal, how) in std::mem::take(&mut self.killed_early) {
            self.begin_part(agent);
            self.processes[agent.0.index()].stage = Stage::Running;
            self.killed(agent, signal, how);
        }
        for (host, agents, restarts) in std::mem::take(&mut self.lost_early) {
            for agent in &agents {
                self.begin_part(*agent);
                self.processes[agent.0.index()].stage = Stage::Running;
            }
            self.host_lost(host, &agents, restarts);
        }
        for (host, restarts) in std::mem::take(&mut self.back_early) {
            self.host_back(host, restarts);
        }
        self.flush();
        Ok(())
    }

    /// Begins the part of the journal of an agent that may have ended before it could do so itself.
    fn begin_part(&self, agent: AgentKey) {
        if let Some(Err(e)) = self.options.journal.as_ref().map(|parts| begin_journal(parts, agent)) {
            tracing::warn!("{e}");
        }
    }

    fn send_begin(&mut self, i: usize) {
        let place = self.world.place(self.processes[i].id);
        self.processes[i].stage = Stage::Running;
        self.tell(i, ControlMessage::Runtime(RuntimeMessage::Begin { place }));
        if !self.link_changes.is_none() {
            self.tell(i, ControlMessage::Runtime(RuntimeMessage::Links(self.link_changes)));
        }
    }

    /// Lets a restarted process join the run.
    pub(super) fn rejoin(&mut self, i: usize) {
        let (id, incarnation) = (self.processes[i].id, self.processes[i].incarnation);
        let now = self.now();
        self.world.advance(now);
        // Percepts up to here were meant for the incarnation before.
        self.forward_sensed();
        self.send_begin(i);
        self.world.start(now, id, incarnation);
        self.forward_sensed();
        self.director.started(now, id);
        self.execute(now);
    }
}
