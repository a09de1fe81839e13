//! Errors of the package, raised from here.

use pyo3::prelude::*;

/// Raises a class of `metamorph._errors`. These are made in Python: an extension for all versions of Python can derive
/// exceptions only from 3.12 on.
pub fn raise(py: Python<'_>, class: &str, arguments: impl for<'py> pyo3::call::PyCallArgs<'py>) -> PyErr {
    let raised =
        py.import("metamorph._errors").and_then(|m| m.getattr(class)).and_then(|c| c.call1(arguments));
    raised.map_or_else(|e| e, PyErr::from_value)
}
