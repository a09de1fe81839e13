//! The controls of the page of `metamorph view` in a real browser: sections, views, following, notes on the picture, moves,
//! saved pictures, touch, and pages of several widths. Where there is no browser, the tests are skipped with a message.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::browser::Browser;
use metamorph_tests::page::{check_clean, choose, open, scrub, text};
use metamorph_tests::view::View;
use serde_json::{Value, json};

/// Waits until what is seen matches the controls.
fn settle(browser: &mut Browser) {
    browser.until("!window.page.dirty");
}

/// Returns the cells of all parts that are drawn.
const DRAWN: &str = "(() => { const { layers } = window.page.picture; const cells = []; \
    for (const { parts } of layers) for (let at = 0; at < parts.length; at += 16) \
    cells.push([0, 1, 2].map((k) => Math.floor(parts.list[at + k] + (k < 2 ? 0.5 : 0)))); return cells; })()";

fn drawn(browser: &mut Browser) -> Vec<[i64; 3]> {
    let cells = browser.evaluate(DRAWN);
    let cell = |cell: &Value| [0, 1, 2].map(|k: usize| cell[k].as_i64().unwrap());
    cells.as_array().unwrap().iter().map(cell).collect()
}

#[test]
fn sections_and_the_goal_alone_hide_modules() {
    let view = View::of("swarm.toml", &[]);
    let Some(mut browser) = open(&view) else { return };
    scrub(&mut browser, 3e6);
    let all = drawn(&mut browser);
    browser.press("x");
    settle(&mut browser);
    assert_eq!(browser.evaluate("document.getElementById('section').value"), json!("x ≤"));
    let last = |browser: &mut Browser| {
        browser.evaluate("Number(document.getElementById('cut').value)").as_i64().unwrap()
    };
    let plane = last(&mut browser);
    let kept = drawn(&mut browser);
    assert!(!kept.is_empty() && kept.len() < all.len());
    assert_eq!(kept.len(), all.iter().filter(|cell| cell[0] <= plane).count());
    // A module behind the plane is not picked.
    let picked = "(() => { const { picture } = window.page; const id = picture.poses.findIndex((p) => \
        Math.round(p[0]) > Number(document.getElementById('cut').value)); const [x, y, z] = picture.poses[id]; \
        return [id, picture.pick({ origin: [x + 0.01, y + 0.013, z + 50], direction: [1e-9, 1e-9, -1] })]; })()";
    let picked = browser.evaluate(picked);
    assert_ne!(picked[0], json!(-1));
    assert_ne!(picked[0], picked[1]);
    browser.press("PageDown");
    settle(&mut browser);
    assert_eq!(last(&mut browser), plane - 1);
    let figure = browser.evaluate("window.page.figure().section");
    assert_eq!(figure, json!(format!("x<={}", plane - 1)));
    // The other side, and then none.
    browser.press("x");
    settle(&mut browser);
    let (kept, plane) = (drawn(&mut browser), last(&mut browser));
    assert_eq!(kept.len(), all.iter().filter(|cell| cell[0] >= plane).count());
    for _ in 0..5 {
        browser.press("x");
    }
    settle(&mut browser);
    assert_eq!(drawn(&mut browser).len(), all.len());

    browser.press("o");
    settle(&mut browser);
    let goal = browser.evaluate("window.page.story.scene.goals[0].cells");
    let is_goal = |cell: &[i64; 3]| {
        goal.as_array().unwrap().iter().any(|c| (0..3).all(|k| c[k].as_i64() == Some(cell[k])))
    };
    let kept = drawn(&mut browser);
    assert!(kept.iter().all(is_goal));
    assert_eq!(kept.len(), all.iter().filter(|cell| is_goal(cell)).count());
    assert_eq!(browser.evaluate("window.page.figure().only"), json!("goal"));
    check_clean(&mut browser, &view);
}

