//! `metamorph studio` over plain HTTP: what its page can ask for, and what others cannot.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::run;
use metamorph_tests::view::View;
use metamorph_world_controller::console::stopwatch::wait_until;
use serde_json::{Value, json};
use std::fs;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::time::Duration;

const WATCHDOG: Duration = Duration::from_secs(240);

/// The chair, with the repair by additions that the recommender offers first.
fn chair() -> Vec<[i16; 3]> {
    let mut cells = vec![[0, 0, 0], [2, 0, 0], [0, 2, 0], [2, 2, 0]];
    cells.extend((0..9).map(|i| [i % 3, i / 3, 1]));
    cells.extend((0..3).map(|x| [x, 2, 2]));
    cells
}

fn ask(view: &View, name: &str, body: Value) -> (u16, Value) {
    let mut body = body;
    body["version"] = json!(1);
    view.post_to(name, &body.to_string())
}

fn analysed(cells: &[[i16; 3]]) -> Value {
    json!({ "session": "a", "revision": 1, "base": null, "add": cells, "remove": [], "all": true })
}

fn start(cells: &[[i16; 3]], family: &str, link: &str) -> Value {
    json!({ "name": "chair", "cells": cells, "family": family, "link": link })
}

/// Waits until the run is over, and returns what is known of it.
fn ended(view: &View) -> Value {
    let mut latest = Value::Null;
    assert!(wait_until(WATCHDOG, || {
        latest = ask(view, "state", json!({})).1["run"].clone();
        latest["going"] == json!(false)
    }));
    latest
}

fn repaired(view: &View) -> Vec<[i16; 3]> {
    let (status, answer) = ask(view, "analyse", analysed(&chair()));
    assert_eq!((status, &answer["d"], &answer["result"]), (200, &json!(4), &json!("analysed")), "{answer}");
    let mut cells = chair();
    for change in answer["repairs"][0]["changes"].as_array().unwrap() {
        cells.push(serde_json::from_value(change["add"].clone()).unwrap());
    }
    cells
}

#[test]
fn a_repaired_chair_is_started_commanded_stopped_and_built() {
    let view = View::start(&["studio", "--modules", "24"]);
    let cells = repaired(&view);
    let (_, answer) = ask(&view, "analyse", analysed(&cells));
    assert_eq!((&answer["d"], &answer["families"][0]["can"]), (&json!(0), &json!(true)), "{answer}");
    assert_eq!(ask(&view, "begin", json!({})).1["modules"], json!(24));
    let root = view.parts().1.to_owned();
    assert_eq!(view.get(&format!("{root}run/"), "").0, 404);
    assert_eq!(ask(&view, "stop", json!({})).0, 409);

    let (status, answer) = ask(&view, "start", start(&cells, "cube", "ipc"));
    assert_eq!(status, 200, "{answer}");
    assert_eq!(ask(&view, "start", start(&cells, "cube", "sim")).0, 409, "one run at a time");
    assert_eq!(view.get(&format!("{root}run/scene"), "").0, 200);
    let command = json!({ "version": 1, "session": "s", "n": 1, "commands": ["pause 0"] });
    let (status, answer) = view.post_to("run/command", &command.to_string());
    assert!(status == 200 || status == 202, "{answer}");
    assert_eq!(ask(&view, "stop", json!({})).0, 200);
    let run = ended(&view);
    assert_eq!(run["outcome"], json!("aborted"), "{run}");

    assert_eq!(ask(&view, "start", start(&cells, "cube", "sim")).0, 200);
    assert_eq!(ask(&view, "stop", json!({})).0, 200);
    assert_eq!(ended(&view)["link"], json!("sim"));
    assert_eq!(ask(&view, "start", start(&cells, "cube", "ipc")).0, 200);
    let run = ended(&view);
    assert_eq!(
        (&run["outcome"], &run["run"], &run["link"]),
        (&json!("built"), &json!(3), &json!("ipc")),
        "{run}"
    );
    assert_eq!(view.end(), Some(0));
}

/// Ctrl-C ends a run that is going on, and everything that it left behind.
#[test]
fn the_studio_ends_with_its_run() {
    let view = View::start(&["studio"]);
    assert_eq!(ask(&view, "start", start(&repaired(&view), "cube", "ipc")).0, 200);
    assert_eq!(view.end(), Some(0));
}

#[test]
fn a_drawing_of_chains_is_built_by_metamodules_too() {
    let view = View::start(&["studio"]);
    let tower: Vec<[i16; 3]> = (0..8).map(|i| [i % 2, 0, i / 2]).collect();
    let (_, answer) = ask(&view, "analyse", analysed(&tower));
    let families = answer["families"].as_array().unwrap();
    assert!(families.len() == 2 && families.iter().all(|f| f["can"] == true), "{answer}");
    let mut wanted = start(&tower, "metamodule", "sim");
    wanted["only_scenario"] = json!(true);
    let (status, answer) = ask(&view, "start", wanted);
    assert!(status == 200 && answer["scenario"].as_str().unwrap().contains("levels"), "{answer}");
    // A chair has feet for too few of them.
    let (status, answer) = ask(&view, "start", start(&chair(), "metamodule", "sim"));
    assert!(status == 422 && answer["why"].as_str().unwrap().contains("chains of four"), "{answer}");
}

