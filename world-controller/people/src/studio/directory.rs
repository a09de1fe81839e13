//! The directory of `--dir`: drawings are read and written in it and nowhere else. Names have no path, links are not
//! followed, and nothing is overwritten unless that is asked for.

use metamorph_module_agent::regular_file::must_be_regular;
use rustix::fs::{AtFlags, CWD, Dir, Mode, OFlags, RenameFlags, openat, renameat, renameat_with, unlinkat};
use rustix::io::Errno;
use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::OwnedFd;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use thiserror::Error;

/// Largest size of a file, in bytes.
pub const MAX_FILE: u64 = 1 << 20;
/// Largest number of characters of a name.
const MAX_NAME: usize = 64;
/// Number of names that are listed.
const LISTED: usize = 1_000;

/// Why a file is not read or written.
#[derive(Debug, Error)]
pub enum DirectoryError {
    /// The name is not allowed.
    #[error(
        "a name has 1 to {MAX_NAME} letters, digits, dots, dashes and underscores, and begins with no dot"
    )]
    Name,
    /// The file is there already.
    #[error("a file of this name is there already; save with `replace`, or choose another name")]
    Exists,
    /// The file is too large.
    #[error("the file is longer than {MAX_FILE} bytes")]
    TooLarge,
    /// The system refuses.
    #[error("{0}")]
    System(#[from] io::Error),
}

impl From<Errno> for DirectoryError {
    fn from(error: Errno) -> DirectoryError {
        DirectoryError::System(error.into())
    }
}

/// An open directory.
#[derive(Debug)]
pub struct Directory {
    handle: OwnedFd,
    written: AtomicU64,
}

/// Returns whether a file may have this name.
pub fn is_name(name: &str) -> bool {
    let plain = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'-' | b'_');
    (1..=MAX_NAME).contains(&name.len()) && name.bytes().all(plain) && !name.starts_with('.')
}

impl Directory {
    /// Opens a directory.
    ///
    /// # Errors
    /// If there is none that can be opened.
    pub fn open(path: &Path) -> io::Result<Directory> {
        let flags = OFlags::DIRECTORY | OFlags::RDONLY | OFlags::CLOEXEC;
        let handle = openat(CWD, path, flags, Mode::empty())?;
        Ok(Directory { handle, written: AtomicU64::new(0) })
    }

    /// Returns the names of files in the directory, in order.
    ///
    /// # Errors
    /// If the directory cannot be read.
    pub fn names(&self) -> Result<Vec<String>, DirectoryError> {
        let entries = Dir::read_from(&self.handle)?;
        let name = |entry: rustix::fs::DirEntry| entry.file_name().to_str().ok().map(str::to_owned);
        let names = entries.map_while(Result::ok).filter_map(name).filter(|name| is_name(name));
        let mut names: Vec<String> = names.take(LISTED).collect();
        names.sort_unstable();
        Ok(names)
    }

    /// Reads a regular file.
    ///
    /// # Errors
    /// If the name is not allowed, or the file is no regular one, too large or unreadable.
    pub fn read(&self, name: &str) -> Result<Vec<u8>, DirectoryError> {
        if !is_name(name) {
            return Err(DirectoryError::Name);
        }
        let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
        let file = File::from(openat(&self.handle, name, flags, Mode::empty())?);
        must_be_regular(file.metadata()?.file_type())?;
        let mut bytes = Vec::new();
        file.take(MAX_FILE + 1).read_to_end(&mut bytes)?;
        if bytes.len() as u64 > MAX_FILE { Err(DirectoryError::TooLarge) } else { Ok(bytes) }
    }

    /// Writes a file as a whole.
    ///
    /// # Errors
    /// If the name is not allowed, the content is too large, the file exists and is not to be replaced, or the system
    /// refuses.
    pub fn write(&self, name: &str, content: &[u8], replace: bool) -> Result<(), DirectoryError> {
        if !is_name(name) {
            return Err(DirectoryError::Name);
        }
        if content.len() as u64 > MAX_FILE {
            return Err(DirectoryError::TooLarge);
        }
        let number = self.written.fetch_add(1, Ordering::Relaxed);
        let draft = format!(".metamorph-{}-{number}", std::process::id());
        let flags = OFlags::WRONLY | OFlags::CREATE | OFlags::EXCL | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        let mut file = File::from(openat(&self.handle, &draft, flags, Mode::from_raw_mode(0o644))?);
        let written = file.write_all(content).and_then(|()| file.sync_all());
        let renamed = written.map_err(DirectoryError::from).and_then(|()| match replace {
            true => Ok(renameat(&self.handle, &draft, &self.handle, name)?),
            false => match renameat_with(&self.handle, &draft, &self.handle, name, RenameFlags::NOREPLACE) {
                Err(Errno::EXIST) => Err(DirectoryError::Exists),
                other => Ok(other?),
            },
        });
        if renamed.is_err() {
            // The error before says more.
            let _ = unlinkat(&self.handle, &draft, AtFlags::empty());
        }
        renamed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::fs::symlink;

    #[test]
    fn files_are_read_and_written_in_the_directory_only() {
        let (outer, inner) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let secret = outer.path().join("secret");
        fs::write(&secret, "not yours").unwrap();
        symlink(&secret, inner.path().join("link.toml")).unwrap();
        symlink(outer.path(), inner.path().join("out")).unwrap();
        fs::create_dir(inner.path().join("folder")).unwrap();
        let directory = Directory::open(inner.path()).unwrap();
        for name in ["", ".", "..", "../secret", "/etc/passwd", "out/secret", ".hidden", "a\0b", "a b", "ü"]
        {
            assert!(matches!(directory.read(name), Err(DirectoryError::Name)), "{name:?}");
            assert!(matches!(directory.write(name, b"x", true), Err(DirectoryError::Name)), "{name:?}");
        }
        assert!(!is_name(&"a".repeat(65)) && is_name(&"a".repeat(64)));
        for name in ["link.toml", "folder", "none.toml"] {
            assert!(directory.read(name).is_err(), "{name}");
        }
        directory.write("a.toml", b"one", false).unwrap();
        assert!(matches!(directory.write("a.toml", b"two", false), Err(DirectoryError::Exists)));
        assert_eq!(directory.read("a.toml").unwrap(), b"one");
        directory.write("a.toml", b"two", true).unwrap();
        assert_eq!(directory.read("a.toml").unwrap(), b"two");
        // A link is replaced, and what it points to is not touched.
        assert!(matches!(directory.write("link.toml", b"x", false), Err(DirectoryError::Exists)));
        directory.write("link.toml", b"x", true).unwrap();
        assert_eq!(fs::read_to_string(&secret).unwrap(), "not yours");
        let large = vec![b'x'; MAX_FILE as usize + 1];
        assert!(matches!(directory.write("b.toml", &large, false), Err(DirectoryError::TooLarge)));
        fs::write(inner.path().join("large.toml"), &large).unwrap();
        assert!(matches!(directory.read("large.toml"), Err(DirectoryError::TooLarge)));
        assert_eq!(directory.names().unwrap(), ["a.toml", "folder", "large.toml", "link.toml", "out"]);
    }
}
