//! Session logs of the study of thesis 8.2: what a person did with a room, as lines of JSON, and what is measured.
//!
//! The first line has the version and the condition, every other line one event; see `docs/rooms.md`.

use super::measure::{Precision, precision};
use super::study_format::{Action, Event, Head, MAX_BYTES, Mobility, Placed, Representation, VERSION};
use metamorph_module_agent::regular_file;
use metamorph_text::escape::Shown as _;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use thiserror::Error;

/// Why a log cannot be read.
#[derive(Debug, Error)]
pub enum StudyError {
    /// No file.
    #[error("cannot read the session log: {0}")]
    Read(String),
    /// A wrong line.
    #[error("line {line}: {why}")]
    Line {
        /// Its number, from 1.
        line: usize,
        /// The reason.
        why: String,
    },
}

/// An error in a log, with the name of the file.
#[derive(Debug, Error)]
#[error("{file}: {error}\n  fix: docs/rooms.md describes session logs")]
pub struct LogError {
    /// The file.
    pub file: String,
    /// The reason.
    pub error: StudyError,
}

/// A session.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Session {
    /// How the person saw the room.
    pub representation: Representation,
    /// Whether the eye could move.
    pub mobility: Mobility,
    /// The name of the piece in the middle.
    pub table: String,
    /// From the first action to the last, in seconds.
    pub time_s: f64,
    /// The actions by kind.
    pub actions: BTreeMap<Action, u64>,
    /// The number of times that the eye was noted.
    pub samples: u64,
    /// The length of the eye's path in metres.
    pub path_m: f64,
    /// Pieces in the room at the end of the session.
    pub pieces: BTreeMap<String, Placed>,
    /// The measures in metres; `None` without a table or with fewer than two other pieces.
    pub precision: Option<Precision>,
}

/// Reads a log.
///
/// # Errors
/// If there is no such file, or a line is wrong.
pub fn read(path: &Path) -> Result<Session, LogError> {
    let fail = |error| LogError { file: path.shown(), error };
    let bytes = regular_file::read(path, MAX_BYTES).map_err(|e| fail(StudyError::Read(e.to_string())))?;
    let text =
        String::from_utf8(bytes).map_err(|_| fail(StudyError::Read("it is not UTF-8 text".to_owned())))?;
    session(&text).map_err(fail)
}

/// Reads the text of a log.
///
/// # Errors
/// If a line is wrong.
pub fn session(text: &str) -> Result<Session, StudyError> {
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let wrong = |line: usize, why: String| StudyError::Line { line: line + 1, why };
    let (first, head) = lines.next().ok_or_else(|| wrong(0, "the log is empty".to_owned()))?;
    let head: serde_json::Value = serde_json::from_str(head).map_err(|e| wrong(first, e.to_string()))?;
    match head.get("study").and_then(serde_json::Value::as_u64) {
        Some(version) if version == u64::from(VERSION) => {}
        Some(version) => {
            return Err(wrong(first, format!("the log has version {version}; this program reads {VERSION}")));
        }
        None => return Err(wrong(first, format!("a log begins with {{\"study\": {VERSION}, …}}"))),
    }
    let head: Head = serde_json::from_value(head).map_err(|e| wrong(first, e.to_string()))?;
    debug_assert_eq!(head.study, VERSION);
    let mut log = Log::new(head).map_err(|why| wrong(first, why))?;
    for (line, text) in lines {
        let event = serde_json::from_str::<Event>(text).map_err(|e| wrong(line, e.to_string()))?;
        log.take(event).map_err(|why| wrong(line, why))?;
    }
    Ok(log.finish())
}

/// A log that is being read, or written.
#[derive(Clone, Debug)]
pub struct Log {
    session: Session,
    last: f64,
    acted: Option<(f64, f64)>,
    eye: Option<[f64; 3]>,
}

