//! What other programs need to know of this one, made from the definitions that it works with itself:
//! JSON schemas of what it reads and writes, completions for shells, and man pages.

use crate::cli::args::CommandLine;
use crate::experiments::sweep::summary::Summary;
use crate::family::families;
use crate::report::schema::Report;
use crate::scenario::schema as scenario;
use clap::{Args, CommandFactory, ValueEnum};
use clap_complete::Shell;
use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde_json::Value;
use std::fs;
use std::io;
use std::path::PathBuf;

/// What `schema` takes.
#[derive(Debug, Args)]
pub struct SchemaArgs {
    /// The schema of what
    #[arg(value_enum, default_value_t = Described::Scenario)]
    pub of: Described,
}

/// Something with a schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Described {
    /// A scenario; TOML has the same values as JSON
    Scenario,
    /// What `run --json` writes
    Report,
    /// The summary.json of a sweep
    Summary,
}

/// What `completions` takes.
#[derive(Debug, Args)]
pub struct CompletionArgs {
    /// Which shell
    #[arg(value_enum)]
    pub shell: Shell,
}

/// What `man` takes.
#[derive(Debug, Args)]
pub struct ManArgs {
    /// Where the pages go; it is made if it is not there
    #[arg(value_name = "DIR")]
    pub dir: PathBuf,
}

/// A JSON schema (draft 2020-12).
pub fn schema(of: Described) -> String {
    let schema = match of {
        Described::Scenario => scenario::schema(families()),
        Described::Report => written::<Report>(),
        Described::Summary => written::<Summary>(),
    };
    serde_json::to_string_pretty(&schema).expect("invariant: a schema is made of plain values and text keys")
}

/// The schema of something that is written: no field is ever left out.
fn written<T: JsonSchema>() -> Value {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    settings.into_generator().into_root_schema_for::<T>().to_value()
}

/// A script that completes command lines.
pub fn completions(shell: Shell) -> String {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut CommandLine::command(), "metamorph", &mut script);
    String::from_utf8_lossy(&script).into_owned()
}

/// A page for the program and one for each command, and the files that they go to.
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
