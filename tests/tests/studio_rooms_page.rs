//! Rooms on the page of `metamorph studio` in a real browser: pieces moved with the mouse, with the keyboard and by touch,
//! violations shown, an arrangement proposed and taken, the room saved. Where there is no browser, the tests are skipped.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::browser::Browser;
use metamorph_tests::command::{root, run};
use metamorph_tests::studio::{check_clean, drag, enter, middle, number, open, press_with_shift};
use metamorph_tests::view::View;
use serde_json::{Value, json};
use std::fs;

const SETTLED: &str = "window.studio.room.settled";

fn corner() -> String {
    root().join("deploy/rooms/corner.toml").display().to_string()
}

/// Returns where the page shows a connector of the floor.
fn connector(browser: &mut Browser, x: i32, y: i32) -> (f64, f64) {
    let place = browser.evaluate(&format!("window.studio.room.plan.project([{x}, {y}])"));
    (place["x"].as_f64().unwrap(), place["y"].as_f64().unwrap())
}

/// Waits until a piece stands here and everything about it is known.
fn stands(browser: &mut Browser, piece: &str, at: [i32; 2], turn: u8) {
    let is = format!("(({{ at, turn }}) => String([...at, turn]) === '{},{},{turn}')", at[0], at[1]);
    browser.until(&format!("{SETTLED} && {is}(window.studio.room.piece('{piece}'))"));
}

/// Returns the kinds of constraints that the list shows as violated.
fn violated(browser: &mut Browser) -> Value {
    browser.evaluate(
        "[...document.querySelectorAll('#constraints [data-state=violated] b')].map((b) => b.textContent)",
    )
}

fn text(browser: &mut Browser, id: &str) -> String {
    let text = browser.evaluate(&format!("document.getElementById('{id}').textContent"));
    text.as_str().unwrap().to_owned()
}

#[test]
fn a_room_is_furnished_put_right_saved_and_checked() {
    let directory = tempfile::tempdir().unwrap();
    let view = View::start(&["studio", "--dir", directory.path().to_str().unwrap(), &corner()]);
    let Some(mut browser) = open(&view, None) else { return };
    stands(&mut browser, "chair", [5, 5], 0);
    assert_eq!(
        (violated(&mut browser), text(&mut browser, "room-verdict-text")),
        (json!([]), "No constraint is violated".to_owned())
    );

    // With the mouse: the constraints are judged while the piece is dragged.
    let (from, to) = (connector(&mut browser, 6, 7), connector(&mut browser, 11, 8));
    drag(&mut browser, from, to, "left");
    stands(&mut browser, "chair", [10, 6], 0);
    assert_eq!(violated(&mut browser), json!(["align"]));
    assert_eq!(text(&mut browser, "room-verdict-text"), "1 constraint violated");
    assert!(number(&mut browser, "document.querySelectorAll('#plan .violation').length") > 0);
    let why = browser.evaluate("document.querySelector('#constraints .why').textContent");
    assert_eq!(why, json!("the middles of chair, table differ by 5 cells"));
    assert_eq!(browser.evaluate("document.getElementById('room-start').disabled"), json!(true));

    // With the keyboard: a turn, a step, back to where it was by undo, and again.
    browser.press("t");
    stands(&mut browser, "chair", [10, 6], 1);
    browser.press("ArrowRight");
    stands(&mut browser, "chair", [11, 6], 1);
    browser.press("z");
    stands(&mut browser, "chair", [10, 6], 1);
    browser.evaluate("document.getElementById('redo').click()");
    stands(&mut browser, "chair", [11, 6], 1);
    press_with_shift(&mut browser, "ArrowLeft");
    stands(&mut browser, "chair", [6, 6], 1);
    browser.press("n");
    assert_eq!(browser.evaluate("window.studio.room.chosen"), json!(["table"]));
    press_with_shift(&mut browser, "N");
    assert_eq!(browser.evaluate("window.studio.room.chosen"), json!(["table", "chair"]));

    // An arrangement is proposed, left, proposed again and taken.
    browser.press("p");
    browser.until(&format!("{SETTLED} && window.studio.room.proposal"));
    assert!(text(&mut browser, "proposal-text").contains("the least that puts the room right"));
    assert_eq!(number(&mut browser, "document.querySelectorAll('#plan .ghost').length"), 1);
    browser.press("Escape");
    browser.until("!window.studio.room.proposal");
    let propose = middle(&mut browser, "#put-right");
    browser.click(propose.0, propose.1);
    browser.until(&format!("{SETTLED} && window.studio.room.proposal"));
    browser.evaluate("document.activeElement.blur()");
    enter(&mut browser);
    browser.until(&format!("{SETTLED} && !window.studio.room.proposal"));
    assert_eq!(violated(&mut browser), json!([]));

    // What is saved is a room that keeps its constraints, with its comments.
    browser.press("s");
    browser.until("document.getElementById('room-hint').textContent === 'corner.toml is saved'");
    let saved = directory.path().join("corner.toml");
    let written = fs::read_to_string(&saved).unwrap();
    assert!(written.contains("# the pillar") && written.contains("# A chair at a table"), "{written}");
    assert_ne!(written, fs::read_to_string(corner()).unwrap());
    let ran = run(&["room", saved.to_str().unwrap()]);
    assert!(ran.code == Some(0) && ran.out.contains("no constraint is violated"), "{ran:?}");
    // A right room is started like a drawing, and the page of its run is shown.
    browser.evaluate("document.getElementById('room-link').value = 'sim'");
    browser.press("g");
    browser.until("document.getElementById('run-state').dataset.outcome === 'building'");
    assert_eq!(number(&mut browser, "Number(document.getElementById('run').dataset.modules)"), 11);
    let stop = middle(&mut browser, "#stop");
    browser.click(stop.0, stop.1);
    browser.until("document.getElementById('stop').hidden");
    check_clean(&mut browser, &view);
}

