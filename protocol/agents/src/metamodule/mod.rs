//! The metamodule's protocol: the thesis's experiment (4.1.3) as a sans-IO agent.
//!
//! A metamodule is two Roombots modules with two ends that can grip. It stands on one connector of the floor,
//! knows its absolute position, hears others within [`params::Params::communication_range`], and learns from the
//! world-controller (or from its neighbours) which seeds are open. It chooses a motion, asks the neighbours in
//! range for a lock on all cells of the motion, turns its joints step by step, grips with the free end, detaches with
//! the other, tells its new pose, and starts again. On an open seed's connector it takes the seed's shape and stays.
//!
//! An agent is made of parts, each with a state of its own. `agent` holds them together, with `inputs` for
//! messages, contacts and orders, `execution` for asking and moving, `queries` for audits and viewers:
//!
//! * `neighbour_table` — the neighbours in range, the dead, obstacles;
//! * `locks` — what has been granted, and what is asked for, with leases;
//! * `phase`, `plan` — what the metamodule does now, and one motion;
//! * `strategy` — what to do next, with the state of the strategy;
//! * `steering` — what an operator commands instead;
//! * `detector` — finding out that no metamodule can continue;
//! * `outbox` — telling neighbours and the world-controller;
//! * `view` — what the parts read: the module itself and the parts above, at the time of the step.
//!
//! *Safety.* A metamodule has a lock only if every neighbour in range that may move has granted it, and none waits
//! for a lock while it holds another. A grant ends by itself, later than the lease of the holder, and the body does
//! not begin an action after its deadline. The body's own interlock protects it even if all of that fails.
//!
//! *Progress* is not promised by the strategies of the thesis: the force field has local minima, and
//! that is what the experiment measures. `negotiated` has no field; what it promises is in
//! `docs/negotiated.md`. Deliberately absent: gripping other metamodules; walls.
//!
//! *Elements.* `elements` has the passive elements of a swarm. Under `planned` metamodules carry them, by single steps
//! that are locked like all motions (see `docs/manipulation.md`).

mod agent;
pub mod blueprint;
mod commands;
mod detector;
mod digest;
pub mod elements;
mod execution;
mod inputs;
mod locks;
pub mod message;
pub mod motions;
mod neighbour_table;
mod outbox;
pub mod params;
mod phase;
pub mod plan;
pub mod planning;
pub mod pose;
mod queries;
pub mod setup;
pub mod start;
pub mod steering;
pub mod strategy;
pub mod tuning;
mod view;

pub use agent::Metamodule;
