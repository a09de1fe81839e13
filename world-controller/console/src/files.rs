//! The file system as a source of files, and the cache of the user.

use crate::output::Outputs;
use crate::output_kind::OutputKind;
use metamorph_module_agent::regular_file;
use metamorph_text::sources::{STANDARD_INPUT, Sources};
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// The file system. Relative paths begin at the working directory; what takes long to compute is kept in
/// `$XDG_CACHE_HOME/metamorph` or `~/.cache/metamorph`.
#[derive(Clone, Copy, Debug)]
pub struct Files;

impl Sources for Files {
    fn read(&self, path: &Path, limit: u64) -> io::Result<Vec<u8>> {
        regular_file::read(path, limit)
    }
    fn read_argument(&self, path: &Path, limit: u64) -> io::Result<Vec<u8>> {
        // Descriptors inherited from the parent process are read, whatever they are; opening another special file
        // could block without end.
        let path = if path == Path::new(STANDARD_INPUT) { Path::new("/dev/stdin") } else { path };
        if !["/dev/stdin", "/dev/fd/", "/proc/self/fd/"]
            .iter()
            .any(|start| path.to_string_lossy().starts_with(start))
        {
            return regular_file::read(path, limit);
        }
        let mut bytes = Vec::new();
        File::open(path)?.take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
        if bytes.len() as u64 > limit { Err(io::ErrorKind::FileTooLarge.into()) } else { Ok(bytes) }
    }
    fn is_file(&self, path: &Path) -> bool {
        fs::metadata(path).is_ok_and(|file| !file.is_dir())
    }
    fn exists(&self, path: &Path) -> bool {
        fs::symlink_metadata(path).is_ok()
    }
    fn beside(&self, missing: &Path) -> Vec<PathBuf> {
        let directory = missing.parent().filter(|parent| !parent.as_os_str().is_empty());
        let entries = fs::read_dir(directory.unwrap_or(Path::new("."))).into_iter().flatten().flatten();
        let mut beside: Vec<PathBuf> = entries
            .map(|entry| directory.map_or_else(PathBuf::new, Path::to_owned).join(entry.file_name()))
            .collect();
        beside.sort();
        beside
    }
    fn kept(&self, name: &str, limit: u64) -> Option<Vec<u8>> {
        regular_file::read(&cache()?.join(name), limit).ok()
    }
    fn keep(&self, name: &str, bytes: &[u8]) {
        if let Some(folder) = cache() {
            keep_at(&folder.join(name), bytes);
        }
    }
}

/// Returns the folder of the cache; `None` if neither `XDG_CACHE_HOME` nor `HOME` is usable.
fn cache() -> Option<PathBuf> {
    cache_of(|name: &str| std::env::var_os(name).filter(|value| !value.is_empty()))
}

fn cache_of(variable: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    let base = match variable("XDG_CACHE_HOME").map(PathBuf::from).filter(|path| path.is_absolute()) {
        Some(base) => base,
        None => PathBuf::from(variable("HOME")?).join(".cache"),
    };
    Some(base.join("metamorph"))
}

/// Writes a cached file. Failure is ignored: the content is computed again next time.
fn keep_at(path: &Path, bytes: &[u8]) {
    let made = fs::create_dir_all(path.parent().unwrap_or(Path::new(".")));
    if made.is_ok()
        && let Err(error) = Outputs::default()
            .writes("what is computed once", path, OutputKind::Any)
            .and_then(|file| file.write(bytes))
    {
        tracing::debug!("{error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cache_follows_the_environment() {
        let only_home = |n: &str| (n == "HOME").then(|| OsString::from("/home/someone"));
        assert_eq!(cache_of(only_home).unwrap(), Path::new("/home/someone/.cache/metamorph"));
        let cache = |n: &str| (n == "XDG_CACHE_HOME").then(|| OsString::from("/var/keep"));
        assert_eq!(cache_of(cache).unwrap(), Path::new("/var/keep/metamorph"));
        assert_eq!(cache_of(|_| None), None);
    }

    /// Folders are made, a file is replaced as a whole, and a cache that cannot be written is no error.
    #[test]
    fn kept_bytes_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deeper").join("motions.bin");
        keep_at(&path, b"first");
        keep_at(&path, b"second");
        assert_eq!(fs::read(&path).unwrap(), b"second");
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
        keep_at(Path::new("/proc/none/motions.bin"), b"");
    }

    #[test]
    fn neighbours_of_a_missing_file_are_listed_in_order() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["b.toml", "a.txt"] {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let beside = Files.beside(&folder.path().join("c.toml"));
        assert_eq!(beside, ["a.txt", "b.toml"].map(|name| folder.path().join(name)));
        assert!(Files.exists(folder.path()) && !Files.is_file(folder.path()));
    }
}
