//! Swarms of real processes on several hosts: daemons on this machine, connected by Unix sockets, that are killed and
//! frozen. Nothing is left behind on any host.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_module_agent::journal_file::Reader;
use metamorph_module_agent::run_dir::identity::Identity;
use metamorph_tests::chaos::{left_of, root_of, signal_to, wait_until};
use metamorph_tests::command::{command, report, run, run_processes, scenario};
use metamorph_world_controller::record::journal::{Event, parts_of};
use metamorph_world_controller::report::schema::Report;
use metamorph_world_controller::swarm::{RunDir, clean};
use rustix::process::Signal;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::Mutex;
use tempfile::TempDir;

/// Times of the links between hosts in these tests.
const TIMES: &str = "version = 1\nsilent = \"1s\"\nfence = \"2s\"\n";
/// Modules of h2 in the scenario `swarm` on three hosts.
const OF_H2: std::ops::Range<u32> = 14..28;

/// Two runs at a time would compete for the processors.
static ALONE: Mutex<()> = Mutex::new(());

/// Two daemons, h2 and h3, and the hosts file that names them. Killed when dropped.
struct Daemons {
    directory: TempDir,
    children: Vec<Child>,
}

impl Daemons {
    fn start() -> Daemons {
        let directory = tempfile::tempdir().unwrap();
        let mut text = format!("{TIMES}[[host]]\nname = \"h1\"\naddress = \"local\"\n");
        let mut daemons = Daemons { directory, children: Vec::new() };
        for host in ["h2", "h3"] {
            let socket = daemons.path(host);
            let daemon = command(&["host", "--listen", &socket]).stderr(Stdio::null()).spawn().unwrap();
            daemons.children.push(daemon);
            wait_until("a daemon to listen", || Path::new(&socket).exists());
            text += &format!("[[host]]\nname = \"{host}\"\naddress = \"unix:{socket}\"\n");
        }
        fs::write(daemons.path("hosts.toml"), text).unwrap();
        daemons
    }

    fn path(&self, name: &str) -> String {
        self.directory.path().join(name).display().to_string()
    }

    fn identity(&self, i: usize) -> Identity {
        Identity::of(self.children[i].id() as i32).unwrap().unwrap()
    }

    /// Sends a signal to a daemon.
    fn signal(&self, i: usize, signal: Signal) {
        signal_to(self.children[i].id() as i32, signal);
    }

    /// Runs the scenario `swarm` on the hosts; `disturb` is called when all agents of h2 are up and the first has acted.
    fn run(&self, disturb: impl FnOnce()) -> Report {
        let (hosts, journal) = (self.path("hosts.toml"), self.path("run.journal"));
        let swarm = scenario("swarm.toml").display().to_string();
        let args = ["run", &swarm, "--hosts", &hosts, "--journal", &journal, "--json", "-", "--quiet"];
        let args = [&args[..], &["--set", "stop.timeout=30s", "--seed", "3"]].concat();
        let ran = std::thread::scope(|scope| {
            let ran = scope.spawn(|| run_processes(&args));
            let h2 = self.children[0].id() as i32;
            // A counter file for each agent, and one for the daemon.
            wait_until("the agents of h2 to work", || {
                let agents = root_of(h2).map(|root| fs::read_dir(root.join("ledgers")));
                agents.and_then(Result::ok).is_some_and(|agents| agents.count() > OF_H2.len())
            });
            // A host that is lost before the run begins ends it.
            let controller = parts_of(Path::new(&journal)).join("controller");
            wait_until("the run to begin", || {
                let records = Reader::open(&controller).into_iter().flatten();
                records.map_while(Result::ok).any(|record| matches!(record.event, Event::Act { .. }))
            });
            disturb();
            ran.join().unwrap()
        });
        let replayed = run(&["replay", &journal, "--quiet"]);
        assert_eq!(replayed.code, Some(0), "{replayed:?}");
        assert!(!ran.out.is_empty(), "{ran:?}");
        report(&ran.out)
    }

    /// Ends the daemons, and asserts that no file of their runs is left.
    fn end(mut self) {
        let identities: Vec<Identity> = (0..self.children.len()).map(|i| self.identity(i)).collect();
        for child in &mut self.children {
            signal_to(child.id() as i32, Signal::TERM);
            assert!(child.wait().unwrap().success());
        }
        for daemon in identities {
            assert_eq!(left_by(daemon), Vec::<PathBuf>::new());
        }
    }
}

impl Drop for Daemons {
    fn drop(&mut self) {
        for child in &mut self.children {
            let _ = child.kill();
            let _ = child.wait();
        }
        let _ = clean();
    }
}

/// Returns the files that the first runs of a process have left.
fn left_by(process: Identity) -> Vec<PathBuf> {
    (0..4).flat_map(|n| left_of(&RunDir::name_of(process, n).root())).collect()
}

