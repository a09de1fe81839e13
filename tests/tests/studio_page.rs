//! The page of `metamorph studio` in a real browser: from nothing to a structure that processes have built, with the
//! mouse, with the keyboard alone and by touch. Where there is no browser, the tests are skipped with a message.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]
#![allow(clippy::print_stdout, reason = "says what was measured")]

use metamorph_tests::browser::Browser;
use metamorph_tests::studio::{check_clean, drag, enter, middle, number, open, press_with_shift};
use metamorph_tests::view::View;
use metamorph_world_controller::console::stopwatch::Stopwatch;
use serde_json::json;

const SETTLED: &str = "window.studio.analyst.settled";
const BUILT: &str = "document.getElementById('run-state').dataset.outcome === 'built'";

/// Returns where the page shows a place of the drawing.
fn spot(browser: &mut Browser, at: [f64; 3]) -> (f64, f64) {
    let place = browser.evaluate(&format!("window.studio.space.project({at:?})"));
    (place["x"].as_f64().unwrap(), place["y"].as_f64().unwrap())
}

const CELLS: &str = "window.studio.structure.cells.size";

/// Checks what the page shows of the run that has been started: processes have built it.
fn check_built(browser: &mut Browser) {
    browser.until(BUILT);
    browser.until(
        "document.querySelector('iframe').contentDocument.getElementById('outcome').textContent === 'built'",
    );
    let modules = number(browser, "Number(document.getElementById('run').dataset.modules)");
    assert!(modules > 18, "{modules}");
}

#[test]
fn a_chair_is_drawn_repaired_and_built_in_five_clicks() {
    let view = View::start(&["studio"]);
    let since = Stopwatch::start();
    let Some(mut browser) = open(&view, None) else { return };
    let chair = middle(&mut browser, ".card");
    browser.click(chair.0, chair.1);
    browser.until(&format!("{SETTLED} && {CELLS} === 23"));
    assert_eq!(number(&mut browser, "window.studio.panel.answer.d"), 1);
    // A cube on the middle of the back, by its upper face.
    let face = spot(&mut browser, [0.0, 1.0, 4.5]);
    browser.click(face.0, face.1);
    browser.until(&format!("{SETTLED} && {CELLS} === 24 && window.studio.structure.has([0, 1, 5])"));
    let repair = middle(&mut browser, ".repair.first");
    browser.click(repair.0, repair.1);
    browser.until(&format!("{SETTLED} && window.studio.panel.answer.d === 0"));
    assert_eq!(
        browser.evaluate("document.getElementById('verdict').dataset.state"),
        json!("good"),
        "every cube has a partner"
    );
    let start = middle(&mut browser, "#start");
    browser.click(start.0, start.1);
    check_built(&mut browser);
    println!("from the browser's start to `built`: {:.1} s", since.elapsed().as_secs_f64());
    let back = middle(&mut browser, "#back");
    browser.click(back.0, back.1);
    assert_eq!(browser.evaluate("document.getElementById('run').hidden"), json!(true));
    check_clean(&mut browser, &view);
}

#[test]
fn the_same_with_the_keyboard_alone() {
    let view = View::start(&["studio"]);
    let since = Stopwatch::start();
    let Some(mut browser) = open(&view, None) else { return };
    enter(&mut browser);
    browser.until(&format!("{SETTLED} && {CELLS} === 23"));
    // The cursor begins in the middle of the highest layer.
    for key in ["ArrowUp", "ArrowUp", "PageUp"] {
        browser.press(key);
    }
    enter(&mut browser);
    browser.until(&format!("{SETTLED} && {CELLS} === 24"));
    assert_eq!(browser.evaluate("window.studio.structure.has([0, 1, 5])"), json!(true));
    browser.press("Delete");
    browser.until(&format!("{SETTLED} && {CELLS} === 23"));
    browser.press("z");
    browser.until(&format!("{SETTLED} && {CELLS} === 24"));
    browser.press("r");
    browser.until(&format!("{SETTLED} && window.studio.panel.answer.d === 0"));
    browser.press("g");
    check_built(&mut browser);
    println!("from the browser's start to `built`: {:.1} s", since.elapsed().as_secs_f64());
    check_clean(&mut browser, &view);
}

