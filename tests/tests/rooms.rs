//! `metamorph room` on the rooms that are kept in `deploy/rooms`: they keep their constraints, and become scenarios.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{root, run};
use serde_json::Value;
use std::fs;

fn kept(name: &str) -> String {
    root().join("deploy/rooms").join(name).display().to_string()
}

#[test]
fn kept_rooms_are_right_and_their_circles_precise() {
    for name in ["circle.toml", "corner.toml"] {
        let ran = run(&["room", &kept(name), "--measure", "--json", "-"]);
        assert_eq!(ran.code, Some(0), "{name}: {ran:?}");
        let answer: Value = serde_json::from_str(&ran.out).unwrap();
        assert_eq!(answer["violations"], Value::Array(Vec::new()), "{name}");
        let circles = answer["circles"].as_array().unwrap();
        assert_eq!(circles.len(), usize::from(name == "circle.toml"));
        for circle in circles {
            let of = |key: &str| circle[key].as_f64().unwrap();
            assert!(of("p_l") <= 0.03 && of("p_g") <= 1.02, "{circle}");
        }
    }
}

/// The scenario of the small room is built; that of the circle can be read, with all its seeds.
#[test]
fn rooms_become_scenarios() {
    let dir = tempfile::tempdir().unwrap();
    for (name, seeds) in [("corner.toml", 10), ("circle.toml", 64)] {
        let scenario = dir.path().join(name).display().to_string();
        let ran = run(&["room", &kept(name), "--write", &scenario]);
        assert_eq!(ran.code, Some(0), "{name}: {ran:?}");
        assert_eq!(fs::read_to_string(&scenario).unwrap().matches("foot = ").count(), seeds);
        let ran = run(&["check", &scenario]);
        assert_eq!(ran.code, Some(0), "{name}: {ran:?}");
    }
    let scenario = dir.path().join("corner.toml").display().to_string();
    let ran = run(&["run", &scenario, "--link", "sim", "--seed", "3"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
}

#[test]
fn violations_have_their_exit_code_and_what_puts_them_right() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("room.toml").display().to_string();
    let text = fs::read_to_string(kept("corner.toml")).unwrap().replace("at = [5, 5]", "at = [9, 6]");
    fs::write(&file, &text).unwrap();
    let ran = run(&["room", &file]);
    assert!(ran.code == Some(3) && ran.out.contains("align 4"), "{ran:?}");
    let ran = run(&["room", &file, "--put-right", "--json", "-"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let answer: Value = serde_json::from_str(&ran.out).unwrap();
    assert_eq!(
        (answer["put_right"]["total"].as_u64(), &answer["put_right"]["least"]),
        (Some(4), &"proven".into())
    );
    let ran = run(&["room", &file, "--snap", "chair", "--json", "-"]);
    let answer: Value = serde_json::from_str(&ran.out).unwrap();
    assert_eq!(answer["snap"]["at"], serde_json::json!([5, 6]), "{ran:?}");
    let ran = run(&["room", &file, "--snap", "sofa"]);
    assert!(ran.code == Some(2) && ran.err.contains("sofa"), "{ran:?}");
}
