//! Scenarios of metamodules on the command line: errors, reports, goals that change and obstacles.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{on, refused, report};
use metamorph_world_controller::family::metamodule::report::MetamoduleReport;
use metamorph_world_controller::report::schema::Report;
use std::fs;

const METAMODULES: &str = r#"
version = 1
name = "metamodules"

[swarm]
family = "metamodule"
kind = "SRS"
floor = { min = [0, 0], max = [12, 12] }
start = "random"

[[goal]]
shape = { box = [5, 5] }
order = "circular"

[stop]
timeout = "500s"
"#;

#[test]
fn bad_scenarios_of_metamodules_are_refused_with_place_reason_and_fix() {
    let with = |old: &str, new: &str| {
        assert!(METAMODULES.contains(old), "{old}");
        METAMODULES.replace(old, new)
    };
    let (goal, start) = ("shape = { box = [5, 5] }", "start = \"random\"");
    let levels = |seeds: &str| with(goal, &format!("levels = [{seeds}]"));
    let seed = |x, y, way: &str| format!("{{ foot = [{x}, {y}], directions = [{way}] }}");
    let (l, folded) = ("\"up\", \"up\", \"east\"", "\"up\", \"down\", \"up\"");
    let crowd: Vec<String> = (0..130).map(|i| format!("{{ at = [{}, {}] }}", i % 13, i / 13)).collect();
    let (bent, flat) = ("\"up\", \"up\", \"up\"", "\"east\", \"down\", \"east\"");
    let cases: &[(String, &[&str])] = &[
        // Keys of the other family.
        (
            with(goal, "shape = { sphere = { center = [0, 0, 0], radius = 2 } }"),
            &["`sphere` in the shape of a goal is for the family `cube`"],
        ),
        (
            with("kind", "move_time = \"1s\"\nkind"),
            &["scenario.toml:7:1:", "`move_time` in [swarm] is for the family `cube`", "family = \"cube\""],
        ),
        (
            with("order = \"circular\"", "growth = \"solid\""),
            &["`growth` in [[goal]] is for the family `cube`"],
        ),
        (with(goal, "seed = [5, 5, 0]"), &["`seed` in [[goal]] is for the family `cube`", "no `shape`"]),
        (
            with("[stop]", "[protocol]\nco_owners = true\n[stop]"),
            &["`co_owners` in [protocol] is for the family `cube`"],
        ),
        // Names.
        (with("SRS", "SSR"), &["scenario.toml:7:8:", "unknown kind `SSR`", "did you mean `SRS`?"]),
        (with("SRS", "single"), &["unknown kind `single`", "PAR, SRS, PER, SRZ"]),
        (with("circular", "cicular"), &["unknown order `cicular`", "did you mean `circular`?"]),
        (
            with("[stop]", "[protocol]\nstrategy = \"gredy\"\n[stop]"),
            &["unknown strategy `gredy`", "did you mean `greedy`?"],
        ),
        // The force field.
        (
            with("[stop]", "[protocol]\nprecedence = \"of\"\n[stop]"),
            &["scenario.toml:16:14:", "unknown precedence `of`", "did you mean `off`?"],
        ),
        (
            with("[stop]", "[protocol]\nprecedence = { within = 4 }\n[stop]"),
            &["precedence has no `by`", "by = \"seed-distance\""],
        ),
        (
            with(
                "[stop]",
                "[protocol]\nprecedence = { within = 13, by = \"id\" }\nstrategy = \"step\"\n[stop]",
            ),
            &["within is 13", "from 1 to 12"],
        ),
        (
            with("[stop]", "[protocol]\nprecedence = true\n[stop]"),
            &["expected \"off\" or a table", "precedence = { within = 4"],
        ),
        (
            with("[stop]", "[protocol]\nrepulsion = { decay = 1001 }\n[stop]"),
            &["scenario.toml:16:23:", "decay is 1001", "from 0 to 1000"],
        ),
        (
            with("[stop]", "[protocol]\nstrategy = \"negotiated\"\nsettled_repel = true\n[stop]"),
            &["`negotiated` has no force field", "`settled_repel`", "choose `greedy`"],
        ),
        (
            with("[stop]", "[protocol]\nstrategy = \"planned\"\nsettled_repel = true\n[stop]"),
            &["`planned` has no force field", "`settled_repel`", "choose `greedy`"],
        ),
        (
            with("[stop]", "[protocol]\nstrategy = \"greedy\"\nfallback = \"none\"\n[stop]"),
            &["`greedy` makes no plan of the whole", "leave `fallback` out, or choose `planned`"],
        ),
        (
            with("[stop]", "[protocol]\nstrategy = \"planned\"\nfallback = \"step\"\n[stop]"),
            &["unknown fallback `step`", "negotiated"],
        ),
        (
            with("[stop]", "[protocol]\nseed_authority = \"me\"\n[stop]"),
            &["unknown seed authority `me`", "neighbours"],
        ),
        (with("kind", "turn_time = \"0s\"\nkind"), &["turn_time is 0s", "1ms to 3600s"]),
        // The floor and the start.
        (with("max = [12, 12]", "max = [12, -1]"), &["scenario.toml:8:9:", "side of the floor is 0"]),
        (with("max = [12, 12]", "max = [12000, 12]"), &["side of the floor is 12001"]),
        (with("max = [12, 12]", "max = [12, 12, 0]"), &["expected the two coordinates of a connector"]),
        (with(start, &format!("{start}\ncount = 200")), &["scenario.toml:9:9:", "has no room for 200"]),
        (with(start, "start = \"anywhere\""), &["unknown start `anywhere`", "random"]),
        (
            with(start, "start = [{ at = [1, 1] }, { at = [3, 1] }, { at = [13, 1] }, { at = [1, 3] }]"),
            &["scenario.toml:9:44:", "the start at (13, 1) is not on the floor", "from (0, 0) to (12, 12)"],
        ),
        (
            with(
                start,
                "start = [{ at = [1, 1] }, { at = [3, 1] }, { at = [1, 3] }, { at = [3, 1], class = 2 }]",
            ),
            &["scenario.toml:9:61:", "metamodules 1 and 3 both start at (3, 1)"],
        ),
        (
            with(start, &format!("start = [{}]", crowd.join(", "))),
            &["scenario.toml:9:9:", "metamodule 0 starts with 129 others", "and has 128 ports"],
        ),
        (with(start, "start = [{ at = [1, 1], class = 4 }]"), &["quarter turns, is 4", "from 0 to 3"]),
        (with(start, "start = [{ at = [1, 1] }]\ncount = 4"), &["`count` is 4, but `start` lists 1"]),
        // Too few.
        (
            with(start, "start = [{ at = [1, 1] }]"),
            &["scenario.toml:9:9:", "4 seeds", "1 metamodules: 3 too few"],
        ),
        (with("kind", "count = 3\nkind"), &["scenario.toml:7:9:", "the swarm has 3 metamodules: 1 too few"]),
        (with("kind", "count = 2000\nkind"), &["count is 2000", "from 1 to 1000"]),
        // Goals.
        (
            with(goal, "shape = { box = [11, 5] }"),
            &["scenario.toml:12:17:", "the seed at (13, 5) is not on the floor"],
        ),
        (with(goal, "shape = { stool = [5, 5] }"), &["unknown key `stool`", "one shape, `box` or `chair`"]),
        (with(goal, "shape = { box = [5, 5], chair = [1, 1] }"), &["none or both"]),
        (with(goal, ""), &["[[goal]] has no `shape`"]),
        (with(goal, &format!("{goal}\nlevels = []")), &["either `shape` or `levels`, found both"]),
        (with(goal, "levels = []"), &["scenario.toml:11:", "there is no seed"]),
        (levels("[]"), &["scenario.toml:12:11:", "there is no seed"]),
        (
            levels(&format!("[{}]", seed(5, 5, folded))),
            &["scenario.toml:12:12:", "seed 1 has a cell in the floor or twice"],
        ),
        (levels(&format!("[{}]", seed(5, 5, flat))), &["in the floor"]),
        (
            levels(&format!("[{}], [{}]", seed(5, 5, l), seed(6, 5, bent))),
            &["scenario.toml:12:68:", "seeds 1 and 2 both need the cell [6, 5, 2]"],
        ),
        (
            levels(&format!("[{}]", seed(5, 5, "\"up\", \"upp\", \"up\""))),
            &["unknown direction `upp`", "did you mean `up`?"],
        ),
        (levels(&format!("[{}]", seed(5, 5, "\"up\""))), &["expected three directions"]),
        // The mirror image of a possible shape.
        (
            levels(&format!("[{}]", seed(5, 5, "\"up\", \"north\", \"west\""))),
            &["scenario.toml:12:12:", "no posture of a metamodule of kind SRS fills the seed at (5, 5)"],
        ),
        (levels("[{ foot = [5, 5] }]"), &["a seed has no `directions`"]),
        (levels("{ foot = [5, 5] }"), &["expected a list, found a table"]),
        (with("shape", "at = \"5s\"\nshape"), &["scenario.toml:12:6:", "the first goal has an `at`"]),
        (
            format!("{METAMODULES}[[goal]]\n{goal}\n"),
            &["scenario.toml:17:1:", "a later [[goal]] has no `at`"],
        ),
        (
            format!("{METAMODULES}[[goal]]\n{goal}\nat = \"60s\"\n[[goal]]\n{goal}\nat = \"60s\"\n"),
            &["scenario.toml:22:6:", "replaces the previous one at 60s, but that one starts at 60s"],
        ),
        (
            format!("{METAMODULES}[[goal]]\n{goal}\nat = \"501s\"\n"),
            &["scenario.toml:19:6:", "it happens at 501s, but the run ends at 500s"],
        ),
        (
            format!("{METAMODULES}[[goal]]\nshape = {{ chair = [5, 5] }}\nat = \"9s\"\n")
                .replace("kind", "count = 5\nkind"),
            &["scenario.toml:7:9:", "6 seeds", "5 metamodules: 1 too few"],
        ),
        // Faults and ends.
        (
            format!("{METAMODULES}[[fault]]\nkill = 4\nat = \"1s\"\n"),
            &["scenario.toml:18:8:", "no module 4", "modules 0 to 3"],
        ),
        (
            format!("{METAMODULES}[[fault]]\nobstacle = [1, 1]\nat = \"1s\"\n"),
            &["the three coordinates of a cell"],
        ),
        (format!("{METAMODULES}[[fault]]\nobstacle = [1, 1, 1]\n"), &["[[fault]] has no `at`"]),
        (
            format!("{METAMODULES}[[fault]]\nobstacle = [1, 1, 1]\nkill = 3\nat = \"1s\"\n"),
            &["this one has kill and obstacle"],
        ),
    ];
    for (text, parts) in cases {
        refused(text, &["check", "{}", "--link", "sim"], parts);
    }
}

