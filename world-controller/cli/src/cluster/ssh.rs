//! Daemons on machines that are reached over `ssh`: the program of the system, so that its configuration, agents and jump hosts
//! work. Each machine has a directory of its own below the home directory there.

use super::{ClusterError, metrics_of, on_network};
use metamorph_processes::swarm::HostsFile;
use metamorph_protocol::ids::HostId;
use metamorph_text::version::version;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;

/// The directory of the daemons of a machine, below the home directory.
const PLACE: &str = ".local/share/metamorph/cluster";
/// Options that keep ssh from asking, and from waiting for long.
const OPTIONS: [&str; 4] = ["-o", "BatchMode=yes", "-o", "ConnectTimeout=10"];

/// A function of the shell: true if the daemon runs that was started last.
const RUNS: &str = "runs() { [ -f pid ] && [ \"$(readlink \"/proc/$(cat pid)/exe\" | sed 's/ (deleted)$//')\" = \"$(pwd -P)/metamorph\" ]; }";

/// A machine with a daemon.
#[derive(Debug)]
pub struct Machine {
    host: HostId,
    /// The machine as ssh knows it.
    login: String,
    /// The address on which the daemon listens.
    address: String,
    /// The options with which it serves metrics.
    metrics: Vec<String>,
}

/// Returns the machines of a hosts file, on which daemons serve metrics at a port.
pub fn machines(file: &Path, hosts: &HostsFile, metrics: Option<u16>) -> Result<Vec<Machine>, ClusterError> {
    let each = (1u16..).map(HostId).zip(hosts.addresses.iter().zip(&hosts.ssh));
    let mut machines: Vec<Machine> = Vec::new();
    for (host, (address, ssh)) in each {
        let (machine, _) = on_network(file, host, address)?;
        let metrics = metrics_of(&machine, metrics);
        if let Some(other) = machines.iter().find(|other| !metrics.is_empty() && other.metrics == metrics) {
            return Err(ClusterError::OnePort(other.host, host, machine));
        }
        let login = ssh.clone().unwrap_or(machine);
        machines.push(Machine { host, login, address: address.to_string(), metrics });
    }
    Ok(machines)
}

/// Does something on all machines at the same time. Returns what each says; an error is that of the first that has one.
pub fn on_all(
    machines: &[Machine],
    action: impl Fn(&Machine) -> Result<String, ClusterError> + Sync,
) -> Result<Vec<String>, ClusterError> {
    let action = &action;
    thread::scope(|scope| {
        let started: Vec<_> = machines.iter().map(|machine| scope.spawn(move || action(machine))).collect();
        let panicked = |_| Err(ClusterError::Start("a thread", io::Error::other("it has panicked")));
        started.into_iter().map(|thread| thread.join().unwrap_or_else(panicked)).collect()
    })
}

impl Machine {
    /// Copies program and keys if others are there, and starts the daemon if it does not run.
    pub fn up(&self, keys: &Path) -> Result<String, ClusterError> {
        let host = self.host;
        let program = std::env::current_exe().map_err(|e| ClusterError::Start("metamorph", e))?;
        let size =
            fs::metadata(&program).map_err(|e| ClusterError::Io { path: program.clone(), error: e })?.len();
        let there = self.shell(
            "a look at the machine",
            "wc -c <metamorph 2>/dev/null || echo 0; ./metamorph --version 2>/dev/null || echo none",
        )?;
        let is_ours = |text: &str| {
            let mut lines = text.lines().map(str::trim);
            lines.next() == Some(&size.to_string())
                && lines.next().is_some_and(|line| line.ends_with(version()))
        };
        let mut done = Vec::new();
        if !is_ours(&there) {
            let bytes =
                File::open(&program).map_err(|e| ClusterError::Io { path: program.clone(), error: e })?;
            let script = "cat >metamorph.part && chmod 755 metamorph.part && mv metamorph.part metamorph && ./metamorph --version";
            self.call("copying the program", script, Stdio::from(bytes))?;
            done.push("program copied");
        }
        let said = self.with_input("copying keys", "sh -s", &self.keys(keys)?)?;
        if said.contains("new") {
            done.push("keys copied");
        }
        let start = format!(
            "{RUNS}; if runs; then echo runs; else setsid nohup ./metamorph -v host --listen {} --name {host} --keys keys {} \
             >>log 2>&1 </dev/null & echo $! >pid; echo started; fi",
            self.address,
            self.metrics.join(" ")
        );
        done.push(if self.shell("starting the daemon", &start)?.contains("runs") {
            "it runs"
        } else {
            "daemon started"
        });
        Ok(format!("{host} at {}: {}", self.address, done.join(", ")))
    }

