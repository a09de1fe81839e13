//! Thesis appendix B.3 to B.5 on a table: levels and isolation do not give the order in which it can be built.

use super::PlannerTable;
use crate::Experiment;
use metamorph_protocol::manipulation::structure::isolation::{CELL, Place, degree_centrality};
use metamorph_protocol::rng::Rng;
use nalgebra::{DMatrix, SymmetricEigen};

/// Length of a side of the table in connectors.
const SIDE: i64 = 2;
/// Length of a side of the grid if all of its connectors are nodes.
const GRID: i64 = 13;
/// Number of random structures for the order by both measures.
const STRUCTURES: u64 = 1000;
/// Largest number of units of a random structure.
const UNITS_MAX: u64 = 20;
/// Length of the edge of a cell in metres.
const METRES: f64 = 0.11;

/// The nodes of the table: the lower and the upper modules, the plate, and then connectors.
fn table_nodes() -> Vec<Place> {
    let corners = [(0, 0), (SIDE, 0), (SIDE, SIDE), (0, SIDE)];
    let at = |z: i64| corners.into_iter().map(move |(x, y)| [x * CELL, y * CELL, z * CELL]);
    let plate = [SIDE * CELL / 2, SIDE * CELL / 2, 9 * CELL / 2];
    at(1).chain(at(3)).chain([plate]).chain(at(0)).collect()
}

/// The same with all connectors of the grid, the table in its middle.
fn nodes_on_grid() -> Vec<Place> {
    let mut nodes = table_nodes();
    nodes.truncate(9);
    let middle = (GRID - 1) / 2 - SIDE / 2;
    nodes.iter_mut().for_each(|p| (p[0], p[1]) = (p[0] + middle * CELL, p[1] + middle * CELL));
    nodes.extend((0..GRID).flat_map(|x| (0..GRID).map(move |y| [x * CELL, y * CELL, 0])));
    nodes
}

/// Returns the eigenvalues and eigenvectors of the density graph, with lengths in this unit of cells.
fn eigen(nodes: &[Place], unit: f64) -> SymmetricEigen<f64, nalgebra::Dyn> {
    let distance = |a: &Place, b: &Place| degree_centrality(*a, &[*b]) as f64 / CELL as f64 * unit;
    SymmetricEigen::new(DMatrix::from_fn(nodes.len(), nodes.len(), |i, j| distance(&nodes[i], &nodes[j])))
}

