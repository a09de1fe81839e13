//! The world-controller: reads scenarios, runs swarms, injects failures, measures, reports.
//!
//! This crate is the command `metamorph` and the library of those who embed it: it has nothing of its own, and names the
//! crates below it by what they are for. ARCHITECTURE.md draws them.
//!
//! Absent: decisions of the protocol, which are in `metamorph_protocol`, and ground truth about the world, which
//! is in `metamorph_sim_bridge`.

pub use metamorph_cli::learn;
pub use metamorph_free_modules::gait;
pub use metamorph_people::{pointing, room, studio};
pub use metamorph_processes::{control, metrics, record, swarm};

/// The command line, with the commands of all crates.
pub mod cli {
    pub use metamorph_cli::{PAIRING_SCHEMA, reference};
    use std::sync::Once;

    /// The list of all commands, and the command line that they make.
    pub mod commands {
        pub use metamorph_cli::commands::{NameTaken, all, install};

        /// The command line.
        pub struct CommandLine;

        impl clap::CommandFactory for CommandLine {
            fn command() -> clap::Command {
                super::install_all();
                metamorph_cli::commands::command_line()
            }
            fn command_for_update() -> clap::Command {
                Self::command()
            }
        }
    }

    /// The program: from its arguments to an exit code.
    pub mod dispatch {
        use std::ffi::OsString;
        use std::process::ExitCode;

        /// Executes the command given by the arguments (the first is the program's name).
        pub fn main(args: impl IntoIterator<Item = OsString>) -> ExitCode {
            super::install_all();
            metamorph_cli::dispatch::main(args)
        }
    }

    fn install_all() {
        static INSTALLED: Once = Once::new();
        INSTALLED.call_once(|| {
            let installed = metamorph_cli::commands::install(metamorph_people::COMMANDS);
            installed.expect("invariant: the names of commands differ, as a test shows");
        });
    }
}

/// The terminal, output files, signals, and how numbers and foreign text are written.
pub mod console {
    pub use metamorph_console::*;
    pub use metamorph_text::*;
}

/// Scenarios: from TOML to a checked plan.
pub mod scenario {
    pub use metamorph_scenario::*;
    pub use metamorph_shapes as mesh_import;
}

/// The report of a run.
pub mod report {
    pub use metamorph_processes::swarm::balance;
    pub use metamorph_report::*;
}

/// Families of modules, and the list of them.
pub mod family {
    pub use metamorph_families::ExploredFamily;
    pub use metamorph_processes::family::*;
}

/// One run: simulated, on processes, or replayed from a journal.
pub mod run {
    pub use metamorph_families::runnable;
    pub use metamorph_processes::run::{PageChannels, processes};

    /// Replay of journals.
    pub mod replay {
        pub use metamorph_families::worded::{self as words, Worded};
        pub use metamorph_processes::run::replay::*;
    }

    /// Simulated runs.
    pub mod simulated {
        pub use metamorph_families::simulated::*;
        pub use metamorph_processes::run::simulated::*;
    }
}

/// Body and limbs of structures, and the command `structure`.
pub mod structure {
    pub use metamorph_cli::structure::*;
    pub use metamorph_free_modules::structure::SCHEMA;
}

/// Plans of free modules, and the command `plan`.
pub mod plan {
    pub use metamorph_cli::plan::*;
    pub use metamorph_free_modules::plan::*;
}

/// The page of a run, pictures and exports.
pub mod view {
    pub use metamorph_scene::*;
    pub use metamorph_view::*;

    /// The bodies of a swarm, for pictures.
    pub mod bodies {
        pub use metamorph_families::visible::Bodies;
        pub use metamorph_scene::bodies::*;
    }

    /// Builds a scene from the records of a run.
    pub mod scene_builder {
        pub use metamorph_families::scene_builder::SceneBuilder;
        pub use metamorph_processes::record::journal::ReadError;
        pub use metamorph_scene::shared::Shared;
    }

    /// The interface between a family and pictures of its runs.
    pub mod visible {
        pub use metamorph_families::visible::Visible;
        pub use metamorph_scene::visible::*;
    }
}

/// Commands that do many runs.
pub mod experiments {
    pub use metamorph_bench::SCHEMA as BENCH_SCHEMA;
    pub use metamorph_experiments::{diff, explore, why};
    pub use metamorph_reproduce as reproduce;

    /// Sweeps.
    pub mod sweep {
        pub use metamorph_experiments::sweep::*;
        pub use metamorph_scenario::grid;
    }
}
