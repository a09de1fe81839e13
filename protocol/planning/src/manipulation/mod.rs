//! Passive elements: what metamodules carry, hand over and place (thesis chapter 5).
//!
//! An [`element::Element`] is a rigid set of cells with ports. A metamodule holds it by a port with its head plate,
//! in one of a few [`element::Grip`]s. Whether it can move with it is a table of the postures and single steps
//! ([`carry`]) and of the load on its joints ([`load`]); which pairs of postures pass an element on is the table
//! of [`handover`]. [`colour`] shows what no posture of the lattice can do, [`off_lattice`] how it is done between the
//! lattice postures, and [`torque_walk`] repeats the torque
//! experiment of thesis 5.1.4.
//!
//! A [`terrain`] with everything that metamodules of one kind can do on it is a [`scene`]. The planner of [`transport`]
//! searches it first without the bodies of metamodules that stand still, and [`verification`] carries out what was
//! found with all bodies. [`resting`] has the places where it puts the element down on the way. [`walking`] moves a
//! metamodule without an element among obstacles.
//!
//! A [`structure`] of metamodules and elements is planned by taking it apart.
//!
//! Lengths are in cells, masses in grams, torques in µNm. Floats are used to build tables only: [`contact`] and
//! [`load`] compute with exact bodies and levers, and everything they give is an integer.

pub mod carry;
pub mod colour;
pub mod contact;
pub mod element;
pub mod handover;
pub mod load;
pub mod off_lattice;
pub mod rest;
pub mod resting;
pub mod scene;
pub mod structure;
pub mod task;
pub mod terrain;
pub mod torque_walk;
pub mod transport;
pub mod verification;
pub mod walking;
pub mod worlds;
