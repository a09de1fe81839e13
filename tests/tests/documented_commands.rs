//! The commands that the documentation shows: each is run, in the order of its page, or is an exception with a reason.
//!
//! Blocks marked `console` have prompts, exit codes (`? N`, if not 0) and outputs, where `...` stands for any lines and
//! `[..]` for any text. Blocks marked `sh` are lines to be pasted into a shell, which must succeed. Each page has a
//! directory of its own, in which `deploy` is that of the repository.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use clap::CommandFactory;
use metamorph_tests::command::{Ran, metamorph, root};
use metamorph_world_controller::cli::commands::CommandLine;
use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The longest time of one command, in seconds.
const WATCHDOG: &str = "180";

/// Beginnings of commands that are not run, and why. Those of `metamorph` must still have valid arguments.
const EXCEPTIONS: [(&str, &str); 26] = [
    ("cargo install", "needs a release build; deploy/package.sh tries the program elsewhere"),
    ("podman", "needs a container engine; deploy/package.sh starts the image by buildah"),
    ("cargo test", "runs all tests, of which this is one"),
    (".ci/run", "runs all tests, of which this is one"),
    (
        "cargo build --release -p metamorph-tutorial",
        "needs a release build; the tests of deploy/tutorial run the program",
    ),
    ("metamorph-election", "a program of its own; the tests of deploy/tutorial run it"),
    ("git clone", "needs the network"),
    ("pip install", "builds the Python package; deploy/python/test installs it"),
    ("metamorph run swarm --view", "serves until it is interrupted; tests/tests/commands.rs runs it"),
    (
        "metamorph export swarm.journal --commands",
        "needs the journal of such a run; tests/tests/commands.rs runs it",
    ),
    ("metamorph run session.toml", "needs that export; tests/tests/commands.rs runs it"),
    ("metamorph view", "serves until it is interrupted; tests/tests/view_server.rs runs it"),
    ("metamorph studio", "serves until it is interrupted; tests/tests/studio.rs starts it"),
    ("metamorph check my.toml", "a file of the reader"),
    ("metamorph diff results others", "sweeps of the reader"),
    ("metamorph diff forest cycles   ", "sweeps of the reader"),
    ("metamorph diff forest cycles --at-least 5% --json diff.json", "sweeps of the reader"),
    ("metamorph diff a.json b.json", "reports of the reader"),
    ("metamorph render run.journal --at 12s --camera", "a journal of the reader"),
    ("metamorph resume", "needs a controller that was killed; tests/tests/resume.rs kills one"),
    ("metamorph sweep swarm --seeds 0..1000", "runs for minutes in a debug build"),
    ("metamorph sweep swarm --seeds 0..1000", "runs for minutes in a debug build"),
    ("metamorph reproduce", "runs for minutes in a debug build"),
    ("metamorph explore --seconds 60", "runs for a minute"),
    ("metamorph render slab-to-sphere", "runs for long in a debug build; tests/tests/render.rs draws it"),
    (
        "metamorph doctor --modules 1058",
        "fails where the machine is too small; tests/tests/daily_use.rs runs it",
    ),
];

/// A command of a page.
#[derive(Debug)]
struct Shown {
    /// The line of the page that it begins in.
    line: usize,
    command: String,
    /// What a `console` block says: the exit code, and the lines of the output.
    says: Option<(i32, Vec<String>)>,
}

/// Returns the commands of a page.
fn commands(text: &str) -> Vec<Shown> {
    let mut commands = Vec::new();
    let mut lines = text.lines().enumerate();
    while let Some((_, opening)) = lines.next() {
        let indent = opening.len() - opening.trim_start().len();
        let is_console = opening.trim() == "```console";
        if !is_console && opening.trim() != "```sh" {
            continue;
        }
        let block = lines.by_ref().take_while(|(_, line)| line.trim() != "```");
        let block: Vec<(usize, &str)> =
            block.map(|(at, line)| (at + 1, line.get(indent..).unwrap_or_default())).collect();
        commands.extend(if is_console { prompts(&block) } else { pasted(&block) });
    }
    commands
}

