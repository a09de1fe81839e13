//! Runs the protocol on a square plate of modules, in virtual time or as processes.

use crate::election::Election;
use crate::leader::{Leader, Setup};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::kernel::sim::{Sim, SimConfig};
use metamorph_sim_bridge::kernel::still_world::StillWorld;
use metamorph_sim_bridge::world::World;
use metamorph_world_controller::swarm::{SwarmError, SwarmOptions, run_swarm};
use std::path::PathBuf;
use std::sync::Arc;

/// The result of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// The module that all agreed on, and the time; `None` if they did not within a minute.
    pub leader: Option<(ModuleId, Time)>,
    /// The number of messages sent.
    pub sent: u64,
    /// The trace hash; `None` for processes, whose runs do not repeat exactly.
    pub trace: Option<u64>,
}

/// Scenario time after which an election has failed.
const MINUTE: Time = Time(60_000_000_000);

fn plate(side: u16) -> StillWorld<Leader> {
    StillWorld::new([side, side, 1])
}

fn setup() -> Setup {
    Setup { repeat: Span::millis(500) }
}

/// Runs a plate of `side` times `side` modules in virtual time.
pub fn simulate(side: u16, loss: Ratio, seed: u64) -> Outcome {
    let director = Election::new(plate(side).len(), MINUTE);
    let link =
        LinkModel { delay_min: Span::millis(10), delay_max: Span::millis(50), loss, ..LinkModel::default() };
    let config = SimConfig {
        setup: Arc::new(setup()),
        link,
        seed,
        audit_every: Span::secs(1),
        ignore_sessions: false,
    };
    let mut sim = Sim::new(config, plate(side), director);
    sim.run_until(MINUTE + Span::secs(1));
    Outcome {
        leader: sim.director().leader,
        sent: sim.tally().total().sent,
        trace: Some(sim.trace().value()),
    }
}

/// Runs the same plate with one process for each module, started as `program agent ...`.
pub fn processes(program: PathBuf, side: u16, loss: Ratio) -> Result<Outcome, SwarmError> {
    let mut world = plate(side);
    let mut director = Election::new(world.len(), MINUTE);
    let options = SwarmOptions {
        program_args: vec!["agent".into()],
        link: LinkModel { loss, ..LinkModel::default() },
        catch_signals: true,
        ..SwarmOptions::new(program)
    };
    let swarm = run_swarm(&options, &setup(), &mut world, &mut director)?;
    Ok(Outcome { leader: director.leader, sent: swarm.tally.total().sent, trace: None })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loss() -> Ratio {
        "10%".parse().expect("a probability")
    }

    #[test]
    fn one_seed_is_one_run() {
        assert_eq!(simulate(6, loss(), 1), simulate(6, loss(), 1));
        assert_ne!(simulate(6, loss(), 1).trace, simulate(6, loss(), 2).trace);
    }

    #[test]
    fn all_agree_though_messages_are_lost() {
        for seed in 1..=20 {
            let leader = simulate(6, loss(), seed).leader.map(|(leader, _)| leader);
            assert_eq!(leader, Some(ModuleId(0)), "seed {seed}");
        }
    }
}
