//! Runs on the operating system: swarms of processes on one host or several, journals, resumption, replay, and simulated
//! runs that are recorded and commanded.
//!
//! `control` carries commands into a run, `metrics` numbers out of it; `swarm` starts, supervises and ends processes and has the controller's loop;
//! `record` reads and writes journals; `run` carries out one run, as processes, from a journal or simulated; `family` adds to
//! families what needs processes, and has the list of them.

pub mod control;
pub mod family;
pub mod metrics;
pub mod record;
pub mod run;
pub mod swarm;
