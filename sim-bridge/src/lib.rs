//! The simulated world and the simulated network.
pub mod chronicle;
pub mod cube_audit;
pub mod cube_world;
pub mod diagnosis;
pub mod direct;
pub mod director;
pub mod faults;
pub mod grid;
pub mod injector;
pub mod invariants;
pub mod metamodule_audit;
pub mod metamodule_director;
pub mod metamodule_world;
pub mod outcome;
pub mod sim;
pub mod trace;
pub mod world;
