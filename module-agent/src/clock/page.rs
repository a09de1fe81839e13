//! The clock page: how scenario time passes in a run, in a small file of the run's directory that the
//! controller writes and every process reads.
//!
//! The page is a promise. It says how scenario time passes until a given instant of CLOCK_MONOTONIC, and is
//! never taken back: the controller only adds the next slice. A reader may therefore use its copy until that
//! instant, all readers agree on the time, and it neither jumps nor goes back. If the controller does not
//! renew its promise in time (its machine is busy, or it is stopped or killed), scenario time stands still at
//! the end of the last slice.
//!
//! Not here: how fast time should pass, which the controller decides.

use crate::clock::Speed;
use metamorph_protocol::time::Time;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Identifies the file; the last byte is the version of the layout.
const MAGIC: [u8; 8] = *b"MMCLOCK\x01";
/// Size of the file in bytes: magic, two stretches, the end of the promise, a check sum.
pub const SIZE: usize = 8 + 2 * 24 + 8 + 4;
/// Largest number of reads of a page whose check sum does not fit, as while it is being written.
const ATTEMPTS: usize = 64;

/// Returns the path of the clock page of the run in `root`.
pub fn path(root: &Path) -> PathBuf {
    root.join("clock")
}

/// A stretch of time of constant speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stretch {
    /// CLOCK_MONOTONIC at its beginning.
    from: u64,
    /// Scenario time at its beginning.
    time: u64,
    speed: Speed,
}

impl Stretch {
    fn at(&self, monotonic: u64) -> u64 {
        self.time.saturating_add(self.speed.scenario(monotonic.saturating_sub(self.from)))
    }
}

/// How scenario time passes up to a given instant: two consecutive stretches of constant speed. All instants
/// are nanoseconds of CLOCK_MONOTONIC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Page {
    now: Stretch,
    next: Stretch,
    until: u64,
}

impl Page {
    /// Returns a page on which scenario time stands at `time` from the instant `monotonic` on, until a slice
    /// is added.
    pub const fn stopped(monotonic: u64, time: Time) -> Page {
        let stretch = Stretch { from: monotonic, time: time.0, speed: Speed::STOPPED };
        Page { now: stretch, next: stretch, until: monotonic }
    }

    /// Returns the scenario time at an instant; after the end of the promise, the time at its end.
    pub fn at(&self, monotonic: u64) -> Time {
        let monotonic = monotonic.min(self.until);
        let stretch = if monotonic >= self.next.from { &self.next } else { &self.now };
        Time(stretch.at(monotonic))
    }

    /// Returns how fast time passes at an instant; `None` if the promise does not cover it.
    pub fn speed_at(&self, monotonic: u64) -> Option<Speed> {
        let stretch = if monotonic >= self.next.from { &self.next } else { &self.now };
        (monotonic < self.until).then_some(stretch.speed)
    }

    /// Returns the end of the promise.
    pub const fn until(&self) -> u64 {
        self.until
    }

    /// Returns when the last slice begins, which is when the next one should be added.
    pub const fn renewal(&self) -> u64 {
        self.next.from
    }

    /// Returns the page with a further slice of `nanos` in which time passes with `speed`, added at an
    /// instant not before [`Page::renewal`]. The slice follows the last one, or begins now if that is over.
    pub fn extended(&self, monotonic: u64, nanos: u64, speed: Speed) -> Page {
        debug_assert!(monotonic >= self.next.from, "a page holds two slices");
        let from = self.until.max(monotonic);
        let next = Stretch { from, time: self.at(from).0, speed };
        let now = if from > self.until { next } else { self.next };
        Page { now, next, until: from.saturating_add(nanos) }
    }

    /// Returns the page by a clock that is ahead by `by` nanoseconds of the one that it was written by.
    pub const fn shifted(&self, by: i64) -> Page {
        let Page { now, next, until } = *self;
        Page {
            now: Stretch { from: now.from.saturating_add_signed(by), time: now.time, speed: now.speed },
            next: Stretch { from: next.from.saturating_add_signed(by), time: next.time, speed: next.speed },
            until: until.saturating_add_signed(by),
        }
    }

    /// Returns the bytes of the page, as other hosts get it.
    pub fn encode(&self) -> [u8; SIZE] {
        let mut bytes = [0; SIZE];
        bytes[..8].copy_from_slice(&MAGIC);
        for (stretch, out) in [&self.now, &self.next].into_iter().zip(bytes[8..56].chunks_exact_mut(24)) {
            let (num, den) = stretch.speed.into();
            out[..8].copy_from_slice(&stretch.from.to_le_bytes());
            out[8..16].copy_from_slice(&stretch.time.to_le_bytes());
            out[16..20].copy_from_slice(&num.to_le_bytes());
            out[20..].copy_from_slice(&den.to_le_bytes());
        }
        bytes[56..64].copy_from_slice(&self.until.to_le_bytes());
        let sum = crc32fast::hash(&bytes[..SIZE - 4]);
        bytes[SIZE - 4..].copy_from_slice(&sum.to_le_bytes());
        bytes
    }

