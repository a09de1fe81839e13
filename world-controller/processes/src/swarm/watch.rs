//! The watcher: a process that cleans up after a killed controller. It waits until a pipe closes whose other
//! end only the controller holds. Unless the controller has reported that everything is removed, the watcher
//! then reports the controller's death and removes everything.
//!
//! A controller gets SIGBUS when it writes to shared memory that has run out. The pipe reports it too, and
//! the controller ends with an exit code of its own. Not here: runs whose agents wait to be taken over by
//! `metamorph resume`; those are left alone.

use crate::swarm::run_dir::{clean, owner, waits_for_controller};
use metamorph_console::terminal::print_error;
use metamorph_module_agent::run_dir::run_name::HOME;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{PidfdFlags, pidfd_open};
use signal_hook::consts::{SIGBUS, SIGHUP, SIGINT, SIGTERM};
use signal_hook::{SigId, flag, low_level};
use std::ffi::OsString;
use std::io::{self, Read};
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// The name of the hidden subcommand.
pub const SUBCOMMAND: &str = "watch-run";
/// Code that a controller sends when it has removed everything.
const DONE: u8 = b'.';
/// Code that a controller sends when it cannot remove what is left of the run.
const LEFT: u8 = b'!';
/// The exit code of a controller that got SIGBUS: the program itself failed.
const FAILED: i32 = 1;
/// Longest time that the watcher waits for the controller's process to disappear after its files are closed (s).
const DYING_MAX: i64 = 5;

/// The controller's end of the pipe.
#[derive(Debug)]
pub struct Watch {
    child: Child,
    pipe: OwnedFd,
    handlers: Vec<SigId>,
    /// Whether nothing is left to be removed.
    is_done: bool,
}

impl Watch {
    /// Starts the watcher of the run in `root`.
    ///
    /// # Errors
    /// If the pipe or the process cannot be created.
    pub fn start(program: &Path, args: &[OsString], root: &Path) -> io::Result<Watch> {
        let mut child = Command::new(program)
            .args(args)
            .arg(root)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            // Ctrl-C reaches only the controller.
            .process_group(0)
            .spawn()?;
        let pipe = child.stdin.take().ok_or_else(|| io::Error::other("it has no standard input"))?;
        let mut watch = Watch { child, pipe: pipe.into(), handlers: Vec::new(), is_done: true };
        let copy = watch.pipe.try_clone()?;
        // In this order: the second handler ends the process.
        watch.handlers.push(low_level::pipe::register(SIGBUS, copy)?);
        let always = Arc::new(AtomicBool::new(true));
        watch.handlers.push(flag::register_conditional_shutdown(SIGBUS, FAILED, always)?);
        Ok(watch)
    }
}

impl Watch {
    /// Lets the watcher remove what is left of the run, after this process has ended.
    pub fn hand_over(mut self) {
        self.is_done = false;
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        for handler in self.handlers.drain(..) {
            low_level::unregister(handler);
        }
        // Without a watcher there is nothing to report.
        let _ = rustix::io::write(&self.pipe, &[if self.is_done { DONE } else { LEFT }]);
        if self.is_done {
            let _ = self.child.wait();
        }
    }
}

/// Waits for the end of the controller of the run in `root`, which is the parent of this process, and removes
/// what it has left.
///
/// # Errors
/// If the leftovers cannot be removed.
pub fn watch(root: &Path) -> io::Result<()> {
    // A service or a container ends all of its processes together; this one has to outlast the others.
    for signal in [SIGHUP, SIGINT, SIGTERM] {
        flag::register(signal, Arc::default())?;
    }
    let controller = owner(root).and_then(|owner| owner.as_pid());
    let controller = controller.and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok());
    let mut last = None;
    for said in io::stdin().lock().bytes() {
        match said? {
            DONE => return Ok(()),
            other => last = Some(other),
        }
    }
    if let Some(controller) = controller {
        let limit = Timespec { tv_sec: DYING_MAX, tv_nsec: 0 };
        poll(&mut [PollFd::new(&controller, PollFlags::IN)], Some(&limit))?;
    }
    let why = match last {
        None => "was killed".to_owned(),
        Some(LEFT) => "could not remove its files".to_owned(),
        Some(_) => format!(
            "died of SIGBUS: shared memory ({HOME}) is full (mount -o remount,size=..., docker: --shm-size)"
        ),
    };
    if waits_for_controller(root) {
        print_error(&format!("metamorph: the controller {why}; its agents wait for `metamorph resume`"));
        return Ok(());
    }
    let removed = clean().map_err(io::Error::other)?;
    print_error(&format!(
        "metamorph: the controller {why}; what it left is removed: {} processes, {} files of shared memory",
        removed.agents_killed, removed.files
    ));
    Ok(())
}
