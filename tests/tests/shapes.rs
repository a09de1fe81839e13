//! Shapes from files: solids built end to end, and broken files, which must be refused with place, reason and
//! fix, in bounded time and memory.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_protocol::lattice::Cell;
use metamorph_tests::command::{Ran, command, root, run};
use metamorph_world_controller::family::sources;
use metamorph_world_controller::report::schema::Report;
use metamorph_world_controller::scenario::mesh_import::{Import, Part, import};
use proptest::prelude::*;
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};

fn shapes(name: &str) -> PathBuf {
    root().join("deploy/shapes").join(name)
}

/// Runs `metamorph shape` on a file with this content.
fn shape(name: &str, content: impl AsRef<[u8]>, args: &[&str]) -> Ran {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join(name);
    fs::write(&path, content).unwrap();
    run(&[&["shape", path.to_str().unwrap()], args].concat())
}

fn refused(ran: &Ran, parts: &[&str]) {
    assert_eq!(ran.code, Some(2), "{ran:?}");
    for part in parts.iter().chain(&["fix: "]) {
        assert!(ran.err.contains(part) || ran.out.contains(part), "`{part}` is missing in: {ran:?}");
    }
    assert!(!ran.err.contains("panicked"), "{}", ran.err);
}

fn built(args: &[&str]) -> Report {
    let ran = run(&[args, &["--quiet", "--json", "-"]].concat());
    assert_eq!(ran.code, Some(0), "{ran:?}");
    serde_json::from_str(&ran.out).unwrap()
}

/// A real solid of hundreds of cells, from an STL file to the last cell, with every invariant on.
#[test]
fn a_rabbit_is_built_from_its_mesh() {
    let report = built(&["run", "deploy/scenarios/rabbit.toml", "--link", "sim"]);
    assert_eq!((report.goal.cells, report.goal.filled), (319, 319));
    assert_eq!((report.invariants.broken, report.collisions.suffered), (0, 0));
    assert!(report.invariants.checked > 1_000);
}

#[test]
fn processes_build_a_solid_from_a_file_with_a_hole_cut_into_it() {
    let report = built(&["run", "deploy/scenarios/arch.toml"]);
    assert_eq!((report.goal.cells, report.goal.filled, report.agents.alive), (13, 13, 24));
    assert_eq!(report.invariants.broken, 0);
}

/// From a file to a scenario that does not need the file any more, and to its structure.
#[test]
fn shape_writes_a_scenario_that_runs() {
    let directory = tempfile::tempdir().unwrap();
    for (file, args, cells) in [
        ("arch.stl", &["--pitch", "10"][..], 14),
        ("case.xml", &[], 16),
        ("table.obj", &["--cells", "7", "--at", "3,-2,1"], 65),
    ] {
        let [written, drawn] = ["toml", "svg"].map(|end| directory.path().join(format!("{file}.{end}")));
        let (written, drawn) = (written.to_str().unwrap(), drawn.to_str().unwrap());
        let path = shapes(file);
        let ran =
            run(&[&["shape", path.to_str().unwrap(), "--write", written, "--svg", drawn], args].concat());
        assert_eq!(ran.code, Some(0), "{ran:?}");
        assert!(ran.out.contains(&format!("cells     {cells},")) && ran.out.contains("\n  #"), "{}", ran.out);
        assert!(fs::read_to_string(drawn).unwrap().starts_with("<svg"));
        let report = built(&["run", written, "--link", "sim"]);
        assert_eq!((report.goal.cells, report.goal.filled, report.invariants.broken), (cells, cells, 0));
        let again = run(&[&["shape", path.to_str().unwrap(), "--write", written], args].concat());
        assert_eq!(again.code, Some(2), "a file was written over: {again:?}");
    }
}

