//! The two sources of a run's clock: a monotonic clock, and the clock page that the controller writes and
//! every agent reads. [`FileClock`] serves the processes of one machine, [`MemoryClock`] a single process.

use crate::clock::monotonic;
use crate::clock::page::{Page, path};
use metamorph_protocol::time::Time;
use std::fs::{self, File};
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// A monotonic clock and a clock page that all members of a run share.
pub trait ClockSource {
    /// Returns the nanoseconds since a fixed instant, the same for all members of the run. Never goes back.
    fn monotonic(&self) -> u64;

    /// Reads the clock page.
    ///
    /// # Errors
    /// If there is no whole page.
    fn read_page(&self) -> io::Result<Page>;

    /// Writes the clock page; only the controller does.
    ///
    /// # Errors
    /// If the page cannot be written.
    fn write_page(&self, page: &Page) -> io::Result<()>;
}

/// CLOCK_MONOTONIC, and the clock page in the run's directory.
#[derive(Debug)]
pub struct FileClock {
    page: File,
}

impl FileClock {
    /// Opens the clock of the run in `root`, as an agent uses it.
    ///
    /// # Errors
    /// If the clock page cannot be opened.
    pub fn open(root: &Path) -> io::Result<FileClock> {
        Ok(FileClock { page: File::open(path(root))? })
    }

    /// Opens the clock of the run in `root`, as its controller uses it.
    ///
    /// # Errors
    /// If the clock page cannot be opened for writing.
    pub fn open_writable(root: &Path) -> io::Result<FileClock> {
        Ok(FileClock { page: File::options().read(true).write(true).open(path(root))? })
    }

    /// Creates the clock of a run in `root`. Scenario time stands still, at `time`.
    ///
    /// # Errors
    /// If the clock page cannot be written.
    pub fn create(root: &Path, time: Time) -> io::Result<FileClock> {
        let part = root.join("clock.part");
        Page::stopped(monotonic(), time).write(&File::create(&part)?)?;
        fs::rename(&part, path(root))?;
        FileClock::open_writable(root)
    }
}

impl ClockSource for FileClock {
    fn monotonic(&self) -> u64 {
        monotonic()
    }
    fn read_page(&self) -> io::Result<Page> {
        Page::read(&self.page)
    }
    fn write_page(&self, page: &Page) -> io::Result<()> {
        page.write(&self.page)
    }
}

/// A clock page in memory. Clones share it.
#[derive(Clone, Debug)]
pub struct MemoryClock {
    page: Arc<Mutex<Page>>,
    /// The nanoseconds of a clock that only [`MemoryClock::advance`] moves; `None` for CLOCK_MONOTONIC.
    manual: Option<Arc<AtomicU64>>,
}

impl MemoryClock {
    /// Creates a clock over CLOCK_MONOTONIC. Scenario time stands at zero.
    pub fn real() -> MemoryClock {
        let page = Page::stopped(monotonic(), Time::ZERO);
        MemoryClock { page: Arc::new(Mutex::new(page)), manual: None }
    }

    /// Creates a clock that only [`MemoryClock::advance`] moves. Scenario time stands at zero.
    pub fn manual() -> MemoryClock {
        let page = Page::stopped(0, Time::ZERO);
        MemoryClock { page: Arc::new(Mutex::new(page)), manual: Some(Arc::default()) }
    }

    /// Moves a manual clock forwards; without effect on others.
    pub fn advance(&self, nanos: u64) {
        if let Some(manual) = &self.manual {
            manual.fetch_add(nanos, Ordering::Relaxed);
        }
    }
}

impl ClockSource for MemoryClock {
    fn monotonic(&self) -> u64 {
        self.manual.as_ref().map_or_else(monotonic, |manual| manual.load(Ordering::Relaxed))
    }
    fn read_page(&self) -> io::Result<Page> {
        Ok(*self.page.lock().unwrap_or_else(PoisonError::into_inner))
    }
    fn write_page(&self, page: &Page) -> io::Result<()> {
        *self.page.lock().unwrap_or_else(PoisonError::into_inner) = *page;
        Ok(())
    }
}
