//! A repertoire: the best point of each way to behave (MAP-Elites, Mouret and Clune 2015).
//!
//! Behaviour is divided into cells. The first points are drawn; later ones are variations of elites of random cells.

use super::ask_tell::{BATCH, Learner, Point, Scored, anywhere, normal};
use metamorph_protocol::rng::Rng;
use std::collections::BTreeMap;

/// Parts of the range of each number of a behaviour.
const PARTS: f64 = 5.0;
/// Number of points drawn before variation begins.
const DRAWN: usize = 4 * BATCH;
/// Spread of a variation, as a share of a side of the box.
const VARIATION: f64 = 0.1;

/// A cell of the space of behaviours.
type Cell = Vec<u8>;

/// Returns the cell of a behaviour.
pub fn cell(behaviour: &[f64]) -> Cell {
    behaviour.iter().map(|b| (b * PARTS).clamp(0.0, PARTS - 1.0) as u8).collect()
}

/// The elites, and points to come.
pub struct Repertoire {
    dimensions: usize,
    rng: Rng,
    asked: Vec<Point>,
    told: usize,
    elites: BTreeMap<Cell, (f64, Point)>,
}

impl Repertoire {
    /// Creates an empty repertoire.
    pub fn new(dimensions: usize, rng: Rng) -> Repertoire {
        Repertoire { dimensions, rng, asked: Vec::new(), told: 0, elites: BTreeMap::new() }
    }

    fn variation(&mut self) -> Point {
        let at = self.rng.below(self.elites.len() as u64) as usize;
        let elite = self.elites.values().nth(at).map(|(_, point)| point.clone());
        let elite = elite.unwrap_or_else(|| anywhere(self.dimensions, &mut self.rng));
        elite.iter().map(|x| (x + VARIATION * normal(&mut self.rng)).clamp(0.0, 1.0)).collect()
    }
}

impl Learner for Repertoire {
    fn ask(&mut self) -> Vec<Point> {
        let drawn = self.told < DRAWN;
        self.asked = (0..BATCH)
            .map(|_| if drawn { anywhere(self.dimensions, &mut self.rng) } else { self.variation() })
            .collect();
        self.asked.clone()
    }
    fn tell(&mut self, results: &[Scored]) {
        self.told += results.len();
        for (point, result) in self.asked.iter().zip(results) {
            let cell = cell(&result.behaviour);
            if self.elites.get(&cell).is_none_or(|(fitness, _)| result.fitness > *fitness) {
                self.elites.insert(cell, (result.fitness, point.clone()));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_cell_keeps_its_best() {
        let mut repertoire = Repertoire::new(2, Rng::named(1, "test", 0));
        for _ in 0..200 {
            let points = repertoire.ask();
            let scored = points.iter().map(|p| Scored { fitness: -p[0], behaviour: vec![p[1]] });
            repertoire.tell(&scored.collect::<Vec<_>>());
        }
        let cells: Vec<&Cell> = repertoire.elites.keys().collect();
        assert_eq!(cells, [&[0], &[1], &[2], &[3], &[4]]);
        assert!(repertoire.elites.values().all(|(fitness, _)| *fitness > -0.05));
        assert_eq!((cell(&[1.0, 0.0]), cell(&[-1.0, 7.0])), (vec![4, 0], vec![0, 4]));
    }
}
