//! The command `doctor`: what of this machine limits a swarm of processes, and how to raise it. It changes nothing.
//!
//! What a swarm needs of shared memory and descriptors is computed by the functions that `run` calls.

use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::stopwatch::wait_until;
use metamorph_console::terminal::{Channel, print_data};
use metamorph_module_agent::run_dir::run_name::HOME;
use metamorph_processes::swarm;
use metamorph_text::escape::json;
use metamorph_text::format::{bytes, count, many};
use rustix::fs::{StatVfs, statvfs};
use rustix::process::{Pid, PidfdFlags, Resource, Signal, geteuid, getrlimit, pidfd_open, pidfd_send_signal};
use serde::Serialize;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// Exit code: the swarm cannot run.
const CANNOT: u8 = 1;
/// Files in shared memory for each module; measured: 51 with 42 modules, 58 with 200.
const FILES: u64 = 60;
/// Memory for each module in bytes, as measured.
const MEMORY: u64 = 830_000;
/// Processes besides those of the modules.
const OTHER_PROCESSES: u64 = 10;
/// The share of time in which something waits for a processor, in percent, above which a swarm is slowed.
const PRESSURE: f64 = 20.0;
/// The longest time that a stopped process takes to stop.
const STOPS_WITHIN: Duration = Duration::from_secs(2);
/// Code of the file system type tmpfs, which shared memory is on (`TMPFS_MAGIC`).
const TMPFS: u64 = 0x0102_1994;

/// Arguments of `doctor`.
#[derive(Debug, Args)]
pub struct DoctorArgs {
    /// The number of modules of the swarm
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..=swarm::MODULE_LIMIT as u64))]
    pub modules: u64,
    /// Print a JSON array instead of text
    #[arg(long)]
    pub json: bool,
}

/// The result of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
enum State {
    Ok,
    Warn,
    Fail,
}

/// A check.
#[derive(Clone, Debug, Serialize)]
struct Check {
    name: &'static str,
    state: State,
    /// Measured amount, as text.
    found: String,
    /// Amount that the swarm needs, as text.
    needs: String,
    /// Consequence of a failed check and the remedy; empty if the check passed.
    otherwise: &'static str,
    fix: String,
}

impl Check {
    /// Creates a check that a measured amount reaches what is needed. An amount that cannot be measured is a
    /// warning.
    fn amount(
        name: &'static str,
        found: Option<u64>,
        needed: u64,
        shown: fn(u64) -> String,
        otherwise: &'static str,
        fix: String,
    ) -> Check {
        let state = match found {
            Some(found) if found >= needed => State::Ok,
            Some(_) => State::Fail,
            None => State::Warn,
        };
        let told = found.map_or_else(
            || "unknown".to_owned(),
            |n| if n == u64::MAX { "no limit".to_owned() } else { shown(n) },
        );
        Check { name, state, found: told, needs: shown(needed), otherwise, fix }
    }

    fn yes(
        name: &'static str,
        works: bool,
        state: State,
        found: String,
        otherwise: &'static str,
        fix: String,
    ) -> Check {
        let state = if works { State::Ok } else { state };
        Check { name, state, found, needs: "yes".to_owned(), otherwise, fix }
    }
}

/// Reports what limits a swarm. The exit code is 0 if it can run.
pub fn doctor(args: &DoctorArgs) -> u8 {
    let checks = checks(args.modules);
    let worst = checks.iter().map(|check| check.state).max().unwrap_or(State::Ok);
    if args.json {
        print_data(&(json(&checks) + "\n"));
    } else {
        let channel = Channel::Out;
        channel.say(&text(args.modules, &checks, worst));
    }
    if worst == State::Fail { CANNOT } else { 0 }
}

fn text(modules: u64, checks: &[Check], worst: State) -> String {
    let mut text = String::new();
    for check in checks {
        let state = match check.state {
            State::Ok => "ok",
            State::Warn => "warn",
            State::Fail => "FAIL",
        };
        text.push_str(&format!(
            "  {state:<5} {:<22} {:<16} needs {}\n",
            check.name, check.found, check.needs
        ));
        if check.state != State::Ok {
            text.push_str(&format!("        {}\n        fix: {}\n", check.otherwise, check.fix));
        }
    }
    let modules = count(modules);
    text.push_str(&match worst {
        State::Ok => format!("a swarm of {modules} modules can run here\n"),
        State::Warn => format!("a swarm of {modules} modules can run here, with the warnings above\n"),
        State::Fail => format!("a swarm of {modules} modules cannot run here\n"),
    });
    text
}

