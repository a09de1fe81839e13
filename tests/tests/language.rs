//! The language of the sources: one word for one thing, and comments that begin with their subject.
//!
//! Old cases are listed in `language/old_cases.txt`: how many of each rule a folder may have. A folder may not have more, and
//! one that has fewer changes the list: `METAMORPH_LANGUAGE=write cargo test -p metamorph-tests language::`.

use metamorph_tests::command::root;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The list of old cases.
const OLD_CASES: &str = "tests/tests/language/old_cases.txt";

/// Environment variable that writes the list again.
const WRITE: &str = "METAMORPH_LANGUAGE";

/// A rule of language.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Rule {
    /// A definition or a file has a word of the glossary's last column in its name.
    Glossary,
    /// Two public types of a crate have one name.
    TypeName,
    /// A numeric constant says neither unit nor quantity, in its name or in the first line of its documentation.
    Constant,
    /// A comment begins with "What".
    Comment,
}

impl Rule {
    const ALL: [Rule; 4] = [Rule::Glossary, Rule::TypeName, Rule::Constant, Rule::Comment];

    const fn name(self) -> &'static str {
        match self {
            Rule::Glossary => "glossary",
            Rule::TypeName => "type-name",
            Rule::Constant => "constant",
            Rule::Comment => "comment",
        }
    }
}

/// A place that a rule does not allow.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Case {
    rule: Rule,
    /// The folder of a crate, and the first folder in its sources, if any.
    folder: String,
    /// The file and the text in question.
    place: String,
}

/// Returns the words of the glossary's last column, without those that are terms themselves.
fn banned_words(glossary: &str) -> BTreeSet<String> {
    let rows = glossary.lines().filter_map(|line| line.strip_prefix("| "));
    let cells = rows.map(|row| row.split('|').map(str::trim).collect::<Vec<_>>());
    let (mut terms, mut banned) = (BTreeSet::new(), BTreeSet::new());
    let words = |text: &str| -> Vec<String> {
        let words = text.split(|c: char| !c.is_alphanumeric());
        words.filter(|word| !word.is_empty()).map(str::to_lowercase).collect()
    };
    for row in cells.filter(|row| row.len() == 5 && !row[0].starts_with('-') && row[0] != "term") {
        terms.extend(words(row[0]));
        let listed = row[3].split(',').filter(|word| !word.contains("*format*"));
        banned.extend(listed.map(words).filter(|words| words.len() == 1).flatten());
    }
    banned.difference(&terms).cloned().collect()
}

/// Splits a name in snake or camel case into words of lower case.
fn words_of(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut before = '_';
    for c in name.chars() {
        let begins = c == '_' || c == '-' || (c.is_uppercase() && before.is_lowercase());
        if begins {
            words.push(String::new());
        }
        if c.is_alphanumeric() {
            words.last_mut().expect("there is a word").extend(c.to_lowercase());
        }
        before = c;
    }
    words.retain(|word| !word.is_empty());
    words
}

/// A definition: its kind, such as `struct`, and its name.
fn definition(line: &str) -> Option<(&str, &str)> {
    let line = line.trim_start();
    let line = line.strip_prefix("pub").map_or(line, |rest| match rest.strip_prefix('(') {
        Some(inside) => inside.split_once(')').map_or(rest, |(_, rest)| rest),
        None => rest,
    });
    let mut words = line.split_whitespace();
    let mut kind = words.next()?;
    let mut name = words.next()?;
    while ["const", "async", "unsafe"].contains(&kind) && ["fn", "unsafe", "async"].contains(&name) {
        kind = name;
        name = words.next()?;
    }
    let is_kind = ["struct", "enum", "trait", "type", "fn", "const", "static", "mod"].contains(&kind);
    let end = name.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(name.len());
    (is_kind && end > 0).then_some((kind, &name[..end]))
}

/// Last words of names of constants that say a unit, a quantity or a bound.
const LAST_WORDS: [&str; 34] = [
    "max", "min", "s", "ms", "us", "ns", "mm", "deg", "rad", "px", "hz", "bytes", "bits", "count", "len",
    "percent", "ratio", "share", "version", "schema", "code", "seed", "scale", "step", "steps", "width",
    "height", "size", "radius", "time", "every", "rate", "speed", "mask",
];

