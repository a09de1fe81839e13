//! The layout of the sources is the one that ARCHITECTURE.md describes: dependencies between crates,
//! dependencies between the modules of a crate, and a subject for every file.

mod imports;

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand};
use imports::{Files, code, used_modules};
use metamorph_tests::command::root;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Returns for each of our crates the others that it may use.
fn allowed() -> BTreeMap<&'static str, Vec<&'static str>> {
    BTreeMap::from([
        ("metamorph-core", vec![]),
        ("metamorph-cube", vec!["metamorph-core"]),
        ("metamorph-host-link", vec!["metamorph-core"]),
        ("metamorph-pairing", vec!["metamorph-core"]),
        ("metamorph-roombots", vec!["metamorph-core"]),
        ("metamorph-planning", vec!["metamorph-core", "metamorph-roombots"]),
        ("metamorph-agents", vec!["metamorph-core", "metamorph-roombots", "metamorph-planning"]),
        (
            "metamorph-central-planning",
            vec!["metamorph-core", "metamorph-roombots", "metamorph-planning", "metamorph-agents"],
        ),
        (
            "metamorph-protocol",
            vec![
                "metamorph-core",
                "metamorph-cube",
                "metamorph-host-link",
                "metamorph-pairing",
                "metamorph-roombots",
                "metamorph-planning",
                "metamorph-agents",
                "metamorph-central-planning",
            ],
        ),
        ("metamorph-physics", vec!["metamorph-protocol"]),
        ("metamorph-kernel", vec!["metamorph-core"]),
        ("metamorph-sim-bridge", vec!["metamorph-protocol", "metamorph-kernel", "metamorph-physics"]),
        ("metamorph-module-agent", vec!["metamorph-protocol"]),
        ("metamorph-text", vec![]),
        ("metamorph-console", vec!["metamorph-kernel", "metamorph-module-agent", "metamorph-text"]),
        ("metamorph-shapes", vec!["metamorph-core", "metamorph-pairing", "metamorph-text"]),
        (
            "metamorph-scenario",
            vec!["metamorph-core", "metamorph-kernel", "metamorph-text", "metamorph-shapes"],
        ),
        (
            "metamorph-report",
            vec!["metamorph-core", "metamorph-kernel", "metamorph-text", "metamorph-scenario"],
        ),
        (
            "metamorph-scene",
            vec![
                "metamorph-core",
                "metamorph-kernel",
                "metamorph-text",
                "metamorph-scenario",
                "metamorph-report",
            ],
        ),
        ("metamorph-free-modules", vec!["metamorph-protocol", "metamorph-sim-bridge", "metamorph-text"]),
        (
            "metamorph-families",
            vec![
                "metamorph-protocol",
                "metamorph-sim-bridge",
                "metamorph-text",
                "metamorph-shapes",
                "metamorph-scenario",
                "metamorph-report",
                "metamorph-scene",
                "metamorph-free-modules",
            ],
        ),
        (
            "metamorph-runs",
            vec![
                "metamorph-sim-bridge",
                "metamorph-text",
                "metamorph-scenario",
                "metamorph-report",
                "metamorph-scene",
                "metamorph-families",
            ],
        ),
        (
            "metamorph-processes",
            vec![
                "metamorph-protocol",
                "metamorph-sim-bridge",
                "metamorph-module-agent",
                "metamorph-text",
                "metamorph-console",
                "metamorph-scenario",
                "metamorph-report",
                "metamorph-scene",
                "metamorph-families",
                "metamorph-runs",
            ],
        ),
        (
            "metamorph-experiments",
            vec![
                "metamorph-protocol",
                "metamorph-sim-bridge",
                "metamorph-module-agent",
                "metamorph-text",
                "metamorph-console",
                "metamorph-scenario",
                "metamorph-report",
                "metamorph-families",
                "metamorph-processes",
            ],
        ),
        (
            "metamorph-view",
            vec![
                "metamorph-protocol",
                "metamorph-sim-bridge",
                "metamorph-module-agent",
                "metamorph-text",
                "metamorph-console",
                "metamorph-scenario",
                "metamorph-report",
                "metamorph-scene",
                "metamorph-processes",
            ],
        ),
        (
            "metamorph-people",
            vec![
                "metamorph-protocol",
                "metamorph-sim-bridge",
                "metamorph-module-agent",
                "metamorph-text",
                "metamorph-console",
                "metamorph-shapes",
                "metamorph-scenario",
                "metamorph-report",
                "metamorph-scene",
                "metamorph-free-modules",
                "metamorph-families",
                "metamorph-processes",
                "metamorph-experiments",
                "metamorph-view",
            ],
        ),
        (
            "metamorph-reproduce",
            vec![
                "metamorph-protocol",
                "metamorph-sim-bridge",
                "metamorph-text",
                "metamorph-console",
                "metamorph-scenario",
                "metamorph-report",
                "metamorph-free-modules",
                "metamorph-families",
                "metamorph-processes",
                "metamorph-experiments",
                "metamorph-people",
            ],
        ),
        (
            "metamorph-bench",
            vec![
                "metamorph-protocol",
                "metamorph-sim-bridge",
                "metamorph-module-agent",
                "metamorph-text",
                "metamorph-console",
                "metamorph-scenario",
                "metamorph-report",
                "metamorph-free-modules",
                "metamorph-families",
                "metamorph-processes",
                "metamorph-experiments",
            ],
        ),
        (
            "metamorph-cli",
            vec![
                "metamorph-protocol",
                "metamorph-sim-bridge",
                "metamorph-module-agent",
                "metamorph-text",
                "metamorph-console",
                "metamorph-shapes",
                "metamorph-scenario",
                "metamorph-report",
                "metamorph-scene",
                "metamorph-free-modules",
                "metamorph-families",
                "metamorph-processes",
                "metamorph-experiments",
                "metamorph-view",
                "metamorph-people",
                "metamorph-reproduce",
                "metamorph-bench",
            ],
        ),
        (
            "metamorph-world-controller",
            vec![
                "metamorph-sim-bridge",
                "metamorph-text",
                "metamorph-console",
                "metamorph-shapes",
                "metamorph-scenario",
                "metamorph-report",
                "metamorph-scene",
                "metamorph-free-modules",
                "metamorph-families",
                "metamorph-processes",
                "metamorph-experiments",
                "metamorph-view",
                "metamorph-people",
                "metamorph-reproduce",
                "metamorph-bench",
                "metamorph-cli",
            ],
        ),
        (
            "metamorph-tutorial",
            vec!["metamorph-protocol", "metamorph-sim-bridge", "metamorph-world-controller"],
        ),
        (
            "metamorph-python",
            vec!["metamorph-protocol", "metamorph-sim-bridge", "metamorph-world-controller"],
        ),
        (
            "metamorph-site",
            vec!["metamorph-protocol", "metamorph-module-agent", "metamorph-world-controller"],
        ),
        (
            "metamorph-tests",
            vec![
                "metamorph-protocol",
                "metamorph-sim-bridge",
                "metamorph-module-agent",
                "metamorph-world-controller",
            ],
        ),
    ])
}

