//! The licences of the crates that are in the program: `third-party.txt`, which `metamorph licences` prints and packages carry.

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand, Package, PackageId, TargetKind};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// The notices, in the repository.
pub const PATH: &str = "world-controller/cli/third-party.txt";

const PROGRAM: &str = "metamorph-world-controller";

/// How files with licences begin, in lower case.
const FILE_NAMES: [&str; 5] = ["licen", "copying", "copyright", "notice", "unlicense"];

/// Parts of the program that are no crates, and the files that have their notices.
const OTHERS: [(&str, &str); 2] = [
    ("three.js (MIT)", "world-controller/view/src/page/vendor/three.js"),
    ("DejaVu Sans (Bitstream Vera)", "world-controller/scene/src/figure/letters/licence.txt"),
];

/// The features of the dependencies that are looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Build {
    /// Those that are on by default. Their crates have been downloaded when the program was built.
    Default,
    /// Links between machines, too. Cargo may download crates.
    WithHosts,
}

/// Returns the crates that are linked into the program: dependencies at run time, without macros and what these need.
///
/// # Errors
/// If cargo cannot resolve the dependencies.
pub fn linked(root: &Path, build: Build) -> io::Result<Vec<Package>> {
    let metadata = resolved(root, build)?;
    let resolve = metadata.resolve.as_ref().ok_or_else(|| io::Error::other("cargo resolved nothing"))?;
    let packages: BTreeMap<&PackageId, &Package> =
        metadata.packages.iter().map(|one| (&one.id, one)).collect();
    let nodes: BTreeMap<_, _> = resolve.nodes.iter().map(|node| (&node.id, node)).collect();
    let program = metadata.packages.iter().find(|one| one.name.as_str() == PROGRAM);
    let mut next: Vec<&PackageId> = program.iter().map(|one| &one.id).collect();
    let mut reached: BTreeSet<&PackageId> = next.iter().copied().collect();
    while let Some(id) = next.pop() {
        for dependency in &nodes[id].deps {
            let at_run_time = dependency.dep_kinds.iter().any(|kind| kind.kind == DependencyKind::Normal);
            if at_run_time && !is_macro(packages[&dependency.pkg]) && reached.insert(&dependency.pkg) {
                next.push(&dependency.pkg);
            }
        }
    }
    let foreign = reached.into_iter().map(|id| packages[id]).filter(|one| one.source.is_some());
    let mut foreign: Vec<Package> = foreign.cloned().collect();
    foreign.sort_by(|a, b| (&a.name, &a.version).cmp(&(&b.name, &b.version)));
    Ok(foreign)
}

fn resolved(root: &Path, build: Build) -> io::Result<Metadata> {
    let mut command = MetadataCommand::new();
    let mut options =
        vec!["--filter-platform".to_owned(), format!("{}-unknown-linux-gnu", std::env::consts::ARCH)];
    match build {
        Build::Default => options.push("--offline".to_owned()),
        Build::WithHosts => options.extend(["--features".to_owned(), format!("{PROGRAM}/hosts")]),
    }
    command.manifest_path(root.join("Cargo.toml")).other_options(options).exec().map_err(io::Error::other)
}

fn is_macro(package: &Package) -> bool {
    package.targets.iter().any(|target| target.kind.contains(&TargetKind::ProcMacro))
}

/// Returns the line that names a crate in the notices.
pub fn named(package: &Package) -> String {
    format!("{} {}", package.name, package.version)
}

