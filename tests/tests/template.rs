//! `metamorph new --protocol` makes a repository that builds outside of this one, against the crates as they are packed.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{Ran, command, root};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The crates that a protocol is built with.
const CRATES: [&str; 3] = ["metamorph-protocol", "metamorph-sim-bridge", "metamorph-world-controller"];

/// Returns the crates that these are made of. In a clone their paths are known; packed, they have to be named, too.
fn parts() -> Vec<String> {
    let manifest = fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let ours = manifest.lines().filter_map(|line| line.split_once(" = { path = \"").map(|(name, _)| name));
    ours.filter(|name| !CRATES.contains(name)).map(str::to_owned).collect()
}

fn cargo(directory: &Path, args: &[&str]) -> Ran {
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(args).arg("--offline").current_dir(directory);
    // What cargo says to this test is not for the cargo of the template.
    cargo.env_remove("CARGO_MANIFEST_DIR").env_remove("CARGO_TARGET_DIR");
    let ran: Ran = cargo.output().unwrap().into();
    assert_eq!(ran.code, Some(0), "cargo {args:?} in {}:\n{}\n{}", directory.display(), ran.out, ran.err);
    ran
}

/// Packs the crates and unpacks them as a registry would hand them out. Returns the directory of each.
fn packed(directory: &Path) -> Vec<(String, PathBuf)> {
    let target = directory.join("target");
    let target = target.to_str().unwrap();
    let mut args = vec!["package", "--quiet", "--no-verify", "--allow-dirty", "--target-dir", target];
    let names: Vec<String> = CRATES.map(str::to_owned).into_iter().chain(parts()).collect();
    args.extend(names.iter().flat_map(|name| ["--package", name]));
    cargo(&root(), &args);
    let unpacked = names.iter().map(|name| {
        let stem = format!("{name}-{}", env!("CARGO_PKG_VERSION"));
        let file = directory.join("target/package").join(format!("{stem}.crate"));
        let status = Command::new("tar").arg("-xzf").arg(&file).arg("-C").arg(directory).status().unwrap();
        assert!(status.success(), "{}", file.display());
        (name.clone(), directory.join(stem))
    });
    unpacked.collect()
}

#[test]
fn the_template_builds_against_packed_crates() {
    let directory = tempfile::tempdir().unwrap();
    let ran: Ran =
        command(&["new", "--protocol", "mine"]).current_dir(directory.path()).output().unwrap().into();
    assert_eq!((ran.code, ran.err.as_str()), (Some(0), ""), "{ran:?}");
    let mine = directory.path().join("mine");
    // The patch of the template names a clone; here it names the packed crates.
    let manifest = fs::read_to_string(mine.join("Cargo.toml")).unwrap();
    let mut manifest = manifest;
    for (name, path) in packed(directory.path()) {
        let after = format!("{name} = {{ path = \"{}\" }}", path.display());
        if !CRATES.contains(&name.as_str()) {
            // The patch is the last table.
            manifest += &format!("{after}\n");
            continue;
        }
        let folder = name.trim_start_matches("metamorph-");
        let before = format!("{name} = {{ path = \"../metamorph/{folder}\" }}");
        assert!(manifest.contains(&before), "{manifest}");
        manifest = manifest.replace(&before, &after);
    }
    fs::write(mine.join("Cargo.toml"), manifest).unwrap();
    // The same versions of other crates as here, since there may be no network.
    fs::copy(root().join("Cargo.lock"), mine.join("Cargo.lock")).unwrap();
    // Kept from one run to the next: only what has changed is checked again.
    let target = metamorph_tests::command::metamorph().parent().unwrap().join("template");
    cargo(&mine, &["check", "--quiet", "--all-targets", "--target-dir", target.to_str().unwrap()]);
}

#[test]
fn directories_with_files_are_refused() {
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("kept"), "").unwrap();
    let path = directory.path().to_str().unwrap();
    let ran: Ran = command(&["new", "--protocol", path]).output().unwrap().into();
    assert!(ran.code == Some(2) && ran.err.contains("this directory is not empty"), "{ran:?}");
    assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1);
    let ran: Ran = command(&["new", "a.toml", "--protocol", path]).output().unwrap().into();
    assert!(ran.code == Some(2) && ran.err.contains("cannot be used with"), "{ran:?}");
}
