//! The source of the files that a scenario names: the caller hands in a [`Sources`], so that a scenario can be read
//! without a file system.

use std::io;
use std::path::{Path, PathBuf};

/// Stands for standard input where a command line names a file to be read.
pub const STANDARD_INPUT: &str = "-";

/// Gives the content of files by their paths.
///
/// Implementations return the same bytes for the same path as long as a scenario is being read. A path may be relative; the
/// implementation says to what.
pub trait Sources: Sync {
    /// Returns the content of a regular file of at most `limit` bytes.
    ///
    /// # Errors
    /// [`io::ErrorKind::FileTooLarge`] if it is longer, [`io::ErrorKind::InvalidInput`] if it is no regular file, or another
    /// kind if it cannot be read.
    fn read(&self, path: &Path, limit: u64) -> io::Result<Vec<u8>>;

    /// Returns the content of a file that a person names on a command line, which may be an open descriptor
    /// (`/dev/fd/3`) or [`STANDARD_INPUT`]; otherwise like [`read`](Sources::read).
    ///
    /// # Errors
    /// As those of [`read`](Sources::read).
    fn read_argument(&self, path: &Path, limit: u64) -> io::Result<Vec<u8>> {
        self.read(path, limit)
    }
    /// Returns true if something other than a directory is there; links are followed.
    fn is_file(&self, path: &Path) -> bool;
    /// Returns true if anything is there, a directory or a broken link among them.
    fn exists(&self, path: &Path) -> bool {
        self.is_file(path)
    }
    /// Returns the files in the directory of a missing one, in order; for suggestions.
    fn beside(&self, _missing: &Path) -> Vec<PathBuf> {
        Vec::new()
    }
    /// Returns what an earlier call of [`keep`](Sources::keep) has kept under this name, possibly in another process. The
    /// caller checks the content.
    fn kept(&self, _name: &str, _limit: u64) -> Option<Vec<u8>> {
        None
    }
    /// Keeps bytes that take long to compute under a name. It is allowed to do nothing.
    fn keep(&self, _name: &str, _bytes: &[u8]) {}
}

/// No files at all.
#[derive(Clone, Copy, Debug)]
pub struct NoFiles;

impl Sources for NoFiles {
    fn read(&self, _path: &Path, _limit: u64) -> io::Result<Vec<u8>> {
        Err(io::ErrorKind::NotFound.into())
    }
    fn is_file(&self, _path: &Path) -> bool {
        false
    }
}
