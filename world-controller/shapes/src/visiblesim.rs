//! Configurations of VisibleSim (XML): the modules of `blockList`, and the cells of `targetList` or the older
//! `targetGrid`.
//!
//! Positions are cells of a simple cubic lattice, as of its sliding cubes, Smart Blocks and Blinky Blocks.
//! The file does not name the robot: positions in the face-centred lattice of 3D Catoms are read too, but as
//! a sheared shape. Ignored: cameras, lights, colours, orientations. Refused: descriptions of shapes (`csg`,
//! `blockBox`).

use super::error::{MAX_ATTRIBUTES, MAX_ATTRIBUTES_OF_ONE, MAX_NAMESPACES, MAX_NODES, SolidError};
use metamorph_core::lattice::Cell;
use roxmltree::{Document, Error, Node, ParsingOptions};
use std::collections::BTreeSet;

/// A part of a configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Part {
    /// The modules at the start.
    Blocks,
    /// The cells to be filled.
    #[default]
    Targets,
}

/// Reads the cells of one part.
pub fn cells(file: &str, text: &str, part: Part) -> Result<BTreeSet<Cell>, SolidError> {
    check_size(file, text)?;
    let options = ParsingOptions { nodes_limit: MAX_NODES, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text, options).map_err(|error| {
        let (line, file) = (error.pos().row, file.to_owned());
        match error {
            Error::DtdDetected => SolidError::Doctype { file, line: doctype_line(text) },
            other => {
                SolidError::Syntax { file, line: line as usize, why: format!("this is not XML: {other}") }
            }
        }
    })?;
    let mut reader = Reader { file, document: &document, cells: BTreeSet::new() };
    let world = document.root_element();
    if !world.has_tag_name("world") {
        let why = format!("expected <world>, found <{}>", world.tag_name().name());
        return Err(SolidError::Syntax { file: file.to_owned(), line: reader.line(world) as usize, why });
    }
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
    Ok(reader.cells)
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
    cells: BTreeSet<Cell>,
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
                    let position = self.attribute(node, "position")?;
                    let cell = coordinates(position).ok_or_else(|| {
                        self.syntax(
                            node,
                            format!("expected three whole numbers, found position=\"{}\"", cut(position)),
                        )
                    })?;
                    self.add(node, cell)?;
                }
                "blocksLine" | "targetLine" => self.line_of_cells(node)?,
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
            self.add(node, [x, y, z])?;
        }
        Ok(())
    }

    fn attribute<'n>(&self, node: Node<'n, '_>, name: &str) -> Result<&'n str, SolidError> {
        let missing = || self.syntax(node, format!("<{}> has no `{name}`", node.tag_name().name()));
        node.attribute(name).ok_or_else(missing)
    }

    fn add(&mut self, node: Node<'_, '_>, at: [i64; 3]) -> Result<(), SolidError> {
        let cell = in_range(self.file, at)?;
        if self.cells.insert(cell) {
            return Ok(());
        }
        Err(SolidError::Twice { file: self.file.to_owned(), line: self.line(node), cell })
    }
}

fn cut(text: &str) -> String {
    text.chars().take(40).collect()
}

/// Parses `1,2,3`. Whole numbers may also be written as `1.0`.
fn coordinates(text: &str) -> Option<[i64; 3]> {
    let mut numbers = text.split(',').map(|part| {
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
