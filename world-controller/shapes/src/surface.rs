//! The surface of a mesh on the fine grid: its rim, where it is not closed, and repairs that make the rim shorter.
//!
//! Every surface winds around a point, a closed one a whole number of times, another one a fraction (Jacobson, Kavan and
//! Sorkine-Hornung 2013, "Robust inside-outside segmentation using generalized winding numbers"). Curtains that rise
//! from the rim without end close every surface. As no vertical column crosses them, the crossings below a point are those with the
//! closed surface, a whole number; [`Surface::turns`] adds the share of the view that the curtains fill. So only
//! the rim costs more work, and a surface whose rim vanishes is exact. Where corners are on the edges of other triangles
//! (T-junctions), the slits are closed by triangles as thin as the rounding of corners, and pieces of the rim that cancel on a
//! straight line vanish.
//!
//! Absent: filling holes, and uniting parts.

use super::error::{MAX_RIM, SolidError};
use super::mesh::Triangle;
use super::visiblesim::counted;
use super::voxel::{Point, cross, left_of, show};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// The width of a slit at most, in steps of the fine grid: its corners were rounded.
const SLIT_WIDTH: i128 = 2;
/// Size, relative to the terms of a sum, of a result that is taken for 0.
const NOISE: f64 = 1e-9;

/// An edge of a triangle: its corners in ascending order, whether the triangle runs along it in that order, and the
/// triangle.
type Edge = (u32, u32, bool, u32);

/// A straight piece of the rim, and how often the surface runs along it from the first to the second point.
type Piece = (Point, Point, i64);

/// A surface, repaired where that makes its rim shorter.
pub struct Surface<'a> {
    /// The triangles, and behind them those that close slits. A triangle left out has three equal corners.
    pub triangles: Cow<'a, [[u32; 3]]>,
    /// The triangles of the mesh.
    whole: &'a [[u32; 3]],
    rim: Vec<Piece>,
    /// The number of edges that triangles do not traverse equally often in both directions, whether each belongs to one
    /// triangle only, and the first of them.
    unequal: (usize, bool, Option<Edge>),
    turned: usize,
    doubled: usize,
    /// The number of edges of more than two triangles.
    crowded: usize,
}

impl<'a> Surface<'a> {
    /// Returns the surface of a mesh. If every edge belongs to two triangles that traverse it in opposite directions, it
    /// is the mesh.
    pub fn new(points: &[Point], triangles: &'a [[u32; 3]]) -> Surface<'a> {
        let mut best = Surface::of(triangles, Cow::Borrowed(triangles));
        if best.unequal.0 == 0 {
            return best;
        }
        for single in [false, true] {
            let mut changed = triangles.to_vec();
            let doubled = if single { leave_doubled_out(&mut changed) } else { 0 };
            if single && doubled == 0 {
                break;
            }
            let turned = turn(points, &mut changed);
            if turned + doubled == 0 {
                continue;
            }
            let other = Surface::of(triangles, Cow::Owned(changed));
            // Copies of a triangle tell nothing of what is inside, so they are left out also if no edge is closed by that.
            if other.unequal.0 < best.unequal.0 || doubled > 0 && other.unequal.0 == best.unequal.0 {
                best = Surface { turned, doubled, crowded: best.crowded, ..other };
            }
        }
        if best.unequal.0 <= MAX_RIM {
            let slits = slits(points, &edges(&best.triangles));
            best.triangles.to_mut().extend(slits);
            best.rim = rim(points, &edges(&best.triangles));
        }
        best
    }

    fn of(whole: &'a [[u32; 3]], triangles: Cow<'a, [[u32; 3]]>) -> Surface<'a> {
        let (mut unequal, mut crowded) = ((0, true, None), 0);
        for group in groups(&edges(&triangles)) {
            crowded += usize::from(group.len() > 2);
            if balance(group) != 0 {
                unequal = (unequal.0 + 1, unequal.1 && group.len() == 1, unequal.2.or(Some(group[0])));
            }
        }
        Surface { triangles, whole, rim: Vec::new(), unequal, turned: 0, doubled: 0, crowded }
    }

    /// Returns the number of pieces of the rim, or `None` if there are too many to be examined.
    pub fn pieces(&self) -> Option<u64> {
        (self.unequal.0 <= MAX_RIM).then_some(self.rim.len() as u64)
    }

