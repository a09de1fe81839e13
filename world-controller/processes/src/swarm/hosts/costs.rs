//! Costs of links between machines, as `metamorph bench` reports them.

use serde::Serialize;

/// The costs of one way to send frames between hosts.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct NetCost {
    /// Frames of 96 bytes that arrived in a second.
    pub frames_per_s: f64,
    /// Processor time of both ends for a frame, in nanoseconds.
    pub processor_ns: f64,
    /// Median time of one way, half of there and back, in nanoseconds.
    pub one_way_ns: f64,
    /// Time of one way that 99 % of the frames do not exceed, in nanoseconds.
    pub one_way_p99_ns: f64,
    /// Time of one way that 99.9 % of the frames do not exceed, in nanoseconds.
    pub one_way_p999_ns: f64,
}

/// The results.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct NetCosts {
    /// Over the host link.
    pub host_link: NetCost,
    /// One put for each frame, with the same settings.
    pub zenoh: NetCost,
    /// How far the other clock may be off, at the end (ns).
    pub clock_error_ns: u64,
}
