//! Hostile inputs of every kind: every command ends with a documented exit code, within bounds, and neither
//! destroys nor leaves files (see `metamorph_tests::hostile`). More than 300 inputs, in tables; the last test
//! counts them.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{command, root, run};
use metamorph_tests::hostile::{Case, Thing, file, run_all};
use std::fs;

/// A valid scenario.
const SMALL: &str = r#"version = 1
name = "small"
description = "a plate becomes a square"
seed = 3
[swarm]
start = { box = { min = [0, 0, 0], max = [3, 2, 0] } }
move_time = "1s"
failed_connections = "1%"
[[goal]]
name = "one"
shape = { box = { min = [0, 0, 0], max = [2, 2, 0] } }
seed = [0, 0, 0]
growth = "solid"
[protocol]
connectivity = "forest"
co_owners = true
[link]
delay = "10ms..100ms"
loss = "5%"
[process]
time_scale = 20
[[fault]]
pause = [2]
from = "1s"
until = "3s"
[stop]
timeout = "500s"
"#;
/// The start and the end of a scenario whose initial shape is in between.
const START: &str = "version = 1\n[swarm]\nstart = ";
const GOAL: &str = "\n[[goal]]\nshape = { box = { min = [0, 0, 0], max = [1, 1, 0] } }\n";

fn check(text: impl AsRef<[u8]>) -> Case {
    Case::new(&["check", "--link", "sim", "a.toml"]).with("a.toml", file(text))
}

fn texts() -> Vec<Case> {
    let mut cases: Vec<Case> = SMALL
        .lines()
        .enumerate()
        .flat_map(|(i, _)| {
            let without = |i| SMALL.lines().enumerate().filter(move |(n, _)| *n != i).map(|(_, l)| l);
            let cut: String = SMALL.lines().take(i).collect::<Vec<_>>().join("\n");
            [without(i).collect::<Vec<_>>().join("\n"), cut]
        })
        .map(check)
        .collect();
    let deep = |open: &str, close: &str, n: usize| format!("{}{}", open.repeat(n), close.repeat(n));
    let utf16: Vec<u8> = SMALL.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let refused: Vec<Vec<u8>> = vec![
        b"".to_vec(),
        b"\0".repeat(1000),
        utf16,
        (0..=255u8).cycle().take(5000).collect(),
        b"\xff\xfe\xfd".to_vec(),
        format!("a = {}", deep("[", "]", 20_000)).into(),
        format!("a = {}1{}", "{ a = ".repeat(20_000), " }".repeat(20_000)).into(),
        format!("{}a = 1", "a.".repeat(20_000)).into(),
        format!("[{}a]", "a.".repeat(20_000)).into(),
        format!("a = \"{}", "x".repeat(1 << 20)).into(),
        format!("{} = 1\nversion = 1", "k".repeat(1 << 20)).into(),
        (0..100_000).map(|i| format!("k{i} = 1\n")).collect::<String>().into(),
        format!("version = 1\nname = {}", "9".repeat(100_000)).into(),
        "version = 1\n".repeat(50_000).into(),
        "[[goal]]\n".repeat(100_000).into(),
        "[[fault]]\n".repeat(100_000).into(),
        vec![b'#'; 17 << 20],
        format!("{START}{}{GOAL}", deep("{ union = [", "] }", 100)).into(),
        format!("{START}{{ union = [] }}{GOAL}").into(),
        format!("{START}{{ cells = [{}] }}{GOAL}", "[0, 0, 0],".repeat(1000)).into(),
        format!("{SMALL}[link]\nloss = 1\n").into(),
        format!("\"{}\" = 1\nversion = 1", "\\u001B[31m").into(),
        SMALL.replace("loss", "\"lo\\u001B[31mss\\u202E\"").into(),
        SMALL.replace("\"forest\"", "\"\\u001B[2J\\u009B31m\\u202E\"").into(),
        SMALL.replace("\"forest\"", &format!("\"{}\"", "forest".repeat(10_000))).into(),
        SMALL.replace("\"5%\"", &format!("\"{}\"", "5".repeat(1 << 20))).into(),
        SMALL.replace("= 20", "= nan").into(),
        SMALL.replace("= 20", "= 1e999").into(),
        SMALL.replace("\n", "\r").into(),
    ];
    cases.extend(refused.into_iter().map(|text| check(text).refused(&["fix: "])));
    // A valid scenario with hostile names.
    let names = SMALL.replace("\"small\"", "\"\\u001B[2J\\u009B31m\\u202E\\n\\rBUILT\"");
    let names =
        names.replace("\"one\"", "\"\\u0007\\u2066\\u007F\"").replace("a plate", "\\u001B]0;x\\u0007");
    for command in [&["check"][..], &["run"], &["sweep", "--seeds", "0..2"], &["run", "--json", "-"]] {
        let sim: &[&str] = if command[0] == "sweep" { &[] } else { &["--link", "sim"] };
        cases.push(Case::new(&[command, sim, &["a.toml"]].concat()).with("a.toml", file(&names)).ends(&[0]));
    }
    cases.push(check(SMALL.replace("small", &"x".repeat(1 << 20))).ends(&[0]));
    cases.push(check(format!("\u{feff}{SMALL}")));
    cases.push(check(SMALL.replace('\n', "\r\n")).ends(&[0]));
    cases
}

