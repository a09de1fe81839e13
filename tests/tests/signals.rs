//! SIGINT, SIGTERM and SIGHUP at any moment of any command: each ends it with a message and a documented exit
//! code, and nothing is left behind: no process, no shared memory, no temporary file, no torn journal.
//!
//! The only delays are those before a signal is sent, which are what is tested.

use metamorph_module_agent::run_dir::identity::Identity;
use metamorph_tests::chaos::wait_until;
use metamorph_tests::command::{Ran, command, metamorph, module_agent, run, scenario};
use metamorph_world_controller::record::journal::Journal;
use metamorph_world_controller::swarm::RunDir;
use rustix::process::{Pid, Signal, kill_process};
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Stdio};
use std::sync::Mutex;
use std::time::Duration;
use tempfile::TempDir;

/// Delays before the signal, in milliseconds.
const MOMENTS: [u64; 11] = [0, 1, 2, 5, 10, 20, 30, 50, 100, 200, 500];
/// Delay of the second signal of a pair, in milliseconds.
const SECOND: u64 = 15;
/// The largest number of runs of processes in a command until it is interrupted.
const RUNS: u64 = 4;
/// The number of commands that are tested at the same time.
const TOGETHER: usize = 4;
/// The exit code of the program after a signal.
const ABORTED: i32 = 7;

/// One command, and its end without a signal.
struct Case {
    name: &'static str,
    args: Vec<String>,
    /// The exit codes of the command itself: if it is over before the signal, or if the signal is its usual
    /// end.
    usual: &'static [i32],
    /// Files that may be there afterwards.
    outputs: &'static [&'static str],
}

impl Case {
    fn new(name: &'static str, dir: &Path, line: &str) -> Case {
        let word = |word: &str| match word.split_once(':') {
            Some(("scenario", name)) => scenario(name).display().to_string(),
            Some(("dir", name)) => dir.join(name).display().to_string(),
            _ => word.to_owned(),
        };
        Case { name, args: line.split_whitespace().map(word).collect(), usual: &[], outputs: &[] }
    }
}

fn cases(dir: &Path, journal: &Path) -> Vec<Case> {
    let journal = journal.display();
    let case = |name, line: &str| Case::new(name, dir, line);
    let of_run = &["journal", "report.json", "report.html"];
    let swarm = "run scenario:swarm.toml --time-scale 1 --journal dir:journal --json dir:report.json";
    let sim = "run scenario:slab-to-sphere.toml --link sim --journal dir:journal --html dir:report.html";
    vec![
        Case { outputs: of_run, ..case("run", swarm) },
        Case { outputs: of_run, ..case("run --view", &format!("{swarm} --view")) },
        Case { outputs: of_run, ..case("run --link sim", sim) },
        Case {
            outputs: &["out"],
            ..case("sweep", "sweep scenario:chair.toml --seeds 0..100000 --out dir:out")
        },
        case("explore", "explore --seconds 600 --out dir:"),
        Case { outputs: &["out"], ..case("reproduce", "reproduce 4.1 --seeds 5000 --out dir:out") },
        Case { outputs: &["b.json"], ..case("bench flood", "bench flood --json dir:b.json") },
        Case { outputs: &["b.json"], ..case("bench wire", "bench wire --json dir:b.json") },
        Case { outputs: &["b.json"], ..case("bench swarm", "bench swarm --most 100 --json dir:b.json") },
        Case { usual: &[0], ..case("replay", &format!("replay {journal}")) },
        Case { usual: &[0], ..case("view", &format!("view {journal}")) },
        Case { usual: &[0], ..case("view of a scenario", "view scenario:slab-to-sphere.toml") },
        Case {
            usual: &[0],
            outputs: &["x.mcap"],
            ..case("export", &format!("export {journal} --mcap dir:x.mcap"))
        },
        Case { usual: &[0], ..case("check", "check scenario:slab-to-sphere.toml") },
    ]
}

/// The signals of a test.
#[derive(Clone, Copy, Debug)]
enum Sent {
    Once(Signal),
    Twice(Signal),
}

impl Sent {
    fn signal(self) -> Signal {
        match self {
            Sent::Once(signal) | Sent::Twice(signal) => signal,
        }
    }
}

