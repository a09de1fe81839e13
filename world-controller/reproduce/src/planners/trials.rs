//! Long experiments of independent trials: on several threads, with a line of progress, and kept in a file from which the same
//! command continues.
//!
//! The file has one line of JSON for its head and one for each trial, in the order in which trials ended. A last line without
//! a line end is left by a killed program and is cut off. A trial is known by its name, so a later command may ask for more.

use crate::error::ReproduceError;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::Live;
use metamorph_experiments::sweep::bar;
use metamorph_text::escape::Shown;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Write};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;
use thiserror::Error;

/// The name of the format.
const FORMAT: &str = "metamorph-trials";
/// The version of the file's layout.
pub const VERSION: u32 = 1;
/// Time after which the line of progress is redrawn though no trial has ended.
const PATIENCE: Duration = Duration::from_millis(200);

/// Why the trials of a file cannot be used.
#[derive(Debug, Error)]
pub enum TrialsError {
    /// The file cannot be read or written.
    #[error("--out: cannot use {}: {error}\n  fix: name a directory on a disk with room that is yours", .path.shown())]
    File {
        /// The file.
        path: PathBuf,
        /// The cause.
        error: io::Error,
    },
    /// Another process writes to the file.
    #[error("--out: another program is writing {}\n  fix: wait until it has ended, or name another directory", .0.shown())]
    Busy(PathBuf),
    /// The file has other contents.
    #[error("{}:{line}: {reason}\n  fix: name another directory with --out, or remove the file", .path.shown())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The cause.
        reason: String,
    },
}

#[derive(PartialEq, Eq, Serialize, Deserialize)]
struct Head {
    format: String,
    version: u32,
    /// The version of the program: another one may give other results.
    program: String,
    experiment: String,
}

#[derive(Serialize, Deserialize)]
struct Line<T> {
    trial: String,
    result: T,
}

/// The trials of one experiment that are kept.
pub struct Kept<T> {
    file: Option<(File, PathBuf)>,
    known: BTreeMap<String, T>,
}

