//! Structures that walk: how much faster than time bodies and agents are simulated, how many phases agents tell, and what
//! learners cost without trials.
//!
//! Absent: how fast structures walk, which `metamorph learn` finds out.

use super::BenchError;
use super::machine::CpuWatch;
use metamorph_console::terminal::Live;
use metamorph_free_modules::gait::ask_tell::{Method, Scored};
use metamorph_free_modules::gait::space::{Gait, Space};
use metamorph_protocol::counters::Class;
use metamorph_protocol::free_module::gait::WalkSetup;
use metamorph_protocol::free_module::named;
use metamorph_protocol::free_module::network::NetworkKind;
use metamorph_protocol::free_module::structure::{JOINTS, Joint, Structure};
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::free_module::director::GaitDirector;
use metamorph_sim_bridge::free_module::physics::{Down, FRICTION, Physics, TICK};
use metamorph_sim_bridge::free_module::physics_world::PhysicsWorld;
use metamorph_sim_bridge::free_module::rapier::Bodies;
use metamorph_sim_bridge::free_module::structure_world::StructureWorld;
use metamorph_sim_bridge::free_module::trial::REST;
use metamorph_sim_bridge::kernel::audited::Audited;
use metamorph_sim_bridge::kernel::sim::{Sim, SimConfig};
use metamorph_sim_bridge::world::World;
use serde::Serialize;
use std::sync::Arc;

/// The number of modules of a ring, and their joint angles in degrees.
type Ring = (usize, [f64; 3]);

/// The structures, and their rings.
const STRUCTURES: [(&str, Option<Ring>); 4] =
    [("tripod4", None), ("quad5-sym", None), ("quad9", None), ("struct10", Some((4, [-120.0, 90.0, 0.0])))];
/// The network.
const NETWORK: NetworkKind = NetworkKind::BlfSym;
/// Time simulated.
const TIME: Span = Span::secs(30);
/// Time at the end of a simulation in which messages are counted, in s: phases are in lock then.
const LOCKED: u64 = 10;
/// Number of gaits that each learner asks for.
const ASKED: usize = 120;
/// The learners.
const LEARNERS: [Method; 5] = [Method::Cma, Method::Bayes, Method::Pso, Method::Repertoire, Method::Random];

/// The results.
#[derive(Debug, Serialize)]
pub struct Gaits {
    /// A row for each structure.
    pub rows: Vec<Row>,
    /// A row for each learner, with the parameters of quad5-sym.
    pub learners: Vec<Asking>,
}

/// The result for one structure.
#[derive(Debug, Serialize)]
pub struct Row {
    /// Its name.
    pub structure: String,
    /// Its modules.
    pub modules: u64,
    /// Simulated seconds by second of processor time: bodies alone, agents alone, and both.
    pub bodies: f64,
    pub agents: f64,
    pub both: f64,
    /// Messages of class gait a second in lock, and without prediction.
    pub gait_messages: f64,
    pub unpredicted: f64,
}

/// The cost of a learner.
#[derive(Debug, Serialize)]
pub struct Asking {
    /// Its name.
    pub learner: String,
    /// The number of parameters.
    pub parameters: u64,
    /// Gaits asked for.
    pub asked: u64,
    /// Processor time of a gait in microseconds, without its trial.
    pub us: f64,
}

/// Measures structures of at most this many modules, and the learners.
pub fn measure(most: u64, live: &mut Live) -> Result<Gaits, BenchError> {
    let mut rows = Vec::new();
    for (name, ring) in STRUCTURES {
        // Invariant: these are names of structures.
        let structure = named::structure(name).expect("a named structure");
        if structure.bound() as u64 <= most || rows.is_empty() {
            live.show(|| format!("gait: {name}"));
            rows.push(row(name, &structure, ring)?);
        }
    }
    let space = named::structure("quad5-sym").and_then(|structure| Space::of(&structure, NETWORK).ok());
    let dimensions = space.map_or(1, |space| space.dimensions());
    let learners = LEARNERS.map(|method| {
        live.show(|| format!("gait: {method}"));
        asking(method, dimensions)
    });
    live.clear();
    Ok(Gaits { rows, learners: learners.into() })
}

