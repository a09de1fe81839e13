//! The layout of the sources is the one that ARCHITECTURE.md describes: dependencies between crates,
//! dependencies between the modules of a crate, and a subject for every file.

use cargo_metadata::{DependencyKind, MetadataCommand};
use metamorph_tests::command::root;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

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
        ("metamorph-sim-bridge", vec!["metamorph-protocol"]),
        ("metamorph-module-agent", vec!["metamorph-protocol"]),
        (
            "metamorph-world-controller",
            vec!["metamorph-protocol", "metamorph-sim-bridge", "metamorph-module-agent"],
        ),
        (
            "metamorph-tutorial",
            vec![
                "metamorph-protocol",
                "metamorph-sim-bridge",
                "metamorph-module-agent",
                "metamorph-world-controller",
            ],
        ),
        (
            "metamorph-python",
            vec!["metamorph-protocol", "metamorph-sim-bridge", "metamorph-world-controller"],
        ),
        ("metamorph-site", vec!["metamorph-world-controller"]),
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
const ABSENT: [(&str, &[&str]); 11] = [
    // Agents compute without floating point.
    ("metamorph-core", &["nalgebra", "petgraph", "pathfinding", "rand"]),
    ("metamorph-cube", &["nalgebra", "petgraph", "pathfinding", "rand"]),
    ("metamorph-host-link", &OF_PROGRAMS),
    ("metamorph-pairing", &OF_PROGRAMS),
    ("metamorph-roombots", &OF_PROGRAMS),
    ("metamorph-planning", &OF_PROGRAMS),
    ("metamorph-agents", &OF_PROGRAMS),
    ("metamorph-central-planning", &OF_PROGRAMS),
    ("metamorph-sim-bridge", &["tokio", "iceoryx2", "rustix", "rand", "clap", "toml"]),
    ("metamorph-module-agent", &["tokio", "rapier3d", "clap", "toml"]),
    ("metamorph-world-controller", &["rand"]),
];

#[test]
fn arrows_point_one_way() {
    let metadata = MetadataCommand::new()
        .manifest_path(root().join("Cargo.toml"))
        .no_deps()
        .exec()
        .expect("cargo metadata works offline");
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
    for (name, absent) in ABSENT {
        let package = metadata.packages.iter().find(|p| p.name.as_str() == name).expect("checked above");
        for dependency in package.dependencies.iter().filter(|d| d.kind == DependencyKind::Normal) {
            assert!(!absent.contains(&dependency.name.as_str()), "{name} must not use {}", dependency.name);
        }
    }
}