impl<T: Clone + Serialize + DeserializeOwned + Send> Kept<T> {
    /// Opens the trials of an experiment in a directory, which is created if it is absent; without a directory nothing is
    /// kept.
    ///
    /// # Errors
    /// If the file is that of another experiment or program, is damaged, or cannot be written.
    pub fn open(dir: Option<&Path>, experiment: &str) -> Result<Kept<T>, TrialsError> {
        let Some(dir) = dir else { return Ok(Kept { file: None, known: BTreeMap::new() }) };
        let path = dir.join(experiment).with_extension("jsonl");
        let failed = |error| TrialsError::File { path: path.clone(), error };
        std::fs::create_dir_all(dir).map_err(failed)?;
        let options = OpenOptions::new().read(true).append(true).create(true).clone();
        let mut file = options.open(&path).map_err(failed)?;
        // Reading from a pipe would block for ever.
        if !file.metadata().map_err(failed)?.is_file() {
            return Err(failed(io::Error::other("it is not a regular file")));
        }
        file.try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => TrialsError::Busy(path.clone()),
            TryLockError::Error(error) => failed(error),
        })?;
        let mut text = String::new();
        file.read_to_string(&mut text).map_err(failed)?;
        let whole = text.rfind('\n').map_or(0, |end| end + 1);
        let program = metamorph_text::version::version().to_owned();
        let head =
            Head { format: FORMAT.to_owned(), version: VERSION, program, experiment: experiment.to_owned() };
        let mut known = BTreeMap::new();
        // A file without a whole line, which is not that of a killed program, is somebody else's.
        let lines = if whole == 0 { text.as_str() } else { &text[..whole] };
        let is_begun = whole == 0 && line_of(&head).map_err(failed)?.starts_with(lines);
        for (i, line) in lines.lines().enumerate().filter(|_| !is_begun) {
            let wrong = |reason: String| TrialsError::Line { path: path.clone(), line: i + 1, reason };
            if i == 0 {
                let found: Head = serde_json::from_str(line).map_err(|e| wrong(e.to_string()))?;
                if found != head {
                    let of = |head: &Head| {
                        format!(
                            "{} {} of `{}` by {}",
                            head.format, head.version, head.experiment, head.program
                        )
                    };
                    return Err(wrong(format!("the trials are {}, not {}", of(&found), of(&head))));
                }
            } else {
                let Line { trial, result } = serde_json::from_str(line).map_err(|e| wrong(e.to_string()))?;
                known.insert(trial, result);
            }
        }
        file.set_len(whole as u64).map_err(failed)?;
        if is_begun {
            file.write_all(line_of(&head).map_err(failed)?.as_bytes()).map_err(failed)?;
        }
        Ok(Kept { file: Some((file, path)), known })
    }

    /// Carries out those of the named trials that are not known, and returns the results of all, in the order of the names:
    /// `None` for those that an interruption has left out, for which `carry_out` returns `None`, too.
    ///
    /// # Errors
    /// If a result cannot be kept.
    pub fn complete<N: Sync>(
        mut self,
        trials: &[(String, N)],
        on: Hands<'_>,
        carry_out: impl Fn(&N) -> Option<T> + Sync,
    ) -> Result<Vec<Option<T>>, TrialsError> {
        let is_open = |(name, _): &&(String, N)| !self.known.contains_key(name);
        let open: Vec<&(String, N)> = trials.iter().filter(is_open).collect();
        let (all, known) = (trials.len() as u64, (trials.len() - open.len()) as u64);
        let (mut live, since, mut now) = (Live::new(on.show), Stopwatch::start(), known);
        in_parallel(
            &open,
            (on.jobs, on.stop),
            |trial| carry_out(&trial.1),
            |ended| {
                if let Some((i, result)) = ended {
                    let name = &open[i].0;
                    self.keep(name, &result)?;
                    self.known.insert(name.clone(), result);
                    now += 1;
                }
                live.show(|| {
                    format!("{}  {}", on.name, bar(known, now, all, 0, since.elapsed().as_secs_f64()))
                });
                Ok(())
            },
        )?;
        Ok(trials.iter().map(|(name, _)| self.known.get(name).cloned()).collect())
    }

    fn keep(&mut self, trial: &str, result: &T) -> Result<(), TrialsError> {
        let Some((file, path)) = &mut self.file else { return Ok(()) };
        let line = line_of(&Line { trial: trial.to_owned(), result });
        let written = line.and_then(|line| file.write_all(line.as_bytes()));
        written.map_err(|error| TrialsError::File { path: path.clone(), error })
    }
}

/// Who carries out trials.
#[derive(Clone, Copy)]
pub struct Hands<'a> {
    /// The name of the experiment in the line of progress.
    pub name: &'a str,
    /// Number of threads.
    pub jobs: NonZeroUsize,
    /// The request to end early.
    pub stop: &'a Interrupt,
    /// True to show a line of progress.
    pub show: bool,
}

/// Carries out work on several threads until all is done or `stop` is set. `take` gets each result with its number, as soon as it
/// is there, and `None` from time to time if there is none; pieces of work that return `None` have no result.
///
/// # Errors
/// The first error of `take`, which ends the work.
pub fn in_parallel<N: Sync, T: Send, E>(
    work: &[N],
    (jobs, stop): (NonZeroUsize, &Interrupt),
    carry_out: impl Fn(&N) -> Option<T> + Sync,
    mut take: impl FnMut(Option<(usize, T)>) -> Result<(), E>,
) -> Result<(), E> {
    let next = AtomicUsize::new(0);
    let (sender, receiver) = channel();
    thread::scope(|scope| {
        for _ in 0..jobs.get() {
            let (sender, next, carry_out) = (sender.clone(), &next, &carry_out);
            scope.spawn(move || {
                while !stop.is_set() {
                    let i = next.fetch_add(1, Ordering::Relaxed);
                    let Some(piece) = work.get(i) else { break };
                    let result = carry_out(piece);
                    // The receiver is gone after an error: end.
                    if result.is_some_and(|result| sender.send((i, result)).is_err()) {
                        break;
                    }
                }
            });
        }
        drop(sender);
        let receiver = receiver;
        loop {
            match receiver.recv_timeout(PATIENCE) {
                Ok(ended) => take(Some(ended))?,
                Err(RecvTimeoutError::Timeout) => take(None)?,
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            }
        }
    })
}