/// Returns the commands of a block with prompts.
fn prompts(block: &[(usize, &str)]) -> Vec<Shown> {
    let mut commands: Vec<Shown> = Vec::new();
    for (line, text) in block {
        if let Some(command) = text.strip_prefix("$ ") {
            commands.push(Shown { line: *line, command: command.to_owned(), says: Some((0, Vec::new())) });
            continue;
        }
        let shown =
            commands.last_mut().unwrap_or_else(|| panic!("line {line}: a block begins with a prompt"));
        let says = shown.says.as_mut().unwrap();
        match text.strip_prefix("? ").and_then(|code| code.parse().ok()) {
            Some(code) if says.1.is_empty() => says.0 = code,
            _ if says.1.is_empty() && shown.command.ends_with('\\') => {
                shown.command.push('\n');
                shown.command.push_str(text);
            }
            _ => says.1.push((*text).to_owned()),
        }
    }
    commands
}

/// Returns the commands of a block without prompts: a line each, with the lines that continue it.
fn pasted(block: &[(usize, &str)]) -> Vec<Shown> {
    let mut commands: Vec<Shown> = Vec::new();
    let mut until: Option<&str> = None;
    for (line, text) in block {
        let continues = commands.last().is_some_and(|shown| shown.command.ends_with('\\'));
        match commands.last_mut().filter(|_| continues || until.is_some()) {
            Some(shown) => {
                shown.command.push('\n');
                shown.command.push_str(text);
            }
            None if text.trim().is_empty() => continue,
            None => commands.push(Shown { line: *line, command: (*text).to_owned(), says: None }),
        }
        match until {
            Some(end) if *text == end => until = None,
            Some(_) => {}
            None => until = text.split_once("<<").map(|(_, word)| word.trim()),
        }
    }
    commands
}

/// Returns true if a text is what is said, where `[..]` stands for any text.
fn line_fits(said: &str, text: &str) -> bool {
    let Some((before, rest)) = said.split_once("[..]") else { return said == text };
    let Some(text) = text.strip_prefix(before) else { return false };
    (0..=text.len()).any(|at| text.is_char_boundary(at) && line_fits(rest, &text[at..]))
}

/// Returns true if an output is what is said, where `...` stands for any lines.
fn fits(said: &[String], output: &[&str]) -> bool {
    match said.split_first() {
        None => output.is_empty(),
        Some((first, rest)) if first == "..." => {
            (0..=output.len()).any(|skipped| fits(rest, &output[skipped..]))
        }
        Some((first, rest)) => {
            output.split_first().is_some_and(|(line, below)| line_fits(first, line) && fits(rest, below))
        }
    }
}

/// Asserts that the arguments of a command of `metamorph` are valid.
fn can_be_parsed(place: &str, command: &str) {
    let words = command.split([' ', '\n']).filter(|word| !word.is_empty() && *word != "\\");
    let words = words.take_while(|word| !word.starts_with('#') && !word.starts_with(['|', '>']));
    if let Err(error) = CommandLine::command().try_get_matches_from(words.map(|word| word.trim_matches('\'')))
    {
        panic!("{place}: {error}");
    }
}

/// A directory for the commands of a page, and a `PATH` in which `cargo run --release --` is the debug build.
struct Workplace {
    directory: tempfile::TempDir,
    programs: tempfile::TempDir,
}

impl Workplace {
    fn new() -> Workplace {
        let (directory, programs) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        symlink(root().join("deploy"), directory.path().join("deploy")).unwrap();
        symlink(metamorph(), programs.path().join("metamorph")).unwrap();
        let cargo = programs.path().join("cargo");
        fs::write(
            &cargo,
            "#!/bin/sh\n[ \"$1 $2 $3\" = \"run --release --\" ] || exit 90\nshift 3\nexec metamorph \"$@\"\n",
        )
        .unwrap();
        fs::set_permissions(&cargo, fs::Permissions::from_mode(0o755)).unwrap();
        Workplace { directory, programs }
    }

