//! The painter's order of solids: those that are hidden before those that hide them.
//!
//! Of two boxes with axes along those of space, one can hide the other only if it is nearer to the eye along
//! every axis that separates them; of two halves of balls of equal size, if its centre is nearer, and of one
//! ball, if its dome is. A topological order of these relations is a painter's order. Should solids hide each
//! other in a cycle, the farthest centre is drawn first.

use super::camera::{V, View, dot};
use super::solid::Solid;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

/// Length of the edge of the squares of the picture in which solids are compared, in edges of a cell.
const SQUARE: f64 = 2.0;
/// Distance below which solids touch.
const TOUCH: f64 = 1e-6;

/// The bounds of a solid in the picture.
fn extent(solid: &Solid) -> Option<[f64; 4]> {
    let points = solid.facets.iter().flat_map(|f| &f.points);
    points.fold(None, |extent: Option<[f64; 4]>, [x, y]| {
        let [left, bottom, right, top] = extent.unwrap_or([*x, *y, *x, *y]);
        Some([left.min(*x), bottom.min(*y), right.max(*x), top.max(*y)])
    })
}

fn overlap(a: [f64; 4], b: [f64; 4]) -> bool {
    a[0] < b[2] - TOUCH && b[0] < a[2] - TOUCH && a[1] < b[3] - TOUCH && b[1] < a[3] - TOUCH
}

/// Returns true if `a` may hide `b`, false if `b` may hide `a`; `None` if neither can.
fn hides(view: &View, a: &Solid, b: &Solid) -> Option<bool> {
    let nearer = |a: V, b: V| view.nearness(a) > view.nearness(b);
    if let (Some(dome), Some(_)) = (a.dome, b.dome) {
        let apart = (0..3).map(|i| (a.centre[i] - b.centre[i]).abs()).fold(0.0, f64::max);
        return Some(if apart < TOUCH { dot(dome, view.eye) > 0.0 } else { nearer(a.centre, b.centre) });
    }
    let (mut front, mut back) = (false, false);
    for axis in 0..3 {
        let towards = view.eye[axis];
        if a.bounds[0][axis] >= b.bounds[1][axis] - TOUCH {
            (front, back) = (front || towards >= 0.0, back || towards <= 0.0);
        } else if b.bounds[0][axis] >= a.bounds[1][axis] - TOUCH {
            (front, back) = (front || towards <= 0.0, back || towards >= 0.0);
        }
    }
    match (front, back) {
        (true, true) => None,
        (false, false) => Some(nearer(a.centre, b.centre)),
        (front, _) => Some(front),
    }
}

/// A key by which numbers are ordered as they are.
fn ascending(x: f64) -> i64 {
    (x * 1e6).round() as i64
}

/// Returns the numbers of the solids that are seen, from back to front.
pub fn painters_order(view: &View, solids: &[Solid]) -> Vec<usize> {
    let extents: Vec<Option<[f64; 4]>> = solids.iter().map(extent).collect();
    let mut squares: BTreeMap<(i32, i32), Vec<usize>> = BTreeMap::new();
    for (i, extent) in extents.iter().enumerate() {
        let Some(extent) = extent else { continue };
        let [left, bottom, right, top] = extent.map(|x| (x / SQUARE).floor() as i32);
        for square in (left..=right).flat_map(|x| (bottom..=top).map(move |y| (x, y))) {
            squares.entry(square).or_default().push(i);
        }
    }
    // Of each solid those that may hide it, and how many it may itself hide.
    let mut hidden_by: Vec<Vec<usize>> = vec![Vec::new(); solids.len()];
    for members in squares.values() {
        for (n, i) in members.iter().enumerate() {
            for j in &members[..n] {
                let (Some(a), Some(b)) = (extents[*i], extents[*j]) else { continue };
                if overlap(a, b)
                    && let Some(i_in_front) = hides(view, &solids[*i], &solids[*j])
                {
                    let (front, back) = if i_in_front { (*i, *j) } else { (*j, *i) };
                    hidden_by[back].push(front);
                }
            }
        }
    }
    let mut before = vec![0u32; solids.len()];
    for list in &mut hidden_by {
        list.sort_unstable();
        list.dedup();
        list.iter().for_each(|front| before[*front] += 1);
    }
    let seen = (0..solids.len()).filter(|i| extents[*i].is_some()).collect();
    sort(seen, &hidden_by, &mut before, |i| ascending(view.nearness(solids[i].centre)))
}

