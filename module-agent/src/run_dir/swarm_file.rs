//! The configuration that all agents of a run share, written once by the controller and read by each agent
//! when it starts: `swarm.bin` in the run's directory. `MMSW`, a version (2 bytes), then bincode.

use crate::clock::Speed;
use crate::journal_file::Parts;
use bincode::config::standard;
use metamorph_protocol::link::{Hosts, LinkModel};
use metamorph_protocol::time::Span;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use thiserror::Error;

const MAGIC: [u8; 4] = *b"MMSW";
/// The version of the layout. Any change of [`SwarmFile`] raises it.
pub const VERSION: u16 = 10;
/// Largest size of the file in bytes; bounds the memory that a damaged length can claim.
const LIMIT: usize = 256 << 20;

/// The configuration that all agents of a run share. `S` is the family's setup.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SwarmFile<S> {
    /// The name of the run on all its hosts, for logs and metrics: that of the first controller's directory.
    pub run: String,
    /// The number of modules.
    pub count: u32,
    /// The seed of the run.
    pub seed: u64,
    /// The highest speed of scenario time.
    pub speed: Speed,
    /// The lateness of agents, in scenario time, above which the controller slows the clock.
    pub tolerance: Span,
    /// The effects of links on messages.
    pub link: LinkModel,
    /// The files of the agents' parts of the journal; `None` if none is kept.
    pub journal: Option<Parts>,
    /// How long an agent waits for a controller to come back (ms of real time); 0 if it ends with its
    /// controller.
    pub patience: u32,
    /// The family's own part.
    pub setup: S,
}

/// Errors of writing and reading a swarm file.
#[derive(Debug, Error)]
pub enum SwarmFileError {
    /// The file cannot be written or read.
    #[error("cannot access {0}: {1}")]
    Io(PathBuf, io::Error),
    /// Not a swarm file.
    #[error("{0} is not a swarm file")]
    Magic(PathBuf),
    /// Another version.
    #[error(
        "{0} has version {1}; this program reads version {VERSION}: start agents with the controller's own program"
    )]
    Version(PathBuf, u16),
    /// The content cannot be decoded.
    #[error("{0} is damaged or was written by another program: {1}")]
    Content(PathBuf, String),
    /// The setup is too large or cannot be encoded.
    #[error("the setup of the swarm cannot be written: {0}")]
    Encode(String),
}

/// Returns the path of the swarm file of the run in `root`.
pub fn path(root: &Path) -> PathBuf {
    root.join("swarm.bin")
}

impl<S: Serialize> SwarmFile<S> {
    /// Writes the file; readers see all of it or none.
    ///
    /// # Errors
    /// If the setup cannot be encoded, or the file cannot be written.
    pub fn write(&self, root: &Path) -> Result<(), SwarmFileError> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(VERSION.to_le_bytes());
        let body = bincode::serde::encode_to_vec(self, standard())
            .map_err(|e| SwarmFileError::Encode(e.to_string()))?;
        if body.len() > LIMIT {
            return Err(SwarmFileError::Encode(format!("{} bytes are more than {LIMIT}", body.len())));
        }
        bytes.extend(body);
        let (path, part) = (path(root), root.join("swarm.part"));
        let io = |e| SwarmFileError::Io(path.clone(), e);
        fs::write(&part, bytes).map_err(io)?;
        fs::rename(&part, &path).map_err(io)
    }
}

impl<S: DeserializeOwned> SwarmFile<S> {
    /// Reads the file of the run in `root`.
    ///
    /// # Errors
    /// If the file cannot be read, is foreign, damaged or of another version.
    pub fn read(root: &Path) -> Result<SwarmFile<S>, SwarmFileError> {
        let path = path(root);
        let bytes = fs::read(&path).map_err(|e| SwarmFileError::Io(path.clone(), e))?;
        let Some(rest) = bytes.strip_prefix(&MAGIC) else {
            return Err(SwarmFileError::Magic(path));
        };
        let Some((version, body)) = rest.split_first_chunk::<2>() else {
            return Err(SwarmFileError::Magic(path));
        };
        let version = u16::from_le_bytes(*version);
        if version != VERSION {
            return Err(SwarmFileError::Version(path, version));
        }
        match bincode::serde::decode_from_slice(body, standard().with_limit::<LIMIT>()) {
            Ok((file, used)) if used == body.len() => Ok(file),
            Ok(_) => Err(SwarmFileError::Content(path, "there is more than a swarm file holds".into())),
            Err(e) => Err(SwarmFileError::Content(path, e.to_string())),
        }
    }
}

