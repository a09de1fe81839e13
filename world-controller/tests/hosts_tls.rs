//! Swarms on several machines over zenoh with mutual TLS, played by daemons on loopback addresses (feature `hosts`): a run
//! is built and replays, and everything without the right keys is refused by name.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_module_agent::pid_directory;
use metamorph_module_agent::run_dir::identity::Identity;
use metamorph_module_agent::run_dir::run_name::RunName;
use metamorph_protocol::ids::HostId;
use metamorph_world_controller::report::schema::Report;
use metamorph_world_controller::swarm::make_keys;
use rustix::process::{Pid, Signal, kill_process};
use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Mutex;
use std::time::Duration;
use tempfile::TempDir;

/// The longest wait for a condition.
const WATCHDOG: u32 = 60_000;

/// Two runs at a time would compete for the processors.
static ALONE: Mutex<()> = Mutex::new(());

fn metamorph(program: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(program);
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    command.args(args).stdin(Stdio::null()).current_dir(root).env_remove("METAMORPH_LOG");
    command
}

fn program() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_metamorph"))
}

fn run(args: &[&str]) -> (Option<i32>, String, String) {
    let Output { status, stdout, stderr } = metamorph(program(), args).output().unwrap();
    let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
    (status.code(), text(&stdout), text(&stderr))
}

fn wait_until(what: &str, mut holds: impl FnMut() -> bool) {
    for _ in 0..WATCHDOG / 20 {
        if holds() {
            return;
        }
        std::thread::park_timeout(Duration::from_millis(20));
    }
    panic!("timed out waiting for {what}");
}

/// Returns a port that was free a moment ago.
fn port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// The keys and the hosts file of a site, and its daemons. They are killed when dropped.
struct Site {
    directory: TempDir,
    ports: Vec<u16>,
    daemons: Vec<Child>,
}

