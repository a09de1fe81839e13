//! Faults in reports: signals to processes from outside a run, and partitions, as the faults that a scenario
//! plans; in JSON, in the text, on the page and in the journal.

use metamorph_module_agent::run_dir::counter_file::CounterFile;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_tests::chaos::{agent_of, root_of, signal_to, wait_until};
use metamorph_tests::command::{Ran, command, module_agent, run, scenario};
use metamorph_world_controller::family::replay;
use metamorph_world_controller::run::replay::Request;
use rustix::process::Signal;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

/// A run of processes with a journal and a page, slow enough for interventions.
struct Run {
    child: Option<Child>,
    directory: tempfile::TempDir,
    root: PathBuf,
}

impl Run {
    fn start() -> Run {
        let directory = tempfile::tempdir().expect("a directory");
        let file = scenario("swarm.toml").display().to_string();
        let [journal, page] =
            ["journal", "page.html"].map(|n| directory.path().join(n).display().to_string());
        let args =
            ["run", &file, "--time-scale", "10", "--json", "-", "--journal", &journal, "--html", &page];
        module_agent();
        let child = command(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        let mut run = Run { child: Some(child.expect("metamorph starts")), directory, root: PathBuf::new() };
        let pid = run.child.as_ref().expect("it was just started").id() as i32;
        wait_until("the run to have a directory", || {
            run.root = root_of(pid).unwrap_or_default();
            run.root.is_dir()
        });
        run
    }

    /// Sends a signal to a module that takes part in the run.
    fn signal(&self, id: u32, signal: Signal) {
        wait_until("the module to take part", || {
            let counters = CounterFile::read(&self.root, ModuleId(id), Incarnation(0)).ok().flatten();
            counters.is_some_and(|counters| counters.tally.total().delivered > 0)
        });
        signal_to(agent_of(&self.root, id, 0).expect("it has written its identity").pid, signal);
    }

    /// Waits until the controller's part of the journal holds a text.
    fn until_noted(&self, text: &str) {
        let part = self.directory.path().join("journal.parts").join("controller");
        wait_until(text, || {
            let bytes = fs::read(&part).unwrap_or_default();
            bytes.windows(text.len()).any(|window| window == text.as_bytes())
        });
    }

    fn end(&mut self) -> Ran {
        let child = self.child.take().expect("it has not been waited for");
        child.wait_with_output().expect("a child can be waited for").into()
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            signal_to(child.id() as i32, Signal::TERM);
            let _ = child.wait();
        }
    }
}

fn report(ran: &Ran) -> Value {
    serde_json::from_str(&ran.out).unwrap_or_else(|e| panic!("{e}: {ran:?}"))
}

/// Returns module and effect of the faults of one kind, in order.
fn faults(report: &Value, kind: &str) -> Vec<(Option<u64>, String)> {
    let all = report["faults"].as_array().expect("a list of faults");
    let times: Vec<f64> = all.iter().filter_map(|f| f["at_s"].as_f64()).collect();
    assert!(times.is_sorted() && times.len() == all.len(), "{all:?}");
    let of_kind = all.iter().filter(|f| f["fault"] == kind);
    of_kind.map(|f| (f["module"].as_u64(), f["effect"].as_str().expect("a text").to_owned())).collect()
}

fn replays(journal: &Path) {
    let request = Request { file: journal.to_owned(), until: None, agent: None };
    let (_, replayed) = replay(&request).expect("the journal can be read");
    assert_eq!((replayed.difference, replayed.troubles), (None, Vec::new()));
}

