//! The page of `metamorph view`: what a user sees and does in a real browser. Where there is no browser, the tests
//! are skipped with a message.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]
#![allow(clippy::print_stdout, reason = "figures are shown with --nocapture")]

use metamorph_protocol::metamodule::Metamodule;
use metamorph_protocol::metamodule::message::{Action, BodyAction};
use metamorph_protocol::time::Time;
use metamorph_tests::browser::{Browser, find};
use metamorph_tests::command::{run, scenario};
use metamorph_tests::page::{check_clean, choose, micros, open, scrub, text};
use metamorph_tests::view::{View, record};
use metamorph_world_controller::family::metamodule::Metamodules;
use metamorph_world_controller::family::read_file;
use metamorph_world_controller::scenario::{LinkKind, Overrides};
use metamorph_world_controller::view::parts::Part;
use metamorph_world_controller::view::visible::Visible;
use serde_json::{Value, json};
use std::fs;

#[test]
fn commands_a_run_in_progress() {
    let Some(program) = find() else { return };
    let file = scenario("swarm.toml").display().to_string();
    let view =
        View::start(&["run", &file, "--link", "sim", "--time-scale", "1", "--view", "--control", "--quiet"]);
    let mut browser = Browser::start(program);
    browser.open(&format!("{}#c={}", view.address, view.secret));
    browser.until("document.body.dataset.state === 'paused'");
    assert_eq!(browser.evaluate("location.hash"), json!(""), "the secret leaves the address");
    choose(&mut browser, 3);
    browser.evaluate("document.querySelector('[data-command=kill]').click()");
    browser.until("document.getElementById('answer').textContent.startsWith('kill 3: taken')");
    browser.until(
        "window.page.story.faults.some((f) => f.what === 'kill 3' && f.effect.startsWith('operator 1'))",
    );
    browser.evaluate("document.querySelector('[data-command=resume]').click()");
    browser.until("document.getElementById('answer').textContent === 'resume 3: module 3 is not paused'");
    browser.until("window.page.story.over");
    browser.until("document.querySelector('[data-command=kill]').disabled");
    check_clean(&mut browser, &view);
    // The first address only shows the run.
    browser.open(&view.address);
    browser.until("document.body.dataset.state === 'paused'");
    assert_eq!(browser.evaluate("document.getElementById('commands').hidden"), json!(true));
}