#[test]
fn files_are_opened_and_saved_in_the_directory_only() {
    let (outside, inside) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let secret = outside.path().join("secret.toml");
    fs::write(&secret, "version = 1\ncells = [[7, 7, 7]]\n").unwrap();
    symlink(&secret, inside.path().join("link.toml")).unwrap();
    symlink(outside.path(), inside.path().join("out")).unwrap();
    let view = View::start(&["studio", "--dir", inside.path().to_str().unwrap()]);
    let save = |name: &str, replace: bool| {
        ask(&view, "save", json!({ "name": name, "cells": chair(), "replace": replace }))
    };
    assert_eq!(save("chair.toml", false).0, 200);
    assert_eq!(save("chair.toml", false).0, 409);
    assert_eq!(save("chair.toml", true).0, 200);
    let names =
        ["", "../x.toml", "/tmp/x.toml", "out/x.toml", ".x.toml", "a b.toml", "chair", "ä.toml", "x.toml\0"];
    for name in names {
        assert_eq!(save(name, true).0, 422, "{name:?}");
    }
    assert_eq!(save(&format!("{}.toml", "a".repeat(59)), false).0, 200);
    assert_eq!(save(&format!("{}.toml", "b".repeat(60)), false).0, 422);
    assert_eq!(save("link.toml", true).0, 200);
    assert!(fs::read_to_string(&secret).unwrap().contains("7, 7, 7"), "what the link names is as it was");
    let opened = |name: &str| ask(&view, "open", json!({ "name": name }));
    let (status, answer) = opened("chair.toml");
    assert_eq!((status, answer["opened"]["cells"].as_array().unwrap().len()), (200, 16));
    symlink(&secret, inside.path().join("again.toml")).unwrap();
    for name in ["again.toml", "out/secret.toml", "../secret.toml", "none.toml", "out", "/etc/passwd"] {
        let (status, answer) = opened(name);
        assert!(status == 422 && !answer.to_string().contains("7,7,7"), "{name}: {answer}");
    }
    // Pins are kept, and those of no module refused.
    let pinned =
        |name: &str, pins: Value| ask(&view, "save", json!({ "name": name, "cells": chair(), "pins": pins }));
    assert_eq!(pinned("pins.toml", json!([[[1, 0, 1], [0, 0, 1]]])).0, 200);
    assert_eq!(opened("pins.toml").1["opened"]["pins"], json!([[[0, 0, 1], [1, 0, 1]]]));
    for pins in [json!([[[0, 0, 1], [2, 0, 1]]]), json!([[[0, 0, 1], [0, 0, 2]]])] {
        let (status, answer) = pinned("bad.toml", pins);
        assert!(status == 422 && answer["why"].as_str().unwrap().contains("pin"), "{answer}");
    }
    // What the page sends needs no directory.
    let hex: String = b"version = 1\ncells = [[0, 0, 0]]\n".iter().map(|b| format!("{b:02x}")).collect();
    assert_eq!(ask(&view, "open", json!({ "name": "a.toml", "content": hex })).0, 200);
    for (name, content) in
        [("a.toml", "zz"), ("a.toml", "0"), ("../a.toml", &hex), ("a.exe", &hex), ("a.stl", &hex)]
    {
        let (status, answer) = ask(&view, "open", json!({ "name": name, "content": content }));
        assert!(status == 422 && !answer.to_string().contains("/tmp/"), "{name}: {answer}");
    }
    // A voxel at [1, 2, 3] of a model of MagicaVoxel.
    let vox = "564f582096000000\
        4d41494e000000002c000000\
        53495a450c00000000000000040000000400000004000000\
        58595a49080000000000000001000000\
        01020301";
    let (status, answer) = ask(&view, "open", json!({ "name": "a.vox", "content": vox }));
    assert_eq!((status, &answer["opened"]["cells"]), (200, &json!([[1, 2, 3]])), "{answer}");
    let (status, answer) = ask(&view, "open", json!({ "name": "a.vox", "content": &vox[..80] }));
    assert!(status == 422 && answer["why"].as_str().unwrap().contains("a.vox: byte"), "{answer}");
    assert!(!Path::new("/tmp/x.toml").exists());
    drop(view);
    let view = View::start(&["studio"]);
    assert_eq!(
        ask(&view, "save", json!({ "name": "a.toml", "cells": chair() })).0,
        422,
        "there is no directory"
    );
    assert_eq!(ask(&view, "open", json!({ "name": "chair.toml" })).0, 422);
}

#[test]
fn wrong_command_lines_are_refused() {
    for (args, part) in [
        (vec!["studio", "none.toml"], "none.toml"),
        (vec!["studio", "--dir", "/nowhere"], "/nowhere"),
        (vec!["studio", "Cargo.lock"], "Cargo.lock"),
        (vec!["studio", "--modules", "0"], "--modules"),
    ] {
        let ran = run(&args);
        assert!(ran.code == Some(2) && ran.err.contains(part), "{ran:?}");
    }
}

