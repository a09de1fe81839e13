//! The run of the studio: at most one at a time, handed from the page to the thread that carries runs out.

use metamorph_console::interrupt::Interrupt;
use metamorph_console::shutdown::{Shutdown, Urgency};
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::Live;
use metamorph_processes::control::{SharedQueue, queue};
use metamorph_processes::family;
use metamorph_processes::run::PageChannels;
use metamorph_processes::run::processes::{ProcessError, Processes};
use metamorph_processes::run::simulated::{Simulation, simulate};
use metamorph_protocol::time::Time;
use metamorph_report::schema::Report;
use metamorph_scenario::{LinkKind, Plan};
use metamorph_scene::shared::Shared;
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_text::command_error::CommandError;
use metamorph_view::access::Token;
use metamorph_view::control::Control;
use metamorph_view::request::{Command, Origin};
use metamorph_view::saved::Subject;
use metamorph_view::server::RunPage;
use serde_json::{Value, json};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use thiserror::Error;

/// Longest time until a request to end is seen while no run is in progress.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// A run to be carried out.
#[derive(Debug)]
struct Order {
    plan: Plan,
    scene: Shared,
    commands: SharedQueue,
    shutdown: Shutdown,
}

/// State of the latest run.
#[derive(Debug, Default)]
struct State {
    order: Option<Order>,
    page: Option<Arc<RunPage>>,
    /// Number of runs so far.
    runs: u64,
    title: String,
    link: &'static str,
    modules: usize,
    /// Asks the run to end, while it is in progress.
    going: Option<Shutdown>,
    outcome: Option<String>,
    failure: Option<String>,
}

/// Where runs are handed over.
#[derive(Debug, Default)]
pub struct Desk {
    state: Mutex<State>,
    ordered: Condvar,
}

/// A run is in progress already.
#[derive(Debug, Error)]
#[error("a run is going on; stop it first")]
pub struct Busy;

impl Desk {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Hands over a run, and returns its number. Its page takes commands that hold the secret.
    ///
    /// # Errors
    /// If another run is in progress.
    pub fn start(&self, plan: Plan, secret: &Token) -> Result<u64, Busy> {
        if self.state().going.is_some() {
            return Err(Busy);
        }
        let messages = plan.overrides.link == LinkKind::Sim;
        let scene = Shared::new(family::scene(&plan, messages));
        let (operators, commands) = queue();
        let origin =
            Origin { title: plan.title(), seed: plan.seed, command: Command::Run(plan.repeat_with()) };
        let subject = Subject::new(family::of(&plan).shown(&plan), origin);
        let page = RunPage::new(scene.clone(), subject, Some(Control::new(secret.clone(), operators)));
        let shutdown = Shutdown::new();
        let mut state = self.state();
        if state.going.is_some() {
            return Err(Busy);
        }
        *state = State {
            page: Some(Arc::new(page)),
            runs: state.runs + 1,
            title: plan.title(),
            link: plan.overrides.link.name(),
            modules: plan.swarm.len(),
            going: Some(shutdown.clone()),
            order: Some(Order { plan, scene, commands, shutdown }),
            ..State::default()
        };
        self.ordered.notify_all();
        Ok(state.runs)
    }

    /// Asks the run to end; a second request asks it to hurry. Returns whether there is one.
    pub fn stop(&self) -> bool {
        let state = self.state();
        state.going.iter().for_each(Shutdown::request);
        state.going.is_some()
    }

    /// Returns the page of the latest run.
    pub fn page(&self) -> Option<Arc<RunPage>> {
        self.state().page.clone()
    }

    /// Returns what is known of the latest run, for the page; null if there was none.
    pub fn latest(&self) -> Value {
        let state = self.state();
        if state.page.is_none() {
            return Value::Null;
        }
        json!({
            "run": state.runs, "title": state.title, "link": state.link, "modules": state.modules,
            "going": state.going.is_some(), "outcome": state.outcome, "failure": state.failure,
        })
    }

    /// Carries out runs one after the other until a signal asks the program to end.
    pub fn carry_out(&self, interrupt: &Interrupt) {
        while !interrupt.is_set() {
            let state = self.state();
            let waited = self.ordered.wait_timeout_while(state, LOOK_EVERY, |s| s.order.is_none());
            let Some(order) = waited.unwrap_or_else(PoisonError::into_inner).0.order.take() else { continue };
            let (scene, commands) = (order.scene.clone(), order.commands.clone());
            let ended = run(order, interrupt);
            commands.lock().close();
            let (outcome, failure) = match ended {
                Ok(report) => {
                    let outcome = report.outcome.clone();
                    scene.lock().finish(report);
                    (Some(outcome), None)
                }
                Err(error) => {
                    scene.lock().end(vec![error.text()]);
                    (None, Some(error.text()))
                }
            };
            let mut state = self.state();
            (state.outcome, state.failure, state.going) = (outcome, failure, None);
        }
    }
}

fn run(order: Order, interrupt: &Interrupt) -> Result<Report, ProcessError> {
    let Order { plan, scene, commands, shutdown } = order;
    let (family, since) = (family::of(&plan), Stopwatch::start());
    let scribe = Some(family.shown(&plan).scribe(scene));
    let page = PageChannels { scribe, control: Some(commands), shutdown: shutdown.clone(), metrics: None };
    match plan.overrides.link {
        LinkKind::Ipc => {
            let live = &mut Live::new(false);
            let patience = Duration::ZERO;
            let processes = Processes { live, since, keeping: None, patience, hosts: None, page };
            family.run_processes(&plan, processes)
        }
        LinkKind::Sim => {
            let mut watch = |_: Time, _: &dyn Fn() -> Progress| {
                shutdown.urgency() == Urgency::None && !interrupt.is_set()
            };
            let simulation = Simulation { since, watch: &mut watch, keeping: None, page, search: false };
            Ok(simulate(&plan, simulation).0)
        }
    }
}
