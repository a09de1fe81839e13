//! CMA-ES with the constants of Hansen, "The CMA evolution strategy: a tutorial", 2016, table 1 without negative weights.
//!
//! Points outside the box are moved to its walls, and the strategy learns from where they were moved to.

use super::ask_tell::{Learner, Point, Scored, normal};
use metamorph_protocol::rng::Rng;
use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// Largest spread, as a share of a side of the box.
const SPREAD_MAX: f64 = 1.0;

/// The strategy.
pub struct CmaEs {
    rng: Rng,
    mean: DVector<f64>,
    sigma: f64,
    covariance: DMatrix<f64>,
    /// Eigenvectors of the covariance, and the roots of its eigenvalues.
    axes: (DMatrix<f64>, DVector<f64>),
    path_of_sigma: DVector<f64>,
    path: DVector<f64>,
    constants: Constants,
    generation: i32,
    asked: Vec<DVector<f64>>,
}

/// Constants of a number of dimensions.
struct Constants {
    population: usize,
    weights: Vec<f64>,
    /// The variance-effective number of parents.
    mu: f64,
    path_of_sigma: f64,
    damping: f64,
    path: f64,
    rank_one: f64,
    rank_mu: f64,
    /// The mean length of a normally distributed vector.
    length: f64,
}

impl Constants {
    fn of(dimensions: usize) -> Constants {
        let n = dimensions as f64;
        let population = 4 + (3.0 * libm::log(n)) as usize;
        let half = population / 2;
        let raw = (1..=half).map(|i| libm::log((population as f64 + 1.0) / 2.0) - libm::log(i as f64));
        let raw: Vec<f64> = raw.collect();
        let sum: f64 = raw.iter().sum();
        let weights: Vec<f64> = raw.iter().map(|w| w / sum).collect();
        let mu = 1.0 / weights.iter().map(|w| w * w).sum::<f64>();
        let path_of_sigma = (mu + 2.0) / (n + mu + 5.0);
        let rank_one = 2.0 / ((n + 1.3) * (n + 1.3) + mu);
        let rank_mu = 2.0 * (mu - 2.0 + 1.0 / mu) / ((n + 2.0) * (n + 2.0) + mu);
        Constants {
            population,
            weights,
            mu,
            path_of_sigma,
            damping: 1.0 + 2.0 * (((mu - 1.0) / (n + 1.0)).sqrt() - 1.0).max(0.0) + path_of_sigma,
            path: (4.0 + mu / n) / (n + 4.0 + 2.0 * mu / n),
            rank_one,
            rank_mu: rank_mu.min(1.0 - rank_one),
            length: n.sqrt() * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n)),
        }
    }
}

impl CmaEs {
    /// Begins at a point with a spread.
    pub fn new(start: Point, sigma: f64, rng: Rng) -> CmaEs {
        let n = start.len();
        CmaEs {
            rng,
            mean: DVector::from_vec(start),
            sigma,
            covariance: DMatrix::identity(n, n),
            axes: (DMatrix::identity(n, n), DVector::repeat(n, 1.0)),
            path_of_sigma: DVector::zeros(n),
            path: DVector::zeros(n),
            constants: Constants::of(n),
            generation: 0,
            asked: Vec::new(),
        }
    }

    /// Moves mean, spread and covariance by the best steps, the best first.
    fn update(&mut self, steps: &[DVector<f64>]) {
        let Constants { weights, mu, path_of_sigma, damping, path, rank_one, rank_mu, length, .. } =
            &self.constants;
        let weighted = steps.iter().zip(weights).map(|(step, weight)| step * *weight);
        let shift = weighted.fold(DVector::zeros(self.mean.len()), |sum, step| sum + step);
        self.mean += &shift * self.sigma;
        let (vectors, lengths) = &self.axes;
        let whitened = vectors * (vectors.transpose() * &shift).component_div(lengths);
        let gain = (path_of_sigma * (2.0 - path_of_sigma) * mu).sqrt();
        self.path_of_sigma = &self.path_of_sigma * (1.0 - path_of_sigma) + whitened * gain;
        self.generation += 1;
        let started = 1.0 - libm::pow(1.0 - path_of_sigma, 2.0 * f64::from(self.generation));
        let norm = self.path_of_sigma.norm();
        let is_long = norm / started.sqrt() / length > 1.4 + 2.0 / (self.mean.len() as f64 + 1.0);
        let (kept, lost) = if is_long { (0.0, path * (2.0 - path)) } else { (1.0, 0.0) };
        self.path = &self.path * (1.0 - path) + &shift * (kept * (path * (2.0 - path) * mu).sqrt());
        let decay = 1.0 - rank_one - rank_mu + rank_one * lost;
        let mut covariance = &self.covariance * decay + &self.path * self.path.transpose() * *rank_one;
        for (step, weight) in steps.iter().zip(weights) {
            covariance += step * step.transpose() * (rank_mu * weight);
        }
        let grown = self.sigma * libm::exp(path_of_sigma / damping * (norm / length - 1.0));
        self.sigma = grown.clamp(1e-12, SPREAD_MAX);
        // Rounding must not make it asymmetric, nor an eigenvalue negative.
        self.covariance = (&covariance + covariance.transpose()) * 0.5;
        let eigen = SymmetricEigen::new(self.covariance.clone());
        self.axes = (eigen.eigenvectors, eigen.eigenvalues.map(|v| v.max(1e-20).sqrt()));
    }
}

impl Learner for CmaEs {
    fn ask(&mut self) -> Vec<Point> {
        let n = self.mean.len();
        let (vectors, lengths) = &self.axes;
        let rng = &mut self.rng;
        self.asked = (0..self.constants.population)
            .map(|_| {
                let drawn = DVector::from_iterator(n, (0..n).map(|_| normal(rng)));
                let point = &self.mean + vectors * drawn.component_mul(lengths) * self.sigma;
                point.map(|x| x.clamp(0.0, 1.0))
            })
            .collect();
        self.asked.iter().map(|p| p.iter().copied().collect()).collect()
    }
    fn tell(&mut self, results: &[Scored]) {
        if results.len() < self.asked.len() {
            return;
        }
        let mut order: Vec<usize> = (0..self.asked.len()).collect();
        order.sort_by(|a, b| results[*b].fitness.total_cmp(&results[*a].fitness));
        let best = order.iter().take(self.constants.weights.len());
        let steps: Vec<DVector<f64>> = best.map(|i| (&self.asked[*i] - &self.mean) / self.sigma).collect();
        self.update(&steps);
    }
}
