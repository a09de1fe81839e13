//! The directory of a sweep, or of a part of one: its request (`manifest.json`) and every run (`runs.csv`).
//!
//! When a sweep gets more seeds, the runs have other numbers. They are written to `runs.csv.new` first, then the manifest is
//! replaced, then the runs: resuming completes or repeats that, wherever it was interrupted.
//!
//! Lines of `runs.csv` are in the order of the runs. Only after an interruption may lines with gaps follow
//! the first missing run; resuming reads them into memory, and writes them again in their place. A last line
//! without a line end is left by a killed program. Absent: the summary and the report, which are derived from
//! the runs at any time.

use super::row::{self, Row, RowError};
use metamorph_console::output::{OutputError, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_module_agent::regular_file;
use metamorph_scenario::error::MAX_BYTES;
use metamorph_scenario::grid::{Grid, Part};
use metamorph_text::escape::{Shown, json};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, BufRead, BufReader, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The name of the format.
const FORMAT: &str = "metamorph-sweep";
/// The version of the directory's layout, `runs.csv` included.
pub const VERSION: u32 = 6;
/// File name of the manifest.
const MANIFEST: &str = "manifest.json";
/// File name of the runs.
pub const RUNS: &str = "runs.csv";
/// File name of the runs of a sweep that gets more seeds, until its manifest says so.
const NEW_RUNS: &str = "runs.csv.new";

/// Bytes of a manifest at most: it contains a scenario in which every byte may be escaped.
const LONGEST: u64 = 6 * MAX_BYTES + (1 << 20);

/// Why a directory cannot be used.
#[derive(Debug, Error)]
pub enum StoreError {
    /// The directory is not empty.
    #[error("--out {}: the directory is not empty\n  fix: name a new or empty directory{}", .dir.shown(),
        if *.resumable { ", or add --resume to continue the sweep in it" } else { "" })]
    NotEmpty {
        /// The directory.
        dir: PathBuf,
        /// True if it contains a sweep.
        resumable: bool,
    },
    /// There is no sweep.
    #[error("{}: there is no sweep, because {} is missing\n  fix: name a directory that `metamorph sweep --out` has written", .0.shown(), MANIFEST)]
    Nothing(PathBuf),
    /// The manifest is damaged or of another kind.
    #[error("{}: this is not the manifest of a sweep: {reason}\n  fix: name another directory with --out and start anew without --resume", .path.shown())]
    Manifest {
        /// The file.
        path: PathBuf,
        /// The cause.
        reason: String,
    },
    /// The manifest has another version.
    #[error("{}: the sweep has format version {found}; this program (metamorph {program}) reads version {VERSION}\n  fix: resume with the program that started it, or start anew in another directory",
        .path.shown(), program = metamorph_text::version::version())]
    Version {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
    },
    /// The directory contains another sweep.
    #[error("--out {}: the sweep there has {what}: {theirs} there, {ours} here\n  fix: resume with the program and exactly the options that started it, or start anew in another directory", .dir.shown())]
    Different {
        /// The directory.
        dir: PathBuf,
        /// The difference.
        what: &'static str,
        /// The value in the directory.
        theirs: String,
        /// The value requested.
        ours: String,
    },
    /// Another process writes to the directory.
    #[error("--out {}: another sweep is writing there\n  fix: wait until it has ended, or name another directory", .0.shown())]
    Busy(PathBuf),
    /// The runs are damaged.
    #[error("{}:{line}: {reason}\n  fix: remove this line and all after it, and resume; their runs are repeated", .path.shown())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: u64,
        /// The cause.
        reason: String,
    },
    /// A run could not be written.
    #[error("cannot write {}: {error}; earlier runs are kept, and --resume continues from there", .path.shown())]
    Write {
        /// The file.
        path: PathBuf,
        /// The cause.
        error: io::Error,
    },
    /// The manifest cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// A file cannot be written.
    #[error("--out: cannot write {}: {error}\n  fix: name a directory on a disk with room that is yours", .path.shown())]
    File {
        /// The file.
        path: PathBuf,
        /// The cause.
        error: io::Error,
    },
}

