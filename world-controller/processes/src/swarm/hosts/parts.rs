//! Parts of a journal that are written on another machine: a daemon sends what its agents have written, stretch by
//! stretch, and the controller's host puts it into files of the same names. A host that is lost leaves torn parts.

use metamorph_module_agent::journal_file::{agent_of, agent_part};
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

/// A part that an agent writes on this machine.
#[derive(Debug, Default)]
struct Part {
    /// Opened once the agent has created it.
    file: Option<File>,
    /// Number of bytes sent to the controller, besides those sent for its call.
    sent: u64,
    /// Number of bytes that the controller had when it began.
    base: u64,
}

impl Part {
    /// Reads the next stretch after `from`, by way of `bytes`; `None` at the end of what has been written.
    fn read(&mut self, directory: &Path, agent: AgentKey, from: u64, bytes: &mut [u8]) -> Option<Stretch> {
        if self.file.is_none() {
            self.file = File::open(agent_part(directory, agent.0, agent.1)).ok();
        }
        let file = self.file.as_mut()?;
        match file.seek(SeekFrom::Start(from)).and_then(|_| file.read(bytes)) {
            Ok(0) => None,
            Ok(read) => Some(Stretch { agent, offset: from, bytes: bytes[..read].to_vec() }),
            Err(e) => {
                tracing::warn!("the journal of module {} cannot be read: {e}", agent.0);
                None
            }
        }
    }
}

/// The parts that agents write on this machine.
#[derive(Debug)]
pub struct Written {
    directory: PathBuf,
    parts: BTreeMap<AgentKey, Part>,
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
        self.parts.insert(agent, Part::default());
    }

    /// Turns to a controller that has taken over and has so many bytes of each part.
    pub fn turn_to(&mut self, collected: &BTreeMap<AgentKey, u64>) {
        for (agent, part) in &mut self.parts {
            part.base = collected.get(agent).copied().unwrap_or(0);
            part.sent = part.base;
        }
    }

    /// Returns what an agent has written since the controller took over, also what has been sent already.
    pub fn since_takeover(&mut self, agent: AgentKey) -> Vec<Stretch> {
        let Some(part) = self.parts.get_mut(&agent) else { return Vec::new() };
        let (mut from, mut bytes) = (part.base, vec![0; STRETCH]);
        std::iter::from_fn(|| {
            let stretch = part.read(&self.directory, agent, from, &mut bytes)?;
            from += stretch.bytes.len() as u64;
            Some(stretch)
        })
        .collect()
    }

    /// Hands the stretches that have been written to `send` until it refuses one. Returns true if nothing is left.
    pub fn send(&mut self, mut send: impl FnMut(Stretch) -> bool) -> bool {
        let mut bytes = vec![0; STRETCH];
        for (agent, part) in &mut self.parts {
            while let Some(stretch) = part.read(&self.directory, *agent, part.sent, &mut bytes) {
                let read = stretch.bytes.len() as u64;
                if !send(stretch) {
                    return false;
                }
                part.sent += read;
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

    /// Returns the directory.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// Returns how many bytes of each part are in a directory.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn lengths(directory: &Path) -> io::Result<BTreeMap<AgentKey, u64>> {
        let mut lengths = BTreeMap::new();
        for entry in fs::read_dir(directory)? {
            let entry = entry?;
            if let Some(agent) = entry.file_name().to_str().and_then(agent_of) {
                lengths.insert(agent, entry.metadata()?.len());
            }
        }
        Ok(lengths)
    }

    /// Appends a stretch to its part. Bytes that have arrived before are left out: after a takeover some are sent twice.
    ///
    /// # Errors
    /// If it does not follow on the one before, or cannot be written.
    pub fn put(&mut self, stretch: &Stretch) -> io::Result<()> {
        let (id, incarnation) = stretch.agent;
        if let std::collections::btree_map::Entry::Vacant(part) = self.parts.entry(stretch.agent) {
            let path = agent_part(&self.directory, id, incarnation);
            let file = File::options().create(true).append(true).open(path)?;
            let length = file.metadata()?.len();
            part.insert((file, length));
        }
        // Invariant: it was just opened if it was not there.
        let Some((file, length)) = self.parts.get_mut(&stretch.agent) else { return Ok(()) };
        let known = length.checked_sub(stretch.offset).ok_or_else(|| {
            let what = format!("a stretch at {} follows {length} bytes", stretch.offset);
            io::Error::new(io::ErrorKind::InvalidData, what)
        })?;
        let new =
            usize::try_from(known).ok().and_then(|known| stretch.bytes.get(known..)).unwrap_or_default();
        file.write_all(new)?;
        *length += new.len() as u64;
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
        let length = expected.len() as u64;
        let beyond = Stretch { agent: agents[1], offset: length + 1, bytes: vec![1] };
        assert!(collected.put(&beyond).is_err());

        // Another controller takes over; some of the messages that answer its call come twice.
        assert_eq!(Collected::lengths(here.path()).unwrap(), BTreeMap::from([(agents[1], length)]));
        let mut collected = Collected::new(here.path());
        written.turn_to(&BTreeMap::from([(agents[1], length - 3)]));
        expected.extend(vec![9; 2 * STRETCH]);
        fs::write(agent_part(written.directory(), agents[1].0, agents[1].1), &expected).unwrap();
        let told = written.since_takeover(agents[1]);
        assert_eq!((told.len(), told[0].offset), (3, length - 3));
        told.iter().for_each(|stretch| collected.put(stretch).unwrap());
        expected.push(7);
        fs::write(agent_part(written.directory(), agents[1].0, agents[1].1), &expected).unwrap();
        assert!(written.send(|stretch| collected.put(&stretch).is_ok()));
        assert_eq!(fs::read(agent_part(here.path(), agents[1].0, agents[1].1)).unwrap(), expected);
    }
}