/// Presses a key that has a meaning of its own for the browser.
fn key(browser: &mut Browser, key: &str, code: u32, text: &str) {
    for (kind, text) in [("keyDown", text), ("keyUp", "")] {
        let how =
            json!({ "type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code, "text": text });
        browser.call("Input.dispatchKeyEvent", how);
    }
}

/// Commands with parameters, to a module and to the run, on a small screen and with the keyboard.
#[test]
fn commands_have_fields_for_their_parameters() {
    let Some(program) = find() else { return };
    let file = scenario("box.toml").display().to_string();
    let options = [
        "--link",
        "sim",
        "--time-scale",
        "1",
        "--set",
        "protocol.strategy=slope",
        "--view",
        "--control",
        "--quiet",
    ];
    let view = View::start(&[&["run", &file], &options[..]].concat());
    let mut browser = Browser::start(program);
    let screen = json!({ "width": 400, "height": 760, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", screen);
    browser.open(&format!("{}#c={}", view.address, view.secret));
    browser.until("document.body.dataset.state === 'paused'");
    choose(&mut browser, 1);
    let beyond = "[...document.querySelectorAll('.command, .command *')].filter((e) => { \
        const r = e.getBoundingClientRect(); return r.width && (r.left < 0 || r.right > 400); }).map((e) => e.outerHTML)";
    assert_eq!(browser.evaluate(beyond), json!([]));
    assert_eq!(browser.evaluate("document.documentElement.scrollWidth"), json!(400));
    assert_eq!(browser.evaluate(include_str!("../src/contrast.js")), json!([]));

    // The fields are reached with Tab, filled and sent.
    browser.evaluate("document.getElementById('unchoose').focus()");
    let is_there = "document.activeElement === document.querySelector('[data-command=goto]').form.querySelector('input')";
    for _ in 0..20 {
        key(&mut browser, "Tab", 9, "");
        if browser.evaluate(is_there) == json!(true) {
            break;
        }
    }
    for digit in ["4", "5", "0", "9"] {
        browser.press(digit);
        if digit != "9" {
            key(&mut browser, "Tab", 9, "");
        }
    }
    key(&mut browser, "Enter", 13, "\r");
    browser
        .until("document.getElementById('answer').textContent.startsWith('goto 1 [4, 5, 0] for 9s: taken')");
    browser.until("window.page.story.faults.some((f) => f.what.startsWith('goto 1'))");

    // Each is understood; what is refused is refused by a rule of the run.
    let verbs = browser.evaluate("window.page.story.scene.commands.map((c) => c.verb)");
    for verb in verbs.as_array().unwrap() {
        browser.evaluate(&format!("document.querySelector('[data-command={verb}]').form.requestSubmit()"));
        browser.until("!document.getElementById('answer').textContent.endsWith(': pending')");
        let answer = text(&mut browser, "#answer");
        assert!(answer.starts_with(verb.as_str().unwrap()), "{verb}: {answer}");
        let is_understood = !answer.contains("is no fault") && !answer.contains("is no command");
        assert!(is_understood && !answer.contains("malformed"), "{answer}");
    }
    assert!(verbs.as_array().unwrap().len() > 15, "{verbs}");
    check_clean(&mut browser, &view);
}

/// The level of autonomy disables what it refuses, and the page says why.
#[test]
fn commands_that_the_level_refuses_cannot_be_pressed() {
    let Some(program) = find() else { return };
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("full.toml");
    let chair = fs::read_to_string(scenario("chair.toml")).unwrap();
    fs::write(&file, chair + "\n[operator]\nkind = \"person\"\nlevel = \"full\"\n").unwrap();
    let options = ["--link", "sim", "--time-scale", "1", "--view", "--control", "--quiet"];
    let view = View::start(&[&["run", file.to_str().unwrap()], &options[..]].concat());
    let mut browser = Browser::start(program);
    browser.open(&format!("{}#c={}", view.address, view.secret));
    browser.until("document.body.dataset.state === 'paused'");
    choose(&mut browser, 1);
    let disabled = |verb: &str| format!("document.querySelector('[data-command={verb}]').disabled");
    for (verb, expected) in [("hold", true), ("release", true), ("kill", false), ("loss", false)] {
        assert_eq!(browser.evaluate(&disabled(verb)), json!(expected), "{verb}");
    }
    assert!(text(&mut browser, "#commands .refused").contains("level = \"full\""));
    assert_eq!(browser.evaluate(include_str!("../src/contrast.js")), json!([]));
    check_clean(&mut browser, &view);
}

/// Requests of the swarm are shown with the time left, and answered with a key and by a button.
#[test]
fn requests_of_a_swarm_are_shown_and_answered() {
    let Some(program) = find() else { return };
    let directory = tempfile::tempdir().unwrap();
    let corpus =
        scenario("chair.toml").with_file_name("../../tests/corpus/metamodule-led-out-of-a-knot.toml");
    let knot = fs::read_to_string(corpus).unwrap();
    let asks = "[protocol]\nask = \"always\"\nanswer_within = \"300s\"\n";
    let file = directory.path().join("asks.toml");
    fs::write(&file, knot.replace("[protocol]\n", asks)).unwrap();
    let file = file.to_str().unwrap();
    let options = ["--link", "sim", "--time-scale", "25", "--view", "--control", "--quiet"];
    let view = View::start(&[&["run", file], &options[..]].concat());
    let mut browser = Browser::start(program);
    browser.open(&format!("{}#c={}", view.address, view.secret));
    browser.until("document.body.dataset.state === 'paused'");
    browser.until("!document.getElementById('requests').hidden");
    let shown = text(&mut browser, "#requests li");
    let left: f64 = shown.split_once("; ").unwrap().1.split(' ').next().unwrap().parse().unwrap();
    assert!(shown.contains("asks whether to plan for all") && (1.0..=300.0).contains(&left), "{shown}");
    assert_eq!(browser.evaluate(include_str!("../src/contrast.js")), json!([]));
    browser.press("r");
    browser.until("/^release \\d+: taken/.test(document.getElementById('answer').textContent)");
    browser.until("document.getElementById('requests').hidden");
    check_clean(&mut browser, &view);
    // A page that only looks shows the request of that time, without a way to answer it.
    browser.open(&view.address);
    browser.until("document.body.dataset.state === 'paused'");
    let at = "(() => { const { story } = window.page; const all = story.modules.flatMap((m) => m.standings); \
        const t = Math.min(...all.filter((s) => s.flags & 16).map((s) => s.t)); window.page.seek(t, true); return t; })()";
    assert!(browser.evaluate(at).as_f64().unwrap() > 0.0);
    browser.until("!document.getElementById('requests').hidden");
    assert_eq!(browser.evaluate("document.querySelectorAll('[data-answer]').length"), json!(0));
}

#[test]
fn plays_a_chair_to_its_end() {
    let directory = tempfile::tempdir().unwrap();
    let view = View::start(&["view", &record(directory.path(), "chair.toml", &[])]);
    let Some(mut browser) = open(&view) else { return };
    assert_eq!(text(&mut browser, "#title"), "chair");
    assert_eq!(text(&mut browser, "#outcome"), "built");
    assert_eq!(micros(&mut browser), 0.0);

    // The canvas is not empty: pixels have several colours.
    let colours = "(() => { const c = document.getElementById('space'); const d = document.createElement('canvas'); \
        d.width = 64; d.height = 64; window.page.show(); const p = d.getContext('2d'); p.drawImage(c, 0, 0, 64, 64); \
        const all = p.getImageData(0, 0, 64, 64).data; const seen = new Set(); \
        for (let i = 0; i < all.length; i += 4) seen.add(all.slice(i, i + 3).join()); return seen.size; })()";
    assert!(browser.evaluate(colours).as_u64().unwrap() > 20);

    // Plays and pauses.
    browser.press(" ");
    browser.until(
        "document.body.dataset.state === 'playing' && document.getElementById('time').dataset.micros > 0",
    );
    browser.press(" ");
    browser.until("document.body.dataset.state === 'paused'");
    let paused = micros(&mut browser);
    let frames = "new Promise((done) => { let n = 0; const tick = () => (++n > 5 ? done(n) : requestAnimationFrame(tick)); tick(); })";
    browser.evaluate(frames);
    assert_eq!(micros(&mut browser), paused);

    // Steps forward and back.
    browser.press(".");
    let next = micros(&mut browser);
    assert!(next > paused);
    browser.press(".");
    assert!(micros(&mut browser) > next);
    browser.press(",");
    assert_eq!(micros(&mut browser), next);

    // Goes to the position of the scrubber.
    scrub(&mut browser, 60_000_000.0);
    assert_eq!(micros(&mut browser), 60_000_000.0);
    let filled = text(&mut browser, "[data-part=numbers] dd");
    assert!(filled.ends_with("/ 6") && !filled.starts_with("6"), "{filled}");

    // Plays to the end and stops there.
    browser.press("Home");
    assert_eq!(micros(&mut browser), 0.0);
    browser.evaluate("{ const s = document.getElementById('speed'); s.value = '128'; s.dispatchEvent(new Event('change')); }");
    browser.press(" ");
    browser.until("document.body.dataset.state === 'paused' && window.page.t === window.page.story.now");
    assert_eq!(text(&mut browser, "[data-part=numbers] dd"), "6 / 6");
    for id in 0..6 {
        choose(&mut browser, id);
        let said = text(&mut browser, "[data-part=module-facts]");
        assert!(said.contains("settled in seed") && said.contains("alive"), "{said}");
        browser.until("document.querySelectorAll('[data-part=module-facts] .messages li .when').length > 3");
    }
    // Every cell of the chair has a cube in it, by the kinematics of the page.
    let missing = "(() => { const p = window.page.picture; const places = p.poses.flat(); \
        const cubes = places.filter((_, i) => i % 7 === 0).map((_, i) => places.slice(7 * i, 7 * i + 3)); \
        return p.goals[0].cells.filter(([x, y, z]) => \
        !cubes.some((c) => Math.hypot(c[0] - x, c[1] - y, c[2] - z - 0.5) < 1e-6)).length; })()";
    assert_eq!(browser.evaluate(missing), json!(0));

    // A click chooses the module that is drawn there.
    browser.press("Escape");
    let place = browser.evaluate(
        "(() => { const { page } = window; const box = document.getElementById('space').getBoundingClientRect(); \
         const m = page.camera.matrix(); const [x, y, z] = page.picture.poses[3].slice(6 * 7); \
         const c = [0, 1, 2, 3].map((i) => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i]); \
         return [box.left + (c[0] / c[3] + 1) / 2 * box.width, box.top + (1 - c[1] / c[3]) / 2 * box.height]; })()",
    );
    browser.click(place[0].as_f64().unwrap(), place[1].as_f64().unwrap());
    browser.until("!window.page.dirty && document.getElementById('module').dataset.id !== undefined && !document.getElementById('module').hidden");
    check_clean(&mut browser, &view);
    drop(browser);
    assert_eq!(view.end(), Some(0));
}

/// The figure that is saved is what the page shows, and the line that is told makes the same one.
#[test]
fn saves_a_figure_of_what_is_shown() {
    let directory = tempfile::tempdir().unwrap();
    let journal = record(directory.path(), "swarm.toml", &[]);
    let view = View::start(&["view", &journal]);
    let Some(mut browser) = open(&view) else { return };
    scrub(&mut browser, 3_300_000.0);
    browser.evaluate("{ const box = document.getElementById('waits'); box.checked = true; window.page.camera.orbit(0.4, 0.1); window.page.setMeaning('gradient'); }");
    browser.press("s");
    browser.until("document.getElementById('saving').open");
    let told = text(&mut browser, "#render");
    let words: Vec<&str> = told.split_whitespace().collect();
    let from = words.iter().position(|word| *word == "…").unwrap() + 1;
    let until = words.iter().position(|word| *word == "--out").unwrap();
    for part in ["--at 3.3s", "--color gradient", "--goal ghost", "--links waits", "--width 85mm"] {
        assert!(told.contains(part), "{told}");
    }
    let ran = run(&[&["render", &journal][..], &words[from..until]].concat());
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let saved = "import('./figure.js').then((m) => m.fetchFigure(window.page.figure(), 'svg')).then((f) => f.content.text())";
    assert_eq!(browser.evaluate(saved).as_str().unwrap(), ran.out);
    // The browser gets a file with a name.
    browser.evaluate("{ HTMLAnchorElement.prototype.click = function () { window.saved = this.download; } }");
    browser.evaluate("document.querySelector('#saving button[value=save]').click()");
    browser.until("window.saved !== undefined");
    assert_eq!(browser.evaluate("window.saved"), json!("swarm-3.3s.svg"));
    // What cannot be drawn is said.
    browser.evaluate("{ const width = document.getElementById('width'); width.add(new Option('1px')); width.value = '1px'; }");
    browser.press("s");
    browser.evaluate("document.querySelector('#saving button[value=save]').click()");
    browser.until("!document.getElementById('note').hidden");
    let note = text(&mut browser, "#note");
    assert!(note.contains("The figure cannot be saved: ") && note.contains("100px to 20000px"), "{note}");
    drop(browser);
    assert_eq!(view.end(), Some(0));
}

/// What the page computes between two frames is what everything else that draws bodies gets.
#[test]
fn parts_move_on_the_page_as_they_do_in_the_program() {
    let view = View::of("chair.toml", &[]);
    let Some(mut browser) = open(&view) else { return };
    let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
    let plan = read_file(&scenario("chair.toml"), &overrides).unwrap();
    let swarm = plan.swarm.of::<Metamodules>().unwrap();
    let (setup, place) = (&*swarm.setup, &swarm.poses[1]);
    let numbers = |parts: &[Part]| -> Vec<f64> {
        let pose = |p: &Part| [p.centre().as_slice(), p.pose.rotation.coords.as_slice()].concat();
        parts.iter().flat_map(pose).collect()
    };
    let rest = numbers(&Metamodule::at_rest(setup, place));
    // The page has taken the same from the scene.
    let close = |page: &Value, own: &[f64], about: &str| {
        let page: Vec<f64> = page.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
        let off = page.iter().zip(own).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(page.len() == own.len() && off < 1e-9, "{about}: {page:?}, not {own:?}");
    };
    close(&browser.evaluate("window.page.story.modules[1].first.poses"), &rest, "at the start");
    let mut turned = 0;
    for number in 0..setup.motions.table().steps().len() as u16 {
        let action = Action { body_action: BodyAction::Turn(number), not_after: Time::ZERO };
        let Some((motion, _)) = Metamodule::motion(setup, place, &action) else { continue };
        turned += 1;
        for fraction in [0.0, 0.2, 0.5, 0.9, 1.0] {
            let own = numbers(&Metamodule::parts(setup, place, Some((&action, fraction))));
            let ask = format!(
                "import('./parts.js').then(({{ carried }}) => carried({}, {}[2], {fraction}))",
                json!(rest),
                motion.to_json()
            );
            close(&browser.evaluate(&ask), &own, &format!("{motion:?} at {fraction}"));
        }
    }
    assert!(turned > 2, "{turned}");
    check_clean(&mut browser, &view);
}

#[test]
fn a_killed_module_is_shown_as_dead_and_a_stopped_one_as_paused() {
    let view = View::of("swarm.toml", &["--pause", "7@3s..6s"]);
    let Some(mut browser) = open(&view) else { return };
    let pattern = |id: u32| format!("window.page.picture.layers[0].parts.list[{id} * 16 + 11]");
    for (at, id, life, drawn) in [
        (1.0, 41, "alive", 0),
        (2.5, 41, "dead", 1),
        (2.5, 7, "alive", 0),
        (4.0, 7, "paused", 2),
        (7.0, 7, "alive", 0),
        (7.0, 41, "dead", 1),
    ] {
        scrub(&mut browser, at * 1e6);
        choose(&mut browser, id);
        assert_eq!(
            browser.evaluate("document.getElementById('module').dataset.life"),
            json!(life),
            "{id} at {at} s"
        );
        assert_eq!(browser.evaluate(&pattern(id)), json!(drawn), "{id} at {at} s");
    }
    let faults = text(&mut browser, "[data-part=faults]");
    assert!(faults.contains("kill 41") && faults.contains("pause 7"), "{faults}");
    check_clean(&mut browser, &view);
}

#[test]
fn messages_locks_and_gradients_of_a_thousand_modules_are_shown() {
    let view = View::of("slab-to-sphere.toml", &[]);
    let Some(mut browser) = open(&view) else { return };
    scrub(&mut browser, 60e6);
    browser.press("m");
    browser.until("window.page.picture.links.length > 1000 * 13");
    browser.press("m");
    for (key, meaning) in [("2", "level"), ("3", "gradient"), ("4", "locks"), ("1", "state")] {
        browser.press(key);
        browser.until(&format!(
            "!window.page.dirty && document.getElementById('meaning').value === '{meaning}'"
        ));
        let colours = "new Set([...Array(1058).keys()].map((i) => \
                       [...window.page.picture.layers[0].parts.list.slice(i * 16 + 8, i * 16 + 11)].join())).size";
        browser.until(&format!("{colours} >= 3"));
    }
    // Modules that wait for each other while others move are not at a standstill, and no circle is drawn.
    let circle = "[...Array(149).keys()].some((s) => { window.page.seek(s * 1e6, true); window.page.show(); \
                  return document.body.dataset.circle !== ''; })";
    assert_eq!(browser.evaluate(circle), Value::Bool(false));
    // Dark, if the user's system asks for that.
    let dark = json!({ "features": [{ "name": "prefers-color-scheme", "value": "dark" }] });
    browser.call("Emulation.setEmulatedMedia", dark);
    browser.until("document.documentElement.dataset.theme === 'dark'");
    check_clean(&mut browser, &view);
}

/// At the end of a run that stands still the page gives the reason, and draws the waiting modules.
#[test]
fn a_deadlock_is_drawn_and_explained() {
    // With the published gradient no module is led.
    let gradient = ["--set", "protocol.connectivity=gradient"];
    let kills = [&gradient[..], &["--kill", "4@5s", "--kill", "22@5s", "--kill", "30@12s"]].concat();
    let file = scenario("swarm.toml").display().to_string();
    let waits = |report: &Value| {
        let waiting = report["unbuilt"]["waiting"].as_array();
        report["outcome"] == "deadlock"
            && waiting.is_some_and(|w| w.iter().any(|w| !w["waits_for"].is_null()))
    };
    let seed = (0..200).map(|seed| seed.to_string()).find(|seed| {
        let fixed = ["run", &file, "--link", "sim", "--seed", seed, "--quiet", "--json", "-"];
        waits(&serde_json::from_str(&run(&[&fixed, &kills[..]].concat()).out).unwrap())
    });
    let seed = seed.expect("a module that holds a dead one waits for ever");
    let view = View::of("swarm.toml", &[&["--seed", &seed], &kills[..]].concat());
    let Some(mut browser) = open(&view) else { return };
    browser.press("End");
    browser.until("!window.page.dirty && window.page.t === window.page.story.now");
    assert_eq!(text(&mut browser, "#outcome"), "deadlock");
    let said = text(&mut browser, "[data-part=why] .waiting");
    let first =
        "(() => { const w = window.page.story.report.unbuilt.waiting[0]; return `${w.module} ${w.why}`; })()";
    let first = browser.evaluate(first);
    assert!(said.starts_with(first.as_str().unwrap()), "{said}, not {first}");
    assert_ne!(browser.evaluate("window.page.picture.marks.length"), json!(0));
    assert!(text(&mut browser, "[data-part=legend]").contains("waits for"));
    // Before the end only chosen items are drawn.
    scrub(&mut browser, 1.0);
    assert_eq!(browser.evaluate("window.page.picture.marks.length"), json!(0));
    check_clean(&mut browser, &view);
}

#[test]
fn a_run_of_processes_is_followed_and_its_messages_are_shown_when_it_is_over() {
    let Some(program) = find() else { return };
    let directory = tempfile::tempdir().unwrap();
    let journal = directory.path().join("run.journal").display().to_string();
    let file = scenario("swarm.toml").display().to_string();
    let view = View::start(&["run", &file, "--view", "--quiet", "--journal", &journal]);
    let mut browser = Browser::start(program);
    browser.open(&view.address);
    browser.until("window.page.story.modules.some((m) => m.doings.length > 0)");
    // Messages between modules are not known yet, and not claimed.
    let offered =
        "[...document.getElementById('meaning').options].filter((o) => o.disabled).map((o) => o.value)";
    let over = "document.getElementById('outcome').textContent !== ''";
    let seen = browser.evaluate(offered);
    assert!(seen == json!(["gradient", "locks"]) || browser.evaluate(over) == json!(true), "{seen}");
    // The whole journal replaces the partial data, in the same page at the same time.
    browser.evaluate(
        "window.same = 0; window.back = 0; window.last = 0; \
        const look = () => { const { t } = window.page; if (t < window.last) window.back++; \
        window.last = t; requestAnimationFrame(look); }; look()",
    );
    browser.until("document.getElementById('outcome').textContent === 'built'");
    browser.until("window.page.story.scene.messages && window.page.story.over");
    browser.until("!window.page.dirty && window.page.t === window.page.story.now");
    assert_eq!(browser.evaluate("[window.same, window.back]"), json!([0, 0]));
    assert_eq!(browser.evaluate(offered), json!([]));
    browser.press("End");
    browser.until("document.querySelector('[data-part=numbers] dd').textContent === '32 / 32'");
    // Bodies are drawn at their places: a refused move has not taken place.
    let filled = "(() => { const { story } = window.page; \
        const middles = new Set(story.scene.goals[0].cells.map(([x, y, z]) => [x, y, z + 0.5].join())); \
        return story.modules.filter((_, id) => \
        middles.has(story.bodyAt(id, story.now).to.poses.slice(0, 3).join())).length; })()";
    assert_eq!(browser.evaluate(filled), json!(32));
    choose(&mut browser, 41);
    assert_eq!(browser.evaluate("document.getElementById('module').dataset.life"), json!("dead"));
    browser.until("document.querySelectorAll('[data-part=module-facts] .messages li .when').length > 3");
    check_clean(&mut browser, &view);
    assert_eq!(view.end(), Some(0));
}

/// The number of colours in the middle of the picture.
const COLOURS: &str = "(() => { const { page } = window; const space = document.getElementById('space'); \
    const canvas = Object.assign(document.createElement('canvas'), { width: 120, height: 90 }); \
    const paint = canvas.getContext('2d'); page.picture.draw(page.camera, page.clock); \
    const [w, h] = [space.width, space.height]; paint.drawImage(space, w / 4, h / 4, w / 2, h / 2, 0, 0, 120, 90); \
    const { data } = paint.getImageData(0, 0, 120, 90); const seen = new Set(); \
    for (let i = 0; i < data.length; i += 4) seen.add((data[i] >> 4 << 8) | (data[i + 1] >> 4 << 4) | (data[i + 2] >> 4)); \
    return seen.size; })()";

/// The picture of every family shows its bodies: simulated, as the journal of processes, and as a plan without a run.
#[test]
fn no_picture_is_of_one_colour() {
    let Some(program) = find() else { return };
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name).display().to_string();
    let walk = ["--set", "goal.0.walk.for=5s"];
    let (loops, plan) = (at("loop.journal"), at("plan.json"));
    let line = scenario("line-to-loop.toml").display().to_string();
    assert_eq!(run(&["run", &line, "--quiet", "--time-scale", "20", "--journal", &loops]).code, Some(0));
    assert_eq!(run(&["plan", "--from", "line:4", "--to", "loop:3x3", "-o", &plan, "--quiet"]).code, Some(0));
    let file = |name: &str| scenario(name).display().to_string();
    let (cubes, chair, quadruped) = (file("swarm.toml"), file("chair.toml"), file("quadruped.toml"));
    let cases: [(&[&str], &str); 6] = [
        (&["view", &cubes], "32 / 32"),
        (&["view", &chair], "6 / 6"),
        (&["view", &line], "4 / 4"),
        // A journal has no report.
        (&["view", &loops], "–"),
        (&[&["view", &quadruped], &walk[..]].concat(), "5 / 5"),
        (&["plan", "--check", &plan, "--view"], "–"),
    ];
    for (command, filled) in cases {
        let view = View::start(command);
        let mut browser = Browser::start(program.clone());
        browser.open(&view.address);
        browser.until(
            "document.body.dataset.state === 'paused' && window.page.story.over && !window.page.dirty",
        );
        // A structure that walks may have left the picture at the end.
        browser.press("Home");
        browser.until("!window.page.dirty");
        let colours = browser.evaluate(COLOURS).as_u64().unwrap();
        assert!(colours > 8, "{command:?}: {colours} colours");
        browser.press("End");
        browser.until("!window.page.dirty");
        assert_eq!(text(&mut browser, "[data-part=numbers] dd"), filled, "{command:?}");
        check_clean(&mut browser, &view);
    }
}

/// Buttons stay where they are while a run goes on, and cannot be pressed after its end.
#[test]
fn nothing_that_is_pressed_moves() {
    let Some(program) = find() else { return };
    let file = scenario("swarm.toml").display().to_string();
    let options = ["--link", "sim", "--time-scale", "3", "--view", "--control", "--quiet"];
    let view = View::start(&[&["run", &file], &options[..]].concat());
    let mut browser = Browser::start(program);
    browser.open(&format!("{}#c={}", view.address, view.secret));
    browser.until("document.body.dataset.state === 'paused'");
    choose(&mut browser, 20);
    // The places of all buttons and fields from now on, each once, until the run is over.
    let places = "new Promise((done) => { const seen = new Map(); const look = () => { \
        for (const e of document.querySelectorAll('.command button, .command input, #find input, #find button')) { \
            const { left, top } = e.getBoundingClientRect(); const name = e.dataset.command ?? e.ariaLabel ?? e.id; \
            seen.set(name, (seen.get(name) ?? new Set()).add(`${left} ${top}`)); } \
        if (window.page.story.over && !window.page.dirty) done([...seen].map(([name, all]) => [name, all.size])); \
        else requestAnimationFrame(look); }; look(); })";
    let places = browser.evaluate(places);
    let places = places.as_array().unwrap();
    assert!(places.len() > 8 && places.iter().all(|place| place[1] == 1), "{places:?}");
    assert_eq!(
        browser.evaluate("document.querySelectorAll('[data-command]:not(:disabled)').length"),
        json!(0)
    );
    check_clean(&mut browser, &view);
}

/// A page that was sent back to an earlier moment stays there while the run goes on and when it ends, also if
/// it was asking what is new at that time.
#[test]
fn the_end_of_a_run_does_not_move_a_page_that_looks_back() {
    let Some(program) = find() else { return };
    let directory = tempfile::tempdir().unwrap();
    let journal = directory.path().join("run.journal").display().to_string();
    let file = scenario("swarm.toml").display().to_string();
    let view = View::start(&["run", &file, "--view", "--quiet", "--journal", &journal]);
    let mut browser = Browser::start(program);
    browser.open(&view.address);
    browser.until("window.page.story.now > 2e6");
    assert_eq!(browser.evaluate("window.page.story.over"), json!(false));
    browser.evaluate(
        "{ const { story } = window.page; const ask = story.ask; story.ask = async (what) => { \
        const answer = await ask(what); if (what.startsWith('events') && !window.lookedBack) { \
        window.page.seek(1.5e6, true); window.lookedBack = true; } return answer; }; }",
    );
    browser.until("window.lookedBack && !window.page.dirty");
    // Every moment that is shown from now on, in words, until the whole journal is there.
    let shown = "new Promise((done) => { const [seen, time] = [new Set(), document.getElementById('time')]; \
        const look = () => { const { story, dirty } = window.page; seen.add(Number(time.dataset.micros)); \
        if (story.over && story.scene.messages && !dirty) done([...seen]); else requestAnimationFrame(look); \
        }; look(); })";
    assert_eq!(browser.evaluate(shown), json!([1_500_000]));
    check_clean(&mut browser, &view);
}

/// While a run goes on modules wait for each other and go on again: that is not a standstill, which is drawn
/// only where a run has ended in a deadlock. Colours show what is known, and nothing before that.
#[test]
fn only_known_facts_are_shown() {
    let directory = tempfile::tempdir().unwrap();
    let view = View::start(&["view", &record(directory.path(), "swarm.toml", &[])]);
    let Some(mut browser) = open(&view) else { return };
    // Two that wait for each other in the middle of a run that is built.
    browser.evaluate(
        "{ const { modules } = window.page.story; const t = 5e6; \
        for (const [a, b] of [[3, 4], [4, 3]]) { \
        modules[a].standings = [{ t, role: 0, flags: 8, place: 0, waits: b }]; } }",
    );
    let seen = "(() => { const { page } = window; const options = { meaning: 'state', messages: false, waits: false, \
        goal: true, chosen: null, classes: [] }; const seen = page.picture.build(10e6, options); \
        return [seen.circle.size, page.picture.marks.length, seen.arrows]; })()";
    assert_eq!(browser.evaluate(seen), json!([0, 0, false]));
    // Before a module has reported, its state is not shown.
    scrub(&mut browser, 2e6);
    let legend = text(&mut browser, "[data-part=legend]");
    assert!(legend.contains("not heard of yet"), "{legend}");
    choose(&mut browser, 3);
    let facts = text(&mut browser, "[data-part=module]");
    assert!(facts.contains("not heard of yet") && !facts.contains("waits for"), "{facts}");
    // While messages are loaded, colours by them say so.
    let loading = "(() => { const { page } = window; const { story, picture } = page; \
        const talkAt = story.talkAt; story.talkAt = () => null; \
        const options = { meaning: 'gradient', messages: false, waits: false, goal: true, chosen: 3, classes: [] }; \
        const seen = picture.build(10e6, options); page.panel.module(3, 10e6, seen); story.talkAt = talkAt; \
        const facts = document.querySelector('[data-part=module]').textContent; \
        return picture.legend('gradient', seen).map((e) => e.text).concat(facts); })()";
    let said = browser.evaluate(loading);
    assert_eq!(said[0], "loading", "{said}");
    let facts = said[1].as_str().unwrap();
    assert!(
        facts.contains("loading") && !facts.contains("unknown") && !facts.contains("locked bynone"),
        "{facts}"
    );
    check_clean(&mut browser, &view);
}

/// Prints the frame rate of a thousand modules, without a graphics card, and asserts nothing: `cargo test -p
/// metamorph-tests frame_rate -- --ignored --nocapture`
#[test]
#[ignore = "measures, and judges nothing"]
fn frame_rate_of_a_thousand_modules() {
    let view = View::of("slab-to-sphere.toml", &[]);
    let Some(mut browser) = open(&view) else { return };
    scrub(&mut browser, 60e6);
    // The window of the browser is a little larger than the page.
    let size = json!({ "width": 1280, "height": 720, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", size);
    browser.until("window.innerHeight === 720 && !window.page.dirty");
    // Frames as they come, then each of them awaited, so that the processor's share is known.
    let measure = "(async (move) => { const { page } = window; const { gl } = page.renderer; \
        const next = () => new Promise(requestAnimationFrame); const [gaps, js, drawn] = [[], [], []]; \
        const middle = (list) => [...list].sort((a, b) => a - b)[list.length >> 1].toFixed(1); \
        let last = await next(); \
        for (let i = 0; i < 120; i++) { move(); const now = await next(); gaps.push(now - last); last = now; } \
        const late = gaps.slice(60); const size = `${gl.canvas.width}x${gl.canvas.height}`; \
        const pixel = new Uint8Array(4); \
        for (let i = 0; i < 20; i++) { \
            move(); page.stale ||= page.playing; page.t += page.playing ? 1e4 : 0; \
            const a = performance.now(); page.show(); const b = performance.now(); \
            gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel); \
            js.push(b - a); drawn.push(performance.now() - b); } \
        const fps = (60e3 / late.reduce((a, b) => a + b)).toFixed(1); \
        return `${fps} pictures/s of ${size}; of each ${middle(js)} ms scripts, ${middle(drawn)} ms drawing`; })";
    let orbit = "() => window.page.camera.orbit(0.02, 0)";
    let mut say = |what: &str, before: &str, adapt: bool, step: &str| {
        let fixed = if adapt { "" } else { "window.page.adapt = () => {};" };
        browser.evaluate(&format!("{{ delete window.page.adapt; {fixed} {before} }}"));
        browser.until("window.page.seen !== null");
        let figures = browser.evaluate(&format!("{measure}({step})"));
        println!("{what:<30} {}", figures.as_str().unwrap());
    };
    say("turning, all pixels", "", false, orbit);
    say("turning", "", true, orbit);
    say("turning, colours by gradient", "window.page.setMeaning('gradient');", true, orbit);
    say("playing", "window.page.setMeaning('state'); window.page.setPlaying(true);", true, "() => {}");
    println!("load of this machine: {}", fs::read_to_string("/proc/loadavg").unwrap_or_default().trim());
}
