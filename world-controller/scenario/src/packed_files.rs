//! Files that are part of a scenario's own text: `[[file]]`, each with its name as the scenario writes it and its content.
//! A scenario that has all files that it names is one file which any machine runs. Not here: reading the key, which is in `raw`.

use metamorph_text::sources::Sources;
use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

/// The folder in which packed files seem to be.
const ROOT: &str = "(packed)";

/// The files of a scenario, by their names in it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PackedFiles(BTreeMap<String, Vec<u8>>);

impl PackedFiles {
    /// Adds a file. Returns false if there is one of this name.
    pub fn add(&mut self, name: String, content: Vec<u8>) -> bool {
        self.0.insert(name, content).is_none()
    }

    /// Returns the number of files.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// Returns the path by which [`PackedSources`] know a file; `None` if the scenario does not have it.
    pub fn path_of(&self, name: &str) -> Option<PathBuf> {
        self.0.contains_key(name).then(|| path(name))
    }
}

/// Returns the path of a packed file. The name may be an absolute path or lead out of a folder, and is part of the path all the
/// same.
fn path(name: &str) -> PathBuf {
    PathBuf::from(format!("{ROOT}/{name}"))
}

/// Returns true if a path is that of a packed file.
pub fn is_packed(path: &Path) -> bool {
    path.starts_with(ROOT)
}

/// The files of a scenario, and other sources for what it does not have.
#[derive(Clone, Copy)]
pub struct PackedSources<'a> {
    /// The files of the scenario.
    pub packed: &'a PackedFiles,
    /// The other sources.
    pub others: &'a dyn Sources,
}

impl PackedSources<'_> {
    fn find(&self, path: &Path) -> Option<&[u8]> {
        let name = path.to_str()?.strip_prefix(ROOT)?.strip_prefix('/')?;
        self.packed.0.get(name).map(Vec::as_slice)
    }
}

impl Sources for PackedSources<'_> {
    fn read(&self, path: &Path, limit: u64) -> io::Result<Vec<u8>> {
        match self.find(path) {
            Some(bytes) if bytes.len() as u64 > limit => Err(ErrorKind::FileTooLarge.into()),
            Some(bytes) => Ok(bytes.to_vec()),
            None => self.others.read(path, limit),
        }
    }
    fn is_file(&self, path: &Path) -> bool {
        self.find(path).is_some() || self.others.is_file(path)
    }
    fn exists(&self, path: &Path) -> bool {
        self.find(path).is_some() || self.others.exists(path)
    }
    fn kept(&self, name: &str, limit: u64) -> Option<Vec<u8>> {
        self.others.kept(name, limit)
    }
    fn keep(&self, name: &str, bytes: &[u8]) {
        self.others.keep(name, bytes);
    }
}
