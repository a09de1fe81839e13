//! Commands that the page sends: who may send them, in which order, and how many.
//!
//! Only a request that names this server as its host and origin and that holds a second secret reaches the run. That
//! secret is in the fragment of an address, which browsers send to no server and write into no log of requests.

use super::access::Token;
use crate::console::stopwatch::Stopwatch;
use crate::control::{Answer, Operators, Unreachable};
use http_body_util::{BodyExt, Limited};
use hyper::StatusCode;
use hyper::body::Incoming;
use hyper::header::{AUTHORIZATION, CONTENT_TYPE, HeaderMap};
use metamorph_protocol::time::Time;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io;
use std::time::Duration;
use tokio::sync::Mutex;
use tokio::time::timeout;

/// The version of the format of requests.
const VERSION: u16 = 1;
/// Largest size of the body of a request, in bytes.
const MAX_BODY: usize = 64 << 10;
/// Time limit for the body of a request.
const BODY: Duration = Duration::from_secs(3);
/// How long a request waits for the run before it is answered as pending.
const RUN: Duration = Duration::from_secs(2);
/// How long a session keeps the control that it does not use.
const LEASE: Duration = Duration::from_secs(10);
/// Number of commands that a session can give at once.
const BURST: f64 = 40.0;
/// Number by which that grows in a second.
const RATE: f64 = 20.0;
/// Number of sessions remembered; the one used least recently is forgotten.
const SESSIONS: usize = 16;
/// Largest number of characters of the name of a session.
const MAX_NAME: usize = 64;

/// A request.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Posted {
    version: u16,
    /// A name that a page draws at random when it is loaded.
    session: String,
    /// The number of the request in its session, from 1.
    n: u64,
    /// Takes the control from another session.
    #[serde(default)]
    take_over: bool,
    commands: Vec<String>,
}

/// What is known of a session.
#[derive(Debug)]
struct Session {
    operator: u16,
    /// The number of its latest request, and the answer.
    n: u64,
    answer: (StatusCode, Value),
    /// The latest request, if the run has not answered it yet.
    pending: Option<Answer>,
    /// Number of commands that it can give now, at this time.
    allowance: f64,
    used: Duration,
}

#[derive(Debug, Default)]
struct Sessions {
    all: BTreeMap<String, Session>,
    /// The session that controls the run, and since when it has not used that.
    holder: Option<(String, Duration)>,
    operators: u16,
}

/// The channel through which a run is controlled.
#[derive(Debug)]
pub struct Control {
    secret: Token,
    operators: Operators,
    since: Stopwatch,
    sessions: Mutex<Sessions>,
}

type Response = (StatusCode, Value);

fn refused(status: StatusCode, why: &str) -> Response {
    (status, json!({ "result": "refused", "why": why }))
}

impl Control {
    /// Creates the channel to a run, with a new secret.
    ///
    /// # Errors
    /// If the system has no random bytes.
    pub fn new(operators: Operators) -> io::Result<Control> {
        let (secret, since) = (Token::random()?, Stopwatch::start());
        Ok(Control { secret, operators, since, sessions: Mutex::default() })
    }

    /// Returns the secret, for the printed address.
    pub fn secret(&self) -> &str {
        self.secret.text()
    }

    /// Returns whether the headers of a request hold the secret.
    pub fn is_authorized(&self, headers: &HeaderMap) -> bool {
        let mut all = headers.get_all(AUTHORIZATION).iter();
        let given = all.next().and_then(|value| value.to_str().ok()).and_then(|v| v.strip_prefix("Bearer "));
        all.next().is_none() && given.is_some_and(|given| self.secret.is(given))
    }