impl Site {
    /// Makes keys for `hosts` hosts, without daemons.
    fn new(hosts: usize) -> Site {
        let ports: Vec<u16> = (1..hosts).map(|_| port()).collect();
        let site = Site { directory: tempfile::tempdir().unwrap(), ports, daemons: Vec::new() };
        let mut text =
            "version = 1\nkeys = \"keys\"\nsilent = \"1s\"\nfence = \"6s\"\nclock_error = \"20ms\"\n\
                        [[host]]\nname = \"h1\"\naddress = \"local\"\n"
                .to_owned();
        for (port, number) in site.ports.iter().zip(2..) {
            text += &format!("[[host]]\nname = \"h{number}\"\naddress = \"127.0.0.1:{port}\"\n");
        }
        fs::write(site.path("hosts.toml"), text).unwrap();
        let made = run(&["host", "--keys", &site.text("keys"), "--make-keys", &site.text("hosts.toml")]);
        assert_eq!(made.0, Some(0), "{made:?}");
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    /// Starts the daemon of h2, h3, ... with these keys and waits until it listens.
    fn start(&mut self, program: &Path, i: usize, name: &str, keys: &str) {
        let (listen, log) = (format!("127.0.0.1:{}", self.ports[i]), self.path(&format!("{i}.log")));
        let args = ["-v", "host", "--listen", &listen, "--name", name, "--keys", keys];
        let daemon = metamorph(program, &args).stderr(fs::File::create(log).unwrap()).spawn().unwrap();
        self.daemons.push(daemon);
        let port = self.ports[i];
        wait_until("a daemon to listen", || TcpStream::connect(("127.0.0.1", port)).is_ok());
    }

    fn start_all(&mut self) {
        for i in 0..self.ports.len() {
            self.start(program(), i, &HostId(i as u16 + 1).to_string(), &self.text("keys"));
        }
    }

    fn log(&self, i: usize) -> String {
        fs::read_to_string(self.path(&format!("{i}.log"))).unwrap_or_default()
    }

    fn check(&self) -> (Option<i32>, String, String) {
        run(&["check", "deploy/scenarios/swarm.toml", "--hosts", &self.text("hosts.toml")])
    }
}

impl Drop for Site {
    fn drop(&mut self) {
        for daemon in &mut self.daemons {
            let _ = daemon.kill();
            let _ = daemon.wait();
        }
        let _ = metamorph(program(), &["clean"]).output();
    }
}

/// zenoh reads and writes a connection without a lock.
#[test]
fn zenoh_has_one_thread() {
    let mut site = Site::new(2);
    site.start_all();
    let threads = || -> Vec<String> {
        let tasks = fs::read_dir(format!("/proc/{}/task", site.daemons[0].id())).unwrap();
        tasks.filter_map(|task| fs::read_to_string(task.unwrap().path().join("comm")).ok()).collect()
    };
    assert_eq!(site.check().0, Some(0));
    let found = threads();
    let of = |name: &str| found.iter().filter(|thread| thread.starts_with(name)).count();
    assert!(of("rx-") >= 1, "{found:?}");
    assert!(["tx-", "net-", "acc-"].iter().all(|name| of(name) == 0), "{found:?}");
}

#[test]
fn a_swarm_on_three_machines_is_built_and_its_journal_replays() {
    let _alone = ALONE.lock();
    let mut site = Site::new(3);
    site.start_all();
    let checked = site.check();
    assert_eq!(checked.0, Some(0), "{checked:?} {}", site.log(0));
    assert!(
        checked.1.matches("room for").count() == 2 && checked.1.contains("its clock is known to"),
        "{checked:?}"
    );
    let (hosts, journal) = (site.text("hosts.toml"), site.text("run.journal"));
    let scenario = "deploy/scenarios/swarm.toml";
    let ran = run(&["run", scenario, "--hosts", &hosts, "--journal", &journal, "--json", "-", "--quiet"]);
    assert_eq!(ran.0, Some(0), "{ran:?}\n{}\n{}", site.log(0), site.log(1));
    let report: Report = serde_json::from_str(&ran.1).unwrap();
    assert_eq!((report.outcome.as_str(), report.invariants.broken), ("built", 0), "{:?}", report.notes);
    let crossed = report.hosts.unwrap().crossed;
    for (from, to) in [("h1", "h2"), ("h2", "h1"), ("h2", "h3"), ("h3", "h2")] {
        let pair = crossed.iter().find(|c| (c.from.as_str(), c.to.as_str()) == (from, to)).unwrap();
        assert!(pair.all.sent > 50, "{from} to {to}: {pair:?}");
    }
    let replayed = run(&["replay", &journal, "--quiet"]);
    assert_eq!(replayed.0, Some(0), "{replayed:?}");
    // The agents of h2 and h3 have written their parts on their own hosts.
    assert!(!site.path("run.journal.parts").exists());
}

/// Asserts that `check --hosts` fails and names the reason.
fn is_named(site: &Site, reason: &str) {
    let (code, out, err) = site.check();
    assert_eq!(code, Some(1), "{out} {err} {}", site.log(0));
    assert!(out.contains(reason) && out.contains("fix: "), "`{reason}` is missing: {out} {err}");
}

#[test]
fn keys_of_another_site_and_expired_ones_are_refused_by_name() {
    let hosts = [(HostId(0), vec![]), (HostId(1), vec!["127.0.0.1".to_owned()])];
    let mut site = Site::new(2);
    is_named(&site, "no connection");
    make_keys(&site.path("other"), &hosts, Duration::from_secs(3_600)).unwrap();
    site.start(program(), 0, "h2", &site.text("other"));
    is_named(&site, "its certificate is of another authority");
    wait_until("the daemon to name it", || site.log(0).contains("WARN"));

    let mut site = Site::new(2);
    make_keys(&site.path("expired"), &hosts, Duration::ZERO).unwrap();
    site.start(program(), 0, "h2", &site.text("expired"));
    // The controller has keys of the same, expired site, so that only the dates are wrong.
    fs::rename(site.path("keys"), site.path("unused")).unwrap();
    fs::rename(site.path("expired"), site.path("keys")).unwrap();
    // Certificates end with the second in which they were made.
    wait_until("the certificates to expire", || site.check().1.contains("not valid"));
    is_named(&site, "its certificate is not valid now");
}

#[test]
fn a_wrong_token_name_or_build_and_plain_tcp_are_refused_by_name() {
    let mut site = Site::new(2);
    let copy = |site: &Site, to: &str| {
        fs::create_dir(site.path(to)).unwrap();
        for entry in fs::read_dir(site.path("keys")).unwrap() {
            let from = entry.unwrap().path();
            fs::copy(&from, site.path(to).join(from.file_name().unwrap())).unwrap();
        }
    };
    copy(&site, "forged");
    fs::write(site.path("forged").join("token"), [7; 32]).unwrap();
    site.start(program(), 0, "h2", &site.text("forged"));
    is_named(&site, "the proof is wrong");
    wait_until("the daemon to name it", || site.log(0).contains("without proving the token"));

    let mut site = Site::new(3);
    site.start(program(), 0, "h3", &site.text("keys"));
    is_named(&site, "its certificate is that of `h3`");

    let mut site = Site::new(2);
    let other = site.path("metamorph");
    fs::copy(program(), &other).unwrap();
    fs::File::options().append(true).open(&other).unwrap().write_all(b"another build").unwrap();
    site.start(&other, 0, "h2", &site.text("keys"));
    is_named(&site, "they run different builds of the program");

    let site = Site::new(2);
    let listener = TcpListener::bind(("127.0.0.1", site.ports[0])).unwrap();
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let mut stream = stream;
            let _ = stream.write_all(b"220 some other service\r\n");
        }
    });
    is_named(&site, "does not speak TLS");
}

