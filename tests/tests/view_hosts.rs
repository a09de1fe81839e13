//! Hosts on the page of `metamorph view` and in the HTML report: modules in the colour of their home, the links between hosts
//! with what crosses them, and which of them are cut.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{run, scenario};
use metamorph_tests::page::{check_clean, open, scrub, text};
use metamorph_tests::view::{View, record};
use serde_json::json;
use std::fs;

const CUT: &str = "\n[[fault]]\ncut = [\"h1\", \"h2\"]\nfrom = \"1s\"\nuntil = \"2s\"\n";

#[test]
fn the_page_shows_homes_and_links() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("cut.toml");
    fs::write(&file, fs::read_to_string(scenario("swarm.toml")).unwrap() + CUT).unwrap();
    let journal = record(directory.path(), file.to_str().unwrap(), &["--hosts", "3"]);
    let view = View::start(&["view", &journal]);
    let Some(mut browser) = open(&view) else { return };
    let table = "document.querySelectorAll('#hosts tbody tr').length";
    let state = "document.querySelector('#hosts tr[data-state=cut]')?.textContent ?? 'none'";
    for (at, cut) in [(500_000.0, false), (1_500_000.0, true), (2_500_000.0, false)] {
        scrub(&mut browser, at);
        browser.until(&format!("{table} === 3"));
        let cut_row = browser.evaluate(state);
        assert_eq!(cut_row.as_str().unwrap().starts_with("h1 – h2cut"), cut, "{cut_row} at {at}");
    }
    // Messages a second, once they are loaded, of links that are not cut.
    let said = "[...document.querySelectorAll('#hosts tbody tr td:nth-child(3)')].some((cell) => Number(cell.textContent) > 0)";
    browser.until(said);
    browser.press("5");
    browser.until("!window.page.dirty && window.page.meaning === 'host'");
    let legend = text(&mut browser, "#legend");
    assert!(["h1: 14", "h2: 14", "h3: 14"].iter().all(|host| legend.contains(host)), "{legend}");
    // A module has the colour of its home, as the legend shows it.
    let colours = "(() => { const { picture, story } = window.page; \
        const of = (id) => picture.paintOf(id, 'none', {}, {}, { options: { meaning: 'host' } }).join(); \
        return story.modules.every((_, id) => (of(id) === of(0)) === (story.scene.hosts.homes[id] === 0)); })()";
    assert_eq!(browser.evaluate(colours), json!(true));
    check_clean(&mut browser, &view);
}

#[test]
fn the_page_of_one_host_has_no_hosts() {
    let directory = tempfile::tempdir().unwrap();
    let view = View::start(&["view", &record(directory.path(), "swarm.toml", &[])]);
    let Some(mut browser) = open(&view) else { return };
    assert_eq!(browser.evaluate("document.getElementById('hosts-section').hidden"), json!(true));
    browser.press("5");
    assert_eq!(browser.evaluate("window.page.meaning"), json!("state"));
    check_clean(&mut browser, &view);
}

#[test]
fn the_html_report_lists_what_crossed() {
    let directory = tempfile::tempdir().unwrap();
    let html = directory.path().join("report.html").display().to_string();
    let swarm = scenario("swarm.toml").display().to_string();
    let ran = run(&["run", &swarm, "--link", "sim", "--hosts", "3", "--quiet", "--html", &html]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let page = fs::read_to_string(html).unwrap();
    for part in ["<h2>Hosts</h2>", "h1: 14 modules, h2: 14 modules", "What crossed from one host to another"]
    {
        assert!(page.contains(part), "`{part}` is missing");
    }
}