/// The part of a swarm file before the family's own, with its length in bytes, if the file can be read that far.
fn common_part(bytes: &[u8]) -> Option<(SwarmFile<()>, usize)> {
    let body = bytes.strip_prefix(&MAGIC)?.get(2..)?;
    // The setup is last, and `()` takes no bytes.
    let (file, used) = bincode::serde::decode_from_slice(body, standard().with_limit::<LIMIT>()).ok()?;
    Some((file, MAGIC.len() + 2 + used))
}

/// True if the agents of this swarm file keep a journal.
pub fn keeps_journal(bytes: &[u8]) -> bool {
    common_part(bytes).is_some_and(|(file, _)| file.journal.is_some())
}

/// Returns the name of the run of a swarm file.
pub fn run_of(bytes: &[u8]) -> Option<String> {
    common_part(bytes).map(|(file, _)| file.run)
}

/// Returns the bytes of a swarm file for the agents of a daemon: they end with it, and on another machine they write their
/// parts of the journal into another directory. Bytes that are no swarm file stay as they are, and agents refuse them.
pub fn for_daemon(bytes: &[u8], parts_in: Option<&Path>) -> Vec<u8> {
    changed(bytes, |file| {
        file.patience = 0;
        if let Some((parts, directory)) = file.journal.as_mut().zip(parts_in) {
            parts.dir = directory.to_owned();
        }
    })
}

/// Returns the bytes of a swarm file for agents that write their parts of the journal into another directory.
pub fn with_parts_in(bytes: &[u8], directory: &Path) -> Vec<u8> {
    changed(bytes, |file| file.journal.iter_mut().for_each(|parts| parts.dir = directory.to_owned()))
}

/// Returns the bytes of a swarm file with other homes of modules.
pub fn with_homes(bytes: &[u8], homes: &Hosts) -> Vec<u8> {
    changed(bytes, |file| file.link.hosts = Some(Arc::new(homes.clone())))
}

/// Returns the bytes of a swarm file without hosts: the same for all hosts of a run, wherever modules have moved.
pub fn without_hosts(bytes: &[u8]) -> Vec<u8> {
    changed(bytes, |file| file.link.hosts = None)
}

/// Writes the file of the run in `root` again for agents that start from now on, with other homes of modules. Readers see all
/// of it or none.
///
/// # Errors
/// If the file cannot be read or written.
pub fn move_homes(root: &Path, homes: &Hosts) -> io::Result<()> {
    let bytes = fs::read(path(root))?;
    let part = root.join("swarm.part");
    fs::write(&part, with_homes(&bytes, homes))?;
    fs::rename(part, path(root))
}

