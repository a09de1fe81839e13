//! The world-controller: reads scenarios, runs swarms, injects failures, measures, reports.
//!
//! `scenario` makes a checked plan of what a person wrote; a driver runs it (`simulated` in virtual
//! time, `processes` and `swarm` with one process per module); `report` says what happened; `journal`
//! reads what a run has written down, `replay` carries it out again, `export` makes a recording for other
//! viewers of it; `sweep` runs one scenario many times, `reproduce` the thesis's experiments, `bench`
//! measures what the links cost, `explore` runs what is drawn. `solid` makes shapes of files; `robot`
//! answers questions about the Roombots model, from the
//! `database` that metamodules move by; `runnable` is what drivers and reports need of each family of
//! units. `command` is the command line, `commands` carries it out, `terminal` prints what it has to
//! say (`gauge` while a run is under way) and `shown` makes what came from outside fit to be printed; files
//! are written by `output`; `reference` tells other programs about all of it.
//!
//! Deliberately absent: decisions of the protocol (they are in `protocol`) and ground truth about
//! the world (it is in `sim-bridge`).

pub mod balance;
mod bench;
pub mod command;
pub mod commands;
pub mod database;
pub mod explore;
pub mod export;
pub mod gauge;
pub mod interrupt;
pub mod journal;
pub mod output;
pub mod overview;
pub mod processes;
pub mod reference;
pub mod replay;
pub mod report;
pub mod reproduce;
pub mod robot;
pub mod runnable;
pub mod scenario;
pub mod shown;
pub mod simulated;
pub mod solid;
pub mod stopwatch;
pub mod swarm;
pub mod sweep;
pub mod terminal;
pub mod view;
pub mod wording;
