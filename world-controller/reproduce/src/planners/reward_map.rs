//! The reward map (thesis 4.2.3): metamodules on a floor, the published scheme beside exact moves.

use super::PlannerTable;
use super::sample::Ratios;
use crate::Experiment;
use crate::published::KINDS;
use metamorph_console::interrupt::Interrupt;
use metamorph_protocol::on_grid::reward_map::{Attachment, MILLION, Terrain};
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::roombots::Kind;
use metamorph_text::format::{count, percent};

/// Length of a side of the published floor in connectors.
const SIDE: i16 = 13;
/// Cells along each edge of the published box.
const BOX: i16 = 6;
/// The channel of the floor with a narrow passage: its length in x and its width in y, in connectors. The floor has no other
/// connectors at these x.
const CHANNEL: [std::ops::RangeInclusive<i16>; 2] = [5..=7, 5..=7];
/// Number of runs of each published experiment.
const PUBLISHED: u64 = 24;
/// Moves of the experiment with failing connections for each seed.
const MOVES: u64 = 100;

/// Makes the table.
pub fn table(seeds: u64, stop: &Interrupt) -> PlannerTable {
    let mut table = PlannerTable::new(Experiment::RewardMap);
    for kind in KINDS {
        if stop.is_set() {
            break;
        }
        let floor = Terrain::floor(kind, SIDE, |_, _| false);
        let channel = passage(kind);
        let name = format!("{kind}, floor: failed tries per minimal move");
        let cube = Terrain::cube(kind, BOX);
        let once = Reading { penalty: 0, smallest: false };
        let visits = Reading { penalty: 2, smallest: false };
        let smallest = Reading { penalty: 0, smallest: true };
        let rows: [(&str, &Terrain, &Reading, Draw, Option<f64>); 6] = [
            (&name, &floor, &once, ends, Some(1.22)),
            ("  with a penalty of 2 moves for each visit", &floor, &visits, ends, Some(1.22)),
            ("  always arriving in the smallest class", &floor, &smallest, ends, Some(1.22)),
            ("  box", &cube, &once, ends, Some(0.92)),
            ("  box, with a penalty of 2 moves for each visit", &cube, &visits, ends, Some(0.92)),
            ("  floor with a narrow passage", &channel, &once, through, None),
        ];
        for (name, terrain, reading, draw, published) in rows {
            Scheme::run(terrain, seeds, reading, draw).rows(&mut table, name, published);
        }
        table.row("  exact moves: failed tries; reached", "", exact(&floor, seeds, ends));
        table.row("  exact moves on the box", "", exact(&cube, seeds, ends));
        table.row("  exact moves through the passage", "", exact(&channel, seeds, through));
        let (tries, moves) = failing(&floor, seeds * MOVES);
        let ratio = tries as f64 / moves.max(1) as f64;
        let ours = format!("{ratio:.4} in {} moves (expected 1.0526)", count(moves));
        table.row("  tries per move, 5 % of connections fail", "1.05 (19 of 20)", ours);
        table.row("  expected tries past a connector that fails at 60 %", "", detour(&floor));
    }
    table.notes = vec![
        format!(
            "floor of {SIDE} by {SIDE} connectors, {seeds} random starts and goals with classes; {PUBLISHED} published. p of failed tries: how often {PUBLISHED} of our walks differ as much"
        ),
        "the text leaves bonus, penalty, discount, ties, classes and start poses open; this is one reading"
            .to_owned(),
        "a connector can be reached in several classes, and the rates depend on which is taken: it is drawn"
            .to_owned(),
        "rates are over the walks that reach their goal; one is given up after 100 moves".to_owned(),
        "exact: PAR cannot reach all states in the corners of a floor with a rim".to_owned(),
        format!(
            "box: the surface of {BOX} by {BOX} by {BOX} cells, all six faces; moves lead around its edges"
        ),
        "passage: connectors at x 5 to 7 only where y is 5 to 7, from one side to the other".to_owned(),
        "box and passage with one metamodule; two and four published, in places that are not given"
            .to_owned(),
    ];
    table
}

/// Makes the floor with the narrow passage.
fn passage(kind: Kind) -> Terrain {
    let [length, width] = CHANNEL;
    Terrain::floor(kind, SIDE, |x, y| length.contains(&x) && !width.contains(&y))
}

/// Draws a start and a goal at different connectors.
fn ends(terrain: &Terrain, rng: &mut Rng) -> (Attachment, Attachment) {
    loop {
        let (from, goal) = (terrain.draw(rng), terrain.draw(rng));
        if from.connector != goal.connector {
            return (from, goal);
        }
    }
}

