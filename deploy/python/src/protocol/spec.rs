//! A protocol as given to one call: its class, when a run is over, and what must hold. Also keeps the first error that
//! its code raised.

use crate::raised::raise;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::{Span, Time};
use metamorph_world_controller::scenario::table::span;
use pyo3::exceptions::{PyException, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyType;
use std::cell::Cell;
use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// The protocol of the scenarios that are being read.
static READING: Mutex<Option<Arc<Spec>>> = Mutex::new(None);

thread_local! {
    /// Whether what this thread reads is only to be shown.
    static SHOWING: Cell<bool> = const { Cell::new(false) };
}

/// Carries out `work`, which shows a record and needs no protocol for that.
pub fn showing<T>(work: impl FnOnce() -> T) -> T {
    let before = SHOWING.replace(true);
    let done = work();
    SHOWING.set(before);
    done
}

/// True if this process is one agent.
static IN_AGENT: AtomicBool = AtomicBool::new(false);

/// Makes this process one agent, which ends when its code raises an error.
pub fn be_agent() {
    IN_AGENT.store(true, Ordering::Relaxed);
}

/// An error that the code of a protocol raised.
struct Failure {
    error: PyErr,
    /// The module; `None` for `until` and `invariants`.
    module: Option<ModuleId>,
    at: Time,
    /// The call that raised it.
    input: String,
}

/// A protocol, for one call of `run`, `sweep` or `Simulation`.
pub struct Spec {
    pub class: Py<PyType>,
    pub until: Option<Py<PyAny>>,
    pub invariants: Vec<(String, Py<PyAny>)>,
    /// The time between two checks of the invariants; `None` to check after every input of a module.
    pub every: Option<Span>,
    failure: Mutex<Option<Failure>>,
    has_failed: AtomicBool,
    /// True if this stands for a protocol that is not at hand: a recorded run can be shown with it, and not be carried out.
    pub is_stand_in: bool,
}

impl fmt::Debug for Spec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Spec").field("class", &self.class).finish_non_exhaustive()
    }
}

/// Ends [`Spec::reading`].
pub struct Reading;

impl Drop for Reading {
    fn drop(&mut self) {
        *READING.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

impl Spec {
    /// Makes this the protocol of all scenarios that are read until the guard is dropped. The interpreter must be held
    /// meanwhile, or the process must work for this protocol only.
    pub fn reading(self: &Arc<Spec>) -> Reading {
        *READING.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(self));
        Reading
    }
    /// Returns the protocol of the scenario that is being read; while a record is shown, one that stands for it.
    pub fn read() -> Option<Arc<Spec>> {
        let given = READING.lock().unwrap_or_else(PoisonError::into_inner).clone();
        given.or_else(|| SHOWING.get().then(Spec::stand_in).and_then(Result::ok))
    }
    /// Returns a protocol that stands for one that is not at hand.
    fn stand_in() -> PyResult<Arc<Spec>> {
        Python::attach(|py| {
            let class = py.import("metamorph._protocol")?.getattr("Protocol")?.cast_into::<PyType>()?;
            let spec = Spec::new(class.unbind(), None, Vec::new(), None);
            Ok(Arc::new(Spec { is_stand_in: true, ..spec }))
        })
    }
    fn new(
        class: Py<PyType>,
        until: Option<Py<PyAny>>,
        invariants: Vec<(String, Py<PyAny>)>,
        every: Option<Span>,
    ) -> Spec {
        let (failure, has_failed) = (Mutex::new(None), AtomicBool::new(false));
        Spec { class, until, invariants, every, failure, has_failed, is_stand_in: false }
    }

    /// Notes an error of the protocol's code, unless there was one before; the run ends.
    pub fn fail(&self, error: PyErr, module: Option<ModuleId>, at: Time, input: impl Into<String>) {
        if IN_AGENT.load(Ordering::Relaxed) {
            // The controller reports the end of a process with what it has printed.
            Python::attach(|py| error.print(py));
            #[allow(
                clippy::disallowed_methods,
                reason = "the files of an agent are removed by its controller"
            )]
            std::process::exit(1);
        }
        let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        if failure.is_none() {
            *failure = Some(Failure { error, module, at, input: input.into() });
            self.has_failed.store(true, Ordering::Relaxed);
        }
    }
    /// Returns true if the protocol's code has raised an error.
    pub fn has_failed(&self) -> bool {
        self.has_failed.load(Ordering::Relaxed)
    }
    /// Raises the error that the protocol's code has raised, if any: as a `ProtocolError` with the error as its cause. A
    /// `KeyboardInterrupt` stays what it is.
    pub fn check(&self, py: Python<'_>) -> PyResult<()> {
        let Some(Failure { error, module, at, input }) = self.failure(py) else { return Ok(()) };
        if !error.is_instance_of::<PyException>(py) {
            return Err(error);
        }
        let whose = module.map_or_else(String::new, |id| format!("module {id}: "));
        let text = format!("{whose}{input} at {} s: {error}", at.as_secs_f64());
        let raised = raise(py, "ProtocolError", (text, module.map(|id| id.0), at.0, input));
        raised.set_cause(py, Some(error));
        Err(raised)
    }

    /// Returns the error with the lock released: code of Python that runs meanwhile may raise another one.
    fn failure(&self, py: Python<'_>) -> Option<Failure> {
        let failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        let Failure { error, module, at, input } = failure.as_ref()?;
        Some(Failure { error: error.clone_ref(py), module: *module, at: *at, input: input.clone() })
    }
}

/// A protocol for the calls of this extension.
#[pyclass(frozen, module = "metamorph._metamorph")]
pub struct Protocol {
    pub spec: Arc<Spec>,
}

#[pymethods]
impl Protocol {
    #[new]
    #[pyo3(signature = (class_, until, invariants, every))]
    fn new(
        class_: Py<PyType>,
        until: Option<Py<PyAny>>,
        invariants: Vec<(String, Py<PyAny>)>,
        every: Option<&str>,
    ) -> PyResult<Protocol> {
        let wrong = |why: String| PyValueError::new_err(format!("every: {why}"));
        let every = every.map(|text| span(text).map_err(|error| wrong(error.to_string()))).transpose()?;
        if every == Some(Span::ZERO) {
            return Err(wrong(
                "0 is no time between two checks; leave it out to check after every input".to_owned(),
            ));
        }
        Ok(Protocol { spec: Arc::new(Spec::new(class_, until, invariants, every)) })
    }
}
