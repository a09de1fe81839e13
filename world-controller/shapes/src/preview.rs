//! Shows cells to people: as layers of text, as a drawing, and as a scenario that builds them.

use super::printability::corners;
use metamorph_core::goal::Growth;
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::shape::Shape;
use std::collections::BTreeSet;
use std::fmt::Write;

/// Largest number of columns of a layer that is shown.
const COLUMNS_MAX: usize = 110;
/// Largest number of lines of all layers together.
const LINES_MAX: usize = 400;
/// The maximum number of layers of the start slab; the slab is made wide enough for that.
const THICKEST: usize = 3;

/// Spare modules in a written scenario, in percent of the goal cells.
const SPARE: usize = 10;

/// Returns the layers from lowest to highest, north at the top; `None` if they are too large.
pub fn layers(cells: &[Cell]) -> Option<String> {
    let (min, max) = corners(cells)?;
    let side = |low: i16, high: i16| usize::from(low.abs_diff(high)) + 1;
    if side(min.x, max.x) > COLUMNS_MAX || side(min.z, max.z) * (side(min.y, max.y) + 2) > LINES_MAX {
        return None;
    }
    let mut out = String::new();
    for z in min.z..=max.z {
        let _ = writeln!(out, "z = {z}");
        for y in (min.y..=max.y).rev() {
            let filled = |x: i16| cells.binary_search(&Cell::new(x, y, z)).is_ok();
            let line: String = (min.x..=max.x).map(|x| if filled(x) { '#' } else { '.' }).collect();
            let _ = writeln!(out, "  {line}");
        }
    }
    Some(out)
}

/// Draws the cubes, seen from above the south-east corner.
pub fn svg(cells: &[Cell]) -> String {
    /// Length of the edge of a cube in pixels.
    const EDGE: f64 = 12.0;
    let filled: BTreeSet<Cell> = cells.iter().copied().collect();
    let project = |x: f64, y: f64, z: f64| [(x + y) * 0.866 * EDGE, (x - y) * 0.5 * EDGE - z * EDGE];
    // The side, its corners in the unit cube, and its shade.
    let sides: [(Face, [[f64; 3]; 4], &str); 3] = [
        (Face::Up, [[0., 0., 1.], [1., 0., 1.], [1., 1., 1.], [0., 1., 1.]], "#9ecae1"),
        (Face::South, [[0., 0., 0.], [1., 0., 0.], [1., 0., 1.], [0., 0., 1.]], "#4292c6"),
        (Face::East, [[1., 0., 0.], [1., 1., 0.], [1., 1., 1.], [1., 0., 1.]], "#2171b5"),
    ];
    // Nearer cubes are drawn later.
    let mut order: Vec<&Cell> = cells.iter().collect();
    order.sort_by_key(|c| (i32::from(c.x) - i32::from(c.y) + i32::from(c.z), **c));
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let mut faces = String::new();
    for cell in order {
        for (face, corners, shade) in &sides {
            if filled.contains(&cell.step(*face)) {
                continue;
            }
            let points: Vec<String> = corners
                .iter()
                .map(|[x, y, z]| {
                    let at = project(x + f64::from(cell.x), y + f64::from(cell.y), z + f64::from(cell.z));
                    for axis in 0..2 {
                        low[axis] = low[axis].min(at[axis]);
                        high[axis] = high[axis].max(at[axis]);
                    }
                    format!("{:.1},{:.1}", at[0], at[1])
                })
                .collect();
            let _ = writeln!(faces, "<polygon points=\"{}\" fill=\"{shade}\"/>", points.join(" "));
        }
    }
    let [x, y] = low.map(|c| c - EDGE);
    let (width, height) = (high[0] - x + EDGE, high[1] - y + EDGE);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"{x:.1} {y:.1} {width:.1} {height:.1}\" \
         width=\"{width:.0}\" height=\"{height:.0}\">\n<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"100%\" height=\"100%\" \
         fill=\"white\"/>\n<g stroke=\"#08306b\" stroke-width=\"0.6\" stroke-linejoin=\"round\">\n{faces}</g>\n</svg>\n"
    )
}

/// Returns a slab on the floor of the goal with room for `modules` modules, at least as wide as the goal.
pub fn slab(goal: &[Cell], modules: usize) -> Option<(Cell, Cell)> {
    let (mut min, mut max) = corners(goal)?;
    let side = |low: i16, high: i16| usize::from(low.abs_diff(high)) + 1;
    while side(min.x, max.x) * side(min.y, max.y) * THICKEST < modules {
        (min.x, min.y, max.x, max.y) = (min.x - 1, min.y - 1, max.x + 1, max.y + 1);
    }
    let thick = modules.div_ceil(side(min.x, max.x) * side(min.y, max.y)).max(1);
    max.z = min.z + thick as i16 - 1;
    Some((min, max))
}