/// Sorts topologically; the smallest key goes first where there is a choice, and where there is a cycle.
fn sort(
    seen: Vec<usize>,
    after: &[Vec<usize>],
    before: &mut [u32],
    key: impl Fn(usize) -> i64,
) -> Vec<usize> {
    let mut by_key: Vec<usize> = seen;
    by_key.sort_by_key(|i| (key(*i), *i));
    let mut free: BinaryHeap<Reverse<(i64, usize)>> =
        by_key.iter().filter(|i| before[**i] == 0).map(|i| Reverse((key(*i), *i))).collect();
    let mut done = vec![false; before.len()];
    let mut order = Vec::with_capacity(by_key.len());
    let mut rest = by_key.into_iter();
    loop {
        let next = match free.pop() {
            Some(Reverse((_, next))) => next,
            None => match rest.find(|i| !done[*i]) {
                Some(next) => next,
                None => return order,
            },
        };
        if std::mem::replace(&mut done[next], true) {
            continue;
        }
        order.push(next);
        for front in &after[next] {
            before[*front] -= 1;
            if before[*front] == 0 && !done[*front] {
                free.push(Reverse((key(*front), *front)));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::camera::{Camera, P};
    use super::super::solid::{Filled, Owner, of_cell, of_part};
    use super::*;
    use crate::parts::{Part, Shape, Tone};
    use metamorph_core::ids::ModuleId;
    use metamorph_core::lattice::Cell;
    use metamorph_core::rng::Rng;
    use nalgebra::UnitQuaternion;
    use std::collections::BTreeSet;

    /// Returns the distance along the eye to the first cell that a ray through a point of the picture meets.
    fn first_hit(view: &View, at: P, cubes: &[V]) -> Option<usize> {
        let point = [0, 1, 2].map(|i| at[0] * view.right[i] + at[1] * view.up[i]);
        let nearest = |low: V, high: V| {
            let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
            for i in 0..3 {
                if view.eye[i].abs() < 1e-12 {
                    if point[i] < low[i] || point[i] > high[i] {
                        return None;
                    }
                    continue;
                }
                let (a, b) = ((low[i] - point[i]) / view.eye[i], (high[i] - point[i]) / view.eye[i]);
                (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
            }
            (near < far - 1e-9).then_some(far)
        };
        let hit = |(i, c): (usize, &V)| Some((nearest(c.map(|x| x - 0.5), c.map(|x| x + 0.5))?, i));
        cubes.iter().enumerate().filter_map(hit).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, i)| i)
    }

    fn inside(points: &[P], [x, y]: P) -> bool {
        let sides = (0..points.len()).map(|i| {
            let ([ax, ay], [bx, by]) = (points[i], points[(i + 1) % points.len()]);
            (bx - ax) * (y - ay) - (by - ay) * (x - ax)
        });
        let sides: Vec<f64> = sides.collect();
        sides.iter().all(|s| *s > 1e-9) || sides.iter().all(|s| *s < -1e-9)
    }

    /// Random structures with cubes on their way, seen from all sides: the last solid painted at a point is the
    /// first one that a ray from the eye meets.
    #[test]
    fn what_is_painted_last_is_nearest() {
        let cameras = ["iso", "true-iso", "front", "top", "200,-35", "-70,10"];
        let mut compared = 0;
        for seed in 0..40 {
            let mut random = Rng::named(seed, "figure", 0);
            let mut cells = BTreeSet::new();
            for _ in 0..40 {
                let mut at = || random.below(5) as i16;
                cells.insert(Cell::new(at(), at(), at()));
            }
            let moves = random.below(2) == 0;
            let all: Vec<Cell> = cells.iter().copied().collect();
            // Every fourth cube slides towards a free cell.
            let slide = |cell: &Cell| {
                let to =
                    metamorph_core::lattice::Face::ALL.into_iter().find(|f| !cells.contains(&cell.step(*f)));
                to.map(|f| <[i16; 3]>::from(f.offset()).map(|x| f64::from(x) * 0.4)).unwrap_or_default()
            };
            let mut taken = BTreeSet::new();
            let mut parts = Vec::new();
            for (i, cell) in all.iter().enumerate() {
                let shape = Shape::Box { size: [1.0; 3] };
                let mut part = Part::in_cell(shape, *cell, UnitQuaternion::identity(), Tone::Plain);
                let by = slide(cell);
                let target = [
                    part.centre().x + by[0] * 2.5,
                    part.centre().y + by[1] * 2.5,
                    part.centre().z + by[2] * 2.5,
                ];
                if moves && i % 4 == 0 && taken.insert(target.map(|x| (x * 2.0).round() as i32)) {
                    part.pose.translation.vector += nalgebra::Vector3::from(by);
                }
                parts.push(part);
            }
            let drawn = parts.iter().filter_map(super::super::solid::filled_cell).collect();
            let filled = Filled { drawn, cut: BTreeSet::new() };
            let view = cameras[seed as usize % cameras.len()].parse::<Camera>().unwrap().view();
            let of = |(i, part): (usize, &Part)| of_part(&view, ModuleId(i as u32), part, &filled);
            let solids: Vec<Solid> = parts.iter().enumerate().map(of).collect();
            let order = painters_order(&view, &solids);
            let cubes: Vec<V> = parts.iter().map(|p| p.centre().into()).collect();
            for _ in 0..400 {
                let mut at = || random.below(12_000) as f64 / 1000.0 - 6.0 + 0.000_123;
                let at = [at(), at()];
                let painted =
                    order.iter().rev().find(|i| solids[**i].facets.iter().any(|f| inside(&f.points, at)));
                let hit = first_hit(&view, at, &cubes);
                if let (Some(painted), Some(hit)) = (painted, hit) {
                    assert_eq!(*painted, hit, "seed {seed} at {at:?}");
                    compared += 1;
                }
            }
        }
        assert!(compared > 1_000, "{compared}");
    }

    #[test]
    fn halves_of_one_ball_are_ordered_by_their_domes() {
        let view = "iso".parse::<Camera>().unwrap().view();
        let shape = Shape::HalfCube { radius: 0.58, half_edge: 0.5 };
        let half = |rotation| Part::in_cell(shape, Cell::new(0, 0, 0), rotation, Tone::Plain);
        let [up, down] = [
            half(UnitQuaternion::identity()),
            half(UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, std::f64::consts::FRAC_PI_2)),
        ];
        let solids = [up, down].map(|part| of_part(&view, ModuleId(0), &part, &Filled::default()));
        let nearest =
            usize::from(view.nearness(solids[1].dome.unwrap()) > view.nearness(solids[0].dome.unwrap()));
        assert_eq!(painters_order(&view, &solids), [1 - nearest, nearest]);
        let cell =
            of_cell(&view, Owner::Obstacle(Cell::new(1, -1, 0)), Cell::new(1, -1, 0), &Filled::default());
        let [up, down] = solids;
        assert_eq!(painters_order(&view, &[cell, up, down])[2], 0, "the obstacle is in front");
    }
}