    /// Answers an authorized request.
    pub async fn answer(&self, headers: &HeaderMap, body: Incoming) -> Response {
        if headers.get(CONTENT_TYPE).is_none_or(|kind| kind != "application/json") {
            return refused(StatusCode::UNSUPPORTED_MEDIA_TYPE, "the body must be application/json");
        }
        let body = match timeout(BODY, Limited::new(body, MAX_BODY).collect()).await {
            Err(_) => return refused(StatusCode::REQUEST_TIMEOUT, "the body took too long"),
            Ok(Err(_)) => {
                let why = format!("the body is unreadable or longer than {MAX_BODY} bytes");
                return refused(StatusCode::PAYLOAD_TOO_LARGE, &why);
            }
            Ok(Ok(body)) => body.to_bytes(),
        };
        let posted: Posted = match serde_json::from_slice(&body) {
            Ok(posted) => posted,
            Err(error) => {
                return refused(StatusCode::BAD_REQUEST, &format!("the body is malformed: {error}"));
            }
        };
        if posted.version != VERSION {
            let why = format!("this program reads version {VERSION} of requests, not {}", posted.version);
            return refused(StatusCode::BAD_REQUEST, &why);
        }
        if posted.session.is_empty()
            || posted.session.chars().count() > MAX_NAME
            || posted.commands.is_empty()
        {
            let why = format!("a request has a session of 1 to {MAX_NAME} characters, and commands");
            return refused(StatusCode::BAD_REQUEST, &why);
        }
        // One request after the other, so that their order is that of their numbers.
        let mut sessions = self.sessions.lock().await;
        sessions.handle(posted, self.since.elapsed(), &self.operators).await
    }
}

impl Sessions {
    async fn handle(&mut self, posted: Posted, now: Duration, operators: &Operators) -> Response {
        let Posted { session: name, n, take_over, commands, .. } = posted;
        if !self.all.contains_key(&name) {
            self.begin(&name, now);
        }
        // Invariant: the session was there, or has just begun.
        let Some(session) = self.all.get_mut(&name) else { unreachable!("the session has begun") };
        session.settle().await;
        if n == session.n && n > 0 {
            return session.answer.clone();
        }
        let due = session.n + 1;
        if n != due {
            let why = format!("the next request of this session has number {due}");
            return (StatusCode::CONFLICT, json!({ "result": "refused", "why": why, "due": due }));
        }
        if session.pending.is_some() {
            return refused(StatusCode::TOO_MANY_REQUESTS, "the request before is still waiting for the run");
        }
        let other = self.holder.as_ref().filter(|(holder, used)| *holder != name && now < *used + LEASE);
        if other.is_some() && !take_over {
            return refused(
                StatusCode::LOCKED,
                "another page controls the run; take over or wait until it is idle",
            );
        }
        let grown = (now.saturating_sub(session.used)).as_secs_f64() * RATE;
        session.allowance = (session.allowance + grown).min(BURST);
        session.used = now;
        if session.allowance < commands.len() as f64 {
            let seconds = (commands.len() as f64 - session.allowance) / RATE;
            let why = format!("too many commands; try again in {seconds:.1} s, with at most {BURST} at once");
            return refused(StatusCode::TOO_MANY_REQUESTS, &why);
        }
        session.allowance -= commands.len() as f64;
        self.holder = Some((name, now));
        match operators.give(session.operator, commands) {
            Ok(answer) => session.pending = Some(answer),
            Err(Unreachable::Full) => {
                return refused(StatusCode::TOO_MANY_REQUESTS, &Unreachable::Full.to_string());
            }
            Err(over) => return refused(StatusCode::GONE, &over.to_string()),
        }
        session.n = n;
        session.answer = (StatusCode::ACCEPTED, json!({ "result": "pending", "n": n }));
        session.settle().await;
        session.answer.clone()
    }

    fn begin(&mut self, name: &str, now: Duration) {
        if self.all.len() == SESSIONS {
            let oldest =
                self.all.iter().min_by_key(|(_, session)| session.used).map(|(name, _)| name.clone());
            oldest.iter().for_each(|name| drop(self.all.remove(name)));
        }
        self.operators = self.operators.saturating_add(1);
        let none = refused(StatusCode::BAD_REQUEST, "no request");
        let (operator, used) = (self.operators, now);
        let session = Session { operator, n: 0, answer: none, pending: None, allowance: BURST, used };
        self.all.insert(name.to_owned(), session);
    }
}

impl Session {
    /// Waits for the answer of the run, if there is one to come.
    async fn settle(&mut self) {
        let Some(pending) = &mut self.pending else { return };
        let Ok(answered) = timeout(RUN, pending).await else { return };
        self.pending = None;
        let (operator, n) = (self.operator, self.n);
        self.answer = match answered {
            Ok(Ok(Time(at))) => {
                let at = at as f64 / 1e9;
                (StatusCode::OK, json!({ "result": "taken", "n": n, "operator": operator, "at_s": at }))
            }
            Ok(Err(why)) => {
                let value = json!({ "result": "refused", "n": n, "operator": operator, "why": why });
                (StatusCode::OK, value)
            }
            Err(_) => (StatusCode::GONE, json!({ "result": "refused", "n": n, "why": "the run is over" })),
        };
    }
}
