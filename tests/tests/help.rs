//! The command line describes itself: the help states every default, completions and man pages have every command.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use clap::CommandFactory;
use metamorph_tests::command::{names_default, run};
use metamorph_world_controller::cli::commands::CommandLine;
use std::fs;

/// The help states the default of every option with a value, unless the option only adds something: a file, a
/// fault.
#[test]
fn the_help_states_every_default() {
    let adds = [
        "FILE",
        "FILE|-",
        "DIR",
        "KEY=VALUE",
        "KEY=V1,V2,..",
        "KIND=VALUE@EVENTS",
        "ID@T",
        "ID@T..T",
        "ID,..@T..T",
    ];
    let line = CommandLine::command();
    let mut seen = 0;
    for command in line.get_subcommands().filter(|c| !c.is_hide_set()) {
        for option in command.get_opts().filter(|o| !o.is_required_set() && o.get_action().takes_values()) {
            let names: Vec<&str> =
                option.get_value_names().unwrap_or_default().iter().map(|n| n.as_str()).collect();
            let help = option.get_help().map(ToString::to_string).unwrap_or_default();
            let says_it = !option.get_default_values().is_empty() || names_default(&help);
            assert!(
                says_it || adds.contains(&names[0]),
                "{} --{}: {help}",
                command.get_name(),
                option.get_id()
            );
            seen += usize::from(says_it);
        }
    }
    assert!(seen > 15, "only {seen} options state a default");
    // The stated default is the one in use.
    let printed = run(&["run", "--help"]).out;
    for part in ["the scenario's, or 1", "the scenario's, or 0%", "the scenario's, or 20"] {
        assert!(
            printed.replace("\n", " ").split_whitespace().collect::<Vec<_>>().join(" ").contains(part),
            "{part}: {printed}"
        );
    }
}

#[test]
fn completions_and_man_pages_have_every_command() {
    let line = CommandLine::command();
    let commands: Vec<&str> =
        line.get_subcommands().filter(|c| !c.is_hide_set()).map(|c| c.get_name()).collect();
    assert!(commands.len() > 5);
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let ran = run(&["completions", shell]);
        assert_eq!(ran.code, Some(0), "{ran:?}");
        for command in &commands {
            assert!(ran.out.contains(command), "{shell} does not complete {command}");
        }
    }
    let directory = tempfile::tempdir().unwrap();
    let pages = directory.path().join("man/man1");
    let ran = run(&["man", pages.to_str().unwrap()]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    for command in &commands {
        let page = fs::read_to_string(pages.join(format!("metamorph-{command}.1"))).unwrap();
        assert!(page.contains(".TH") && page.to_lowercase().contains(command), "{command}");
    }
    let file = directory.path().join("file");
    fs::write(&file, "").unwrap();
    let refused = run(&["man", file.to_str().unwrap()]);
    assert!(refused.code == Some(1) && refused.err.contains("fix: "), "{refused:?}");
}
