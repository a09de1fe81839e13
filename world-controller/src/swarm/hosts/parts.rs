//! Parts of a journal that are written on another machine: a daemon sends what its agents have written, stretch by
//! stretch, and the controller's host puts it into files of the same names. A host that is lost leaves torn parts.

use metamorph_module_agent::journal_file::agent_part;
use metamorph_module_agent::transport::AgentKey;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Largest stretch in bytes.
const STRETCH: usize = 32 << 10;

/// The next stretch of a part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stretch {
    /// Whose part it is.
    pub agent: AgentKey,
    /// Where it begins.
    pub offset: u64,
    /// The bytes.
    pub bytes: Vec<u8>,
}

/// The parts that agents write on this machine.
#[derive(Debug)]
pub struct Written {
    directory: PathBuf,
    parts: BTreeMap<AgentKey, (Option<File>, u64)>,
}

impl Written {
    /// Creates the directory of parts.
    ///
    /// # Errors
    /// If that fails.
    pub fn create(root: &Path) -> io::Result<Written> {
        let directory = root.join("parts");
        fs::create_dir(&directory)?;
        Ok(Written { directory, parts: BTreeMap::new() })
    }

    /// Returns the directory, in which agents write.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// Notes that an agent is started.
    pub fn begin(&mut self, agent: AgentKey) {
        self.parts.insert(agent, (None, 0));
    }

    /// Hands the stretches that have been written to `send` until it refuses one. Returns true if nothing is left.
    pub fn send(&mut self, mut send: impl FnMut(Stretch) -> bool) -> bool {
        let mut bytes = vec![0; STRETCH];
        for (agent, (file, sent)) in &mut self.parts {
            if file.is_none() {
                *file = File::open(agent_part(&self.directory, agent.0, agent.1)).ok();
            }
            let Some(file) = file else { continue };
            loop {
                let read = file.seek(SeekFrom::Start(*sent)).and_then(|_| file.read(&mut bytes));
                let read = match read {
                    Ok(0) => break,
                    Ok(read) => read,
                    Err(e) => {
                        tracing::warn!("the journal of module {} cannot be read: {e}", agent.0);
                        break;
                    }
                };
                if !send(Stretch { agent: *agent, offset: *sent, bytes: bytes[..read].to_vec() }) {
                    return false;
                }
                *sent += read as u64;
            }
        }
        true
    }
}

/// The parts of agents of other machines, as they are collected on this one.
#[derive(Debug)]
pub struct Collected {
    directory: PathBuf,
    parts: BTreeMap<AgentKey, (File, u64)>,
}

impl Collected {
    /// Collects parts in a directory.
    pub fn new(directory: &Path) -> Collected {
        Collected { directory: directory.to_owned(), parts: BTreeMap::new() }
    }

    /// Appends a stretch to its part.
    ///
    /// # Errors
    /// If it does not follow on the one before, or cannot be written.
    pub fn put(&mut self, stretch: &Stretch) -> io::Result<()> {
        let (id, incarnation) = stretch.agent;
        if let std::collections::btree_map::Entry::Vacant(part) = self.parts.entry(stretch.agent) {
            part.insert((File::create_new(agent_part(&self.directory, id, incarnation))?, 0));
        }
        // Invariant: it was just created if it was not there.
        let Some((file, length)) = self.parts.get_mut(&stretch.agent) else { return Ok(()) };
        if stretch.offset != *length {
            let what = format!("a stretch at {} follows {length} bytes", stretch.offset);
            return Err(io::Error::new(io::ErrorKind::InvalidData, what));
        }
        file.write_all(&stretch.bytes)?;
        *length += stretch.bytes.len() as u64;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::ids::{Incarnation, ModuleId};

    #[test]
    fn parts_arrive_whole_and_in_order() {
        let (there, here) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (mut written, mut collected) =
            (Written::create(there.path()).unwrap(), Collected::new(here.path()));
        let agents = [1, 2].map(|id| (ModuleId(id), Incarnation(0)));
        agents.iter().for_each(|agent| written.begin(*agent));
        assert!(written.send(|_| false), "nothing is written yet");
        let mut expected = Vec::new();
        for round in 0..3_u8 {
            expected.extend(vec![round; STRETCH + 7]);
            fs::write(agent_part(written.directory(), agents[1].0, agents[1].1), &expected).unwrap();
            // The link takes one stretch at a time.
            let mut left = 1;
            while !written.send(|stretch| {
                let takes = left > 0;
                left = if takes { left - 1 } else { 1 };
                if takes {
                    collected.put(&stretch).unwrap();
                }
                takes
            }) {}
        }
        assert_eq!(fs::read(agent_part(here.path(), agents[1].0, agents[1].1)).unwrap(), expected);
        assert!(!agent_part(here.path(), agents[0].0, agents[0].1).exists());
        let again = Stretch { agent: agents[1], offset: 3, bytes: vec![1] };
        assert!(collected.put(&again).is_err());
    }
}
