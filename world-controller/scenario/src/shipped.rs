//! The scenarios that ship with the program, and the shapes and gaits that they name: part of the program, so that a
//! scenario is found by its name wherever the program is started.

use metamorph_text::sources::{STANDARD_INPUT, Sources};
use std::ffi::OsStr;
use std::io;
use std::path::{Component, Path, PathBuf};
use strsim::damerau_levenshtein;

/// Where the files of the program seem to be.
const ROOT: &str = "(shipped)";
/// Where shipped scenarios seem to be.
const DIRECTORY: &str = "(shipped)/scenarios";
/// Largest number of suggestions.
const SUGGESTIONS_MAX: usize = 3;

macro_rules! scenarios {
    ($($name:literal),* $(,)?) => {
        /// The scenarios, in the order of their names.
        const SCENARIOS: &[(&str, &str)] =
            &[$(($name, include_str!(concat!("../shipped/scenarios/", $name, ".toml")))),*];
    };
}

scenarios!(
    "a-third-dies",
    "arch",
    "box",
    "box-to-chair",
    "box-to-table",
    "carry-cube",
    "carry-dead",
    "chair",
    "chair-hardware",
    "disc-to-sphere",
    "drop",
    "faults",
    "hand-over",
    "line-to-box",
    "line-to-loop",
    "quadruped",
    "rabbit",
    "slab-to-disc",
    "slab-to-sphere",
    "soft-joints",
    "stoy",
    "swarm",
    "swarm-200",
    "table",
    "table-to-shelf",
);

/// The files that shipped scenarios name.
const FILES: &[(&str, &[u8])] = &[
    ("(shipped)/gaits/quad5.json", include_bytes!("../shipped/gaits/quad5.json")),
    ("(shipped)/gaits/quad5-dead-0.json", include_bytes!("../shipped/gaits/quad5-dead-0.json")),
    ("(shipped)/shapes/arch.stl", include_bytes!("../shipped/shapes/arch.stl")),
    ("(shipped)/shapes/rabbit.stl", include_bytes!("../shipped/shapes/rabbit.stl")),
];

/// Returns the names of all scenarios, in order.
pub fn names() -> impl Iterator<Item = &'static str> {
    SCENARIOS.iter().map(|(name, _)| *name)
}

/// Returns the text of the scenario of this name.
pub fn text(name: &str) -> Option<&'static str> {
    SCENARIOS.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// Resolves the path of a file that a scenario names: relative to the scenario, unless it is in the program.
pub fn resolve(origin: &str, name: &str) -> PathBuf {
    let directory = match text(origin) {
        _ if name.starts_with(ROOT) => Path::new(""),
        Some(_) => Path::new(DIRECTORY),
        None => Path::new(origin).parent().unwrap_or(Path::new("")),
    };
    directory.join(name)
}

/// Returns the text of the scenario of this name, for a file elsewhere: with files of the program by their whole
/// paths.
pub fn text_elsewhere(name: &str) -> Option<String> {
    text(name).map(|text| {
        let of =
            |text: String, folder| text.replace(&format!("\"../{folder}/"), &format!("\"{ROOT}/{folder}/"));
        of(of(text.to_owned(), "shapes"), "gaits")
    })
}

/// Returns the content of a file that a shipped scenario names.
pub fn file(path: &Path) -> Option<&'static [u8]> {
    path.starts_with(ROOT).then(|| {
        let mut plain = PathBuf::new();
        for component in path.components() {
            match component {
                Component::ParentDir => drop(plain.pop()),
                other => plain.push(other),
            }
        }
        FILES.iter().find(|(name, _)| Path::new(name) == plain).map(|(_, bytes)| *bytes)
    })?
}

/// The files that ship with the program, and other sources.
#[derive(Clone, Copy, Debug)]
pub struct WithShipped<S>(pub S);

impl<S: Sources> Sources for WithShipped<S> {
    fn read(&self, path: &Path, limit: u64) -> io::Result<Vec<u8>> {
        file(path).map_or_else(|| self.0.read(path, limit), |bytes| Ok(bytes.to_owned()))
    }
    fn read_argument(&self, path: &Path, limit: u64) -> io::Result<Vec<u8>> {
        self.0.read_argument(path, limit)
    }
    fn is_file(&self, path: &Path) -> bool {
        self.0.is_file(path)
    }
    fn exists(&self, path: &Path) -> bool {
        self.0.exists(path)
    }
    fn beside(&self, missing: &Path) -> Vec<PathBuf> {
        self.0.beside(missing)
    }
    fn kept(&self, name: &str, limit: u64) -> Option<Vec<u8>> {
        self.0.kept(name, limit)
    }
    fn keep(&self, name: &str, bytes: &[u8]) {
        self.0.keep(name, bytes);
    }
}

