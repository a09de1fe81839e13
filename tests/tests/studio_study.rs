//! `metamorph studio --study`: what a person does with a room is recorded, and read by `metamorph room --measure`; what is
//! refused; and the page that says it is recorded, in a real browser (skipped where there is none).
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::browser::Browser;
use metamorph_tests::command::{root, run};
use metamorph_tests::studio::{check_clean, drag, number, open};
use metamorph_tests::view::View;
use metamorph_world_controller::console::stopwatch::wait_until;
use serde_json::{Value, json};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

const WATCHDOG: Duration = Duration::from_secs(120);
const SETTLED: &str = "window.studio.room.settled && window.studio.room.recorder.settled";

fn kept(name: &str) -> String {
    root().join("deploy/rooms").join(name).display().to_string()
}

fn text(name: &str) -> String {
    fs::read_to_string(kept(name)).unwrap()
}

/// Starts a studio that records, with a room.
fn record(directory: &Path, room: &str) -> (View, PathBuf) {
    let log = directory.join("log.jsonl");
    (View::start(&["studio", &kept(room), "--study", log.to_str().unwrap()]), log)
}

/// Sends what a page has seen.
fn send(view: &View, session: &str, rest: &Value) -> (u16, Value) {
    let mut body = json!({ "version": 1, "session": session });
    body.as_object_mut().unwrap().extend(rest.as_object().unwrap().clone());
    view.post_to("study", &body.to_string())
}

/// Returns the text of a room after changes.
fn changed(view: &View, text: &str, edits: &Value) -> String {
    let body = json!({ "version": 1, "session": "a", "revision": 1, "room": text, "edits": edits });
    let (status, answer) = view.post_to("room", &body.to_string());
    assert_eq!(status, 200, "{answer}");
    answer["room"].as_str().unwrap().to_owned()
}

/// Returns what `metamorph room` measures of a log, the task being a kept room, or of a room alone.
fn measure(room: &str, log: Option<&Path>) -> Value {
    let mut args = vec!["room", room, "--measure", "--json", "-"];
    if let Some(log) = log {
        args.extend(["--study", log.to_str().unwrap()]);
    }
    let ran = run(&args);
    serde_json::from_str(&ran.out).unwrap_or_else(|_| panic!("{ran:?}"))
}

