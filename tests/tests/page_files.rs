//! The files of the page, as they are in the program: the bundled library is the one whose versions are locked.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::root;
use sha2::{Digest, Sha256};
use std::fs;
use std::path::PathBuf;

fn vendor() -> PathBuf {
    root().join("world-controller/src/view/page/vendor")
}

#[test]
fn the_library_is_the_one_that_was_made() {
    let library = fs::read(vendor().join("three.js")).unwrap();
    let sum: String = Sha256::digest(&library).iter().map(|byte| format!("{byte:02x}")).collect();
    let noted = fs::read_to_string(vendor().join("three.js.sha256")).unwrap();
    assert_eq!(noted, format!("{sum}  three.js\n"), "run world-controller/src/view/page/vendor/make");
    let text = String::from_utf8(library).unwrap();
    // The banner has the version that is locked, and the licence.
    let lock = fs::read_to_string(vendor().join("package-lock.json")).unwrap();
    let lock: serde_json::Value = serde_json::from_str(&lock).unwrap();
    let version = lock["packages"]["node_modules/three"]["version"].as_str().unwrap();
    assert!(text.starts_with(&format!("/*!\nthree.js {version}, ")), "{}", &text[..60]);
    assert!(text.contains("The MIT License") && text.contains("three.js authors"));
    // The page's policy allows no text that becomes code.
    assert!(!text.contains("eval(") && !text.contains("new Function"));
}