/// Words of documentation that say a unit or a quantity.
const QUANTITIES: [&str; 42] = [
    "number",
    "time",
    "seconds",
    "milliseconds",
    "microseconds",
    "nanoseconds",
    "bytes",
    "bits",
    "cells",
    "mm",
    "degrees",
    "radians",
    "percent",
    "share",
    "ratio",
    "factor",
    "version",
    "code",
    "size",
    "width",
    "height",
    "length",
    "distance",
    "speed",
    "rate",
    "pixels",
    "columns",
    "lines",
    "characters",
    "steps",
    "moves",
    "modules",
    "weight",
    "radius",
    "count",
    "hundredths",
    "thousandths",
    "torque",
    "friction",
    "angle",
    "mass",
    "acceleration",
];

fn is_number(kind: &str, line: &str) -> bool {
    let numeric = [
        "u8", "u16", "u32", "u64", "u128", "usize", "i8", "i16", "i32", "i64", "f32", "f64", "Span",
        "Duration", "Time",
    ];
    let of = |line: &str| Some(line.split_once(": ")?.1.split([' ', ';', '=']).next()?.to_owned());
    ["const", "static"].contains(&kind) && of(line).is_some_and(|of| numeric.contains(&of.as_str()))
}

fn says_quantity(name: &str, documentation: &str) -> bool {
    let last = words_of(name).pop().unwrap_or_default();
    let words: Vec<String> =
        documentation.split(|c: char| !c.is_alphanumeric()).map(str::to_lowercase).collect();
    LAST_WORDS.contains(&last.as_str())
        || QUANTITIES.iter().any(|quantity| words.iter().any(|word| word == quantity))
}

/// Finds the cases of all rules but [`Rule::TypeName`] in a source, without its tests.
fn cases(text: &str, banned: &BTreeSet<String>) -> Vec<(Rule, String)> {
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    let (mut found, mut documentation, mut before) = (Vec::new(), String::new(), "");
    for line in code.lines() {
        let trimmed = line.trim_start();
        let comment = trimmed.strip_prefix("//").map(|rest| rest.trim_start_matches(['/', '!']).trim_start());
        if let Some(comment) = comment {
            let begins = !before.trim_start().starts_with("//");
            if begins && comment.starts_with("What ") {
                found.push((Rule::Comment, comment.to_owned()));
            }
            if trimmed.starts_with("///") && begins {
                documentation = comment.to_owned();
            }
        } else if let Some((kind, name)) = definition(line) {
            if words_of(name).iter().any(|word| banned.contains(word)) {
                found.push((Rule::Glossary, format!("{kind} {name}")));
            }
            let own = if before.trim_start().starts_with("///") { documentation.as_str() } else { "" };
            if is_number(kind, line) && !says_quantity(name, own) {
                found.push((Rule::Constant, name.to_owned()));
            }
        }
        if !trimmed.starts_with("#[") {
            before = line;
        }
    }
    found
}

fn rust_files(directory: &Path, found: &mut Vec<PathBuf>) {
    let entries = fs::read_dir(directory).expect("the directory can be read");
    for path in entries.map(|entry| entry.expect("the directory can be read").path()) {
        if path.is_dir() {
            rust_files(&path, found);
        } else if path.extension().is_some_and(|end| end == "rs") {
            found.push(path);
        }
    }
}

/// Returns the folders of all crates below the folders of sources.
fn crates() -> Vec<PathBuf> {
    let mut found = Vec::new();
    for top in ["protocol", "sim-bridge", "module-agent", "world-controller", "deploy"] {
        let inner = fs::read_dir(root().join(top)).expect("the folder can be read");
        let inner = inner.map(|entry| entry.expect("the folder can be read").path());
        let all = inner.chain([root().join(top)]).filter(|path| path.join("Cargo.toml").is_file());
        found.extend(all.filter(|path| path.join("src").is_dir()));
    }
    found.sort();
    found
}