/// Meaning of an argument that names a scenario.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Named {
    /// A file, which may be missing.
    File(PathBuf),
    /// The scenario of this name that ships with the program.
    Shipped(&'static str),
}

/// Finds what an argument names: an existing file, else one of this name with `.toml`, else a shipped scenario.
pub fn find(sources: &dyn Sources, argument: &Path) -> Named {
    let shipped = argument.to_str().and_then(|name| names().find(|known| *known == name));
    let with_end = || {
        let mut name = argument.as_os_str().to_owned();
        name.push(".toml");
        PathBuf::from(name)
    };
    match shipped {
        Some(name) if sources.is_file(argument) => {
            tracing::warn!(
                "{name}: this file is read, not the scenario of this name that ships with the program"
            );
            // Written so, the name does not mean the shipped scenario.
            Named::File(Path::new(".").join(argument))
        }
        None if sources.exists(argument) => Named::File(argument.to_owned()),
        _ if sources.is_file(&with_end()) => Named::File(with_end()),
        Some(name) => Named::Shipped(name),
        None => Named::File(argument.to_owned()),
    }
}

/// Returns true if an argument names a scenario, by its end or by its name, and not a journal. A file that is missing counts
/// as a scenario unless its name ends in `.journal`.
pub fn is_scenario(sources: &dyn Sources, argument: &Path) -> bool {
    let ends_in =
        |path: &Path, ends: &[&str]| path.extension().is_some_and(|end| ends.iter().any(|e| end == *e));
    match find(sources, argument) {
        Named::File(path) if path == Path::new(STANDARD_INPUT) => true,
        Named::File(path) if sources.exists(&path) => ends_in(&path, &["toml", "json"]),
        Named::File(path) => !ends_in(&path, &["journal"]),
        Named::Shipped(_) => true,
    }
}

/// Returns what a missing file may have been meant to be: similar names of shipped scenarios and of scenarios
/// in its directory, the most similar first.
pub fn suggestions(sources: &dyn Sources, missing: &Path) -> Vec<String> {
    let end = |name: &OsStr| name.to_string_lossy().trim_end_matches(".toml").to_owned();
    let Some(wanted) = missing.file_name().map(end) else { return Vec::new() };
    let is_toml = |path: &PathBuf| path.extension().is_some_and(|end| end == "toml");
    let beside: Vec<PathBuf> = sources.beside(missing).into_iter().filter(is_toml).collect();
    let files = beside.iter().filter_map(|path| Some((end(path.file_name()?), path.display().to_string())));
    nearest(&wanted, files.chain(names().map(|name| (name.to_owned(), name.to_owned()))))
}

/// Returns the names of shipped scenarios that are similar to a name.
pub fn similar(wanted: &str) -> Vec<String> {
    nearest(wanted, names().map(|name| (name.to_owned(), name.to_owned())))
}

/// Chooses the nearest of some names, and returns what is to be shown for each.
fn nearest(wanted: &str, names: impl Iterator<Item = (String, String)>) -> Vec<String> {
    let most = (wanted.chars().count() / 3).max(1);
    let away = |(name, shown): (String, String)| (damerau_levenshtein(&name, wanted), shown);
    let mut near: Vec<(usize, String)> = names.map(away).filter(|(away, _)| *away <= most).collect();
    near.sort_by_key(|(away, _)| *away);
    near.into_iter().map(|(_, shown)| shown).take(SUGGESTIONS_MAX).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_are_found_where_scenarios_name_them() {
        let path = resolve("rabbit", "../shapes/rabbit.stl");
        let rabbit: &[u8] = include_bytes!("../shipped/shapes/rabbit.stl");
        assert_eq!(file(&path), Some(rabbit));
        for other in
            ["(shipped)/scenarios/../shapes/none.stl", "(shipped)/../../etc/passwd", "shapes/rabbit.stl"]
        {
            assert_eq!(file(Path::new(other)), None, "{other}");
        }
        assert_eq!(resolve("./rabbit", "a.stl"), Path::new("./a.stl"));
        assert_eq!(
            resolve("x/rabbit.toml", "(shipped)/shapes/arch.stl"),
            Path::new("(shipped)/shapes/arch.stl")
        );
    }
}
