//! Room files: TOML, read with the place of every error. Absent: what constraints mean (see `constraint`).

use super::constraint::{Axis, Constraint, Rule};
use super::form::{Form, FormError, SHAPES};
use super::model::{Area, Block, COLOURS, Colour, MAX_HEIGHT, MAX_PIECES, MAX_SIDE, Piece, Placement, Room};
use metamorph_module_agent::regular_file;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::pairing::pins::Pin;
use metamorph_scenario::diagnostics::{At, Diagnostics, Place};
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::family::Families;
use metamorph_scenario::shipped::resolve;
use metamorph_scenario::table::{Connector, Node, Read, Section, elements, wrong};
use metamorph_shapes::drawing::{self, Drawing};
use std::collections::BTreeMap;
use std::sync::Arc;
use toml::de::DeTable;

/// The version of the format.
pub const VERSION: u64 = 1;
/// Bytes of a room file at most.
pub const MAX_BYTES: u64 = 1 << 20;
/// Largest number of constraints of a room.
const MAX_CONSTRAINTS: usize = 256;
/// Cells of all keep-out boxes at most.
const MAX_KEPT_OUT: usize = 4_096;
/// Layers of a room that says nothing of its height.
const HEIGHT: i16 = 24;

const ROOM: &str = "[room]\nsize = [40, 30]";
const PIECE: &str = "[[piece]]\nname = \"chair 1\"\nshape = \"chair\"\nat = [3, 4]";
const CONSTRAINT: &str = "[[constraint]]\nkind = \"gap\"\npieces = [\"chair 1\", \"chair 2\"]\ncells = 2";
const PIECES: &str = "[\"chair 1\", \"chair 2\"]";
const AREA: &str = "{ min = [0, 0], max = [9, 4] }";
const BLOCK: &str = "{ min = [0, 0, 0], max = [1, 1, 3] }";

/// Returns the content of the drawing of this name, or why there is none.
pub type Drawings<'a> = &'a dyn Fn(&str) -> Result<Vec<u8>, String>;

/// Reads a room; drawings that it names are found beside the file `origin`.
///
/// # Errors
/// All that is wrong with the file, with its places.
pub fn read(origin: &str, text: &str) -> Result<Room, Diagnostics> {
    let beside =
        |name: &str| regular_file::read(&resolve(origin, name), MAX_BYTES).map_err(|error| error.to_string());
    read_with(origin, text, &beside)
}

/// Reads a room whose drawings are not files beside it.
///
/// # Errors
/// All that is wrong with the file, with its places.
pub fn read_with(origin: &str, text: &str, drawings: Drawings<'_>) -> Result<Room, Diagnostics> {
    let mut diagnostics = Diagnostics::new(Families::NONE, origin, text);
    let room = match DeTable::parse(text) {
        Ok(table) => document(table.get_ref(), drawings, &mut diagnostics),
        Err(error) => {
            let place = error.span().map_or(Place::File, Place::from);
            diagnostics.add(
                place,
                wrong_text(&format!("this is not TOML: {}", error.message()), "correct the line"),
            );
            None
        }
    };
    match room {
        Some(room) if diagnostics.is_empty() => Ok(room),
        _ => Err(diagnostics.sorted()),
    }
}

fn wrong_text(reason: &str, fix: &str) -> ScenarioError {
    ScenarioError::OfFamily { reason: reason.to_owned(), fix: fix.to_owned() }
}

fn document(table: &DeTable<'_>, drawings: Drawings<'_>, diagnostics: &mut Diagnostics) -> Option<Room> {
    let mut file = Section::new(table, "the room file", Place::File);
    let version = file.need::<u64>("version", "version = 1", diagnostics)?;
    if version.value != VERSION {
        let reason = format!("the room file has version {}; this program reads {VERSION}", version.value);
        diagnostics.add(version.place, wrong_text(&reason, "use the program that wrote it"));
        return None;
    }
    let name = file.get("name", diagnostics).map(|n| n.value);
    let mut room = match file.node("room") {
        Some(node) => read_room(node, diagnostics),
        None => {
            file.missing("room", ROOM, diagnostics);
            None
        }
    };
    let mut forms = Forms { drawings, read: BTreeMap::new() };
    let pieces = list(file.node("piece"), PIECE, MAX_PIECES, "pieces", diagnostics);
    let pieces: Vec<At<Piece>> =
        pieces.filter_map(|node| read_piece(node, &mut forms, diagnostics)).collect();
    for (i, piece) in pieces.iter().enumerate() {
        if pieces[..i].iter().any(|other| other.value.name == piece.value.name) {
            let reason = format!("there are two pieces with the name `{}`", piece.value.name);
            diagnostics.add(piece.place.clone(), wrong_text(&reason, "give each a name of its own"));
        }
    }
    if let Some(room) = &mut room {
        (room.name, room.pieces) = (name, pieces.into_iter().map(|piece| piece.value).collect());
    }
    let constraints = list(file.node("constraint"), CONSTRAINT, MAX_CONSTRAINTS, "constraints", diagnostics);
    let known = room.clone();
    let constraints: Vec<Constraint> =
        constraints.filter_map(|node| read_constraint(node, known.as_ref()?, diagnostics)).collect();
    file.finish(diagnostics);
    room.map(|room| Room { constraints, ..room })
}

