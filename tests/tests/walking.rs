//! Structures that walk, in simulation and as processes: a module dies, and the others walk on.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]
#![allow(clippy::print_stdout, reason = "shown only on failure or with --nocapture")]

use metamorph_protocol::counters::Class;
use metamorph_protocol::free_module::gait::message::WalkMessage;
use metamorph_protocol::free_module::oscillator::{Dynamics, Phase};
use metamorph_protocol::record::{Consumed, Event};
use metamorph_protocol::time::{Span, Time};
use metamorph_tests::command::{Ran, on, refused, report, root, run, run_processes, scenario};
use metamorph_tests::json_schema::Schema;
use metamorph_world_controller::record::journal::Journal;
use metamorph_world_controller::report::schema::Report;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;

/// The quadruped of a short walk: a goal of 15 s.
fn short(more: &[&str]) -> Vec<String> {
    let path = scenario("quadruped.toml").display().to_string();
    let goal = "goal.0.walk.for=15s";
    let fixed = ["run", path.as_str(), "--set", goal, "--json", "-"];
    fixed.iter().chain(more).map(|arg| (*arg).to_owned()).collect()
}

fn simulated(more: &[&str]) -> Ran {
    let args = short(&[&["--link", "sim"], more].concat());
    run(&args.iter().map(String::as_str).collect::<Vec<_>>())
}

/// Returns what was done in each situation: dead modules, the number of gaits and the speed of the best.
fn situations(report: &Report) -> Vec<(Vec<u64>, u64, f64)> {
    let all = report.family_parts["free_modules"]["situations"].as_array().unwrap().iter();
    all.map(|s| {
        let dead = s["dead"].as_array().unwrap().iter().map(|m| m.as_u64().unwrap()).collect();
        (dead, s["tried"].as_u64().unwrap(), s["best_mm_s"].as_f64().unwrap_or(0.0))
    })
    .collect()
}

/// Checks a run in which module 2 died after 18 s, in the first trial or after it.
fn walks_on(report: &Report) {
    assert_eq!((report.outcome.as_str(), report.agents.crashed), ("built", 1), "{}", report.reason);
    assert_eq!(report.invariants.broken, 0, "{:?}", report.invariants);
    let done = situations(report);
    println!("{done:?}");
    let (whole, without) = (done.first().unwrap(), done.last().unwrap());
    assert!(whole.0.is_empty() && whole.2 > 10.0, "{done:?}");
    assert!(without.0 == [2] && without.1 >= 1, "{done:?}");
    let part = &report.family_parts["free_modules"];
    assert!(part["distance_mm"].as_f64().unwrap() > 300.0, "{part}");
    // Phases are told, and agents tell each other what is docked.
    for class in ["gait", "connectivity", "liveness"] {
        assert!(report.messages.by_class[class].delivered > 0, "{class}");
    }
}

