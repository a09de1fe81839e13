//! The program within the interpreter, for runs whose protocol is written in Python: `metamorph` itself does not know their family.
//! It shows their records, and is their controller and their agents if they run as processes.

use crate::protocol::Protocol;
use crate::protocol::spec::{be_agent, showing};
use metamorph_world_controller::cli::dispatch;
use metamorph_world_controller::console::program::set_leading;
use pyo3::prelude::*;
use std::ffi::OsString;
use std::process::ExitCode;

/// Carries out a command line, and returns whether it succeeded; raises the error that the code of the protocol has raised.
/// `leading` are the arguments with which the interpreter comes here again, `protocol` is that of the run; without it runs can
/// only be shown. It takes signals over from the interpreter, so the process should do nothing else.
#[pyfunction]
#[pyo3(signature = (leading, words, protocol))]
pub fn program(
    py: Python<'_>,
    leading: Vec<OsString>,
    words: Vec<OsString>,
    protocol: Option<&Protocol>,
) -> PyResult<bool> {
    set_leading(leading);
    if words.get(1).is_some_and(|word| word == "agent") {
        be_agent();
    }
    let _reading = protocol.map(|protocol| protocol.spec.reading());
    let code = py.detach(|| showing(|| dispatch::main(words)));
    protocol.map_or(Ok(()), |protocol| protocol.spec.check(py))?;
    Ok(code == ExitCode::SUCCESS)
}
