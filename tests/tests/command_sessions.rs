//! Random sessions of commands in virtual time: the scenario with the commands, as `export` writes it, makes the same run.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::director::commands::Commands;
use metamorph_sim_bridge::director::faults::{Fault, Target};
use metamorph_sim_bridge::director::link_faults::LinkFault;
use metamorph_sim_bridge::director::steering::Steering;
use metamorph_sim_bridge::metamodule::faults::{
    GOAL_DROPPED, GOAL_MOVED, GOAL_ORDERED, GOAL_SET, GOAL_TURNED, OBSTACLE, OBSTACLE_GONE, ORDERS, TUNABLE,
    TUNED,
};
use metamorph_world_controller::family::{begin, read_text};
use metamorph_world_controller::scenario::commands::write;
use metamorph_world_controller::scenario::{LinkKind, Overrides};

const METAMODULES: &str = "version = 1\n[swarm]\nfamily = \"metamodule\"\nkind = \"SRS\"\ncount = 5\n\
    floor = { min = [0, 0], max = [12, 12] }\nturn_time = \"1s\"\nfailed_connections = \"5%\"\n\
    [[goal]]\nshape = { box = [5, 5] }\n[protocol]\nrelocate = true\n[link]\nloss = \"2%\"\nuntil = \"100s\"\n";
const CUBES: &str = "version = 1\n[swarm]\nstart = { box = { min = [0, 0, 0], max = [3, 3, 0] } }\n\
    [[goal]]\nseed = [0, 0, 0]\nshape = { box = { min = [0, 0, 0], max = [3, 1, 1] } }\n[link]\nloss = \"2%\"\nuntil = \"60s\"\n";

/// Draws a command; some will be refused.
fn command(rng: &mut Rng, modules: u64, metamodules: bool) -> Fault {
    let id = ModuleId(rng.below(modules + 1) as u32);
    let mut cell = |from: i16, size: u64| Cell {
        x: from + rng.below(size) as i16,
        y: from + rng.below(size) as i16,
        z: 0,
    };
    let (place, by) = (cell(0, 14), cell(-2, 5));
    let lease = Span(1 + rng.below(60_000_000_000));
    // Every family has the first ones.
    match rng.below(if metamodules { 23 } else { 13 }) {
        0 => Fault::Kill(id),
        1 => Fault::Restart(id),
        2 => Fault::Pause(id),
        3 => Fault::Resume(id),
        4 => Fault::Stick(id),
        5 => Fault::Unstick(id),
        6 => Fault::Links(LinkFault::Loss(Ratio::new(rng.below(11) as u32, 20).unwrap(), lease)),
        7 => Fault::Links(LinkFault::LossEnds),
        8 => {
            let last = id.0 + rng.below(3) as u32;
            Fault::Links(LinkFault::Partition(id, ModuleId(last), lease))
        }
        9 => Fault::Links(LinkFault::PartitionEnds),
        10 => Fault::Steer(id, Steering::GoTo(place, lease)),
        11 => Fault::Steer(id, Steering::Hold(lease)),
        12 => Fault::Steer(id, Steering::Release),
        13 => Fault::World(&GOAL_SET, Target::Number(rng.below(3) as u16)),
        14 => Fault::World(&TUNED, Target::Word(TUNABLE[rng.below(TUNABLE.len() as u64) as usize])),
        15 => Fault::Steer(id, Steering::Swap(ModuleId(rng.below(modules) as u32))),
        16 | 17 => Fault::Steer(id, Steering::Take(rng.below(5) as u8, lease)),
        18 => {
            let kind = if rng.below(2) == 0 { &OBSTACLE } else { &OBSTACLE_GONE };
            Fault::World(kind, Target::Cell(place))
        }
        19 => Fault::World(&GOAL_TURNED, Target::Number(rng.below(4) as u16)),
        20 => Fault::World(&GOAL_ORDERED, Target::Word(ORDERS[rng.below(3) as usize])),
        21 => Fault::World(&GOAL_DROPPED, Target::Nothing),
        _ => Fault::World(&GOAL_MOVED, Target::Shift(by.x, by.y)),
    }
}

/// Runs sessions, and returns how many commands were taken.
fn sessions(seeds: std::ops::Range<u64>) -> u64 {
    let mut taken = 0;
    for seed in seeds {
        let metamodules = seed % 2 == 0;
        // Parameters are tuned under published strategies only.
        let slope = METAMODULES.replace("[protocol]", "[protocol]\nstrategy = \"slope\"");
        let text = match seed % 4 {
            0 => METAMODULES,
            2 => &slope,
            _ => CUBES,
        };
        let overrides = Overrides { link: LinkKind::Sim, seed: Some(seed), ..Overrides::default() };
        let plan = read_text("session.toml", text, &overrides).unwrap_or_else(|e| panic!("{e}"));
        let mut rng = Rng::named(seed, "session", 0);
        let mut run = begin(&plan);
        let mut given = Vec::new();
        let mut paused = Vec::new();
        for _ in 0..1 + rng.below(12) {
            let at = Time(run.now().0 + rng.below(20_000_000_000));
            if run.run_until(at) {
                break;
            }
            let fault = command(&mut rng, run.modules() as u64, metamodules);
            if let Ok(at) = run.inject(fault) {
                given.push(Commands { at, operator: 0, faults: vec![fault] });
                match fault {
                    Fault::Pause(id) => paused.push(id),
                    Fault::Resume(id) => paused.retain(|other| *other != id),
                    _ => {}
                }
            }
        }
        // What is paused for ever keeps a run from its end.
        for id in paused {
            if let Ok(at) = run.inject(Fault::Resume(id)) {
                given.push(Commands { at, operator: 0, faults: vec![Fault::Resume(id)] });
            }
        }
        run.run_until(Time::NEVER);
        let first = run.report();
        let scenario = format!("{text}{}", write(&given));
        let plan =
            read_text("session.toml", &scenario, &overrides).unwrap_or_else(|e| panic!("seed {seed}: {e}"));
        let mut again = begin(&plan);
        again.run_until(Time::NEVER);
        let second = again.report();
        assert_eq!(
            (&first.trace_hash, &first.state_hash, &first.outcome),
            (&second.trace_hash, &second.state_hash, &second.outcome),
            "seed {seed}; repeat with `cargo test -p metamorph-tests command_sessions::`, and this scenario:\n{scenario}"
        );
        assert_eq!(first.invariants.broken, 0, "seed {seed}:\n{scenario}");
        taken += given.len() as u64;
    }
    taken
}

#[test]
fn a_session_is_a_scenario() {
    let taken = sessions(0..16);
    assert!(taken > 20, "{taken} commands were taken");
}

/// `cargo test --release -p metamorph-tests command_sessions:: -- --ignored`
#[test]
#[ignore = "takes minutes"]
fn a_thousand_sessions_are_scenarios() {
    let taken = sessions(0..1_000);
    assert!(taken > 2_000, "{taken} commands were taken");
}
