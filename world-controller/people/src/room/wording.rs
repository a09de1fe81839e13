//! Constraints in words, and the pieces that each constraint refers to.

use super::constraint::{Axis, Rule};
use super::model::Room;

impl Rule {
    /// Returns what the rule asks for.
    pub fn text(&self, room: &Room) -> String {
        let name = |p: &usize| room.pieces[*p].name.as_str();
        let all = |pieces: &[usize]| pieces.iter().map(name).collect::<Vec<_>>().join(", ");
        match self {
            Rule::Inside => "all pieces are inside the room".to_owned(),
            Rule::Apart => "no two pieces share a cell".to_owned(),
            Rule::Gap(a, b, k) => format!("at least {k} free between {} and {}", name(a), name(b)),
            Rule::Near(a, b, k) => format!("at most {k} free between {} and {}", name(a), name(b)),
            Rule::Wall(p) => format!("{} stands at a wall", name(p)),
            Rule::Facing(a, b) => format!("{} faces {}", name(a), name(b)),
            Rule::Align(pieces, Axis::X) => format!("{} in a row from west to east", all(pieces)),
            Rule::Align(pieces, Axis::Y) => format!("{} in a row from south to north", all(pieces)),
            Rule::Circle { pieces, around, radius, tolerance } => {
                let around = name(around);
                format!("{} pieces around {around}, {radius} ± {tolerance} cells away", pieces.len())
            }
            Rule::Clear(area) => {
                let ((x0, y0), (x1, y1)) = (area.min, area.max);
                format!("nothing from ({x0}, {y0}) to ({x1}, {y1})")
            }
            Rule::Walkway(k) => format!("a way {k} wide from a door to every piece"),
            Rule::Reach => "metamodules reach every place from the store".to_owned(),
        }
    }

    /// Returns the pieces that the rule names; none if it is about all.
    pub fn pieces(&self) -> Vec<usize> {
        match self {
            Rule::Gap(a, b, _) | Rule::Near(a, b, _) | Rule::Facing(a, b) => vec![*a, *b],
            Rule::Wall(p) => vec![*p],
            Rule::Align(pieces, _) => pieces.clone(),
            Rule::Circle { pieces, around, .. } => pieces.iter().copied().chain([*around]).collect(),
            Rule::Inside | Rule::Apart | Rule::Clear(_) | Rule::Walkway(_) | Rule::Reach => Vec::new(),
        }
    }
}