/// What needs an operating system, or belongs to worlds and programs.
const OF_PROGRAMS: [&str; 7] = ["tokio", "iceoryx2", "rustix", "rand", "rapier3d", "clap", "toml"];

/// Crates that a crate must not use, not even indirectly.
const ABSENT: &[(&str, &[&str])] = &[
    // Agents compute without floating point.
    ("metamorph-core", &["nalgebra", "petgraph", "pathfinding", "rand"]),
    ("metamorph-cube", &["nalgebra", "petgraph", "pathfinding", "rand"]),
    ("metamorph-host-link", &OF_PROGRAMS),
    ("metamorph-pairing", &OF_PROGRAMS),
    ("metamorph-roombots", &OF_PROGRAMS),
    ("metamorph-planning", &OF_PROGRAMS),
    ("metamorph-agents", &OF_PROGRAMS),
    ("metamorph-central-planning", &OF_PROGRAMS),
    ("metamorph-physics", &["tokio", "iceoryx2", "rustix", "rand", "clap", "toml"]),
    ("metamorph-sim-bridge", &["tokio", "iceoryx2", "rustix", "rand", "rapier3d", "clap", "toml"]),
    ("metamorph-module-agent", &["tokio", "rapier3d", "clap", "toml"]),
    ("metamorph-world-controller", &["rand"]),
];

fn metadata() -> Metadata {
    let manifest = root().join("Cargo.toml");
    MetadataCommand::new().manifest_path(manifest).no_deps().exec().expect("cargo metadata works offline")
}

