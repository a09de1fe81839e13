//! Imports between the files of a crate, and the circles that they make.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// A path of a source, by its segments.
pub type Segments = Vec<String>;

/// Returns a source without its tests and comments.
pub fn code(text: &str) -> String {
    let code = text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
    let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    lines.collect::<Vec<_>>().join("\n")
}

/// Reads the paths at the beginning of a text: segments joined by `::`, at the end also lists in braces. Each begins with
/// the segments of `before`. Returns the text behind them.
fn read_paths<'a>(text: &'a str, before: &[String], found: &mut Vec<Segments>) -> &'a str {
    let text = text.trim_start();
    if let Some(mut rest) = text.strip_prefix('{') {
        loop {
            rest = rest.trim_start();
            if let Some(behind) = rest.strip_prefix('}') {
                return behind;
            }
            rest = read_paths(rest, before, found);
            // Passes over an alias.
            let Some(end) = rest.find([',', '}']) else { return "" };
            rest = rest[end..].trim_start_matches(',');
        }
    }
    let end = text.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(text.len());
    let (name, rest) = text.split_at(end);
    let mut path = before.to_vec();
    path.extend((!name.is_empty() && name != "self").then(|| name.to_owned()));
    match rest.strip_prefix("::") {
        Some(rest) => read_paths(rest, &path, found),
        None => {
            found.push(path);
            rest
        }
    }
}

/// Returns the paths of a source without comments that begin with `start`, without it.
fn paths_from(code: &str, start: &str) -> Vec<Segments> {
    let mut found = Vec::new();
    for (at, _) in code.match_indices(start) {
        let before = &code[..at];
        let is_whole = !before.ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == '$');
        // `pub(in crate::...)` uses nothing.
        if is_whole && !before.ends_with("(in ") {
            read_paths(&code[at + start.len()..], &[], &mut found);
        }
    }
    found
}

/// Returns the modules that a source names by `crate::`, without its tests and comments.
pub fn used_modules(text: &str) -> BTreeSet<String> {
    paths_from(&code(text), "crate::").into_iter().filter_map(|path| path.into_iter().next()).collect()
}

/// The files of a crate, by the paths of their modules.
pub struct Files {
    files: BTreeMap<Segments, File>,
}

struct File {
    path: PathBuf,
    /// The paths that it names by `crate::`, `super::` or as an import from a module of its own, from the root of the crate.
    used: BTreeSet<Segments>,
    /// The paths of its imports, by the name of what is imported.
    imports: BTreeMap<String, Segments>,
}

