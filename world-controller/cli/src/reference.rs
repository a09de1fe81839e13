//! The generated reference: JSON schemas of input and output, shell completions, and man pages.

use crate::commands::CommandLine;
use clap::{Args, CommandFactory, ValueEnum};
use clap_complete::Shell;
use metamorph_experiments::sweep::summary::Summary;
use metamorph_free_modules::gait::document::GaitFile;
use metamorph_free_modules::plan::document::{PlanFile, StructureFile};
use metamorph_processes::family::families;
use metamorph_report::schema::Report;
use metamorph_scenario::schema as scenario;
use metamorph_text::command_error::CommandError;
use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde_json::{Value, json};
use std::fs;
use std::io;
use std::path::PathBuf;
use thiserror::Error;

/// Arguments of `schema`.
#[derive(Debug, Args)]
pub struct SchemaArgs {
    /// What to describe
    #[arg(value_enum, default_value_t = Described::Scenario)]
    pub of: Described,
}

/// Documents with a schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Described {
    /// A scenario; the schema holds for TOML and JSON
    Scenario,
    /// The output of `run --json`
    Report,
    /// The summary.json of a sweep
    Summary,
    /// A plan of free modules, as `plan -o` writes it
    Plan,
    /// A structure of free modules, as `plan --from` and `structure` read it
    Structure,
    /// A gait, as `learn --write` writes it
    Gait,
}

/// Arguments of `completions`.
#[derive(Debug, Args)]
pub struct CompletionArgs {
    /// The shell
    #[arg(value_enum)]
    pub shell: Shell,
}

/// Arguments of `man`.
#[derive(Debug, Args)]
pub struct ManArgs {
    /// The directory of the pages; created if missing
    #[arg(value_name = "DIR")]
    pub dir: PathBuf,
}

/// Returns a JSON schema (draft 2020-12).
pub fn schema(of: Described) -> String {
    let schema = match of {
        Described::Scenario => scenario::schema(families()),
        Described::Report => report(),
        Described::Summary => written::<Summary>(),
        Described::Plan => written::<PlanFile>(),
        Described::Structure => written::<StructureFile>(),
        Described::Gait => written::<GaitFile>(),
    };
    serde_json::to_string_pretty(&schema).expect("invariant: a schema consists of plain values and text keys")
}

/// Returns the schema of reports, with the fields of every family.
fn report() -> Value {
    let mut schema = written::<Report>();
    for (key, part) in families().all.iter().filter_map(|family| family.report_part()) {
        schema["properties"][key] = json!({ "anyOf": [part, { "type": "null" }] });
        if let Some(required) = schema["required"].as_array_mut() {
            required.push(json!(key));
        }
    }
    schema
}

/// Returns the schema of an output: every field is required.
fn written<T: JsonSchema>() -> Value {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    settings.into_generator().into_root_schema_for::<T>().to_value()
}

/// Returns a completion script.
pub fn completions(shell: Shell) -> String {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut CommandLine::command(), "metamorph", &mut script);
    String::from_utf8_lossy(&script).into_owned()
}

/// Man pages cannot be written.
#[derive(Debug, Error)]
#[error("{path}: cannot write man pages there: {error}\n  fix: name a directory that is yours")]
pub struct PagesError {
    /// The directory.
    pub path: String,
    /// The cause.
    pub error: io::Error,
}

impl CommandError for PagesError {}

/// Returns a page for the program and one for each command, with their paths.
pub fn man(ManArgs { dir }: &ManArgs) -> io::Result<Vec<(PathBuf, Vec<u8>)>> {
    fs::create_dir_all(dir)?;
    let made = tempfile::tempdir()?;
    clap_mangen::generate_to(CommandLine::command(), made.path())?;
    let pages = fs::read_dir(made.path())?.map(|page| {
        let page = page?;
        Ok((dir.join(page.file_name()), fs::read(page.path())?))
    });
    pages.collect()
}