fn changed(bytes: &[u8], change: impl FnOnce(&mut SwarmFile<()>)) -> Vec<u8> {
    let Some((mut file, common)) = common_part(bytes) else { return bytes.to_vec() };
    change(&mut file);
    match bincode::serde::encode_to_vec(&file, standard()) {
        Ok(body) => [&bytes[..MAGIC.len() + 2], &body, &bytes[common..]].concat(),
        Err(_) => bytes.to_vec(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::journal_file::RunId;
    use metamorph_protocol::ids::HostId;
    use metamorph_protocol::link::ClockOffset;
    use proptest::prelude::*;

    fn sample() -> SwarmFile<Vec<u32>> {
        SwarmFile {
            run: "mm0000000000".to_owned(),
            count: 3,
            seed: 9,
            speed: Speed::new(10, 1).unwrap(),
            tolerance: Span::millis(100),
            link: LinkModel { delay_max: Span::millis(2), ..LinkModel::default() },
            journal: Some(Parts { dir: "/tmp/journal.parts".into(), run: RunId([9; 16]) }),
            patience: 30_000,
            setup: vec![1, 2],
        }
    }

    #[test]
    fn reads_what_it_writes_and_refuses_the_rest() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        assert!(matches!(SwarmFile::<Vec<u32>>::read(root), Err(SwarmFileError::Io(..))));
        sample().write(root).unwrap();
        assert_eq!(SwarmFile::read(root).unwrap(), sample());
        let good = fs::read(path(root)).unwrap();
        let read_with = |edit: &dyn Fn(&mut Vec<u8>)| {
            let mut bytes = good.clone();
            edit(&mut bytes);
            fs::write(path(root), bytes).unwrap();
            SwarmFile::<Vec<u32>>::read(root).unwrap_err()
        };
        assert!(matches!(read_with(&|b| b[0] = b'X'), SwarmFileError::Magic(_)));
        assert!(matches!(read_with(&|b| b.truncate(5)), SwarmFileError::Magic(_)));
        assert!(matches!(read_with(&|b| b[4] = 1), SwarmFileError::Version(_, 1)));
        assert!(matches!(read_with(&|b| b.push(0)), SwarmFileError::Content(..)));
        assert!(matches!(read_with(&|b| b.truncate(9)), SwarmFileError::Content(..)));
    }

    #[test]
    fn agents_of_a_daemon_end_with_it_and_write_where_it_says() {
        let dir = tempfile::tempdir().unwrap();
        sample().write(dir.path()).unwrap();
        let bytes = fs::read(path(dir.path())).unwrap();
        assert!(keeps_journal(&bytes) && !keeps_journal(&bytes[..9]));
        assert_eq!((run_of(&bytes), run_of(&bytes[..9])), (Some(sample().run), None));
        fs::write(path(dir.path()), for_daemon(&bytes, Some(Path::new("/there")))).unwrap();
        let Parts { run, .. } = sample().journal.unwrap();
        let journal = Some(Parts { dir: "/there".into(), run });
        assert_eq!(SwarmFile::read(dir.path()).unwrap(), SwarmFile { journal, patience: 0, ..sample() });
        fs::write(path(dir.path()), for_daemon(&bytes, None)).unwrap();
        assert_eq!(SwarmFile::read(dir.path()).unwrap(), SwarmFile { patience: 0, ..sample() });
        assert_eq!(for_daemon(b"no swarm file", None), b"no swarm file");
    }

    #[test]
    fn agents_that_start_later_find_other_homes() {
        let hosts = |homes: [u16; 3]| {
            let clocks = vec![ClockOffset::default(); 2];
            Hosts::new(homes.map(HostId).to_vec(), clocks, vec![LinkModel::default()]).unwrap()
        };
        let dir = tempfile::tempdir().unwrap();
        let of = |homes| LinkModel { hosts: Some(Arc::new(hosts(homes))), ..sample().link };
        SwarmFile { link: of([0, 1, 1]), ..sample() }.write(dir.path()).unwrap();
        move_homes(dir.path(), &hosts([0, 0, 0])).unwrap();
        assert_eq!(SwarmFile::read(dir.path()).unwrap(), SwarmFile { link: of([0, 0, 0]), ..sample() });
    }

    proptest! {
        /// A damaged file is refused or read; it causes no panic and no huge allocation.
        #[test]
        fn garbage_never_panics(body in proptest::collection::vec(any::<u8>(), 0..200)) {
            let dir = tempfile::tempdir().unwrap();
            let mut bytes = MAGIC.to_vec();
            bytes.extend(VERSION.to_le_bytes());
            bytes.extend(body);
            fs::write(path(dir.path()), bytes).unwrap();
            let _ = SwarmFile::<Vec<u32>>::read(dir.path());
        }
    }
}
