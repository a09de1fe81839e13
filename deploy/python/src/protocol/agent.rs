//! The agent whose decisions are made by an object of Python.

use super::context::Context;
use super::message::Payload;
use super::setup::Setup;
use super::state;
use metamorph_protocol::agent::{Agent, Birth, Input, InputOf, OutputOf, Summary};
use metamorph_protocol::cube::body::{Move, Percept, Refusal};
use metamorph_protocol::digest::Portable;
use metamorph_protocol::ids::{ModuleId, Port, Session};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::Never;
use pyo3::intern;
use pyo3::prelude::*;
use std::collections::VecDeque;
use std::hash::{Hash, Hasher};
use std::sync::Arc;

/// An agent and its object.
pub struct PyAgent {
    setup: Arc<Setup>,
    id: ModuleId,
    /// The object and its context; `None` if it could not be made, which has ended the run.
    held: Option<(Py<PyAny>, Py<Context>)>,
    outputs: VecDeque<OutputOf<PyAgent>>,
    wake_at: Time,
}

impl Agent for PyAgent {
    type Setup = Setup;
    type Place = Cell;
    type Message = Payload;
    type Action = Move;
    type Percept = Percept;
    type Order = Never;
    type Report = Payload;
    /// Number of faces of a cube.
    const PORTS: usize = 6;

    fn new(setup: &Arc<Setup>, birth: Birth<Cell>, now: Time) -> PyAgent {
        let mut agent = PyAgent {
            setup: Arc::clone(setup),
            id: birth.id,
            held: None,
            outputs: VecDeque::new(),
            wake_at: Time::NEVER,
        };
        if setup.spec.has_failed() {
            return agent;
        }
        Python::attach(|py| {
            if let Err(error) = agent.begin(py, &birth, now) {
                setup.spec.fail(error, Some(birth.id), now, "start");
            }
        });
        agent
    }

    fn handle(&mut self, now: Time, input: InputOf<PyAgent>) {
        if self.setup.spec.has_failed() || (matches!(input, Input::Wake) && now < self.wake_at) {
            return;
        }
        Python::attach(|py| {
            if let Err(error) = self.call(py, now, &input) {
                self.setup.spec.fail(error, Some(self.id), now, describe(&input));
            }
        });
    }

    fn poll(&mut self) -> Option<OutputOf<PyAgent>> {
        self.outputs.pop_front()
    }

    fn wake_at(&self) -> Time {
        self.wake_at
    }

    fn digest(&self, hasher: &mut dyn Hasher) {
        let Some((object, context)) = &self.held else { return };
        Python::attach(|py| {
            let mut hasher = Portable::new(hasher);
            let context = context.borrow(py);
            context.is_up.hash(&mut hasher);
            context.random.borrow(py).rng.hash(&mut hasher);
            match state::parts(object.bind(py), self.setup.overridden.state) {
                Ok(parts) => parts.hash(&mut hasher),
                Err(error) => self.setup.spec.fail(error, Some(self.id), context.now, "state"),
            }
        });
    }

    /// Takes what the attributes of the usual names say.
    fn summary(&self, _: Time) -> Summary {
        let Some((object, _)) = &self.held else { return Summary::default() };
        Python::attach(|py| {
            let object = object.bind(py);
            let text = |name| object.getattr(name).and_then(|v| v.extract::<String>()).unwrap_or_default();
            let number = |name| object.getattr(name).and_then(|v| v.extract::<u32>()).ok();
            Summary {
                role: text(intern!(py, "role")),
                activity: text(intern!(py, "activity")),
                level: number(intern!(py, "level")).and_then(|level| level.try_into().ok()),
                gradient: number(intern!(py, "gradient")),
                waits_for: number(intern!(py, "waits_for")).map(ModuleId),
                ..Summary::default()
            }
        })
    }
}

impl PyAgent {
    fn begin(&mut self, py: Python<'_>, birth: &Birth<Cell>, now: Time) -> PyResult<()> {
        let context = Py::new(py, Context::new(py, &self.setup, birth, now)?)?;
        let Cell { x, y, z } = birth.place;
        let object = self.setup.class.bind(py).call1((birth.id.0, birth.incarnation.0, (x, y, z)))?;
        self.setup.modules.bind(py).set_item(birth.id.0, &object)?;
        object.call_method1(intern!(py, "start"), (&context,))?;
        self.held = Some((object.unbind(), context));
        self.take(py);
        Ok(())
    }

    fn call(&mut self, py: Python<'_>, now: Time, input: &InputOf<PyAgent>) -> PyResult<()> {
        let Some((object, context)) = &self.held else { return Ok(()) };
        let (object, on) = (object.bind(py), self.setup.overridden);
        {
            let mut context = context.borrow_mut(py);
            context.now = now;
            match input {
                Input::Contact { port, session } => context.is_up[port.index()] = session.is_some(),
                Input::Wake => context.wake_at = Time::NEVER,
                _ => {}
            }
        }
        match input {
            Input::Contact { port: Port(port), session } if on.contact => {
                object.call_method1(intern!(py, "contact"), (context, *port, session.is_some()))?;
            }
            Input::Message { port: Port(port), message } if on.receive => {
                let message = self.setup.message(py, message)?;
                object.call_method1(intern!(py, "receive"), (context, *port, message))?;
            }
            Input::Percept(percept) if on.sensed => {
                object.call_method1(intern!(py, "sensed"), (context, sensed(py, *percept)?))?;
            }
            Input::Wake if on.wake => {
                object.call_method1(intern!(py, "wake"), (context,))?;
            }
            Input::Order(never) => match *never {},
            Input::Contact { .. } | Input::Message { .. } | Input::Percept(_) | Input::Wake => {}
        }
        self.take(py);
        Ok(())
    }

    /// Takes what the code has asked for.
    fn take(&mut self, py: Python<'_>) {
        if let Some((_, context)) = &self.held {
            let mut context = context.borrow_mut(py);
            // The outputs of the last call have been polled, so that the two only change places.
            std::mem::swap(&mut self.outputs, &mut context.outputs);
            self.wake_at = context.wake_at;
        }
    }
}

/// Returns a percept as the class of Python.
fn sensed(py: Python<'_>, percept: Percept) -> PyResult<Bound<'_, PyAny>> {
    let class = py.import(intern!(py, "metamorph._protocol"))?.getattr(intern!(py, "Percept"))?;
    match percept {
        Percept::Arrived(Cell { x, y, z }) => class.call1(("arrived", (x, y, z), py.None())),
        Percept::Failed => class.call1(("failed", py.None(), py.None())),
        Percept::Refused(why) => {
            let why = match why {
                Refusal::Blocked => "blocked",
                Refusal::Late => "late",
                Refusal::Stale => "stale",
                Refusal::Moving => "moving",
            };
            class.call1(("refused", py.None(), why))
        }
    }
}

fn describe(input: &InputOf<PyAgent>) -> String {
    let contact = |session: &Option<Session>| if session.is_some() { "contact" } else { "end of contact" };
    match input {
        Input::Contact { port, session } => format!("{} on port {}", contact(session), port.0),
        Input::Message { port, .. } => format!("message on port {}", port.0),
        Input::Percept(_) => "percept".to_owned(),
        Input::Wake => "wake".to_owned(),
        Input::Order(never) => match *never {},
    }
}
