//! Cubes as processes build a shape, while some of them are killed and stopped.

use metamorph_module_agent::clock::Speed;
use metamorph_protocol::cube::params::{Params, Setup};
use metamorph_protocol::goal::{Goal, Growth};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::shape::Shape;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::cube::director::Director;
use metamorph_sim_bridge::cube::world::CubeWorld;
use metamorph_sim_bridge::director::faults::{Fault, Schedule};
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::progress::Stop;
use metamorph_tests::command::module_agent;
use metamorph_world_controller::report::balance::unbalanced;
use metamorph_world_controller::swarm::{SwarmOptions, SwarmOutcome, run_swarm};
use std::sync::Arc;

/// Lets a slab of `side` by `side` cubes build a block in its middle.
fn build(side: i16, block: i16, speed: u32, faults: Vec<(Time, Fault)>) -> (Option<Outcome>, SwarmOutcome) {
    let cells = |min, max| Shape::Box { min, max }.cells().expect("a shape");
    let start = cells(Cell::new(0, 0, 0), Cell::new(side - 1, side - 1, 0));
    let low = (side - block) / 2;
    let high = low + block - 1;
    let goal = cells(Cell::new(low, low, 0), Cell::new(high, high, block - 1));
    let goal = Goal::compile(&goal, Cell::new(low, low, 0), Growth::Solid).expect("a goal");
    let params = Params::scaled(Span::secs(1), Span::millis(200), 4 * (side as u16 * 2 + 30));
    let setup = Arc::new(Setup { params, goals: vec![goal] });
    let mut world = CubeWorld::new(&start, Span::secs(1), 1);
    let stop = Stop {
        timeout: Time(2_000_000_000_000),
        stall: Span::secs(200),
        livelock: Span::secs(800),
        planned_until: Time::ZERO,
    };
    let schedule = Schedule::new(faults);
    let mut director =
        Director::new(setup.clone(), start.len(), schedule, stop, Default::default(), Default::default());
    let options = SwarmOptions {
        speed: Speed::new(speed, 1).expect("a speed"),
        seed: 1,
        program_args: vec!["cube".into()],
        ..SwarmOptions::new(module_agent().into())
    };
    let outcome = run_swarm(&options, setup.as_ref(), &mut world, &mut director).expect("the swarm runs");
    #[allow(clippy::print_stdout, reason = "shown only on failure or with --nocapture")]
    {
        println!(
            "{:?} {:?} {:?} {outcome:#?}",
            director.monitor().outcome(),
            director.progress(),
            director.monitor().stall()
        );
    }
    assert!(world.take_violations().is_empty(), "an invariant broke");
    assert_eq!(outcome.crashes, []);
    assert_eq!((outcome.foreign, outcome.missing_counters.len()), (0, 0));
    assert_eq!(unbalanced(&outcome, 6, true), None);
    (director.monitor().outcome().map(|(_, came_to)| came_to), outcome)
}

#[test]
fn thirty_six_cubes_build_a_block_of_processes() {
    let (came_to, swarm) = build(6, 2, 20, vec![]);
    assert_eq!(came_to, Some(Outcome::Built));
    assert_eq!((swarm.launched, swarm.alive), (36, 36));
    assert!(swarm.tally.total().delivered > 0);
}

/// At a thousand times real speed a move takes a millisecond, which is less than most machines take to wake sixteen
/// processes: they build all the same. By how much the clock is slowed, tests of `swarm/pace.rs` hold, with given lateness.
#[test]
fn cubes_build_although_the_clock_is_too_fast() {
    let (came_to, swarm) = build(6, 2, 1_000, vec![]);
    assert_eq!(came_to, Some(Outcome::Built));
    assert!(swarm.slowed.factor <= 1.0 && swarm.slowed.lowest <= 1.0, "{:?}", swarm.slowed);
}

/// Over two hundred cubes; ten are killed, and five stopped for a while. The ten die in reserve: a module that dies
/// inside a solid goal holds its growth up for `out_of_turn_after`, 250 move times, with 9 % of seeds in simulation as well.
#[test]
fn two_hundred_cubes_build_although_some_are_killed_and_some_stopped() {
    let at = |s: u64| Time(s * 1_000_000_000);
    let mut faults = vec![];
    for i in 0..10u32 {
        faults.push((at(1), Fault::Kill(ModuleId(i * 3))));
    }
    for i in 0..5 {
        faults.push((at(4 + i), Fault::Pause(ModuleId(200 + i as u32))));
        faults.push((at(15 + i), Fault::Resume(ModuleId(200 + i as u32))));
    }
    let (came_to, swarm) = build(15, 4, 10, faults);
    assert_eq!(came_to, Some(Outcome::Built));
    assert_eq!((swarm.launched, swarm.killed, swarm.alive), (225, 10, 215));
}
