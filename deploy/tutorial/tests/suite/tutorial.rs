//! The protocol of the tutorial behaves as described, on both links, and the tutorial shows the
//! code that is compiled.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_protocol::ids::ModuleId;
use metamorph_tutorial::{processes, simulate};
use std::fs;
use std::path::Path;

#[test]
fn modules_agree_although_messages_are_lost() {
    for (side, loss) in [(1, "0%"), (8, "0%"), (8, "30%"), (20, "10%")] {
        let outcome = simulate(side, loss.parse().unwrap(), 7);
        assert_eq!(outcome.leader.unwrap().0, ModuleId(0), "{side} {loss}");
        assert_eq!(outcome, simulate(side, loss.parse().unwrap(), 7), "a seed gives one run");
    }
    assert_eq!(simulate(3, "100%".parse().unwrap(), 7).leader, None);
}

#[test]
fn processes_agree_although_messages_are_lost() {
    let outcome = processes(env!("CARGO_BIN_EXE_tutorial").into(), 3, "10%".parse().unwrap()).unwrap();
    assert_eq!(outcome.leader.unwrap().0, ModuleId(0));
}

/// Every piece of Rust in the text is in a source file, line by line.
#[test]
fn the_tutorial_shows_the_code_that_is_compiled() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = fs::read_to_string(here.join("README.md")).unwrap();
    let sources: Vec<String> = ["leader.rs", "election.rs", "lib.rs", "main.rs", "metamorph_election.rs"]
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
}
