//! `metamorph sweep --join`: one sweep of the parts that several machines have run. Its files are those of the same sweep on one
//! machine, byte for byte.

use super::store::{Manifest, RUNS, Store, StoreError, rows_of};
use super::summary::{Summary, Tallies};
use super::{Results, SweepError};
use metamorph_console::output::Outputs;
use metamorph_scenario::grid::Part;
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED};
use metamorph_text::escape::Shown;
use metamorph_text::format::{count, many};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Largest number of parts that an error lists.
const LISTED_MAX: usize = 10;

/// Why parts cannot be joined.
#[derive(Debug, Error)]
pub enum JoinError {
    /// A directory cannot be read, or has a part of another sweep.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A directory has a whole sweep.
    #[error("--join {}: a whole sweep is there, and no part of one\n  fix: name directories that `metamorph sweep --part I/N --out DIR` has written", .0.shown())]
    Whole(PathBuf),
    /// A directory has a part of a sweep that is divided otherwise.
    #[error("--join {}: the part {found} is there, and that of {} is one of {}\n  fix: join the parts of one division", .dir.shown(), .first.shown(), count(*.of))]
    Division {
        /// The directory.
        dir: PathBuf,
        /// Its part.
        found: String,
        /// The first directory.
        first: PathBuf,
        /// The number of parts there.
        of: u64,
    },
    /// Two directories have one part.
    #[error("--join: the part {part} is in {} and in {}\n  fix: name one of them", .first.shown(), .second.shown())]
    Twice {
        /// The part.
        part: String,
        /// A directory.
        first: PathBuf,
        /// Another one.
        second: PathBuf,
    },
    /// No directory has some parts.
    #[error("--join: {} of {of} missing: {}\n  fix: run them with `metamorph sweep --part I/N`, and name their directories",
        many(.missing.len() as u64, "part"), listed(.missing))]
    Missing {
        /// The parts.
        missing: Vec<String>,
        /// The number of all.
        of: u64,
    },
    /// Parts are not finished.
    #[error("--join: not all runs are done: {}\n  fix: give the command of each part again, with --resume", listed(.0))]
    Unfinished(Vec<String>),
}

impl CommandError for JoinError {
    fn exit_code(&self) -> u8 {
        match self {
            JoinError::Store(StoreError::Write { .. }) => FAILED,
            _ => BAD_USAGE,
        }
    }
}

fn listed(all: &[String]) -> String {
    let shown = all.iter().take(LISTED_MAX).cloned().collect::<Vec<_>>().join(", ");
    match all.len().saturating_sub(LISTED_MAX) {
        0 => shown,
        more => format!("{shown} and {} more", count(more as u64)),
    }
}

/// Joins the parts in these directories into a new or empty one. Returns the summary of the whole.
///
/// # Errors
/// If a part is missing, there twice, unfinished or of another sweep, or the directory cannot be written.
pub fn join(parts: &[PathBuf], out: &Path) -> Result<Summary, SweepError> {
    let (manifest, parts) = found(parts)?;
    let (grid, whole) = (&manifest.grid, manifest.of_part(Part::WHOLE));
    let mut rows = BTreeMap::new();
    let mut unfinished = Vec::new();
    for (name, (part, dir)) in &parts {
        let of_part = rows_of(dir, &manifest.of_part(*part)).map_err(JoinError::Store)?;
        let (done, planned) = (of_part.len() as u64, part.runs(grid));
        if done < planned {
            let (done, planned) = (count(done), many(planned, "run"));
            unfinished.push(format!("{name} in {} has {done} of {planned}", dir.shown()));
        }
        rows.extend(of_part);
    }
    if !unfinished.is_empty() {
        return Err(JoinError::Unfinished(unfinished).into());
    }
    let mut outputs = Outputs::new();
    for (_, dir) in parts.values() {
        outputs.reads("a part", &dir.join(RUNS));
    }
    let mut store = Store::create(out, &whole)?;
    let results = Results::of(out, &mut outputs)?;
    let mut tallies = Tallies::new(grid);
    for (run, row) in &rows {
        store.write(*run, row)?;
        tallies.add(grid.combination(*run), row);
    }
    store.flush()?;
    let summary = tallies.summary(&manifest.scenario, grid);
    results.write(&whole, &summary)?;
    Ok(summary)
}

/// The directories of parts, by the parts in words.
type Found = BTreeMap<String, (Part, PathBuf)>;

