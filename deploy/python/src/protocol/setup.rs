//! State shared by all agents of one run: the class with its parameters, its messages, and the reports so far.

use super::message::{MessageType, Payload};
use super::spec::Spec;
use metamorph_protocol::time::Span;
use metamorph_world_controller::report::message_timeline::MessageLabel;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple, PyType};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

/// A value of a parameter.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Value {
    /// A text, such as a time.
    Text(String),
    /// A whole number.
    Number(i64),
    /// A flag.
    Flag(bool),
}

impl Value {
    fn to_python<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Ok(match self {
            Value::Text(text) => text.into_pyobject(py)?.into_any(),
            Value::Number(number) => number.into_pyobject(py)?.into_any(),
            Value::Flag(flag) => flag.into_pyobject(py)?.to_owned().into_any(),
        })
    }
}

/// The part of a setup that agents in processes of their own are told; they have the class from their command line.
#[derive(Serialize, Deserialize)]
struct Told {
    parameters: Vec<(String, Value)>,
    move_time: Span,
}

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
    /// The parameters that the scenario sets.
    parameters: Vec<(String, Value)>,
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
    /// Prepares a run of a class with these parameters.
    pub fn new(
        py: Python<'_>,
        spec: &Arc<Spec>,
        parameters: Vec<(String, Value)>,
        move_time: Span,
    ) -> PyResult<Setup> {
        let class = bind(py, spec, &parameters)?;
        let class = &class;
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
            parameters,
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
    /// Prepares another run of the same class.
    pub fn again(&self) -> PyResult<Setup> {
        Python::attach(|py| Setup::new(py, &self.spec, self.parameters.clone(), self.move_time))
    }
    /// Returns the label of a message.
    pub fn label(&self, payload: &Payload) -> MessageLabel {
        use metamorph_protocol::wire::Wire;
        let found = self.messages.iter().find(|message| message.kind() == payload.kind());
        let unknown = || MessageLabel::with("message of kind", payload.kind().into());
        found.map_or_else(unknown, |of| of.label(payload))
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

/// Sets the parameters of a class: returns a class of this run. A stand-in has none.
fn bind<'py>(py: Python<'py>, spec: &Spec, parameters: &[(String, Value)]) -> PyResult<Bound<'py, PyType>> {
    if spec.is_stand_in {
        return Ok(spec.class.bind(py).clone());
    }
    let values = PyDict::new(py);
    for (name, value) in parameters {
        values.set_item(name, value.to_python(py)?)?;
    }
    let class = py.import("metamorph._protocol")?.getattr("_bind")?.call1((&spec.class, values))?;
    Ok(class.cast_into::<PyType>()?)
}

/// Returns the error of a value of a parameter: what is wrong, and what to do.
pub fn wrong(py: Python<'_>, spec: &Spec, name: &str, value: &Value) -> PyResult<Option<(String, String)>> {
    let wrong = py.import("metamorph._protocol")?.getattr("_wrong")?;
    wrong.call1((&spec.class, name, value.to_python(py)?))?.extract()
}

impl Serialize for Setup {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        Told { parameters: self.parameters.clone(), move_time: self.move_time }.serialize(to)
    }
}

impl<'de> Deserialize<'de> for Setup {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Setup, D::Error> {
        let Told { parameters, move_time } = Told::deserialize(from)?;
        let spec = Spec::read().ok_or_else(|| D::Error::custom("no protocol is given"))?;
        Python::attach(|py| Setup::new(py, &spec, parameters, move_time)).map_err(D::Error::custom)
    }
}
