//! Site of the studio: its page, the page of the latest run below `run/`, and requests that carry the secret.

use super::VERSION;
use super::analyses::{Analyses, MAX_CELLS};
use super::desk::Desk;
use super::directory::{Directory, DirectoryError};
use super::files::{Opened, OpenedDrawing, open_content};
use super::recording::Recording;
use super::rooms::{Drawings, OpenedRoom, Rooms, read_room};
use super::start::{Start, plan};
use hyper::body::{Bytes, Incoming};
use hyper::{Method, Request, StatusCode};
use metamorph_processes::family::families;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::pairing::pins::{self, Pin};
use metamorph_shapes::drawing;
use metamorph_view::access::{AccessCheck, Token};
use metamorph_view::http::{Answer, JS, Site, TEXT, json_body, refused};
use metamorph_view::server::{LIBRARY, file as file_of_view};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Largest size of the body of a request, in bytes.
const MAX_BODY: usize = 1 << 20;
/// Largest number of characters of the name of a page.
const MAX_PAGE_NAME: usize = 64;
/// As for the page of a run, which the studio embeds.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; \
                      img-src 'self' data:; frame-src 'self'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'self'";

/// The files of the page: name, type and content.
const FILES: [(&str, &str, &str); 20] = [
    ("", "text/html; charset=utf-8", include_str!("page/index.html")),
    ("studio.css", "text/css; charset=utf-8", include_str!("page/studio.css")),
    ("room.css", "text/css; charset=utf-8", include_str!("page/room.css")),
    ("room.js", JS, include_str!("page/room.js")),
    ("room-keys.js", JS, include_str!("page/room-keys.js")),
    ("room-panel.js", JS, include_str!("page/room-panel.js")),
    ("recorder.js", JS, include_str!("page/recorder.js")),
    ("plan.js", JS, include_str!("page/plan.js")),
    ("recent.js", JS, include_str!("page/recent.js")),
    ("studio.js", JS, include_str!("page/studio.js")),
    ("structure.js", JS, include_str!("page/structure.js")),
    ("cells.js", JS, include_str!("page/cells.js")),
    ("examples.js", JS, include_str!("page/examples.js")),
    ("space.js", JS, include_str!("page/space.js")),
    ("faces.js", JS, include_str!("page/faces.js")),
    ("layer.js", JS, include_str!("page/layer.js")),
    ("tools.js", JS, include_str!("page/tools.js")),
    ("keys.js", JS, include_str!("page/keys.js")),
    ("panel.js", JS, include_str!("page/panel.js")),
    ("server.js", JS, include_str!("page/server.js")),
];

/// The studio.
#[derive(Debug)]
pub struct Studio {
    secret: Token,
    desk: Arc<Desk>,
    analyses: Arc<Analyses>,
    rooms: Rooms,
    opened: Vec<OpenedDrawing>,
    opened_rooms: Vec<OpenedRoom>,
    modules: Option<u32>,
    recording: Option<Arc<Recording>>,
}

/// A request without members of its own.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Plain {
    version: u16,
}

/// A request to write a drawing or a room.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Save {
    version: u16,
    name: String,
    cells: Option<Vec<Cell>>,
    #[serde(default)]
    pins: Vec<Pin>,
    /// The text of a room file.
    room: Option<String>,
    #[serde(default)]
    replace: bool,
}

/// A request to read a file of the directory, or one with its content in hexadecimal digits.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Open {
    version: u16,
    name: String,
    content: Option<String>,
}

/// An answer, or a refusal.
pub type Response = (StatusCode, Value);

/// Reads a request of the version of this program.
pub fn read<T: DeserializeOwned>(body: &[u8], version: impl Fn(&T) -> u16) -> Result<T, Response> {
    let asked: T = serde_json::from_slice(body)
        .map_err(|error| refused(StatusCode::BAD_REQUEST, &format!("the body is malformed: {error}")))?;
    match version(&asked) {
        VERSION => Ok(asked),
        other => {
            let why = format!("this program reads version {VERSION} of requests, not {other}");
            Err(refused(StatusCode::BAD_REQUEST, &why))
        }
    }
}

/// Reads a request in which a page says its name.
pub fn read_of_page<T: DeserializeOwned>(
    body: &[u8],
    version: impl Fn(&T) -> u16,
    page: impl Fn(&T) -> &str,
) -> Result<T, Response> {
    let asked = read(body, version)?;
    if (1..=MAX_PAGE_NAME).contains(&page(&asked).chars().count()) {
        return Ok(asked);
    }
    let why = format!("`session` has 1 to {MAX_PAGE_NAME} characters");
    Err(refused(StatusCode::BAD_REQUEST, &why))
}

