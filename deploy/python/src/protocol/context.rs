//! The context of a call into a protocol: sending, the timer, movement, reports and random numbers.

use super::agent::PyAgent;
use super::message::{Payload, counter_class};
use super::setup::Setup;
use metamorph_protocol::agent::{Agent, Birth, Output, OutputOf};
use metamorph_protocol::counters::Class;
use metamorph_protocol::cube::body::Move;
use metamorph_protocol::ids::{ModuleId, Port};
use metamorph_protocol::lattice::{Cell, Face, Motion, MotionKind};
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::time::{Span, Time};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyInt, PyList, PyString};
use std::collections::VecDeque;
use std::sync::Arc;

/// The names of the faces, in the order of their numbers.
const FACES: [&str; PyAgent::PORTS] = ["east", "west", "north", "south", "up", "down"];

/// What a module may do, and what it knows of itself.
#[pyclass(module = "metamorph._metamorph")]
pub struct Context {
    setup: Arc<Setup>,
    id: ModuleId,
    incarnation: u16,
    pub now: Time,
    pub is_up: [bool; PyAgent::PORTS],
    pub wake_at: Time,
    pub outputs: VecDeque<OutputOf<PyAgent>>,
    pub random: Py<Random>,
}

impl Context {
    /// Creates the context of a module that starts.
    pub fn new(py: Python<'_>, setup: &Arc<Setup>, birth: &Birth<Cell>, now: Time) -> PyResult<Context> {
        // Each incarnation draws numbers of its own: it must not repeat what another has drawn.
        let index = u64::from(birth.incarnation.0) << 32 | u64::from(birth.id.0);
        let random = Random { rng: Rng::named(birth.seed, "python", index) };
        Ok(Context {
            setup: Arc::clone(setup),
            id: birth.id,
            incarnation: birth.incarnation.0,
            now,
            is_up: [false; PyAgent::PORTS],
            wake_at: Time::NEVER,
            outputs: VecDeque::new(),
            random: Py::new(py, random)?,
        })
    }

    fn encode(&self, message: &Bound<'_, PyAny>, class: Option<&str>) -> PyResult<(Payload, Class)> {
        let kind = self.setup.type_of(message)?;
        let class = class.map_or(Ok(kind.counted_as()), counter_class)?;
        Ok((kind.encode(message)?, class))
    }
}

#[pymethods]
impl Context {
    #[getter]
    fn id(&self) -> u32 {
        self.id.0
    }
    #[getter]
    fn incarnation(&self) -> u16 {
        self.incarnation
    }
    #[getter]
    fn now_ns(&self) -> u64 {
        self.now.0
    }
    /// The ports that another module touches.
    #[getter]
    fn ports_up(&self) -> Vec<u32> {
        (0..).zip(self.is_up).filter(|(_, up)| *up).map(|(port, _)| port).collect()
    }
    #[getter]
    fn random(&self, py: Python<'_>) -> Py<Random> {
        self.random.clone_ref(py)
    }
    /// Sends a message by a port. By a port that nothing touches it goes nowhere.
    #[pyo3(signature = (port, message, cls=None))]
    fn send(&mut self, port: usize, message: &Bound<'_, PyAny>, cls: Option<&str>) -> PyResult<()> {
        if port >= PyAgent::PORTS {
            let text =
                format!("there is no port {port}; ports are numbered from 0 to {}", PyAgent::PORTS - 1);
            return Err(PyValueError::new_err(text));
        }
        let (message, class) = self.encode(message, cls)?;
        self.outputs.push_back(Output::Send { port: Port(port as u8), class, message });
        Ok(())
    }
    /// Sends a message by every port that another module touches, in the order of the ports.
    #[pyo3(signature = (message, cls=None))]
    fn broadcast(&mut self, message: &Bound<'_, PyAny>, cls: Option<&str>) -> PyResult<()> {
        let (message, class) = self.encode(message, cls)?;
        let ports = (0u8..).zip(self.is_up).filter(|(_, up)| *up);
        self.outputs.extend(ports.map(|(port, _)| Output::Send { port: Port(port), class, message }));
        Ok(())
    }
    /// Reports a message to the controller.
    fn report(&mut self, message: &Bound<'_, PyAny>) -> PyResult<()> {
        let (message, _) = self.encode(message, None)?;
        self.outputs.push_back(Output::Report(message));
        Ok(())
    }
    /// Sets the timer to a time in nanoseconds; replaces an earlier one.
    fn wake_at(&mut self, ns: u64) {
        self.wake_at = Time(ns);
    }
    /// Sets the timer to a time from now; replaces an earlier one.
    fn wake_after(&mut self, span: &Bound<'_, PyAny>) -> PyResult<()> {
        self.wake_at = self.now + duration(span)?;
        Ok(())
    }
    /// Asks the body to move.
    #[pyo3(signature = (kind, support, heading, not_after=None))]
    fn r#move(
        &mut self,
        kind: &str,
        support: &str,
        heading: &str,
        not_after: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let kind = match kind {
            "slide" => MotionKind::Slide,
            "convex" => MotionKind::Convex,
            _ => return Err(unknown("motion", kind, &["slide", "convex"])),
        };
        let face = |name: &str| {
            let index = FACES.iter().position(|face| *face == name);
            index.map(|i| Face::ALL[i]).ok_or_else(|| unknown("face", name, &FACES))
        };
        let motion = Motion { kind, support: face(support)?, heading: face(heading)? };
        if motion.heading.slot_in(motion.support).is_none() {
            let text = format!("a module on its {support} cannot go {heading}; the two are at right angles");
            return Err(PyValueError::new_err(text));
        }
        let not_after =
            not_after.map_or(Ok(Time::NEVER), |span| duration(span).map(|span| self.now + span))?;
        self.outputs.push_back(Output::Act(Move { motion, not_after }));
        Ok(())
    }
}

