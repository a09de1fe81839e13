//! What a controller leaves to the one that takes over after its death: which hosts take part, where their daemons are, and
//! the secret of the run. It is a file in the run's directory, which only this user can read.

use super::messages::{Assignment, read_opening, write_opening};
use super::{Address, FleetError};
use metamorph_module_agent::run_dir::swarm_file;
use metamorph_protocol::ids::HostId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

const NAME: &str = "hosts";

/// The hosts of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Succession {
    /// What the controller's own host works with.
    pub own: Assignment,
    /// The run directories of the daemons; `None` on other machines.
    pub roots: BTreeMap<HostId, Option<PathBuf>>,
    /// True if the daemons belong to this run alone.
    pub are_ours: bool,
}

impl Succession {
    /// Writes the file of the run in `root`.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, root: &Path) -> io::Result<()> {
        // The swarm file lies beside it.
        let own = Assignment { swarm: Vec::new(), ..self.own.clone() };
        let mut file = File::options().write(true).create_new(true).mode(0o600).open(root.join(NAME))?;
        write_opening(&mut file, &Succession { own, ..self.clone() })
    }

    /// Reads the file of the run in `root`; `None` if the run has one host only.
    ///
    /// # Errors
    /// If it cannot be read, or is of another version.
    pub fn read(root: &Path) -> io::Result<Option<Succession>> {
        let mut file = match File::open(root.join(NAME)) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
            file => file?,
        };
        let mut succession: Succession = read_opening(&mut file)?;
        succession.own.swarm = fs::read(swarm_file::path(root))?;
        Ok(Some(succession))
    }

    /// Checks that another controller can take over, of this build, before the run is touched.
    ///
    /// # Errors
    /// If it cannot.
    pub fn check(root: &Path, build: u64) -> Result<(), FleetError> {
        let Some(Succession { own, .. }) = Succession::read(root).map_err(FleetError::Prepare)? else {
            return Ok(());
        };
        if own.build != build {
            return Err(FleetError::OtherBuild);
        }
        match own.addresses.iter().find(|address| matches!(address, Address::Net { .. })) {
            Some(address) => Err(FleetError::Away(address.clone())),
            None => Ok(()),
        }
    }
}
