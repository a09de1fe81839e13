//! Configurations of VisibleSim (XML): the modules of `blockList`, and the cells of `targetList` or the older
//! `targetGrid`.
//!
//! Positions are cells of a simple cubic lattice, as of its sliding cubes, Smart Blocks and Blinky Blocks.
//! The file does not name the robot: positions in the face-centred lattice of 3D Catoms are read too, but as
//! a sheared shape, and a solid (`csg`) fills the cells that VisibleSim fills in its cubic lattice. The root is `<world>`, or
//! `<vs>` with `<world>` in it; other elements may stand beside them, as VisibleSim's parser allows.
//! Ignored: cameras, lights, colours, orientations, parameters. Obstacles are a note, and an error where the shape has a
//! cell; all else in `<world>` is a note. Refused: surfaces and meshes.

use super::comma_hint;
use super::csg::{self, Solid, Why, Wrong};
use super::error::{
    MAX_ATTRIBUTES, MAX_ATTRIBUTES_OF_ONE, MAX_GRID, MAX_NAMESPACES, MAX_NODES, MAX_VOXELS, MAX_WORK,
    SolidError,
};
use metamorph_core::lattice::Cell;
use metamorph_text::format::many;
use roxmltree::{Document, Error, Node, ParsingOptions};
use std::borrow::Cow;
use std::collections::BTreeSet;

/// The element put around a file that has several roots.
const AROUND: &str = "files";
/// Elements of `<world>` that say nothing about the shape, or are read.
const KNOWN: [&str; 9] = [
    "blockList",
    "targetList",
    "targetGrid",
    "obstacleList",
    "camera",
    "spotlight",
    "lightSource",
    "customization",
    "parameters",
];
/// Number of elements left out that a note names at most.
const MAX_NAMED: usize = 5;

/// A part of a configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Part {
    /// The modules at the start.
    Blocks,
    /// The cells to be filled.
    #[default]
    Targets,
}

/// Reads the cells of one part, with notes about the rest.
pub fn cells(file: &str, bytes: &[u8], part: Part) -> Result<(BTreeSet<Cell>, Vec<String>), SolidError> {
    let text = without_declaration(decode(bytes));
    check_size(file, &text)?;
    let options = || ParsingOptions { nodes_limit: MAX_NODES, ..ParsingOptions::default() };
    let around;
    let document = match Document::parse_with_options(&text, options()) {
        Ok(document) => document,
        Err(Error::DtdDetected) => {
            return Err(SolidError::Doctype { file: file.to_owned(), line: doctype_line(&text) });
        }
        Err(first) => {
            // VisibleSim's parser accepts several roots.
            around = format!("<{AROUND}>{text}</{AROUND}>");
            Document::parse_with_options(&around, options()).map_err(|second| {
                // The one that comes further is the fault; the other one may be about the roots.
                let last = second.pos().row as usize <= text.lines().count();
                let error = if last && second.pos().row > first.pos().row { second } else { first };
                not_xml(file, &error)
            })?
        }
    };
    let root = document.root_element();
    let inside = |name| children(root).find(move |node| root.has_tag_name(AROUND) && node.has_tag_name(name));
    let world = match inside("vs").unwrap_or(root) {
        vs if vs.has_tag_name("vs") => children(vs).find(|node| node.has_tag_name("world")),
        world => inside("world").or(Some(world).filter(|node| node.has_tag_name("world"))),
    };
    let grid = world.and_then(|world| coordinates(world.attribute("gridSize")?));
    let mut reader = Reader::new(file, &document, grid);
    let Some(world) = world else {
        let found = if root.has_tag_name(AROUND) { children(root).next() } else { Some(root) };
        let name = found.map_or("nothing".to_owned(), |found| format!("<{}>", cut(found.tag_name().name())));
        return Err(reader.syntax(found.unwrap_or(root), format!("expected <world>, found {name}")));
    };
    let lists = match part {
        Part::Blocks => ["blockList"].as_slice(),
        Part::Targets => &["targetList", "targetGrid"],
    };
    let mut empty = None;
    for list in children(world).filter(|node| lists.contains(&node.tag_name().name())) {
        match list.tag_name().name() {
            "targetList" => reader.targets(list)?,
            _ => reader.list(list)?,
        }
        empty.get_or_insert(list);
    }
    if reader.cells.is_empty() {
        return Err(reader.no_cells(part, empty));
    }
    reader.obstacles()?;
    reader.note_all(world);
    Ok((reader.cells, reader.notes))
}

fn not_xml(file: &str, error: &Error) -> SolidError {
    let (line, why) = (error.pos().row as usize, format!("this is not XML: {error}"));
    SolidError::Syntax { file: file.to_owned(), line, why }
}