/// True if the fault took this module away from outside.
fn was_lost(report: &Report, module: u32) -> bool {
    report.faults.iter().any(|fault| fault.fault == "external" && fault.module == Some(module))
}

#[test]
fn a_swarm_on_three_hosts_is_built_and_its_journal_replays() {
    let _alone = ALONE.lock();
    let directory = tempfile::tempdir().unwrap();
    let journal = directory.path().join("run.journal").display().to_string();
    let swarm = scenario("swarm.toml").display().to_string();
    let ran =
        run_processes(&["run", &swarm, "--hosts", "3", "--journal", &journal, "--json", "-", "--quiet"]);
    assert_eq!((ran.code, ran.err.as_str()), (Some(0), ""), "{ran:?}");
    let report = report(&ran.out);
    assert_eq!((report.outcome.as_str(), report.invariants.broken, &report.notes[..]), ("built", 0, &[][..]));
    let hosts = report.hosts.unwrap();
    assert_eq!(hosts.hosts.iter().map(|host| host.modules).collect::<Vec<_>>(), [14, 14, 14]);
    for (from, to) in [("h1", "h2"), ("h2", "h1"), ("h2", "h3"), ("h3", "h2")] {
        let crossed = hosts.crossed.iter().find(|c| (c.from.as_str(), c.to.as_str()) == (from, to)).unwrap();
        assert!(crossed.all.sent > 50, "{from} to {to}: {crossed:?}");
        assert_eq!(crossed.all.lost, 0, "{from} to {to}");
        assert_eq!(crossed.body_messages > 0, from == "h1" || to == "h1", "{from} to {to}");
    }
    let replayed = run(&["replay", &journal, "--quiet"]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
}

#[test]
fn a_killed_daemon_takes_its_modules_along_and_the_rest_goes_on() {
    let _alone = ALONE.lock();
    let daemons = Daemons::start();
    let h2 = daemons.identity(0);
    let report = daemons.run(|| daemons.signal(0, Signal::KILL));
    assert_eq!((report.invariants.broken, &report.notes[..]), (0, &[][..]));
    assert!(OF_H2.into_iter().all(|module| was_lost(&report, module)), "{:?}", report.faults);
    assert!(!(0..14).chain(28..41).any(|module| was_lost(&report, module)), "{:?}", report.faults);
    assert_eq!(report.agents.alive, 27);
    wait_until("all of h2 to be removed", || left_by(h2).is_empty());
}

#[test]
fn a_frozen_daemon_ends_its_share_when_it_is_continued_and_serves_the_next_run() {
    let _alone = ALONE.lock();
    let daemons = Daemons::start();
    let root = std::cell::RefCell::new(None);
    let report = daemons.run(|| {
        *root.borrow_mut() = root_of(daemons.children[0].id() as i32);
        daemons.signal(0, Signal::STOP);
    });
    assert_eq!(report.invariants.broken, 0);
    assert!(OF_H2.into_iter().all(|module| was_lost(&report, module)), "{:?}", report.faults);
    daemons.signal(0, Signal::CONT);
    let root = root.into_inner().unwrap();
    wait_until("its share to end", || left_of(&root).is_empty());
    let again = daemons.run(|| ());
    assert_eq!((again.outcome.as_str(), &again.notes[..]), ("built", &[][..]));
    daemons.end();
}

#[test]
fn a_daemon_that_is_frozen_for_less_than_the_fence_loses_no_module() {
    let _alone = ALONE.lock();
    let daemons = Daemons::start();
    let report = daemons.run(|| {
        daemons.signal(0, Signal::STOP);
        std::thread::park_timeout(std::time::Duration::from_millis(1_300));
        daemons.signal(0, Signal::CONT);
    });
    assert_eq!((report.outcome.as_str(), report.invariants.broken, report.agents.alive), ("built", 0, 41));
    assert_eq!(report.notes, [""; 0]);
    daemons.end();
}

#[test]
fn a_host_that_is_not_there_is_named() {
    let daemons = tempfile::tempdir().unwrap();
    let file = daemons.path().join("hosts.toml");
    let socket = daemons.path().join("h2.sock");
    let host = |name: &str, address: &str| format!("[[host]]\nname = \"{name}\"\naddress = \"{address}\"\n");
    let text = [TIMES, &host("h1", "local"), &host("h2", &format!("unix:{}", socket.display()))].concat();
    fs::write(&file, text).unwrap();
    let swarm = scenario("swarm.toml").display().to_string();
    let ran = run(&["run", &swarm, "--hosts", &file.display().to_string()]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(1), ""), "{ran:?}");
    assert!(
        ran.err.contains("h2 cannot be reached") && ran.err.contains("fix: start `metamorph host"),
        "{ran:?}"
    );
    let refused = run(&["check", &swarm, "--hosts", "50"]);
    assert_eq!(refused.code, Some(2), "{refused:?}");
    assert!(refused.err.contains("the number of hosts is 50"), "{refused:?}");
}
