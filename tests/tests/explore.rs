//! Exploration: what is known to be wrong is found and made small, what was wrong once is right, and
//! new scenarios are tried every time.
#![allow(clippy::print_stdout, reason = "what it took is printed for whoever asks with --nocapture")]
#![allow(clippy::unwrap_used, reason = "what cannot be done here fails the test")]

use metamorph_module_agent::Family;
use metamorph_protocol::cube::params::Connectivity;
use metamorph_protocol::sabotage::Sabotage;
use metamorph_tests::command::{root, run as metamorph};
use metamorph_world_controller::explore::draft::{Draft, SwarmDraft};
use metamorph_world_controller::explore::draw::draw;
use metamorph_world_controller::explore::verdict::{Kind, Verdict};
use metamorph_world_controller::explore::{Small, make_small, run};
use metamorph_world_controller::interrupt::Interrupt;
use metamorph_world_controller::scenario::{LinkKind, Overrides, read_file};
use std::fs;
use std::hash::{BuildHasher, RandomState};
use std::sync::atomic::{AtomicUsize, Ordering};

/// A defect, the family that has it, and how many runs may pass until it is found.
struct Wrong {
    defect: Sabotage,
    family: Family,
    within: u64,
}

const fn cube(defect: Sabotage, within: u64) -> Wrong {
    Wrong { defect, family: Family::Cube, within }
}
const fn metamodule(defect: Sabotage, within: u64) -> Wrong {
    Wrong { defect, family: Family::Metamodule, within }
}

const WRONG: [Wrong; 21] = [
    cube(Sabotage::IgnoreSessions, 400),
    cube(Sabotage::NoDeadline, 400),
    cube(Sabotage::ShortLease, 400),
    cube(Sabotage::IgnoreLocks, 400),
    cube(Sabotage::KeepLocks, 400),
    cube(Sabotage::ReserveTwice, 400),
    cube(Sabotage::DropSilentChildren, 400),
    cube(Sabotage::AdoptUnacknowledged, 400),
    cube(Sabotage::NoListening, 400),
    cube(Sabotage::IgnoreStrangers, 400),
    cube(Sabotage::ShallowSearch, 400),
    cube(Sabotage::AcceptStaleValues, 400),
    cube(Sabotage::AnyLowerOnSolids, 400),
    metamodule(Sabotage::GrantEverything, 60),
    metamodule(Sabotage::AskNobody, 60),
    metamodule(Sabotage::ForgetGrants, 60),
    metamodule(Sabotage::OutstayLease, 60),
    metamodule(Sabotage::GrantAfterRestart, 60),
    metamodule(Sabotage::AcceptStaleStates, 60),
    metamodule(Sabotage::IgnoreClaims, 60),
    metamodule(Sabotage::StandInTheWay, 60),
];

/// How a scenario fails with a defect, if it does, and does not without it.
fn fails_by(defect: Sabotage, draft: &Draft) -> Option<Kind> {
    let interrupt = Interrupt::default();
    let judged = |sabotage| run(&draft.plan("drawn.toml", sabotage).ok()?, &interrupt).map(|r| r.verdict);
    match judged(Some(defect))? {
        Verdict::Failed(failure) => {
            let sound = !matches!(judged(None), Some(Verdict::Failed(f)) if f.kind == failure.kind);
            sound.then_some(failure.kind)
        }
        _ => None,
    }
}

/// Explores with a defect until it is found, and makes what was found small.
fn find(wrong: &Wrong) -> Result<(u64, Kind, Small), String> {
    for seed in 1..=wrong.within {
        let (draft, _) = draw(seed, Some(wrong.family));
        if let Some(kind) = fails_by(wrong.defect, &draft) {
            let small =
                make_small(&draft, &kind, Some(wrong.defect), wrong.within * 2, &Interrupt::default());
            let small = small.ok_or_else(|| format!("{:?}: seed {seed} fails only once", wrong.defect))?;
            return Ok((seed, kind, small));
        }
    }
    Err(format!("{:?} was not found in {} runs", wrong.defect, wrong.within))
}

/// Every defect is found within its budget, and what was found is made small enough to be read.
#[test]
fn every_known_defect_is_found_and_made_small() {
    let next = AtomicUsize::new(0);
    let work = || {
        let mut wrong = Vec::new();
        while let Some(of) = WRONG.get(next.fetch_add(1, Ordering::Relaxed)) {
            match find(of) {
                Ok((runs, kind, small)) => {
                    let (agents, faults) = (small.draft.modules(), small.draft.faults.len());
                    println!(
                        "{:?}: {kind} after {runs} runs; small with {agents} agents and {faults} faults ({} runs)",
                        of.defect, small.runs
                    );
                    if agents > 4 && faults > 10 {
                        wrong.push(format!("{:?} is still large:\n{}", of.defect, small.draft));
                    }
                }
                Err(complaint) => wrong.push(complaint),
            }
        }
        wrong
    };
    let wrong: Vec<String> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..2).map(|_| scope.spawn(work)).collect();
        workers.into_iter().flat_map(|w| w.join().unwrap()).collect()
    });
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(Sabotage::ALL.iter().all(|d| WRONG.iter().any(|w| w.defect == *d)));
}

