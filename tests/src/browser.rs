//! A real browser without a window, driven over the DevTools protocol: opens a page, presses keys, evaluates
//! expressions, and collects errors of the page. Not here: any knowledge of our page.
//!
//! There are no fixed delays: conditions are checked by the page itself, frame by frame, and a browser that
//! is silent for [`WATCHDOG`] fails the test.

use crate::required::{Check, skip};
use rustix::process::{Pid, Signal, geteuid, kill_process_group};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use tempfile::TempDir;
use tungstenite::{Message, WebSocket, client};

/// The longest silence of a browser. Machines that build at the same time are slow.
const WATCHDOG: Duration = Duration::from_secs(240);
/// Names of browsers of this protocol.
const NAMES: [&str; 5] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome"];

/// Returns a browser of this machine. If there is none, the test is skipped.
pub fn find() -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let directories: Vec<PathBuf> = std::env::split_paths(&path).collect();
    let mut programs = NAMES.iter().flat_map(|name| directories.iter().map(move |d| d.join(name)));
    let found = programs.find(|file| file.is_file());
    if found.is_none() {
        skip(Check::Browser, "there is no chromium or chrome on this machine");
    }
    found
}

/// A browser with one page. Its processes and files are removed when this is dropped, also in a failing test.
pub struct Browser {
    process: Child,
    // Removed after the processes are gone.
    _profile: TempDir,
    socket: WebSocket<TcpStream>,
    session: String,
    asked: u64,
    /// The errors, warnings and exceptions of the page.
    pub complaints: Vec<String>,
    /// Every address that the page loaded from.
    pub loaded: Vec<String>,
}