#[test]
fn an_obj_whose_y_points_up_is_set_upright() {
    let how = |up| Import { pitch: Some(1.0), up, ..Import::default() };
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("tower.obj");
    // 1 wide, 3 along y, 2 along z; with a polygon, an index from the end, and a material that does not
    // exist.
    let text = "mtllib none.mtl\nusemtl none\nv 0 0 0\nv 1 0 0\nv 1 3 0\nv 0 3 0\nv 0 0 2\nv 1 0 2\nv 1 3 2\nv 0 3 2\n\
                f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf -5 -8 -4 -1\n";
    fs::write(&path, text).unwrap();
    let upright =
        import(sources(), &path, &how(Some(metamorph_world_controller::scenario::mesh_import::Up::Y)))
            .unwrap();
    assert_eq!(upright.cells.iter().map(|c| c.z).max(), Some(2));
    let lying = import(sources(), &path, &how(None)).unwrap();
    assert_eq!((lying.cells.len(), lying.cells.iter().map(|c| c.z).max()), (6, Some(1)));
}

#[test]
fn broken_meshes_are_refused_with_place_reason_and_fix() {
    let rabbit = fs::read(shapes("rabbit.stl")).unwrap();
    let arch = fs::read_to_string(shapes("arch.stl")).unwrap();
    let table = fs::read_to_string(shapes("table.obj")).unwrap();
    let ten = &["--pitch", "10"];
    // Binary STL that ends too early, or promises too much.
    refused(
        &shape("a.stl", &rabbit[..40_000], ten),
        &["a.stl: the file ends in triangle 799 of 1664 (byte 40000)"],
    );
    refused(&shape("a.stl", &rabbit[..70], ten), &["has 70 bytes"]);
    refused(&shape("a.stl", &rabbit[..90], ten), &["ends in triangle 1 of 1664"]);
    refused(&shape("a.stl", b"", ten), &["has 0 bytes"]);
    let mut promises = rabbit.clone();
    promises[80..84].fill(255);
    refused(&shape("a.stl", &promises, ten), &["of 4294967295"]);
    let mut infinite = rabbit.clone();
    infinite[84 + 50 * 6 + 12..][..4].copy_from_slice(&f32::INFINITY.to_le_bytes());
    refused(&shape("a.stl", &infinite, ten), &["a corner of triangle 7 is not a finite number"]);
    // Text STL: facets have seven lines here, the first begins on line 2.
    let end = arch.match_indices("vertex").nth(10).unwrap().0;
    refused(&shape("a.stl", &arch[..end], ten), &["a.stl:26: expected `vertex`, but the file ends"]);
    refused(
        &shape("a.stl", arch.replacen("vertex 10 0 0", "vertex ten 0 0", 1), ten),
        &["a.stl:5: expected a number such as 1.5, found \"ten\""],
    );
    refused(&shape("a.stl", "solid\nendsolid\n", ten), &["no triangle"]);
    // OBJ.
    refused(
        &shape("a.obj", table.replacen("f 4 3 2 1", "f 4 3 2 900", 1), ten),
        &["a.obj:11: there is no corner 900 of a face; the file has "],
    );
    refused(&shape("a.obj", table.replacen("v 0 0 70", "v zero 0 70", 1), ten), &["a.obj:3: ", "position"]);
    refused(&shape("a.obj", "v 0 0 0\n", ten), &["no triangle"]);
    // Other content than the name says.
    let pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:4d5e\nsize 684\n";
    refused(&shape("a.stl", pointer, ten), &["a.stl: this is a pointer of Git LFS"]);
    refused(&shape("a.obj", "<!DOCTYPE html><html></html>", ten), &["a.obj: this is an HTML page"]);
    // No inside: half a side of the arch is missing, and cells are small beside it.
    let facet = |n: usize| arch.match_indices("facet normal").nth(n).unwrap().0;
    let hole = format!("{}{}", &arch[..facet(3)], &arch[facet(4)..]);
    refused(
        &shape("a.stl", &hole, &["--pitch", "2"]),
        &["3 edges belong to one triangle only", " of triangle ", "neither inside nor outside"],
    );
    // Faults that leave the inside clear.
    let twice = format!("{}{}{}", &arch[..facet(4)], &arch[facet(3)..facet(4)], &arch[facet(4)..]);
    let third = &arch[facet(3)..facet(4)];
    let mut lines: Vec<&str> = third.lines().collect();
    lines.swap(2, 3);
    let turned = arch.replace(third, &(lines.join("\n") + "\n"));
    for mesh in [hole, twice, turned] {
        let ran = shape("a.stl", mesh, ten);
        assert!(ran.code == Some(0) && ran.out.contains("cells     14,"), "{ran:?}");
    }
    // Other kinds of files.
    refused(&shape("a.step", "", ten), &[".stl, .obj, .vox, .xml or .toml"]);
    refused(&run(&["shape", "none.stl"]), &["none.stl: cannot read it"]);
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("folder.stl");
    fs::create_dir(&path).unwrap();
    refused(&run(&["shape", path.to_str().unwrap(), "--pitch", "1"]), &["not a regular file"]);
}

