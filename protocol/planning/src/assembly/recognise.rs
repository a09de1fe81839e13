//! Recognises structures: the name of a shape, its symmetries, and the metamodules in it.

use super::configuration::Configuration;
use super::named;
use super::shape::{Bar, Shape};
use super::tables::TABLES;
use metamorph_roombots::Kind;
use serde::Serialize;

/// Name and figures of a known structure.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Recognised {
    /// Its name, such as `loop:3x3`.
    pub name: Option<String>,
    /// The number of modules.
    pub modules: usize,
    /// The number of joined faces.
    pub joins: usize,
    /// The number of rotations that map it onto itself.
    pub symmetries: usize,
    /// True if no rotation maps it onto its mirror image.
    pub chiral: bool,
    /// Pairs of modules that are joined C3X to C0X, with their kind; of configurations only.
    pub metamodules: Vec<(usize, usize, Kind)>,
}

/// Recognises a shape, and in a configuration of this shape the metamodules.
pub fn recognise(shape: &Shape, configuration: Option<&Configuration>) -> Recognised {
    let form = shape.canonical();
    let n = shape.len();
    let loops = (2..=n).map(|w| format!("loop:{w}x{}", (n + 2).saturating_sub(w)));
    let names = [format!("line:{n}"), format!("ell:{n}"), format!("zigzag:{n}"), format!("quadruped:{n}")];
    let mut names = names.into_iter().chain(loops);
    let name = names.find(|name| named::shape(name).is_ok_and(|s| s.len() == n && s.canonical() == form));
    let symmetries = shape.key(&mut vec![0; Shape::key_width(n)]);
    Recognised {
        name,
        modules: n,
        joins: shape.joins().len(),
        symmetries,
        chiral: mirrored(shape).canonical() != form,
        metamodules: configuration.map(metamodules).unwrap_or_default(),
    }
}

/// Returns the mirror image x ↔ y.
pub fn mirrored(shape: &Shape) -> Shape {
    let face = |f: u8| [2, 3, 0, 1, 4, 5][usize::from(f)];
    let faces = |set: u8| (0..6).filter(|f| set & 1 << f != 0).map(|f| 1 << face(f)).sum();
    let mut image = *shape;
    for bar in image.bars_mut() {
        let [x, y, z] = bar.cell;
        *bar = Bar { cell: [y, x, z], direction: face(bar.direction), joined: bar.joined.map(faces) };
    }
    image
}

fn metamodules(configuration: &Configuration) -> Vec<(usize, usize, Kind)> {
    /// The number of connector C0X.
    const C0X: u8 = 0;
    /// The number of connector C3X.
    const C3X: u8 = 7;
    let t = &**TABLES;
    let mut found = Vec::new();
    for pair in configuration.connections() {
        let (first, second) = match (pair.a.1, pair.b.1) {
            (C3X, C0X) => (pair.a.0, pair.b.0),
            (C0X, C3X) => (pair.b.0, pair.a.0),
            _ => continue,
        };
        let [a, b] = [first, second].map(|m| configuration.modules()[usize::from(m)]);
        let last = t.times(a.rotation, t.hemisphere[usize::from(a.posture)][3]);
        let relative = t.times(t.inverse[usize::from(last)], b.rotation);
        let class = t.rotations[usize::from(relative)].class();
        let kind = class.and_then(|k| Kind::METAMODULES.into_iter().find(|kind| kind.quarter_turns() == k));
        found.extend(kind.map(|kind| (usize::from(first), usize::from(second), kind)));
    }
    found.sort_unstable();
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn named_shapes_are_recognised_with_their_symmetries() {
        for (name, symmetries) in [("line:4", 8), ("loop:3x3", 4), ("loop:2x3", 2), ("ell:4", 1)] {
            let found = recognise(&named::shape(name).unwrap(), None);
            let expected = (Some(name), symmetries, false);
            assert_eq!((found.name.as_deref(), found.symmetries, found.chiral), expected);
        }
        // Along x, then y, then z: a screw.
        let bars = [[[0, 0, 0], [1, 0, 0]], [[1, 1, 0], [1, 2, 0]], [[1, 2, 1], [1, 2, 2]]];
        let screw =
            crate::assembly::structure::joined(&bars, &[[bars[0][1], bars[1][0]], [bars[1][1], bars[2][0]]]);
        let found = recognise(&screw.unwrap(), None);
        assert_eq!((found.name, found.symmetries, found.chiral), (None, 1, true));
        let line = named::line(&[0, 1, 2]).unwrap();
        let found = recognise(&Shape::of(&line), Some(&line));
        assert_eq!(found.metamodules, [(0, 1, Kind::Par), (1, 2, Kind::Srs), (2, 3, Kind::Per)]);
    }
}
