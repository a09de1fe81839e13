//! Real runs with too few resources or foreign interference: full disks, small memories, other runs, foreign
//! processes that write into inboxes.
//!
//! A small disk or memory is a mount in a namespace of its own, which ends with the run. Where the system
//! allows none, these tests say so and check nothing.
#![allow(clippy::print_stdout, reason = "shown only on failure or with --nocapture")]

use metamorph_module_agent::run_dir::identity::Identity;
use metamorph_module_agent::transport::iceoryx::outbox::Outbox;
use metamorph_module_agent::transport::iceoryx::rendezvous::Rendezvous;
use metamorph_module_agent::transport::shared_frame::SharedFrame;
use metamorph_module_agent::transport::{Link, SendStatus};
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::rng::Rng;
use metamorph_tests::chaos::{agent_of, left_of, root_of, signal_to, wait_until};
use metamorph_tests::command::{Ran, command, metamorph, module_agent, root, run, scenario};
use metamorph_tests::required::{Check, skip};
use metamorph_world_controller::console::format::many;
use metamorph_world_controller::family::replay;
use metamorph_world_controller::run::replay::{Replayed, Request, text};
use metamorph_world_controller::swarm::RunDir;
use rustix::process::{Pid, Resource, Rlimit, Signal, kill_process, prlimit};
use serde_json::Value;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

fn again(journal: &Path) -> Replayed {
    let request = Request { file: journal.to_owned(), until: None, agent: None };
    let (plan, replayed) = replay(&request).expect("the journal can be read");
    println!("{}", text(&plan, &replayed));
    replayed
}

fn report(ran: &Ran) -> Value {
    serde_json::from_str(&ran.out).unwrap_or_else(|e| panic!("{e}: {ran:?}"))
}

fn notes(report: &Value) -> String {
    report["notes"].to_string()
}

/// Runs a shell script in a namespace of mounts of its own, with `small` a disk of this size. `None` if the
/// system allows none.
fn with_small_disk(small: &Path, size: &str, script: &str) -> Option<Ran> {
    module_agent();
    let mount = format!("mount -t tmpfs -o size={size} tmpfs {} || exit 77; {script}", small.display());
    let unshare = ["--map-root-user", "--mount", "--", "sh", "-c", mount.as_str()];
    let ran = Command::new("unshare").args(unshare).current_dir(root()).stdin(Stdio::null()).output();
    let Ok(ran) = ran else {
        skip(Check::Mounts, "there is no unshare on this machine");
        return None;
    };
    let ran = Ran::from(ran);
    let denied = ran.code == Some(77) || ran.err.starts_with("unshare:");
    if denied {
        skip(Check::Mounts, &format!("no small disk can be mounted here: {}", ran.err));
    }
    (!denied).then_some(ran)
}

/// A full disk ends the journal. The run goes on and reports what is missing; the rest replays.
#[test]
fn a_full_disk_ends_the_journal_and_not_the_run() {
    let dir = tempfile::tempdir().expect("a directory");
    let (disk, kept) = (dir.path().join("disk"), dir.path().join("kept"));
    for made in [&disk, &kept] {
        std::fs::create_dir(made).expect("it can be made");
    }
    let (program, file) = (metamorph().display(), scenario("swarm.toml"));
    let (disk_name, kept_name, file) = (disk.display(), kept.display(), file.display());
    let script = format!(
        "timeout 200 {program} run {file} --time-scale 20 --json - --journal {disk_name}/run; code=$?; \
         cp -a {disk_name}/. {kept_name}; exit $code"
    );
    let Some(ran) = with_small_disk(&disk, "400k", &script) else { return };
    let report = report(&ran);
    // The run was built, and what was asked for is not whole.
    assert_eq!((ran.code, report["outcome"].as_str()), (Some(1), Some("built")), "{ran:?}");
    assert!(ran.err.contains("--journal") && ran.err.contains("make room"), "{ran:?}");
    assert!(notes(&report).contains("missing from the journal: "), "{report}");
    assert!(notes(&report).contains("could not be joined, and stay in"), "{report}");
    // The fates of messages are counted elsewhere, and complete.
    let all = &report["messages"]["all"];
    let of = |what: &str| all[what].as_i64().expect("a count");
    let met =
        ["delivered", "lost", "overflowed", "expired", "refused", "in_flight"].map(of).iter().sum::<i64>();
    assert_eq!(of("sent") + of("duplicated"), met, "{all}");
    assert!(of("in_flight") >= 0 && of("sent") > 1_000, "{all}");
    let replayed = again(&kept.join("run"));
    assert_eq!(replayed.difference, None);
    assert!(replayed.done.steps > 100 && replayed.ended.is_none());
}

