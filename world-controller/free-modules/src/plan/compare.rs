//! `metamorph plan --recognise`, `--distance` and `--count`: questions about structures that need no plan.

use super::error::PlanError;
use super::input::Structured;
use metamorph_protocol::assembly::action::Rules;
use metamorph_protocol::assembly::configuration::Configuration;
use metamorph_protocol::assembly::recognise::{Recognised, recognise};
use metamorph_protocol::assembly::shape::Shape;
use metamorph_protocol::assembly::shape_distance::ShapeDistance;
use metamorph_protocol::assembly::shape_graph::{Prices, ShapeGraph};
use metamorph_protocol::assembly::similarity::{Similarity, similarity};
use metamorph_protocol::assembly::space::{Assembly, Goal, Objective};
use metamorph_protocol::plan::levels::{Counted, Levels};
use metamorph_protocol::plan::{Limits, Space};
use metamorph_text::format::{count, many};
use serde::Serialize;

/// How far two structures are apart.
#[derive(Clone, Debug, Serialize)]
pub struct Distances {
    /// The similarities of [`Similarity`].
    #[serde(flatten)]
    pub similarity: Similarity,
    /// A lower bound on the number of actions from one to the other: their distance in the graph of shapes.
    /// `None` if the other cannot be reached.
    pub shape: Option<u32>,
    /// True if that distance is exact.
    pub shape_exact: bool,
}

/// Compares two structures.
pub fn distance(a: &Structured, b: &Structured, places: [&str; 2]) -> Result<Distances, PlanError> {
    let shapes = [a.shape(), b.shape()];
    if shapes[0].len() != shapes[1].len() {
        let [x, y] = shapes.map(|s| s.len());
        let reason = format!("{} has {}, {} has {}", places[0], many(x as u64, "module"), places[1], y);
        return Err(PlanError::option("--distance", reason, "compare structures with equally many modules"));
    }
    let table = ShapeDistance::to(&shapes[1], Prices::ONE, 60_000);
    let shape = table.of(&shapes[0]);
    let filled = |s: &Structured| match s {
        Structured::Configuration(c) => *c,
        Structured::Shape(s) => s.filled(|_| (0, [0; 3])),
    };
    Ok(Distances {
        similarity: similarity(&filled(a), &filled(b)),
        shape,
        shape_exact: shape.is_none() || table.knows(&shapes[0]),
    })
}

/// Describes distances.
pub fn distance_text(d: &Distances) -> String {
    let s = &d.similarity;
    let shape = match (d.shape, d.shape_exact) {
        (None, _) => "cannot be reached".to_owned(),
        (Some(n), true) => n.to_string(),
        (Some(n), false) => format!("at least {n}"),
    };
    format!(
        "  shape distance (lower bound of actions)  {shape}\n  label similarity (report 2.3)            {} of {}\n  \
         largest common subgraph                  {}\n  Hausdorff distance of the volumes         {} (squared, cells)\n  \
         assignment distance of the volumes        {} (sum of |dx|+|dy|+|dz|, cells)",
        s.shared_labels,
        s.joins,
        s.common_subgraph.map_or_else(|| "too large".to_owned(), |n| format!("{n} of {}", s.joins)),
        s.hausdorff_squared,
        s.assignment,
    )
}

/// Names a structure.
pub fn recognised(structured: &Structured) -> Recognised {
    match structured {
        Structured::Shape(shape) => recognise(shape, None),
        Structured::Configuration(c) => recognise(&Shape::of(c), Some(c)),
    }
}

/// Describes what was recognised.
pub fn recognised_text(r: &Recognised) -> String {
    let name = r.name.as_deref().unwrap_or("no shape with a name");
    let mirrored = match r.chiral {
        true => "chiral: it differs from its mirror image",
        false => "equal to its mirror image",
    };
    let pairs =
        r.metamodules.iter().map(|(a, b, kind)| format!("\n  metamodule {kind}: modules {a} and {b}"));
    format!(
        "{name}: {} with {}\n  symmetries: {}, {mirrored}{}",
        many(r.modules as u64, "module"),
        many(r.joins as u64, "joined face"),
        r.symmetries,
        pairs.collect::<String>()
    )
}

/// The numbers of shapes and configurations by distance from a start.
#[derive(Clone, Debug, Serialize)]
pub struct Count {
    /// Shapes in the graph of shapes.
    pub shapes: Level,
    /// Configurations.
    pub configurations: Level,
}

/// Numbers by distance.
#[derive(Clone, Debug, Serialize)]
pub struct Level {
    /// The number at each distance.
    pub levels: Vec<u64>,
    /// Their sum.
    pub total: u64,
    /// True if nothing is farther away.
    pub complete: bool,
}

/// Counts what can be reached, until `is_over` returns true; it is called between slices of work with how many of what
/// have been counted.
pub fn counted(
    start: &Configuration,
    rules: &Rules,
    limits: Limits,
    is_over: &mut dyn FnMut(u64, &str) -> bool,
) -> Count {
    let n = start.len();
    let graph = ShapeGraph { modules: n, prices: Prices::ONE };
    let shapes = drive(Levels::new(graph, &Shape::of(start), limits), "shapes", is_over);
    let space = Assembly::new(n, rules.clone(), Objective::Actions, &Goal::None, 0);
    let configurations = drive(Levels::new(space, start, limits), "configurations", is_over);
    Count { shapes, configurations }
}

fn drive<S: Space>(mut levels: Levels<S>, what: &str, is_over: &mut dyn FnMut(u64, &str) -> bool) -> Level {
    let complete = loop {
        match levels.advance(256) {
            Counted::All => break true,
            Counted::OutOfRoom => break false,
            Counted::Running if is_over(levels.table().len() as u64, what) => break false,
            Counted::Running => {}
        }
    };
    let counts = levels.counts();
    Level { total: counts.iter().sum(), levels: counts, complete }
}

/// Describes counts.
pub fn counted_text(c: &Count) -> String {
    let line = |name: &str, level: &Level| {
        let list: Vec<String> = level.levels.iter().map(|n| count(*n)).collect();
        let more = if level.complete { "" } else { " and more: a limit was reached" };
        format!("{name}: {}{more}\n  by distance: {}", count(level.total), list.join(" "))
    };
    format!("{}\n{}", line("shapes", &c.shapes), line("configurations", &c.configurations))
}
