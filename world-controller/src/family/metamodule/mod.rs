//! Roombots metamodules: the motion database and the `robot` command.

pub mod robot;
