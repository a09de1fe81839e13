//! A program that commands a run under control: the other end of the channel of [`control`](super::control).
//!
//! The address of the channel is read from a file, since it ends with a secret that no command line should show.

use super::access::Token;
use super::control::VERSION;
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::Bytes;
use hyper::client::conn::http1;
use hyper::header::{AUTHORIZATION, CONTENT_TYPE, HOST, ORIGIN};
use hyper::{Request, StatusCode};
use hyper_util::rt::TokioIo;
use metamorph_module_agent::regular_file;
use metamorph_text::escape::Shown;
use serde_json::{Value, json};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;
use thiserror::Error;
use tokio::net::TcpStream;
use tokio::runtime::{Builder, Runtime};
use tokio::time::timeout;

/// Largest size of the file with an address, in bytes.
const MAX_FILE: u64 = 4096;
/// Largest size of an answer, in bytes.
const MAX_ANSWER: usize = 64 << 10;
/// Time limit for an answer; the run itself is waited for over several requests.
const PATIENCE: Duration = Duration::from_secs(10);
/// Number of times that a request is sent while the run does not answer it.
const TRIES: u32 = 15;

/// Why a run cannot be commanded.
#[derive(Debug, Error)]
pub enum ClientError {
    /// The file cannot be read.
    #[error("--control {}: {error}\n  fix: write the second address that `metamorph run --view --control` prints into this file", .path.shown())]
    File {
        /// The file.
        path: PathBuf,
        /// The cause.
        error: io::Error,
    },
    /// The file holds no address of a channel.
    #[error("--control {}: this is not the address of a run under control\n  fix: write the second address that `metamorph run --view --control` prints into this file; it ends with #c= and a secret", .0.shown())]
    Address(PathBuf),
    /// The run cannot be reached, or is over.
    #[error(
        "the run cannot be commanded: {0}\n  fix: check that it is still shown at this address; each run has another one"
    )]
    Unreachable(String),
    /// This program cannot send requests.
    #[error("cannot send a command: {0}")]
    System(#[from] io::Error),
}

/// A session that commands a run.
#[derive(Debug)]
pub struct ControlClient {
    runtime: Runtime,
    /// Machine and port, the path below which requests go, and the secret.
    host: String,
    root: String,
    secret: String,
    session: String,
    /// The number of the latest request.
    n: u64,
}

impl ControlClient {
    /// Reads the address of the channel from a file.
    ///
    /// # Errors
    /// If the file cannot be read, or holds something else.
    pub fn open(path: &Path) -> Result<ControlClient, ClientError> {
        let bytes = regular_file::read(path, MAX_FILE)
            .map_err(|error| ClientError::File { path: path.to_owned(), error })?;
        let text = String::from_utf8_lossy(&bytes);
        let parts = || {
            let (address, secret) = text.trim().strip_prefix("http://")?.split_once("#c=")?;
            let (host, root) = address.split_at(address.find('/')?);
            let is_secret = !secret.is_empty() && secret.bytes().all(|b| b.is_ascii_hexdigit());
            (is_secret && root.ends_with('/')).then(|| [host, root, secret].map(str::to_owned))
        };
        let [host, root, secret] = parts().ok_or_else(|| ClientError::Address(path.to_owned()))?;
        let runtime = Builder::new_current_thread().enable_all().build()?;
        let session = Token::random()?.text().to_owned();
        Ok(ControlClient { runtime, host, root, secret, session, n: 0 })
    }

    /// Gives commands together, and returns the answer of the run: `result` is `taken` or `refused`.
    ///
    /// # Errors
    /// If the run cannot be reached, is over, or does not answer.
    pub fn command(&mut self, commands: &[String]) -> Result<Value, ClientError> {
        self.n += 1;
        for _ in 0..TRIES {
            let (status, answer) = self.runtime.block_on(self.post(commands))?;
            match status {
                // The run has not answered yet: the same request asks again.
                StatusCode::ACCEPTED => {}
                StatusCode::OK => return Ok(answer),
                // A refusal has no effect and leaves the number unused.
                StatusCode::BAD_REQUEST | StatusCode::LOCKED | StatusCode::TOO_MANY_REQUESTS => {
                    self.n -= 1;
                    return Ok(answer);
                }
                _ => return Err(ClientError::Unreachable(format!("it answers {status}: {answer}"))),
            }
        }
        Err(ClientError::Unreachable("it does not answer".to_owned()))
    }

    async fn post(&self, commands: &[String]) -> Result<(StatusCode, Value), ClientError> {
        let body = json!({ "version": VERSION, "session": self.session, "n": self.n, "commands": commands });
        let exchange = async {
            let stream = TcpStream::connect(&self.host).await.map_err(|e| e.to_string())?;
            let (mut sender, connection) =
                http1::handshake(TokioIo::new(stream)).await.map_err(|e| e.to_string())?;
            let driven = tokio::spawn(connection);
            let request = Request::post(format!("{}command", self.root))
                .header(HOST, &self.host)
                .header(ORIGIN, format!("http://{}", self.host))
                .header(CONTENT_TYPE, "application/json")
                .header(AUTHORIZATION, format!("Bearer {}", self.secret))
                .body(Full::new(Bytes::from(body.to_string())))
                .map_err(|e| e.to_string())?;
            let response = sender.send_request(request).await.map_err(|e| e.to_string())?;
            let status = response.status();
            let bytes = Limited::new(response.into_body(), MAX_ANSWER).collect().await;
            let bytes = bytes.map_err(|e| e.to_string())?.to_bytes();
            drop(sender);
            driven.abort();
            Ok::<_, String>((status, serde_json::from_slice(&bytes).unwrap_or(Value::Null)))
        };
        match timeout(PATIENCE, exchange).await {
            Ok(answer) => answer.map_err(ClientError::Unreachable),
            Err(_) => Err(ClientError::Unreachable("it does not answer".to_owned())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_without_the_address_of_a_channel_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("control");
        assert!(matches!(ControlClient::open(&path), Err(ClientError::File { .. })));
        for text in ["", "http://127.0.0.1:1/abc/", "http://127.0.0.1:1#c=00", "http://127.0.0.1:1/a/#c=g"] {
            std::fs::write(&path, text).unwrap();
            assert!(matches!(ControlClient::open(&path), Err(ClientError::Address(_))), "{text}");
        }
        std::fs::write(&path, "http://127.0.0.1:9/abc/#c=00ff\n").unwrap();
        let client = ControlClient::open(&path).unwrap();
        assert_eq!(
            [client.host, client.root, client.secret],
            ["127.0.0.1:9", "/abc/", "00ff"].map(str::to_owned)
        );
    }
}