/// The request of a sweep. Sweeps with equal manifests have equal runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    format: String,
    version: u32,
    /// The version of the program: another one may give other results.
    program: String,
    /// The file of the scenario, as named by the user.
    pub scenario: String,
    /// The name of the scenario, or its file.
    pub title: String,
    /// The description of the scenario.
    pub description: Option<String>,
    /// The text of the scenario.
    pub text: String,
    /// The options that change it in all runs.
    pub options: Vec<String>,
    /// Which part of the runs is in this directory; left out if all are.
    #[serde(default, skip_serializing_if = "Part::is_whole")]
    pub part: Part,
    /// All runs.
    #[serde(flatten)]
    pub grid: Grid,
}

/// The part of every manifest that does not depend on its version.
#[derive(Deserialize)]
struct Stamp {
    format: String,
    version: u32,
}

impl Manifest {
    fn write(&self, dir: &Path) -> Result<(), StoreError> {
        let output = Outputs::new().writes("--out", &dir.join(MANIFEST), OutputKind::Any)?;
        Ok(output.write(self.text())?)
    }
    /// Returns the text of its file.
    pub fn text(&self) -> String {
        json(self) + "\n"
    }
    /// Creates the manifest of a sweep of this program.
    pub fn new(scenario: &str, text: &str, options: Vec<String>, grid: &Grid) -> Manifest {
        Manifest {
            format: FORMAT.to_owned(),
            version: VERSION,
            program: metamorph_text::version::version().to_owned(),
            scenario: scenario.to_owned(),
            title: scenario.to_owned(),
            description: None,
            text: text.to_owned(),
            options,
            part: Part::WHOLE,
            grid: grid.clone(),
        }
    }

    /// Returns the manifest of a part of the sweep, or of the whole.
    pub fn of_part(&self, part: Part) -> Manifest {
        Manifest { part, ..self.clone() }
    }

    /// Reads the manifest of a directory.
    pub fn read(dir: &Path) -> Result<Manifest, StoreError> {
        let path = dir.join(MANIFEST);
        let bytes = match regular_file::read(&path, LONGEST) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Err(StoreError::Nothing(dir.into()));
            }
            Err(error) => return Err(StoreError::File { path, error }),
            Ok(bytes) => bytes,
        };
        let wrong = |reason: String| StoreError::Manifest { path: path.clone(), reason };
        let stamp: Stamp = serde_json::from_slice(&bytes).map_err(|e| wrong(e.to_string()))?;
        if stamp.format != FORMAT {
            return Err(wrong(format!("its format is `{}`", stamp.format)));
        }
        if stamp.version != VERSION {
            return Err(StoreError::Version { path, found: stamp.version });
        }
        serde_json::from_slice(&bytes).map_err(|e| wrong(e.to_string()))
    }

    /// True if the other sweep has the same runs and more seeds.
    fn is_begun_of(&self, longer: &Manifest) -> bool {
        let (theirs, ours) = (self.grid.seeds, longer.grid.seeds);
        theirs.from == ours.from && theirs.until < ours.until
    }

    /// Checks that this is the manifest of a part of the same sweep as `first`.
    pub fn must_be_of(&self, first: &Manifest, dir: &Path) -> Result<(), StoreError> {
        self.must_be(&first.of_part(self.part), dir)?;
        let (theirs, ours) = (self.grid.seeds, first.grid.seeds);
        if theirs == ours {
            return Ok(());
        }
        let (what, theirs, ours) = ("other seeds", theirs.to_string(), ours.to_string());
        Err(StoreError::Different { dir: dir.into(), what, theirs, ours })
    }

    /// Compares all but the number of seeds, which may grow. The directory of the scenario file does not matter.
    pub fn must_be(&self, ours: &Manifest, dir: &Path) -> Result<(), StoreError> {
        let differ = |what, theirs: String, ours: String| {
            Err(StoreError::Different { dir: dir.into(), what, theirs, ours })
        };
        if self.part != ours.part {
            let name = |m: &Manifest| match m.part.is_whole() {
                true => "the whole".to_owned(),
                false => m.part.to_string(),
            };
            return differ("another part", name(self), name(ours));
        }
        let vary = |m: &Manifest| match m.grid.vary.len() {
            0 => "none".to_owned(),
            _ => m.grid.vary.iter().map(|axis| format!("--vary {axis}")).collect::<Vec<_>>().join(" "),
        };
        if self.text != ours.text {
            let name = |m: &Manifest| format!("the text of {} as it was given then", m.scenario);
            return differ("another scenario", name(self), format!("that of {} now", ours.scenario));
        }
        if self.options != ours.options {
            let options =
                |m: &Manifest| if m.options.is_empty() { "none".to_owned() } else { m.options.join(" ") };
            return differ("other options of the scenario", options(self), options(ours));
        }
        if self.grid.vary != ours.grid.vary {
            return differ("other variations", vary(self), vary(ours));
        }
        if self.grid.seeds != ours.grid.seeds && !self.is_begun_of(ours) {
            return differ("other seeds", self.grid.seeds.to_string(), ours.grid.seeds.to_string());
        }
        if self.program != ours.program {
            return differ("another version of metamorph", self.program.clone(), ours.program.clone());
        }
        Ok(())
    }
}