/// Returns every key with values that it does not expect.
fn values() -> Vec<Case> {
    let keys = [
        "version",
        "name",
        "seed",
        "swarm",
        "swarm.family",
        "swarm.start",
        "swarm.move_time",
        "goal",
        "goal.0.shape",
        "goal.0.seed",
        "goal.0.growth",
        "goal.1",
        "link.delay",
        "link.loss",
        "link.until",
        "process.time_scale",
        "fault.0.pause",
        "fault.0.from",
        "stop.timeout",
        "stop.stall",
        "protocol",
        "no.such.key",
        "",
    ];
    let long = "9".repeat(4_000);
    let values = [
        "-1",
        "99999999999999999999",
        &long,
        "\x1b[31m\u{202e}",
        "1e308",
        "nan",
        "[[]]",
        "{}",
        "true",
        "0s..0s",
        "\"\"",
    ];
    let of = |key: &str| {
        let case = |value: &&str| {
            Case::new(&["check", "--link", "sim", "a.toml", "--set", &format!("{key}={value}")])
                .with("a.toml", file(SMALL))
        };
        values.iter().map(case).collect::<Vec<_>>()
    };
    keys.into_iter().flat_map(of).collect()
}

fn options() -> Vec<Case> {
    let run = ["run", "--link", "sim", "a.toml"];
    let wrong: &[&[&str]] = &[
        &["--kill", "99@1s"],
        &["--kill", "\x1b[31m"],
        &["--kill", "1@99999999999999999999999h"],
        &["--pause", "1@3s..1s"],
        &["--loss", "-5%"],
        &["--loss", "1/0"],
        &["--loss", "\u{202e}"],
        &["--delay", "1s..0s"],
        &["--delay", "9999999999h"],
        &["--seed", "-1"],
        &["--seed", "18446744073709551616"],
        &["--seed", "\x1b]0;x\x07"],
        &["--time-scale", "inf"],
        &["--json"],
        &["--json", ""],
        &["--json", "."],
        &["--html", "no/such/directory/x.html"],
        &["--journal", ".."],
        &["--\x1b[31m"],
        &["-\u{9b}31m"],
        &["\x1b[2J"],
        &["--set", "\x1b[31m=1"],
        &["--set", "link.loss"],
        &["--patience", "1s"],
    ];
    let mut cases: Vec<Case> = wrong
        .iter()
        .map(|words| Case::new(&[&run[..], words].concat()).with("a.toml", file(SMALL)).refused(&[]))
        .collect();
    let seeds = ["0", "1..0", "0..99999999999", "..", "\x1b..1", "-1..2", "0..18446744073709551615"];
    cases.extend(seeds.map(|seeds| {
        Case::new(&["sweep", "a.toml", "--jobs", "2", "--seeds", seeds])
            .with("a.toml", file(SMALL))
            .refused(&[])
    }));
    for vary in ["link.loss", "=", "link.loss=", "\x1b=1,2", "no.such=1,2", "link.loss=0%,1%,2,zebra"] {
        let args = ["sweep", "a.toml", "--jobs", "2", "--seeds", "0..1", "--vary", vary];
        cases.push(Case::new(&args).with("a.toml", file(SMALL)).refused(&[]));
    }
    let others: [&[&[u8]]; 9] = [
        &[b"\x1b[31m"],
        &[b"\xff\xfe"],
        &[b"check", b"\xff\x1b[31m.toml"],
        &[b"replay", b"\x1b[31m\n\nok"],
        &[b"replay", b"--until", b"\x1b[31m", b"x"],
        &[b"shape", b"\x1b[31m.stl"],
        &[b"shape", b"no-such-end"],
        &[b"robot", b"moves", b"\x1b[31m"],
        &[b"reproduce", b"\x1b[31m"],
    ];
    cases.extend(others.map(|args| Case::new(args).refused(&[])));
    cases
}