/// Returns a number with its noun and the verb for one or for many.
pub fn counted(n: usize, noun: &str, [one, more]: [&str; 2]) -> String {
    format!("{} {}", many(n as u64, noun), if n == 1 { one } else { more })
}

/// Returns the text of bytes in UTF-8, or in Latin-1 if they are declared as that or are no UTF-8.
fn decode(bytes: &[u8]) -> Cow<'_, str> {
    /// Bytes at the beginning that are searched for a declaration.
    const DECLARED_BYTES: usize = 1 << 10;
    let unmarked = bytes.strip_prefix(b"\xef\xbb\xbf");
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(DECLARED_BYTES)]).to_ascii_lowercase();
    let declared =
        head.split_once("<?xml").and_then(|(_, rest)| rest.split_once("?>")).and_then(|(inner, _)| {
            let value = inner.split_once("encoding")?.1.trim_start().strip_prefix('=')?.trim_start();
            value.get(1..)?.split(['"', '\'']).next().map(str::to_owned)
        });
    let latin = ["iso-8859-1", "iso8859-1", "iso_8859-1", "latin1", "latin-1", "windows-1252"];
    let latin = unmarked.is_none() && declared.is_some_and(|name| latin.contains(&name.as_str()));
    match std::str::from_utf8(unmarked.unwrap_or(bytes)) {
        Ok(text) if !latin => Cow::Borrowed(text),
        _ => Cow::Owned(bytes.iter().map(|byte| char::from(*byte)).collect()),
    }
}

/// Replaces the XML declaration by blanks: it may stand behind blanks and comments, where XML has none.
fn without_declaration(text: Cow<'_, str>) -> Cow<'_, str> {
    let mut rest = text.trim_start();
    while let Some((_, behind)) = rest.strip_prefix("<!--").and_then(|inner| inner.split_once("-->")) {
        rest = behind.trim_start();
    }
    let inner = rest.strip_prefix("<?xml").filter(|inner| inner.starts_with(char::is_whitespace));
    let Some((inner, behind)) = inner.and_then(|inner| inner.split_once("?>")) else { return text };
    let before = &text[..text.len() - rest.len()];
    let blanks: String = inner.chars().map(|c| if c == '\n' { c } else { ' ' }).collect();
    Cow::Owned([before, &blanks, behind].concat())
}

/// Counts attributes before parsing, because the parser compares each pair of attributes of an element.
/// Invalid XML is left to the parser.
fn check_size(file: &str, text: &str) -> Result<(), SolidError> {
    let (mut rest, mut all, mut namespaces) = (text, 0, 0);
    let too_many = |rest: &str, what, most| {
        let line = text[..text.len() - rest.len()].matches('\n').count() + 1;
        Err(SolidError::TooManyParts { file: file.to_owned(), line, what, most })
    };
    while let Some(at) = rest.find('<') {
        rest = &rest[at..];
        let without = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")];
        if let Some((_, end)) = without.iter().find(|(begin, _)| rest.starts_with(begin)) {
            let Some(at) = rest.find(end) else { return Ok(()) };
            rest = &rest[at + end.len()..];
            continue;
        }
        let mut of_one = 0;
        // Each attribute has one quoted value.
        loop {
            let Some(at) = rest.find(['"', '\'', '>']) else { return Ok(()) };
            let quote = &rest[at..=at];
            namespaces += usize::from(rest[..at].contains("xmlns"));
            rest = &rest[at + 1..];
            if quote == ">" {
                break;
            }
            (of_one, all) = (of_one + 1, all + 1);
            if of_one > MAX_ATTRIBUTES_OF_ONE {
                return too_many(rest, "attributes in one element", MAX_ATTRIBUTES_OF_ONE);
            }
            if all > MAX_ATTRIBUTES {
                return too_many(rest, "attributes", MAX_ATTRIBUTES);
            }
            if namespaces > MAX_NAMESPACES {
                return too_many(rest, "namespaces", MAX_NAMESPACES);
            }
            let Some(end) = rest.find(quote) else { return Ok(()) };
            rest = &rest[end + 1..];
        }
    }
    Ok(())
}

/// Returns the line of the document type, which the parser does not report.
fn doctype_line(text: &str) -> u32 {
    let before = text.find("<!DOCTYPE").map_or("", |at| &text[..at]);
    before.matches('\n').count() as u32 + 1
}

fn children<'a, 'i>(node: Node<'a, 'i>) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(Node::is_element)
}

