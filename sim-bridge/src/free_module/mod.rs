//! Free modules off the grid: a world of fixed connections, and the director that hands out a gait.

pub mod director;
pub mod structure_world;
#[cfg(test)]
mod tests;