#[test]
fn a_recorded_session_is_measured() {
    let directory = tempfile::tempdir().unwrap();
    let (view, log) = record(directory.path(), "circle.toml");
    assert_eq!(fs::metadata(&log).unwrap().permissions().mode() & 0o777, 0o600);
    let begun = view.post_to("begin", &json!({ "version": 1 }).to_string()).1;
    assert_eq!(begun["study"], json!("log.jsonl"));

    let task = text("circle.toml");
    let moved = changed(
        &view,
        &task,
        &json!([{ "place": { "piece": "chair 1", "at": [31, 20], "turn": 3 } }, { "colour": { "piece": "chair 2", "colour": "violet" } }]),
    );
    let turned =
        changed(&view, &moved, &json!([{ "place": { "piece": "chair 3", "at": [18, 24], "turn": 1 } }]));
    let added =
        changed(&view, &turned, &json!([{ "add": { "name": "chair 11", "shape": "chair", "at": [2, 2] } }]));
    let without = changed(&view, &added, &json!([{ "remove": { "piece": "chair 4" } }]));
    let eye = |t: f64, x: f64| json!({ "eye": { "t": t, "at": [x, 2, 8], "direction": [0, 0, -1] } });
    let chosen = |t: f64, pieces: &[&str]| json!({ "chosen": { "t": t, "pieces": pieces } });
    for part in [
        json!({ "room": { "t": 0, "text": task } }),
        json!({ "events": [eye(0.1, 2.0), chosen(2.0, &["chair 1"]), eye(2.1, 3.5)] }),
        json!({ "room": { "t": 3, "text": moved } }),
        json!({ "room": { "t": 4, "text": turned }, "events": [chosen(4.0, &["chair 3", "chair 4"])] }),
        json!({ "room": { "t": 5, "text": added } }),
        json!({ "room": { "t": 6, "text": without } }),
        // A step back.
        json!({ "room": { "t": 7, "text": added } }),
        json!({ "events": [chosen(7.5, &[]), { "look": { "t": 8.5 } }, eye(9.0, 3.5)] }),
    ] {
        let (status, answer) = send(&view, "a", &part);
        assert_eq!((status, &answer["result"]), (200, &json!("done")), "{answer}");
    }
    let answer = measure(&kept("circle.toml"), Some(&log));
    let session = &answer["session"];
    assert_eq!(
        session["actions"],
        json!({ "create": 2, "delete": 1, "select": 3, "deselect": 2, "move": 1, "turn": 1, "colour": 1, "look": 1 }),
        "{session}"
    );
    assert_eq!(
        (&session["time_s"], &session["samples"], &session["path_m"]),
        (&json!(6.5), &json!(3), &json!(1.5))
    );
    let condition = ["table", "representation", "mobility"].map(|key| &session[key]);
    assert_eq!(condition, [&json!("table"), &json!("virtual"), &json!("dynamic")]);
    assert_eq!(answer["errors"], json!(["chair 11 is not part of the task", "chair 2 is violet"]));

    // The arrangement is the one that `metamorph room` measures.
    let restored = changed(&view, &added, &json!([{ "remove": { "piece": "chair 11" } }]));
    assert_eq!(send(&view, "a", &json!({ "room": { "t": 10, "text": restored } })).0, 200);
    let file = directory.path().join("restored.toml");
    fs::write(&file, &restored).unwrap();
    let (of_log, of_room) =
        (measure(&kept("circle.toml"), Some(&log)), measure(file.to_str().unwrap(), None));
    for key in ["p_l", "p_g"] {
        let values = [&of_log["session"]["precision"][key], &of_room["circles"][0][key]].map(Value::as_f64);
        let [Some(of_log), Some(of_room)] = values else { panic!("{key}: {values:?}") };
        assert!((of_log - of_room).abs() < 1e-9 && of_log > 0.02, "{key}: {of_log} {of_room}");
    }
    let table = run(&["reproduce", "8.2", "--study", log.to_str().unwrap()]);
    assert!(table.code == Some(0) && table.out.contains("one session"), "{table:?}");
    assert_eq!(view.end(), Some(0));
}

