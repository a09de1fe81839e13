//! Rooms that pages furnish. A page sends the text of a room file and changes of it, and gets the changed text, what
//! stands where, and which constraints are violated. All of that is decided by `room`, as for `metamorph room`; the
//! server keeps no room.

use super::budget::{Budget, LONGEST};
use super::directory::Directory;
use super::one_at_a_time::{NoAnswer, OneAtATime};
use super::site::{Response, read_of_page, wrong};
use crate::room::description::describe;
use crate::room::document::read_with;
use crate::room::edit::{Edit, apply};
use crate::room::help::{put_right, snap};
use crate::room::model::Room;
use crate::room::{KindArg, motions_of};
use hyper::StatusCode;
use metamorph_view::http::refused;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::cell::LazyCell;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Largest size of the text of a room, in bytes: half of a body, since quotes and ends of lines take two there.
pub const MAX_TEXT: usize = 512 << 10;
/// Largest number of changes in one request.
const MAX_EDITS: usize = 512;
/// Processor time of a check that looks at `reach`, a search for each place of each piece.
const LONGEST_REACH: Duration = Duration::from_secs(10);
/// Processor time of the search for an order of building when a run is started.
pub const LONGEST_ORDER: Duration = Duration::from_secs(60);

/// A room that can be opened.
#[derive(Clone, Debug, Serialize)]
pub struct OpenedRoom {
    /// Its name, without path and ending.
    pub name: String,
    /// The text of its file.
    pub text: String,
}

/// The rooms of the first page, with what they are for.
const EXAMPLES: [(&str, &str, &str); 3] = [
    ("corner", "a chair at a table", include_str!("../../shipped/rooms/corner.toml")),
    ("circle", "ten chairs around a table", include_str!("../../shipped/rooms/circle.toml")),
    ("room", "an empty one", include_str!("../../shipped/rooms/empty.toml")),
];

/// Where the drawings come from that pieces name: files that were named beside rooms on the command line, and the
/// directory.
#[derive(Debug, Default)]
pub struct Drawings {
    /// The content of drawings by their names; of two rooms with equal names in different places the first counts.
    pub given: BTreeMap<String, Vec<u8>>,
    /// The directory of `--dir`.
    pub directory: Option<Arc<Directory>>,
}

impl Drawings {
    /// Returns the content of a drawing, or why there is none.
    pub fn read(&self, name: &str) -> Result<Vec<u8>, String> {
        self.given.get(name).map_or_else(|| self.read_in_directory(name), |content| Ok(content.clone()))
    }

    /// Returns the content of a drawing in the directory alone.
    pub fn read_in_directory(&self, name: &str) -> Result<Vec<u8>, String> {
        let none = "there is no directory of drawings; start the studio with --dir, or draw the piece";
        let directory = self.directory.as_ref().ok_or(none)?;
        directory.read(name).map_err(|error| error.to_string())
    }
}

/// A request about a room.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Asked {
    version: u16,
    /// A name that a page draws at random when it is loaded.
    session: String,
    /// The revision that the answer is for.
    revision: u64,
    /// The text of the room file.
    room: String,
    /// Edits to apply before the question is answered.
    #[serde(default)]
    edits: Vec<Edit>,
    /// Question to answer in addition to a check.
    #[serde(default)]
    ask: Question,
}

/// Question about a room.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Question {
    /// A check without `reach`, which takes longer.
    #[default]
    Check,
    /// A check of all constraints.
    Reach,
    /// The least change that puts the room right.
    PutRight,
    /// The nearest place at which this piece violates nothing.
    Snap(String),
}

/// Answers requests about rooms, one at a time.
#[derive(Debug, Default)]
pub struct Rooms {
    drawings: Arc<Drawings>,
    work: OneAtATime,
}

impl Rooms {
    /// Creates what answers requests.
    pub fn new(drawings: Drawings) -> Rooms {
        Rooms { drawings: Arc::new(drawings), work: OneAtATime::default() }
    }

    /// Where drawings come from.
    pub fn drawings(&self) -> &Drawings {
        &self.drawings
    }

