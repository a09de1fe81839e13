//! No text makes the scenario reader panic, and every refusal has a place and a fix.

use metamorph_tests::command::{root, scenarios};
use metamorph_world_controller::family::cube::Cubes;
use metamorph_world_controller::family::metamodule::Metamodules;
use metamorph_world_controller::family::{read_file, read_text};
use metamorph_world_controller::scenario::settings::Setting;
use metamorph_world_controller::scenario::{LinkKind, Overrides};
use proptest::prelude::*;
use std::fs;

fn sim() -> Overrides {
    Overrides { link: LinkKind::Sim, ..Overrides::default() }
}

/// Reads a scenario, and checks that a refusal can be shown.
fn survives(text: &str, overrides: &Overrides) {
    if let Err(diagnostics) = read_text("fuzz.toml", text, overrides) {
        assert!(!diagnostics.list().is_empty());
        let shown = diagnostics.to_string();
        assert!(shown.contains("fix: "), "{shown}");
    }
}

/// A small scenario with every kind of value in it, so that mutations reach every branch quickly.
const EVERYTHING: &str = r#"
version = 1
name = "everything"
description = "all keys"
seed = 3
[swarm]
family = "cube"
start = { union = [{ box = { min = [0, 0, 0], max = [5, 5, 0] } }, { cells = [[0, 0, 1], [1, 0, 1]] }] }
move_time = "1s"
failed_connections = "1%"
[[goal]]
name = "one"
shape = { difference = [{ sphere = { center = [2, 2, 0], radius = 2.5 } }, { disc = { center = [2, 2, 2], radius = 1, axis = "z" } }] }
seed = [2, 2, 0]
growth = "scaffold"
[[goal]]
shape = { cylinder = { base = [2, 2, 0], radius = 2, height = 1, axis = "z" } }
growth = "solid"
[protocol]
connectivity = "forest"
dead = "hold"
co_owners = true
[link]
delay = "10ms..100ms"
loss = "5%"
duplicate = 0.01
reorder = "1/50"
corrupt = 0
[process]
time_scale = 20
[[fault]]
kill = 3
at = "2s"
[[fault]]
pause = [2, 4]
from = "1s"
until = "3s"
[[fault]]
restart = 5
at = "4s"
memory = false
[[fault]]
stick = 7
at = "1s"
until = "9s"
[[fault]]
crash = { fraction = "5%", between = "0s..60s" }
[[fault]]
partition = { modules = [1, 2, 3], from = "5s", until = "10s" }
[stop]
timeout = "1000s"
stall = "300s"
livelock = "900s"
"#;

/// The same for metamodules.
const METAMODULES: &str = r#"
version = 1
name = "everything"
seed = 3
[swarm]
family = "metamodule"
kind = "PER"
count = 3
start = [{ at = [1, 2], class = 3 }, { at = [8, 2] }, { at = [9, 9], class = 1 }]
floor = { min = [-1, 0], max = [12, 11] }
turn_time = "1s"
communication_range = 10
failed_connections = "5%"
[[goal]]
name = "one"
levels = [
  [{ foot = [5, 5], directions = ["up", "up", "east"] }, { foot = [3, 3], directions = ["up", "up", "up"] }],
  [{ foot = [7, 7], directions = ["up", "up", "west"] }],
]
order = "crosswise"
[[goal]]
name = "two"
at = "60s"
levels = [[{ foot = [2, 8], directions = ["up", "up", "up"] }]]
order = "at-once"
[protocol]
strategy = "negotiated"
seed_authority = "neighbours"
relocate = true
[link]
delay = "10ms..100ms"
loss = "5%"
[process]
time_scale = 20
[[fault]]
obstacle = [4, 4, 0]
at = "1s"
until = "99s"
[[fault]]
kill = 1
at = "2s"
[[fault]]
crash = { count = 1, between = "0s..60s" }
[stop]
timeout = "1000s"
stall = "300s"
livelock = "900s"
"#;