/// Neither plain TCP nor TLS without a certificate gets anything out of a daemon, and it keeps serving.
#[test]
fn a_daemon_refuses_who_has_no_certificate() {
    let mut site = Site::new(2);
    site.start_all();
    let mut plain = TcpStream::connect(("127.0.0.1", site.ports[0])).unwrap();
    plain.write_all(b"GET / HTTP/1.1\r\n\r\n").unwrap();
    plain.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let mut answer = Vec::new();
    let _ = plain.read_to_end(&mut answer);
    // At most an alert of TLS.
    assert!(answer.len() < 16, "{answer:?}");
    wait_until("the daemon to name it", || site.log(0).contains("WARN"));
    let checked = site.check();
    assert_eq!(checked.0, Some(0), "{checked:?}");
    let plain = run(&["host", "--listen", "127.0.0.1:1", "--most", "3"]);
    assert!(
        plain.0 == Some(1) && plain.2.contains("a daemon on a network needs a name and keys"),
        "{plain:?}"
    );
}

/// One port of a machine serves the metrics of one daemon, so `cluster up` begins nothing if two are to use it.
#[test]
fn daemons_of_one_machine_do_not_serve_metrics_at_one_port() {
    let directory = TempDir::new().unwrap();
    let hosts = directory.path().join("hosts.toml");
    let host = |name: &str, address: &str| format!("[[host]]\nname = \"{name}\"\naddress = \"{address}\"\n");
    let text = ["version = 1\nkeys = \"keys\"\n".to_owned(), host("h1", "local")];
    let others = [host("h2", "127.0.0.1:7001"), host("h3", "127.0.0.1:7002")];
    fs::write(&hosts, [text, others].concat().concat()).unwrap();
    let refused = run(&["cluster", "up", &hosts.display().to_string(), "--metrics", "9100"]);
    let says = |part| refused.2.contains(part);
    assert!(refused.0 == Some(1) && says("h2 and h3 are on one machine, 127.0.0.1"), "{refused:?}");
    assert!(!directory.path().join("keys").exists());
}

