//! The program that makes generated pages and the site.

use clap::{Parser, Subcommand};
use metamorph_site::{generate, notices, root};
use std::error::Error;
#[cfg(feature = "book")]
use std::path::PathBuf;

const AFTER_HELP: &str =
    if cfg!(feature = "book") { "" } else { "To build the site, run this program with `--features book`." };

/// Makes the documentation.
#[derive(Debug, Parser)]
#[command(name = "metamorph-site", after_help = AFTER_HELP)]
struct CommandLine {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Write the pages of docs/ that are made from the program, and the generated parts of other pages
    Generate,
    /// Write the licences of the crates that are in the program; cargo may download crates of links between machines
    Notices,
    /// Build the site into a directory, which is replaced
    #[cfg(feature = "book")]
    Build {
        /// The directory
        directory: PathBuf,
        /// The address of the repository's files, for links to sources; without it they are plain text
        #[arg(long, value_name = "URL")]
        repository: Option<String>,
    },
}

fn main() -> Result<(), Box<dyn Error>> {
    match CommandLine::parse().command {
        Command::Generate => generate(&root())?,
        Command::Notices => std::fs::write(root().join(notices::PATH), notices::text(&root())?)?,
        #[cfg(feature = "book")]
        Command::Build { directory, repository } => {
            metamorph_site::book::build(&root(), &std::path::absolute(directory)?, repository.as_deref())?;
        }
    }
    Ok(())
}