    /// Returns the winding number of the curtains around a point, in the sign of a column's crossings.
    pub fn turns(&self, at: Point) -> f64 {
        self.rim.iter().map(|(from, to, times)| *times as f64 * curtain(*from, *to, at)).sum()
    }

    /// Returns the faults that were read over, each in one sentence.
    pub fn notes(&self) -> Vec<String> {
        let unequal = if self.rim.is_empty() {
            "ends at corners inside other edges; together they are closed"
        } else if self.unequal.1 {
            "belongs to one triangle only; the holes are closed by the winding number"
        } else {
            "belongs to triangles that do not fit each other; the winding number decides"
        };
        let plural = unequal.replacen("ends", "end", 1).replacen("belongs", "belong", 1);
        [
            (self.turned, "triangle", ["is turned", "are turned"]),
            (self.doubled, "triangle", ["is doubled", "are doubled"]),
            (
                self.crowded,
                "edge",
                ["belongs to more than two triangles", "belong to more than two triangles"],
            ),
            (self.unequal.0, "edge", [unequal, &plural]),
        ]
        .into_iter()
        .filter(|(n, ..)| *n > 0)
        .map(|(n, noun, verbs)| counted(n, noun, verbs))
        .collect()
    }

    /// Returns the error that the surface is not closed.
    pub fn open(&self, file: &str, mesh: &[Triangle], why: String) -> SolidError {
        let (edges, single, example) = self.unequal;
        let (a, b, along, triangle) = example.unwrap_or_default();
        let number = triangle as usize;
        let corner = |end: u32| {
            let place = self.whole[number].iter().position(|corner| *corner == end);
            show(mesh[number][place.unwrap_or_default()])
        };
        let (from, to) = if along { (a, b) } else { (b, a) };
        let ends = format!("from {} to {}", corner(from), corner(to));
        let how = if single {
            "belong to one triangle only"
        } else {
            "belong to triangles that do not fit each other"
        };
        SolidError::Open { file: file.to_owned(), edges, how, ends, triangle: number + 1, why }
    }
}

fn edges(triangles: &[[u32; 3]]) -> Vec<Edge> {
    let mut edges = Vec::with_capacity(triangles.len() * 3);
    for (number, [a, b, c]) in triangles.iter().enumerate() {
        if a == b || b == c || c == a {
            // Such a triangle has no surface; its two long edges coincide.
            continue;
        }
        edges.extend([(a, b), (b, c), (c, a)].map(|(a, b)| (*a.min(b), *a.max(b), a < b, number as u32)));
    }
    // Entries of one edge become adjacent.
    edges.sort_unstable();
    edges
}

fn groups(edges: &[Edge]) -> impl Iterator<Item = &[Edge]> {
    edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1))
}

/// Returns how much more often triangles traverse an edge in the order of its corners than against it.
fn balance(edge: &[Edge]) -> i64 {
    edge.iter().map(|(_, _, along, _)| if *along { 1 } else { -1 }).sum()
}

/// Leaves out all but the first triangle with the same corners in any order. Returns the number of those left out.
fn leave_doubled_out(triangles: &mut [[u32; 3]]) -> usize {
    let key = |[a, b, c]: [u32; 3]| {
        let mut key = [a, b, c];
        key.sort_unstable();
        key
    };
    let mut order: Vec<([u32; 3], u32)> = triangles.iter().map(|t| key(*t)).zip(0..).collect();
    order.retain(|([a, b, c], _)| a < b && b < c);
    order.sort_unstable();
    let mut left_out = 0;
    for pair in order.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
        triangles[pair[1].1 as usize] = [pair[1].0[0]; 3];
        left_out += 1;
    }
    left_out
}