/// Refuses what a request says.
pub fn wrong(why: &str) -> Response {
    refused(StatusCode::UNPROCESSABLE_ENTITY, why)
}

impl Site for Studio {
    fn policy(&self) -> &'static str {
        POLICY
    }

    async fn answer(
        self: Arc<Self>,
        access: &AccessCheck,
        request: Request<Incoming>,
        is_drawing: &AtomicBool,
    ) -> Answer {
        if request.method() == Method::POST {
            let (head, body) = request.into_parts();
            return match access.admit_post(&self.secret, &head.headers, head.uri.path()) {
                Err(refusal) => Answer::refused(refusal),
                Ok("run/command") => match self.desk.page() {
                    Some(page) => page.command(&head.headers, body).await,
                    None => Answer::not_found(),
                },
                Ok(name) => {
                    let name = name.to_owned();
                    let (status, value) = match json_body(&head.headers, body, MAX_BODY).await {
                        Ok(body) => self.carry_out(&name, body).await,
                        Err(refused) => refused,
                    };
                    Answer::json(status, &value)
                }
            };
        }
        let (uri, query) = (request.uri(), request.uri().query().unwrap_or_default());
        match access.admit(request.method(), request.headers(), uri.path()) {
            Err(refusal) => Answer::refused(refusal),
            Ok(rest) => match (rest.strip_prefix("run/"), self.desk.page()) {
                (Some(rest), Some(page)) => page.read(rest, query, is_drawing).await,
                (Some(_), None) => Answer::of(StatusCode::NOT_FOUND, TEXT, "nothing is started yet\n"),
                (None, _) => file(rest).map_or_else(Answer::not_found, |(content_type, text)| {
                    Answer::of(StatusCode::OK, content_type, text)
                }),
            },
        }
    }
}

fn file(name: &str) -> Option<(&'static str, &'static str)> {
    let own = FILES.into_iter().find(|(n, ..)| *n == name).map(|(_, kind, text)| (kind, text));
    own.or_else(|| (name == LIBRARY).then(|| file_of_view(name)).flatten())
}

impl Studio {
    /// Creates a studio that begins with what was opened.
    pub fn new(
        secret: Token,
        desk: Arc<Desk>,
        drawings: Drawings,
        all: Vec<Opened>,
        modules: Option<u32>,
        recording: Option<Arc<Recording>>,
    ) -> Studio {
        let (mut opened, mut opened_rooms) = (Vec::new(), Vec::new());
        for one in all {
            match one {
                Opened::Drawing(drawing) => opened.push(drawing),
                Opened::Room(room) => opened_rooms.push(room),
            }
        }
        let (analyses, rooms) = (Arc::default(), Rooms::new(drawings));
        Studio { secret, desk, analyses, rooms, opened, opened_rooms, modules, recording }
    }

    /// Carries out an admitted request.
    async fn carry_out(self: &Arc<Self>, name: &str, body: Bytes) -> Response {
        if name == "analyse" {
            return self.analyses.answer(&body, families()).await;
        }
        if name == "room" {
            return self.rooms.answer(&body).await;
        }
        let (studio, name) = (Arc::clone(self), name.to_owned());
        let carried_out = tokio::task::spawn_blocking(move || match name.as_str() {
            "begin" => studio.begin(&body),
            "start" => studio.start(&body),
            "stop" => studio.stop(&body),
            "state" => read(&body, |p: &Plain| p.version).map(|_| ok(json!({ "run": studio.desk.latest() }))),
            "save" => studio.save(&body),
            "open" => studio.open(&body),
            "study" => studio.study(&body),
            _ => Err(refused(StatusCode::NOT_FOUND, "there is no request of this name")),
        });
        match carried_out.await {
            Ok(answer) => answer.unwrap_or_else(|refused| refused),
            Err(_) => refused(StatusCode::INTERNAL_SERVER_ERROR, "the request could not be carried out"),
        }
    }

    /// Says what a page needs to begin with.
    fn begin(&self, body: &[u8]) -> Result<Response, Response> {
        read(body, |p: &Plain| p.version)?;
        let names = match &self.rooms.drawings().directory {
            Some(directory) => Some(directory.names().map_err(|error| wrong(&error.to_string()))?),
            None => None,
        };
        Ok(ok(json!({
            "opened": self.opened, "directory": names, "modules": self.modules, "most_cells": MAX_CELLS,
            "rooms": self.opened_rooms, "room_examples": Rooms::examples(),
            "run": self.desk.latest(),
            "study": self.recording.as_ref().map(|recording| recording.name()),
        })))
    }

