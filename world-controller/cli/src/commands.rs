//! The list of all commands, and the command line that they make.

#[cfg(feature = "hosts")]
use crate::cluster;
use crate::exit_codes::{EXIT_CODES, JOURNAL_EXIT_CODES};
use crate::{
    agent, bench, check, clean, diff, doctor, explore, export, host, learn, licences, new, plan, reference,
    render, replay, reproduce, resume, robot, run, scenarios, shape, structure, sweep, view, why,
};
use clap::builder::EnumValueParser;
use clap::{Arg, ArgAction, ArgMatches};
use metamorph_console::command::{Call, Command, Group, unwrapped};
use metamorph_console::terminal::ColorChoice;
use metamorph_text::command_error::{BAD_USAGE, Failure};
use std::sync::{Mutex, PoisonError};
use thiserror::Error;

/// The commands of this crate, in the order of the help.
const BUILT_IN: &[&dyn Command] = &[
    &scenarios::COMMAND,
    &run::COMMAND,
    &view::COMMAND,
    &check::COMMAND,
    &new::COMMAND,
    &resume::COMMAND,
    &replay::COMMAND,
    &host::COMMAND,
    #[cfg(feature = "hosts")]
    &cluster::COMMAND,
    &render::COMMAND,
    &export::COMMAND,
    &shape::COMMAND,
    &sweep::COMMAND,
    &diff::COMMAND,
    &explore::COMMAND,
    &why::COMMAND,
    &reproduce::COMMAND,
    &plan::COMMAND,
    &structure::COMMAND,
    &learn::COMMAND,
    &robot::COMMAND,
    &doctor::COMMAND,
    &clean::COMMAND,
    &bench::COMMAND,
    &reference::SCHEMA,
    &reference::COMPLETIONS,
    &reference::MAN,
    &licences::COMMAND,
    &agent::COMMAND,
];

/// The commands that a newcomer needs first.
const FIRST: [&str; 6] = ["scenarios", "run", "view", "check", "new", "sweep"];

/// The examples at the end of the help of the program.
const EXAMPLES: &str = "\
Examples:
  metamorph run swarm              one process per module
  metamorph run swarm --link sim   the same in virtual time, repeatable
  metamorph check my.toml          what would run, or what is wrong
  metamorph clean                  remove what killed runs left behind

An output file appears at the end of a command, complete; it must not be another file that the command
reads or writes. A file that is there is replaced if metamorph wrote it as the same kind of file, or with --force. If standard output cannot be written, the exit code is 1; a reader that closes it early
(`| head`) is not an error.

Logs go to standard error; -v, -vv and -vvv show more, and METAMORPH_LOG takes filters such as
`metamorph_processes=debug`.";

/// Commands of other crates, and of programs that embed this one.
static INSTALLED: Mutex<Vec<&'static dyn Command>> = Mutex::new(Vec::new());

