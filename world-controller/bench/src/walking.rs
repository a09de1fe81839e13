//! How freely modules walk: the share of the walkers that move, attempts for each move, and denials by reason.
//!
//! Together they tell a swarm that lacks targets from one whose walkers block each other.

use metamorph_protocol::coverage::{self, CoveragePoint};
use metamorph_protocol::cube::Cube;
use metamorph_protocol::cube::message::Role;
use serde::Serialize;
use std::collections::BTreeMap;

/// Reasons for denials, and the points at which they are counted.
const DENIALS: [(&str, CoveragePoint); 6] = [
    ("occupied", CoveragePoint::CubeDeniedOccupied),
    ("reserved", CoveragePoint::CubeDeniedReserved),
    ("busy", CoveragePoint::CubeDeniedBusy),
    ("younger", CoveragePoint::CubeDeniedYounger),
    ("unsupported", CoveragePoint::CubeDeniedNoSupport),
    ("restarted", CoveragePoint::CubeDeniedQuarantined),
];

/// How freely the modules of a run walk.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Walking {
    /// The share of the walkers that move, over all instants looked at.
    pub moving: f64,
    /// Moves asked for, for each move completed.
    pub attempts_per_move: f64,
    /// Requests denied, by reason.
    pub denials: BTreeMap<String, u64>,
}

impl Walking {
    /// Returns the share of the denials with a reason.
    pub fn denied_for(&self, reason: &str) -> f64 {
        let all: u64 = self.denials.values().sum();
        self.denials.get(reason).copied().unwrap_or(0) as f64 / all.max(1) as f64
    }
}

/// Walkers counted at instants of a run.
#[derive(Clone, Copy, Debug, Default)]
pub struct WalkingCounts {
    walkers: u64,
    moving: u64,
}

impl WalkingCounts {
    /// Counts the walkers of this instant.
    pub fn look_at<'a>(&mut self, cubes: impl Iterator<Item = &'a Cube>) {
        for cube in cubes.filter(|cube| cube.role() == Role::Walker) {
            self.walkers += 1;
            self.moving += u64::from(cube.is_moving());
        }
    }

    /// Returns the figures of a run that ends now, of which this thread has counted attempts and denials.
    pub fn walking(&self, moves: u64) -> Walking {
        Walking {
            moving: self.moving as f64 / self.walkers.max(1) as f64,
            attempts_per_move: coverage::count(CoveragePoint::CubeAsked) as f64 / moves.max(1) as f64,
            denials: DENIALS.map(|(name, point)| (name.to_owned(), coverage::count(point))).into(),
        }
    }
}
