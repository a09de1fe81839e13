//! The reference: every command as its `--help` says it, and every document with a schema.

use crate::schema_page;
use clap::{Command, CommandFactory, ValueEnum};
use metamorph_world_controller::cli::commands::CommandLine;
use metamorph_world_controller::cli::reference::{Described, schema};

/// Columns of help texts.
const COLUMNS: usize = 100;

/// Returns the commands that are not hidden with their whole names, in the order of the help, each after the
/// command that it belongs to.
pub fn each() -> Vec<(String, Command)> {
    let mut root = CommandLine::command().term_width(COLUMNS);
    root.build();
    let mut found = Vec::new();
    collect("", root, &mut found);
    found
}

fn collect(before: &str, command: Command, found: &mut Vec<(String, Command)>) {
    let name = format!("{before} {}", command.get_name()).trim().to_owned();
    let below: Vec<Command> = command
        .get_subcommands()
        .filter(|command| !command.is_hide_set() && command.get_name() != "help")
        .cloned()
        .collect();
    found.push((name.clone(), command));
    for command in below {
        collect(&name, command.term_width(COLUMNS), found);
    }
}

/// Returns what `--help` prints.
pub fn help(command: &mut Command) -> String {
    let text = command.render_long_help().to_string();
    text.lines().map(str::trim_end).collect::<Vec<_>>().join("\n")
}

/// Returns the page of the commands.
pub fn commands() -> String {
    let mut page = "# Commands\n\nWhat `--help` of each command prints.\n".to_owned();
    for (name, mut command) in each() {
        page.push_str(&format!("\n## {name}\n\n```text\n{}\n```\n", help(&mut command).trim_end()));
    }
    page
}

/// Returns a page for each document with a schema.
pub fn documents() -> Vec<(String, String)> {
    let page = |of: &Described| {
        let value = of.to_possible_value().expect("invariant: no document is skipped");
        let name = value.get_name();
        let about = value.get_help().map(ToString::to_string).unwrap_or_default();
        let schema = serde_json::from_str(&schema(*of)).expect("invariant: a schema is JSON");
        (format!("reference/{name}.md"), schema_page::page(name, &about, &schema))
    };
    Described::value_variants().iter().map(page).collect()
}