fn unknown(what: &str, got: &str, known: &[&str]) -> PyErr {
    PyValueError::new_err(format!("`{got}` is no {what}; write one of {}", known.join(", ")))
}

/// Reads a duration: text as in scenarios, seconds, or a `timedelta`.
pub fn duration(value: &Bound<'_, PyAny>) -> PyResult<Span> {
    if let Ok(text) = value.cast::<PyString>() {
        return text.to_cow()?.parse().map_err(|e| PyValueError::new_err(format!("{e}")));
    }
    if let Ok(seconds) = value.extract::<f64>() {
        if !(0.0..1e9).contains(&seconds) {
            return Err(PyValueError::new_err(format!("{seconds} is no duration in seconds")));
        }
        return Ok(Span((seconds * 1e9).round() as u64));
    }
    value.extract::<std::time::Duration>().map(|span| Span(span.as_nanos() as u64))
}

/// A stream of random numbers that belongs to one module of one run.
#[pyclass(module = "metamorph._metamorph")]
pub struct Random {
    pub rng: Rng,
}

#[pymethods]
impl Random {
    /// Returns a number from 0 to below `n`.
    fn below(&mut self, n: u64) -> PyResult<u64> {
        if n == 0 {
            return Err(PyValueError::new_err("there is no number below 0"));
        }
        Ok(self.rng.below(n))
    }
    /// Returns whether an event of this probability happens: text such as "5%", or a `Fraction`.
    fn chance(&mut self, probability: &Bound<'_, PyAny>) -> PyResult<bool> {
        let ratio = if let Ok(text) = probability.cast::<PyString>() {
            text.to_cow()?.parse().map_err(|e| PyValueError::new_err(format!("{e}")))?
        } else {
            let part = |name| probability.getattr(name)?.cast_into::<PyInt>()?.extract::<u32>();
            Ratio::new(part("numerator")?, part("denominator")?)
                .ok_or_else(|| PyValueError::new_err(format!("{probability} is not between 0 and 1")))?
        };
        Ok(self.rng.chance(ratio))
    }
    /// Puts the elements of a list into a random order.
    fn shuffle(&mut self, list: &Bound<'_, PyList>) -> PyResult<()> {
        for i in (1..list.len()).rev() {
            let j = self.rng.below(i as u64 + 1) as usize;
            let (a, b) = (list.get_item(i)?, list.get_item(j)?);
            list.set_item(i, b)?;
            list.set_item(j, a)?;
        }
        Ok(())
    }
}
