//! Figures of runs: their structure, the same bytes on every run, sections, cameras, moving pictures, and errors.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{Ran, command, run, scenario};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::thread;

/// A run with a dead module, so that all groups of colours occur.
const SWARM: &str = "deploy/scenarios/swarm.toml";
const BOX: &str = "deploy/scenarios/box.toml";

/// Draws a figure, and returns its bytes.
fn figure(source: &str, name: &str, options: &[&str]) -> Vec<u8> {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join(name);
    let line = ["render", source, "--quiet", "--out", out.to_str().unwrap()];
    let ran = run(&[&line, options].concat());
    assert_eq!((ran.code, ran.out.as_str(), ran.err.as_str()), (Some(0), "", ""), "{options:?}");
    fs::read(out).unwrap()
}

fn svg(source: &str, options: &[&str]) -> String {
    String::from_utf8(figure(source, "figure.svg", options)).unwrap()
}

/// A module in a figure: its attributes, and the number of its paths.
#[derive(Debug)]
struct Group {
    attributes: BTreeMap<String, String>,
    paths: Vec<String>,
}

impl Group {
    fn cell(&self) -> [i32; 3] {
        let numbers: Vec<i32> = self.attributes["data-cell"].split(' ').map(|n| n.parse().unwrap()).collect();
        numbers.try_into().unwrap()
    }
    fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.get(name).map(String::as_str)
    }
}

/// Returns the groups of a figure by their identities, which are unique.
fn groups(svg: &str) -> BTreeMap<String, Group> {
    let document = roxmltree::Document::parse(svg).unwrap();
    let mut groups = BTreeMap::new();
    for group in document.descendants().filter(|node| node.has_tag_name("g")) {
        let attributes = group.attributes().map(|a| (a.name().to_owned(), a.value().to_owned())).collect();
        let paths = group.children().filter_map(|node| node.attribute("d")).map(str::to_owned).collect();
        let id = group.attribute("id").unwrap().to_owned();
        assert!(groups.insert(id.clone(), Group { attributes, paths }).is_none(), "{id} occurs twice");
    }
    groups
}

fn modules(svg: &str) -> BTreeMap<String, Group> {
    groups(svg).into_iter().filter(|(id, _)| id.starts_with('m')).collect()
}

fn text_of(svg: &str, tag: &str) -> String {
    let document = roxmltree::Document::parse(svg).unwrap();
    let node = document.descendants().find(|node| node.has_tag_name(tag)).unwrap();
    node.text().unwrap_or_default().to_owned()
}

#[test]
fn the_same_run_and_options_give_the_same_bytes() {
    let cases: [(&str, &str, &[&str]); 4] = [
        (SWARM, "a.svg", &["--at", "3s", "--labels", "ids", "--goal", "ghost"]),
        (SWARM, "a.png", &["--at", "50%", "--color", "messages", "--width", "400px"]),
        (SWARM, "a.gif", &["--every", "4s", "--width", "200px"]),
        (BOX, "a.svg", &["--at", "20s"]),
    ];
    for (source, name, options) in cases {
        assert!(figure(source, name, options) == figure(source, name, options), "{name} {options:?}");
    }
}

/// Every module that is seen is a group with its number, role and cell; styles are attributes, and the figure
/// says how it was made.
#[test]
fn every_module_is_a_group() {
    let svg = svg(SWARM, &["--kill", "3@2s"]);
    let root = roxmltree::Document::parse(&svg).unwrap();
    assert_eq!(root.root_element().attribute("width"), Some("85mm"));
    assert!(!svg.contains("<style") && !svg.contains("NaN") && !svg.contains("inf"));
    let modules = modules(&svg);
    let roles: BTreeSet<_> = modules.values().filter_map(|m| m.attribute("data-role")).collect();
    assert!(roles.contains("final"), "{roles:?}");
    assert_eq!(modules["m3"].attribute("data-process"), Some("dead"));
    // The cells of a group are those of the report's world: one module each.
    let cells: BTreeSet<_> = modules.values().map(Group::cell).collect();
    assert_eq!(cells.len(), modules.len());
    // The camera sees three faces of a cube at most; a fourth path is a mark.
    assert!(modules.values().all(|m| (1..=4).contains(&m.paths.len())), "{modules:?}");
    let description = text_of(&svg, "desc");
    assert!(
        description.contains("metamorph render deploy/scenarios/swarm.toml --kill 3@2s. Trace hash"),
        "{description}"
    );
    assert_eq!(text_of(&svg, "title"), text_of(&svg, "title").trim());
    let words: Vec<_> =
        root.descendants().filter(|n| n.has_tag_name("text")).filter_map(|n| n.text()).collect();
    assert!(["x", "y", "z", "finalized", "dead"].iter().all(|word| words.contains(word)), "{words:?}");
    assert!(words.iter().any(|word| word.ends_with("cells") || word.ends_with("cell")), "{words:?}");
}