struct Reader<'a> {
    file: &'a str,
    document: &'a Document<'a>,
    /// Cells of VisibleSim's grid along each axis.
    grid: Option<[i64; 3]>,
    cells: BTreeSet<Cell>,
    /// Cells named so far.
    named: usize,
    /// Those of them that were there before.
    again: usize,
    /// The number of boxes that VisibleSim's grid cuts, and the line of the first.
    cut: Option<(usize, u32)>,
    /// The lines of the first positions that have two numbers, and three.
    numbers: [Option<u32>; 2],
    notes: Vec<String>,
}

impl<'a> Reader<'a> {
    fn new(file: &'a str, document: &'a Document<'a>, grid: Option<[i64; 3]>) -> Reader<'a> {
        let (cells, notes) = (BTreeSet::new(), Vec::new());
        Reader { file, document, grid, cells, named: 0, again: 0, cut: None, numbers: [None; 2], notes }
    }

    /// Returns the error for a part without a cell; it names its list if there is one.
    fn no_cells(&self, part: Part, list: Option<Node<'_, '_>>) -> SolidError {
        let (what, cells) = match part {
            Part::Blocks => ("modules (<blockList>)", "modules"),
            Part::Targets => ("target (<targetList>)", "cells"),
        };
        let Some(list) = list else { return SolidError::NoPart { file: self.file.to_owned(), what } };
        let outside =
            self.cut.map(|(_, line)| format!("; the <blockBox> in line {line} has none in the grid"));
        let (file, line) = (self.file.to_owned(), self.line(list));
        let list = list.tag_name().name();
        SolidError::EmptyPart {
            file,
            line,
            what: format!("<{list}> has no {cells}{}", outside.unwrap_or_default()),
        }
    }

    /// Notes all that was left out or read otherwise than written.
    fn note_all(&mut self, world: Node<'_, '_>) {
        if self.again > 0 {
            self.notes.push(format!("{} named twice", counted(self.again, "cell", ["is", "are"])));
        }
        if let Some((boxes, line)) = self.cut {
            let ends = counted(boxes, "<blockBox>", ["ends", "end"]);
            self.notes.push(format!(
                "{ends} before the last cells of the grid (`gridSize`), as in VisibleSim; the first is in line {line}"
            ));
        }
        if let Some(line) = self.numbers[0] {
            self.notes
                .push(format!("positions of two numbers are x and y; z is 0 (the first is in line {line})"));
        }
        let others = children(world).filter(|node| !KNOWN.contains(&node.tag_name().name()));
        let mut names: Vec<String> = Vec::new();
        for name in others.map(|node| format!("<{}> (line {})", cut(node.tag_name().name()), self.line(node)))
        {
            if names.len() == MAX_NAMED {
                names.push("others".to_owned());
                break;
            }
            names.push(name);
        }
        if !names.is_empty() {
            self.notes.push(format!("left out of <world>: {}", names.join(", ")));
        }
    }

    fn line(&self, node: Node<'_, '_>) -> u32 {
        self.document.text_pos_at(node.range().start).row
    }

    fn syntax(&self, node: Node<'_, '_>, why: String) -> SolidError {
        SolidError::Syntax { file: self.file.to_owned(), line: self.line(node) as usize, why }
    }

    fn not_read(&self, node: Node<'_, '_>, what: String) -> SolidError {
        SolidError::NotRead { file: self.file.to_owned(), line: self.line(node), what }
    }

    /// Reads the first target; VisibleSim has a sequence of targets, a goal is one shape.
    fn targets(&mut self, list: Node<'_, '_>) -> Result<(), SolidError> {
        let mut targets = children(list);
        let Some(target) = targets.next() else { return Ok(()) };
        if let Some(second) = targets.next() {
            return Err(self.not_read(second, "a second <target>".to_owned()));
        }
        let method = || children(target).find_map(|node| node.attribute("meth").map(cut));
        match target.attribute("format") {
            Some("grid") | None => self.list(target),
            Some("csg") if children(target).any(|node| node.has_tag_name("csg")) => self.list(target),
            Some("csg") => Err(self.syntax(target, "a target of the format `csg` has no <csg>".to_owned())),
            Some("relativeGrid") => {
                self.notes.push(
                    "its positions are relative to a cell that the program chooses; `at` places them"
                        .to_owned(),
                );
                self.list(target)
            }
            Some(other) => {
                let method = method().map_or(String::new(), |method| format!(" (method `{method}`)"));
                Err(self.not_read(target, format!("a target of the format `{}`{method}", cut(other))))
            }
        }
    }

    fn list(&mut self, list: Node<'_, '_>) -> Result<(), SolidError> {
        let mut solids = 0;
        for node in children(list) {
            match self.known_name(node) {
                "block" | "cell" => {
                    let cell = self.position(node)?;
                    self.add(cell)?;
                }
                "blocksLine" | "targetLine" => self.line_of_cells(node)?,
                "blockBox" => self.box_of_cells(node)?,
                "csg" if solids > 0 => return Err(self.not_read(node, "a second <csg>".to_owned())),
                "csg" => {
                    solids += 1;
                    self.solid(node, list.has_tag_name("blockList"))?;
                }
                other => return Err(self.not_read(node, format!("<{}>", cut(other)))),
            }
        }
        Ok(())
    }

    /// Returns the name of an element, or that which differs from it in capitals only, with a note.
    fn known_name<'n>(&mut self, node: Node<'n, '_>) -> &'n str {
        let name = node.tag_name().name();
        let known = ["block", "cell", "blocksLine", "targetLine", "blockBox", "csg"];
        let alike = known.into_iter().find(|known| name.eq_ignore_ascii_case(known) && name != *known);
        if let Some(alike) = alike {
            let line = self.line(node);
            self.notes.push(format!(
                "<{name}> in line {line} is read as <{alike}>; VisibleSim leaves it out for its capitals"
            ));
        }
        alike.unwrap_or(name)
    }

    /// Fills the cells of the grid that are in a solid, as VisibleSim does in a cubic lattice.
    fn solid(&mut self, node: Node<'_, '_>, of_blocks: bool) -> Result<(), SolidError> {
        let line = self.line(node);
        let Some(grid) = self.grid else {
            return Err(self.syntax(
                node,
                "<csg> fills a grid, but <world> has no `gridSize` of three numbers".to_owned(),
            ));
        };
        let (solid, parts) = self.csg(node)?;
        let origin = self.origin(node, &solid, of_blocks)?;
        // The cells around the grid are examined to tell whether it cuts the solid.
        let corners = solid.corners().unwrap_or_default();
        let low = [0, 1, 2].map(|axis| ((corners[0][axis] - origin[axis]).floor() as i64).max(-1));
        let high = [0, 1, 2].map(|axis| ((corners[1][axis] - origin[axis]).ceil() as i64).min(grid[axis]));
        let cells = [0, 1, 2].map(|axis| (high[axis] + 1).saturating_sub(low[axis]).max(0).unsigned_abs());
        let cells = cells.into_iter().fold(1, u64::saturating_mul);
        if cells > MAX_GRID || cells.saturating_mul(parts) > MAX_WORK {
            return Err(self.not_read(node, "a <csg> with so many solids in so large a grid".to_owned()));
        }
        let (mut filled, mut outside) = (0usize, false);
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    let at = [x, y, z];
                    if !solid.contains([0, 1, 2].map(|axis| at[axis] as f64 + origin[axis])) {
                        continue;
                    }
                    if at.iter().zip(grid).any(|(c, cells)| *c < 0 || *c >= cells) {
                        outside = true;
                    } else {
                        filled += 1;
                        self.insert(at)?;
                    }
                }
            }
        }
        if filled == 0 {
            return Err(self.syntax(node, "<csg> fills no cell of the grid (`gridSize`)".to_owned()));
        }
        self.notes.push(format!(
            "its <csg> fills {} of a cubic lattice; VisibleSim fills those of its robot's lattice",
            many(filled as u64, "cell")
        ));
        if outside {
            self.notes.push(format!(
                "the grid (`gridSize`) ends inside the <csg> in line {line}; cells outside are left out, as in VisibleSim"
            ));
        }
        Ok(())
    }

    /// Parses the solid of a `<csg>`; returns it with the number of its parts.
    fn csg(&self, node: Node<'_, '_>) -> Result<(Solid, u64), SolidError> {
        self.attribute(node, "content")?;
        let place = node.attribute_node("content").map_or(0..0, |content| content.range_value());
        // The text as it is in the file, in which lines can be counted.
        let text = self.document.input_text().get(place.clone()).unwrap_or_default();
        csg::parse(text).map_err(|Wrong { at, why }| {
            let (file, line) = (self.file.to_owned(), self.document.text_pos_at(place.start + at).row);
            match why {
                Why::Syntax(why) => SolidError::Syntax { file, line: line as usize, why },
                Why::NotRead(what) => SolidError::NotRead { file, line, what },
                Why::TooMany(what, most) => {
                    SolidError::TooManyParts { file, line: line as usize, what, most }
                }
            }
        })
    }

    /// Returns the point of a solid that is in the first cell of the grid.
    fn origin(&mut self, node: Node<'_, '_>, solid: &Solid, of_blocks: bool) -> Result<[f64; 3], SolidError> {
        let heeded = ["content", "boundingBox", "offset", "orientation", "color"];
        let others = node
            .attributes()
            .filter(|a| !heeded.contains(&a.name()) && (of_blocks || a.name() != "translate"));
        for other in others {
            self.notes.push(format!("`{}` of its <csg> is left out, as in VisibleSim", cut(other.name())));
        }
        let mut origin = [0.0; 3];
        if self.flag(node, "boundingBox", true)? {
            origin = solid.corners().map_or(origin, |[low, _]| low);
        }
        if self.flag(node, "offset", of_blocks)? {
            origin = origin.map(|c| c - 1.0);
        }
        match node.attribute("translate").filter(|_| !of_blocks) {
            None => Ok(origin),
            Some(text) => {
                let wrong = || self.wrong_number(node, "three numbers", "translate", text);
                let by: [f64; 3] = numbers(text).ok_or_else(wrong)?;
                Ok([0, 1, 2].map(|axis| origin[axis] - by[axis]))
            }
        }
    }

    fn flag(&self, node: Node<'_, '_>, name: &str, default: bool) -> Result<bool, SolidError> {
        match node.attribute(name).map(str::trim) {
            None => Ok(default),
            Some("true" | "yes" | "1") => Ok(true),
            Some("false" | "no" | "0") => Ok(false),
            Some(other) => Err(self.wrong_number(node, "`true` or `false`", name, other)),
        }
    }

    /// Reads one character for each cell along x; `1` is a module.
    fn line_of_cells(&mut self, node: Node<'_, '_>) -> Result<(), SolidError> {
        let number = |name| match node.attribute(name) {
            None => Ok(0),
            Some(text) => {
                text.trim().parse::<i64>().map_err(|_| self.wrong_number(node, "a whole number", name, text))
            }
        };
        let (y, z) = (number("line")?, number("plane")?);
        let values = self.attribute(node, "values")?;
        for x in values.chars().enumerate().filter(|(_, value)| *value == '1').map(|(x, _)| x as i64) {
            self.add([x, y, z])?;
        }
        Ok(())
    }

    /// Reads a box as VisibleSim does: it begins within the grid and ends before the last cells of the grid.
    fn box_of_cells(&mut self, node: Node<'_, '_>) -> Result<(), SolidError> {
        let origin = self.place(node, "boxOrigin")?.unwrap_or_default().map(|c| c.max(0));
        let size = self.place(node, "boxSize")?;
        let wished = size.map(|size| [0, 1, 2].map(|axis| origin[axis] + size[axis]));
        let last = self.grid.map(|grid| grid.map(|cells| cells - 1));
        let end = match (wished, last) {
            (Some(wished), Some(last)) => [0, 1, 2].map(|axis| wished[axis].min(last[axis])),
            (Some(end), None) | (None, Some(end)) => end,
            (None, None) => return Err(self.syntax(node, "<blockBox> has no `boxSize`".to_owned())),
        };
        if wished.is_some_and(|wished| wished != end) {
            let line = self.line(node);
            self.cut.get_or_insert((0, line)).0 += 1;
        }
        let sides = [0, 1, 2].map(|axis| (end[axis] - origin[axis]).max(0).unsigned_abs());
        if sides.contains(&0) {
            return Ok(());
        }
        if sides.into_iter().fold(1, u64::saturating_mul) > MAX_VOXELS as u64 {
            return Err(self.too_much());
        }
        for z in 0..sides[2] as i64 {
            for y in 0..sides[1] as i64 {
                for x in 0..sides[0] as i64 {
                    self.add([origin[0] + x, origin[1] + y, origin[2] + z])?;
                }
            }
        }
        Ok(())
    }

    /// Notes obstacles beside the shape, wherever their list is, and refuses those in it.
    fn obstacles(&mut self) -> Result<(), SolidError> {
        let lists = self.document.descendants().filter(|node| node.has_tag_name("obstacleList"));
        let (mut obstacles, mut example) = (0, None);
        for node in lists.flat_map(children) {
            let cell = in_range(self.file, self.position(node)?)?;
            if self.cells.contains(&cell) {
                return Err(SolidError::Obstacle { file: self.file.to_owned(), line: self.line(node), cell });
            }
            obstacles += 1;
            example.get_or_insert(cell);
        }
        if let Some(example) = example {
            self.notes.push(format!(
                "its <obstacleList> is left out: {}, such as {example}; modules may move through such cells, unless a scenario of metamodules has them as faults (`obstacle`)",
                many(obstacles, "obstacle")
            ));
        }
        Ok(())
    }

    /// Reads a position, of three numbers or, in files for flat robots, all of two.
    fn position(&mut self, node: Node<'_, '_>) -> Result<[i64; 3], SolidError> {
        let text = self.attribute(node, "position")?;
        let flat = text.matches(',').count() == 1;
        let position = coordinates(text).or_else(|| whole(text).map(|[x, y]| [x, y, 0]));
        let position =
            position.ok_or_else(|| self.wrong_number(node, "three whole numbers", "position", text))?;
        if self.numbers[usize::from(!flat)].is_none() {
            self.numbers[usize::from(!flat)] = Some(self.line(node));
        }
        match self.numbers {
            [Some(_), Some(_)] => Err(self.syntax(
                node,
                format!(
                    "the position \"{}\" and others before it do not have equally many numbers",
                    cut(text)
                ),
            )),
            _ => Ok(position),
        }
    }

    /// Returns the three whole numbers of an attribute, if the element has it.
    fn place(&self, node: Node<'_, '_>, name: &str) -> Result<Option<[i64; 3]>, SolidError> {
        let Some(text) = node.attribute(name) else { return Ok(None) };
        coordinates(text).map(Some).ok_or_else(|| self.wrong_number(node, "three whole numbers", name, text))
    }

    /// Returns the error for an attribute with something else than expected.
    fn wrong_number(&self, node: Node<'_, '_>, expected: &str, name: &str, text: &str) -> SolidError {
        let hint = comma_hint(text.as_bytes(), if expected.starts_with("three") { 3 } else { 1 });
        self.syntax(node, format!("expected {expected}, found {name}=\"{}\"{hint}", cut(text)))
    }

    fn attribute<'n>(&self, node: Node<'n, '_>, name: &str) -> Result<&'n str, SolidError> {
        let missing = || self.syntax(node, format!("<{}> has no `{name}`", node.tag_name().name()));
        node.attribute(name).ok_or_else(missing)
    }

    fn too_much(&self) -> SolidError {
        SolidError::TooMuch { file: self.file.to_owned(), what: "cells", most: MAX_VOXELS }
    }

    fn add(&mut self, at: [i64; 3]) -> Result<(), SolidError> {
        let cell = in_range(self.file, at)?;
        self.named += 1;
        if self.named > MAX_VOXELS {
            return Err(self.too_much());
        }
        self.again += usize::from(!self.cells.insert(cell));
        Ok(())
    }

    /// Adds a cell that may be there.
    fn insert(&mut self, at: [i64; 3]) -> Result<(), SolidError> {
        let again = self.again;
        self.add(at)?;
        self.again = again;
        Ok(())
    }
}