/// The decompression of lz4_flex 0.10 can show foreign memory (RUSTSEC-2026-0041). zenoh always builds it and uses it with
/// one feature only, which is off.
#[test]
fn zenoh_does_not_compress() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let args =
        ["metadata", "--offline", "--format-version", "1", "--features", "metamorph-world-controller/hosts"];
    let platform = format!("{}-unknown-linux-gnu", std::env::consts::ARCH);
    let mut cargo = Command::new(env!("CARGO"));
    let output = cargo.args(args).args(["--filter-platform", &platform]).current_dir(root).output().unwrap();
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let nodes = metadata["resolve"]["nodes"].as_array().unwrap();
    let zenoh: Vec<_> = nodes.iter().filter(|node| node["id"].as_str().unwrap().contains("#zenoh")).collect();
    assert!(zenoh.len() > 10, "zenoh was not found");
    for node in zenoh {
        let features = node["features"].as_array().unwrap();
        let refused = ["transport_compression", "transport_tcp", "transport_udp", "shared-memory"];
        // zenoh itself asks zenoh-keyexpr for what it calls unstable there.
        let is_zenoh = node["id"].as_str().unwrap().contains("#zenoh@");
        let is_refused = |f: &str| refused.contains(&f) || (is_zenoh && f == "unstable");
        assert!(features.iter().all(|f| !is_refused(f.as_str().unwrap())), "{node}");
    }
}

/// Starts `swarm` on three machines with more options, and waits until the modules of h2 work.
fn started(site: &Site, more: &[&str]) -> Child {
    let (hosts, journal, out) = (site.text("hosts.toml"), site.text("run.journal"), site.text("report.json"));
    let scenario = "deploy/scenarios/swarm.toml";
    let args = ["run", scenario, "--hosts", &hosts, "--journal", &journal, "--json", &out, "--quiet"];
    let run_of = metamorph(program(), &[&args[..], more].concat())
        .stderr(fs::File::create(site.path("run.log")).unwrap())
        .spawn()
        .unwrap();
    wait_for_h2(site);
    run_of
}

/// Waits until the modules of h2, which are numbers 14 to 27, have sent parts of their journals over the network.
fn wait_for_h2(site: &Site) {
    let parts = site.path("run.journal.parts");
    let has_sent = |id| parts.join(format!("{id}.0")).metadata().is_ok_and(|m| m.len() > 2_000);
    wait_until("the modules of h2 to work", || (14..28).all(has_sent));
}

/// Waits for the end of a run that [`started`], and returns its report once its journal has been replayed.
fn ended(site: &Site, mut run_of: Child) -> Report {
    wait_until("the run to end", || run_of.try_wait().unwrap().is_some());
    let said = fs::read_to_string(site.path("run.log")).unwrap();
    let text = fs::read_to_string(site.path("report.json")).unwrap_or_else(|e| panic!("{e}: {said}"));
    let report: Report = serde_json::from_str(&text).unwrap();
    assert_eq!(report.invariants.broken, 0, "{:?} {said}", report.notes);
    let replayed = run(&["replay", &site.text("run.journal"), "--quiet"]);
    assert_eq!(replayed.0, Some(0), "{replayed:?}");
    report
}

/// A daemon that dies takes its modules along; the rest continues, and the journal, with torn parts, replays.
#[test]
fn a_lost_machine_takes_its_modules_along() {
    let _alone = ALONE.lock();
    let mut site = Site::new(3);
    site.start_all();
    let run_of = started(&site, &["--set", "stop.timeout=30s"]);
    site.daemons[0].kill().unwrap();
    let report = ended(&site, run_of);
    let lost: Vec<&str> =
        report.faults.iter().filter(|f| f.fault == "lost").map(|f| f.effect.as_str()).collect();
    assert_eq!(lost, ["h2 with 14 modules: the host was silent for too long"], "{:?}", report.faults);
}

