//! The static load on the joints of a metamodule that carries an element, by step and mass.
//!
//! The torque on a joint is a linear function of the mass. Of all samples of a step only those are kept that are the
//! largest for some mass, in whole µNm, so that mass and limits stay parameters without floats.

use super::carry::CarryTable;
use metamorph_core::lattice::Face;
use metamorph_roombots::database::Table;
use metamorph_roombots::posture::is_middle;
use metamorph_roombots::torque::{Load, Torque, torques};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// The largest mass of an element, in grams: 20 kg, more than any metamodule lifts.
pub const MAX_GRAMS: u32 = 20_000;

/// The largest torques of the joints, in µNm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LoadLimits {
    /// Of the outer joints.
    pub outer: u32,
    /// Of the middle joints.
    pub middle: u32,
}

impl LoadLimits {
    /// The nominal torques of thesis table 2.1.
    pub const NOMINAL: LoadLimits = LoadLimits { outer: 4_900_000, middle: 3_600_000 };
}

/// The largest torque during a step, in µNm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Peak {
    /// On the outer joints.
    pub outer: u32,
    /// On the middle joints.
    pub middle: u32,
}

impl Peak {
    /// Returns the largest of the torques on all joints.
    pub fn of(torques: &[Torque]) -> Peak {
        let highest = |middle: bool| {
            let of =
                torques.iter().enumerate().filter(|(i, _)| is_middle(*i) == middle).map(|(_, t)| t.exact);
            (of.fold(0.0, f64::max) * 1e6).ceil() as u32
        };
        Peak { outer: highest(false), middle: highest(true) }
    }
    /// Returns true if no limit is exceeded.
    pub fn within(self, limits: LoadLimits) -> bool {
        self.outer <= limits.outer && self.middle <= limits.middle
    }
    /// Returns the larger values of both.
    pub fn max(self, other: Peak) -> Peak {
        Peak { outer: self.outer.max(other.outer), middle: self.middle.max(other.middle) }
    }
}

/// A torque as a function of the mass of the element: µNm, and µNm per kilogram.
type Line = (i64, i64);

/// The loads of all steps of a carry table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LoadTable {
    /// For each step the lines of the outer and of the middle joints.
    steps: Vec<[Vec<Line>; 2]>,
}

impl LoadTable {
    /// Computes the loads of a carry table, where gravity points to `gravity` in the foot frame. Outer joints are
    /// sampled every 7.5°, middle joints likewise.
    pub fn new(table: &Table, carry: &CarryTable, gravity: Face) -> LoadTable {
        let centre = centre_of_mass(carry);
        let down = Vector3::from(<[i16; 3]>::from(gravity.offset()).map(f64::from));
        let of_step = |step: &super::carry::CarryStep| {
            let mut q = table.postures()[usize::from(step.from)].posture.radians();
            let joint = usize::from(step.joint);
            let (first, samples) = (q[joint], if is_middle(joint) { 12_u32 } else { 16 });
            let mut lines = [Vec::new(), Vec::new()];
            for sample in 0..=samples {
                q[joint] = first + (7.5 * f64::from(sample)).to_radians();
                let signed = |payload| {
                    let all = torques(table.kind(), &q, &Load { gravity: down, payload, payload_at: centre });
                    let all =
                        all.expect("invariant: a posture of the table has all joints and finite angles");
                    all.into_iter().map(|t| t.signed).collect::<Vec<f64>>()
                };
                for (i, (empty, loaded)) in signed(0.0).into_iter().zip(signed(1.0)).enumerate() {
                    let line = ((empty * 1e6).round() as i64, ((loaded - empty) * 1e6).round() as i64);
                    lines[usize::from(is_middle(i))].extend([line, (-line.0, -line.1)]);
                }
            }
            lines.map(upper_envelope)
        };
        LoadTable { steps: carry.steps().iter().map(of_step).collect() }
    }

