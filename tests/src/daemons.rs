//! Host daemons on this machine, each behind a relay that can hold back what passes in either direction: swarms of processes
//! on several hosts whose hosts and cables fail.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use crate::chaos::{left_of, signal_to, wait_until};
use crate::command::command;
use metamorph_module_agent::run_dir::identity::Identity;
use metamorph_world_controller::swarm::{RunDir, clean};
use rustix::process::Signal;
use std::fs;
use std::io::{Read, Write};
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use tempfile::TempDir;

/// Times of the links between hosts in most of these tests: shorter than the default ones.
const TIMES: &str = "silent = \"1s\"\nfence = \"2s\"\n";

/// What a cable holds back: what goes to the daemon, and what comes from it.
#[derive(Debug, Default)]
pub struct Cable {
    held: Mutex<[bool; 2]>,
    changed: Condvar,
    over: AtomicBool,
}

impl Cable {
    /// Holds back each direction, or lets it pass again.
    pub fn hold(&self, to_daemon: bool, from_daemon: bool) {
        *self.held.lock().unwrap() = [to_daemon, from_daemon];
        self.changed.notify_all();
    }

    fn pass(&self, direction: usize) -> bool {
        let held = self.held.lock().unwrap();
        let is_held = |held: &mut [bool; 2]| held[direction] && !self.over.load(Ordering::Relaxed);
        drop(self.changed.wait_while(held, is_held).unwrap());
        !self.over.load(Ordering::Relaxed)
    }

    fn carry(&self, direction: usize, mut from: UnixStream, mut to: UnixStream) {
        let mut bytes = [0; 4_096];
        while let Ok(length) = from.read(&mut bytes) {
            if length == 0 || !self.pass(direction) || to.write_all(&bytes[..length]).is_err() {
                break;
            }
        }
        let _ = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
    }

    fn relay(self: &Arc<Cable>, at: &Path, to: PathBuf) {
        let (cable, listener) = (Arc::clone(self), UnixListener::bind(at).unwrap());
        std::thread::spawn(move || {
            for near in listener.incoming().map_while(Result::ok) {
                let Ok(far) = UnixStream::connect(&to) else { continue };
                for (direction, from, to) in [(0, &near, &far), (1, &far, &near)] {
                    let (cable, from) = (Arc::clone(&cable), from.try_clone().unwrap());
                    let to = to.try_clone().unwrap();
                    std::thread::spawn(move || cable.carry(direction, from, to));
                }
            }
        });
    }
}

/// Starts a daemon on a socket, and waits until it listens.
fn daemon(socket: &str) -> Child {
    let daemon = command(&["host", "--listen", socket]).stderr(Stdio::null()).spawn().unwrap();
    wait_until("a daemon to listen", || Path::new(socket).exists());
    daemon
}

/// Two daemons, h2 and h3, and the hosts file that names them. Killed when dropped.
#[derive(Debug)]
pub struct Daemons {
    directory: TempDir,
    children: Vec<Child>,
    cables: Vec<Arc<Cable>>,
}

impl Daemons {
    /// Starts the daemons, with a silence of 1 s and a fence of 2 s in the hosts file.
    pub fn start() -> Daemons {
        Daemons::with(TIMES)
    }

    /// Starts the daemons, with these times in the hosts file.
    pub fn with(times: &str) -> Daemons {
        let directory = tempfile::tempdir().unwrap();
        let mut text = format!("version = 1\n{times}[[host]]\nname = \"h1\"\naddress = \"local\"\n");
        let mut daemons = Daemons { directory, children: Vec::new(), cables: Vec::new() };
        for host in ["h2", "h3"] {
            let (socket, relay) = (daemons.path(&format!("{host}.daemon")), daemons.path(host));
            daemons.children.push(daemon(&socket));
            let cable = Arc::<Cable>::default();
            cable.relay(Path::new(&relay), PathBuf::from(socket));
            daemons.cables.push(cable);
            text += &format!("[[host]]\nname = \"{host}\"\naddress = \"unix:{relay}\"\n");
        }
        fs::write(daemons.path("hosts.toml"), text).unwrap();
        daemons
    }

    /// Kills a daemon, and starts another in its place.
    pub fn replace(&mut self, i: usize) {
        self.children[i].kill().unwrap();
        self.children[i].wait().unwrap();
        let socket = self.path(&format!("h{}.daemon", i + 2));
        fs::remove_file(&socket).unwrap();
        self.children[i] = daemon(&socket);
    }

    /// Returns the path of a file beside the hosts file.
    pub fn path(&self, name: &str) -> String {
        self.directory.path().join(name).display().to_string()
    }

    /// Returns the process of a daemon: 0 is h2.
    pub fn pid(&self, i: usize) -> i32 {
        self.children[i].id() as i32
    }

    /// Returns the identity of a daemon.
    pub fn identity(&self, i: usize) -> Identity {
        Identity::of(self.pid(i)).unwrap().unwrap()
    }

    /// Returns the cable to a daemon.
    pub fn cable(&self, i: usize) -> &Cable {
        &self.cables[i]
    }

    /// Sends a signal to a daemon.
    pub fn signal(&self, i: usize, signal: Signal) {
        signal_to(self.pid(i), signal);
    }

    /// Ends the daemons, and asserts that no file of their runs is left.
    pub fn end(mut self) {
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
        for cable in &self.cables {
            cable.over.store(true, Ordering::Relaxed);
            cable.changed.notify_all();
        }
        for child in &mut self.children {
            let _ = child.kill();
            let _ = child.wait();
        }
        let _ = clean();
    }
}

/// Returns the files that the first runs of a process have left.
pub fn left_by(process: Identity) -> Vec<PathBuf> {
    (0..4).flat_map(|n| left_of(&RunDir::name_of(process, n).root())).collect()
}