fn name(signal: Signal) -> &'static str {
    match signal {
        Signal::INT => "SIGINT",
        Signal::TERM => "SIGTERM",
        Signal::HUP => "SIGHUP",
        _ => panic!("not one of the table"),
    }
}

fn send(child: &Child, signal: Signal) {
    // It may be over, but its number is reserved until it is waited for.
    let _ = kill_process(Pid::from_child(child), signal);
}

/// Returns true if a process has a handler for a signal. One that is over has none.
fn is_caught(child: &Child, signal: Signal) -> bool {
    is_in("SigCgt:", &child.id().to_string(), signal)
}

/// Returns true if a set of signals of a process, in proc(5), has this one.
fn is_in(set: &str, process: &str, signal: Signal) -> bool {
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let mask = status.lines().find_map(|l| l.strip_prefix(set)).unwrap_or("0");
    u64::from_str_radix(mask.trim(), 16).is_ok_and(|mask| mask >> (signal.as_raw() - 1) & 1 == 1)
}

/// Returns true if a process has a thread of this name. One that is over has none.
fn has_thread(child: &Child, name: &str) -> bool {
    let threads = fs::read_dir(format!("/proc/{}/task", child.id())).into_iter().flatten().flatten();
    threads.filter_map(|t| fs::read_to_string(t.path().join("comm")).ok()).any(|comm| comm.trim() == name)
}

/// Returns the signal; SIGTERM if these tests ignore it (`nohup cargo test`, `cargo test &` in a script), since the commands
/// that they start do so, too, until they listen or for ever.
fn heeded(signal: Signal) -> Signal {
    if is_in("SigIgn:", "self", signal) { Signal::TERM } else { signal }
}

fn pause(milliseconds: u64) {
    std::thread::park_timeout(Duration::from_millis(milliseconds));
}

