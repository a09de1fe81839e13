//! Gaits of free modules: gait files, the parameters of networks, learners, and trials.
//!
//! `ask_tell` has the learners, `space` the parameters of a network, `study` trials and their fitness, `document` the format
//! of gait files and `file` their reading, `tuner` the choice of gaits while a structure walks, and `elites` which of a repertoire
//! to try next.

pub mod ask_tell;
mod bayes;
mod cma;
pub mod document;
pub mod elites;
pub mod file;
mod gaussian_process;
mod pso;
mod repertoire;
pub mod space;
pub mod study;
pub mod tuner;