/// Returns the largest eigenvalue of the density graph.
fn largest(nodes: &[Place], unit: f64) -> f64 {
    eigen(nodes, unit).eigenvalues.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

/// Returns the nodes by subgraph centrality (equation B.2), the lowest first. All values have the factor of the largest
/// eigenvalue taken out, without which they overflow.
fn by_subgraph_centrality(nodes: &[Place], unit: f64) -> Vec<usize> {
    let eigen = eigen(nodes, unit);
    let first = eigen.eigenvalues.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let centrality = |i: usize| -> f64 {
        let terms = eigen.eigenvalues.iter().enumerate();
        terms.map(|(k, value)| eigen.eigenvectors[(i, k)].powi(2) * (value - first).exp()).sum()
    };
    sorted(nodes.len(), centrality)
}

fn by_degree_centrality(nodes: &[Place]) -> Vec<usize> {
    sorted(nodes.len(), |i| degree_centrality(nodes[i], nodes) as f64)
}

/// Returns the nodes by a measure. Values that differ by rounding only are equal.
fn sorted(n: usize, measure: impl Fn(usize) -> f64) -> Vec<usize> {
    let values: Vec<f64> = (0..n).map(measure).collect();
    let scale = values.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by_key(|i| ((values[*i] / scale * 1e9).round() as i64, *i));
    order
}

/// Draws a structure: units at different places of a box of 8 × 8 × 4 cells.
fn random_structure(seed: u64) -> Vec<Place> {
    let mut rng = Rng::named(seed, "structure", 0);
    let units = 3 + rng.below(UNITS_MAX - 2);
    let mut places: Vec<Place> = Vec::new();
    while (places.len() as u64) < units {
        let place = [8, 8, 4].map(|n| rng.below(n) as i64 * CELL);
        if !places.contains(&place) {
            places.push(place);
        }
    }
    places
}

/// Makes the table.
pub fn table() -> PlannerTable {
    let mut table = PlannerTable::new(Experiment::AppendixB);
    let nodes = table_nodes();
    let of = |i: usize| degree_centrality(nodes[i], &nodes) as f64 / CELL as f64;
    let (lower, upper, plate) = (of(0), of(4), of(8));
    let dc = "no number is published";
    table.row("DC of a lower module, in cells", dc, format!("{lower:.2}"));
    table.row("DC of an upper module", "", format!("{upper:.2}"));
    table.row("DC of the plate", "", format!("{plate:.2}"));
    let (leg, both) = ((lower + upper) / 2.0, (lower + upper + plate) / 3.0);
    table.row("mean DC of a leg: taken first", "by increasing isolation (B.5)", format!("{leg:.2}"));
    table.row("mean DC of a leg with the plate: taken later", "", format!("{both:.2}"));
    let grid = nodes_on_grid();
    let on_grid = degree_centrality(grid[0], &grid) as f64 / CELL as f64;
    let all = format!("{on_grid:.0}, not {lower:.0}");
    table.row("DC of the lower module if all connectors of 13 × 13 are nodes", "not said which are", all);
    table.row("largest eigenvalue, 13 nodes, in cells", "", format!("{:.1}", largest(&nodes, 1.0)));
    for (name, unit) in [("cells", 1.0), ("centimetres", METRES * 100.0), ("metres", METRES)] {
        let value = largest(&grid, unit);
        let fits = if value.exp().is_finite() { "SC is finite" } else { "SC overflows double precision" };
        let what = format!("largest eigenvalue, {} nodes, in {name}", grid.len());
        table.row(what, "SC (equation B.2)", format!("{value:.1}: {fits}"));
    }
    let (mut units_differ, mut measures_agree) = (0, 0);
    for seed in 0..STRUCTURES {
        let places = random_structure(seed);
        let in_cells = by_subgraph_centrality(&places, 1.0);
        units_differ += u32::from(by_subgraph_centrality(&places, METRES) != in_cells);
        measures_agree += u32::from(by_degree_centrality(&places) == in_cells);
    }
    table.row(
        "order by SC is another one in metres than in cells",
        "",
        format!("{units_differ} of {STRUCTURES}"),
    );
    table.row("order by SC is that by DC", "", format!("{measures_agree} of {STRUCTURES}"));
    table.notes = vec![
        "contradiction 1: B.5 takes chains by increasing isolation, so the four bare legs come before a leg with the plate, and the plate is left over; no metamodule brings it up between standing legs. `metamorph plan table --planner thesis` stops there, `metamorph plan table` builds it".to_owned(),
        "contradiction 2: subgraph centrality on distances grows as e to the power of nodes times distance, and its order depends on the unit of length, which B.3 does not give".to_owned(),
        "contradiction 3: B.4 deconstructs the final structure, B.5 takes nothing away from it and takes nothing back; equations B.1 and B.2 run over edges where nodes are meant".to_owned(),
        "a table of four upright metamodules and a plate of 3 × 3; random structures of 3 to 20 units in 8 × 8 × 4 cells are ours, the thesis has none".to_owned(),
    ];
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn subgraph_centrality_overflows_and_the_leg_comes_first() {
        let table = table();
        let ours = |part: &str| {
            table.rows.iter().find(|row| row.what.contains(part)).map(|row| row.ours.clone()).unwrap()
        };
        assert_eq!(ours("mean DC of a leg:"), "32.27");
        assert_eq!(ours("mean DC of a leg with"), "35.59");
        assert_eq!(ours("if all connectors"), "904, not 30");
        assert_eq!(ours("13 nodes"), "33.9");
        assert!(ours("178 nodes, in cells").ends_with("overflows double precision"));
        assert!(ours("178 nodes, in metres").ends_with("is finite"));
    }
}
