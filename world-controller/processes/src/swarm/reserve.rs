//! Shared memory that a run reserves in advance: a file in the run's directory with all its pages allocated.
//! It covers what agents will still need while the swarm starts, so that a shortage is an error at the start;
//! and, as long as the run lasts, what its end needs in case something else fills the shared memory.

use crate::swarm::outcome::SwarmError;
use metamorph_module_agent::transport::SpaceShortage;
use metamorph_module_agent::transport::iceoryx::space;
use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;
use std::fs::File;
use std::io;
use std::path::Path;

const NAME: &str = "reserve";
/// Shared memory for each agent, and for the run, in bytes; twice as much as measured.
const SPACE: (u64, u64) = (200 << 10, 8 << 20);
/// The part for the run that the controller takes at the start, in bytes.
const OWN: u64 = SPACE.1 - LAST;
/// The part that is held until the run ends, in bytes.
const LAST: u64 = 1 << 20;
/// A run ends when fewer bytes than this are free.
pub const SCARCE: u64 = 512 << 10;

/// The reserve of a run. Its file is removed with the run's directory. The default holds nothing, for runs
/// without shared memory.
#[derive(Debug, Default)]
pub struct Reserve {
    file: Option<File>,
    held: u64,
    /// True if the run uses shared memory.
    shared: bool,
}

/// Returns the bytes of shared memory that a run of so many agents must find free.
pub fn needed(agents: u64) -> u64 {
    agents * SPACE.0 + SPACE.1
}

impl Reserve {
    /// Reserves the needs of `agents` agents.
    ///
    /// # Errors
    /// If too little is free, or the limit of file sizes is too low.
    pub fn take(root: &Path, agents: u64) -> Result<Reserve, SwarmError> {
        let held = needed(agents);
        // A failed attempt would take all memory for a moment, which may kill other programs.
        match space::free() {
            Ok(free) if free < held => return Err(shortage(held, free)),
            Ok(_) => {}
            Err(e) => return Err(SwarmError::NoSharedMemory(e)),
        }
        let create = || -> io::Result<File> {
            let file = File::create_new(root.join(NAME))?;
            fallocate(&file, FallocateFlags::empty(), 0, held)?;
            Ok(file)
        };
        Ok(Reserve { file: Some(create().map_err(|e| refused(e, held))?), held, shared: true })
    }

    /// Returns the rest of the reserve of a run that is taken over.
    pub fn left(root: &Path) -> Reserve {
        let file = File::options().write(true).open(root.join(NAME)).ok();
        let held = file.as_ref().and_then(|file| Some(file.metadata().ok()?.len())).unwrap_or_default();
        Reserve { file, held, shared: true }
    }

    /// Releases the part that the controller is about to take.
    pub fn release_own(&mut self) {
        self.shrink(self.held.saturating_sub(OWN).max(LAST));
    }

    /// Releases half of what one agent needs: what it needs to start, or what it and the controller need for its
    /// contacts.
    pub fn release_one(&mut self) {
        self.shrink(self.held.saturating_sub(SPACE.0 / 2).max(LAST));
    }

    /// Releases what all agents need for their contacts.
    pub fn release_most(&mut self) {
        self.shrink(LAST);
    }

    /// Releases everything, because the run ends.
    pub fn release(&mut self) {
        self.shrink(0);
    }

    /// Checks that shared memory does not run out.
    ///
    /// # Errors
    /// If fewer than [`SCARCE`] bytes are free.
    pub fn check(&self) -> Result<(), SpaceShortage> {
        if self.shared { space::require(SCARCE) } else { Ok(()) }
    }

    fn shrink(&mut self, held: u64) {
        if held < self.held
            && let Some(file) = &self.file
            && let Err(e) = file.set_len(held)
        {
            tracing::warn!("reserved memory could not be given back: {e}");
        }
        self.held = self.held.min(held);
    }
}

fn shortage(needed: u64, free: u64) -> SwarmError {
    SwarmError::Space { needed, available: free }
}

/// Returns the error for a failed allocation of the controller's own part.
pub fn refused_own(error: io::Error) -> SwarmError {
    refused(error, OWN)
}

fn refused(error: io::Error, needed: u64) -> SwarmError {
    let errno = error.raw_os_error().unwrap_or_default();
    if [Errno::NOSPC, Errno::DQUOT, Errno::NOMEM].iter().any(|e| e.raw_os_error() == errno) {
        return shortage(needed, space::free().unwrap_or_default());
    }
    if errno == Errno::FBIG.raw_os_error() {
        return SwarmError::FileSize { needed: needed >> 10 };
    }
    SwarmError::NoSharedMemory(error)
}