#[test]
fn views_turn_the_picture_and_follow_a_module() {
    let view = View::of("swarm.toml", &[]);
    let Some(mut browser) = open(&view) else { return };
    let name = "document.getElementById('view').value";
    assert_eq!(browser.evaluate(name), json!("corner"));
    // Where the axes point in the picture, to the right and up.
    let axes = "(() => { const { right, up } = window.page.camera.axes(); \
        return [0, 1, 2].map((i) => [Math.round(right[i]) + 0, Math.round(up[i]) + 0]); })()";
    for (view, seen) in [
        ("above", [[1, 0], [0, 1], [0, 0]]),
        ("front", [[1, 0], [0, 0], [0, 1]]),
        ("right", [[0, 0], [1, 0], [0, 1]]),
        ("back", [[-1, 0], [0, 0], [0, 1]]),
        ("left", [[0, 0], [-1, 0], [0, 1]]),
    ] {
        browser.press("v");
        settle(&mut browser);
        assert_eq!(browser.evaluate(name), json!(view));
        assert_eq!(browser.evaluate(axes), json!(seen), "{view}");
    }
    browser.press("ArrowLeft");
    settle(&mut browser);
    assert_eq!(browser.evaluate(name), json!(""), "turned, it is none of them");
    // In parallel projection nothing gets smaller with its distance.
    let last_row =
        "(() => { const m = window.page.camera.matrix(); return [3, 7, 11, 15].map((i) => m[i]); })()";
    assert_ne!(browser.evaluate(last_row), json!([0, 0, 0, 1]));
    browser.press("l");
    settle(&mut browser);
    assert_eq!(browser.evaluate(last_row), json!([0, 0, 0, 1]));
    // A ray through a body in the picture hits it, in both projections.
    let hit = "(() => { const { camera, picture } = window.page; const m = camera.matrix(); \
        const id = picture.poses.reduce((a, p, i) => p[2] > picture.poses[a][2] ? i : a, 0); \
        const [x, y, z] = picture.poses[id]; \
        const c = [0, 1, 3].map((i) => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i]); \
        const found = picture.pick(camera.ray(c[0] / c[2], c[1] / c[2])); \
        const seen = (i) => { const { out } = camera.eye(); return picture.poses[i].slice(0, 3).reduce((s, v, k) => s + v * out[k], 0); }; \
        return found !== null && seen(found) >= seen(id) - 1e-6; })()";
    assert_eq!(browser.evaluate(hit), json!(true));
    browser.press("l");
    settle(&mut browser);
    assert_eq!(browser.evaluate(hit), json!(true));

    choose(&mut browser, 5);
    browser.press("c");
    let offset = "(() => { const { camera, picture } = window.page; \
        return Math.hypot(...camera.target.map((x, k) => x - picture.poses[5][k])); })()";
    for at in [1e6, 4e6, 7e6] {
        scrub(&mut browser, at);
        assert!(browser.evaluate(offset).as_f64().unwrap() < 1e-6);
    }
    browser.press("Escape");
    settle(&mut browser);
    assert_eq!(browser.evaluate("document.getElementById('follow').disabled"), json!(true));
    check_clean(&mut browser, &view);
}

