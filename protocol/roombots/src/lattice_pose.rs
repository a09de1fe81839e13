//! Poses of the lattice in integers: the 24 rotations of the cube and positions in half cells.
//!
//! +120° about (1,1,1) is the cyclic permutation x→y→z→x and 90° about z a signed permutation, so a
//! robot whose joints are at lattice angles never needs a floating-point number.

use metamorph_core::lattice::{Cell, Face};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use std::ops::Mul;

/// An integer vector, in half cells when it is a position.
pub type Half = [i16; 3];

/// A rotation of the cube: a signed permutation matrix of determinant 1, by rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct LatticeRotation([[i8; 3]; 3]);

impl LatticeRotation {
    /// No rotation.
    pub const IDENTITY: LatticeRotation = LatticeRotation([[1, 0, 0], [0, 1, 0], [0, 0, 1]]);
    /// +120° about (1,1,1).
    pub const DIAGONAL: LatticeRotation = LatticeRotation([[0, 0, 1], [1, 0, 0], [0, 1, 0]]);
    /// +90° about z.
    pub const QUARTER: LatticeRotation = LatticeRotation([[0, -1, 0], [1, 0, 0], [0, 0, 1]]);
    /// The foot frame seen from the other end: x' = −y, y' = −x, z' = −z.
    pub const FLIP: LatticeRotation = LatticeRotation([[0, -1, 0], [-1, 0, 0], [0, 0, -1]]);

    /// Returns the rotation with these rows, if it is one.
    pub fn from_rows(rows: [[i8; 3]; 3]) -> Option<LatticeRotation> {
        let unit = |v: [i8; 3]| v.iter().map(|x| i32::from(*x).pow(2)).sum::<i32>() == 1;
        let columns = [0, 1, 2].map(|c| [rows[0][c], rows[1][c], rows[2][c]]);
        let r = LatticeRotation(rows);
        (rows.into_iter().all(unit) && columns.into_iter().all(unit) && r.determinant() == 1).then_some(r)
    }
    /// Iterates over the 24 rotations of the cube, in order.
    pub fn all() -> impl Iterator<Item = LatticeRotation> {
        let signed = |i: i8| [0, 1, 2].map(|k| if k == i / 2 { 1 - 2 * (i % 2) } else { 0 });
        (0..216).filter_map(move |n: i16| {
            LatticeRotation::from_rows([n / 36, n / 6 % 6, n % 6].map(|i| signed(i as i8)))
        })
    }
    /// Returns the rows of the matrix.
    pub const fn rows(self) -> [[i8; 3]; 3] {
        self.0
    }
    fn determinant(self) -> i32 {
        let m = self.0.map(|r| r.map(i32::from));
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    }
    /// Returns the inverse rotation.
    pub fn inverse(self) -> LatticeRotation {
        let m = self.0;
        LatticeRotation([0, 1, 2].map(|r| [0, 1, 2].map(|c| m[c][r])))
    }
    /// Returns this rotation applied `n` times.
    pub fn power(self, n: u8) -> LatticeRotation {
        (0..n).fold(LatticeRotation::IDENTITY, |r, _| r * self)
    }
    /// Returns the image of a vector.
    pub fn apply(self, v: Half) -> Half {
        self.0.map(|r| i16::from(r[0]) * v[0] + i16::from(r[1]) * v[1] + i16::from(r[2]) * v[2])
    }
    /// Returns the face that the side `f` looks at after this rotation.
    pub fn face(self, f: Face) -> Face {
        let o: [i16; 3] = f.offset().into();
        let image = Cell::from(self.apply(o));
        Cell::default().face_to(image).expect("a rotation of the cube maps faces to faces")
    }
    /// Returns the direction of z after this rotation.
    pub fn up(self) -> Face {
        self.face(Face::Up)
    }
    /// Returns the class 0..3 of a rotation about +z, if it is one.
    pub fn class(self) -> Option<u8> {
        (0..4).find(|c| LatticeRotation::QUARTER.power(*c) == self)
    }
    /// Returns the same rotation as an exact matrix of floating-point numbers.
    pub fn matrix(self) -> Matrix3<f64> {
        Matrix3::from_fn(|r, c| f64::from(self.0[r][c]))
    }
    /// Returns the rotation nearest to a matrix, if every entry is within `tolerance` of it.
    pub fn nearest(m: &Matrix3<f64>, tolerance: f64) -> Option<LatticeRotation> {
        let near = m.iter().all(|x| (x - x.round()).abs() <= tolerance && x.abs() < 1.5);
        if !near {
            return None;
        }
        LatticeRotation::from_rows([0, 1, 2].map(|r| [0, 1, 2].map(|c| m[(r, c)].round() as i8)))
    }
}

impl Mul for LatticeRotation {
    type Output = LatticeRotation;
    fn mul(self, o: LatticeRotation) -> LatticeRotation {
        LatticeRotation(
            [0, 1, 2].map(|r| [0, 1, 2].map(|c| (0..3).map(|k| self.0[r][k] * o.0[k][c]).sum::<i8>())),
        )
    }
}

/// A pose of the lattice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct LatticePose {
    /// The rotation of the frame.
    pub rotation: LatticeRotation,
    /// The position of its origin, in half cells.
    pub half: Half,
}

impl LatticePose {
    /// The foot frame itself.
    pub const IDENTITY: LatticePose = LatticePose { rotation: LatticeRotation::IDENTITY, half: [0; 3] };

    /// Returns the position in cells.
    pub fn origin(self) -> Vector3<f64> {
        Vector3::from(self.half.map(|h| f64::from(h) / 2.0))
    }
    /// Returns the pose in the outer frame of `inner`, which is given in this frame.
    pub fn compose(self, inner: LatticePose) -> LatticePose {
        let moved = self.rotation.apply(inner.half);
        LatticePose {
            rotation: self.rotation * inner.rotation,
            half: [0, 1, 2].map(|i| self.half[i] + moved[i]),
        }
    }
    /// Returns the inverse pose.
    pub fn inverse(self) -> LatticePose {
        let rotation = self.rotation.inverse();
        LatticePose { rotation, half: rotation.apply(self.half).map(|x| -x) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_generators_make_the_24_rotations_of_the_cube() {
        let mut all = std::collections::BTreeSet::from([LatticeRotation::IDENTITY]);
        loop {
            let more: Vec<_> = all
                .iter()
                .flat_map(|r| [*r * LatticeRotation::DIAGONAL, *r * LatticeRotation::QUARTER])
                .collect();
            let before = all.len();
            all.extend(more);
            if all.len() == before {
                break;
            }
        }
        assert_eq!(all.len(), 24);
        assert_eq!(LatticeRotation::all().collect::<std::collections::BTreeSet<_>>(), all);
        for r in &all {
            assert_eq!(*r * r.inverse(), LatticeRotation::IDENTITY);
            assert_eq!(LatticeRotation::from_rows(r.rows()), Some(*r));
            assert_eq!(LatticeRotation::nearest(&r.matrix(), 1e-9), Some(*r));
        }
        assert!(all.contains(&LatticeRotation::FLIP));
        assert_eq!(LatticeRotation::DIAGONAL.power(3), LatticeRotation::IDENTITY);
        assert_eq!(LatticeRotation::DIAGONAL.up(), Face::East);
        assert_eq!(LatticeRotation::from_rows([[1, 0, 0], [0, 1, 0], [0, 0, -1]]), None);
    }
}
