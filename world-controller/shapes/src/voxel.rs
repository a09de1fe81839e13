//! Finds the cells that a closed mesh fills: those whose centre it encloses.
//!
//! Corners are rounded to a grid of 1/65,536 of a cell; everything after that is exact integer arithmetic, so
//! that every machine gets the same cells. A centre is inside if the surface winds around it, so parts may
//! overlap, and a shell that faces inwards is a void. A centre exactly on the surface, or a ray through an
//! edge, is decided by symbolic perturbation: as if the centre were shifted by infinitesimals along x, y and
//! z, each much smaller than the previous one. So no triangle is counted twice.
//!
//! A mesh that is not closed winds around a centre by a fraction (see `surface`); a fraction that is far from a whole
//! number is an error.
//!
//! Absent: repairing meshes, beyond `surface`. Gaps thinner than a cell are closed silently.

use super::error::{MAX_GRID, MAX_WORK, SolidError};
use super::mesh::Triangle;
use super::surface::Surface;
use super::visiblesim::counted;
use metamorph_core::lattice::Cell;
use std::collections::HashMap;

/// Length of the edge of a cell in units of the fine grid.
const ONE: i64 = 1 << 16;
/// Half the length of that edge.
const HALF: i64 = ONE / 2;

/// The largest distance of a winding number from a whole number at which it is clear, in turns.
const CLEAR: f64 = 0.25;
/// Factor of the work for a centre and a piece of the rim, beside that for a triangle and a column.
const RIM_WORK: u64 = 8;

/// A mesh converted to cells.
#[derive(Clone, Debug, PartialEq)]
pub struct Voxels {
    /// Cells along each axis of the box around it.
    pub extent: [usize; 3],
    /// Whether each is filled; z changes fastest, x slowest.
    pub filled: Vec<bool>,
    /// The part of the surface more than a cell away from every filled cell, if any.
    pub thin: Option<SolidError>,
    /// Faults of the mesh that were read over, each in one sentence.
    pub notes: Vec<String>,
}

impl Voxels {
    /// Returns the filled cells with their places in the box.
    pub fn cells(&self) -> impl Iterator<Item = [usize; 3]> + '_ {
        let filled = self.filled.iter().enumerate().filter(|(_, filled)| **filled);
        filled.map(move |(i, _)| self.place(i))
    }

    fn place(&self, i: usize) -> [usize; 3] {
        let [_, ny, nz] = self.extent;
        [i / (ny * nz), i / nz % ny, i % nz]
    }
}