/// Agents of cubes and all that they use run without an operating system: no crate that they use brings std by default.
#[test]
fn the_core_and_cubes_need_no_std() {
    let metadata = MetadataCommand::new()
        .manifest_path(root().join("Cargo.toml"))
        .no_deps()
        .exec()
        .expect("cargo metadata works offline");
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

/// The top-level modules of each crate, from the bottom up: a module may use those before it only.
const LAYERS: [(&str, &[&str]); 6] = [
    (
        "protocol/core",
        &[
            "ids", "time", "ratio", "rng", "digest", "coverage", "defects", "lattice", "shape", "goal",
            "counters", "wire", "link", "agent", "runtime", "record", "host",
        ],
    ),
    ("protocol/planning", &["plan", "assembly", "manipulation", "reconfiguration"]),
    ("protocol/agents", &["on_grid", "free_module", "metamodule"]),
    ("sim-bridge", &["world", "director", "kernel", "cube", "metamodule", "free_module", "testing"]),
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
    (
        "world-controller",
        &[
            "console",
            "scenario",
            "control",
            "swarm",
            "report",
            "record",
            "view",
            "run",
            "plan",
            "gait",
            "family",
            "room",
            "structure",
            "experiments",
            "learn",
            "pointing",
            "studio",
            "cli",
        ],
    ),
];

/// Returns the modules that a source names by `crate::`, without its tests and comments.
fn used_modules(text: &str) -> BTreeSet<String> {
    let code = text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
    let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    let paths = lines.flat_map(|line| line.split("crate::").skip(1));
    let name = |path: &str| path.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    paths.map(name).collect()
}

#[test]
fn modules_use_only_those_below_them() {
    for (name, layers) in LAYERS {
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

/// A transport is chosen where a run is started; the loops at both of its ends are generic over it.
#[test]
fn the_wait_loop_and_the_controller_loop_name_no_transport() {
    let start = root().join("module-agent/src/process/start.rs");
    let mut files = Vec::new();
    for folder in ["module-agent/src/process", "world-controller/src/swarm/controller_loop"] {
        rust_files(&root().join(folder), &mut files);
    }
    assert!(files.len() > 10 && files.contains(&start), "the sources were not found");
    for file in files.into_iter().filter(|file| *file != start) {
        let text = fs::read_to_string(&file).expect("sources are text");
        let code = text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
        for absent in ["iceoryx", "transport::memory", "/dev/shm"] {
            let names = |line: &str| !line.trim_start().starts_with("//") && line.contains(absent);
            assert!(!code.lines().any(names), "{} names {absent}", file.display());
        }
    }
}

/// The folders of families, and the places outside of them that may name a family: benchmarks and published
/// experiments are about one family each, and the command line has a command of one.
const OF_FAMILIES: [&str; 18] = [
    "protocol/src/lib.rs",
    "protocol/cube",
    "protocol/agents/src/metamodule",
    "protocol/agents/src/free_module",
    "protocol/central-planning",
    "sim-bridge/src/cube",
    "sim-bridge/src/metamodule",
    "sim-bridge/src/free_module",
    "module-agent/src/registry.rs",
    "world-controller/src/family",
    "world-controller/src/experiments/bench",
    "world-controller/src/experiments/reproduce",
    "world-controller/src/cli",
    // Commands about structures of free modules.
    "world-controller/src/plan",
    "world-controller/src/gait",
    "world-controller/src/structure",
    "world-controller/src/learn",
    // Rooms are built by metamodules.
    "world-controller/src/room",
];

#[test]
fn families_are_named_in_their_folders_only() {
    let folders = fs::read_dir(root().join("world-controller/src/family")).expect("families have folders");
    let folders =
        folders.map(|entry| entry.expect("a folder can be read").path()).filter(|path| path.is_dir());
    let families: Vec<String> =
        folders.filter_map(|path| Some(format!("{}::", path.file_name()?.to_str()?))).collect();
    assert!(families.len() > 1, "{families:?}");
    for name in ["protocol", "sim-bridge", "module-agent", "world-controller"] {
        let mut files = Vec::new();
        rust_files(&root().join(name), &mut files);
        files.retain(|file| file.components().any(|part| part.as_os_str() == "src"));
        let allowed = |file: &Path| OF_FAMILIES.iter().any(|place| file.starts_with(root().join(place)));
        for file in files.iter().filter(|file| !allowed(file)) {
            let text = fs::read_to_string(file).expect("sources are text");
            let code = text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
            let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
            let named: Vec<&str> =
                lines.filter(|line| families.iter().any(|family| line.contains(family))).collect();
            assert!(named.is_empty(), "{} names a family: {named:?}", file.display());
        }
    }
}

/// Journals have a format of their own and do not use the command line.
#[test]
fn journals_do_not_use_the_command_line() {
    let mut files = Vec::new();
    rust_files(&root().join("world-controller/src/record/journal"), &mut files);
    assert!(files.len() > 2, "the sources were not found");
    for file in files {
        let text = fs::read_to_string(&file).expect("sources are text");
        for absent in ["clap", "crate::cli"] {
            assert!(!text.contains(absent), "{} uses {absent}", file.display());
        }
    }
}

/// The test command for contributors is the one of CI.
#[test]
fn the_readme_names_the_test_command_of_ci() {
    let ci = fs::read_to_string(root().join(".ci/run")).expect(".ci/run is there");
    let readme = fs::read_to_string(root().join("README.md")).expect("README.md is there");
    let command = ci
        .lines()
        .map(str::trim)
        .find(|line| line.starts_with("cargo test"))
        .expect(".ci/run runs the tests");
    assert!(readme.contains(command), "README.md does not name `{command}`");
}
