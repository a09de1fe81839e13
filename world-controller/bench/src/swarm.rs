//! Swarms of processes: the time to start a block of agents and to flood it, the memory of each, and their
//! cost when idle.

use super::BenchError;
use super::machine::{available_memory, children, open_files, proportional_memory, ran};
use super::part::{AGENT, SUBCOMMAND};
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::Live;
use metamorph_processes::run::processes::ProcessError;
use metamorph_processes::swarm::{SwarmError, SwarmOptions, descriptor_limit, run_swarm};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use metamorph_protocol::wire::Never;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::kernel::still_world::StillWorld;
use metamorph_sim_bridge::testing::flood::{Flooded, Hops};
use metamorph_sim_bridge::world::World;
use metamorph_text::format::many;
use serde::Serialize;
use std::time::Duration;

/// Modules along the sides of a block: 100, 1,000, 2,000, 5,000, 6,000, 8,000 and 12,000 in all.
const SIDES: [[u16; 3]; 7] =
    [[4, 5, 5], [10, 10, 10], [10, 10, 20], [10, 20, 25], [15, 20, 20], [20, 20, 20], [20, 24, 25]];
/// Memory per agent in bytes, including the kernel's.
const MEMORY: u64 = 2 << 20;
/// Time for which an idle swarm is observed.
const IDLE: Span = Span::secs(5);
/// Time after which an incomplete flood has failed.
const DEADLINE: Time = Time(120_000_000_000);

/// The results for all sizes.
#[derive(Debug, Serialize)]
pub struct Swarms {
    /// A row for each size.
    pub rows: Vec<Row>,
    /// Why larger swarms were not measured.
    pub ended_by: Option<String>,
    /// The limit of open descriptors per process, and the number of modules that one run may have with it.
    pub descriptors: u64,
    pub modules_by_descriptors: u64,
}

/// The result for one size.
#[derive(Debug, Serialize)]
pub struct Row {
    pub modules: u64,
    /// Seconds until all processes were up.
    pub setup_s: f64,
    /// Seconds from the start until the flood was complete, and its messages.
    pub exchange_s: f64,
    pub messages: u64,
    /// Proportional set size of all agents, and per agent, in bytes.
    pub pss_bytes: u64,
    pub pss_per_agent: f64,
    /// Load of the idle swarm in percent of one processor: all agents, and the controller.
    pub idle_agents_percent: f64,
    pub idle_controller_percent: f64,
    /// Descriptors open in the controller.
    pub descriptors: u64,
    /// Seconds to stop and remove the swarm.
    pub stop_s: f64,
}

/// Measures all sizes up to `most` modules, as far as this machine permits.
pub fn measure(most: u64, live: &mut Live) -> Result<Swarms, BenchError> {
    let (descriptors, modules_by_descriptors) = descriptor_limit();
    let mut swarms = Swarms { rows: Vec::new(), ended_by: None, descriptors, modules_by_descriptors };
    for sides in SIDES {
        let modules: u64 = sides.into_iter().map(u64::from).product();
        if modules > most {
            break;
        }
        let available = available_memory();
        if available < modules * MEMORY {
            let needed = (modules * MEMORY) >> 20;
            swarms.ended_by = Some(format!(
                "{modules} processes: they need {needed} MB of memory, {} MB are free",
                available >> 20
            ));
            break;
        }
        live.show(|| format!("swarm: {}", many(modules, "process")));
        let row = row(sides);
        live.clear();
        match row {
            Ok(row) => swarms.rows.push(row),
            // The limit of a machine is a result.
            Err(BenchError::Swarm(
                e @ (SwarmError::Descriptors { .. } | SwarmError::Space { .. } | SwarmError::Spawn { .. }),
            )) => {
                swarms.ended_by = Some(format!("{modules} processes: {e}"));
                break;
            }
            Err(e) => return Err(e),
        }
    }
    Ok(swarms)
}

