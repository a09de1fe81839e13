//! Those who publish the crates or cite the program find what they need: licences, keywords, the version.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use cargo_metadata::MetadataCommand;
use metamorph_tests::command::root;
use std::fs;

#[test]
fn published_crates_have_licences_and_keywords() {
    let metadata = MetadataCommand::new()
        .manifest_path(root().join("Cargo.toml"))
        .no_deps()
        .other_options(vec!["--offline".to_owned()])
        .exec()
        .unwrap();
    // A crate that is not published lists no registry.
    let published: Vec<_> = metadata.packages.iter().filter(|one| one.publish.is_none()).collect();
    assert!(published.len() > 20, "only {} crates are published", published.len());
    for package in published {
        let folder = package.manifest_path.parent().unwrap();
        for licence in ["LICENSE-MIT", "LICENSE-APACHE"] {
            let text = fs::read_to_string(folder.join(licence)).unwrap_or_else(|error| {
                panic!("{folder}: {licence} is no link to that of the repository: {error}")
            });
            assert_eq!(text, fs::read_to_string(root().join(licence)).unwrap(), "{folder}/{licence}");
        }
        assert!(!package.keywords.is_empty() && package.description.is_some(), "{}", package.name);
    }
}

#[test]
fn the_citation_and_the_changelog_have_the_version() {
    let version = env!("CARGO_PKG_VERSION");
    let citation = fs::read_to_string(root().join("CITATION.cff")).unwrap();
    assert!(citation.lines().any(|line| line == format!("version: {version}")), "CITATION.cff: {version}");
    let changes = fs::read_to_string(root().join("CHANGELOG.md")).unwrap();
    assert!(
        changes.lines().any(|line| line.starts_with(&format!("## {version} "))),
        "CHANGELOG.md: {version}"
    );
}
