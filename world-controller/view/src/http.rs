//! A server of pages on the loopback interface: what it listens on, how many connections it keeps for how long, and the
//! headers of every response. What is asked for is answered by a [`Site`].
//!
//! Every user of the machine can connect, so connections, their headers, their bodies and their time are bounded.

use super::access::{AccessCheck, Refusal, Token};
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{
    CACHE_CONTROL, CONNECTION, CONTENT_DISPOSITION, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderMap,
    HeaderName, HeaderValue, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED};
use serde_json::{Value, json};
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
/// Time limit for the body of a request.
const BODY: Duration = Duration::from_secs(3);
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
/// Time to wait before another attempt to accept a connection, when the system is short of a resource.
const AGAIN: Duration = Duration::from_secs(1);

/// The type of a script.
pub const JS: &str = "text/javascript; charset=utf-8";
/// The type of a text.
pub const TEXT: &str = "text/plain; charset=utf-8";

/// Errors of serving a page.
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

/// A response before its headers.
#[derive(Debug)]
pub struct Answer {
    status: StatusCode,
    content_type: &'static str,
    body: Bytes,
    /// The name of the file to save it as.
    name: Option<String>,
    /// Whether the connection is closed after it.
    is_last: bool,
}

impl Answer {
    /// A response with a body of this type.
    pub fn of(status: StatusCode, content_type: &'static str, body: impl Into<Bytes>) -> Answer {
        Answer { status, content_type, body: body.into(), name: None, is_last: false }
    }
    /// A response with a value as JSON.
    pub fn json(status: StatusCode, value: &Value) -> Answer {
        Answer::of(status, "application/json", value.to_string())
    }
    /// A request that is refused before it is looked at. Its connection is closed, so that a program that asks again and again
    /// without permission does not take the place of the page of the owner.
    pub fn refused(refusal: Refusal) -> Answer {
        let (status, text) = refusal.answer();
        Answer { is_last: true, ..Answer::of(status, TEXT, text) }
    }
    /// There is nothing of this name.
    pub fn not_found() -> Answer {
        Answer::of(StatusCode::NOT_FOUND, TEXT, "not found\n")
    }
    /// This response, to be saved as a file of this name, which consists of letters, digits, dots and dashes.
    pub fn saved_as(self, name: String) -> Answer {
        Answer { name: Some(name), ..self }
    }
}

/// A refused request, as JSON.
pub fn refused(status: StatusCode, why: &str) -> (StatusCode, Value) {
    (status, json!({ "result": "refused", "why": why }))
}

/// Reads the body of a request, which must be JSON of at most `most` bytes.
///
/// # Errors
/// The response to a body of another type, to one that is too long, and to one that is too slow.
pub async fn json_body(
    headers: &HeaderMap,
    body: Incoming,
    most: usize,
) -> Result<Bytes, (StatusCode, Value)> {
    if headers.get(CONTENT_TYPE).is_none_or(|kind| kind != "application/json") {
        return Err(refused(StatusCode::UNSUPPORTED_MEDIA_TYPE, "the body must be application/json"));
    }
    match timeout(BODY, Limited::new(body, most).collect()).await {
        Err(_) => Err(refused(StatusCode::REQUEST_TIMEOUT, "the body took too long")),
        Ok(Err(_)) => {
            let why = format!("the body is unreadable or longer than {most} bytes");
            Err(refused(StatusCode::PAYLOAD_TOO_LARGE, &why))
        }
        Ok(Ok(body)) => Ok(body.to_bytes()),
    }
}

/// A site that a server serves.
pub trait Site: Send + Sync + 'static {
    /// Returns the content security policy: the sources a page may load, and the sites that may embed it.
    fn policy(&self) -> &'static str;
    /// Answers a request that has not been checked yet. `is_drawing` is set while a figure is drawn.
    fn answer(
        self: Arc<Self>,
        access: &AccessCheck,
        request: Request<Incoming>,
        is_drawing: &AtomicBool,
    ) -> impl Future<Output = Answer> + Send;
}

struct Inside<S> {
    access: AccessCheck,
    site: Arc<S>,
}

/// Serves a site at this port or at any free one until the program ends, on a thread of its own. Returns the address
/// to open, with its token.
///
/// # Errors
/// If the port is not available, or there is no thread.
pub fn serve_site<S: Site>(site: S, port: Option<u16>) -> Result<String, ServerError> {
    let bound = TcpListener::bind((Ipv4Addr::LOCALHOST, port.unwrap_or(0)));
    let listener = bound.map_err(|error| match port {
        Some(port) => ServerError::Port { port, error },
        None => ServerError::Listen(error),
    })?;
    let access = AccessCheck::new(Token::random()?, listener.local_addr()?.port());
    let address = access.address();
    serve_on(listener, "page", access, site)?;
    Ok(address)
}

/// Serves a site until the program ends, on a thread of this name.
///
/// # Errors
/// If there is no thread.
pub fn serve_on<S: Site>(
    listener: TcpListener,
    name: &str,
    access: AccessCheck,
    site: S,
) -> Result<(), io::Error> {
    listener.set_nonblocking(true)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let inside = Arc::new(Inside { access, site: Arc::new(site) });
    let listener = {
        let _entered = runtime.enter();
        tokio::net::TcpListener::from_std(listener)?
    };
    let thread = std::thread::Builder::new().name(name.into());
    thread.spawn(move || runtime.block_on(serve(listener, inside)))?;
    Ok(())
}

/// Accepts connections, at most [`CONNECTIONS`] at a time.
async fn serve<S: Site>(listener: tokio::net::TcpListener, inside: Arc<Inside<S>>) {
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
                tracing::warn!("a connection cannot be accepted: {error}");
                sleep(AGAIN).await;
            }
        }
    }
}

/// Answers the requests of one connection.
async fn serve_one<S: Site>(stream: TcpStream, inside: Arc<Inside<S>>) {
    let is_drawing = Arc::new(AtomicBool::new(false));
    let service = service_fn(|request: Request<Incoming>| {
        let (inside, is_drawing) = (Arc::clone(&inside), Arc::clone(&is_drawing));
        async move {
            let policy = inside.site.policy();
            let answer = Arc::clone(&inside.site).answer(&inside.access, request, &is_drawing).await;
            Ok::<_, Infallible>(response(policy, answer))
        }
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

fn response(policy: &'static str, answer: Answer) -> Response<Full<Bytes>> {
    let mut response = Response::new(Full::new(answer.body));
    *response.status_mut() = answer.status;
    let headers = response.headers_mut();
    for (name, value) in [
        (CONTENT_TYPE, answer.content_type),
        (CONTENT_SECURITY_POLICY, policy),
        (CACHE_CONTROL, "no-store"),
        (REFERRER_POLICY, "no-referrer"),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    if answer.is_last {
        headers.insert(CONNECTION, HeaderValue::from_static("close"));
    }
    let attachment =
        answer.name.map(|name| HeaderValue::try_from(format!("attachment; filename=\"{name}\"")));
    if let Some(Ok(attachment)) = attachment {
        headers.insert(CONTENT_DISPOSITION, attachment);
    }
    response
}
