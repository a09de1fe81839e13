//! The Roombots module and metamodule: exact kinematics, collision, torque and the motion database.
//!
//! Lengths are in cells of 0.11 m, angles in radians unless a name says degrees, frames right-handed.
//! The *foot frame* has its origin in the centre of the plate by which the robot is attached and +z
//! pointing into the robot; the foot cube is the cell (0, 0, 0) and is centred at (0, 0, ½).
//!
//! Two models are kept side by side and tied together by tests: a continuous one (product of
//! exponentials, [`chain`]) and an integer one for the angles of the lattice ([`lattice_pose`],
//! [`posture`]). Everything the motion database stores is an integer.
//!
//! Absent: dynamics, friction, motor control and any file. Citations "thesis" are to S. Bonardi, EPFL
//! thesis, 2014; "report" is J. Lotfi, EPFL report, 2009.

pub mod body;
pub mod chain;
pub mod collision;
pub mod connection;
pub mod connector;
pub mod convex;
pub mod database;
pub mod error;
pub mod grid;
pub mod inverse;
pub mod kind;
pub mod lattice_pose;
pub mod posture;
pub mod reach;
pub mod shape;
pub mod spheres;
pub mod sweep;
pub mod torque;

pub use error::KinematicsError;
pub use kind::Kind;

/// Edge length of a cell in metres: the smaller dimension of a module (thesis table 2.1).
pub const CELL_METRES: f64 = 0.11;
/// Mass of a module in kilograms (thesis table 2.1).
pub const MODULE_MASS: f64 = 1.4;
/// Mass of one of the four hemispheres of a module in kilograms.
pub const HEMISPHERE_MASS: f64 = MODULE_MASS / 4.0;
/// Radius of the sphere around a cube, in cells: 63.98 mm (thesis 5.1.4 gives a diameter of 0.128 m).
pub const OUTER_RADIUS: f64 = 63.98 / 110.0;
/// Distance from the centre of a cube to its plates, in cells.
pub const HALF_EDGE: f64 = 0.5;