/// Turns the triangles that face another side than most of those that they are joined with by edges of two triangles.
/// Where there are as many of both, the solid has a positive volume. Returns the number of turned ones.
fn turn(points: &[Point], triangles: &mut [[u32; 3]]) -> usize {
    // The neighbours of each triangle, and whether each faces another side.
    let mut joined = vec![[None; 3]; triangles.len()];
    let mut join = |triangle: u32, other: u32, unlike: bool| {
        let free = joined[triangle as usize].iter_mut().find(|place| place.is_none());
        if let Some(place) = free {
            *place = Some((other, unlike));
        }
    };
    for group in groups(&edges(triangles)) {
        if let [a, b] = group {
            join(a.3, b.3, a.2 == b.2);
            join(b.3, a.3, a.2 == b.2);
        }
    }
    let (mut seen, mut turned) = (vec![false; triangles.len()], 0);
    for first in 0..triangles.len() {
        if std::mem::replace(&mut seen[first], true) {
            continue;
        }
        // Triangles of one part, and whether each faces another side than the first.
        let (mut part, mut next) = (vec![(first, false)], 0);
        while let Some(&(triangle, other_side)) = part.get(next) {
            next += 1;
            for (neighbour, unlike) in joined[triangle].iter().flatten() {
                if !std::mem::replace(&mut seen[*neighbour as usize], true) {
                    part.push((*neighbour as usize, other_side != *unlike));
                }
            }
        }
        let unlike = part.iter().filter(|(_, other_side)| *other_side).count();
        if unlike == 0 {
            continue;
        }
        let first_turns = match (unlike * 2).cmp(&part.len()) {
            std::cmp::Ordering::Less => false,
            std::cmp::Ordering::Greater => true,
            std::cmp::Ordering::Equal => {
                let volume = |(triangle, other_side): &(usize, bool)| {
                    let volume = volume(triangles[*triangle].map(|corner| points[corner as usize]));
                    if *other_side { -volume } else { volume }
                };
                part.iter().map(volume).sum::<i128>() < 0
            }
        };
        for (triangle, _) in part.iter().filter(|(_, other_side)| *other_side != first_turns) {
            triangles[*triangle].swap(1, 2);
            turned += 1;
        }
    }
    turned
}

/// Returns six times the signed volume between a triangle and the origin.
fn volume([a, b, c]: [Point; 3]) -> i128 {
    let [a, b, c] = [a, b, c].map(|p| p.map(i128::from));
    let minor = |i: usize, j: usize| b[i] * c[j] - b[j] * c[i];
    a[0] * minor(1, 2) + a[1] * minor(2, 0) + a[2] * minor(0, 1)
}

/// Returns triangles that close the loops of the rim that have hardly a width.
fn slits(points: &[Point], edges: &[Edge]) -> Vec<[u32; 3]> {
    // The rim's edges in their direction, as often as they are there, in order.
    let mut open: Vec<(u32, u32)> = Vec::new();
    for group in groups(edges) {
        let (times, (a, b, ..)) = (balance(group), group[0]);
        let edge = if times > 0 { (a, b) } else { (b, a) };
        open.extend(std::iter::repeat_n(edge, times.unsigned_abs() as usize));
    }
    open.sort_unstable();
    // Whether each was walked along, and how many of a corner were, at the first one: always its first ones.
    let (mut used, mut walked) = (vec![false; open.len()], vec![0; open.len()]);
    let first_from = |corner: u32| open.partition_point(|(from, _)| *from < corner);
    let (mut triangles, mut path): (Vec<[u32; 3]>, Vec<u32>) = (Vec::new(), Vec::new());
    // The place of a corner in the path.
    let mut places = BTreeMap::new();
    for first in 0..open.len() {
        let mut next = Some(first).filter(|first| !used[*first]);
        path.clear();
        places.clear();
        while let Some(edge) = next {
            let (from, to) = open[edge];
            used[edge] = true;
            walked[first_from(from)] += 1;
            places.insert(from, path.len());
            path.push(from);
            if let Some(place) = places.get(&to) {
                let corners = path.split_off(*place);
                for corner in &corners {
                    places.remove(corner);
                }
                if is_slit(points, &corners) {
                    triangles.extend(corners[1..].windows(2).map(|pair| [corners[0], pair[1], pair[0]]));
                }
            }
            let start = first_from(to);
            next = walked.get(start).map(|walked| start + walked);
            next = next.filter(|next| open.get(*next).is_some_and(|(from, _)| *from == to));
        }
    }
    triangles
}

