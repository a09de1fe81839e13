//! Bodies as convex solids: the faces of each that are seen, projected, and what decides which one hides which.
//!
//! Faces turned away from the eye are left out, and so are those between two drawn cells.

use super::camera::{P, V, View, dot};
use crate::elements::Hold;
use crate::parts::{Part, Shape, Tone, centre};
use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::{Cell, Face};
use nalgebra::Vector3;
use std::collections::BTreeSet;

/// Number of points of a whole circle.
const CIRCLE_POINTS: u32 = 48;
/// Brightness of faces: turned up, to the front, and to the side; as on a body lit from above.
const SHADES: [f64; 3] = [1.0, 0.8, 0.64];

/// A flat face or an outline, projected.
#[derive(Clone, Debug, PartialEq)]
pub struct Facet {
    /// Its corners, in edges of a cell.
    pub points: Vec<P>,
    /// Its brightness, from 0 to 1.
    pub shade: f64,
    /// True if a section plane cuts the structure here.
    pub cut: bool,
}

/// The owner of a solid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owner {
    /// A part of a module.
    Module(ModuleId),
    /// A foreign object in a cell.
    Obstacle(Cell),
    /// A cell of a passive element, and how that is held.
    Element(Cell, Hold),
    /// A cell of the goal that nothing fills.
    Goal(Cell),
}

/// A convex solid.
#[derive(Clone, Debug)]
pub struct Solid {
    /// Whose it is.
    pub owner: Owner,
    /// Visible faces, from back to front.
    pub facets: Vec<Facet>,
    /// The corners of its bounding box.
    pub bounds: [V; 2],
    /// Its centre; of half a ball, that of the ball.
    pub centre: V,
    /// Of half a ball, the direction of its dome.
    pub dome: Option<V>,
    /// The shade that distinguishes the parts of a body.
    pub tone: Tone,
}

/// The cells that are filled, and those among them that are drawn.
#[derive(Debug, Default)]
pub struct Filled {
    /// Drawn: a face towards one of them is not seen.
    pub drawn: BTreeSet<Cell>,
    /// Removed by a section plane: a face towards one of them is a cut.
    pub cut: BTreeSet<Cell>,
}

/// Returns the cell that a part fills; `None` if it is between cells or is no cell.
pub fn filled_cell(part: &Part) -> Option<Cell> {
    let whole = part.shape == Shape::Box { size: [1.0; 3] };
    let cell = part.cell();
    let at_rest = part.pose.rotation.angle() < 1e-9 && (part.centre() - centre(cell)).norm() < 1e-9;
    (whole && at_rest).then_some(cell)
}

/// Returns the solid of a part of a module.
pub fn of_part(view: &View, id: ModuleId, part: &Part, filled: &Filled) -> Solid {
    let owner = Owner::Module(id);
    match (part.shape, filled_cell(part)) {
        (_, Some(cell)) => of_cell(view, owner, cell, filled),
        (Shape::Box { size }, None) => of_box(view, owner, part, size),
        (Shape::HalfCube { radius, half_edge }, None) => half_ball(view, owner, part, radius, half_edge),
    }
}

/// Returns the solid of a cell, without its faces towards drawn cells.
pub fn of_cell(view: &View, owner: Owner, cell: Cell, filled: &Filled) -> Solid {
    let middle: V = centre(cell).into();
    let mut facets = Vec::new();
    for face in Face::ALL {
        let normal = <[i16; 3]>::from(face.offset()).map(f64::from);
        let behind = cell.step(face);
        if view.faces(normal) && !filled.drawn.contains(&behind) {
            let facet = square(view, middle, normal);
            facets.push(Facet { cut: filled.cut.contains(&behind), ..facet });
        }
    }
    let bounds = [middle.map(|x| x - 0.5), middle.map(|x| x + 0.5)];
    Solid { owner, facets, bounds, centre: middle, dome: None, tone: Tone::Plain }
}

