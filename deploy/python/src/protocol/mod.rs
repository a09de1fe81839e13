//! Protocols written in Python: one object per module, driven by the simulated link like any other agent.
//!
//! They are the family [`family::NAME`] of this extension, so that runs, steps, sweeps, faults and reports are those of
//! every family. The class comes with the call, not with the scenario: see [`spec::Spec::reading`].

mod agent;
mod bodies;
mod context;
mod director;
pub mod family;
mod look;
mod message;
mod setup;
pub mod spec;
mod state;

pub use context::{Context, Random};
pub use message::check_message;
pub use setup::Setup;
pub use spec::Protocol;
pub use state::state_parts;
