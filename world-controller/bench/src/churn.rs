//! Deaths in a swarm of processes: modules are killed and restarted one by one, first rarely, then often.
//! Measures whether the controller keeps up, how long a module is away, and whether anything the dead
//! processes held is lost.

use super::BenchError;
use super::machine::{children, open_files, proportional_memory, ran};
use super::median;
use metamorph_console::terminal::Live;
use metamorph_families::cube::{Cubes, NAME};
use metamorph_families::runnable::Runnable;
use metamorph_processes::family::read_text;
use metamorph_processes::run::processes::ProcessError;
use metamorph_processes::swarm::{SwarmOptions, run_swarm};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use metamorph_scenario::Overrides;
use metamorph_sim_bridge::cube::world::CubeWorld;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::world::World;
use metamorph_text::format::many;
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

type Body = <CubeWorld as World>::Agent;

/// Deaths per second, and the duration.
const PHASES: [(u32, Span); 2] = [(2, Span::secs(10)), (20, Span::secs(60))];
/// Pause between phases, in which all modules come back.
const PAUSE: Span = Span::secs(3);

/// The result for one swarm.
#[derive(Debug, Serialize)]
pub struct Churn {
    /// Modules running the cube protocol.
    pub modules: u64,
    /// Proportional set size per agent before the first death, in bytes.
    pub pss_per_agent: f64,
    /// A row for each rate.
    pub rows: Vec<Row>,
}

/// The result for one rate.
#[derive(Debug, Serialize)]
pub struct Row {
    /// Deaths per second requested.
    pub wanted_per_s: u32,
    /// Modules killed.
    pub deaths: u64,
    /// Seconds from the first death until the last killed module was back.
    pub seconds: f64,
    /// Median time from the order to kill a module until its next incarnation has started, in milliseconds.
    pub away_median_ms: f64,
    pub away_worst_ms: f64,
    /// Modules not back at the end.
    pub missing: u64,
    /// Load of the controller, including launching and reaping, in percent of one processor.
    pub controller_percent: f64,
    /// Descriptors open in the controller at the end.
    pub descriptors: u64,
}

/// Measures a block of `side`³ modules.
pub fn measure(side: u16, live: &mut Live) -> Result<Churn, BenchError> {
    let last = side - 1;
    let text = format!(
        "version = 1\n[swarm]\nstart = {{ box = {{ min = [0, 0, 0], max = [{last}, {last}, {last}] }} }}\n\
         [[goal]]\nshape = {{ box = {{ min = [0, 0, 0], max = [{last}, {last}, {last}] }} }}\ngrowth = \"solid\"\n"
    );
    let plan =
        read_text("bench", &text, &Overrides::default()).map_err(|e| BenchError::Wrong(e.to_string()))?;
    let Some(cubes) = plan.swarm.of::<Cubes>() else {
        return Err(BenchError::Wrong("the scenario is not one of cubes".to_owned()));
    };
    live.show(|| format!("churn: deaths among {}", many(cubes.cells.len() as u64, "process")));
    let mut world = cubes.world(&plan);
    let mut reaper = Reaper::new(world.len() as u32);
    let options = SwarmOptions {
        program_args: vec!["agent".into(), "--".into(), NAME.into()],
        catch_signals: true,
        setup_timeout: Duration::from_secs(300),
        stop_timeout: Duration::from_secs(60),
        ..SwarmOptions::new(std::env::current_exe().map_err(ProcessError::Program)?)
    };
    let outcome = run_swarm(&options, cubes.setup.as_ref(), &mut world, &mut reaper)?;
    live.clear();
    if let Some(crash) = outcome.crashes.first() {
        return Err(BenchError::Wrong(format!(
            "module {} {} by itself: {}",
            crash.id, crash.how, crash.stderr_tail
        )));
    }
    Ok(Churn { modules: world.len() as u64, pss_per_agent: reaper.pss, rows: reaper.rows })
}

