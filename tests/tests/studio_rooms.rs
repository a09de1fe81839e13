//! Rooms in `metamorph studio` over plain HTTP: the same answers as those of `metamorph room`, and what is refused.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{root, run};
use metamorph_tests::view::View;
use metamorph_world_controller::console::stopwatch::wait_until;
use serde_json::{Value, json};
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::time::Duration;

const WATCHDOG: Duration = Duration::from_secs(240);

fn kept(name: &str) -> String {
    root().join("deploy/rooms").join(name).display().to_string()
}

fn text(name: &str) -> String {
    fs::read_to_string(kept(name)).unwrap()
}

fn ask(view: &View, name: &str, mut body: Value) -> (u16, Value) {
    body["version"] = json!(1);
    view.post_to(name, &body.to_string())
}

/// Asks about a room, with changes of it.
fn room(view: &View, text: &str, edits: Value, question: Value) -> (u16, Value) {
    ask(view, "room", json!({ "session": "a", "revision": 7, "room": text, "edits": edits, "ask": question }))
}

/// Returns the answer of `metamorph room` about a text.
fn command(text: &str, options: &[&str]) -> (Option<i32>, Value) {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("room.toml").display().to_string();
    fs::write(&file, text).unwrap();
    let ran = run(&[&["room", &file, "--json", "-"], options].concat());
    (ran.code, serde_json::from_str(&ran.out).unwrap_or_else(|_| panic!("{ran:?}")))
}

/// Whatever is changed: what the studio says is violated, proposed and measured is what `metamorph room` says.
#[test]
fn answers_are_those_of_the_command() {
    let view = View::start(&["studio"]);
    let place =
        |piece: &str, at: [i16; 2], turn: u8| json!({ "place": { "piece": piece, "at": at, "turn": turn } });
    for (edits, violated) in [
        (json!([]), &[][..]),
        (json!([place("chair", [9, 6], 0)]), &["align"]),
        (json!([place("chair", [5, 5], 2)]), &["facing"]),
        (json!([place("table", [1, 3], 0)]), &["wall", "clear"]),
        (json!([place("chair", [5, 1], 0)]), &["apart", "gap"]),
        (json!([place("chair", [18, 5], 0)]), &["inside", "near", "facing"]),
        (json!([place("table", [8, 1], 0), { "remove": { "piece": "chair" } }]), &["wall"]),
    ] {
        let (status, answer) = room(&view, &text("corner.toml"), edits.clone(), json!("reach"));
        assert_eq!((status, &answer["revision"]), (200, &json!(7)), "{edits}: {answer}");
        let (code, said) = command(answer["room"].as_str().unwrap(), &["--measure"]);
        assert_eq!(answer["violations"], said["violations"], "{edits}");
        assert_eq!(answer["circles"], said["circles"], "{edits}");
        let all = answer["violations"].as_array().unwrap();
        for rule in violated {
            let found = all.iter().find(|v| v["rule"] == *rule);
            let found = found.unwrap_or_else(|| panic!("{edits}: {rule} is not violated: {answer}"));
            assert!(
                !found["cells"].as_array().unwrap().is_empty()
                    && !found["pieces"].as_array().unwrap().is_empty()
            );
        }
        let hard = all.iter().any(|v| v["wish"] == false);
        assert_eq!(code, Some(if hard { 3 } else { 0 }), "{edits}: {answer}");
        assert_eq!(all.is_empty(), violated.is_empty(), "{edits}: {answer}");
    }
    let moved = json!([place("chair", [9, 6], 0)]);
    let (_, answer) = room(&view, &text("corner.toml"), moved.clone(), json!("put-right"));
    let (_, said) = command(answer["room"].as_str().unwrap(), &["--put-right"]);
    assert_eq!((&answer["put_right"], &answer["put_right"]["least"]), (&said["put_right"], &json!("proven")));
    let (_, answer) = room(&view, &text("corner.toml"), moved, json!({ "snap": "chair" }));
    let (_, said) = command(answer["room"].as_str().unwrap(), &["--snap", "chair"]);
    assert_eq!((&answer["snap"], &answer["snap"]["at"]), (&said["snap"], &json!([5, 6])));
    // The circle is measured as by the command; that of a chair moved by one connector is worse.
    let (_, answer) =
        room(&view, &text("circle.toml"), json!([place("chair 1", [31, 18], 3)]), json!("check"));
    assert!(answer["circles"][0]["p_l"].as_f64().unwrap() > 0.01, "{}", answer["circles"]);
    assert_eq!(
        answer["constraints"].as_array().unwrap().len(),
        2 + text("circle.toml").matches("[[constraint]]").count()
    );
}

