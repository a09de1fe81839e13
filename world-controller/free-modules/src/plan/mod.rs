//! Plans of free modules: `input`, `connected` and `document` read and write files, `solve` drives a planner, `counts` says what
//! a plan consists of, `check` is the independent check of a plan, `compare` has the questions without a plan. The planners
//! themselves are in `metamorph_protocol::plan` and `assembly`.

pub mod check;
pub mod compare;
pub mod connected;
mod counts;
pub mod document;
pub mod error;
pub mod input;
pub mod solve;

pub use error::PlanError;
