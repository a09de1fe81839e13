//! Changes of a room file. They are made in its text, so that comments and the order of keys stay; what the changed text
//! means, and whether it is right, `document` says.

use super::TemplateArg;
use super::form::{Form, SHAPES};
use super::model::{MAX_PIECES, MAX_SIDE, Placement};
use super::template::fresh_names;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::pairing::pins::Pin;
use serde::Deserialize;
use thiserror::Error;
use toml_edit::{Array, ArrayOfTables, DocumentMut, Item, Table, TableLike, Value};

/// One change.
#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Edit {
    /// Puts a piece elsewhere.
    Place {
        /// Its name.
        piece: String,
        /// The corner with the smallest coordinates.
        at: (i16, i16),
        /// Quarter turns.
        turn: u8,
    },
    /// Gives a piece another colour.
    Colour {
        /// Its name.
        piece: String,
        /// The colour's name.
        colour: String,
    },
    /// Gives a piece another name, in constraints, too.
    Rename {
        /// The name until now.
        piece: String,
        /// The new one.
        name: String,
    },
    /// Takes a piece out, and what constraints say of it.
    Remove {
        /// Its name.
        piece: String,
    },
    /// Puts a new piece into the room.
    Add(NewPiece),
    /// Puts equal pieces into the room.
    Arrange(Arrangement),
    /// Asks for one thing more.
    Constrain(NewConstraint),
    /// Gives a constraint up.
    Release {
        /// Its number, from 1.
        constraint: usize,
    },
    /// Says whether a constraint is only wished for.
    Wish {
        /// Its number, from 1.
        constraint: usize,
        /// True if it is.
        wish: bool,
    },
    /// Makes the floor larger or smaller.
    Resize {
        /// Connectors along x and y.
        size: (i16, i16),
    },
}

/// A piece, as in the file: it has one of `shape`, `file` and `cells`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "the keys of [[piece]]")]
pub struct NewPiece {
    pub name: String,
    pub shape: Option<String>,
    pub file: Option<String>,
    pub cells: Option<Vec<Cell>>,
    #[serde(default)]
    pub pins: Vec<Pin>,
    pub at: (i16, i16),
    #[serde(default)]
    pub turn: u8,
    pub colour: Option<String>,
}

/// A constraint, as in the file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "the keys of [[constraint]]")]
pub struct NewConstraint {
    pub kind: String,
    pub pieces: Option<Vec<String>>,
    pub piece: Option<String>,
    pub around: Option<String>,
    pub cells: Option<u16>,
    pub axis: Option<String>,
    pub radius: Option<f64>,
    pub tolerance: Option<f64>,
    #[serde(default)]
    pub wish: bool,
}

/// Equal pieces, as `metamorph room --template` makes them.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "the options of --template")]
pub struct Arrangement {
    pub template: TemplateArg,
    pub count: (usize, usize),
    pub around: (i16, i16),
    pub radius: f64,
    pub gap: i16,
    pub shape: String,
    pub colour: Option<String>,
}

/// Why a change is not made.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum EditError {
    /// The text is not TOML.
    #[error("this is not TOML: {0}")]
    Syntax(String),
    /// There is no such piece.
    #[error("there is no piece `{0}`")]
    NoPiece(String),
    /// There is no such constraint.
    #[error("there is no constraint {0}")]
    NoConstraint(usize),
    /// The file has something else there.
    #[error("`{0}` is no table")]
    NoTable(&'static str),
    /// There is no such shape.
    #[error("there is no shape `{0}`")]
    NoShape(String),
    /// A number of an arrangement.
    #[error(
        "an arrangement has 1 to {MAX_PIECES} pieces a row and rows, a middle in the room, a radius from 0 to {MAX_SIDE} and gaps from 0 to 64"
    )]
    Arrangement,
}

/// Makes the changes, one after the other.
///
/// # Errors
/// If the text is no TOML, or a change is about what is not there.
pub fn apply(text: &str, edits: &[Edit]) -> Result<String, EditError> {
    if edits.is_empty() {
        return Ok(text.to_owned());
    }
    let mut file: DocumentMut =
        text.parse().map_err(|error: toml_edit::TomlError| EditError::Syntax(error.message().to_owned()))?;
    for edit in edits {
        one(&mut file, edit)?;
    }
    Ok(file.to_string())
}