/// The same run twice, and carried out again from its journal, is the same to the bit; a picture shows it.
#[test]
fn a_simulated_quadruped_walks_on_and_its_journal_replays() {
    let directory = tempfile::tempdir().unwrap();
    let journal = directory.path().join("journal").display().to_string();
    let kill = ["--kill", "2@18s"];
    let first = report(&simulated(&[&kill[..], &["--journal", &journal]].concat()).out);
    walks_on(&first);
    let second = report(&simulated(&kill).out);
    assert_eq!((&first.trace_hash, &first.state_hash), (&second.trace_hash, &second.state_hash));
    let replayed = run(&["replay", &journal]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
    let told = run(&["replay", &journal, "--agent", "1", "--until", "20s"]);
    for part in ["gait 1 from", "module 2 is dead", "asks its body to follow", "knee"] {
        assert!(told.out.contains(part), "`{part}` is missing: {}", told.out);
    }
    let picture = directory.path().join("picture.svg").display().to_string();
    let drawn = run(&["render", &journal, "--at", "50%", "--out", &picture]);
    assert_eq!(drawn.code, Some(0), "{drawn:?}");
}

/// Returns how far the phases that agents heard between two times are apart at most, in degrees. They are counted from
/// those of the gait, so in lock all are equal; each is extrapolated to the first time.
fn apart(journal: &Path, [from, until]: [u64; 2]) -> f64 {
    let [from, until] = [from, until].map(|s| Time::ZERO + Span::secs(s));
    let mut phases = Vec::new();
    for record in Journal::open(journal).unwrap() {
        let record = record.unwrap();
        let Event::Step(step) = &record.event else { continue };
        let Consumed::Message { message, class: Class::Gait, .. } = &step.input else { continue };
        let WalkMessage::Phases { phases: heard, .. } = message.read().unwrap() else { continue };
        let within = heard.into_iter().filter(|p| from <= p.at && p.at < until);
        phases.extend(
            within.map(|p| p.phase - Phase::default().after(p.at.since(from), Dynamics::THESIS.frequency)),
        );
    }
    assert!(phases.len() > 20, "{} phases", phases.len());
    let off = phases.iter().map(|p| f64::from(p.ahead_of(phases[0])) / 2f64.powi(32) * 360.0);
    let (low, high) = off.fold((0.0, 0.0), |(low, high): (f64, f64), x| (low.min(x), high.max(x)));
    high - low
}

/// The quadruped as processes walks on as the simulated one does, with messages of the same kinds, and in lock.
#[test]
fn a_quadruped_of_processes_walks_on() {
    let directory = tempfile::tempdir().unwrap();
    let journal = directory.path().join("journal").display().to_string();
    let args = short(&["--link", "ipc", "--time-scale", "2", "--kill", "2@18s", "--journal", &journal]);
    let ran = run_processes(&args.iter().map(String::as_str).collect::<Vec<_>>());
    println!("{}", ran.err);
    let processes = report(&ran.out);
    walks_on(&processes);
    let simulated = report(&simulated(&["--kill", "2@18s"]).out);
    let kinds = |report: &Report| -> BTreeSet<String> {
        let sent = report.messages.by_class.iter().filter(|(_, counts)| counts.sent > 0);
        sent.map(|(class, _)| class.clone()).collect()
    };
    assert_eq!(kinds(&processes), kinds(&simulated));
    let off = apart(Path::new(&journal), [12, 17]);
    let seconds = processes.time.virtual_s;
    let gait = processes.messages.by_class["gait"].sent as f64 / seconds;
    println!("phases {off:.3} degrees apart, {gait:.1} messages of class gait a second");
    assert!(off <= 1.0 && gait <= 30.0, "{off} degrees, {gait} messages a second");
    let replayed = run(&["replay", &journal]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
}

/// Uphill, in a direction, while turning, and with elites after a failure: the report has what was done.
#[test]
fn a_walk_has_a_direction_and_a_slope() {
    let set = |sets: &[&str]| {
        let sets: Vec<&str> = sets.iter().flat_map(|set| ["--set", *set]).collect();
        report(&simulated(&sets).out)
    };
    let part = |report: &Report, key: &str| report.family_parts["free_modules"][key].as_f64();
    let level = set(&["goal.0.walk.speed_at_least=0mm/s"]);
    let uphill = set(&["goal.0.walk.speed_at_least=0mm/s", "swarm.ground.slope=10deg"]);
    assert_ne!(part(&level, "distance_mm"), part(&uphill, "distance_mm"));
    let cost = part(&level, "cost_of_transport").unwrap();
    println!("cost of transport {cost:.2}, turned by {:?} degrees", part(&level, "turned_deg"));
    assert!((0.1..100.0).contains(&cost), "{cost}");
    // The gait goes one way, so one of two opposite directions is not the one asked for, and another gait is tried.
    let tried = |heading: &str| {
        let heading = format!("goal.0.walk.heading={heading}");
        let short = ["protocol.trials=2", "protocol.relearn=repertoire", "stop.timeout=60s"];
        situations(&set(&[&short[..], &[&heading]].concat()))[0].1
    };
    let (east, west) = (tried("0deg"), tried("180deg"));
    assert!(east.max(west) == 2, "{east} {west}");
}

/// When the body dies, hips move into the limbs, by the gait for this failure.
#[test]
fn limbs_walk_on_without_the_body() {
    let ran = simulated(&["--kill", "0@18s", "--set", "goal.0.walk.speed_at_least=5mm/s"]);
    let report = report(&ran.out);
    assert_eq!(report.outcome, "built", "{}", report.reason);
    let done = situations(&report);
    assert!(done.last().is_some_and(|(dead, _, speed)| *dead == [0] && *speed > 5.0), "{done:?}");
}

/// Without a module whose joints move, and without a gait that is fast enough, a run ends with the reason.
#[test]
fn what_cannot_walk_ends_with_the_reason() {
    let kills: Vec<String> = (0..5).map(|m| format!("{m}@15s")).collect();
    let kills: Vec<&str> = kills.iter().flat_map(|kill| ["--kill", kill.as_str()]).collect();
    let ran = simulated(&kills);
    let dead = report(&ran.out);
    assert_eq!((ran.code, dead.outcome.as_str()), (Some(3), "deadlock"), "{}", dead.reason);
    assert!(dead.reason.contains("infeasible"), "{}", dead.reason);
    let slow = ["goal.0.walk.speed_at_least=500mm/s", "protocol.relearn=none", "stop.livelock=30s"];
    let slow: Vec<&str> = slow.into_iter().flat_map(|set| ["--set", set]).collect();
    let ran = simulated(&slow);
    let slow = report(&ran.out);
    assert_eq!((ran.code, slow.outcome.as_str()), (Some(4), "livelock"), "{}", slow.reason);
}

const TEXT: &str = "version = 1\n[swarm]\nfamily = \"free-module\"\nbody = \"physics\"\nSTART\n[[goal]]\n\
    walk = { for = \"20s\", speed_at_least = \"SPEED\" }\n[protocol]\nGAITS\n";

fn text(start: &str, speed: &str, gaits: &str) -> String {
    TEXT.replace("START", start).replace("SPEED", speed).replace("GAITS", gaits)
}

#[test]
fn wrong_scenarios_are_refused_with_a_fix() {
    let file = |name: &str| root().join("deploy/gaits").join(name).display().to_string();
    let (whole, headless) = (file("quad5.json"), file("quad5-dead-0.json"));
    let gaits = |files: &[&str]| format!("gaits = {files:?}");
    let usual = gaits(&[&whole]);
    let start = "start = \"quad5-sym\"";
    let fine = on(&text(start, "5mm/s", &usual), &["check", "{}"]);
    assert_eq!(fine.code, Some(0), "{fine:?}");
    for (text, reason) in [
        (text("start = \"quad6\"", "5mm/s", &usual), "`quad6` is not the name of a structure that walks"),
        (text("start = \"nowhere.json\"", "5mm/s", &usual), "cannot be read"),
        (text("start = \"quad5-unsym\"", "5mm/s", &usual), "fingerprint"),
        (text("start = \"struct10\"", "5mm/s", &usual), "fingerprint"),
        (text(start, "5", &usual), "`5` is not a speed"),
        (text(start, "-5mm/s", &usual), "`-5mm/s` is not a speed"),
        (text(start, "5mm/s", ""), "no `gaits`"),
        (text(start, "5mm/s", "gaits = [\"nowhere.json\"]"), "nowhere.json"),
        (text(start, "5mm/s", &gaits(&[&headless])), "without dead modules"),
        (text(start, "5mm/s", &gaits(&[&whole, &whole])), "another gait for the same dead modules"),
        (text(start, "5mm/s", &format!("{usual}\nnetwork = \"fo\"")), "of the network blf-sym, not fo"),
        (text(start, "5mm/s", &format!("{usual}\nrelearn = \"spsa\"")), "unknown learner `spsa`"),
        (text(start, "5mm/s", &format!("{usual}\ntrial = \"4s\"")), "trial is 4s"),
        (text(start, "5mm/s", &format!("{usual}\ntrials = 0")), "trials is 0"),
        (text(start, "5mm/s", &format!("{usual}\nweight = 2")), "`weight` is for body lattice"),
        (text(start, "5mm/s", &format!("{usual}\nstrategy = \"planned\"")), "`planned` is for body lattice"),
        (text(&format!("{start}\ndown = \"up\""), "5mm/s", &usual), "`up` is not a direction"),
        (text(&format!("{start}\nfriction = -1"), "5mm/s", &usual), "friction is -1"),
        (text(&format!("{start}\nground = {{ slope = \"60deg\" }}"), "5mm/s", &usual), "slope is `60deg`"),
        (text(start, "5mm/s\", heading = \"north", &usual), "heading is `north`"),
        (text(start, "5mm/s\", turn = \"5deg", &usual), "turn is `5deg`"),
        (text(start, "0mm/s\", turn = \"5deg/s", &usual), "needs a turn other than 0"),
    ] {
        refused(&text, &["check", "{}"], &[reason]);
    }
}

/// Runs with equal seeds are equal in every process.
///
/// `cargo test -p metamorph-tests twenty_runs_are_equal -- --ignored --nocapture`
#[test]
#[ignore = "minutes: twenty runs"]
fn twenty_runs_are_equal() {
    let hashes: BTreeSet<_> = (0..20)
        .map(|_| {
            let report = report(&simulated(&["--kill", "2@18s"]).out);
            (report.trace_hash, report.state_hash)
        })
        .collect();
    println!("{hashes:?}");
    assert_eq!(hashes.len(), 1);
}

/// The value of a key of the report, which a schema describes.
#[test]
fn reports_follow_the_schema() {
    let schema: Value = serde_json::from_str(&run(&["schema", "report"]).out).unwrap();
    let ran = simulated(&["--set", "goal.0.walk.speed_at_least=0mm/s"]);
    let report: Value = serde_json::from_str(&ran.out).unwrap();
    Schema::new(&schema).accepts(&report, "the report");
}