    /// Returns the largest torques during a step with an element of this mass.
    pub fn peak(&self, step: usize, grams: u32) -> Peak {
        let [outer, middle] = &self.steps[step];
        let highest = |lines: &[Line]| {
            let at = lines.iter().map(|line| height(*line, i64::from(grams))).max().unwrap_or(0);
            // Rounded up, so that a limit is never exceeded by less than the resolution.
            u32::try_from((at.max(0) + 999) / 1000).unwrap_or(u32::MAX)
        };
        Peak { outer: highest(outer), middle: highest(middle) }
    }
}

/// Returns the torques on the joints of a metamodule that stands still in a posture with an element of this mass, where
/// gravity points to `gravity` in the foot frame.
pub fn standing_peak(table: &Table, carry: &CarryTable, gravity: Face, posture: u16, grams: u32) -> Peak {
    let down = Vector3::from(<[i16; 3]>::from(gravity.offset()).map(f64::from));
    let load = Load { gravity: down, payload: f64::from(grams) / 1000.0, payload_at: centre_of_mass(carry) };
    let q = table.postures()[usize::from(posture)].posture.radians();
    let all = torques(table.kind(), &q, &load);
    let all = all.expect("invariant: a posture of the table has all joints and finite angles");
    Peak::of(&all)
}

/// Returns the centre of mass of the element in the head frame, in cells.
fn centre_of_mass(carry: &CarryTable) -> Vector3<f64> {
    let centres = &carry.grip().centres;
    let sum = centres.iter().fold([0i32; 3], |s, c| [0, 1, 2].map(|i| s[i] + i32::from(c[i])));
    Vector3::from(sum.map(|x| f64::from(x) / (2 * centres.len()) as f64))
}

/// Returns a thousand times the torque with a mass in grams.
fn height((empty, per_kilogram): Line, grams: i64) -> i64 {
    empty * 1000 + per_kilogram * grams
}

/// Keeps the lines that are the highest for some mass from 0 to [`MAX_GRAMS`], by rising slope.
fn upper_envelope(mut lines: Vec<Line>) -> Vec<Line> {
    // Of parallel lines the highest comes last and replaces the others.
    lines.sort_unstable_by_key(|(empty, slope)| (*slope, *empty));
    let mut kept: Vec<Line> = Vec::new();
    for line in lines {
        while let Some(last) = kept.last().copied() {
            let parallel = last.1 == line.1;
            let hidden_from_the_start = last.0 <= line.0;
            // `last` is the highest nowhere if `line` overtakes the one before no later than `last` does.
            let hidden = kept.len() >= 2 && {
                let before = kept[kept.len() - 2];
                let overtakes = |l: Line| (i128::from(before.0 - l.0), i128::from(l.1 - before.1));
                let (by_last, by_line) = (overtakes(last), overtakes(line));
                by_line.0 * by_last.1 <= by_last.0 * by_line.1
            };
            if !(parallel || hidden_from_the_start || hidden) {
                break;
            }
            kept.pop();
        }
        let in_time = kept
            .last()
            .is_none_or(|last| height(line, i64::from(MAX_GRAMS)) > height(*last, i64::from(MAX_GRAMS)));
        if in_time {
            kept.push(line);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_core::rng::Rng;

    /// For every mass the envelope is as high as the highest line.
    #[test]
    fn the_envelope_is_the_highest_line() {
        let mut rng = Rng::named(1, "envelope", 0);
        for _ in 0..500 {
            let mut draw = |n: u64| rng.below(2 * n + 1) as i64 - n as i64;
            let lines: Vec<Line> = (0..12).map(|_| (draw(30), draw(9))).collect();
            let kept = upper_envelope(lines.clone());
            for grams in [0, 1, 250, 999, 1000, 1400, 3333, 8000, 20_000] {
                let best = |l: &[Line]| l.iter().map(|l| height(*l, grams)).max();
                assert_eq!(best(&kept), best(&lines), "{grams} of {lines:?}: {kept:?}");
            }
        }
        assert_eq!(upper_envelope(vec![(5, 0), (-5, 0), (0, 1), (0, -1)]), [(5, 0), (0, 1)]);
    }
}
