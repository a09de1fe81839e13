//! Access to the page of `metamorph view`, over plain HTTP.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::run;
use metamorph_tests::journal_file::half;
use metamorph_tests::view::{View, record};
use metamorph_world_controller::console::stopwatch::wait_until;
use serde_json::Value;
use std::fs;
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::Duration;

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
    // A refused request does not keep its connection.
    let (status, answer) = view.raw(&rebound.replace("Connection: close\r\n", ""));
    assert!(status == 403 && answer.to_lowercase().contains("connection: close"), "{answer}");
    assert!(answer.contains("ssh -L"), "{answer}");
    // A forwarded port is another one on the browser's side.
    let forwarded = format!("GET {scene} HTTP/1.1\r\nHost: localhost:9000\r\nConnection: close\r\n\r\n");
    assert_eq!(view.raw(&forwarded).0, 200);
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
        let stream = TcpStream::connect(host).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(120))).unwrap();
        stream
    };
    // The server closes them all.
    let closed = |mut stream: TcpStream, about: &str| {
        let ended = stream.read_to_end(&mut Vec::new()).map_err(|error| error.kind());
        assert!(!matches!(ended, Err(ErrorKind::WouldBlock | ErrorKind::TimedOut)), "{about} is still open");
    };
    let unfinished: Vec<TcpStream> = (0..400)
        .map(|_| {
            let mut stream = connect();
            stream.write_all(format!("GET {root} HTTP/1.1\r\nHost: {host}\r\nX-Slow: ").as_bytes()).unwrap();
            stream
        })
        .collect();
    unfinished.into_iter().for_each(|stream| closed(stream, "an unfinished request"));
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
        let mut stream = connect();
        // The server may have closed it before all of it was read.
        let _ = stream.write_all(request).and_then(|()| stream.shutdown(Shutdown::Write));
        closed(stream, &String::from_utf8_lossy(&request[..request.len().min(80)]));
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
    fs::write(&journal, half(&whole)).unwrap();
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

/// A plan is shown action by action, as it is made and from its file; without a plan there is no page.
#[test]
fn plans_are_shown_step_by_step() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("plan.json").display().to_string();
    let base = ["plan", "--from", "line:4", "--to", "loop:3x3", "--collision", "core", "-o", &file];
    for ground in [&["--floor", "--gravity", "--up", "x"][..], &[]] {
        let made: Value = {
            let view = View::start(&[&base[..], ground, &["--view"]].concat());
            let shown = shown_actions(&view);
            let made: Value = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
            let names: Vec<String> =
                (0..made["actions"].as_array().unwrap().len()).map(|i| format!("action {i}")).collect();
            assert_eq!(shown, names);
            assert_eq!(view.end(), Some(0));
            made
        };
        let view = View::start(&["plan", "--check", &file, "--view"]);
        assert_eq!(shown_actions(&view).len(), made["actions"].as_array().unwrap().len());
        assert_eq!(view.end(), Some(0));
    }
    let mut plan: Value = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
    plan["cost"] = Value::from(1);
    fs::write(&file, plan.to_string()).unwrap();
    let ran = run(&["plan", "--check", &file, "--view"]);
    assert!(ran.code == Some(8) && !ran.err.contains("http://"), "{ran:?}");
    let none = ["plan", "--from", "quadruped:6", "--to", "line:6", "--work", "50", "--view"];
    let ran = run(&none);
    assert!(ran.code == Some(4) && !ran.err.contains("http://"), "{ran:?}");
}

/// Returns the names of the actions that a page shows, each of which begins one second after the one before, and with the
/// motion of a module.
fn shown_actions(view: &View) -> Vec<String> {
    let root = view.parts().1;
    let get = |what: &str| -> Value {
        let (status, answer) = view.get(&format!("{root}{what}"), "");
        assert_eq!(status, 200, "{answer}");
        serde_json::from_str(answer.split("\r\n\r\n").nth(1).unwrap()).unwrap()
    };
    let scene = get("scene");
    assert_eq!((&scene["link"], &scene["seed"]), (&Value::from("plan"), &Value::Null));
    assert!(scene["repeat"].as_str().unwrap().starts_with("metamorph plan --"), "{scene}");
    let told = get("events?from=0&bin=0&width=0");
    let events = told["events"].as_array().unwrap();
    let of = |kind: &'static str| events.iter().filter(move |e| e[0] == kind);
    let mut names = Vec::new();
    for (i, entry) in (0..).zip(of("x")) {
        assert_eq!(entry[1], Value::from(i * 1_000_000));
        assert!(of("m").any(|begun| begun[1] == entry[1]), "nothing is done at {}", entry[1]);
        names.push(entry[3].as_str().unwrap().to_owned());
    }
    assert_eq!((&told["over"], &told["now"]), (&Value::from(true), &Value::from(names.len() * 1_000_000)));
    names
}

