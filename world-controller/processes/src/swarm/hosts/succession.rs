//! Information that a controller leaves for the one that takes over after its death: the hosts that take part, the
//! addresses of their daemons, and the secret of the run. It is a file in the run's directory, which only this user can
//! read, and another beside the parts of the journal, for a controller on another machine.

use super::messages::{Assignment, read_opening, write_opening};
use super::{FleetError, HostsFile};
use metamorph_module_agent::clock::page;
use metamorph_module_agent::run_dir::swarm_file;
use metamorph_protocol::ids::HostId;
use metamorph_protocol::link::Hosts;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const NAME: &str = "hosts";

/// The hosts of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Succession {
    /// Assignment of the controller's own host.
    pub own: Assignment,
    /// The run directories of the daemons; `None` on other machines.
    pub roots: BTreeMap<HostId, Option<PathBuf>>,
    /// The most modules that each daemon takes.
    pub rooms: BTreeMap<HostId, usize>,
    /// True if the daemons belong to this run alone.
    pub are_ours: bool,
    /// The directory of this host's keys, if hosts are on other machines.
    pub keys: Option<PathBuf>,
}

impl Succession {
    /// Writes the file in a directory.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, directory: &Path) -> io::Result<()> {
        let part = directory.join(NAME).with_extension("part");
        let mut file = File::options().write(true).create(true).truncate(true).mode(0o600).open(&part)?;
        write_opening(&mut file, self)?;
        fs::rename(part, directory.join(NAME))
    }

    /// Writes the file in a directory again with other homes of modules and other directories of daemons. Nothing is done if
    /// there is none.
    ///
    /// # Errors
    /// If it cannot be read or written.
    pub fn change(
        directory: &Path,
        hosts: &Hosts,
        roots: &BTreeMap<HostId, Option<PathBuf>>,
    ) -> io::Result<()> {
        let Some(mut succession) = Succession::read_as_is(directory)? else { return Ok(()) };
        succession.own.hosts = Arc::new(hosts.clone());
        succession.roots.clone_from(roots);
        if !succession.own.swarm.is_empty() {
            succession.own.swarm = swarm_file::with_homes(&succession.own.swarm, hosts);
        }
        succession.write(directory)
    }

    /// Goes on in a run directory of this machine, after the controller's machine has been lost, with hosts where the hosts
    /// file says. `parts` is where the parts of the journal are on this machine.
    ///
    /// # Errors
    /// If other hosts are named, or a file cannot be written.
    pub fn move_to(mut self, root: &Path, parts: &Path, hosts: &HostsFile) -> Result<(), FleetError> {
        if hosts.count() != self.own.hosts.len() {
            return Err(FleetError::OtherHosts { run: self.own.hosts.len(), file: hosts.count() });
        }
        let keys = hosts.keys.as_deref().map(std::path::absolute).transpose();
        self.keys = keys.map_err(FleetError::Prepare)?;
        self.own.addresses.clone_from(&hosts.addresses);
        self.own.clock = page::path(root);
        let swarm = swarm_file::with_parts_in(&self.own.swarm, parts);
        fs::write(swarm_file::path(root), swarm).and_then(|()| self.write(root)).map_err(FleetError::Prepare)
    }

    /// Reads the file in a directory; `None` if there is none, as in runs with one host.
    ///
    /// # Errors
    /// If it cannot be read, or is of another version.
    pub fn read(directory: &Path) -> io::Result<Option<Succession>> {
        let mut found = Succession::read_as_is(directory)?;
        if let Some(succession) = found.as_mut().filter(|found| found.own.swarm.is_empty()) {
            // It lies beside the file.
            succession.own.swarm = fs::read(swarm_file::path(directory))?;
        }
        Ok(found)
    }

    fn read_as_is(directory: &Path) -> io::Result<Option<Succession>> {
        match File::open(directory.join(NAME)) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
            file => read_opening(&mut file?).map(Some),
        }
    }

    /// Reads the file in a directory before a controller of this build takes over.
    ///
    /// # Errors
    /// If the controller cannot take over.
    pub fn find(directory: &Path, build: u64) -> Result<Option<Succession>, FleetError> {
        let found = Succession::read(directory).map_err(FleetError::Prepare)?;
        if found.as_ref().is_some_and(|found| found.own.build != build) {
            return Err(FleetError::OtherBuild);
        }
        Ok(found)
    }
}