#[test]
fn rooms_are_opened_saved_started_and_built() {
    let directory = tempfile::tempdir().unwrap();
    let inside = directory.path().to_str().unwrap();
    let view = View::start(&["studio", "--dir", inside, &kept("corner.toml")]);
    let (_, begun) = ask(&view, "begin", json!({}));
    assert_eq!(
        (&begun["rooms"][0]["name"], &begun["rooms"][0]["text"]),
        (&json!("corner"), &json!(text("corner.toml")))
    );
    let examples = begun["room_examples"].as_array().unwrap();
    assert_eq!(examples.len(), 3, "{begun}");
    for example in examples {
        assert_eq!(example["described"]["violations"], json!([]), "{}", example["name"]);
    }
    // A changed room is written with its comments, and read by the command and by the studio again.
    let edits = json!([{ "place": { "piece": "chair", "at": [5, 6], "turn": 0 } }]);
    let (_, answer) = room(&view, &text("corner.toml"), edits, json!("check"));
    let changed = answer["room"].as_str().unwrap();
    assert_eq!(changed, text("corner.toml").replace("[5, 5]", "[5, 6]"));
    let save = |name: &str, replace: bool| {
        ask(&view, "save", json!({ "name": name, "room": changed, "replace": replace }))
    };
    assert_eq!(save("mine.toml", false).0, 200);
    assert_eq!(save("mine.toml", false).0, 409);
    assert_eq!(save("mine.toml", true).1["directory"], json!(["mine.toml"]));
    let file = directory.path().join("mine.toml");
    assert_eq!(fs::read_to_string(&file).unwrap(), changed);
    assert_eq!(run(&["room", file.to_str().unwrap()]).code, Some(0));
    let (status, answer) = ask(&view, "open", json!({ "name": "mine.toml" }));
    assert_eq!((status, &answer["room"]), (200, &json!({ "name": "mine", "text": changed })), "{answer}");
    let hex: String = changed.bytes().map(|b| format!("{b:02x}")).collect();
    assert_eq!(
        ask(&view, "open", json!({ "name": "sent.toml", "content": hex })).1["room"]["name"],
        json!("sent")
    );

    // The scenario is that of the command; a run of it is built.
    let start = |room: &str, rest: Value| {
        let mut body = json!({ "name": "mine", "room": room, "link": "sim" });
        body.as_object_mut().unwrap().extend(rest.as_object().unwrap().clone());
        ask(&view, "start", body)
    };
    let (status, answer) = start(changed, json!({ "kind": "PAR", "only_scenario": true }));
    let written = directory.path().join("scenario.toml").display().to_string();
    assert_eq!(run(&["room", file.to_str().unwrap(), "--kind", "PAR", "--write", &written]).code, Some(0));
    let without_origin = |text: &str| text.split_once('\n').unwrap().1.to_owned();
    let said = fs::read_to_string(&written).unwrap();
    assert_eq!((status, without_origin(answer["scenario"].as_str().unwrap())), (200, without_origin(&said)));
    let violated = changed.replace("[5, 6]", "[9, 6]");
    let (status, answer) = start(&violated, json!({}));
    assert!(status == 422 && answer["why"].as_str().unwrap().contains("violates a constraint"), "{answer}");
    for rest in [
        json!({ "cells": [[0, 0, 0]] }),
        json!({ "family": "cube" }),
        json!({ "pins": [[[0, 0, 0], [0, 0, 1]]] }),
    ] {
        assert_eq!(start(changed, rest.clone()).0, 400, "{rest}");
    }
    assert_eq!(start(changed, json!({ "kind": "SRS" })).0, 200);
    let mut latest = Value::Null;
    assert!(wait_until(WATCHDOG, || {
        latest = ask(&view, "state", json!({})).1["run"].clone();
        latest["going"] == json!(false)
    }));
    assert_eq!((&latest["outcome"], &latest["modules"]), (&json!("built"), &json!(11)), "{latest}");
}