/// Too little shared memory is detected before any process is started.
#[test]
fn too_little_shared_memory_is_refused_at_once() {
    let (program, file) = (metamorph().display(), scenario("swarm.toml"));
    let script = format!(
        "timeout 200 {program} run {} --time-scale 20; code=$?; ls -A /dev/shm; exit $code",
        file.display()
    );
    let Some(ran) = with_small_disk(Path::new("/dev/shm"), "4m", &script) else { return };
    assert_eq!(ran.code, Some(1), "{ran:?}");
    assert!(ran.err.contains("in /dev/shm, but only") && ran.err.contains("--shm-size"), "{ran:?}");
    assert_eq!(ran.out.trim(), "", "nothing stays: {ran:?}");
}

/// Another process fills the shared memory during a run: the run ends in order and gives the reason.
#[test]
fn full_shared_memory_ends_the_run_with_the_reason() {
    let (program, file) = (metamorph().display(), scenario("swarm.toml"));
    let script = format!(
        "timeout 200 {program} run {} --time-scale 1 --json - & pid=$!; \
         until [ \"$(stat -c %s /dev/shm/mm*/reserve 2>/dev/null)\" = 1048576 ]; do \
             kill -0 $pid || exit 1; done; \
         cat /dev/zero >/dev/shm/fill 2>/dev/null; wait $pid; code=$?; ls -A /dev/shm >&2; exit $code",
        file.display()
    );
    let Some(ran) = with_small_disk(Path::new("/dev/shm"), "24m", &script) else { return };
    assert_eq!(ran.code, Some(7), "{ran:?}");
    let report = report(&Ran { out: ran.out[ran.out.find('{').unwrap_or_default()..].to_owned(), ..ran });
    assert_eq!(report["outcome"].as_str(), Some("aborted"), "{report}");
    assert!(notes(&report).contains("the run was ended early: shared memory is full"), "{report}");
}