/// Returns the tables of a list, as far as they are allowed.
fn list<'d, 'i>(
    node: Option<&'d Node<'i>>,
    example: &'static str,
    most: usize,
    what: &str,
    diagnostics: &mut Diagnostics,
) -> impl Iterator<Item = &'d Node<'i>> + use<'d, 'i> {
    let all = node.and_then(|node| elements(node, example, diagnostics));
    let (all, place) =
        (all.map(|all| all.iter().collect::<Vec<_>>()).unwrap_or_default(), node.map(Node::span));
    if let Some(place) = place.filter(|_| all.len() > most) {
        let reason = format!("there are {} {what}, at most {most} are possible", all.len());
        diagnostics.add(place, wrong_text(&reason, "leave some out"));
    }
    all.into_iter().take(most)
}

/// Returns a whole number within limits.
fn limited(
    number: At<u64>,
    what: &'static str,
    low: i16,
    high: i16,
    diagnostics: &mut Diagnostics,
) -> Option<i16> {
    let fits = i16::try_from(number.value).ok().filter(|n| (low..=high).contains(n));
    if fits.is_none() {
        let (got, low, high) = (number.value.to_string(), low.to_string(), high.to_string());
        diagnostics.add(number.place, ScenarioError::Range { what, got, low, high });
    }
    fits
}

