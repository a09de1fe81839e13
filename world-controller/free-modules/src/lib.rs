//! Free modules as data: structure files, plans and their check, gait files, learners, analyses of structures.
//!
//! `plan` reads and writes structures and plans, drives planners, checks plans and compares structures; `gait` has gait files,
//! learners and trials; `structure` analyses body, limbs and networks. Nothing here asks the operating system: files come
//! from a [`Sources`](metamorph_text::sources::Sources), and searches are driven in slices by their caller.

pub mod gait;
pub mod plan;
pub mod structure;
