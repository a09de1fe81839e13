//! What commands to metamodules do, what they cannot do, and how a scripted operator helps swarms that are stuck.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::SeedOrder;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::director::faults::{Fault, Target, WorldFault};
use metamorph_sim_bridge::director::steering::Steering;
use metamorph_sim_bridge::metamodule::faults::{GOAL_DROPPED, GOAL_SET, GOAL_TURNED, TUNED};
use metamorph_tests::command::{report, root, run, scenario};
use metamorph_tests::json_schema::Schema;
use metamorph_tests::metamodules::{Assembled, Assembly, Goal};
use metamorph_world_controller::family::families;
use metamorph_world_controller::report::schema::Report;
use metamorph_world_controller::scenario::schema::schema;
use std::fs;
use std::path::Path;

const LEASE: Span = Span::secs(60);

fn assembly(strategy: Strategy, seed: u64) -> Assembly {
    Assembly::new(Goal::Box, Kind::Srs, strategy, SeedOrder::Crosswise, seed)
}
fn steer(id: u32, steering: Steering) -> Fault {
    Fault::Steer(ModuleId(id), steering)
}
fn effects(ran: &Assembled) -> Vec<&str> {
    ran.struck.iter().map(|fault| fault.effect.as_str()).collect()
}

#[test]
fn a_metamodule_that_is_held_does_not_move() {
    // None is spare, so the goal is built only after the lease.
    let ran =
        assembly(Strategy::Negotiated, 3).fault(Time(1), steer(2, Steering::Hold(Span::secs(600)))).run();
    let free = assembly(Strategy::Negotiated, 3).run();
    assert!(ran.built() && free.built(), "{:?}", ran.outcome);
    let at = |ran: &Assembled| ran.outcome.unwrap().0;
    assert!(at(&free) < Time(600_000_000_000) && at(&ran) > Time(600_000_000_000), "{:?}", ran.outcome);
    // A release ends it earlier.
    let released = Time(100_000_000_000);
    let ran = assembly(Strategy::Negotiated, 3)
        .fault(Time(1), steer(2, Steering::Hold(Span::secs(600))))
        .fault(released, steer(2, Steering::Release))
        .run();
    assert!(ran.built() && at(&ran) > released && at(&ran) < Time(600_000_000_000), "{:?}", ran.outcome);
    assert_eq!(ran.broken, 0);
}

#[test]
fn metamodules_go_where_they_are_sent_and_take_what_they_are_given() {
    let to = Cell { x: 0, y: 12, z: 0 };
    for strategy in [Strategy::Greedy, Strategy::Step, Strategy::Negotiated] {
        let mut arrived = 0;
        for seed in 0..6 {
            // Dead, it stays where it has been sent; the others are held meanwhile.
            let ran = assembly(strategy, seed)
                .fault(Time(1), steer(0, Steering::GoTo(to, Span::secs(600))))
                .fault(Time(2), steer(1, Steering::Take(0, Span::secs(600))))
                .fault(Time(3), steer(2, Steering::Hold(Span::secs(600))))
                .fault(Time(4), steer(3, Steering::Hold(Span::secs(600))))
                .fault(Time(300_000_000_000), Fault::Kill(ModuleId(0)))
                .run();
            assert_eq!(ran.broken, 0, "{strategy:?} {seed}: {:?}", ran.violations);
            arrived += u64::from(ran.poses[0].foot() == (to.x, to.y) && ran.filled >= 1);
        }
        assert!(arrived >= 5, "{strategy:?}: {arrived} of 6");
    }
}