/// Returns cases with other kinds of entries where a file should be: refused at once.
fn special_files() -> Vec<Case> {
    let commands: [&[&str]; 11] = [
        &["check", "--link", "sim", "x.toml"],
        &["run", "--link", "sim", "x.toml"],
        &["sweep", "--seeds", "0..1", "x.toml"],
        &["view", "x.toml"],
        &["view", "x.journal"],
        &["replay", "x.journal"],
        &["export", "x.journal", "--mcap", "out.mcap"],
        &["render", "x.toml", "--out", "out.svg"],
        &["render", "x.journal", "--out", "out.svg"],
        &["shape", "x.stl"],
        &["shape", "x.xml"],
    ];
    let things = [
        Thing::Pipe,
        Thing::Socket,
        Thing::Directory,
        Thing::Link("x"),
        Thing::Link("none"),
        Thing::Link("/dev/zero"),
    ];
    let mut cases = Vec::new();
    for command in commands {
        let name = command.iter().find(|word| word.starts_with("x.")).unwrap();
        for thing in &things {
            let case = Case::new(command).with("x", Thing::Pipe).with(name, thing.clone());
            cases.push(case.refused(&["fix: "]));
        }
        cases.push(Case::new(command).refused(&["fix: "]));
    }
    let named = format!("{START}{{ file = {{ path = \"b.stl\", pitch = 1 }} }}{GOAL}");
    for thing in things {
        cases.push(check(&named).with("x", Thing::Pipe).with("b.stl", thing).refused(&["fix: "]));
    }
    for part in ["x.journal.parts/controller", "x.journal.parts/3.0", "x.journal.parts/run"] {
        for args in [&["replay", "x.journal"][..], &["resume", "x.journal"], &["view", "x.journal"]] {
            let case = Case::new(args).with("x.journal.parts", Thing::Directory).with(part, Thing::Pipe);
            cases.push(case.ends(&[1, 2]));
        }
    }
    let sweep = ["sweep", "a.toml", "--seeds", "0..1", "--jobs", "1", "--out", "out"];
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("a.toml"), SMALL).unwrap();
    assert!(command(&sweep).current_dir(&directory).output().unwrap().status.success());
    let manifest = file(fs::read(directory.path().join("out/manifest.json")).unwrap());
    let resume = Case::new(&[&sweep[..], &["--resume"]].concat());
    let resume = resume.with("a.toml", file(SMALL)).with("out", Thing::Directory).refused(&["fix: "]);
    cases.push(resume.clone().with("out/manifest.json", Thing::Pipe));
    cases.push(resume.with("out/manifest.json", manifest).with("out/runs.csv", Thing::Pipe));
    cases
}