/// Drawings that pieces name come from the directory, or from beside a room of the command line; from nowhere else.
#[test]
fn pieces_name_drawings_of_the_directory_only() {
    let (outside, inside) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let drawing = "version = 1\ncells = [[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 0, 3]]\n";
    for directory in [&outside, &inside] {
        fs::write(directory.path().join("pole.toml"), drawing).unwrap();
    }
    fs::write(outside.path().join("secret.toml"), drawing).unwrap();
    symlink(outside.path().join("secret.toml"), inside.path().join("link.toml")).unwrap();
    let with = |name: &str| {
        format!(
            "version = 1\n[room]\nsize = [20, 20]\n[[piece]]\nname = \"pole\"\nfile = {}\nat = [3, 3]\n",
            json!(name)
        )
    };
    let beside = outside.path().join("room.toml");
    fs::write(&beside, with("secret.toml")).unwrap();
    let view = View::start(&["studio", "--dir", inside.path().to_str().unwrap(), beside.to_str().unwrap()]);
    let check = |name: &str| room(&view, &with(name), json!([]), json!("check"));
    let (status, answer) = check("pole.toml");
    assert_eq!((status, &answer["metamodules"]), (200, &json!(1)), "{answer}");
    assert_eq!(check("secret.toml").0, 200, "it was opened on the command line");
    for name in ["link.toml", "none.toml", "../pole.toml", "/etc/passwd", "./pole.toml", "", "pole.toml\0"] {
        let (status, answer) = check(name);
        assert!(
            status == 422 && answer["why"].as_str().unwrap().contains("room.toml:"),
            "{name:?}: {answer}"
        );
    }
    // Where it is written it could not be opened.
    let save = |name: &str| ask(&view, "save", json!({ "name": "saved.toml", "room": with(name) }));
    assert_eq!(save("secret.toml").0, 422);
    assert!(!inside.path().join("saved.toml").exists());
    assert_eq!(save("pole.toml").0, 200);
    let saved = inside.path().join("saved.toml").display().to_string();
    assert_eq!(run(&["room", &saved]).code, Some(0));
    // A drawing of the page becomes a piece with its pins, if metamodules make it.
    let add = |cells: Value, pins: Value| {
        let piece = json!([{ "add": { "name": "drawn", "cells": cells, "pins": pins, "at": [9, 9] } }]);
        room(&view, &with("pole.toml"), piece, json!("check"))
    };
    let square = json!([[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1]]);
    assert_eq!(add(square.clone(), json!([[[0, 0, 0], [0, 0, 1]]])).1["metamodules"], json!(2));
    for (cells, pins, why) in [
        (json!([[0, 0, 0], [1, 0, 0]]), json!([]), "multiple of four"),
        (square, json!([[[0, 0, 0], [1, 0, 1]]]), "pin"),
    ] {
        let (status, answer) = add(cells, pins);
        assert!(status == 422 && answer["why"].as_str().unwrap().contains(why), "{answer}");
    }
    let refused = run(&["studio", &Path::new(inside.path()).join("none.toml").display().to_string()]);
    assert_eq!(refused.code, Some(2));
    fs::write(&beside, with("nothing.toml")).unwrap();
    let refused = run(&["studio", beside.to_str().unwrap()]);
    assert!(refused.code == Some(2) && refused.err.contains("nothing.toml"), "{refused:?}");
}

