//! Hostile inputs: a directory with files of every kind, a command in it, and the conditions that must hold
//! for all inputs. Not here: the inputs themselves.
//!
//! The conditions: the command ends in time with a documented exit code, does not panic, gets by with
//! [`MOST_MEMORY_KB`] of address space, creates and changes only the files that it was asked to write, prints
//! no control character, and leaves nothing in /dev/shm.

use crate::command::metamorph;
use metamorph_module_agent::run_dir::identity::Identity;
use rustix::fs::{CWD, FileType, Mode, mknodat};
use rustix::process::Signal;
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::fs;
use std::os::unix::ffi::OsStringExt;
use std::os::unix::fs::symlink;
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::time::Duration;
use tempfile::TempDir;

/// The largest address space of a command, in KiB.
pub const MOST_MEMORY_KB: u64 = 512 << 10;
/// The longest duration of a command. Machines that build at the same time are slow.
const WATCHDOG: Duration = Duration::from_secs(120);

/// An entry in the directory of a case.
#[derive(Clone, Debug)]
pub enum Thing {
    /// A regular file.
    File(Arc<[u8]>),
    /// A directory.
    Directory,
    /// A named pipe that no program writes to.
    Pipe,
    /// A socket.
    Socket,
    /// A symbolic link to this path.
    Link(&'static str),
    /// A second name of this file.
    HardLink(&'static str),
}

/// Returns a regular file with this content.
pub fn file(content: impl AsRef<[u8]>) -> Thing {
    Thing::File(content.as_ref().into())
}

/// The destination of standard output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Out {
    /// To the test.
    Test,
    /// To a full disk.
    Full,
}

/// A command in a directory with files.
#[derive(Clone, Debug)]
pub struct Case {
    /// The entries by name, created in this order.
    pub things: Vec<(OsString, Thing)>,
    /// The arguments.
    pub args: Vec<OsString>,
    /// The destination of standard output.
    pub out: Out,
    /// The accepted exit codes; if empty, every documented one.
    pub codes: Vec<i32>,
    /// The words that standard error must contain.
    pub says: Vec<&'static str>,
    /// The files that the command may create or change.
    pub makes: Vec<&'static str>,
}

impl Case {
    /// Creates a case without files.
    pub fn new<S: AsRef<[u8]>>(args: &[S]) -> Case {
        let word = |word: &S| OsString::from_vec(word.as_ref().to_vec());
        Case {
            things: Vec::new(),
            args: args.iter().map(word).collect(),
            out: Out::Test,
            codes: Vec::new(),
            says: Vec::new(),
            makes: Vec::new(),
        }
    }
    /// Adds an entry to the directory.
    #[must_use]
    pub fn with(mut self, name: impl AsRef<[u8]>, thing: Thing) -> Case {
        self.things.push((OsString::from_vec(name.as_ref().to_vec()), thing));
        self
    }
    /// Expects a refusal with these words.
    #[must_use]
    pub fn refused(mut self, says: &[&'static str]) -> Case {
        self.codes = vec![2];
        self.says.extend(says);
        self
    }
    /// Expects one of these exit codes.
    #[must_use]
    pub fn ends(mut self, codes: &[i32]) -> Case {
        self.codes = codes.to_vec();
        self
    }
    /// Lets the command write this file.
    #[must_use]
    pub fn makes(mut self, name: &'static str) -> Case {
        self.makes.push(name);
        self
    }
    /// Sends standard output to a full disk.
    #[must_use]
    pub fn full(mut self) -> Case {
        self.out = Out::Full;
        self.ends(&[1]).says("standard output could not be written")
    }
    fn says(mut self, words: &'static str) -> Case {
        self.says.push(words);
        self
    }

    fn prepare(&self, directory: &Path) -> Vec<UnixListener> {
        let mut sockets = Vec::new();
        for (name, thing) in &self.things {
            let path = directory.join(name);
            let made = match thing {
                Thing::File(content) => fs::write(&path, content),
                Thing::Directory => fs::create_dir(&path),
                Thing::Pipe => {
                    mknodat(CWD, &path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).map_err(Into::into)
                }
                Thing::Socket => UnixListener::bind(&path).map(|socket| sockets.push(socket)),
                Thing::Link(to) => symlink(to, &path),
                Thing::HardLink(to) => fs::hard_link(directory.join(to), &path),
            };
            made.unwrap_or_else(|error| panic!("{path:?} cannot be made: {error}"));
        }
        sockets
    }
}

/// Runs all cases, on all processors, and reports each that violates a condition.
pub fn run_all(cases: &[Case]) {
    let documented = documented_codes();
    let (next, wrong) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let pids = Mutex::new(BTreeSet::new());
    std::thread::scope(|threads| {
        for _ in 0..std::thread::available_parallelism().map_or(2, Into::into) {
            threads.spawn(|| {
                while let Some(case) = cases.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let complaints = check(case, &documented, &pids);
                    if !complaints.is_empty() {
                        let mut all = wrong.lock().expect("no thread panicked with it");
                        all.push(format!("{:?}\n  {}", case.args, complaints.join("\n  ")));
                    }
                }
            });
        }
    });
    let mut wrong = wrong.into_inner().expect("no thread panicked with it");
    let left = runs_of(&pids.into_inner().expect("no thread panicked with it"));
    wrong.extend(left.iter().map(|root| format!("{} was left behind", root.display())));
    assert!(wrong.is_empty(), "{} of {} cases:\n{}", wrong.len(), cases.len(), wrong.join("\n"));
}

/// Returns the conditions that a case violates.
fn check(case: &Case, documented: &BTreeSet<i32>, pids: &Mutex<BTreeSet<i32>>) -> Vec<String> {
    let directory = TempDir::new().expect("a directory");
    let _sockets = case.prepare(directory.path());
    let before = snapshot(directory.path(), &case.makes);
    let Some(ran) = run(case, directory.path(), pids) else {
        return vec![format!("was not over after {WATCHDOG:?}")];
    };
    let mut wrong = Vec::new();
    let code = ran.code.unwrap_or(-1);
    let right = if case.codes.is_empty() { documented.contains(&code) } else { case.codes.contains(&code) };
    if !right || ran.err.contains("panicked") || ran.err.contains("memory allocation") {
        let wanted =
            if case.codes.is_empty() { documented.iter().copied().collect() } else { case.codes.clone() };
        wrong.push(format!("exit code {:?}, not one of {wanted:?}: {}", ran.code, short(&ran.err)));
    }
    for words in case.says.iter().filter(|words| !ran.err.contains(**words)) {
        wrong.push(format!("does not say `{words}`: {}", short(&ran.err)));
    }
    if code == 2 && !ran.err.contains("fix: ") && !ran.err.contains("--help") && !ran.err.contains("tip: ") {
        wrong.push(format!("names no fix: {}", short(&ran.err)));
    }
    let is_control =
        |c: char| (c.is_control() && !matches!(c, '\n' | '\t')) || ('\u{202a}'..='\u{202e}').contains(&c);
    for (name, text) in [("output", &ran.out), ("error", &ran.err)] {
        if text.contains(is_control) {
            wrong.push(format!("prints control characters on standard {name}: {:?}", short(text)));
        }
    }
    let after = snapshot(directory.path(), &case.makes);
    for name in before.keys().chain(after.keys()).collect::<BTreeSet<_>>() {
        if before.get(name) != after.get(name) {
            let what = match (before.contains_key(name), after.contains_key(name)) {
                (true, true) => "was changed",
                (true, false) => "is gone",
                _ => "is new",
            };
            wrong.push(format!("{} {what}", name.display()));
        }
    }
    wrong
}

struct Ran {
    code: Option<i32>,
    out: String,
    err: String,
}

fn run(case: &Case, directory: &Path, pids: &Mutex<BTreeSet<i32>>) -> Option<Ran> {
    // The shell becomes the command, so its pid is that of the command.
    let mut command = Command::new("sh");
    command.arg("-c").arg(format!("ulimit -v {MOST_MEMORY_KB}; exec \"$0\" \"$@\""));
    command.arg(metamorph()).args(&case.args).current_dir(directory);
    command.env_remove("METAMORPH_LOG").env_remove("NO_COLOR").stdin(Stdio::null()).stderr(Stdio::piped());
    match case.out {
        Out::Test => command.stdout(Stdio::piped()),
        Out::Full => command.stdout(fs::File::options().write(true).open("/dev/full").expect("it is there")),
    };
    let child = command.spawn().expect("a shell can be started");
    let pid = child.id() as i32;
    pids.lock().expect("no thread panicked with it").insert(pid);
    let (sender, ended) = mpsc::channel();
    std::thread::spawn(move || sender.send(child.wait_with_output()));
    let Ok(output) = ended.recv_timeout(WATCHDOG) else {
        crate::chaos::signal_to(pid, Signal::KILL);
        return None;
    };
    let output = output.expect("a child can be waited for");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    Some(Ran { code: output.status.code(), out: text(&output.stdout), err: text(&output.stderr) })
}

/// Returns all entries in a directory and below, except these files: kinds, permissions and contents.
fn snapshot(directory: &Path, except: &[&str]) -> BTreeMap<PathBuf, (fs::Permissions, Vec<u8>)> {
    let mut all = BTreeMap::new();
    for entry in fs::read_dir(directory).expect("it can be listed").flatten() {
        let path = entry.path();
        let facts = fs::symlink_metadata(&path).expect("it is there");
        if except.iter().any(|name| path.ends_with(name)) {
            continue;
        }
        let content = match facts.file_type() {
            kind if kind.is_file() => fs::read(&path).expect("it can be read"),
            kind if kind.is_symlink() => fs::read_link(&path).expect("it is one").into_os_string().into_vec(),
            kind if kind.is_dir() => {
                all.extend(snapshot(&path, except));
                Vec::new()
            }
            kind => format!("{kind:?}").into_bytes(),
        };
        all.insert(path, (facts.permissions(), content));
    }
    all
}

/// Returns the exit codes that the help of commands names.
fn documented_codes() -> BTreeSet<i32> {
    let of = |name: &str| {
        let help = crate::command::run(&[name, "--help"]).out;
        let codes = help.lines().filter_map(|line| {
            let (code, about) = line.strip_prefix("  ")?.split_once("  ")?;
            (!about.starts_with(' ')).then(|| code.parse::<i32>().ok())?
        });
        codes.collect::<Vec<_>>()
    };
    let codes: BTreeSet<i32> =
        ["run", "replay", "sweep", "shape", "explore"].into_iter().flat_map(of).collect();
    assert!(codes.contains(&0) && codes.contains(&8) && codes.len() > 7, "{codes:?}");
    codes
}

/// Returns the directories of runs that were controlled by one of these processes.
fn runs_of(pids: &BTreeSet<i32>) -> Vec<PathBuf> {
    let owner = |root: &Path| fs::read_to_string(root.join("owner")).ok()?.parse::<Identity>().ok();
    let roots = fs::read_dir("/dev/shm").expect("it can be listed").flatten().map(|e| e.path());
    roots.filter(|root| owner(root).is_some_and(|owner| pids.contains(&owner.pid))).collect()
}

fn short(text: &str) -> String {
    text.chars().take(300).collect()
}
