//! Record and replay, crossed with every option that all families share: drawn scenarios and shipped ones, each with a few options
//! drawn from all of them. A new key of the schema fails here until it has values.
#![allow(clippy::print_stdout, reason = "results are shown with --nocapture")]
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_protocol::rng::Rng;
use metamorph_tests::checked_run::record;
use metamorph_world_controller::experiments::explore::draw::{Drawn, draw};
use metamorph_world_controller::family::{all, families, read_text, replay};
use metamorph_world_controller::run::replay::Request;
use metamorph_world_controller::scenario::schema::schema;
use metamorph_world_controller::scenario::settings::Setting;
use metamorph_world_controller::scenario::{LinkKind, Overrides, shipped};
use serde_json::Value;
use std::collections::BTreeSet;
use std::env;

/// Keys that all families share, with values for runs on the simulated link.
const OPTIONS: [(&str, &[&str]); 30] = [
    (
        "link.delay",
        &[
            "0s",
            "5ms..400ms",
            "0s..2s",
            "{ quantiles = [[\"50%\", \"5ms\"], [\"99%\", \"300ms\"], [\"100%\", \"1s\"]] }",
        ],
    ),
    (
        "link.burst",
        &[
            "{ enter = \"2%\", leave = \"20%\", loss = \"80%\" }",
            "{ enter = \"5%\", leave = \"50%\", delay = \"100ms..900ms\" }",
        ],
    ),
    ("link.loss", &["5%", "20%"]),
    ("link.duplicate", &["10%"]),
    ("link.reorder", &["10%"]),
    ("link.corrupt", &["5%"]),
    ("link.until", &["30s"]),
    (
        "link.between",
        &[
            "[{ modules = [0, \"any\"], one_way = true, loss = \"40%\" }]",
            "[{ modules = [[0, 1], 2], until = \"9s\", delay = \"1s\" }, { modules = \"any\", from = \"5s\", delay = \"0s..900ms\" }]",
        ],
    ),
    ("link.controller.delay", &["20ms..50ms", "0s..3s"]),
    ("link.controller.loss", &["20%"]),
    ("link.between_hosts.hosts", &["2", "3"]),
    ("link.between_hosts.placement", &["\"cut\"", "\"blocks\""]),
    ("link.between_hosts.delay", &["20ms..60ms"]),
    ("link.between_hosts.burst", &["{ enter = \"5%\", leave = \"20%\", loss = \"50%\" }"]),
    ("link.between_hosts.loss", &["5%"]),
    ("link.between_hosts.duplicate", &["5%"]),
    ("link.between_hosts.reorder", &["5%"]),
    ("link.between_hosts.corrupt", &["5%"]),
    ("link.between_hosts.skew", &["[\"0s\", \"1ms\"]"]),
    ("link.between_hosts.clock_error", &["5ms"]),
    ("link.between_hosts.lost", &["elsewhere", "crash"]),
    ("link.between_hosts.fence", &["3s"]),
    ("link.between_hosts.pair", &["[{ hosts = [\"h1\", \"h2\"], delay = \"40ms..90ms\" }]"]),
    ("controller.rescue", &["off", "calls", "plans"]),
    (
        "change",
        &[
            "[{ after = 40, reseed = { all = 3 } }, { after = 300, reseed = { links = 7 } }]",
            "[{ after = 0, reseed = { links = 7 } }, { after = 500, reseed = { all = 9 } }, { after = 900, rescue = 'off' }]",
            "[{ after = 90, lose = '0.0.3' }, { after = 200, sleep = { module = 1, for = '2s' } }]",
        ],
    ),
    ("stop.timeout", &["20s"]),
    ("stop.stall", &["90s"]),
    ("stop.livelock", &["200s"]),
    ("swarm.failed_connections", &["10%"]),
    ("swarm.connection", &["{ shift_noise_mm = 8 }", "{ shift_noise_mm = 4.5, twist_noise_deg = 20 }"]),
];
/// Keys without an effect on a simulated run.
const WITHOUT_EFFECT: [&str; 1] = ["process.time_scale"];
/// The largest number of modules of a shipped scenario that is run again and again.
const MODULES_MAX: usize = 60;

/// Returns the keys of a table of the schema and of the tables in it.
fn keys(schema: &Value, at: &str, table: &Value, found: &mut BTreeSet<String>) {
    let definition = table["$ref"].as_str().and_then(|name| name.strip_prefix("#/$defs/"));
    let table = definition.map_or(table, |name| &schema["$defs"][name]);
    match table["properties"].as_object() {
        Some(properties) => {
            properties.iter().for_each(|(key, value)| keys(schema, &format!("{at}.{key}"), value, found));
        }
        None => drop(found.insert(at.to_owned())),
    }
}