/// The file that runs are written to.
#[derive(Debug)]
pub struct Store {
    grid: Grid,
    path: PathBuf,
    out: csv::Writer<File>,
}

/// Runs done before.
#[derive(Debug, Default)]
pub struct Done {
    /// Every run of the part before this one is done.
    pub before: u64,
    /// Number of these runs.
    pub count: u64,
    /// Later runs, which are not in the file any more and will be written in their place.
    pub ahead: BTreeMap<u64, Row>,
}

impl Done {
    /// Returns the number of runs done.
    pub fn runs(&self) -> u64 {
        self.count + self.ahead.len() as u64
    }
}

impl Store {
    /// Creates a sweep in a new or empty directory.
    pub fn create(dir: &Path, manifest: &Manifest) -> Result<Store, StoreError> {
        create_directory(dir)?;
        manifest.write(dir)?;
        Store::open(dir, manifest, |_, _| {}).map(|(store, _)| store)
    }

    /// Resumes a sweep, or begins it where nothing is yet. It may have more seeds than it had before. `seen` is called with every
    /// run that stays in the file.
    pub fn resume(
        dir: &Path,
        manifest: &Manifest,
        seen: impl FnMut(u64, &Row),
    ) -> Result<(Store, Done), StoreError> {
        let there = match Manifest::read(dir) {
            Err(StoreError::Nothing(_)) => return Ok((Store::create(dir, manifest)?, Done::default())),
            there => there?,
        };
        there.must_be(manifest, dir)?;
        let new = dir.join(NEW_RUNS);
        if there.is_begun_of(manifest) {
            lengthen(dir, &there, manifest)?;
        }
        if new.exists() {
            fs::rename(&new, dir.join(RUNS)).map_err(|error| StoreError::File { path: new, error })?;
        }
        Store::open(dir, manifest, seen)
    }

