//! Learners as state machines: ask for points to try, then tell how good they were.
//!
//! Points are in the unit box, and larger is better. A learner is a function of its seed and of the results that it
//! got, so a study is resumed by telling its results again. Results depend neither on the number of threads nor on
//! time.

use super::bayes::Bayes;
use super::cma::CmaEs;
use super::pso::Swarm;
use super::repertoire::Repertoire;
use metamorph_protocol::rng::Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::fmt;

/// A point in the unit box.
pub type Point = Vec<f64>;

/// Result of trying a point.
#[derive(Clone, Debug, PartialEq)]
pub struct Scored {
    /// How good it is.
    pub fitness: f64,
    /// Behaviour of the gait as coordinates from 0 to 1; used by [`Repertoire`] only.
    pub behaviour: Vec<f64>,
}

/// A learner.
pub trait Learner {
    /// Returns the points to try next, at least one.
    fn ask(&mut self) -> Vec<Point>;
    /// Takes the results of the points asked for last, in their order. Results after the last one are missing if the study
    /// ends there.
    fn tell(&mut self, results: &[Scored]);
}

/// How gaits are learnt.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// CMA-ES: adapts the covariance of a normal distribution
    Cma,
    /// Bayesian optimisation: a model of all results, one gait at a time
    Bayes,
    /// The thesis's swarm of 80 particles
    Pso,
    /// Uniformly drawn gaits, for comparison
    Random,
    /// MAP-Elites: the best gait of each way to use the limbs
    Repertoire,
}

impl Method {
    /// Creates the learner of a number of parameters. `start` is where it begins, if it can.
    pub fn learner(
        self,
        dimensions: usize,
        seed: u64,
        start: Option<Point>,
    ) -> Box<dyn Learner + Send + Sync> {
        let rng = Rng::named(seed, "learn", 0);
        match self {
            Method::Cma => match start {
                Some(start) => Box::new(CmaEs::new(start, SIGMA_NEAR, rng)),
                None => Box::new(CmaEs::new(vec![0.5; dimensions], SIGMA, rng)),
            },
            Method::Bayes => Box::new(Bayes::new(dimensions, rng)),
            Method::Pso => Box::new(Swarm::new(dimensions, rng)),
            Method::Random => Box::new(Random { dimensions, rng }),
            Method::Repertoire => Box::new(Repertoire::new(dimensions, rng)),
        }
    }
}

/// Initial spread of CMA-ES, as a share of a side of the box.
const SIGMA: f64 = 0.3;
/// Initial spread of CMA-ES around a known gait, as a share of a side of the box.
const SIGMA_NEAR: f64 = 0.15;

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Method::Cma => "cma",
            Method::Bayes => "bayes",
            Method::Pso => "pso",
            Method::Random => "random",
            Method::Repertoire => "repertoire",
        })
    }
}