/// The published connection gradient, which exploration leaves out, tears bodies.
#[test]
fn the_published_gradient_is_found_too() {
    let interrupt = Interrupt::default();
    let torn = (1..=500).find(|seed| {
        let (mut draft, _) = draw(*seed, Some(Family::Cube));
        if let SwarmDraft::Cubes(cubes) = &mut draft.swarm {
            cubes.connectivity = Connectivity::Gradient;
        }
        let verdict = run(&draft.plan("drawn.toml", None).unwrap(), &interrupt).unwrap().verdict;
        matches!(verdict, Verdict::Failed(f) if f.kind == Kind::Unsafe("body-connected".into()))
    });
    println!("the published gradient: torn after {torn:?} runs");
    assert!(torn.is_some());
}

/// What failed once does not fail any more.
#[test]
fn past_failures_stay_past() {
    let (interrupt, mut replayed) = (Interrupt::default(), 0);
    for entry in fs::read_dir(root().join("tests/corpus")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|e| e != "toml") {
            continue;
        }
        let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
        let plan = read_file(&path, &overrides).unwrap_or_else(|problems| panic!("{problems}"));
        let verdict = run(&plan, &interrupt).unwrap().verdict;
        assert!(!matches!(verdict, Verdict::Failed(_)), "{}: {verdict:?}", path.display());
        replayed += 1;
    }
    assert!(replayed > 0, "the corpus is empty");
}

/// So many new scenarios of each family are tried every time.
const FRESH: u64 = 150;

/// New scenarios every time: no invariant breaks, whatever is drawn.
#[test]
fn new_scenarios_break_no_invariant() {
    let from = RandomState::new().hash_one(0) >> 28;
    println!("new scenarios from seed {from}");
    for family in [Family::Cube, Family::Metamodule] {
        for seed in from..from + FRESH {
            let (draft, plan) = draw(seed, Some(family));
            let verdict = run(&plan, &Interrupt::default()).unwrap().verdict;
            let broken = matches!(&verdict, Verdict::Failed(f) if f.kind.is_unsafe());
            let repeat = format!("metamorph explore --runs 1 --seed {seed} --family {}", family.name());
            assert!(!broken, "{verdict:?}\n  {repeat}\n{draft}");
        }
    }
}

/// As a user types it: the same results with any number of threads, in JSON and for people.
#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let out = tempfile::tempdir().unwrap();
    let explore = |jobs: &str, json: &str| {
        let (dir, json) = (out.path().join(jobs).display().to_string(), out.path().join(json));
        let json = json.display().to_string();
        let args = ["explore", "--runs", "40", "--seed", "7", "--jobs", jobs, "--out", &dir, "--json", &json];
        let ran = metamorph(&args);
        assert!(matches!(ran.code, Some(0 | 3 | 6)), "{ran:?}");
        assert!(ran.out.contains("exploring from seed 7") && ran.out.contains("rare paths"), "{ran:?}");
        let text = fs::read_to_string(json).unwrap();
        text.replace(&dir, "DIR")
    };
    let one = explore("1", "one.json");
    assert_eq!(one, explore("3", "three.json"));
    let summary: serde_json::Value = serde_json::from_str(&one).unwrap();
    assert_eq!((summary["runs"].as_u64(), summary["seed"].as_u64()), (Some(40), Some(7)));
    assert_eq!(summary["outcomes"].as_object().unwrap().values().filter_map(|n| n.as_u64()).sum::<u64>(), 40);
    assert!(summary["marks"].as_object().unwrap().len() > 10);
}

/// One run shows its scenario first, and that scenario is one that can be run.
#[test]
fn one_run_shows_its_scenario() {
    let ran = metamorph(&["explore", "--runs", "1", "--seed", "5", "--family", "cube"]);
    assert!(matches!(ran.code, Some(0 | 3)), "{ran:?}");
    let (draft, _) = draw(5, Some(Family::Cube));
    assert!(ran.out.contains(&draft.to_string()), "{ran:?}");
    let ran = metamorph(&["explore", "--runs", "1", "--seconds", "1"]);
    assert_eq!(ran.code, Some(2), "{ran:?}");
}