#[test]
fn pieces_and_constraints_are_added_and_taken_out() {
    let view = View::start(&["studio"]);
    let Some(mut browser) = open(&view, None) else { return };
    let empty = middle(&mut browser, ".room-card:last-child");
    browser.click(empty.0, empty.1);
    browser.until(SETTLED);
    // A second piece stands beside the first one, since it is put where it violates nothing; one step takes it back.
    let pieces = "window.studio.room.room.pieces.length";
    for count in [1, 2] {
        browser.evaluate("document.getElementById('piece-what').value = 'shape:chair'; document.getElementById('piece-add').requestSubmit()");
        browser.until(&format!("{SETTLED} && {pieces} === {count}"));
        // Whether metamodules reach it is not looked at when a place is looked for.
        assert!([json!([]), json!(["reach"])].contains(&violated(&mut browser)));
    }
    browser.press("z");
    browser.until(&format!("{SETTLED} && {pieces} === 1"));
    browser.evaluate("document.getElementById('redo').click()");
    browser.until(&format!("{SETTLED} && {pieces} === 2"));
    // A drawing becomes a piece.
    browser.evaluate("window.studio.structure.open([[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 0, 3]], 'pole')");
    browser.evaluate("window.studio.room.panel.what(window.studio.room.room); document.getElementById('piece-what').value = 'drawing'; document.getElementById('piece-add').requestSubmit()");
    browser.until(&format!("{SETTLED} && window.studio.room.piece('piece 1')?.metamodules === 1"));
    browser.evaluate("window.studio.room.rename('pole')");
    browser.until(&format!("{SETTLED} && window.studio.room.piece('pole')"));
    browser.evaluate(
        "window.studio.room.change([{ place: { piece: 'chair 2', at: [4, 6], turn: 0 } }, \
         { place: { piece: 'pole', at: [28, 6], turn: 0 } }])",
    );
    browser.until(&format!("{SETTLED} && window.studio.room.room.violations.length === 0"));
    // Constraints are about what is chosen.
    browser.evaluate("window.studio.room.choose(['chair 1']); window.studio.room.panel.get('constraint-kind').value = 'gap'; window.studio.room.panel.fields()");
    assert_eq!(browser.evaluate("document.getElementById('constraint-add').disabled"), json!(true));
    browser.evaluate("window.studio.room.choose(['chair 1', 'pole']); document.getElementById('constraint-cells').value = 30; document.getElementById('constrain').requestSubmit()");
    browser.until(&format!("{SETTLED} && window.studio.room.room.constraints.some((c) => c.kind === 'gap')"));
    assert_eq!(violated(&mut browser), json!(["gap"]));
    browser.evaluate("document.querySelector('#constraints [data-state=violated] .small').click()");
    browser.until(&format!("{SETTLED} && window.studio.room.room.constraints.at(-1).wish"));
    assert_eq!(text(&mut browser, "room-verdict-text"), "1 wish not fulfilled");
    browser.evaluate("window.studio.room.choose(['pole'])");
    browser.press("Delete");
    browser
        .until(&format!("{SETTLED} && {pieces} === 2 && window.studio.room.room.constraints.length === 4"));
    // A circle of six around the first chair; what is impossible is refused, and the room stays as it was.
    browser.evaluate(
        "window.studio.room.choose(['chair 1']); document.getElementById('arrange').requestSubmit()",
    );
    browser.until(&format!("{SETTLED} && {pieces} === 8"));
    browser.evaluate(
        "document.getElementById('room-width').value = 3; document.getElementById('resize').requestSubmit()",
    );
    browser.until(&format!(
        "{SETTLED} && document.getElementById('note').textContent.includes('is not in the room')"
    ));
    assert_eq!(browser.evaluate("window.studio.room.room.size"), json!([36, 30]));
    // The browser notes the refusal, and nothing else.
    let refusals = browser.complaints.len();
    browser.complaints.retain(|complaint| !complaint.contains("status of 422"));
    assert_eq!(refusals - browser.complaints.len(), 1);
    check_clean(&mut browser, &view);
}

