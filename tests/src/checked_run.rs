//! Simulated runs with a journal, checked by the independent [`checker`](crate::checker).

use crate::checker::{Breach, Checked, Geometry, check};
use metamorph_world_controller::console::interrupt::Interrupt;
use metamorph_world_controller::console::stopwatch::Stopwatch;
use metamorph_world_controller::console::terminal::Live;
use metamorph_world_controller::family::metamodule::Metamodules;
use metamorph_world_controller::family::metamodule::motion_database::database;
use metamorph_world_controller::family::{run_simulated, sources};
use metamorph_world_controller::record::journal::JournalSession;
use metamorph_world_controller::report::schema::Report;
use metamorph_world_controller::run::PageChannels;
use metamorph_world_controller::scenario::Plan;
use std::path::Path;
use std::sync::OnceLock;

/// Returns the geometry of the bodies of a plan, which is not in its journal; `None` for cubes.
pub fn geometry(plan: &Plan) -> Option<Geometry> {
    static DATABASE: OnceLock<Vec<u8>> = OnceLock::new();
    let metamodules = plan.swarm.of::<Metamodules>()?;
    let floor = metamodules.setup.floor;
    let bytes = DATABASE.get_or_init(|| database(sources()).to_bytes());
    let geometry = Geometry::read(bytes, metamodules.setup.motions.kind().name(), [floor.min, floor.max]);
    Some(geometry.expect("the database has all kinds"))
}

/// Simulates a plan with a journal in this file.
pub fn record(plan: &Plan, journal: &Path) -> Report {
    let keeping = JournalSession::simulated(journal, plan).expect("a journal can be begun");
    let (interrupt, mut live) = (Interrupt::default(), Live::new(false));
    run_simulated(plan, &interrupt, &mut live, Stopwatch::start(), Some(keeping), PageChannels::default())
}

/// Simulates a plan and checks the positions of its bodies.
///
/// # Errors
/// Returns the first rule that was broken.
pub fn run_and_check(plan: &Plan) -> Result<Checked, Breach> {
    let dir = tempfile::tempdir().expect("a directory");
    let journal = dir.path().join("journal");
    record(plan, &journal);
    check(&journal, geometry(plan).as_ref())
}
