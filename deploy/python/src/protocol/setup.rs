//! State shared by all agents of one run: the class with its parameters, its messages, and the reports so far.

use super::message::{MessageType, Payload};
use super::spec::Spec;
use metamorph_protocol::time::Span;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple, PyType};
use serde::de::Error as _;
use serde::ser::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

const ONLY_SIMULATED: &str = "a protocol written in Python runs on the simulated link only";

/// The methods that a class overrides.
#[derive(Clone, Copy)]
pub struct Overridden {
    pub contact: bool,
    pub receive: bool,
    pub sensed: bool,
    pub wake: bool,
    pub state: bool,
}

/// State shared by all agents of one run.
pub struct Setup {
    pub spec: Arc<Spec>,
    /// The class with the parameters of this run.
    pub class: Py<PyType>,
    pub overridden: Overridden,
    /// The time of a move.
    pub move_time: Span,
    /// The objects of living modules, by number.
    pub modules: Py<PyDict>,
    /// The last reports of living modules, by number.
    pub reports: Py<PyDict>,
    /// How often each invariant of the protocol was called.
    pub calls: Box<[AtomicU64]>,
    messages: Vec<MessageType>,
    /// `tuple.__new__`.
    make: Py<PyAny>,
}

impl std::fmt::Debug for Setup {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Setup").field("class", &self.class).finish_non_exhaustive()
    }
}

impl Setup {
    /// Prepares a run of a class whose parameters are set.
    pub fn new(spec: &Arc<Spec>, class: &Bound<'_, PyType>, move_time: Span) -> PyResult<Setup> {
        let py = class.py();
        let base = py.import("metamorph._protocol")?.getattr("Protocol")?;
        let overrides = |name: &str| Ok::<_, PyErr>(!class.getattr(name)?.is(&base.getattr(name)?));
        let mut messages: Vec<MessageType> = Vec::new();
        for message in class.getattr("messages")?.try_iter()? {
            let message = MessageType::of(message?.cast::<PyType>()?)?;
            if messages.iter().any(|other| other.kind() == message.kind()) {
                let text = format!("two messages of {} have kind {}", class.name()?, message.kind());
                return Err(PyTypeError::new_err(text));
            }
            messages.push(message);
        }
        Ok(Setup {
            calls: spec.invariants.iter().map(|_| AtomicU64::new(0)).collect(),
            spec: Arc::clone(spec),
            class: class.clone().unbind(),
            overridden: Overridden {
                contact: overrides("contact")?,
                receive: overrides("receive")?,
                sensed: overrides("sensed")?,
                wake: overrides("wake")?,
                state: overrides("state")?,
            },
            move_time,
            modules: PyDict::new(py).unbind(),
            reports: PyDict::new(py).unbind(),
            messages,
            make: py.get_type::<PyTuple>().getattr("__new__")?.unbind(),
        })
    }
    /// Returns the class of a message.
    pub fn type_of(&self, message: &Bound<'_, PyAny>) -> PyResult<&MessageType> {
        self.messages.iter().find(|m| m.is_type_of(message)).ok_or_else(|| {
            let (class, name) = (self.class.bind(message.py()), message.get_type());
            let text = format!("{} is not in `messages` of {}", word(name.as_any()), word(class.as_any()));
            PyTypeError::new_err(text)
        })
    }
    /// Returns the message with these bytes.
    pub fn message<'py>(&self, py: Python<'py>, payload: &Payload) -> PyResult<Bound<'py, PyAny>> {
        use metamorph_protocol::wire::Wire;
        let kind = payload.kind();
        let found = self.messages.iter().find(|m| m.kind() == kind);
        found
            .ok_or_else(|| PyTypeError::new_err(format!("no message has kind {kind}")))?
            .decode(py, payload, &self.make)
    }
}

fn word(class: &Bound<'_, PyAny>) -> String {
    class.getattr("__name__").map_or_else(|_| "it".to_owned(), |name| name.to_string())
}

impl Serialize for Setup {
    fn serialize<S: Serializer>(&self, _: S) -> Result<S::Ok, S::Error> {
        Err(S::Error::custom(ONLY_SIMULATED))
    }
}

impl<'de> Deserialize<'de> for Setup {
    fn deserialize<D: Deserializer<'de>>(_: D) -> Result<Setup, D::Error> {
        Err(D::Error::custom(ONLY_SIMULATED))
    }
}
