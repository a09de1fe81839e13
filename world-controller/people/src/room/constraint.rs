//! Constraints on the pieces of a room, and a check for violations (without the reach of metamodules, see `reach`).

use super::model::{Area, Piece, Room};
use super::walkway::Free;
use metamorph_protocol::lattice::Cell;
use serde::Serialize;
use std::collections::BTreeSet;
use std::f64::consts::TAU;

/// Cells that a violation names at most.
const MAX_NAMED: usize = 64;

/// Along which axis pieces are in line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Axis {
    /// In a row from west to east.
    X,
    /// In a row from south to north.
    Y,
}

/// One rule. Pieces are numbers in the list of the room.
#[derive(Clone, Debug, PartialEq)]
pub enum Rule {
    /// All cells are in the room, and not in a keep-out box.
    Inside,
    /// No two pieces share a cell.
    Apart,
    /// At least this many free connectors are between two pieces.
    Gap(usize, usize, u16),
    /// At most this many.
    Near(usize, usize, u16),
    /// The piece stands at a wall.
    Wall(usize),
    /// The front of the first looks to the second.
    Facing(usize, usize),
    /// The middles are in line.
    Align(Vec<usize>, Axis),
    /// The pieces stand in a circle around one.
    Circle {
        /// Those in the circle.
        pieces: Vec<usize>,
        /// The one in its middle.
        around: usize,
        /// The radius in cells.
        radius: f64,
        /// By how much a distance may differ from it.
        tolerance: f64,
    },
    /// No piece is in an area.
    Clear(Area),
    /// A square of this many connectors can go from a door to every piece.
    Walkway(u16),
    /// Metamodules reach every place of every piece from the store.
    Reach,
}

impl Rule {
    /// Its name in files.
    pub const fn name(&self) -> &'static str {
        match self {
            Rule::Inside => "inside",
            Rule::Apart => "apart",
            Rule::Gap(..) => "gap",
            Rule::Near(..) => "near",
            Rule::Wall(_) => "wall",
            Rule::Facing(..) => "facing",
            Rule::Align(..) => "align",
            Rule::Circle { .. } => "circle",
            Rule::Clear(_) => "clear",
            Rule::Walkway(_) => "walkway",
            Rule::Reach => "reach",
        }
    }
}

/// A rule, and whether it has to be kept.
#[derive(Clone, Debug, PartialEq)]
pub struct Constraint {
    /// The rule.
    pub rule: Rule,
    /// True if it is only wished for.
    pub wish: bool,
}

/// A violated constraint.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Violation {
    /// The name of the rule.
    pub rule: &'static str,
    /// The number of the constraint in the file, from 1; `None` for `inside` and `apart`.
    pub constraint: Option<usize>,
    /// Whether it was only wished for.
    pub wish: bool,
    /// The pieces whose moves may mend it.
    pub pieces: Vec<String>,
    /// The cells where it is violated.
    pub cells: Vec<Cell>,
    /// Description of the violation.
    pub why: String,
    /// The pieces by number.
    #[serde(skip)]
    pub movers: Vec<usize>,
}

/// One violation, before it is known which constraint it belongs to.
pub(super) struct Found {
    pub movers: Vec<usize>,
    pub cells: Vec<Cell>,
    pub why: String,
}

/// Returns all violations; those of `inside` and `apart` first, then by constraint. `reach` is not judged here.
pub fn check(room: &Room) -> Vec<Violation> {
    check_while(room, &|| true)
}

/// Returns the violations that are found while `going` holds.
pub fn check_while(room: &Room, going: &dyn Fn() -> bool) -> Vec<Violation> {
    let mut all = Vec::new();
    visit(room, going, &mut |violation| {
        all.push(violation);
        true
    });
    all
}

/// Returns the first violation of what is not just wished for.
pub fn first(room: &Room) -> Option<Violation> {
    let mut first = None;
    visit(room, &|| true, &mut |violation| {
        if !violation.wish {
            first = Some(violation);
        }
        first.is_none()
    });
    first
}

/// Hands out violations one by one, until `take` or `going` returns false.
fn visit(room: &Room, going: &dyn Fn() -> bool, take: &mut dyn FnMut(Violation) -> bool) {
    let built_in = [Rule::Inside, Rule::Apart].map(|rule| Constraint { rule, wish: false });
    let numbered = room.constraints.iter().enumerate().map(|(i, c)| (Some(i + 1), c));
    for (number, constraint) in built_in.iter().map(|c| (None, c)).chain(numbered) {
        if !going() {
            return;
        }
        for found in judge(room, &constraint.rule) {
            if !take(violation(room, number, constraint, found)) {
                return;
            }
        }
    }
}

pub(super) fn violation(
    room: &Room,
    number: Option<usize>,
    constraint: &Constraint,
    mut found: Found,
) -> Violation {
    found.cells.truncate(MAX_NAMED);
    Violation {
        rule: constraint.rule.name(),
        constraint: number,
        wish: constraint.wish,
        pieces: found.movers.iter().map(|p| room.pieces[*p].name.clone()).collect(),
        cells: found.cells,
        why: found.why,
        movers: found.movers,
    }
}