/// Finds all cases, in order.
fn all_cases() -> Vec<Case> {
    let glossary = fs::read_to_string(root().join("docs/glossary.md")).expect("the glossary is there");
    let banned = banned_words(&glossary);
    let mut found = Vec::new();
    for one in crates() {
        let mut files = Vec::new();
        rust_files(&one.join("src"), &mut files);
        files.sort();
        let folder = one.strip_prefix(root()).expect("below the root").to_string_lossy().into_owned();
        let mut types: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for file in files.iter().filter(|file| !file.ends_with("tests.rs")) {
            let text = fs::read_to_string(file).expect("sources are text");
            let name = file.strip_prefix(root()).expect("below the root").display().to_string();
            let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let of_name = words_of(&stem)
                .iter()
                .any(|word| banned.contains(word))
                .then(|| (Rule::Glossary, format!("file {stem}")));
            for (rule, what) in cases(&text, &banned).into_iter().chain(of_name) {
                found.push(Case { rule, folder: folder.clone(), place: format!("{name}: {what}") });
            }
            let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
            for line in code.lines().filter(|line| line.starts_with("pub ")) {
                if let Some((_, name_of_type)) =
                    definition(line).filter(|(kind, _)| ["struct", "enum", "trait"].contains(kind))
                {
                    types.entry(name_of_type.to_owned()).or_default().push(name.clone());
                }
            }
        }
        for (name, files) in types.into_iter().filter(|(_, files)| files.len() > 1) {
            for file in &files[1..] {
                found.push(Case {
                    rule: Rule::TypeName,
                    folder: folder.clone(),
                    place: format!("{file}: {name}, as in {}", files[0]),
                });
            }
        }
    }
    found.sort();
    found
}

/// Counts cases by rule and folder.
fn counted(cases: &[Case]) -> BTreeMap<(Rule, String), usize> {
    let mut counts = BTreeMap::new();
    for case in cases {
        *counts.entry((case.rule, case.folder.clone())).or_default() += 1;
    }
    counts
}

fn written(counts: &BTreeMap<(Rule, String), usize>) -> String {
    counts.iter().map(|((rule, folder), count)| format!("{} {folder} {count}\n", rule.name())).collect()
}

fn read(text: &str) -> BTreeMap<(Rule, String), usize> {
    let line = |line: &str| {
        let mut words = line.split(' ');
        let rule = words.next().and_then(|name| Rule::ALL.into_iter().find(|rule| rule.name() == name))?;
        Some(((rule, words.next()?.to_owned()), words.next()?.parse().ok()?))
    };
    text.lines().map(|text| line(text).unwrap_or_else(|| panic!("{OLD_CASES}: `{text}`"))).collect()
}

#[test]
fn no_new_case_comes_in() {
    let found = all_cases();
    let counts = counted(&found);
    let path = root().join(OLD_CASES);
    if std::env::var_os(WRITE).is_some_and(|value| value == "write") {
        fs::write(&path, written(&counts)).expect("the list can be written");
        return;
    }
    let old = read(&fs::read_to_string(&path).expect("the list is there"));
    for ((rule, folder), count) in &counts {
        let allowed = old.get(&(*rule, folder.clone())).copied().unwrap_or(0);
        let places: Vec<&str> = found
            .iter()
            .filter(|case| case.rule == *rule && case.folder == *folder)
            .map(|case| case.place.as_str())
            .collect();
        assert!(
            *count <= allowed,
            "{rule:?}: {folder} has {count} cases, {allowed} of them old: {places:#?}"
        );
    }
    let fewer: Vec<_> =
        old.iter().filter(|(key, count)| counts.get(key).copied().unwrap_or(0) < **count).collect();
    assert!(fewer.is_empty(), "fewer cases than listed; {WRITE}=write makes the list again: {fewer:?}");
}

#[test]
fn each_rule_finds_its_case() {
    let glossary = "| term | meaning | where | not used |\n|---|---|---|---|\n| move | a step | here | deed, stride |\n\
                    | frame | bytes | here | packet, two words |\n| packet of a host link | bytes | here | |\n";
    let banned = banned_words(glossary);
    assert_eq!(banned, BTreeSet::from(["deed".to_owned(), "stride".to_owned()]));
    let found = |text: &str| cases(text, &banned);
    assert_eq!(found("pub(crate) struct FirstDeed;"), [(Rule::Glossary, "struct FirstDeed".to_owned())]);
    assert_eq!(found("const fn stride_of() {}"), [(Rule::Glossary, "fn stride_of".to_owned())]);
    assert_eq!(found("/// The longest.\nconst LONGEST: u32 = 4;"), [(Rule::Constant, "LONGEST".to_owned())]);
    assert_eq!(found("const PATIENCE: Span = Span(4);").len(), 1);
    assert_eq!(found("    // What it is.\n    let x = 1;"), [(Rule::Comment, "What it is.".to_owned())]);
    for allowed in [
        "struct Indeed;",
        "/// Largest number of gaits.\nconst GAITS: u32 = 4;",
        "const GAITS_MAX: u32 = 4;",
        "const NAME: &str = \"a\";",
        "/// Reads a file.\n/// What is read stays.\nfn read() {}",
        "#[cfg(test)]\nmod tests {\n    // What it is.\n}",
    ] {
        assert_eq!(found(allowed), [], "{allowed}");
    }
}