/// Returns the notices: each text once, below the crates that it is of.
///
/// Of a crate that lets one choose among licences and has the text of MIT, that one is chosen. The text of Apache 2.0 has no
/// names in it and is the same for all, so it is referred to.
///
/// # Errors
/// If cargo cannot resolve the dependencies, or a file cannot be read.
pub fn text(root: &Path) -> io::Result<String> {
    let mut crates_of: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for package in linked(root, Build::WithHosts)? {
        let licence = package.license.as_deref().unwrap_or("see its text").trim().to_owned();
        for text in texts(&package)? {
            crates_of.entry(text).or_default().push(format!("{} ({licence})", named(&package)));
        }
    }
    let mut blocks: Vec<(Vec<String>, String)> =
        crates_of.into_iter().map(|(text, crates)| (crates, text)).collect();
    blocks.sort();
    for (name, path) in OTHERS {
        let text = fs::read_to_string(root.join(path))?;
        // Of a script, the notice is its first comment.
        let notice = text.strip_prefix("/*!").and_then(|text| text.split("*/").next()).unwrap_or(&text);
        blocks.push((vec![name.to_owned()], shortened(notice)));
    }
    let mut all = "The program metamorph has parts by others: the crates below, the library of the page, and letters of pictures. Those of \
                   zenoh, rustls and what they need are in programs with links between machines only.\n"
        .to_owned();
    for (crates, text) in blocks {
        all.push_str(&format!("\n{}\n\n{}\n\n{text}\n", "=".repeat(80), crates.join("\n")));
    }
    Ok(all)
}

fn texts(package: &Package) -> io::Result<Vec<String>> {
    let folder = package.manifest_path.parent().map_or(Path::new("."), |folder| folder.as_std_path());
    let mut files = licence_files(folder)?;
    let is_mit = |path: &PathBuf| path.file_name().is_some_and(|name| name.to_string_lossy().contains("MIT"));
    let is_choice =
        package.license.as_deref().is_some_and(|licence| licence.contains(" OR ") || licence.contains('/'));
    if is_choice && files.iter().any(is_mit) {
        files.retain(is_mit);
    }
    if files.is_empty() {
        let authors =
            if package.authors.is_empty() { "its authors".to_owned() } else { package.authors.join(", ") };
        return Ok(vec![format!("Copyright of {authors}. The package has no text of its licence.")]);
    }
    files.iter().map(|path| Ok(shortened(&String::from_utf8_lossy(&fs::read(path)?)))).collect()
}

fn licence_files(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().to_lowercase();
        if FILE_NAMES.iter().any(|begin| name.starts_with(begin)) && entry.path().is_file() {
            files.push(entry.path());
        }
    }
    files.sort();
    Ok(files)
}

/// Returns a text without blanks at the ends of lines, or a reference if it is that of Apache 2.0 alone.
fn shortened(text: &str) -> String {
    /// Bytes of a file that has the text of Apache 2.0 and hardly more.
    const APACHE_BYTES: std::ops::Range<usize> = 8_000..13_000;
    if text.contains("Apache License") && text.contains("Version 2.0") && APACHE_BYTES.contains(&text.len()) {
        return "Apache License, Version 2.0: the text is that of Metamorph's own licence.".to_owned();
    }
    let lines: Vec<&str> = text.lines().map(str::trim_end).collect();
    lines.join("\n").trim_matches('\n').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::root;

    #[test]
    fn notices_name_every_crate_of_the_program() {
        let text = fs::read_to_string(root().join(PATH)).unwrap();
        let linked = linked(&root(), Build::Default).unwrap();
        assert!(linked.len() > 50, "only {} crates were found", linked.len());
        let absent: Vec<String> =
            linked.iter().map(named).filter(|name| !text.contains(&format!("\n{name} ("))).collect();
        assert!(
            absent.is_empty(),
            "cargo run -p metamorph-site -- notices: these are not in {PATH}: {absent:?}"
        );
    }

    #[test]
    fn the_text_of_apache_is_referred_to_and_others_are_kept() {
        let apache = fs::read_to_string(root().join("LICENSE-APACHE")).unwrap();
        assert!(shortened(&apache).starts_with("Apache License, Version 2.0: the text"));
        let mit = fs::read_to_string(root().join("LICENSE-MIT")).unwrap();
        assert_eq!(shortened(&mit), mit.trim_matches('\n'));
    }
}
