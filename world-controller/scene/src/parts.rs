//! Rigid parts of bodies and their motions: all that a picture of a run needs of a body.
//!
//! Lengths are edges of a cell. The frame is right-handed with z up, and the cell (x, y, z) has its centre
//! at (x, y, z + ½): the lowest cells stand on z = 0.
//!
//! A motion consists of slides and turns about fixed axes; [`Motion::carry`] computes any moment of it. The
//! page computes frames by itself, so it gets the motion and not its frames.

use metamorph_core::lattice::Cell;
use metamorph_core::time::Span;
use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};
use serde::Serialize;
use serde_json::{Value, json};
use std::ops::Range;

/// The shape of a part, about the origin of its own frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Shape {
    /// A box.
    Box {
        /// Lengths of its edges along x, y and z.
        size: [f64; 3],
    },
    /// Half a ball, where x + y + z ≥ 0, with flat plates across +x, +y and +z.
    HalfCube {
        /// Radius of the ball.
        radius: f64,
        /// Distance of the plates from the centre of the ball.
        half_edge: f64,
    },
}

/// The shade of a part, which distinguishes the parts of a body; the hue shows the state of the module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Tone {
    /// The colour as it is.
    Plain = 0,
    /// A little lighter.
    Light = 1,
}

/// A rigid part of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Its shape.
    pub shape: Shape,
    /// The pose of its frame in the world.
    pub pose: Isometry3<f64>,
    /// Its shade.
    pub tone: Tone,
}

impl Part {
    /// Returns a part in the centre of a cell.
    pub fn in_cell(shape: Shape, cell: Cell, rotation: UnitQuaternion<f64>, tone: Tone) -> Part {
        let pose = Isometry3::from_parts(Translation3::from(centre(cell)), rotation);
        Part { shape, pose, tone }
    }
    /// Returns its centre.
    pub fn centre(&self) -> Vector3<f64> {
        self.pose.translation.vector
    }
    /// Returns the cell that its centre is in.
    pub fn cell(&self) -> Cell {
        let [x, y, z]: [f64; 3] = self.centre().into();
        Cell::new(x.round() as i16, y.round() as i16, z.floor() as i16)
    }
}

/// Returns the centre of a cell.
pub fn centre(cell: Cell) -> Vector3<f64> {
    Vector3::new(cell.x.into(), cell.y.into(), f64::from(cell.z) + 0.5)
}

/// A motion of a body's parts.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Its duration.
    pub takes: Span,
    /// Description of the motion, as in "module 3 slides".
    pub name: String,
    /// The segments in order; empty if the body stays as it is, as when a gripper closes.
    pub segments: Vec<Segment>,
}

/// A part of a motion that begins and ends at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Segment {
    /// The share of the motion's time at which it ends: greater than that of the one before, at most 1.
    pub until: f64,
    /// Simultaneous displacements. Each is given as if those after it had not happened, so of a chain of
    /// joints the last one comes first.
    pub steps: Vec<Step>,
}

/// A displacement of some parts.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// The parts, by number.
    pub parts: Range<usize>,
    /// Their displacement.
    pub by: Displacement,
}

/// A displacement in axes of the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Displacement {
    /// Along a straight line.
    Slide([f64; 3]),
    /// About an axis.
    Turn {
        /// Its direction, of any length.
        axis: [f64; 3],
        /// The angle in degrees, by the right-hand rule about the axis.
        degrees: f64,
        /// A point on the axis, relative to the centre of the body's first part before the motion.
        through: [f64; 3],
    },
}

impl Displacement {
    fn share(self, share: f64, origin: Vector3<f64>) -> Isometry3<f64> {
        match self {
            Displacement::Slide(by) => Translation3::from(Vector3::from(by) * share).into(),
            Displacement::Turn { axis, degrees, through } => {
                let axis = Unit::new_normalize(Vector3::from(axis));
                let rotation = UnitQuaternion::from_axis_angle(&axis, degrees.to_radians() * share);
                let point = origin + Vector3::from(through);
                Isometry3::from_parts((point - rotation * point).into(), rotation)
            }
        }
    }
}

