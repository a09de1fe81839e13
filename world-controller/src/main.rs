//! The command `metamorph`.

use clap::{Parser, Subcommand};
use metamorph_world_controller::robot::{self, RobotArgs};
use std::io::Write;
use std::process::ExitCode;

#[derive(Parser)]
#[command(name = "metamorph", version, about = "Swarms of self-reconfiguring modular robots")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Robot(RobotArgs),
}

fn main() -> ExitCode {
    let Command::Robot(args) = Cli::parse().command;
    match robot::run(args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "metamorph: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}
