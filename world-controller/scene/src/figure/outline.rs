//! The outline of cells in the picture: the edges with a point outside on one side.

use super::camera::{P, V, View};
use crate::parts::centre;
use metamorph_core::lattice::{Cell, Face};
use std::collections::{BTreeMap, BTreeSet};

/// Distance from an edge at which its sides are tested, in edges of a cell.
const ASIDE: f64 = 1e-4;

/// A cell's outline, as half planes: every point with all values at most 0 is inside.
struct Silhouette {
    middle: P,
    /// Normal and distance from the middle of each side.
    sides: Vec<(P, f64)>,
}

/// The six faces of a cell in one camera are the same, moved.
fn silhouette(view: &View) -> Vec<(P, f64)> {
    let edges = [0, 1, 2].map(|axis| view.project(unit(axis)));
    let mut sides = Vec::new();
    for [x, y] in edges {
        let length = x.hypot(y);
        if length < 1e-6 {
            continue;
        }
        let normal = [-y / length, x / length];
        let reach: f64 = edges.iter().map(|e| (e[0] * normal[0] + e[1] * normal[1]).abs() / 2.0).sum();
        sides.push((normal, reach));
        sides.push((normal.map(|n| -n), reach));
    }
    sides
}

fn unit(axis: usize) -> V {
    let mut unit = [0.0; 3];
    unit[axis] = 1.0;
    unit
}

impl Silhouette {
    fn contains(&self, [x, y]: P) -> bool {
        let inside =
            |(n, reach): &(P, f64)| (x - self.middle[0]) * n[0] + (y - self.middle[1]) * n[1] <= *reach;
        self.sides.iter().all(inside)
    }
    /// Adds where a segment enters and leaves.
    fn crossings(&self, a: P, b: P, crossings: &mut Vec<f64>) {
        for (n, reach) in &self.sides {
            let at = |p: P| (p[0] - self.middle[0]) * n[0] + (p[1] - self.middle[1]) * n[1] - reach;
            let (from, to) = (at(a), at(b));
            let t = from / (from - to);
            if t.is_finite() && t > 1e-9 && t < 1.0 - 1e-9 {
                crossings.push(t);
            }
        }
    }
}

/// Returns the edges between a face that the eye sees and one that it does not.
fn candidates(view: &View, cells: &BTreeSet<Cell>) -> BTreeMap<[i32; 4], [P; 2]> {
    let mut edges = BTreeMap::new();
    for cell in cells {
        for face in Face::ALL {
            let normal = <[i16; 3]>::from(face.offset()).map(f64::from);
            if cells.contains(&cell.step(face)) || !view.faces(normal) {
                continue;
            }
            let middle: V = centre(*cell).into();
            for side in face.perpendicular() {
                let towards = <[i16; 3]>::from(side.offset()).map(f64::from);
                let along = (0..3).find(|i| normal[*i] == 0.0 && towards[*i] == 0.0).unwrap_or(0);
                let beside = cell.step(side);
                // A face that continues in the same plane has no edge here.
                if cells.contains(&beside) && !cells.contains(&beside.step(face)) {
                    continue;
                }
                let end = |by: f64| {
                    let mut end = [0, 1, 2].map(|i| middle[i] + (normal[i] + towards[i]) / 2.0);
                    end[along] += by;
                    view.project(end)
                };
                let ends = [end(-0.5), end(0.5)];
                let key = [ends[0][0], ends[0][1], ends[1][0], ends[1][1]].map(|x| (x * 1e4).round() as i32);
                edges.insert(key, ends);
            }
        }
    }
    edges
}

