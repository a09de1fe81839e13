//! Structures as URDF and SDF: read by an independent reader of URDF, and compared with the places of the report.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{Ran, run};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use tempfile::TempDir;
use urdf_rs::{Geometry, JointType, Robot};

/// A directory with the journal of a simulated run.
fn recorded(scenario: &str, options: &[&str]) -> (TempDir, String) {
    let directory = tempfile::tempdir().unwrap();
    let journal = directory.path().join("run.journal").display().to_string();
    let line = ["run", scenario, "--link", "sim", "--quiet", "--journal", &journal];
    let ran = run(&[&line, options].concat());
    assert_eq!(ran.code, Some(0), "{ran:?}");
    (directory, journal)
}

fn export(journal: &str, options: &[&str], file: &Path) -> String {
    let ran = run(&[&["export", journal], options, &[file.to_str().unwrap()]].concat());
    assert_eq!((ran.code, ran.err.as_str()), (Some(0), ""), "{ran:?}");
    assert!(ran.out.starts_with(&file.display().to_string()), "{ran:?}");
    fs::read_to_string(file).unwrap()
}

/// Reads URDF, and returns it with the position of each link, from the joints alone. Every link but the base has one
/// parent.
fn read(text: &str) -> (Robot, BTreeMap<String, [f64; 3]>) {
    let robot = urdf_rs::read_from_string(text).unwrap();
    let mut at = BTreeMap::from([("base".to_owned(), [0.0; 3])]);
    let mut parents = BTreeMap::new();
    for joint in &robot.joints {
        assert!(
            parents.insert(joint.child.link.clone(), joint).is_none(),
            "{} has two parents",
            joint.child.link
        );
    }
    let names: BTreeSet<&str> = robot.links.iter().map(|link| link.name.as_str()).collect();
    assert_eq!((names.len(), parents.len() + 1), (robot.links.len(), robot.links.len()));
    while at.len() < robot.links.len() {
        let before = at.len();
        for (child, joint) in &parents {
            // Cubes are not turned, so positions add up.
            if let Some([x, y, z]) = at.get(&joint.parent.link).copied() {
                let [dx, dy, dz] = joint.origin.xyz.0;
                at.insert(child.clone(), [x + dx, y + dy, z + dz]);
            }
        }
        assert!(at.len() > before, "the links are not a tree");
    }
    (robot, at)
}

#[test]
fn cubes_are_boxes_in_their_cells() {
    let (directory, journal) = recorded("swarm", &[]);
    let text = export(&journal, &["--at", "0s", "--urdf"], &directory.path().join("start.urdf"));
    let (robot, at) = read(&text);
    assert_eq!(robot.links.len(), 43);
    let cells: BTreeSet<[i64; 3]> = at
        .iter()
        .filter(|(name, _)| *name != "base")
        .map(|(_, at)| at.map(|length| (length / 0.11 - 0.25).round() as i64))
        .collect();
    let plate = (0..7).flat_map(|x| (0..6).map(move |y| [x, y, 0])).collect();
    assert_eq!(cells, plate, "the start of the scenario is a plate of 7 by 6");
    assert!(robot.joints.iter().all(|joint| joint.joint_type == JointType::Fixed));
    for link in robot.links.iter().filter(|link| link.name != "base") {
        let Geometry::Box { size } = &link.collision[0].geometry else { panic!("{link:?}") };
        assert_eq!(size.0, [0.11; 3]);
        let (mass, ixx) = (link.inertial.mass.value, link.inertial.inertia.ixx);
        assert!(mass == 0.5 && (ixx - 0.5 * 0.11 * 0.11 / 6.0).abs() < 1e-9, "{link:?}");
    }
    // A plate of 7 by 6 has 71 contacts, of which 41 are the tree.
    assert!(text.contains("<!-- 30 further connections would close loops"), "{}", &text[..400]);
    // In the middle of the run, with movers and a dead module.
    let half = export(&journal, &["--at", "50%", "--urdf"], &directory.path().join("half.urdf"));
    assert_eq!(read(&half).0.links.len(), 43);
    let end = export(&journal, &["--urdf"], &directory.path().join("end.urdf"));
    assert_eq!(end.matches("<visual>").count(), 42);
    assert_eq!(end.matches("</geometry><material name=\"dead\"/>").count(), 1);
}

#[test]
fn metamodules_have_three_joints_in_each_module() {
    let (directory, journal) = recorded("box", &[]);
    let text = export(&journal, &["--urdf"], &directory.path().join("box.urdf"));
    let robot = urdf_rs::read_from_string(&text).unwrap();
    let of_kind = |kind: JointType| robot.joints.iter().filter(|joint| joint.joint_type == kind).count();
    // Four metamodules of eight half cubes: six joints each, one connection inside, and one to the floor.
    assert_eq!((robot.links.len(), of_kind(JointType::Continuous), of_kind(JointType::Fixed)), (33, 24, 8));
    for joint in robot.joints.iter().filter(|joint| joint.joint_type == JointType::Continuous) {
        let [x, y, z] = joint.axis.xyz.0;
        assert!((x * x + y * y + z * z - 1.0).abs() < 1e-6, "{joint:?}");
    }
    let sdf = export(&journal, &["--sdf"], &directory.path().join("box.sdf"));
    let document = roxmltree::Document::parse(&sdf).unwrap();
    let count = |tag: &str| document.descendants().filter(|node| node.has_tag_name(tag)).count();
    assert_eq!((count("link"), count("joint"), count("axis")), (32, 32, 24));
}

#[test]
fn cubes_are_one_link_or_many_in_sdf() {
    let (directory, journal) = recorded("swarm", &[]);
    let links = |options: &[&str], name: &str| {
        let text = export(&journal, options, &directory.path().join(name));
        let document = roxmltree::Document::parse(&text).unwrap();
        let count = |tag: &str| document.descendants().filter(|node| node.has_tag_name(tag)).count();
        (count("link"), count("joint"), count("collision"))
    };
    assert_eq!(links(&["--at", "0s", "--sdf"], "a.sdf"), (1, 0, 42));
    assert_eq!(links(&["--at", "0s", "--bodies", "modules", "--sdf"], "b.sdf"), (42, 71, 42));
}

#[test]
fn what_cannot_be_exported_is_refused() {
    let (directory, journal) = recorded("box", &[]);
    let file = directory.path().join("out").display().to_string();
    let cases: [(&[&str], &str); 5] = [
        (&["--sdf", &file, "--bodies", "merged"], "metamodules have joints"),
        (&["--urdf", &file, "--at", "9999s"], "the run ended at"),
        (&["--urdf", &file, "--cell", "0"], "say a number above 0"),
        (&["--urdf", &file, "--mcap", &file], "cannot be used with"),
        (&["--mcap", &file, "--at", "1s"], "cannot be used with"),
    ];
    for (options, about) in cases {
        let ran: Ran = run(&[&["export", &journal], options].concat());
        assert!(ran.code == Some(2) && ran.err.contains(about), "{options:?}: {ran:?}");
    }
    assert!(!Path::new(&file).exists());
}