#[test]
fn unbuildable_solids_are_refused_with_the_reason() {
    let path = shapes("rabbit.stl");
    let rabbit = |args: &[&str]| run(&[&["shape", path.to_str().unwrap()], args].concat());
    refused(&rabbit(&["--pitch", "0"]), &["the pitch is 0"]);
    refused(&rabbit(&["--pitch", "0.01"]), &["6800 x 13200 x 14400 cells", "larger pitch"]);
    refused(&rabbit(&["--pitch", "1e-30"]), &["larger pitch"]);
    refused(&rabbit(&["--pitch", "1e6"]), &["no cell has its middle inside", "smaller pitch"]);
    // The ears are 18 mm thick, and pointed.
    refused(&rabbit(&["--pitch", "20"]), &["thinner than a cell, which is 20", "--drop-thin"]);
    let dropped = rabbit(&["--pitch", "20", "--drop-thin", "--cells", "3"]);
    assert_eq!(dropped.code, Some(2), "two pitches: {dropped:?}");
    let dropped = rabbit(&["--pitch", "20", "--drop-thin"]);
    assert_eq!(dropped.code, Some(0), "{dropped:?}");
    refused(
        &run(&["shape", path.to_str().unwrap(), "--part", "blocks", "--pitch", "9"]),
        &["`part` does not apply to"],
    );
    // Two arches far apart in one file.
    let arch = fs::read_to_string(shapes("arch.stl")).unwrap();
    let other = arch.replace("vertex ", "vertex 9");
    refused(
        &shape("two.stl", arch.clone() + &other, &["--pitch", "10"]),
        &["2 parts that do not touch", "14 cells with"],
    );
    // A hollow cube: an outer shell and an inner one that faces inwards.
    let cube = |low: i32, high: i32, faces: [&str; 6], first: usize| {
        let mut text = String::new();
        for i in 0..8 {
            let c = |bit: i32| if i >> bit & 1 == 1 { high } else { low };
            text += &format!("v {} {} {}\n", c(0), c(1), c(2));
        }
        for face in faces {
            let corners: Vec<String> =
                face.split(' ').map(|n| (n.parse::<usize>().unwrap() + first).to_string()).collect();
            text += &format!("f {}\n", corners.join(" "));
        }
        text
    };
    let out = ["1 5 7 3", "2 4 8 6", "1 2 6 5", "3 7 8 4", "1 3 4 2", "5 6 8 7"];
    let inwards = ["3 7 5 1", "6 8 4 2", "5 6 2 1", "4 8 7 3", "2 4 3 1", "7 8 6 5"];
    let hollow = cube(0, 5, out, 0) + &cube(2, 3, inwards, 8);
    let ran = shape("hollow.obj", &hollow, &["--pitch", "1"]);
    assert!(ran.code == Some(0) && ran.out.contains("note: it has 1 inner void with 1 cell"), "{ran:?}");
    let ran = shape("hollow.obj", &hollow, &["--pitch", "1", "--fill-voids"]);
    assert!(
        ran.code == Some(0) && ran.out.contains("cells     125,") && !ran.out.contains("void"),
        "{ran:?}"
    );
}