#[test]
fn signals_from_outside_are_faults() {
    let mut run = Run::start();
    run.signal(30, Signal::STOP);
    run.until_noted("stopped by SIGSTOP from outside");
    run.signal(30, Signal::CONT);
    run.until_noted("continued by SIGCONT from outside");
    run.signal(35, Signal::KILL);
    run.until_noted("killed by SIGKILL from outside");
    let ran = run.end();
    let report = report(&ran);
    let external = faults(&report, "external");
    let modules: Vec<Option<u64>> = external.iter().map(|f| f.0).collect();
    assert_eq!(modules, [Some(30), Some(30), Some(35)], "{report}");
    let begins = ["stopped by SIGSTOP", "continued by SIGCONT", "killed by SIGKILL"];
    for ((_, effect), begin) in external.iter().zip(begins) {
        assert!(effect.starts_with(begin) && effect.contains("; it was "), "{effect}");
    }
    // The kill that the scenario plans is a fault of its own, and no process has crashed by itself.
    assert_eq!(faults(&report, "kill").len(), 1, "{report}");
    assert_eq!(report["agents"]["crashed"], 2, "{report}");
    assert!(!report["notes"].to_string().contains("without an order"), "{report}");
    assert!(ran.err.contains("1 of 1 planned struck, 3 from outside"), "{ran:?}");
    let page = fs::read_to_string(run.directory.path().join("page.html")).expect("the page is there");
    assert!(page.contains("external 35") && page.contains("killed by SIGKILL from outside"));
    replays(&run.directory.path().join("journal"));
}

/// An agent that is killed while others still start is dead from the beginning, and the run begins without it.
#[test]
fn an_agent_that_is_killed_before_the_run_begins_is_a_fault() {
    let mut run = Run::start();
    let mut first = None;
    wait_until("the first agent", || {
        first = agent_of(&run.root, 0, 0);
        first.is_some()
    });
    signal_to(first.expect("it was just there").pid, Signal::KILL);
    let ran = run.end();
    let report = report(&ran);
    let external = faults(&report, "external");
    assert!(external.len() == 1 && external[0].0 == Some(0), "{ran:?}");
    assert!(external[0].1.starts_with("killed by SIGKILL"), "{report}");
    assert_eq!((report["agents"]["crashed"].as_u64(), report["outcome"].as_str()), (Some(2), Some("built")));
    assert!(!report["notes"].to_string().contains("without an order"), "{report}");
    replays(&run.directory.path().join("journal"));
}

#[test]
fn a_process_that_ends_by_its_own_error_has_crashed() {
    let mut run = Run::start();
    // Like a panic that aborts.
    run.signal(35, Signal::ABORT);
    let ran = run.end();
    let report = report(&ran);
    assert_eq!(faults(&report, "external"), [], "{report}");
    assert!(report["notes"].to_string().contains("module 35 was killed by SIGABRT"), "{report}");
}

#[test]
fn a_partition_is_a_fault_like_the_others() {
    let directory = tempfile::tempdir().expect("a directory");
    let [file, page, journal] =
        ["cut.toml", "page.html", "journal"].map(|name| directory.path().join(name).display().to_string());
    let cut = "\n[[fault]]\npartition = { modules = [1, 2, 3], from = \"5s\", until = \"10s\" }\n";
    let text = fs::read_to_string(scenario("swarm.toml")).expect("it is there");
    fs::write(&file, text + cut).expect("it can be written");
    let args = ["run", &file, "--link", "sim", "--json", "-", "--html", &page, "--journal", &journal];
    let ran = run(&args);
    let report = report(&ran);
    let effect = |effect: &str| vec![(None, effect.to_owned())];
    assert_eq!(faults(&report, "partition"), effect("modules 1, 2 and 3 cut off from the other 39"));
    assert_eq!(faults(&report, "heal"), effect("modules 1, 2 and 3 no longer cut off"));
    assert_eq!(report["faults_planned"], 3, "{report}");
    assert!(ran.err.contains("3 of 3 planned struck)") && ran.err.contains("cut off from"), "{ran:?}");
    let page = fs::read_to_string(page).expect("the page is there");
    assert!(page.contains("cut off from the other 39"));
    replays(Path::new(&journal));
}