/// Converts a mesh to cells with edges of length `pitch`. The box around the mesh is centred on cells.
pub fn voxelise(file: &str, mesh: &[Triangle], pitch: f64) -> Result<Voxels, SolidError> {
    if !(pitch.is_finite() && pitch > 0.0) {
        return Err(SolidError::Pitch(pitch.to_string()));
    }
    let (min, max) = bounds(mesh);
    let size = [0, 1, 2].map(|axis| max[axis] - min[axis]);
    let vanished = || {
        let (file, size) = (file.to_owned(), show(size.map(|s| s as f32)));
        SolidError::Vanished { file, size, pitch: pitch.to_string() }
    };
    if size.iter().all(|length| *length < pitch / 2.0) {
        return Err(vanished());
    }
    // Saturates at u64::MAX; such sizes are refused.
    let cells = size.map(|length| ((length / pitch).round() as u64).max(1));
    let volume = cells.iter().try_fold(1u64, |product, n| product.checked_mul(*n));
    let longest = cells.iter().max().is_some_and(|n| *n > u64::from(Cell::LIMIT.unsigned_abs()));
    if longest || volume.is_none_or(|volume| volume > MAX_GRID) {
        let [x, y, z] = cells;
        return Err(SolidError::TooFine { file: file.to_owned(), pitch: pitch.to_string(), x, y, z });
    }
    let extent = cells.map(|n| n as usize);
    let origin = [0, 1, 2].map(|axis| (min[axis] + max[axis] - cells[axis] as f64 * pitch) / 2.0);
    let fine = Fine::new(mesh, origin, pitch);
    let empty = mesh.iter().filter(|[a, b, c]| a == b || b == c || c == a).count();
    let surface = Surface::new(&fine.points, &fine.triangles);
    let open = |why| surface.open(file, mesh, why);
    let pieces = surface.pieces().ok_or_else(|| open("so many are not examined".to_owned()))?;
    let mut work = Work { left: MAX_WORK, file };
    work.spend(cells.iter().product::<u64>().saturating_mul(pieces * RIM_WORK))?;
    let place =
        |at: [f64; 3]| show([0, 1, 2].map(|axis| (origin[axis] + at[axis] / ONE as f64 * pitch) as f32));
    let winds = fine.fill(extent, &surface.triangles, &mut work)?;
    let mut voxels =
        Voxels { extent, filled: Vec::with_capacity(winds.len()), thin: None, notes: surface.notes() };
    for (i, winds) in winds.into_iter().enumerate() {
        let centre = voxels.place(i).map(|c| c as i64 * ONE + HALF);
        let turns = f64::from(winds) + surface.turns(centre);
        if (turns - turns.round()).abs() > CLEAR {
            let at = place(centre.map(|c| c as f64));
            return Err(open(format!(
                "around {at} the surface winds {:.2} times, neither inside nor outside",
                turns.abs()
            )));
        }
        voxels.filled.push(turns.round() != 0.0);
    }
    if !voxels.filled.contains(&true) {
        return Err(vanished());
    }
    if empty > 0 {
        voxels.notes.push(counted(empty, "triangle", ["is empty", "are empty"]));
    }
    let (samples, of, at) = fine.thin_places(&voxels, &mut work)?;
    voxels.thin = at.map(|at| SolidError::Thin {
        file: file.to_owned(),
        pitch: pitch.to_string(),
        samples,
        of,
        at: place(at),
    });
    Ok(voxels)
}

/// Returns the corners of the box around a mesh.
pub fn bounds(mesh: &[Triangle]) -> ([f64; 3], [f64; 3]) {
    let fold = |start: f64, f: fn(f64, f64) -> f64| {
        let corners = mesh.iter().flatten();
        corners.fold([start; 3], |a, c| [0, 1, 2].map(|axis| f(a[axis], f64::from(c[axis]))))
    };
    (fold(f64::INFINITY, f64::min), fold(f64::NEG_INFINITY, f64::max))
}

/// Shows a place in the units of the file.
pub fn show([x, y, z]: [f32; 3]) -> String {
    format!("({x}, {y}, {z})")
}

/// A budget of work.
struct Work<'a> {
    left: u64,
    file: &'a str,
}

impl Work<'_> {
    fn spend(&mut self, amount: u64) -> Result<(), SolidError> {
        match self.left.checked_sub(amount) {
            Some(left) => {
                self.left = left;
                Ok(())
            }
            None => Err(SolidError::TooMuchWork(self.file.to_owned())),
        }
    }
}

/// A point on the fine grid.
pub type Point = [i64; 3];

/// A mesh on the fine grid, with equal corners merged.
struct Fine {
    points: Vec<Point>,
    triangles: Vec<[u32; 3]>,
}

impl Fine {
    fn new(mesh: &[Triangle], origin: [f64; 3], pitch: f64) -> Fine {
        let mut fine = Fine { points: Vec::new(), triangles: Vec::with_capacity(mesh.len()) };
        let mut numbers: HashMap<Point, u32> = HashMap::new();
        for triangle in mesh {
            let corners = triangle.map(|corner| {
                let at = [0, 1, 2].map(|axis| {
                    ((f64::from(corner[axis]) - origin[axis]) / pitch * ONE as f64).round() as i64
                });
                *numbers.entry(at).or_insert_with(|| {
                    fine.points.push(at);
                    fine.points.len() as u32 - 1
                })
            });
            fine.triangles.push(corners);
        }
        fine
    }

