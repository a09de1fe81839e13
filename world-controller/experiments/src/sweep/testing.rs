//! Results of runs for tests.

use super::row::Row;
use metamorph_sim_bridge::director::outcome::Outcome;

/// Returns the row of a built run whose numbers are all different.
pub fn row(seed: u64) -> Row {
    Row {
        seed,
        outcome: Outcome::Built,
        reason: String::new(),
        filled: 21,
        cells: 22,
        moves: 23,
        turns: Some(24),
        standstills: 6,
        rescued: 7,
        called: 26,
        led: 25,
        collisions_prevented: 1,
        collisions_refused: 2,
        collisions_suffered: 3,
        sent_gradient: 10,
        sent_seed: 20,
        sent_connectivity: 30,
        sent_negotiation: 40,
        sent_world: 50,
        sent_liveness: 60,
        sent_gait: 70,
        latency_p50_s: Some(0.02),
        latency_p99_s: Some(0.05),
        makespan_s: Some(1.25),
        end_s: 0.1 + 0.2,
        faults_struck: 4,
        violations: 5,
        trace_hash: "0012345678901234".into(),
        state_hash: "0043210987654321".into(),
    }
}