impl Log {
    /// Begins with the first line.
    ///
    /// # Errors
    /// If a piece is in no room.
    pub fn new(head: Head) -> Result<Log, String> {
        check_near(head.pieces.values().flat_map(|piece| piece.centre))?;
        let session = Session {
            representation: head.representation,
            mobility: head.mobility,
            table: head.table,
            time_s: 0.0,
            actions: BTreeMap::new(),
            samples: 0,
            path_m: 0.0,
            pieces: head.pieces,
            precision: None,
        };
        Ok(Log { session, last: 0.0, acted: None, eye: None })
    }

    /// Takes the next line.
    ///
    /// # Errors
    /// If it does not follow from those before it.
    pub fn take(&mut self, event: Event) -> Result<(), String> {
        if !(event.t.is_finite() && event.t >= self.last) {
            return Err(format!("the time {} is before {}", event.t, self.last));
        }
        self.last = event.t;
        let plane = event.centre.into_iter().flatten();
        check_near(plane.chain([event.eye, event.direction].into_iter().flatten().flatten()))?;
        match (event.action, event.eye) {
            (Some(action), None) => self.act(action, event),
            (None, Some(eye)) => {
                let step = self.eye.map_or(0.0, |from| {
                    let square: f64 = from.iter().zip(eye).map(|(a, b)| (a - b) * (a - b)).sum();
                    libm::sqrt(square)
                });
                (self.eye, self.session.path_m) = (Some(eye), self.session.path_m + step);
                self.session.samples += 1;
                Ok(())
            }
            _ => Err("an event has either an action or an eye".to_owned()),
        }
    }

    fn act(&mut self, action: Action, event: Event) -> Result<(), String> {
        let first = self.acted.map_or(event.t, |(first, _)| first);
        self.acted = Some((first, event.t));
        *self.session.actions.entry(action).or_default() += 1;
        if action == Action::Look {
            return Ok(());
        }
        let pieces = &mut self.session.pieces;
        let name = match event.piece {
            Some(name) => name,
            // Nothing is selected any more.
            None if action == Action::Deselect => return Ok(()),
            None => return Err("the action names no piece".to_owned()),
        };
        match action {
            Action::Create => {
                let centre = event.centre.ok_or("a new piece has a centre")?;
                if pieces.contains_key(&name) {
                    return Err(format!("there is a piece {name} already"));
                }
                pieces.insert(name, Placed { centre, colour: event.colour });
            }
            Action::Delete => {
                pieces.remove(&name).ok_or_else(|| format!("there is no piece {name}"))?;
            }
            _ => {
                let piece = pieces.get_mut(&name).ok_or_else(|| format!("there is no piece {name}"))?;
                piece.centre = event.centre.unwrap_or(piece.centre);
                if event.colour.is_some() {
                    piece.colour = event.colour;
                }
            }
        }
        Ok(())
    }

    fn finish(mut self) -> Session {
        let session = &mut self.session;
        session.time_s = self.acted.map_or(0.0, |(first, last)| last - first);
        let table = session.pieces.get(&session.table).map(|table| table.centre);
        let others = session.pieces.iter().filter(|(name, _)| **name != session.table);
        let chairs: Vec<[f64; 2]> = others.map(|(_, piece)| piece.centre).collect();
        session.precision = table.and_then(|table| precision(&chairs, table));
        self.session
    }
}

