//! The tutorial shows the code that is compiled.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use std::fs;
use std::path::Path;

/// Every piece of Rust in the text is in a source file, line by line.
#[test]
fn the_tutorial_shows_the_code_that_is_compiled() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = fs::read_to_string(here.join("README.md")).unwrap();
    let sources: Vec<String> = ["leader.rs", "family.rs", "main.rs"]
        .iter()
        .map(|name| fs::read_to_string(here.join("src").join(name)).unwrap())
        .collect();
    let mut shown = 0;
    for block in text.split("```rust\n").skip(1).map(|rest| rest.split("```").next().unwrap()) {
        let found = sources.iter().any(|source| source.contains(block));
        assert!(found, "this is in no source file:\n{block}");
        shown += 1;
    }
    assert!(shown >= 5, "only {shown} pieces of code were found");
    // A reader writes this besides the agent.
    let family = sources[1].split("#[cfg(test)]").next().unwrap();
    let written = family.lines().chain(sources[2].lines()).filter(|line| !line.trim().is_empty()).count();
    assert!(written <= 150, "{written} lines");
}
