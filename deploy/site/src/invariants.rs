//! The invariants of a run, as the sources declare them: a constant of the type `Invariant` each.

use crate::crates;
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};

/// An invariant.
#[derive(Clone, Debug)]
pub struct Declared {
    /// The name of its constant.
    pub constant: String,
    /// The file with this constant.
    pub declared_in: PathBuf,
    /// Its name in reports.
    pub name: String,
    /// The text of its documentation.
    pub holds: String,
    /// The files that check it.
    pub checked_in: BTreeSet<PathBuf>,
    /// True if a test names the invariant or the function that checks it.
    pub is_tested: bool,
}

/// The type of a declaration.
const TYPE: &str = ": Invariant = Invariant";

/// Returns the invariants that have a public constant, in the order of their files.
///
/// # Errors
/// If the sources cannot be read.
pub fn all(root: &Path) -> io::Result<Vec<Declared>> {
    let (mut sources, mut tests) = (BTreeMap::new(), String::new());
    for one in crates::all(root)? {
        sources.extend(crates::sources(root, &one, "src")?);
        tests.extend(crates::sources(root, &one, "tests")?.into_values());
    }
    let mut found = Vec::new();
    for (path, text) in &mut sources {
        found.extend(declared(text, path));
        let is_test = path.file_name().is_some_and(|name| name == "tests.rs");
        let code = if is_test { 0 } else { text.find("#[cfg(test)]\nmod tests").unwrap_or(text.len()) };
        tests.push_str(&text.split_off(code));
    }
    let (tests, _) = parts(&tests);
    for one in &mut found {
        let [constant, function] = [one.constant.clone(), one.constant.to_lowercase()];
        one.is_tested = tests.contains(constant.as_str()) || tests.contains(function.as_str());
    }
    for (path, text) in &sources {
        let (words, imports) = parts(text);
        for one in &mut found {
            let module = one.declared_in.file_stem().unwrap_or_default().to_string_lossy();
            let imports_it = |import: &&str| import.contains(&one.constant) && import.contains(&*module);
            let names_it =
                *path == one.declared_in || imports.iter().any(|import| imports_it(&import.as_str()));
            if names_it && words.contains(one.constant.as_str()) {
                one.checked_in.insert(path.clone());
            }
        }
    }
    Ok(found)
}

/// Returns the invariants that a source declares.
fn declared(text: &str, path: &Path) -> Vec<Declared> {
    let mut holds: Vec<&str> = Vec::new();
    let mut found = Vec::new();
    for line in text.lines() {
        if let Some(doc) = line.strip_prefix("/// ") {
            holds.push(doc);
            continue;
        }
        if let Some((constant, value)) = line.split_once(TYPE)
            && let Some(constant) = constant.strip_prefix("pub const ")
            && let Some(name) = value.split('"').nth(1)
        {
            found.push(Declared {
                constant: constant.to_owned(),
                declared_in: path.to_owned(),
                name: name.to_owned(),
                holds: holds.join(" "),
                checked_in: BTreeSet::new(),
                is_tested: false,
            });
        }
        holds.clear();
    }
    found
}

/// Returns the words of a source without its comments, imports and declarations of invariants, and its imports.
fn parts(text: &str) -> (BTreeSet<&str>, Vec<String>) {
    let (mut words, mut imports) = (BTreeSet::new(), Vec::new());
    let mut is_import = false;
    for line in text.lines().map(str::trim) {
        let begins = line.starts_with("use ") || line.starts_with("pub use ");
        if begins {
            imports.push(String::new());
        }
        is_import |= begins;
        match imports.last_mut().filter(|_| is_import) {
            Some(import) => import.push_str(line),
            None if line.starts_with("//") || line.contains(TYPE) => {}
            None => words.extend(line.split(|c: char| !c.is_alphanumeric() && c != '_')),
        }
        is_import &= !line.ends_with(';');
    }
    (words, imports)
}

/// Returns the table of invariants.
pub fn table(all: &[Declared]) -> String {
    let mut table = "\n| name | holds | checked in |\n|---|---|---|\n".to_owned();
    for one in all {
        let places: Vec<String> = one.checked_in.iter().map(|path| format!("`{}`", path.display())).collect();
        table.push_str(&format!("| `{}` | {} | {} |\n", one.name, one.holds, places.join(", ")));
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn declarations_and_uses_are_told_apart() {
        let text = "/// One thing\n/// holds.\npub const A_B: Invariant = Invariant::new(\"a-b\");\nuse x::{\n    C,\n};\ncheck(D);\n";
        let found = declared(text, Path::new("x.rs"));
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].name.as_str(), found[0].holds.as_str()), ("a-b", "One thing holds."));
        let (words, imports) = parts(text);
        assert!(words.contains("D") && !words.contains("C") && !words.contains("A_B"));
        assert_eq!(imports, ["use x::{C,};"]);
    }
}