/// Draws a number of [0, 1).
pub fn uniform(rng: &mut Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

/// Draws a normally distributed number (Box and Muller).
pub fn normal(rng: &mut Rng) -> f64 {
    // In (0, 1], so that the logarithm is finite.
    let radius = (-2.0 * libm::log(1.0 - uniform(rng))).sqrt();
    radius * libm::cos(TAU * uniform(rng))
}

/// Draws a point of the unit box.
pub fn anywhere(dimensions: usize, rng: &mut Rng) -> Point {
    (0..dimensions).map(|_| uniform(rng)).collect()
}

/// Points that [`Random`] and [`Repertoire`] ask for at a time.
pub const BATCH: usize = 10;

/// Uniformly drawn points.
struct Random {
    dimensions: usize,
    rng: Rng,
}

impl Learner for Random {
    fn ask(&mut self) -> Vec<Point> {
        (0..BATCH).map(|_| anywhere(self.dimensions, &mut self.rng)).collect()
    }
    fn tell(&mut self, _: &[Scored]) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Those that are quick with thousands of points.
    const ALL: [Method; 4] = [Method::Cma, Method::Pso, Method::Random, Method::Repertoire];

    fn sphere(x: &[f64]) -> f64 {
        -x.iter().enumerate().map(|(i, x)| (x - 0.2 - 0.05 * i as f64).powi(2)).sum::<f64>()
    }
    /// Rosenbrock's valley on [-2, 2], with its optimum at 1 in every direction.
    fn rosenbrock(x: &[f64]) -> f64 {
        let x: Vec<f64> = x.iter().map(|x| 4.0 * x - 2.0).collect();
        -x.windows(2).map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2)).sum::<f64>()
    }
    /// An optimum in a corner of the box.
    fn corner(x: &[f64]) -> f64 {
        x.iter().sum::<f64>() - x.len() as f64
    }

    /// Returns all points asked for and the best value among them.
    fn optimise(
        method: Method,
        f: fn(&[f64]) -> f64,
        n: usize,
        trials: usize,
        seed: u64,
    ) -> (Vec<Point>, f64) {
        let mut learner = method.learner(n, seed, None);
        let (mut all, mut best) = (Vec::new(), f64::MIN);
        while all.len() < trials {
            let points = learner.ask();
            assert!(points.iter().flatten().all(|x| (0.0..=1.0).contains(x)), "{method} left the box");
            let scored = points.iter().map(|p| Scored { fitness: f(p), behaviour: p[..2].to_vec() });
            let scored: Vec<Scored> = scored.collect();
            best = scored.iter().map(|s| s.fitness).fold(best, f64::max);
            learner.tell(&scored);
            all.extend(points);
        }
        (all, best)
    }

    fn median(method: Method, f: fn(&[f64]) -> f64, n: usize, trials: usize) -> f64 {
        let mut all: Vec<f64> = (0..5).map(|seed| optimise(method, f, n, trials, seed).1).collect();
        all.sort_by(f64::total_cmp);
        all[2]
    }

    #[test]
    fn known_optima_are_found() {
        for (method, f, n, trials, within) in [
            (Method::Cma, sphere as fn(&[f64]) -> f64, 10, 2_000, 1e-9),
            (Method::Cma, rosenbrock, 5, 4_000, 1e-6),
            (Method::Cma, corner, 10, 2_000, 1e-3),
            (Method::Pso, sphere, 10, 16_000, 1e-6),
            (Method::Pso, corner, 10, 16_000, 1e-3),
            (Method::Repertoire, sphere, 5, 2_000, 1e-2),
        ] {
            let best = median(method, f, n, trials);
            assert!(best > -within, "{method} in {n} dimensions: {best}");
        }
    }

    /// All do better than uniform points on the same budget.
    #[test]
    fn learning_is_better_than_drawing() {
        let random = median(Method::Random, sphere, 14, 400);
        for method in ALL.into_iter().filter(|m| *m != Method::Random) {
            let best = median(method, sphere, 14, 400);
            assert!(best > 0.8 * random, "{method}: {best}, random: {random}");
        }
    }

    #[test]
    fn the_same_seed_and_results_give_the_same_points() {
        for (method, n) in ALL.map(|method| (method, 300)).into_iter().chain([(Method::Bayes, 30)]) {
            let first = optimise(method, sphere, 6, n, 7);
            assert_eq!(first, optimise(method, sphere, 6, n, 7), "{method}");
            assert_ne!(first.0, optimise(method, sphere, 6, n, 8).0, "{method}");
        }
    }

    /// A trial without a finite value must not stop a study.
    #[test]
    fn equal_results_do_no_harm() {
        for method in ALL {
            let (points, _) = optimise(method, |_| 0.0, 4, 2_000, 1);
            assert!(points.iter().flatten().all(|x| x.is_finite()), "{method}");
        }
    }

    #[test]
    fn a_start_is_where_the_first_points_are() {
        let mut learner = Method::Cma.learner(6, 1, Some(vec![0.2; 6]));
        let points = learner.ask();
        let mean = points.iter().flatten().sum::<f64>() / (6 * points.len()) as f64;
        assert!((0.1..0.35).contains(&mean), "{mean}");
    }

    #[test]
    fn normal_numbers_have_mean_0_and_variance_1() {
        let mut rng = Rng::named(1, "test", 0);
        let drawn: Vec<f64> = (0..100_000).map(|_| normal(&mut rng)).collect();
        let mean = drawn.iter().sum::<f64>() / 1e5;
        let variance = drawn.iter().map(|x| x * x).sum::<f64>() / 1e5;
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.02, "{mean}, {variance}");
    }
}
