//! Shapes as written in a scenario, with the places of their parts. Shapes from files become cells in
//! the crate `metamorph-shapes`.

use super::diagnostics::{At, Diagnostics, Place};
use super::error::{MAX_DEPTH, MAX_LAID_OUT, MAX_MODULES, MAX_VOLUME, ScenarioError};
use super::family::SectionKind;
use super::table::{Node, Read, Section, elements};
use metamorph_core::lattice::Cell;
use metamorph_core::shape::{Axis, Radius, Shape, ShapeError, components};
use metamorph_shapes::{Import, Part, Up, import};
use serde::Deserialize;
use serde::de::IntoDeserializer;
use serde::de::value::Error as ValueError;
use std::collections::BTreeSet;

const EXAMPLE: &str = "{ box = { min = [0, 0, 0], max = [3, 3, 0] } }";
/// The kinds of shapes, by their keys.
pub const KINDS: [&str; 9] =
    ["box", "sphere", "disc", "cylinder", "cells", "file", "union", "difference", "intersection"];
const FILE: &str = "{ file = { path = \"table.stl\", pitch = 10 } }";
/// Which axis of a mesh points up.
pub const UPS: [(&str, Up); 2] = [("z", Up::Z), ("y", Up::Y)];
/// Which part of a configuration of VisibleSim is meant.
pub const PARTS: [(&str, Part); 2] = [("blocks", Part::Blocks), ("targets", Part::Targets)];
/// Treatment of parts thinner than a cell, the default first; true if they are dropped.
pub const THIN: [(&str, bool); 2] = [("refuse", false), ("drop", true)];
/// Treatment of inner voids, the default first; true if they are filled.
pub const VOIDS: [(&str, bool); 2] = [("keep", false), ("fill", true)];
/// The axis of a round shape.
pub const AXES: [(&str, Axis); 3] = [("x", Axis::X), ("y", Axis::Y), ("z", Axis::Z)];

impl Read for Shape {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Shape> {
        shape(node, 0, diagnostics)
    }
}

fn shape(node: &Node<'_>, depth: usize, diagnostics: &mut Diagnostics) -> Option<Shape> {
    if depth > MAX_DEPTH {
        diagnostics.add(node.span(), ScenarioError::TooDeep);
        return None;
    }
    let mut section = Section::of(node, "a shape", EXAMPLE, diagnostics)?;
    let present = section.present(&KINDS);
    section.differs_between_families(SectionKind::Shape);
    let nodes: Vec<_> = KINDS.iter().filter_map(|kind| Some((*kind, section.node(kind)?))).collect();
    section.finish(diagnostics);
    let [(kind, inner)] = nodes[..] else {
        if present.is_empty() {
            let (expected, found) = ("a shape", "a table without one");
            diagnostics.add(node.span(), ScenarioError::Kind { expected, found, example: EXAMPLE });
        } else {
            let (expected, found) = ("one shape", "several in one table; combine them with `union`");
            diagnostics.add(node.span(), ScenarioError::Kind { expected, found, example: EXAMPLE });
        }
        return None;
    };
    match kind {
        "union" => parts(inner, depth, diagnostics).map(Shape::Union),
        "difference" => parts(inner, depth, diagnostics).map(Shape::Difference),
        "intersection" => parts(inner, depth, diagnostics).map(Shape::Intersection),
        "cells" => cells(inner, diagnostics).map(Shape::Cells),
        "file" => file(inner, diagnostics).map(Shape::Cells),
        _ => primitive(kind, inner, diagnostics),
    }
}

