//! Shapes by name: line, loop, ell, zigzag, quadruped, and random trees.

use super::configuration::{Configuration, MAX_MODULES};
use super::shape::{Bar, Shape};
use super::tables::{STEP, Vec3, add, face_to};
use metamorph_core::rng::Rng;
use thiserror::Error;

/// Why a name gives no shape.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum NameError {
    /// The name is unknown.
    #[error("no shape is called `{0}`")]
    Unknown(String),
    /// The size cannot be read.
    #[error("`{size}` is not a size of a {name}; {expected}")]
    Size {
        /// The name.
        name: &'static str,
        /// The size as typed.
        size: String,
        /// A description of the expected size.
        expected: &'static str,
    },
    /// There are too many modules.
    #[error("{0} modules, but a plan of free modules has at most {MAX_MODULES}")]
    TooMany(u64),
}

/// Returns the shape of a name such as `line:4`, `loop:3x3`, `ell:4`, `zigzag:4`, `quadruped:6` or `tree:8x1`.
pub fn shape(name: &str) -> Result<Shape, NameError> {
    let (kind, size) = name.split_once(':').unwrap_or((name, ""));
    match kind {
        "line" => Ok(strip(&vec![0; 2 * count("line", size)?])),
        "ell" => {
            // The corner is where the second half of the modules begins.
            let n = count("ell", size)?;
            Ok(strip(&[vec![0; 2 * n.div_ceil(2)], vec![2; 2 * (n / 2)]].concat()))
        }
        "zigzag" => {
            // Each module at a right angle to the one before.
            let n = count("zigzag", size)?;
            Ok(strip(&(0..n).flat_map(|i| if i % 2 == 0 { [2, 0] } else { [0, 2] }).collect::<Vec<_>>()))
        }
        "loop" => ring(size),
        "quadruped" => quadruped(size),
        "tree" => tree(size),
        _ => Err(NameError::Unknown(name.to_owned())),
    }
}

/// Returns the straight line whose end-to-end connections have these rotations, all joints at 0.
pub fn line(types: &[u8]) -> Option<Configuration> {
    let n = types.len() + 1;
    let shape = shape(&format!("line:{n}")).ok()?;
    let mut class = 0;
    let mut classes = vec![0];
    for turn in types {
        class = (class + turn) % 4;
        classes.push(class);
    }
    let t = &**super::tables::TABLES;
    let mut filled = shape.filled(|_| (0, [0; 3]));
    let base = filled.modules()[0].rotation;
    for (m, class) in filled.modules_mut().iter_mut().zip(classes) {
        // About the axis of the line: in the frame of the module that is z.
        let turn = (0..class).fold(0, |r, _| t.times(r, t.quarter));
        let held = m.held;
        *m = super::configuration::Module { rotation: t.times(base, turn), held, ..*m };
    }
    Some(filled)
}

fn count(name: &'static str, size: &str) -> Result<usize, NameError> {
    let expected = "write the number of modules, such as 4";
    let n: u64 = size.parse().map_err(|_| NameError::Size { name, size: size.to_owned(), expected })?;
    match n {
        0 => Err(NameError::Size { name, size: size.to_owned(), expected }),
        1..=16 => Ok(n as usize),
        _ => Err(NameError::TooMany(n)),
    }
}

/// Cuts a strip of cells into modules; `steps[i]` is the face that leads to cell i, and `steps[0]` is not used.
fn strip(steps: &[u8]) -> Shape {
    let mut cells: Vec<Vec3> = vec![[0; 3]];
    for step in &steps[1..] {
        cells.push(add(cells[cells.len() - 1], STEP[usize::from(*step)]));
    }
    cut(&cells, false)
}

/// Cuts cells into modules of two; each is joined with the one before, and in a ring the last with the first.
fn cut(cells: &[Vec3], ring: bool) -> Shape {
    let face = |a: Vec3, b: Vec3| face_to(a, b).expect("consecutive cells touch");
    let mut bars: Vec<Bar> = cells
        .chunks_exact(2)
        .map(|c| Bar { cell: c[0], direction: face(c[0], c[1]), joined: [0; 2] })
        .collect();
    let n = bars.len();
    for i in if ring { 0..n } else { 1..n } {
        let before = (i + n - 1) % n;
        let f = face(cells[2 * before + 1], cells[2 * i]);
        bars[before].joined[1] |= 1 << f;
        bars[i].joined[0] |= 1 << (f ^ 1);
    }
    Shape::new(&bars).expect("invariant: counts are checked")
}