#[test]
fn moves_are_listed_and_notes_are_drawn() {
    let view = View::of("swarm.toml", &[]);
    let Some(mut browser) = open(&view) else { return };
    // Moves under way, of all modules.
    browser.evaluate(
        "{ const { story } = window.page; const m = story.modules.findIndex((m) => m.doings.length > 2); \
        window.mover = m; window.page.seek(story.modules[m].doings[2].t + 1e3, true); }",
    );
    settle(&mut browser);
    assert_eq!(text(&mut browser, "[data-part=moves-title]"), "moves under way");
    assert!(
        browser.evaluate("document.querySelectorAll('[data-part=moves] li').length").as_u64().unwrap() >= 1
    );
    // The last ones of a module; their times go there.
    browser.evaluate("window.page.choose(window.mover)");
    settle(&mut browser);
    assert_eq!(text(&mut browser, "[data-part=moves-title]"), "last moves");
    assert_eq!(browser.evaluate("document.querySelectorAll('[data-part=moves] li').length"), json!(3));
    browser.evaluate("document.querySelectorAll('[data-part=moves] li')[2].querySelector('button').click()");
    settle(&mut browser);
    let first = browser.evaluate("window.page.t === window.page.story.modules[window.mover].doings[0].t");
    assert_eq!(first, json!(true));
    // While the run is played, the messages of the module follow it.
    browser.evaluate(
        "{ window.asked = 0; const { story } = window.page; const ask = story.messagesOf.bind(story); \
        story.messagesOf = (id, t) => { window.asked++; return ask(id, t); }; window.page.setSpeed(0.1); }",
    );
    browser.press(" ");
    browser.until("window.page.playing && window.asked > 2");
    browser.press(" ");

    let written = "(() => { const c = document.getElementById('overlay'); \
        return c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some((x) => x > 0); })()";
    settle(&mut browser);
    assert_eq!(browser.evaluate(written), json!(true));
    let hidden = "['overlay', 'stamp'].map((id) => document.getElementById(id).hidden)";
    assert_eq!(browser.evaluate(hidden), json!([false, false]));
    browser.press("a");
    settle(&mut browser);
    assert_eq!(browser.evaluate(hidden), json!([true, true]));
    assert_eq!(
        browser.evaluate("[window.page.figure().axes, window.page.figure().title ?? null]"),
        json!(["off", null])
    );
    // The picture as it is, with twice the pixels and the legend below.
    let saved = "window.page.screen().then(async ({ name, content }) => { const picture = await createImageBitmap(content); \
        const space = document.getElementById('space'); \
        return [name.startsWith('swarm-'), name.endsWith('s.png'), picture.width === 2 * space.clientWidth, \
        picture.height > 2 * space.clientHeight]; })";
    assert_eq!(browser.evaluate(saved), json!([true, true, true, true]));
    check_clean(&mut browser, &view);
}

/// Turns, moves, zooms and chooses with fingers.
#[test]
fn fingers_turn_zoom_and_choose() {
    let view = View::of("swarm.toml", &[]);
    let Some(mut browser) = open(&view) else { return };
    size(&mut browser, 375, 667);
    browser.call("Emulation.setTouchEmulationEnabled", json!({ "enabled": true, "maxTouchPoints": 2 }));
    let middle = browser.evaluate(
        "(() => { const b = document.getElementById('space').getBoundingClientRect(); \
        return [b.left + b.width / 2, b.top + b.height / 2]; })()",
    );
    let (x, y) = (middle[0].as_f64().unwrap(), middle[1].as_f64().unwrap());
    let look = |browser: &mut Browser| {
        browser.until("!window.page.dirty");
        let seen =
            browser.evaluate("[window.page.camera.azimuth, window.page.camera.distance, window.page.chosen]");
        (seen[0].as_f64().unwrap(), seen[1].as_f64().unwrap(), seen[2].as_u64())
    };
    let before = look(&mut browser);
    browser.swipe(&[0.0, 30.0, 60.0].map(|by| [(x + by, y)]));
    let turned = look(&mut browser);
    assert!((turned.0 - before.0).abs() > 0.1 && turned.2.is_none(), "{before:?} {turned:?}");
    browser.swipe(&[20.0, 50.0, 80.0].map(|by| [(x - by, y), (x + by, y)]));
    let near = look(&mut browser);
    assert!(near.1 < turned.1 * 0.7, "{turned:?} {near:?}");
    // A tap on a body that stands in the middle of the picture.
    browser.evaluate("{ const { camera, picture } = window.page; camera.moveTo(picture.poses.reduce((a, p) => (p[2] > a[2] ? p : a)).slice(0, 3)); }");
    settle(&mut browser);
    browser.tap((x, y));
    browser.until("window.page.chosen !== null");
    check_clean(&mut browser, &view);
}

fn size(browser: &mut Browser, width: u32, height: u32) {
    let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600 });
    browser.call("Emulation.setDeviceMetricsOverride", size);
    browser.until(&format!("window.innerWidth === {width}"));
    // The page is told of its size in a frame, and drawn in the next one.
    let frames = "new Promise((done) => { let n = 0; const tick = () => (++n > 3 ? done(n) : requestAnimationFrame(tick)); tick(); })";
    browser.evaluate(frames);
    settle(browser);
}