/// The command in the description makes the same figure.
#[test]
fn figures_can_be_made_again_from_their_description() {
    let options =
        ["--at", "30%", "--camera", "200,35", "--section", "x<4", "--title", "at {t}", "--axes", "off"];
    let first = svg(SWARM, &options);
    let description = text_of(&first, "desc");
    let line = description.split("metamorph render ").nth(1).unwrap();
    let line = line.split(". Trace hash").next().unwrap();
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("again.svg");
    // The line is for a shell, so a shell reads it.
    let mut shell = std::process::Command::new("sh");
    shell.arg("-c").arg(format!("\"$0\" render {line} --quiet --out \"$1\""));
    shell.arg(metamorph_tests::command::metamorph()).arg(&out);
    let status = shell.current_dir(metamorph_tests::command::root()).status().unwrap();
    assert!(status.success());
    assert_eq!(fs::read_to_string(out).unwrap(), first);
}

/// A slab of 9 by 15 by 3 modules, along each axis: the nearest layer hides the others.
#[test]
fn cameras_along_an_axis_see_one_layer() {
    let slab = "deploy/scenarios/rabbit.toml";
    for (camera, axis, nearest, seen) in
        [("top", 2, 2, 9 * 15), ("front", 1, -7, 9 * 3), ("side", 0, 4, 15 * 3)]
    {
        let modules = modules(&svg(slab, &["--at", "0s", "--camera", camera]));
        assert_eq!(modules.len(), seen, "{camera}");
        assert!(modules.values().all(|m| m.cell()[axis] == nearest && m.paths.len() == 1), "{camera}");
    }
    let iso = modules(&svg(slab, &["--at", "0s"]));
    assert_eq!(iso.len(), 9 * 15 * 3 - 8 * 14 * 2, "the hidden ones are left out");
    assert!(iso.values().all(|m| m.cell()[2] == 2 || m.cell()[1] == -7 || m.cell()[0] == 4));
}

#[test]
fn sections_remove_what_is_beyond_and_hatch_the_cut() {
    let whole = svg(SWARM, &["--goal", "off"]);
    let cut = svg(SWARM, &["--goal", "off", "--section", "x<3"]);
    let kept = modules(&cut);
    assert!(kept.values().all(|m| m.cell()[0] < 3) && !kept.is_empty());
    // A hatched face is two paths; the cut is across x, which this camera sees.
    let hatched = |m: &Group| m.paths.iter().any(|d| d.matches('M').count() == 5);
    let faces: Vec<_> = kept.values().filter(|m| hatched(m)).map(Group::cell).collect();
    assert!(!faces.is_empty() && faces.iter().all(|[x, ..]| *x == 2), "{faces:?}");
    assert!(!modules(&whole).values().any(hatched));
    // The other side of the plane is seen from the other side only.
    let behind = svg(SWARM, &["--goal", "off", "--section", "x>2"]);
    assert!(modules(&behind).values().all(|m| m.cell()[0] > 2 && !hatched(m)));
}

#[test]
fn modules_can_be_chosen_and_coloured() {
    let chosen = modules(&svg(SWARM, &["--only", "modules=1,4,7..9"]));
    let ids: BTreeSet<&str> = chosen.keys().map(String::as_str).collect();
    assert_eq!(ids, BTreeSet::from(["m1", "m4", "m7", "m8", "m9"]));
    let goal = modules(&svg(SWARM, &["--only", "goal"]));
    assert!(!goal.is_empty() && goal.values().all(|m| m.attribute("data-role") == Some("final")));
    let levels = modules(&svg(SWARM, &["--only", "level=1", "--color", "level"]));
    assert!(!levels.is_empty() && levels.values().all(|m| m.attribute("data-value") == Some("1")));
    for color in ["gradient", "messages", "seed", "module", "none"] {
        let svg = svg(SWARM, &["--at", "50%", "--color", color]);
        assert!(!modules(&svg).is_empty());
        assert_eq!(svg.contains("data-value"), ["gradient", "messages"].contains(&color), "{color}");
    }
    for theme in ["dark", "transparent", "grey"] {
        assert!(svg(SWARM, &["--theme", theme]).len() > 1_000);
    }
}