impl Browser {
    /// Starts a browser with an empty page.
    pub fn start(program: PathBuf) -> Browser {
        let profile = TempDir::new().expect("a directory for the browser's profile");
        let mut command = Command::new(program);
        command.args(["--headless", "--remote-debugging-port=0", "--no-first-run", "--window-size=1280,860"]);
        // Pictures are rendered by the processor: the same on every machine, and without a graphics card.
        command.args(["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars"]);
        command.arg(format!("--user-data-dir={}", profile.path().display()));
        if geteuid().is_root() {
            // Chromium's sandbox refuses to run as root.
            command.arg("--no-sandbox");
        }
        command.arg("about:blank").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut process = command.process_group(0).spawn().expect("the browser starts");
        let mut lines = BufReader::new(process.stderr.take().expect("it is piped")).lines();
        let address = lines
            .by_ref()
            .map_while(Result::ok)
            .find_map(|line| line.strip_prefix("DevTools listening on ").map(str::to_owned));
        let Some(address) = address else {
            end(&mut process);
            panic!("the browser did not say where it listens");
        };
        // Further output must be read, or the browser would block.
        std::thread::spawn(move || lines.map_while(Result::ok).for_each(drop));
        let host = address.trim_start_matches("ws://").split('/').next().unwrap_or_default().to_owned();
        let stream = TcpStream::connect(host).expect("the browser listens");
        stream.set_read_timeout(Some(WATCHDOG)).expect("a socket can have a timeout");
        let (socket, _) = client(address.trim(), stream).expect("the browser speaks its protocol");
        let (complaints, loaded) = (Vec::new(), Vec::new());
        let session = String::new();
        let mut browser =
            Browser { process, _profile: profile, socket, session, asked: 0, complaints, loaded };
        let page = browser.call("Target.createTarget", json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": page["targetId"], "flatten": true });
        let attached = browser.call("Target.attachToTarget", attach);
        browser.session = attached["sessionId"].as_str().expect("a session has a name").to_owned();
        for domain in ["Page", "Runtime", "Log", "Network"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        browser
    }

    /// Calls a method of the protocol.
    pub fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.try_call(method, parameters).unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    fn try_call(&mut self, method: &str, parameters: Value) -> Result<Value, Value> {
        let number = self.send(method, parameters);
        self.answer(number)
    }

    /// Sends a call and returns its number.
    fn send(&mut self, method: &str, parameters: Value) -> u64 {
        self.asked += 1;
        let mut request = json!({ "id": self.asked, "method": method, "params": parameters });
        if !self.session.is_empty() {
            request["sessionId"] = json!(self.session);
        }
        self.socket.send(Message::text(request.to_string())).expect("the browser listens");
        self.asked
    }

    /// Waits for the answer to a call. The browser answers input events in their order.
    fn answer(&mut self, number: u64) -> Result<Value, Value> {
        loop {
            let Message::Text(text) = self.socket.read().expect("the browser answers") else { continue };
            let mut answer: Value = serde_json::from_str(&text).expect("the browser speaks JSON");
            if answer["id"] == json!(number) {
                return match answer["error"].take() {
                    Value::Null => Ok(answer["result"].take()),
                    error => Err(error),
                };
            }
            self.hear(&answer);
        }
    }

    fn hear(&mut self, event: &Value) {
        let parameters = &event["params"];
        match event["method"].as_str().unwrap_or_default() {
            "Runtime.exceptionThrown" => self.complaints.push(parameters["exceptionDetails"].to_string()),
            "Runtime.consoleAPICalled"
                if parameters["type"] == "error" || parameters["type"] == "warning" =>
            {
                self.complaints.push(parameters["args"].to_string());
            }
            "Log.entryAdded" if parameters["entry"]["level"] == "error" => {
                self.complaints.push(parameters["entry"].to_string());
            }
            "Network.requestWillBeSent" => {
                self.loaded.push(parameters["request"]["url"].as_str().unwrap_or_default().to_owned());
            }
            _ => {}
        }
    }

    /// Opens an address.
    pub fn open(&mut self, address: &str) {
        self.call("Page.navigate", json!({ "url": address }));
    }

    /// Evaluates an expression and returns its value; promises are awaited.
    pub fn evaluate(&mut self, expression: &str) -> Value {
        let how = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let mut answer = self.call("Runtime.evaluate", how);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {}", answer["exceptionDetails"]);
        answer["result"]["value"].take()
    }

    /// Waits until an expression is true. It is evaluated in every frame.
    pub fn until(&mut self, condition: &str) {
        let look = "const look = () => { let is = false; try { is = ok(); } catch {} \
                    if (is) done(true); else requestAnimationFrame(look); }; look();";
        let promise = format!("new Promise((done) => {{ const ok = () => ({condition}); {look} }})");
        let how = json!({ "expression": promise, "awaitPromise": true, "returnByValue": true });
        // A page that reloads itself forgets its promises.
        while self.try_call("Runtime.evaluate", how.clone()).is_err() {}
    }

    /// Presses a key, as a user would.
    pub fn press(&mut self, key: &str) {
        let text = if key.chars().count() == 1 { key } else { "" };
        for kind in ["keyDown", "keyUp"] {
            let text = if kind == "keyDown" { text } else { "" };
            self.call("Input.dispatchKeyEvent", json!({ "type": kind, "key": key, "text": text }));
        }
    }

    /// Waits until the browser has made so many pictures of the page.
    pub fn frames(&mut self, count: u32) {
        self.evaluate(&format!(
            "new Promise((done) => {{ let left = {count}; \
             const frame = () => (left-- ? requestAnimationFrame(frame) : done(true)); frame(); }})"
        ));
    }

    /// Moves one finger or more over the page: `places` are those of each finger, one set after the other.
    pub fn swipe<const FINGERS: usize>(&mut self, places: &[[(f64, f64); FINGERS]]) {
        let method = "Input.dispatchTouchEvent";
        for (i, fingers) in places.iter().enumerate() {
            let points: Vec<Value> =
                (0..).zip(fingers).map(|(id, (x, y))| json!({ "x": x, "y": y, "id": id })).collect();
            let kind = if i == 0 { "touchStart" } else { "touchMove" };
            self.call(method, json!({ "type": kind, "touchPoints": points }));
        }
        // Fingers rest before they are lifted: the picture would move on, and the next tap would only stop it.
        self.frames(20);
        self.call(method, json!({ "type": "touchEnd", "touchPoints": [] }));
    }

    /// Touches the page for a moment.
    pub fn tap(&mut self, (x, y): (f64, f64)) {
        // What is touched is looked up in the picture that was made last, which may be older than the page (crbug.com/764122).
        self.frames(2);
        // A touch that is long is no tap: its end does not wait for the answer to its start.
        let method = "Input.dispatchTouchEvent";
        let touches = [("touchStart", json!([{ "x": x, "y": y }])), ("touchEnd", json!([]))]
            .map(|(kind, points)| self.send(method, json!({ "type": kind, "touchPoints": points })));
        for touch in touches {
            self.answer(touch).unwrap_or_else(|error| panic!("{method}: {error}"));
        }
    }

    /// Clicks at a position of the page.
    pub fn click(&mut self, x: f64, y: f64) {
        for kind in ["mousePressed", "mouseReleased"] {
            let how = json!({ "type": kind, "x": x, "y": y, "button": "left", "clickCount": 1 });
            self.call("Input.dispatchMouseEvent", how);
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        end(&mut self.process);
    }
}

/// Ends a browser with all its processes, which are one group.
fn end(process: &mut Child) {
    if let Some(group) = Pid::from_raw(process.id() as i32) {
        // It may have ended by itself.
        let _ = kill_process_group(group, Signal::KILL);
    }
    let _ = process.wait();
}