/// The texts with too little contrast to what is behind them, and their contrast. What is disabled is exempt.
const TOO_FAINT: &str = "(() => { \
    const probe = document.createElement('canvas').getContext('2d', { willReadFrequently: true }); \
    const read = (css) => { probe.clearRect(0, 0, 1, 1); probe.fillStyle = css; probe.fillRect(0, 0, 1, 1); \
        return [...probe.getImageData(0, 0, 1, 1).data]; }; \
    const light = (rgb) => { const [r, g, b] = rgb.map((c) => { const x = c / 255; \
        return x <= 0.03928 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4; }); return 0.2126 * r + 0.7152 * g + 0.0722 * b; }; \
    const contrast = (a, b) => { const [x, y] = [light(a), light(b)].sort((p, q) => q - p); return (x + 0.05) / (y + 0.05); }; \
    const behind = (e) => { for (; e; e = e.parentElement) { const c = read(getComputedStyle(e).backgroundColor); \
        if (c[3] === 255) return c.slice(0, 3); } return [255, 255, 255]; }; \
    const faint = []; \
    for (const e of document.querySelectorAll('body *')) { \
        const said = [...e.childNodes].filter((n) => n.nodeType === 3 && n.textContent.trim()); \
        if (!said.length || e.matches(':disabled, :disabled *, option, script') || !e.checkVisibility()) continue; \
        const ratio = contrast(read(getComputedStyle(e).color).slice(0, 3), behind(e)); \
        if (ratio < 4.5) faint.push([e.tagName, e.id, said[0].textContent, ratio.toFixed(2)].join(' ')); } \
    const root = getComputedStyle(document.documentElement); const tone = (name) => read(root.getPropertyValue(name)).slice(0, 3); \
    for (const [ink, paper] of [['--ink', '--sky'], ['--axis-x', '--sky'], ['--axis-y', '--sky'], ['--axis-z', '--sky'], \
        ['--ink', '--paper'], ['--soft', '--paper']]) { const ratio = contrast(tone(ink), tone(paper)); \
        if (ratio < 4.5) faint.push(`${ink} on ${paper} ${ratio.toFixed(2)}`); } \
    return faint; })()";

/// Elements that are cut off at the right, and controls that cannot be reached.
const CUT_OFF: &str = "(() => { const off = []; \
    for (const e of document.querySelectorAll('body *')) { const b = e.getBoundingClientRect(); \
        if (b.width > 0 && b.right > innerWidth + 1) off.push(`${e.tagName} ${e.id} ${Math.round(b.right)}`); } \
    if (document.documentElement.scrollWidth > innerWidth) off.push('the page scrolls sideways'); \
    if (document.getElementById('space').clientHeight < 200) off.push('the picture is low'); return off; })()";

#[test]
fn the_page_fits_and_its_texts_can_be_read() {
    let view = View::of("swarm.toml", &["--kill", "4@2s"]);
    let Some(mut browser) = open(&view) else { return };
    browser.press("End");
    choose(&mut browser, 3);
    for (width, height) in [(1440, 900), (800, 900), (400, 800), (375, 667)] {
        size(&mut browser, width, height);
        for open in ["false", "true"] {
            browser.evaluate(&format!("document.getElementById('shown').open = {open}"));
            settle(&mut browser);
            assert_eq!(browser.evaluate(CUT_OFF), json!([]), "{width} pixels, controls open: {open}");
        }
    }
    for theme in [1, 2] {
        for meaning in ["1", "3"] {
            browser.press(meaning);
            settle(&mut browser);
            assert_eq!(browser.evaluate(TOO_FAINT), json!([]), "theme {theme}, colours {meaning}");
        }
        browser.press("?");
        browser.until("document.getElementById('keys').open");
        assert_eq!(browser.evaluate(TOO_FAINT), json!([]), "list of keys, theme {theme}");
        browser.evaluate("document.getElementById('keys').close()");
        browser.press("d");
    }
    check_clean(&mut browser, &view);
}