#[test]
fn rules_refuse_commands_and_are_named() {
    let refused = |strategy, at: Time, fault: Fault| {
        let ran = assembly(strategy, 3).fault(at, fault).run();
        assert_eq!(ran.broken, 0);
        let effects = effects(&ran).join(" ");
        let rule = effects.split_once("refused: ").map(|(_, rule)| rule.to_owned());
        rule.unwrap_or_else(|| panic!("{fault} was taken: {effects}"))
    };
    let off = Cell { x: 13, y: 0, z: 0 };
    let early = Time(1_000_000_000);
    assert!(
        refused(Strategy::Negotiated, early, steer(0, Steering::GoTo(off, LEASE))).starts_with("floor: ")
    );
    assert!(refused(Strategy::Negotiated, early, steer(0, Steering::Take(7, LEASE))).starts_with("goal: "));
    assert!(refused(Strategy::Planned, early, steer(0, Steering::Hold(LEASE))).starts_with("central-plan: "));
    let swap = steer(0, Steering::Swap(ModuleId(1)));
    assert!(refused(Strategy::Negotiated, early, swap).starts_with("no-command: "));
    let tune = world(&TUNED, Target::Word("strategy=slope"));
    assert!(refused(Strategy::Negotiated, early, tune).starts_with("strategy: "));
    for (goal, strategy) in [(1, Strategy::Negotiated), (0, Strategy::Greedy)] {
        let why = refused(strategy, early, world(&GOAL_SET, Target::Number(goal)));
        assert!(why.starts_with("goal: "), "{why}");
    }
    for (kind, target, rule) in
        [(&GOAL_TURNED, Target::Number(4), "turn: "), (&GOAL_DROPPED, Target::Nothing, "central-plan: ")]
    {
        let why = refused(Strategy::Planned, early, world(kind, target));
        assert!(why.starts_with(rule), "{why}");
    }
    let dead = assembly(Strategy::Negotiated, 3)
        .spares(1)
        .fault(early, Fault::Kill(ModuleId(0)))
        .fault(Time(2_000_000_000), steer(0, Steering::Hold(LEASE)))
        .run();
    assert!(effects(&dead)[1].contains("refused: dead: "), "{:?}", dead.struck);
}

fn world(kind: &'static WorldFault, target: Target) -> Fault {
    Fault::World(kind, target)
}

#[test]
fn commands_are_swapped_and_parameters_tuned() {
    let (lease, second) = (Span::secs(600), Time(1_000_000_000));
    let to = |y| Cell { x: 0, y, z: 0 };
    let (a, b) = (Steering::GoTo(to(12), lease), Steering::GoTo(to(0), lease));
    let mut swapped = 0;
    for seed in 0..4 {
        let sent = |swap: bool| {
            let held = assembly(Strategy::Slope, seed)
                .fault(Time(1), steer(0, a))
                .fault(Time(2), steer(1, b))
                .fault(Time(3), steer(2, Steering::Hold(lease)))
                .fault(Time(4), steer(3, Steering::Hold(lease)));
            let swap = swap.then(|| steer(0, Steering::Swap(ModuleId(1))));
            let asked = swap.into_iter().fold(held, |run, swap| run.fault(second, swap));
            // Dead, they stay where they were sent.
            let end = |run: Assembly, id| run.fault(Time(500_000_000_000), Fault::Kill(ModuleId(id)));
            let ran = end(end(asked, 0), 1).run();
            assert_eq!(ran.broken, 0, "seed {seed}: {:?}", ran.violations);
            (ran.poses[0].foot(), ran.poses[1].foot())
        };
        let (straight, crossed) = (sent(false), sent(true));
        swapped += u64::from(straight == ((0, 12), (0, 0)) && crossed == ((0, 0), (0, 12)));
    }
    assert!(swapped >= 2, "{swapped} of 4");
    let ran = assembly(Strategy::Slope, 3)
        .fault(second, world(&TUNED, Target::Word("strategy=step")))
        .fault(second, world(&TUNED, Target::Word("repulsion=off")))
        .run();
    assert_eq!(effects(&ran)[..2], ["strategy=step from now on", "repulsion=off from now on"]);
    let greedy = assembly(Strategy::Slope, 3).run();
    assert_ne!(ran.outcome, greedy.outcome, "other parameters make another run");
    assert_eq!(ran.broken, 0);
}

/// Leases, locks and invariants hold whatever is commanded.
#[test]
fn no_command_breaks_an_invariant() {
    for seed in 0..12u64 {
        let strategy = Strategy::DISTRIBUTED[seed as usize % 4];
        let mut assembly = assembly(strategy, seed).spares(1).loss("5%").failed_connections("5%");
        for i in 0..20u64 {
            let place = Cell { x: ((i * 5 + seed) % 13) as i16, y: ((i * 7) % 13) as i16, z: 0 };
            let lease = Span::secs(1 + (i * 13 + seed) % 60);
            let steering = [
                Steering::GoTo(place, lease),
                Steering::Take((i % 4) as u8, lease),
                Steering::Hold(lease),
                Steering::Release,
            ][((i + seed) % 4) as usize];
            assembly = assembly.fault(Time((1 + i * 6) * 1_000_000_000), steer((i % 5) as u32, steering));
        }
        let ran = assembly.run();
        assert_eq!(ran.broken, 0, "{strategy:?}, seed {seed}: {:?}", ran.violations);
    }
}

