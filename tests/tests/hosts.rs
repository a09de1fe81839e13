//! Swarms over several hosts on the simulated link: what passes between hosts, clocks that differ, and what the remedies
//! against these prevent.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_protocol::defects::Defect;
use metamorph_protocol::link::ClockOffset;
use metamorph_protocol::metamodule::blueprint::SeedOrder;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::time::Span;
use metamorph_sim_bridge::cube::invariants::{BODY_CONNECTED, PARENT_DESCENDS};
use metamorph_sim_bridge::world::invariants::{Invariant, MOVE_WITHIN_LEASE};
use metamorph_tests::command::{on, refused, report};
use metamorph_tests::growth::{Experiment, Ran};
use metamorph_tests::metamodules::{Assembly, Goal};
use metamorph_world_controller::report::hosts::CrossedCounts;
use std::ops::RangeInclusive;
use std::thread;

const SIDE: i16 = 10;
/// Seeds with which nothing may break.
const SEEDS: u64 = 80;
/// Seeds that are searched for torn bodies: of the first 5,000 seeds 23 have one.
const TORN: RangeInclusive<u64> = 790..=800;
/// Seeds that are searched for modules that hang on their descendants: of the first 1,000 seeds 34 have one.
const HANGING: RangeInclusive<u64> = 122..=124;

fn clocks<const N: usize>(milliseconds: [i64; N]) -> [ClockOffset; N] {
    milliseconds.map(|ms| ClockOffset(ms * 1_000_000))
}

/// Runs an experiment with each of these seeds, two at a time, and returns the results in the order of the seeds.
fn all(seeds: u64, vary: fn(u64) -> Experiment) -> Vec<Ran> {
    let run =
        |first: u64| move || (first..=seeds).step_by(2).map(|seed| vary(seed).run()).collect::<Vec<_>>();
    let halves = [1, 2].map(|first| thread::spawn(run(first)));
    let [odd, even] = halves.map(|half| half.join().unwrap().into_iter());
    let mut both = [odd, even];
    (0..seeds as usize).map(|i| both[i % 2].next().unwrap()).collect()
}

/// Two hosts have clocks that are wrong by almost a quarter of the time in which a move may start. Actions are held back by
/// cuts, so that some reach the bodies when the grants of neighbours have nearly ended.
fn late_starts(seed: u64) -> Experiment {
    Experiment::slab_to_sphere(SIDE, seed).hosts(&clocks([0, 1_600, -1_600])).host_cuts(Span::secs(9))
}

/// Modules restart on hosts whose clocks differ by more than the time between two restarts.
fn restarts(seed: u64) -> Experiment {
    let experiment = Experiment::slab_to_sphere(SIDE, seed).hosts(&clocks([0, 20_000, -20_000])).restarts(60);
    // Deadlines are not the subject, and could not bear this difference.
    let mut experiment = Experiment { until_broken: true, ..experiment };
    experiment.setup.params.skew = Span::ZERO;
    experiment
}

/// Returns the first seed of which the run breaks this invariant with the defect.
fn first_broken(
    mut seeds: RangeInclusive<u64>,
    invariant: Invariant,
    defect: Defect,
    vary: fn(u64) -> Experiment,
) -> Option<u64> {
    seeds.find(|seed| {
        let mut experiment = vary(*seed);
        experiment.setup.params.defect = Some(defect);
        experiment.run().broke(invariant)
    })
}

#[test]
fn deadlines_that_ignore_the_skew_admit_moves_too_late() {
    assert!(first_broken(1..=3, MOVE_WITHIN_LEASE, Defect::IgnoreSkew, late_starts).is_some());
}

#[test]
fn deadlines_that_ignore_the_skew_tear_the_body() {
    assert!(first_broken(TORN, BODY_CONNECTED, Defect::IgnoreSkew, late_starts).is_some());
}

/// Metamodules whose clocks are wrong by almost a quarter of a lease, with links that are cut for about a lease.
fn metamodules(seed: u64) -> Assembly {
    let order = SeedOrder::AtOnce;
    Assembly::new(Goal::Chair, Kind::Srs, Strategy::Negotiated, order, seed)
        .hosts(&clocks([0, 9_000, -9_000]), Span::secs(45))
}