    fn corners(&self, triangle: &[u32; 3]) -> [Point; 3] {
        triangle.map(|corner| self.points[corner as usize])
    }

    /// Sweeps every column of centres. Returns for each centre the number of surface crossings below it, by their
    /// directions.
    fn fill(
        &self,
        [nx, ny, nz]: [usize; 3],
        triangles: &[[u32; 3]],
        work: &mut Work<'_>,
    ) -> Result<Vec<i32>, SolidError> {
        let mut crossings = vec![0i32; nx * ny * (nz + 1)];
        for triangle in triangles {
            let [a, mut b, mut c] = self.corners(triangle);
            let area = cross(a, b, c);
            if area == 0 {
                continue;
            }
            if area < 0 {
                std::mem::swap(&mut b, &mut c);
            }
            let (up, area) = (if area > 0 { 1 } else { -1 }, i128::from(area.abs()));
            let columns = |axis: usize, n: usize| {
                let low = a[axis].min(b[axis]).min(c[axis]) - HALF;
                let high = a[axis].max(b[axis]).max(c[axis]) - HALF;
                // From the first centre at or after `low` to the last at or before `high`.
                (-(-low).div_euclid(ONE)).max(0)..(high.div_euclid(ONE) + 1).min(n as i64)
            };
            let (over_x, over_y) = (columns(0, nx), columns(1, ny));
            let length = |range: &std::ops::Range<i64>| (range.end - range.start).max(0).unsigned_abs();
            work.spend(1 + length(&over_x) * length(&over_y))?;
            for x in over_x {
                for y in over_y.clone() {
                    let p = [x * ONE + HALF, y * ONE + HALF, 0];
                    let (Some(of_a), Some(of_b), Some(of_c)) =
                        (left_of(b, c, p), left_of(c, a, p), left_of(a, b, p))
                    else {
                        continue;
                    };
                    let weigh = |weight: i64, corner: Point| i128::from(weight) * i128::from(corner[2]);
                    let height = weigh(of_a, a) + weigh(of_b, b) + weigh(of_c, c);
                    // The first centre at or above the crossing.
                    let above = -(i128::from(HALF) * area - height).div_euclid(i128::from(ONE) * area);
                    let layer = above.clamp(0, nz as i128) as usize;
                    crossings[(x as usize * ny + y as usize) * (nz + 1) + layer] += up;
                }
            }
        }
        let mut winds = Vec::with_capacity(nx * ny * nz);
        for column in crossings.chunks_exact(nz + 1) {
            winds.extend(column[..nz].iter().scan(0, |winds, crossed| {
                *winds += crossed;
                Some(*winds)
            }));
        }
        Ok(winds)
    }

    /// Samples the surface for thin parts. Returns the number of samples without a filled cell among the
    /// 3×3×3 cells around them, the number of all samples, and the place of the first sample without one. The
    /// surface of a part that is at least a cell thick has no such samples.
    fn thin_places(
        &self,
        voxels: &Voxels,
        work: &mut Work<'_>,
    ) -> Result<(u64, u64, Option<[f64; 3]>), SolidError> {
        let near = grown(voxels);
        let [nx, ny, nz] = voxels.extent;
        let (mut samples, mut of, mut example) = (0, 0, None);
        for triangle in &self.triangles {
            let ([a, b, c], steps, lines) = sampling(self.corners(triangle));
            work.spend((steps + 1) * (lines + 1))?;
            for i in 0..=lines {
                let along = i as f64 / lines as f64;
                let (from, to) = (between(a, c, along), between(b, c, along));
                for j in 0..=steps {
                    let at = between(from, to, j as f64 / steps as f64);
                    let cell = |axis: usize, n: usize| {
                        ((at[axis] / ONE as f64).floor().max(0.0) as usize).min(n - 1)
                    };
                    of += 1;
                    if !near[(cell(0, nx) * ny + cell(1, ny)) * nz + cell(2, nz)] {
                        samples += 1;
                        example.get_or_insert(at);
                    }
                }
            }
        }
        Ok((samples, of, example))
    }
}

