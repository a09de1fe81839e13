//! Free Roombots modules: configurations, their canonical form, actions, shapes and bounds.
//!
//! Geometry, joints and bodies are those of [`roombots`](metamorph_roombots). A configuration says where every module is,
//! its joint values and which connectors hold (thesis 3.1); a shape leaves joint values out (report 3.2).
//! [`space::Assembly`] is what the engines of [`plan`](crate::plan) search.

pub mod action;
pub mod canonical;
pub mod checker;
pub mod collision;
pub mod configuration;
pub mod ground;
#[cfg(test)]
mod ground_tests;
pub mod kept_edges;
pub mod named;
pub mod order;
pub mod recognise;
pub mod report2009;
pub mod shape;
pub mod shape_distance;
pub mod shape_graph;
pub mod similarity;
pub mod space;
pub mod standing;
pub mod structure;
pub mod tables;
#[cfg(test)]
mod tests;
pub mod world;