#[test]
fn metamodules_need_room_for_the_skew_as_well() {
    assert!((1..=4).any(|seed| {
        let ran = metamodules(seed).defect(Some(Defect::IgnoreSkew)).run();
        ran.violations.iter().any(|v| v.invariant == MOVE_WITHIN_LEASE)
    }));
    for seed in 1..=8 {
        let ran = metamodules(seed).run();
        assert_eq!(
            (ran.broken, ran.built()),
            (0, true),
            "seed {seed}: {:?} {:?}",
            ran.violations.first(),
            ran.stall
        );
    }
}

#[test]
fn restarts_dated_by_their_own_clock_hang_modules_on_their_descendants() {
    assert!(first_broken(HANGING, PARENT_DESCENDS, Defect::OwnBirthTime, restarts).is_some());
}

/// With the remedies the same runs break nothing.
#[test]
fn skewed_clocks_break_nothing() {
    for (i, ran) in all(SEEDS, late_starts).into_iter().enumerate() {
        assert_eq!((ran.broken, ran.built()), (0, true), "seed {}: {:?}", i + 1, ran.violations.first());
    }
    for (i, ran) in all(SEEDS, restarts).into_iter().enumerate() {
        assert_eq!(ran.broken, 0, "seed {}: {:?}", i + 1, ran.violations.first());
    }
}

/// Hosts are part of what determines a run.
#[test]
fn same_hosts_and_seed_give_the_same_trace() {
    let run = |clock| Experiment::slab_to_sphere(SIDE, 1).hosts(&clocks([0, clock])).run();
    let (first, again, other) = (run(0), run(0), run(5));
    assert_eq!((first.trace, first.digest, first.state), (again.trace, again.digest, again.state));
    let alone = Experiment::slab_to_sphere(SIDE, 1).run();
    assert!(first.trace != other.trace && first.trace != alone.trace);
    assert!(first.built() && other.built());
}

const SWARM: &str = r#"
version = 1
[swarm]
start = { box = { min = [0, 0, 0], max = [9, 9, 0] } }
[[goal]]
shape = { sphere = { center = [5, 5, 0], radius = 4 } }
seed = [5, 5, 0]
growth = "scaffold"
[[fault]]
restart = 50
at = "8s"
[[fault]]
cut = ["h1", "h3"]
from = "5s"
until = "15s"
[[fault]]
pause_host = "h2"
from = "10s"
until = "12s"
[link.between_hosts]
hosts = 3
delay = "50ms..200ms"
loss = "2%"
skew = ["0s", "500ms", "-300ms"]
[[link.between_hosts.pair]]
hosts = ["h3", "h1"]
delay = "300ms"
"#;

