//! The places that a square of connectors can reach from the doors.

use super::model::{Piece, Room};
use std::collections::VecDeque;

/// The connectors that a square covers on all its ways from the doors.
pub struct Free {
    size: (i16, i16),
    covered: Vec<bool>,
}

impl Free {
    /// Spreads a square of `width` by `width` connectors from all doors.
    pub fn from_doors(room: &Room, width: u16) -> Free {
        let size = room.size;
        let wide = i32::from(width).max(1);
        let (w, d) = (i32::from(size.0), i32::from(size.1));
        let index = |x: i32, y: i32| (y * w + x) as usize;
        let mut filled = vec![0u32; (w * d) as usize];
        let pieces = room.pieces.iter().flat_map(Piece::columns);
        for (x, y) in pieces.chain(room.kept_out()).filter(|at| room.has(*at)) {
            filled[index(x.into(), y.into())] = 1;
        }
        // The number of filled connectors in every rectangle from the origin.
        let mut sums = vec![0u32; ((w + 1) * (d + 1)) as usize];
        let at = |x: i32, y: i32| (y * (w + 1) + x) as usize;
        for y in 0..d {
            for x in 0..w {
                sums[at(x + 1, y + 1)] =
                    filled[index(x, y)] + sums[at(x, y + 1)] + sums[at(x + 1, y)] - sums[at(x, y)];
            }
        }
        let fits = |x: i32, y: i32| {
            (0..=w - wide).contains(&x)
                && (0..=d - wide).contains(&y)
                && sums[at(x + wide, y + wide)] + sums[at(x, y)]
                    == sums[at(x, y + wide)] + sums[at(x + wide, y)]
        };
        let mut reached = vec![false; filled.len()];
        let mut front = VecDeque::new();
        let doors = room.doors.iter().flat_map(|(x, y)| {
            let (x, y) = (i32::from(*x), i32::from(*y));
            (0..wide).flat_map(move |i| (0..wide).map(move |j| (x - i, y - j)))
        });
        for (x, y) in doors.filter(|(x, y)| fits(*x, *y)) {
            if !std::mem::replace(&mut reached[index(x, y)], true) {
                front.push_back((x, y));
            }
        }
        while let Some((x, y)) = front.pop_front() {
            for (x, y) in [(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)] {
                if fits(x, y) && !std::mem::replace(&mut reached[index(x, y)], true) {
                    front.push_back((x, y));
                }
            }
        }
        let mut covered = vec![false; filled.len()];
        for (x, y) in (0..d).flat_map(|y| (0..w).map(move |x| (x, y))).filter(|(x, y)| reached[index(*x, *y)])
        {
            for (i, j) in (0..wide).flat_map(|i| (0..wide).map(move |j| (i, j))) {
                covered[index(x + i, y + j)] = true;
            }
        }
        Free { size, covered }
    }

    /// Whether a connector beside a piece is covered.
    pub fn touches(&self, piece: &Piece) -> bool {
        let covered = |x: i16, y: i16| {
            (0..self.size.0).contains(&x)
                && (0..self.size.1).contains(&y)
                && self.covered[usize::from(y.unsigned_abs()) * usize::from(self.size.0.unsigned_abs())
                    + usize::from(x.unsigned_abs())]
        };
        piece
            .columns()
            .any(|(x, y)| covered(x + 1, y) || covered(x - 1, y) || covered(x, y + 1) || covered(x, y - 1))
    }
}