#[test]
fn the_bases_of_the_mutations_are_valid() {
    let plan = read_text("metamodules.toml", METAMODULES, &sim()).unwrap_or_else(|p| panic!("{p}"));
    assert_eq!((plan.swarm.len(), plan.stages.len(), plan.schedule.len()), (3, 2, 4));
    let plan = read_text("everything.toml", EVERYTHING, &sim()).unwrap_or_else(|p| panic!("{p}"));
    assert_eq!((plan.swarm.len(), plan.stages.len(), plan.seed), (38, 2, 3));
    assert_eq!(plan.schedule.len(), 1 + 4 + 1 + 2 + 1);
    assert_eq!(plan.link.partitions.len(), 1);
}

#[test]
fn shipped_scenarios_are_valid_on_both_links() {
    for path in scenarios() {
        for link in [LinkKind::Sim, LinkKind::Ipc] {
            let overrides = Overrides { link, ..Overrides::default() };
            let plan = read_file(&path, &overrides).unwrap_or_else(|diagnostics| panic!("{diagnostics}"));
            let largest = match plan.swarm.of::<Cubes>() {
                Some(cubes) => cubes.setup.goals.iter().map(|goal| goal.len()).max(),
                None => match plan.swarm.of::<Metamodules>() {
                    Some(swarm) => swarm.setup.goals.iter().map(|goal| goal.seeds().len()).max(),
                    // All free modules are part of the goal.
                    None => Some(plan.swarm.len()),
                },
            };
            let count = plan.swarm.len();
            assert!(largest.is_some_and(|cells| cells > 0 && cells <= count), "{}", path.display());
        }
    }
}

/// The examples in README.md are valid.
#[test]
fn the_scenarios_of_the_readme_are_valid() {
    let readme = fs::read_to_string(root().join("README.md")).expect("README.md is there");
    let blocks = readme.split("```toml\n").skip(1).map(|rest| rest.split("```").next().unwrap_or_default());
    let blocks: Vec<&str> = blocks.collect();
    assert_eq!(blocks.len(), 2, "one of each family");
    for text in blocks {
        read_text("README.md", text, &sim()).unwrap_or_else(|diagnostics| panic!("{diagnostics}"));
    }
}

/// One change to a text.
#[derive(Clone, Debug)]
enum Change {
    Delete(usize, usize),
    Insert(usize, String),
    Swap(usize, usize),
    Number(usize, i64),
}

fn change() -> impl Strategy<Value = Change> {
    let pieces = prop_oneof![
        "[\\[\\]{}\"=.,'#\\n -]{1,4}",
        Just("99999999999999999999".to_owned()),
        Just("-1".to_owned()),
        Just("nan".to_owned()),
        Just("inf".to_owned()),
        Just("1e308".to_owned()),
        Just("\u{0}é\u{202e}".to_owned()),
        "[a-z_]{1,9} = [0-9]{1,3}\n",
        any::<String>(),
    ];
    prop_oneof![
        (any::<usize>(), 1..40usize).prop_map(|(at, n)| Change::Delete(at, n)),
        (any::<usize>(), pieces).prop_map(|(at, text)| Change::Insert(at, text)),
        (any::<usize>(), any::<usize>()).prop_map(|(a, b)| Change::Swap(a, b)),
        (any::<usize>(), prop_oneof![-20_000..20_000i64, any::<i64>()])
            .prop_map(|(at, n)| Change::Number(at, n)),
    ]
}

