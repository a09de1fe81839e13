//! Work that pages ask for: one piece is carried out at a time, and what a page asks for later ends what it asked for
//! before.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Number of pages that are remembered; the one heard of least recently is forgotten.
pub const PAGES: usize = 8;

/// Why there is no answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoAnswer {
    /// The page has asked for something newer.
    Stale,
    /// The work has panicked.
    Failed,
}

/// Work in progress.
#[derive(Debug, Default)]
pub struct OneAtATime {
    /// Cancellation flag of the latest work of each page, by the page's name. The most recently active page is last.
    latest: Mutex<Vec<(String, Arc<AtomicBool>)>>,
    one: tokio::sync::Mutex<()>,
}

impl OneAtATime {
    /// Carries out work for a page on a thread of its own. The work is given what is set when it is no longer wanted.
    ///
    /// # Errors
    /// If the page has asked for newer work, or the work has failed.
    pub async fn carry_out<T: Send + 'static>(
        &self,
        page: &str,
        work: impl FnOnce(Arc<AtomicBool>) -> T + Send + 'static,
    ) -> Result<T, NoAnswer> {
        let cancelled = self.begin(page);
        let one = self.one.lock().await;
        if cancelled.load(Ordering::Relaxed) {
            return Err(NoAnswer::Stale);
        }
        let given = Arc::clone(&cancelled);
        let done = tokio::task::spawn_blocking(move || work(given)).await;
        drop(one);
        match done {
            Err(_) => Err(NoAnswer::Failed),
            Ok(_) if cancelled.load(Ordering::Relaxed) => Err(NoAnswer::Stale),
            Ok(answer) => Ok(answer),
        }
    }

    /// Cancels what the page has asked for before.
    fn begin(&self, page: &str) -> Arc<AtomicBool> {
        let cancelled = Arc::new(AtomicBool::new(false));
        // Poisoning is ignored: no statement that can panic leaves the value half changed.
        let mut latest = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(place) = latest.iter().position(|(name, _)| name == page) {
            latest.remove(place).1.store(true, Ordering::Relaxed);
        }
        latest.push((page.to_owned(), Arc::clone(&cancelled)));
        if latest.len() > PAGES {
            latest.remove(0);
        }
        cancelled
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newer_work_of_a_page_ends_its_older_work_and_not_that_of_others() {
        let work = OneAtATime::default();
        let (first, other, second) = (work.begin("a"), work.begin("b"), work.begin("a"));
        assert!(first.load(Ordering::Relaxed));
        assert!(!other.load(Ordering::Relaxed) && !second.load(Ordering::Relaxed));
        for i in 0..2 * PAGES {
            work.begin(&i.to_string());
        }
        assert_eq!(work.latest.lock().unwrap().len(), PAGES);
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        assert_eq!(runtime.block_on(work.carry_out("a", |_| 7)), Ok(7));
        let ended = work.carry_out("a", |cancelled| cancelled.store(true, Ordering::Relaxed));
        assert_eq!(runtime.block_on(ended), Err(NoAnswer::Stale));
    }
}