/// Refuses coordinates that are in no room, in metres.
fn check_near(mut coordinates: impl Iterator<Item = f64>) -> Result<(), String> {
    match coordinates.find(|c| !(-1e4..=1e4).contains(c)) {
        Some(far) => Err(format!("{far} m is not in a room")),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str =
        r#"{"study": 1, "representation": "virtual", "mobility": "dynamic", "table": "table"}"#;

    /// Ten chairs at 1 m around a table that is 0.1 m beside the middle; one is created twice and one moved.
    fn log() -> String {
        let mut lines = vec![HEAD.to_owned()];
        lines.push(r#"{"t": 1.5, "eye": [0, 0, 1.6], "direction": [1, 0, 0]}"#.to_owned());
        lines.push(r#"{"t": 2, "action": "create", "piece": "table", "centre": [3.1, 2]}"#.to_owned());
        lines.push(r#"{"t": 3, "action": "create", "piece": "wrong", "centre": [0, 0]}"#.to_owned());
        lines.push(r#"{"t": 4, "action": "delete", "piece": "wrong"}"#.to_owned());
        for i in 0..10 {
            let angle = std::f64::consts::TAU * f64::from(i) / 10.0;
            let (x, y) = (3.0 + libm::cos(angle), 2.0 + libm::sin(angle));
            lines.push(format!(
                r#"{{"t": {}, "action": "create", "piece": "chair {i}", "centre": [9, 9], "colour": "red"}}"#,
                5 + i
            ));
            lines.push(format!(
                r#"{{"t": {}, "action": "move", "piece": "chair {i}", "centre": [{x}, {y}]}}"#,
                5 + i
            ));
        }
        lines.push(r#"{"t": 20, "eye": [3, 4, 1.6], "direction": [1, 0, 0]}"#.to_owned());
        lines.push(r#"{"t": 22, "action": "deselect"}"#.to_owned());
        lines.join("\n")
    }

    #[test]
    fn a_session_is_measured() {
        let session = session(&log()).unwrap();
        assert_eq!((session.time_s, session.samples, session.path_m), (20.0, 2, 5.0));
        let count = |action| session.actions.get(&action).copied().unwrap_or(0);
        use Action::{Create, Delete, Deselect, Move, Turn};
        assert_eq!([Create, Delete, Move, Deselect, Turn].map(count), [12, 1, 10, 1, 0]);
        let precision = session.precision.unwrap();
        assert!((precision.p_l - 0.1).abs() < 1e-9 && (precision.p_g.unwrap() - 1.0).abs() < 1e-9);
        assert_eq!(session.pieces.len(), 11);
    }

    #[test]
    fn what_stands_in_the_room_at_first_is_no_action() {
        let pieces = r#""pieces": {"table": {"centre": [3, 2], "colour": "blue"}, "a": {"centre": [4, 2]}, "b": {"centre": [9, 9]}}}"#;
        let head = HEAD.replace('}', &format!(", {pieces}"));
        let moved = r#"{"t": 5, "action": "move", "piece": "b", "centre": [2, 2]}"#;
        let session = session(&format!("{head}\n{moved}\n")).unwrap();
        assert_eq!((session.time_s, session.pieces.len()), (0.0, 3));
        assert_eq!(session.actions, BTreeMap::from([(Action::Move, 1)]));
        assert_eq!(session.precision.unwrap().p_l, 0.0);
    }

    #[test]
    fn wrong_logs_are_refused_with_their_line() {
        let after = |line: &str| format!("{HEAD}\n{line}");
        for (text, line, why) in [
            (String::new(), 1, "empty"),
            ("{}".to_owned(), 1, "begins with"),
            (HEAD.replace('1', "2"), 1, "version 2"),
            (HEAD.replace("dynamic", "walking"), 1, "walking"),
            (HEAD.replace('}', r#", "pieces": {"a": {"centre": [1, 1e9]}}}"#), 1, "not in a room"),
            (after("{"), 2, "EOF"),
            (after(r#"{"t": 1}"#), 2, "either an action or an eye"),
            (after(r#"{"t": -1, "action": "look"}"#), 2, "before"),
            (after(r#"{"t": 1, "action": "create", "piece": "a"}"#), 2, "centre"),
            (after(r#"{"t": 1, "action": "move", "piece": "a", "centre": [1, 2]}"#), 2, "no piece a"),
            (after(r#"{"t": 1, "eye": [1e9, 0, 0]}"#), 2, "not in a room"),
            (after(r#"{"t": 1, "action": "look", "speed": 3}"#), 2, "speed"),
        ] {
            let Err(StudyError::Line { line: at, why: found }) = session(&text) else {
                panic!("{text} is accepted");
            };
            assert!(at == line && found.contains(why), "{text}: {at}: {found}");
        }
    }
}
