//! Opens files for reading, and refuses at once all but regular files: opening a named pipe waits for a
//! writer, and a device may have no end. Not here: which files are read.

use rustix::fs::{Mode, OFlags};
use std::fs::{self, File, FileType};
use std::io::{self, Read};
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

/// Opens a regular file. Never waits, even if the file is replaced by a pipe meanwhile.
///
/// # Errors
/// If the file cannot be opened, or is not a regular one.
pub fn open(path: &Path) -> io::Result<File> {
    // Checked before the open too, because opening a device may have effects.
    must_be_regular(fs::metadata(path).map_err(plain)?.file_type())?;
    let flags = OFlags::RDONLY | OFlags::CLOEXEC | OFlags::NONBLOCK | OFlags::NOCTTY;
    let file = File::from(rustix::fs::open(path, flags, Mode::empty()).map_err(|error| plain(error.into()))?);
    must_be_regular(file.metadata()?.file_type())?;
    Ok(file)
}

/// Returns the error with a text for those who do not know the names of the operating system's errors.
fn plain(error: io::Error) -> io::Error {
    let text = match error.kind() {
        io::ErrorKind::NotFound => "there is no such file",
        io::ErrorKind::NotADirectory => "there is no such file, since a part of its path is no directory",
        io::ErrorKind::PermissionDenied => "this user may not read it",
        _ => return error,
    };
    io::Error::new(error.kind(), text)
}

/// Reads a regular file of at most `most` bytes.
///
/// # Errors
/// If the file cannot be read, is not a regular one, or is longer.
pub fn read(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open(path)?.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, format!("it is longer than {most} bytes")));
    }
    Ok(bytes)
}

/// Refuses all kinds of files but regular ones.
///
/// # Errors
/// If it is another one, with its name.
pub fn must_be_regular(kind: FileType) -> io::Result<()> {
    let name = match kind {
        _ if kind.is_file() => return Ok(()),
        _ if kind.is_dir() => "a directory",
        _ if kind.is_fifo() => "a named pipe",
        _ if kind.is_socket() => "a socket",
        _ => "a device",
    };
    let what = format!("it is {name}, and only regular files are read");
    Err(io::Error::new(io::ErrorKind::InvalidInput, what))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::fs::{CWD, FileType as Kind, mknodat};
    use std::os::unix::net::UnixListener;

    #[test]
    fn only_regular_files_are_opened_and_nothing_is_waited_for() {
        let dir = tempfile::tempdir().unwrap();
        let (pipe, socket, file) = (dir.path().join("pipe"), dir.path().join("socket"), dir.path().join("f"));
        mknodat(CWD, &pipe, Kind::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
        let _socket = UnixListener::bind(&socket).unwrap();
        fs::write(&file, "12345").unwrap();
        let link = dir.path().join("link");
        std::os::unix::fs::symlink(&pipe, &link).unwrap();
        for (path, part) in [
            (pipe.as_path(), "a named pipe"),
            (&link, "a named pipe"),
            (&socket, "a socket"),
            (dir.path(), "a directory"),
            (Path::new("/dev/zero"), "a device"),
        ] {
            let error = open(path).unwrap_err().to_string();
            assert!(error.contains(part), "{path:?}: {error}");
        }
        assert_eq!(read(&file, 5).unwrap(), b"12345");
        assert!(read(&file, 4).unwrap_err().to_string().contains("longer than 4 bytes"));
        for (path, kind) in [("none", io::ErrorKind::NotFound), ("f/none", io::ErrorKind::NotADirectory)] {
            let error = open(&dir.path().join(path)).unwrap_err();
            assert!(
                error.kind() == kind && error.to_string().starts_with("there is no such file"),
                "{error}"
            );
        }
    }
}
