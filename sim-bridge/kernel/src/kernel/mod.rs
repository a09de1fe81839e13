//! The discrete-event simulator that drives agents, links and a world of any family: event queue, trace hash,
//! state hash and recording.

pub mod audited;
pub mod change;
pub mod graph_world;
pub mod queue;
pub mod recording;
pub mod sim;
pub mod state;
pub mod still_world;
pub mod trace;
