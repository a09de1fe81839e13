//! The lattice kinematics of one module as tables: rotations by number, connectors by face, postures.
//!
//! Everything is computed once from [`roombots`](metamorph_roombots), which has the geometry.

use metamorph_core::lattice::{Cell, Face};
use metamorph_roombots::Kind;
use metamorph_roombots::connector::Connector;
use metamorph_roombots::lattice_pose::LatticeRotation;
use metamorph_roombots::posture::Posture;
use std::collections::BTreeSet;
use std::sync::LazyLock;

/// Number of rotations of the cube.
pub const ROTATIONS: usize = 24;
/// Number of postures of a module.
pub const POSTURES: usize = 36;

/// A rotation of the cube by its number; 0 is the identity.
pub type Rot = u8;
/// A posture by its code, see [`Posture::code`].
pub type Code = u8;
/// A vector in cells.
pub type Vec3 = [i8; 3];

/// The offset of coordinates in packed cells.
pub const OFFSET: i8 = 64;
/// The origin as a packed cell.
const ORIGIN_CODE: i32 = (OFFSET as i32) << 14 | (OFFSET as i32) << 7 | OFFSET as i32;

/// The number that stands for no connector.
pub const NONE: u8 = u8::MAX;

/// The tables.
pub struct Tables {
    /// The rotations.
    pub rotations: [LatticeRotation; ROTATIONS],
    /// The change of a packed cell by a step along each axis, after each rotation.
    weights: [[i32; 3]; ROTATIONS],
    /// Products.
    pub product: [[Rot; ROTATIONS]; ROTATIONS],
    /// Inverse rotations.
    pub inverse: [Rot; ROTATIONS],
    /// The direction of each face after a rotation.
    pub face: [[u8; 6]; ROTATIONS],
    /// A set of faces (bits) after a rotation.
    pub faces: [[u8; 64]; ROTATIONS],
    /// The frames of the four hemispheres of a posture, in the foot frame.
    pub hemisphere: [[Rot; 4]; POSTURES],
    /// The direction from the first to the second cube, in the foot frame.
    pub direction: [u8; POSTURES],
    /// The frame of each connector in the foot frame: +z into the module.
    pub connector: [[Rot; 10]; POSTURES],
    /// The outward normal of each connector, by the rotation of the module.
    pub normal: [[[u8; 10]; POSTURES]; ROTATIONS],
    /// The connector at each face of each cube, by the rotation of the module; [`NONE`] between the cubes.
    pub at_face: [[[[u8; 6]; 2]; POSTURES]; ROTATIONS],
    /// The head frame of a posture, in the foot frame.
    pub head: [Rot; POSTURES],
    /// The posture seen from the other end.
    pub reversed: [Code; POSTURES],
    /// A set of connectors (bits) seen from the other end.
    pub reversed_held: [u16; 1024],
    /// The posture after a step of a joint, by −1 and by +1.
    pub turned: [[[Code; 2]; 3]; POSTURES],
    /// The rotation of a step of a joint about its axis, in the foot frame, by −1 and by +1.
    pub turn: [[[Rot; 2]; 3]; POSTURES],
    /// Number of +120° about the diagonal.
    pub diagonal: Rot,
    /// Number of +90° about z.
    pub quarter: Rot,
    /// Number of the rotation from the foot frame to that of the other end.
    pub flip: Rot,
}

/// The tables, computed when first used.
pub static TABLES: LazyLock<Box<Tables>> = LazyLock::new(Tables::compute);

/// Returns the hemisphere of a connector by its number.
pub const fn hemisphere(connector: u8) -> usize {
    Connector::ALL[connector as usize].hemisphere()
}

impl Tables {
    fn compute() -> Box<Tables> {
        let rotations = all_rotations();
        let number = |r: LatticeRotation| -> Rot {
            rotations.iter().position(|x| *x == r).expect("the rotations are a group") as Rot
        };
        let mut t = Box::new(Tables {
            rotations,
            weights: rotations.map(|r| {
                let rows = r.rows();
                [0, 1, 2].map(|axis| rows.iter().fold(0, |sum, row| (sum << 7) + i32::from(row[axis])))
            }),
            product: [[0; ROTATIONS]; ROTATIONS],
            inverse: rotations.map(|r| number(r.inverse())),
            face: rotations.map(|r| Face::ALL.map(|f| r.face(f) as u8)),
            faces: [[0; 64]; ROTATIONS],
            hemisphere: [[0; 4]; POSTURES],
            direction: [0; POSTURES],
            connector: [[0; 10]; POSTURES],
            normal: [[[0; 10]; POSTURES]; ROTATIONS],
            at_face: [[[[NONE; 6]; 2]; POSTURES]; ROTATIONS],
            head: [0; POSTURES],
            reversed: [0; POSTURES],
            reversed_held: [0; 1024],
            turned: [[[0; 2]; 3]; POSTURES],
            turn: [[[0; 2]; 3]; POSTURES],
            diagonal: number(LatticeRotation::DIAGONAL),
            quarter: number(LatticeRotation::QUARTER),
            flip: number(LatticeRotation::FLIP),
        });
        for a in 0..ROTATIONS {
            for b in 0..ROTATIONS {
                t.product[a][b] = number(rotations[a] * rotations[b]);
            }
            for set in 0..64_u8 {
                let image = (0..6).filter(|f| set & 1 << f != 0).map(|f| 1 << t.face[a][f]);
                t.faces[a][usize::from(set)] = image.sum();
            }
        }
        for set in 0..1024_u16 {
            let image = Connector::ALL.into_iter().filter(|c| set & 1 << *c as u16 != 0);
            t.reversed_held[usize::from(set)] = image.map(|c| 1 << c.reversed() as u16).sum();
        }
        for posture in Posture::all(Kind::Single) {
            t.add_posture(posture);
        }
        t
    }

