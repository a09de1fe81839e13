//! Structures by name: those of the thesis, and a few others.
//!
//! Figure 7.3 of the thesis does not say by which connectors its structures are joined; these are our choice. They have
//! the published numbers of parameters.

use super::structure::{Connection, Structure};
use metamorph_core::ids::ModuleId;
use metamorph_roombots::connector::Connector::{self, C0X, C0Y, C3X, C3Y};

/// The names.
pub const NAMES: [&str; 5] = ["quad5-sym", "quad5-unsym", "struct10", "quad9", "tripod4"];

/// Returns the structure of a name.
pub fn structure(name: &str) -> Option<Structure> {
    let (modules, connections) = match name {
        // A module with four limbs of one module each; in the second one of them is turned (thesis 7.6).
        "quad5-sym" => (5, limbs(&QUAD)),
        "quad5-unsym" => (5, with_rotation(limbs(&QUAD), 3, 1)),
        // A ring of four modules with limbs of two, two, one and one (thesis 7.6).
        "struct10" => (10, struct10()),
        // The quadruped of figure 7.2: limbs of two modules.
        "quad9" => {
            let feet = (1..5).map(|limb| join(limb, C3X, limb + 4, 0));
            (9, limbs(&QUAD).into_iter().chain(feet).collect())
        }
        "tripod4" => (4, limbs(&QUAD[..3])),
        _ => return None,
    };
    Structure::new(modules, &connections).ok()
}

/// The connectors of the limbs of a quadruped: a flat pinwheel.
const QUAD: [Connector; 4] = [C0X, C0Y, C3X, C3Y];

fn join(a: u32, at: Connector, b: u32, rotation: u8) -> Connection {
    Connection { a: ModuleId(a), at, b: ModuleId(b), to: C0X, rotation }
}

/// Joins modules 1, 2, ... to these connectors of module 0.
fn limbs(at: &[Connector]) -> Vec<Connection> {
    (1..).zip(at).map(|(limb, at)| join(0, *at, limb, 0)).collect()
}

fn with_rotation(mut connections: Vec<Connection>, at: usize, rotation: u8) -> Vec<Connection> {
    connections[at].rotation = rotation;
    connections
}

fn struct10() -> Vec<Connection> {
    let ring = (0..4).map(|m| join(m, C3X, (m + 1) % 4, 0));
    let limbs =
        [(0, C0Y, 4, 0), (4, C3X, 5, 0), (1, C0Y, 6, 1), (6, C3X, 7, 2), (2, C0Y, 8, 3), (3, C3Y, 9, 0)];
    ring.chain(limbs.map(|(a, at, b, rotation)| join(a, at, b, rotation))).collect()
}
