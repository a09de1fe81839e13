//! When the end of a run was decided: answers are the same on any number of threads, and their futures can be repeated.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::rescue::Rescue;
use metamorph_tests::command::{root, run, run_processes, scenario};
use metamorph_world_controller::experiments::why::answer::{Answer, PointReport};
use metamorph_world_controller::experiments::why::{WhyError, WhyRequest, answer};
use metamorph_world_controller::family::{begin, read_file, read_text};
use metamorph_world_controller::scenario::settings::Setting;
use metamorph_world_controller::scenario::{LinkKind, Overrides, Plan};
use std::num::NonZeroUsize;
use std::time::Duration;

/// Six blocks two wide stack themselves under the published rule, which is unsafe with delays as different as these.
const UNSAFE: &str = r#"
version = 1
[swarm]
start = { box = { min = [0, 0, 0], max = [5, 1, 0] } }
[[goal]]
shape = { box = { min = [0, 0, 0], max = [1, 1, 2] } }
[protocol]
connectivity = "gradient"
[link]
delay = "10ms..900ms"
"#;
/// A seed with which they fall apart.
const FALLS_APART: u64 = 73;

fn overrides(seed: u64, settings: &[&str]) -> Overrides {
    let set = |text: &&str| Setting { option: "--set", text: (*text).to_owned() };
    let settings = settings.iter().map(set).collect();
    Overrides { link: LinkKind::Sim, seed: Some(seed), settings, ..Overrides::default() }
}

fn chair(strategy: &str, seed: u64) -> Plan {
    let setting = format!("protocol.strategy={strategy}");
    read_file(&scenario("chair.toml"), &overrides(seed, &[&setting])).unwrap()
}

fn ask(plan: &Plan, jobs: usize, standstill: Option<usize>) -> Result<Answer, WhyError> {
    let request = WhyRequest {
        plan: plan.clone(),
        standstill,
        rescue: plan.swarm.has_rescue().then_some(Rescue::Off),
        budget: Duration::MAX,
        jobs: NonZeroUsize::new(jobs).unwrap(),
        json: None,
        plot: None,
        quiet: true,
    };
    answer(&request, &|| false, &|| false)
}

/// Carries out the future that options such as `--change links=3@51` describe.
fn future(plan: &Plan, options: &str) -> (Outcome, bool) {
    let mut plan = plan.clone();
    let changes = options.split(' ').filter(|word| *word != "--change");
    changes.for_each(|change| plan.add_change(change.parse().unwrap()));
    let mut run = begin(&plan);
    while run.step() {}
    (run.outcome(), run.violations().is_empty())
}

fn shares(answer: &Answer) -> Vec<f64> {
    answer.curve.iter().map(|point| point.share.rate).collect()
}

fn ends(answer: &Answer) -> [&PointReport; 2] {
    [&answer.before, &answer.after].map(|point| point.as_ref().unwrap())
}

/// A standstill that one event decided: the same answer on one thread and on three, and futures that the options repeat.
#[test]
fn an_instant_is_found_and_its_futures_can_be_repeated() {
    let plan = chair("slope", 10);
    let found = ask(&plan, 3, None).unwrap();
    let json = |answer: &Answer| serde_json::to_value(answer).unwrap();
    assert_eq!(json(&found), json(&ask(&plan, 1, None).unwrap()));
    assert_eq!((found.decided, found.end.as_str(), found.is_cut_short), ("instant", "deadlock", false));
    let [before, after] = ends(&found);
    assert_eq!(before.events + 1, after.events);
    assert!(before.share.low > 0.5 && after.share.high < 0.1, "{before:?} {after:?}");
    assert!(
        after.at_s < found.since_s && found.event.as_ref().unwrap().contains("module "),
        "{:?}",
        found.event
    );
    let shares = shares(&found);
    assert!(shares[0] > 0.2 && shares[shares.len() - 1] == 0.0, "{shares:?}");
    let decisions = found.decisions.as_ref().unwrap();
    assert!(!decisions.is_empty() && found.withheld as usize >= decisions.len(), "{found:?}");
    for decision in decisions {
        assert!(decision.p <= 0.05 && decision.after.share.rate > 0.4, "{decision:?}");
        let mut plan = plan.clone();
        plan.add_change(decision.change.parse().unwrap());
        let (outcome, _) = future(&plan, decision.after.repeat_yes.as_ref().unwrap());
        assert_eq!(outcome, Outcome::Built, "{decision:?}");
    }
    for (options, is_built) in
        [(&before.repeat_yes, true), (&before.repeat_no, false), (&after.repeat_no, false)]
    {
        let (outcome, _) = future(&plan, options.as_ref().unwrap());
        assert_eq!(outcome == Outcome::Built, is_built, "{options:?}: {outcome}");
    }
}

/// Under `greedy` this start allows no future, but other strategies build from it.
#[test]
fn a_start_that_decides_says_by_what() {
    let found = ask(&chair("greedy", 2), 3, None).unwrap();
    assert_eq!(found.decided, "start");
    let start = serde_json::to_value(found.start.unwrap()).unwrap();
    assert_eq!(start["cause"], "strategy");
    let share = |setting: &str| {
        let strategies = start["strategies"].as_array().unwrap();
        strategies.iter().find(|other| other["setting"] == setting).unwrap()["share"]["rate"]
            .as_f64()
            .unwrap()
    };
    assert!(
        share("protocol.strategy=planned") > 0.9 && start["all"]["high"].as_f64().unwrap() < 0.1,
        "{start}"
    );
}

