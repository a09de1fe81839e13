//! The session log that `--study` records of one page. The page sends the text of the room after each change, the
//! chosen pieces, and the position of the eye. Actions on pieces are derived here, and the reader of session logs
//! checks the lines before they are written. Absent: the format, which is that of `room`.

use super::site::{Response, ok, read_of_page, wrong};
use crate::room::model::{MAX_PIECES, Room};
use crate::room::study::Log;
use crate::room::study_actions::{Arrangement, table};
use crate::room::study_format::{self, Action, AppendError, Event, Head, LogFile, Mobility, Representation};
use hyper::StatusCode;
use metamorph_text::escape::Shown as _;
use metamorph_view::http::refused;
use serde::Deserialize;
use serde_json::json;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::{fs, io};

/// Largest number of events in one request.
const MAX_EVENTS: usize = 512;

/// A request to record what a person did.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Asked {
    version: u16,
    /// The name that the page draws at random when it is loaded.
    session: String,
    /// Events that happened before the room was changed.
    #[serde(default)]
    events: Vec<Seen>,
    /// The room after a change.
    room: Option<Changed>,
}

/// A room. Times are seconds since the page has opened its first room.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Changed {
    t: f64,
    /// The text of the room file.
    text: String,
}

/// An event that cannot be derived from the text of the room.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
enum Seen {
    /// These pieces, and no others, are chosen from now on.
    Chosen { t: f64, pieces: Vec<String> },
    /// The eye is moved.
    Look { t: f64 },
    /// Where the eye is and looks, in metres.
    Eye { t: f64, at: [f64; 3], direction: [f64; 3] },
}

/// A session log that is being written.
#[derive(Debug)]
pub struct Recording {
    path: PathBuf,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    file: LogFile,
    /// The page that is recorded.
    page: Option<Recorded>,
    /// Why nothing is recorded any more.
    ended: Option<String>,
}

#[derive(Debug)]
struct Recorded {
    name: String,
    session: Session,
}

/// State of the session according to the log so far.
#[derive(Clone, Debug)]
struct Session {
    log: Log,
    pieces: Arrangement,
    chosen: BTreeSet<String>,
}

impl Recording {
    /// Creates the log.
    ///
    /// # Errors
    /// If the file exists already, or the system refuses.
    pub fn create(path: &Path) -> io::Result<Recording> {
        Ok(Recording::over(path, LogFile::create(path)?))
    }

    fn over(path: &Path, file: LogFile) -> Recording {
        Recording { path: path.to_owned(), state: Mutex::new(State { file, page: None, ended: None }) }
    }

    /// Returns the name of the log, without its path.
    pub fn name(&self) -> String {
        Path::new(self.path.file_name().unwrap_or_default()).shown()
    }

    /// Removes the log if no page was recorded, so that the same command can be given again.
    pub fn remove_unused(&self) {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if state.page.is_none() && fs::metadata(&self.path).is_ok_and(|file| file.len() == 0) {
            // An empty log that stays does no harm.
            let _ = fs::remove_file(&self.path);
        }
    }

    /// Records what a request says. `read_room` reads the text of a room.
    ///
    /// # Errors
    /// If the request is wrong, another page is recorded, or nothing is recorded any more; then nothing is written.
    pub fn answer(
        &self,
        body: &[u8],
        read_room: &dyn Fn(&str) -> Result<Room, Response>,
    ) -> Result<Response, Response> {
        let asked = read_of_page(body, |a: &Asked| a.version, |a| &a.session)?;
        if asked.events.len() > MAX_EVENTS {
            let why = format!("a request has at most {MAX_EVENTS} events");
            return Err(refused(StatusCode::PAYLOAD_TOO_LARGE, &why));
        }
        // Poisoning is ignored: no statement that can panic leaves the value half changed.
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if state.page.as_ref().is_some_and(|page| page.name != asked.session) {
            let why = "another page is recorded, or this one was before it was loaded again; start the studio with \
                       another file to record anew";
            return Err(refused(StatusCode::CONFLICT, why));
        }
        if let Some(why) = &state.ended {
            return Err(refused(StatusCode::CONFLICT, why));
        }
        let room = match &asked.room {
            Some(changed) => Some((changed.t, read_room(&changed.text)?)),
            None => None,
        };
        let mut lines = String::new();
        let session = match (&state.page, room) {
            (Some(page), room) => {
                let mut session = page.session.clone();
                session.take(asked.events, room, &mut lines).map_err(|why| wrong(&why))?;
                session
            }
            (None, Some((_, room))) if asked.events.is_empty() => {
                Session::begin(&room, &mut lines).map_err(|why| wrong(&why))?
            }
            (None, _) => return Err(wrong("a session begins with `room`, and without `events`")),
        };
        if let Err(error) = state.file.append(&lines) {
            let status = match error {
                AppendError::Full => StatusCode::CONFLICT,
                AppendError::System(_) => StatusCode::INTERNAL_SERVER_ERROR,
            };
            let why = error.to_string();
            let answer = refused(status, &why);
            state.ended = Some(why);
            return Err(answer);
        }
        state.page = Some(Recorded { name: asked.session, session });
        Ok(ok(json!({})))
    }
}

impl Session {
    /// Begins with a room, and writes the first line.
    fn begin(room: &Room, lines: &mut String) -> Result<Session, String> {
        let pieces = Arrangement::of(room);
        // The plan is a picture without the real room behind it, which can be moved.
        let head = Head {
            study: study_format::VERSION,
            representation: Representation::Virtual,
            mobility: Mobility::Dynamic,
            table: table(room),
            pieces: pieces.placed(),
        };
        push(lines, &head)?;
        Ok(Session { log: Log::new(head)?, pieces, chosen: BTreeSet::new() })
    }

