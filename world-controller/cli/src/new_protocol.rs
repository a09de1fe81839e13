//! The command `new --protocol`: a repository for a protocol of one's own, which builds against the crates of this
//! version. It is `deploy/template`, with the name of its directory.

use crate::new::NewError;
use metamorph_console::output::Outputs;
use metamorph_scenario::quote;
use metamorph_text::escape::Shown;
use std::fs;
use std::path::Path;

/// The name of the crate in the template.
const NAME: &str = "my-protocol";

/// The files of the template, with their paths.
const FILES: [(&str, &str); 8] = [
    (".github/workflows/ci.yml", include_str!("../shipped/template/ci.yml")),
    (".gitignore", include_str!("../shipped/template/gitignore")),
    ("Cargo.toml", include_str!("../shipped/template/manifest.toml")),
    ("README.md", include_str!("../shipped/template/README.md")),
    ("ring.toml", include_str!("../shipped/template/ring.toml")),
    ("src/family.rs", include_str!("../shipped/template/family.rs")),
    ("src/leader.rs", include_str!("../shipped/template/leader.rs")),
    ("src/main.rs", include_str!("../shipped/template/main.rs")),
];

/// Returns a name for a crate that is like that of a directory.
fn crate_name(directory: &Path) -> String {
    let name = directory.file_name().map(|name| name.to_string_lossy().to_lowercase()).unwrap_or_default();
    let name: String =
        name.chars().map(|c| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' }).collect();
    match name.trim_matches('-') {
        name if name.starts_with(|c: char| c.is_ascii_alphabetic()) => name.to_owned(),
        _ => NAME.to_owned(),
    }
}

/// Writes the repository, and returns what to do next.
///
/// # Errors
/// If the directory exists and is not empty, or a file cannot be written.
pub fn protocol(directory: &Path) -> Result<String, NewError> {
    if fs::read_dir(directory).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(NewError::NotEmpty(directory.to_owned()));
    }
    let unwritable = |error| NewError::Directory { directory: directory.to_owned(), error };
    let name = crate_name(directory);
    for (path, text) in FILES {
        let path = directory.join(path);
        fs::create_dir_all(path.parent().unwrap_or(directory)).map_err(unwritable)?;
        Outputs::new().creates("new --protocol", &path)?.write(text.replace(NAME, &name))?;
    }
    Ok(format!(
        "{}: a protocol, its family and tests, as the crate {name}\n  name your clone of Metamorph in {}, then: cd {} && cargo test\n",
        directory.shown(),
        directory.join("Cargo.toml").shown(),
        quote(directory.shown()),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use std::path::PathBuf;

    fn files(directory: &Path, below: &Path, found: &mut BTreeSet<PathBuf>) {
        for entry in fs::read_dir(directory.join(below)).unwrap() {
            let path = below.join(entry.unwrap().file_name());
            match directory.join(&path).is_dir() {
                true if path.ends_with("target") => {}
                true => files(directory, &path, found),
                false => drop(found.insert(path)),
            }
        }
    }

    #[test]
    fn the_copy_is_the_template() {
        let template = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/template");
        let mut there = BTreeSet::new();
        files(&template, Path::new(""), &mut there);
        there.remove(Path::new("Cargo.lock"));
        assert_eq!(there, FILES.iter().map(|(path, _)| PathBuf::from(path)).collect());
        let directory = tempfile::tempdir().unwrap();
        let mine = directory.path().join("Mine of 2");
        protocol(&mine).unwrap();
        for (path, _) in FILES {
            let text = fs::read_to_string(template.join(path)).unwrap();
            let copy = fs::read_to_string(mine.join(path)).unwrap();
            assert_eq!(copy, text.replace(NAME, "mine-of-2"), "{path}");
        }
        assert!(matches!(protocol(&mine), Err(NewError::NotEmpty(_))));
        let empty = directory.path().join("empty");
        fs::create_dir(&empty).unwrap();
        assert!(protocol(&empty).is_ok());
    }

    #[test]
    fn crates_have_valid_names() {
        for (directory, name) in
            [("a/B_c", "b_c"), ("9lives", NAME), ("..", NAME), ("ü1", NAME), ("x y", "x-y")]
        {
            assert_eq!(crate_name(Path::new(directory)), name, "{directory}");
        }
    }

    /// The versions that the template asks for are those of this workspace.
    #[test]
    fn the_template_asks_for_this_version() {
        let (_, manifest) = FILES.iter().find(|(path, _)| *path == "Cargo.toml").unwrap();
        let manifest: toml::Table = manifest.parse().unwrap();
        let ours: Vec<_> = manifest["dependencies"]
            .as_table()
            .unwrap()
            .iter()
            .filter(|(name, _)| name.starts_with("metamorph-"))
            .collect();
        assert_eq!(ours.len(), 3);
        assert!(
            ours.iter().all(|(_, version)| version.as_str() == Some(env!("CARGO_PKG_VERSION"))),
            "{ours:?}"
        );
    }
}
