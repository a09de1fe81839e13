//! Actions of a person on the pieces of a room, derived from the arrangements before and after.

use super::constraint::Rule;
use super::model::{CELL_M, Colour, Piece, Room};
use super::study_format::{Action, Event, Placed};
use std::collections::BTreeMap;

/// The name that the piece in the middle has where the room does not say which it is.
const TABLE: &str = "table";

/// How the pieces of a room stand, by their names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Arrangement(BTreeMap<String, Standing>);

/// How a piece stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Standing {
    /// Twice its middle, in cells.
    centre2: (i32, i32),
    turn: u8,
    colour: Colour,
}

impl Standing {
    fn of(piece: &Piece) -> Standing {
        Standing { centre2: piece.centre2(), turn: piece.place.turn, colour: piece.colour }
    }
    /// The middle in metres.
    fn centre(self) -> [f64; 2] {
        [self.centre2.0, self.centre2.1].map(|c| f64::from(c) / 2.0 * CELL_M)
    }
    fn colour(self) -> String {
        self.colour.name().to_owned()
    }

    /// Returns the actions that change a piece from this standing to `after`.
    fn actions(self, after: Standing) -> impl Iterator<Item = Action> {
        let (x, y) = (self.centre2.0.abs_diff(after.centre2.0), self.centre2.1.abs_diff(after.centre2.1));
        let is_turned = self.turn != after.turn;
        // A turn moves the middle of a piece with an odd and an even side by half a cell.
        let still = u32::from(is_turned);
        let all = [
            (Action::Move, x > still || y > still),
            (Action::Turn, is_turned),
            (Action::Colour, self.colour != after.colour),
        ];
        all.into_iter().filter_map(|(action, is_done)| is_done.then_some(action))
    }
}

impl Arrangement {
    /// Returns how the pieces of a room stand.
    pub fn of(room: &Room) -> Arrangement {
        Arrangement(room.pieces.iter().map(|piece| (piece.name.clone(), Standing::of(piece))).collect())
    }

    /// Returns whether there is a piece of this name.
    pub fn has(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }

    /// Returns the pieces as the head of a log has them.
    pub fn placed(&self) -> BTreeMap<String, Placed> {
        let placed = |s: &Standing| Placed { centre: s.centre(), colour: Some(s.colour()) };
        self.0.iter().map(|(name, standing)| (name.clone(), placed(standing))).collect()
    }

    /// Returns the actions that lead to another arrangement: first what is taken out, and then the rest by name.
    pub fn actions(&self, after: &Arrangement, t: f64) -> Vec<Event> {
        let of = |action, name: &String| Event {
            t,
            action: Some(action),
            piece: Some(name.clone()),
            ..Event::default()
        };
        let gone = self.0.keys().filter(|name| !after.has(name));
        let mut events: Vec<Event> = gone.map(|name| of(Action::Delete, name)).collect();
        for (name, now) in &after.0 {
            let (centre, colour) = (Some(now.centre()), Some(now.colour()));
            let Some(before) = self.0.get(name) else {
                events.push(Event { centre, colour, ..of(Action::Create, name) });
                continue;
            };
            events.extend(before.actions(*now).map(|action| match action {
                Action::Colour => Event { colour: colour.clone(), ..of(action, name) },
                _ => Event { centre, ..of(action, name) },
            }));
        }
        events
    }
}

/// Returns the name of the piece in the middle: the one that the first circle is around, or the one that is called
/// `table`, or the first.
pub fn table(room: &Room) -> String {
    let around = room.constraints.iter().find_map(|constraint| match constraint.rule {
        Rule::Circle { around, .. } => Some(around),
        _ => None,
    });
    let piece = around.or_else(|| room.find(TABLE)).unwrap_or(0);
    room.pieces.get(piece).map_or(TABLE, |piece| &piece.name).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::room::document::read_with;
    use crate::room::edit::{Edit, apply};

    const CORNER: &str = include_str!("../../shipped/rooms/corner.toml");

    fn room(text: &str) -> Room {
        read_with("room.toml", text, &|_| Err(String::new())).unwrap()
    }

    fn changed(text: &str, edits: &str) -> String {
        let edits: Vec<Edit> = serde_json::from_str(edits).unwrap();
        apply(text, &edits).unwrap()
    }

    /// Returns the actions of changes of the corner, as words.
    fn done(edits: &str) -> Vec<String> {
        let after = Arrangement::of(&room(&changed(CORNER, edits)));
        let events = Arrangement::of(&room(CORNER)).actions(&after, 1.5);
        let word = |event: &Event| {
            assert_eq!((event.t, event.eye), (1.5, None));
            format!("{:?} {}", event.action.unwrap(), event.piece.as_deref().unwrap())
        };
        events.iter().map(word).collect()
    }

    #[test]
    fn actions_are_derived_from_what_has_changed() {
        for (edits, expected) in [
            ("[]", &[][..]),
            (r#"[{"resize": {"size": [21, 18]}}]"#, &[]),
            (r#"[{"release": {"constraint": 1}}]"#, &[]),
            (r#"[{"place": {"piece": "chair", "at": [5, 6], "turn": 0}}]"#, &["Move chair"]),
            (r#"[{"place": {"piece": "chair", "at": [5, 5], "turn": 1}}]"#, &["Turn chair"]),
            (
                r#"[{"place": {"piece": "chair", "at": [8, 5], "turn": 3}}, {"colour": {"piece": "chair", "colour": "red"}}]"#,
                &["Move chair", "Turn chair", "Colour chair"],
            ),
            (
                r#"[{"remove": {"piece": "table"}}, {"add": {"name": "box", "shape": "box", "at": [9, 0]}}]"#,
                &["Delete table", "Create box"],
            ),
            (r#"[{"rename": {"piece": "chair", "name": "seat"}}]"#, &["Delete chair", "Create seat"]),
        ] {
            assert_eq!(done(edits), expected, "{edits}");
        }
    }

    #[test]
    fn a_quarter_turn_in_place_is_no_move() {
        // The page turns a piece about its middle, rounded to connectors.
        let bar = r#"[{"add": {"name": "bar", "cells": [[0,0,0],[1,0,0],[2,0,0],[3,0,0]], "at": [8, 4]}}]"#;
        let text = changed(CORNER, bar);
        let turned = changed(&text, r#"[{"place": {"piece": "bar", "at": [9, 3], "turn": 1}}]"#);
        let events = Arrangement::of(&room(&text)).actions(&Arrangement::of(&room(&turned)), 0.0);
        assert_eq!(events.iter().filter_map(|e| e.action).collect::<Vec<_>>(), [Action::Turn]);
        let [x, y] = events[0].centre.unwrap();
        assert!((x - 9.0 * CELL_M).abs() < 1e-9 && (y - 4.5 * CELL_M).abs() < 1e-9, "{x} {y}");
    }

    #[test]
    fn the_table_is_that_of_the_first_circle_or_called_so_or_the_first() {
        assert_eq!(table(&room(CORNER)), "table");
        let renamed = changed(CORNER, r#"[{"rename": {"piece": "table", "name": "desk"}}]"#);
        assert_eq!(table(&room(&renamed)), "desk");
        let circle = include_str!("../../shipped/rooms/circle.toml");
        let renamed = changed(circle, r#"[{"rename": {"piece": "table", "name": "desk"}}]"#);
        let swapped = changed(&renamed, r#"[{"rename": {"piece": "chair 1", "name": "table"}}]"#);
        assert_eq!(table(&room(&swapped)), "desk");
        assert_eq!(table(&room(include_str!("../../shipped/rooms/empty.toml"))), "table");
    }
}
