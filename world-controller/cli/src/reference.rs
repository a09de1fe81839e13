//! The generated reference: JSON schemas of input and output, shell completions, and man pages.

use crate::commands::command_line;
use clap::{Args, ValueEnum};
use clap_complete::Shell;
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::output::Outputs;
use metamorph_console::output_kind::OutputKind;
use metamorph_console::terminal::print_data;
use metamorph_experiments::sweep::summary::Summary;
use metamorph_free_modules::gait::document::GaitFile;
use metamorph_free_modules::plan::document::{PlanFile, StructureFile};
use metamorph_processes::family::families;
use metamorph_report::schema::Report;
use metamorph_scenario::schema as scenario;
use metamorph_text::command_error::CommandError;
use metamorph_text::command_error::Failure;
use metamorph_text::escape::Shown;
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
        schema["properties"][key] = json!({ "anyOf": [part(), { "type": "null" }] });
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
    clap_complete::generate(shell, &mut command_line(), "metamorph", &mut script);
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
    clap_mangen::generate_to(command_line(), made.path())?;
    let pages = fs::read_dir(made.path())?.map(|page| {
        let page = page?;
        Ok((dir.join(page.file_name()), fs::read(page.path())?))
    });
    pages.collect()
}

/// Examples for the help.
const SCHEMA_EXAMPLES: &str = "\
Examples:
  metamorph schema > scenario.schema.json
  metamorph schema report | jq .properties.outcome

An editor with a TOML language server checks a scenario that begins with
    #:schema scenario.schema.json";

/// Examples for the help.
const COMPLETION_EXAMPLES: &str = "\
Examples:
  metamorph completions bash > ~/.local/share/bash-completion/completions/metamorph
  metamorph completions zsh > ~/.zfunc/_metamorph
  metamorph completions fish > ~/.config/fish/completions/metamorph.fish";

/// The command `schema`.
pub static SCHEMA: CommandOf<SchemaArgs> = CommandOf {
    name: "schema",
    group: Some(Group::Machine),
    about: "Print the JSON schema of scenarios or reports",
    after_help: || SCHEMA_EXAMPLES.to_owned(),
    execute: |args, _| {
        print_data(&schema(args.of));
        Ok(0)
    },
};

/// The command `completions`.
pub static COMPLETIONS: CommandOf<CompletionArgs> = CommandOf {
    name: "completions",
    group: Some(Group::Machine),
    about: "Print a script that completes command lines in a shell",
    after_help: || COMPLETION_EXAMPLES.to_owned(),
    execute: |args, _| {
        print_data(&completions(args.shell));
        Ok(0)
    },
};

/// The command `man`.
pub static MAN: CommandOf<ManArgs> = CommandOf {
    name: "man",
    group: Some(Group::Machine),
    about: "Write man pages",
    after_help: String::new,
    execute: |args, _| write_pages(&args),
};

fn write_pages(args: &ManArgs) -> Result<u8, Failure> {
    let path = args.dir.shown();
    for (file, page) in man(args).map_err(|error| PagesError { path, error })? {
        Outputs::new().writes("man", &file, OutputKind::Manual)?.write(page)?;
    }
    Ok(0)
}
