//! Standstills of the local protocol, and the help of the controller: each is reported, and each level of help does what it says.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_protocol::cube::control::Order;
use metamorph_protocol::runtime::Command;
use metamorph_sim_bridge::director::rescue::Rescue;
use metamorph_tests::checked_run::record;
use metamorph_tests::command::run;
use metamorph_world_controller::experiments::explore::draw::Drawn;
use metamorph_world_controller::experiments::explore::draw::draw;
use metamorph_world_controller::family::cube::CubeFamily;
use metamorph_world_controller::family::read_text;
use metamorph_world_controller::record::journal::{Event, Journal};
use metamorph_world_controller::report::schema::{Report, StandstillsReport};
use metamorph_world_controller::scenario::settings::Setting;
use metamorph_world_controller::scenario::{LinkKind, Overrides};
use std::path::Path;

/// A plate of which more than a third dies while it becomes a ball: so many that not all of these swarms heal by themselves.
const BROKEN: &str = r#"
version = 1
[swarm]
start = { box = { min = [0, 0, 0], max = [9, 5, 1] } }
[[goal]]
shape = { sphere = { center = [4, 2, 1], radius = 4 } }
seed = [4, 2, 1]
growth = "scaffold"
[[fault]]
crash = { fraction = "35%", between = "0s..20s" }
[stop]
timeout = "3000s"
"#;

/// Seeds of that swarm: in three of them the controller calls modules, in the second one it leads them.
const HELPED: [u64; 4] = [9, 10, 12, 13];

fn run_at(level: Rescue, seed: u64, journal: &Path) -> Report {
    run_changed(level, seed, &[], journal)
}

fn run_changed(level: Rescue, seed: u64, change: &[&str], journal: &Path) -> Report {
    let settings = vec![Setting { option: "--rescue", text: format!("controller.rescue={level}") }];
    let change = change.iter().map(|change| (*change).to_owned()).collect();
    let overrides =
        Overrides { link: LinkKind::Sim, seed: Some(seed), settings, change, ..Overrides::default() };
    record(&read_text("broken.toml", BROKEN, &overrides).unwrap(), journal)
}

/// Returns how many modules were called.
fn calls(journal: &Path) -> usize {
    let records = Journal::open(journal).unwrap().map(|record| record.unwrap().event);
    let is_call = |event: &Event| match event {
        Event::Command(Command::Order(_, order)) => matches!(order.read(), Ok(Order::Call { .. })),
        _ => false,
    };
    records.filter(is_call).count()
}

fn standstills(report: &Report) -> &StandstillsReport {
    report.standstills.as_ref().unwrap()
}

/// A change of the level of rescue holds from its event on: at the start, the run is that of the other level; at the end, that of
/// its own.
#[test]
fn the_level_can_change_within_a_run() {
    let (dir, seed) = (tempfile::tempdir().unwrap(), HELPED[0]);
    let journal = |name: &str| dir.path().join(name);
    let [off, .., plans] = Rescue::ALL.map(|level| run_at(level, seed, &journal(level.name())));
    let changed = |change: &str| run_changed(Rescue::Plans, seed, &[change], &journal(change));
    assert_ne!(off.trace_hash, plans.trace_hash);
    assert_eq!(changed("rescue=off@0").trace_hash, off.trace_hash);
    assert_eq!(changed("rescue=off@1000000000").trace_hash, plans.trace_hash);
}

/// Without help the controller calls no module, so a run that it would have helped ends at its last standstill; up to the first
/// one all levels are the same.
#[test]
fn each_level_gives_the_help_that_it_says() {
    let dir = tempfile::tempdir().unwrap();
    let (mut called, mut led, mut alone) = (0, 0, 0);
    for seed in HELPED {
        let [off, calls_only, plans] = Rescue::ALL.map(|level| {
            let journal = dir.path().join(format!("{seed}-{level}"));
            let report = run_at(level, seed, &journal);
            (calls(&journal), report)
        });
        assert_eq!(off.0, 0, "seed {seed}");
        assert_eq!((off.1.move_details.called, off.1.move_details.led), (0, 0), "seed {seed}");
        assert_eq!(calls_only.1.move_details.led, 0, "seed {seed}");
        assert_eq!(standstills(&off.1).rescued, 0, "seed {seed}");
        for (_, report) in [&off, &calls_only, &plans] {
            let all = standstills(report);
            assert_eq!(all.ended.values().sum::<u64>(), all.count, "seed {seed}");
            assert_eq!(all.count > 0, !all.events.is_empty(), "seed {seed}");
            let first = all.events.first().map(|event| (event.since_s, event.unfilled.clone()));
            let other = standstills(&plans.1).events.first();
            assert_eq!(first, other.map(|event| (event.since_s, event.unfilled.clone())), "seed {seed}");
            let help = all.events.iter().map(|event| event.called + event.led).sum::<u64>();
            let moves = report.move_details.called + report.move_details.led;
            // The last moves of a call may end when others move again.
            assert!(help <= moves && (help > 0) == (moves > 0), "seed {seed}: {help} of {moves}");
        }
        if plans.1.outcome == "built" && standstills(&plans.1).rescued > 0 {
            assert!(plans.1.reason.contains("controller resolved"), "seed {seed}: {}", plans.1.reason);
        }
        called += plans.1.move_details.called;
        led += plans.1.move_details.led;
        alone += u64::from(off.1.outcome == "built");
    }
    assert!(called > 0 && led > 0 && alone < 4, "{called} called, {led} led, {alone} built alone");
}

/// What is never broken gets no help, so the level changes nothing.
#[test]
fn levels_do_not_change_runs_without_faults() {
    let hashes = Rescue::ALL.map(|level| {
        let ran = run(&[
            "run",
            "swarm",
            "--link",
            "sim",
            "--set",
            "fault=[]",
            "--rescue",
            level.name(),
            "--json",
            "-",
        ]);
        let report: Report = serde_json::from_str(&ran.out).unwrap();
        assert_eq!(standstills(&report).rescue, level.name());
        report.trace_hash.unwrap()
    });
    assert_eq!((&hashes[0], &hashes[1]), (&hashes[1], &hashes[2]));
}

#[test]
fn families_without_rescue_say_so() {
    let checked = run(&["check", "chair"]);
    assert!(checked.out.contains("does not help modules of this family"), "{}", checked.out);
    let ran = run(&["run", "chair", "--link", "sim", "--json", "-", "--rescue", "off"]);
    let report: Report = serde_json::from_str(&ran.out).unwrap();
    assert_eq!(standstills(&report).rescue, "none");
    // The moves of a central plan are counted as what they are.
    let planned =
        run(&["run", "chair", "--link", "sim", "--set", "protocol.strategy=planned", "--json", "-"]);
    let report: Report = serde_json::from_str(&planned.out).unwrap();
    assert_eq!(report.move_details.led, report.moves);
    assert!(report.reason.contains("by plans of the controller"), "{}", report.reason);
}

/// An explored run at `off` repeats with the command that is printed.
#[test]
fn explored_levels_are_repeated() {
    let drawn = Drawn { rescue: Some(Rescue::Off), ..Drawn::from(Some(&CubeFamily as _)) };
    let (draft, plan) = draw(3, drawn);
    assert_eq!(plan.rescue, Rescue::Off);
    assert!(draft.to_string().contains("[controller]\nrescue = \"off\""), "{draft}");
    let ran = run(&["explore", "--runs", "1", "--seed", "3", "--family", "cube", "--rescue", "off"]);
    assert!(ran.out.contains("rescue = \"off\""), "{}", ran.out);
}
