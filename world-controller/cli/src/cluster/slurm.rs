//! Daemons as steps of a job of SLURM: one on each node of the job but this one. The hosts file is written, and beside it, in a
//! directory, keys, logs and the processes of `srun`.

use super::{ClusterError, metrics_of};
use metamorph_console::stopwatch::wait_until;
use metamorph_processes::swarm::make_keys;
use metamorph_protocol::ids::HostId;
use rustix::process::{Pid, Signal, kill_process, test_kill_process};
use std::env;
use std::fs::{self, File};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

/// Longest time to wait for a step to begin and its daemon to listen.
const STEP_WAIT_MAX: Duration = Duration::from_secs(60);
/// Longest time to wait for a step to end.
const END_WAIT_MAX: Duration = Duration::from_secs(15);
/// The line of a daemon that says where it listens.
const LISTENING: &str = "listening on ";

/// Starts a daemon on each node of the job but this one, and writes the hosts file. Returns a line for each.
pub fn up(file: &Path, valid: Duration, metrics: Option<u16>) -> Result<Vec<String>, ClusterError> {
    let steps = Steps::beside(file);
    if file.exists() || steps.directory.exists() {
        return Err(ClusterError::There(file.to_owned()));
    }
    env::var_os("SLURM_JOB_ID").ok_or(ClusterError::NoJob("SLURM_JOB_ID"))?;
    // Where there is none, this is no node of the job.
    let own = env::var("SLURMD_NODENAME").unwrap_or_default();
    let nodes: Vec<String> = scontrol(&["show", "hostnames"])?.lines().map(str::to_owned).collect();
    let others: Vec<(HostId, &String)> =
        (1u16..).map(HostId).zip(nodes.iter().filter(|node| **node != own)).collect();
    if others.is_empty() {
        return Err(ClusterError::Slurm(format!(
            "the job has no node but this one ({own})\n  fix: ask for two nodes or more"
        )));
    }
    let machines = others
        .iter()
        .map(|(host, node)| Ok((*host, address(node)?)))
        .collect::<Result<Vec<_>, ClusterError>>()?;
    let failed = |e| ClusterError::Io { path: steps.directory.clone(), error: e };
    fs::create_dir(&steps.directory).map_err(failed)?;
    let keys = steps.directory.join("keys");
    let with_keys: Vec<_> = std::iter::once((HostId::CONTROLLER, Vec::new()))
        .chain(machines.iter().map(|(host, machine)| (*host, vec![machine.clone()])))
        .collect();
    make_keys(&keys, &with_keys, valid)?;
    let program = env::current_exe().map_err(|e| ClusterError::Start("metamorph", e))?;
    for ((host, node), (_, machine)) in others.iter().zip(&machines) {
        let log = File::create(steps.log(*host)).map_err(failed)?;
        let child = Command::new("srun")
            .args(["--overlap", "--nodes=1", "--ntasks=1", "--nodelist", node])
            .arg(&program)
            .args(["-v", "host", "--listen", &format!("{machine}:0"), "--name", &host.to_string(), "--keys"])
            .arg(&keys)
            .args(metrics_of(machine, metrics))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            // Ctrl-C and the end of this command leave it alone.
            .process_group(0)
            .spawn()
            .map_err(|e| ClusterError::Start("srun", e))?;
        fs::write(steps.pid(*host), child.id().to_string()).map_err(failed)?;
    }
    let mut text = "version = 1\n".to_owned();
    text += &format!("keys = {:?}\n[[host]]\nname = \"h1\"\naddress = \"local\"\n", relative(&keys));
    let mut lines = Vec::new();
    for (host, node) in &others {
        let mut found = None;
        wait_until(STEP_WAIT_MAX, || {
            let log = fs::read_to_string(steps.log(*host)).unwrap_or_default();
            let line = log.lines().find_map(|line| line.strip_prefix(LISTENING));
            found = line.and_then(|line| line.split(';').next()).map(str::to_owned);
            found.is_some()
        });
        let Some(address) = found else {
            let log = fs::read_to_string(steps.log(*host)).unwrap_or_default();
            let said = log.lines().last().unwrap_or("nothing was said").to_owned();
            // Those that have begun would otherwise last as long as the job.
            steps.down()?;
            return Err(ClusterError::Slurm(format!("the daemon of {host} on {node} did not begin: {said}")));
        };
        text += &format!("[[host]]\nname = \"{host}\"\naddress = \"{address}\"\n");
        lines.push(format!("{host} at {address}: daemon started on node {node}"));
    }
    fs::write(file, text).map_err(|e| ClusterError::Io { path: file.to_owned(), error: e })?;
    Ok(lines)
}

