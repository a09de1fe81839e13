//! What belongs to one family of units only.

pub mod metamodule;