/// Returns a face of a unit cube with axes along those of space.
fn square(view: &View, middle: V, normal: V) -> Facet {
    let axis = normal.iter().position(|x| *x != 0.0).unwrap_or(0);
    let corner = |a: f64, b: f64| {
        let mut corner = middle;
        corner[axis] += normal[axis] / 2.0;
        corner[(axis + 1) % 3] += a / 2.0;
        corner[(axis + 2) % 3] += b / 2.0;
        view.project(corner)
    };
    let points = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(a, b)| corner(a, b));
    Facet { points: points.into(), shade: shade(normal), cut: false }
}

/// Returns the brightness of a face with this normal of length 1: the weights of the axes add up to 1.
fn shade(normal: V) -> f64 {
    let [top, front, side] = SHADES;
    let up = if normal[2] < 0.0 { side } else { top };
    normal[0] * normal[0] * side + normal[1] * normal[1] * front + normal[2] * normal[2] * up
}

fn of_box(view: &View, owner: Owner, part: &Part, size: V) -> Solid {
    let place = |corner: V| -> V { (part.pose * nalgebra::Point3::from(corner)).coords.into() };
    let mut facets = Vec::new();
    let mut corners = Vec::new();
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let corner = |a: f64, b: f64| {
                let mut corner = [0.0; 3];
                corner[axis] = side * size[axis] / 2.0;
                corner[(axis + 1) % 3] = a * size[(axis + 1) % 3] / 2.0;
                corner[(axis + 2) % 3] = b * size[(axis + 2) % 3] / 2.0;
                place(corner)
            };
            let points = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
            let mut normal = Vector3::zeros();
            normal[axis] = side;
            let normal: V = (part.pose.rotation * normal).into();
            corners.extend(points);
            if view.faces(normal) {
                let points = points.map(|p| view.project(p)).into();
                facets.push(Facet { points, shade: shade(normal), cut: false });
            }
        }
    }
    let bounds = around(&corners);
    Solid { owner, facets, bounds, centre: part.centre().into(), dome: None, tone: part.tone }
}

fn around(points: &[V]) -> [V; 2] {
    let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    for point in points {
        for axis in 0..3 {
            bounds[0][axis] = bounds[0][axis].min(point[axis]);
            bounds[1][axis] = bounds[1][axis].max(point[axis]);
        }
    }
    bounds
}

/// Returns half a ball with three flat plates. It is convex, so its outline is the convex hull of the outline of
/// the sphere, where the half has it, and of its edges: the rims of the plates and the circle of the cut.
fn half_ball(view: &View, owner: Owner, part: &Part, radius: f64, half_edge: f64) -> Solid {
    let middle: V = part.centre().into();
    let turned = |v: V| -> V { (part.pose.rotation * Vector3::from(v)).into() };
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(turned);
    let dome = turned([1.0; 3].map(|x: f64| x / 3f64.sqrt()));
    let inside = |p: &V| dot(*p, dome) >= -1e-9 && axes.iter().all(|axis| dot(*p, *axis) <= half_edge + 1e-9);
    let rim = (radius * radius - half_edge * half_edge).max(0.0).sqrt();
    let plate = |axis: usize| {
        circle(axes[axis].map(|x| x * half_edge), axes[(axis + 1) % 3], axes[(axis + 2) % 3], rim)
    };
    // Two directions in the plane of the cut.
    let across = turned([1.0, -1.0, 0.0].map(|x: f64| x / 2f64.sqrt()));
    let along = turned([1.0, 1.0, -2.0].map(|x: f64| x / 6f64.sqrt()));
    let edges = circle([0.0; 3], across, along, radius).chain((0..3).flat_map(plate));
    let outline: Vec<V> =
        circle([0.0; 3], view.right, view.up, radius).filter(|p| inside(p)).chain(edges).collect();
    let at = |p: &V| view.project([p[0] + middle[0], p[1] + middle[1], p[2] + middle[2]]);
    let points = hull(outline.iter().map(at).collect());
    let mut facets = vec![Facet { points, shade: 0.86, cut: false }];
    let mut plates: Vec<usize> = (0..3).filter(|axis| view.faces(axes[*axis])).collect();
    plates.sort_by(|a, b| view.nearness(axes[*a]).total_cmp(&view.nearness(axes[*b])));
    for axis in plates {
        let points = plate(axis).map(|p| at(&p)).collect();
        facets.push(Facet { points, shade: shade(axes[axis]), cut: false });
    }
    let bounds = [middle.map(|x| x - half_edge), middle.map(|x| x + half_edge)];
    Solid { owner, facets, bounds, centre: middle, dome: Some(dome), tone: part.tone }
}

