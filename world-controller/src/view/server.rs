//! The server of the page: on the loopback interface, behind the access check, on a thread of its own. It
//! serves the files that are in the program and the scene as JSON, and nothing else.
//!
//! Every user of the machine can connect, so connections, their headers and their time are bounded.

use super::access::{AccessCheck, Token};
use super::scene_builder::Shared;
use crate::console::command_error::{BAD_USAGE, CommandError, FAILED};
use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderName, HeaderValue, REFERRER_POLICY,
    X_CONTENT_TYPE_OPTIONS,
};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use metamorph_protocol::ids::ModuleId;
use serde_json::Value;
use std::convert::Infallible;
use std::io;
use std::net::{Ipv4Addr, TcpListener};
use std::pin::pin;
use std::sync::Arc;
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
const FILES: [(&str, &str, &str); 10] = [
    ("", "text/html; charset=utf-8", include_str!("page/index.html")),
    ("style.css", "text/css; charset=utf-8", include_str!("page/style.css")),
    ("main.js", JS, include_str!("page/main.js")),
    ("story.js", JS, include_str!("page/story.js")),
    ("parts.js", JS, include_str!("page/parts.js")),
    ("camera.js", JS, include_str!("page/camera.js")),
    ("drawing.js", JS, include_str!("page/drawing.js")),
    ("picture.js", JS, include_str!("page/picture.js")),
    ("timeline.js", JS, include_str!("page/timeline.js")),
    ("panel.js", JS, include_str!("page/panel.js")),
];
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
}

struct Inside {
    access: AccessCheck,
    scene: Shared,
}

impl Server {
    /// Starts to serve a scene, at this port or at any free one.
    ///
    /// # Errors
    /// If the port is not available, or there is no thread.
    pub fn start(scene: Shared, port: Option<u16>) -> Result<Server, ServerError> {
        let bound = TcpListener::bind((Ipv4Addr::LOCALHOST, port.unwrap_or(0)));
        let listener = bound.map_err(|error| match port {
            Some(port) => ServerError::Port { port, error },
            None => ServerError::Listen(error),
        })?;
        listener.set_nonblocking(true)?;
        let access = AccessCheck::new(Token::random()?, listener.local_addr()?.port());
        let address = access.address();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let inside = Arc::new(Inside { access, scene });
        let listener = {
            let _entered = runtime.enter();
            tokio::net::TcpListener::from_std(listener)?
        };
        let page = std::thread::Builder::new().name("page".into());
        page.spawn(move || runtime.block_on(serve(listener, inside)))?;
        Ok(Server { address })
    }

    /// Returns the address to open, with its token.
    pub fn address(&self) -> &str {
        &self.address
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
    let service = service_fn(|request: Request<Incoming>| {
        let answered = answer(&inside, &request);
        async { Ok::<_, Infallible>(answered) }
    });
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEADERS);
    http.max_buf_size(MAX_HEADER_BYTES).max_headers(MAX_HEADERS);
    let mut connection = pin!(http.serve_connection(TokioIo::new(stream), service));
    // An error of a connection concerns its other end only.
    if timeout(LIFETIME, connection.as_mut()).await.is_err() {
        connection.as_mut().graceful_shutdown();
        let _ = timeout(LAST_ANSWER, connection).await;
    }
}

fn answer(inside: &Inside, request: &Request<Incoming>) -> Response<Full<Bytes>> {
    let uri = request.uri();
    let (status, kind, body) = match inside.access.admit(request.method(), request.headers(), uri.path()) {
        Err(refusal) => {
            let (status, text) = refusal.answer();
            (status, TEXT, Bytes::from_static(text.as_bytes()))
        }
        Ok(rest) => match (file(rest), data(&inside.scene, rest, uri.query().unwrap_or_default())) {
            (Some((kind, text)), _) => (StatusCode::OK, kind, Bytes::from_static(text.as_bytes())),
            (None, Some(value)) => (StatusCode::OK, "application/json", Bytes::from(value.to_string())),
            (None, None) => (StatusCode::NOT_FOUND, TEXT, Bytes::from_static(b"not found\n")),
        },
    };
    let mut response = Response::new(Full::new(body));
    *response.status_mut() = status;
    let headers = response.headers_mut();
    for (name, value) in [
        (CONTENT_TYPE, kind),
        (CONTENT_SECURITY_POLICY, POLICY),
        (CACHE_CONTROL, "no-store"),
        (REFERRER_POLICY, "no-referrer"),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
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
        for (file, _, text) in FILES {
            for word in text.split(|c: char| !c.is_alphanumeric()) {
                let word = word.to_lowercase();
                let named = |family: &Family| word.trim_end_matches('s') == family.name();
                assert!(!Family::ALL.iter().any(named), "{file}: {word}");
            }
        }
    }
}