    fn open(
        dir: &Path,
        manifest: &Manifest,
        seen: impl FnMut(u64, &Row),
    ) -> Result<(Store, Done), StoreError> {
        let grid = &manifest.grid;
        let path = dir.join(RUNS);
        let failed = |error| StoreError::File { path: path.clone(), error };
        let options = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
        let mut file = options.map_err(failed)?;
        // Reading from a pipe would block for ever.
        if !file.metadata().map_err(failed)?.is_file() {
            return Err(failed(io::Error::other("it is not a regular file")));
        }
        lock(&file, dir, &path)?;
        let (done, end) = scan(&file, &path, manifest, seen)?;
        file.set_len(end).map_err(failed)?;
        file.seek(SeekFrom::Start(end)).map_err(failed)?;
        let out = csv::WriterBuilder::new().has_headers(false).buffer_capacity(1 << 16).from_writer(file);
        let mut store = Store { grid: grid.clone(), path, out };
        if end == 0 {
            let written = row::write_header(&mut store.out, grid);
            store.check(written)?;
        }
        Ok((store, done))
    }

    /// Adds a run; it may stay in memory until [`Store::flush`].
    pub fn write(&mut self, run: u64, row: &Row) -> Result<(), StoreError> {
        let written = row::write(&mut self.out, &self.grid, run, row);
        self.check(written)
    }

    /// Passes everything to the operating system.
    pub fn flush(&mut self) -> Result<(), StoreError> {
        self.out.flush().map_err(|error| StoreError::Write { path: self.path.clone(), error })
    }

    fn check(&self, written: csv::Result<()>) -> Result<(), StoreError> {
        let error = |e: csv::Error| StoreError::Write { path: self.path.clone(), error: e.into() };
        written.map_err(error)
    }
}

/// Locks the runs of a directory.
fn lock(file: &File, dir: &Path, path: &Path) -> Result<(), StoreError> {
    match file.try_lock() {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => Err(StoreError::Busy(dir.into())),
        Err(TryLockError::Error(error)) => Err(StoreError::File { path: path.to_owned(), error }),
    }
}

/// Gives the sweep in a directory more seeds: its runs get the numbers that they have in the longer one.
fn lengthen(dir: &Path, shorter: &Manifest, longer: &Manifest) -> Result<(), StoreError> {
    let (path, new) = (dir.join(RUNS), dir.join(NEW_RUNS));
    let failed = |error| StoreError::File { path: path.clone(), error };
    let written = |error: io::Error| StoreError::Write { path: new.clone(), error };
    let file = regular_file::open(&path).map_err(failed)?;
    lock(&file, dir, &path)?;
    let (old, grid) = (&shorter.grid, &longer.grid);
    let renumbered = |run| old.combination(run) * grid.seeds.len() + (old.seed(run) - old.seeds.from);
    let mut rows = BTreeMap::new();
    let (done, _) = scan(&file, &path, shorter, |run, row| _ = rows.insert(renumbered(run), row.clone()))?;
    rows.extend(done.ahead.into_iter().map(|(run, row)| (renumbered(run), row)));
    let out = File::create(&new).map_err(written)?;
    let mut out = csv::WriterBuilder::new().has_headers(false).buffer_capacity(1 << 16).from_writer(out);
    let lines = row::write_header(&mut out, grid)
        .and_then(|()| rows.iter().try_for_each(|(run, row)| row::write(&mut out, grid, *run, row)));
    lines.map_err(|e| written(e.into()))?;
    let out = out.into_inner().map_err(|e| written(e.into_error()))?;
    out.sync_all().map_err(written)?;
    longer.write(dir)
}

/// Creates a directory for results, or accepts an empty one.
pub fn create_directory(dir: &Path) -> Result<(), StoreError> {
    let failed = |error| StoreError::File { path: dir.into(), error };
    fs::create_dir_all(dir).map_err(failed)?;
    match fs::read_dir(dir).map_err(failed)?.next() {
        None => Ok(()),
        Some(_) => Err(StoreError::NotEmpty { dir: dir.into(), resumable: dir.join(MANIFEST).exists() }),
    }
}

/// The runs of a sweep that is not resumed.
#[derive(Debug)]
pub struct Runs {
    /// The scenario, as named by the user.
    pub scenario: String,
    /// The keys that are varied.
    pub keys: Vec<String>,
    /// The number of runs of the whole sweep.
    pub planned: u64,
    /// The runs done, each with the values of these keys.
    pub rows: Vec<(Vec<String>, Row)>,
}

