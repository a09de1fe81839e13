//! One run: simulated, on processes, or replayed from a journal.

pub mod processes;
pub mod replay;
pub mod runnable;
pub mod simulated;
