//! Checks that are skipped where a tool is missing, unless the environment requires them: `METAMORPH_REQUIRE` lists, with
//! commas, the checks whose skipping is an error. `.ci/run` knows the same words.
#![allow(clippy::print_stdout, reason = "says why something is skipped")]

use std::fmt::{self, Display};

/// Name of the environment variable with the checks that must not be skipped.
const VARIABLE: &str = "METAMORPH_REQUIRE";

/// A kind of checks that may be skipped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Check {
    /// Licences, advisories and sources of dependencies, by cargo-deny.
    Deny,
    /// Pages in a browser.
    Browser,
    /// The types of the page's scripts, and its bundle.
    Npm,
    /// The Python package.
    Python,
    /// Runs with a disk or shared memory of a small size, which are mounts in a namespace.
    Mounts,
    /// Hosts in network namespaces.
    Namespaces,
    /// Jobs of SLURM, which is started on this machine.
    Slurm,
    /// Sweeps by Dask, from Python.
    Dask,
    /// Proofs for any number of modules, by z3.
    Proofs,
}

impl Check {
    const ALL: [Check; 9] = [
        Check::Deny,
        Check::Browser,
        Check::Npm,
        Check::Python,
        Check::Mounts,
        Check::Namespaces,
        Check::Slurm,
        Check::Dask,
        Check::Proofs,
    ];
}

impl Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Check::Deny => "deny",
            Check::Browser => "browser",
            Check::Npm => "npm",
            Check::Python => "python",
            Check::Mounts => "mounts",
            Check::Namespaces => "namespaces",
            Check::Slurm => "slurm",
            Check::Dask => "dask",
            Check::Proofs => "proofs",
        })
    }
}

/// Says why a check is skipped.
///
/// # Panics
/// If the environment requires the check, or names one that does not exist.
pub fn skip(check: Check, why: &str) {
    let required = std::env::var(VARIABLE).unwrap_or_default();
    match requires(&required, check) {
        Ok(false) => println!("skipped: {why}"),
        Ok(true) => panic!("{why}, and {VARIABLE}={required} does not let `{check}` be skipped"),
        Err(unknown) => panic!("{VARIABLE}={required}: there is no check `{unknown}`"),
    }
}

/// True if the environment requires a check. For those that are not made just because their tools are there.
///
/// # Panics
/// If the environment names one that does not exist.
pub fn is_required(check: Check) -> bool {
    let required = std::env::var(VARIABLE).unwrap_or_default();
    requires(&required, check)
        .unwrap_or_else(|unknown| panic!("{VARIABLE}={required}: there is no check `{unknown}`"))
}

/// Returns whether a list of checks has this one; the error is a word that is none.
fn requires(list: &str, check: Check) -> Result<bool, &str> {
    let words = || list.split(',').map(str::trim).filter(|word| !word.is_empty());
    match words().find(|word| Check::ALL.iter().all(|check| check.to_string() != *word)) {
        Some(unknown) => Err(unknown),
        None => Ok(words().any(|word| word == check.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_required_is_a_list_of_known_checks() {
        assert_eq!(requires("", Check::Browser), Ok(false));
        assert_eq!(requires("deny, browser", Check::Browser), Ok(true));
        assert_eq!(requires("deny, browser,", Check::Python), Ok(false));
        assert_eq!(requires("browser,chrome", Check::Browser), Err("chrome"));
        let all = Check::ALL.map(|check| check.to_string()).join(",");
        assert!(Check::ALL.iter().all(|check| requires(&all, *check) == Ok(true)));
    }
}
