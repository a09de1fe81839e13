//! The page of `metamorph view` in a real browser: what tests of it do again and again.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use crate::browser::{Browser, find};
use crate::view::View;

/// Opens a browser with the page of a view; `None` where there is no browser.
pub fn open(view: &View) -> Option<Browser> {
    let mut browser = Browser::start(find()?);
    browser.open(&view.address);
    browser.until("['paused', 'failed'].includes(document.body.dataset.state)");
    // The run may still be going on when the page is loaded.
    browser.until("window.page.story.over");
    Some(browser)
}

/// Asserts that the page had no errors and loaded nothing from elsewhere.
pub fn check_clean(browser: &mut Browser, view: &View) {
    browser.evaluate("1");
    assert_eq!(browser.complaints, Vec::<String>::new());
    let elsewhere = |url: &&String| !url.starts_with(&view.address) && !url.starts_with("data:");
    assert_eq!(browser.loaded.iter().filter(elsewhere).collect::<Vec<_>>(), Vec::<&String>::new());
    assert!(browser.loaded.len() > 10);
}

/// Returns the time that is shown, in microseconds.
pub fn micros(browser: &mut Browser) -> f64 {
    browser.until("!window.page.dirty");
    browser.evaluate("Number(document.getElementById('time').dataset.micros)").as_f64().unwrap()
}

/// Returns the text of the first element that a selector finds.
pub fn text(browser: &mut Browser, selector: &str) -> String {
    browser
        .evaluate(&format!("document.querySelector('{selector}').textContent"))
        .as_str()
        .unwrap()
        .to_owned()
}

/// Moves the scrubber to a time.
pub fn scrub(browser: &mut Browser, to: f64) {
    let event = "scrub.dispatchEvent(new Event('input', { bubbles: true }))";
    browser.evaluate(&format!(
        "{{ const scrub = document.getElementById('scrub'); scrub.value = {to}; {event}; }}"
    ));
    browser.until("!window.page.dirty");
}

/// Chooses a module in the form.
pub fn choose(browser: &mut Browser, id: u32) {
    browser.evaluate(&format!(
        "document.getElementById('which').value = '{id}'; document.querySelector('#find button').click()"
    ));
    browser.until(&format!("!window.page.dirty && document.getElementById('module').dataset.id === '{id}'"));
}