    /// Returns a script that writes the keys of this host, and says `new` if others were there.
    fn keys(&self, directory: &Path) -> Result<String, ClusterError> {
        let mut script = "umask 077; mkdir -p keys; ".to_owned();
        for name in [
            "ca.pem".to_owned(),
            "token".to_owned(),
            format!("{}.pem", self.host),
            format!("{}.key", self.host),
        ] {
            let path = directory.join(&name);
            let bytes = fs::read(&path).map_err(|e| ClusterError::Io { path, error: e })?;
            let octal: String = bytes.iter().map(|byte| format!("\\{byte:03o}")).collect();
            script += &format!(
                "printf '{octal}' >keys/part; if cmp -s keys/part keys/{name}; then rm keys/part; else mv keys/part keys/{name}; echo new; fi\n"
            );
        }
        Ok(script)
    }

    /// Returns the end of the log.
    pub fn log(&self, lines: u32) -> Result<String, ClusterError> {
        let log = self.shell("reading the log", &format!("tail -n {lines} log 2>/dev/null || true"))?;
        let place = format!("~/{PLACE}/{}/log on {}", self.host, self.login);
        Ok(format!("{}: {place}\n{}", self.host, log.trim_end()))
    }

    /// Ends the daemon, and waits until it has ended.
    pub fn down(&self) -> Result<String, ClusterError> {
        let script = format!(
            "{RUNS}; if runs; then kill \"$(cat pid)\"; for _ in $(seq 100); do runs || break; sleep 0.1; done; \
             if runs; then kill -9 \"$(cat pid)\"; fi; echo ended; else echo none; fi; rm -f pid"
        );
        let ended = self.shell("ending the daemon", &script)?;
        Ok(format!(
            "{}: {}",
            self.host,
            if ended.contains("ended") { "ended" } else { "no daemon was running" }
        ))
    }

    /// Runs a script of the shell in the directory of this host.
    fn shell(&self, what: &'static str, script: &str) -> Result<String, ClusterError> {
        self.call(what, script, Stdio::null())
    }

    fn with_input(&self, what: &'static str, script: &str, input: &str) -> Result<String, ClusterError> {
        let mut child =
            self.command(script).stdin(Stdio::piped()).spawn().map_err(|e| ClusterError::Start("ssh", e))?;
        if let Some(mut stdin) = child.stdin.take() {
            // A command that fails says why itself.
            let _ = stdin.write_all(input.as_bytes());
        }
        let output = child.wait_with_output().map_err(|e| ClusterError::Start("ssh", e))?;
        self.result(what, output)
    }

    fn call(&self, what: &'static str, script: &str, stdin: Stdio) -> Result<String, ClusterError> {
        let output = self.command(script).stdin(stdin).output().map_err(|e| ClusterError::Start("ssh", e))?;
        self.result(what, output)
    }

    fn command(&self, script: &str) -> Command {
        let place = format!("{PLACE}/{}", self.host);
        let mut command = Command::new("ssh");
        command.args(OPTIONS).arg(&self.login).arg("--");
        command.arg(format!("mkdir -p -m 700 {place} && cd {place} && {{ {script}; }}"));
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    fn result(&self, what: &'static str, output: std::process::Output) -> Result<String, ClusterError> {
        if output.status.success() {
            return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
        }
        let said = String::from_utf8_lossy(&output.stderr);
        let why = said
            .lines()
            .rev()
            .find(|line| !line.trim().is_empty())
            .unwrap_or("it says nothing")
            .trim()
            .to_owned();
        let fix = match output.status.code() {
            Some(255) => {
                "see that `ssh` reaches the machine without asking; `ssh = \"user@machine\"` in the hosts file names it"
            }
            _ => "look at the machine: disk, permissions, and whether it runs programs of this one",
        };
        Err(ClusterError::Machine { host: self.host, machine: self.login.clone(), what, why, fix })
    }
}