fn between(a: [f64; 3], b: [f64; 3], share: f64) -> [f64; 3] {
    [0, 1, 2].map(|axis| a[axis] + (b[axis] - a[axis]) * share)
}

/// Returns twice the signed area of the triangle seen from above; positive if counter-clockwise.
pub fn cross(a: Point, b: Point, c: Point) -> i64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Returns twice the area of the triangle `from`, `to`, `p`, seen from above, if `p` is to the left of the
/// line from `from` to `to`. A `p` on the line is perturbed first.
pub fn left_of(from: Point, to: Point, p: Point) -> Option<i64> {
    let area = cross(from, to, p);
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let left = match area {
        0 => dy < 0 || (dy == 0 && dx > 0),
        area => area > 0,
    };
    left.then_some(area)
}

/// Returns the corners, rotated so that the longest side comes first, and the numbers of steps along that
/// side and of lines parallel to it that keep samples at most half a cell apart.
fn sampling([a, b, c]: [Point; 3]) -> ([[f64; 3]; 3], u64, u64) {
    let [a, b, c] = [a, b, c].map(|p| p.map(|x| x as f64));
    let square = |p: [f64; 3], q: [f64; 3]| (0..3).map(|axis| (p[axis] - q[axis]).powi(2)).sum::<f64>();
    let turned = [[a, b, c], [b, c, a], [c, a, b]];
    let sides = turned.map(|[p, q, _]| square(p, q));
    let longest = (0..3).fold(0, |best, i| if sides[i] > sides[best] { i } else { best });
    let ([p, q, r], side) = (turned[longest], sides[longest].max(1.0));
    // The height is the distance to the third corner without its component along the side.
    let along = (0..3).map(|axis| (q[axis] - p[axis]) * (r[axis] - p[axis])).sum::<f64>();
    let height = (square(p, r) - along * along / side).max(0.0);
    let parts = |length: f64| (length.sqrt() / HALF as f64).ceil().max(1.0) as u64;
    ([p, q, r], parts(side), parts(height))
}

