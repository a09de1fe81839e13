//! A scene that is shared by its writer and its readers.

use crate::scene::Scene;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A scene shared by its writer and its readers.
#[derive(Clone, Debug)]
pub struct Shared(Arc<Mutex<Scene>>);

impl Shared {
    /// Shares a scene.
    pub fn new(scene: Scene) -> Shared {
        Shared(Arc::new(Mutex::new(scene)))
    }
    /// Locks the scene. A reader that has panicked leaves it as it was.
    pub fn lock(&self) -> MutexGuard<'_, Scene> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
    /// Replaces the scene by another version of the same run. Pages start again from the beginning.
    pub fn replace(&self, mut scene: Scene) {
        let mut shared = self.lock();
        scene.succeed(&shared);
        *shared = scene;
    }
    /// Returns the scene once its writer is done.
    pub fn into_inner(self) -> Scene {
        let alone = Arc::try_unwrap(self.0).expect("invariant: the writer of a scene drops it");
        alone.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}