    /// Takes what was done, and writes its lines.
    fn take(
        &mut self,
        events: Vec<Seen>,
        room: Option<(f64, Room)>,
        lines: &mut String,
    ) -> Result<(), String> {
        for seen in events {
            match seen {
                Seen::Look { t } => {
                    self.write(Event { t, action: Some(Action::Look), ..Event::default() }, lines)?;
                }
                Seen::Eye { t, at, direction } => {
                    let (eye, direction) = (Some(at), Some(direction));
                    self.write(Event { t, eye, direction, ..Event::default() }, lines)?;
                }
                Seen::Chosen { t, pieces } => self.choose(t, pieces, lines)?,
            }
        }
        let Some((t, room)) = room else { return Ok(()) };
        let after = Arrangement::of(&room);
        for event in self.pieces.actions(&after, t) {
            self.write(event, lines)?;
        }
        // A piece that was removed is no longer chosen. That is not an action of its own.
        self.chosen.retain(|name| after.has(name));
        self.pieces = after;
        Ok(())
    }

    fn choose(&mut self, t: f64, pieces: Vec<String>, lines: &mut String) -> Result<(), String> {
        if pieces.len() > MAX_PIECES {
            return Err(format!("at most {MAX_PIECES} pieces are chosen"));
        }
        // A piece may have been taken out by a step back while the page still showed it.
        let chosen: BTreeSet<String> = pieces.into_iter().filter(|name| self.pieces.has(name)).collect();
        let before = std::mem::replace(&mut self.chosen, chosen.clone());
        let left = before.difference(&chosen).map(|name| (Action::Deselect, name));
        let new = chosen.difference(&before).map(|name| (Action::Select, name));
        for (action, name) in left.chain(new) {
            let (action, piece) = (Some(action), Some(name.clone()));
            self.write(Event { t, action, piece, ..Event::default() }, lines)?;
        }
        Ok(())
    }

    fn write(&mut self, event: Event, lines: &mut String) -> Result<(), String> {
        push(lines, &event)?;
        self.log.take(event)
    }
}

fn push<T: serde::Serialize>(lines: &mut String, value: &T) -> Result<(), String> {
    study_format::push_line(lines, value).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::room::document::read_with;
    use crate::room::study;
    use crate::studio::VERSION;
    use serde_json::Value;
    use std::fs::File;

    const CORNER: &str = include_str!("../../shipped/rooms/corner.toml");

    fn room(text: &str) -> Result<Room, Response> {
        read_with("room.toml", text, &|_| Err(String::new())).map_err(|error| wrong(&error.to_string()))
    }

    fn send(recording: &Recording, rest: Value) -> StatusCode {
        let mut body = json!({ "version": VERSION, "session": "a" });
        body.as_object_mut().unwrap().extend(rest.as_object().unwrap().clone());
        let answer = recording.answer(body.to_string().as_bytes(), &room);
        answer.map_or_else(|refused| refused.0, |done| done.0)
    }

    #[test]
    fn what_is_chosen_becomes_selections_and_a_wrong_request_writes_nothing() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("log.jsonl");
        let recording = Recording::create(&path).unwrap();
        assert_eq!(recording.name(), "log.jsonl");
        let chosen = |t: f64, pieces: Value| json!({ "chosen": { "t": t, "pieces": pieces } });
        let first = json!([chosen(1.0, json!(["table"]))]);
        assert_eq!(send(&recording, json!({ "events": first })), 422, "no room yet");
        assert_eq!(send(&recording, json!({ "room": { "t": 0, "text": CORNER } })), 200);
        let begun = fs::read_to_string(&path).unwrap();
        assert_eq!(begun.lines().count(), 1);
        let late = json!([chosen(3.0, json!(["table"])), chosen(2.0, json!([]))]);
        assert_eq!(send(&recording, json!({ "events": late })), 422);
        assert_eq!(fs::read_to_string(&path).unwrap(), begun);
        let events = json!([
            chosen(1.0, json!(["table", "sofa"])),
            chosen(2.0, json!(["chair", "table"])),
            chosen(3.0, json!(["chair"])),
        ]);
        assert_eq!(send(&recording, json!({ "events": events })), 200);
        // A piece that is taken out is not deselected.
        let without = format!(
            "{}[[piece]]{}",
            &CORNER[..CORNER.find("[[piece]]").unwrap()],
            "\nname = \"table\"\nshape = \"box\"\nat = [5, 0]\n"
        );
        assert_eq!(send(&recording, json!({ "room": { "t": 4, "text": without } })), 200);
        assert_eq!(send(&recording, json!({ "events": [chosen(5.0, json!([]))] })), 200);
        let session = study::read(&path).unwrap();
        let counts: Vec<(Action, u64)> = session.actions.into_iter().collect();
        assert_eq!(counts, [(Action::Delete, 1), (Action::Select, 2), (Action::Deselect, 1)]);
        assert_eq!((session.time_s, session.pieces.len()), (3.0, 1));
        recording.remove_unused();
        assert!(path.exists());
    }

    #[test]
    fn recording_ends_where_the_log_cannot_be_written_and_an_unused_log_is_removed() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("log");
        let recording = Recording::create(&path).unwrap();
        let unwritable = LogFile::at_end(File::open(&path).unwrap()).unwrap();
        let begin = json!({ "room": { "t": 0, "text": CORNER } });
        let broken = Recording::over(&path, unwritable);
        assert_eq!(send(&broken, begin.clone()), 500);
        assert_eq!(send(&broken, begin), 409, "it has ended");
        recording.remove_unused();
        assert!(!path.exists());
    }
}
