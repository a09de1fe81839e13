//! The motion database: its bytes are kept between runs, and the data derived from it within one.
//!
//! Kept bytes that are damaged or of another version are built again.

use metamorph_protocol::metamodule::motions::{Motions, MotionsError};
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::database::{Database, VERSION};
use metamorph_text::sources::Sources;
use std::cell::OnceCell;
use std::sync::{Arc, OnceLock};

/// Largest size of the kept bytes, in bytes; the current ones have a fifth of that.
const BYTES_MAX: u64 = 64 << 20;

/// Returns the motions of a kind of metamodule, created once per thread. Simulating threads do not share
/// them, because they would contend for the caches of earlier searches.
pub fn motions(sources: &dyn Sources, kind: Kind) -> Result<Motions, MotionsError> {
    static DATABASE: OnceLock<Arc<Database>> = OnceLock::new();
    thread_local! {
        static MADE: [OnceCell<Motions>; Kind::ALL.len()] = const { [const { OnceCell::new() }; Kind::ALL.len()] };
    }
    MADE.with(|made| {
        let slot = &made[kind as usize];
        if let Some(motions) = slot.get() {
            return Ok(motions.clone());
        }
        let new = Motions::new(Arc::clone(DATABASE.get_or_init(|| Arc::new(database(sources)))), kind)?;
        Ok(slot.get_or_init(|| new).clone())
    })
}

/// Returns the motion database: that which `sources` keep, or a new one, which they are given to keep.
pub fn database(sources: &dyn Sources) -> Database {
    let name = format!("roombots-motions-{VERSION}.bin");
    let kept = sources.kept(&name, BYTES_MAX);
    kept.and_then(|bytes| Database::from_bytes(&bytes).ok()).unwrap_or_else(|| {
        let database = Database::build();
        sources.keep(&name, &database.to_bytes());
        database
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io;
    use std::path::Path;
    use std::sync::Mutex;

    #[derive(Default)]
    struct Memory(Mutex<Option<Vec<u8>>>);

    impl Sources for Memory {
        fn read(&self, _path: &Path, _limit: u64) -> io::Result<Vec<u8>> {
            Err(io::ErrorKind::NotFound.into())
        }
        fn is_file(&self, _path: &Path) -> bool {
            false
        }
        fn kept(&self, _name: &str, _limit: u64) -> Option<Vec<u8>> {
            self.0.lock().unwrap().clone()
        }
        fn keep(&self, _name: &str, bytes: &[u8]) {
            *self.0.lock().unwrap() = Some(bytes.to_owned());
        }
    }

    /// A second run reads what the first kept, and damage is repaired.
    #[test]
    fn kept_bytes_are_used_and_repaired() {
        let memory = Memory::default();
        let first = database(&memory);
        let bytes = memory.kept("", 0).unwrap();
        assert_eq!(bytes, first.to_bytes());
        memory.keep("", &bytes[..1000]);
        assert_eq!(database(&memory), first);
        assert_eq!(memory.kept("", 0).unwrap(), bytes);
    }
}