/// A port can be chosen, so that it can be forwarded; one that is taken is refused.
#[test]
fn the_port_can_be_chosen() {
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = free.local_addr().unwrap().port().to_string();
    let ran = run(&["view", "chair", "--port", &port]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{ran:?}");
    assert!(
        ran.err.contains(&format!("--port {port}: ")) && ran.err.contains("\n  fix: name another port"),
        "{ran:?}"
    );
    drop(free);
    let view = View::of("chair.toml", &["--port", &port]);
    assert_eq!(view.parts().0, format!("127.0.0.1:{port}"));
    assert_eq!(view.get(&format!("{}scene", view.parts().1), "").0, 200);
}

/// A figure that the page saves has the bytes of the one that `render` writes with the same options: of a journal, and
/// of a scenario, of which `render` simulates only the beginning.
#[test]
fn saved_figures_are_those_of_render() {
    let directory = tempfile::tempdir().unwrap();
    let journal = record(directory.path(), "swarm.toml", &[]);
    let cases: [(&str, &[&str]); 4] = [
        (
            "svg",
            &[
                "at=3.3s",
                "camera=200,35",
                "color=messages",
                "goal=ghost",
                "links=messages,waits",
                "theme=dark",
            ],
        ),
        ("svg", &["at=2500000us", "color=gradient", "links=contacts", "title=x %3C 4 %26 %7Bt%7D"]),
        ("png", &["width=400px", "color=locks", "at=4s"]),
        ("gif", &["at=2s", "every=500ms", "width=200px"]),
    ];
    for (source, options) in [(journal.as_str(), &[][..]), ("swarm", &["--seed", "3"])] {
        let view = View::start(&[&["view", source], options].concat());
        let is_over =
            || view.get(&format!("{}events?from=999999999", view.parts().1), "").1.contains("\"over\":true");
        assert!(wait_until(Duration::from_secs(120), is_over), "the run does not end");
        for (format, query) in cases {
            let (head, saved) =
                view.content(&format!("figure.{format}?{}", query.join("&").replace(' ', "%20")));
            assert!(
                head.starts_with("HTTP/1.1 200 "),
                "{query:?}: {head}{}",
                String::from_utf8_lossy(&saved)
            );
            assert!(head.contains("content-disposition: attachment; filename=\"swarm-"), "{head}");
            assert!(head.contains("content-type: image/") && head.contains("nosniff"), "{head}");
            let out = directory.path().join(format!("figure.{format}")).display().to_string();
            let decoded = [("%3C", "<"), ("%26", "&"), ("%7B", "{"), ("%7D", "}")];
            let typed = query
                .iter()
                .map(|pair| decoded.iter().fold(format!("--{pair}"), |t, (a, b)| t.replace(a, b)));
            let typed: Vec<String> = typed.collect();
            let typed: Vec<&str> = typed.iter().map(String::as_str).collect();
            let ran = run(&[&["render", source, "--quiet", "--out", &out], options, &typed[..]].concat());
            assert_eq!(ran.code, Some(0), "{ran:?}");
            assert!(
                saved == fs::read(&out).unwrap(),
                "{source} {query:?}: {}",
                String::from_utf8_lossy(&saved[..400])
            );
        }
        // The end of the run, with the trace hash of a simulated one.
        let (_, saved) = view.content("figure.svg");
        let ran = run(&[&["render", source], options].concat());
        assert!(saved == ran.out.as_bytes(), "{}", ran.err);
        assert_eq!(ran.out.contains("Trace hash"), source == "swarm");
        for (path, status, part) in [
            ("figure.svg?at=1h", 400, "the run ended at"),
            ("figure.svg?colour=state", 400, "unexpected argument '--colour'"),
            ("figure.svg?every=1s", 400, "shows one moment"),
            ("figure.gif", 400, "needs the time from one frame"),
            ("figure.gif?every=1s&theme=transparent", 400, "have a background"),
            ("figure.png?width=2000mm&dpi=2400", 400, "million pixels"),
            ("figure.jpeg", 404, "not found"),
        ] {
            let (head, text) = view.content(path);
            let text = String::from_utf8_lossy(&text);
            assert!(
                head.starts_with(&format!("HTTP/1.1 {status} ")) && text.contains(part),
                "{path}: {head}{text}"
            );
            assert!(!head.contains("content-disposition"), "{path}: {head}");
        }
        let (host, root) = view.parts();
        let (status, _) = view.get(&format!("{root}figure.svg"), "Origin: http://evil.example\r\n");
        assert_eq!(status, 403);
        assert_eq!(view.get("/figure.svg", "").0, 404, "{host}");
        assert_eq!(view.end(), Some(0));
    }
}