fn start(case: &Case) -> Child {
    let args: Vec<&str> = case.args.iter().map(String::as_str).collect();
    let child = command(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    child.expect("metamorph can be started")
}

/// Returns all remains of the runs of a process: shared memory, and processes that know its name.
fn left_of(controller: Identity) -> Vec<String> {
    let names: Vec<String> = (0..RUNS).map(|n| RunDir::name_of(controller, n).to_string()).collect();
    let is_of = |text: &str| names.iter().any(|name| text.contains(name.as_str()));
    let shared = fs::read_dir("/dev/shm").expect("it can be listed").flatten();
    let mut left: Vec<String> =
        shared.map(|e| e.path().display().to_string()).filter(|path| is_of(path)).collect();
    for entry in fs::read_dir("/proc").expect("it can be listed").flatten() {
        let line = fs::read(entry.path().join("cmdline")).unwrap_or_default();
        let line = String::from_utf8_lossy(&line).replace('\0', " ");
        if is_of(&line) {
            left.push(format!("process {}: {line}", entry.file_name().display()));
        }
    }
    left
}

fn check(case: &Case, dir: &Path, sent: Sent, moment: u64) -> Result<(), String> {
    let mut child = start(case);
    let identity = Identity::of(child.id() as i32).ok().flatten().expect("it is not waited for yet");
    pause(moment);
    let signal = sent.signal();
    let caught = is_caught(&child, signal);
    if caught {
        // What arrives while handlers are installed may be lost (signal-hook then calls the handler before, which is none).
        wait_until("it to listen", || {
            has_thread(&child, "signals") || child.try_wait().is_ok_and(|s| s.is_some())
        });
    }
    send(&child, signal);
    if let Sent::Twice(signal) = sent {
        pause(SECOND);
        send(&child, signal);
    }
    let mut status = None;
    wait_until(case.name, || {
        status = child.try_wait().expect("a child can be waited for");
        status.is_some()
    });
    let status = status.expect("it was just there");
    let left = left_of(identity);
    let ran: Ran = child.wait_with_output().expect("a child can be waited for").into();
    let said = ran.err.contains(&format!("metamorph: {}:", name(signal)))
        || ran.err.contains(&format!("metamorph: ended by {}", name(signal)));
    let over = ran.code.is_some_and(|code| case.usual.contains(&code));
    let fine = match ran.code {
        Some(ABORTED) => said,
        Some(_) => over,
        // The process had not reached `main`.
        None => !caught && status.signal() == Some(signal.as_raw()) && ran.err.is_empty(),
    };
    let mut troubles = Vec::new();
    if !fine {
        troubles.push(format!("ended by {status}, caught: {caught}"));
    }
    if !left.is_empty() {
        troubles.push(format!("left {} things, such as {}", left.len(), left[0]));
    }
    for entry in fs::read_dir(dir).expect("it can be listed").flatten() {
        let file = entry.file_name().to_string_lossy().into_owned();
        if !case.outputs.contains(&file.as_str()) {
            troubles.push(format!("left the file {file}"));
        }
    }
    troubles.extend(torn(&dir.join("journal")));
    if troubles.is_empty() { Ok(()) } else { Err(format!("{}; {ran:?}", troubles.join("; "))) }
}

/// Returns the errors of a journal, if there is one.
fn torn(journal: &Path) -> Vec<String> {
    if fs::metadata(journal).map_or(0, |found| found.len()) == 0 {
        return Vec::new();
    }
    match Journal::open(journal) {
        Err(e) => vec![format!("the journal cannot be read: {e}")],
        Ok(mut journal) => {
            journal.by_ref().for_each(drop);
            journal.troubles()
        }
    }
}

/// Records a journal to replay, view and export.
fn a_journal(dir: &TempDir) -> std::path::PathBuf {
    let path = dir.path().join("of-a-run");
    let (file, journal) = (scenario("swarm.toml").display().to_string(), path.display().to_string());
    assert_eq!(run(&["run", &file, "--link", "sim", "--journal", &journal, "-q"]).code, Some(0));
    path
}

/// Runs each command of the table, each with its signals and moments, in directories of their own.
fn check_all(wanted: impl Fn(&str) -> bool, table: &[(Sent, u64)]) {
    module_agent();
    let shelf = tempfile::tempdir().expect("a directory");
    let journal = a_journal(&shelf);
    let names: Vec<&str> = cases(shelf.path(), &journal).iter().map(|c| c.name).collect();
    let mut work = Vec::new();
    for (i, name) in names.iter().enumerate().filter(|(_, name)| wanted(name)) {
        work.extend(table.iter().map(|(sent, moment)| (i, *name, *sent, *moment)));
    }
    let (work, failed) = (Mutex::new(work), Mutex::new(Vec::new()));
    let next = || work.lock().expect("no thread panics with it").pop();
    let labour = || {
        while let Some((i, name, sent, moment)) = next() {
            let dir = tempfile::tempdir().expect("a directory");
            let case = &cases(dir.path(), &journal)[i];
            if let Err(what) = check(case, dir.path(), sent, moment) {
                let mut failed = failed.lock().expect("no thread panics with it");
                failed.push(format!("{name}, {sent:?} after {moment} ms: {what}"));
            }
        }
    };
    std::thread::scope(|scope| (0..TOGETHER).for_each(|_| drop(scope.spawn(labour))));
    let failed = failed.into_inner().expect("no thread panics with it");
    assert!(failed.is_empty(), "{} failed:\n{}", failed.len(), failed.join("\n\n"));
}

#[test]
fn a_run_of_processes_ends_cleanly_at_any_moment() {
    let [interrupt, hang_up] = [Signal::INT, Signal::HUP].map(heeded);
    let kinds =
        [Sent::Once(interrupt), Sent::Once(Signal::TERM), Sent::Once(hang_up), Sent::Twice(interrupt)];
    let table: Vec<_> = MOMENTS.iter().flat_map(|m| kinds.map(|kind| (kind, *m))).collect();
    check_all(|name| name == "run", &table);
}

#[test]
fn every_command_ends_cleanly_at_any_moment() {
    let kinds = [Sent::Once(heeded(Signal::INT)), Sent::Once(heeded(Signal::HUP)), Sent::Twice(Signal::TERM)];
    let table: Vec<_> = MOMENTS.into_iter().enumerate().map(|(i, m)| (kinds[i % kinds.len()], m)).collect();
    check_all(|name| name != "run", &table);
}

/// A second Ctrl-C does not wait for agents that do not respond.
#[test]
fn a_second_signal_does_not_wait_for_stopped_agents() {
    module_agent();
    let dir = tempfile::tempdir().expect("a directory");
    let case = Case::new("run", dir.path(), "run scenario:swarm.toml --time-scale 1 --pause 5@0s..500s -q");
    let child = start(&case);
    let identity = Identity::of(child.id() as i32).ok().flatten().expect("it is not waited for yet");
    let root = RunDir::name_of(identity, 0).root();
    let mut stopped = None;
    wait_until("module 5 to be stopped", || {
        stopped = metamorph_tests::chaos::agent_of(&root, 5, 0);
        stopped.is_some_and(|agent| agent.is_stopped())
    });
    send(&child, Signal::INT);
    send(&child, Signal::TERM);
    let ran: Ran = child.wait_with_output().expect("a child can be waited for").into();
    assert_eq!(ran.code, Some(ABORTED), "{ran:?}");
    assert!(ran.err.contains("again: ending at once"), "{ran:?}");
    assert_eq!(left_of(identity), Vec::<String>::new());
}

/// `nohup` starts programs with SIGHUP ignored, which stays so.
#[test]
fn an_ignored_hangup_stays_ignored() {
    let shell = "trap '' HUP; exec \"$0\" explore --seconds 600 -q";
    let child = std::process::Command::new("sh")
        .args(["-c".as_ref(), shell.as_ref(), metamorph().as_os_str()])
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .expect("a shell can be started");
    wait_until("it to listen", || is_caught(&child, Signal::TERM));
    assert!(!is_caught(&child, Signal::HUP));
    send(&child, Signal::HUP);
    send(&child, Signal::TERM);
    let ran: Ran = child.wait_with_output().expect("a child can be waited for").into();
    assert_eq!(ran.code, Some(ABORTED), "{ran:?}");
    assert!(ran.err.contains("SIGTERM") && !ran.err.contains("SIGHUP"), "{ran:?}");
}

/// A parent that blocks signals hands that down to its children, which would not be ended by them.
#[test]
fn blocked_signals_are_unblocked() {
    let (program, file) = (metamorph(), scenario("swarm.toml"));
    module_agent();
    for signal in [Signal::TERM, Signal::INT, Signal::HUP].map(heeded) {
        let mut command = std::process::Command::new("env");
        command.arg("--block-signal=TERM,INT,HUP").arg(program).arg("run").arg(&file);
        command.args(["--time-scale", "1", "-q"]).stdout(Stdio::null()).stderr(Stdio::piped());
        let child = command.spawn().expect("env can be started");
        let identity = Identity::of(child.id() as i32).ok().flatten().expect("it is not waited for yet");
        wait_until("it to listen", || has_thread(&child, "signals"));
        send(&child, signal);
        let ran: Ran = child.wait_with_output().expect("a child can be waited for").into();
        assert_eq!(ran.code, Some(ABORTED), "{signal:?}: {ran:?}");
        assert!(ran.err.contains(name(signal)), "{ran:?}");
        assert_eq!(left_of(identity), Vec::<String>::new());
    }
}

/// The files of a killed controller are removed by a watching process, whatever the signal.
#[test]
fn a_killed_controller_leaves_nothing() {
    for (signal, why) in [(Signal::KILL, "was killed"), (Signal::BUS, "died of SIGBUS: shared memory")] {
        module_agent();
        let dir = tempfile::tempdir().expect("a directory");
        let case = Case::new("run", dir.path(), "run scenario:swarm.toml --time-scale 1 -q");
        let child = start(&case);
        let identity = Identity::of(child.id() as i32).ok().flatten().expect("it is not waited for yet");
        let root = RunDir::name_of(identity, 0).root();
        wait_until("the last module", || metamorph_tests::chaos::agent_of(&root, 41, 0).is_some());
        send(&child, signal);
        // The watcher has the same standard error.
        let output = child.wait_with_output().expect("a child can be waited for");
        let ran: Ran = output.into();
        assert_eq!(ran.code, (signal == Signal::BUS).then_some(1), "{ran:?}");
        assert!(ran.err.contains(why) && ran.err.contains("is removed"), "{ran:?}");
        wait_until("nothing to be left", || left_of(identity).is_empty());
    }
}