fn one(file: &mut DocumentMut, edit: &Edit) -> Result<(), EditError> {
    match edit {
        Edit::Place { piece, at, turn } => {
            let table = piece_named(file, piece)?;
            set(table, "at", pair(*at));
            if *turn != 0 || table.contains_key("turn") {
                set(table, "turn", i64::from(*turn).into());
            }
        }
        Edit::Colour { piece, colour } => set(piece_named(file, piece)?, "colour", colour.as_str().into()),
        Edit::Rename { piece, name } => {
            set(piece_named(file, piece)?, "name", name.as_str().into());
            tables(file, "constraint").into_iter().for_each(|table| rename(table, piece, name));
        }
        Edit::Remove { piece } => remove_piece(file, piece)?,
        Edit::Add(piece) => push(file, "piece", piece.table())?,
        Edit::Arrange(arrangement) => arrange(file, arrangement)?,
        Edit::Constrain(constraint) => push(file, "constraint", constraint.table())?,
        Edit::Release { constraint } => {
            constraint_at(file, *constraint)?;
            remove(file, "constraint", constraint - 1);
        }
        Edit::Wish { constraint, wish } => set(constraint_at(file, *constraint)?, "wish", (*wish).into()),
        Edit::Resize { size } => {
            let room = file.get_mut("room").and_then(Item::as_table_like_mut);
            set(room.ok_or(EditError::NoTable("room"))?, "size", pair(*size));
        }
    }
    Ok(())
}

/// The tables of a list, written as `[[key]]` or in brackets.
fn tables<'a>(file: &'a mut DocumentMut, key: &str) -> Vec<&'a mut dyn TableLike> {
    match file.get_mut(key) {
        Some(Item::ArrayOfTables(all)) => all.iter_mut().map(|table| table as &mut dyn TableLike).collect(),
        Some(Item::Value(Value::Array(all))) => {
            let tables = all.iter_mut().filter_map(Value::as_inline_table_mut);
            tables.map(|table| table as &mut dyn TableLike).collect()
        }
        _ => Vec::new(),
    }
}

fn text_of<'a>(table: &'a dyn TableLike, key: &str) -> Option<&'a str> {
    table.get(key).and_then(Item::as_str)
}

fn piece_named<'a>(file: &'a mut DocumentMut, name: &str) -> Result<&'a mut dyn TableLike, EditError> {
    let mut pieces = tables(file, "piece").into_iter();
    let found = pieces.find(|table| text_of(*table, "name") == Some(name));
    found.ok_or_else(|| EditError::NoPiece(name.to_owned()))
}

fn constraint_at(file: &mut DocumentMut, number: usize) -> Result<&mut dyn TableLike, EditError> {
    let mut constraints = tables(file, "constraint").into_iter();
    let found = number.checked_sub(1).and_then(|i| constraints.nth(i));
    found.ok_or(EditError::NoConstraint(number))
}

/// Sets a value, and keeps the comment behind the one before.
fn set(table: &mut dyn TableLike, key: &str, mut value: Value) {
    if let Some(before) = table.get(key).and_then(Item::as_value) {
        *value.decor_mut() = before.decor().clone();
    }
    table.insert(key, Item::Value(value));
}

fn push(file: &mut DocumentMut, key: &'static str, mut table: Table) -> Result<(), EditError> {
    table.decor_mut().set_prefix("\n");
    match file.entry(key).or_insert_with(|| Item::ArrayOfTables(ArrayOfTables::new())) {
        Item::ArrayOfTables(all) => all.push(table),
        Item::Value(Value::Array(all)) => all.push(Value::InlineTable(table.into_inline_table())),
        _ => return Err(EditError::NoTable(key)),
    }
    Ok(())
}

fn remove(file: &mut DocumentMut, key: &str, i: usize) {
    match file.get_mut(key) {
        Some(Item::ArrayOfTables(all)) => drop(all.remove(i)),
        Some(Item::Value(Value::Array(all))) => drop(all.remove(i)),
        _ => {}
    }
}

fn rename(table: &mut dyn TableLike, from: &str, to: &str) {
    for key in ["piece", "around"] {
        if text_of(table, key) == Some(from) {
            set(table, key, to.into());
        }
    }
    let named = table.get_mut("pieces").and_then(Item::as_array_mut).into_iter().flat_map(Array::iter_mut);
    for value in named.filter(|value| value.as_str() == Some(from)) {
        let decor = value.decor().clone();
        *value = to.into();
        *value.decor_mut() = decor;
    }
}

fn remove_piece(file: &mut DocumentMut, name: &str) -> Result<(), EditError> {
    let mut pieces = tables(file, "piece").into_iter();
    let place = pieces.position(|table| text_of(table, "name") == Some(name));
    let place = place.ok_or_else(|| EditError::NoPiece(name.to_owned()))?;
    remove(file, "piece", place);
    let constraints = tables(file, "constraint").into_iter().enumerate();
    let ended: Vec<usize> =
        constraints.filter_map(|(i, table)| (!keeps_without(table, name)).then_some(i)).collect();
    ended.into_iter().rev().for_each(|i| remove(file, "constraint", i));
    Ok(())
}

