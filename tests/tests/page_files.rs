//! The files of the page, as they are in the program: the bundled library is the one whose versions are locked.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use flate2::Compression;
use flate2::write::GzEncoder;
use metamorph_tests::command::root;
use sha2::{Digest, Sha256};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

fn page() -> PathBuf {
    root().join("world-controller/view/src/page")
}

fn vendor() -> PathBuf {
    page().join("vendor")
}

/// Adds the sizes of all files that a browser can load, as they are and compressed one by one.
fn weigh(directory: &Path, whole: &mut usize, compressed: &mut usize) {
    for entry in fs::read_dir(directory).unwrap().map(Result::unwrap) {
        let path = entry.path();
        if path.is_dir() {
            weigh(&path, whole, compressed);
        } else if path.extension().is_some_and(|e| ["html", "css", "js"].iter().any(|known| e == *known)) {
            let content = fs::read(path).unwrap();
            let mut packed = GzEncoder::new(Vec::new(), Compression::best());
            packed.write_all(&content).unwrap();
            *whole += content.len();
            *compressed += packed.finish().unwrap().len();
        }
    }
}

#[test]
fn the_page_is_small() {
    let (mut whole, mut compressed) = (0, 0);
    weigh(&page(), &mut whole, &mut compressed);
    assert!(whole > 600_000, "the files were not found: {whole} bytes");
    assert!(whole <= 900_000 && compressed <= 220_000, "{whole} bytes, {compressed} with gzip");
}

#[test]
fn the_library_is_the_one_that_was_made() {
    let library = fs::read(vendor().join("three.js")).unwrap();
    let sum: String = Sha256::digest(&library).iter().map(|byte| format!("{byte:02x}")).collect();
    let noted = fs::read_to_string(vendor().join("three.js.sha256")).unwrap();
    assert_eq!(noted, format!("{sum}  three.js\n"), "run world-controller/view/src/page/vendor/make");
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
