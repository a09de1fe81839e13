//! `metamorph view` as a process, and requests to it.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use crate::command::{command, run, scenario};
use rustix::process::{Pid, Signal, kill_process};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::Duration;

/// Runs a scenario on the simulated link with a journal, and returns the journal's name.
pub fn record(directory: &Path, name: &str, options: &[&str]) -> String {
    let (file, journal) = (scenario(name).display().to_string(), directory.join("run.journal"));
    let journal = journal.display().to_string();
    let ran = run(&[&["run", &file, "--link", "sim", "--quiet", "--journal", &journal], options].concat());
    assert_eq!(ran.code, Some(0), "{ran:?}");
    journal
}

/// A running `metamorph view`, ended when dropped.
pub struct View {
    /// The process.
    pub process: Child,
    /// The address that it printed.
    pub address: String,
    /// The secret for commands, if the run can be controlled.
    pub secret: String,
}

impl View {
    /// Shows a shipped scenario.
    pub fn of(name: &str, options: &[&str]) -> View {
        let file = scenario(name).display().to_string();
        View::start(&[&["view", &file], options].concat())
    }

    /// Starts a command that shows a run.
    pub fn start(args: &[&str]) -> View {
        let mut command = command(args);
        // The standard output of a run is for its report, that of a plan for the answer; daemons have none.
        let process = match args[0] {
            "run" | "plan" | "host" => command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn(),
            _ => command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn(),
        };
        let mut view = View {
            process: process.expect("metamorph starts"),
            address: String::new(),
            secret: String::new(),
        };
        let pipes = (view.process.stdout.take(), view.process.stderr.take());
        let said: Box<dyn Read + Send> = match pipes {
            (Some(out), _) => Box::new(out),
            (_, err) => Box::new(err.unwrap()),
        };
        let mut lines = BufReader::new(said).lines().map_while(Result::ok);
        let mut address = || {
            let found = lines.find_map(|line| {
                line.split_whitespace().find(|word| word.starts_with("http://")).map(str::to_owned)
            });
            found.expect("the address is printed")
        };
        view.address = address();
        // The studio has one address, with the secret.
        if let Some((page, secret)) = view.address.clone().split_once("#c=") {
            (view.address, view.secret) = (page.to_owned(), secret.to_owned());
        }
        if args.contains(&"--control") {
            let (looking, secret) =
                address().split_once("#c=").map(|(a, b)| (a.to_owned(), b.to_owned())).unwrap();
            assert_eq!(looking, view.address);
            view.secret = secret;
        }
        // Further output must be read.
        std::thread::spawn(move || lines.for_each(drop));
        view
    }

    /// Returns host and port, and the path with the token.
    pub fn parts(&self) -> (&str, &str) {
        let rest = self.address.strip_prefix("http://").unwrap();
        rest.split_at(rest.find('/').unwrap())
    }