#[test]
fn the_same_by_touch_on_a_small_screen() {
    let view = View::start(&["studio"]);
    let since = Stopwatch::start();
    let Some(mut browser) = open(&view, Some((375, 667))) else { return };
    let wide = number(&mut browser, "document.documentElement.scrollWidth");
    assert!(wide <= 375, "{wide} pixels");
    let chair = middle(&mut browser, ".card");
    browser.tap(chair);
    browser.until(&format!("{SETTLED} && {CELLS} === 23"));
    let face = spot(&mut browser, [0.0, -1.0, 2.5]);
    browser.tap(face);
    browser.until(&format!("{SETTLED} && {CELLS} === 24 && window.studio.structure.has([0, -1, 3])"));
    // Two fingers turn the picture, and draw nothing.
    let before = browser.evaluate("window.studio.space.camera.position.toArray()");
    let fingers = |step: i32| [0.0, 100.0].map(|x| (100.0 + x + f64::from(step) * 8.0, 200.0 + x * 0.4));
    browser.swipe(&[0, 1, 2, 3, 4, 5].map(fingers));
    assert_ne!(browser.evaluate("window.studio.space.camera.position.toArray()"), before);
    assert_eq!(number(&mut browser, CELLS), 24);
    let repair = middle(&mut browser, ".repair.first");
    browser.tap(repair);
    browser.until(&format!("{SETTLED} && window.studio.panel.answer.d === 0"));
    let start = middle(&mut browser, "#start");
    browser.tap(start);
    check_built(&mut browser);
    println!("from the browser's start to `built`: {:.1} s", since.elapsed().as_secs_f64());
    check_clean(&mut browser, &view);
}

#[test]
fn cubes_are_drawn_mirrored_chosen_copied_and_taken_back() {
    let view = View::start(&["studio"]);
    let Some(mut browser) = open(&view, None) else { return };
    browser.press("Escape");
    browser.until(&format!("{SETTLED} && {CELLS} === 0"));
    let at = |browser: &mut Browser, cell: [f64; 3]| spot(browser, cell);
    // A click between two cubes hits one of them.
    browser.evaluate("window.studio.structure.open([[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1]], 'wall')");
    let between = "[...Array(99)].map((_, i) => window.studio.space.project([0.5, (i - 49) / 100, 1.5])).map(({ x, y }) => window.studio.space.pick(x, y)) \
        .filter((hit) => !hit?.onCube || window.studio.structure.has(hit.at)).length";
    assert_eq!(number(&mut browser, between), 0);
    browser.press("z");
    browser.until(&format!("{SETTLED} && {CELLS} === 0"));
    // A rectangle on the floor, and a part of it away by the right button.
    let (from, to) = (at(&mut browser, [-1.0, -1.0, -0.5]), at(&mut browser, [1.0, 0.0, -0.5]));
    drag(&mut browser, from, to, "left");
    browser.until(&format!("{CELLS} === 6"));
    let corner = at(&mut browser, [1.0, -1.0, 0.5]);
    drag(&mut browser, corner, corner, "right");
    browser.until(&format!("{CELLS} === 5 && !window.studio.structure.has([1, -1, 0])"));
    // History is kept as differences, and both views show the same.
    browser.press("z");
    browser.until(&format!("{CELLS} === 6"));
    browser.evaluate("document.getElementById('redo').click()");
    browser.until(&format!("{CELLS} === 5 && {SETTLED}"));
    assert_eq!(number(&mut browser, "window.studio.layer.partner.size"), 4);
    // A mirror through cells and one between cells.
    browser.evaluate("window.studio.structure.open([[0, 0, 0]], 'one')");
    browser.press("x");
    browser.evaluate("window.studio.structure.change([[2, 0, 0]])");
    browser.until(&format!("{CELLS} === 3 && window.studio.structure.has([-2, 0, 0])"));
    browser.press("x");
    browser.evaluate("window.studio.structure.change([[4, 0, 0]])");
    browser.until(&format!("{CELLS} === 5 && window.studio.structure.has([-3, 0, 0])"));
    browser.press("x");
    // Choose, copy, paste, turn, mirror, move.
    browser.evaluate("window.studio.structure.open([[0, 0, 0], [1, 0, 0], [1, 1, 0]], 'corner')");
    browser.press("a");
    browser.press("c");
    browser.evaluate("window.studio.structure.move([5, 0, 0])");
    browser.press("v");
    browser.until(&format!("{CELLS} === 6 && window.studio.structure.has([6, 1, 0])"));
    browser.press("t");
    browser.until(&format!("{CELLS} === 6 && !window.studio.structure.has([5, 0, 0])"));
    browser.press("m");
    browser.press("Delete");
    browser.until(&format!("{CELLS} === 3"));
    // A line with the keyboard, a block of one, and the list of keys.
    browser.evaluate("window.studio.structure.open([], 'empty')");
    browser.press("l");
    for key in ["ArrowRight", "ArrowRight", "ArrowUp"] {
        browser.press(key);
    }
    browser.press("l");
    browser.until(&format!("{CELLS} === 4 && {SETTLED}"));
    browser.press("?");
    browser.until("document.getElementById('keys').open");
    browser.evaluate("document.getElementById('keys').close()");
    // Files come in through the server.
    let text = "version = 1\\ncells = [[5, 5, 5], [6, 5, 5]]\\n";
    browser.evaluate(&format!("window.studio.import(new File(['{text}'], 'two cells.toml'))"));
    browser.until(&format!("{CELLS} === 2 && {SETTLED} && window.studio.structure.has([0, 0, 0])"));
    check_clean(&mut browser, &view);
}