    fn add_posture(&mut self, posture: Posture) {
        let p = usize::from(posture.code());
        let placement = posture.placement();
        let frames: [LatticeRotation; 4] = [0, 1, 2, 3].map(|h| placement.rotations[h]);
        let number = |r: LatticeRotation| {
            self.rotations.iter().position(|x| *x == r).expect("the rotations are a group")
        };
        self.hemisphere[p] = frames.map(|r| number(r) as Rot);
        self.direction[p] = frames[1].up() as u8;
        self.head[p] = number(placement.head.rotation) as Rot;
        self.reversed[p] = posture.reversed().code() as Code;
        for connector in Connector::ALL {
            let frame = frames[connector.hemisphere()] * connector.frame();
            self.connector[p][connector as usize] = number(frame) as Rot;
            for r in 0..ROTATIONS {
                let normal = (self.rotations[r] * frame).face(Face::Down) as u8;
                self.normal[r][p][connector as usize] = normal;
                let cube = connector.hemisphere() / 2;
                self.at_face[r][p][cube][usize::from(normal)] = connector as u8;
            }
        }
        let one = [LatticeRotation::DIAGONAL, LatticeRotation::QUARTER, LatticeRotation::DIAGONAL];
        for joint in 0..3 {
            let forward = posture.turned(joint);
            let steps = if joint == 1 { 4 } else { 3 };
            let back = (0..steps - 1).fold(posture, |p, _| p.turned(joint));
            self.turned[p][joint] = [back.code() as Code, forward.code() as Code];
            let frame = frames[joint];
            self.turn[p][joint] =
                [one[joint].inverse(), one[joint]].map(|r| number(frame * r * frame.inverse()) as Rot);
        }
    }

    /// Returns a rotated vector.
    pub fn rotate(&self, rotation: Rot, v: Vec3) -> Vec3 {
        let rows = self.rotations[usize::from(rotation)].rows();
        rows.map(|r| r[0] * v[0] + r[1] * v[1] + r[2] * v[2])
    }
    /// Returns a rotated cell in 21 bits, in the order of the coordinates. Packing and rotating are both linear, so one sum
    /// does both.
    pub fn packed(&self, rotation: Rot, v: Vec3) -> u64 {
        let weights = &self.weights[usize::from(rotation)];
        let [x, y, z] = v.map(i32::from);
        (ORIGIN_CODE + x * weights[0] + y * weights[1] + z * weights[2]) as u64
    }
    /// Returns the product of two rotations.
    pub fn times(&self, a: Rot, b: Rot) -> Rot {
        self.product[usize::from(a)][usize::from(b)]
    }
}

fn all_rotations() -> [LatticeRotation; ROTATIONS] {
    let mut all = BTreeSet::from([LatticeRotation::IDENTITY]);
    while all.len() < ROTATIONS {
        let more: Vec<_> = all
            .iter()
            .flat_map(|r| [*r * LatticeRotation::DIAGONAL, *r * LatticeRotation::QUARTER])
            .collect();
        all.extend(more);
    }
    let rest = all.into_iter().filter(|r| *r != LatticeRotation::IDENTITY);
    let list: Vec<_> = std::iter::once(LatticeRotation::IDENTITY).chain(rest).collect();
    list.try_into().expect("the generators make 24 rotations")
}

/// The unit steps of the faces, by their numbers.
pub const STEP: [Vec3; 6] = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];

/// Returns the sum of two vectors.
pub fn add(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}
/// Returns the difference of two vectors.
pub fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}
/// Returns the face that looks from `a` to `b`, if the two are neighbours.
pub fn face_to(a: Vec3, b: Vec3) -> Option<u8> {
    match sub(b, a) {
        [1, 0, 0] => Some(0),
        [-1, 0, 0] => Some(1),
        [0, 1, 0] => Some(2),
        [0, -1, 0] => Some(3),
        [0, 0, 1] => Some(4),
        [0, 0, -1] => Some(5),
        _ => None,
    }
}
/// Converts a vector to a [`Cell`].
pub fn cell(v: Vec3) -> Cell {
    Cell::new(v[0].into(), v[1].into(), v[2].into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seen from its other end, a module has the same connectors at the same faces, and turns the same way.
    #[test]
    fn tables_of_both_ends_agree() {
        let t = &**TABLES;
        for r in 0..ROTATIONS {
            for p in 0..POSTURES {
                let (other, q) = (t.product[r][usize::from(t.head[p])], usize::from(t.reversed[p]));
                assert_eq!(t.product[usize::from(other)][usize::from(t.head[q])], r as u8);
                for connector in Connector::ALL {
                    let image = connector.reversed() as usize;
                    assert_eq!(t.normal[r][p][connector as usize], t.normal[usize::from(other)][q][image]);
                }
                for cube in 0..2 {
                    let used = t.at_face[r][p][cube].iter().filter(|c| **c != NONE).count();
                    assert_eq!(used, 5, "each cube has five connectors");
                }
            }
        }
    }

    #[test]
    fn the_hemisphere_behind_a_joint_turns_by_its_step() {
        let t = &**TABLES;
        for p in 0..POSTURES {
            for joint in 0..3 {
                for way in 0..2 {
                    let to = usize::from(t.turned[p][joint][way]);
                    for h in 0..4 {
                        let before = t.hemisphere[p][h];
                        let turned = t.times(t.turn[p][joint][way], before);
                        let expected = if h > joint { turned } else { before };
                        assert_eq!(t.hemisphere[to][h], expected, "joint {joint}, hemisphere {h}");
                    }
                }
            }
        }
    }
}
