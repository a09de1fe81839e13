//! Elites of a repertoire after a failure: which of them to try next, by what the others were worth (Cully, Clune, Tarapore
//! and Mouret, "Robots that can adapt like animals", 2015).
//!
//! What a gait is worth after a failure is what it was worth before, plus a function of how the limbs are used. Each trial
//! tells something about that function, so that gaits which use the limbs alike need not be tried.

use super::document::GaitFile;
use super::gaussian_process::Process;
use super::repertoire::cell;
use super::space::{Gait, Space};
use super::study::behaviour;
use std::collections::BTreeMap;

/// The distance of behaviours in which the function changes.
const LENGTH: f64 = 0.4;
/// Number of standard deviations by which a gait may be better than expected.
const HOPE: f64 = 0.05;
/// The standard deviation of the function, as a share of the fastest elite's speed.
const SPREAD: f64 = 0.3;
/// Gaits slower than this share of the fastest one are no elites.
const SLOWEST: f64 = 0.2;

/// A gait, and what it does.
#[derive(Clone, Debug, PartialEq)]
pub struct Elite {
    /// The gait.
    pub gait: Gait,
    /// The speed in mm/s when it was learnt.
    pub speed_mm_s: f64,
    /// How the limbs are used, as numbers from 0 to 1.
    pub behaviour: Vec<f64>,
}

/// Returns the fastest gait of each way to use the limbs, the fastest first.
fn elites(all: impl IntoIterator<Item = Elite>) -> Vec<Elite> {
    let mut cells: BTreeMap<Vec<u8>, Elite> = BTreeMap::new();
    for elite in all {
        let cell = cell(&elite.behaviour);
        if cells.get(&cell).is_none_or(|other| elite.speed_mm_s > other.speed_mm_s) {
            cells.insert(cell, elite);
        }
    }
    let mut found: Vec<Elite> = cells.into_values().collect();
    found.sort_by(|a, b| b.speed_mm_s.total_cmp(&a.speed_mm_s));
    let least = found.first().map_or(0.0, |fastest| SLOWEST * fastest.speed_mm_s);
    found.retain(|elite| elite.speed_mm_s > least);
    found
}

/// Returns the elites among all trials of a gait file, whose gaits have these parameters. Trials that cannot be of this space
/// are left out.
pub fn of_file(file: &GaitFile, space: &Space) -> Vec<Elite> {
    let trials = file.runs.iter().flat_map(|run| &run.trials);
    let fits = trials.filter(|trial| {
        let in_box = trial.parameters.iter().all(|x| (0.0..=1.0).contains(x));
        trial.parameters.len() == space.dimensions() && in_box && trial.fitness_mm_s.is_finite()
    });
    elites(fits.map(|trial| Elite {
        gait: space.gait(&trial.parameters),
        speed_mm_s: trial.fitness_mm_s,
        behaviour: behaviour(space, trial),
    }))
}

/// Elites of which some were tried.
#[derive(Clone, Debug)]
pub struct Order {
    elites: Vec<Elite>,
    /// Indices of those tried, and their speeds now.
    tried: Vec<(usize, f64)>,
}

impl Order {
    /// Begins with elites, the fastest first.
    pub fn new(elites: Vec<Elite>) -> Order {
        Order { elites, tried: Vec::new() }
    }

    /// Returns the elite to try next; `None` if no other one is expected to be faster than the best one tried.
    pub fn choose(&mut self) -> Option<&Elite> {
        let scale = SPREAD * self.elites.first()?.speed_mm_s;
        let points = self.tried.iter().map(|(i, _)| self.elites[*i].behaviour.clone()).collect();
        let values = self.tried.iter().map(|(i, speed)| (speed - self.elites[*i].speed_mm_s) / scale);
        let process = Process::new(points, &values.collect::<Vec<_>>(), LENGTH);
        let open = (0..self.elites.len()).filter(|i| self.tried.iter().all(|(tried, _)| tried != i));
        let hoped = open.map(|i| {
            let (mean, spread) = process.predict(&self.elites[i].behaviour);
            (i, self.elites[i].speed_mm_s + scale * (mean + HOPE * spread))
        });
        let (next, hoped) = hoped.reduce(|a, b| if b.1 > a.1 { b } else { a })?;
        let best = self.tried.iter().map(|(_, speed)| *speed).fold(0.0, f64::max);
        if hoped <= best {
            return None;
        }
        // Its speed is the next result.
        self.tried.push((next, 0.0));
        Some(&self.elites[next])
    }

    /// Takes the speed of a gait that was tried without being asked for, if it is an elite.
    pub fn heard(&mut self, gait: &Gait, speed_mm_s: f64) {
        let found = self.elites.iter().position(|elite| elite.gait == *gait);
        self.tried.extend(found.map(|i| (i, speed_mm_s)));
    }

    /// Takes the speed of the elite returned last.
    pub fn tell(&mut self, speed_mm_s: f64) {
        if let Some((_, speed)) = self.tried.last_mut() {
            *speed = speed_mm_s;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn elite(speed_mm_s: f64, behaviour: [f64; 2]) -> Elite {
        Elite { gait: Gait::new(), speed_mm_s, behaviour: behaviour.to_vec() }
    }

    #[test]
    fn each_cell_has_its_fastest_gait() {
        let all = [(10.0, [0.1, 0.1]), (12.0, [0.15, 0.05]), (30.0, [0.9, 0.1]), (5.0, [0.9, 0.9])];
        let found = elites(all.map(|(speed, behaviour)| elite(speed, behaviour)));
        assert_eq!(found.iter().map(|e| e.speed_mm_s).collect::<Vec<_>>(), [30.0, 12.0]);
    }

    /// Gaits that use the first limb are worth nothing any more. After the first one, those beside it are passed over, and the
    /// fastest one without it is found although many were faster before.
    #[test]
    fn what_one_gait_is_worth_tells_about_those_like_it() {
        let with: Vec<Elite> =
            (0..10).map(|i| elite(50.0 - f64::from(i), [0.9, 0.3 + 0.02 * f64::from(i)])).collect();
        let without: Vec<Elite> =
            (0..10).map(|i| elite(35.0 - f64::from(i), [0.1, 0.3 + 0.02 * f64::from(i)])).collect();
        let mut order = Order::new(elites(with).into_iter().chain(without).collect());
        let mut tried = Vec::new();
        while let Some(elite) = order.choose() {
            let is_useless = elite.behaviour[0] > 0.5;
            tried.push(elite.speed_mm_s);
            let speed = if is_useless { 1.0 } else { elite.speed_mm_s };
            order.tell(speed);
        }
        assert!(tried.len() <= 4 && tried.contains(&35.0), "{tried:?}");
    }

    #[test]
    fn without_elites_there_is_nothing_to_try() {
        assert!(Order::new(Vec::new()).choose().is_none());
        let mut order = Order::new(vec![elite(10.0, [0.5, 0.5])]);
        assert!(order.choose().is_some());
        order.tell(9.0);
        assert!(order.choose().is_none());
    }
}