/// Something removes the files of a run in shared memory: the run ends at once, as a fault of the machine and not as a deadlock.
#[test]
fn removed_shared_memory_ends_the_run_with_the_reason() {
    let dir = tempfile::tempdir().expect("a directory");
    let run = Run::start(&dir.path().join("journal"), &["--time-scale", "3"]);
    wait_until("the run to begin", || root_of(run.pid()).is_some_and(|root| begun(&root)));
    let root = root_of(run.pid()).expect("it has begun");
    for path in left_of(&root) {
        // Links and directories are removed as what they are.
        let is_dir = path.symlink_metadata().is_ok_and(|found| found.is_dir());
        let _ = if is_dir { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
    }
    let ran = run.end();
    let report = report(&ran);
    assert_eq!((ran.code, report["outcome"].as_str()), (Some(7), Some("aborted")), "{ran:?}");
    let reason = report["reason"].to_string();
    assert!(reason.contains("machine: ") && reason.contains("removed from outside"), "{reason}");
    assert_eq!(left_of(&root), Vec::<std::path::PathBuf>::new());
}

/// Something removes the inboxes of agents, which go on with the neighbours that they have. A new neighbour finds none, and the
/// run ends, since the protocol would stand still without a fault of its own.
#[test]
fn removed_inboxes_end_the_run_with_the_reason() {
    let dir = tempfile::tempdir().expect("a directory");
    let run = Run::start(&dir.path().join("journal"), &["--time-scale", "3"]);
    wait_until("the run to begin", || root_of(run.pid()).is_some_and(|root| begun(&root)));
    let services = root_of(run.pid()).expect("it has begun").join("services");
    let mut removed = 0;
    for service in std::fs::read_dir(services).expect("it has channels").flatten() {
        let is_inbox =
            std::fs::read_to_string(service.path()).is_ok_and(|text| text.contains("service_name = \"in/"));
        removed += u32::from(is_inbox && std::fs::remove_file(service.path()).is_ok());
    }
    assert_eq!(removed, 42);
    let reason = reason_of_machine(&run.end());
    assert!(reason.contains("the inbox of module") && reason.contains("removed from outside"), "{reason}");
}

/// A limit of file sizes is an error, and does not end the command by a signal.
#[test]
fn a_limit_of_file_sizes_is_refused_at_once() {
    let (program, file) = (metamorph().display(), scenario("swarm.toml"));
    let script = format!("ulimit -f 1000; exec {program} run {} -q", file.display());
    let ran: Ran = Command::new("sh").args(["-c", &script]).output().expect("a shell can be started").into();
    assert_eq!(ran.code, Some(1), "{ran:?}");
    assert!(ran.err.contains("ulimit -f"), "{ran:?}");
}

/// Waits until a run has begun, and returns one of its agents.
fn agent_of_begun(run: &Run, module: u32) -> Identity {
    let mut agent = None;
    wait_until("the run to begin", || {
        let root = root_of(run.pid());
        agent = root.as_ref().and_then(|root| agent_of(root, module, 0));
        root.is_some_and(|root| begun(&root)) && agent.is_some()
    });
    agent.expect("it was just there")
}

/// Asserts that a run was ended because of the machine, and returns the reason.
fn reason_of_machine(ran: &Ran) -> String {
    let report = report(ran);
    let reason = report["reason"].to_string();
    assert_eq!((ran.code, report["outcome"].as_str()), (Some(7), Some("aborted")), "{ran:?}");
    assert!(reason.contains("machine: "), "{reason}");
    reason
}

/// An agent that dies from a lack of memory ends the run, since that says nothing about the protocol.
#[test]
fn an_agent_that_dies_of_sigbus_ends_the_run_with_the_reason() {
    let dir = tempfile::tempdir().expect("a directory");
    let run = Run::start(&dir.path().join("journal"), &["--time-scale", "3"]);
    let victim = agent_of_begun(&run, 20);
    let pid = Pid::from_raw(victim.pid).expect("a pid is not 0");
    wait_until("it to be dead", || {
        // The standard library catches the first signal, since a fault comes again.
        let _ = kill_process(pid, Signal::BUS);
        !victim.is_alive()
    });
    let reason = reason_of_machine(&run.end());
    assert!(reason.contains("module 20 died of SIGBUS: shared memory"), "{reason}");
}

/// Size of a page, in bytes.
const PAGE: u64 = 4096;
/// Memory that an agent may still map, in bytes, so that its stack can grow.
const ROOM: u64 = 16 * PAGE;

/// An agent that may map no more memory, or open no more files, cannot reach new neighbours, nor be reached. It does not stay
/// silent: it ends, and the run with it. The same holds for the controller.
#[test]
fn processes_that_reach_nobody_any_more_end_the_run_with_the_reason() {
    let dir = tempfile::tempdir().expect("a directory");
    for (what, resource) in [("memory", Resource::As), ("files", Resource::Nofile)] {
        let run = Run::start(&dir.path().join(what), &["--time-scale", "1"]);
        agent_of_begun(&run, 0);
        let root = root_of(run.pid()).expect("it has begun");
        for module in 0..42 {
            // One may have died meanwhile.
            let Some(agent) = agent_of(&root, module, 0) else { continue };
            let statm = std::fs::read_to_string(format!("/proc/{}/statm", agent.pid)).unwrap_or_default();
            let pages =
                statm.split(' ').next().and_then(|pages| pages.parse::<u64>().ok()).unwrap_or_default();
            // SIGSEGV would end one whose stack cannot grow by a page.
            let least = if resource == Resource::As { pages * PAGE + ROOM } else { 0 };
            let least = Rlimit { current: Some(least), maximum: Some(least) };
            let _ = prlimit(Pid::from_raw(agent.pid), resource, least);
        }
        let reason = reason_of_machine(&run.end());
        // Whichever is first: a sending end that it opens, the receiving end of one that another has opened, or its heap.
        let ends =
            ["cannot reach module", "cannot receive from a sender", "aborted, because it may map no more"];
        let reached = ends.iter().any(|why| reason.contains(why));
        assert!(reached && reason.contains("ulimit"), "{what}: {reason}");
    }
}

/// A controller that may open no more files leaves nothing behind, at whatever moment it happens: the watcher removes after its
/// end the files that it could not.
#[test]
fn a_controller_without_files_leaves_nothing() {
    let dir = tempfile::tempdir().expect("a directory");
    for module in [5, 41] {
        let run = Run::start(&dir.path().join(module.to_string()), &["--time-scale", "1"]);
        let mut root = None;
        wait_until("the module", || {
            root = root_of(run.pid());
            root.as_ref().is_some_and(|root| agent_of(root, module, 0).is_some())
        });
        let root = root.expect("it was just there");
        let least = Rlimit { current: Some(8), maximum: Some(8) };
        prlimit(Pid::from_raw(run.pid()), Resource::Nofile, least).expect("it is not over");
        let ran = run.end();
        assert_ne!(ran.code, Some(0), "{ran:?}");
        wait_until("nothing to be left", || left_of(&root).is_empty());
    }
}

/// Shared memory that fills while the swarm starts ends the run in the same way.
#[test]
fn shared_memory_that_fills_during_the_start_is_named() {
    let (program, file) = (metamorph().display(), scenario("swarm.toml"));
    let script = format!(
        "timeout 200 {program} run {} --time-scale 20 --json - & pid=$!; \
         until ls /dev/shm/mm*/pids/5.0 >/dev/null 2>&1; do kill -0 $pid || exit 1; done; \
         cat /dev/zero >/dev/shm/fill 2>/dev/null; wait $pid; exit $?",
        file.display()
    );
    let Some(ran) = with_small_disk(Path::new("/dev/shm"), "24m", &script) else { return };
    let reason = reason_of_machine(&ran);
    assert!(reason.contains("shared memory"), "{reason}");
}

/// Returns true if all agents of a run are up: the memory reserved for them is released.
fn begun(root: &Path) -> bool {
    std::fs::metadata(root.join("reserve")).is_ok_and(|held| held.len() == 1 << 20)
}

/// Other users can neither read nor write the files of a run in shared memory, at any time; and no file has a
/// size without the pages for it, which would end the process that writes there when they run out.
#[test]
fn shared_memory_is_private_and_really_there() {
    for file in ["swarm.toml", "chair.toml"] {
        let file = scenario(file).display().to_string();
        let mut command = command(&["run", &file, "--time-scale", "20", "--json", "-"]);
        module_agent();
        let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        let run = Run(Some(child.expect("metamorph can be started")));
        let identity = Identity::of(run.pid()).ok().flatten().expect("it is not waited for yet");
        let name = RunDir::name_of(identity, 0);
        let (mut looks, mut segments) = (0, 0);
        while identity.is_alive() {
            let on = begun(&name.root());
            for entry in std::fs::read_dir("/dev/shm").expect("it can be listed").flatten() {
                let file = entry.file_name().to_string_lossy().into_owned();
                let Ok(found) = entry.metadata() else { continue };
                if !file.starts_with(&name.to_string()) {
                    continue;
                }
                assert_eq!(found.mode() & 0o077, 0, "{file} is {:o}", found.mode());
                // A file that an agent is just creating may still lack pages.
                let age = found.modified().ok().and_then(|at| at.elapsed().ok()).unwrap_or_default();
                if on && found.is_file() && age > Duration::from_secs(1) {
                    segments += 1;
                    assert!(found.blocks() * 512 >= found.len(), "{file} has {} pages", found.blocks() / 8);
                }
            }
            looks += 1;
        }
        assert!(looks > 10 && segments > 0, "{looks} looks at {segments} segments");
        assert_built(&run.end());
    }
}

/// A run of the command. Asked to end when it is dropped, so that it removes its files.
struct Run(Option<Child>);

impl Run {
    fn start(journal: &Path, options: &[&str]) -> Run {
        let (file, journal) = (scenario("swarm.toml").display().to_string(), journal.display().to_string());
        let fixed = ["run", file.as_str(), "--json", "-", "--journal", journal.as_str()];
        let mut command = command(&[&fixed, options].concat());
        module_agent();
        let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        Run(Some(child.expect("metamorph can be started")))
    }
    fn pid(&self) -> i32 {
        self.0.as_ref().expect("it has not been waited for").id() as i32
    }
    /// Waits for its end.
    fn end(mut self) -> Ran {
        wait_until("the run to end", || {
            let child = self.0.as_mut().expect("it has not been waited for");
            child.try_wait().expect("a child can be waited for").is_some()
        });
        let child = self.0.take().expect("it has not been waited for");
        child.wait_with_output().expect("a child can be waited for").into()
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        if let Some(mut child) = self.0.take() {
            signal_to(child.id() as i32, Signal::TERM);
            let _ = child.wait();
        }
    }
}

fn assert_built(ran: &Ran) -> Value {
    let report = report(ran);
    assert_eq!((ran.code, report["outcome"].as_str()), (Some(0), Some("built")), "{ran:?}");
    assert_eq!(report["invariants"]["broken"].as_u64(), Some(0), "{report}");
    report
}

/// Two runs at the same time do not see each other.
#[test]
fn two_runs_side_by_side_do_not_disturb_each_other() {
    let dir = tempfile::tempdir().expect("a directory");
    let journals = ["one", "two"].map(|name| dir.path().join(name));
    let [one, two] = [0, 1].map(|i| {
        let seed = (i + 1).to_string();
        Run::start(&journals[i], &["--seed", &seed, "--time-scale", "20"])
    });
    let roots = || [one.pid(), two.pid()].map(root_of);
    wait_until("both to have a place", || roots().iter().all(Option::is_some));
    let [first, second] = roots();
    assert_ne!(first, second);
    // What a new run removes of old ones does not touch those that live.
    assert_eq!(run(&["clean"]).code, Some(0));
    for (ran, journal) in [one.end(), two.end()].iter().zip(&journals) {
        let report = assert_built(ran);
        assert_eq!(notes(&report), "[]", "no foreign frames, no module lost");
        let replayed = again(journal);
        assert_eq!((replayed.difference, replayed.done.unchecked), (None, 0));
    }
}

/// A foreign process fills the inbox of a stopped module, which is then continued: all frames are refused and
/// counted, the run is built, and its journal has no trace of them.
#[test]
fn a_foreign_process_that_fills_an_inbox_changes_nothing() {
    let dir = tempfile::tempdir().expect("a directory");
    let journal = dir.path().join("journal");
    let run = Run::start(&journal, &["--time-scale", "5"]);
    let mut place = None;
    wait_until("module 20 to be there", || {
        place = root_of(run.pid()).and_then(|root| Some((agent_of(&root, 20, 0)?, root)));
        place.is_some()
    });
    let (victim, root) = place.expect("it was just there");
    let at = Rendezvous::join(&root).expect("any permitted process can join");
    let mut outbox = None;
    wait_until("its inbox to be there", || {
        outbox = Outbox::to_agent(&at, ModuleId(20), Incarnation(0)).ok();
        outbox.is_some()
    });
    let mut outbox = outbox.expect("it was just there");
    signal_to(victim.pid, Signal::STOP);
    let mut random = Rng::named(1, "garbage", 0);
    let mut written = 0;
    wait_until("the inbox to be full", || {
        let handed = (0..100)
            .map(|_| outbox.send(SharedFrame::from_bytes(std::array::from_fn(|_| random.next_u64() as u8))))
            .collect::<Vec<_>>();
        written += handed.iter().filter(|h| **h == SendStatus::Sent).count();
        handed.contains(&SendStatus::Full)
    });
    outbox.flush();
    signal_to(victim.pid, Signal::CONT);
    let report = assert_built(&run.end());
    drop((outbox, at));
    println!("{written} frames of garbage: {}", notes(&report));
    assert!(written > 10);
    let said = format!("refused {} from outside the run", many(written as u64, "frame"));
    assert!(notes(&report).contains(&said), "{report}");
    let replayed = again(&journal);
    assert_eq!(replayed.difference, None);
}
