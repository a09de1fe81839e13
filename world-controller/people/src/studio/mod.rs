//! `metamorph studio`: a person draws a structure of cubes, sees which modules it becomes and what to change if it
//! cannot, starts a swarm that builds it, and commands that swarm; or furnishes a room.
//!
//! `site` answers the page (`page/`, plain JavaScript), `analyses` keeps the drawings of pages and analyses them within a
//! `budget`; `analysis` is the answer; `desk` hands runs to the thread that carries them out; `directory` reads and
//! writes files under `--dir`; `files` opens them; `rooms` answers about rooms, `recording` writes the session log of
//! `--study`, and `start` makes scenarios. What a drawing becomes, whether a room is right, and what was done to its pieces,
//! is decided here and never on the page.
//!
//! Everything that changes something, or that tells what is in files, needs the secret of the printed address.

pub mod analyses;
pub use metamorph_shapes::analysis;
mod budget;
mod desk;
mod directory;
mod files;
mod one_at_a_time;
mod recording;
mod rooms;
mod site;
mod start;

use clap::Args;
use desk::Desk;
use directory::Directory;
use files::{Opened, open};
use metamorph_console::interrupt::Interrupt;
use metamorph_console::terminal::{self, print_out};
use metamorph_scenario::diagnostics::Diagnostics;
use metamorph_shapes::error::SolidError;
use metamorph_text::command_error::{BAD_USAGE, CommandError};
use metamorph_text::escape::Shown as _;
use metamorph_view::access::Token;
use metamorph_view::http::{ServerError, serve_site};
use recording::Recording;
use rooms::Drawings;
use site::Studio;
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use thiserror::Error;

/// The version of the format of requests.
pub const VERSION: u16 = 1;

/// The end of the command's help.
pub const EXAMPLES: &str = "\
Examples:
  metamorph studio                                       draw, and start what you have drawn
  metamorph studio deploy/shapes/chair.toml              open a drawing, a solid or a configuration
  metamorph studio --dir drawings --modules 24           keep drawings in a directory; there are 24 modules
  metamorph studio deploy/rooms/corner.toml              furnish a room, and start what builds it
  metamorph studio room.toml --study session.jsonl       record what a person does with rooms

Two addresses are printed. The first ends with a secret and permits drawing and starting runs. The second only
shows the latest run. Both work on this machine only and without a network. `?` on the page lists its keys. Ctrl-C
ends the studio, and a run that is going on.

Exit codes:
  0  the studio was open until Ctrl-C, SIGTERM or SIGHUP
  1  the program itself failed, for example because no port was free
  2  the command line or a file is wrong; the error names the place, reason and fix";

/// Arguments of `studio`.
#[derive(Debug, Args)]
pub struct StudioArgs {
    /// Drawings or rooms (.toml), solids (.stl, .obj), scenes of MagicaVoxel (.vox) or configurations of VisibleSim (.xml) to open
    #[arg(value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Read and write drawings and rooms in this directory; default: none, the browser downloads and uploads them
    #[arg(long, value_name = "DIR")]
    pub dir: Option<PathBuf>,
    /// The number of modules that there are; the page says when a drawing takes more. Default: any number
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub modules: Option<u32>,
    /// The port of the page's address, for example one that is forwarded; default: any free one
    #[arg(long, value_name = "PORT", value_parser = clap::value_parser!(u16).range(1..))]
    pub port: Option<u16>,
    /// Record in this new file what is done with rooms, on the first page that opens one; the page says that it is
    /// recorded. Default: nothing is recorded
    #[arg(long, value_name = "FILE")]
    pub study: Option<PathBuf>,
}

/// Why the studio cannot be opened.
#[derive(Debug, Error)]
pub enum StudioError {
    /// A file.
    #[error("{0}\n  fix: {fix}", fix = .0.fix())]
    File(#[from] SolidError),
    /// A drawing is too large.
    #[error("{file}: it has {cells} cells; {most} is the maximum here\n  fix: choose a coarser pitch with `metamorph shape --pitch`", most = analyses::MAX_CELLS)]
    TooLarge {
        /// The file.
        file: String,
        /// Its cells.
        cells: usize,
    },
    /// A room is wrong.
    #[error("{0}")]
    Room(Box<Diagnostics>),
    /// The directory.
    #[error("--dir {0}: {1}\n  fix: name a directory that you may read")]
    Directory(String, io::Error),
    /// The session log.
    #[error("--study {file}: {why}\n  fix: {fix}")]
    Study {
        /// The file.
        file: String,
        /// The reason.
        why: String,
        /// Suggested fix.
        fix: &'static str,
    },
    /// The page cannot be served.
    #[error(transparent)]
    Server(#[from] ServerError),
    /// There is no secret.
    #[error("no random numbers: {0}")]
    Random(#[from] io::Error),
}

impl CommandError for StudioError {
    fn exit_code(&self) -> u8 {
        match self {
            StudioError::Server(error) => error.exit_code(),
            StudioError::Random(_) => metamorph_text::command_error::FAILED,
            _ => BAD_USAGE,
        }
    }
    fn text(&self) -> String {
        match self {
            StudioError::Server(error) => error.text(),
            StudioError::Room(_) => self.to_string(),
            _ => format!("metamorph: {self}"),
        }
    }
}

/// Opens the studio until a signal asks the program to end.
pub fn studio(args: &StudioArgs, interrupt: &Interrupt) -> Result<u8, StudioError> {
    let mut given = BTreeMap::new();
    let opened: Vec<Opened> =
        args.files.iter().map(|file| open(file, &mut given)).collect::<Result<_, _>>()?;
    let directory = args
        .dir
        .as_ref()
        .map(|path| Directory::open(path).map_err(|error| StudioError::Directory(path.shown(), error)));
    let drawings = Drawings { given, directory: directory.transpose()?.map(Arc::new) };
    let (desk, secret) = (Arc::new(Desk::default()), Token::random()?);
    let recording = args.study.as_ref().map(|path| record(path)).transpose()?.map(Arc::new);
    interrupt.begin();
    let shown = recording.clone();
    let studio = Studio::new(secret.clone(), Arc::clone(&desk), drawings, opened, args.modules, shown);
    let served = serve_site(studio, args.port).map(|address| {
        print_address(&address, &secret);
        // An address that could not be printed is of no use.
        if terminal::failure().is_none() {
            desk.carry_out(interrupt);
        }
    });
    if let Some(recording) = recording {
        recording.remove_unused();
    }
    served?;
    Ok(0)
}

fn print_address(address: &str, secret: &Token) {
    print_out(&format!(
        "open {address}#c={} in a browser\nto only look at what is started, open {address}run/\nCtrl-C ends it",
        secret.text()
    ));
}

/// Creates a session log.
fn record(path: &Path) -> Result<Recording, StudioError> {
    Recording::create(path).map_err(|error| {
        let (why, fix) = match error.kind() {
            io::ErrorKind::AlreadyExists => {
                ("there is such a file already".to_owned(), "name a new file; no session is written over")
            }
            io::ErrorKind::NotFound => (
                "its directory does not exist".to_owned(),
                "create the directory, or name a file in another one",
            ),
            _ => (error.to_string(), "name a new file in a directory that exists and is yours"),
        };
        StudioError::Study { file: path.shown(), why, fix }
    })
}