impl Files {
    /// Reads the files of a crate, given by their paths in its folder of sources. Files of tests are left out.
    pub fn new<'a>(sources: impl Iterator<Item = (&'a Path, &'a str)>) -> Files {
        let sources = sources.filter(|(path, _)| !path.ends_with("tests.rs"));
        let texts: BTreeMap<Segments, (&Path, String)> =
            sources.map(|(path, text)| (module_of(path), (path, code(text)))).collect();
        let file = |module: &Segments, path: &Path, code: &str| {
            let mut used: BTreeSet<Segments> = paths_from(code, "crate::").into_iter().collect();
            let above = |levels: usize| &module[..module.len().saturating_sub(levels)];
            for path in paths_from(code, "super::") {
                let levels = 1 + path.iter().take_while(|name| *name == "super").count();
                used.insert([above(levels), &path[levels - 1..]].concat());
            }
            let mut own = Vec::new();
            for (at, _) in code.match_indices("use ").filter(|(at, _)| is_statement(&code[..*at])) {
                read_paths(&code[at + "use ".len()..], &[], &mut own);
            }
            let mut imports = BTreeMap::new();
            for path in own {
                let first = path.first().map(String::as_str).unwrap_or_default();
                let levels = path.iter().take_while(|name| *name == "super").count();
                let whole = match first {
                    "crate" => path[1..].to_vec(),
                    "super" => [above(levels), &path[levels..]].concat(),
                    _ => [module, path.as_slice()].concat(),
                };
                let is_ours = ["crate", "super"].contains(&first)
                    || texts.contains_key(&[module.as_slice(), &path[..1.min(path.len())]].concat());
                if let Some(name) = path.last().filter(|_| is_ours) {
                    imports.insert(name.clone(), whole.clone());
                    used.insert(whole);
                }
            }
            File { path: path.to_owned(), used, imports }
        };
        Files { files: texts.iter().map(|(m, (path, code))| (m.clone(), file(m, path, code))).collect() }
    }

    /// Returns the module of the file that has what a path names. What a module imports is looked for where it comes from.
    fn owner(&self, path: &[String], depth: usize) -> Option<&Segments> {
        let length = (0..=path.len()).rev().find(|length| self.files.contains_key(&path[..*length]))?;
        let (module, file) = self.files.get_key_value(&path[..length])?;
        let from = path.get(length).and_then(|name| file.imports.get(name));
        let whole = from.filter(|_| depth > 0).map(|from| [from.as_slice(), &path[length + 1..]].concat());
        whole.and_then(|whole| self.owner(&whole, depth - 1)).or(Some(module))
    }

    /// Returns the circles of files, the largest first: of two files of one circle each reaches the other by imports.
    pub fn circles(&self) -> Vec<BTreeSet<&Path>> {
        let mut reached: BTreeMap<&Segments, BTreeSet<&Segments>> = BTreeMap::new();
        for (module, file) in &self.files {
            let uses = file.used.iter().filter_map(|path| self.owner(path, 8));
            reached.insert(module, uses.filter(|used| *used != module).collect());
        }
        // Each round doubles the length of the paths that are followed.
        loop {
            let before = reached.clone();
            for far in reached.values_mut() {
                let further: Vec<_> = far.iter().flat_map(|module| &before[module]).copied().collect();
                far.extend(further);
            }
            if reached == before {
                break;
            }
        }
        let circle = |module: &&Segments| -> BTreeSet<&Path> {
            let both = reached[module].iter().filter(|other| reached[*other].contains(module));
            both.map(|other| self.files[*other].path.as_path()).collect()
        };
        let circles: BTreeSet<_> = reached.keys().map(circle).filter(|circle| circle.len() > 1).collect();
        let mut circles: Vec<_> = circles.into_iter().collect();
        circles.sort_by_key(|circle| std::cmp::Reverse(circle.len()));
        circles
    }
}

/// Returns the path of the module of a file.
fn module_of(file: &Path) -> Segments {
    let names = file.with_extension("");
    let mut names: Segments = names.iter().map(|name| name.to_string_lossy().into_owned()).collect();
    if names.last().is_some_and(|name| ["mod", "lib", "main"].contains(&name.as_str())) {
        names.pop();
    }
    names
}

/// Returns whether a word that follows this text begins a statement, or follows its visibility.
fn is_statement(before: &str) -> bool {
    let line = before.rsplit('\n').next().unwrap_or_default().trim();
    line.is_empty() || line == "pub" || line.starts_with("pub(") && line.ends_with(')')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modules_are_read_from_nested_lists() {
        let text = "use crate::{family, swarm::{hosts::{A, B}, C}, view as seen};\nuse crate::{\n    report::Report,\n    \
                    run,\n};\nfn f() { crate::cli::g::<u8>(); }\n// crate::absent\npub(in crate::inside) fn g() {}\n\
                    #[cfg(test)]\nmod tests { use crate::tested; }\n";
        let expected = ["family", "swarm", "view", "report", "run", "cli"].map(str::to_owned);
        assert_eq!(used_modules(text), BTreeSet::from(expected));
    }

    fn circles(sources: &[(&str, &str)]) -> Vec<Vec<String>> {
        let files = Files::new(sources.iter().map(|(path, text)| (Path::new(*path), *text)));
        let name = |path: &&Path| path.display().to_string();
        files.circles().iter().map(|circle| circle.iter().map(name).collect()).collect()
    }

    #[test]
    fn circles_go_through_imports_and_what_they_hand_on() {
        let sources = [
            ("lib.rs", "pub mod a;\npub mod b;\npub mod c;"),
            ("a/mod.rs", "mod inner;\npub use inner::Inner;\nuse crate::{b::{B}, c};"),
            ("a/inner.rs", "use super::super::c::C;\npub struct Inner;"),
            ("b.rs", "use crate::a::Inner;\npub struct B;"),
            ("c.rs", "fn f() -> super::b::B {}\npub struct C;"),
        ];
        // `b` uses `a/inner.rs`, not `a/mod.rs`, which only hands it on.
        assert_eq!(circles(&sources), [["a/inner.rs", "b.rs", "c.rs"]]);
        assert_eq!(circles(&sources[..3]), [[""; 0]; 0]);
    }
}