#[test]
fn broken_configurations_are_refused_with_place_reason_and_fix() {
    let case = fs::read_to_string(shapes("case.xml")).unwrap();
    let with = |old: &str, new: &str| {
        assert!(case.contains(old));
        case.replacen(old, new, 1)
    };
    let bomb = "<?xml version=\"1.0\"?>\n<!DOCTYPE bomb [<!ENTITY a \"aaaaaaaaaa\"><!ENTITY b \"&a;&a;&a;&a;&a;&a;&a;&a;\">\
                <!ENTITY c \"&b;&b;&b;&b;&b;&b;&b;&b;\">]>\n<world><blockList>&c;</blockList></world>";
    refused(&shape("a.xml", bomb, &[]), &["a.xml:2: the file declares a document type"]);
    let deep = "<world>".repeat(200_000);
    refused(&shape("a.xml", &deep, &[]), &["a.xml:1: "]);
    refused(&shape("a.xml", &case[..300], &[]), &["a.xml:", "not XML"]);
    refused(&shape("a.xml", "<robots/>", &[]), &["expected <world>, found <robots>"]);
    refused(&shape("a.xml", [b'<', 0xff, 0xfe], &[]), &["a.xml:1: this is not XML"]);
    refused(
        &shape("a.xml", with("4,4,0", "4,four,0"), &[]),
        &["a.xml:12: expected three whole numbers", "4,four,0"],
    );
    refused(&shape("a.xml", with("4,4,0", "4,4.5,0"), &[]), &["a.xml:12: ", "4,4.5,0"]);
    refused(&shape("a.xml", with("4,4,0", "4,40000,0"), &[]), &["[4, 40000, 0] is out of range"]);
    refused(
        &shape("a.xml", with("\"grid\"", "\"csg\""), &[]),
        &["a.xml:11: a target of the format `csg` has no <csg>"],
    );
    let mesh = with("<blocksLine", "<mesh file=\"a.obj\"/><blocksLine");
    refused(&shape("a.xml", &mesh, &["--part", "blocks"]), &["a.xml:5: <mesh> is not supported"]);
    let obstacle = with("</world>", "<obstacleList><obstacle position=\"4,4,0\"/></obstacleList></world>");
    refused(&shape("a.xml", &obstacle, &[]), &["<obstacleList> has an obstacle in the cell [4, 4, 0]"]);
    refused(
        &shape("a.xml", with("targetList", "goals").replace("/targetList", "/goals"), &[]),
        &["has no target"],
    );
    refused(&shape("a.xml", &case, &["--pitch", "3"]), &["`pitch` does not apply to"]);
    let far = with("4,4,0", "-16000,4,0").replace("5,4,0", "5,16000,16000");
    refused(&shape("a.xml", far, &[]), &["the box around its cells has"]);
}

