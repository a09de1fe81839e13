//! Machines on a network of their own: a network namespace for each host, with a bridge between them. A port
//! that is taken off the bridge drops all packets. It takes root and `ip`; hosts are on one machine otherwise, so they share processors, files and the clock.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use crate::chaos::{signal_to, wait_until};
use crate::command::{Ran, command, metamorph, root, run};
use rustix::process::Signal;
use std::fs;
use std::net::Ipv4Addr;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use tempfile::TempDir;

/// Port on which daemons listen.
const PORT: u16 = 7_447;

/// Number of networks made by this process.
static MADE: AtomicU32 = AtomicU32::new(0);

/// A network of hosts h1, h2, ..., removed when dropped.
#[derive(Debug)]
pub struct Network {
    name: String,
    hosts: u8,
}

impl Network {
    /// Makes a network.
    ///
    /// # Errors
    /// Returns why there can be none on this machine.
    pub fn new(hosts: u8) -> Result<Network, String> {
        let number = MADE.fetch_add(1, Ordering::Relaxed);
        let network = Network { name: format!("mm{}x{number}", std::process::id()), hosts };
        let bridge = network.namespace(0);
        ip(&["netns", "add", &bridge])?;
        ip(&["-n", &bridge, "link", "add", "br0", "type", "bridge"])?;
        ip(&["-n", &bridge, "link", "set", "br0", "up"])?;
        for host in 1..=hosts {
            let (namespace, port) = (network.namespace(host), port(host));
            ip(&["netns", "add", &namespace])?;
            let peer = ["type", "veth", "peer", "name", "eth0", "netns", &namespace];
            ip(&[&["-n", &bridge, "link", "add", &port][..], &peer].concat())?;
            ip(&["-n", &bridge, "link", "set", &port, "master", "br0", "up"])?;
            let address = format!("{}/24", address(host));
            ip(&["-n", &namespace, "addr", "add", &address, "dev", "eth0"])?;
            ip(&["-n", &namespace, "link", "set", "lo", "up"])?;
            ip(&["-n", &namespace, "link", "set", "eth0", "up"])?;
        }
        Ok(network)
    }

    /// Returns the namespace of a host; 0 is that of the bridge.
    fn namespace(&self, host: u8) -> String {
        format!("{}h{host}", self.name)
    }

    /// Drops all packets to and from a host, or forwards them again.
    pub fn cut(&self, host: u8, is_cut: bool) {
        let (bridge, port) = (self.namespace(0), port(host));
        let place = if is_cut { &["nomaster"][..] } else { &["master", "br0"] };
        ip(&[&["-n", &bridge, "link", "set", &port], place].concat()).unwrap();
    }

    /// Returns the command `metamorph` with these arguments on a host.
    pub fn command(&self, host: u8, args: &[&str]) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.namespace(host)]).arg(metamorph()).args(args);
        command.stdin(Stdio::null()).current_dir(root());
        command.env_remove("METAMORPH_LOG").env_remove("NO_COLOR");
        command
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        for host in 0..=self.hosts {
            let _ = ip(&["netns", "del", &self.namespace(host)]);
        }
    }
}

fn port(host: u8) -> String {
    format!("port{host}")
}

fn address(host: u8) -> Ipv4Addr {
    Ipv4Addr::new(10, 77, 0, host)
}

fn ip(args: &[&str]) -> Result<(), String> {
    let failed = |why: String| format!("`ip {}` fails: {why}", args.join(" "));
    let output = Command::new("ip").args(args).output().map_err(|e| failed(e.to_string()))?;
    match output.status.success() {
        true => Ok(()),
        false => Err(failed(String::from_utf8_lossy(&output.stderr).trim().to_owned())),
    }
}

/// Three hosts on a network with a daemon on h2 and h3, keys, and a hosts file.
#[derive(Debug)]
pub struct Machines {
    directory: TempDir,
    daemons: Vec<Child>,
    /// The network.
    pub network: Network,
}

impl Machines {
    /// Starts the daemons, with these times in the hosts file.
    ///
    /// # Errors
    /// Returns why that cannot be done on this machine, or with this build of the program.
    pub fn start(times: &str) -> Result<Machines, String> {
        let network = Network::new(3)?;
        let directory = tempfile::tempdir().unwrap();
        let mut machines = Machines { directory, daemons: Vec::new(), network };
        let mut text =
            format!("version = 1\nkeys = \"keys\"\n{times}[[host]]\nname = \"h1\"\naddress = \"local\"\n");
        for host in 2..=3 {
            text += &format!("[[host]]\nname = \"h{host}\"\naddress = \"{}:{PORT}\"\n", address(host));
        }
        fs::write(machines.path("hosts.toml"), text).unwrap();
        let (keys, hosts) = (machines.text("keys"), machines.text("hosts.toml"));
        let made = run(&["host", "--keys", &keys, "--make-keys", &hosts]);
        if made.code != Some(0) {
            return Err(made.err);
        }
        for host in 2..=3 {
            machines.daemon(host);
        }
        Ok(machines)
    }