/// A command of this name exists already.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("there is a command {0} already")]
pub struct NameTaken(&'static str);

/// Adds commands to the built-in ones, after those of the same group.
///
/// # Errors
/// A command of the name of one of them exists already; the commands before it are added.
pub fn install(more: &[&'static dyn Command]) -> Result<(), NameTaken> {
    for command in more {
        if all().iter().any(|known| known.name() == command.name()) {
            return Err(NameTaken(command.name()));
        }
        INSTALLED.lock().unwrap_or_else(PoisonError::into_inner).push(*command);
    }
    Ok(())
}

/// Returns all commands, in the order of the help.
pub fn all() -> Vec<&'static dyn Command> {
    let mut all = BUILT_IN.to_vec();
    all.extend(INSTALLED.lock().unwrap_or_else(PoisonError::into_inner).iter());
    // Stable, so that the order within a group stays.
    all.sort_by_key(|command| command.group().map_or(Group::ALL.len(), |group| group as usize));
    all
}

/// Returns the command line: all commands, and the options of the program.
pub fn command_line() -> clap::Command {
    // The last of the options of every command, before its help.
    let verbose = Arg::new("verbose")
        .short('v')
        .long("verbose")
        .action(ArgAction::Count)
        .global(true)
        .display_order(998);
    let force = Arg::new("force").long("force").action(ArgAction::SetTrue).global(true).display_order(997);
    let color = Arg::new("color")
        .long("color")
        .value_name("WHEN")
        .value_parser(EnumValueParser::<ColorChoice>::new())
        .global(true)
        .display_order(996)
        .help("Colour the output: on terminals, also in files and pipes, or not at all; default: auto");
    // Figures have colours of their own; there the option is given before the command.
    let defined = all().into_iter().map(|command| {
        let own = command.define();
        let has_color = own.get_arguments().any(|argument| argument.get_long() == Some("color"));
        if has_color { own } else { own.arg(color.clone()) }
    });
    let subcommands: Vec<clap::Command> = defined.collect();
    clap::Command::new("metamorph")
        .version(metamorph_text::version::version())
        .about(
            "Runs swarms of self-reconfiguring modules: every module is a process, or all are simulated in virtual time",
        )
        .subcommand_required(true)
        .arg_required_else_help(true)
        .arg(verbose.help("Log more to standard error; repeatable"))
        .arg(color.global(false))
        .arg(force.help("Replace output files that metamorph did not write"))
        .subcommands(subcommands)
        .help_template(format!(
            "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{}Options:\n{{options}}{{after-help}}",
            groups()
        ))
        .after_help(unwrapped(EXAMPLES))
        .after_long_help(unwrapped(&format!("{EXAMPLES}\n\n{EXIT_CODES}{JOURNAL_EXIT_CODES}")))
}

/// Width of the list of commands in columns.
const WIDTH: usize = 100;

/// Lists the commands for the help: those that a newcomer needs first, then the others by groups.
fn groups() -> String {
    let all = all();
    let named = |name: &&str| all.iter().copied().find(|command| command.name() == *name);
    let first: Vec<&dyn Command> = FIRST.iter().filter_map(named).collect();
    let listed = all.iter().copied().filter(|command| command.group().is_some());
    let widest = listed.clone().map(|command| command.name().len()).max().unwrap_or(0);
    let mut text = String::new();
    let mut section = |heading: &str, commands: &[&dyn Command]| {
        text += &format!("{heading}:\n");
        for command in commands {
            text += &entry(command.name(), command.about(), widest);
        }
        text.push('\n');
    };
    section("To begin with", &first);
    for group in Group::ALL {
        let others = listed.clone().filter(|command| command.group() == Some(group));
        section(group.heading(), &others.filter(|c| !FIRST.contains(&c.name())).collect::<Vec<_>>());
    }
    text
}

/// Writes a name and a sentence beside it, which is wrapped.
fn entry(name: &str, about: &str, widest: usize) -> String {
    let indent = widest + 4;
    let mut lines = vec![String::new()];
    for word in about.split(' ') {
        let line = lines.last_mut().expect("invariant: there is a line");
        if !line.is_empty() && indent + line.chars().count() + 1 + word.chars().count() > WIDTH {
            lines.push(word.to_owned());
        } else {
            if !line.is_empty() {
                line.push(' ');
            }
            line.push_str(word);
        }
    }
    let separator = format!("\n{}", " ".repeat(indent));
    format!("  {name:widest$}  {}\n", lines.join(&separator))
}

/// Executes the command of a parsed command line, and returns the exit code.
pub fn execute(matches: &ArgMatches, call: Call<'_>) -> Result<u8, Failure> {
    let chosen = matches.subcommand().and_then(|(name, own)| {
        let command = all().into_iter().find(|command| command.name() == name)?;
        Some((command, own))
    });
    match chosen {
        Some((command, own)) => command.execute(own, call),
        None => Err(Failure { text: "metamorph: no command is named".to_owned(), exit_code: BAD_USAGE }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_is_listed_once_and_names_are_unique() {
        let help = command_line().render_help().to_string();
        for command in BUILT_IN.iter().filter(|command| command.group().is_some()) {
            let begins = format!("  {} ", command.name());
            assert_eq!(help.lines().filter(|line| line.starts_with(&begins)).count(), 1, "{begins}\n{help}");
        }
        let order: Vec<usize> =
            FIRST.iter().chain(&["replay"]).map(|name| help.find(&format!("\n  {name} ")).unwrap()).collect();
        assert!(order.is_sorted(), "{help}");
        assert_eq!(install(&[&run::COMMAND]), Err(NameTaken("run")));
    }

    #[test]
    fn a_long_sentence_is_wrapped_below_itself() {
        let long = ["word"; 30].join(" ");
        let text = entry("run", &long, 5);
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
        assert!(text.lines().skip(1).all(|line| line.starts_with("         word")), "{text}");
    }
}