/// Runs the chair of the thesis with an operator, or without.
fn chair(directory: &Path, operator: &str, seed: u64) -> Report {
    let text = "version = 1\n[swarm]\nfamily = \"metamodule\"\nkind = \"SRS\"\n\
        floor = { min = [0, 0], max = [12, 12] }\nturn_time = \"1s\"\n\
        [[goal]]\nshape = { chair = [5, 5] }\norder = \"circular\"\n[protocol]\nstrategy = \"greedy\"\n\
        [link]\ndelay = \"10ms..100ms\"\n";
    let file = directory.join("chair.toml");
    fs::write(&file, text.to_owned() + operator).unwrap();
    let seed = seed.to_string();
    let ran =
        run(&["run", file.to_str().unwrap(), "--link", "sim", "--seed", &seed, "--json", "-", "--quiet"]);
    report(&ran.out)
}

#[test]
fn a_scripted_operator_helps_a_swarm_that_is_stuck() {
    let directory = tempfile::tempdir().unwrap();
    let (mut alone, mut helped, mut interactions) = (0, 0, 0);
    for seed in 0..12 {
        let without = chair(directory.path(), "", seed);
        assert_eq!(without.operator, None);
        alone += u64::from(without.outcome == "built");
        let with = chair(directory.path(), "[operator]\nkind = \"scripted\"\n", seed);
        let again = chair(directory.path(), "[operator]\nkind = \"scripted\"\n", seed);
        assert_eq!(
            (&with.trace_hash, &with.state_hash),
            (&again.trace_hash, &again.state_hash),
            "seed {seed}"
        );
        let operator = with.operator.as_ref().unwrap();
        helped += u64::from(with.outcome == "built");
        interactions += operator.swarm.interactions;
        assert_eq!(with.invariants.broken, 0, "seed {seed}");
        let by_operator = with.faults.iter().filter(|fault| fault.by == "operator 1").count() as u64;
        assert_eq!(operator.commands - operator.refused, by_operator, "seed {seed}");
        if without.outcome == "built" && operator.commands == 0 {
            // An operator that only looks changes nothing that is built.
            assert_eq!(with.moves, without.moves, "seed {seed}");
        }
    }
    assert!(helped > alone && interactions > 0, "{helped} of 12 with, {alone} without");
}

#[test]
fn another_goal_of_the_scenario_is_built() {
    let directory = tempfile::tempdir().unwrap();
    let text = "version = 1\n[swarm]\nfamily = \"metamodule\"\nkind = \"SRS\"\nfloor = { min = [0, 0], max = [12, 12] }\n\
        turn_time = \"1s\"\n[[goal]]\nshape = { box = [5, 5] }\n[[goal]]\nat = \"1000s\"\nshape = { box = [2, 2] }\n\
        [[command]]\nat = \"2s\"\ndo = [\"goal.set 1\"]\n[[command]]\nat = \"900s\"\ndo = [\"goal.set 0\", \"goal.set 2\"]\n";
    let file = directory.path().join("goals.toml");
    fs::write(&file, text).unwrap();
    let ran = run(&["run", file.to_str().unwrap(), "--link", "sim", "--json", "-", "--quiet"]);
    let report = report(&ran.out);
    assert_eq!((report.outcome.as_str(), report.invariants.broken), ("built", 0), "{ran:?}");
    let effects: Vec<&str> = report.faults.iter().map(|fault| fault.effect.as_str()).collect();
    assert_eq!(effects[..2], ["goal 0 was built before", "goal 1 was built before"]);
    assert!(effects[2].starts_with("refused: goal: the scenario has no goal 2"), "{effects:?}");
}

/// A swarm that would plan for all together asks first, and an operator who would not have looked answers. Without an
/// answer it goes on by itself.
#[test]
fn swarms_ask_before_they_plan_for_all() {
    let directory = tempfile::tempdir().unwrap();
    let asked = |file: &str, ask: &str, operator: &str| {
        let text = fs::read_to_string(root().join(format!("tests/corpus/{file}.toml"))).unwrap();
        let text = text.replace("[protocol]\n", &format!("[protocol]\n{ask}\n")) + operator;
        let file = directory.path().join("ask.toml");
        fs::write(&file, text).unwrap();
        report(&run(&["run", file.to_str().unwrap(), "--link", "sim", "--json", "-", "--quiet"]).out)
    };
    let (knot, luck) = ("metamodule-led-out-of-a-knot", "metamodule-led-by-luck");
    let operator = "\n[operator]\nkind = \"scripted\"\nwindow = \"3000s\"\nlease = \"60s\"\n";
    let within = "answer_within = \"300s\"";
    let alone = asked(luck, "", "");
    assert_eq!(alone.trace_hash, asked(luck, "ask = \"never\"", "").trace_hash);
    let waits = asked(luck, &format!("ask = \"stuck\"\n{within}"), "");
    assert_eq!((waits.outcome.as_str(), waits.invariants.broken), ("built", 0));
    assert_ne!(waits.trace_hash, alone.trace_hash);
    let silent = asked(knot, "", operator).operator.unwrap();
    assert_eq!((silent.requests, silent.commands, silent.mixed_initiative), (0, 0, None));
    for ask in ["stuck", "always"] {
        let helped = asked(knot, &format!("ask = \"{ask}\"\n{within}"), operator);
        assert_eq!((helped.outcome.as_str(), helped.invariants.broken), ("built", 0), "{ask}");
        let operator = helped.operator.unwrap();
        assert_eq!((operator.requests, operator.answered, operator.mixed_initiative), (1, 1, Some(1.0)));
    }
}

