//! The binary itself, so that building the tests builds it.

use std::process::Command;

#[test]
fn says_its_version() {
    let output = Command::new(env!("CARGO_BIN_EXE_metamorph")).arg("--version").output().unwrap();
    assert!(output.status.success());
    let text = String::from_utf8(output.stdout).unwrap();
    let version = text.trim().strip_prefix(concat!("metamorph ", env!("CARGO_PKG_VERSION"))).unwrap();
    // Outside of a repository there is no commit.
    if let Some(commit) = version.strip_prefix('+') {
        let hash = commit.strip_suffix(".changed").unwrap_or(commit);
        assert!(hash.len() == 12 && hash.bytes().all(|digit| digit.is_ascii_hexdigit()), "{version}");
    } else {
        assert_eq!(version, "");
    }
}