#[test]
fn a_piece_is_moved_by_touch_on_a_small_screen() {
    let view = View::start(&["studio", &corner()]);
    let Some(mut browser) = open(&view, Some((400, 760))) else { return };
    stands(&mut browser, "chair", [5, 5], 0);
    let (from, to) = (connector(&mut browser, 6, 7), connector(&mut browser, 8, 7));
    browser.swipe(&[[from], [to]]);
    stands(&mut browser, "chair", [7, 5], 0);
    let turn = middle(&mut browser, "#piece-turn");
    browser.tap(turn);
    stands(&mut browser, "chair", [7, 5], 1);
    let snap = middle(&mut browser, "#piece-snap");
    browser.tap(snap);
    browser.until(&format!("{SETTLED} && window.studio.room.room.violations.length === 0"));
    check_clean(&mut browser, &view);
}

/// Texts have contrast, and controls fit, at every size.
#[test]
fn rooms_can_be_read_at_every_size() {
    let view = View::start(&["studio", &corner()]);
    let Some(mut browser) = open(&view, None) else { return };
    browser.until(SETTLED);
    let check = include_str!("../src/contrast.js");
    browser.evaluate("window.studio.room.choose(['chair']); window.studio.room.move([6, 1])");
    browser.until(SETTLED);
    browser.evaluate(
        "window.studio.room.putRight(); document.querySelectorAll('details').forEach((d) => (d.open = true))",
    );
    browser.until(&format!("{SETTLED} && window.studio.room.proposal"));
    for (width, height) in [(1440, 900), (800, 700), (400, 760)] {
        let screen = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        browser.call("Emulation.setDeviceMetricsOverride", screen);
        for theme in ["light", "dark"] {
            browser.evaluate(&format!("window.studio.setTheme('{theme}')"));
            assert_eq!(browser.evaluate(check), json!([]), "{width} {theme}");
        }
        let beyond = format!(
            "[...document.querySelectorAll('header *, #room button, #room input, #room select, #room li')].filter((e) => {{ \
             const r = e.getBoundingClientRect(); return r.width && (r.left < -0.5 || r.right > {width}.5); }}).map((e) => e.outerHTML)"
        );
        assert_eq!(browser.evaluate(&beyond), json!([]), "{width}");
        assert_eq!(number(&mut browser, "document.documentElement.scrollWidth"), width);
    }
    check_clean(&mut browser, &view);
}