const PINS: &str = "window.studio.structure.pins.size / 2";

/// Pins by tool, keyboard and module; they cost a module, are given up, move with their cubes, and are saved.
#[test]
fn modules_are_pinned_and_the_pins_that_forbid_a_pairing_are_given_up() {
    let directory = tempfile::tempdir().unwrap();
    let view = View::start(&["studio", "--dir", directory.path().to_str().unwrap()]);
    let Some(mut browser) = open(&view, None) else { return };
    let is = |browser: &mut Browser, pins: u64, d: u64| {
        browser.until(&format!("{SETTLED} && {PINS} === {pins} && window.studio.panel.answer.d === {d}"));
    };
    browser.press("Escape");
    browser.evaluate("window.studio.structure.open([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], 'line')");
    is(&mut browser, 0, 0);
    // A drag from a cube to the next makes the two inner ones a module, which forbids the outer ones.
    browser.press("0");
    let (from, to) = (spot(&mut browser, [1.0, 0.0, 0.5]), spot(&mut browser, [2.0, 0.0, 0.5]));
    drag(&mut browser, from, to, "left");
    is(&mut browser, 1, 2);
    let verdict = "document.getElementById('verdict-text').textContent";
    assert_eq!(browser.evaluate(verdict), json!("A pin forbids it: 2 cubes left over"));
    browser.press("z");
    is(&mut browser, 0, 0);
    browser.evaluate("document.getElementById('redo').click()");
    is(&mut browser, 1, 2);
    // The button gives it up, as one step that can be taken back; the key does the same.
    let give_up = middle(&mut browser, "#give-up");
    browser.click(give_up.0, give_up.1);
    is(&mut browser, 0, 0);
    browser.press("z");
    is(&mut browser, 1, 2);
    press_with_shift(&mut browser, "R");
    is(&mut browser, 0, 0);
    // A click on a module keeps it as it is, and a second one no longer.
    let cube = spot(&mut browser, [0.0, 0.0, 0.5]);
    drag(&mut browser, cube, cube, "left");
    is(&mut browser, 1, 0);
    assert_eq!(browser.evaluate("window.studio.structure.pinnedTo([0, 0, 0])"), json!([1, 0, 0]));
    drag(&mut browser, cube, cube, "left");
    is(&mut browser, 0, 0);
    // The keyboard: the module at the cursor, and two chosen cubes.
    browser.evaluate("window.studio.structure.move([3, 0, 0])");
    browser.press("k");
    is(&mut browser, 1, 0);
    assert_eq!(browser.evaluate("window.studio.structure.pinnedTo([3, 0, 0])"), json!([2, 0, 0]));
    browser.press("k");
    is(&mut browser, 0, 0);
    browser.evaluate("window.studio.tools.choose([[1, 0, 0], [2, 0, 0]])");
    browser.press("k");
    is(&mut browser, 1, 2);
    press_with_shift(&mut browser, "K");
    is(&mut browser, 0, 0);
    browser.press("Escape");
    // The tool for modules pins what it draws; a cube that goes away takes its pin along, and the tool both cubes.
    browser.press("3");
    browser.evaluate("window.studio.structure.move([6, 0, 0])");
    enter(&mut browser);
    browser.until(&format!("{CELLS} === 6"));
    is(&mut browser, 1, 0);
    browser.evaluate("window.studio.structure.change([], [[6, 0, 1]])");
    is(&mut browser, 0, 1);
    browser.press("z");
    is(&mut browser, 1, 0);
    browser.press("f");
    browser.frames(20);
    let above = spot(&mut browser, [6.0, 0.0, 1.5]);
    drag(&mut browser, above, above, "right");
    browser.until(&format!("{CELLS} === 4"));
    is(&mut browser, 0, 0);
    browser.press("z");
    is(&mut browser, 1, 0);
    // Pins go with their cubes: moved, turned, and copied.
    browser.evaluate("window.studio.tools.choose([[6, 0, 0], [6, 0, 1]])");
    browser.evaluate("window.studio.tools.moveChosen([0, 2, 0])");
    is(&mut browser, 1, 0);
    assert_eq!(browser.evaluate("window.studio.structure.pinnedTo([6, 2, 0])"), json!([6, 2, 1]));
    browser.press("c");
    browser.evaluate("window.studio.structure.move([8, 0, 0])");
    browser.press("v");
    is(&mut browser, 2, 0);
    assert_eq!(browser.evaluate("window.studio.structure.pinnedTo([8, 0, 1])"), json!([8, 0, 0]));
    // Mirrors pin the images, too.
    browser.evaluate("window.studio.structure.open([[0, 0, 0]], 'one')");
    is(&mut browser, 0, 1);
    browser.press("x");
    browser.press("x");
    browser.evaluate("window.studio.tools.put([3, 0, 0])");
    is(&mut browser, 2, 1);
    browser.press("x");
    // What is saved has the pins, and what is opened.
    browser
        .evaluate("window.studio.structure.open([[0, 0, 0], [1, 0, 0]], 'kept', [[[1, 0, 0], [0, 0, 0]]])");
    is(&mut browser, 1, 0);
    browser.evaluate("window.studio.save()");
    browser.until("document.getElementById('hint').textContent === 'kept.toml is saved'");
    let saved = std::fs::read_to_string(directory.path().join("kept.toml")).unwrap();
    assert!(saved.contains("pins = [\n    [[0, 0, 0], [1, 0, 0]],\n]"), "{saved}");
    press_with_shift(&mut browser, "K");
    is(&mut browser, 0, 0);
    browser.evaluate(
        "[...document.querySelectorAll('#files button')].find((b) => b.textContent === 'kept.toml').click()",
    );
    is(&mut browser, 1, 0);
    check_clean(&mut browser, &view);
}

