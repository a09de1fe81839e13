//! Caches the bytes of the motion database between runs, and the derived data within one.
//!
//! A cached file that is missing, damaged or of another version is rebuilt; failure to write one is ignored.

use crate::console::output::Outputs;
use metamorph_module_agent::regular_file;
use metamorph_protocol::metamodule::motions::{Motions, MotionsError};
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::database::{Database, VERSION};
use std::cell::OnceCell;
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// Bytes of a cached file at most; the current one has a fifth of that.
const MAX_BYTES: u64 = 64 << 20;

/// Returns the motions of a kind of metamodule, created once per thread. Simulating threads do not share
/// them, because they would contend for the caches of earlier searches.
pub fn motions(kind: Kind) -> Result<Motions, MotionsError> {
    static DATABASE: OnceLock<Arc<Database>> = OnceLock::new();
    thread_local! {
        static MADE: [OnceCell<Motions>; Kind::ALL.len()] = const { [const { OnceCell::new() }; Kind::ALL.len()] };
    }
    MADE.with(|made| {
        let slot = &made[kind as usize];
        if let Some(motions) = slot.get() {
            return Ok(motions.clone());
        }
        let new = Motions::new(Arc::clone(DATABASE.get_or_init(|| Arc::new(database(true)))), kind)?;
        Ok(slot.get_or_init(|| new).clone())
    })
}

/// Returns the motion database. If `keep` is set, it is read from the cache, or built and written there;
/// otherwise it is built.
pub fn database(keep: bool) -> Database {
    let variable = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty());
    match keep.then(|| place(variable)).flatten() {
        Some(path) => kept_at(&path),
        None => Database::build(),
    }
}

/// Returns the path of the cached file, in `$XDG_CACHE_HOME/metamorph` or `~/.cache/metamorph`; `None` if
/// neither `XDG_CACHE_HOME` nor `HOME` is usable.
fn place(variable: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    let base = match variable("XDG_CACHE_HOME").map(PathBuf::from).filter(|p| p.is_absolute()) {
        Some(base) => base,
        None => PathBuf::from(variable("HOME")?).join(".cache"),
    };
    Some(base.join("metamorph").join(format!("roombots-motions-{VERSION}.bin")))
}

fn kept_at(path: &Path) -> Database {
    let kept = regular_file::read(path, MAX_BYTES).ok();
    if let Some(database) = kept.and_then(|b| Database::from_bytes(&b).ok()) {
        return database;
    }
    let database = Database::build();
    let made = fs::create_dir_all(path.parent().unwrap_or(Path::new(".")));
    if made.is_ok()
        && let Err(error) = Outputs::default()
            .writes("the motion database", path)
            .and_then(|file| file.write(database.to_bytes()))
    {
        tracing::debug!("{error}");
    }
    database
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_place_follows_the_environment() {
        let only_home = |n: &str| (n == "HOME").then(|| OsString::from("/home/someone"));
        let path = place(only_home).unwrap();
        assert!(path.starts_with("/home/someone/.cache/metamorph"), "{path:?}");
        let cache = |n: &str| (n == "XDG_CACHE_HOME").then(|| OsString::from("/var/keep"));
        assert!(place(cache).unwrap().starts_with("/var/keep/metamorph"));
        assert_eq!(place(|_| None), None);
    }

    /// A second run reads what the first wrote; damage is repaired; an unwritable cache is not an error.
    #[test]
    fn kept_bytes_are_used_and_repaired() {
        let folder = std::env::temp_dir().join(format!("metamorph-cache-{}", std::process::id()));
        let path = folder.join("deeper").join("motions.bin");
        let first = kept_at(&path);
        let bytes = fs::read(&path).unwrap();
        assert_eq!(bytes, first.to_bytes());
        fs::write(&path, &bytes[..1000]).unwrap();
        assert_eq!(kept_at(&path), first);
        assert_eq!(fs::read(&path).unwrap(), bytes);
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
        fs::remove_dir_all(&folder).unwrap();
        assert_eq!(kept_at(Path::new("/proc/none/motions.bin")), first);
    }
}
