//! Commands that the page sends: who may send them, in which order, and how many.
//!
//! Only a request that names this server as its host and origin and that holds a second secret reaches the run. That
//! secret is in the fragment of an address, which browsers send to no server and write into no log of requests.

use super::access::Token;
use super::http::{json_body, refused};
use hyper::StatusCode;
use hyper::body::Incoming;
use hyper::header::HeaderMap;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_processes::control::{Answer, Operators, Unreachable};
use metamorph_protocol::time::Time;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::sync::Mutex;
use tokio::time::timeout;

/// The version of the format of requests.
pub const VERSION: u16 = 1;
/// Largest size of the body of a request, in bytes.
const MAX_BODY: usize = 64 << 10;
/// Longest time that a request waits for the run before it is answered as pending.
const RUN_WAIT_MAX: Duration = Duration::from_secs(2);
/// Time for which a session keeps the control without using it.
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

impl Posted {
    /// Reads the body of a request.
    fn read(body: &[u8]) -> Result<Posted, String> {
        let posted: Posted =
            serde_json::from_slice(body).map_err(|error| format!("the body is malformed: {error}"))?;
        if posted.version != VERSION {
            return Err(format!("this program reads version {VERSION} of requests, not {}", posted.version));
        }
        if posted.session.is_empty()
            || posted.session.chars().count() > MAX_NAME
            || posted.commands.is_empty()
        {
            return Err(format!("a request has a session of 1 to {MAX_NAME} characters, and commands"));
        }
        Ok(posted)
    }
}

/// State of a session.
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

impl Control {
    /// Creates the channel to a run.
    pub fn new(secret: Token, operators: Operators) -> Control {
        Control { secret, operators, since: Stopwatch::start(), sessions: Mutex::default() }
    }

    /// Returns the secret that requests must hold.
    pub fn secret(&self) -> &Token {
        &self.secret
    }

    /// Answers an authorized request.
    pub async fn answer(&self, headers: &HeaderMap, body: Incoming) -> Response {
        let body = match json_body(headers, body, MAX_BODY).await {
            Ok(body) => body,
            Err(refused) => return refused,
        };
        let posted = match Posted::read(&body) {
            Ok(posted) => posted,
            Err(why) => return refused(StatusCode::BAD_REQUEST, &why),
        };
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
        let Ok(answered) = timeout(RUN_WAIT_MAX, pending).await else { return };
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

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::rng::Rng;
    use metamorph_sim_bridge::director::commands::Commands;
    use metamorph_sim_bridge::metamodule::faults::{COMMANDS, OBSTACLE, OBSTACLE_GONE};

    const BODIES: [&str; 3] = [
        r#"{"version":1,"session":"a1b2","n":1,"take_over":false,"commands":["kill 7","goto 3 [4, 5, 0] for 30s"]}"#,
        r#"{"version":1,"session":"é","n":18446744073709551615,"commands":["goal.move [1, -2]","hold 3 for 1ns"]}"#,
        r#"{"version":1,"session":"a","n":2,"commands":["block [1, 2, 3]","take 0 31","release 4294967295"]}"#,
    ];
    const PARTS: [&[u8]; 8] =
        [b"\"", b"[", b"{", b"\\u0000", b"9999999999999999999", b"; ", b"\xff", b" for "];

    /// Returns a body with a few places changed.
    fn changed(rng: &mut Rng) -> Vec<u8> {
        let mut body = BODIES[rng.below(BODIES.len() as u64) as usize].as_bytes().to_vec();
        for _ in 0..1 + rng.below(4) {
            let at = rng.below(body.len() as u64 + 1) as usize;
            match rng.below(4) {
                0 if at < body.len() => body[at] = rng.next_u64() as u8,
                1 => body.truncate(at),
                2 => drop(body.splice(at..at, PARTS[rng.below(8) as usize].iter().copied())),
                _ => {
                    let to = (at + rng.below(8) as usize).min(body.len());
                    drop(body.drain(at..to));
                }
            }
        }
        body
    }

    /// Reads changed bodies, and returns how many were requests and how many of these were commands.
    fn read_changed(bodies: u64, seed: u64) -> (u64, u64) {
        let world = [[&OBSTACLE, &OBSTACLE_GONE].as_slice(), &COMMANDS].concat();
        let mut rng = Rng::named(seed, "bodies", 0);
        let (mut requests, mut given) = (0, 0);
        for _ in 0..bodies {
            let Ok(posted) = Posted::read(&changed(&mut rng)) else { continue };
            requests += 1;
            let text = format!("at 1 ns by operator 1: {}", posted.commands.join("; "));
            if let Ok(commands) = Commands::parse(&text, &world) {
                given += 1;
                // What is taken is written down as it is read.
                assert_eq!(Commands::parse(&commands.to_string(), &world), Ok(commands), "{text}");
            }
        }
        (requests, given)
    }

    #[test]
    fn no_body_makes_the_reader_panic() {
        let (requests, given) = read_changed(20_000, 1);
        assert!(requests > 100 && given > 10, "{requests}, {given}");
    }

    /// `cargo test --release -p metamorph-world-controller --lib ten_million_bodies -- --ignored`
    #[test]
    #[ignore = "takes minutes without optimization"]
    fn ten_million_bodies() {
        let (requests, given) = read_changed(10_000_000, 2);
        assert!(requests > 50_000 && given > 5_000, "{requests}, {given}");
    }
}
