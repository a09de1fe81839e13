//! One form of bytes for the state of a protocol's objects, so that it can be hashed: the same on every machine, without
//! `repr`, `hash` or the order of sets.

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyDict, PyFrozenSet, PyInt, PyList, PySet, PyString, PyTuple};

/// Largest number of collections nested within each other.
const DEPTH_MAX: usize = 32;

fn counted(out: &mut Vec<u8>, tag: u8, length: usize) {
    out.push(tag);
    out.extend((length as u64).to_le_bytes());
}

fn bytes(out: &mut Vec<u8>, tag: u8, bytes: &[u8]) {
    counted(out, tag, bytes.len());
    out.extend(bytes);
}

fn all<'py>(
    out: &mut Vec<u8>,
    tag: u8,
    values: impl Iterator<Item = Bound<'py, PyAny>>,
    depth: usize,
    sort: bool,
) -> PyResult<()> {
    let mut parts = Vec::new();
    for value in values {
        let mut part = Vec::new();
        encode(&value, &mut part, depth - 1)?;
        parts.push(part);
    }
    if sort {
        parts.sort_unstable();
    }
    counted(out, tag, parts.len());
    parts.into_iter().for_each(|part| out.extend(part));
    Ok(())
}

fn encode(value: &Bound<'_, PyAny>, out: &mut Vec<u8>, depth: usize) -> PyResult<()> {
    if depth == 0 {
        return Err(PyTypeError::new_err(format!("it is nested more than {DEPTH_MAX} deep")));
    }
    if value.is_none() {
        out.push(b'n');
    } else if let Ok(flag) = value.cast::<PyBool>() {
        out.push(if flag.is_true() { b't' } else { b'f' });
    } else if value.is_instance_of::<PyInt>() {
        match value.extract::<i64>() {
            Ok(number) => {
                out.push(b'i');
                out.extend(number.to_le_bytes());
            }
            Err(_) => {
                bytes(out, b'I', value.call_method1("__format__", ("d",))?.extract::<String>()?.as_bytes())
            }
        }
    } else if let Ok(text) = value.cast::<PyString>() {
        bytes(out, b's', text.to_cow()?.as_bytes());
    } else if let Ok(content) = value.cast::<PyBytes>() {
        bytes(out, b'b', content.as_bytes());
    } else if let Ok(tuple) = value.cast::<PyTuple>() {
        if let Ok((kind, ..)) =
            value.getattr("_layout").and_then(|l| l.extract::<(u8, String, Bound<'_, PyAny>)>())
        {
            out.extend([b'm', kind]);
        }
        all(out, b'(', tuple.iter(), depth, false)?;
    } else if let Ok(list) = value.cast::<PyList>() {
        all(out, b'[', list.iter(), depth, false)?;
    } else if let Ok(dict) = value.cast::<PyDict>() {
        all(out, b'{', dict.items().iter(), depth, true)?;
    } else if let Ok(set) = value.cast::<PySet>() {
        all(out, b'<', set.iter(), depth, true)?;
    } else if let Ok(set) = value.cast::<PyFrozenSet>() {
        all(out, b'<', set.iter(), depth, true)?;
    } else {
        let name = value.get_type().name()?;
        return Err(PyTypeError::new_err(format!(
            "a {name} has no state that is the same on every machine; keep int, bool, str, bytes, None, messages, and \
             tuples, lists, dicts and sets of these, or return such a value from `state()`"
        )));
    }
    Ok(())
}

/// Returns the parts of the state of an object, for comparing two runs.
#[pyfunction]
pub fn state_parts<'py>(
    object: &Bound<'py, PyAny>,
    has_state: bool,
) -> PyResult<Vec<(String, Bound<'py, PyBytes>)>> {
    let parts = parts(object, has_state)?.into_iter();
    Ok(parts.map(|(name, bytes)| (name, PyBytes::new(object.py(), &bytes))).collect())
}

/// Returns the parts of the state of an object by name, in one form of bytes: its attributes, or the one value of its
/// method `state`.
pub fn parts(object: &Bound<'_, PyAny>, has_state: bool) -> PyResult<Vec<(String, Vec<u8>)>> {
    let mut found = Vec::new();
    if has_state {
        let mut out = Vec::new();
        encode(&object.call_method0("state")?, &mut out, DEPTH_MAX)?;
        return Ok(vec![("state()".to_owned(), out)]);
    }
    let attributes = object.getattr("__dict__")?;
    for (name, value) in attributes.cast::<PyDict>()?.iter() {
        let (name, mut out) = (name.extract::<String>()?, Vec::new());
        encode(&value, &mut out, DEPTH_MAX)
            .map_err(|e| PyTypeError::new_err(format!("the attribute `{name}`: {}", e.value(object.py()))))?;
        found.push((name, out));
    }
    found.sort_unstable();
    Ok(found)
}