/// Returns the outline of cells as segments.
pub fn outline(view: &View, cells: &BTreeSet<Cell>) -> Vec<[P; 2]> {
    let sides = silhouette(view);
    let mut near: BTreeMap<(i32, i32), Vec<Silhouette>> = BTreeMap::new();
    let hidden = |cell: &&Cell| Face::ALL.into_iter().all(|face| cells.contains(&cell.step(face)));
    for cell in cells.iter().filter(|cell| !hidden(cell)) {
        let middle = view.project(centre(*cell).into());
        let square = middle.map(|x| x.floor() as i32);
        let silhouette = Silhouette { middle, sides: sides.clone() };
        near.entry((square[0], square[1])).or_default().push(silhouette);
    }
    let mut segments = Vec::new();
    for [a, b] in candidates(view, cells).into_values() {
        let length = (b[0] - a[0]).hypot(b[1] - a[1]);
        if length < 1e-6 {
            continue;
        }
        // A silhouette is at most √3 wide, and the segment at most 1 long.
        let middle = [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0].map(|x| x.floor() as i32);
        let around: Vec<&Silhouette> = (-2..=2)
            .flat_map(|x| (-2..=2).map(move |y| (middle[0] + x, middle[1] + y)))
            .filter_map(|square| near.get(&square))
            .flatten()
            .collect();
        let mut crossings = vec![0.0, 1.0];
        around.iter().for_each(|s| s.crossings(a, b, &mut crossings));
        crossings.sort_by(f64::total_cmp);
        let aside = [-(b[1] - a[1]) / length * ASIDE, (b[0] - a[0]) / length * ASIDE];
        let point = |t: f64| [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t];
        let outside = |t: f64, sign: f64| {
            let [x, y] = point(t);
            let beside = [x + sign * aside[0], y + sign * aside[1]];
            !around.iter().any(|s| s.contains(beside))
        };
        let mut kept: Option<[f64; 2]> = None;
        for pair in crossings.windows(2).filter(|pair| pair[1] - pair[0] > 1e-6) {
            let t = f64::midpoint(pair[0], pair[1]);
            if outside(t, 1.0) || outside(t, -1.0) {
                kept = Some([kept.map_or(pair[0], |[from, _]| from), pair[1]]);
            } else if let Some([from, to]) = kept.take() {
                segments.push([point(from), point(to)]);
            }
        }
        segments.extend(kept.map(|[from, to]| [point(from), point(to)]));
    }
    segments
}

/// Joins segments with common ends to courses, so that dashes continue around corners.
pub fn joined(segments: &[[P; 2]]) -> Vec<Vec<P>> {
    let key = |p: P| p.map(|x| (x * 1e4).round() as i64);
    let mut at: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
    for (i, ends) in segments.iter().enumerate() {
        ends.iter().for_each(|end| at.entry(key(*end)).or_default().push(i));
    }
    let mut used = vec![false; segments.len()];
    let mut courses = Vec::new();
    for first in 0..segments.len() {
        if std::mem::replace(&mut used[first], true) {
            continue;
        }
        let mut course = segments[first].to_vec();
        for _ in 0..2 {
            while let Some(end) = course.last().copied()
                && let Some(next) = at[&key(end)].iter().copied().find(|i| !used[*i])
            {
                used[next] = true;
                let [a, b] = segments[next];
                course.push(if key(a) == key(end) { b } else { a });
            }
            course.reverse();
        }
        courses.push(course);
    }
    courses
}

#[cfg(test)]
mod tests {
    use super::super::camera::Camera;
    use super::*;

    fn length(segments: &[[P; 2]]) -> f64 {
        segments.iter().map(|[a, b]| (b[0] - a[0]).hypot(b[1] - a[1])).sum()
    }

    /// The outline of a block is that of a cell of its size, in all cameras.
    #[test]
    fn blocks_have_the_outline_of_one_box() {
        let block: BTreeSet<Cell> = (0..24).map(|i| Cell::new(i % 4, i / 4 % 3, i / 12)).collect();
        for camera in ["iso", "true-iso", "front", "side", "top", "-50,-20"] {
            let view = camera.parse::<Camera>().unwrap().view();
            let edges = [0, 1, 2].map(|axis| view.project(unit(axis))).map(|[x, y]| x.hypot(y));
            let around = 2.0 * (4.0 * edges[0] + 3.0 * edges[1] + 2.0 * edges[2]);
            let seen = if camera.contains("iso") || camera.contains(',') {
                around
            } else {
                // Along an axis, edges in its direction are points.
                2.0 * edges.iter().zip([4.0, 3.0, 2.0]).map(|(e, n)| e.round() * n).sum::<f64>()
            };
            let segments = outline(&view, &block);
            assert!((length(&segments) - seen).abs() < 1e-6, "{camera}: {} and {seen}", length(&segments));
            assert_eq!(joined(&segments).len(), 1, "{camera}");
        }
    }

    #[test]
    fn holes_have_an_outline_too() {
        let ring: BTreeSet<Cell> = (0..9).filter(|i| *i != 4).map(|i| Cell::new(i % 3, 0, i / 3)).collect();
        let view = "front".parse::<Camera>().unwrap().view();
        let segments = outline(&view, &ring);
        assert!((length(&segments) - 16.0).abs() < 1e-9, "{}", length(&segments));
        assert_eq!(joined(&segments).len(), 2);
    }
}
