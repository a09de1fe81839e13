//! Ends a run when the machine takes away what it needs: shared memory that something else fills, before processes die of the
//! shortage, or files of the run that were removed from outside. Without this a swarm that has lost its memory looks like one whose
//! protocol stands still. What its end needs comes from the reserve.

use super::ControllerLoop;
use crate::swarm::launcher::Backend;
use crate::swarm::process::Stage;
use metamorph_module_agent::run_dir::run_name::HOME;
use metamorph_module_agent::transport::{AgentKey, SpaceShortage};
use metamorph_protocol::ids::ModuleId;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::world::World;

/// Time between two checks (ns).
const EVERY: u64 = 500_000_000;
/// Time in which the end of a process is heard of (ns).
const GRACE: u64 = 3_000_000_000;

impl<W: World, D: DirectorPort<W>, B: Backend> ControllerLoop<'_, W, D, B> {
    pub(super) fn look_at_space(&mut self) {
        let now = self.pace.monotonic();
        if now.saturating_sub(self.looked) < EVERY {
            return;
        }
        self.looked = now;
        if let Err(shortage) = self.reserve.check() {
            self.run_short(shortage);
        } else if !self.look_for_files() {
            self.look_for_inboxes(now);
        }
    }

    /// Ends the run if an agent that runs has no inbox. One that a neighbour finds without may be ending: what its end brings
    /// with it is heard before [`GRACE`] is over.
    fn look_for_inboxes(&mut self, now: u64) {
        let processes = &self.processes;
        let lives = |(id, incarnation): &AgentKey| {
            let process = processes.get(id.index()).filter(|process| process.incarnation == *incarnation);
            process.is_some_and(|p| p.stage == Stage::Running && !p.terminating && p.verdict.is_none())
        };
        self.unreached.retain(|agent, _| lives(agent));
        let Some((id, _)) = self.unreached.iter().find(|(_, since)| now.saturating_sub(**since) > GRACE)
        else {
            return;
        };
        // The controller may not reach it any more, either.
        self.hurried = true;
        let why = format!(
            "the inbox of module {}, which runs, was removed from outside; nothing may clean {HOME} during a run",
            id.0
        );
        self.end_early(why);
    }

    /// Ends the run if its files in shared memory were removed. Returns true if they were.
    fn look_for_files(&mut self) -> bool {
        let Some(dir) = self.dir.filter(|dir| !dir.is_there()) else { return false };
        let root = dir.root().display();
        let why = format!(
            "the run's files in shared memory ({root}) were removed from outside; nothing may clean {HOME} during a run \
             (of a user without a session, systemd-logind does: RemoveIPC=no)"
        );
        // Agents that cannot be reached any more need not be asked to stop.
        self.hurried = true;
        self.end_early(why);
        true
    }

    pub(super) fn run_short(&mut self, shortage: SpaceShortage) {
        self.reserve.release();
        self.end_early(shortage.to_string());
    }

    /// Ends the run because the machine has taken away what an agent needs.
    pub(super) fn end_for_agent(&mut self, id: ModuleId, how: &str, stderr_tail: &str) {
        if let Err(shortage) = self.reserve.check() {
            return self.run_short(shortage);
        }
        if self.look_for_files() {
            return;
        }
        let said = stderr_tail.lines().rev().find(|line| !line.trim().is_empty());
        let said = said.map(|line| format!(" and said: {}", line.trim()));
        self.hurried = true;
        self.end_early(format!("module {id} {how}{}", said.unwrap_or_default()));
    }

    /// Ends the run because of a fault of the machine, which says nothing about the swarm.
    pub(super) fn end_early(&mut self, why: String) {
        if self.outcome.machine_fault.is_none() {
            tracing::error!("the run ends: {why}");
            self.outcome.machine_fault = Some(why);
        }
        self.outcome.interrupted = true;
        self.finishing = true;
    }
}