/// Reads the runs of a sweep.
///
/// # Errors
///
/// The directory has no sweep of this version, or its runs are damaged.
pub fn read_runs(dir: &Path) -> Result<Runs, StoreError> {
    let manifest = Manifest::read(dir)?;
    let grid = &manifest.grid;
    let values = |run| grid.values(grid.combination(run)).into_iter().map(str::to_owned).collect();
    let rows = rows_of(dir, &manifest)?.into_iter().map(|(run, row)| (values(run), row)).collect();
    let keys = grid.vary.iter().map(|axis| axis.key.clone()).collect();
    Ok(Runs { scenario: manifest.scenario.clone(), keys, planned: grid.runs(), rows })
}

/// Reads the runs in the directory of this manifest.
///
/// # Errors
///
/// They are damaged, or a sweep is writing there.
pub fn rows_of(dir: &Path, manifest: &Manifest) -> Result<BTreeMap<u64, Row>, StoreError> {
    let path = dir.join(RUNS);
    let file = regular_file::open(&path).map_err(|error| StoreError::File { path: path.clone(), error })?;
    let mut rows = BTreeMap::new();
    let (done, _) = scan(&file, &path, manifest, |run, row| _ = rows.insert(run, row.clone()))?;
    rows.extend(done.ahead);
    Ok(rows)
}

