//! The controller is killed during a run, and another takes over: the swarm builds its goal, and the journal
//! of both replays.
#![allow(clippy::print_stdout, reason = "shown only on failure or with --nocapture")]

use metamorph_protocol::rng::Rng;
use metamorph_tests::chaos::{agent_of, signal_to, wait_until};
use metamorph_tests::checked_run::geometry;
use metamorph_tests::checker::check;
use metamorph_tests::command::{Ran, command, run, run_processes, scenario, surprises};
use metamorph_world_controller::family::replay;
use metamorph_world_controller::record::journal::{Event, Journal, parts_of};
use metamorph_world_controller::report::schema::Report;
use metamorph_world_controller::run::replay::{Request, text};
use metamorph_world_controller::swarm::clean;
use rustix::process::Signal;
use std::path::Path;
use std::process::{Child, Stdio};

/// A run whose controller is going to be killed. No process stays, even if the test fails.
struct Victim {
    child: Child,
}

impl Victim {
    fn start(journal: &Path, name: &str, options: &[&str]) -> Victim {
        let (path, file) = (scenario(name).display().to_string(), journal.display().to_string());
        let fixed = ["run", path.as_str(), "--quiet", "--journal", file.as_str()];
        let mut command = command(&[&fixed, options].concat());
        let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        Victim { child: child.expect("metamorph can be started") }
    }

    /// Kills the controller once `records` of it are in the journal; returns false if it was over before.
    fn kill_at(&mut self, journal: &Path, records: usize) -> bool {
        let parts = parts_of(journal);
        let controller = parts.join("controller");
        wait_until("the run to get so far", || {
            let over = self.child.try_wait().expect("a child can be waited for").is_some();
            over || (parts.join("run").exists() && count(&controller) >= records)
        });
        if self.child.try_wait().expect("a child can be waited for").is_some() {
            return false;
        }
        signal_to(self.child.id() as i32, Signal::KILL);
        self.child.wait().expect("a child can be waited for");
        true
    }
}

impl Drop for Victim {
    fn drop(&mut self) {
        if self.child.try_wait().is_ok_and(|ended| ended.is_none()) {
            // Asked to end, so that it removes its files.
            signal_to(self.child.id() as i32, Signal::TERM);
            let _ = self.child.wait();
        }
    }
}

fn count(part: &Path) -> usize {
    metamorph_module_agent::journal_file::Reader::open(part).map_or(0, Iterator::count)
}

/// Resumes a run, until no controller is killed any more.
fn resume(journal: &Path) -> (Ran, Report) {
    let html = journal.with_extension("html");
    let (file, page) = (journal.display().to_string(), html.display().to_string());
    let ran = run_processes(&["resume", &file, "--json", "-", "--html", &page]);
    println!("{}", ran.err);
    // The report includes events before the first controller was killed, messages included.
    let page = std::fs::read_to_string(html).expect("the report is written");
    for part in ["built", "another one resumed", "class=\"area moves\"", "class=\"area c-negotiation\""] {
        assert!(page.contains(part), "`{part}` is missing");
    }
    let report = serde_json::from_str(&ran.out).unwrap_or_else(|e| panic!("{e}: {ran:?}"));
    (ran, report)
}

fn assert_one_run(journal: &Path, report: &Report, controllers: usize) {
    assert!(!parts_of(journal).exists(), "the parts are joined");
    let request = Request { file: journal.to_owned(), until: None, agent: None };
    let (plan, replayed) = replay(&request).expect("the journal can be read");
    println!("{}", text(&plan, &replayed));
    assert_eq!(replayed.difference, None);
    assert_eq!((replayed.troubles.as_slice(), replayed.done.unchecked), (&[] as &[String], 0));
    assert_eq!(replayed.ended.as_deref(), Some(report.outcome.as_str()));
    check(journal, geometry(&plan).as_ref()).unwrap_or_else(|breach| panic!("{breach}"));
    let resumed = |e: &Event| matches!(e, Event::Resumed);
    let journal = Journal::open(journal).expect("it was just read");
    let seen = journal.filter(|r| resumed(&r.as_ref().expect("it is sound").event)).count();
    assert_eq!(seen, controllers - 1);
    // The counts of the report are the totals of the whole journal, before and after.
    assert!(replayed.tally.total().sent >= report.messages.total);
    assert!(replayed.tally.total().sent <= report.messages.total + 50);
    assert_eq!((report.invariants.broken, report.collisions.suffered), (0, 0));
    assert!(report.messages.all.in_flight >= 0);
}

/// Kills the controller at a time drawn from the seed, and resumes.
fn kill_and_resume(name: &str, most: u64, options: &[&str], seed: u64) -> bool {
    let dir = tempfile::tempdir().expect("a directory");
    let journal = dir.path().join("journal");
    let mut random = Rng::named(seed, "when the controller is killed", 0);
    let records = 200 + random.below(most) as usize;
    let number = seed.to_string();
    let mut victim = Victim::start(&journal, name, &[&["--seed", number.as_str()], options].concat());
    if !victim.kill_at(&journal, records) {
        return false;
    }
    // A run that starts meanwhile cleans up, but spares runs that can be resumed.
    clean().expect("cleaning works");
    let (ran, report) = resume(&journal);
    assert_eq!((ran.code, report.outcome.as_str()), (Some(0), "built"), "{}", report.reason);
    assert!(report.notes.iter().any(|n| n.contains("another one resumed")), "{:?}", report.notes);
    assert_eq!(surprises(&report), [""; 0], "no module was lost");
    assert_one_run(&journal, &report, 2);
    true
}

