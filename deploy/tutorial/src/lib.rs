//! A protocol of one's own, outside the crates of the runtime: see README.md beside this crate.
//!
//! [`leader`] is the protocol, [`election`] the controller's side; here both are run, in virtual time
//! and as processes. Absent: anything that the two drivers would have to know about it.

pub mod election;
pub mod family;
pub mod leader;

use election::Election;
use leader::{Leader, Setup};
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

/// What a run came to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// Whom all agreed on, and when; none if they did not within a minute.
    pub leader: Option<(ModuleId, Time)>,
    /// Messages sent.
    pub sent: u64,
    /// The hash of everything that happened; only in virtual time can a run be repeated.
    pub trace: Option<u64>,
}

const MINUTE: Time = Time(60_000_000_000);

/// A square plate.
fn plate(side: u16) -> StillWorld<Leader> {
    StillWorld::new([side, side, 1])
}

fn setup() -> Setup {
    Setup { repeat: Span::millis(500) }
}

/// A plate of `side` times `side` modules in virtual time.
pub fn simulate(side: u16, loss: Ratio, seed: u64) -> Outcome {
    let world = plate(side);
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
    let mut sim = Sim::new(config, world, director);
    sim.run_until(MINUTE + Span::secs(1));
    Outcome {
        leader: sim.director().leader,
        sent: sim.tally().total().sent,
        trace: Some(sim.trace().value()),
    }
}

/// The same plate with one process for each module. `program` is started as `program agent …`.
pub fn processes(program: PathBuf, side: u16, loss: Ratio) -> Result<Outcome, SwarmError> {
    let mut world = plate(side);
    let mut director = Election::new(plate(side).len(), MINUTE);
    let options = SwarmOptions {
        program_args: vec!["agent".into()],
        link: LinkModel { loss, ..LinkModel::default() },
        catch_signals: true,
        ..SwarmOptions::new(program)
    };
    let swarm = run_swarm(&options, &setup(), &mut world, &mut director)?;
    Ok(Outcome { leader: director.leader, sent: swarm.tally.total().sent, trace: None })
}