impl Motion {
    /// Moves parts from their poses at rest to those after a share of the motion's time.
    pub fn carry(&self, parts: &mut [Part], fraction: f64) {
        let Some(origin) = parts.first().map(Part::centre) else { return };
        let mut begin = 0.0;
        for Segment { until, steps } in &self.segments {
            let x = ((fraction - begin) / (until - begin)).clamp(0.0, 1.0);
            let eased = x * x * (3.0 - 2.0 * x);
            for Step { parts: moved, by } in steps {
                let by = by.share(eased, origin);
                for part in parts.get_mut(moved.clone()).into_iter().flatten() {
                    part.pose = by * part.pose;
                }
            }
            begin = *until;
        }
    }

    /// Returns the form for the page: duration in microseconds, name, and of each segment its end and its
    /// steps: the first part, the one after the last, and a slide, or axis, degrees and point of a turn.
    pub fn to_json(&self) -> Value {
        let step = |Step { parts, by }: &Step| match by {
            Displacement::Slide([x, y, z]) => json!([parts.start, parts.end, x, y, z]),
            Displacement::Turn { axis: [a, b, c], degrees, through: [x, y, z] } => {
                json!([parts.start, parts.end, a, b, c, degrees, x, y, z])
            }
        };
        let segment = |s: &Segment| json!([s.until, s.steps.iter().map(step).collect::<Vec<_>>()]);
        let segments: Vec<Value> = self.segments.iter().map(segment).collect();
        json!([self.takes.0 / 1_000, self.name, segments])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOX: Shape = Shape::Box { size: [1.0; 3] };

    fn row(cells: usize) -> Vec<Part> {
        let cell = |x| Cell::new(x as i16, 2, 0);
        (0..cells).map(|x| Part::in_cell(BOX, cell(x), UnitQuaternion::identity(), Tone::Plain)).collect()
    }

    /// Simultaneous turns of two joints of a chain equal the same turns in sequence.
    #[test]
    fn joints_that_turn_at_once_carry_what_is_behind_them() {
        let turn = |joint: usize, degrees| Step {
            parts: joint..4,
            by: Displacement::Turn {
                axis: [0.0, 0.0, 7.0],
                degrees,
                through: [joint as f64 - 0.5, 0.0, 0.0],
            },
        };
        let segments = vec![Segment { until: 1.0, steps: vec![turn(3, 90.0), turn(1, 180.0)] }];
        let motion = Motion { takes: Span::secs(1), name: String::new(), segments };
        let mut parts = row(4);
        motion.carry(&mut parts, 0.0);
        assert_eq!(parts, row(4));
        motion.carry(&mut parts, 1.0);
        let at = [(0.0, 2.0), (0.0, 2.0), (-1.0, 2.0), (-1.5, 1.5)];
        for (part, (x, y)) in parts.iter().zip(at) {
            let off = (part.centre() - Vector3::new(x, y, 0.5)).norm();
            assert!(off < 1e-12, "{:?}, not {x}, {y}", part.centre());
        }
        let half: f64 = parts[3].pose.rotation.angle().to_degrees();
        assert!((half - 90.0).abs() < 1e-9, "{half}");
    }

    #[test]
    fn segments_come_one_after_the_other_and_begin_and_end_at_rest() {
        let slide =
            |until, by| Segment { until, steps: vec![Step { parts: 0..1, by: Displacement::Slide(by) }] };
        let segments = vec![slide(0.5, [1.0, 0.0, 0.0]), slide(1.0, [0.0, 0.0, 1.0])];
        let motion = Motion { takes: Span::secs(1), name: String::new(), segments };
        let at = |fraction| {
            let mut parts = row(1);
            motion.carry(&mut parts, fraction);
            let c = parts[0].centre();
            [c.x, c.z - 0.5]
        };
        let expected = [(0.0, [0.0, 0.0]), (0.25, [0.5, 0.0]), (0.5, [1.0, 0.0]), (0.75, [1.0, 0.5])];
        for (fraction, place) in expected.into_iter().chain([(1.0, [1.0, 1.0]), (2.0, [1.0, 1.0])]) {
            assert_eq!(at(fraction), place, "at {fraction}");
        }
        assert!(at(0.01)[0] < 0.002 && at(0.49)[0] > 0.998);
    }
}
