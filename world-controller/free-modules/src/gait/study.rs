//! Trials of a study: what the fitness of a gait is.

use super::ask_tell::{Point, Scored};
use super::space::{Gait, Space};
use metamorph_protocol::free_module::structure::JOINTS;
use metamorph_sim_bridge::free_module::physics::{FRICTION, PhysicsError};
use metamorph_sim_bridge::free_module::trial::{TrialOutcome, TrialSetup};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What a gait is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Fitness {
    /// The least speed with friction 0.8, 0.6 and 1.0
    Robust,
    /// The speed with friction 0.8
    Thesis,
}

impl Fitness {
    /// Returns the frictions of the trials of a gait.
    pub const fn frictions(self) -> &'static [f32] {
        match self {
            Fitness::Robust => &[FRICTION, 0.6, 1.0],
            Fitness::Thesis => &[FRICTION],
        }
    }
}

/// The factor of the speed after a self-collision (thesis 7.6), or after a fall that ends a trial.
const COLLIDED: f64 = 0.001;

/// One gait tried.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Trial {
    /// The parameters, each from 0 to 1: amplitudes, offsets, lags.
    pub parameters: Vec<f64>,
    /// The fitness in mm/s.
    pub fitness_mm_s: f64,
    /// True if two modules met. The gait is not tried with other frictions then.
    pub collided: bool,
    /// True if an invariant of the bodies was violated; the fitness is 0 then.
    pub broken: bool,
    /// True if the body turned upside down. Older files do not say so.
    #[serde(default)]
    pub fell: bool,
    /// The share of time that each module has touched the floor, with the first friction.
    pub duty: Vec<f64>,
}

/// Parameters that all trials of a study share.
pub struct Study {
    /// The structure and the time.
    pub course: TrialSetup,
    /// The parameters.
    pub space: Space,
    /// The fitness.
    pub fitness: Fitness,
}

/// Returns how a gait uses the limbs: the share of time that each module with an oscillator has touched the floor.
pub fn behaviour(space: &Space, trial: &Trial) -> Vec<f64> {
    let moving = |m: usize| space.oscillators().iter().any(|j| usize::from(j.0 / JOINTS) == m);
    trial.duty.iter().enumerate().filter(|(m, _)| moving(*m)).map(|(_, d)| *d).collect()
}

impl Study {
    /// Returns the fitness of an outcome in mm/s (thesis 7.8).
    fn speed(&self, outcome: &TrialOutcome) -> f64 {
        let speed = outcome.distance_mm / self.course.time.as_secs_f64();
        if outcome.collided || outcome.fallen { speed * COLLIDED } else { speed }
    }

    /// Tries a gait with every friction, and returns the speeds and the outcomes.
    ///
    /// # Errors
    /// Refuses a structure that cannot have bodies.
    pub fn outcomes(&self, gait: &Gait) -> Result<Vec<(f64, TrialOutcome)>, PhysicsError> {
        let mut all: Vec<(f64, TrialOutcome)> = Vec::new();
        for friction in self.fitness.frictions() {
            let outcome = self.course.trial(gait.clone(), *friction)?;
            let ends = outcome.collided || outcome.fallen || outcome.broken;
            all.push((self.speed(&outcome), outcome));
            if ends {
                break;
            }
        }
        Ok(all)
    }

    /// Tries a gait, with other frictions until it fails.
    ///
    /// # Errors
    /// Refuses a structure that cannot have bodies.
    pub fn trial(&self, point: Point) -> Result<Trial, PhysicsError> {
        let outcomes = self.outcomes(&self.space.gait(&point))?;
        let fitness_mm_s = outcomes.iter().map(|(speed, _)| *speed).fold(f64::INFINITY, f64::min);
        let any = |of: fn(&TrialOutcome) -> bool| outcomes.iter().any(|(_, outcome)| of(outcome));
        let duty = outcomes.first().map(|(_, outcome)| outcome.duty.clone()).unwrap_or_default();
        let (collided, broken, fell) = (any(|o| o.collided), any(|o| o.broken), any(|o| o.falls > 0));
        Ok(Trial { parameters: point, fitness_mm_s, collided, broken, fell, duty })
    }

    /// Returns the result of a trial for a learner: the fitness, and the duty of limbs as behaviour. A fitness that is no
    /// number counts as 0.
    pub fn scored(&self, trial: &Trial) -> Scored {
        let fitness = if trial.fitness_mm_s.is_finite() { trial.fitness_mm_s } else { 0.0 };
        Scored { fitness, behaviour: behaviour(&self.space, trial) }
    }
}