/// Requests that are too large, malformed or of another version are refused with the reason, and change nothing.
#[test]
fn wrong_requests_about_rooms_are_refused() {
    let inside = tempfile::tempdir().unwrap();
    let view = View::start(&["studio", "--dir", inside.path().to_str().unwrap()]);
    let good = json!({ "version": 1, "session": "a", "revision": 1, "room": text("corner.toml"), "edits": [], "ask": "check" });
    let but = |key: &str, value: Value| {
        let mut body = good.clone();
        body[key] = value;
        body.to_string()
    };
    let place = |at: Value| json!([{ "place": { "piece": "chair", "at": at, "turn": 0 } }]);
    let long = format!("version = 1\n# {}\n[room]\nsize = [9, 9]\n", "x".repeat(600 << 10));
    let deep = format!("version = 1\nroom = {}1{}\n", "[".repeat(9_000), "]".repeat(9_000));
    let many: Value = (0..513).map(|_| json!({ "wish": { "constraint": 1, "wish": true } })).collect();
    let cells: Value = (0..600).map(|i| json!([i % 30, i / 30, 0])).collect();
    assert_eq!(view.post_to("room", &good.to_string()).0, 200);
    for (expected, why, body) in [
        (400, "malformed", String::new()),
        (400, "malformed", "[]".to_owned()),
        (400, "version 1", but("version", json!(2))),
        (400, "session", but("session", json!(""))),
        (400, "session", but("session", json!("a".repeat(65)))),
        (400, "unknown field", but("command", json!("x"))),
        (400, "malformed", but("ask", json!("everything"))),
        (400, "malformed", but("revision", json!(-1))),
        (400, "malformed", but("edits", json!([{ "move": { "piece": "chair" } }]))),
        (400, "malformed", but("edits", place(json!([0, 99_999])))),
        (400, "malformed", but("edits", place(json!([0])))),
        (413, "at most 512 changes", but("edits", many)),
        (413, "at most 512 KiB", but("room", json!(long))),
        (422, "TOML", but("room", json!("version = "))),
        (422, "room.toml", but("room", json!(deep))),
        (422, "version 2", but("room", json!("version = 2\n[room]\nsize = [9, 9]\n"))),
        (422, "256", but("edits", json!([{ "resize": { "size": [300, 9] } }]))),
        (422, "is not in the room", but("edits", json!([{ "resize": { "size": [4, 4] } }]))),
        (
            422,
            "quarter turns",
            but("edits", json!([{ "place": { "piece": "chair", "at": [0, 0], "turn": 4 } }])),
        ),
        (422, "no piece `sofa`", but("edits", json!([{ "remove": { "piece": "sofa" } }]))),
        (422, "no piece `sofa`", but("ask", json!({ "snap": "sofa" }))),
        (422, "no constraint 99", but("edits", json!([{ "release": { "constraint": 99 } }]))),
        (
            422,
            "two pieces with the name",
            but("edits", json!([{ "add": { "name": "chair", "shape": "chair", "at": [0, 0] } }])),
        ),
        (
            422,
            "at most 512 cells",
            but("edits", json!([{ "add": { "name": "x", "cells": cells, "at": [0, 0] } }])),
        ),
        (
            422,
            "one of `shape`, `file` and `cells`",
            but("edits", json!([{ "add": { "name": "x", "shape": "box", "file": "a.toml", "at": [0, 0] } }])),
        ),
        (
            422,
            "this constraint is about two pieces",
            but(
                "edits",
                json!([{ "constrain": { "kind": "gap", "pieces": ["chair", "table", "chair 3"], "cells": 1 } }]),
            ),
        ),
    ] {
        let (status, answer) = view.post_to("room", &body);
        let said = answer["why"].as_str().unwrap_or_default();
        let shown: String = body.chars().rev().take(120).collect::<Vec<_>>().into_iter().rev().collect();
        assert!(
            status == expected && (said.contains(why) || why.starts_with("this constraint")),
            "{shown}: {status} {answer}"
        );
    }
    for (name, expected, body) in [
        (
            "save",
            400,
            json!({ "version": 1, "name": "a.toml", "room": text("corner.toml"), "cells": [[0, 0, 0]] }),
        ),
        ("save", 400, json!({ "version": 1, "name": "a.toml" })),
        ("save", 422, json!({ "version": 1, "name": "a.toml", "room": "version = 1" })),
        ("save", 422, json!({ "version": 1, "name": "../a.toml", "room": text("corner.toml") })),
        ("save", 422, json!({ "version": 1, "name": "a.txt", "room": text("corner.toml") })),
        ("start", 422, json!({ "version": 1, "name": "a", "room": "version = 1", "link": "sim" })),
        (
            "start",
            400,
            json!({ "version": 1, "name": "a", "room": text("corner.toml"), "kind": "XYZ", "link": "sim" }),
        ),
        ("start", 400, json!({ "version": 1, "name": "a", "link": "sim" })),
        ("start", 422, json!({ "version": 1, "name": "a", "room": text("empty.toml"), "link": "sim" })),
    ] {
        let (status, answer) = view.post_to(name, &body.to_string());
        assert!(
            status == expected && !answer["why"].as_str().unwrap_or_default().is_empty(),
            "{name}: {answer}"
        );
    }
    assert!(ask(&view, "state", json!({})).1["run"].is_null(), "nothing was started");
    assert_eq!(fs::read_dir(inside.path()).unwrap().count(), 0, "nothing was written");
    assert_eq!(view.end(), Some(0));
}
