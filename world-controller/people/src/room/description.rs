//! A room for those who draw it: what stands where, and which constraints are kept. Absent: any judgement of its own,
//! which `constraint` and `reach` have.

use super::constraint::{Constraint, Rule, Violation, check_while};
use super::form::{Form, SHAPES, Turned};
use super::model::{Area, Block, COLOURS, Colour, Placement, Room};
use super::reach;
use super::{CircleAnswer, circles};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::motions::Motions;
use serde::Serialize;

/// A room.
#[derive(Debug, Serialize)]
pub struct Description {
    name: Option<String>,
    /// Connectors along x and y.
    size: (i16, i16),
    height: i16,
    doors: Vec<(i16, i16)>,
    keep_out: Vec<Block>,
    store: Option<Area>,
    spare: usize,
    /// The forms of all pieces, each listed once.
    forms: Vec<FormOf>,
    pieces: Vec<PieceOf>,
    /// Metamodules of all pieces.
    metamodules: usize,
    /// `inside` and `apart`, and then those of the file.
    constraints: Vec<ConstraintOf>,
    violations: Vec<Violation>,
    /// The circles of the room, measured.
    circles: Vec<CircleAnswer>,
    /// The shapes and colours that a piece can have.
    shapes: [&'static str; SHAPES.len()],
    colours: [&'static str; COLOURS.len()],
    /// False if the time was over before all constraints were looked at; then no `unknown` one is kept or violated.
    complete: bool,
}

#[derive(Debug, Serialize)]
struct FormOf {
    height: i16,
    metamodules: usize,
    /// After 0 to 3 quarter turns.
    turns: Vec<TurnOf>,
}

#[derive(Debug, Serialize)]
struct TurnOf {
    size: (i16, i16),
    cells: Vec<Cell>,
}

#[derive(Debug, Serialize)]
struct PieceOf {
    name: String,
    #[serde(flatten)]
    place: Placement,
    colour: Colour,
    /// Its number in the list of forms.
    form: usize,
    metamodules: usize,
}

#[derive(Debug, Serialize)]
struct ConstraintOf {
    /// Its number in the file, from 1; none for those that always hold.
    number: Option<usize>,
    kind: &'static str,
    /// The requirement in words.
    text: String,
    /// The pieces that it names.
    pieces: Vec<String>,
    /// The area that has to be clear.
    area: Option<Area>,
    wish: bool,
    state: State,
}

/// Result of the check of a constraint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum State {
    Kept,
    Violated,
    Unknown,
}

/// Describes a room, and checks it while `going` holds. `reach` is looked at if there are motions.
pub fn describe(room: &Room, motions: Option<&Motions>, going: &dyn Fn() -> bool) -> Description {
    let mut violations = check_while(room, going);
    let (mut complete, mut reached) = (going(), false);
    if let Some(motions) = motions.filter(|_| complete && !super::is_impossible(&violations)) {
        violations.extend(reach::check_while(room, motions, going));
        (complete, reached) = (going(), going());
    }
    let mut forms: Vec<&Form> = Vec::new();
    let pieces = room.pieces.iter().map(|piece| {
        let known = forms.iter().position(|form| **form == *piece.form);
        let form = known.unwrap_or(forms.len());
        if known.is_none() {
            forms.push(&piece.form);
        }
        let metamodules = piece.form.metamodules();
        PieceOf { name: piece.name.clone(), place: piece.place, colour: piece.colour, form, metamodules }
    });
    let pieces = pieces.collect();
    let built_in = [Rule::Inside, Rule::Apart].map(|rule| Constraint { rule, wish: false });
    let numbered = room.constraints.iter().enumerate().map(|(i, c)| (Some(i + 1), c));
    let constraints = built_in.iter().map(|c| (None, c)).chain(numbered);
    let constraints = constraints.map(|(number, constraint)| {
        let violated = |v: &Violation| v.constraint == number && v.rule == constraint.rule.name();
        let looked_at = if constraint.rule == Rule::Reach { reached } else { complete || motions.is_some() };
        let state = match (violations.iter().any(violated), looked_at) {
            (true, _) => State::Violated,
            (false, true) => State::Kept,
            (false, false) => State::Unknown,
        };
        of_constraint(room, number, constraint, state)
    });
    let constraints = constraints.collect();
    Description {
        name: room.name.clone(),
        size: room.size,
        height: room.height,
        doors: room.doors.clone(),
        keep_out: room.keep_out.clone(),
        store: room.store,
        spare: room.spare,
        forms: forms.into_iter().map(of_form).collect(),
        pieces,
        metamodules: room.pieces.iter().map(|piece| piece.form.metamodules()).sum(),
        constraints,
        circles: circles(room),
        shapes: SHAPES.map(|(name, _)| name),
        colours: COLOURS.map(|(name, _)| name),
        violations,
        complete,
    }
}

fn of_form(form: &Form) -> FormOf {
    let turn = |turn| {
        let Turned { size, cells, .. } = form.turned(turn);
        TurnOf { size: *size, cells: cells.clone() }
    };
    FormOf { height: form.height, metamodules: form.metamodules(), turns: (0..4).map(turn).collect() }
}

fn of_constraint(room: &Room, number: Option<usize>, constraint: &Constraint, state: State) -> ConstraintOf {
    let Constraint { rule, wish } = constraint;
    let area = if let Rule::Clear(area) = rule { Some(*area) } else { None };
    let pieces = rule.pieces().into_iter().map(|p| room.pieces[p].name.clone()).collect();
    ConstraintOf { number, kind: rule.name(), text: rule.text(room), pieces, area, wish: *wish, state }
}