fn ring(size: &str) -> Result<Shape, NameError> {
    let expected = "write width and height in cells, at least 2x2 and with an even rim, such as 3x3";
    let wrong = || NameError::Size { name: "loop", size: size.to_owned(), expected };
    let (w, h) = size.split_once('x').ok_or_else(wrong)?;
    let (w, h): (u64, u64) = (w.parse().map_err(|_| wrong())?, h.parse().map_err(|_| wrong())?);
    if w < 2 || h < 2 {
        return Err(wrong());
    }
    // The rim has 2 (w + h) − 4 cells, two for each module.
    let modules = w.saturating_add(h) - 2;
    if modules > MAX_MODULES as u64 {
        return Err(NameError::TooMany(modules));
    }
    let mut cells: Vec<Vec3> = vec![[0; 3]];
    for (face, n) in [(0, w - 1), (2, h - 1), (1, w - 1), (3, h - 1)] {
        for _ in 0..n {
            cells.push(add(cells[cells.len() - 1], STEP[face]));
        }
    }
    cells.pop();
    Ok(cut(&cells, true))
}

fn quadruped(size: &str) -> Result<Shape, NameError> {
    type Pair = [Vec3; 2];
    let (modules, joined): (&[Pair], &[Pair]) = match size {
        "4" => (
            &[
                [[0, 0, 0], [1, 0, 0]],
                [[0, 1, 0], [0, 2, 0]],
                [[1, 1, 0], [1, 2, 0]],
                [[0, -1, 0], [0, -2, 0]],
            ],
            &[[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]], [[0, -1, 0], [0, 0, 0]]],
        ),
        "6" => (
            &[
                [[0, 0, 0], [1, 0, 0]],
                [[2, 0, 0], [3, 0, 0]],
                [[0, 1, 0], [0, 2, 0]],
                [[0, -2, 0], [0, -1, 0]],
                [[3, 1, 0], [3, 2, 0]],
                [[3, -2, 0], [3, -1, 0]],
            ],
            &[
                [[1, 0, 0], [2, 0, 0]],
                [[0, 0, 0], [0, 1, 0]],
                [[0, -1, 0], [0, 0, 0]],
                [[3, 0, 0], [3, 1, 0]],
                [[3, -1, 0], [3, 0, 0]],
            ],
        ),
        _ => {
            let expected = "there are quadruped:4 and quadruped:6";
            return Err(NameError::Size { name: "quadruped", size: size.to_owned(), expected });
        }
    };
    Ok(super::structure::joined(modules, joined).expect("invariant: the named shapes are whole"))
}

/// Draws a tree, given as number of modules and seed: each module is joined to an earlier one, anywhere it fits.
fn tree(size: &str) -> Result<Shape, NameError> {
    let expected = "write the number of modules and a seed, such as 8x1";
    let wrong = || NameError::Size { name: "tree", size: size.to_owned(), expected };
    let (n, seed) = size.split_once('x').ok_or_else(wrong)?;
    let (n, seed) = (count("tree", n)?, seed.parse().map_err(|_| wrong())?);
    let mut rng = Rng::named(seed, "tree", 0);
    let mut modules: Vec<[Vec3; 2]> = vec![[[0; 3], STEP[0]]];
    let mut joins = Vec::new();
    // There is always room beside the outermost cell.
    while modules.len() < n {
        let from = modules[rng.below(modules.len() as u64) as usize][rng.below(2) as usize];
        let mut next = |cell: Vec3| add(cell, STEP[rng.below(6) as usize]);
        let first = next(from);
        let second = next(first);
        if !modules.iter().flatten().any(|cell| *cell == first || *cell == second) {
            modules.push([first, second]);
            joins.push([from, first]);
        }
    }
    Ok(super::structure::joined(&modules, &joins).expect("invariant: modules fit and are joined"))
}