fn judge(room: &Room, rule: &Rule) -> Vec<Found> {
    let one = |found: Option<Found>| found.into_iter().collect();
    match rule {
        Rule::Inside => (0..room.pieces.len()).filter_map(|p| inside(room, p)).collect(),
        Rule::Apart => apart(room),
        Rule::Gap(a, b, least) => one(gap(room, *a, *b, *least..=u16::MAX)),
        Rule::Near(a, b, most) => one(gap(room, *a, *b, 0..=*most)),
        Rule::Wall(p) => one(wall(room, *p)),
        Rule::Facing(a, b) => one(facing(room, *a, *b)),
        Rule::Align(pieces, axis) => one(align(room, pieces, *axis)),
        Rule::Circle { pieces, around, radius, tolerance } => {
            one(circle(room, pieces, *around, *radius, *tolerance))
        }
        Rule::Clear(area) => (0..room.pieces.len()).filter_map(|p| clear(room, p, *area)).collect(),
        Rule::Walkway(width) => walkway(room, *width),
        // Judged by `reach`, which needs the motions of metamodules.
        Rule::Reach => Vec::new(),
    }
}

fn inside(room: &Room, p: usize) -> Option<Found> {
    let piece = &room.pieces[p];
    let out = |c: &Cell| {
        !room.has((c.x, c.y)) || c.z >= room.height || room.keep_out.iter().any(|block| block.has(*c))
    };
    let cells: Vec<Cell> = piece.cells().filter(out).collect();
    let first = *cells.first()?;
    let why = match room.keep_out.iter().any(|block| block.has(first)) {
        true => format!("{} is in a keep-out box at {first}", piece.name),
        false => format!("{} is outside of the room at {first}", piece.name),
    };
    Some(Found { movers: vec![p], cells, why })
}

fn overlap(a: Area, b: Area) -> bool {
    a.min.0 <= b.max.0 && b.min.0 <= a.max.0 && a.min.1 <= b.max.1 && b.min.1 <= a.max.1
}

fn apart(room: &Room) -> Vec<Found> {
    let areas: Vec<Area> = room.pieces.iter().map(Piece::area).collect();
    let mut all = Vec::new();
    for (a, one) in room.pieces.iter().enumerate() {
        for (b, other) in
            room.pieces.iter().enumerate().skip(a + 1).filter(|(b, _)| overlap(areas[a], areas[*b]))
        {
            let mine: BTreeSet<Cell> = one.cells().collect();
            let cells: Vec<Cell> = other.cells().filter(|c| mine.contains(c)).collect();
            if let Some(first) = cells.first() {
                let why = format!("{} and {} both need the cell {first}", one.name, other.name);
                all.push(Found { movers: vec![a, b], cells, why });
            }
        }
    }
    all
}

/// Returns the free connectors between two pieces, seen from above, and the columns that are closest.
fn between(a: &Piece, b: &Piece) -> (u16, Vec<Cell>) {
    let pairs = a.columns().flat_map(|p| b.columns().map(move |q| (p, q)));
    let far = |(p, q): &((i16, i16), (i16, i16))| p.0.abs_diff(q.0).max(p.1.abs_diff(q.1));
    // Invariant: every piece has a column.
    let (p, q) = pairs.min_by_key(far).unwrap_or_default();
    (far(&(p, q)).saturating_sub(1), vec![Cell::new(p.0, p.1, 0), Cell::new(q.0, q.1, 0)])
}

fn gap(room: &Room, a: usize, b: usize, allowed: std::ops::RangeInclusive<u16>) -> Option<Found> {
    let (one, other) = (&room.pieces[a], &room.pieces[b]);
    let (free, cells) = between(one, other);
    let limit = match allowed.contains(&free) {
        true => return None,
        false if free < *allowed.start() => format!("at least {}", allowed.start()),
        false => format!("at most {}", allowed.end()),
    };
    let why = format!("{free} connectors are free between {} and {}, not {limit}", one.name, other.name);
    Some(Found { movers: vec![a, b], cells, why })
}

fn wall(room: &Room, p: usize) -> Option<Found> {
    let piece = &room.pieces[p];
    let Area { min, max } = piece.area();
    let touches = min.0 <= 0 || min.1 <= 0 || max.0 >= room.size.0 - 1 || max.1 >= room.size.1 - 1;
    let why = || format!("{} does not stand at a wall", piece.name);
    (!touches).then(|| Found { movers: vec![p], cells: piece.cells().collect(), why: why() })
}

