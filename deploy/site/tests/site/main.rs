//! Generated pages are current, and all links lead somewhere.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

#[cfg(feature = "book")]
mod book;

use metamorph_site::{generated, links, root};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

fn markdown_below(directory: &Path, found: &mut BTreeSet<PathBuf>) {
    for entry in fs::read_dir(root().join(directory)).unwrap() {
        let path = directory.join(entry.unwrap().file_name());
        if root().join(&path).is_dir() {
            markdown_below(&path, found);
        } else if path.extension().is_some_and(|end| end == "md") {
            found.insert(path);
        }
    }
}

#[test]
fn generated_pages_are_current() {
    for (path, text) in generated() {
        let kept = fs::read_to_string(root().join("docs").join(&path)).unwrap_or_default();
        let differs = text.lines().zip(kept.lines()).find(|(new, old)| new != old);
        assert!(
            kept == text,
            "docs/{path} is old: {differs:?}; run `cargo run -p metamorph-site -- generate`"
        );
    }
}

/// Every page in docs/ is on the site, once, and every picture of the gallery is drawn by the script.
#[test]
fn the_list_has_every_page() {
    let listed = links::pages(&root()).unwrap();
    let once: BTreeSet<PathBuf> = listed.iter().cloned().collect();
    assert_eq!(listed.len(), once.len(), "a page is listed twice: {listed:?}");
    let mut pages = BTreeSet::new();
    markdown_below(Path::new("docs"), &mut pages);
    pages.remove(Path::new("docs/SUMMARY.md"));
    let listed: BTreeSet<PathBuf> = once.into_iter().filter(|page| page.starts_with("docs")).collect();
    assert_eq!(listed, pages, "docs/SUMMARY.md does not list the pages of docs/");
}

#[test]
fn all_links_lead_somewhere() {
    let mut pages = BTreeSet::from(
        ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md"].map(PathBuf::from),
    );
    for directory in ["docs", "deploy"] {
        markdown_below(Path::new(directory), &mut pages);
    }
    pages.retain(|page| !page.components().any(|part| part.as_os_str().to_string_lossy().starts_with('.')));
    let dead: Vec<String> = pages
        .iter()
        .flat_map(|page| links::dead(&root(), page, &fs::read_to_string(root().join(page)).unwrap()))
        .collect();
    assert!(pages.len() > 25 && dead.is_empty(), "{dead:#?}");
}
