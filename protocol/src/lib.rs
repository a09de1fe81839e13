//! Vocabulary and protocols of a self-reconfigurable swarm.
//!
//! This crate has no code of its own. It gives the crates below `protocol/` one name, so that a program depends on one
//! crate and finds the ids, units, lattice and messages that every part of Metamorph shares beside the protocols, which
//! are sans-IO state machines: inputs and the current time go in, outputs are polled out, and one call returns the next
//! wake-up time.
//!
//! None of them uses a clock, thread, socket, file or global randomness, or floating point in the state of an agent.

pub use metamorph_agents::on_grid;
pub use metamorph_core::{
    agent, counters, coverage, defects, digest, goal, host, ids, latency, lattice, link, ratio, record, rng,
    runtime, shape, time, wire,
};
pub use metamorph_cube as cube;
pub use metamorph_host_link as host_link;
pub use metamorph_pairing as pairing;
pub use metamorph_planning::{assembly, manipulation, plan};
pub use metamorph_roombots as roombots;

/// Free modules: structures, the agent that walks, and the agent that changes its structure.
pub mod free_module {
    pub use metamorph_agents::free_module::*;

    /// Structures that change: the agent and its messages, and the plans.
    pub mod reconfiguration {
        pub use metamorph_agents::free_module::reconfiguration::*;
        pub use metamorph_planning::reconfiguration as planning;
    }
}

/// Metamodules: the agent, and the plans that are made for a swarm.
pub mod metamodule {
    pub use metamorph_agents::metamodule::*;

    /// The setup of a swarm and its parameters.
    pub mod params {
        pub use metamorph_agents::metamodule::blueprint::Floor;
        pub use metamorph_agents::metamodule::params::*;
        pub use metamorph_agents::metamodule::setup::Setup;
    }

    /// Searches of one metamodule, of several, and of the controller for all.
    pub mod planning {
        pub use metamorph_agents::metamodule::planning::*;
        pub use metamorph_central_planning::{assembly_order, bundles, centralized, transports};

        /// Plans one transport of an element.
        pub mod transport {
            pub use metamorph_agents::metamodule::elements::is_at_goal;
            pub use metamorph_central_planning::transport::*;
        }
    }
}