/// A daemon that dies and is started again shows that its agents have ended, so the wait for the fence, an hour here, is
/// over. Its modules start there, and the links to both other machines carry what they say.
#[test]
fn a_machine_that_comes_back_ends_the_wait_for_the_fence() {
    let _alone = ALONE.lock();
    let mut site = Site::new(3);
    site.start_all();
    let text = fs::read_to_string(site.path("hosts.toml")).unwrap();
    fs::write(site.path("hosts.toml"), text.replace("fence = \"6s\"", "fence = \"3600s\"")).unwrap();
    let elsewhere = ["--set", "link.between_hosts.lost=elsewhere", "--rescue", "off", "--time-scale", "2"];
    let run_of = started(&site, &elsewhere);
    site.daemons[0].kill().unwrap();
    site.daemons[0].wait().unwrap();
    site.start(program(), 0, "h2", &site.text("keys"));
    let report = ended(&site, run_of);
    assert_eq!(report.outcome.as_str(), "built", "{:?}", report.notes);
    let lost = &report.hosts.as_ref().unwrap().hosts[1].lost_why;
    assert_eq!(lost.as_deref(), Some("its daemon was started again, which ended its agents"));
    let restarted = report.faults.iter().filter(|f| f.fault == "restart").filter_map(|f| f.module);
    assert!(restarted.eq(14..28), "{:?}", report.faults);
    let crossed = report.hosts.unwrap().crossed;
    for (from, to) in [("h1", "h2"), ("h2", "h1"), ("h2", "h3"), ("h3", "h2")] {
        let pair = crossed.iter().find(|c| (c.from.as_str(), c.to.as_str()) == (from, to)).unwrap();
        assert!(pair.all.sent > 50, "{from} to {to}: {pair:?}");
    }
}

/// A run on three machines whose controller is killed at some point.
struct Orphaned<'s> {
    site: &'s Site,
    journal: String,
}

