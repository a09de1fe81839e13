//! Particle swarm optimisation with the constants of the thesis (table 7.3; Clerc and Kennedy 2002).

use super::ask_tell::{Learner, Point, Scored, anywhere, uniform};
use metamorph_protocol::rng::Rng;

/// Number of particles, as for the thesis's quadruped.
const PARTICLES: usize = 80;
/// Largest velocity per step, as a share of a side of the box.
const VELOCITY_MAX: f64 = 0.6;
/// Factor of the attraction to the best point of the swarm.
const SOCIAL: f64 = 2.05;
/// Factor of the attraction to the best point of the particle.
const COGNITIVE: f64 = 2.05;
/// Constriction factor of velocities.
const CONSTRICTION: f64 = 0.729;

#[derive(Clone)]
struct Particle {
    at: Point,
    velocity: Vec<f64>,
    best: Point,
    fitness: f64,
}

/// A swarm in which every particle knows the best point of all. The thesis leaves the topology open.
pub struct Swarm {
    particles: Vec<Particle>,
    best: Point,
    fitness: f64,
    rng: Rng,
    begun: bool,
}

impl Swarm {
    /// Draws a swarm.
    pub fn new(dimensions: usize, mut rng: Rng) -> Swarm {
        let particles: Vec<Particle> = (0..PARTICLES)
            .map(|_| {
                let at = anywhere(dimensions, &mut rng);
                let velocity =
                    (0..dimensions).map(|_| VELOCITY_MAX * (2.0 * uniform(&mut rng) - 1.0)).collect();
                Particle { best: at.clone(), at, velocity, fitness: f64::MIN }
            })
            .collect();
        Swarm { best: particles[0].at.clone(), particles, fitness: f64::MIN, rng, begun: false }
    }
}

impl Particle {
    fn fly(&mut self, best: &[f64], rng: &mut Rng) {
        for (d, best) in best.iter().enumerate() {
            let own = COGNITIVE * uniform(rng) * (self.best[d] - self.at[d]);
            let social = SOCIAL * uniform(rng) * (best - self.at[d]);
            let velocity = CONSTRICTION * (self.velocity[d] + own + social);
            self.velocity[d] = velocity.clamp(-VELOCITY_MAX, VELOCITY_MAX);
            let next = self.at[d] + self.velocity[d];
            // Walls reflect at half the speed.
            let beyond = next - next.clamp(0.0, 1.0);
            if beyond != 0.0 {
                self.velocity[d] *= -0.5;
            }
            self.at[d] = (next - 1.5 * beyond).clamp(0.0, 1.0);
        }
    }
}

impl Learner for Swarm {
    fn ask(&mut self) -> Vec<Point> {
        if self.begun {
            self.particles.iter_mut().for_each(|p| p.fly(&self.best, &mut self.rng));
        }
        self.begun = true;
        self.particles.iter().map(|p| p.at.clone()).collect()
    }
    fn tell(&mut self, results: &[Scored]) {
        for (particle, result) in self.particles.iter_mut().zip(results) {
            if result.fitness > particle.fitness {
                (particle.fitness, particle.best) = (result.fitness, particle.at.clone());
            }
            if result.fitness > self.fitness {
                (self.fitness, self.best) = (result.fitness, particle.at.clone());
            }
        }
    }
}
