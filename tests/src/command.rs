//! The command `metamorph` as a user runs it, and the scenarios that ship with it.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use crate::chaos::signal_to;
use metamorph_world_controller::report::schema::Report;
use rustix::process::Signal;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::{OnceLock, mpsc};
use std::time::{Duration, SystemTime};

/// Returns the root of the workspace.
pub fn root() -> PathBuf {
    // Invariant: this crate lives one level below the root.
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().map(Path::to_owned).unwrap_or_default()
}

/// Returns the path of a scenario that ships with the program.
pub fn scenario(name: &str) -> PathBuf {
    root().join("deploy/scenarios").join(name)
}

/// Returns all scenarios that ship with the program, in the order of their names.
pub fn scenarios() -> Vec<PathBuf> {
    let entries = fs::read_dir(root().join("deploy/scenarios")).expect("the scenarios are there");
    let mut paths: Vec<PathBuf> = entries
        .map(|entry| entry.expect("the directory can be read").path())
        .filter(|path| path.extension().is_some_and(|e| e == "toml"))
        .collect();
    paths.sort();
    paths
}

/// Returns the binary `metamorph` of the profile that these tests are built in.
pub fn metamorph() -> &'static Path {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    BINARY.get_or_init(|| binary("metamorph"))
}

/// Returns the binary `module-agent` of the profile that these tests are built in.
pub fn module_agent() -> &'static Path {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    BINARY.get_or_init(|| binary("module-agent"))
}

/// Returns a binary, and builds it if it is missing or older than a library: `cargo test` builds the binaries of
/// packages with integration tests only.
fn binary(name: &str) -> PathBuf {
    let test = std::env::current_exe().expect("a running test has an executable");
    let deps = test.parent().expect("test executables are in target/<profile>/deps");
    let profile = deps.parent().expect("test executables are in target/<profile>/deps");
    let binary = profile.join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    if modified(&binary) < newest_library(deps) || !binary.exists() {
        let mut build = Command::new(env!("CARGO"));
        // With a test of the workspace beside it, the features are those of the tests, and no library is built twice.
        build.args(["build", "--quiet", "--workspace", "--bin", name, "--test", "suite"]);
        if let Some(features) = std::env::var_os("METAMORPH_TEST_FEATURES") {
            build.arg("--features").arg(features);
        }
        build.arg("--target-dir").arg(profile.parent().unwrap_or(profile));
        if profile.ends_with("release") {
            build.arg("--release");
        }
        let built = build.current_dir(root()).status().expect("cargo can be started");
        assert!(built.success(), "the binary {name} does not build");
    }
    binary
}

fn modified(path: &Path) -> Option<SystemTime> {
    fs::metadata(path).and_then(|m| m.modified()).ok()
}

fn newest_library(deps: &Path) -> Option<SystemTime> {
    // Libraries of other crates, such as these tests, may be built after the binaries.
    let parts = ["protocol", "sim_bridge", "module_agent", "world_controller"];
    let is_ours = |path: &Path| {
        let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
        let part = name.strip_prefix("libmetamorph_").and_then(|name| name.rsplit_once('-'));
        name.ends_with(".rlib") && part.is_some_and(|(part, _)| parts.contains(&part))
    };
    let entries = fs::read_dir(deps).ok()?;
    entries.filter_map(Result::ok).map(|e| e.path()).filter(|p| is_ours(p)).filter_map(|p| modified(&p)).max()
}

/// The output and exit code of a command.
#[derive(Debug)]
pub struct Ran {
    /// The exit code; `None` if a signal ended it.
    pub code: Option<i32>,
    /// The standard output.
    pub out: String,
    /// The standard error.
    pub err: String,
}

impl From<Output> for Ran {
    fn from(output: Output) -> Ran {
        Ran {
            code: output.status.code(),
            out: String::from_utf8_lossy(&output.stdout).into_owned(),
            err: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

/// Returns a command with these arguments, without a terminal, at the root of the workspace.
pub fn command(args: &[&str]) -> Command {
    let mut command = Command::new(metamorph());
    command.args(args).stdin(Stdio::null()).current_dir(root());
    command.env_remove("METAMORPH_LOG").env_remove("NO_COLOR");
    command
}

/// Runs `metamorph` with these arguments to its end.
pub fn run(args: &[&str]) -> Ran {
    command(args).output().expect("metamorph can be started").into()
}

/// The longest run of processes in a test. One that takes longer is asked to end, so that it removes its
/// files.
const WATCHDOG: Duration = Duration::from_secs(240);

/// Runs `metamorph` with these arguments, which start processes, to its end.
pub fn run_processes(args: &[&str]) -> Ran {
    let child = command(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let child = child.expect("metamorph can be started");
    let pid = child.id() as i32;
    let (sender, ended) = mpsc::channel();
    std::thread::spawn(move || sender.send(child.wait_with_output()));
    let Ok(output) = ended.recv_timeout(WATCHDOG) else {
        signal_to(pid, Signal::TERM);
        panic!("{args:?} was not over in time");
    };
    output.expect("a child can be waited for").into()
}

/// Runs a command on a scenario with this text; `{}` in the arguments is its path.
pub fn on(text: &str, args: &[&str]) -> Ran {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("scenario.toml");
    fs::write(&path, text).unwrap();
    let path = path.display().to_string();
    let args: Vec<&str> = args.iter().map(|a| if *a == "{}" { path.as_str() } else { a }).collect();
    run(&args)
}

/// Asserts that a command is refused, with these parts in the error.
pub fn refused(text: &str, args: &[&str], parts: &[&str]) {
    let ran = on(text, args);
    assert_eq!(ran.code, Some(2), "{args:?}: {ran:?}");
    assert!(ran.out.is_empty(), "{ran:?}");
    for part in parts.iter().chain(&["fix: "]) {
        assert!(ran.err.contains(part), "`{part}` is missing in: {}", ran.err);
    }
    assert!(!ran.err.contains("panicked"), "{}", ran.err);
}

/// Parses a report.
pub fn report(text: &str) -> Report {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

/// Returns the notes of a report that no slow machine explains: ends of processes without an order, and frames from outside.
pub fn surprises(report: &Report) -> Vec<&str> {
    let notes = report.notes.iter().map(String::as_str);
    notes.filter(|note| note.contains("without an order") || note.contains("from outside")).collect()
}

/// Returns true if the text says what happens without the key or option.
pub fn names_default(text: &str) -> bool {
    let text = text.to_lowercase();
    text.contains("default") || text.contains("left out")
}