/// What is refused is not written, and the recorded page goes on.
#[test]
fn wrong_requests_are_not_recorded() {
    let directory = tempfile::tempdir().unwrap();
    let (view, log) = record(directory.path(), "corner.toml");
    let corner = text("corner.toml");
    let begin = json!({ "room": { "t": 0, "text": corner } });
    let look = |t: f64| json!({ "events": [{ "look": { "t": t } }] });
    assert_eq!(send(&view, "a", &look(1.0)).0, 422, "no room yet");
    assert_eq!(send(&view, "a", &begin).0, 200);
    assert_eq!(send(&view, "a", &look(5.0)).0, 200);
    let written = fs::read_to_string(&log).unwrap();
    let many: Value = (0..513).map(|_| json!({ "look": { "t": 6 } })).collect();
    let names: Value = (0..129).map(|i| json!(i.to_string())).collect();
    for (status, why, rest) in [
        (400, "version 1", json!({ "version": 2 })),
        (400, "unknown field", json!({ "action": "move" })),
        (400, "unknown variant", json!({ "events": [{ "move": { "t": 6, "piece": "chair" } }] })),
        (400, "unknown field", json!({ "events": [{ "look": { "t": 6, "piece": "chair" } }] })),
        (400, "malformed", json!({ "events": [{ "look": { "t": null } }] })),
        (
            400,
            "malformed",
            json!({ "events": [{ "eye": { "t": 6, "at": [0, 0], "direction": [0, 0, -1] } }] }),
        ),
        (400, "session", json!({ "session": "" })),
        (413, "at most 512 events", json!({ "events": many })),
        (413, "longer than", json!({ "session": "a".repeat(1 << 20) })),
        (413, "512 KiB", json!({ "room": { "t": 6, "text": "#".repeat(600 << 10) } })),
        (422, "the time 4.9 is before 5", look(4.9)),
        (422, "is before", json!({ "room": { "t": 1, "text": corner.replace("[5, 5]", "[5, 6]") } })),
        (422, "is before", json!({ "events": [{ "look": { "t": 7 } }, { "look": { "t": 6 } }] })),
        (
            422,
            "not in a room",
            json!({ "events": [{ "eye": { "t": 6, "at": [0, 0, 1e9], "direction": [0, 0, -1] } }] }),
        ),
        (422, "at most 128", json!({ "events": [{ "chosen": { "t": 6, "pieces": names } }] })),
        (422, "room.toml", json!({ "room": { "t": 6, "text": "version = 1" } })),
        (409, "another page", json!({ "session": "b", "room": { "t": 6, "text": corner } })),
    ] {
        let (code, answer) = send(&view, "a", &rest);
        let said = answer["why"].as_str().unwrap_or_default();
        let shown: String = rest.to_string().chars().take(120).collect();
        assert!(code == status && said.contains(why), "{shown}: {code} {answer}");
    }
    for (status, headers) in view.hostile_headers() {
        let (host, path) = view.parts();
        let body = json!({ "version": 1, "session": "a", "events": [{ "look": { "t": 6 } }] }).to_string();
        let request = View::post_request(&format!("{path}study"), host, &headers, &body);
        assert_eq!(view.raw(&request).0, status, "{headers}");
    }
    assert_eq!(fs::read_to_string(&log).unwrap(), written);
    assert_eq!(send(&view, "a", &look(5.0)).0, 200);
    assert_eq!(view.end(), Some(0));
    assert_eq!(measure(&kept("corner.toml"), Some(&log))["session"]["actions"], json!({ "look": 2 }));

    // A log is written over by nothing, and a log without a session does not stay.
    let beyond = directory.path().join("none/log.jsonl");
    for (path, why) in
        [(&log, "--study"), (&log, "there is such a file already"), (&beyond, "does not exist")]
    {
        let ran = run(&["studio", "--study", path.to_str().unwrap()]);
        assert!(ran.code == Some(2) && ran.err.contains(why) && ran.err.contains("fix: "), "{ran:?}");
    }
    let unused = directory.path().join("unused.jsonl");
    let view = View::start(&["studio", "--study", unused.to_str().unwrap()]);
    assert!(unused.exists());
    assert_eq!(view.end(), Some(0));
    assert!(!unused.exists());

    let view = View::start(&["studio", &kept("corner.toml")]);
    let (status, answer) = send(&view, "a", &begin);
    assert!(status == 422 && answer["why"].as_str().unwrap().contains("--study"), "{answer}");
    assert!(view.post_to("begin", &json!({ "version": 1 }).to_string()).1["study"].is_null());
}

/// Returns what the page says about a recording, as far as it can be seen on the screen.
fn said(browser: &mut Browser) -> String {
    let shown = "(() => { const e = document.getElementById('recorded'); const r = e.getBoundingClientRect(); \
                 return r.width > 50 && r.height > 10 && r.left >= 0 && r.right <= innerWidth && r.top >= 0 ? e.textContent : ''; })()";
    browser.evaluate(shown).as_str().unwrap().to_owned()
}

fn stands(browser: &mut Browser, at: [i32; 2], turn: u8) {
    let is = format!("(({{ at, turn }}) => String([...at, turn]) === '{},{},{turn}')", at[0], at[1]);
    browser.until(&format!("{SETTLED} && {is}(window.studio.room.piece('chair'))"));
}