    /// Records what a person does with a room.
    fn study(&self, body: &[u8]) -> Result<Response, Response> {
        let none = "nothing is recorded; start the studio with --study";
        let recording = self.recording.as_ref().ok_or_else(|| wrong(none))?;
        recording.answer(body, &|text| read_room(text, &|name| self.rooms.drawings().read(name)))
    }

    /// Starts a run that builds a drawing or a room.
    fn start(&self, body: &[u8]) -> Result<Response, Response> {
        let start = read(body, |s: &Start| s.version)?;
        let (text, plan) = plan(&start, self.rooms.drawings())?;
        if start.only_scenario {
            return Ok(ok(json!({ "scenario": text })));
        }
        match self.desk.start(plan, &self.secret) {
            Ok(run) => Ok(ok(json!({ "run": run, "scenario": text }))),
            Err(busy) => Err(refused(StatusCode::CONFLICT, &busy.to_string())),
        }
    }

    fn stop(&self, body: &[u8]) -> Result<Response, Response> {
        read(body, |p: &Plain| p.version)?;
        match self.desk.stop() {
            true => Ok(ok(json!({}))),
            false => Err(refused(StatusCode::CONFLICT, "no run is going on")),
        }
    }

    fn save(&self, body: &[u8]) -> Result<Response, Response> {
        let save = read(body, |s: &Save| s.version)?;
        let Some(stem) = save.name.strip_suffix(".toml") else {
            return Err(wrong("the name of a drawing or a room ends in .toml"));
        };
        let directory = self.directory()?;
        let text = match (&save.cells, &save.room) {
            (Some(cells), None) => {
                let cells = checked(cells)?;
                let drawn = cells.iter().copied().collect();
                let pins = pins::checked(&drawn, &save.pins).map_err(|error| wrong(&error.to_string()))?;
                drawing::text("studio", Some(stem), &cells, &pins)
            }
            (None, Some(room)) if save.pins.is_empty() => {
                // A room that could not be opened where it is written is not written.
                read_room(room, &|name| self.rooms.drawings().read_in_directory(name))?;
                room.clone()
            }
            _ => {
                let why = "what is saved has `cells` and `pins`, or `room`";
                return Err(refused(StatusCode::BAD_REQUEST, why));
            }
        };
        match directory.write(&save.name, text.as_bytes(), save.replace) {
            Ok(()) => Ok(ok(json!({ "directory": directory.names().unwrap_or_default() }))),
            Err(error @ DirectoryError::Exists) => Err(refused(StatusCode::CONFLICT, &error.to_string())),
            Err(error) => Err(wrong(&error.to_string())),
        }
    }

    fn open(&self, body: &[u8]) -> Result<Response, Response> {
        let Open { name, content, .. } = read(body, |o: &Open| o.version)?;
        let content = match content {
            Some(digits) => {
                bytes(&digits).ok_or_else(|| wrong("`content` has two hexadecimal digits a byte"))?
            }
            None => self.directory()?.read(&name).map_err(|error| wrong(&error.to_string()))?,
        };
        match open_content(&name, &content, self.rooms.drawings()).map_err(|why| wrong(&why))? {
            Opened::Drawing(drawing) => Ok(ok(json!({ "opened": drawing }))),
            Opened::Room(room) => Ok(ok(json!({ "room": room }))),
        }
    }

    fn directory(&self) -> Result<&Directory, Response> {
        let none = "there is no directory; start the studio with --dir";
        self.rooms.drawings().directory.as_deref().ok_or_else(|| wrong(none))
    }
}

/// Answers a request that was carried out.
pub fn ok(mut value: Value) -> Response {
    value["result"] = json!("done");
    (StatusCode::OK, value)
}

fn bytes(digits: &str) -> Option<Vec<u8>> {
    let digit = |b: &u8| char::from(*b).to_digit(16);
    let pairs = digits.as_bytes().chunks(2);
    pairs.map(|pair| Some((digit(pair.first()?)? * 16 + digit(pair.get(1)?)?) as u8)).collect()
}

/// Returns cells in order, each once, if there are some and not too many.
pub fn checked(cells: &[Cell]) -> Result<Vec<Cell>, Response> {
    let cells: BTreeSet<Cell> = cells.iter().copied().collect();
    match cells.len() {
        0 => Err(wrong("there is no cell")),
        n if n > MAX_CELLS => {
            Err(refused(StatusCode::PAYLOAD_TOO_LARGE, &format!("a drawing has at most {MAX_CELLS} cells")))
        }
        _ => Ok(cells.into_iter().collect()),
    }
}