/// Runs the chair of the thesis with these commands, which are given at once.
fn commanded_chair(directory: &Path, strategy: &str, commands: &str) -> Report {
    let text = format!(
        "version = 1\n[swarm]\nfamily = \"metamodule\"\nkind = \"SRS\"\nfloor = {{ min = [0, 0], max = [14, 14] }}\n\
         turn_time = \"1s\"\n[[goal]]\nshape = {{ chair = [5, 5] }}\norder = \"circular\"\n\
         [protocol]\nstrategy = \"{strategy}\"\n[[command]]\nat = \"5s\"\ndo = [{commands}]\n"
    );
    Schema::new(&schema(families())).accepts(&toml::from_str(&text).unwrap(), "a commanded chair");
    let file = directory.join("chair.toml");
    fs::write(&file, text).unwrap();
    let ran = run(&["run", file.to_str().unwrap(), "--link", "sim", "--json", "-", "--quiet"]);
    report(&ran.out)
}

#[test]
fn goals_turn_change_their_order_and_are_given_up() {
    let directory = tempfile::tempdir().unwrap();
    let chair = |strategy, commands| commanded_chair(directory.path(), strategy, commands);
    for strategy in ["negotiated", "planned"] {
        let turned = chair(strategy, r#""goal.turn 1", "goal.order at-once""#);
        assert_eq!((turned.outcome.as_str(), turned.invariants.broken), ("built", 0), "{strategy}");
        // A chair is four connectors long and three wide.
        assert_eq!(turned.faults[0].effect, "the goal was turned by 0° before");
        assert_eq!(turned.faults[1].effect, "the order was the scenario's before");
        assert_eq!(changes(&turned), ["turned by 90° by command", "order at-once by command"]);
        assert_ne!(turned.trace_hash, chair(strategy, r#""goal.turn 2", "goal.order at-once""#).trace_hash);
        assert_ne!(turned.trace_hash, chair(strategy, r#""goal.turn 1", "goal.order crosswise""#).trace_hash);
    }
    let around = chair("negotiated", r#""goal.turn 1", "goal.turn 3""#);
    assert_eq!(
        (around.faults[1].effect.as_str(), around.outcome.as_str()),
        ("the goal was turned by 90° before", "built")
    );
    assert_eq!(changes(&around), ["turned by 90° by command", "turned by 270° by command"]);
    let dropped = chair("negotiated", r#""goal.drop", "goal.turn 1""#);
    assert_eq!((dropped.outcome.as_str(), dropped.invariants.broken), ("deadlock", 0));
    assert!(dropped.faults[1].effect.starts_with("refused: goal: "), "{:?}", dropped.faults);
    assert_eq!(dropped.unbuilt.as_ref().unwrap().reason, "goal-given-up");
    assert_eq!((dropped.stages[0].filled, dropped.goal.cells), (0, 6));
    let again = chair("negotiated", r#""goal.drop", "goal.set 0""#);
    assert_eq!((again.outcome.as_str(), again.invariants.broken), ("built", 0));
    assert_eq!(again.faults[0].effect, "0 of 6 seeds of the goal were filled");
    assert_eq!(changes(&again), ["given up by command", "taken up again by command"]);
    let moved = chair("negotiated", r#""goal.move [1, 1]""#);
    assert_eq!(changes(&moved), ["moved by (1, 1) by command"]);
    assert_eq!(changes(&chair("negotiated", r#""pause 0", "resume 0""#)), Vec::<String>::new());
}

/// Returns what the report says was done to the goal.
fn changes(report: &Report) -> Vec<String> {
    let report = serde_json::to_value(report).unwrap();
    serde_json::from_value(report["metamodules"]["goal_changes"].clone()).unwrap_or_default()
}

/// A command that the level does not permit is refused and names the levels that do; metamodules that may not decide for
/// themselves stay where they are unless they are commanded.
#[test]
fn levels_of_autonomy_permit_commands_and_hold_metamodules() {
    let directory = tempfile::tempdir().unwrap();
    let at = |kind: &str, level: &str, commands: &str| {
        let text = format!(
            "version = 1\n[swarm]\nfamily = \"metamodule\"\nkind = \"SRS\"\nfloor = {{ min = [0, 0], max = [14, 14] }}\n\
             turn_time = \"1s\"\n[[goal]]\nshape = {{ chair = [5, 5] }}\norder = \"circular\"\n\
             [protocol]\nstrategy = \"negotiated\"\n[stop]\nstall = \"600s\"\n\
             [operator]\nkind = \"{kind}\"\nlevel = \"{level}\"\n{commands}"
        );
        let file = directory.path().join("levels.toml");
        fs::write(&file, text).unwrap();
        report(&run(&["run", file.to_str().unwrap(), "--link", "sim", "--json", "-", "--quiet"]).out)
    };
    let given = "[[command]]\nat = \"5s\"\ndo = [\"goto 0 [1, 1, 0]\", \"goal.move [1, 0]\", \"release 0\", \"pause 1\"]\n\
                 [[command]]\nat = \"6s\"\ndo = [\"resume 1\"]\n";
    let alone = at("person", "shared", "");
    for (level, refused, needs) in [
        ("shared", [false, false, false], ""),
        ("full", [true, false, true], "needs `teleoperation` or `safe` or `shared`"),
        ("safe", [false, true, false], "needs `shared` or `full`"),
        ("teleoperation", [false, true, true], "needs `shared` or `full`"),
    ] {
        let commanded = at("person", level, given);
        let effects: Vec<&str> = commanded.faults.iter().map(|fault| fault.effect.as_str()).collect();
        for (effect, is_refused) in effects.iter().zip(refused) {
            assert_eq!(effect.contains("refused: level: "), is_refused, "{level}: {effects:?}");
        }
        let own = format!("[operator] has `level = \"{level}\"`; this command {needs}");
        assert!(needs.is_empty() || effects.iter().any(|effect| effect.contains(&own)), "{effects:?}");
        assert!(!effects[3].contains("refused") && commanded.invariants.broken == 0, "{effects:?}");
    }
    // Left to themselves they build at two levels, and stay where they are at the others.
    assert_eq!((alone.outcome.as_str(), alone.invariants.broken), ("built", 0));
    assert_eq!(at("person", "full", "").trace_hash, alone.trace_hash);
    for level in ["safe", "teleoperation"] {
        let held = at("person", level, "");
        assert_eq!((held.outcome.as_str(), held.moves, held.goal.filled), ("deadlock", 0, 0), "{level}");
        // One goes where it is commanded, and stays there when the lease has ended.
        let led = at("person", level, "[[command]]\nat = \"5s\"\ndo = [\"take 0 0 for 300s\"]\n");
        assert_eq!((led.goal.filled, led.invariants.broken), (1, 0), "{level}");
        // The scripted operator leads all of them.
        let built = at("scripted", level, "");
        assert_eq!((built.outcome.as_str(), built.invariants.broken), ("built", 0), "{level}");
        let operator = built.operator.unwrap();
        assert!(operator.commands >= 6 && operator.refused == 0 && operator.level == level, "{operator:?}");
    }
    // One that is released decides for itself.
    let released = at("person", "safe", "[[command]]\nat = \"5s\"\ndo = [\"release 0\"]\n");
    assert!(released.goal.filled == 1 && released.moves > 0, "{}", released.goal.filled);
}

#[test]
fn tables_of_operators_are_checked() {
    let text = fs::read_to_string(scenario("chair.toml")).unwrap();
    let cases = [
        ("kind = \"robot\"", "robot"),
        ("kind = \"person\"\nlook = \"1s\"", "`look` of a person"),
        ("look = \"0s\"", "look"),
        ("lease = \"601s\"", "lease"),
        ("level = \"some\"", "some"),
        ("speed = 1", "speed"),
        ("think = \"4s..1s\"", "4s..1s"),
        ("[protocol]\nask = \"often\"", "often"),
        ("[protocol]\nanswer_within = \"0s\"", "answer_within"),
        ("[protocol]\nstrategy = \"slope\"\nask = \"stuck\"", "asks the operator nothing"),
    ];
    for (line, part) in cases {
        let text = format!("{text}\n[operator]\n{line}\n");
        metamorph_tests::command::refused(&text, &["check", "{}"], &[part]);
    }
    let cubes = fs::read_to_string(scenario("swarm.toml")).unwrap() + "\n[operator]\nkind = \"scripted\"\n";
    metamorph_tests::command::refused(&cubes, &["check", "{}"], &["an operator of the family `cube`"]);
}