fn facing(room: &Room, a: usize, b: usize) -> Option<Found> {
    let (one, other) = (&room.pieces[a], &room.pieces[b]);
    let ((ax, ay), (bx, by), (fx, fy)) = (one.centre2(), other.centre2(), one.front());
    let (dx, dy) = (bx - ax, by - ay);
    // Towards it by at least as much as to the side.
    let ahead = dx * fx + dy * fy;
    let aside = (dx * fy).abs() + (dy * fx).abs();
    let why = || format!("the front of {} does not look to {}", one.name, other.name);
    (ahead <= 0 || ahead < aside).then(|| Found {
        movers: vec![a, b],
        cells: one.cells().collect(),
        why: why(),
    })
}

fn align(room: &Room, pieces: &[usize], axis: Axis) -> Option<Found> {
    let across = |p: usize| match axis {
        Axis::X => room.pieces[p].centre2().1,
        Axis::Y => room.pieces[p].centre2().0,
    };
    let (low, high) =
        pieces.iter().map(|p| across(*p)).fold((i32::MAX, i32::MIN), |(l, h), c| (l.min(c), h.max(c)));
    // Middles of pieces of even and odd sizes are half a cell apart at best.
    if high - low <= 1 {
        return None;
    }
    let names: Vec<&str> = pieces.iter().map(|p| room.pieces[*p].name.as_str()).collect();
    let why = format!("the middles of {} differ by {} cells", names.join(", "), f64::from(high - low) / 2.0);
    let odd = |p: &&usize| across(**p) != low;
    let cells = pieces.iter().filter(odd).flat_map(|p| room.pieces[*p].cells()).collect();
    Some(Found { movers: pieces.to_vec(), cells, why })
}

fn circle(room: &Room, pieces: &[usize], around: usize, radius: f64, tolerance: f64) -> Option<Found> {
    let [x, y] = room.pieces[around].centre();
    let from = |p: &usize| {
        let [px, py] = room.pieces[*p].centre();
        (px - x, py - y)
    };
    let offsets: Vec<(f64, f64)> = pieces.iter().map(from).collect();
    let many = offsets.len() as f64;
    let centroid = offsets.iter().fold((0.0, 0.0), |(x, y), o| (x + o.0 / many, y + o.1 / many));
    let middle = &room.pieces[around].name;
    let found = |wrong: Vec<usize>, why: String| {
        let cells = wrong.iter().flat_map(|p| room.pieces[*p].cells()).collect();
        let movers = pieces.iter().copied().chain([around]).collect();
        Some(Found { movers, cells, why })
    };
    for (p, (dx, dy)) in pieces.iter().zip(&offsets) {
        let distance = libm::hypot(*dx, *dy);
        if (distance - radius).abs() > tolerance {
            let why = format!(
                "{} is {distance:.2} cells from {middle}, not {radius} by at most {tolerance}",
                room.pieces[*p].name
            );
            return found(vec![*p], why);
        }
    }
    let off = libm::hypot(centroid.0, centroid.1);
    if off > tolerance {
        return found(pieces.to_vec(), format!("the centroid of the circle is {off:.2} cells from {middle}"));
    }
    // How far each is from its place on the regular polygon that fits best.
    let mut angles: Vec<(f64, usize)> =
        pieces.iter().zip(&offsets).map(|(p, (dx, dy))| (libm::atan2(*dy, *dx), *p)).collect();
    angles.sort_by(|a, b| a.0.total_cmp(&b.0));
    let ahead: Vec<f64> = angles.iter().enumerate().map(|(i, (a, _))| a - TAU * i as f64 / many).collect();
    let (low, high) = ahead.iter().fold((f64::MAX, f64::MIN), |(l, h), a| (l.min(*a), h.max(*a)));
    if (high - low) / 2.0 * radius > 1.0 {
        let worst = ahead.iter().zip(&angles).max_by(|a, b| {
            let off = |a: &f64| (a - (low + high) / 2.0).abs();
            off(a.0).total_cmp(&off(b.0))
        });
        let why = format!("the angles around {middle} are not equal within one cell");
        return found(worst.map(|(_, (_, p))| *p).into_iter().collect(), why);
    }
    None
}

fn clear(room: &Room, p: usize, area: Area) -> Option<Found> {
    let piece = &room.pieces[p];
    let cells: Vec<Cell> = piece.cells().filter(|c| area.has((c.x, c.y))).collect();
    let first = cells.first()?;
    let why = format!("{} is in an area that has to be clear, at {first}", piece.name);
    Some(Found { movers: vec![p], cells, why })
}

fn walkway(room: &Room, width: u16) -> Vec<Found> {
    let free = Free::from_doors(room, width);
    let movers = || (0..room.pieces.len()).collect::<Vec<_>>();
    let cut_off = room.pieces.iter().filter(|piece| !free.touches(piece));
    let why = |piece: &Piece| match room.doors.is_empty() {
        true => "the room has no door".to_owned(),
        false => format!("no path {width} connectors wide leads from a door to {}", piece.name),
    };
    cut_off.map(|piece| Found { movers: movers(), cells: piece.cells().collect(), why: why(piece) }).collect()
}