#[test]
fn a_swarm_is_built_although_its_controller_is_killed() {
    assert!(kill_and_resume("swarm.toml", 600, &["--time-scale", "10", "--pause", "20@1s..8s"], 1));
}

/// The daemons of the other hosts wait for the next controller, and answer for their agents.
#[test]
fn a_swarm_on_three_hosts_is_built_although_its_controller_is_killed() {
    let options = ["--time-scale", "10", "--hosts", "3", "--pause", "20@1s..8s"];
    assert!(kill_and_resume("swarm.toml", 600, &options, 2));
}

#[test]
fn metamodules_build_although_their_controller_is_killed() {
    let options = ["--time-scale", "20", "--set", "protocol.seed_authority=neighbours"];
    assert!(kill_and_resume("box.toml", 200, &options, 3));
}

/// The controller that comes back has the plan and what is done of it from the journal. Nothing moves meanwhile.
#[test]
fn a_plan_is_carried_on_although_its_controller_is_killed() {
    let options = ["--time-scale", "20", "--set", "protocol.strategy=planned"];
    for (name, seed) in [("chair.toml", 5), ("box.toml", 6)] {
        assert!(
            kill_and_resume(name, 200, &options, seed),
            "{name} was over before the controller was killed"
        );
    }
}

#[test]
fn the_controller_that_came_back_may_be_killed_too() {
    let dir = tempfile::tempdir().expect("a directory");
    let journal = dir.path().join("journal");
    let mut victim = Victim::start(&journal, "swarm.toml", &["--time-scale", "5"]);
    assert!(victim.kill_at(&journal, 300));
    let args = ["resume", &journal.display().to_string(), "--quiet"];
    let child = command(&args).stdout(Stdio::null()).spawn().expect("it starts");
    assert!(Victim { child }.kill_at(&journal, 600));
    let (ran, report) = resume(&journal);
    assert_eq!((ran.code, report.outcome.as_str()), (Some(0), "built"), "{}", report.reason);
    assert_one_run(&journal, &report, 3);
}

#[test]
fn runs_that_cannot_be_resumed_are_refused() {
    let dir = tempfile::tempdir().expect("a directory");
    let journal = dir.path().join("journal");
    let file = journal.display().to_string();
    let none = run(&["resume", &file]);
    assert!(none.code == Some(1) && none.err.contains("no run writes its journal there"), "{none:?}");
    std::fs::write(&journal, b"").expect("it can be written");
    let over = run(&["resume", &file]);
    assert!(
        over.code == Some(1) && over.err.contains("the run is finished") && over.err.contains("fix: "),
        "{over:?}"
    );
    std::fs::remove_file(&journal).expect("it is there");
    // A live run is not taken over.
    let mut victim = Victim::start(&journal, "swarm.toml", &["--time-scale", "2", "--patience", "100ms"]);
    wait_until("the run to begin", || parts_of(&journal).join("run").exists());
    let alive = run(&["resume", &file]);
    assert!(alive.code == Some(1) && alive.err.contains("lives"), "{alive:?}");
    let again = run(&["run", &scenario("swarm.toml").display().to_string(), "--journal", &file]);
    assert!(again.code == Some(2) && again.err.contains("unfinished run"), "{again:?}");
    // A run that is not resumed ends by itself, and is cleaned up.
    assert!(victim.kill_at(&journal, 100));
    let name = std::fs::read_to_string(parts_of(&journal).join("run")).expect("the run has begun");
    let root = Path::new("/dev/shm").join(name.split(' ').next().unwrap_or_default());
    wait_until("the agents to give up", || clean().is_ok() && !root.exists());
    let late = run(&["resume", &file]);
    assert!(late.code == Some(1) && late.err.contains("waited long enough"), "{late:?}");
    // Its records until then are kept.
    let replayed = run(&["replay", &file]);
    assert!(replayed.code == Some(0) && replayed.out.contains("the run was not finished"), "{replayed:?}");
}

/// Agents that died before the run is resumed are no deadlock of the protocol: that is said, and the journal stays as it is.
#[test]
fn a_run_whose_agents_are_gone_is_refused() {
    let dir = tempfile::tempdir().expect("a directory");
    let journal = dir.path().join("journal");
    let file = journal.display().to_string();
    let mut victim = Victim::start(&journal, "swarm.toml", &["--time-scale", "2"]);
    assert!(victim.kill_at(&journal, 300), "the run is slower than this");
    let name = std::fs::read_to_string(parts_of(&journal).join("run")).expect("the run has begun");
    let root = Path::new("/dev/shm").join(name.split(' ').next().unwrap_or_default());
    let agents: Vec<_> = (0..42).filter_map(|id| agent_of(&root, id, 0)).collect();
    assert!(!agents.is_empty());
    for agent in agents.iter().filter(|agent| agent.is_alive()) {
        signal_to(agent.pid, Signal::KILL);
    }
    wait_until("all agents to be dead", || agents.iter().all(|agent| !agent.is_alive()));
    let before = count(&parts_of(&journal).join("controller"));
    let refused = run(&["resume", &file]);
    assert!(
        refused.code == Some(1) && refused.err.contains("agents of the run is there any more"),
        "{refused:?}"
    );
    assert_eq!(count(&parts_of(&journal).join("controller")), before);
}

/// `cargo test -p metamorph-tests resume::fifty -- --ignored --nocapture`
#[test]
#[ignore = "minutes: fifty runs of 42 processes"]
fn fifty_swarms_are_built_although_their_controllers_are_killed() {
    let mut killed = 0;
    for seed in 2_000.. {
        killed += usize::from(kill_and_resume("swarm.toml", 1_000, &["--time-scale", "15"], seed));
        println!("{killed} controllers killed, all swarms resumed and built");
        if killed == 50 {
            return;
        }
    }
}