/// Returns the directory of the keys as seen from the hosts file beside it.
fn relative(keys: &Path) -> String {
    let directory = keys.parent().and_then(Path::file_name).unwrap_or_default();
    Path::new(directory).join("keys").display().to_string()
}

/// Returns the address of a node.
fn address(node: &str) -> Result<String, ClusterError> {
    let shown = scontrol(&["show", "node", node])?;
    let address = shown.split_whitespace().find_map(|word| word.strip_prefix("NodeAddr="));
    address
        .map(str::to_owned)
        .ok_or_else(|| ClusterError::Slurm(format!("scontrol names no address of node {node}")))
}

fn scontrol(args: &[&str]) -> Result<String, ClusterError> {
    let output =
        Command::new("scontrol").args(args).output().map_err(|e| ClusterError::Start("scontrol", e))?;
    match output.status.success() {
        true => Ok(String::from_utf8_lossy(&output.stdout).into_owned()),
        false => {
            let said = String::from_utf8_lossy(&output.stderr);
            Err(ClusterError::Slurm(format!("`scontrol {}` fails: {}", args.join(" "), said.trim())))
        }
    }
}

/// The steps of a cluster, and what belongs to them.
pub struct Steps {
    file: PathBuf,
    directory: PathBuf,
}

impl Steps {
    fn beside(file: &Path) -> Steps {
        let mut name = file.file_name().unwrap_or_default().to_owned();
        name.push(".d");
        Steps { file: file.to_owned(), directory: file.with_file_name(name) }
    }

    /// Returns the steps whose hosts file this is; `None` if it is of no job of SLURM.
    pub fn read(file: &Path) -> Option<Steps> {
        Some(Steps::beside(file)).filter(|steps| steps.directory.is_dir())
    }

    fn log(&self, host: HostId) -> PathBuf {
        self.directory.join(format!("{host}.log"))
    }
    fn pid(&self, host: HostId) -> PathBuf {
        self.directory.join(format!("{host}.pid"))
    }
    fn hosts(&self) -> impl Iterator<Item = HostId> {
        (1u16..).map(HostId).take_while(|host| self.pid(*host).exists())
    }

    /// Returns the ends of the logs.
    pub fn logs(&self, lines: u32) -> Result<Vec<String>, ClusterError> {
        self.hosts()
            .map(|host| {
                let path = self.log(host);
                let text = fs::read_to_string(&path)
                    .map_err(|e| ClusterError::Io { path: path.clone(), error: e })?;
                let all: Vec<&str> = text.lines().collect();
                let end = &all[all.len().saturating_sub(lines as usize)..];
                Ok(format!("{host}: {}\n{}", path.display(), end.join("\n")))
            })
            .collect()
    }

    /// Ends the daemons, and removes what `up` has written.
    pub fn down(&self) -> Result<Vec<String>, ClusterError> {
        let mut lines = Vec::new();
        for host in self.hosts() {
            let pid = fs::read_to_string(self.pid(host))
                .ok()
                .and_then(|text| Pid::from_raw(text.trim().parse().ok()?));
            let Some(pid) = pid.filter(|pid| is_srun(*pid)) else {
                lines.push(format!("{host}: no daemon was running"));
                continue;
            };
            // srun passes it on.
            let _ = kill_process(pid, Signal::TERM);
            let has_ended = wait_until(END_WAIT_MAX, || test_kill_process(pid).is_err() || !is_srun(pid));
            if !has_ended {
                let _ = kill_process(pid, Signal::KILL);
            }
            lines.push(format!("{host}: ended"));
        }
        let failed = |e| ClusterError::Io { path: self.directory.clone(), error: e };
        fs::remove_dir_all(&self.directory).map_err(failed)?;
        if self.file.exists() {
            fs::remove_file(&self.file)
                .map_err(|e| ClusterError::Io { path: self.file.clone(), error: e })?;
        }
        Ok(lines)
    }
}

/// True if the process is a living `srun`.
fn is_srun(pid: Pid) -> bool {
    let name = fs::read_to_string(format!("/proc/{}/comm", pid.as_raw_nonzero())).unwrap_or_default();
    let state = fs::read_to_string(format!("/proc/{}/stat", pid.as_raw_nonzero())).unwrap_or_default();
    name.trim() == "srun" && !state.contains(") Z ")
}
