//! The crates of the workspace: folders, sources, and which uses which.

use cargo_metadata::{DependencyKind, MetadataCommand};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// A crate of the workspace.
#[derive(Clone, Debug)]
pub struct Crate {
    /// Its name.
    pub name: String,
    /// Its folder in the repository.
    pub folder: PathBuf,
    /// Its description in one sentence.
    pub description: String,
    /// The names of the crates of the workspace that it uses, except for its tests.
    pub uses: BTreeSet<String>,
}

/// Returns the crates of the workspace as cargo sees them.
///
/// # Errors
/// If cargo cannot be run or its answer cannot be read.
pub fn all(root: &Path) -> io::Result<Vec<Crate>> {
    let mut command = MetadataCommand::new();
    command.current_dir(root).no_deps().other_options(["--offline".to_owned()]);
    let metadata = command.exec().map_err(io::Error::other)?;
    let ours: BTreeSet<String> = metadata.packages.iter().map(|package| package.name.to_string()).collect();
    let described = metadata.packages.into_iter().map(|package| {
        let folder =
            package.manifest_path.parent().and_then(|at| at.strip_prefix(&metadata.workspace_root).ok());
        let uses = package.dependencies.into_iter().filter(|one| one.kind == DependencyKind::Normal);
        Crate {
            name: package.name.to_string(),
            folder: folder.map(PathBuf::from).unwrap_or_default(),
            description: package.description.unwrap_or_default(),
            uses: uses.map(|one| one.name).filter(|name| ours.contains(name)).collect(),
        }
    });
    Ok(described.collect())
}

/// Returns the Rust files of a crate in its `src` or in its `tests`, with their paths in the repository.
///
/// # Errors
/// If the sources cannot be read.
pub fn sources(root: &Path, of: &Crate, folder: &str) -> io::Result<BTreeMap<PathBuf, String>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![of.folder.join(folder)];
    folders.retain(|folder| root.join(folder).is_dir());
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(root.join(&folder))? {
            let path = folder.join(entry?.file_name());
            if root.join(&path).is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|end| end == "rs") {
                let text = fs::read_to_string(root.join(&path))?;
                found.insert(path, text);
            }
        }
    }
    Ok(found)
}

/// Returns the crates that each crate reaches by one or more uses.
fn reached(crates: &[Crate]) -> BTreeMap<&str, BTreeSet<&str>> {
    let mut reached: BTreeMap<&str, BTreeSet<&str>> =
        crates.iter().map(|one| (one.name.as_str(), one.uses.iter().map(String::as_str).collect())).collect();
    // Each round doubles the length of the paths that are followed.
    loop {
        let before = reached.clone();
        for far in reached.values_mut() {
            let further: Vec<&str> = far.iter().flat_map(|name| &before[name]).copied().collect();
            far.extend(further);
        }
        if reached == before {
            return reached;
        }
    }
}

/// Returns the table of crates, from the bottom up. Of the crates that a crate uses it names those that it does not also reach
/// by another; `old` is the table that stands in the document.
///
/// # Errors
/// If cargo or the sources cannot be read.
pub fn table(root: &Path, old: &str) -> io::Result<String> {
    let mut crates = all(root)?;
    crates.sort_by(|a, b| a.folder.cmp(&b.folder));
    let reached = reached(&crates);
    let folder = |name: &str| {
        let found = crates.iter().find(|one| one.name == name);
        found.map(|one| format!("`{}`", one.folder.display())).unwrap_or_default()
    };
    let mut rows: Vec<&Crate> = crates.iter().collect();
    rows.sort_by_key(|one| reached[one.name.as_str()].len());
    let mut table = "\n| folder | crate | content | lines | uses |\n|---|---|---|---|---|\n".to_owned();
    for one in rows {
        let begin = format!("| `{}` | `{}` |", one.folder.display(), one.name);
        let lines: usize = sources(root, one, "src")?.values().map(|text| text.lines().count()).sum();
        let kept = old.lines().find(|row| row.starts_with(&begin));
        let kept = kept.and_then(|row| row.rsplit(" | ").nth(1));
        let uses = one
            .uses
            .iter()
            .filter(|used| !one.uses.iter().any(|other| reached[other.as_str()].contains(used.as_str())));
        let uses: Vec<String> = uses.map(|used| folder(used)).collect();
        let uses = if uses.is_empty() { "–".to_owned() } else { uses.join(", ") };
        let description = one.description.trim_end_matches('.');
        table.push_str(&format!("{begin} {description} | {} | {uses} |\n", thousands(lines, kept)));
    }
    Ok(table)
}

/// Returns lines in thousands, to the nearest half. A figure that stands already is kept while it is less than half a thousand
/// off, so that small changes do not make a document stale.
fn thousands(lines: usize, kept: Option<&str>) -> String {
    let halves = ((lines + 250) / 500).max(1);
    let text = |halves: usize| format!("{}.{} k", halves / 2, halves % 2 * 5);
    let near = [halves.saturating_sub(1), halves + 1]
        .into_iter()
        .find(|near| *near > 0 && kept == Some(&text(*near)) && lines.abs_diff(near * 500) < 500);
    text(near.unwrap_or(halves))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::root;

    #[test]
    fn arrows_are_those_of_cargo_without_shortcuts() {
        let table = table(&root(), "").unwrap();
        let row =
            |folder: &str| table.lines().find(|row| row.starts_with(&format!("| `{folder}` |"))).unwrap();
        assert!(row("protocol/core").ends_with(" k | – |"), "{table}");
        let uses = row("tests").rsplit(" | ").next().unwrap();
        assert!(uses.contains("`world-controller`") && !uses.contains("`protocol/core`"), "{table}");
        assert!(table.find("| `protocol/core`") < table.find("| `world-controller`"), "{table}");
    }

    #[test]
    fn a_figure_is_kept_while_it_is_near() {
        assert_eq!(thousands(7_740, None), "7.5 k");
        assert_eq!(thousands(7_760, None), "8.0 k");
        assert_eq!(thousands(7_760, Some("7.5 k")), "7.5 k");
        assert_eq!(thousands(8_010, Some("7.5 k")), "8.0 k");
        assert_eq!(thousands(3, None), "0.5 k");
    }
}