/// A run that breaks an invariant: futures that break the same one become more, and can be repeated.
#[test]
fn a_broken_invariant_is_decided_before_it_breaks() {
    let plan = read_text("unsafe.toml", UNSAFE, &overrides(FALLS_APART, &[])).unwrap();
    let found = ask(&plan, 3, None).unwrap();
    assert_eq!((found.end.as_str(), found.sought.as_str()), ("unsafe", "body-connected"));
    let [before, after] = ends(&found);
    assert!(before.share.rate < after.share.rate && after.at_s < found.since_s, "{before:?} {after:?}");
    // A module that another one relied on leaves: the grant, or an input that it follows from.
    let decisions = found.decisions.as_ref().unwrap();
    assert!(decisions.iter().all(|d| d.after.share.rate < after.share.rate), "{decisions:?}");
    let shares = shares(&found);
    assert!(shares[0] < 0.1 && shares[shares.len() - 1] > 0.9, "{shares:?}");
    for (options, is_safe) in [(&after.repeat_yes, false), (&before.repeat_no, true)] {
        assert_eq!(future(&plan, options.as_ref().unwrap()).1, is_safe, "{options:?}");
    }
}

#[test]
fn a_run_that_was_built_has_nothing_to_explain() {
    let built = read_file(&scenario("box.toml"), &overrides(1, &[])).unwrap();
    assert!(matches!(ask(&built, 1, None), Err(WhyError::Built(0))));
    assert!(matches!(ask(&built, 1, Some(1)), Err(WhyError::NoStandstill { number: 1, of: 0 })));
}

/// The command: figure, JSON, journals, and what it refuses.
#[test]
fn the_command_explains_scenarios_and_journals() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str| dir.path().join(name).display().to_string();
    let own = ["--set", "protocol.strategy=slope", "--seed", "10"];
    let of_scenario = ["why", "chair", "--plot", &file("why.svg"), "--json", &file("why.json")];
    let told = run(&[&of_scenario[..], &own].concat());
    assert_eq!(told.code, Some(0), "{told:?}");
    assert!(told.out.contains("decided at ") && told.out.contains("--change links="), "{told:?}");
    let figure = std::fs::read_to_string(file("why.svg")).unwrap();
    assert!(figure.starts_with("<svg ") && !figure.contains("class=") && !figure.contains("NaN"), "{figure}");
    let kept = std::fs::read_to_string(root().join("docs/pictures/why-chair.svg")).unwrap();
    assert!(figure == kept, "docs/pictures/why-chair.svg is not what the command in docs/why.md draws");
    let journal = file("run.journal");
    run(&[&["run", "chair", "--link", "sim", "--journal", &journal, "-q"][..], &own].concat());
    let of_journal = run(&["why", &journal, "--json", &file("of-journal.json"), "-q"]);
    assert_eq!((of_journal.code, of_journal.out.as_str()), (Some(0), ""), "{of_journal:?}");
    let json = |name: &str| -> serde_json::Value {
        serde_json::from_str(&std::fs::read_to_string(file(name)).unwrap()).unwrap()
    };
    assert_eq!(json("why.json"), json("of-journal.json"));
    // The journal of a run of processes names the simulated run to explain.
    let processes = file("processes.journal");
    run_processes(&["run", "box", "--journal", &processes, "--time-scale", "200", "-q"]);
    let refused = run(&["why", &processes]);
    assert!(
        refused.code == Some(2) && refused.err.contains("the journal of a run of processes"),
        "{refused:?}"
    );
    let repeat = refused.err.split("its scenario: ").nth(1).unwrap().trim();
    assert!(repeat.starts_with("metamorph why box") && !repeat.contains("--link"), "{repeat}");
    let cut = run(&[&["why", "chair", "--budget", "1ns"][..], &own].concat());
    assert!(cut.code == Some(0) && cut.out.contains("the search was cut short"), "{cut:?}");
    for (line, part) in [
        (&["why", "box"][..], "name the seed of a run that was not"),
        (&["why", "box", "--standstill", "1"], "--standstill 1: the run never stood still"),
        (&["why", &journal, "--loss", "5%"], "--loss: a journal holds a run that is over"),
        (&["why", "chair", "--change", "links=7"], "`links=7` is not of the form KIND=VALUE@EVENTS"),
        (&["check", "box", "--link", "sim", "--change", "sleep=4/1s@9"], "there is no module 4"),
        (&["check", "box", "--link", "sim", "--change", "lose=4.0@9"], "`lose=4.0@9` is not of the form"),
        (
            &["run", "box", "--link", "ipc", "--change", "all=7@9"],
            "a change at an event in a run of processes",
        ),
    ] {
        let refused = run(line);
        assert!(refused.code == Some(2) && refused.err.contains(part), "{line:?}: {refused:?}");
    }
}