/// Returns a journal of a simulated run.
fn journal() -> Vec<u8> {
    let directory = tempfile::tempdir().unwrap();
    let (scenario, journal) = (directory.path().join("a.toml"), directory.path().join("journal"));
    fs::write(&scenario, SMALL).unwrap();
    let [scenario, file] = [&scenario, &journal].map(|path| path.to_str().unwrap().to_owned());
    let ran = run(&["run", &scenario, "--link", "sim", "--quiet", "--journal", &file]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    fs::read(journal).unwrap()
}

fn journals() -> Vec<Case> {
    let whole = journal();
    let mut damaged: Vec<Vec<u8>> = Vec::new();
    for i in 0..24 {
        damaged.push(whole[..whole.len() * i / 24].to_vec());
        let mut flipped = whole.clone();
        // Every part of the file is changed, the head most often.
        let at = if i < 12 { i * 3 } else { whole.len() * (i - 11) / 13 };
        flipped[at] ^= 1 << (i % 8);
        damaged.push(flipped);
    }
    for version in [0u16, 1, 2, 99, u16::MAX] {
        damaged.push([&whole[..8], &version.to_le_bytes(), &whole[10..]].concat());
    }
    for length in [0u32, 1, 32 << 20, u32::MAX] {
        damaged.push([&whole[..10], &length.to_le_bytes(), &whole[14..]].concat());
    }
    damaged.push([&whole[..], &whole[..]].concat());
    damaged.push([&whole[..], b"\0\0\0\0\0\0\0\0"].concat());
    damaged.push(vec![0; 1 << 16]);
    damaged.push(SMALL.into());
    let mut cases = Vec::new();
    for bytes in damaged {
        cases.push(Case::new(&["replay", "x"]).with("x", file(&bytes)));
        cases.push(Case::new(&["replay", "--agent", "3", "--until", "9s", "x"]).with("x", file(&bytes)));
        cases.push(
            Case::new(&["export", "x", "--mcap", "out.mcap"]).with("x", file(&bytes)).makes("out.mcap"),
        );
        cases.push(Case::new(&["render", "x", "--out", "out.svg"]).with("x", file(&bytes)).makes("out.svg"));
    }
    for args in [&["replay", "x"][..], &["resume", "x"], &["export", "x", "--mcap", "out.mcap"]] {
        let case = Case::new(args).with("x.parts", Thing::Directory).makes("out.mcap");
        cases.push(case.clone().with("x.parts/controller", file(&whole)));
        cases.push(case.clone().with("x.parts/controller", file(&whole)).with("x.parts/1.0", file(&whole)));
        cases
            .push(case.clone().with("x.parts/controller", file(&whole)).with("x.parts/1.0", file("garbage")));
        cases.push(case.with("x.parts/run", file("\x1b[31m")));
    }
    cases
}

fn solids() -> Vec<Case> {
    let shape = |name: &str, bytes: Vec<u8>| Case::new(&["shape", name]).with(name, file(bytes));
    let shipped = |name: &str| fs::read(root().join("deploy/shapes").join(name)).unwrap();
    let mut cases = Vec::new();
    for (name, end) in
        [("rabbit.stl", "x.stl"), ("arch.stl", "x.stl"), ("table.obj", "x.obj"), ("case.xml", "x.xml")]
    {
        let whole = shipped(name);
        for i in 0..8 {
            cases.push(shape(end, whole[..whole.len() * i / 8].to_vec()));
            let mut flipped = whole.clone();
            flipped[whole.len() * i / 8] ^= 0x55;
            cases.push(shape(end, flipped));
        }
    }
    let binary = |count: u32, triangles: &[f32]| {
        let records = triangles.chunks(12).flat_map(|t| t.iter().flat_map(|f| f.to_le_bytes()).chain([0; 2]));
        [&[b' '; 80][..], &count.to_le_bytes(), &records.collect::<Vec<u8>>()].concat()
    };
    let facets =
        "facet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n";
    let stls: Vec<Vec<u8>> = vec![
        binary(u32::MAX, &[]),
        binary(1, &[f32::NAN; 12]),
        binary(1, &[f32::INFINITY; 12]),
        binary(1, &[f32::MAX; 12]),
        binary(2, &[0.0; 24]),
        binary(4_000_000, &[1.0; 1200]),
        b"solid".to_vec(),
        "solid\n".repeat(200_000).into(),
        format!("solid x\n{}", facets.repeat(20_000)).into(),
        format!("solid {}\n{facets}endsolid\n", "\x1b[31m").into(),
        format!("solid x\nvertex {}\n", "9".repeat(1 << 20)).into(),
    ];
    cases.extend(stls.into_iter().map(|bytes| shape("x.stl", bytes).refused(&["fix: "])));
    let corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    let objs: Vec<String> = vec![
        String::new(),
        "f 1 2 3\n".into(),
        format!("{corners}f 1 2 99999999999\n"),
        format!("{corners}f -9 -8 -7\n"),
        format!("{corners}f 0 0 0\n"),
        format!("{corners}{}", "f 1 2 3\n".repeat(2_100_000)),
        format!("{corners}f{}\n", " 1 2".repeat(1_100_000)),
        format!("{corners}{}", "g a\nf 1 2 3\n".repeat(20_000)),
        format!("{corners}{}", "l 1 2\n".repeat(2_100_000)),
        "v 1e999 nan inf\n".repeat(100),
        "v \x1b[31m 0 0\n".into(),
        format!("mtllib {}\nusemtl \x1b[31m\n{corners}f 1 2 3\n", "../".repeat(1000)),
    ];
    cases.extend(objs.into_iter().map(|text| shape("x.obj", text.into()).refused(&["fix: "])));
    cases.extend(configurations().into_iter().map(|text| shape("x.xml", text.into()).refused(&["fix: "])));
    for name in ["x.stl", "x.obj", "x.xml", "\x1b[31m.stl"] {
        cases.push(shape(name, (0..=255u8).cycle().take(100_000).collect()).refused(&["fix: "]));
    }
    for option in [
        &["--pitch", "0"][..],
        &["--pitch", "nan"],
        &["--pitch", "1e-30"],
        &["--pitch", "1e30"],
        &["--cells", "65535"],
    ] {
        let case =
            Case::new(&[&["shape", "x.stl"], option].concat()).with("x.stl", file(shipped("arch.stl")));
        cases.push(case.refused(&[]));
    }
    cases
}

/// Returns files that are no configurations of VisibleSim.
fn configurations() -> Vec<String> {
    let targets = |inner: &str| format!("<world><targetList><target>{inner}</target></targetList></world>");
    let solid = |text: &str| {
        let targets = targets(&format!("<csg content=\"{text}\"/>"));
        targets.replace("<world>", "<world gridSize=\"30000,30000,30000\">")
    };
    let attributes = |n: usize| (0..n).map(|i| format!(" a{i}=\"1\"")).collect::<String>();
    let namespaces = |n: usize| (0..n).map(|i| format!(" xmlns:n{i}=\"u{i}\"")).collect::<String>();
    vec![
        String::new(),
        "<world>".repeat(100_000),
        format!("<world>{}", "<a>".repeat(1 << 20)),
        format!("<world{}/>", attributes(40_000)),
        format!("<world><!-- <a> ' --><a{}/></world>", attributes(40_000)),
        format!("<world>{}</world>", format!("<a{}/>", attributes(60)).repeat(40_000)),
        format!("<world>{}", format!("<a{}>", namespaces(5)).repeat(10_000)),
        format!("<world>{}</world>", "<a/>".repeat(2_100_000)),
        "<!DOCTYPE x [<!ENTITY a \"aaaa\"><!ENTITY b \"&a;&a;&a;\">]><world>&b;</world>".into(),
        "<!DOCTYPE x [<!ENTITY a SYSTEM \"/etc/passwd\">]><world>&a;</world>".into(),
        "<world>&a;&#0;&#x1b;</world>".into(),
        "<".repeat(1 << 20),
        "<a '".repeat(1 << 18),
        "<!--".repeat(1 << 18),
        "<![CDATA[".repeat(1 << 18),
        targets("<blockBox boxSize=\"900000000,900000000,900000000\"/>"),
        targets("<blockBox boxSize=\"0,900000000,900000000\"/>"),
        targets("<cell position=\"1e300,0,0\"/>"),
        targets("<cell position=\"0,0,99999\"/>"),
        targets("<cell position=\"&#x9b;31m\"/>"),
        targets("<cell/>"),
        targets("<csg content=\"sphere(9)\"/>"),
        solid(&"translate([1, 0, 0]) ".repeat(100_000)),
        solid(&"union() {".repeat(100_000)),
        solid(&"(".repeat(1 << 20)),
        solid(&format!("cube({}", "(".repeat(1 << 20))),
        solid(&format!("cube([{}", "1,".repeat(1 << 20))),
        solid(&"cube(1);".repeat(100_000)),
        solid(&"cube(99999);".repeat(100)),
        solid("cube(1e300 * 1e300);"),
        solid("translate([1e300, 0, 0]) cube(1);").replace("content", "boundingBox=\"false\" content"),
        targets(&format!("<targetLine values=\"{}\"/>", "1".repeat(1 << 20))),
        targets("<targetLine line=\"99999999999999999999\" values=\"1\"/>"),
        "<world\u{202e}/>".into(),
        "<w\u{202e}/>".into(),
    ]
}

/// Returns shapes with more cells than there is memory for.
fn large_shapes() -> Vec<Case> {
    let cube = |z: i32| format!("{{ box = {{ min = [0, 0, {z}], max = [150, 150, {}] }} }}", z + 150);
    let nest = |kind: &str, apart: i32| {
        (1..15).fold(cube(0), |inner, i| format!("{{ {kind} = [{}, {inner}] }}", cube(i * apart)))
    };
    let shapes = [
        nest("union", 200),
        nest("union", 0),
        nest("difference", 0),
        nest("intersection", 0),
        format!("{{ union = [{}] }}", format!("{},", cube(0)).repeat(500)),
        "{ box = { min = [-16383, -16383, -16383], max = [16383, 16383, 16383] } }".into(),
        "{ sphere = { center = [0, 0, 0], radius = 16383 } }".into(),
        "{ cylinder = { base = [0, 0, 0], radius = 16383, height = 65535 } }".into(),
        "{ cylinder = { base = [0, 0, 0], radius = 1e300, height = -1 } }".into(),
        "{ disc = { center = [0, 0, 0], radius = 16383 } }".into(),
    ];
    let mut cases: Vec<Case> =
        shapes.iter().map(|shape| check(format!("{START}{shape}{GOAL}")).refused(&["fix: "])).collect();
    let goals = |shape: &str| format!("[[goal]]\nshape = {shape}\n").repeat(32);
    let start = "{ box = { min = [0, 0, 0], max = [9, 9, 0] } }";
    // A thin frame in a large box.
    let bar = |max: &str| format!("{{ box = {{ min = [0, 0, 0], max = {max} }} }}");
    let frame =
        format!("{{ union = [{}, {}, {}] }}", bar("[390, 0, 0]"), bar("[0, 390, 0]"), bar("[0, 0, 390]"));
    for shape in [&cube(0), &nest("union", 0), &frame] {
        let solid = format!("{shape}\ngrowth = \"solid\"");
        cases.push(check(format!("{START}{start}\n{}", goals(&solid))).refused(&["fix: "]));
        let large = "{ box = { min = [0, 0, 0], max = [60, 60, 0] } }";
        cases.push(check(format!("{START}{large}\n{}", goals(&frame))).refused(&["fix: "]));
    }
    cases
}

/// Returns outputs that are an input or another output: refused under all names.
fn outputs() -> Vec<Case> {
    let case = |args: &[&str]| {
        let shaped = SMALL
            .replace("{ box = { min = [0, 0, 0], max = [2, 2, 0] } }", "{ file = { path = \"b.xml\" } }");
        let cells = "<cell position=\"0,0,0\"/><cell position=\"1,0,0\"/>";
        let configuration = format!(
            "<world><blockList>{cells}</blockList><targetList><target>{cells}</target></targetList></world>"
        );
        let case = Case::new(args).with("a.toml", file(shaped)).with("b.xml", file(configuration));
        let case = case.with("link", Thing::Link("a.toml")).with("hard", Thing::HardLink("a.toml"));
        case.with("dir", Thing::Directory)
            .with("dir/hard", Thing::HardLink("b.xml"))
            .with("way", Thing::Link("dir"))
    };
    let same = "this is the same file as";
    let mut cases = Vec::new();
    for option in ["--json", "--html", "--journal"] {
        for name in ["a.toml", "./a.toml", "dir/../a.toml", "link", "hard", "b.xml", "dir/hard", "way/hard"] {
            cases.push(case(&["run", "--link", "sim", "a.toml", option, name]).refused(&[same]));
        }
        cases.push(case(&["run", "a.toml", option, "link"]).refused(&[same]));
    }
    for (one, other) in [
        (["--json", "new"], ["--html", "new"]),
        (["--json", "dir/new"], ["--html", "way/new"]),
        (["--json", "new"], ["--html", "./dir/../new"]),
        (["--json", "new"], ["--journal", "new"]),
        (["--html", "dangling"], ["--journal", "new"]),
    ] {
        let args = [&["run", "--link", "sim", "a.toml"][..], &one, &other].concat();
        cases.push(case(&args).with("dangling", Thing::Link("new")).refused(&[same]));
    }
    for option in ["--svg", "--write"] {
        for name in ["b.xml", "dir/hard"] {
            cases.push(case(&["shape", "b.xml", option, name]).refused(&["fix: "]));
        }
    }
    cases.push(case(&["shape", "b.xml", "--svg", "new", "--write", "new"]).refused(&[same]));
    for name in ["a.toml", "b.xml", "link"] {
        cases.push(case(&["export", "a.toml", "--mcap", name]).refused(&["fix: "]));
    }
    for name in ["dir", "no/such/file", "."] {
        for option in ["--json", "--html", "--journal"] {
            cases.push(case(&["run", "--link", "sim", "a.toml", option, name]).refused(&["fix: "]));
        }
    }
    let pipe = case(&["run", "--link", "sim", "a.toml", "--json", "pipe"]).with("pipe", Thing::Pipe);
    cases.push(pipe.refused(&["a pipe that no program reads"]));
    cases
}

/// Returns commands whose standard output goes to a full disk.
fn full_disks() -> Vec<Case> {
    let whole = journal();
    let commands: [&[&str]; 19] = [
        &["--help"],
        &["--version"],
        &["run", "--help"],
        &["help", "sweep"],
        &["check", "--link", "sim", "a.toml"],
        &["run", "--link", "sim", "a.toml"],
        &["run", "--link", "sim", "a.toml", "--quiet", "--json", "-"],
        &["run", "--link", "sim", "a.toml", "--quiet", "--json", "/dev/stdout"],
        &["sweep", "a.toml", "--seeds", "0..2", "--jobs", "2"],
        &["explore", "--runs", "1", "--seed", "1", "--family", "cube"],
        &["replay", "x"],
        &["view", "x"],
        &["view", "a.toml"],
        &["shape", "b.obj", "--pitch", "10"],
        &["schema"],
        &["schema", "report"],
        &["completions", "bash"],
        &["robot", "table", "2.2"],
        &["clean"],
    ];
    let table = fs::read(root().join("deploy/shapes/table.obj")).unwrap();
    let case = |args: &&[&str]| {
        let case =
            Case::new(args).with("a.toml", file(SMALL)).with("x", file(&whole)).with("b.obj", file(&table));
        match args[..] {
            ["robot", ..] | [.., "/dev/stdout"] => Case { says: vec!["No space left"], ..case.full() },
            _ => case.full(),
        }
    };
    let mut cases: Vec<Case> = commands.iter().map(case).collect();
    let export = Case::new(&["export", "x", "--mcap", "out"]).with("x", file(&whole)).makes("out");
    cases.push(export.full());
    cases
}

#[test]
fn scenarios() {
    run_all(&texts());
}

#[test]
fn keys_and_options() {
    run_all(&[values(), options()].concat());
}

#[test]
fn other_kinds_of_entries() {
    run_all(&special_files());
}

#[test]
fn damaged_journals() {
    run_all(&journals());
}

#[test]
fn broken_solids() {
    run_all(&[solids(), large_shapes()].concat());
}

#[test]
fn files_that_must_not_be_overwritten() {
    run_all(&outputs());
}

#[test]
fn disks_without_room() {
    run_all(&full_disks());
}

#[test]
fn there_are_hundreds() {
    let all = [
        texts(),
        values(),
        options(),
        special_files(),
        journals(),
        solids(),
        large_shapes(),
        outputs(),
        full_disks(),
    ];
    assert!(all.iter().map(Vec::len).sum::<usize>() >= 600);
}
