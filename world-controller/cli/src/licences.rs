//! The command `licences`: the licences of the program and of its parts by others.

use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::terminal::print_data;

const OURS: &str = "Metamorph is licensed under MIT or Apache 2.0, at your option.";
const MIT: &str = include_str!("../LICENSE-MIT");
const APACHE: &str = include_str!("../LICENSE-APACHE");
/// The notices of parts by others, as `metamorph-site notices` writes them.
const THIRD_PARTY: &str = include_str!("../third-party.txt");

/// Arguments of `licences`.
#[derive(Debug, Args)]
pub struct LicencesArgs {}

/// The command `licences`.
pub static COMMAND: CommandOf<LicencesArgs> = CommandOf {
    name: "licences",
    group: Some(Group::Machine),
    about: "Print the licences of the program and of its parts by others",
    after_help: String::new,
    execute: |_, _| {
        print_data(&text());
        Ok(0)
    },
};

fn text() -> String {
    let rule = "=".repeat(80);
    format!("{OURS}\n\n{rule}\n\n{MIT}\n{rule}\n\n{APACHE}\n{rule}\n\n{THIRD_PARTY}")
}
