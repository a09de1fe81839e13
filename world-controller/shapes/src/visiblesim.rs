//! Configurations of VisibleSim (XML): the modules of `blockList`, and the cells of `targetList` or the older
//! `targetGrid`.
//!
//! Positions are cells of a simple cubic lattice, as of its sliding cubes, Smart Blocks and Blinky Blocks.
//! The file does not name the robot: positions in the face-centred lattice of 3D Catoms are read too, but as
//! a sheared shape. The root is `<world>`, or `<vs>` with `<world>` in it; other elements may stand beside them,
//! as VisibleSim's parser allows. Ignored: cameras, lights, colours, orientations, parameters. Obstacles are a note,
//! and an error where the shape has a cell. Refused: descriptions of shapes (`csg`, `mesh`).

use super::error::{
    MAX_ATTRIBUTES, MAX_ATTRIBUTES_OF_ONE, MAX_NAMESPACES, MAX_NODES, MAX_VOXELS, SolidError,
};
use metamorph_core::lattice::Cell;
use metamorph_text::format::many;
use roxmltree::{Document, Error, Node, ParsingOptions};
use std::borrow::Cow;
use std::collections::BTreeSet;

/// The element put around a file that has several roots.
const AROUND: &str = "files";

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
        Err(error) => {
            // VisibleSim's parser accepts several roots.
            around = format!("<{AROUND}>{text}</{AROUND}>");
            let (line, why) = (error.pos().row as usize, format!("this is not XML: {error}"));
            Document::parse_with_options(&around, options()).map_err(|_| SolidError::Syntax {
                file: file.to_owned(),
                line,
                why,
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
    let (cells, notes) = (BTreeSet::new(), Vec::new());
    let mut reader = Reader { file, document: &document, grid, cells, named: 0, again: 0, cut: None, notes };
    let Some(world) = world else {
        let found = if root.has_tag_name(AROUND) { children(root).next() } else { Some(root) };
        let name = found.map_or("nothing".to_owned(), |found| format!("<{}>", cut(found.tag_name().name())));
        return Err(reader.syntax(found.unwrap_or(root), format!("expected <world>, found {name}")));
    };
    let lists = match part {
        Part::Blocks => ["blockList"].as_slice(),
        Part::Targets => &["targetList", "targetGrid"],
    };
    for list in children(world).filter(|node| lists.contains(&node.tag_name().name())) {
        match list.tag_name().name() {
            "targetList" => reader.targets(list)?,
            _ => reader.list(list)?,
        }
    }
    if reader.cells.is_empty() {
        let what = match part {
            Part::Blocks => "modules (<blockList>)",
            Part::Targets => "target (<targetList>)",
        };
        return Err(SolidError::NoPart { file: file.to_owned(), what });
    }
    reader.obstacles(world)?;
    if reader.again > 0 {
        reader.notes.push(format!("{} named twice", counted(reader.again, "cell", ["is", "are"])));
    }
    if let Some((boxes, line)) = reader.cut {
        let ends = counted(boxes, "<blockBox>", ["ends", "end"]);
        reader.notes.push(format!(
            "{ends} before the last cells of the grid (`gridSize`), as in VisibleSim; the first is in line {line}"
        ));
    }
    Ok((reader.cells, reader.notes))
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
    notes: Vec<String>,
}

impl Reader<'_> {
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
        match target.attribute("format") {
            Some("grid") | None => self.list(target),
            Some("relativeGrid") => {
                self.notes.push(
                    "its positions are relative to a cell that the program chooses; `at` places them"
                        .to_owned(),
                );
                self.list(target)
            }
            Some(other) => {
                let other: String = other.chars().take(40).collect();
                Err(self.not_read(target, format!("a target of the format `{other}`")))
            }
        }
    }

    fn list(&mut self, list: Node<'_, '_>) -> Result<(), SolidError> {
        for node in children(list) {
            match node.tag_name().name() {
                "block" | "cell" => {
                    let cell = self.position(node)?;
                    self.add(cell)?;
                }
                "blocksLine" | "targetLine" => self.line_of_cells(node)?,
                "blockBox" => self.box_of_cells(node)?,
                other => return Err(self.not_read(node, format!("<{}>", cut(other)))),
            }
        }
        Ok(())
    }

    /// Reads one character for each cell along x; `1` is a module.
    fn line_of_cells(&mut self, node: Node<'_, '_>) -> Result<(), SolidError> {
        let number = |name| match node.attribute(name) {
            None => Ok(0),
            Some(text) => text.trim().parse::<i64>().map_err(|_| {
                self.syntax(node, format!("expected a whole number, found {name}=\"{}\"", cut(text)))
            }),
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

    /// Notes obstacles beside the shape, and refuses those in it.
    fn obstacles(&mut self, world: Node<'_, '_>) -> Result<(), SolidError> {
        let lists = children(world).filter(|node| node.has_tag_name("obstacleList"));
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

    fn position(&self, node: Node<'_, '_>) -> Result<[i64; 3], SolidError> {
        let missing = || self.syntax(node, format!("<{}> has no `position`", node.tag_name().name()));
        self.place(node, "position")?.ok_or_else(missing)
    }

    /// Returns the three whole numbers of an attribute, if the element has it.
    fn place(&self, node: Node<'_, '_>, name: &str) -> Result<Option<[i64; 3]>, SolidError> {
        let Some(text) = node.attribute(name) else { return Ok(None) };
        let wrong = || format!("expected three whole numbers, found {name}=\"{}\"", cut(text));
        coordinates(text).map(Some).ok_or_else(|| self.syntax(node, wrong()))
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
}

fn cut(text: &str) -> String {
    text.chars().take(40).collect()
}

/// Parses `1,2,3` or `(1,2,3)`. Whole numbers may also be written as `1.0`.
fn coordinates(text: &str) -> Option<[i64; 3]> {
    let text = text.trim();
    let inner = text.strip_prefix('(').and_then(|rest| rest.strip_suffix(')')).unwrap_or(text);
    let mut numbers = inner.split(',').map(|part| {
        let number: f64 = part.trim().parse().ok()?;
        (number.fract() == 0.0 && number.abs() < 1e9).then_some(number as i64)
    });
    let cell = [numbers.next()??, numbers.next()??, numbers.next()??];
    numbers.next().is_none().then_some(cell)
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
        let cases: [(String, usize, &str); 16] = [
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
    }

    #[test]
    fn errors_name_the_line_and_what_is_not_read() {
        let world = |inner: &str| format!("<world>\n<blockList>\n{inner}</blockList>\n{TARGET}</world>");
        let far = "<blockBox boxOrigin='0,0,0' boxSize='900000000,900000000,900000000'/>";
        for (text, error) in [
            (world("<mesh file='a.obj'/>"), "a.xml:3: <mesh> is not supported"),
            (world("<csg content='sphere(9)'/>"), "a.xml:3: <csg> is not supported"),
            (world("<blockBox boxOrigin='0,0,0'/>"), "a.xml:3: <blockBox> has no `boxSize`"),
            (
                world("<blockBox boxSize='3,2'/>"),
                "a.xml:3: expected three whole numbers, found boxSize=\"3,2\"",
            ),
            (world(far), "there are more than 4000000 cells"),
            (world("<blockBox boxSize='9000,9000,1'/>"), "there are more than 4000000 cells"),
            (
                world("<block position='2,1,0'/>").replace("<target>", "<target format='csg'>"),
                "a.xml:4: a target of the format `csg`",
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
