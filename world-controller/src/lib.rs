//! The world-controller: reads scenarios, runs swarms, injects failures, measures, reports.
//!
//! From the bottom up, and each module uses only those before it: `console` writes to the terminal and
//! to files; `scenario` makes a checked plan of a scenario file; `control` has the way of commands into a
//! run; `swarm` runs one process per module;
//! `report` says what a run did; `record` reads and writes journals; `view` makes the page and
//! recordings for other viewers; `run` carries out one run, simulated, on processes or from a journal;
//! `family` holds what belongs to one family of modules, and the list of them; `plan` plans for free modules;
//! `gait` has gait files and learners; `room` has rooms of furniture; `structure` analyses their body and limbs;
//! `experiments` carries out many runs; `learn` learns gaits; `pointing` finds the tile that a
//! person points at; `studio` has the editor of drawings; `cli` is the command line.
//!
//! Absent: decisions of the protocol, which are in `protocol`, and ground truth about the world, which
//! is in `sim-bridge`.

pub mod cli;
pub mod console;
pub mod control;
pub mod experiments;
pub mod family;
pub mod gait;
pub mod learn;
pub mod plan;
pub mod pointing;
pub mod record;
pub mod report;
pub mod room;
pub mod run;
pub mod scenario;
pub mod structure;
pub mod studio;
pub mod swarm;
pub mod view;
