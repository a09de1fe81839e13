//! The program: from its arguments to an exit code.

use crate::commands::{command_line, execute};
use crate::log;
use metamorph_bench as bench;
use metamorph_console::command::Call;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output_kind::replace_any_file;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::{self, ColorChoice, choose_color, note, print_error};
use metamorph_processes::{family, swarm};
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED, Failure};
use metamorph_text::escape::Shown;
use metamorph_text::program;
use rustix::fs::Mode;
use rustix::process::umask;
use std::ffi::OsString;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;
use thiserror::Error;

/// The thread or the handlers for signals cannot be set up.
#[derive(Debug, Error)]
#[error("cannot listen for Ctrl-C: {0}")]
struct NoSignals(std::io::Error);

impl CommandError for NoSignals {}

/// The remains of a killed controller cannot be removed.
#[derive(Debug, Error)]
#[error("cannot remove what a killed controller left behind: {0}")]
struct NotRemoved(std::io::Error);

impl CommandError for NotRemoved {}

/// Lets files of this program be read, written and entered by their owner, whatever the umask: a directory that its owner may not
/// enter could not be removed.
fn keep_own_permissions() {
    let before = umask(Mode::RWXU | Mode::RWXG | Mode::RWXO);
    umask(before.difference(Mode::RWXU));
}

/// Executes the command given by the arguments (the first is the program's name).
pub fn main(args: impl IntoIterator<Item = OsString>) -> ExitCode {
    let since = Stopwatch::start();
    let args: Vec<OsString> = args.into_iter().collect();
    // Agents are started by the thousand: parsing the full command line costs each of them milliseconds, and
    // memory that it keeps.
    if let Some(done) = short_cut(&args) {
        return match done {
            Ok(()) => ExitCode::SUCCESS,
            Err(failure) => fail(&failure),
        };
    }
    keep_own_permissions();
    if let Some(name) = args.first().and_then(|program| Path::new(program).file_name()) {
        program::set_name(&name.to_string_lossy());
    }
    let line = match command_line().try_get_matches_from(&args) {
        Ok(line) => line,
        Err(error) => return ExitCode::from(refuse(&error, &args)),
    };
    let of_command =
        line.subcommand().and_then(|(_, own)| own.try_get_one::<ColorChoice>("color").ok().flatten());
    if let Some(choice) = of_command.or_else(|| line.get_one("color")) {
        choose_color(*choice);
    }
    if line.get_flag("force") {
        replace_any_file();
    }
    let carried_out = log::to_stderr(line.get_count("verbose"))
        .map_err(Failure::from)
        .and_then(|()| Interrupt::listen().map_err(|error| NoSignals(error).into()))
        .and_then(|interrupt| execute(&line, Call { since, interrupt: &interrupt }));
    match carried_out {
        Ok(code) => ExitCode::from(unless_out_failed(code)),
        Err(failure) => fail(&failure),
    }
}

/// Prints help or a usage error. Clap chooses the stream and the colours.
fn refuse(error: &clap::Error, args: &[OsString]) -> u8 {
    if !error.use_stderr() {
        note(error.print().and_then(|()| std::io::stdout().flush()));
        return unless_out_failed(0);
    }
    // Clap quotes the arguments, so let it report on their escaped form.
    let shown = args.iter().map(|arg| arg.to_string_lossy().shown());
    let harmless = command_line().try_get_matches_from(shown).err().filter(clap::Error::use_stderr);
    match harmless {
        // A failure here cannot be reported anywhere.
        Some(error) => drop(error.print()),
        None => print_error(&error.to_string()),
    }
    BAD_USAGE
}

/// Returns the exit code, or [`FAILED`] if standard output could not be written: then the result was not
/// seen.
fn unless_out_failed(code: u8) -> u8 {
    let Some(why) = terminal::failure() else { return code };
    print_error(&format!(
        "metamorph: standard output could not be written: {why}\n  fix: redirect it to a program or a file with room"
    ));
    FAILED
}

/// Executes one of the internal commands that this program starts itself with: an agent, the watcher of a
/// controller, or a part of a benchmark. Returns `None` for all other arguments.
fn short_cut(args: &[OsString]) -> Option<Result<(), Failure>> {
    match args {
        [_, agent, dashes, rest @ ..] if agent == "agent" && dashes == "--" => {
            Some(family::agent(rest).map_err(Failure::from))
        }
        [_, watch, root] if watch == swarm::WATCH => {
            Some(swarm::watch(Path::new(root)).map_err(|error| NotRemoved(error).into()))
        }
        [_, part, rest @ ..] if part == bench::SUBCOMMAND => Some(bench::part(rest).map_err(Failure::from)),
        _ => None,
    }
}

/// Reports a failure, and returns its exit code.
fn fail(failure: &Failure) -> ExitCode {
    print_error(&failure.text);
    ExitCode::from(failure.exit_code)
}