#[test]
fn the_page_says_that_it_is_recorded_and_what_is_done_is_in_the_log() {
    let directory = tempfile::tempdir().unwrap();
    let (view, log) = record(directory.path(), "corner.toml");
    let Some(mut browser) = open(&view, None) else { return };
    stands(&mut browser, [5, 5], 0);
    for (width, height) in [(400, 760), (800, 700), (1440, 900)] {
        let screen = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        browser.call("Emulation.setDeviceMetricsOverride", screen);
        assert_eq!(said(&mut browser), "● recorded in log.jsonl", "{width}");
        assert_eq!(number(&mut browser, "document.documentElement.scrollWidth"), width);
        assert_eq!(browser.evaluate(include_str!("../src/contrast.js")), json!([]), "{width}");
    }
    let mut connector = |x: i32, y: i32| {
        let place = browser.evaluate(&format!("window.studio.room.plan.project([{x}, {y}])"));
        (place["x"].as_f64().unwrap(), place["y"].as_f64().unwrap())
    };
    let (from, to) = (connector(6, 7), connector(11, 8));
    drag(&mut browser, from, to, "left");
    stands(&mut browser, [10, 6], 0);
    browser.press("t");
    stands(&mut browser, [10, 6], 1);
    browser.press("z");
    stands(&mut browser, [10, 6], 0);
    // A step back is recorded even if a check is going on, and the check does not take it back.
    browser.evaluate("window.studio.room.move([0, 1])");
    stands(&mut browser, [10, 7], 0);
    browser.evaluate("window.studio.room.ask(); window.studio.room.undo()");
    stands(&mut browser, [10, 6], 0);
    // A new piece and its place are one action.
    browser.evaluate("document.getElementById('piece-what').value = 'shape:chair'; document.getElementById('piece-add').requestSubmit()");
    browser.until(&format!("{SETTLED} && window.studio.room.room.pieces.length === 3"));
    assert_eq!(browser.evaluate("window.studio.room.chosen"), json!(["chair 1"]));
    browser.press("n");
    browser.press("+");
    browser.press("+");
    browser.until(SETTLED);
    let is_seen = || {
        let text = fs::read_to_string(&log).unwrap();
        text.rsplit_once("\"look\"").is_some_and(|(_, after)| after.contains("\"eye\""))
    };
    assert!(wait_until(WATCHDOG, is_seen), "the eye is noted after it was moved");
    let session = measure(&kept("corner.toml"), Some(&log))["session"].clone();
    let mut actions = session["actions"].clone();
    // Two gestures, if there was a pause between both keys.
    assert!(actions.as_object_mut().unwrap().remove("look").is_some_and(|n| n == 1 || n == 2), "{session}");
    assert_eq!(
        actions,
        json!({ "create": 1, "deselect": 2, "select": 3, "move": 3, "turn": 2 }),
        "{session}"
    );
    assert!(
        session["samples"].as_u64().unwrap() > 0 && session["path_m"].as_f64().unwrap() > 0.5,
        "{session}"
    );
    let (edge, chair) = (0.11, &session["pieces"]["chair"]["centre"]);
    let place = browser.evaluate("(({ at, form, turn }) => at.map((v, i) => v + (window.studio.room.room.forms[form].turns[turn].size[i] - 1) / 2))(window.studio.room.piece('chair'))");
    for axis in [0, 1] {
        let (recorded, shown) = (chair[axis].as_f64().unwrap(), place[axis].as_f64().unwrap() * edge);
        assert!((recorded - shown).abs() < 1e-9, "{recorded} {shown}");
    }
    check_clean(&mut browser, &view);

    // Another page is not recorded, and says so.
    let Some(mut other) = open(&view, Some((400, 760))) else { return };
    other.until("document.getElementById('recorded').dataset.on === 'false'");
    assert!(said(&mut other).starts_with("not recorded: another page is recorded"), "{}", said(&mut other));
}

#[test]
fn nothing_is_recorded_or_shown_without_the_option() {
    let view = View::start(&["studio", &kept("corner.toml")]);
    let Some(mut browser) = open(&view, None) else { return };
    browser.until(SETTLED);
    browser.evaluate("window.studio.room.choose(['chair']); window.studio.room.move([1, 0])");
    stands(&mut browser, [6, 5], 0);
    assert_eq!(browser.evaluate("document.getElementById('recorded').hidden"), json!(true));
    assert!(!browser.loaded.iter().any(|url| url.ends_with("/study")), "{:?}", browser.loaded);
    check_clean(&mut browser, &view);
}