/// Every text has a contrast of at least 4.5 to what is behind it, in light and dark; nothing is wider than the screen.
#[test]
fn texts_can_be_read_at_every_size() {
    let view = View::start(&["studio", "--modules", "6"]);
    let Some(mut browser) = open(&view, None) else { return };
    let check = include_str!("../src/contrast.js");
    for (width, height) in [(1440, 900), (800, 700), (400, 760)] {
        let screen = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        browser.call("Emulation.setDeviceMetricsOverride", screen);
        for theme in ["light", "dark"] {
            browser.evaluate(&format!("window.studio.setTheme('{theme}')"));
            for state in ["welcome()", "close()"] {
                browser.evaluate(&format!("window.studio.{state}"));
                browser.until(SETTLED);
                let low = browser.evaluate(check);
                assert_eq!(low, json!([]), "{width} {theme} {state}");
                let wide = number(&mut browser, "document.documentElement.scrollWidth");
                assert!(wide <= width, "{wide} of {width} pixels");
            }
            browser.evaluate("document.querySelector('.card').click()");
            browser.until(SETTLED);
            assert_eq!(browser.evaluate(check), json!([]), "{width} {theme}, a chair");
        }
    }
    check_clean(&mut browser, &view);
}

/// Prints how long it takes from a click until the modules have been drawn; run it with nothing else on the machine. The
/// page is at rest before each click, as it is for a person.
#[test]
#[ignore = "a measurement"]
fn click_to_redrawn() {
    let view = View::start(&["studio"]);
    let Some(mut browser) = open(&view, None) else { return };
    // Reading a pixel waits until the picture is drawn.
    let hook = "window.times = []; addEventListener('pointerdown', () => { window.begun = performance.now(); }, true); \
        const studio = window.studio; const answered = studio.answered.bind(studio); \
        const gl = studio.space.renderer.getContext(); \
        const drawn = () => { gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); \
            window.times.push(performance.now() - window.begun); window.begun = 0; }; \
        studio.answered = (answer, quick) => { answered(answer, quick); \
            if (window.begun && quick) requestAnimationFrame(drawn); };";
    browser.evaluate(&format!("(() => {{ {hook} }})()"));
    browser.press("Escape");
    for (side, height) in [(10u64, 10u64), (25, 16)] {
        let open = format!(
            "(() => {{ const c = []; for (let z = 0; z < {height}; z++) for (let y = 0; y < {side}; y++) \
             for (let x = 0; x < {side}; x++) c.push([x, y, z]); window.studio.opened({{ name: 'block', cells: c }}); }})()"
        );
        browser.evaluate(&open);
        browser.until(SETTLED);
        browser.evaluate("window.times = []; 0");
        let cells = side * side * height;
        for i in 0..60i32 {
            let (x, y) = (f64::from(i % 7 - 3), f64::from(i / 7 % 7 - 3));
            let at = spot(&mut browser, [x, y, height as f64 - 0.5]);
            browser.frames(20);
            browser.click(at.0, at.1);
            browser.until(&format!("window.times.length === {} && {SETTLED}", i + 1));
            assert_eq!(number(&mut browser, CELLS), cells + i as u64 + 1, "click {i}");
        }
        let mut times: Vec<f64> = serde_json::from_value(browser.evaluate("window.times")).unwrap();
        times.sort_by(f64::total_cmp);
        println!(
            "{cells} cells: median {:.0} ms, 95 % {:.0} ms",
            times[times.len() / 2],
            times[times.len() * 95 / 100]
        );
    }
}