fn read_room(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Room> {
    let mut section = Section::of(node, "[room]", ROOM, diagnostics)?;
    let size = section.need::<Connector>("size", "size = [40, 30]", diagnostics);
    let height = section.get::<u64>("height", diagnostics);
    let height = height.map_or(Some(HEIGHT), |h| limited(h, "the height", 1, MAX_HEIGHT, diagnostics));
    let doors = section.node("doors").and_then(|node| elements(node, "doors = [[0, 5]]", diagnostics));
    let doors: Vec<At<Connector>> = doors
        .into_iter()
        .flat_map(|doors| doors.iter())
        .filter_map(|door| Connector::read(door, diagnostics).map(|value| At::new(value, door.span())))
        .collect();
    let keep_out = section
        .node("keep_out")
        .and_then(|node| elements(node, "keep_out = [{ min = [0, 0, 0], max = [1, 1, 3] }]", diagnostics));
    let keep_out: Vec<At<Block>> = keep_out
        .into_iter()
        .flat_map(|all| all.iter())
        .filter_map(|node| Block::read(node, diagnostics).map(|value| At::new(value, node.span())))
        .collect();
    let store = section.get::<Area>("store", diagnostics);
    let spare = section.get::<u64>("spare", diagnostics);
    let spare = spare.map_or(Some(0), |s| limited(s, "the spare metamodules", 0, 256, diagnostics));
    section.finish(diagnostics);
    let At { value: Connector(w, d), place } = size?;
    if !(1..=MAX_SIDE).contains(&w) || !(1..=MAX_SIDE).contains(&d) {
        let (low, high) = ("1".to_owned(), MAX_SIDE.to_string());
        diagnostics.add(
            place,
            ScenarioError::Range { what: "a side of the room", got: format!("{w} or {d}"), low, high },
        );
        return None;
    }
    let room = Room {
        name: None,
        size: (w, d),
        height: height?,
        doors: doors.iter().map(|d| (d.value.0, d.value.1)).collect(),
        keep_out: keep_out.iter().map(|b| b.value).collect(),
        store: store.as_ref().map(|s| s.value),
        spare: usize::from(spare?.unsigned_abs()),
        pieces: Vec::new(),
        constraints: Vec::new(),
    };
    let outside = |at: &(i16, i16)| !room.has(*at);
    let places = doors.iter().map(|d| (vec![(d.value.0, d.value.1)], &d.place));
    let corners = |min: (i16, i16), max: (i16, i16)| vec![min, max];
    let stores = store.iter().map(|s| (corners(s.value.min, s.value.max), &s.place));
    let blocks = keep_out.iter().map(|b| {
        let Block { min, max } = b.value;
        (corners((min.x, min.y), (max.x, max.y)), &b.place)
    });
    for (at, place) in places.chain(stores).chain(blocks) {
        if let Some((x, y)) = at.into_iter().find(outside) {
            let reason =
                format!("({x}, {y}) is not in the room, which goes from (0, 0) to ({}, {})", w - 1, d - 1);
            diagnostics.add(place.clone(), wrong_text(&reason, "move it, or make `size` larger"));
        }
    }
    let volume: usize = room.keep_out.iter().map(Block::volume).sum();
    if volume > MAX_KEPT_OUT {
        let reason = format!("the keep-out boxes have {volume} cells, at most {MAX_KEPT_OUT} are possible");
        diagnostics.add(node.span(), wrong_text(&reason, "make them lower, or only as thick as a wall"));
    }
    Some(room)
}

impl Read for Area {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Area> {
        let mut section = Section::of(node, "an area", AREA, diagnostics)?;
        let min = section.need::<Connector>("min", "min = [0, 0]", diagnostics);
        let max = section.need::<Connector>("max", "max = [9, 4]", diagnostics);
        section.finish(diagnostics);
        let (min, max) = (min?.value, max?.value);
        if min.0 > max.0 || min.1 > max.1 {
            diagnostics.add(node.span(), wrong_text("`min` is beyond `max`", "exchange them"));
            return None;
        }
        Some(Area { min: (min.0, min.1), max: (max.0, max.1) })
    }
}

impl Read for Block {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Block> {
        let mut section = Section::of(node, "a box", BLOCK, diagnostics)?;
        let min = section.need::<Cell>("min", "min = [0, 0, 0]", diagnostics);
        let max = section.need::<Cell>("max", "max = [1, 1, 3]", diagnostics);
        section.finish(diagnostics);
        let (min, max) = (min?.value, max?.value);
        if min.x > max.x || min.y > max.y || min.z > max.z || min.z < 0 || max.z >= MAX_HEIGHT {
            let reason = "`min` is beyond `max`, below the floor, or above all rooms";
            diagnostics.add(
                node.span(),
                wrong_text(reason, "write a box such as { min = [0, 0, 0], max = [1, 1, 3] }"),
            );
            return None;
        }
        Some(Block { min, max })
    }
}

/// Where drawings come from, and the forms that pieces have named so far, since many pieces have the same.
struct Forms<'a> {
    drawings: Drawings<'a>,
    read: BTreeMap<String, Option<Arc<Form>>>,
}

fn read_piece(node: &Node<'_>, forms: &mut Forms<'_>, diagnostics: &mut Diagnostics) -> Option<At<Piece>> {
    let mut section = Section::of(node, "[[piece]]", PIECE, diagnostics)?;
    let name = section.need::<String>("name", "name = \"chair 1\"", diagnostics);
    let at = section.need::<Connector>("at", "at = [3, 4]", diagnostics);
    let turn = section.get::<u64>("turn", diagnostics);
    let turn = turn.map_or(Some(0), |t| limited(t, "the quarter turns", 0, 3, diagnostics));
    let colour = section.choice("colour", "colour", &COLOURS, diagnostics).unwrap_or(Colour::default());
    let form = match section.present(&["shape", "file", "cells"])[..] {
        ["shape"] => read_shape(&mut section, diagnostics).map(Arc::new),
        ["file"] => {
            let At { value: path, place } = section.get::<String>("file", diagnostics)?;
            if !forms.read.contains_key(&path) {
                let form = read_drawing(&path, &place, forms.drawings, diagnostics).map(Arc::new);
                forms.read.insert(path.clone(), form);
            }
            forms.read.get(&path).cloned().flatten()
        }
        ["cells"] => {
            let pins = section.node("pins").map_or(Some(Vec::new()), |node| read_pins(node, diagnostics));
            read_cells(section.node("cells"), &pins?, diagnostics).map(Arc::new)
        }
        [] => {
            section.missing("shape", "shape = \"chair\"", diagnostics);
            None
        }
        _ => {
            let reason = "a piece has one of `shape`, `file` and `cells`";
            diagnostics.add(node.span(), wrong_text(reason, "leave the others out"));
            for key in section.present(&["shape", "file", "cells"]) {
                section.node(key);
            }
            None
        }
    };
    section.finish(diagnostics);
    let (At { value: name, place }, at, form, turn) = (name?, at?.value, form?, turn?);
    if name.is_empty() || name.chars().count() > 64 || name.chars().any(char::is_control) {
        diagnostics.add(place, wrong_text("a name has 1 to 64 characters", "write a short name"));
        return None;
    }
    // Invariant: a limited turn is 0 to 3.
    let turn = turn as u8;
    Some(At { value: Piece { name, form, place: Placement { at: (at.0, at.1), turn }, colour }, place })
}