fn row(name: &str, structure: &Structure, ring: Option<(usize, [f64; 3])>) -> Result<Row, BenchError> {
    let wrong = |error: &dyn std::fmt::Display| BenchError::Wrong(format!("{name}: {error}"));
    let mut posture = vec![[0.0; 3]; structure.bound()];
    if let Some((modules, angles)) = ring {
        posture[..modules].fill(angles);
    }
    let space = Space::of(structure, NETWORK).map_err(|_| wrong(&"no joint moves"))?;
    // Small amplitudes and equal phases: a gait in which no modules meet.
    let mut point = vec![0.5; space.dimensions()];
    point[..space.groups()].fill(0.25);
    let gait = space.gait(&point);
    let bodies = || Bodies::new(structure, &posture, Down::DEFAULT, FRICTION).map_err(|e| wrong(&e));
    let mut alone = bodies()?;
    let watch = CpuWatch::start();
    for tick in 0..TIME.0 / TICK.0 {
        // A triangle wave with the period of the gait.
        let wave = ((tick % 500) as f32 - 250.0).abs() / 250.0 - 0.5;
        for joint in gait.keys() {
            let at = posture[joint.module().index()][usize::from(joint.0 % JOINTS)].to_radians() as f32;
            alone.set_target(*joint, at + 0.5 * wave);
        }
        alone.step();
    }
    let cpu_bodies = watch.elapsed().as_secs_f64();
    let (cpu_agents, gait_messages) = agents(&gait, true, StructureWorld::new(structure.clone()));
    let (_, unpredicted) = agents(&gait, false, StructureWorld::new(structure.clone()));
    let (cpu_both, _) = agents(&gait, true, PhysicsWorld::new(structure.clone(), bodies()?));
    let by = |cpu: f64| TIME.as_secs_f64() / cpu;
    Ok(Row {
        structure: name.to_owned(),
        modules: structure.bound() as u64,
        bodies: by(cpu_bodies),
        agents: by(cpu_agents),
        both: by(cpu_both),
        gait_messages,
        unpredicted,
    })
}

/// Runs a gait. Returns the processor time, and the number of messages of class gait a second at the end.
fn agents<W>(gait: &Gait, predict: bool, world: W) -> (f64, f64)
where
    W: World<Agent = metamorph_protocol::free_module::gait::FreeModule> + Audited,
{
    let config = SimConfig {
        setup: Arc::new(WalkSetup { predict, ..WalkSetup::new(NETWORK) }),
        link: LinkModel::default(),
        seed: 1,
        audit_every: Span::secs(1),
        ignore_sessions: false,
    };
    let joints: std::collections::BTreeMap<Joint, _> = gait.clone();
    let mut sim = Sim::new(config, world, GaitDirector::new(Time::ZERO + REST, joints));
    let watch = CpuWatch::start();
    sim.run_until(Time::ZERO + TIME - Span::secs(LOCKED));
    let before = sim.tally()[Class::Gait].sent;
    sim.run_until(Time::ZERO + TIME);
    let sent = sim.tally()[Class::Gait].sent - before;
    (watch.elapsed().as_secs_f64(), sent as f64 / LOCKED as f64)
}

fn asking(method: Method, dimensions: usize) -> Asking {
    let watch = CpuWatch::start();
    let (mut learner, mut asked) = (method.learner(dimensions, 1, None), 0);
    while asked < ASKED {
        let points = learner.ask();
        asked += points.len();
        // A smooth value of no meaning; the first coordinates stand for what a gait does.
        let results = points.iter().map(|p| Scored {
            fitness: -p.iter().map(|x| (x - 0.3) * (x - 0.3)).sum::<f64>(),
            behaviour: p.iter().take(5).copied().collect(),
        });
        learner.tell(&results.collect::<Vec<_>>());
    }
    Asking {
        learner: method.to_string(),
        parameters: dimensions as u64,
        asked: asked as u64,
        us: watch.elapsed().as_secs_f64() * 1e6 / asked as f64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_structure_is_measured() {
        let found = measure(1, &mut Live::new(false)).unwrap();
        assert_eq!((found.rows.len(), found.learners.len()), (1, LEARNERS.len()));
        let row = &found.rows[0];
        assert!(row.bodies > 0.0 && row.both > 0.0 && row.gait_messages < row.unpredicted, "{row:?}");
        assert!(found.learners.iter().all(|l| l.asked >= 120 && l.us > 0.0), "{:?}", found.learners);
    }
}