#[test]
fn every_shared_key_is_crossed_with_record_and_replay() {
    let schema = schema(families());
    let mut found = BTreeSet::new();
    for section in ["link", "controller", "process", "stop"] {
        keys(&schema, section, &schema["properties"][section], &mut found);
    }
    let known = OPTIONS.iter().map(|(key, _)| *key).chain(WITHOUT_EFFECT);
    let known: BTreeSet<String> = known.map(str::to_owned).collect();
    // A table that needs several keys is one option.
    let is_known = |key: &String| known.iter().any(|k| key == k || key.starts_with(&format!("{k}.")));
    let missing: Vec<_> = found.iter().filter(|key| !is_known(key)).collect();
    assert!(missing.is_empty(), "give these keys values in OPTIONS: {missing:?}");
}

/// Returns the text of a scenario, and its name for people.
fn base(seed: u64, random: &mut Rng) -> (String, String) {
    let families: Vec<_> = all().iter().copied().filter(|family| family.is_drawn()).collect();
    if random.below(4) > 0 {
        let family = families[random.below(families.len() as u64) as usize];
        return (draw(seed, Drawn::from(Some(family))).0.to_string(), format!("{} {seed}", family.name()));
    }
    let names: Vec<&str> = shipped::names().collect();
    let name = names[random.below(names.len() as u64) as usize];
    (shipped::text(name).unwrap().to_owned(), name.to_owned())
}

/// Records a run and replays it. Returns the keys that it had, or `None` if there is no such scenario.
fn record_and_replay(seed: u64) -> Option<Vec<&'static str>> {
    let mut random = Rng::named(seed, "replay matrix", 0);
    let (text, name) = base(seed, &mut random);
    let mut options: Vec<(&str, &str)> = Vec::new();
    for _ in 0..1 + random.below(4) {
        let (key, values) = OPTIONS[random.below(OPTIONS.len() as u64) as usize];
        let value = values[random.below(values.len() as u64) as usize];
        if options.iter().all(|(other, _)| *other != key) {
            options.push((key, value));
        }
    }
    // The other keys of hosts need some.
    let needs_hosts = options.iter().any(|(key, _)| key.starts_with("link.between_hosts."));
    if needs_hosts && options.iter().all(|(key, _)| *key != "link.between_hosts.hosts") {
        options.push(("link.between_hosts.hosts", "2"));
    }
    if options.iter().any(|(key, _)| *key == "link.between_hosts.fence") {
        options.retain(|(key, _)| *key != "link.between_hosts.lost");
        options.push(("link.between_hosts.lost", "elsewhere"));
    }
    let set = |(key, value): &(&str, &str)| Setting { option: "--set", text: format!("{key}={value}") };
    let settings: Vec<Setting> = options.iter().map(set).collect();
    let overrides = Overrides { link: LinkKind::Sim, settings, seed: Some(seed), ..Overrides::default() };
    let plan = read_text(&format!("{name}.toml"), &text, &overrides).ok()?;
    if plan.swarm.len() > MODULES_MAX {
        return None;
    }
    let dir = tempfile::tempdir().unwrap();
    let journal = dir.path().join("journal");
    let report = record(&plan, &journal);
    let request = Request { file: journal, until: None, agent: None };
    let (_, replayed) = replay(&request).unwrap();
    let about = format!("seed {seed}: {name} with {options:?}");
    assert_eq!(replayed.difference, None, "{about}");
    assert_eq!((replayed.damage, replayed.done.unchecked), (None, 0), "{about}");
    // Audits, which find what is unsafe, are not repeated.
    let has_same_end =
        report.outcome == "unsafe" || replayed.ended.as_deref() == Some(report.outcome.as_str());
    assert!(has_same_end, "{about}: {} {:?}", report.outcome, replayed.ended);
    Some(options.into_iter().map(|(key, _)| key).collect())
}

fn matrix(from: u64, runs: usize) {
    let (mut done, mut seen) = (0, BTreeSet::new());
    for seed in from.. {
        if let Some(keys) = record_and_replay(seed) {
            done += 1;
            seen.extend(keys);
        }
        if done == runs {
            break;
        }
    }
    println!("{runs} runs replayed the same, with {} of {} options", seen.len(), OPTIONS.len());
    let never: Vec<_> = OPTIONS.iter().filter(|(key, _)| !seen.contains(key)).collect();
    assert!(never.is_empty(), "no run had {never:?}");
}

#[test]
fn drawn_options_replay() {
    matrix(0, 80);
}

/// `REPLAYED=300 cargo test -p metamorph-tests replay_matrix:: -- --ignored --nocapture`
#[test]
#[ignore = "a minute: 300 runs, or as many as REPLAYED says"]
fn many_drawn_options_replay() {
    let runs = env::var("REPLAYED").map_or(300, |text| text.parse().expect("REPLAYED is a number"));
    matrix(1_000_000, runs);
}