/// A run over hosts builds, its report counts what crosses, and its journal replays to the same state although clocks
/// differ.
#[test]
fn a_run_over_hosts_is_reported_and_replayed() {
    let directory = tempfile::tempdir().unwrap();
    let journal = directory.path().join("hosts.mmj").display().to_string();
    let ran = on(SWARM, &["run", "{}", "--link", "sim", "--json", "-", "--journal", &journal]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let report = report(&ran.out);
    let hosts = report.hosts.unwrap();
    let modules: Vec<(&str, u64)> = hosts.hosts.iter().map(|h| (h.name.as_str(), h.modules)).collect();
    assert_eq!(modules, [("h1", 34), ("h2", 33), ("h3", 33)]);
    assert_eq!(hosts.hosts[2].clock_s, -0.3);
    let sum = |of: fn(&CrossedCounts) -> u64, classes: &mut dyn Iterator<Item = &CrossedCounts>| {
        classes.map(of).sum::<u64>()
    };
    for crossed in &hosts.crossed {
        assert_eq!(sum(|c| c.sent, &mut crossed.by_class.values()), crossed.all.sent, "{crossed:?}");
        // Bodies are at h1.
        assert_eq!(crossed.from == "h1" || crossed.to == "h1", crossed.body_messages > 0, "{crossed:?}");
    }
    let (sent, lost) = (
        sum(|c| c.sent, &mut hosts.crossed.iter().map(|c| &c.all)),
        sum(|c| c.lost, &mut hosts.crossed.iter().map(|c| &c.all)),
    );
    // The link within a host loses nothing.
    assert!(sent > 100 && sent < report.messages.total && lost > 0 && lost == report.messages.all.lost);
    let faults: Vec<&str> = report.faults.iter().map(|f| f.fault.as_str()).collect();
    assert_eq!(faults.iter().filter(|f| **f == "pause").count(), 33);
    assert!(faults.contains(&"partition") && faults.contains(&"heal"));
    let replayed = on("", &["replay", &journal]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
    let digits = report.agents_hash.unwrap();
    assert!(replayed.out.contains(&digits) || replayed.err.contains(&digits), "{digits}: {replayed:?}");
}

#[test]
fn a_killed_host_takes_its_modules_along() {
    let ran = on(SWARM, &["run", "{}", "--link", "sim", "--json", "-", "--kill", "h3@6s"]);
    let report = report(&ran.out);
    let killed = report.faults.iter().filter(|f| f.fault == "kill").filter_map(|f| f.module);
    assert!(killed.eq(67..100), "{ran:?}");
    assert_eq!((report.agents.crashed, report.invariants.broken), (34, 0));
}

#[test]
fn the_check_shows_placement_and_what_crosses() {
    let ran = on(SWARM, &["check", "{}", "--link", "sim"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    for part in [
        "h1 modules 0 to 33, h2 modules 34 to 66, h3 modules 67 to 99",
        // Of 180 edges of the slab; a module number counts up along one axis.
        "22 of 180 contacts at the start cross (12%)",
        "between h1 and h3 delay 300ms; loss 2%",
        "clocks: h2 500ms ahead, h3 300ms behind",
        "h1 and h3 cut off from each other from 5s to 15s",
    ] {
        assert!(ran.out.contains(part), "`{part}` is missing in: {}", ran.out);
    }
}

#[test]
fn wrong_hosts_are_refused_with_place_reason_and_fix() {
    let cases: &[(&str, &str, &[&str])] = &[
        ("hosts = 3", "hosts = 0", &["the number of hosts is 0", "from 1 to 100"]),
        ("hosts = 3", "hosts = 101", &["the number of hosts is 101"]),
        ("hosts = 3", "hosts = [50, 40]", &["90 modules together, and the swarm has 100"]),
        ("hosts = 3", "hosts = [60, 40, 0]", &["100 modules together"]),
        ("hosts = 3", "hosts = \"three\"", &["expected a whole number"]),
        ("hosts = 3\n", "", &["[link.between_hosts] has no `hosts`"]),
        ("\"-300ms\"", "\"-300\"", &["has no known unit"]),
        ("\"-300ms\"", "\"-3s\"", &["clocks differ by up to 3s", "a quarter of"]),
        (", \"-300ms\"", "", &["2 clocks are given for 3 hosts", "write 3 times"]),
        ("skew = [\"0s\"", "skew = [\"1ms\"", &["the clock of h1 is the controller's", "`0s`"]),
        ("[\"h3\", \"h1\"]", "[\"h3\", \"h4\"]", &["no host `h4`; the swarm has h1 to h3"]),
        ("[\"h3\", \"h1\"]", "[\"h3\"]", &["expected the names of two hosts"]),
        ("cut = [\"h1\", \"h3\"]", "cut = [\"h1\", \"h1\"]", &["both ends are h1", "two different hosts"]),
        ("\"h2\"\nfrom", "\"host2\"\nfrom", &["no host `host2`"]),
        ("until = \"15s\"\n", "", &["[[fault]] has no `until`"]),
        ("delay = \"300ms\"", "delay = \"2h\"", &["the delay is 7200s", "to 3600s"]),
        ("delay = \"300ms\"", "dely = \"300ms\"", &["unknown key `dely`", "did you mean `delay`?"]),
    ];
    for (old, new, parts) in cases {
        assert!(SWARM.contains(old), "{old}");
        refused(&SWARM.replace(old, new), &["check", "{}", "--link", "sim"], parts);
    }
    let alone = SWARM.split("[link.between_hosts]").next().unwrap();
    refused(alone, &["check", "{}", "--link", "sim"], &["no host `h2`; the swarm has one host", "hosts = 3"]);
    refused(
        SWARM,
        &["check", "{}"],
        &["processes with clocks that differ is not supported yet", "--link sim"],
    );
}