fn apply(text: &str, change: &Change) -> String {
    let mut chars: Vec<char> = text.chars().collect();
    let len = chars.len().max(1);
    match change {
        Change::Delete(at, n) => {
            let at = at % len;
            chars.drain(at..(at + n).min(chars.len()));
        }
        Change::Insert(at, piece) => {
            let at = (at % len).min(chars.len());
            chars.splice(at..at, piece.chars());
        }
        Change::Swap(a, b) if chars.len() > 1 => chars.swap(a % len, b % len),
        Change::Swap(..) => {}
        // The next number after a position becomes another one.
        Change::Number(at, n) => {
            let from = at % len;
            if let Some(start) = (from..chars.len()).find(|i| chars[*i].is_ascii_digit()) {
                let end = (start..chars.len()).find(|i| !chars[*i].is_ascii_digit()).unwrap_or(chars.len());
                chars.splice(start..end, n.to_string().chars());
            }
        }
    }
    chars.into_iter().collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1_000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn survives_mutations(changes in prop::collection::vec(change(), 1..6)) {
        for base in [EVERYTHING, METAMODULES] {
            let text = changes.iter().fold(base.to_owned(), |text, c| apply(&text, c));
            survives(&text, &sim());
        }
    }

    #[test]
    fn survives_any_text(text in any::<String>()) {
        survives(&text, &sim());
    }

    #[test]
    fn survives_toml_like_text(text in "([a-z]{1,6}( = |\\.|\\[|\\]|\\{|\\}|\"|[0-9]{1,6}|\n|, ){1,3}){0,30}") {
        survives(&text, &sim());
    }

    #[test]
    fn survives_any_option(kill in any::<String>(), pause in "[0-9]{0,4}@?[0-9sm.-]{0,9}(\\.\\.)?[0-9sm-]{0,5}",
                           loss in any::<String>(), delay in "[0-9.smun-]{0,40}", scale in any::<String>()) {
        let overrides = Overrides {
            kill: vec![kill],
            pause: vec![pause],
            loss: Some(loss),
            delay: Some(delay),
            time_scale: Some(scale),
            ..sim()
        };
        survives(EVERYTHING, &overrides);
        survives(METAMODULES, &overrides);
    }

    #[test]
    fn survives_any_setting(any in any::<String>(), value in any::<String>(),
                            key in "(goal|swarm|link|fault|start|shape|seed|loss|min|[0-9]){1}(\\.(0|1|9|seed|start|box|loss|x)){0,4}",
                            toml in "([a-z0-9=\"{}\\[\\], .%-]){0,30}") {
        let setting = |text| Setting { option: "--set", text };
        for texts in [vec![any], vec![format!("{key}={value}"), format!("{key}={toml}")]] {
            let overrides = Overrides { settings: texts.into_iter().map(setting).collect(), ..sim() };
            survives(EVERYTHING, &overrides);
            survives(METAMODULES, &overrides);
        }
    }
}

/// Another seed gives another start and other crashes, and the seed that a plan was read with gives the same
/// plan.
#[test]
fn seeds_are_drawn_from_again_without_reading_again() {
    let drawn = METAMODULES.replace("start = [", "# start = [");
    let plan = read_text("metamodules.toml", &drawn, &sim()).unwrap_or_else(|p| panic!("{p}"));
    let of = |seed| {
        let plan = plan.with_seed(seed).expect("the floor has room");
        let m = plan.swarm.of::<Metamodules>().expect("metamodules");
        (plan.seed, m.poses.clone(), plan.schedule.clone())
    };
    let m = plan.swarm.of::<Metamodules>().expect("metamodules");
    assert_eq!(of(3), (3, m.poses.clone(), plan.schedule.clone()));
    assert!(of(3).1 != of(4).1 && of(3).2 != of(4).2);
    let overrides = Overrides { seed: Some(4), ..sim() };
    let again = read_text("metamodules.toml", &drawn, &overrides).unwrap_or_else(|p| panic!("{p}"));
    let m = again.swarm.of::<Metamodules>().expect("metamodules");
    assert_eq!(of(4), (4, m.poses.clone(), again.schedule.clone()));
}

/// Bytes that are not text are refused when the file is read.
#[test]
fn bytes_that_are_not_text_are_refused() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("bytes.toml");
    for bytes in [&[0xFFu8, 0xFE, 0x00][..], &[0xC3, 0x28], &[0x80; 100]] {
        fs::write(&path, bytes).unwrap();
        let diagnostics = read_file(&path, &sim()).unwrap_err();
        assert!(diagnostics.to_string().contains("not UTF-8"), "{diagnostics}");
    }
}