fn checks(modules: u64) -> Vec<Check> {
    let contained = ["/.dockerenv", "/run/.containerenv"].iter().any(|path| Path::new(path).exists());
    let mut checks = shared_memory(modules, contained);
    checks.push(descriptors(modules, contained));
    checks.push(processes(modules, contained));
    checks.push(memory(modules));
    checks.extend(processors());
    checks.push(process_control());
    checks.push(leftovers());
    checks.push(own_program());
    checks
}

fn shared_memory(modules: u64, contained: bool) -> Vec<Check> {
    let home: Option<StatVfs> = statvfs(HOME).ok();
    let needed = swarm::shared_memory_needed(modules);
    let size = needed.div_ceil(1 << 20).next_power_of_two();
    let larger = match contained {
        true => format!("start the container with --shm-size={size}m"),
        false => format!("mount -o remount,size={size}m {HOME}"),
    };
    let free = home.as_ref().map(|home| home.f_bavail.saturating_mul(home.f_frsize));
    // A file system without a limit of files says 0.
    let files = home.map(|home| if home.f_files == 0 { u64::MAX } else { home.f_favail });
    let kind = rustix::fs::statfs(HOME).ok().map(|home| home.f_type as u64);
    let writable = tempfile::Builder::new().prefix(".metamorph-doctor-").tempfile_in(HOME).is_ok();
    vec![
        Check::yes(
            "shared memory",
            writable && kind == Some(TMPFS),
            if writable { State::Warn } else { State::Fail },
            match (writable, kind == Some(TMPFS)) {
                (true, true) => "a writable tmpfs",
                (true, false) => "not a tmpfs",
                (false, _) => "not writable",
            }
            .to_owned(),
            "channels between processes are files in it; on a disk they would be slow, and without it there are none",
            format!("mount -t tmpfs -o mode=1777 tmpfs {HOME}"),
        ),
        Check::amount("shared memory, free", free, needed, bytes, "`run` refuses to start", larger),
        Check::amount(
            "shared memory, files",
            files,
            modules * FILES,
            count,
            "agents could not create their channels",
            format!("mount -o remount,nr_inodes={} {HOME}", (modules * FILES).next_power_of_two()),
        ),
    ]
}

fn descriptors(modules: u64, contained: bool) -> Check {
    let needed = swarm::descriptors_needed(modules);
    let fix = match contained {
        true => format!("start the container with --ulimit nofile={needed}"),
        false => format!("ulimit -Hn {needed} as root, or LimitNOFILE={needed} in the unit of the service"),
    };
    let (found, _) = swarm::descriptor_limit();
    Check::amount("open files, hard limit", Some(found), needed, count, "`run` refuses to start", fix)
}

/// Returns the number in the first line of a file; `max` is no limit.
fn limit_in(path: &Path) -> Option<u64> {
    match fs::read_to_string(path).ok()?.trim() {
        "max" => Some(u64::MAX),
        number => number.parse().ok(),
    }
}