/// Returns the cells of modules that build a goal: a slab on its floor, with some spare ones.
pub fn start(goal: &[Cell]) -> Vec<Cell> {
    let modules = goal.len() + goal.len() * SPARE / 100 + 1;
    let slab = slab(goal, modules).map(|(min, max)| Shape::Box { min, max }.cells());
    // A slab has cells; reading the scenario reports one out of range.
    slab.and_then(Result::ok).unwrap_or_default()
}

/// The contents of a scenario to be written.
pub struct Written<'a> {
    /// Where it comes from, for its first line.
    pub origin: &'a str,
    /// Its name.
    pub name: &'a str,
    /// The start cells.
    pub start: &'a [Cell],
    /// The goal cells.
    pub goal: &'a [Cell],
    /// The growth of the goal.
    pub growth: Growth,
}

/// Returns the text of a runnable scenario.
pub fn scenario(written: &Written<'_>) -> String {
    let text = |text: &str| toml::Value::String(text.to_owned()).to_string();
    let growth = match written.growth {
        Growth::Scaffold => "scaffold",
        Growth::Solid => "solid",
    };
    format!(
        "# Written by `metamorph {}.\nversion = 1\nname = {}\n\n[swarm]\n\n[swarm.start]\n{}\n\
         [[goal]]\nname = {}\ngrowth = \"{growth}\"\n\n[goal.shape]\n{}",
        written.origin.chars().map(|c| if c.is_control() { ' ' } else { c }).collect::<String>(),
        text(written.name),
        union(written.start),
        text(written.name),
        union(written.goal),
    )
}

fn union(cells: &[Cell]) -> String {
    let mut out = "union = [\n".to_owned();
    for (min, max) in boxes(cells) {
        let _ = writeln!(out, "    {{ box = {{ min = {min}, max = {max} }} }},");
    }
    out + "]\n"
}

/// Splits cells into disjoint boxes: each extends from the first remaining cell as far as possible along x,
/// then y, then z.
fn boxes(cells: &[Cell]) -> Vec<(Cell, Cell)> {
    let mut left: BTreeSet<Cell> = cells.iter().copied().collect();
    let mut boxes = Vec::new();
    while let Some(min) = left.first().copied() {
        let mut max = min;
        let all = |low: Cell, high: Cell| {
            let line = |x: i16, y: i16| (low.z..=high.z).all(|z| left.contains(&Cell::new(x, y, z)));
            (low.x..=high.x).all(|x| (low.y..=high.y).all(|y| line(x, y)))
        };
        while all(Cell::new(max.x + 1, min.y, min.z), Cell::new(max.x + 1, max.y, max.z)) {
            max.x += 1;
        }
        while all(Cell::new(min.x, max.y + 1, min.z), Cell::new(max.x, max.y + 1, max.z)) {
            max.y += 1;
        }
        while all(Cell::new(min.x, min.y, max.z + 1), Cell::new(max.x, max.y, max.z + 1)) {
            max.z += 1;
        }
        for x in min.x..=max.x {
            for y in min.y..=max.y {
                for z in min.z..=max.z {
                    left.remove(&Cell::new(x, y, z));
                }
            }
        }
        boxes.push((min, max));
    }
    boxes
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_core::shape::{Radius, Shape};

    #[test]
    fn boxes_are_the_same_cells() {
        let ball = Shape::Sphere { center: Cell::new(3, -2, 1), radius: Radius::cells(4) }.cells().unwrap();
        let mut again: Vec<Cell> = Vec::new();
        let boxes = boxes(&ball);
        for (min, max) in &boxes {
            again.extend(Shape::Box { min: *min, max: *max }.cells().unwrap());
        }
        again.sort_unstable();
        assert_eq!(again, ball);
        assert!(boxes.len() * 3 < ball.len(), "{} boxes", boxes.len());
    }

    #[test]
    fn a_slab_has_room_for_all_and_covers_the_floor() {
        let tower = Shape::Box { min: Cell::new(0, 0, 2), max: Cell::new(1, 1, 40) }.cells().unwrap();
        let (min, max) = slab(&tower, tower.len()).unwrap();
        let modules = Shape::Box { min, max }.cells().unwrap();
        assert!(modules.len() >= tower.len() && max.z - min.z < 3, "{min} {max}");
        assert!(modules.contains(&tower[0]));
    }

    #[test]
    fn layers_stand_one_above_the_other() {
        let cells = [Cell::new(0, 0, 0), Cell::new(0, 0, 1), Cell::new(1, 1, 1)];
        assert_eq!(layers(&cells).unwrap(), "z = 0\n  ..\n  #.\nz = 1\n  .#\n  #.\n");
    }
}
