//! Searches for plans, and what is planned on the Roombots model without regard to an agent.
//!
//! [`plan`] is the search core: engines over a space, in slices, with bounded memory. [`assembly`] has free modules with
//! their shapes and bounds, and an independent checker of plans; [`manipulation`] the passive elements that metamodules
//! carry; [`reconfiguration`] the central plan of a structure of free modules. Agents use these; nothing here knows an agent.

pub mod assembly;
pub mod manipulation;
pub mod plan;
pub mod reconfiguration;
