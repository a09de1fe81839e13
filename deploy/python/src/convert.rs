//! Values of Python turned into those of scenarios.

use metamorph_protocol::time::Span;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use toml::Value;

fn read(json: &str) -> PyResult<Value> {
    serde_json::from_str(json)
        .map_err(|e| PyValueError::new_err(format!("there is no TOML for this value: {e}")))
}

/// Returns a JSON object as a TOML document.
#[pyfunction]
pub fn to_toml(json: &str) -> PyResult<String> {
    toml::to_string(&read(json)?)
        .map_err(|e| PyValueError::new_err(format!("there is no TOML for this value: {e}")))
}

/// Returns a JSON value as a TOML value on one line, as in `--set KEY=VALUE`.
#[pyfunction]
pub fn to_value(json: &str) -> PyResult<String> {
    Ok(read(json)?.to_string())
}

/// Returns a duration such as `1.5s`, as scenarios write it, in nanoseconds.
#[pyfunction]
pub fn nanoseconds(text: &str) -> PyResult<u64> {
    text.parse().map(|Span(ns)| ns).map_err(|e| PyValueError::new_err(format!("{e}")))
}
