//! Gait files: a learnt gait with everything needed to learn it again, and all trials.

use super::ask_tell::Method;
use super::space::{Gait, OFFSETS_DEG, angle, phase, radians, turns};
use super::study::{Fitness, Trial};
use metamorph_protocol::free_module::gait::message::{LARGEST, Parameters};
use metamorph_protocol::free_module::structure::Joint;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The name of the format.
pub const FORMAT: &str = "metamorph gait";
/// The version of the format.
pub const VERSION: u32 = 1;

/// A gait, and how it was learnt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GaitFile {
    /// `metamorph gait`.
    pub format: String,
    /// 1.
    pub version: u32,
    /// What was asked for.
    pub study: StudyPart,
    /// The best gait of all runs; null before the first trial.
    pub best: Option<Best>,
    /// One for each seed, in order.
    pub runs: Vec<RunPart>,
}

/// What a study depends on. Two studies with the same values have the same results.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StudyPart {
    /// The name or the file of the structure.
    pub structure: String,
    /// The hash of the structure, as 16 hexadecimal digits.
    pub fingerprint: String,
    /// The direction of the first module's foot frame that points down at the start.
    pub down: String,
    /// Modules that are dead.
    pub dead: Vec<u32>,
    /// The network: fo, blf, blf-sym or sym.
    pub network: String,
    /// The learner.
    pub method: Method,
    /// What a gait is worth.
    pub fitness: Fitness,
    /// The direction in which the distance counted, in degrees from +x towards +y; null for any.
    #[serde(default)]
    pub heading_deg: Option<f64>,
    /// True if a trial ended with a fall, and its speed counted a thousandth. Older files do not say so.
    #[serde(default)]
    pub upright: bool,
    /// The largest offset of an oscillator in degrees. Older files, which do not say so, have 30.
    #[serde(default = "offsets_deg")]
    pub offsets_deg: f64,
    /// The time of a trial in seconds, after 2 s at rest.
    pub trial_s: f64,
    /// The number of gaits that each run tries.
    pub trials: u64,
    /// The gait that the learner began at; null if it began anywhere.
    pub from: Option<Vec<JointPart>>,
    /// The engine and its version.
    pub engine: String,
}

fn offsets_deg() -> f64 {
    OFFSETS_DEG
}

/// The runs of a seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RunPart {
    /// The seed.
    pub seed: u64,
    /// The trials, in order.
    pub trials: Vec<Trial>,
}

/// The best gait.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Best {
    /// The seed of its run.
    pub seed: u64,
    /// The number of the trial, from 1.
    pub trial: u64,
    /// Its fitness in mm/s.
    pub fitness_mm_s: f64,
    /// The oscillators.
    pub joints: Vec<JointPart>,
}

/// The oscillator of a joint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JointPart {
    /// 3 * module + 0, 1 or 2 for q1, q2 or q3.
    pub joint: u16,
    /// The amplitude in radians.
    pub amplitude_rad: f64,
    /// The offset in radians.
    pub offset_rad: f64,
    /// The phase in turns, from 0 to 1.
    pub phase_turns: f64,
}

/// Returns a gait as it is written.
pub fn written(gait: &Gait) -> Vec<JointPart> {
    let part = |(joint, p): (&Joint, &Parameters)| JointPart {
        joint: joint.0,
        amplitude_rad: radians(p.amplitude),
        offset_rad: radians(p.offset),
        phase_turns: turns(p.phase),
    };
    gait.iter().map(part).collect()
}

/// Returns the gait that was written, of a structure with this many joints.
///
/// # Errors
/// Returns the joint that is wrong, and what is wrong with it.
pub fn read(parts: &[JointPart], joints: usize) -> Result<Gait, (u16, &'static str)> {
    let mut gait = Gait::new();
    let most = radians(LARGEST);
    for part in parts {
        let wrong = |what| Err((part.joint, what));
        if usize::from(part.joint) >= joints {
            return wrong("is not a joint of the structure");
        }
        if !(0.0..=most).contains(&part.amplitude_rad) || !(-most..=most).contains(&part.offset_rad) {
            return wrong("has an amplitude or offset beyond 4 rad, or a negative amplitude");
        }
        if !(0.0..=1.0).contains(&part.phase_turns) {
            return wrong("has a phase that is not from 0 to 1");
        }
        let parameters = Parameters {
            amplitude: angle(part.amplitude_rad),
            offset: angle(part.offset_rad),
            phase: phase(part.phase_turns),
        };
        if gait.insert(Joint(part.joint), parameters).is_some() {
            return wrong("stands twice");
        }
    }
    Ok(gait)
}

impl StudyPart {
    /// Returns the first value in which another study differs, with both.
    pub fn difference(&self, other: &StudyPart) -> Option<(&'static str, String, String)> {
        let text = |s: &StudyPart| {
            [
                ("structure", s.fingerprint.clone()),
                ("--down", s.down.clone()),
                ("--dead", format!("{:?}", s.dead)),
                ("--network", s.network.clone()),
                ("--method", s.method.to_string()),
                ("--fitness", format!("{:?}", s.fitness).to_lowercase()),
                ("--heading", s.heading_deg.map_or("any".to_owned(), |h| format!("{h} degrees"))),
                ("--upright", s.upright.to_string()),
                ("--offsets", format!("{}deg", s.offsets_deg)),
                ("--trial", format!("{} s", s.trial_s)),
                ("--from", format!("{} oscillators", s.from.as_ref().map_or(0, Vec::len))),
                ("the engine", s.engine.clone()),
            ]
        };
        let pairs = text(self).into_iter().zip(text(other));
        let found = pairs.map(|((name, ours), (_, theirs))| (name, ours, theirs)).find(|(_, a, b)| a != b);
        let start = (self.from != other.from).then(|| ("--from", "a gait".into(), "another gait".into()));
        found.or(start)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(joint: u16) -> JointPart {
        JointPart { joint, amplitude_rad: 0.5, offset_rad: -0.25, phase_turns: 0.75 }
    }

    #[test]
    fn gaits_go_there_and_back() {
        let parts = [part(0), part(3)];
        let gait = read(&parts, 6).unwrap();
        assert_eq!(written(&gait), parts);
    }

    #[test]
    fn wrong_joints_are_named() {
        let wrong = |part: JointPart| read(&[part], 6).unwrap_err();
        assert_eq!(wrong(part(6)).0, 6);
        for value in [f64::NAN, -0.1, 4.1] {
            assert_eq!(wrong(JointPart { amplitude_rad: value, ..part(2) }).0, 2);
            assert_eq!(wrong(JointPart { phase_turns: value, ..part(2) }).0, 2);
        }
        assert_eq!(wrong(JointPart { offset_rad: f64::INFINITY, ..part(2) }).0, 2);
        assert_eq!(read(&[part(1), part(1)], 6).unwrap_err(), (1, "stands twice"));
    }
}