    /// Returns the rooms of the first page, described.
    pub fn examples() -> Vec<Value> {
        let examples = EXAMPLES.iter().filter_map(|(name, about, text)| {
            // Rooms of this program are right; a test reads them.
            let room = read_with(name, text, &|_| Err(String::new())).ok()?;
            let described = describe(&room, None, &|| true);
            Some(json!({ "name": name, "about": about, "text": text, "described": described }))
        });
        examples.collect()
    }

    /// Answers a request.
    pub async fn answer(&self, body: &[u8]) -> Response {
        let asked = match parse(body) {
            Ok(asked) => asked,
            Err(refused) => return refused,
        };
        let (session, drawings) = (asked.session.clone(), Arc::clone(&self.drawings));
        let answered = self.work.carry_out(&session, move |cancelled| answer(&asked, &drawings, cancelled));
        match answered.await {
            Ok(answer) => answer.unwrap_or_else(|refused| refused),
            Err(NoAnswer::Stale) => {
                (StatusCode::CONFLICT, json!({ "result": "stale", "why": "a newer request has come" }))
            }
            Err(NoAnswer::Failed) => refused(StatusCode::INTERNAL_SERVER_ERROR, "the check has failed"),
        }
    }
}

fn parse(body: &[u8]) -> Result<Asked, Response> {
    let asked = read_of_page(body, |a: &Asked| a.version, |a| &a.session)?;
    if asked.edits.len() > MAX_EDITS {
        let why = format!("a request has at most {MAX_EDITS} changes");
        return Err(refused(StatusCode::PAYLOAD_TOO_LARGE, &why));
    }
    Ok(asked)
}

fn check_length(text: &str) -> Result<(), Response> {
    let why = || format!("a room file has at most {} KiB here", MAX_TEXT >> 10);
    if text.len() > MAX_TEXT { Err(refused(StatusCode::PAYLOAD_TOO_LARGE, &why())) } else { Ok(()) }
}

/// Reads the text of a room.
///
/// # Errors
/// What is wrong with it, for the page.
pub fn read_room(text: &str, drawings: &dyn Fn(&str) -> Result<Vec<u8>, String>) -> Result<Room, Response> {
    check_length(text)?;
    read_with("room.toml", text, drawings).map_err(|found| wrong(found.to_string().trim_end()))
}

fn answer(asked: &Asked, drawings: &Drawings, cancelled: Arc<AtomicBool>) -> Result<Response, Response> {
    check_length(&asked.room)?;
    let text = apply(&asked.room, &asked.edits).map_err(|error| wrong(&error.to_string()))?;
    let mut room = read_room(&text, &|name| drawings.read(name))?;
    let budget = |longest| Budget::of_steps(Arc::clone(&cancelled), longest);
    let is_whole = matches!(asked.ask, Question::Reach);
    let checking = budget(if is_whole { LONGEST_REACH } else { LONGEST });
    let motions = is_whole.then(|| motions_of(KindArg::Srs));
    let description = describe(&room, motions.as_ref(), &|| checking.is_left());
    let mut value = serde_json::to_value(&description).unwrap_or_default();
    match &asked.ask {
        Question::Check | Question::Reach => {}
        Question::PutRight => {
            let searching = budget(LONGEST);
            // Its time begins when the other has ended.
            let mending = LazyCell::new(|| budget(LONGEST));
            let mended = put_right(&room, &|| searching.is_left(), &|| mending.is_left());
            value["put_right"] = json!(mended);
            value["ended"] = json!(mended.is_none() && mending.was_ended());
            if let Some(mended) = &mended {
                room.place(&mended.placements);
            }
        }
        Question::Snap(name) => {
            let piece = room.find(name);
            let piece = piece.ok_or_else(|| wrong(&format!("there is no piece `{name}`")))?;
            let mending = budget(LONGEST);
            value["snap"] = json!(snap(&room, piece, &|| mending.is_left()));
            value["ended"] = json!(mending.was_ended());
        }
    }
    value["result"] = json!("checked");
    value["revision"] = json!(asked.revision);
    value["room"] = json!(text);
    Ok((StatusCode::OK, value))
}