fn primitive(kind: &str, inner: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Shape> {
    let mut section = Section::of(inner, &format!("a {kind}"), EXAMPLE, diagnostics)?;
    let shape = match kind {
        "box" => {
            let min = section.need::<Cell>("min", "min = [0, 0, 0]", diagnostics);
            let max = section.need::<Cell>("max", "max = [3, 3, 0]", diagnostics);
            min.zip(max).map(|(min, max)| Shape::Box { min: min.value, max: max.value })
        }
        "cylinder" => {
            let base = section.need::<Cell>("base", "base = [0, 0, 0]", diagnostics);
            let radius = section.need::<Radius>("radius", "radius = 4", diagnostics);
            let height = section.need::<u64>("height", "height = 3", diagnostics);
            let axis = section.choice("axis", "axis", &AXES, diagnostics).unwrap_or_default();
            base.zip(radius).zip(height).map(|((base, radius), height)| Shape::Cylinder {
                base: base.value,
                radius: radius.value,
                height: u16::try_from(height.value).unwrap_or(u16::MAX),
                axis,
            })
        }
        round => {
            let center = section.need::<Cell>("center", "center = [0, 0, 0]", diagnostics);
            let radius = section.need::<Radius>("radius", "radius = 4", diagnostics);
            let axis = if round == "disc" {
                section.choice("axis", "axis", &AXES, diagnostics).unwrap_or_default()
            } else {
                Axis::default()
            };
            center.zip(radius).map(|(At { value: center, .. }, At { value: radius, .. })| match round {
                "disc" => Shape::Disc { center, radius, axis },
                _ => Shape::Sphere { center, radius },
            })
        }
    };
    section.finish(diagnostics);
    shape
}

fn parts(node: &Node<'_>, depth: usize, diagnostics: &mut Diagnostics) -> Option<Vec<Shape>> {
    let array = elements(node, "[{ … }, { … }]", diagnostics)?;
    let parts: Vec<Shape> = array.iter().filter_map(|part| shape(part, depth + 1, diagnostics)).collect();
    (parts.len() == array.len()).then_some(parts)
}

/// Reads explicit cells. Duplicates are found here and not later, so that the error points at the second one.
fn cells(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Vec<Cell>> {
    let array = elements(node, "[[0, 0, 0], [1, 0, 0]]", diagnostics)?;
    let (mut cells, mut seen) = (Vec::new(), BTreeSet::new());
    for element in array.iter() {
        let cell = Cell::read(element, diagnostics)?;
        if !seen.insert(cell) {
            diagnostics.add(element.span(), ShapeError::Twice(cell));
            return None;
        }
        cells.push(cell);
    }
    Some(cells)
}

/// Reads a shape from a file.
fn file(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Vec<Cell>> {
    let mut section = Section::of(node, "a file", FILE, diagnostics)?;
    let path = section.need::<String>("path", "path = \"table.stl\"", diagnostics);
    let pitch = section.get::<f64>("pitch", diagnostics);
    let up = section.choice("up", "axis", &UPS, diagnostics);
    let at = section.get::<Cell>("at", diagnostics);
    let part = section.choice("part", "part", &PARTS, diagnostics);
    let drop_thin = section.choice("thin", "treatment of thin parts", &THIN, diagnostics);
    let fill_voids = section.choice("voids", "treatment of voids", &VOIDS, diagnostics);
    section.finish(diagnostics);
    let At { value: path, place } = path?;
    let how = Import {
        pitch: pitch.map(|p| p.value),
        up,
        at: at.map_or(Cell::default(), |at| at.value),
        part,
        drop_thin: drop_thin.unwrap_or_default(),
        fill_voids: fill_voids.unwrap_or_default(),
    };
    let name = path;
    let path = diagnostics.file(&name);
    let path = diagnostics.note(&place, path)?;
    let imported = diagnostics.note(&place, import(&diagnostics.sources(), &path, &how))?;
    for note in imported.notes {
        diagnostics.remark(format!("{name}: {note}"));
    }
    match imported.thin {
        Some(thin) if !how.drop_thin => {
            diagnostics.add(place, thin);
            None
        }
        _ => Some(imported.cells),
    }
}

impl Read for Radius {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Radius> {
        let cells = f64::read(node, diagnostics)?;
        let radius: Result<Radius, ValueError> = Radius::deserialize(cells.into_deserializer());
        if radius.is_err() {
            let (low, high) = ("0".into(), Cell::LIMIT.to_string());
            diagnostics.add(
                node.span(),
                ScenarioError::Range { what: "the radius", got: cells.to_string(), low, high },
            );
        }
        radius.ok()
    }
}

/// Lays out the shapes of one scenario, within limits of time and memory for all together.
#[derive(Debug, Default)]
pub struct Layout {
    /// Cells visited so far.
    looked_at: u64,
}

impl Layout {
    /// Returns the cells of a shape.
    pub fn cells(&mut self, shape: &Shape) -> Result<Vec<Cell>, ScenarioError> {
        self.looked_at = self.looked_at.saturating_add(volume(shape));
        if self.looked_at > MAX_LAID_OUT {
            return Err(ScenarioError::TooMuch(self.looked_at));
        }
        Ok(shape.cells()?)
    }

    /// Returns the cells of the modules at the start, which must be connected; `None` if they cannot be laid out.
    pub fn start(&mut self, start: &At<Shape>, diagnostics: &mut Diagnostics) -> Option<Vec<Cell>> {
        let cells = diagnostics.note(&start.place, self.cells(&start.value))?;
        if cells.len() > MAX_MODULES {
            diagnostics.add(start.place.clone(), ScenarioError::TooMany(cells.len()));
            return None;
        }
        let parts = components(&cells);
        if parts.len() > 1 {
            let examples: Vec<String> = parts.iter().take(4).map(|part| part[0].to_string()).collect();
            let mut examples = examples.join(", ");
            if parts.len() > 4 {
                examples.push_str(", …");
            }
            diagnostics
                .add(start.place.clone(), ScenarioError::DisconnectedStart { count: parts.len(), examples });
        }
        Some(cells)
    }
}

/// Returns the sum of the sides of the box around all cells; `None` if the box is too large for memory.
pub fn check_box<'c>(cells: impl Iterator<Item = &'c Cell>, diagnostics: &mut Diagnostics) -> Option<u64> {
    let sides = sides(cells);
    let volume = sides.iter().product();
    if volume > MAX_VOLUME {
        diagnostics.add(Place::File, ScenarioError::TooWide(volume));
        return None;
    }
    Some(sides.iter().sum())
}

/// Returns the sides of the box around cells.
pub fn sides<'c>(cells: impl Iterator<Item = &'c Cell>) -> [u64; 3] {
    let mut bounds: Option<([i16; 3], [i16; 3])> = None;
    for cell in cells {
        let at: [i16; 3] = (*cell).into();
        let (min, max) = bounds.get_or_insert((at, at));
        for axis in 0..3 {
            min[axis] = min[axis].min(at[axis]);
            max[axis] = max[axis].max(at[axis]);
        }
    }
    let (min, max) = bounds.unwrap_or_default();
    [0, 1, 2].map(|axis: usize| u64::from(max[axis].abs_diff(min[axis])) + 1)
}

/// Returns the cells visited to lay a shape out.
fn volume(shape: &Shape) -> u64 {
    let side = |a: i16, b: i16| (i64::from(b) - i64::from(a)).max(0).unsigned_abs() + 1;
    // A radius shows its length only as text.
    let diameter =
        |r: &Radius| serde_json::to_value(r).ok().and_then(|v| v.as_f64()).unwrap_or(0.0) as u64 * 2 + 1;
    match shape {
        Shape::Box { min, max } => side(min.x, max.x) * side(min.y, max.y) * side(min.z, max.z),
        Shape::Sphere { radius, .. } => diameter(radius).pow(3),
        Shape::Disc { radius, .. } => diameter(radius).pow(2),
        Shape::Cylinder { radius, height, .. } => diameter(radius).pow(2) * u64::from(*height),
        Shape::Cells(cells) => cells.len() as u64,
        Shape::Union(parts) | Shape::Difference(parts) | Shape::Intersection(parts) => {
            parts.iter().fold(0, |sum: u64, part| sum.saturating_add(volume(part)))
        }
    }
}