/// Kills whose modules have not restarted yet, and how long the others took.
#[derive(Debug, Default)]
struct Restarts {
    killed: BTreeMap<ModuleId, Time>,
    away_ms: Vec<f64>,
    first: Option<Time>,
    last_back: Time,
}

/// A controller that kills and restarts modules.
struct Reaper {
    modules: u32,
    /// The current rate, or past the last.
    phase: usize,
    /// Time of the next death or phase.
    due: Time,
    until: Time,
    deaths: u32,
    restarts: Restarts,
    /// Processor time of the controller at the start of the phase.
    ran: Duration,
    commands: VecDeque<Command<<Body as Agent>::Order>>,
    pss: f64,
    rows: Vec<Row>,
}

impl Reaper {
    fn new(modules: u32) -> Reaper {
        let due = Time::ZERO + PAUSE;
        Reaper {
            modules,
            phase: 0,
            due,
            until: due + PHASES[0].1,
            deaths: 0,
            restarts: Restarts::default(),
            ran: Duration::ZERO,
            commands: VecDeque::new(),
            pss: 0.0,
            rows: Vec::new(),
        }
    }

    fn kill_next(&mut self, now: Time) {
        // A large stride, so that no module loses its neighbours for long; the number of modules is no
        // multiple of it.
        let id = ModuleId(self.deaths.wrapping_mul(387) % self.modules);
        self.deaths += 1;
        if self.restarts.killed.contains_key(&id) {
            return;
        }
        if self.restarts.first.is_none() {
            self.restarts.first = Some(now);
            self.ran = ran(std::process::id());
        }
        self.restarts.killed.insert(id, now);
        self.commands.push_back(Command::Kill(id));
    }

    fn end_phase(&mut self, now: Time) {
        let mut restarts = std::mem::take(&mut self.restarts);
        let first = restarts.first.unwrap_or(now);
        let missing = restarts.killed.len() as u64;
        self.rows.push(Row {
            wanted_per_s: PHASES[self.phase].0,
            deaths: restarts.away_ms.len() as u64 + missing,
            seconds: restarts.last_back.since(first).as_secs_f64(),
            away_median_ms: median(&mut restarts.away_ms),
            // Sorted by now.
            away_worst_ms: restarts.away_ms.last().copied().unwrap_or(0.0),
            missing,
            controller_percent: (ran(std::process::id()) - self.ran).as_secs_f64()
                / (now.since(first)).as_secs_f64().max(1.0)
                * 100.0,
            descriptors: open_files(),
        });
        self.phase += 1;
        match PHASES.get(self.phase) {
            Some((_, long)) => (self.due, self.until) = (now, now + *long),
            None => self.commands.push_back(Command::Finish),
        }
    }
}

impl DirectorPort<CubeWorld> for Reaper {
    fn report(&mut self, _: Time, _: ModuleId, _: <Body as Agent>::Report) {}
    fn died(&mut self, _: Time, id: ModuleId) {
        self.commands.push_back(Command::Restart(id));
    }
    fn started(&mut self, now: Time, id: ModuleId) {
        if let Some(since) = self.restarts.killed.remove(&id) {
            self.restarts.away_ms.push(now.since(since).as_secs_f64() * 1e3);
            self.restarts.last_back = now;
        }
    }

    fn wake(&mut self, now: Time, _: &mut CubeWorld) {
        let Some((rate, _)) = PHASES.get(self.phase).filter(|_| now >= self.due) else { return };
        if self.pss == 0.0 {
            let agents = children();
            let all: u64 = agents.iter().copied().map(proportional_memory).sum();
            self.pss = all as f64 / agents.len().max(1) as f64;
        }
        if now < self.until {
            self.kill_next(now);
            self.due += Span::millis(1_000 / u64::from(*rate));
        } else if now < self.until + PAUSE {
            self.due = self.until + PAUSE;
        } else {
            self.end_phase(now);
        }
    }

    fn wake_at(&self) -> Time {
        if self.phase < PHASES.len() { self.due } else { Time::NEVER }
    }
    fn poll(&mut self) -> Option<Command<<Body as Agent>::Order>> {
        self.commands.pop_front()
    }
}