/// Draws a start on one side of the passage and a goal on the other.
fn through(terrain: &Terrain, rng: &mut Rng) -> (Attachment, Attachment) {
    loop {
        let (from, goal) = ends(terrain, rng);
        let [first, last] = [CHANNEL[0].start(), CHANNEL[0].end()].map(|x| 2 * x);
        if terrain.place(from)[0] < first && terrain.place(goal)[0] > last {
            return (from, goal);
        }
    }
}

/// A way to draw a start and a goal.
type Draw = fn(&Terrain, &mut Rng) -> (Attachment, Attachment);

/// Choices that the text leaves open.
struct Reading {
    /// Moves added for each earlier visit of a connector.
    penalty: u32,
    /// True to arrive in the smallest class that is possible; if false, it is drawn.
    smallest: bool,
}

/// Walks by the published scheme.
struct Scheme {
    walks: u64,
    /// Failed tries and minimal moves of each walk that reached its goal.
    failed: Vec<(u64, u64)>,
    /// Moves and minimal moves of the same walks.
    moves: Vec<(u64, u64)>,
}

impl Scheme {
    fn run(terrain: &Terrain, seeds: u64, reading: &Reading, draw: Draw) -> Scheme {
        let mut scheme = Scheme { walks: seeds, failed: Vec::new(), moves: Vec::new() };
        for seed in 0..seeds {
            let (from, goal) = draw(terrain, &mut Rng::named(seed, "reward map", 0));
            let mut classes = Rng::named(seed, "classes of arrival", 0);
            let class = |n: usize| if reading.smallest { 0 } else { classes.below(n as u64) as usize };
            let walk = terrain.walk(from, goal, reading.penalty, class);
            if walk.reached {
                let minimal = u64::from(walk.minimal);
                scheme.failed.push((walk.failed.into(), minimal));
                scheme.moves.push((walk.moves.into(), minimal));
            }
        }
        scheme
    }

    /// Adds its rows; `published` is the printed number of failed tries for each minimal move.
    fn rows(self, table: &mut PlannerTable, name: &str, published: Option<f64>) {
        let reached = (self.failed.len() as u64, self.walks);
        let failed = Ratios::new(self.failed);
        let row = table.ratio(name, published.map_or(String::new(), |p| format!("{p}")), &failed);
        row.p = published.and_then(|p| failed.p(p, PUBLISHED));
        let row = table.share("    goals reached", "100 %", reached);
        // Of the passage the number of runs is not printed.
        if published.is_some() {
            row.against(reached, (PUBLISHED, PUBLISHED));
        }
        table.ratio("    moves per minimal one", "", &Ratios::new(self.moves));
    }
}

fn exact(terrain: &Terrain, seeds: u64, draw: Draw) -> String {
    let (mut reached, mut moves, mut minimal) = (0, 0, 0);
    for seed in 0..seeds {
        let (from, goal) = draw(terrain, &mut Rng::named(seed, "reward map", 0));
        if let Some(cost) = terrain.expected(goal, |_| Ratio::ZERO).get(&from) {
            reached += 1;
            moves += cost / MILLION;
            minimal += u64::from(terrain.map(goal.connector)[&from.connector]);
        }
    }
    let share = percent(reached as f64 / seeds.max(1) as f64);
    format!("0; {share} reached; {:.2} moves per minimal one", moves as f64 / minimal.max(1) as f64)
}

fn five_percent() -> Ratio {
    Ratio::new(1, 20).expect("one of twenty is a probability")
}

/// Returns tries and moves of walks with at least this many moves.
fn failing(floor: &Terrain, least: u64) -> (u64, u64) {
    let mut rng = Rng::named(0, "failing connections", 0);
    let (mut tries, mut moves) = (0, 0);
    while moves < least {
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
fn detour(floor: &Terrain) -> String {
    let end = |x, class| floor.at(x, SIDE / 2, class).expect("the floor has all its connectors");
    let (from, goal) = (end(0, 0), end(SIDE / 2, 1));
    let equal = floor.expected(goal, |_| five_percent());
    let Some(bad) = floor.next(from).iter().min_by_key(|s| equal.get(s).copied().unwrap_or(u64::MAX)) else {
        return "no move".to_owned();
    };
    let at = |s: Attachment| {
        let bad = s.connector == bad.connector;
        if bad { Ratio::new(3, 5).expect("three of five is a probability") } else { five_percent() }
    };
    let around = floor.expected(goal, at).get(&from).copied().unwrap_or(0);
    // The same path as before, through the bad connector once.
    let through = equal.get(&from).copied().unwrap_or(0) + MILLION * 5 / 2 - MILLION * 20 / 19;
    let tries = |n: u64| n as f64 / MILLION as f64;
    format!("{:.2}; along the shortest path {:.2}", tries(around), tries(through))
}
