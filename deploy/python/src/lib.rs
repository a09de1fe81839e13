//! The private extension under the Python package `metamorph`: about twenty entry points. The public, typed interface is
//! `python/metamorph/_api.py`; what is here takes and returns plain values only.
//!
//! Long calls release the interpreter, and look for signals at least every 0.1 s, so that Ctrl-C works as in any other
//! Python code. Nothing here installs a signal handler.

mod convert;
mod journal;
mod program;
mod protocol;
mod raised;
mod scenario;
mod simulation;
mod sweep;

use pyo3::prelude::*;

/// The commit that the extension is built from; empty outside of a repository.
const COMMIT: &str = git_version::git_version!(
    args = ["--always", "--exclude=*", "--abbrev=12", "--dirty=.changed"],
    fallback = ""
);

/// Simulated runs of swarms of self-reconfigurable modular robots.
#[pymodule]
mod _metamorph {
    #[pymodule_export]
    use super::convert::{nanoseconds, to_toml, to_value};
    #[pymodule_export]
    use super::journal::Journal;
    #[pymodule_export]
    use super::program::program;
    #[pymodule_export]
    use super::protocol::{Context, Protocol, Random, check_message, state_parts};
    #[pymodule_export]
    use super::scenario::{Plan, load, shipped};
    #[pymodule_export]
    use super::simulation::{Simulation, run};
    #[pymodule_export]
    use super::sweep::{manifest, sweep};

    use super::{Bound, PyModule, PyModuleMethods, PyResult};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        metamorph_world_controller::console::version::set_commit(super::COMMIT);
        // The families are in use already if the module was imported before.
        let _ = metamorph_world_controller::family::install(&[&super::protocol::family::PythonFamily]);
        module.add("VERSION", env!("CARGO_PKG_VERSION"))
    }
}