/// Reads the manifests, which must be those of all parts of one sweep, each once. Returns the first.
fn found(dirs: &[PathBuf]) -> Result<(Manifest, Found), JoinError> {
    let mut all: Found = BTreeMap::new();
    let mut first: Option<(Manifest, Part, PathBuf)> = None;
    for dir in dirs {
        let manifest = Manifest::read(dir)?;
        let part = manifest.part;
        if part.is_whole() {
            return Err(JoinError::Whole(dir.clone()));
        }
        let (reference, of, first_dir) = first.get_or_insert_with(|| (manifest.clone(), part, dir.clone()));
        if part.of() != of.of() {
            let (dir, first, of) = (dir.clone(), first_dir.clone(), of.of());
            return Err(JoinError::Division { dir, found: part.to_string(), first, of });
        }
        manifest.must_be_of(reference, dir)?;
        if let Some((_, other)) = all.insert(part.to_string(), (part, dir.clone())) {
            return Err(JoinError::Twice { part: part.to_string(), first: other, second: dir.clone() });
        }
    }
    let Some((manifest, part, _)) = first else {
        return Err(JoinError::Missing { missing: Vec::new(), of: 0 });
    };
    let missing: Vec<String> =
        part.all().map(|part| part.to_string()).filter(|name| !all.contains_key(name)).collect();
    match missing.is_empty() {
        true => Ok((manifest, all)),
        false => Err(JoinError::Missing { missing, of: part.of() }),
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::row;
    use super::*;
    use metamorph_scenario::grid::{Axis, Grid, Seeds};
    use std::fs;

    fn grid(until: u64) -> Grid {
        Grid::new(Seeds { from: 3, until }, vec![Axis::parse("link.loss=0%,5%").unwrap()]).unwrap()
    }
    fn manifest(until: u64) -> Manifest {
        Manifest::new("a.toml", "version = 1\n", Vec::new(), &grid(until))
    }
    /// Writes the runs of a part for which `is_done` holds, in a directory of its own.
    fn write(
        root: &Path,
        name: &str,
        part: Part,
        manifest: &Manifest,
        is_done: impl Fn(u64) -> bool,
    ) -> PathBuf {
        let (dir, grid) = (root.join(name), &manifest.grid);
        let mut store = Store::create(&dir, &manifest.of_part(part)).unwrap();
        for run in (0..grid.runs()).filter(|run| part.has(grid, *run) && is_done(*run)) {
            store.write(run, &row(grid.seed(run))).unwrap();
        }
        store.flush().unwrap();
        dir
    }

    #[test]
    fn parts_give_the_files_of_the_whole() {
        let root = tempfile::tempdir().unwrap();
        let manifest = manifest(10);
        let write_part =
            |part: Part| write(root.path(), &part.to_string().replace('/', "-"), part, &manifest, |_| true);
        let mut parts: Vec<PathBuf> = Part::parse("1/3").unwrap().all().map(write_part).collect();
        // Directories are named in any order.
        parts.reverse();
        let summary = join(&parts, &root.path().join("joined")).unwrap();
        assert_eq!((summary.runs, summary.runs_planned), (14, 14));
        let whole = write(root.path(), "whole", Part::WHOLE, &manifest, |_| true);
        for file in [RUNS, "manifest.json"] {
            assert_eq!(
                fs::read(root.path().join("joined").join(file)).unwrap(),
                fs::read(whole.join(file)).unwrap()
            );
        }
    }

    #[test]
    fn each_mistake_is_named_with_its_fix() {
        let root = tempfile::tempdir().unwrap();
        let part = |text| Part::parse(text).unwrap();
        let ours = manifest(10);
        let dirs: Vec<PathBuf> = ["1/2", "2/2", "2/2", "1/3"]
            .into_iter()
            .zip(["a", "b", "c", "d"])
            .map(|(text, name)| write(root.path(), name, part(text), &ours, |_| true))
            .collect();
        let other = write(root.path(), "e", part("2/2"), &manifest(11), |_| true);
        let torn = write(root.path(), "f", part("2/2"), &ours, |run| run != 1);
        let whole = write(root.path(), "g", Part::WHOLE, &ours, |_| true);
        let [a, b, c, d] = &dirs[..] else { panic!("four") };
        let out = root.path().join("out");
        let cases: [(&[&PathBuf], &str); 7] = [
            (&[a], "1 part of 2 missing: 2/2"),
            (&[a, b, c], "the part 2/2 is in"),
            (&[a, d], "the part 1/3 is there"),
            (&[a, &other], "other seeds: 3..11 there, 3..10 here"),
            (&[a, &torn], "2/2 in"),
            (&[&whole], "a whole sweep"),
            (&[a, &root.path().join("none")], "there is no sweep"),
        ];
        for (dirs, what) in cases {
            let dirs: Vec<PathBuf> = dirs.iter().map(|dir| (*dir).clone()).collect();
            let error = join(&dirs, &out).unwrap_err().to_string();
            assert!(error.contains(what) && error.contains("fix: "), "{error}");
            assert!(!out.exists(), "{what}");
        }
    }
}
