//! Long experiments of independent trials: on several threads, with a line of progress, and kept in a file from which the same
//! command continues.
//!
//! The file has one line of JSON for its head and one for each trial, in the order in which trials ended. A last line without
//! a line end is left by a killed program and is cut off. A trial is known by its name, so a later command may ask for more.

use crate::error::ReproduceError;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::Live;
use metamorph_text::format::{many, seconds};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
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
    #[error("--out: cannot use {}: {error}\n  fix: name a directory on a disk with room that is yours", .path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The cause.
        error: io::Error,
    },
    /// The file has other contents.
    #[error("{}:{line}: {reason}\n  fix: name another directory with --out, or remove the file", .path.display())]
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
        let mut text = String::new();
        file.read_to_string(&mut text).map_err(failed)?;
        let whole = text.rfind('\n').map_or(0, |end| end + 1);
        file.set_len(whole as u64).map_err(failed)?;
        let program = metamorph_text::version::version().to_owned();
        let head =
            Head { format: FORMAT.to_owned(), version: VERSION, program, experiment: experiment.to_owned() };
        let mut known = BTreeMap::new();
        if whole == 0 {
            write_line(&mut file, &head).map_err(failed)?;
        }
        for (i, line) in text[..whole].lines().enumerate() {
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
        Ok(Kept { file: Some((file, path)), known })
    }

    /// Carries out those of the named trials that are not known, and returns the results of all, in the order of the names:
    /// `None` for those that an interruption has left out.
    ///
    /// # Errors
    /// If a result cannot be kept.
    pub fn complete<N: Sync>(
        mut self,
        trials: &[(String, N)],
        on: Hands<'_>,
        carry_out: impl Fn(&N) -> T + Sync,
    ) -> Result<Vec<Option<T>>, TrialsError> {
        let open: Vec<&(String, N)> =
            trials.iter().filter(|(name, _)| !self.known.contains_key(name)).collect();
        let next = AtomicUsize::new(0);
        let (sender, receiver) = channel();
        let (mut live, since, mut ended) = (Live::new(on.show), Stopwatch::start(), 0);
        thread::scope(|scope| {
            for _ in 0..on.jobs.get() {
                let (sender, next, open, carry_out) = (sender.clone(), &next, &open, &carry_out);
                scope.spawn(move || {
                    while !on.stop.is_set() {
                        let Some((name, trial)) = open.get(next.fetch_add(1, Ordering::Relaxed)) else {
                            break;
                        };
                        // The receiver is gone after an error: end.
                        if sender.send((name.clone(), carry_out(trial))).is_err() {
                            break;
                        }
                    }
                });
            }
            drop(sender);
            let receiver = receiver;
            loop {
                match receiver.recv_timeout(PATIENCE) {
                    Ok((name, result)) => {
                        self.keep(&name, &result)?;
                        self.known.insert(name, result);
                        ended += 1;
                    }
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => return Ok(()),
                }
                live.show(|| line(on.name, (ended, open.len(), trials.len()), since.elapsed()));
            }
        })?;
        Ok(trials.iter().map(|(name, _)| self.known.get(name).cloned()).collect())
    }

    fn keep(&mut self, trial: &str, result: &T) -> Result<(), TrialsError> {
        let Some((file, path)) = &mut self.file else { return Ok(()) };
        let line = Line { trial: trial.to_owned(), result };
        write_line(file, &line).map_err(|error| TrialsError::File { path: path.clone(), error })
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

fn line(name: &str, (ended, open, all): (usize, usize, usize), took: Duration) -> String {
    let mut line = format!("{name}: {} of {}", all - open + ended, many(all as u64, "trial"));
    if ended > 0 {
        let left = (open - ended) as f64 * took.as_secs_f64() / ended as f64;
        line += &format!("  about {} left", seconds(left));
    }
    line
}

fn write_line<T: Serialize>(file: &mut File, line: &T) -> io::Result<()> {
    let mut text = serde_json::to_string(line).map_err(io::Error::other)?;
    text.push('\n');
    file.write_all(text.as_bytes())
}

impl From<TrialsError> for ReproduceError {
    fn from(error: TrialsError) -> ReproduceError {
        ReproduceError::Trials(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn complete(dir: &Path, trials: u32) -> (Vec<Option<u32>>, usize) {
        let stop = Interrupt::default();
        let carried_out = AtomicUsize::new(0);
        let names: Vec<(String, u32)> = (0..trials).map(|n| (format!("trial {n}"), n)).collect();
        let on = Hands { name: "test", jobs: NonZeroUsize::MIN, stop: &stop, show: false };
        let kept = Kept::open(Some(dir), "test").unwrap();
        let results = kept.complete(&names, on, |n| {
            carried_out.fetch_add(1, Ordering::Relaxed);
            n * n
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