    /// Sends a raw request, whose answer can be read from the connection.
    fn send(&self, request: &[u8]) -> TcpStream {
        let mut stream = TcpStream::connect(self.parts().0).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(120))).unwrap();
        stream.write_all(request).unwrap();
        stream
    }

    /// Returns the bytes of the answer to a raw request.
    fn bytes(&self, request: &[u8]) -> Vec<u8> {
        let mut answer = Vec::new();
        self.send(request).read_to_end(&mut answer).unwrap();
        answer
    }

    /// Returns the head and the content of the answer to a request of a path below the token.
    pub fn content(&self, path: &str) -> (String, Vec<u8>) {
        let (host, root) = self.parts();
        let request = format!("GET {root}{path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
        let mut head = self.bytes(request.as_bytes());
        let end = head.windows(4).position(|bytes| bytes == b"\r\n\r\n").expect("a head");
        let content = head.split_off(end + 4);
        (String::from_utf8(head).unwrap(), content)
    }

    /// Returns the answer to a raw request.
    pub fn raw(&self, request: &str) -> (u16, String) {
        self.raw_bytes(request.as_bytes())
    }

    /// Returns the answer to a raw request that need not be text.
    pub fn raw_bytes(&self, request: &[u8]) -> (u16, String) {
        let answer = String::from_utf8(self.bytes(request)).unwrap();
        let status = answer.split(' ').nth(1).and_then(|code| code.parse().ok());
        (status.unwrap_or_else(|| panic!("no HTTP: {answer}")), answer)
    }

    /// Returns the answer to a request of a path.
    pub fn get(&self, path: &str, headers: &str) -> (u16, String) {
        let host = self.parts().0;
        self.raw(&format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{headers}\r\n"))
    }

    /// Returns the answer to commands, with everything that a page of this server would say.
    pub fn post(&self, body: &str) -> (u16, serde_json::Value) {
        self.post_to("command", body)
    }

    /// Returns the answer to a request of a path below the token, with everything that a page of this server would say.
    pub fn post_to(&self, path: &str, body: &str) -> (u16, serde_json::Value) {
        let (status, answer) = self.raw(&self.own_request(path, body));
        let body = answer.split_once("\r\n\r\n").map_or("", |(_, body)| body);
        (status, serde_json::from_str(body).unwrap_or_default())
    }

    /// Sends commands like [`View::post`], without waiting for the answer, which can be read from the connection.
    pub fn post_unheard(&self, body: &str) -> TcpStream {
        self.send(self.own_request("command", body).as_bytes())
    }

    fn own_request(&self, path: &str, body: &str) -> String {
        let (host, root) = self.parts();
        let headers = format!("{}Sec-Fetch-Site: same-origin\r\n", self.headers().concat());
        View::post_request(&format!("{root}{path}"), host, &headers, body)
    }

    /// Returns a request of a path with these headers.
    pub fn post_request(path: &str, host: &str, headers: &str, body: &str) -> String {
        let length = body.len();
        format!(
            "POST {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\nContent-Length: {length}\r\n{headers}\r\n{body}"
        )
    }

    /// Returns the headers of an admitted request: its origin, the secret and the type of its body.
    pub fn headers(&self) -> [String; 3] {
        [
            format!("Origin: http://{}\r\n", self.parts().0),
            format!("Authorization: Bearer {}\r\n", self.secret),
            "Content-Type: application/json\r\n".to_owned(),
        ]
    }

    /// Returns headers that programs of other users and pages of other servers can send, and the status of the answer.
    pub fn hostile_headers(&self) -> Vec<(u16, String)> {
        let [origin, secret, kind] = self.headers();
        let all = format!("{origin}{secret}{kind}");
        let wrong = format!("Authorization: Bearer {}\r\n", "0".repeat(32));
        let token = format!("Authorization: Bearer {}\r\n", self.parts().1.trim_matches('/'));
        let basic = format!("Authorization: Basic {}\r\n", self.secret);
        let refused = [
            String::new(),
            kind.clone(),
            format!("{secret}{kind}"),
            format!("{origin}{kind}"),
            format!("{origin}{wrong}{kind}"),
            format!("{origin}{token}{kind}"),
            format!("{origin}{basic}{kind}"),
            format!("{origin}{secret}{wrong}{kind}"),
            format!("{origin}Cookie: c={}\r\n{kind}", self.secret),
            format!("Origin: http://evil.example\r\n{secret}{kind}"),
            format!("Origin: null\r\n{secret}{kind}"),
            format!("{origin}Origin: http://evil.example\r\n{secret}{kind}"),
            format!("{all}Sec-Fetch-Site: cross-site\r\n"),
            format!("{all}Sec-Fetch-Site: same-site\r\n"),
            format!("{all}Sec-Fetch-Site: none\r\n"),
        ];
        let of_another_type = [
            format!("{origin}{secret}"),
            format!("{origin}{secret}Content-Type: text/plain\r\n"),
            format!("{origin}{secret}Content-Type: application/x-www-form-urlencoded\r\n"),
            format!("{origin}{secret}Content-Type: multipart/form-data; boundary=x\r\n"),
        ];
        let refused = refused.into_iter().map(|headers| (403, headers));
        refused.chain(of_another_type.into_iter().map(|headers| (415, headers))).collect()
    }

    /// Sends Ctrl-C, and returns the exit code.
    pub fn end(mut self) -> Option<i32> {
        kill_process(Pid::from_child(&self.process), Signal::INT).unwrap();
        self.process.wait().unwrap().code()
    }
}

impl Drop for View {
    fn drop(&mut self) {
        // It may have ended. If not, it takes its processes with it.
        let _ = kill_process(Pid::from_child(&self.process), Signal::TERM);
        let _ = self.process.wait();
    }
}
