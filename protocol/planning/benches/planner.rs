//! How fast the planner of free modules is: configurations generated a second, bytes a kept state, and how
//! many of a set of random problems it solves.
//!
//! `cargo bench -p metamorph-planning --bench planner` prints a line for each problem. `PLANNER_FILLINGS` sets the
//! number of random joint values of each start (default 3), `PLANNER_WORK` the expansions of each (default 200,000),
//! `PLANNER_TREES` the number of pairs of random trees of eight modules (default 2). A cost such as 11..20 is that of the
//! best plan found, with the proven bound before it.

#![allow(clippy::disallowed_methods, clippy::print_stdout, reason = "a benchmark reads the clock and prints")]

use metamorph_core::rng::Rng;
use metamorph_planning::assembly::action::{Connectors, Rules};
use metamorph_planning::assembly::collision::Model;
use metamorph_planning::assembly::configuration::Configuration;
use metamorph_planning::assembly::named::{line, shape};
use metamorph_planning::assembly::space::{Assembly, Goal, Objective};
use metamorph_planning::plan::levels::{Counted, Levels};
use metamorph_planning::plan::portfolio::Portfolio;
use metamorph_planning::plan::search::{Method, OPTIMAL, Search};
use metamorph_planning::plan::{Limits, Outcome, Step};
use std::time::Instant;

fn setting(name: &str, default: u64) -> u64 {
    std::env::var(name).ok().and_then(|t| t.parse().ok()).unwrap_or(default)
}

fn rules(model: Model) -> Rules {
    Rules::new(Connectors::All, model)
}

fn main() {
    // `cargo test --benches` only wants to see it start.
    if std::env::args().any(|a| a == "--test") {
        return;
    }
    breadth_first();
    exact();
    let work = setting("PLANNER_WORK", 200_000);
    for model in [Model::Final, Model::Core, Model::Strict] {
        solve(
            &format!("line:4 to loop:3x3, {model:?}"),
            &[line(&[0; 3]).expect("a line")],
            "loop:3x3",
            model,
            work,
        );
    }
    for (n, to) in [(5, "loop:4x3"), (6, "loop:4x4"), (8, "loop:5x5")] {
        let start = line(&vec![0; n - 1]).expect("a line");
        solve(&format!("line:{n} to {to}"), &[start], to, Model::Final, work);
    }
    let names = ["line:4", "loop:3x3", "ell:4", "quadruped:4", "zigzag:4"];
    for from in names {
        for to in names.into_iter().filter(|to| *to != from) {
            solve(&format!("{from} to {to}"), &fillings(from), to, Model::Final, work);
        }
    }
    solve("quadruped:6 to line:6", &fillings("quadruped:6"), "line:6", Model::Final, work);
    for tree in 1..=setting("PLANNER_TREES", 2) {
        let (from, to) = (format!("tree:8x{tree}"), format!("tree:8x{}", tree + 20));
        let start = shape(&from).expect("a known name").filled(|_| (0, [0; 3]));
        solve(&format!("{from} to {to}"), &[start], &to, Model::Final, work);
    }
}

fn breadth_first() {
    let start = line(&[0; 3]).expect("a line");
    let space = Assembly::new(4, rules(Model::Final), Objective::Actions, &Goal::None, 0);
    let since = Instant::now();
    let mut levels = Levels::new(space, &start, Limits { memory: 1 << 30, work: 100_000 });
    while levels.advance(1_000) == Counted::Running {}
    let (states, seconds) = (levels.table().len() as f64, since.elapsed().as_secs_f64());
    let bytes = levels.table().bytes() as f64;
    println!(
        "breadth-first from line:4: 100,000 expansions in {seconds:.2} s, {states} kept, {:.1} bytes each",
        bytes / states
    );
}

/// Measures the search core alone: A* on problems of four modules, all with the same table of shapes.
fn exact() {
    let goal = shape("line:4").expect("a known name");
    let space = Assembly::new(4, rules(Model::Final), Objective::Actions, &Goal::Shape(goal), 20_000);
    let since = Instant::now();
    let generated: u64 = fillings("zigzag:4")
        .iter()
        .map(|start| {
            let limits = Limits { memory: 1 << 30, work: 20_000 };
            let mut search = Search::new(space.clone(), start, limits, Method::astar());
            while search.advance(1_000) == Step::Running {}
            search.progress().generated
        })
        .sum();
    let seconds = since.elapsed().as_secs_f64();
    println!(
        "A*, zigzag:4 to line:4: {generated} generated in {seconds:.2} s ({:.2} M/s)",
        generated as f64 / seconds / 1e6
    );
}

/// Draws joint values of a shape.
fn fillings(name: &str) -> Vec<Configuration> {
    let shape = shape(name).expect("a known name");
    let draw = |seed| {
        let mut rng = Rng::named(seed, "joint values", 0);
        let mut draw = |n: u64| rng.below(n) as u8;
        shape.filled(|_| (draw(4), [draw(3), draw(4), draw(3)]))
    };
    (0..setting("PLANNER_FILLINGS", 3)).map(draw).collect()
}

fn solve(name: &str, starts: &[Configuration], to: &str, model: Model, work: u64) {
    let since = Instant::now();
    let goal = shape(to).expect("a known name");
    let shapes = if goal.len() <= 4 { 20_000 } else { 30_000 };
    let space = Assembly::new(goal.len(), rules(model), Objective::Actions, &Goal::Shape(goal), shapes);
    let table = since.elapsed().as_secs_f64();
    let (mut costs, mut generated, mut expanded, mut kept) = (Vec::new(), 0, 0, 0);
    for start in starts {
        let mut search = Portfolio::new(space.clone(), start, Limits { memory: 1 << 30, work }, OPTIMAL);
        let outcome = loop {
            if let Step::Done(outcome) = search.advance(u64::MAX) {
                break outcome;
            }
        };
        costs.push(match outcome {
            Outcome::Solved { path, .. } => path.cost.to_string(),
            Outcome::Impossible { .. } => "impossible".to_owned(),
            Outcome::OutOf { best: Some(path), lower, .. } => format!("{lower}..{}", path.cost),
            Outcome::OutOf { lower, .. } => format!("≥ {lower}"),
        });
        let progress = search.progress();
        generated += progress.generated;
        expanded += progress.expanded;
        kept = kept.max(progress.kept);
    }
    let seconds = since.elapsed().as_secs_f64() - table;
    println!(
        "{name}: {}; {expanded} expanded, {generated} generated, at most {kept} kept; {seconds:.2} s ({:.2} M/s), table {table:.2} s",
        costs.join(" "),
        generated as f64 / seconds / 1e6
    );
}