/// Errors of a file are reported at the place in the scenario that names it.
#[test]
fn scenarios_point_at_the_file_that_is_wrong() {
    let directory = tempfile::tempdir().unwrap();
    let check = |shape: &str| {
        let path = directory.path().join("scenario.toml");
        let text = format!(
            "version = 1\n[swarm]\nstart = {{ box = {{ min = [0, 0, 0], max = [9, 9, 9] }} }}\n[[goal]]\ngrowth = \"solid\"\nshape = {shape}\n"
        );
        fs::write(&path, text).unwrap();
        run(&["check", path.to_str().unwrap()])
    };
    fs::copy(shapes("arch.stl"), directory.path().join("arch.stl")).unwrap();
    fs::copy(shapes("case.xml"), directory.path().join("case.xml")).unwrap();
    fs::copy(shapes("rabbit.stl"), directory.path().join("rabbit.stl")).unwrap();
    let here = "scenario.toml:6:";
    refused(&check("{ file = { path = \"none.stl\", pitch = 1 } }"), &[here, "none.stl: cannot read it"]);
    refused(&check("{ file = { path = \"arch.stl\" } }"), &[here, "needs a `pitch`"]);
    refused(&check("{ file = { path = \"arch.stl\", pitch = -1 } }"), &[here, "the pitch is -1"]);
    refused(&check("{ file = { path = \"arch.stl\", pich = 1 } }"), &[here, "did you mean `pitch`?"]);
    refused(
        &check("{ file = { path = \"rabbit.stl\", pitch = 20 } }"),
        &[here, "thinner than a cell", "thin = \"drop\""],
    );
    refused(
        &check("{ file = { path = \"case.xml\", part = \"goals\" } }"),
        &[here, "unknown part", "targets"],
    );
    refused(&check("{ intersection = [] }"), &[here, "at least one"]);
    let many = vec!["{ file = { path = \"arch.stl\", pitch = 10 } }"; 17].join(", ");
    refused(&check(&format!("{{ union = [{many}] }}")), &[here, "more than 16 files"]);
    let mixed = "{ intersection = [{ file = { path = \"arch.stl\", pitch = 10, at = [4, 4, 0] } }, \
                 { difference = [{ box = { min = [0, 0, 0], max = [9, 9, 9] } }, { file = { path = \"case.xml\" } }] }] }";
    let ran = check(mixed);
    // The arch without the cells that it shares with the wall of the configuration.
    assert!(ran.code == Some(0) && ran.out.contains("10 cells"), "{ran:?}");
}

/// Returns a ball of this number of slices and layers, as binary STL.
fn ball(slices: usize, layers: usize) -> Vec<u8> {
    use std::f64::consts::{PI, TAU};
    let at = |i: usize, j: usize| {
        let (up, round) = (PI * j as f64 / layers as f64, TAU * (i % slices) as f64 / slices as f64);
        let wide = if j == 0 || j == layers { 0.0 } else { up.sin() };
        [wide * round.cos(), wide * round.sin(), up.cos()].map(|c| (c * 100.0) as f32)
    };
    let mut bytes = vec![b'.'; 80];
    bytes.extend((slices as u32 * (layers as u32 - 1) * 2).to_le_bytes());
    let mut triangle = |corners: [[f32; 3]; 3]| {
        bytes.extend([0; 12]);
        corners.as_flattened().iter().for_each(|c| bytes.extend(c.to_le_bytes()));
        bytes.extend([0; 2]);
    };
    for i in 0..slices {
        for j in 0..layers {
            if j + 1 < layers {
                triangle([at(i, j), at(i, j + 1), at(i + 1, j + 1)]);
            }
            if j > 0 {
                triangle([at(i, j), at(i + 1, j + 1), at(i + 1, j)]);
            }
        }
    }
    bytes
}

#[test]
fn a_million_triangles_are_laid_into_cells_and_more_than_two_are_refused() {
    let ran = shape("ball.stl", ball(1_000, 501), &["--cells", "10"]);
    assert!(ran.code == Some(0) && ran.out.contains("1,000,000 triangles"), "{ran:?}");
    let mut many = vec![b'.'; 80];
    many.extend(2_000_001u32.to_le_bytes());
    many.resize(84 + 50 * 2_000_001, 0);
    refused(&shape("many.stl", many, &["--cells", "10"]), &["2000001 triangles; 2000000 is the maximum"]);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    /// With a few bytes changed, the file gives cells, or a refusal that names a fix.
    #[test]
    fn no_file_makes_the_reader_panic(
        which in 0usize..4,
        cut in 0.5f64..1.2,
        changes in prop::collection::vec((0.0f64..1.0, any::<u8>()), 0..6),
    ) {
        let name = ["rabbit.stl", "arch.stl", "table.obj", "case.xml"][which];
        let mut bytes = fs::read(shapes(name)).unwrap();
        bytes.truncate((bytes.len() as f64 * cut) as usize);
        for (at, byte) in changes {
            let at = (bytes.len() as f64 * at) as usize;
            bytes[at] = if which == 0 { byte } else { b"0123456789 .-eE/\n<\"="[usize::from(byte) % 20] };
        }
        survives(name, &bytes);
    }
}