/// Reads the runs of the file. Returns those done, and the offset of the first gap or torn line.
fn scan(
    file: &File,
    path: &Path,
    manifest: &Manifest,
    mut seen: impl FnMut(u64, &Row),
) -> Result<(Done, u64), StoreError> {
    let (grid, part) = (&manifest.grid, manifest.part);
    let mut expected_header = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
    // Invariant: writing to memory does not fail.
    let _ = row::write_header(&mut expected_header, grid);
    let expected_header = expected_header.into_inner().unwrap_or_default();

    let mut reader = BufReader::with_capacity(1 << 16, file);
    let (mut done, mut end, mut line, mut number) = (Done::default(), 0, Vec::new(), 0);
    loop {
        line.clear();
        let read = reader.read_until(b'\n', &mut line);
        let length = read.map_err(|error| StoreError::File { path: path.into(), error })?;
        // A line without its end is torn, or the end of the file is reached.
        if line.last() != Some(&b'\n') {
            return Ok((done, end));
        }
        number += 1;
        let wrong = |reason: String| StoreError::Line { path: path.into(), line: number, reason };
        if number == 1 {
            if line != expected_header {
                return Err(wrong("these are not the columns of this sweep".into()));
            }
            end = length as u64;
            continue;
        }
        let (run, row) = row::read(&line, grid).map_err(|e: RowError| wrong(e.to_string()))?;
        if !part.has(grid, run) {
            return Err(wrong(format!("run {run} is not of the part {part}")));
        }
        let last = done.ahead.last_key_value().map(|(run, _)| *run);
        match last {
            None if run == part.next(grid, done.before) => {
                seen(run, &row);
                (done.before, done.count) = (run + 1, done.count + 1);
                end += length as u64;
            }
            None if run < done.before => return Err(wrong(format!("run {run} is there twice"))),
            Some(last) if run <= last => return Err(wrong(format!("run {run} is not in its place"))),
            _ => {
                done.ahead.insert(run, row);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::row;
    use super::*;
    use metamorph_scenario::grid::{Axis, Seeds};

    fn grid() -> Grid {
        let vary = vec![Axis::parse("link.loss=0%,5%").unwrap()];
        Grid::new(Seeds { from: 10, until: 13 }, vary).unwrap()
    }
    fn manifest() -> Manifest {
        Manifest::new("a.toml", "version = 1\n", Vec::new(), &grid())
    }
    fn write(store: &mut Store, runs: &[u64]) {
        for run in runs {
            store.write(*run, &row(grid().seed(*run))).unwrap();
        }
        store.flush().unwrap();
    }
    /// Returns the runs that a resumed sweep finds: those kept, and those ahead.
    fn found(dir: &Path) -> (Vec<u64>, Vec<u64>) {
        let mut kept = Vec::new();
        let (_, done) = Store::resume(dir, &manifest(), |run, _| kept.push(run)).unwrap();
        assert_eq!(kept.len() as u64, done.before);
        (kept, done.ahead.into_keys().collect())
    }

    #[test]
    fn what_is_ahead_of_a_gap_is_taken_up_and_written_in_its_place() {
        let dir = tempfile::tempdir().unwrap();
        let mut store = Store::create(dir.path(), &manifest()).unwrap();
        write(&mut store, &[0, 1, 2, 3, 4, 5]);
        let whole = fs::read(dir.path().join(RUNS)).unwrap();
        drop(store);
        assert_eq!(found(dir.path()), (vec![0, 1, 2, 3, 4, 5], vec![]));

        let other = tempfile::tempdir().unwrap();
        let mut store = Store::create(other.path(), &manifest()).unwrap();
        write(&mut store, &[0, 1, 3, 5]);
        drop(store);
        let (mut store, done) = Store::resume(other.path(), &manifest(), |_, _| {}).unwrap();
        assert_eq!((done.before, done.ahead.keys().copied().collect()), (2, vec![3, 5]));
        write(&mut store, &[2, 3, 4, 5]);
        drop(store);
        assert_eq!(fs::read(other.path().join(RUNS)).unwrap(), whole);
    }

    #[test]
    fn a_torn_line_is_cut_wherever_it_is_torn() {
        let dir = tempfile::tempdir().unwrap();
        write(&mut Store::create(dir.path(), &manifest()).unwrap(), &[0, 1]);
        let path = dir.path().join(RUNS);
        let whole = fs::read(&path).unwrap();
        let ends: Vec<usize> = (0..whole.len()).filter(|i| whole[*i] == b'\n').collect();
        for length in 0..whole.len() {
            fs::write(&path, &whole[..length]).unwrap();
            let lines = ends.iter().filter(|end| **end < length).count();
            let (kept, ahead) = found(dir.path());
            assert_eq!((kept.len(), ahead.len()), (lines.saturating_sub(1), 0), "{length}");
            // The rest ends with a complete line, at least the heading.
            let left = fs::read(&path).unwrap();
            assert_eq!(left, whole[..=ends[lines.saturating_sub(1)]], "{length}");
        }
    }

    #[test]
    fn damaged_lines_are_named() {
        let dir = tempfile::tempdir().unwrap();
        write(&mut Store::create(dir.path(), &manifest()).unwrap(), &[0, 1]);
        let path = dir.path().join(RUNS);
        let text = fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = text.split_inclusive('\n').collect();
        for (damaged, place) in [
            (vec![lines[0], lines[1], lines[1]], ":3: run 0 is there twice"),
            (vec![lines[0], lines[2], lines[1]], ":3: run 0 is not in its place"),
            (vec![lines[0], "\n", lines[1]], ":2: it has"),
            (vec!["run\n", lines[1]], ":1: these are not the columns"),
        ] {
            fs::write(&path, damaged.concat()).unwrap();
            let error = Store::resume(dir.path(), &manifest(), |_, _| {}).unwrap_err().to_string();
            assert!(error.contains(place) && error.contains("\n  fix: "), "{error}");
        }
    }

    /// Wherever the change to more seeds is interrupted, resuming keeps all runs, each with its new number.
    #[test]
    fn runs_are_kept_when_seeds_are_added() {
        let longer = Manifest { grid: Grid { seeds: Seeds { from: 10, until: 15 }, ..grid() }, ..manifest() };
        let resumed = |dir: &Path| -> BTreeMap<u64, u64> {
            let mut seeds = BTreeMap::new();
            let (_, done) = Store::resume(dir, &longer, |run, row| _ = seeds.insert(run, row.seed)).unwrap();
            seeds.extend(done.ahead.iter().map(|(run, row)| (*run, row.seed)));
            assert_eq!(done.runs(), seeds.len() as u64);
            seeds
        };
        let expected = BTreeMap::from([(0, 10), (1, 11), (2, 12), (5, 10), (6, 11)]);
        let begun = |done: &dyn Fn(&Path)| {
            let dir = tempfile::tempdir().unwrap();
            write(&mut Store::create(dir.path(), &manifest()).unwrap(), &[0, 1, 2, 3, 4]);
            done(dir.path());
            assert_eq!(resumed(dir.path()), expected);
            assert!(!dir.path().join(NEW_RUNS).exists());
        };
        begun(&|_| ());
        // A torn file of new runs, beside the old manifest.
        begun(&|dir| fs::write(dir.join(NEW_RUNS), "run,li").unwrap());
        // The new manifest, and the new runs not in their place yet.
        begun(&|dir| lengthen(dir, &manifest(), &longer).unwrap());
        // The runs of a part stay in it.
        let dir = tempfile::tempdir().unwrap();
        let part = Part::parse("1/2").unwrap();
        write(&mut Store::create(dir.path(), &manifest().of_part(part)).unwrap(), &[0, 2, 4]);
        let (_, done) = Store::resume(dir.path(), &longer.of_part(part), |_, _| ()).unwrap();
        assert_eq!((done.runs(), done.before), (3, 3));
    }

    #[test]
    fn only_the_same_sweep_goes_on() {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::create(dir.path(), &manifest()).unwrap();
        let resume = |manifest: &Manifest| Store::resume(dir.path(), manifest, |_, _| {}).map(|_| ());
        let refused = |manifest: &Manifest, part: &str| {
            let error = resume(manifest).unwrap_err().to_string();
            assert!(error.contains(part) && error.contains("\n  fix: "), "{error}");
        };
        refused(&manifest(), "another sweep is writing there");
        drop(store);
        resume(&Manifest::new("elsewhere/a.toml", "version = 1\n", Vec::new(), &grid())).unwrap();
        refused(&Manifest::new("a.toml", "version = 1 \n", Vec::new(), &grid()), "another scenario");
        let fewer = Grid { seeds: Seeds { from: 10, until: 12 }, ..grid() };
        refused(
            &Manifest::new("a.toml", "version = 1\n", Vec::new(), &fewer),
            "other seeds: 10..13 there, 10..12 here",
        );
        let none = Grid { vary: vec![], ..grid() };
        refused(
            &Manifest::new("a.toml", "version = 1\n", Vec::new(), &none),
            "--vary link.loss=0%,5% there, none here",
        );
        let options = vec!["--kill".to_owned(), "3@2s".to_owned()];
        refused(
            &Manifest { options, ..manifest() },
            "other options of the scenario: none there, --kill 3@2s here",
        );
        refused(&Manifest { program: "9.9.9".into(), ..manifest() }, "another version of metamorph");
        let path = dir.path().join(MANIFEST);
        let text = fs::read_to_string(&path).unwrap();
        let version = |n: u32| (format!("\"version\": {n}"), format!("format version {n}"));
        let ((ours, _), (newer, named)) = (version(VERSION), version(VERSION + 1));
        for (old, new, part) in [
            (ours.as_str(), newer.as_str(), named.as_str()),
            ("metamorph-sweep", "else", "its format is `else`"),
            ("{", "", "not the manifest of a sweep"),
        ] {
            fs::write(&path, text.replacen(old, new, 1)).unwrap();
            refused(&manifest(), part);
        }
        fs::remove_file(&path).unwrap();
        refused(&manifest(), "the directory is not empty");
        let error = Store::create(dir.path(), &manifest()).unwrap_err().to_string();
        assert!(error.contains("not empty") && !error.contains("--resume"), "{error}");
    }
}
