//! Whether an element rests: the vertical through its centre of mass meets the convex hull of what supports it.

use metamorph_core::lattice::Cell;

/// Returns true if an element in these cells rests on the floor, of which `is_floor` accepts the cells above it.
pub fn rests(cells: &[Cell], is_floor: impl Fn(Cell) -> bool) -> bool {
    let corners = |c: &Cell| {
        let (x, y) = (2 * i64::from(c.x), 2 * i64::from(c.y));
        [(x - 1, y - 1), (x + 1, y - 1), (x - 1, y + 1), (x + 1, y + 1)]
    };
    let bottom = cells.iter().filter(|c| c.z == 0 && is_floor(**c));
    // All lengths times the number of cells, so that the centre is whole.
    let n = cells.len() as i64;
    let hull: Vec<(i64, i64)> = bottom.flat_map(corners).map(|(x, y)| (x * n, y * n)).collect();
    let sum = cells.iter().fold((0, 0), |(x, y), c| (x + 2 * i64::from(c.x), y + 2 * i64::from(c.y)));
    let left = |a: (i64, i64), b: (i64, i64), p: (i64, i64)| {
        (b.0 - a.0) * (p.1 - a.1) - (b.1 - a.1) * (p.0 - a.0) >= 0
    };
    let is_side = |a, b| a != b && hull.iter().all(|p| left(a, b, *p));
    let pairs = || hull.iter().flat_map(|a| hull.iter().map(move |b| (*a, *b)));
    !hull.is_empty() && pairs().filter(|(a, b)| is_side(*a, *b)).all(|(a, b)| left(a, b, sum))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_rest_below_their_centre_of_mass() {
        let floor = |c: Cell| (0..=9).contains(&c.x) && (0..=9).contains(&c.y);
        let cells = |all: &[[i16; 3]]| all.iter().copied().map(Cell::from).collect::<Vec<_>>();
        assert!(rests(&cells(&[[1, 1, 0]]), floor));
        assert!(!rests(&cells(&[[1, 1, 1]]), floor), "in the air");
        assert!(!rests(&cells(&[[-1, 1, 0]]), floor), "beside the floor");
        // An arm of two cells is held by its base, one of four is not.
        assert!(rests(&cells(&[[1, 1, 0], [1, 1, 1], [2, 1, 1]]), floor));
        assert!(!rests(&cells(&[[1, 1, 0], [1, 1, 1], [2, 1, 1], [3, 1, 1], [4, 1, 1]]), floor));
    }
}
