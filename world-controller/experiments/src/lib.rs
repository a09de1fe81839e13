//! Many runs: `sweep` varies seeds and values, `diff` compares sweeps and reports, `explore` draws scenarios and shrinks failures.

pub mod diff;
pub mod explore;
pub mod sweep;
