//! `docs/sources.md` has every numbered section of both source documents once, and what it says can be checked: its paths
//! exist, and its commands run.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{metamorph, root};
use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::symlink;
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::thread;

/// The sections of a chapter: its name, and the number of subsections of each section.
type Chapter = (&'static str, &'static [usize]);

/// The numbered sections of the thesis, by its table of contents.
const THESIS: [Chapter; 14] = [
    ("1", &[0, 0]),
    ("2", &[0, 4]),
    ("3", &[2, 3, 0]),
    ("4", &[4, 3, 0]),
    ("5", &[5, 0]),
    ("6", &[0, 3, 2, 0]),
    ("7", &[0, 0, 0, 2, 2, 0, 0, 0]),
    ("8", &[0, 2, 3, 4, 4, 0, 0]),
    ("9", &[0, 0, 0]),
    ("A", &[0, 0]),
    ("B", &[0, 0, 0, 0, 0, 0, 0]),
    ("C", &[0, 0, 4, 4, 2, 5, 2, 2]),
    ("D", &[]),
    ("E", &[0, 4, 2, 3, 5, 0]),
];
/// The numbered sections of the report.
const REPORT: [Chapter; 8] = [
    ("1", &[0]),
    ("2", &[0, 0, 0, 0, 0]),
    ("3", &[0, 0]),
    ("4", &[0, 0]),
    ("5", &[0, 6, 0]),
    ("6", &[0, 0, 0]),
    ("7", &[]),
    ("8", &[]),
];

/// Returns the numbers of all sections. Appendices, and chapters without sections, have a row of their own.
fn numbers(chapters: &[Chapter]) -> Vec<String> {
    let mut all = Vec::new();
    for (chapter, sections) in chapters {
        if sections.is_empty() || chapter.chars().all(char::is_alphabetic) {
            all.push((*chapter).to_owned());
        }
        for (section, subsections) in (1..).zip(*sections) {
            all.push(format!("{chapter}.{section}"));
            all.extend((1..=*subsections).map(|sub| format!("{chapter}.{section}.{sub}")));
        }
    }
    all
}

fn page() -> String {
    fs::read_to_string(root().join("docs/sources.md")).unwrap()
}

/// Returns the cells of the rows of tables, without their heads.
fn rows(text: &str) -> Vec<Vec<&str>> {
    let rows = text.lines().filter_map(|line| line.strip_prefix("| ")?.strip_suffix(" |"));
    let cells = rows.map(|row| row.split(" | ").map(str::trim).collect::<Vec<&str>>());
    cells.filter(|cells| cells[0] != "section").collect()
}

#[test]
fn every_numbered_section_has_one_row() {
    let page = page();
    let (thesis, report) = page.split_once("\n## Report").unwrap();
    for (part, chapters) in [(thesis, &THESIS[..]), (report, &REPORT[..])] {
        let found: Vec<&str> = rows(part).iter().map(|cells| cells[0]).collect();
        assert_eq!(found, numbers(chapters));
    }
}

#[test]
fn every_path_exists() {
    let page = page();
    let quoted: Vec<&str> = page.split('`').skip(1).step_by(2).collect();
    let is_path = |text: &&str| {
        ["protocol/", "sim-bridge/", "world-controller/", "module-agent/", "deploy/", "docs/"]
            .iter()
            .any(|folder| text.starts_with(folder))
    };
    let paths: Vec<&str> = quoted.into_iter().filter(is_path).collect();
    let missing: Vec<&&str> = paths.iter().filter(|path| !root().join(path).exists()).collect();
    assert!(paths.len() > 100 && missing.is_empty(), "{missing:?}");
}

#[test]
fn every_command_runs() {
    let page = page();
    let commands: BTreeSet<&str> =
        rows(&page).iter().filter_map(|cells| cells.get(3)?.strip_prefix('`')?.strip_suffix('`')).collect();
    assert!(commands.len() > 40, "{commands:?}");
    let open = Mutex::new(commands.into_iter().collect::<Vec<&str>>());
    let failures = Mutex::new(Vec::new());
    thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                loop {
                    let Some(command) = open.lock().unwrap().pop() else { return };
                    let directory = tempfile::tempdir().unwrap();
                    symlink(root().join("deploy"), directory.path().join("deploy")).unwrap();
                    let args = command.strip_prefix("metamorph ").unwrap().split(' ');
                    let output = Command::new(metamorph())
                        .args(args)
                        .current_dir(directory.path())
                        .stdin(Stdio::null())
                        .output()
                        .unwrap();
                    if !output.status.success() {
                        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
                        failures.lock().unwrap().push(format!("{command}: {:?} {errors}", output.status));
                    }
                }
            });
        }
    });
    let failures = failures.into_inner().unwrap();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
