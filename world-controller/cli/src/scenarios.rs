//! The command `scenarios`: the scenarios that ship with the program.

use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::terminal::{Channel, print_data};
use metamorph_processes::family::read_file;
use metamorph_scenario::{LinkKind, Overrides, shipped};
use metamorph_text::command_error::{BAD_USAGE, Failure};
use metamorph_text::escape::json;
use metamorph_text::format::count;
use metamorph_text::table::Table;
use serde::Serialize;
use std::path::Path;

/// Arguments of `scenarios`.
#[derive(Debug, Args)]
pub struct ScenariosArgs {
    /// Print a JSON array instead of a table
    #[arg(long)]
    pub json: bool,
}

/// A scenario in the list.
#[derive(Debug, Serialize)]
struct Entry {
    name: &'static str,
    family: &'static str,
    modules: usize,
    description: String,
}

/// Lists the scenarios.
pub fn scenarios(args: &ScenariosArgs) -> Result<u8, Failure> {
    let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
    let entry = |name: &'static str| {
        let plan = read_file(Path::new(name), &overrides)
            .map_err(|diagnostics| Failure { text: diagnostics.to_string(), exit_code: BAD_USAGE })?;
        let description = plan.description.as_deref().unwrap_or_default().trim().to_owned();
        Ok(Entry { name, family: plan.swarm.family(), modules: plan.swarm.len(), description })
    };
    let entries: Vec<Entry> = shipped::names().map(entry).collect::<Result<_, Failure>>()?;
    if args.json {
        print_data(&(json(&entries) + "\n"));
        return Ok(0);
    }
    let channel = Channel::Out;
    let mut table = Table::new(&["name", "family", "modules", "description"]);
    for Entry { name, family, modules, description } in &entries {
        let modules = format!("{:>7}", count(*modules as u64));
        table
            .whole_row(&[(*name).to_owned(), (*family).to_owned(), modules, description.clone()], Vec::new());
    }
    channel.say(&table.text(channel.paint()));
    Ok(0)
}

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph scenarios
  metamorph scenarios --json | jq -r '.[].name'
  metamorph run swarm
  metamorph check rabbit

Every command that takes a scenario also takes a name of this list. A file of the same name, or of the
name with .toml, wins over it.";

/// The command.
pub static COMMAND: CommandOf<ScenariosArgs> = CommandOf {
    name: "scenarios",
    group: Some(Group::Run),
    about: "List the scenarios that ship with the program",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, _| scenarios(&args),
};
