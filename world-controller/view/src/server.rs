//! The page of a run: the files that are in the program, the scene as JSON, figures of it, and, of a run that can be
//! controlled, commands; nothing else.

use super::access::{AccessCheck, Refusal, Token};
use super::control::Control;
use super::http::{Answer, JS, ServerError, Site, TEXT, serve_site};
use super::saved::{Saved, Subject};
use crate::request::Kind;
use hyper::body::Incoming;
use hyper::header::HeaderMap;
use hyper::{Method, Request, StatusCode};
use metamorph_processes::control::Operators;
use metamorph_protocol::ids::ModuleId;
use metamorph_scene::shared::Shared;
use serde_json::Value;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Number of time bins sent at once.
const BINS_AT_ONCE: usize = 64;
/// The page may only use resources of this server. What is behind it says which pages may show it in a frame.
macro_rules! policy {
    ($ancestors:literal) => {
        concat!(
            "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; ",
            "base-uri 'none'; form-action 'none'; frame-ancestors ",
            $ancestors
        )
    };
}
/// No page may show it in a frame.
const POLICY: &str = policy!("'none'");
/// Notebooks may that are served by this machine, or are part of an editor.
const IN_FRAMES: &str = policy!(
    "http://localhost:* http://127.0.0.1:* http://[::1]:* https://localhost:* https://127.0.0.1:* vscode-webview:"
);

/// The files of the page: name, type and content.
const FILES: [(&str, &str, &str); 23] = [
    ("", "text/html; charset=utf-8", include_str!("page/index.html")),
    ("style.css", "text/css; charset=utf-8", include_str!("page/style.css")),
    ("main.js", JS, include_str!("page/main.js")),
    ("story.js", JS, include_str!("page/story.js")),
    ("parts.js", JS, include_str!("page/parts.js")),
    ("figure.js", JS, include_str!("page/figure.js")),
    ("viewpoint.js", JS, include_str!("page/viewpoint.js")),
    ("dom.js", JS, include_str!("page/dom.js")),
    ("look.js", JS, include_str!("page/look.js")),
    ("hosts.js", JS, include_str!("page/hosts.js")),
    ("keys.js", JS, include_str!("page/keys.js")),
    ("overlay.js", JS, include_str!("page/overlay.js")),
    ("renderer.js", JS, include_str!("page/renderer.js")),
    ("instances.js", JS, include_str!("page/instances.js")),
    ("shaders.js", JS, include_str!("page/shaders.js")),
    ("cells.js", JS, include_str!("page/cells.js")),
    ("links.js", JS, include_str!("page/links.js")),
    ("legend.js", JS, include_str!("page/legend.js")),
    ("picture.js", JS, include_str!("page/picture.js")),
    ("timeline.js", JS, include_str!("page/timeline.js")),
    ("panel.js", JS, include_str!("page/panel.js")),
    ("control.js", JS, include_str!("page/control.js")),
    (LIBRARY, JS, include_str!("page/vendor/three.js")),
];
/// The library that draws; `page/vendor/make` makes it.
pub const LIBRARY: &str = "vendor/three.js";

/// A page that is served until the program ends.
#[derive(Debug)]
pub struct Server {
    address: String,
    controlling: Option<String>,
}

/// The use that a page admits.
#[derive(Debug)]
pub enum Use {
    /// It is shown in a window of its own.
    Shown,
    /// It is also shown in frames of other pages of this machine.
    InFrames,
    /// It controls the run, if it is opened with a second secret.
    Controlling(Operators),
}

/// The page of a run.
#[derive(Debug)]
pub struct RunPage {
    scene: Shared,
    subject: Subject,
    control: Option<Control>,
    in_frames: bool,
}

/// Set when dropped: when the response is made, or when its connection is closed before.
struct Unwanted(Arc<AtomicBool>);

impl Drop for Unwanted {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Server {
    /// Starts to serve a scene and figures of it, at this port or at any free one.
    ///
    /// # Errors
    /// If the port is not available, or there is no thread.
    pub fn start(
        scene: Shared,
        subject: Subject,
        port: Option<u16>,
        admitted: Use,
    ) -> Result<Server, ServerError> {
        let secret = Token::random()?;
        let in_frames = matches!(admitted, Use::InFrames);
        let control = match admitted {
            Use::Controlling(operators) => Some(Control::new(secret.clone(), operators)),
            Use::Shown | Use::InFrames => None,
        };
        let is_controlled = control.is_some();
        let address = serve_site(RunPage { in_frames, ..RunPage::new(scene, subject, control) }, port)?;
        let controlling = is_controlled.then(|| format!("{address}#c={}", secret.text()));
        Ok(Server { address, controlling })
    }

    /// Returns the address to open, with its token.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Returns the address to open to control the run, with both secrets; `None` if the run cannot be controlled.
    pub fn controlling_address(&self) -> Option<&str> {
        self.controlling.as_deref()
    }
}

impl Site for RunPage {
    fn policy(&self) -> &'static str {
        if self.in_frames { IN_FRAMES } else { POLICY }
    }