fn cut(text: &str) -> String {
    text.chars().take(40).collect()
}

/// Parses `1,2,3` or `(1,2,3)`. Whole numbers may also be written as `1.0`.
fn coordinates(text: &str) -> Option<[i64; 3]> {
    whole(text)
}

/// Parses whole numbers between commas, perhaps in parentheses.
fn whole<const N: usize>(text: &str) -> Option<[i64; N]> {
    let numbers: [f64; N] = numbers(text)?;
    let wholes = numbers.iter().all(|number| number.fract() == 0.0 && number.abs() < 1e9);
    wholes.then(|| numbers.map(|number| number as i64))
}

/// Parses numbers between commas, perhaps in parentheses.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let text = text.trim();
    let inner = text.strip_prefix('(').and_then(|rest| rest.strip_suffix(')')).unwrap_or(text);
    let mut parts = inner.split(',').map(|part| part.trim().parse::<f64>().ok().filter(|n| n.is_finite()));
    let mut numbers = [0.0; N];
    for number in &mut numbers {
        *number = parts.next()??;
    }
    parts.next().is_none().then_some(numbers)
}

/// Returns the cell at these coordinates.
pub fn in_range(file: &str, at: [i64; 3]) -> Result<Cell, SolidError> {
    let limit = i64::from(Cell::LIMIT);
    if at.iter().any(|c| c.abs() > limit) {
        return Err(SolidError::OutOfRange { file: file.to_owned(), cell: at });
    }
    Ok(Cell::from(at.map(|c| c as i16)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TARGET: &str =
        "<targetList><target><cell position='1,1,0'/><cell position='2,1,0'/></target></targetList>";

    /// Returns the cells of both parts and the notes about the blocks.
    fn read(bytes: &[u8]) -> Result<(usize, usize, String), String> {
        let part = |part| cells("a.xml", bytes, part).map_err(|error| error.to_string());
        let (blocks, notes) = part(Part::Blocks)?;
        Ok((blocks.len(), part(Part::Targets)?.0.len(), notes.join("; ")))
    }

    #[test]
    fn files_are_read_as_visiblesim_reads_them() {
        let world = |grid: &str, blocks: &str| {
            format!("<world gridSize='{grid}'><blockList>{blocks}</blockList>{TARGET}</world>")
        };
        let block = world("6,6,3", "<block position='0,0,0'/>");
        let boxes = |origin: &str, size: &str| {
            let text = format!("<blockBox boxOrigin='{origin}' boxSize='{size}'/><block position='0,0,0'/>");
            world("6,6,3", &text)
        };
        let solid = |grid: &str, solid: &str| world(grid, &format!("<csg {solid}/>"));
        let cases: [(String, usize, &str); 28] = [
            (block.clone(), 1, ""),
            (format!("<?xml version='1.0'?><vs><visuals/>{block}</vs>"), 1, ""),
            (format!("<?xml version='1.0'?>\n<parameters/>\n{block}"), 1, ""),
            (format!("<visuals/><vs>{block}</vs>"), 1, ""),
            (format!("<!-- a -->\n <!-- b -->\n<?xml version='1.0' standalone='no' ?>\n{block}"), 1, ""),
            (format!("\u{feff} \n<?xml version='1.0' encoding='UTF-8'?>{block}"), 1, ""),
            (
                world("6,6,3", "<block position='0,0,0'/><block position='0,0,0'/>"),
                1,
                "1 cell is named twice",
            ),
            (world("6,6", "<block position=' (0, 0 ,0) '/>"), 1, ""),
            (boxes("1,0,0", "3,2,1"), 7, ""),
            (boxes("-1,0,0", "3,2,1"), 6, "1 cell is named twice"),
            (boxes("0,0,1", "9,9,9"), 26, "1 <blockBox> ends before the last cells"),
            (boxes("0,0,0", "0,5,2"), 1, ""),
            (boxes("1,0,0", "-4,-9,2"), 1, ""),
            (boxes("0,0,0", "0,900000000,900000000").replace("gridSize", "size"), 1, ""),
            (world("4,4,4", "<blockBox/>"), 27, ""),
            (
                block
                    .replace("</world>", "<obstacleList><obstacle position='5,5,0'/></obstacleList></world>"),
                1,
                "1 obstacle, such as [5, 5, 0]",
            ),
            (
                format!("<vs>{block}<obstacleList><obstacle position='5,5,0'/></obstacleList></vs>"),
                1,
                "1 obstacle, such as [5, 5, 0]",
            ),
            (block.replace("</world>", "<walls/></world>"), 1, "left out of <world>: <walls> (line 1)"),
            (world("6,6,3", "<block position='3,4'/>"), 1, "positions of two numbers are x and y"),
            (
                world("6,6,3", "<blocksline values='0110'/>"),
                2,
                "<blocksline> in line 1 is read as <blocksLine>",
            ),
            (solid("6,6,6", "content='cube(2);'"), 27, "fills 27 cells of a cubic lattice"),
            (solid("6,6,6", "content='cube(2, true);'"), 27, "fills 27 cells"),
            (
                solid("6,6,6", "content='cube(2, true);' boundingBox='false' offset='0'"),
                8,
                "ends inside the <csg>",
            ),
            (solid("6,6,6", "content='cube(2);' offset='false'"), 27, "fills 27 cells"),
            (solid("3,6,6", "content='cube(2);'"), 18, "ends inside the <csg> in line 1"),
            (solid("6,6,6", "content='cube(2);' skew='true'"), 27, "`skew` of its <csg> is left out"),
            (
                solid("6,6,6", "content='cube(2);' translate='1,1,1'"),
                27,
                "`translate` of its <csg> is left out",
            ),
            (
                world("6,6,6", "<block position='1,1,1'/><csg content='cube(2);'/>"),
                27,
                "fills 27 cells of a cubic lattice",
            ),
        ];
        for (text, blocks, note) in cases {
            let (found, targets, notes) =
                read(text.as_bytes()).unwrap_or_else(|error| panic!("{text}: {error}"));
            assert_eq!((found, targets), (blocks, 2), "{text}");
            assert!(if note.is_empty() { notes.is_empty() } else { notes.contains(note) }, "{text}: {notes}");
        }
        // Latin-1, declared and not.
        for declared in ["", " encoding='ISO-8859-1'"] {
            let mut bytes = format!("<?xml version='1.0'{declared}?><!-- f").into_bytes();
            bytes.extend(b"\xfcr -->");
            bytes.extend(block.as_bytes());
            assert_eq!(read(&bytes), Ok((1, 2, String::new())));
        }
        let relative = block.replace("<target>", "<target format='relativeGrid'>");
        let (found, notes) = cells("a.xml", relative.as_bytes(), Part::Targets).unwrap();
        assert!(found.len() == 2 && notes[0].contains("relative"), "{notes:?}");
        let solid = "<world gridSize='9,9,9'><targetList><target format='csg'>\
            <csg content='cube(1);' translate='2,3,4'/></target></targetList></world>";
        let (found, _) = cells("a.xml", solid.as_bytes(), Part::Targets).unwrap();
        assert!(found.len() == 8 && found.first() == Some(&Cell::from([2, 3, 4])), "{found:?}");
    }

    #[test]
    fn errors_name_the_line_and_what_is_not_read() {
        let world = |inner: &str| format!("<world>\n<blockList>\n{inner}</blockList>\n{TARGET}</world>");
        let solid = |inner: &str| world(inner).replace("<world>", "<world gridSize='9,9,9'>");
        let far = "<blockBox boxOrigin='0,0,0' boxSize='900000000,900000000,900000000'/>";
        for (text, error) in [
            (world("<mesh file='a.obj'/>"), "a.xml:3: <mesh> is not supported"),
            (
                world("<csg content='sphere(9)'/>"),
                "a.xml:3: <csg> fills a grid, but <world> has no `gridSize`",
            ),
            (solid("<csg/>"), "a.xml:3: <csg> has no `content`"),
            (
                solid("<csg content='cube(1);\n cube(1,5);'/>"),
                "a.xml:4: expected 1 or 3 numbers of `cube`, found 2",
            ),
            (solid("<csg content='\nmodule a() {}'/>"), "a.xml:4: `module` of <csg> is not supported"),
            (
                solid("<csg content='cube(1);' offset='perhaps'/>"),
                "expected `true` or `false`, found offset=\"perhaps\"",
            ),
            (solid("<csg content='cube(1);'/><csg content='cube(1);'/>"), "a.xml:3: a second <csg>"),
            (
                solid("<csg content='translate([9,9,9]) cube(1);' boundingBox='0'/>"),
                "<csg> fills no cell of the grid",
            ),
            (
                solid("<csg content='cube(900);'/>").replace("9,9,9", "999,999,999"),
                "a <csg> with so many solids in so large a grid",
            ),
            (world("<block position='1,0;2,0;3,0'/>"), "found position=\"1,0;2,0;3,0\"; a point is wanted"),
            (world("<blocksLine line='1,0' values='1'/>"), "found line=\"1,0\"; a point is wanted"),
            (
                world("<block position='1,0'/>\n<block position='1,2,3'/>"),
                "a.xml:4: the position \"1,2,3\" and others before it do not have equally many numbers",
            ),
            (world(""), "a.xml:2: <blockList> has no modules"),
            (
                world("<blockBox boxOrigin='9,0,0' boxSize='1,1,1'/>")
                    .replace("<world>", "<world gridSize='4,4,4'>"),
                "a.xml:2: <blockList> has no modules; the <blockBox> in line 3 has none in the grid",
            ),
            (
                world("<block position='2,1,0'/>").replace(
                    "<target>",
                    "<target format='surface'><method meth='nurbs'><cell position='1,1,1'/></method>",
                ),
                "a.xml:4: a target of the format `surface` (method `nurbs`) is not supported",
            ),
            ("<parameters/>\n<world>\n<a b=1/>\n</world>".to_owned(), "a.xml:3: this is not XML"),
            (world("<blockBox boxOrigin='0,0,0'/>"), "a.xml:3: <blockBox> has no `boxSize`"),
            (
                world("<blockBox boxSize='3,2'/>"),
                "a.xml:3: expected three whole numbers, found boxSize=\"3,2\"",
            ),
            (world(far), "there are more than 4000000 cells"),
            (world("<blockBox boxSize='9000,9000,1'/>"), "there are more than 4000000 cells"),
            (
                world("<block position='2,1,0'/>").replace("<target>", "<target format='csg'>"),
                "a.xml:4: a target of the format `csg` has no <csg>",
            ),
            (
                world("<block position='2,1,0'/>")
                    .replace("</world>", "<obstacleList><obstacle position='2,1,0'/></obstacleList></world>"),
                "a.xml:4: <obstacleList> has an obstacle in the cell [2, 1, 0]",
            ),
            ("<robots><world/></robots>".to_owned(), "a.xml:1: expected <world>, found <robots>"),
            ("\n<vs><visuals/></vs>".to_owned(), "a.xml:2: expected <world>, found <vs>"),
            ("<a/>\n<b/>".to_owned(), "a.xml:1: expected <world>, found <a>"),
            (" \n".to_owned(), "a.xml:1: expected <world>, found nothing"),
            ("<world>".to_owned(), "a.xml:1: this is not XML"),
            ("<parameters/>\n<!DOCTYPE a><world/>".to_owned(), "a.xml:2: "),
        ] {
            let found = read(text.as_bytes()).unwrap_err();
            assert!(found.contains(error), "{text}: {found}");
        }
    }
}