#[test]
fn arrows_point_one_way() {
    let metadata = metadata();
    let ours = allowed();
    let found: BTreeSet<&str> = metadata.packages.iter().map(|p| p.name.as_str()).collect();
    assert_eq!(found, ours.keys().copied().collect(), "a crate is new or gone: say where it belongs");
    for package in &metadata.packages {
        let may = &ours[package.name.as_str()];
        let used = package.dependencies.iter().filter(|d| d.kind != DependencyKind::Development);
        for dependency in used.map(|d| d.name.as_str()).filter(|d| ours.contains_key(d)) {
            assert!(may.contains(&dependency), "{} must not use {dependency}", package.name);
        }
    }
    for (name, absent) in ABSENT.iter().copied() {
        let package = metadata.packages.iter().find(|p| p.name.as_str() == name).expect("checked above");
        for dependency in package.dependencies.iter().filter(|d| d.kind == DependencyKind::Normal) {
            assert!(!absent.contains(&dependency.name.as_str()), "{name} must not use {}", dependency.name);
        }
    }
}

/// Agents of cubes and all that they use run without an operating system: no crate that they use brings std by default.
#[test]
fn the_core_and_cubes_need_no_std() {
    let metadata = metadata();
    for name in ["core", "cube"] {
        let text = fs::read_to_string(root().join("protocol").join(name).join("src/lib.rs"));
        let text = text.expect("sources are text");
        assert!(text.contains("#![cfg_attr(not(test), no_std)]"), "{name}");
        let package = metadata.packages.iter().find(|p| p.name.as_str() == format!("metamorph-{name}"));
        let used = &package.expect("the crate is there").dependencies;
        for dependency in used.iter().filter(|d| d.kind == DependencyKind::Normal) {
            let brings_std =
                dependency.uses_default_features || dependency.features.iter().any(|f| f == "std");
            assert!(!brings_std, "metamorph-{name} uses {} with std", dependency.name);
        }
    }
}

/// Crates that ask an operating system, or belong to programs that do.
const OF_SYSTEMS: [&str; 12] = [
    "clap",
    "hyper",
    "iceoryx2",
    "metamorph-console",
    "metamorph-module-agent",
    "metamorph-processes",
    "rustix",
    "signal-hook",
    "tempfile",
    "tokio",
    "tracing-subscriber",
    "zenoh",
];

/// Names of the standard library that ask the operating system.
const SYSTEM_NAMES: [&str; 9] = [
    "std::fs",
    "std::thread::",
    "std::process",
    "std::net",
    "std::env::var",
    "std::env::current",
    "std::os",
    "Instant::now",
    "SystemTime",
];

/// A run is a function of a text and a seed: `runs` and all below it work where there is no operating system.
#[test]
fn runs_and_all_below_ask_no_operating_system() {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let tree = [
        "tree",
        "--offline",
        "--locked",
        "--package",
        "metamorph-runs",
        "--edges",
        "normal",
        "--prefix",
        "none",
    ];
    let output = Command::new(cargo).args(tree).current_dir(root()).output().expect("cargo can be run");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let used = String::from_utf8(output.stdout).expect("names of crates are text");
    let used: BTreeSet<&str> = used.lines().filter_map(|line| line.split(' ').next()).collect();
    assert!(used.contains("metamorph-scenario"), "{used:?}");
    let asking: Vec<_> = OF_SYSTEMS.iter().filter(|name| used.contains(**name)).collect();
    assert!(asking.is_empty(), "metamorph-runs uses {asking:?}");

    let packages = metadata().packages;
    for package in packages.iter().filter(|package| used.contains(package.name.as_str())) {
        let mut files = Vec::new();
        rust_files(
            package.manifest_path.parent().expect("a manifest has a folder").join("src").as_std_path(),
            &mut files,
        );
        for file in files.iter().filter(|file| !file.ends_with("tests.rs")) {
            let text = fs::read_to_string(file).expect("sources are text");
            let code = code(&text);
            let asking: Vec<_> =
                code.lines().filter(|line| SYSTEM_NAMES.iter().any(|name| line.contains(name))).collect();
            assert!(asking.is_empty(), "{}: {asking:?}", file.display());
        }
    }
}

fn rust_files(directory: &Path, found: &mut Vec<PathBuf>) {
    let entries = fs::read_dir(directory).expect("the directory can be read");
    let mut paths: Vec<PathBuf> = entries.map(|e| e.expect("the directory can be read").path()).collect();
    paths.sort();
    for path in paths {
        let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
        if path.is_dir() && !name.starts_with('.') && name != "target" {
            rust_files(&path, found);
        } else if name.ends_with(".rs") {
            found.push(path);
        }
    }
}

#[test]
fn every_file_begins_with_its_subject() {
    let mut files = Vec::new();
    rust_files(&root(), &mut files);
    assert!(files.len() > 20, "the sources were not found");
    for file in files {
        let text = fs::read_to_string(&file).expect("sources are text");
        let first = text.lines().find(|line| !line.trim().is_empty()).unwrap_or_default();
        assert!(first.starts_with("//! "), "{} does not begin with its subject", file.display());
    }
}