/// Returns the part of a report that only metamodules have.
fn metamodules(report: &Report) -> MetamoduleReport {
    serde_json::from_value(report.family_parts["metamodules"].clone()).unwrap()
}

#[test]
fn metamodules_are_checked_run_and_reported() {
    let ran = on(METAMODULES, &["check", "{}", "--link", "sim"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    for part in ["4 metamodules of kind SRS", "goal 1: 4 seeds", "strategy ", "from (0, 0) to (12, 12)"] {
        assert!(ran.out.contains(part), "`{part}` is missing in {}", ran.out);
    }
    let ran = on(METAMODULES, &["run", "{}", "--link", "sim", "--json", "-", "--loss", "1%"]);
    let report = report(&ran.out);
    assert!(matches!(ran.code, Some(0 | 3..=5)), "{ran:?}");
    assert_eq!((report.family.as_str(), report.goal.cells, report.invariants.broken), ("metamodule", 4, 0));
    let m = metamodules(&report);
    assert_eq!((m.kind.as_str(), m.connections), ("SRS", report.moves));
    assert!(m.turns > m.connections && m.connections > 0, "{m:?}");
    assert_eq!(report.move_details.completed, m.turns + m.connections + m.releases);
    let c = report.collisions;
    assert_eq!(c.attempted, c.prevented + c.refused + c.suffered);
    for (class, c) in report.messages.by_class {
        let out = c.delivered + c.lost + c.overflowed + c.expired + c.refused;
        assert_eq!((c.sent + c.duplicated) as i64, out as i64 + c.in_flight, "{class}");
    }
    assert!(ran.err.contains("seeds filled") && ran.err.contains("the interlock"), "{}", ran.err);
}

/// The metamodules detect their deadlock; the report says which one did, and why each of them waits.
#[test]
fn a_deadlock_is_detected_by_the_swarm_itself() {
    let text = METAMODULES.to_owned() + "[protocol]\nstrategy = \"greedy\"\ndetector = true\n";
    let ran = on(&text, &["check", "{}"]);
    assert!(ran.out.contains("the swarm finds deadlocks by itself"), "{ran:?}");
    assert!(
        ran.out.contains("the metamodule nearer to a seed goes first within 4 connectors; no repulsion"),
        "{ran:?}"
    );
    let step = ["check", "{}", "--set", "protocol.strategy=step", "--set", "protocol.repulsion.range=8"];
    let ran = on(&text, &step);
    let pushes = "no precedence; repulsion within 8 cells by 600/1000, 0/1000 of it lost at the edge, also settled ones";
    assert!(ran.out.contains(pushes), "{ran:?}");
    let deadlocked = (0..20).find_map(|seed: u32| {
        let ran = on(&text, &["run", "{}", "--link", "sim", "--seed", &seed.to_string(), "--json", "-"]);
        (ran.code == Some(3)).then_some((seed.to_string(), ran))
    });
    let (standstill_seed, ran) = deadlocked.expect("greedy deadlocks often");
    let standstill = report(&ran.out).unbuilt.expect("the reason of the standstill");
    assert!(standstill.detected.is_some(), "{standstill:?}");
    assert!(standstill.waiting.iter().all(|w| !w.why.is_empty()) && !standstill.waiting.is_empty());
    assert!(ran.err.contains("found this out"), "{}", ran.err);
    // The report for people gives the same reasons.
    let directory = tempfile::tempdir().unwrap();
    let html = directory.path().join("report.html");
    let args = [
        "run",
        "{}",
        "--link",
        "sim",
        "--seed",
        &standstill_seed,
        "--quiet",
        "--html",
        html.to_str().unwrap(),
    ];
    assert_eq!(on(&text, &args).code, Some(3));
    let page = fs::read_to_string(html).unwrap();
    assert!(page.contains("The swarm detected this itself"), "{page}");
    assert!(standstill.waiting.iter().all(|w| page.contains(&w.why)), "{page}");
    let negotiated = text.replace("greedy", "negotiated");
    let refused = on(&negotiated, &["check", "{}"]);
    assert!(refused.code == Some(2) && refused.err.contains("has no detector"), "{refused:?}");
}

/// Goals that replace one another and obstacles, from the scenario to the report.
#[test]
fn goals_change_and_obstacles_come_and_go() {
    let text = METAMODULES.replace("timeout = \"500s\"", "timeout = \"5000s\"")
        + "[protocol]\nstrategy = \"negotiated\"\nrelocate = true\n"
        + "[[goal]]\nname = \"elsewhere\"\nshape = { box = [1, 1] }\nat = \"30s\"\n"
        + "[[fault]]\nobstacle = [6, 6, 4]\nat = \"10s\"\nuntil = \"20s\"\n"
        // In a cell of the second goal, before it is the goal.
        + "[[fault]]\nobstacle = [1, 1, 2]\nat = \"25s\"\n";
    let ran = on(&text, &["check", "{}", "--link", "sim"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    for part in ["elsewhere: 4 seeds", "from 30s on", "strategy negotiated", "at 10s block [6, 6, 4]"] {
        assert!(ran.out.contains(part), "`{part}` is missing in {}", ran.out);
    }
    let ran = on(&text, &["run", "{}", "--link", "sim", "--json", "-"]);
    let report = report(&ran.out);
    assert_eq!((ran.code, report.outcome.as_str()), (Some(0), "built"), "{}", ran.err);
    let stages: Vec<_> = report.stages.iter().map(|s| (s.name.as_str(), s.opened_s, s.built_s)).collect();
    let [first, (name, opened, Some(built))] = stages[..] else { panic!("{stages:?}") };
    assert_eq!((first.1, first.2, name, opened), (0.0, None, "elsewhere", 30.0), "{stages:?}");
    assert!(built > opened);
    let m = metamodules(&report);
    assert_eq!((m.levels.len(), m.levels[0].seeds, m.levels[0].filled), (1, 4, 4));
    assert_ne!(m.shift, [0, 0], "the goal had to make way for the obstacle");
    let faults: Vec<_> = report.faults.iter().map(|f| (f.fault.as_str(), f.module)).collect();
    assert_eq!(faults, [("block", None), ("unblock", None), ("block", None)]);
    assert!(report.faults[0].effect.contains("the cell was free"), "{:?}", report.faults);
}
