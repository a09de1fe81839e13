//! The page of `metamorph view`: access, over plain HTTP; and what a user sees and does in a real browser.
//! Where there is no browser, the latter is skipped with a message.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]
#![allow(clippy::print_stdout, reason = "says why something is skipped")]

use metamorph_protocol::metamodule::Metamodule;
use metamorph_protocol::metamodule::message::{Action, BodyAction};
use metamorph_protocol::time::Time;
use metamorph_tests::browser::{Browser, find};
use metamorph_tests::command::{command, run, scenario};
use metamorph_world_controller::family::metamodule::Metamodules;
use metamorph_world_controller::family::read_file;
use metamorph_world_controller::scenario::{LinkKind, Overrides};
use metamorph_world_controller::view::parts::Part;
use metamorph_world_controller::view::visible::Visible;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use std::fs;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::Duration;

/// Runs a scenario on the simulated link with a journal, and returns the journal's name.
fn record(directory: &Path, name: &str, options: &[&str]) -> String {
    let (file, journal) = (scenario(name).display().to_string(), directory.join("run.journal"));
    let journal = journal.display().to_string();
    let ran = run(&[&["run", &file, "--link", "sim", "--quiet", "--journal", &journal], options].concat());
    assert_eq!(ran.code, Some(0), "{ran:?}");
    journal
}

/// A running `metamorph view`, ended when dropped.
struct View {
    process: Child,
    address: String,
}

impl View {
    fn of(name: &str, options: &[&str]) -> View {
        let file = scenario(name).display().to_string();
        View::start(&[&["view", &file], options].concat())
    }

    fn start(args: &[&str]) -> View {
        let mut command = command(args);
        // The standard output of a run is for its report.
        let process = match args[0] {
            "run" => command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn(),
            _ => command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn(),
        };
        let mut view = View { process: process.expect("metamorph starts"), address: String::new() };
        let pipes = (view.process.stdout.take(), view.process.stderr.take());
        let said: Box<dyn Read + Send> = match pipes {
            (Some(out), _) => Box::new(out),
            (_, err) => Box::new(err.unwrap()),
        };
        let mut lines = BufReader::new(said).lines().map_while(Result::ok);
        let address = lines.find_map(|line| {
            line.split_whitespace().find(|word| word.starts_with("http://")).map(str::to_owned)
        });
        view.address = address.expect("the address is printed");
        // Further output must be read.
        std::thread::spawn(move || lines.for_each(drop));
        view
    }

    /// Returns host and port, and the path with the token.
    fn parts(&self) -> (&str, &str) {
        let rest = self.address.strip_prefix("http://").unwrap();
        rest.split_at(rest.find('/').unwrap())
    }

    /// Returns the answer to a raw request.
    fn raw(&self, request: &str) -> (u16, String) {
        let mut rng = TcpStream::connect(self.parts().0).unwrap();
        rng.set_read_timeout(Some(Duration::from_secs(120))).unwrap();
        rng.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        rng.read_to_string(&mut answer).unwrap();
        let status = answer.split(' ').nth(1).and_then(|code| code.parse().ok());
        (status.unwrap_or_else(|| panic!("no HTTP: {answer}")), answer)
    }