/// The top-level modules of crates, given by their folders, from the bottom up: a module may use those before it only. A crate
/// that is not listed has no order of modules.
const LAYERS: &[(&str, &[&str])] = &[
    (
        "protocol/core",
        &[
            "names", "ids", "time", "ratio", "rng", "digest", "coverage", "defects", "lattice", "shape",
            "goal", "counters", "latency", "wire", "link", "agent", "runtime", "record", "host",
        ],
    ),
    ("protocol/planning", &["plan", "assembly", "manipulation", "reconfiguration"]),
    ("protocol/agents", &["on_grid", "free_module", "metamodule"]),
    ("sim-bridge/physics", &["hull", "floor", "work", "absent", "rapier", "rapier_tests"]),
    ("sim-bridge/kernel", &["world", "director", "kernel", "testing"]),
    ("sim-bridge", &["connections", "cube", "metamodule", "free_module"]),
    (
        "module-agent",
        &[
            "regular_file",
            "clock",
            "journal_file",
            "run_dir",
            "transport",
            "link_emulator",
            "process",
            "registry",
        ],
    ),
    ("world-controller/processes", &["control", "metrics", "swarm", "record", "run", "family"]),
    ("world-controller/free-modules", &["plan", "gait", "structure"]),
    ("world-controller/experiments", &["sweep", "diff", "explore", "why"]),
    ("world-controller/people", &["room", "pointing", "studio"]),
];

#[test]
fn modules_use_only_those_below_them() {
    for (name, layers) in LAYERS.iter().copied() {
        let source = root().join(name).join("src");
        let mut files = Vec::new();
        rust_files(&source, &mut files);
        let module = |file: &Path| {
            let first = file.strip_prefix(&source).ok()?.components().next()?;
            Some(first.as_os_str().to_str()?.trim_end_matches(".rs").to_owned())
        };
        let found: BTreeSet<String> = files.iter().filter_map(|file| module(file)).collect();
        let named = layers.iter().copied().chain(["lib", "main"]).map(str::to_owned);
        let unnamed: Vec<_> = found.difference(&named.collect()).cloned().collect();
        assert!(unnamed.is_empty(), "{name}: say in LAYERS where {unnamed:?} belong");
        for file in &files {
            let Some(height) = module(file).and_then(|m| layers.iter().position(|l| *l == m)) else {
                continue;
            };
            let used = used_modules(&fs::read_to_string(file).expect("sources are text"));
            let above = layers[height + 1..].iter().filter(|l| used.contains(**l)).collect::<Vec<_>>();
            assert!(above.is_empty(), "{} must not use {above:?}", file.display());
        }
    }
}

/// The most files that may make a circle of imports.
const CIRCLE_MAX: usize = 4;

/// Circles of more files, by the folder that has all of them, with their sizes. None may grow, and one that is gone leaves
/// the list.
const CIRCLES: &[(&str, usize)] = &[
    ("swarm", 20),
    ("scenario", 19),
    ("cube", 14),
    ("bench", 7),
    ("studio", 7),
    ("gait", 6),
    ("reproduce", 6),
];

/// Returns the circles of too many files in a crate, each by the name of the innermost folder that has all its files, which is
/// the crate's own if that is its folder of sources.
fn large_circles(folder: &Path) -> Vec<(String, BTreeSet<PathBuf>)> {
    let source = folder.join("src");
    let mut paths = Vec::new();
    rust_files(&source, &mut paths);
    let texts: Vec<String> =
        paths.iter().map(|path| fs::read_to_string(path).expect("sources are text")).collect();
    let local = paths.iter().map(|path| path.strip_prefix(&source).expect("found below it"));
    let files = Files::new(local.zip(texts.iter().map(String::as_str)));
    let circles = files.circles().into_iter().filter(|circle| circle.len() > CIRCLE_MAX);
    let named = circles.map(|circle| {
        let first = circle.first().expect("a circle has files");
        let has_all = |place: &&Path| circle.iter().all(|file| file.starts_with(place));
        let place = first.ancestors().skip(1).find(has_all).unwrap_or(Path::new(""));
        let name = place.file_name().or(folder.file_name()).expect("a crate has a folder");
        (name.to_string_lossy().into_owned(), circle.into_iter().map(Path::to_owned).collect())
    });
    named.collect()
}

