//! Searches over poses of metamodules: the graph of turns, distances and routes of one body, and
//! cooperative searches for several.

pub mod cooperative;
pub mod distances;
pub(crate) mod enclosure;
pub mod graph;
pub(crate) mod lru_cache;
pub mod nearby;
pub mod paths;
pub(crate) mod posture_set;
pub(crate) mod random_walk;
pub(crate) mod state_space;

pub use enclosure::is_away;
