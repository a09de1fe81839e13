//! Postures of the lattice: every joint at a multiple of 120° or 90°, computed in integers.

use super::lattice_pose::{LatticePose, LatticeRotation};
use super::{Kind, KinematicsError};
use metamorph_core::lattice::{Cell, Face};

/// The largest number of joints of a robot.
pub const MAX_JOINTS: usize = 6;

/// Returns true if joint `joint` (from 0) is a middle joint, which turns by 90° about the long axis; the
/// others turn by 120° about a diagonal.
pub const fn is_middle(joint: usize) -> bool {
    joint % 3 == 1
}

/// Returns the number of lattice values of joint `joint` (from 0).
pub const fn values(joint: usize) -> u8 {
    if is_middle(joint) { 4 } else { 3 }
}

/// A lattice posture of a robot.
///
/// Joint values count steps of +120° or +90° from zero: 0, 1, 2 and 0, 1, 2, 3. Ordering is that of
/// the joint values from the foot on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Posture {
    kind: Kind,
    steps: [u8; MAX_JOINTS],
}

/// The cells and frames of a lattice posture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Placement {
    /// The cells of the cubes from the foot on; a single module repeats its last one.
    pub cells: [Cell; 4],
    /// The directions between the cubes and, last, the outward normal of the head plate.
    pub directions: [Face; 4],
    /// `rotations[i]` is the frame before joint i, the last one that of the head hemisphere.
    pub rotations: [LatticeRotation; MAX_JOINTS + 1],
    /// The head frame: origin in the head plate, +z into the robot.
    pub head: LatticePose,
}

impl Posture {
    /// Returns the posture with all joints at zero.
    pub const fn zero(kind: Kind) -> Posture {
        Posture { kind, steps: [0; MAX_JOINTS] }
    }

    /// Creates the posture with these numbers of steps, taken modulo a full turn.
    pub fn from_steps(kind: Kind, steps: &[u8]) -> Result<Posture, KinematicsError> {
        if steps.len() != kind.joints() {
            return Err(KinematicsError::JointCount { kind, got: steps.len() });
        }
        let mut all = [0; MAX_JOINTS];
        for (joint, (to, from)) in all.iter_mut().zip(steps).enumerate() {
            *to = from % values(joint);
        }
        Ok(Posture { kind, steps: all })
    }

    /// Creates the posture with these angles in degrees, which must be lattice angles to within `tolerance`.
    pub fn from_degrees(kind: Kind, degrees: &[f64], tolerance: f64) -> Result<Posture, KinematicsError> {
        if degrees.len() != kind.joints() {
            return Err(KinematicsError::JointCount { kind, got: degrees.len() });
        }
        let mut steps = [0; MAX_JOINTS];
        for (i, value) in degrees.iter().copied().enumerate() {
            if !value.is_finite() {
                return Err(KinematicsError::NotFinite { joint: i + 1, value });
            }
            let one = if is_middle(i) { 90.0 } else { 120.0 };
            let count = (value / one).round();
            if (value - count * one).abs() > tolerance {
                return Err(KinematicsError::OffLattice { joint: i + 1, degrees: value });
            }
            steps[i] = count.rem_euclid(f64::from(values(i))) as u8;
        }
        Ok(Posture { kind, steps })
    }

    /// Iterates over the postures of a kind in order: 36 for a module, 1296 for a metamodule.
    pub fn all(kind: Kind) -> impl Iterator<Item = Posture> {
        (0..Posture::count(kind)).map(move |code| Posture::from_code(kind, code))
    }
    /// Returns the number of postures of a kind.
    pub const fn count(kind: Kind) -> u16 {
        if kind.modules() == 1 { 36 } else { 1296 }
    }
    /// Returns the posture with a number below [`Posture::count`], taken modulo that count.
    pub fn from_code(kind: Kind, code: u16) -> Posture {
        let mut rest = code;
        let mut steps = [0; MAX_JOINTS];
        for joint in (0..kind.joints()).rev() {
            let n = u16::from(values(joint));
            steps[joint] = (rest % n) as u8;
            rest /= n;
        }
        Posture { kind, steps }
    }
    /// Returns the number of this posture.
    pub fn code(self) -> u16 {
        (0..self.kind.joints()).fold(0, |code, j| code * u16::from(values(j)) + u16::from(self.steps[j]))
    }