impl<'s> Orphaned<'s> {
    fn new(site: &'s Site, seed: u64) -> Orphaned<'s> {
        let (hosts, journal) = (site.text("hosts.toml"), site.text("run.journal"));
        let (scenario, drawn) = ("deploy/scenarios/swarm.toml", seed.to_string());
        let args = ["run", scenario, "--hosts", &hosts, "--journal", &journal, "--quiet", "--seed", &drawn];
        let mut controller = metamorph(program(), &[&args[..], &["--set", "stop.timeout=40s"]].concat())
            .stdout(Stdio::null())
            .stderr(fs::File::create(site.path("run.log")).unwrap())
            .spawn()
            .unwrap();
        wait_for_h2(site);
        // At another point of each run.
        std::thread::park_timeout(Duration::from_millis(seed * 37 % 1_900));
        controller.kill().unwrap();
        controller.wait().unwrap();
        Orphaned { site, journal }
    }

    /// Returns the run directory of the controller.
    fn root(&self) -> PathBuf {
        let text = fs::read_to_string(self.site.path("run.journal.parts").join("run")).unwrap();
        RunName::parse(text.split_once(' ').unwrap().0).unwrap().root()
    }

    /// Resumes the run and returns the report.
    fn resumed(self, options: &[&str]) -> Report {
        let Orphaned { site, journal } = self;
        let args = ["resume", &journal, "--json", "-", "--quiet"];
        let went_on = run(&[&args[..], options].concat());
        let logs = || format!("{} {}", site.log(0), site.log(1));
        let report: Report =
            serde_json::from_str(&went_on.1).unwrap_or_else(|e| panic!("{e}: {went_on:?} {}", logs()));
        assert_eq!(report.invariants.broken, 0, "{:?} {}", report.notes, logs());
        assert!(report.notes[0].contains("another one resumed the run"), "{:?}", report.notes);
        let replayed = run(&["replay", &journal, "--quiet"]);
        assert_eq!(replayed.0, Some(0), "{replayed:?}");
        assert!(!site.path("run.journal.parts").exists());
        fs::remove_file(journal).unwrap();
        report
    }
}

/// Asserts that exactly one host was lost after the takeover, and its modules with it.
fn is_lost(report: &Report, host: &str) {
    let faults = report.faults.iter().filter(|fault| fault.fault == "lost");
    let effects: Vec<&str> = faults.map(|fault| fault.effect.as_str()).collect();
    assert_eq!(effects.len(), 1, "{:?} {:?}", report.faults, report.notes);
    assert!(effects[0].starts_with(&format!("{host} with 14 modules: ")), "{effects:?}");
    assert!(!report.notes.iter().any(|note| note.starts_with("module ")), "{:?}", report.notes);
}

#[test]
fn a_run_on_three_machines_goes_on_with_another_controller() {
    let _alone = ALONE.lock();
    let mut site = Site::new(3);
    site.start_all();
    let report = Orphaned::new(&site, 1).resumed(&[]);
    assert_eq!(report.outcome, "built", "{:?}", report.notes);
    assert_eq!(report.agents.alive, 41, "{:?}", report.faults);
    assert!((0..2).all(|i| site.log(i).contains("another controller has taken over")));
}

/// A daemon that does not answer the new controller may continue until its lease ends, and is not counted as dead until
/// then.
#[test]
fn a_machine_that_does_not_answer_the_new_controller_is_lost() {
    let _alone = ALONE.lock();
    let mut site = Site::new(3);
    site.start_all();
    let daemon = Pid::from_child(&site.daemons[0]);
    let orphaned = Orphaned::new(&site, 2);
    kill_process(daemon, Signal::STOP).unwrap();
    let report = orphaned.resumed(&[]);
    is_lost(&report, "h2");
    kill_process(daemon, Signal::CONT).unwrap();
    wait_until("its share to end", || site.log(0).contains("the controller has been silent for too long"));
}

/// The controller's machine is lost with its modules, its run directory and its clock, but not the journal.
#[test]
fn a_run_goes_on_from_another_machine() {
    let _alone = ALONE.lock();
    let mut site = Site::new(3);
    site.start_all();
    let orphaned = Orphaned::new(&site, 3);
    let hosts = site.text("hosts.toml");
    let elsewhere = ["--old-host-is-gone", "--hosts", &hosts];
    let refused = run(&[&["resume", &orphaned.journal][..], &elsewhere].concat());
    assert!(refused.2.contains("the controller's machine is not lost"), "{refused:?}");
    for pid in fs::read_dir(pid_directory(&orphaned.root())).unwrap() {
        let agent: Identity = fs::read_to_string(pid.unwrap().path()).unwrap().parse().unwrap();
        let _ = kill_process(Pid::from_raw(agent.pid).unwrap(), Signal::KILL);
    }
    let root = orphaned.root();
    wait_until("its files to go", || {
        let _ = metamorph(program(), &["clean"]).output();
        !root.exists()
    });
    let report = orphaned.resumed(&elsewhere);
    is_lost(&report, "h1");
    assert!(report.notes.iter().any(|note| note.contains("h1 was lost")), "{:?}", report.notes);
    assert!(site.log(0).contains("another controller has taken over"));
}

#[test]
#[ignore = "statistics: twenty minutes of runs"]
fn fifty_runs_on_three_machines_go_on_with_another_controller() {
    let _alone = ALONE.lock();
    let mut site = Site::new(3);
    site.start_all();
    for seed in 0..50 {
        let report = Orphaned::new(&site, seed).resumed(&[]);
        println!("seed {seed}: {} with {} alive: {:?}", report.outcome, report.agents.alive, report.notes);
        assert_eq!(report.outcome, "built");
    }
}