    /// Starts the daemon of a host, in place of the one before, and waits until it listens.
    pub fn daemon(&mut self, host: u8) {
        let (listen, name) = (format!("{}:{PORT}", address(host)), format!("h{host}"));
        let log = self.path(&format!("{name}.log"));
        let keys = self.text("keys");
        let args = ["-v", "host", "--listen", &listen, "--name", &name, "--keys", &keys];
        let daemon =
            self.network.command(host, &args).stderr(fs::File::create(&log).unwrap()).spawn().unwrap();
        self.daemons.push(daemon);
        wait_until("a daemon to listen", || fs::read_to_string(&log).unwrap().contains("listening on"));
    }

    /// Returns the path of a file beside the hosts file.
    pub fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    /// Returns the path of a file beside the hosts file as text.
    pub fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    /// Returns the log of a host: of a daemon, or of the run.
    pub fn log(&self, host: u8) -> String {
        fs::read_to_string(self.path(&format!("h{host}.log"))).unwrap_or_default()
    }

    /// Sends a signal to the daemon of h2 or h3.
    pub fn signal(&self, host: u8, signal: Signal) {
        // `ip netns exec` becomes the program.
        signal_to(self.daemons[usize::from(host) - 2].id() as i32, signal);
    }
}

impl Drop for Machines {
    fn drop(&mut self) {
        for daemon in &mut self.daemons {
            let _ = daemon.kill();
            let _ = daemon.wait();
        }
        let _ = command(&["clean"]).output();
    }
}

/// Two empty machines with a server of ssh, each with a home directory of its own, and this one beside them.
#[derive(Debug)]
pub struct SshSite {
    directory: TempDir,
    servers: Vec<Child>,
    network: Network,
}

impl SshSite {
    /// Starts the servers, and writes a hosts file.
    ///
    /// # Errors
    /// Returns why that cannot be done on this machine, or with this build of the program.
    pub fn start() -> Result<SshSite, String> {
        // sshd is called by its path, since it starts itself again.
        let sshd = Path::new("/usr/sbin/sshd");
        if !sshd.exists() {
            return Err("there is no sshd".into());
        }
        if !run(&["cluster", "--help"]).out.contains("SLURM") {
            return Err("the program is built without links between machines".into());
        }
        let network = Network::new(3)?;
        let directory = tempfile::tempdir().unwrap();
        let mut site = SshSite { directory, servers: Vec::new(), network };
        let [id, server, config, bin] = ["id", "server", "sshd_config", "bin"].map(|name| site.text(name));
        for key in [&id, &server] {
            let made = Command::new("ssh-keygen").args(["-q", "-t", "ed25519", "-N", "", "-f", key]).status();
            if !made.is_ok_and(|status| status.success()) {
                return Err("ssh-keygen makes no keys".into());
            }
        }
        let settings = format!(
            "HostKey {server}\nAuthorizedKeysFile {id}.pub\nPermitRootLogin yes\nStrictModes no\nUsePAM no\nPidFile none\n"
        );
        fs::write(&config, settings).unwrap();
        fs::create_dir_all("/run/sshd").map_err(|e| e.to_string())?;
        let mut text = "version = 1\nkeys = \"keys\"\nclock_error = \"20ms\"\n[[host]]\nname = \"h1\"\naddress = \"local\"\n".to_owned();
        for host in 2..=3 {
            let home =
                "mount --make-rprivate / && mount -t tmpfs tmpfs \"$HOME\" && exec /usr/sbin/sshd -D -f";
            let server = Command::new("ip")
                .args(["netns", "exec", &site.network.namespace(host), "unshare", "--mount", "sh", "-c"])
                .arg(format!("{home} {config}"))
                .stdin(Stdio::null())
                .stderr(Stdio::null())
                .spawn();
            site.servers.push(server.map_err(|e| e.to_string())?);
            text += &format!("[[host]]\nname = \"h{host}\"\naddress = \"{}:{PORT}\"\n", address(host));
        }
        fs::write(site.path("hosts.toml"), text).unwrap();
        fs::create_dir(&bin).unwrap();
        let ssh = format!(
            "#!/bin/sh\nexec /usr/bin/ssh -i {id} -o StrictHostKeyChecking=no -o UserKnownHostsFile=/dev/null -o LogLevel=ERROR \"$@\"\n"
        );
        fs::write(site.path("bin").join("ssh"), ssh).unwrap();
        fs::set_permissions(site.path("bin").join("ssh"), fs::Permissions::from_mode(0o755)).unwrap();
        wait_until("the servers to answer", || {
            (2..=3).all(|host| {
                let mut call = Command::new("ip");
                call.args(["netns", "exec", &site.network.namespace(1)]).arg(site.path("bin").join("ssh"));
                call.args([&format!("{}", address(host)), "true"]).stdin(Stdio::null()).stderr(Stdio::null());
                call.status().is_ok_and(|status| status.success())
            })
        });
        Ok(site)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    /// Returns the path of a file beside the hosts file as text.
    pub fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    /// Runs `metamorph` with these arguments on this machine, h1.
    pub fn run(&self, args: &[&str]) -> Ran {
        let path = std::env::var("PATH").unwrap_or_default();
        let path = format!("{}:{path}", self.text("bin"));
        self.network.command(1, args).env("PATH", path).output().expect("`ip` can be started").into()
    }
}

impl Drop for SshSite {
    fn drop(&mut self) {
        // Daemons of a test that has failed.
        let _ = self.run(&["cluster", "down", &self.text("hosts.toml")]);
        for server in &mut self.servers {
            let _ = server.kill();
            let _ = server.wait();
        }
        let _ = command(&["clean"]).output();
    }
}
