//! Structures as URDF and SDF: read as the format says, without code of the program, and compared with the places of the report.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{Ran, run};
use roxmltree::{Document, Node};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

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

/// A link of URDF: its mass, its moment of inertia about x, and the sides of the boxes that it collides with.
struct Link {
    mass: f64,
    ixx: f64,
    boxes: Vec<[f64; 3]>,
}

/// A joint of URDF.
struct Joint {
    kind: String,
    parent: String,
    child: String,
    origin: [f64; 3],
    axis: [f64; 3],
}

/// A document of URDF.
struct Robot {
    links: BTreeMap<String, Link>,
    joints: Vec<Joint>,
}

/// Returns the only child element of this name.
fn only<'a, 'i>(node: Node<'a, 'i>, tag: &str) -> Node<'a, 'i> {
    let all: Vec<Node<'a, 'i>> = node.children().filter(|child| child.has_tag_name(tag)).collect();
    assert_eq!(all.len(), 1, "<{tag}> in {node:?}");
    all[0]
}

fn attribute<'a>(node: Node<'a, '_>, name: &str) -> &'a str {
    node.attribute(name).unwrap_or_else(|| panic!("{node:?} has no {name}"))
}

fn number(node: Node<'_, '_>, name: &str) -> f64 {
    attribute(node, name).parse().unwrap()
}

fn triple(text: &str) -> [f64; 3] {
    let numbers: Vec<f64> = text.split_ascii_whitespace().map(|number| number.parse().unwrap()).collect();
    numbers.try_into().unwrap_or_else(|_| panic!("{text:?} is not three numbers"))
}

/// Reads URDF. What the format does not know is refused.
fn robot(text: &str) -> Robot {
    let document = Document::parse(text).unwrap();
    let root = document.root_element();
    assert!(root.has_tag_name("robot") && !attribute(root, "name").is_empty());
    let (mut links, mut joints, mut named) = (BTreeMap::new(), Vec::new(), BTreeSet::new());
    for node in root.children().filter(Node::is_element) {
        let name = attribute(node, "name");
        assert!(named.insert((node.tag_name().name(), name)), "two are named {name}");
        let parts: BTreeSet<&str> =
            node.children().filter(Node::is_element).map(|part| part.tag_name().name()).collect();
        let known: &[&str] = match node.tag_name().name() {
            "link" => &["inertial", "visual", "collision"],
            "joint" => &["origin", "parent", "child", "axis", "limit", "dynamics"],
            "material" => &["color"],
            other => panic!("<{other}> in a robot"),
        };
        assert!(parts.iter().all(|part| known.contains(part)), "{name}: {parts:?}");
        if node.has_tag_name("link") {
            let collisions = node.children().filter(|part| part.has_tag_name("collision"));
            let shapes = collisions.map(|part| only(part, "geometry").first_element_child().unwrap());
            let boxes = shapes.filter_map(|shape| match shape.tag_name().name() {
                "box" => Some(triple(attribute(shape, "size"))),
                "sphere" => {
                    assert!(number(shape, "radius") > 0.0);
                    None
                }
                other => panic!("<{other}> as a shape"),
            });
            let boxes = boxes.collect();
            // The base has no mass of its own.
            let inertial = node.children().find(|part| part.has_tag_name("inertial"));
            let [mass, ixx] = inertial.map_or([0.0; 2], |part| {
                let inertia = only(part, "inertia");
                for name in ["ixy", "ixz", "iyy", "iyz", "izz"] {
                    assert!(number(inertia, name).is_finite());
                }
                [number(only(part, "mass"), "value"), number(inertia, "ixx")]
            });
            links.insert(name.to_owned(), Link { mass, ixx, boxes });
        }
        if node.has_tag_name("joint") {
            let place = |tag: &str, name: &str, default: &str| {
                let part = node.children().find(|part| part.has_tag_name(tag));
                triple(part.and_then(|part| part.attribute(name)).unwrap_or(default))
            };
            joints.push(Joint {
                kind: attribute(node, "type").to_owned(),
                parent: attribute(only(node, "parent"), "link").to_owned(),
                child: attribute(only(node, "child"), "link").to_owned(),
                origin: place("origin", "xyz", "0 0 0"),
                axis: place("axis", "xyz", "1 0 0"),
            });
        }
    }
    for node in document.descendants().filter(|node| node.has_tag_name("material")) {
        let name = attribute(node, "name");
        let is_known = node.first_element_child().is_some() || named.contains(&("material", name));
        assert!(is_known, "there is no material {name}");
    }
    for joint in &joints {
        let ends = [&joint.parent, &joint.child];
        assert!(ends.iter().all(|end| links.contains_key(*end)), "{} to {}", joint.parent, joint.child);
    }
    Robot { links, joints }
}

/// Reads URDF, and returns it with the position of each link, from the joints alone. Every link but the base has one
/// parent.
fn read(text: &str) -> (Robot, BTreeMap<String, [f64; 3]>) {
    let robot = robot(text);
    let mut at = BTreeMap::from([("base".to_owned(), [0.0; 3])]);
    let mut parents = BTreeMap::new();
    for joint in &robot.joints {
        assert!(parents.insert(joint.child.clone(), joint).is_none(), "{} has two parents", joint.child);
    }
    assert_eq!(parents.len() + 1, robot.links.len());
    while at.len() < robot.links.len() {
        let before = at.len();
        for (child, joint) in &parents {
            // Cubes are not turned, so positions add up.
            if let Some([x, y, z]) = at.get(&joint.parent).copied() {
                let [dx, dy, dz] = joint.origin;
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
    assert!(robot.joints.iter().all(|joint| joint.kind == "fixed"));
    for (name, link) in robot.links.iter().filter(|(name, _)| *name != "base") {
        assert_eq!(link.boxes[0], [0.11; 3], "{name}");
        assert!(link.mass == 0.5 && (link.ixx - 0.5 * 0.11 * 0.11 / 6.0).abs() < 1e-9, "{name}");
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
    let robot = robot(&text);
    let of_kind = |kind: &str| robot.joints.iter().filter(|joint| joint.kind == kind).count();
    // Four metamodules of eight half cubes: six joints each, one connection inside, and one to the floor.
    assert_eq!((robot.links.len(), of_kind("continuous"), of_kind("fixed")), (33, 24, 8));
    for joint in robot.joints.iter().filter(|joint| joint.kind == "continuous") {
        let [x, y, z] = joint.axis;
        assert!((x * x + y * y + z * z - 1.0).abs() < 1e-6, "{}: {:?}", joint.child, joint.axis);
    }
    let sdf = export(&journal, &["--sdf"], &directory.path().join("box.sdf"));
    let document = Document::parse(&sdf).unwrap();
    let count = |tag: &str| document.descendants().filter(|node| node.has_tag_name(tag)).count();
    assert_eq!((count("link"), count("joint"), count("axis")), (32, 32, 24));
}

#[test]
fn cubes_are_one_link_or_many_in_sdf() {
    let (directory, journal) = recorded("swarm", &[]);
    let links = |options: &[&str], name: &str| {
        let text = export(&journal, options, &directory.path().join(name));
        let document = Document::parse(&text).unwrap();
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
