//! The server of metrics: `GET /metrics`, and nothing else. They hold nothing secret, so there is no token; they are served on
//! the loopback interface unless another address is given in full.

use super::access::{AccessCheck, Token};
use super::http::{Answer, Site, TEXT, serve_on};
use hyper::body::Incoming;
use hyper::{Method, Request, StatusCode};
use metamorph_processes::metrics::Metrics;
use metamorph_processes::metrics::open_metrics::CONTENT_TYPE;
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED};
use metamorph_text::escape::Shown;
use std::fmt;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, TcpListener, ToSocketAddrs};
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use thiserror::Error;

/// The path under which metrics are served.
const PATH: &str = "/metrics";

/// The address on which metrics are served.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MetricsAddress {
    machine: String,
    port: u16,
}

/// A text is no address.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "`{0}` is no address\n  fix: write a port such as 9100, for this machine only, or an address with its port such as 10.0.0.2:9100"
)]
pub struct MetricsAddressError(String);

impl FromStr for MetricsAddress {
    type Err = MetricsAddressError;
    fn from_str(text: &str) -> Result<MetricsAddress, MetricsAddressError> {
        let wrong = || MetricsAddressError(text.shown());
        let (machine, port) = text.rsplit_once(':').unwrap_or(("", text));
        let is_number = !port.is_empty() && port.bytes().all(|b| b.is_ascii_digit());
        let port = port.parse().ok().filter(|_| is_number).ok_or_else(wrong)?;
        let is_bare = |machine: &str| !machine.contains([':', '/', '[', ']', '@', ' ']);
        let bracketed = machine.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
        match bracketed.or(is_bare(machine).then_some(machine)) {
            Some("") => Ok(MetricsAddress { machine: Ipv4Addr::LOCALHOST.to_string(), port }),
            Some(machine) => Ok(MetricsAddress { machine: machine.to_owned(), port }),
            None => Err(wrong()),
        }
    }
}

impl fmt::Display for MetricsAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let machine = self.machine.shown();
        if machine.contains(':') {
            write!(f, "[{machine}]:{}", self.port)
        } else {
            write!(f, "{machine}:{}", self.port)
        }
    }
}

/// Metrics cannot be served.
#[derive(Debug, Error)]
pub enum MetricsError {
    /// The address is in use, of another machine, or not allowed.
    #[error("--metrics {address}: {error}\n  fix: name another port, or another address of this machine")]
    Address {
        /// The address.
        address: MetricsAddress,
        /// The cause.
        error: io::Error,
    },
    /// There is no thread.
    #[error("--metrics: they cannot be served: {0}")]
    Thread(#[from] io::Error),
}

impl CommandError for MetricsError {
    fn exit_code(&self) -> u8 {
        match self {
            MetricsError::Address { .. } => BAD_USAGE,
            MetricsError::Thread(_) => FAILED,
        }
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

struct MetricsSite(Metrics);

impl Site for MetricsSite {
    fn policy(&self) -> &'static str {
        "default-src 'none'; frame-ancestors 'none'"
    }

    async fn answer(
        self: Arc<Self>,
        _access: &AccessCheck,
        request: Request<Incoming>,
        _is_drawing: &AtomicBool,
    ) -> Answer {
        match (request.method(), request.uri().path()) {
            (&Method::GET, PATH) => Answer::of(StatusCode::OK, CONTENT_TYPE, self.0.text()),
            (_, PATH) => Answer::of(StatusCode::METHOD_NOT_ALLOWED, TEXT, "only GET\n"),
            _ => Answer::not_found(),
        }
    }
}

/// Serves metrics on an address until the program ends, on a thread of its own. Returns where they are.
///
/// # Errors
/// If the address cannot be used, or there is no thread.
pub fn serve_metrics(metrics: Metrics, address: &MetricsAddress) -> Result<String, MetricsError> {
    let at: io::Result<Vec<SocketAddr>> =
        (address.machine.as_str(), address.port).to_socket_addrs().map(Iterator::collect);
    let bound = at.and_then(|at| TcpListener::bind(&at[..]));
    let listener = bound.map_err(|error| MetricsError::Address { address: address.clone(), error })?;
    let at = listener.local_addr()?;
    serve_on(listener, "metrics", AccessCheck::new(Token::random()?, at.port()), MetricsSite(metrics))?;
    Ok(format!("http://{at}{PATH}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_is_one_of_this_machine_and_other_addresses_are_said_in_full() {
        let shown = |text: &str| text.parse::<MetricsAddress>().map(|address| address.to_string());
        for (text, address) in [
            ("9100", "127.0.0.1:9100"),
            (":9100", "127.0.0.1:9100"),
            ("0", "127.0.0.1:0"),
            ("10.0.0.2:9100", "10.0.0.2:9100"),
            ("rack3:9100", "rack3:9100"),
            ("[::1]:9100", "[::1]:9100"),
        ] {
            assert_eq!(shown(text).as_deref(), Ok(address), "{text}");
        }
        for wrong in
            ["", ":", "+1", "65536", "10.0.0.2", "rack3", "::1:9100", "http://a:9100", "a b:1", "[::1]"]
        {
            assert_eq!(shown(wrong), Err(MetricsAddressError(wrong.to_owned())), "{wrong}");
        }
    }
}
