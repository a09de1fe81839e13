//! Pairing of cubes to modules (thesis C.6.2): the share of drawn graphs that the published algorithm pairs, beside
//! the share that can be paired at all.

use super::PlannerTable;
use crate::Experiment;
use metamorph_console::interrupt::Interrupt;
use metamorph_protocol::pairing::Pairing;
use metamorph_protocol::pairing::generated::{Kind, structure};
use metamorph_protocol::pairing::thesis::Nodes;
use metamorph_protocol::rng::Rng;
use metamorph_text::format::{count, percent};

/// Nodes of the drawn graphs.
const NODES: [usize; 4] = [20, 30, 40, 60];
/// Mean degrees of the drawn graphs.
const DEGREES: [u64; 6] = [3, 4, 5, 6, 7, 8];
/// Cells of the drawn structures.
const CELLS: [usize; 3] = [12, 20, 40];
/// Graphs that the published algorithm paired, and all: about 90 % of 1,000.
const PUBLISHED: (u64, u64) = (900, 1_000);
/// Largest number of graphs drawn for one that is valid.
const DRAWS_MAX: u64 = 1_000;

/// Counts over the drawn graphs.
#[derive(Default)]
struct Tally {
    valid: u64,
    pairable: u64,
    published: u64,
    lowest_degree: u64,
    /// Graphs in which an algorithm made more pairs than a maximum matching has.
    impossible: u64,
}

impl Tally {
    fn add(&mut self, nodes: &Nodes, size: usize, rng: &mut Rng) {
        let most = nodes.most_pairs();
        let (published, lowest) = (nodes.published_pairs(rng), nodes.lowest_degree_pairs(rng));
        self.valid += 1;
        self.pairable += u64::from(2 * most == size);
        self.published += u64::from(2 * published == size);
        self.lowest_degree += u64::from(2 * lowest == size);
        self.impossible += u64::from(published.max(lowest) > most);
    }
    fn text(&self) -> String {
        let share =
            |part: u64, of: u64| if of == 0 { "-".to_owned() } else { percent(part as f64 / of as f64) };
        format!(
            "{} can be paired; {} of those by the text, {} by lowest degree",
            share(self.pairable, self.valid),
            share(self.published, self.pairable),
            share(self.lowest_degree, self.pairable)
        )
    }
}

/// Makes the table; `seeds` graphs of each kind.
pub fn table(seeds: u64, stop: &Interrupt) -> PlannerTable {
    let mut table = PlannerTable::new(Experiment::Pairing);
    let (mut graphs, mut impossible) = (0, 0);
    let mut row = |what: String, published: Option<(u64, u64)>, tally: &Tally| {
        (graphs, impossible) = (graphs + tally.valid, impossible + tally.impossible);
        let paired = (tally.published, tally.valid);
        let printed = published.map_or("", |_| "about 90%");
        let row = table.share(format!("{what}: paired by the text"), printed, paired);
        if let Some(published) = published {
            row.against(paired, published);
        }
        table.row("  these graphs", "", tally.text());
    };
    for degree in DEGREES {
        for size in NODES {
            let tally = random_graphs(size, degree, seeds, stop);
            row(format!("random graphs of {size} nodes, mean degree {degree}"), Some(PUBLISHED), &tally);
        }
    }
    for flat in [true, false] {
        for size in CELLS {
            let tally = drawn_structures(size, flat, seeds, stop);
            let dimensions = if flat { "in one layer" } else { "in space" };
            row(format!("drawn structures of {size} cells, {dimensions}"), None, &tally);
        }
    }
    table.row(
        "graphs with more pairs than a maximum matching",
        "",
        format!("{impossible} of {}", count(graphs)),
    );
    table.notes = vec![
        "published: 1,000 valid graphs of at least 20 nodes; mean degree and sizes are not printed".to_owned(),
        "the remaining 10% are called impossible to pair, which fits the share that can be paired".to_owned(),
        "the text does not say what follows when no component of two nodes is left; here a drawn edge is paired"
            .to_owned(),
        "a node with more than two isolated neighbours is invalid; two already forbid a pairing".to_owned(),
        "cells on a lattice form bipartite graphs, random graphs do not".to_owned(),
    ];
    table
}

/// Draws valid graphs, and stops early if interrupted or if hardly any graph is valid.
fn random_graphs(size: usize, degree: u64, seeds: u64, stop: &Interrupt) -> Tally {
    let mut tally = Tally::default();
    let mut rng = Rng::named(degree, "pairing", size as u64);
    for _ in 0..seeds.saturating_mul(DRAWS_MAX) {
        if tally.valid == seeds || stop.is_set() {
            break;
        }
        let nodes = Nodes::random(size, degree, &mut rng);
        if nodes.is_valid() {
            tally.add(&nodes, size, &mut rng);
        }
    }
    tally
}

fn drawn_structures(size: usize, flat: bool, seeds: u64, stop: &Interrupt) -> Tally {
    let mut tally = Tally::default();
    let mut rng = Rng::named(u64::from(flat), "structures", size as u64);
    for _ in 0..seeds {
        if stop.is_set() {
            break;
        }
        let cells = structure(Kind::Eden, flat, size, &mut rng);
        let pairing = Pairing::of(&cells).expect("invariant: grown structures are connected");
        tally.add(&Nodes::of(&pairing), size, &mut rng);
    }
    tally
}