fn row(sides: [u16; 3]) -> Result<Row, BenchError> {
    let mut world = StillWorld::<Flooded>::new(sides);
    let modules = world.len() as u64;
    let expected = 2 * world.contacts() - (modules - 1);
    let mut census = Census::new(modules);
    let options = SwarmOptions {
        program_args: vec![SUBCOMMAND.into(), AGENT.into()],
        catch_signals: true,
        setup_timeout: Duration::from_secs(300),
        stop_timeout: Duration::from_secs(60),
        ..SwarmOptions::new(std::env::current_exe().map_err(ProcessError::Program)?)
    };
    let outcome = run_swarm(&options, &(), &mut world, &mut census)?;
    let Some(found) = census.found else {
        return Err(BenchError::Wrong(format!("the flood reached {} of {modules} processes", census.know)));
    };
    let messages = outcome.tally.total().delivered;
    if messages != expected {
        return Err(BenchError::Wrong(format!(
            "the flood of {modules} processes had {messages} messages instead of {expected}: {:?}",
            outcome.tally.total()
        )));
    }
    let percent = |time: Duration| time.as_secs_f64() / IDLE.as_secs_f64() * 100.0;
    Ok(Row {
        modules,
        setup_s: outcome.setup.as_secs_f64(),
        exchange_s: found.exchanged_at.as_secs_f64(),
        messages,
        pss_bytes: found.memory,
        pss_per_agent: found.memory as f64 / modules as f64,
        idle_agents_percent: percent(found.agents),
        idle_controller_percent: percent(found.controller),
        descriptors: found.descriptors,
        stop_s: found.finished.elapsed().as_secs_f64(),
    })
}

/// The observations of the controller.
struct Found {
    exchanged_at: Time,
    agents: Duration,
    controller: Duration,
    memory: u64,
    descriptors: u64,
    finished: Stopwatch,
}

/// The phase of a measurement.
enum Stage {
    Flooding,
    Settling { exchanged_at: Time, until: Time },
    Idling { exchanged_at: Time, until: Time, agents: Duration, controller: Duration },
    Over,
}

/// A controller that waits for the flood, then observes the idle swarm.
struct Census {
    modules: u64,
    know: u64,
    stage: Stage,
    found: Option<Found>,
    finish: bool,
}

impl Census {
    fn new(modules: u64) -> Census {
        Census { modules, know: 0, stage: Stage::Flooding, found: None, finish: false }
    }
}

impl DirectorPort<StillWorld<Flooded>> for Census {
    fn report(&mut self, now: Time, _: ModuleId, _: Hops) {
        self.know += 1;
        if self.know == self.modules {
            // The last messages are still in flight, for up to as long as the flood took.
            let until = now + Span::secs(1).max(now.since(Time::ZERO));
            self.stage = Stage::Settling { exchanged_at: now, until };
        }
    }
    fn died(&mut self, _: Time, _: ModuleId) {}
    fn started(&mut self, _: Time, _: ModuleId) {}

    fn wake(&mut self, now: Time, _: &mut StillWorld<Flooded>) {
        let own = std::process::id();
        let all = || children().into_iter().map(ran).sum::<Duration>();
        self.stage = match std::mem::replace(&mut self.stage, Stage::Over) {
            Stage::Flooding if now >= DEADLINE => {
                self.finish = true;
                Stage::Over
            }
            Stage::Settling { exchanged_at, until } if now >= until => {
                let (agents, controller) = (all(), ran(own));
                Stage::Idling { exchanged_at, until: now + IDLE, agents, controller }
            }
            Stage::Idling { exchanged_at, until, agents, controller } if now >= until => {
                let (controller, agents) = (ran(own) - controller, all() - agents);
                self.found = Some(Found {
                    exchanged_at,
                    agents,
                    controller,
                    memory: children().into_iter().map(proportional_memory).sum(),
                    descriptors: open_files(),
                    finished: Stopwatch::start(),
                });
                self.finish = true;
                Stage::Over
            }
            other => other,
        };
    }

    fn wake_at(&self) -> Time {
        match self.stage {
            Stage::Flooding => DEADLINE,
            Stage::Settling { until, .. } | Stage::Idling { until, .. } => until,
            Stage::Over => Time::NEVER,
        }
    }
    fn poll(&mut self) -> Option<Command<Never>> {
        std::mem::take(&mut self.finish).then_some(Command::Finish)
    }
}