fn survives(name: &str, bytes: &[u8]) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join(name);
    fs::write(&path, bytes).unwrap();
    let mesh = !name.ends_with("xml");
    let how = Import {
        pitch: mesh.then_some(10.0),
        part: (!mesh).then_some(Part::Blocks),
        at: Cell::new(1, 2, 3),
        fill_voids: true,
        ..Import::default()
    };
    match import(sources(), Path::new(&path), &how) {
        Ok(imported) => assert!(!imported.cells.is_empty()),
        Err(error) => assert!(!error.fix().is_empty() && error.to_string().contains(name), "{error}"),
    }
}

/// The answer of `shape --modules` about a drawing of these cells.
fn modules(cells: &str, args: &[&str]) -> (Ran, Value) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("drawn.toml");
    fs::write(&path, format!("version = 1\ncells = {cells}\n")).unwrap();
    let ran = run(&[&["shape", path.to_str().unwrap(), "--modules", "--json", "-"], args].concat());
    let answer = serde_json::from_str(&ran.out).unwrap_or_default();
    (ran, answer)
}

#[test]
fn cells_become_modules_or_a_reason_and_repairs() {
    let (ran, answer) = modules("[[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]", &["--split"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert_eq!(answer["pairs"], json!([[[0, 0, 0], [1, 0, 0]], [[2, 0, 0], [3, 0, 0]]]));
    assert_eq!(answer["split"]["standing"]["chains"].as_array().unwrap().len(), 1);
    // A cross: four arms touch the middle only.
    let cross = "[[1, 1, 0], [0, 1, 0], [2, 1, 0], [1, 0, 0], [1, 2, 0]]";
    let (ran, answer) = modules(cross, &["--repair", "remove"]);
    assert_eq!(ran.code, Some(3), "{ran:?}");
    assert_eq!((&answer["d"], &answer["even"], &answer["odd"]), (&json!(3), &json!(1), &json!(4)));
    assert_eq!(answer["reasons"][0]["neighbours"], json!([[1, 1, 0]]));
    assert!(ran.err.contains("these 4 cells touch only this one: [1, 1, 0]"), "{}", ran.err);
    let removed = |c: &Value| c.get("remove").is_some();
    assert!(answer["repairs"][0]["changes"].as_array().unwrap().iter().all(removed), "{answer}");
    assert_eq!(answer["repairs"][0]["changes"].as_array().unwrap().len(), 3);
    // A chain has no end in a lower layer: the tower is too high.
    let (_, answer) =
        modules("[[0,0,0],[0,0,1],[0,0,2],[0,0,3],[0,0,4],[0,0,5],[0,0,6],[0,0,7]]", &["--split"]);
    assert_eq!(
        (&answer["split"]["free"]["answer"], &answer["split"]["standing"]["answer"]),
        (&json!("yes"), &json!("no"))
    );
}

/// Two pinned cells are one module in the answer and in what is written, and pins that forbid a pairing are named.
#[test]
fn pins_of_a_drawing_are_kept_or_named() {
    let pinned = |pins: &str, args: &[&str]| {
        modules(&format!("[[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]\npins = [{pins}]"), args)
    };
    let inner = "[[2, 0, 0], [1, 0, 0]]";
    let (ran, answer) = pinned(inner, &[]);
    assert_eq!(
        (ran.code, &answer["d"], &answer["d_without_pins"]),
        (Some(3), &json!(2), &json!(0)),
        "{ran:?}"
    );
    let costly = json!([[[1, 0, 0], [2, 0, 0]]]);
    assert_eq!((&answer["pairs"], &answer["costly_pins"], &answer["pins"]), (&costly, &costly, &costly));
    assert_eq!(answer["reasons"][0]["pins"], costly, "{answer}");
    for part in [
        "the cell [0, 0, 0] touches only pinned cells",
        "this pin forbids that every cell has a partner: [1, 0, 0]-[2, 0, 0]",
    ] {
        assert!(ran.err.contains(part), "{part}: {}", ran.err);
    }
    // Cells that are added or removed leave the pin as it is.
    let (ran, answer) = pinned(inner, &["--repair", "any"]);
    let changes = answer["repairs"].as_array().unwrap().iter().flat_map(|r| r["changes"].as_array().unwrap());
    assert!(
        changes.clone().count() > 2 && !changes.clone().any(|c| c["remove"] == json!([1, 0, 0])),
        "{ran:?}"
    );
    let (ran, answer) = pinned("[[0, 0, 0], [1, 0, 0]]", &["--split"]);
    assert_eq!((ran.code, answer["costly_pins"].as_array().unwrap().len()), (Some(0), 0), "{ran:?}");
    // A repaired drawing has its pins.
    let directory = tempfile::tempdir().unwrap();
    let [drawn, written] = ["drawn.toml", "written.toml"].map(|name| directory.path().join(name));
    let text =
        format!("version = 1\ncells = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]\npins = [{inner}]\n");
    fs::write(&drawn, text).unwrap();
    let [drawn, written] = [&drawn, &written].map(|path| path.to_str().unwrap());
    let ran = run(&["shape", drawn, "--modules", "--at", "0,0,5", "--write", written]);
    assert!(ran.code == Some(3) && ran.out.contains("repair 1 is written to"), "{ran:?}");
    assert!(fs::read_to_string(written).unwrap().contains("pins = [\n    [[1, 0, 5], [2, 0, 5]],\n]"));
    let ran = run(&["shape", written, "--modules"]);
    assert!(ran.code == Some(0) && ran.out.contains("pins      1"), "{ran:?}");
    for (pins, part) in [
        ("[[3, 0, 0], [4, 0, 0]]", "drawn.toml:3: the pin [3, 0, 0] [4, 0, 0] names the cell [4, 0, 0]"),
        ("[[0, 0, 0], [2, 0, 0]]", "share no face"),
        ("[[0, 0, 0], [1, 0, 0]], [[1, 0, 0], [2, 0, 0]]", "[1, 0, 0] is in two pins"),
    ] {
        refused(&pinned(pins, &[]).0, &[part]);
    }
}

/// A MagicaVoxel file of one model with these voxels.
fn voxels(all: &[[u8; 3]]) -> Vec<u8> {
    let chunk = |name: &[u8; 4], content: &[u8], inner: &[u8]| {
        let lengths = [content.len() as u32, inner.len() as u32].map(u32::to_le_bytes).concat();
        [&name[..], &lengths, content, inner].concat()
    };
    let size = chunk(b"SIZE", &[9u32, 9, 9].map(u32::to_le_bytes).concat(), &[]);
    let listed: Vec<u8> = all.iter().flat_map(|[x, y, z]| [*x, *y, *z, 1]).collect();
    let listed = chunk(b"XYZI", &[&(all.len() as u32).to_le_bytes()[..], &listed].concat(), &[]);
    [&b"VOX "[..], &150u32.to_le_bytes(), &chunk(b"MAIN", &[], &[size, listed].concat())].concat()
}

#[test]
fn scenes_of_magicavoxel_are_read_and_damaged_ones_are_refused() {
    let tower: Vec<[u8; 3]> = (0..4).map(|z| [1, 2, z]).collect();
    let good = voxels(&tower);
    let ran = shape("tower.vox", &good, &["--at", "1,0,0", "--modules", "--split"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert!(ran.out.contains("4, from [2, 2, 0] to [2, 2, 3]"), "{}", ran.out);
    let scenario = "{ file = { path = \"tower.vox\" } }";
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("tower.vox"), &good).unwrap();
    let file = directory.path().join("a.toml");
    let text = format!(
        "version = 1\n[swarm]\nstart = {{ box = {{ min = [1, 2, 0], max = [6, 2, 0] }} }}\n\
         [[goal]]\nseed = [1, 2, 0]\nshape = {scenario}\n"
    );
    fs::write(&file, text).unwrap();
    let ran = run(&["check", file.to_str().unwrap()]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    refused(&shape("a.vox", &good[..40], &[]), &["a.vox: byte "]);
    refused(&shape("a.vox", "solid a", &[]), &["a.vox: byte 0: this is no MagicaVoxel file"]);
    refused(&shape("a.vox", voxels(&[]), &[]), &["a.vox: there is no voxel in it that is shown"]);
    for (option, value) in [("--pitch", "2"), ("--up", "y"), ("--part", "blocks")] {
        refused(&shape("a.vox", &good, &[option, value]), &["a scene of MagicaVoxel"]);
    }
}

/// A repair is written, read again and built by a swarm of cubes whose scenario names the file.
#[test]
fn a_repaired_drawing_pairs_up_and_is_built() {
    let directory = tempfile::tempdir().unwrap();
    let file = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let (repaired, scenario) = (file("repaired.toml"), file("scenario.toml"));
    let chair = shapes("chair.toml");
    let ran = run(&["shape", chair.to_str().unwrap(), "--modules", "--write", &repaired]);
    assert!(ran.code == Some(3) && ran.out.contains("repair 1 is written to"), "{ran:?}");
    let ran = run(&["shape", &repaired, "--modules"]);
    assert!(ran.code == Some(0) && ran.out.contains("every cell has a partner"), "{ran:?}");
    let text = "version = 1\n[swarm.start]\nbox = { min = [0, 0, -2], max = [5, 5, -2] }\n[[goal]]\n\
                growth = \"solid\"\nshape = { file = { path = \"repaired.toml\", at = [0, 0, -2] } }\n";
    fs::write(&scenario, text).unwrap();
    let report = built(&["run", &scenario, "--link", "sim"]);
    assert_eq!((report.goal.filled, report.invariants.broken), (report.goal.cells, 0));
}

#[test]
fn drawings_that_are_no_structure_are_refused() {
    let (ran, _) = modules("[[0, 0, 0], [2, 0, 0]]", &[]);
    refused(&ran, &["drawn.toml: the cells are in 2 parts", "[0, 0, 0] to [2, 0, 0]"]);
    let (ran, _) = modules("[[0, 0, 0], [0, 0, 0]]", &[]);
    refused(&ran, &["drawn.toml", "[0, 0, 0] is listed twice"]);
    let (ran, _) = modules("[[0, 0, 0], [1, 0, 0]]", &["--pitch", "10"]);
    refused(&ran, &["pitch", "a drawing, which is made of cells"]);
    let ran = run(&["shape", shapes("chair.toml").to_str().unwrap(), "--split"]);
    assert_eq!((ran.code, ran.err.contains("--modules")), (Some(2), true), "{ran:?}");
}

/// Faults that were read over are named where the scenario is checked, not only where the file is looked at.
#[test]
fn check_names_the_faults_of_files() {
    let directory = tempfile::tempdir().unwrap();
    let corners =
        (0..8).map(|i| format!("v {} {} {}", i & 1, i >> 1 & 1, i >> 2)).collect::<Vec<_>>().join("\n");
    let faces = "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 2 4 8 6\nf 4 3 7 8\nf 3 1 5 7\nv 0.5 0 0\nf 1 9 2\n";
    std::fs::write(directory.path().join("cube.obj"), format!("{corners}\n{faces}")).unwrap();
    let text = "version = 1\n[swarm]\nstart = { box = { min = [0, 0, 0], max = [2, 2, 0] } }\n\
        [[goal]]\nshape = { file = { path = \"cube.obj\", pitch = 0.5 } }\n";
    std::fs::write(directory.path().join("a.toml"), text).unwrap();
    let checked: Ran = command(&["check", "a.toml"]).current_dir(directory.path()).output().unwrap().into();
    assert_eq!(checked.code, Some(0), "{checked:?}");
    assert!(
        checked.out.contains("  note      cube.obj: 1 edge belongs to more than two triangles"),
        "{}",
        checked.out
    );
}