/// What programs of other users and pages of other servers can send to the studio.
#[test]
fn hostile_requests_have_no_effect() {
    let inside = tempfile::tempdir().unwrap();
    let view = View::start(&["studio", "--dir", inside.path().to_str().unwrap()]);
    let (host, root) = view.parts();
    let mut good = start(&chair(), "cube", "ipc");
    good["version"] = json!(1);
    let good = good.to_string();
    let (post, all, headers) = (View::post_request, view.headers().concat(), view.hostile_headers());
    for name in ["start", "stop", "save", "open", "analyse", "room", "begin", "state"] {
        for (expected, headers) in &headers {
            // What a body says is looked at after everything else.
            let (status, answer) = view.raw(&post(&format!("{root}{name}"), host, headers, &good));
            assert_eq!(status, *expected, "{name}, {headers}: {answer}");
        }
        for other in ["evil.example", "127.0.0.1", "127.0.0.1:1"] {
            assert_eq!(view.raw(&post(&format!("{root}{name}"), other, &all, &good)).0, 403);
        }
        for method in ["PUT", "DELETE", "OPTIONS", "PATCH", "GET", "HEAD"] {
            let request = post(&format!("{root}{name}"), host, &all, &good).replacen("POST", method, 1);
            let status = view.raw(&request).0;
            assert!(status == 405 || status == 404, "{method} {name}: {status}");
        }
    }
    for path in
        ["/start", "/x/start", &format!("{root}Start"), &format!("{root}start/"), &format!("{root}run/start")]
    {
        assert_eq!(view.raw(&post(path, host, &all, &good)).0, 404, "{path}");
    }
    bodies_are_checked(&view, &good);
    assert!(ask(&view, "state", json!({})).1["run"].is_null(), "nothing was started");
    assert_eq!(fs::read_dir(inside.path()).unwrap().count(), 0, "nothing was written");
    assert_eq!(view.end(), Some(0));
}

fn bodies_are_checked(view: &View, good: &str) {
    let many: Vec<[i16; 3]> = (0..20_001).map(|i| [i % 150, i / 150, 0]).collect();
    let deep = format!("{{\"version\":1,\"cells\":{}1{}}}", "[".repeat(9_000), "]".repeat(9_000));
    for (name, expected, body) in [
        ("start", 400, String::new()),
        ("start", 400, "null".to_owned()),
        ("start", 400, deep),
        ("start", 400, good.replace("\"version\":1", "\"version\":2")),
        ("start", 400, good.replace("\"name\"", "\"names\"")),
        ("start", 400, good.replace("\"ipc\"", "\"rpc\"")),
        ("start", 400, good.replace("[0,0,0]", "[0,0,99999]")),
        ("start", 422, good.replace("\"cube\"", "\"cubes\"")),
        ("start", 422, good.replace("\"chair\"", "\"a\\nb = 1\"")),
        ("start", 422, good.replace("\"chair\"", "\"\"")),
        ("start", 422, good.replace("[0,0,0]", "[90,0,0]")),
        ("start", 422, good.replace("[0,0,0]", "[0,0,32000]")),
        (
            "start",
            413,
            json!({ "version": 1, "name": "a", "cells": many, "family": "cube", "link": "sim" }).to_string(),
        ),
        (
            "analyse",
            413,
            json!({ "version": 1, "session": "a", "revision": 1, "base": null, "add": many }).to_string(),
        ),
        ("analyse", 400, json!({ "version": 1, "session": "", "revision": 1, "base": null }).to_string()),
        ("analyse", 409, json!({ "version": 1, "session": "z", "revision": 2, "base": 1 }).to_string()),
        ("analyse", 413, format!("{{\"version\":1,\"session\":\"{}\"}}", "a".repeat(1 << 20))),
        ("open", 413, "x".repeat((1 << 20) + 1)),
    ] {
        let (status, answer) = view.post_to(name, &body);
        assert_eq!(status, expected, "{name} {}: {answer}", &body[..body.len().min(120)]);
    }
    // A body that does not come is not waited for.
    let (host, root) = view.parts();
    let mut slow = TcpStream::connect(host).unwrap();
    slow.set_read_timeout(Some(WATCHDOG)).unwrap();
    let head = format!(
        "POST {root}start HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nAuthorization: Bearer {}\r\n\
         Content-Type: application/json\r\nContent-Length: 9\r\nConnection: close\r\n\r\n{{",
        view.secret
    );
    slow.write_all(head.as_bytes()).unwrap();
    let mut answer = String::new();
    slow.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 408"), "{answer}");
}

/// The secret is in no command line and in no environment, which other users could read.
#[test]
fn the_secret_is_in_no_command_line() {
    let view = View::start(&["studio"]);
    let line = fs::read(format!("/proc/{}/cmdline", view.process.id())).unwrap();
    assert!(!String::from_utf8_lossy(&line).contains(&view.secret) && view.secret.len() == 32);
}
