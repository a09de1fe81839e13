//! The scenario of a run with the commands that operators gave to it: the same run can be made again without them.

use super::ExportError;
use metamorph_console::output::Outputs;
use metamorph_processes::record::journal::{Event, Journal, JournalFailure, plan_of};
use metamorph_scenario::commands::write;
use metamorph_scenario::family::Families;
use metamorph_sim_bridge::director::commands::{COMMAND_INPUT, Commands};
use metamorph_sim_bridge::director::faults::WorldFault;
use metamorph_text::escape::Shown;
use metamorph_text::format::many;
use std::path::Path;

/// Writes the scenario to a file, and returns what was written and the command that runs it. Commands of the program
/// that stepped a run are included; a scenario without commands stays as it was.
///
/// # Errors
/// If the journal cannot be read, or the file cannot be written.
pub fn export_commands(journal: &Path, file: &Path, families: Families) -> Result<String, ExportError> {
    let output = Outputs::new().creates("--commands", file)?;
    let journal = Journal::open(journal).map_err(JournalFailure::from)?;
    let head = journal.head().clone();
    let plan = plan_of(families, &head)?;
    let world: Vec<&WorldFault> =
        families.all.iter().flat_map(|family| family.commanded_to_world()).collect();
    let mut all = Vec::new();
    for record in journal {
        if let Event::Input { kind, bytes } = record.map_err(JournalFailure::from)?.event
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
