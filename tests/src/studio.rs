//! The page of `metamorph studio` in a real browser: what tests of it do again and again.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use crate::browser::{Browser, find};
use crate::view::View;
use serde_json::json;

/// Opens the studio in a browser; `None` where there is none. `size` is that of a touch screen.
pub fn open(view: &View, size: Option<(u32, u32)>) -> Option<Browser> {
    let mut browser = Browser::start(find()?);
    if let Some((width, height)) = size {
        let screen = json!({ "width": width, "height": height, "deviceScaleFactor": 2, "mobile": true });
        browser.call("Emulation.setDeviceMetricsOverride", screen);
        browser.call("Emulation.setTouchEmulationEnabled", json!({ "enabled": true }));
    }
    browser.open(&format!("{}#c={}", view.address, view.secret));
    browser.until("document.body.dataset.state === 'ready'");
    Some(browser)
}

/// Asserts that the page had no errors and loaded nothing from elsewhere, and that the secret has left the address.
pub fn check_clean(browser: &mut Browser, view: &View) {
    assert_eq!(browser.evaluate("location.hash"), json!(""));
    assert_eq!(browser.complaints, Vec::<String>::new());
    let elsewhere = |url: &&String| !url.starts_with(&view.address) && !url.starts_with("data:");
    assert_eq!(browser.loaded.iter().filter(elsewhere).collect::<Vec<_>>(), Vec::<&String>::new());
    assert!(browser.loaded.len() > 10 && !browser.loaded.iter().any(|url| url.contains(&view.secret)));
}

/// Returns the middle of an element.
pub fn middle(browser: &mut Browser, selector: &str) -> (f64, f64) {
    let place = format!(
        "(() => {{ const e = document.querySelector('{selector}'); e.scrollIntoView({{ block: 'nearest' }}); \
         const r = e.getBoundingClientRect(); return [r.left + r.width / 2, r.top + r.height / 2]; }})()"
    );
    let place = browser.evaluate(&place);
    (place[0].as_f64().unwrap(), place[1].as_f64().unwrap())
}

/// Presses Enter, as a keyboard does: a focused button is pressed by it.
pub fn enter(browser: &mut Browser) {
    for kind in ["keyDown", "keyUp"] {
        let text = if kind == "keyDown" { "\r" } else { "" };
        let key = json!({ "type": kind, "key": "Enter", "code": "Enter", "windowsVirtualKeyCode": 13, "text": text });
        browser.call("Input.dispatchKeyEvent", key);
    }
}

/// Returns a number that the page computes.
pub fn number(browser: &mut Browser, expression: &str) -> u64 {
    browser.evaluate(expression).as_u64().unwrap()
}

/// Drags with the mouse, from one place to another.
pub fn drag(browser: &mut Browser, from: (f64, f64), to: (f64, f64), button: &str) {
    let event = |kind: &str, (x, y): (f64, f64)| {
        let buttons = if button == "left" { 1 } else { 2 };
        json!({ "type": kind, "x": x, "y": y, "button": button, "buttons": buttons, "clickCount": 1 })
    };
    browser.call("Input.dispatchMouseEvent", event("mousePressed", from));
    for share in [0.3, 0.6, 1.0] {
        let at = (from.0 + (to.0 - from.0) * share, from.1 + (to.1 - from.1) * share);
        browser.call("Input.dispatchMouseEvent", event("mouseMoved", at));
    }
    browser.call("Input.dispatchMouseEvent", event("mouseReleased", to));
}

/// Presses a key together with Shift.
pub fn press_with_shift(browser: &mut Browser, key: &str) {
    // Keys without a letter type nothing.
    let typed = if key.chars().count() == 1 { key } else { "" };
    for (kind, text) in [("keyDown", typed), ("keyUp", "")] {
        let how = json!({ "type": kind, "key": key, "text": text, "modifiers": 8 });
        browser.call("Input.dispatchKeyEvent", how);
    }
}
