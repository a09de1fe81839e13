//! The program that makes generated pages and the site.

use clap::{Parser, Subcommand};
use mdbook_driver::errors::Result;
use metamorph_site::{book, generate, root};
use std::path::PathBuf;

/// Makes the documentation.
#[derive(Debug, Parser)]
#[command(name = "metamorph-site")]
struct CommandLine {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Write the pages of docs/ that are made from the program
    Generate,
    /// Build the site into a directory, which is replaced
    Build {
        /// The directory
        directory: PathBuf,
        /// The address of the repository's files, for links to sources; without it they are plain text
        #[arg(long, value_name = "URL")]
        repository: Option<String>,
    },
}

fn main() -> Result<()> {
    match CommandLine::parse().command {
        Command::Generate => Ok(generate(&root().join("docs"))?),
        Command::Build { directory, repository } => {
            book::build(&root(), &std::path::absolute(directory)?, repository.as_deref())
        }
    }
}
