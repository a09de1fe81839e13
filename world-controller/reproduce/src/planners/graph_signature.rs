//! The planner of the 2009 report (chapters 3 and 5): searches of a whole space, first plans, and what they miss.

use super::PlannerTable;
use super::sample::Ratios;
use crate::Experiment;
use metamorph_console::interrupt::Interrupt;
use metamorph_protocol::assembly::action::{Connectors, Rules};
use metamorph_protocol::assembly::collision::Model;
use metamorph_protocol::assembly::configuration::Configuration;
use metamorph_protocol::assembly::named;
use metamorph_protocol::assembly::report2009::{Found, Report2009};
use metamorph_protocol::assembly::shape::Shape;
use metamorph_protocol::assembly::shape_graph::{Prices, ShapeGraph};
use metamorph_protocol::assembly::space::{Assembly, Goal, Objective};
use metamorph_protocol::plan::levels::{Counted, Levels};
use metamorph_protocol::plan::search::{Method, Search};
use metamorph_protocol::plan::{Limits, Outcome, Space, Step};
use metamorph_protocol::rng::Rng;
use metamorph_text::format::count;

/// The number of searches through the whole space; each takes as long as several hundred searches for a first
/// plan.
const WHOLE: u64 = 3;
/// Number of expansions between two looks at the interrupt.
const SLICE: u64 = 64;

fn rules() -> Rules {
    Rules::new(Connectors::All, Model::Final)
}

/// Runs the report's planner; `None` if interrupted.
fn run(start: &Configuration, goal: &Shape, seed: u64, until_first: bool, stop: &Interrupt) -> Option<Found> {
    let rng = Rng::named(seed, "report 2009", 0);
    let mut search = Report2009::new(rules(), start, goal, rng);
    while search.advance(SLICE, until_first) {
        if stop.is_set() {
            return None;
        }
    }
    Some(search.found())
}

/// Returns the cost of an optimal plan, and how many configurations A* expanded and generated to prove it;
/// `None` if it found no plan within its limits.
fn optimum(start: &Configuration, goal: &Shape) -> Option<(u32, u64, u64)> {
    let space = Assembly::new(start.len(), rules(), Objective::Actions, &Goal::Shape(*goal), usize::MAX);
    let limits = Limits { memory: 1 << 30, work: 1_000_000 };
    let mut search = Search::new(space, start, limits, Method::astar());
    match search.advance(u64::MAX) {
        Step::Done(Outcome::Solved { path, .. }) => {
            let progress = search.progress();
            Some((path.cost, progress.expanded, progress.generated))
        }
        _ => None,
    }
}

/// Makes the table.
pub fn table(seeds: u64, stop: &Interrupt) -> PlannerTable {
    let mut table = PlannerTable::new(Experiment::GraphSignature);
    let line = |n: usize| named::line(&vec![0; n - 1]).expect("invariant: few modules");
    let goal = named::shape("loop:3x3").expect("invariant: a known name");
    let start = line(4);
    let whole: Vec<Found> = (0..WHOLE).map_while(|s| run(&start, &goal, s, false, stop)).collect();
    let range = |value: fn(&Found) -> u64| {
        let all = whole.iter().map(value);
        format!("{} to {}", count(all.clone().min().unwrap_or(0)), count(all.max().unwrap_or(0)))
    };
    table.row("line to loop, 4 modules: graphs in a whole search", "> 150,000", range(|f| f.generated));
    table.row("  distinct shapes expanded, of 10,726", "", range(|f| f.expanded));
    table.row("  best plan of a whole search, actions", "14", range(|f| f.best.unwrap_or(0).into()));
    let firsts: Vec<(u32, u64)> =
        (0..seeds).map_while(|s| run(&start, &goal, s, true, stop)).filter_map(|f| f.first).collect();
    let lengths: Vec<u64> = firsts.iter().map(|f| f.0.into()).collect();
    let graphs: Vec<u64> = firsts.iter().map(|f| f.1).collect();
    table.ratio("  first plan, actions: mean", "14", &Ratios::new(lengths.iter().map(|n| (*n, 1))));
    table.row("    others", "", summary(&lengths));
    let before = Ratios::new(graphs.iter().map(|n| (*n, 1)));
    table.ratio("  graphs before the first plan: mean", "about 10,000; least < 1,000", &before);
    table.row("    others", "", summary(&graphs));
    let exact = optimum(&start, &goal);
    let text = |o: Option<(u32, u64, u64)>| {
        o.map_or_else(
            || "none".to_owned(),
            |(cost, expanded, generated)| {
                format!("{cost}, proved ({} expanded, {} generated)", count(expanded), count(generated))
            },
        )
    };
    table.row("  fewest actions", "6 (by hand)", text(exact));
    let five = named::shape("loop:4x3").expect("invariant: a known name");
    table.row("5 modules, line to loop 4x3: fewest actions", "not feasible", text(optimum(&line(5), &five)));
    let quadruped = named::shape("quadruped:4").expect("invariant: a known name");
    let snake = named::shape("line:4").expect("invariant: a known name");
    let standing = quadruped.filled(|_| (0, [0; 3]));
    let quick = run(&standing, &snake, 0, true, stop).and_then(|f| f.first).map_or(0, |f| f.0);
    let best = text(optimum(&standing, &snake));
    table.row("quadruped to line: first plan, fewest actions", "equal", format!("{quick}; {best}"));
    table.row("a goal that it misses", "suspected (3.2)", missed(&line(3), stop));
    table.notes = vec![
        "joint values of the published starts are not printed; here all are 0".to_owned(),
        "times: 10 to 15 minutes for 4 modules were published; time this command or `metamorph plan`"
            .to_owned(),
        "histograms 5.2 to 5.5 are figures without numbers, and cannot be compared".to_owned(),
    ];
    table
}

/// Describes the first shape to which A* finds a plan and the report's planner finds none.
fn missed(start: &Configuration, stop: &Interrupt) -> String {
    let graph = ShapeGraph { modules: start.len(), prices: Prices::ONE };
    let limits = Limits { memory: 1 << 30, work: u64::MAX };
    let mut shapes = Levels::new(graph, &Shape::of(start), limits);
    while shapes.advance(SLICE) == Counted::Running {}
    for id in 0..shapes.table().len() as u32 {
        let goal = shapes.space().state(shapes.table().key(id));
        let Some(found) = run(start, &goal, 0, false, stop) else { break };
        if let (None, Some((cost, ..))) = (found.first, optimum(start, &goal)) {
            let of = shapes.table().len();
            return format!(
                "yes: shape {id} of {of} of 3 modules; {} shapes expanded without a plan, A* finds {cost} actions",
                found.expanded
            );
        }
    }
    "none found".to_owned()
}

fn summary(values: &[u64]) -> String {
    let mut sorted = values.to_vec();
    sorted.sort_unstable();
    let (Some(least), Some(most)) = (sorted.first(), sorted.last()) else { return "none".to_owned() };
    let median = sorted[sorted.len() / 2];
    format!("median {}, {} to {}", count(median), count(*least), count(*most))
}