fn read_shape(section: &mut Section<'_, '_>, diagnostics: &mut Diagnostics) -> Option<Form> {
    section.choice("shape", "shape", &SHAPES, diagnostics).map(Form::library)
}

fn read_pins(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Vec<Pin>> {
    let example = "pins = [[[0, 0, 0], [0, 0, 1]]]";
    let pins = elements(node, example, diagnostics)?.iter().map(|pin| {
        let cells = elements(pin, example, diagnostics)?;
        let cells: Option<Vec<Cell>> = cells.iter().map(|cell| Cell::read(cell, diagnostics)).collect();
        let pin = Pin::try_from(cells?).ok();
        if pin.is_none() {
            diagnostics.add(node.span(), wrong_text("a pin has two cells", example));
        }
        pin
    });
    pins.collect()
}

fn read_cells(node: Option<&Node<'_>>, pins: &[Pin], diagnostics: &mut Diagnostics) -> Option<Form> {
    let node = node?;
    let all = elements(node, "cells = [[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 0, 3]]", diagnostics)?;
    let cells: Option<Vec<Cell>> = all.iter().map(|cell| Cell::read(cell, diagnostics)).collect();
    form(&cells?, pins, &node.span().into(), diagnostics)
}

fn read_drawing(
    path: &str,
    place: &Place,
    drawings: Drawings<'_>,
    diagnostics: &mut Diagnostics,
) -> Option<Form> {
    // Counts the files, of which a room can name so many.
    let counted = diagnostics.file(path);
    diagnostics.note(place, counted)?;
    let text = drawings(path);
    let text = text.and_then(|bytes| String::from_utf8(bytes).map_err(|_| "it is not UTF-8 text".to_owned()));
    let drawing = text.and_then(|text| drawing::read(path, &text).map_err(|e| e.to_string()));
    match drawing {
        Ok(Drawing { cells, pins }) => {
            form(&cells.into_iter().collect::<Vec<_>>(), &pins, place, diagnostics)
        }
        Err(why) => {
            let reason = format!("cannot read the drawing: {why}");
            diagnostics.add(
                place.clone(),
                wrong_text(&reason, "name a drawing; `metamorph shape --write` makes one"),
            );
            None
        }
    }
}

fn form(cells: &[Cell], pins: &[Pin], place: &Place, diagnostics: &mut Diagnostics) -> Option<Form> {
    let fix = |error: &FormError| match error {
        FormError::TooMany(_) => "divide it into several pieces",
        FormError::Pairing(_) => "draw one structure whose cells share faces",
        FormError::Split(_) => "`metamorph shape FILE --modules --split` says what becomes metamodules",
    };
    let form = Form::of_cells(cells, pins);
    diagnostics.note(place, form.map_err(|error| wrong_text(&error.to_string(), fix(&error))))
}

fn read_constraint(node: &Node<'_>, room: &Room, diagnostics: &mut Diagnostics) -> Option<Constraint> {
    let mut section = Section::of(node, "[[constraint]]", CONSTRAINT, diagnostics)?;
    let kinds = ["gap", "near", "wall", "facing", "align", "circle", "clear", "walkway", "reach"]
        .map(|kind| (kind, kind));
    if section.present(&["kind"]).is_empty() {
        section.missing("kind", "kind = \"gap\"", diagnostics);
    }
    let kind = section.choice("kind", "kind", &kinds, diagnostics);
    let wish = section.get("wish", diagnostics).is_some_and(|w| w.value);
    let rule = match kind {
        Some("gap") => two(&mut section, room, diagnostics)
            .zip(cells(&mut section, diagnostics))
            .map(|([a, b], k)| Rule::Gap(a, b, k)),
        Some("near") => two(&mut section, room, diagnostics)
            .zip(cells(&mut section, diagnostics))
            .map(|([a, b], k)| Rule::Near(a, b, k)),
        Some("facing") => two(&mut section, room, diagnostics).map(|[a, b]| Rule::Facing(a, b)),
        Some("wall") => one(&mut section, "piece", room, diagnostics).map(Rule::Wall),
        Some("align") => {
            let axes = [("x", Axis::X), ("y", Axis::Y)];
            let axis = section.choice("axis", "axis", &axes, diagnostics);
            if section.present(&["axis"]).is_empty() {
                section.missing("axis", "axis = \"x\"", diagnostics);
            }
            pieces(&mut section, room, 2, diagnostics).zip(axis).map(|(p, axis)| Rule::Align(p, axis))
        }
        Some("circle") => circle(&mut section, room, diagnostics),
        Some("clear") => section
            .need("area", "area = { min = [0, 0], max = [9, 4] }", diagnostics)
            .map(|a| Rule::Clear(a.value)),
        Some("walkway") => cells(&mut section, diagnostics).map(|k| Rule::Walkway(k.max(1))),
        Some("reach") => Some(Rule::Reach),
        _ => return None,
    };
    section.finish(diagnostics);
    rule.map(|rule| Constraint { rule, wish })
}

fn circle(section: &mut Section<'_, '_>, room: &Room, diagnostics: &mut Diagnostics) -> Option<Rule> {
    let pieces = pieces(section, room, 3, diagnostics);
    let around = one(section, "around", room, diagnostics);
    let mut length = |key, example| {
        let at = section.need::<f64>(key, example, diagnostics)?;
        if (0.0..=f64::from(MAX_SIDE)).contains(&at.value) {
            return Some(at.value);
        }
        let (low, high) = ("0".to_owned(), MAX_SIDE.to_string());
        diagnostics.add(at.place, ScenarioError::Range { what: key, got: at.value.to_string(), low, high });
        None
    };
    let (radius, tolerance) = (length("radius", "radius = 12"), length("tolerance", "tolerance = 0.5"));
    Some(Rule::Circle { pieces: pieces?, around: around?, radius: radius?, tolerance: tolerance? })
}

/// Reads the key `cells`, a number of connectors.
fn cells(section: &mut Section<'_, '_>, diagnostics: &mut Diagnostics) -> Option<u16> {
    let number = section.need::<u64>("cells", "cells = 2", diagnostics)?;
    limited(number, "the number of connectors", 0, MAX_SIDE, diagnostics).map(i16::unsigned_abs)
}

/// Finds a piece by its name.
fn named(name: &At<String>, room: &Room, diagnostics: &mut Diagnostics) -> Option<usize> {
    let found = room.find(&name.value);
    if found.is_none() {
        let known: Vec<&str> = room.pieces.iter().take(8).map(|p| p.name.as_str()).collect();
        let fix = match room.pieces.len() {
            0 => "add a [[piece]]".to_owned(),
            _ => {
                format!("name one of {}{}", known.join(", "), if room.pieces.len() > 8 { ", …" } else { "" })
            }
        };
        diagnostics.add(name.place.clone(), wrong_text(&format!("there is no piece `{}`", name.value), &fix));
    }
    found
}

fn one(
    section: &mut Section<'_, '_>,
    key: &'static str,
    room: &Room,
    diagnostics: &mut Diagnostics,
) -> Option<usize> {
    let example = if key == "piece" { "piece = \"chair 1\"" } else { "around = \"table\"" };
    let name = section.need::<String>(key, example, diagnostics)?;
    named(&name, room, diagnostics)
}

/// Reads the key `pieces`: at least `least` different ones.
fn pieces(
    section: &mut Section<'_, '_>,
    room: &Room,
    least: usize,
    diagnostics: &mut Diagnostics,
) -> Option<Vec<usize>> {
    let Some(node) = section.node("pieces") else {
        section.missing("pieces", "pieces = [\"chair 1\", \"chair 2\"]", diagnostics);
        return None;
    };
    let mut all = Vec::new();
    for node in elements(node, PIECES, diagnostics)?.iter() {
        let name = At::new(String::read(node, diagnostics)?, node.span());
        let piece = named(&name, room, diagnostics)?;
        if all.contains(&piece) {
            diagnostics.add(name.place, wrong_text("this piece is named twice", "name each once"));
            return None;
        }
        all.push(piece);
    }
    if all.len() < least {
        diagnostics.add(node.span(), wrong("more pieces", node.get_ref(), PIECES));
        return None;
    }
    Some(all)
}

fn two(section: &mut Section<'_, '_>, room: &Room, diagnostics: &mut Diagnostics) -> Option<[usize; 2]> {
    let all = pieces(section, room, 2, diagnostics)?;
    let two = <[usize; 2]>::try_from(all).ok();
    if two.is_none() {
        let place = section.place().clone();
        diagnostics.add(place, wrong_text("this constraint is about two pieces", "name two pieces"));
    }
    two
}
