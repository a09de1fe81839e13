//! Many runs: `sweep` varies seeds and values, `diff` compares sweeps and reports, `explore` draws scenarios and shrinks failures,
//! `why` asks the futures of a run when its end was decided.

pub mod diff;
pub mod explore;
pub mod sweep;
pub mod why;