/// Returns points of a circle.
fn circle(middle: V, a: V, b: V, radius: f64) -> impl Iterator<Item = V> {
    (0..CIRCLE_POINTS).map(move |i| {
        let (sin, cos) = libm::sincos(f64::from(i) / f64::from(CIRCLE_POINTS) * std::f64::consts::TAU);
        let along = |axis: usize| middle[axis] + radius * (cos * a[axis] + sin * b[axis]);
        [along(0), along(1), along(2)]
    })
}

/// Returns the convex hull of points (Andrew's monotone chain), counterclockwise.
fn hull(mut points: Vec<P>) -> Vec<P> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let turn = |a: P, b: P, c: P| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    let chain = |points: &mut dyn Iterator<Item = P>| {
        let mut chain: Vec<P> = Vec::new();
        for point in points {
            while let [.., a, b] = chain[..]
                && turn(a, b, point) <= 1e-9
            {
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut lower = chain(&mut points.iter().copied());
    lower.extend(chain(&mut points.iter().rev().copied()));
    lower
}

#[cfg(test)]
mod tests {
    use super::super::camera::Camera;
    use super::*;
    use nalgebra::UnitQuaternion;

    fn iso() -> View {
        "iso".parse::<Camera>().unwrap().view()
    }

    #[test]
    fn faces_between_drawn_cells_are_left_out() {
        let cells = [Cell::new(0, 0, 0), Cell::new(1, 0, 0)];
        let owner = Owner::Module(ModuleId(0));
        let alone = Filled { drawn: cells[..1].iter().copied().collect(), cut: BTreeSet::new() };
        assert_eq!(of_cell(&iso(), owner, cells[0], &alone).facets.len(), 3);
        // The camera sees −y, +x and +z.
        let both = Filled { drawn: cells.into(), cut: BTreeSet::new() };
        assert_eq!(of_cell(&iso(), owner, cells[0], &both).facets.len(), 2);
        assert_eq!(of_cell(&iso(), owner, cells[1], &both).facets.len(), 3);
        // Beyond a section the face is seen, as a cut.
        let cut =
            Filled { drawn: cells[..1].iter().copied().collect(), cut: cells[1..].iter().copied().collect() };
        let seen = of_cell(&iso(), owner, cells[0], &cut);
        assert_eq!(seen.facets.iter().map(|f| f.cut).collect::<Vec<_>>(), {
            let mut expected = vec![false; 3];
            expected[seen.facets.iter().position(|f| f.cut).unwrap()] = true;
            expected
        });
    }

    /// The outline of two halves together is that of the ball, where no plate cuts it.
    #[test]
    fn halves_of_a_ball_have_its_outline() {
        let shape = Shape::HalfCube { radius: 0.58, half_edge: 0.5 };
        let cell = Cell::new(0, 0, 0);
        for turn in [0.0, 0.4, 2.0] {
            let rotation = UnitQuaternion::from_euler_angles(turn, 0.3 * turn, 1.1);
            let part = Part::in_cell(shape, cell, rotation, Tone::Plain);
            let solid = of_part(&iso(), ModuleId(0), &part, &Filled::default());
            let points = &solid.facets[0].points;
            let middle = iso().project([0.0, 0.0, 0.5]);
            let far = points.iter().map(|p| (p[0] - middle[0]).hypot(p[1] - middle[1]));
            let most = far.fold(0.0, f64::max);
            assert!((0.5..0.581).contains(&most), "{most}");
            assert!(points.len() > 20, "{}", points.len());
        }
    }
}
