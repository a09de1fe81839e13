//! The server of the page: on the loopback interface, behind the access check, on a thread of its own. It
//! serves the files that are in the program, the scene as JSON, and figures of it, and nothing else.
//!
//! Every user of the machine can connect, so connections, their headers and their time are bounded.

use super::access::{AccessCheck, Refusal, Token};
use super::control::Control;
use super::figure::request::Kind;
use super::saved::{Saved, Subject};
use super::scene_builder::Shared;
use crate::console::command_error::{BAD_USAGE, CommandError, FAILED};
use crate::control::Operators;
use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{
    CACHE_CONTROL, CONTENT_DISPOSITION, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderName, HeaderValue,
    REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use metamorph_protocol::ids::ModuleId;
use serde_json::Value;
use std::convert::Infallible;
use std::io;
use std::net::{Ipv4Addr, TcpListener};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use thiserror::Error;
use tokio::net::TcpStream;
use tokio::sync::Semaphore;
use tokio::time::{sleep, timeout};

/// Number of simultaneous connections; others wait. A browser makes six.
const CONNECTIONS: usize = 128;
/// Time limit for the headers of a request, and for the pause between two requests.
const HEADERS: Duration = Duration::from_secs(3);
/// Time after which a connection is closed once its latest response is sent. A browser makes a new one.
const LIFETIME: Duration = Duration::from_secs(60);
/// Time limit for that response.
const LAST_ANSWER: Duration = Duration::from_secs(10);
/// Time limit for that response if a figure is being drawn for it.
const LAST_FIGURE: Duration = Duration::from_secs(600);
/// Largest size of the headers, and of the read buffer, in bytes.
const MAX_HEADER_BYTES: usize = 16 << 10;
/// Largest number of headers of a request.
const MAX_HEADERS: usize = 64;
/// Pause before another attempt to accept a connection, when the system is short of a resource.
const AGAIN: Duration = Duration::from_secs(1);

/// Number of time bins sent at once.
const BINS_AT_ONCE: usize = 64;
/// The page may only use resources of this server, and no other page may embed it.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; \
                      img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The files of the page: name, type and content.
const FILES: [(&str, &str, &str); 22] = [
    ("", "text/html; charset=utf-8", include_str!("page/index.html")),
    ("style.css", "text/css; charset=utf-8", include_str!("page/style.css")),
    ("main.js", JS, include_str!("page/main.js")),
    ("story.js", JS, include_str!("page/story.js")),
    ("parts.js", JS, include_str!("page/parts.js")),
    ("figure.js", JS, include_str!("page/figure.js")),
    ("viewpoint.js", JS, include_str!("page/viewpoint.js")),
    ("dom.js", JS, include_str!("page/dom.js")),
    ("look.js", JS, include_str!("page/look.js")),
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
const LIBRARY: &str = "vendor/three.js";
const JS: &str = "text/javascript; charset=utf-8";

/// Errors of serving the page.
#[derive(Debug, Error)]
pub enum ServerError {
    /// The port is taken or not allowed.
    #[error(
        "--port {port}: the page cannot be served there: {error}\n  fix: name another port, or leave it out"
    )]
    Port {
        /// The port.
        port: u16,
        /// The cause.
        error: io::Error,
    },
    /// No port or no thread is available.
    #[error("the page cannot be served on this machine's loopback address: {0}")]
    Listen(#[from] io::Error),
}

impl CommandError for ServerError {
    fn exit_code(&self) -> u8 {
        match self {
            ServerError::Port { .. } => BAD_USAGE,
            ServerError::Listen(_) => FAILED,
        }
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

/// A page that is served until the program ends.
#[derive(Debug)]
pub struct Server {
    address: String,
    controlling: Option<String>,
}

struct Inside {
    access: AccessCheck,
    scene: Shared,
    subject: Subject,
    control: Option<Control>,
}

/// A response before its headers.
struct Answer {
    status: StatusCode,
    content_type: &'static str,
    body: Bytes,
    /// The name of the file to save it as.
    name: Option<String>,
}

impl Answer {
    fn of(status: StatusCode, content_type: &'static str, body: impl Into<Bytes>) -> Answer {
        Answer { status, content_type, body: body.into(), name: None }
    }
}

/// Set when dropped: when the response is made, or when its connection is closed before.
struct Unwanted(Arc<AtomicBool>);

impl Drop for Unwanted {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Server {
    /// Starts to serve a scene and figures of it, at this port or at any free one. With `operators`, its page can control
    /// the run.
    ///
    /// # Errors
    /// If the port is not available, or there is no thread.
    pub fn start(
        scene: Shared,
        subject: Subject,
        port: Option<u16>,
        operators: Option<Operators>,
    ) -> Result<Server, ServerError> {
        let bound = TcpListener::bind((Ipv4Addr::LOCALHOST, port.unwrap_or(0)));
        let listener = bound.map_err(|error| match port {
            Some(port) => ServerError::Port { port, error },
            None => ServerError::Listen(error),
        })?;
        listener.set_nonblocking(true)?;
        let access = AccessCheck::new(Token::random()?, listener.local_addr()?.port());
        let address = access.address();
        let control = operators.map(Control::new).transpose()?;
        let controlling = control.as_ref().map(|control| format!("{address}#c={}", control.secret()));
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let inside = Arc::new(Inside { access, scene, subject, control });
        let listener = {
            let _entered = runtime.enter();
            tokio::net::TcpListener::from_std(listener)?
        };
        let page = std::thread::Builder::new().name("page".into());
        page.spawn(move || runtime.block_on(serve(listener, inside)))?;
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

/// Accepts connections, at most [`CONNECTIONS`] at a time.
async fn serve(listener: tokio::net::TcpListener, inside: Arc<Inside>) {
    let places = Arc::new(Semaphore::new(CONNECTIONS));
    while let Ok(place) = Arc::clone(&places).acquire_owned().await {
        match listener.accept().await {
            Ok((stream, _)) => {
                let inside = Arc::clone(&inside);
                tokio::spawn(async move {
                    serve_one(stream, inside).await;
                    drop(place);
                });
            }
            Err(error) => {
                tracing::warn!("the page cannot be asked for: {error}");
                sleep(AGAIN).await;
            }
        }
    }
}

/// Answers the requests of one connection.
async fn serve_one(stream: TcpStream, inside: Arc<Inside>) {
    let is_drawing = Arc::new(AtomicBool::new(false));
    let service = service_fn(|request: Request<Incoming>| {
        let (inside, is_drawing) = (Arc::clone(&inside), Arc::clone(&is_drawing));
        async move { Ok::<_, Infallible>(answer(&inside, request, &is_drawing).await) }
    });
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEADERS);
    http.max_buf_size(MAX_HEADER_BYTES).max_headers(MAX_HEADERS);
    let mut connection = pin!(http.serve_connection(TokioIo::new(stream), service));
    // An error of a connection concerns its other end only.
    if timeout(LIFETIME, connection.as_mut()).await.is_err() {
        connection.as_mut().graceful_shutdown();
        let limit = if is_drawing.load(Ordering::Relaxed) { LAST_FIGURE } else { LAST_ANSWER };
        let _ = timeout(limit, connection).await;
    }
}

async fn answer(
    inside: &Arc<Inside>,
    request: Request<Incoming>,
    is_drawing: &AtomicBool,
) -> Response<Full<Bytes>> {
    let answer = match (&inside.control, request.method()) {
        (Some(control), &Method::POST) => command(inside, control, request).await,
        _ => read(inside, &request, is_drawing).await,
    };
    let mut response = Response::new(Full::new(answer.body));
    *response.status_mut() = answer.status;
    let headers = response.headers_mut();
    for (name, value) in [
        (CONTENT_TYPE, answer.content_type),
        (CONTENT_SECURITY_POLICY, POLICY),
        (CACHE_CONTROL, "no-store"),
        (REFERRER_POLICY, "no-referrer"),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    // The name consists of letters, digits, dots and dashes.
    let attachment =
        answer.name.map(|name| HeaderValue::try_from(format!("attachment; filename=\"{name}\"")));
    if let Some(Ok(attachment)) = attachment {
        headers.insert(CONTENT_DISPOSITION, attachment);
    }
    response
}

/// Answers a request that gives commands to the run.
async fn command(inside: &Inside, control: &Control, request: Request<Incoming>) -> Answer {
    let (head, body) = request.into_parts();
    match inside.access.admit_commands(control, &head.headers, head.uri.path()) {
        Err(refusal) => refused(refusal),
        Ok(()) => {
            let (status, value) = control.answer(&head.headers, body).await;
            Answer::of(status, "application/json", value.to_string())
        }
    }
}

fn refused(refusal: Refusal) -> Answer {
    let (status, text) = refusal.answer();
    Answer::of(status, TEXT, text)
}

/// Answers a request that reads a part of the page.
async fn read(inside: &Arc<Inside>, request: &Request<Incoming>, is_drawing: &AtomicBool) -> Answer {
    let (uri, ok) = (request.uri(), StatusCode::OK);
    let query = uri.query().unwrap_or_default();
    match inside.access.admit(request.method(), request.headers(), uri.path()) {
        Err(refusal) => refused(refusal),
        Ok(rest) => match (file(rest), data(&inside.scene, rest, query), figure_kind(rest)) {
            (Some((content_type, text)), ..) => Answer::of(ok, content_type, text),
            (None, Some(value), _) => Answer::of(ok, "application/json", value.to_string()),
            (None, None, Some(kind)) => {
                is_drawing.store(true, Ordering::Relaxed);
                let answer = figure(inside, kind, query.to_owned()).await;
                is_drawing.store(false, Ordering::Relaxed);
                answer
            }
            (None, None, None) => Answer::of(StatusCode::NOT_FOUND, TEXT, "not found\n"),
        },
    }
}

/// Draws a figure, on a thread of its own, until the page no longer waits for it.
async fn figure(inside: &Arc<Inside>, kind: Kind, query: String) -> Answer {
    let unwanted = Unwanted(Arc::default());
    let (inside, is_unwanted) = (Arc::clone(inside), Arc::clone(&unwanted.0));
    let drawing = tokio::task::spawn_blocking(move || {
        let going = || !is_unwanted.load(Ordering::Relaxed);
        inside.subject.draw(&inside.scene, kind, &query, &going)
    });
    match drawing.await {
        Ok(Ok(Saved { data, content_type, name })) => {
            Answer { name: Some(name), ..Answer::of(StatusCode::OK, content_type, data) }
        }
        Ok(Err(error)) => Answer::of(StatusCode::BAD_REQUEST, TEXT, error + "\n"),
        Err(_) => Answer::of(StatusCode::INTERNAL_SERVER_ERROR, TEXT, "the figure could not be drawn\n"),
    }
}

/// Returns the kind of a figure by its name: `figure.svg`, `figure.png` and so on.
fn figure_kind(name: &str) -> Option<Kind> {
    Kind::of_extension(name.strip_prefix("figure.")?)
}

const TEXT: &str = "text/plain; charset=utf-8";

fn file(name: &str) -> Option<(&'static str, &'static str)> {
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
