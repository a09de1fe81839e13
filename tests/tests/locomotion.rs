//! `metamorph structure` and `reproduce thesis-7` as a user runs them.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{root, run};
use metamorph_tests::json_schema::Schema;
use serde_json::{Value, json};
use std::fs;

fn answer(args: &[&str]) -> Value {
    let ran = run(&[args, &["--quiet", "--json", "-"]].concat());
    assert_eq!(ran.code, Some(0), "{ran:?}");
    serde_json::from_str(&ran.out).unwrap()
}

#[test]
fn a_structure_is_analysed_by_name_and_from_a_file() {
    let named = answer(&["structure", "quad5-sym"]);
    let parameters = |answer: &Value| {
        let networks = answer["networks"].as_array().unwrap().iter();
        networks.map(|n| n["parameters_thesis_lags"].as_u64().unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(parameters(&named), [44, 21, 15, 26]);
    assert_eq!(named["network"]["couplings"].as_array().unwrap().len(), 7);
    let file = root().join("deploy/structures/quad5-sym.json").display().to_string();
    let mut read = answer(&["structure", &file]);
    read["structure"] = named["structure"].clone();
    assert_eq!(read, named);
    let ring = root().join("deploy/structures/struct10.json").display().to_string();
    assert_eq!(parameters(&answer(&["structure", &ring])), [90, 26, 26, 90]);
    let ran = run(&["structure", "quad5-sym", "--dead", "0"]);
    for part in
        ["5 modules, 4 connections", "linear body  0", "1.q1", "2 3 4", "blf-sym", "6", "closes a cycle"]
    {
        assert!(ran.out.contains(part), "`{part}` is missing in {}", ran.out);
    }
    let ran = run(&["structure", "quad5-sym", "--dead", "0,1,2,3,4"]);
    assert!(ran.code == Some(3) && ran.err.contains("no joint moves"), "{ran:?}");
}

/// The same structure by cells with poses and by connectors; as start of a plan, too.
#[test]
fn both_forms_of_structure_files_mean_the_same() {
    let directory = tempfile::tempdir().unwrap();
    let write = |name: &str, content: &Value| {
        let path = directory.path().join(name);
        fs::write(&path, content.to_string()).unwrap();
        path.display().to_string()
    };
    let plan = directory.path().join("plan.json").display().to_string();
    let ran = run(&["plan", "--from", "line:3", "--types", "12", "--to", "loop:2x3", "-o", &plan]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let plan: Value = serde_json::from_str(&fs::read_to_string(plan).unwrap()).unwrap();
    let cells = write("cells.json", &plan["start"]);
    let join =
        |a: u32, rotation: u8| json!({ "a": a, "at": "C3X", "b": a + 1, "to": "C0X", "rotation": rotation });
    let mut line = json!({ "format": "metamorph structure", "version": 1, "modules": 3, "connections": [join(0, 1), join(1, 2)] });
    let shape = write("shape.json", &line);
    line["joints_deg"] = json!([[0, 0, 0], [0, 0, 0], [0, 0, 0]]);
    let connectors = write("connectors.json", &line);
    let fingerprint = |file: &str| answer(&["structure", file])["fingerprint"].clone();
    assert_eq!(fingerprint(&cells), fingerprint(&connectors));
    // No module moves from one to the other, and the line leaves joint values free.
    let same = answer(&["plan", "--from", &cells, "--to", &connectors, "--collision", "final"]);
    assert_eq!((&same["verdict"], &same["cost"]), (&json!("optimal"), &json!(0)), "{same}");
    let free = answer(&["plan", "--distance", "line:3", &shape]);
    assert_eq!(free["shape"]["actions"].as_u64().unwrap_or(0), 0, "{free}");
    let schema: Value = serde_json::from_str(&run(&["schema", "structure"]).out).unwrap();
    Schema::new(&schema).accepts(&line, "the structure");
}

#[test]
fn bad_structures_are_refused_with_place_reason_and_fix() {
    let directory = tempfile::tempdir().unwrap();
    let join = |at: &str, b: u32, rotation: i32| json!({ "a": 0, "at": at, "b": b, "to": "C0X", "rotation": rotation });
    let structure = |modules: u32, connections: Value| json!({ "format": "metamorph structure", "version": 1, "modules": modules, "connections": connections });
    let pair = || structure(2, json!([join("C3X", 1, 0)]));
    let with = |joints: Value| {
        let mut of = pair();
        of["joints_deg"] = joints;
        of
    };
    let mut later = pair();
    later["version"] = json!(2);
    let ring: Value =
        serde_json::from_str(&fs::read_to_string(root().join("deploy/structures/struct10.json")).unwrap())
            .unwrap();
    let mut open = ring.clone();
    open["joints_deg"][0][1] = json!(0);
    let mut folded = structure(3, json!([join("C0X", 1, 0), join("C0Y", 2, 0)]));
    let shape = json!({ "format": "metamorph structure", "version": 1,
        "modules": [[[0, 0, 0], [1, 0, 0]]], "joined": [] });
    folded["joints_deg"] = json!([[0, 0, 0], [-120, 0, 0], [-120, 0, 0]]);
    let overlap = {
        // One of the four rotations folds both limbs into one cell.
        let turned = (0..4).map(|k| {
            let mut of = folded.clone();
            of["connections"][1]["rotation"] = json!(k);
            of
        });
        turned.collect::<Vec<_>>()
    };
    let cases = [
        ("connector", structure(2, json!([join("C9X", 1, 0)])), "unknown variant `C9X`"),
        (
            "twice",
            structure(3, json!([join("C3X", 1, 0), join("C3X", 2, 0)])),
            "both use connector C3X of module 0",
        ),
        ("rotation", structure(2, json!([join("C3X", 1, 4)])), "4 is not a number of quarter turns"),
        ("negative", structure(2, json!([join("C3X", 1, -1)])), "invalid value: integer `-1`"),
        ("parted", structure(3, json!([join("C3X", 1, 0)])), "module 2 is not connected with module 0"),
        ("many", structure(257, json!([])), "257 modules"),
        ("empty", structure(0, json!([])), "no modules"),
        ("nowhere", structure(2, json!([join("C3X", 2, 0)])), "there is no module 2"),
        ("itself", structure(2, json!([join("C3X", 0, 0)])), "joins module 0 to itself"),
        ("count", with(json!([[0, 0, 0]])), "joint values for 1 modules, but there are 2"),
        ("angle", with(json!([[0, 0, 0], [0, 1e9, 0]])), "module 1: q2 = 1000000000"),
        ("ring", open, "the ring does not close"),
        ("version", later, "version 2, not"),
        ("shape", shape, "leave open which connectors hold"),
    ];
    let refused = |name: &str, content: &Value, reason: &str| {
        let path = directory.path().join(format!("{name}.json"));
        fs::write(&path, content.to_string()).unwrap();
        let ran = run(&["structure", &path.display().to_string()]);
        let wanted = [name, reason, "fix: "];
        ran.code == Some(2) && wanted.iter().all(|part| ran.err.contains(part)) || panic!("{name}: {ran:?}")
    };
    assert!(cases.iter().all(|(name, content, reason)| refused(name, content, reason)));
    let files = overlap.iter().enumerate().map(|(k, content)| {
        let path = directory.path().join(format!("folded{k}.json"));
        fs::write(&path, content.to_string()).unwrap();
        run(&["structure", &path.display().to_string()])
    });
    let told: Vec<_> = files.filter(|ran| ran.code == Some(2)).collect();
    assert!(
        !told.is_empty() && told.iter().all(|ran| ran.err.contains("modules 1 and 2 overlap by")),
        "{told:?}"
    );
    let ran = run(&["structure", "quad6"]);
    assert!(ran.code == Some(2) && ran.err.contains("quad5-sym") && ran.err.contains("fix: "), "{ran:?}");
    let ran = run(&["structure", "quad5-sym", "--dead", "5"]);
    assert!(ran.code == Some(2) && ran.err.contains("no module 5"), "{ran:?}");
}

/// 11 of the 12 cells of table 7.2 are equal, and the twelfth is named.
#[test]
fn the_table_of_parameters_is_reproduced() {
    let all = answer(&["reproduce", "thesis-7"]);
    let rows = all["planners"][0]["rows"].as_array().unwrap();
    let differ: Vec<_> = rows.iter().filter(|r| r["ours"].as_str().unwrap().contains("differs")).collect();
    assert_eq!((rows.len(), differ.len()), (12, 1), "{all}");
    assert_eq!((&differ[0]["what"], &differ[0]["published"]), (&json!("quad5-unsym, sym"), &json!("30")));
    assert!(differ[0]["ours"].as_str().unwrap().starts_with("32 "), "{all}");
}

/// Learning curves of gait files stand beside table 7.5.
#[test]
fn learning_curves_are_compared() {
    let directory = tempfile::tempdir().unwrap();
    let files = ["fo", "blf"].map(|network| {
        let file = directory.path().join(network).display().to_string();
        let study = [
            "learn",
            "quad5-sym",
            "--trial",
            "5s",
            "--fitness",
            "thesis",
            "--trials",
            "3",
            "--seeds",
            "1..4",
        ];
        let ran = run(&[&study[..], &["--network", network, "--write", &file]].concat());
        assert_eq!(ran.code, Some(0), "{ran:?}");
        file
    });
    let all = answer(&["reproduce", "thesis-7", "--gaits", &files.join(",")]);
    let rows = all["planners"][0]["rows"].as_array().unwrap();
    let row =
        |what: &str| rows.iter().find(|r| r["what"] == *what).unwrap_or_else(|| panic!("{what}: {all}"));
    assert_eq!(rows.len(), 15, "{all}");
    assert_eq!(row("quad5-sym, fo: speed by trials")["published"], "5 after 400");
    let differ = row("quad5-sym, fo and blf differ until");
    assert_eq!(differ["published"], "iteration 32 (trial 2560)");
    assert!(differ["ours"].as_str().unwrap().contains("trial"), "{differ}");
    let ran = run(&["reproduce", "thesis-7", "--gaits", "nowhere.json"]);
    assert!(ran.code == Some(2) && ran.err.contains("--gaits nowhere.json"), "{ran:?}");
}