/// A limit of control groups.
struct GroupLimit {
    /// The controller of version 1 that has it, with its files for the limit and for what is used.
    v1: (&'static str, &'static str, &'static str),
    /// The files of version 2.
    v2: (&'static str, &'static str),
}

const GROUP_PROCESSES: GroupLimit =
    GroupLimit { v1: ("pids", "pids.max", "pids.current"), v2: ("pids.max", "pids.current") };
const GROUP_MEMORY: GroupLimit = GroupLimit {
    v1: ("memory", "memory.limit_in_bytes", "memory.usage_in_bytes"),
    v2: ("memory.max", "memory.current"),
};

/// Returns the smallest limit in the control groups of this process, less what is used of it.
fn group_limit(limit: &GroupLimit, groups: &str, mounts: &Path) -> Option<u64> {
    let own = |begin: &dyn Fn(&str) -> bool| {
        groups.lines().find_map(|line| {
            let (_, rest) = line.split_once(':')?;
            let (controllers, path) = rest.split_once(':')?;
            begin(controllers).then(|| path.trim_start_matches('/').to_owned())
        })
    };
    let of_v1 = own(&|controllers| controllers.split(',').any(|one| one == limit.v1.0));
    let of_v1 = of_v1.and_then(|own| least_of(&mounts.join(limit.v1.0), &own, (limit.v1.1, limit.v1.2)));
    let of_v2 = own(&|controllers| controllers.is_empty()).and_then(|own| least_of(mounts, &own, limit.v2));
    of_v1.into_iter().chain(of_v2).min()
}

/// Returns the smallest limit from a group up to the root of its hierarchy. A container may see its own group as the root.
fn least_of(root: &Path, own: &str, (limit, used): (&str, &str)) -> Option<u64> {
    let inside = root.join(own);
    let mut group: PathBuf = if inside.is_dir() { inside } else { root.to_owned() };
    let mut least = None;
    loop {
        if let Some(most) = limit_in(&group.join(limit)) {
            let left = match most {
                u64::MAX => u64::MAX,
                most => most.saturating_sub(limit_in(&group.join(used)).unwrap_or(0)),
            };
            least = Some(least.unwrap_or(u64::MAX).min(left));
        }
        if group == root || !group.pop() {
            return least;
        }
    }
}

/// Returns the smallest limit in the control groups of this process.
fn own_limit(limit: &GroupLimit) -> Option<u64> {
    let groups = fs::read_to_string("/proc/self/cgroup").ok()?;
    group_limit(limit, &groups, Path::new("/sys/fs/cgroup"))
}

fn processes(modules: u64, contained: bool) -> Check {
    let of_user = match geteuid().is_root() {
        true => u64::MAX,
        false => getrlimit(Resource::Nproc).current.unwrap_or(u64::MAX),
    };
    let of_group = own_limit(&GROUP_PROCESSES).unwrap_or(u64::MAX);
    let of_machine = limit_in(Path::new("/proc/sys/kernel/pid_max")).unwrap_or(u64::MAX);
    let needed = modules + OTHER_PROCESSES;
    let fix = match (contained, of_group.min(of_user).min(of_machine)) {
        (true, _) => format!("start the container with --pids-limit={}", needed * 2),
        (false, least) if least == of_machine => format!("sysctl kernel.pid_max={}", needed * 4),
        (false, least) if least == of_user => format!("ulimit -u {}", needed * 2),
        (false, _) => format!("TasksMax={} in the unit of the service", needed * 2),
    };
    let found = of_user.min(of_group).min(of_machine);
    Check::amount("processes", Some(found), needed, count, "agents could not be started", fix)
}

fn memory(modules: u64) -> Check {
    let available = fs::read_to_string("/proc/meminfo").ok().and_then(|text| {
        let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
        Some(line.trim().trim_end_matches("kB").trim().parse::<u64>().ok()? << 10)
    });
    let of_group = own_limit(&GROUP_MEMORY).unwrap_or(u64::MAX);
    let found = available.map(|available| available.min(of_group));
    let fix = "use fewer modules, --link sim, or a machine or a container with more memory".to_owned();
    Check::amount("memory", found, modules * MEMORY, bytes, "the system would kill processes", fix)
}

fn processors() -> Vec<Check> {
    let found = std::thread::available_parallelism().map_or(1, |n| n.get() as u64);
    let slow = "the controller slows the clock of the run, so that load does not look like a failure";
    let mut few =
        Check::amount("processors", Some(found), 2, count, slow, "allow more processors".to_owned());
    few.state = few.state.min(State::Warn);
    let pressure = fs::read_to_string("/proc/pressure/cpu").ok().and_then(|text| {
        let average = text.lines().next()?.split(' ').find_map(|word| word.strip_prefix("avg10="))?;
        average.parse::<f64>().ok()
    });
    let waits = Check {
        name: "pressure on processors",
        state: if pressure.is_some_and(|p| p > PRESSURE) { State::Warn } else { State::Ok },
        found: pressure.map_or_else(|| "unknown".to_owned(), |p| format!("{p:.0}%")),
        needs: format!("at most {PRESSURE:.0}%"),
        otherwise: slow,
        fix: "end other programs, or use --link sim".to_owned(),
    };
    vec![few, waits]
}

/// Returns whether a child can be held by a descriptor and stopped, as faults of a run do.
fn process_control() -> Check {
    let refused = stop_a_child().err();
    let works = refused.is_none();
    let found = refused.map_or_else(|| "allowed".to_owned(), |error| format!("refused: {error}"));
    let fix = "allow pidfd_open and kill in the seccomp profile; the former needs Linux 5.3".to_owned();
    Check::yes(
        "control of processes",
        works,
        State::Fail,
        found,
        "agents could not be supervised or paused",
        fix,
    )
}

/// Starts a child, stops it, and ends it.
fn stop_a_child() -> io::Result<()> {
    let mut child = Command::new("sleep").arg("10").stdin(Stdio::null()).spawn()?;
    let stopped = stop(&child);
    child.kill()?;
    child.wait()?;
    stopped
}

/// Opens a descriptor of a child, and stops it by a signal.
fn stop(child: &Child) -> io::Result<()> {
    let fd = pidfd_open(Pid::from_child(child), PidfdFlags::empty())?;
    pidfd_send_signal(&fd, Signal::STOP)?;
    let stops = wait_until(STOPS_WITHIN, || is_stopped(child.id()));
    if stops { Ok(()) } else { Err(io::Error::other("the child does not stop")) }
}

/// Returns true if a process is stopped by a signal.
fn is_stopped(pid: u32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.rsplit_once(") ").is_some_and(|(_, rest)| rest.starts_with('T'))
}

fn leftovers() -> Check {
    let found = swarm::leftovers().map(|runs| runs as u64);
    let shown = match &found {
        Ok(runs) => many(*runs, "dead run"),
        Err(error) => format!("unknown: {error}"),
    };
    Check {
        name: "leftovers",
        state: if matches!(found, Ok(0)) { State::Ok } else { State::Warn },
        found: shown,
        needs: "none".to_owned(),
        otherwise: "killed runs left shared memory and processes behind",
        fix: "metamorph clean".to_owned(),
    }
}

fn own_program() -> Check {
    let works = std::env::current_exe().is_ok_and(|program| fs::File::open(program).is_ok());
    let found = if works { "found" } else { "gone" };
    let fix = "start metamorph again: its file was replaced while it ran".to_owned();
    Check::yes("own program", works, State::Fail, found.to_owned(), "agents are this program", fix)
}

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph doctor
  metamorph doctor --modules 1058
  metamorph doctor --json | jq '.[] | select(.state != \"ok\")'

Nothing is changed. What a swarm needs is computed as `run` does.

Exit codes:
  0  a swarm of this size can run
  1  it cannot; the lines with FAIL say what to change";

/// The command.
pub static COMMAND: CommandOf<DoctorArgs> = CommandOf {
    name: "doctor",
    group: Some(Group::Machine),
    about: "Check what of this machine limits a swarm of processes, and how to raise it",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, _| Ok(doctor(&args)),
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_fails_and_says_what_to_do() {
        let check = |found| Check::amount("x", found, 100, count, "it breaks", "do that".to_owned());
        assert_eq!(check(Some(100)).state, State::Ok);
        assert_eq!((check(Some(99)).state, check(None).state), (State::Fail, State::Warn));
        assert_eq!(check(Some(u64::MAX)).found, "no limit");
        let told = text(5, &[check(Some(1))], State::Fail);
        assert!(told.contains("FAIL  x") && told.contains("it breaks\n        fix: do that"), "{told}");
    }

    /// More modules need more of everything that is counted.
    #[test]
    fn needs_grow_with_the_swarm() {
        let counted =
            |modules| -> Vec<String> { checks(modules).into_iter().map(|check| check.needs).collect() };
        let (few, many) = (counted(10), counted(10_000));
        assert_eq!(few.len(), many.len());
        assert_eq!(few.iter().zip(&many).filter(|(a, b)| a != b).count(), 5);
    }

    #[test]
    fn limits_of_both_versions_of_control_groups_are_found() {
        let mounts = tempfile::tempdir().unwrap();
        let write = |path: &str, text: &str| {
            let path = mounts.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        write("pids/a/pids.max", "max\n");
        write("pids/a/b/pids.max", "100\n");
        write("pids/a/b/pids.current", "30\n");
        let limit = |limit, groups| group_limit(limit, groups, mounts.path());
        assert_eq!(limit(&GROUP_PROCESSES, "4:cpu,pids:/a/b\n0::/\n"), Some(70));
        assert_eq!(limit(&GROUP_MEMORY, "4:cpu,pids:/a/b\n0::/\n"), None);
        write("c/memory.max", "1000\n");
        assert_eq!(limit(&GROUP_MEMORY, "0::/c\n"), Some(1000));
        // Within a container, the own group is mounted as the root.
        write("memory/memory.limit_in_bytes", "4096\n");
        write("memory/memory.usage_in_bytes", "96\n");
        assert_eq!(limit(&GROUP_MEMORY, "9:memory:/docker/0123\n"), Some(4000));
    }
}