fn line_of<T: Serialize>(content: &T) -> io::Result<String> {
    Ok(serde_json::to_string(content).map_err(io::Error::other)? + "\n")
}

impl From<TrialsError> for ReproduceError {
    fn from(error: TrialsError) -> ReproduceError {
        ReproduceError::Trials(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The trial that has no result.
    const INTERRUPTED: u32 = 7;

    fn complete(dir: &Path, trials: u32) -> (Vec<Option<u32>>, usize) {
        let stop = Interrupt::default();
        let carried_out = AtomicUsize::new(0);
        let names: Vec<(String, u32)> = (0..trials).map(|n| (format!("trial {n}"), n)).collect();
        let on = Hands { name: "test", jobs: NonZeroUsize::MIN, stop: &stop, show: false };
        let kept = Kept::open(Some(dir), "test").unwrap();
        let results = kept.complete(&names, on, |n| {
            carried_out.fetch_add(1, Ordering::Relaxed);
            (*n != INTERRUPTED).then_some(n * n)
        });
        (results.unwrap(), carried_out.into_inner())
    }

    #[test]
    fn trials_that_are_kept_are_not_repeated() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(complete(dir.path(), 3), (vec![Some(0), Some(1), Some(4)], 3));
        assert_eq!(complete(dir.path(), 5).1, 2);
        // A killed program leaves a line without its end.
        let path = dir.path().join("test.jsonl");
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, &text[..text.len() - 3]).unwrap();
        assert_eq!(complete(dir.path(), 5), (vec![Some(0), Some(1), Some(4), Some(9), Some(16)], 1));
    }

    /// A trial that was interrupted has no result, and is carried out again.
    #[test]
    fn interrupted_trials_are_not_kept() {
        let dir = tempfile::tempdir().unwrap();
        for carried_out in [INTERRUPTED as usize + 1, 1] {
            let (results, carried) = complete(dir.path(), INTERRUPTED + 1);
            assert_eq!((results.last(), carried), (Some(&None), carried_out));
        }
    }

    /// What somebody else has written there stays, also if it has no whole line.
    #[test]
    fn other_files_are_left_as_they_are() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("test.jsonl");
        for text in ["my notes", "my notes\n", "{\"format\": \"mine\"}\nmore"] {
            std::fs::write(&path, text).unwrap();
            let error = Kept::<u32>::open(Some(dir.path()), "test").err().unwrap().to_string();
            assert!(error.contains("test.jsonl:1: "), "{error}");
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        }
        // The head that a killed program has begun.
        std::fs::write(&path, "{\"format\":\"metamorph-tri").unwrap();
        assert_eq!(complete(dir.path(), 1).1, 1);
        let open = Kept::<u32>::open(Some(dir.path()), "test").unwrap();
        let busy = Kept::<u32>::open(Some(dir.path()), "test");
        assert!(matches!(busy, Err(TrialsError::Busy(_))));
        drop(open);
    }

    #[test]
    fn files_of_other_programs_and_damaged_ones_are_refused_with_the_line() {
        let dir = tempfile::tempdir().unwrap();
        complete(dir.path(), 2);
        let path = dir.path().join("test.jsonl");
        let text = std::fs::read_to_string(&path).unwrap();
        let refusal = |text: &str| {
            std::fs::write(&path, text).unwrap();
            Kept::<u32>::open(Some(dir.path()), "test").err().unwrap().to_string()
        };
        assert!(refusal(&text.replace("\"version\":1", "\"version\":2")).contains("test.jsonl:1: "));
        assert!(refusal(&text.replace("result", "resolt")).contains("test.jsonl:2: "));
    }
}