    async fn answer(
        self: Arc<Self>,
        access: &AccessCheck,
        request: Request<Incoming>,
        is_drawing: &AtomicBool,
    ) -> Answer {
        if let (Some(control), &Method::POST) = (&self.control, request.method()) {
            let (head, body) = request.into_parts();
            return match access.admit_post(control.secret(), &head.headers, head.uri.path()) {
                Ok("command") => self.command(&head.headers, body).await,
                Ok(_) => Answer::refused(Refusal::Method),
                Err(refusal) => Answer::refused(refusal),
            };
        }
        let (uri, query) = (request.uri(), request.uri().query().unwrap_or_default());
        let (method, headers, path) = (request.method(), request.headers(), uri.path());
        let admitted = if self.in_frames {
            access.admit_frame(method, headers, path)
        } else {
            access.admit(method, headers, path)
        };
        match admitted {
            Err(refusal) => Answer::refused(refusal),
            Ok(rest) => self.read(rest, query, is_drawing).await,
        }
    }
}

impl RunPage {
    /// Creates the page of a run. With `control`, it can control the run.
    pub fn new(scene: Shared, subject: Subject, control: Option<Control>) -> RunPage {
        RunPage { scene, subject, control, in_frames: false }
    }

    /// Answers an admitted request that gives commands to the run.
    pub async fn command(&self, headers: &HeaderMap, body: Incoming) -> Answer {
        match &self.control {
            None => Answer::refused(Refusal::Method),
            Some(control) => {
                let (status, value) = control.answer(headers, body).await;
                Answer::json(status, &value)
            }
        }
    }

    /// Answers an admitted request that reads a part of the page.
    pub async fn read(self: &Arc<Self>, rest: &str, query: &str, is_drawing: &AtomicBool) -> Answer {
        let ok = StatusCode::OK;
        match (file(rest), data(&self.scene, rest, query), figure_kind(rest)) {
            (Some((content_type, text)), ..) => Answer::of(ok, content_type, text),
            (None, Some(value), _) => Answer::json(ok, &value),
            (None, None, Some(kind)) => {
                is_drawing.store(true, Ordering::Relaxed);
                let answer = self.figure(kind, query.to_owned()).await;
                is_drawing.store(false, Ordering::Relaxed);
                answer
            }
            (None, None, None) => Answer::not_found(),
        }
    }

    /// Draws a figure, on a thread of its own, until the page no longer waits for it.
    async fn figure(self: &Arc<Self>, kind: Kind, query: String) -> Answer {
        let unwanted = Unwanted(Arc::default());
        let (page, is_unwanted) = (Arc::clone(self), Arc::clone(&unwanted.0));
        let drawing = tokio::task::spawn_blocking(move || {
            let going = || !is_unwanted.load(Ordering::Relaxed);
            page.subject.draw(&page.scene, kind, &query, &going)
        });
        match drawing.await {
            Ok(Ok(Saved { data, content_type, name })) => {
                Answer::of(StatusCode::OK, content_type, data).saved_as(name)
            }
            Ok(Err(error)) => Answer::of(StatusCode::BAD_REQUEST, TEXT, error + "\n"),
            Err(_) => Answer::of(StatusCode::INTERNAL_SERVER_ERROR, TEXT, "the figure could not be drawn\n"),
        }
    }
}

/// Returns the kind of a figure by its name: `figure.svg`, `figure.png` and so on.
fn figure_kind(name: &str) -> Option<Kind> {
    Kind::of_extension(name.strip_prefix("figure.")?)
}

/// Returns the type and the text of a file of the page.
pub fn file(name: &str) -> Option<(&'static str, &'static str)> {
    FILES.into_iter().find(|(n, ..)| *n == name).map(|(_, kind, text)| (kind, text))
}

/// Returns the requested part of the scene. Missing or invalid numbers count as zero.
fn data(scene: &Shared, name: &str, query: &str) -> Option<Value> {
    let number = |key: &str| -> u64 {
        let value = query.split('&').filter_map(|pair| pair.split_once('=')).find(|(k, _)| *k == key);
        value.and_then(|(_, v)| v.parse().ok()).unwrap_or(0)
    };
    let place = |key| usize::try_from(number(key)).unwrap_or(usize::MAX);
    Some(match name {
        "scene" => scene.lock().beginning(),
        "events" => scene.lock().since(place("from"), place("bin"), number("width")),
        "talk" => scene.lock().talk(place("first"), place("count").min(BINS_AT_ONCE)),
        "messages" => {
            let id = u32::try_from(number("id")).unwrap_or(u32::MAX);
            scene.lock().messages(ModuleId(id), number("at"))
        }
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_module_agent::registry::Family;

    /// The page shows families added later without a change: everything about a family comes from the scene.
    #[test]
    fn the_page_names_no_family() {
        for (file, _, text) in FILES.into_iter().filter(|(name, ..)| *name != LIBRARY) {
            for word in text.split(|c: char| !c.is_alphanumeric()) {
                let word = word.to_lowercase();
                let named = |family: &Family| word.trim_end_matches('s') == family.name();
                assert!(!Family::ALL.iter().any(named), "{file}: {word}");
            }
        }
    }
}
