//! The runs of a study: one for each seed, from what a gait file has up to the number of trials.

use super::LearnError;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::terminal::Live;
use metamorph_free_modules::gait::ask_tell::{Point, Scored};
use metamorph_free_modules::gait::document::{Best, GaitFile, RunPart, StudyPart, written};
use metamorph_free_modules::gait::study::{Study, Trial};
use metamorph_free_modules::plan::PlanError;
use metamorph_scenario::grid::Seeds;
use metamorph_sim_bridge::free_module::physics::PhysicsError;
use std::num::NonZeroUsize;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// Parameters that all runs of a study share.
pub struct Runs<'a> {
    /// The trials.
    pub study: &'a Study,
    /// Description of the study in the gait file.
    pub part: &'a StudyPart,
    /// Where the learner begins.
    pub start: Option<Point>,
    /// The seeds.
    pub seeds: Seeds,
    /// The number of threads.
    pub jobs: NonZeroUsize,
    /// The request to end early.
    pub interrupt: &'a Interrupt,
}

impl Runs<'_> {
    /// Carries out all runs, and keeps the file after every round of trials.
    ///
    /// # Errors
    /// Refuses recorded trials that the learner would not have asked for, and passes on errors of `keep`.
    pub fn all(
        &self,
        file: &mut GaitFile,
        live: &mut Live,
        keep: &mut dyn FnMut(&GaitFile) -> Result<(), LearnError>,
    ) -> Result<(), LearnError> {
        for seed in self.seeds.from..self.seeds.until {
            let at = file.runs.iter().position(|run| run.seed == seed).unwrap_or_else(|| {
                file.runs.push(RunPart { seed, trials: Vec::new() });
                file.runs.len() - 1
            });
            self.run(seed, at, file, live, keep)?;
            if self.interrupt.is_set() {
                break;
            }
        }
        file.best = self.best(file);
        keep(file)
    }

    /// Carries out one run. Recorded trials are replayed into the learner, which continues from there.
    fn run(
        &self,
        seed: u64,
        at: usize,
        file: &mut GaitFile,
        live: &mut Live,
        keep: &mut dyn FnMut(&GaitFile) -> Result<(), LearnError>,
    ) -> Result<(), LearnError> {
        let wanted = self.part.trials as usize;
        let mut learner = self.part.method.learner(self.study.space.dimensions(), seed, self.start.clone());
        let mut told = 0;
        while told < wanted {
            let points: Vec<Point> = learner.ask().into_iter().take(wanted - told).collect();
            let known = &file.runs[at].trials[told.min(file.runs[at].trials.len())..];
            let known = &known[..known.len().min(points.len())];
            if let Some(i) = known.iter().zip(&points).position(|(trial, point)| trial.parameters != *point) {
                let reason =
                    format!("trial {} of seed {seed} is not the one that was asked for", told + i + 1);
                return Err(PlanError::option("--resume", reason, "begin again with another file").into());
            }
            let (recorded, count) = (known.len(), points.len());
            let news = self.round(points[recorded..].to_vec(), seed, told + recorded, live)?;
            let is_new = !news.is_empty();
            file.runs[at].trials.extend(news);
            let round = &file.runs[at].trials[told..file.runs[at].trials.len().min(told + count)];
            let scored: Vec<Scored> = round.iter().map(|trial| self.study.scored(trial)).collect();
            told += scored.len();
            if is_new {
                file.best = self.best(file);
                keep(file)?;
            }
            if scored.len() < count {
                break;
            }
            learner.tell(&scored);
        }
        Ok(())
    }

    fn round(
        &self,
        points: Vec<Point>,
        seed: u64,
        before: usize,
        live: &mut Live,
    ) -> Result<Vec<Trial>, PlanError> {
        let state = Mutex::new((live, before));
        let done = || {
            let mut state = state.lock().expect("invariant: no thread panics with the lock");
            state.1 += 1;
            let count = state.1;
            state.0.show(|| format!("seed {seed}  gait {count} of {}", self.part.trials));
        };
        let trials = trials(self.study, points, self.jobs, self.interrupt, &done);
        trials.map_err(|error| PlanError::option(&self.part.structure, error.to_string(), super::BODIES))
    }

    /// Returns the best gait of all runs; of equals the first.
    fn best(&self, file: &GaitFile) -> Option<Best> {
        let all = file.runs.iter().flat_map(|run| run.trials.iter().enumerate().map(move |t| (run.seed, t)));
        let better = |a: Option<(u64, (usize, _))>, b: (u64, (usize, _))| match a {
            Some(a) if fitness(a.1.1) >= fitness(b.1.1) => Some(a),
            _ => Some(b),
        };
        let (seed, (index, trial)) = all.fold(None, better)?;
        let joints = written(&self.study.space.gait(&trial.parameters));
        Some(Best { seed, trial: index as u64 + 1, fitness_mm_s: trial.fitness_mm_s, joints })
    }
}

/// Tries gaits on several threads. Returns them in order; fewer if interrupted.
///
/// # Errors
/// Refuses a structure that cannot have bodies.
fn trials(
    study: &Study,
    points: Vec<Point>,
    jobs: NonZeroUsize,
    interrupt: &Interrupt,
    done: &(dyn Fn() + Sync),
) -> Result<Vec<Trial>, PhysicsError> {
    let next = AtomicUsize::new(0);
    let results: Vec<Mutex<Option<Result<Trial, PhysicsError>>>> =
        points.iter().map(|_| Mutex::new(None)).collect();
    thread::scope(|scope| {
        for _ in 0..jobs.get().min(points.len()) {
            scope.spawn(|| {
                while !interrupt.is_set() {
                    let i = next.fetch_add(1, Ordering::Relaxed);
                    let Some(point) = points.get(i) else { break };
                    let trial = study.trial(point.clone());
                    *results[i].lock().expect("invariant: no thread panics with the lock") = Some(trial);
                    done();
                }
            });
        }
    });
    let done = results.into_iter().map(|r| r.into_inner().expect("invariant: as above"));
    done.map_while(|result| result).collect()
}

fn fitness(trial: &Trial) -> f64 {
    trial.fitness_mm_s
}