    /// Returns the kind of robot.
    pub const fn kind(self) -> Kind {
        self.kind
    }
    /// Returns the joint values in steps.
    pub fn steps(&self) -> &[u8] {
        &self.steps[..self.kind.joints()]
    }
    /// Returns the joint values in degrees: 0, ±120 and 0, ±90, 180.
    pub fn degrees(self) -> Vec<i16> {
        self.steps()
            .iter()
            .enumerate()
            .map(|(joint, s)| if is_middle(joint) { [0, 90, 180, -90] } else { [0, 120, -120, 0] }[usize::from(*s)])
            .collect()
    }
    /// Returns the joint values in radians.
    pub fn radians(self) -> Vec<f64> {
        self.degrees().into_iter().map(|d| f64::from(d).to_radians()).collect()
    }
    /// Returns the posture after joint `joint` (from 0) has turned by one step of +120° or +90°.
    pub fn turned(mut self, joint: usize) -> Posture {
        self.steps[joint] = (self.steps[joint] + 1) % values(joint);
        self
    }
    /// Returns the same robot seen from its other end.
    pub fn reversed(mut self) -> Posture {
        let joints = self.kind.joints();
        self.steps[..joints].reverse();
        self
    }
    /// Returns the mirror image x↔y: every angle negated, SRS becomes SRZ and the other way round.
    pub fn mirrored(mut self) -> Posture {
        for (joint, s) in self.steps.iter_mut().enumerate() {
            *s = (values(joint) - *s) % values(joint);
        }
        Posture { kind: self.kind.mirrored(), steps: self.steps }
    }

    /// Computes the cells of the cubes and the frames, in integers.
    pub fn placement(self) -> Placement {
        let mut rotation = LatticeRotation::IDENTITY;
        let mut rotations = [rotation; MAX_JOINTS + 1];
        let mut cell = Cell::default();
        let mut cells = [cell; 4];
        let mut directions = [Face::Up; 4];
        let joints = self.kind.joints();
        let mut cube = 0;
        for (joint, before) in rotations.iter_mut().enumerate().take(joints) {
            if joint == 3 {
                rotation = rotation * LatticeRotation::QUARTER.power(self.kind.quarter_turns());
            }
            *before = rotation;
            let one = if is_middle(joint) { LatticeRotation::QUARTER } else { LatticeRotation::DIAGONAL };
            rotation = rotation * one.power(self.steps[joint]);
            // Behind an outer joint the chain leaves its cube: to the next cube or out of the head.
            if !is_middle(joint) {
                directions[cube] = rotation.up();
                if joint + 1 < joints {
                    cube += 1;
                    cell = cell.step(rotation.up());
                    cells[cube] = cell;
                }
            }
        }
        for i in cube + 1..4 {
            cells[i] = cell;
            directions[i] = rotation.up();
        }
        for r in &mut rotations[joints..] {
            *r = rotation;
        }
        let out = rotation.up().offset();
        let head = LatticePose {
            rotation: rotation * LatticeRotation::FLIP,
            half: [2 * cell.x + out.x, 2 * cell.y + out.y, 2 * cell.z + 1 + out.z],
        };
        Placement { cells, directions, rotations, head }
    }
}

impl Placement {
    /// Returns true if every cube is at or above the floor.
    pub fn above_floor(&self) -> bool {
        self.cells.iter().all(|c| c.z >= 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_and_angles_go_there_and_back() {
        for kind in Kind::ALL {
            for (i, p) in Posture::all(kind).enumerate() {
                assert_eq!(usize::from(p.code()), i);
                assert_eq!(Posture::from_steps(kind, p.steps()), Ok(p));
                let degrees: Vec<f64> = p.degrees().into_iter().map(f64::from).collect();
                assert_eq!(Posture::from_degrees(kind, &degrees, 1e-9), Ok(p));
                assert_eq!(p.reversed().reversed(), p);
                assert_eq!(p.mirrored().mirrored(), p);
            }
        }
    }

    #[test]
    fn bad_angles_are_named() {
        let wrong = Posture::from_degrees(Kind::Single, &[0.0, 45.0, 0.0], 1e-9).unwrap_err();
        assert!(wrong.to_string().contains("joint 2 at 45°"), "{wrong}");
        let wrong = Posture::from_degrees(Kind::Par, &[0.0; 3], 1e-9).unwrap_err();
        assert_eq!(wrong.to_string(), "PAR has 6 joints, but 3 angles were given");
        let wrong = Posture::from_degrees(Kind::Single, &[f64::NAN, 0.0, 0.0], 1e-9).unwrap_err();
        assert!(wrong.to_string().contains("joint 1"), "{wrong}");
    }
}