/// Returns for each cell of the box whether it is filled or touches a filled cell by a face, an edge or a
/// corner.
fn grown(voxels: &Voxels) -> Vec<bool> {
    let [nx, ny, nz] = voxels.extent;
    let mut near = voxels.filled.clone();
    for (stride, length) in [(1, nz), (nz, ny), (ny * nz, nx)] {
        let before = near.clone();
        for (i, cell) in near.iter_mut().enumerate() {
            let at = i / stride % length;
            *cell |= (at > 0 && before[i - stride]) || (at + 1 < length && before[i + stride]);
        }
    }
    near
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a box with its faces outwards or inwards.
    fn block(min: [f32; 3], max: [f32; 3], outwards: bool) -> Vec<Triangle> {
        let corner = |i: usize| [0, 1, 2].map(|axis| if i >> axis & 1 == 1 { max[axis] } else { min[axis] });
        let sides = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let halves = sides.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]);
        halves
            .map(|[a, b, c]| if outwards { [a, b, c] } else { [c, b, a] })
            .map(|corners| corners.map(corner))
            .collect()
    }

    fn count(mesh: &[Triangle], pitch: f64) -> usize {
        voxelise("test", mesh, pitch).unwrap().cells().count()
    }

    /// Every centre lies on planes through corners and edges, so all ties occur.
    #[test]
    fn boxes_fill_as_many_cells_as_fit() {
        for (x, y, z) in [(1, 1, 1), (2, 3, 4), (5, 1, 2)] {
            for shift in [0.0, 0.5, -3.25] {
                let mesh = block([shift; 3], [x, y, z].map(|n| shift + n as f32), true);
                assert_eq!(count(&mesh, 1.0), x * y * z);
                assert_eq!(count(&mesh, 0.5), x * y * z * 8);
            }
        }
        // Faces through the centres of cells: one side of each axis belongs to the box.
        let mut mesh = block([0.0; 3], [4.0; 3], true);
        mesh.extend(block([-8.0, 0.0, 0.0], [-7.5, 0.5, 0.5], true));
        mesh.extend(block([1.0; 3], [2.5; 3], true));
        assert_eq!(count(&mesh, 1.0), 64);
    }

    #[test]
    fn parts_overlap_and_voids_stay_empty() {
        let outer = block([0.0; 3], [5.0; 3], true);
        let inner = |outwards| block([1.0; 3], [4.0; 3], outwards);
        assert_eq!(count(&[outer.clone(), inner(true)].concat(), 1.0), 125);
        assert_eq!(count(&[outer.clone(), inner(false)].concat(), 1.0), 125 - 27);
        // A mesh with all faces reversed is the same solid.
        assert_eq!(count(&block([0.0; 3], [5.0; 3], false), 1.0), 125);
    }

    /// A triangulated ball has the cells whose centres are in the ball.
    #[test]
    fn a_ball_has_the_cells_of_a_ball() {
        let (n, m, r) = (96, 48, 8.0f64);
        let at = |i: usize, j: usize| {
            let (up, round) = (
                std::f64::consts::PI * j as f64 / m as f64,
                std::f64::consts::TAU * (i % n) as f64 / n as f64,
            );
            // The poles are one point each, whatever the angle.
            let wide = if j == 0 || j == m { 0.0 } else { up.sin() };
            [r * wide * round.cos(), r * wide * round.sin(), r * up.cos()].map(|c| c as f32)
        };
        let mut mesh = Vec::new();
        for i in 0..n {
            for j in 0..m {
                mesh.push([at(i, j), at(i, j + 1), at(i + 1, j + 1)]);
                mesh.push([at(i, j), at(i + 1, j + 1), at(i + 1, j)]);
            }
        }
        mesh.retain(|[a, b, c]| a != b && b != c && c != a);
        let voxels = voxelise("ball", &mesh, 1.0).unwrap();
        assert_eq!((voxels.extent, &voxels.thin), ([16; 3], &None));
        let distance = |cell: [usize; 3]| cell.iter().map(|c| (*c as f64 - 7.5).powi(2)).sum::<f64>().sqrt();
        for x in 0..16 {
            for y in 0..16 {
                for z in 0..16 {
                    let filled = voxels.filled[(x * 16 + y) * 16 + z];
                    let from_middle = distance([x, y, z]);
                    // The triangles are slightly inside the ball.
                    assert!(filled || from_middle > r - 0.05, "{x} {y} {z} is missing");
                    assert!(!filled || from_middle <= r, "{x} {y} {z} is too much");
                }
            }
        }
    }

    #[test]
    fn what_is_thinner_than_a_cell_is_noticed() {
        // A plate under a block: half a cell thick, four cells wide on each side.
        let mut mesh = block([0.0; 3], [4.0; 3], true);
        mesh.extend(block([-4.0, 1.75, 1.75], [8.0, 2.2, 2.2], true));
        let voxels = voxelise("rod", &mesh, 1.0).unwrap();
        assert_eq!(voxels.cells().count(), 64);
        assert!(matches!(voxels.thin, Some(SolidError::Thin { .. })), "{:?}", voxels.thin);
        // Corners and parts a cell thick are not thin.
        for size in [1.0, 1.3, 2.7] {
            let mesh = block([0.1, 0.2, 0.3], [0.1 + size, 0.2 + size, 0.3 + size], true);
            assert_eq!(voxelise("block", &mesh, 1.0).unwrap().thin, None, "{size}");
        }
    }

    /// Splits the first triangle at a corner on one of its sides: a T-junction.
    fn split(mesh: &mut Vec<Triangle>, side: usize, share: f32) {
        mesh[0].rotate_left(side);
        let [a, b, c] = mesh[0];
        let corner = [0, 1, 2].map(|axis| a[axis] + (b[axis] - a[axis]) * share);
        mesh.splice(..1, [[a, corner, c], [corner, b, c]]);
    }

    #[test]
    fn faults_that_leave_the_inside_clear_are_notes() {
        let cube = || block([0.0; 3], [3.0; 3], true);
        let with = |change: &dyn Fn(&mut Vec<Triangle>)| {
            let mut mesh = cube();
            change(&mut mesh);
            mesh
        };
        let beside = |min: [f32; 3], max: [f32; 3]| [cube(), block(min, max, true)].concat();
        let cases: [(&str, Vec<Triangle>, usize, &[&str]); 15] = [
            ("clean", cube(), 27, &[]),
            (
                "a common edge",
                beside([3.0, 3.0, 0.0], [6.0, 6.0, 3.0]),
                54,
                &["1 edge belongs to more than two"],
            ),
            ("a common corner", beside([3.0; 3], [6.0; 3]), 54, &[]),
            (
                "a common face",
                beside([3.0, 0.0, 0.0], [6.0, 3.0, 3.0]),
                54,
                &["5 edges belong to more than two"],
            ),
            ("twice the same", [cube(), cube()].concat(), 27, &["18 edges belong to more than two"]),
            ("turned", with(&|mesh| mesh[4].swap(0, 1)), 27, &["1 triangle is turned"]),
            (
                "many turned",
                with(&|mesh| mesh[3..8].iter_mut().for_each(|t| t.swap(1, 2))),
                27,
                &["5 triangles are turned"],
            ),
            (
                "half turned",
                with(&|mesh| mesh[..6].iter_mut().for_each(|t| t.swap(1, 2))),
                27,
                &["6 triangles are turned"],
            ),
            (
                "doubled",
                with(&|mesh| mesh.push(mesh[5])),
                27,
                &["1 triangle is doubled", "3 edges belong to more"],
            ),
            (
                "doubled and turned",
                with(&|mesh| {
                    let [a, b, c] = mesh[5];
                    mesh.insert(0, [b, a, c])
                }),
                27,
                &["1 triangle is turned", "1 triangle is doubled"],
            ),
            (
                "empty",
                with(&|mesh| mesh.push([mesh[0][0], mesh[0][0], mesh[0][1]])),
                27,
                &["1 triangle is empty"],
            ),
            (
                "a T-junction",
                with(&|mesh| split(mesh, 0, 0.5)),
                27,
                &["3 edges end at corners inside other edges"],
            ),
            (
                "a slanted T-junction and a straight one",
                with(&|mesh| {
                    split(mesh, 2, 0.31);
                    split(mesh, 2, 0.57);
                }),
                27,
                &["6 edges end at corners"],
            ),
            (
                "a T-junction and a turned triangle",
                with(&|mesh| {
                    split(mesh, 1, 0.5);
                    mesh[9].swap(0, 1)
                }),
                27,
                &["1 triangle is turned", "3 edges end"],
            ),
            (
                "a small hole",
                [cube(), block([5.2, 1.2, 1.2], [5.8, 1.8, 1.8], true)[1..].to_vec()].concat(),
                28,
                &["3 edges belong to one triangle only"],
            ),
        ];
        for (name, mesh, cells, notes) in cases {
            let voxels = voxelise("test", &mesh, 1.0).unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!(voxels.cells().count(), cells, "{name}");
            assert!(
                notes.len() <= voxels.notes.len() && notes.is_empty() == voxels.notes.is_empty(),
                "{name}: {:?}",
                voxels.notes
            );
            for note in notes {
                assert!(
                    voxels.notes.iter().any(|found| found.starts_with(note)),
                    "{name}: {:?}",
                    voxels.notes
                );
            }
        }
    }

    /// The number of crossings and the curtains together are the sum of the solid angles of all triangles.
    #[test]
    fn open_surfaces_wind_as_their_solid_angles_say() {
        let mut random = 1u64;
        let mut next = |below: u64| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 33) % below
        };
        for _ in 0..60 {
            let mut mesh = block([0.0; 3], [4.0, 5.0, 6.0], true);
            // Corners on half cells give ties, others none.
            let shift = [0.0, 0.5, 0.37][next(3) as usize];
            mesh.iter_mut().flatten().flatten().for_each(|c| *c += if *c > 0.0 { shift } else { 0.0 });
            for _ in 0..1 + next(3) {
                mesh.swap_remove(next(mesh.len() as u64) as usize);
                let turned = next(mesh.len() as u64) as usize;
                mesh[turned].swap(0, 1);
            }
            let fine = Fine::new(&mesh, [0.0; 3], 1.0);
            let surface = Surface::new(&fine.points, &fine.triangles);
            let mut work = Work { left: MAX_WORK, file: "test" };
            let winds = fine.fill([5, 6, 7], &surface.triangles, &mut work).unwrap();
            for (i, winds) in winds.into_iter().enumerate() {
                let centre = [i / 42, i / 7 % 6, i % 7].map(|c| c as i64 * ONE + HALF);
                let solid_angle = |triangle: &[u32; 3]| {
                    let [a, b, c] = fine
                        .corners(triangle)
                        .map(|corner| [0, 1, 2].map(|i| (corner[i] - centre[i]) as f64));
                    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
                    let [of_a, of_b, of_c] = [a, b, c].map(|v| dot(v, v).sqrt());
                    let normal =
                        [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
                    let ahead = of_a * of_b * of_c + dot(a, b) * of_c + dot(b, c) * of_a + dot(c, a) * of_b;
                    2.0 * dot(a, normal).atan2(ahead)
                };
                let angles = surface.triangles.iter().map(solid_angle);
                let on_surface = surface.triangles.iter().any(|triangle| {
                    let corners = fine.corners(triangle);
                    (0..3).any(|axis| corners.iter().all(|corner| corner[axis] == centre[axis]))
                });
                let (sum, turns) = (
                    angles.sum::<f64>() / (4.0 * std::f64::consts::PI),
                    f64::from(winds) + surface.turns(centre),
                );
                assert!(on_surface || (sum + turns).abs() < 1e-6, "{centre:?}: {sum} {turns}");
            }
        }
    }

    /// Small numbers give every fault at once.
    #[test]
    fn no_triangles_make_the_reader_panic() {
        let mut random = 7u64;
        let mut next = |below: u64| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 33) % below
        };
        let mut read = 0;
        for round in 0..3_000 {
            let mut mesh = if round % 2 == 0 { Vec::new() } else { block([0.0; 3], [2.0; 3], true) };
            for _ in 0..1 + next(4) {
                mesh.push([(); 3].map(|()| [(); 3].map(|()| next(5) as f32 / 2.0)));
            }
            read += usize::from(voxelise("test", &mesh, [0.5, 1.0, 0.3][next(3) as usize]).is_ok());
        }
        assert!(read > 100, "{read}");
    }

    #[test]
    fn refuses_what_has_no_inside() {
        let mesh = block([0.0; 3], [3.0; 3], true);
        let refused = |mesh: &[Triangle]| voxelise("test", mesh, 1.0).unwrap_err();
        let text = refused(&mesh[1..]).to_string();
        assert!(
            text.contains("3 edges belong to one triangle only, such as the one from (0, ")
                && text.contains("winds 0."),
            "{text}"
        );
        assert!(matches!(refused(&mesh[..1]), SolidError::Open { edges: 3, triangle: 1, .. }));
        let lattice = |i: usize| [(i % 100) as f32, (i / 100 % 100) as f32, (i / 10_000) as f32];
        let soup = |i: usize| [lattice(i), lattice(i).map(|c| c + 0.3), lattice(i).map(|c| -c)];
        assert!(matches!(refused(&(1..340_000).map(soup).collect::<Vec<_>>()), SolidError::Open { .. }));
    }
}
