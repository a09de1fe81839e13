//! The reward map (thesis 4.2.3): metamodules on a floor, the published scheme beside exact moves.

use super::PlannerTable;
use crate::console::format::{count, percent};
use crate::console::interrupt::Interrupt;
use crate::experiments::reproduce::Experiment;
use crate::experiments::reproduce::published::KINDS;
use metamorph_protocol::on_grid::reward_map::{Floor, MILLION};
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::roombots::grid::GridState;

/// Connectors along each side of the published floor.
const SIDE: i16 = 13;
/// Moves of the experiment with failing connections.
const MOVES: u64 = 100_000;

/// Makes the table.
pub fn table(seeds: u64, stop: &Interrupt) -> PlannerTable {
    let mut table = PlannerTable::new(Experiment::RewardMap);
    for kind in KINDS {
        if stop.is_set() {
            break;
        }
        let floor = Floor::new(kind, SIDE);
        for penalty in [0, 2] {
            let name = match penalty {
                0 => format!("{kind}: failed tries per minimal move"),
                n => format!("  with a penalty of {n} moves for each visit"),
            };
            table.row(name, "1.22; 100 % reached", published(&floor, seeds, penalty));
        }
        table.row("  exact moves: failed tries; reached", "", exact(&floor, seeds));
        let (tries, moves) = failing(&floor);
        let ratio = tries as f64 / moves.max(1) as f64;
        let ours = format!("{ratio:.4} in {} moves (expected 1.0526)", count(moves));
        table.row("  tries per move, 5 % of connections fail", "1.05 (19 of 20)", ours);
        table.row("  expected tries past a connector that fails at 60 %", "", detour(&floor));
    }
    table.notes = vec![
        format!("floor of {SIDE} by {SIDE} connectors, {seeds} random starts and goals with classes; 24 published"),
        "the text leaves bonus, penalty, discount, ties, classes and start poses open; this is one reading".to_owned(),
        "where a connector can be reached in several classes the smallest is taken, which the rates depend on".to_owned(),
        "exact: PAR cannot reach all states in the corners of a floor with a rim".to_owned(),
        "the box with connectors on its walls (0.92) and the floor with a passage (no number) are not compared"
            .to_owned(),
    ];
    table
}

/// Draws different states.
fn ends(floor: &Floor, rng: &mut Rng) -> (GridState, GridState) {
    loop {
        let (from, goal) = (floor.draw(rng), floor.draw(rng));
        if (from.x, from.y) != (goal.x, goal.y) {
            return (from, goal);
        }
    }
}

fn published(floor: &Floor, seeds: u64, penalty: u32) -> String {
    let (mut reached, mut failed, mut minimal, mut moves) = (0, 0, 0, 0);
    for seed in 0..seeds {
        let (from, goal) = ends(floor, &mut Rng::named(seed, "reward map", 0));
        let walk = floor.walk(from, goal, penalty);
        reached += u64::from(walk.reached);
        failed += u64::from(walk.failed);
        minimal += u64::from(walk.minimal);
        moves += u64::from(walk.moves);
    }
    let per = |n: u64| n as f64 / minimal.max(1) as f64;
    let share = percent(reached as f64 / seeds.max(1) as f64);
    format!("{:.2}; {share} reached; {:.2} moves per minimal one", per(failed), per(moves))
}

fn exact(floor: &Floor, seeds: u64) -> String {
    let (mut reached, mut moves, mut minimal) = (0, 0, 0);
    for seed in 0..seeds {
        let (from, goal) = ends(floor, &mut Rng::named(seed, "reward map", 0));
        if let Some(cost) = floor.expected(goal, |_| Ratio::ZERO).get(&from) {
            reached += 1;
            moves += cost / MILLION;
            minimal += u64::from(floor.map(goal)[&(from.x, from.y)]);
        }
    }
    let share = percent(reached as f64 / seeds.max(1) as f64);
    format!("0; {share} reached; {:.2} moves per minimal one", moves as f64 / minimal.max(1) as f64)
}

fn five_percent() -> Ratio {
    Ratio::new(1, 20).expect("one of twenty is a probability")
}

fn failing(floor: &Floor) -> (u64, u64) {
    let mut rng = Rng::named(0, "failing connections", 0);
    let (mut tries, mut moves) = (0, 0);
    while moves < MOVES {
        let (_, goal) = ends(floor, &mut rng);
        let expected = floor.expected(goal, |_| five_percent());
        for _ in 0..200 {
            let from = floor.draw(&mut rng);
            let (t, s) = floor.attempt(from, &expected, |_| five_percent(), &mut rng);
            (tries, moves) = (tries + t, moves + s);
        }
    }
    (tries, moves)
}

/// Puts a connector that fails at 60 % on a shortest path.
fn detour(floor: &Floor) -> String {
    let (from, goal) = (GridState::new(0, SIDE / 2, 0), GridState::new(SIDE / 2, SIDE / 2, 1));
    let equal = floor.expected(goal, |_| five_percent());
    let Some(bad) = floor.next(from).into_iter().min_by_key(|s| equal.get(s).copied().unwrap_or(u64::MAX))
    else {
        return "no move".to_owned();
    };
    let at = |s: GridState| {
        let here = (s.x, s.y) == (bad.x, bad.y);
        if here { Ratio::new(3, 5).expect("three of five is a probability") } else { five_percent() }
    };
    let around = floor.expected(goal, at).get(&from).copied().unwrap_or(0);
    // The same path as before, through the bad connector once.
    let through = equal.get(&from).copied().unwrap_or(0) + MILLION * 5 / 2 - MILLION * 20 / 19;
    let tries = |n: u64| n as f64 / MILLION as f64;
    format!("{:.2}; along the shortest path {:.2}", tries(around), tries(through))
}
