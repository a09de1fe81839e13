//! Where a free metamodule wants to go: the published force field and the greedy policy.

pub mod force_field;
pub(crate) mod greedy_policy;
