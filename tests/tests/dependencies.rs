//! What crates need in the end, through all their dependencies: nothing that is kept out of them.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]
#![allow(clippy::print_stdout, reason = "says how many there are")]

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand, NodeDep};
use metamorph_tests::command::root;
use std::collections::BTreeSet;
use std::fs;
use std::process::Command;

/// Returns the resolved dependencies of the default build on this platform.
fn metadata() -> Metadata {
    MetadataCommand::new()
        .manifest_path(root().join("Cargo.toml"))
        // Crates of other platforms and features need not have been downloaded.
        .other_options(vec![
            "--offline".to_owned(),
            "--filter-platform".to_owned(),
            format!("{}-unknown-linux-gnu", std::env::consts::ARCH),
        ])
        .exec()
        .expect("cargo metadata works offline")
}

/// What a free module's agent needs: nothing of physics.
#[test]
fn agents_need_no_physics_engine() {
    let metadata = metadata();
    let nodes = &metadata.resolve.as_ref().unwrap().nodes;
    let agent = metadata.packages.iter().find(|p| p.name.as_str() == "metamorph-module-agent").unwrap();
    let (mut reached, mut next) = (BTreeSet::from([agent.id.clone()]), vec![agent.id.clone()]);
    while let Some(id) = next.pop() {
        let node = nodes.iter().find(|node| node.id == id).unwrap();
        let normal = |d: &&NodeDep| d.dep_kinds.iter().any(|k| k.kind == DependencyKind::Normal);
        for dependency in node.deps.iter().filter(normal) {
            if reached.insert(dependency.pkg.clone()) {
                next.push(dependency.pkg.clone());
            }
        }
    }
    let names: BTreeSet<&str> =
        metadata.packages.iter().filter(|p| reached.contains(&p.id)).map(|p| p.name.as_str()).collect();
    assert!(names.contains("metamorph-protocol") && names.len() > 10, "{names:?}");
    for absent in ["rapier3d", "parry3d", "glamx", "metamorph-sim-bridge"] {
        assert!(!names.contains(absent), "the agent needs {absent}: {names:?}");
    }
    println!("{} crates", names.len());
}

/// Links between machines bring many crates; the default build has none of them.
#[test]
fn the_default_build_has_no_links_between_machines() {
    let metadata = metadata();
    let nodes = metadata.resolve.expect("dependencies are resolved").nodes;
    let names: BTreeSet<String> = nodes
        .iter()
        .filter_map(|node| metadata.packages.iter().find(|package| package.id == node.id))
        .map(|package| package.name.to_string())
        .collect();
    assert!(names.contains("iceoryx2"), "the dependencies were not found");
    let controller = metadata.packages.iter().find(|p| p.name.as_str() == "metamorph-processes");
    let of_feature: Vec<&str> = controller.expect("it is a member").features["hosts"]
        .iter()
        .filter_map(|feature| feature.strip_prefix("dep:"))
        .collect();
    assert!(of_feature.contains(&"zenoh"), "{of_feature:?}");
    for name in of_feature.into_iter().chain(["zenoh-transport", "tokio-rustls", "lz4_flex"]) {
        assert!(!names.contains(name), "the default build has {name}");
    }
}

/// Without the feature `physics` neither the simulation nor the command brings the engine.
#[test]
fn a_build_without_physics_has_no_engine() {
    let has_engine = |package: &str, options: &[&str]| {
        let mut tree = Command::new(env!("CARGO"));
        tree.current_dir(root()).args(["tree", "--offline", "--edges", "normal", "--package", package]);
        let tree = tree.args(options).output().unwrap();
        assert!(tree.status.success(), "{}", String::from_utf8_lossy(&tree.stderr));
        String::from_utf8_lossy(&tree.stdout).contains("rapier3d")
    };
    for package in ["metamorph-sim-bridge", "metamorph-world-controller"] {
        assert!(has_engine(package, &[]), "{package}");
        assert!(!has_engine(package, &["--no-default-features"]), "{package}");
    }
}

/// A crate whose examples are not run has none: `doctest = false` saves a run of rustdoc.
#[test]
fn examples_in_documentation_are_tested() {
    let metadata = metadata();
    let members = metadata.workspace_packages();
    let libraries = members.iter().flat_map(|package| package.targets.iter().map(move |of| (package, of)));
    let mut untested = 0;
    for (package, library) in libraries.filter(|(_, target)| target.is_lib() && !target.doctest) {
        untested += 1;
        let mut directories = vec![library.src_path.parent().unwrap().as_std_path().to_owned()];
        while let Some(directory) = directories.pop() {
            for entry in fs::read_dir(directory).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    directories.push(path);
                } else if path.extension().is_some_and(|end| end == "rs") {
                    let text = fs::read_to_string(&path).unwrap();
                    let docs = text.lines().filter_map(|line| line.trim_start().strip_prefix("//"));
                    let docs = docs.filter_map(|line| line.strip_prefix(['/', '!']));
                    let fences = docs.filter_map(|line| line.trim_start().strip_prefix("```"));
                    // Every second fence ends a block.
                    let blocks: Vec<&str> = fences.step_by(2).collect();
                    let is_text = |block: &&str| *block == "text";
                    let place = path.display();
                    assert!(blocks.iter().all(is_text), "{place}: {} has `doctest = false`", package.name);
                }
            }
        }
    }
    assert!(untested > 3, "{untested}");
}