/// Takes a piece out of a constraint, and returns whether the constraint still says something.
fn keeps_without(table: &mut dyn TableLike, name: &str) -> bool {
    if ["piece", "around"].iter().any(|key| text_of(table, key) == Some(name)) {
        return false;
    }
    // Those of two pieces are about these two.
    let least = match text_of(table, "kind") {
        Some("align") => 2,
        Some("circle") => 3,
        _ => usize::MAX,
    };
    let Some(pieces) = table.get_mut("pieces").and_then(Item::as_array_mut) else { return true };
    let place = pieces.iter().position(|value| value.as_str() == Some(name));
    place.is_none_or(|i| {
        pieces.remove(i);
        pieces.len() >= least
    })
}

fn pair((x, y): (i16, i16)) -> Value {
    Value::Array([i64::from(x), i64::from(y)].into_iter().collect())
}

fn cell(cell: &Cell) -> Value {
    Value::Array([cell.x, cell.y, cell.z].map(i64::from).into_iter().collect())
}

/// A list with one value a line.
fn lines(values: impl Iterator<Item = Value>) -> Value {
    let mut all: Array = values.collect();
    for value in all.iter_mut() {
        value.decor_mut().set_prefix("\n    ");
    }
    all.set_trailing("\n");
    all.set_trailing_comma(true);
    Value::Array(all)
}

/// Returns a table of the keys that have a value.
fn table_of<const N: usize>(entries: [(&str, Option<Value>); N]) -> Table {
    let given = entries.into_iter().filter_map(|(key, value)| Some((key, Item::Value(value?))));
    given.collect()
}

impl NewPiece {
    fn table(&self) -> Table {
        let pin = |pin: &Pin| Value::Array(pin.iter().map(cell).collect());
        table_of([
            ("name", Some(self.name.as_str().into())),
            ("shape", self.shape.as_deref().map(Value::from)),
            ("file", self.file.as_deref().map(Value::from)),
            ("cells", self.cells.as_ref().map(|cells| lines(cells.iter().map(cell)))),
            ("pins", (!self.pins.is_empty()).then(|| lines(self.pins.iter().map(pin)))),
            ("at", Some(pair(self.at))),
            ("turn", (self.turn != 0).then(|| i64::from(self.turn).into())),
            ("colour", self.colour.as_deref().map(Value::from)),
        ])
    }
}

impl NewConstraint {
    fn table(&self) -> Table {
        let names = |names: &Vec<String>| Value::Array(names.iter().map(String::as_str).collect());
        table_of([
            ("kind", Some(self.kind.as_str().into())),
            ("pieces", self.pieces.as_ref().map(names)),
            ("piece", self.piece.as_deref().map(Value::from)),
            ("around", self.around.as_deref().map(Value::from)),
            ("cells", self.cells.map(|k| i64::from(k).into())),
            ("axis", self.axis.as_deref().map(Value::from)),
            ("radius", self.radius.map(Value::from)),
            ("tolerance", self.tolerance.map(Value::from)),
            ("wish", self.wish.then(|| true.into())),
        ])
    }
}

fn arrange(file: &mut DocumentMut, asked: &Arrangement) -> Result<(), EditError> {
    let Arrangement { count, around, radius, gap, .. } = *asked;
    let makes = SHAPES.iter().find(|(name, _)| *name == asked.shape).map(|(_, makes)| *makes);
    let makes = makes.ok_or_else(|| EditError::NoShape(asked.shape.clone()))?;
    let many = 1..=MAX_PIECES;
    let floor = 0..MAX_SIDE;
    let fits = many.contains(&count.0)
        && many.contains(&count.1)
        && count.0 * count.1 <= MAX_PIECES
        && floor.contains(&around.0)
        && floor.contains(&around.1)
        && (0.0..=f64::from(MAX_SIDE)).contains(&radius)
        && (0..=64).contains(&gap);
    if !fits {
        return Err(EditError::Arrangement);
    }
    let template = asked.template.of(count, around, radius, gap);
    let places = template.places(&Form::library(makes));
    let taken: Vec<String> = tables(file, "piece")
        .into_iter()
        .filter_map(|table| text_of(table, "name").map(str::to_owned))
        .collect();
    let names = fresh_names(&asked.shape, |name| taken.iter().any(|other| other == name));
    for (name, Placement { at, turn }) in names.zip(places) {
        let (shape, colour) = (Some(asked.shape.clone()), asked.colour.clone());
        let piece = NewPiece { name, shape, file: None, cells: None, pins: Vec::new(), at, turn, colour };
        push(file, "piece", piece.table())?;
    }
    Ok(())
}
