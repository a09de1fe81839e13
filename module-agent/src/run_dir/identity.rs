//! The identity of a process, and whether it is alive.
//!
//! A pid alone does not identify a process, because pids are reused; together with the start time it does.

use rustix::process::{Pid, getpid, getppid};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io;
use std::str::FromStr;
use std::sync::Arc;

/// Identifies one process among all that have run on this machine since its last boot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// The process id.
    pub pid: i32,
    /// The time of its start, in clock ticks since boot.
    pub start: u64,
}

impl Identity {
    /// Returns the identity of this process.
    ///
    /// # Errors
    /// If the process cannot be inspected.
    pub fn own() -> io::Result<Identity> {
        let pid = getpid().as_raw_nonzero().get();
        Identity::of(pid)?.ok_or_else(|| io::Error::other("this process is not in /proc; is /proc mounted?"))
    }

    /// Returns the process that has this pid now; `None` if there is none.
    ///
    /// # Errors
    /// If the process cannot be inspected.
    pub fn of(pid: i32) -> io::Result<Option<Identity>> {
        match stat(pid) {
            Ok(stat) => Ok(start_time(&stat).map(|start| Identity { pid, start })),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
            // ESRCH: the process ended during the read.
            Err(e) if e.raw_os_error() == Some(rustix::io::Errno::SRCH.raw_os_error()) => Ok(None),
            Err(e) => Err(e),
        }
    }

    /// True if this very process is alive. A zombie, for which its parent has not waited yet, is not. A
    /// process that cannot be inspected belongs to another user and counts as alive.
    pub fn is_alive(&self) -> bool {
        match stat(self.pid) {
            Ok(stat) => start_time(&stat) == Some(self.start) && !matches!(state(&stat), Some('Z' | 'X')),
            Err(e) => {
                e.kind() != io::ErrorKind::NotFound
                    && e.raw_os_error() != Some(rustix::io::Errno::SRCH.raw_os_error())
            }
        }
    }

    /// True if this very process is alive and stopped by a signal.
    pub fn is_stopped(&self) -> bool {
        let stat = stat(self.pid).unwrap_or_default();
        start_time(&stat) == Some(self.start) && state(&stat) == Some('T')
    }

    /// Returns the pid as the type that system calls take.
    pub fn as_pid(&self) -> Option<Pid> {
        Pid::from_raw(self.pid)
    }

    /// Returns the identity as one line of text, the inverse of parsing it.
    pub fn to_line(&self) -> String {
        format!("{} {}\n", self.pid, self.start)
    }
}

/// Reads what the kernel says of a process. The name of its program in it may be any bytes.
fn stat(pid: i32) -> io::Result<String> {
    Ok(String::from_utf8_lossy(&fs::read(format!("/proc/{pid}/stat"))?).into_owned())
}

impl FromStr for Identity {
    type Err = ();
    /// Parses the first line; the lines after it belong to other formats.
    fn from_str(text: &str) -> Result<Identity, ()> {
        let (pid, start) = text.lines().next().and_then(|line| line.split_once(' ')).ok_or(())?;
        let identity = Identity { pid: pid.parse().map_err(drop)?, start: start.parse().map_err(drop)? };
        if identity.pid > 0 { Ok(identity) } else { Err(()) }
    }
}

/// Returns the fields after the command name, which may itself contain spaces and brackets.
fn fields(stat: &str) -> Option<std::str::SplitAsciiWhitespace<'_>> {
    Some(stat.rsplit_once(')')?.1.split_ascii_whitespace())
}
fn state(stat: &str) -> Option<char> {
    fields(stat)?.next()?.chars().next()
}
fn start_time(stat: &str) -> Option<u64> {
    // Field 22 of the whole line; the state, field 3, is the first after the name.
    fields(stat)?.nth(22 - 3)?.parse().ok()
}

/// Makes a write beyond the limit of file sizes (`ulimit -f`) fail with EFBIG; without this, SIGXFSZ would
/// end the process. Programs that this process starts keep the default behaviour.
///
/// # Errors
/// If the signal handler cannot be installed.
pub fn survive_file_limits() -> io::Result<()> {
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default()).map(drop)
}

/// Tells an agent process whether its controller is gone.
#[derive(Clone, Copy, Debug)]
pub struct Guard {
    controller: Identity,
    is_parent: bool,
    is_signalled: bool,
}

impl Guard {
    /// Creates the guard of a process whose controller is `controller`. If that is the parent of this process
    /// and `may_outlive` is false, also asks the kernel to kill this process when its parent dies. That does
    /// not help if the parent died just before or is not the controller (a debugger, a wrapper), so the
    /// controller is watched as well.
    pub fn new(controller: Identity, may_outlive: bool) -> Guard {
        let is_parent = getppid().map(|p| p.as_raw_nonzero().get()) == Some(controller.pid);
        let death = Some(rustix::process::Signal::KILL);
        let is_signalled = is_parent
            && !may_outlive
            && rustix::process::set_parent_process_death_signal(death)
                .inspect_err(|e| {
                    tracing::warn!(
                        "no signal when the controller dies ({e}); it is looked for once a second"
                    );
                })
                .is_ok();
        Guard { controller, is_parent, is_signalled }
    }

    /// True if the kernel ends this process with its controller, so that watching is only a precaution.
    pub fn is_signalled(&self) -> bool {
        self.is_signalled
    }

    /// True if the controller is gone, so that this process must end.
    pub fn controller_is_gone(&self) -> bool {
        if self.is_parent {
            getppid().map(|p| p.as_raw_nonzero().get()) != Some(self.controller.pid)
        } else {
            !self.controller.is_alive()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn knows_itself_and_strangers() {
        let me = Identity::own().unwrap();
        assert!(me.is_alive());
        assert!(!Identity { start: me.start + 1, ..me }.is_alive(), "a recycled pid is someone else");
        assert_eq!(me.to_line().parse(), Ok(me));
        assert_eq!((me.to_line() + "17\n").parse(), Ok(me));
        for bad in ["", "1", "0 5", "-3 5", "x y", "1 2 3"] {
            assert_eq!(bad.parse::<Identity>(), Err(()), "{bad}");
        }
    }

    #[test]
    fn reads_awkward_names() {
        let stat = "42 (a) R (b) S 1 42 42 0 -1 4 1 0 0 0 0 0 0 0 20 0 1 0 777 1 1";
        assert_eq!((state(stat), start_time(stat)), (Some('S'), Some(777)));
        assert_eq!(start_time("42 no brackets"), None);
    }
}