/// Metamodules stand on a floor, and consist of halves of balls.
#[test]
fn metamodules_are_drawn_part_by_part() {
    let svg = svg(BOX, &["--at", "30s"]);
    let groups = modules(&svg);
    let first = groups.keys().filter(|id| *id == "m0" || id.starts_with("m0-")).count();
    assert_eq!(first, 8, "{:?}", groups.keys());
    assert!(groups.values().all(|m| !m.paths.is_empty()));
}

/// A journal and its scenario give the same figure, but for the description.
#[test]
fn journals_and_scenarios_give_the_same_figure() {
    let directory = tempfile::tempdir().unwrap();
    let journal = directory.path().join("run.journal");
    let journal = journal.to_str().unwrap();
    let ran = run(&["run", SWARM, "--link", "sim", "--quiet", "--journal", journal]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let without = |svg: String| {
        let (before, rest) = svg.split_once("<desc>").unwrap();
        format!("{before}{}", rest.split_once("</desc>").unwrap().1)
    };
    for at in ["0s", "3.3s", "end"] {
        assert_eq!(without(svg(journal, &["--at", at])), without(svg(SWARM, &["--at", at])), "{at}");
    }
    let ran = run(&["render", journal, "--seed", "1"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("--seed: a journal holds a run that is over\n  fix: "), "{}", ran.err);
    let mut bytes = fs::read(journal).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x55;
    let damaged = directory.path().join("damaged.journal");
    fs::write(&damaged, bytes).unwrap();
    let out = directory.path().join("x.svg");
    let ran = run(&["render", damaged.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    assert_eq!((ran.code, out.exists()), (Some(9), false), "{ran:?}");
}

#[test]
fn png_has_the_size_asked_for_and_says_how_it_was_made() {
    let bytes = figure(SWARM, "a.png", &["--at", "1s"]);
    let reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
    let info = reader.info();
    assert_eq!((info.width, info.color_type), (1004, png::ColorType::Rgb), "85 mm at 300 dpi");
    assert_eq!(info.pixel_dims.unwrap().xppu, 11_811);
    let texts: Vec<String> = info.utf8_text.iter().map(|chunk| chunk.get_text().unwrap()).collect();
    assert!(
        texts.iter().any(|text| text.contains("metamorph render deploy/scenarios/swarm.toml --at 1s")),
        "{texts:?}"
    );
    let bytes = figure(SWARM, "a.png", &["--at", "1s", "--width", "500px", "--theme", "transparent"]);
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
    let mut data = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut data).unwrap();
    assert_eq!((info.width, info.color_type, data[3]), (500, png::ColorType::Rgba, 0));
    assert!(data.chunks(4).filter(|p| p[3] == 255).count() > 10_000, "there are modules");
}

/// A moving picture has a frame for every so much time, and the end.
#[test]
fn moving_pictures_have_all_frames() {
    let options = ["--at", "10s", "--every", "1.5s", "--width", "220px", "--fps", "10"];
    let bytes = figure(SWARM, "a.gif", &options);
    let mut options_of_reader = gif::DecodeOptions::new();
    options_of_reader.set_color_output(gif::ColorOutput::Indexed);
    let mut decoder = options_of_reader.read_info(bytes.as_slice()).unwrap();
    let (mut frames, mut smaller) = (0, 0);
    let size = (decoder.width(), decoder.height());
    while let Some(frame) = decoder.read_next_frame().unwrap() {
        assert_eq!(frame.delay, 10);
        smaller += usize::from((frame.width, frame.height) != size);
        frames += 1;
    }
    assert_eq!((frames, size.0), (8, 220));
    assert!(smaller > 4, "frames hold only what has changed: {smaller}");
    let bytes = figure(SWARM, "a.apng", &options);
    let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
    assert_eq!(reader.info().animation_control.unwrap().num_frames, 8);
    let mut data = vec![0; reader.output_buffer_size().unwrap()];
    for _ in 0..8 {
        reader.next_frame(&mut data).unwrap();
    }
    assert!(reader.next_frame(&mut data).is_err());
}

/// Numbered figures are those of the moments of a moving picture, at one place and scale.
#[test]
fn figures_of_many_moments_are_numbered() {
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join("frames").join(name);
    for kind in ["svg", "png"] {
        let out = at(&format!("run-{{i}}.{kind}"));
        let line = ["render", SWARM, "--out", out.to_str().unwrap(), "--at", "4s", "--every", "1.5s"];
        let ran = run(&[&line[..], &["--width", "200px"]].concat());
        assert_eq!(ran.code, Some(0), "{ran:?}");
        assert!(ran.out.contains("4 files"), "{}", ran.out);
    }
    let names: BTreeSet<String> = fs::read_dir(at(""))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    assert_eq!(names.len(), 8, "{names:?}");
    let read = |number: u32| fs::read_to_string(at(&format!("run-000{number}.svg"))).unwrap();
    let size = |svg: &str| svg.split(" viewBox=\"").nth(1).unwrap().split('"').next().unwrap().to_owned();
    assert_eq!(size(&read(0)), size(&read(3)));
    let cells = |number| modules(&read(number)).values().map(Group::cell).collect::<BTreeSet<_>>();
    assert!(cells(0) != cells(3), "the modules move meanwhile");
    let (width, _) = png_size(&fs::read(at("run-0002.png")).unwrap());
    assert_eq!(width, 200);
}

fn png_size(bytes: &[u8]) -> (u32, u32) {
    let reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
    (reader.info().width, reader.info().height)
}

#[test]
fn errors_say_what_to_do_and_leave_no_file() {
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let cases: [(&str, &[&str], &str); 15] = [
        ("{i}.gif", &[], "a moving picture needs the time"),
        ("a.svg", &["--at", "1h"], "--at 3600s: the run ended at"),
        ("a.svg", &["--at", "soon"], "--at"),
        ("a.svg", &["--only", "modules=4000"], "--only modules=4000: there is no such module at"),
        ("a.svg", &["--only", "level=99"], "there is no such module"),
        ("a.svg", &["--section", "z>50"], "--section 'z>=51'"),
        ("a.svg", &["--camera", "isometric"], "iso, true-iso, front, side, top"),
        (
            "a.svg",
            &["--color", "level", "--only", "modules=41", "--at", "0s"],
            "--color level: no drawn module has one",
        ),
        ("a.svg", &["--every", "1s"], "--every: a file that ends in .svg, .pdf or .png shows one moment"),
        ("a.gif", &[], "a moving picture needs the time from one frame to the next"),
        ("a.gif", &["--every", "1s", "--theme", "transparent"], "moving pictures have a background"),
        ("a.gif", &["--every", "1ms"], "are more than 3000"),
        ("a.jpeg", &[], "the name says no format"),
        ("none/a.svg", &[], "cannot write there"),
        ("a.png", &["--width", "2000mm", "--dpi", "2400"], "are more than 100 million pixels"),
    ];
    for (name, options, expected) in cases {
        let out = at(name);
        let ran = run(&[&["render", SWARM, "--quiet", "--out", &out], options].concat());
        assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{options:?}: {}", ran.err);
        assert!(ran.err.contains(expected), "{options:?}: {}", ran.err);
        assert!(!Path::new(&out).exists(), "{options:?}");
    }
    let ran = run(&["render", "nothing.journal"]);
    assert_eq!(ran.code, Some(2), "{ran:?}");
    let ran = run(&["render", scenario("swarm.toml").to_str().unwrap(), "--out", SWARM]);
    assert_eq!(ran.code, Some(2), "{ran:?}");
}

/// Figures that were looked at, and stay as they are byte by byte.
#[test]
fn figures_are_those_that_are_kept() {
    let golden = metamorph_tests::command::root().join("tests/golden");
    let cases: [(&str, &str, &[&str]); 4] = [
        ("slab.svg", "deploy/scenarios/slab-to-sphere.toml", &["--at", "0s"]),
        ("chair.svg", "deploy/scenarios/chair.toml", &[]),
        ("section.svg", "deploy/scenarios/arch.toml", &["--section", "x<3", "--color", "level"]),
        ("top.svg", SWARM, &["--at", "2.5s", "--camera", "top", "--labels", "ids"]),
    ];
    for (name, source, options) in cases {
        let kept = fs::read_to_string(golden.join(name)).unwrap();
        let line = format!("metamorph render {source} {} --out tests/golden/{name}", options.join(" "));
        assert!(
            svg(source, options) == kept,
            "{name} differs; if that is right, look at it and keep it: {line}"
        );
    }
}

#[test]
fn without_a_file_the_figure_goes_to_standard_output() {
    let output = command(&["render", SWARM, "--at", "1s", "--quiet"]).output().unwrap();
    assert!(output.status.success());
    assert!(String::from_utf8(output.stdout).unwrap().starts_with("<svg "));
}

/// The pictures of README.md, the gallery and three chapters are what `docs/pictures/make` makes: the SVG byte by byte, the
/// moving pictures in size and number of frames, since pixels may differ a little on other processors.
#[test]
fn the_pictures_of_the_pages_are_made_by_render() {
    let pictures = metamorph_tests::command::root().join("docs/pictures");
    let readme = fs::read_to_string(metamorph_tests::command::root().join("README.md")).unwrap();
    let script = fs::read_to_string(pictures.join("make")).unwrap();
    let lines: Vec<&str> = script.lines().filter_map(|line| line.strip_prefix("metamorph ")).collect();
    assert!(lines.len() > 2, "{script}");
    let gallery = fs::read_to_string(pictures.join("../gallery.md")).unwrap();
    let chapter = |name| fs::read_to_string(pictures.join("..").join(name)).unwrap();
    let chapters = ["manipulation.md", "locomotion.md", "healing.md"].map(chapter);
    let missing: Vec<&str> = gallery
        .split("](pictures/")
        .skip(1)
        .filter_map(|rest| rest.split(')').next())
        .filter(|name| *name != "make" && !lines.iter().any(|line| line.ends_with(&format!(" {name}"))))
        .collect();
    assert!(missing.is_empty(), "docs/pictures/make does not draw {missing:?}");
    let frames = |bytes: &[u8]| {
        let mut decoder = gif::DecodeOptions::new().read_info(bytes).unwrap();
        let mut frames = 0;
        while decoder.read_next_frame().unwrap().is_some() {
            frames += 1;
        }
        (decoder.width(), decoder.height(), frames)
    };
    let check = |line: &str| {
        let words: Vec<&str> = line.split(' ').collect();
        let (options, name) = (&words[2..words.len() - 2], words[words.len() - 1]);
        let shown = readme.contains(&format!("docs/pictures/{name}"))
            || chapters.iter().chain([&gallery]).any(|page| page.contains(&format!("](pictures/{name})")));
        assert!(words[0] == "render" && shown, "{line}");
        let options: Vec<&str> = options.iter().copied().filter(|word| *word != "--quiet").collect();
        let made = figure(words[1], name, &options);
        let kept = fs::read(pictures.join(name)).unwrap();
        assert!(kept.len() < 300_000, "{name}: {}", kept.len());
        match name.ends_with(".svg") {
            true => assert!(made == kept, "{name} is not what `{line}` makes; run docs/pictures/make"),
            false => assert_eq!(frames(&made), frames(&kept), "{name}; run docs/pictures/make"),
        }
    };
    // Some take ten seconds, and no other test of this file does.
    thread::scope(|scope| {
        let (even, odd): (Vec<_>, Vec<_>) = lines.iter().enumerate().partition(|(i, _)| i % 2 == 0);
        for part in [even, odd] {
            scope.spawn(|| part.into_iter().for_each(|(_, line)| check(line)));
        }
    });
}

/// A page holds the vectors of the figure, and says how it was made. A page of others is not replaced.
#[test]
fn figures_become_pages() {
    let page = figure(SWARM, "a.pdf", &["--at", "2s", "--title", "a title"]);
    assert!(
        page.starts_with(b"%PDF-") && page == figure(SWARM, "a.pdf", &["--at", "2s", "--title", "a title"])
    );
    let text = String::from_utf8_lossy(&page);
    assert!(text.contains("/Creator (metamorph)") && text.contains("--at 2s"), "{text}");
    let directory = tempfile::tempdir().unwrap();
    let thesis = directory.path().join("thesis.pdf");
    fs::write(&thesis, "%PDF-1.4\nmine").unwrap();
    let refused = run(&["render", SWARM, "--at", "2s", "--out", thesis.to_str().unwrap()]);
    assert!(refused.code == Some(2) && fs::read(&thesis).unwrap().ends_with(b"mine"), "{refused:?}");
}

/// Films are made by ffmpeg; without it, the error names it.
#[test]
fn films_are_made_where_ffmpeg_is() {
    let directory = tempfile::tempdir().unwrap();
    let film = directory.path().join("a.mp4");
    let words = ["render", SWARM, "--every", "2s", "--quiet", "--out", film.to_str().unwrap()];
    let without: Ran = command(&words).env("PATH", "/nonexistent").output().unwrap().into();
    assert!(without.code == Some(2) && without.err.contains("apt install ffmpeg"), "{without:?}");
    assert!(!film.exists());
    let Ran { code, err, .. } = run(&words);
    match code {
        Some(0) => assert_eq!(fs::read(&film).unwrap().get(4..8), Some(&b"ftyp"[..])),
        _ => assert!(err.contains("ffmpeg"), "{err}"),
    }
}
