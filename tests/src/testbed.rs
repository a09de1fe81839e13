//! What a driver must offer to be tested, and the testbed of real processes.

use crate::probe::{ProbeSetup, ProbeWorld};
use crate::script::Script;
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::tally::Tally;
use metamorph_world_controller::swarm::{SwarmOptions, SwarmOutcome, run_swarm};
use std::path::PathBuf;

/// A driver under test: it runs a script to its end.
pub trait Testbed {
    /// Runs `script` in `world`, with links that do what `link` says, and returns what was counted
    /// over all agents and lives.
    fn run(&mut self, link: &LinkModel, world: &mut ProbeWorld, script: &mut Script) -> Tally;
}

/// Real processes over shared memory.
#[derive(Debug)]
pub struct ProcessBed {
    /// How swarms are run.
    pub options: SwarmOptions,
    /// What the last run came to.
    pub outcome: SwarmOutcome,
}

impl ProcessBed {
    /// Agents are processes of this program, see `probe-agent`.
    pub fn new(program: impl Into<PathBuf>) -> ProcessBed {
        ProcessBed { options: SwarmOptions::new(program.into()), outcome: SwarmOutcome::default() }
    }
}

impl Testbed for ProcessBed {
    fn run(&mut self, link: &LinkModel, world: &mut ProbeWorld, script: &mut Script) -> Tally {
        self.options.link = link.clone();
        let setup = ProbeSetup { ballast: vec![7; 1_000] };
        let outcome = run_swarm(&self.options, &setup, world, script);
        self.outcome = outcome.unwrap_or_else(|e| panic!("the swarm could not be run: {e}"));
        self.outcome.tally
    }
}