    /// Decodes the output of [`Page::encode`]; `None` if it is torn, foreign or of another version.
    pub fn decode(bytes: &[u8; SIZE]) -> Option<Page> {
        let (body, sum) = bytes.split_last_chunk::<4>()?;
        if crc32fast::hash(body) != u32::from_le_bytes(*sum) || !body.starts_with(&MAGIC) {
            return None;
        }
        let u64_at = |i: usize| body[i..].first_chunk().map(|b| u64::from_le_bytes(*b));
        let u32_at = |i: usize| body[i..].first_chunk().map(|b| u32::from_le_bytes(*b));
        let stretch = |i: usize| {
            let speed = Speed::try_from((u32_at(i + 16)?, u32_at(i + 20)?)).ok()?;
            Some(Stretch { from: u64_at(i)?, time: u64_at(i + 8)?, speed })
        };
        Some(Page { now: stretch(8)?, next: stretch(32)?, until: u64_at(56)? })
    }

    /// Reads the page of a run.
    ///
    /// # Errors
    /// If the file cannot be read, or no whole page was seen.
    pub fn read(file: &File) -> io::Result<Page> {
        let mut bytes = [0; SIZE];
        for _ in 0..ATTEMPTS {
            file.read_exact_at(&mut bytes, 0)?;
            if let Some(page) = Page::decode(&bytes) {
                return Ok(page);
            }
        }
        Err(io::Error::other("the clock page is damaged or was written by another program"))
    }

    /// Writes the page of a run.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, file: &File) -> io::Result<()> {
        file.write_all_at(&self.encode(), 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn speed(num: u32, den: u32) -> Speed {
        Speed::new(num, den).unwrap()
    }

    #[test]
    fn a_slice_follows_on_the_last_one() {
        let page = Page::stopped(1_000, Time(7));
        assert_eq!((page.at(0), page.at(5_000), page.speed_at(1_000)), (Time(7), Time(7), None));
        // Nothing had been promised up to 2,000.
        let page = page.extended(2_000, 100, speed(3, 1));
        assert_eq!((page.at(2_010), page.at(2_100), page.at(9_000)), (Time(37), Time(307), Time(307)));
        let page = page.extended(2_050, 100, Speed::STOPPED);
        assert_eq!((page.at(2_050), page.at(2_100), page.at(2_200)), (Time(157), Time(307), Time(307)));
        assert_eq!((page.renewal(), page.until()), (2_100, 2_200));
        let page = page.extended(2_100, 100, speed(1, 2));
        assert_eq!((page.at(2_150), page.at(2_200), page.at(2_300)), (Time(307), Time(307), Time(357)));
        assert_eq!(page.speed_at(2_250), Some(speed(1, 2)));
    }

    #[test]
    fn a_torn_page_is_not_believed() {
        let page = Page::stopped(5, Time(6)).extended(9, 100, speed(7, 2));
        let bytes = page.encode();
        assert_eq!(Page::decode(&bytes), Some(page));
        for i in 0..SIZE {
            let mut torn = bytes;
            torn[i] ^= 1;
            assert_eq!(Page::decode(&torn), None, "byte {i}");
        }
    }

    /// A reader that examines every moment reads whole pages only.
    #[test]
    fn readers_never_see_half_of_a_page() {
        let dir = tempfile::tempdir().unwrap();
        let file = File::create(path(dir.path())).unwrap();
        let mut page = Page::stopped(0, Time::ZERO);
        page.write(&file).unwrap();
        let reader = File::open(path(dir.path())).unwrap();
        std::thread::scope(|scope| {
            let read = scope.spawn(|| {
                let mut last = Page::read(&reader).unwrap();
                while last.until() < 2_000 {
                    let next = Page::read(&reader).unwrap();
                    assert!(next.until() >= last.until());
                    last = next;
                }
            });
            for i in 0..2_000 {
                page = page.extended(i, 1, speed(1, 1));
                page.write(&file).unwrap();
            }
            read.join().unwrap();
        });
    }

    proptest! {
        /// Whatever the controller does and whichever page a reader holds, a later look never shows an
        /// earlier time, and a newer page never takes back a time that was shown.
        #[test]
        fn time_never_goes_back(
            slices in proptest::collection::vec((0u64..200, 0u64..150, 0u32..50, 1u32..9), 1..40),
        ) {
            let mut page = Page::stopped(1_000, Time::ZERO);
            let mut m = 1_000;
            for (wait, nanos, num, den) in slices {
                let before = page;
                m = page.renewal().max(m) + wait;
                page = page.extended(m, nanos, speed(num, den));
                for at in m.saturating_sub(300)..m + 300 {
                    prop_assert!(page.at(at + 1) >= page.at(at));
                    if at >= m {
                        // An old copy is never ahead of the new one, and equal as far as it goes.
                        prop_assert!(before.at(at) <= page.at(at));
                        prop_assert!(at >= before.until() || before.at(at) == page.at(at));
                    }
                }
            }
        }
    }
}