#[test]
fn no_circle_of_files_is_large() {
    let mut left = CIRCLES.to_vec();
    let mut new = Vec::new();
    for package in metadata().packages {
        let folder = package.manifest_path.parent().expect("a manifest is in a folder");
        for (name, circle) in large_circles(folder.as_std_path()) {
            match left.iter().rposition(|(listed, size)| *listed == name && circle.len() <= *size) {
                Some(found) => drop(left.remove(found)),
                None => new.push((name, circle.len(), circle)),
            }
        }
    }
    assert!(
        new.is_empty(),
        "these files import each other in a circle: {new:#?}; not found of CIRCLES: {left:?}"
    );
    assert!(left.is_empty(), "these circles are gone: take them from CIRCLES: {left:?}");
}

/// A transport is chosen where a run is started; the loops at both of its ends are generic over it.
#[test]
fn the_wait_loop_and_the_controller_loop_name_no_transport() {
    let start = root().join("module-agent/src/process/start.rs");
    let mut files = Vec::new();
    for folder in ["module-agent/src/process", "world-controller/processes/src/swarm/controller_loop"] {
        rust_files(&root().join(folder), &mut files);
    }
    assert!(files.len() > 10 && files.contains(&start), "the sources were not found");
    for file in files.into_iter().filter(|file| *file != start) {
        let text = fs::read_to_string(&file).expect("sources are text");
        for absent in ["iceoryx", "transport::memory", "/dev/shm"] {
            assert!(!code(&text).contains(absent), "{} names {absent}", file.display());
        }
    }
}

/// The folders of families, and the places outside of them that may name a family: benchmarks and published
/// experiments are about one family each, and the command line has a command of one.
const OF_FAMILIES: &[&str] = &[
    "protocol/src/lib.rs",
    "protocol/cube",
    "protocol/agents/src/metamodule",
    "protocol/agents/src/free_module",
    "protocol/central-planning",
    "sim-bridge/physics",
    "sim-bridge/src/cube",
    "sim-bridge/src/metamodule",
    "sim-bridge/src/free_module",
    "module-agent/src/registry.rs",
    "world-controller/families/src",
    "world-controller/processes/src/family.rs",
    "world-controller/bench",
    "world-controller/reproduce",
    "world-controller/cli",
    // Plans and gaits of free modules, and what commands say of them.
    "world-controller/free-modules",
    // Rooms are built by metamodules.
    "world-controller/people/src/room",
];

#[test]
fn families_are_named_in_their_folders_only() {
    let folders = fs::read_dir(root().join("world-controller/families/src")).expect("families have folders");
    let folders =
        folders.map(|entry| entry.expect("a folder can be read").path()).filter(|path| path.is_dir());
    let families: Vec<String> =
        folders.filter_map(|path| Some(format!("{}::", path.file_name()?.to_str()?))).collect();
    assert!(families.len() > 1, "{families:?}");
    for name in ["protocol", "sim-bridge", "module-agent", "world-controller"] {
        let mut files = Vec::new();
        rust_files(&root().join(name), &mut files);
        // Sources of the crate and of those in folders inside it, without tests that have folders of their own.
        files.retain(|file| file.iter().any(|part| part == "src"));
        let allowed = |file: &Path| OF_FAMILIES.iter().any(|place| file.starts_with(root().join(place)));
        for file in files.iter().filter(|file| !allowed(file)) {
            let text = fs::read_to_string(file).expect("sources are text");
            let code = code(&text);
            let named: Vec<&str> =
                code.lines().filter(|line| families.iter().any(|family| line.contains(family))).collect();
            assert!(named.is_empty(), "{} names a family: {named:?}", file.display());
        }
    }
}

/// Journals have a format of their own and do not use the command line.
#[test]
fn journals_do_not_use_the_command_line() {
    let mut files = Vec::new();
    rust_files(&root().join("world-controller/processes/src/record/journal"), &mut files);
    assert!(files.len() > 2, "the sources were not found");
    for file in files {
        let text = fs::read_to_string(&file).expect("sources are text");
        for absent in ["clap", "metamorph_cli"] {
            assert!(!text.contains(absent), "{} uses {absent}", file.display());
        }
    }
}

/// The test command for contributors is the one of CI, which turns on features besides.
#[test]
fn the_readme_names_the_test_command_of_ci() {
    let ci = fs::read_to_string(root().join(".ci/run")).expect(".ci/run is there");
    let readme = fs::read_to_string(root().join("README.md")).expect("README.md is there");
    let command = ci
        .lines()
        .map(str::trim)
        .find_map(|line| line.starts_with("cargo test").then(|| line.split(" --features").next()).flatten())
        .expect(".ci/run runs the tests");
    assert!(readme.contains(command), "README.md does not name `{command}`");
}