    fn run(&self, command: &str) -> Ran {
        let path =
            format!("{}:{}", self.programs.path().display(), std::env::var("PATH").unwrap_or_default());
        let mut shell = Command::new("timeout");
        shell.args(["--signal=TERM", WATCHDOG, "sh", "-c", command]).env("PATH", path);
        shell.env_remove("METAMORPH_LOG").env("NO_COLOR", "1").stdin(Stdio::null());
        shell.current_dir(self.directory.path()).output().unwrap().into()
    }
}

/// Runs the commands of a page, notes the exceptions that it needed, and returns what is not as it is said.
fn wrong(page: &Path, used: &mut BTreeSet<&'static str>) -> Vec<String> {
    let workplace = Workplace::new();
    let mut wrong = Vec::new();
    for Shown { line, command, says } in commands(&fs::read_to_string(root().join(page)).unwrap()) {
        let place = format!("{}:{line}: {command}", page.display());
        if let Some((beginning, _)) = EXCEPTIONS.iter().find(|(beginning, _)| command.starts_with(beginning))
        {
            used.insert(beginning);
            if command.starts_with("metamorph ") {
                can_be_parsed(&place, &command);
            }
            continue;
        }
        let ran = workplace.run(&command);
        let (code, said) = says.map_or((0, None), |(code, said)| (code, Some(said)));
        let all = format!("{}{}", ran.out, ran.err);
        let output: Vec<&str> = all.lines().map(str::trim_end).collect();
        if ran.code != Some(code) || said.is_some_and(|said| !fits(&said, &output)) {
            wrong.push(format!("{place}: exit code {:?}\n{all}", ran.code));
        }
    }
    wrong
}

fn markdown_below(directory: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(root().join(directory)).unwrap() {
        let path = directory.join(entry.unwrap().file_name());
        if root().join(&path).is_dir() {
            markdown_below(&path, found);
        } else if path.extension().is_some_and(|end| end == "md") {
            found.push(path);
        }
    }
}

#[test]
fn documented_commands_do_what_is_said() {
    let mut pages = vec![PathBuf::from("README.md"), PathBuf::from("CONTRIBUTING.md")];
    for directory in ["docs", "deploy/tutorial", "deploy/python", "deploy/shapes"] {
        markdown_below(Path::new(directory), &mut pages);
    }
    // Its commands are those of the test of names of scenarios.
    pages.retain(|page| {
        page != Path::new("docs/gallery.md") && !page.components().any(|part| part.as_os_str() == ".venv")
    });
    pages.sort();
    assert!(pages.len() > 20, "{pages:?}");
    let mut used = BTreeSet::new();
    let wrong: Vec<String> = pages.iter().flat_map(|page| wrong(page, &mut used)).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let unused: Vec<&str> = EXCEPTIONS
        .iter()
        .map(|(beginning, _)| *beginning)
        .filter(|beginning| !used.contains(beginning))
        .collect();
    assert!(unused.is_empty(), "exceptions that no page needs: {unused:?}");
}

#[test]
fn outputs_are_compared() {
    let said = |lines: &[&str]| lines.iter().map(|line| (*line).to_owned()).collect::<Vec<_>>();
    assert!(fits(&said(&["a", "...", "d[..]!"]), &["a", "b", "c", "do!"]));
    assert!(fits(&said(&["..."]), &[]) && fits(&[], &[]));
    assert!(!fits(&[], &["a"]) && !fits(&said(&["a", "b"]), &["a"]) && !fits(&said(&["d[..]!"]), &["do"]));
    let page = "x\n   ```console\n   $ a \\\n     b\n   ? 3\n   out\n   ```\n```sh\nc <<EOF\n d\nEOF\n\ne # f\n```\n";
    let found = commands(page);
    let first = (found[0].line, found[0].command.as_str(), &found[0].says);
    assert_eq!(first, (3, "a \\\n  b", &Some((3, vec!["out".to_owned()]))));
    let others: Vec<&str> = found[1..].iter().map(|shown| shown.command.as_str()).collect();
    assert_eq!(others, ["c <<EOF\n d\nEOF", "e # f"]);
}
