//! The scenario of a run with the commands that operators gave to it: the same run can be made again without them.

use super::ExportError;
use crate::console::escape::Shown;
use crate::console::format::many;
use crate::console::output::Outputs;
use crate::record::journal::{Event, Journal, JournalError, plan_of};
use crate::scenario::commands::write;
use crate::scenario::family::Families;
use metamorph_sim_bridge::director::commands::{COMMAND_INPUT, Commands};
use metamorph_sim_bridge::director::faults::WorldFault;
use std::path::Path;

/// Writes the scenario to a file, and returns what was written and the command that runs it. Commands of the program
/// that stepped a run are included; a scenario without commands stays as it was.
///
/// # Errors
/// If the journal cannot be read, or the file cannot be written.
pub fn export_commands(journal: &Path, file: &Path, families: Families) -> Result<String, ExportError> {
    let output = Outputs::new().creates("--commands", file)?;
    let journal = Journal::open(journal)?;
    let head = journal.head().clone();
    let plan = plan_of(families, &head)?;
    let world: Vec<&WorldFault> = families.0.iter().flat_map(|family| family.commanded_to_world()).collect();
    let mut all = Vec::new();
    for record in journal {
        if let Event::Input { kind, bytes } = record.map_err(JournalError::from)?.event
            && kind == COMMAND_INPUT
        {
            let commands = Commands::parse(&String::from_utf8_lossy(&bytes), &world);
            all.push(commands.map_err(ExportError::Commands)?);
        }
    }
    let text = head.scenario.trim_end();
    output.write(format!("{text}\n{}", write(&all)))?;
    let given = many(all.iter().map(|commands| commands.faults.len() as u64).sum(), "command");
    let repeat = plan.repeat_as(file.display().to_string());
    Ok(format!("{}: the scenario with {given}\nto run it: {repeat}\n", file.shown()))
}