/// Returns whether all these corners are near one line.
fn is_slit(points: &[Point], corners: &[u32]) -> bool {
    let at = |corner: u32| points[corner as usize].map(i128::from);
    let from_to = |a: [i128; 3], b: [i128; 3]| [0, 1, 2].map(|axis| b[axis] - a[axis]);
    let square = |v: [i128; 3]| v.iter().map(|c| c * c).sum::<i128>();
    let ends = corners.windows(2).map(|pair| (at(pair[0]), from_to(at(pair[0]), at(pair[1]))));
    let Some((start, along)) = ends.max_by_key(|(_, along)| square(*along)) else { return false };
    corners.iter().all(|corner| {
        let away = from_to(start, at(*corner));
        let minor = |i: usize, j: usize| away[i] * along[j] - away[j] * along[i];
        square([minor(1, 2), minor(2, 0), minor(0, 1)]) <= SLIT_WIDTH * SLIT_WIDTH * square(along)
    })
}

/// Returns the pieces along which a surface is not closed. Those that lie on one line are added.
fn rim(points: &[Point], edges: &[Edge]) -> Vec<Piece> {
    // The direction and a point of a line, a place on it, and how much the surface runs along it from there on.
    let mut places: Vec<(Point, Point, i64, i64)> = Vec::new();
    for group in groups(edges) {
        let (mut times, [a, b]) =
            (balance(group), [group[0].0, group[0].1].map(|corner| points[corner as usize]));
        if times == 0 {
            continue;
        }
        let mut along = [0, 1, 2].map(|axis| b[axis] - a[axis]);
        let length = along.iter().fold(0, |of_all, c| common_divisor(of_all, c.unsigned_abs())) as i64;
        // The corners of an edge differ, so one axis is not 0.
        let axis = along.iter().position(|c| *c != 0).unwrap_or_default();
        let start = if along[axis] < 0 { b } else { a };
        times *= along[axis].signum();
        along = along.map(|c| c / length.max(1) * along[axis].signum());
        let place = start[axis].div_euclid(along[axis].max(1));
        let line = [0, 1, 2].map(|axis| start[axis] - place * along[axis]);
        places.extend([(along, line, place, times), (along, line, place + length, -times)]);
    }
    places.sort_unstable();
    let (mut rim, mut times) = (Vec::new(), 0);
    for pair in places.windows(2) {
        let ((along, line, from, step), (.., to, _)) = (pair[0], pair[1]);
        // The steps of one line add up to 0, so that its last place ends all pieces.
        times += step;
        if times != 0 && from < to {
            let point = |place: i64| [0, 1, 2].map(|axis| line[axis] + place * along[axis]);
            rim.push((point(from), point(to), times));
        }
    }
    rim
}

fn common_divisor(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

/// Returns the winding number, around a point, of the curtain that rises from an edge without end: the share that it fills
/// of all directions. On the curtain, the point is shifted as in `voxel`.
fn curtain(from: Point, to: Point, at: Point) -> f64 {
    if from[0] == to[0] && from[1] == to[1] {
        return 0.0;
    }
    // Van Oosterom and Strackee's formula for the triangle of both ends and the direction up. Returns the
    // direction to an end, seen from above, and the sum of its length and its height.
    let towards = |end: Point| {
        let [x, y, z] = [0, 1, 2].map(|axis| (end[axis] - at[axis]) as f64);
        let flat = x * x + y * y;
        if flat == 0.0 && z <= 0.0 {
            // The end is below the point: shifted, the point sees it in this direction.
            return ([-1.0, -f64::MIN_POSITIVE], 0.0, true);
        }
        let length = (flat + z * z).sqrt();
        ([x, y], if z < 0.0 { flat / (length - z) } else { length + z }, false)
    };
    let ((u, of_u, u_below), (v, of_v, v_below)) = (towards(to), towards(from));
    let terms = [of_u * of_v, u[0] * v[0], u[1] * v[1]];
    let mut ahead = terms.iter().sum::<f64>();
    let side = match cross(from, to, at) {
        0 if u_below || v_below => v[0] * u[1] - v[1] * u[0],
        0 => {
            if ahead.abs() <= NOISE * terms.iter().map(|term| term.abs()).sum::<f64>() {
                ahead = 0.0;
            }
            if left_of(from, to, at).is_some() { f64::MIN_POSITIVE } else { -f64::MIN_POSITIVE }
        }
        area => area as f64,
    };
    -libm::atan2(side, ahead) / TAU
}