    fn get(&self, path: &str, headers: &str) -> (u16, String) {
        let host = self.parts().0;
        self.raw(&format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{headers}\r\n"))
    }

    /// Sends Ctrl-C, and returns the exit code.
    fn end(mut self) -> Option<i32> {
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

#[test]
fn only_the_address_with_the_token_gives_access() {
    let view = View::of("chair.toml", &[]);
    let (host, root) = view.parts();
    assert!(host.starts_with("127.0.0.1:") && root.len() == 34, "{}", view.address);
    for (file, part) in [("", "<title>Metamorph</title>"), ("main.js", "import"), ("scene", "\"classes\"")] {
        let (status, answer) = view.get(&format!("{root}{file}"), "");
        assert!(status == 200 && answer.contains(part), "{file}: {answer}");
        for header in ["content-security-policy: default-src 'none'", "nosniff", "no-referrer", "no-store"] {
            assert!(answer.contains(header), "{file} lacks {header}");
        }
    }
    let wrong: String = root.chars().map(|c| if c == '0' { '1' } else { c }).collect::<String>() + "x";
    let without = [wrong.as_str(), "/", "/scene", "/main.js", "//scene", &root[..33], &root[..20]];
    for path in without {
        let (status, answer) = view.get(path, "");
        assert!(status == 404 && !answer.contains("classes"), "{path}: {answer}");
    }
    // Only the page is served behind the token.
    for file in ["../../etc/passwd", "..%2f..%2fetc%2fpasswd", "Cargo.toml", "scene/", "page/main.js", "%00"]
    {
        assert_eq!(view.get(&format!("{root}{file}"), "").0, 404, "{file}");
    }
    let scene = format!("{root}scene");
    for headers in [
        "Origin: http://evil.example\r\n",
        "Origin: null\r\n",
        "Sec-Fetch-Site: cross-site\r\n",
        "Sec-Fetch-Site: same-site\r\n",
        "Host: evil.example\r\n",
    ] {
        let (status, answer) = view.get(&scene, headers);
        assert!(status == 403 || status == 400, "{headers}: {answer}");
        assert!(!answer.contains("classes"), "{headers}: {answer}");
    }
    let rebound = format!("GET {scene} HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n");
    assert_eq!(view.raw(&rebound).0, 403);
    for method in ["POST", "PUT", "DELETE", "OPTIONS"] {
        let request = format!(
            "{method} {scene} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"
        );
        assert_eq!(view.raw(&request).0, 405, "{method}");
    }
    // Meaningless numbers have no effect.
    for query in [
        "events?from=99999999999999999999",
        "talk?first=18446744073709551615&count=9",
        "messages?id=-1",
        "talk?count=x",
    ] {
        assert_eq!(view.get(&format!("{root}{query}"), "").0, 200, "{query}");
    }
    let port = host.rsplit(':').next().and_then(|p| p.parse::<u16>().ok()).unwrap();
    let listening: Vec<String> = fs::read_to_string("/proc/net/tcp")
        .unwrap()
        .lines()
        .filter_map(|line| line.split_whitespace().nth(1).map(str::to_owned))
        .filter(|local| local.ends_with(&format!(":{port:04X}")))
        .collect();
    assert!(!listening.is_empty() && listening.iter().all(|l| l.starts_with("0100007F:")), "{listening:?}");
    assert_eq!(view.end(), Some(0));
}

/// As any program on the machine can send: requests that do not end, and data that is not a request.
#[test]
fn the_server_survives_invalid_requests() {
    let view = View::of("chair.toml", &[]);
    let (host, root) = view.parts();
    let connect = || {
        let rng = TcpStream::connect(host).unwrap();
        rng.set_read_timeout(Some(Duration::from_secs(120))).unwrap();
        rng
    };
    // The server closes them all.
    let closed = |mut rng: TcpStream, about: &str| {
        let ended = rng.read_to_end(&mut Vec::new()).map_err(|error| error.kind());
        assert!(!matches!(ended, Err(ErrorKind::WouldBlock | ErrorKind::TimedOut)), "{about} is still open");
    };
    let unfinished: Vec<TcpStream> = (0..400)
        .map(|_| {
            let mut rng = connect();
            rng.write_all(format!("GET {root} HTTP/1.1\r\nHost: {host}\r\nX-Slow: ").as_bytes()).unwrap();
            rng
        })
        .collect();
    unfinished.into_iter().for_each(|rng| closed(rng, "an unfinished request"));
    let start = format!("GET {root}scene HTTP/1.1\r\nHost: {host}\r\n");
    let requests: Vec<Vec<u8>> = vec![
        Vec::new(),
        vec![0; 100_000],
        b"\r\n".repeat(50_000),
        b"GET".to_vec(),
        b"GET /\r\n".to_vec(),
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".to_vec(),
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03".to_vec(),
        format!("GET /{} HTTP/1.1\r\nHost: {host}\r\n\r\n", "x".repeat(1 << 20)).into(),
        format!("{start}X: {}\r\n\r\n", "x".repeat(1 << 20)).into(),
        format!("{start}{}\r\n", "X: y\r\n".repeat(100_000)).into(),
        format!("{start}Content-Length: 18446744073709551615\r\n\r\nx").into(),
        format!("{start}Content-Length: -1\r\n\r\n").into(),
        format!("{start}Content-Length: 3\r\nContent-Length: 4\r\n\r\n").into(),
        format!("{start}Transfer-Encoding: chunked\r\n\r\nffffffffffffffff\r\nx").into(),
        format!("{start}Connection: upgrade\r\nUpgrade: websocket\r\n\r\n").into(),
        format!("{start}Expect: 100-continue\r\nContent-Length: 9\r\n\r\n").into(),
        format!("{start}\0: x\r\n\r\n").into(),
        format!("GET {root}\x1b[31m HTTP/1.1\r\nHost: {host}\r\n\r\n").into(),
        format!("GET http://evil.example{root} HTTP/1.1\r\nHost: {host}\r\n\r\n").into(),
        format!("CONNECT {host} HTTP/1.1\r\nHost: {host}\r\n\r\n").into(),
        format!("{start}\r\n").repeat(200).into(),
    ];
    for request in &requests {
        let mut rng = connect();
        // The server may have closed it before all of it was read.
        let _ = rng.write_all(request).and_then(|()| rng.shutdown(Shutdown::Write));
        closed(rng, &String::from_utf8_lossy(&request[..request.len().min(80)]));
    }
    let (status, answer) = view.get(&format!("{root}scene"), "");
    assert!(status == 200 && answer.contains("\"classes\""), "{answer}");
    let facts = fs::read_to_string(format!("/proc/{}/status", view.process.id())).unwrap();
    let peak = facts.lines().find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB"));
    let peak: u64 = peak.unwrap().parse().unwrap();
    assert!(peak < 512 << 10, "{peak} kB of memory");
    assert_eq!(view.end(), Some(0));
}

#[test]
fn a_cut_journal_is_shown_as_far_as_it_goes_and_other_files_are_refused() {
    let directory = tempfile::tempdir().unwrap();
    let journal = record(directory.path(), "swarm.toml", &[]);
    let whole = fs::read(&journal).unwrap();
    fs::write(&journal, &whole[..whole.len() / 2]).unwrap();
    let view = View::start(&["view", &journal]);
    let (_, answer) = view.get(&format!("{}events", view.parts().1), "");
    let events: Value = serde_json::from_str(answer.split("\r\n\r\n").nth(1).unwrap()).unwrap();
    assert!(events["troubles"].as_array().is_some_and(|t| !t.is_empty()), "{}", events["troubles"]);
    assert!(events["next"].as_u64().unwrap() > 50 && events["outcome"].is_null() && events["over"] == true);
    assert_eq!(view.end(), Some(0));
    for (content, part) in [(&b"nothing of the kind"[..], "run.journal"), (&whole[..5], "run.journal")] {
        fs::write(&journal, content).unwrap();
        let ran = run(&["view", &journal]);
        assert_eq!(ran.code, Some(2), "{ran:?}");
        assert!(ran.err.contains(part) && ran.err.contains("fix: ") && ran.out.is_empty(), "{ran:?}");
    }
    let ran = run(&["view", "/nowhere/run.journal"]);
    assert!(ran.code == Some(2) && ran.err.contains("/nowhere/run.journal"), "{ran:?}");
}

/// Opens a browser with the page of a view; `None` where there is no browser.
fn open(view: &View) -> Option<Browser> {
    let Some(program) = find() else {
        println!("skipped: there is no chromium or chrome on this machine");
        return None;
    };
    let mut browser = Browser::start(program);
    browser.open(&view.address);
    browser.until("['paused', 'failed'].includes(document.body.dataset.state)");
    // The run may still be going on when the page is loaded.
    browser.until("window.page.story.over");
    Some(browser)
}

/// Asserts that the page had no errors and loaded nothing from elsewhere.
fn check_clean(browser: &mut Browser, view: &View) {
    browser.evaluate("1");
    assert_eq!(browser.complaints, Vec::<String>::new());
    let elsewhere = |url: &&String| !url.starts_with(&view.address) && !url.starts_with("data:");
    assert_eq!(browser.loaded.iter().filter(elsewhere).collect::<Vec<_>>(), Vec::<&String>::new());
    assert!(browser.loaded.len() > 10);
}

/// Returns the time that is shown, in microseconds.
fn micros(browser: &mut Browser) -> f64 {
    browser.until("!window.page.dirty");
    browser.evaluate("Number(document.getElementById('time').dataset.micros)").as_f64().unwrap()
}

fn text(browser: &mut Browser, id: &str) -> String {
    browser.evaluate(&format!("document.querySelector('{id}').textContent")).as_str().unwrap().to_owned()
}

/// Moves the scrubber to a time.
fn scrub(browser: &mut Browser, to: f64) {
    let event = "scrub.dispatchEvent(new Event('input', { bubbles: true }))";
    browser.evaluate(&format!(
        "{{ const scrub = document.getElementById('scrub'); scrub.value = {to}; {event}; }}"
    ));
    browser.until("!window.page.dirty");
}

/// Chooses a module in the form.
fn choose(browser: &mut Browser, id: u32) {
    browser.evaluate(&format!(
        "document.getElementById('which').value = '{id}'; document.querySelector('#find button').click()"
    ));
    browser.until(&format!("!window.page.dirty && document.getElementById('module').dataset.id === '{id}'"));
}

#[test]
fn plays_a_chair_to_its_end() {
    let directory = tempfile::tempdir().unwrap();
    let view = View::start(&["view", &record(directory.path(), "chair.toml", &[])]);
    let Some(mut browser) = open(&view) else { return };
    assert_eq!(text(&mut browser, "#title"), "chair");
    assert_eq!(text(&mut browser, "#outcome"), "built");
    assert_eq!(micros(&mut browser), 0.0);

    // The canvas is not empty: pixels have several colours.
    let colours = "(() => { const c = document.getElementById('space'); const d = document.createElement('canvas'); \
        d.width = 64; d.height = 64; window.page.show(); const p = d.getContext('2d'); p.drawImage(c, 0, 0, 64, 64); \
        const all = p.getImageData(0, 0, 64, 64).data; const seen = new Set(); \
        for (let i = 0; i < all.length; i += 4) seen.add(all.slice(i, i + 3).join()); return seen.size; })()";
    assert!(browser.evaluate(colours).as_u64().unwrap() > 20);

    // Plays and pauses.
    browser.press(" ");
    browser.until(
        "document.body.dataset.state === 'playing' && document.getElementById('time').dataset.micros > 0",
    );
    browser.press(" ");
    browser.until("document.body.dataset.state === 'paused'");
    let paused = micros(&mut browser);
    let frames = "new Promise((done) => { let n = 0; const tick = () => (++n > 5 ? done(n) : requestAnimationFrame(tick)); tick(); })";
    browser.evaluate(frames);
    assert_eq!(micros(&mut browser), paused);

    // Steps forward and back.
    browser.press(".");
    let next = micros(&mut browser);
    assert!(next > paused);
    browser.press(".");
    assert!(micros(&mut browser) > next);
    browser.press(",");
    assert_eq!(micros(&mut browser), next);

    // Goes to the position of the scrubber.
    scrub(&mut browser, 60_000_000.0);
    assert_eq!(micros(&mut browser), 60_000_000.0);
    let filled = text(&mut browser, "[data-part=numbers] dd");
    assert!(filled.ends_with("/ 6") && !filled.starts_with("6"), "{filled}");

    // Plays to the end and stops there.
    browser.press("Home");
    assert_eq!(micros(&mut browser), 0.0);
    browser.evaluate("{ const s = document.getElementById('speed'); s.value = '128'; s.dispatchEvent(new Event('change')); }");
    browser.press(" ");
    browser.until("document.body.dataset.state === 'paused' && window.page.t === window.page.story.now");
    assert_eq!(text(&mut browser, "[data-part=numbers] dd"), "6 / 6");
    for id in 0..6 {
        choose(&mut browser, id);
        let said = text(&mut browser, "#module");
        assert!(said.contains("settled in seed") && said.contains("alive"), "{said}");
        browser.until("document.querySelectorAll('#module .messages li .when').length > 3");
    }
    // Every cell of the chair has a cube in it, by the kinematics of the page.
    let missing = "(() => { const p = window.page.picture; const places = p.poses.flat(); \
        const cubes = places.filter((_, i) => i % 7 === 0).map((_, i) => places.slice(7 * i, 7 * i + 3)); \
        return p.goals[0].cells.filter(([x, y, z]) => \
        !cubes.some((c) => Math.hypot(c[0] - x, c[1] - y, c[2] - z - 0.5) < 1e-6)).length; })()";
    assert_eq!(browser.evaluate(missing), json!(0));

    // A click chooses the module that is drawn there.
    browser.press("Escape");
    let place = browser.evaluate(
        "(() => { const { page } = window; const box = document.getElementById('space').getBoundingClientRect(); \
         const m = page.camera.matrix(); const [x, y, z] = page.picture.poses[3].slice(6 * 7); \
         const c = [0, 1, 2, 3].map((i) => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i]); \
         return [box.left + (c[0] / c[3] + 1) / 2 * box.width, box.top + (1 - c[1] / c[3]) / 2 * box.height]; })()",
    );
    browser.click(place[0].as_f64().unwrap(), place[1].as_f64().unwrap());
    browser.until("!window.page.dirty && document.getElementById('module').dataset.id !== undefined && !document.getElementById('module').hidden");
    check_clean(&mut browser, &view);
    drop(browser);
    assert_eq!(view.end(), Some(0));
}

/// What the page computes between two frames is what everything else that draws bodies gets.
#[test]
fn parts_move_on_the_page_as_they_do_in_the_program() {
    let view = View::of("chair.toml", &[]);
    let Some(mut browser) = open(&view) else { return };
    let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
    let plan = read_file(&scenario("chair.toml"), &overrides).unwrap();
    let swarm = plan.swarm.of::<Metamodules>().unwrap();
    let (setup, place) = (&*swarm.setup, &swarm.poses[1]);
    let numbers = |parts: &[Part]| -> Vec<f64> {
        let pose = |p: &Part| [p.centre().as_slice(), p.pose.rotation.coords.as_slice()].concat();
        parts.iter().flat_map(pose).collect()
    };
    let rest = numbers(&Metamodule::at_rest(setup, place));
    // The page has taken the same from the scene.
    let close = |page: &Value, own: &[f64], about: &str| {
        let page: Vec<f64> = page.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
        let off = page.iter().zip(own).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(page.len() == own.len() && off < 1e-9, "{about}: {page:?}, not {own:?}");
    };
    close(&browser.evaluate("window.page.story.modules[1].first.poses"), &rest, "at the start");
    let mut turned = 0;
    for number in 0..setup.motions.table().steps().len() as u16 {
        let action = Action { deed: BodyAction::Turn(number), not_after: Time::ZERO };
        let Some((motion, _)) = Metamodule::motion(setup, place, &action) else { continue };
        turned += 1;
        for fraction in [0.0, 0.2, 0.5, 0.9, 1.0] {
            let own = numbers(&Metamodule::parts(setup, place, Some((&action, fraction))));
            let ask = format!(
                "import('./parts.js').then(({{ carried }}) => carried({}, {}[2], {fraction}))",
                json!(rest),
                motion.to_json()
            );
            close(&browser.evaluate(&ask), &own, &format!("{motion:?} at {fraction}"));
        }
    }
    assert!(turned > 2, "{turned}");
    check_clean(&mut browser, &view);
}

#[test]
fn a_killed_module_is_shown_as_dead_and_a_stopped_one_as_paused() {
    let view = View::of("swarm.toml", &["--pause", "7@3s..6s"]);
    let Some(mut browser) = open(&view) else { return };
    let pattern = |id: u32| format!("window.page.picture.layers[0].parts.list[{id} * 16 + 11]");
    for (at, id, life, drawn) in [
        (1.0, 41, "alive", 0),
        (2.5, 41, "dead", 1),
        (2.5, 7, "alive", 0),
        (4.0, 7, "paused", 2),
        (7.0, 7, "alive", 0),
        (7.0, 41, "dead", 1),
    ] {
        scrub(&mut browser, at * 1e6);
        choose(&mut browser, id);
        assert_eq!(
            browser.evaluate("document.getElementById('module').dataset.life"),
            json!(life),
            "{id} at {at} s"
        );
        assert_eq!(browser.evaluate(&pattern(id)), json!(drawn), "{id} at {at} s");
    }
    let faults = text(&mut browser, "[data-part=faults]");
    assert!(faults.contains("kill 41") && faults.contains("pause 7"), "{faults}");
    check_clean(&mut browser, &view);
}

#[test]
fn messages_locks_and_gradients_of_a_thousand_modules_are_shown() {
    let view = View::of("slab-to-sphere.toml", &[]);
    let Some(mut browser) = open(&view) else { return };
    scrub(&mut browser, 60e6);
    browser.press("m");
    browser.until("window.page.picture.links.length > 1000 * 13");
    browser.press("m");
    for (key, meaning) in [("2", "level"), ("3", "gradient"), ("4", "locks"), ("1", "state")] {
        browser.press(key);
        browser.until(&format!(
            "!window.page.dirty && document.getElementById('meaning').value === '{meaning}'"
        ));
        let colours = "new Set([...Array(1058).keys()].map((i) => \
                       [...window.page.picture.layers[0].parts.list.slice(i * 16 + 8, i * 16 + 11)].join())).size";
        browser.until(&format!("{colours} >= 3"));
    }
    // Modules that wait for each other while others move are not at a standstill, and no circle is drawn.
    let circle = "[...Array(149).keys()].some((s) => { window.page.seek(s * 1e6, true); window.page.show(); \
                  return document.body.dataset.circle !== ''; })";
    assert_eq!(browser.evaluate(circle), Value::Bool(false));
    // Dark, if the user's system asks for that.
    let dark = json!({ "features": [{ "name": "prefers-color-scheme", "value": "dark" }] });
    browser.call("Emulation.setEmulatedMedia", dark);
    browser.until("document.documentElement.dataset.theme === 'dark'");
    check_clean(&mut browser, &view);
}

/// At the end of a run that stands still the page gives the reason, and draws the waiting modules.
#[test]
fn a_deadlock_is_drawn_and_explained() {
    let kills = ["--kill", "4@5s", "--kill", "22@5s", "--kill", "30@12s"];
    let file = scenario("swarm.toml").display().to_string();
    let waits = |report: &Value| {
        let waiting = report["unbuilt"]["waiting"].as_array();
        report["outcome"] == "deadlock"
            && waiting.is_some_and(|w| w.iter().any(|w| !w["waits_for"].is_null()))
    };
    let seed = (0..200).map(|seed| seed.to_string()).find(|seed| {
        let fixed = ["run", &file, "--link", "sim", "--seed", seed, "--quiet", "--json", "-"];
        waits(&serde_json::from_str(&run(&[&fixed, &kills[..]].concat()).out).unwrap())
    });
    let seed = seed.expect("a module that holds a dead one waits for ever");
    let view = View::of("swarm.toml", &[&["--seed", &seed], &kills[..]].concat());
    let Some(mut browser) = open(&view) else { return };
    browser.press("End");
    browser.until("!window.page.dirty && window.page.t === window.page.story.now");
    assert_eq!(text(&mut browser, "#outcome"), "deadlock");
    let said = text(&mut browser, "[data-part=why] .waiting");
    let first =
        "(() => { const w = window.page.story.report.unbuilt.waiting[0]; return `${w.module} ${w.why}`; })()";
    let first = browser.evaluate(first);
    assert!(said.starts_with(first.as_str().unwrap()), "{said}, not {first}");
    assert_ne!(browser.evaluate("window.page.picture.marks.length"), json!(0));
    assert!(text(&mut browser, "[data-part=legend]").contains("waits for"));
    // Before the end only chosen items are drawn.
    scrub(&mut browser, 1.0);
    assert_eq!(browser.evaluate("window.page.picture.marks.length"), json!(0));
    check_clean(&mut browser, &view);
}

#[test]
fn a_run_of_processes_is_followed_and_its_messages_are_shown_when_it_is_over() {
    let Some(program) = find() else { return println!("skipped: no browser") };
    let directory = tempfile::tempdir().unwrap();
    let journal = directory.path().join("run.journal").display().to_string();
    let file = scenario("swarm.toml").display().to_string();
    let view = View::start(&["run", &file, "--view", "--quiet", "--journal", &journal]);
    let mut browser = Browser::start(program);
    browser.open(&view.address);
    browser.until("window.page.story.modules.some((m) => m.doings.length > 0)");
    // Messages between modules are not known yet, and not claimed.
    let offered =
        "[...document.getElementById('meaning').options].filter((o) => o.disabled).map((o) => o.value)";
    let over = "document.getElementById('outcome').textContent !== ''";
    let seen = browser.evaluate(offered);
    assert!(seen == json!(["gradient", "locks"]) || browser.evaluate(over) == json!(true), "{seen}");
    // The whole journal replaces the partial data, in the same page at the same time.
    browser.evaluate(
        "window.same = 0; window.back = 0; window.last = 0; \
        const look = () => { const { t } = window.page; if (t < window.last) window.back++; \
        window.last = t; requestAnimationFrame(look); }; look()",
    );
    browser.until("document.getElementById('outcome').textContent === 'built'");
    browser.until("window.page.story.scene.messages && window.page.story.over");
    browser.until("!window.page.dirty && window.page.t === window.page.story.now");
    assert_eq!(browser.evaluate("[window.same, window.back]"), json!([0, 0]));
    assert_eq!(browser.evaluate(offered), json!([]));
    browser.press("End");
    browser.until("document.querySelector('[data-part=numbers] dd').textContent === '32 / 32'");
    // Bodies are drawn at their places: a refused move has not taken place.
    let filled = "(() => { const { story } = window.page; \
        const middles = new Set(story.scene.goals[0].cells.map(([x, y, z]) => [x, y, z + 0.5].join())); \
        return story.modules.filter((_, id) => \
        middles.has(story.bodyAt(id, story.now).to.poses.slice(0, 3).join())).length; })()";
    assert_eq!(browser.evaluate(filled), json!(32));
    choose(&mut browser, 41);
    assert_eq!(browser.evaluate("document.getElementById('module').dataset.life"), json!("dead"));
    browser.until("document.querySelectorAll('#module .messages li .when').length > 3");
    check_clean(&mut browser, &view);
    assert_eq!(view.end(), Some(0));
}

/// A page that was sent back to an earlier moment stays there while the run goes on and when it ends, also if
/// it was asking what is new at that time.
#[test]
fn the_end_of_a_run_does_not_move_a_page_that_looks_back() {
    let Some(program) = find() else { return println!("skipped: no browser") };
    let directory = tempfile::tempdir().unwrap();
    let journal = directory.path().join("run.journal").display().to_string();
    let file = scenario("swarm.toml").display().to_string();
    let view = View::start(&["run", &file, "--view", "--quiet", "--journal", &journal]);
    let mut browser = Browser::start(program);
    browser.open(&view.address);
    browser.until("window.page.story.now > 2e6");
    assert_eq!(browser.evaluate("window.page.story.over"), json!(false));
    browser.evaluate(
        "{ const { story } = window.page; const ask = story.ask; story.ask = async (what) => { \
        const answer = await ask(what); if (what.startsWith('events') && !window.lookedBack) { \
        window.page.seek(1.5e6, true); window.lookedBack = true; } return answer; }; }",
    );
    browser.until("window.lookedBack && !window.page.dirty");
    // Every moment that is shown from now on, in words, until the whole journal is there.
    let shown = "new Promise((done) => { const [seen, time] = [new Set(), document.getElementById('time')]; \
        const look = () => { const { story, dirty } = window.page; seen.add(Number(time.dataset.micros)); \
        if (story.over && story.scene.messages && !dirty) done([...seen]); else requestAnimationFrame(look); \
        }; look(); })";
    assert_eq!(browser.evaluate(shown), json!([1_500_000]));
    check_clean(&mut browser, &view);
}

/// While a run goes on modules wait for each other and go on again: that is not a standstill, which is drawn
/// only where a run has ended in a deadlock. Colours show what is known, and nothing before that.
#[test]
fn only_known_facts_are_shown() {
    let directory = tempfile::tempdir().unwrap();
    let view = View::start(&["view", &record(directory.path(), "swarm.toml", &[])]);
    let Some(mut browser) = open(&view) else { return };
    // Two that wait for each other in the middle of a run that is built.
    browser.evaluate(
        "{ const { modules } = window.page.story; const t = 5e6; \
        for (const [a, b] of [[3, 4], [4, 3]]) { \
        modules[a].standings = [{ t, role: 0, flags: 8, place: 0, waits: b }]; } }",
    );
    let seen = "(() => { const { page } = window; const options = { meaning: 'state', messages: false, waits: false, \
        goal: true, chosen: null, classes: [] }; const seen = page.picture.build(10e6, options); \
        return [seen.circle.size, page.picture.marks.length, seen.arrows]; })()";
    assert_eq!(browser.evaluate(seen), json!([0, 0, false]));
    // Before a module has reported, its state is not shown.
    scrub(&mut browser, 2e6);
    let legend = text(&mut browser, "[data-part=legend]");
    assert!(legend.contains("not heard of yet"), "{legend}");
    choose(&mut browser, 3);
    let facts = text(&mut browser, "[data-part=module]");
    assert!(facts.contains("not heard of yet") && !facts.contains("waits for"), "{facts}");
    // While messages are loaded, colours by them say so.
    let loading = "(() => { const { page } = window; const { story, picture } = page; \
        const talkAt = story.talkAt; story.talkAt = () => null; \
        const options = { meaning: 'gradient', messages: false, waits: false, goal: true, chosen: 3, classes: [] }; \
        const seen = picture.build(10e6, options); page.panel.module(3, 10e6, seen); story.talkAt = talkAt; \
        const facts = document.querySelector('[data-part=module]').textContent; \
        return picture.legend('gradient', seen).map((e) => e.text).concat(facts); })()";
    let said = browser.evaluate(loading);
    assert_eq!(said[0], "loading", "{said}");
    let facts = said[1].as_str().unwrap();
    assert!(
        facts.contains("loading") && !facts.contains("unknown") && !facts.contains("locked bynone"),
        "{facts}"
    );
    check_clean(&mut browser, &view);
}

/// Prints the frame rate of a thousand modules, without a graphics card, and asserts nothing: `cargo test -p
/// metamorph-tests --test view_page frame_rate -- --ignored --nocapture`
#[test]
#[ignore = "measures, and judges nothing"]
fn frame_rate_of_a_thousand_modules() {
    let view = View::of("slab-to-sphere.toml", &[]);
    let Some(mut browser) = open(&view) else { return };
    scrub(&mut browser, 60e6);
    // The window of the browser is a little larger than the page.
    let size = json!({ "width": 1280, "height": 720, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", size);
    browser.until("window.innerHeight === 720 && !window.page.dirty");
    // Frames as they come, then each of them awaited, so that the processor's share is known.
    let measure = "(async (move) => { const { page } = window; const { gl } = page.drawing; \
        const next = () => new Promise(requestAnimationFrame); const [gaps, js, drawn] = [[], [], []]; \
        const middle = (list) => [...list].sort((a, b) => a - b)[list.length >> 1].toFixed(1); \
        let last = await next(); \
        for (let i = 0; i < 120; i++) { move(); const now = await next(); gaps.push(now - last); last = now; } \
        const late = gaps.slice(60); const size = `${gl.canvas.width}x${gl.canvas.height}`; \
        const pixel = new Uint8Array(4); \
        for (let i = 0; i < 20; i++) { \
            move(); page.stale ||= page.playing; page.t += page.playing ? 1e4 : 0; \
            const a = performance.now(); page.show(); const b = performance.now(); \
            gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel); \
            js.push(b - a); drawn.push(performance.now() - b); } \
        const fps = (60e3 / late.reduce((a, b) => a + b)).toFixed(1); \
        return `${fps} pictures/s of ${size}; of each ${middle(js)} ms scripts, ${middle(drawn)} ms drawing`; })";
    let orbit = "() => window.page.camera.orbit(0.02, 0)";
    let mut say = |what: &str, before: &str, adapt: bool, step: &str| {
        let fixed = if adapt { "" } else { "window.page.adapt = () => {};" };
        browser.evaluate(&format!("{{ delete window.page.adapt; {fixed} {before} }}"));
        browser.until("window.page.seen !== null");
        let figures = browser.evaluate(&format!("{measure}({step})"));
        println!("{what:<30} {}", figures.as_str().unwrap());
    };
    say("turning, all pixels", "", false, orbit);
    say("turning", "", true, orbit);
    say("turning, colours by gradient", "window.page.setMeaning('gradient');", true, orbit);
    say("playing", "window.page.setMeaning('state'); window.page.setPlaying(true);", true, "() => {}");
    println!("load of this machine: {}", fs::read_to_string("/proc/loadavg").unwrap_or_default().trim());
}
