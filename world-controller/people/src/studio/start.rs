//! Start of a run from the studio: the scenario and the plan of a drawing or of a room.

use super::VERSION;
use super::budget::Budget;
use super::rooms::{Drawings, LONGEST_ORDER, read_room};
use super::site::{checked, wrong};
use crate::room::constraint::first;
use crate::room::{KindArg, scenario_of};
use hyper::StatusCode;
use metamorph_processes::family::{families, read_text};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::pairing::Pairing;
use metamorph_protocol::pairing::pins::Pin;
use metamorph_protocol::pairing::split::{Footing, Split};
use metamorph_scenario::family::DrawnStructure;
use metamorph_scenario::{LinkKind, Overrides, Plan};
use metamorph_text::command_error::CommandError as _;
use metamorph_view::http::refused;
use serde::Deserialize;
use serde_json::Value;
use std::sync::Arc;

/// Largest number of characters of the name of a drawing.
const MAX_NAME: usize = 64;

/// A request to build a drawing or a room.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Start {
    pub version: u16,
    name: String,
    cells: Option<Vec<Cell>>,
    /// Cells that are one module each.
    #[serde(default)]
    pins: Vec<Pin>,
    /// The family that builds a drawing.
    family: Option<String>,
    /// The text of a room file.
    room: Option<String>,
    /// The kind of the metamodules that build a room.
    kind: Option<KindArg>,
    /// Link that carries the messages.
    link: Link,
    /// Whether only the scenario is wanted.
    #[serde(default)]
    pub only_scenario: bool,
}

/// The links, by the names of scenarios and reports.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Link {
    Ipc,
    Sim,
}

type Response = (StatusCode, Value);

/// Makes a scenario and its plan. The text goes through the reader of scenarios, with all its limits.
pub fn plan(start: &Start, drawings: &Drawings) -> Result<(String, Plan), Response> {
    debug_assert_eq!(start.version, VERSION);
    let is_plain = |c: char| c.is_alphanumeric() || " -_.".contains(c);
    if !(1..=MAX_NAME).contains(&start.name.chars().count()) || !start.name.chars().all(is_plain) {
        return Err(wrong("a name has 1 to 64 letters, digits, spaces, dots, dashes and underscores"));
    }
    let text = match (&start.cells, &start.family, &start.room) {
        (Some(cells), Some(family), None) if start.kind.is_none() => of_drawing(start, cells, family)?,
        (None, None, Some(room)) if start.pins.is_empty() => of_room(start, room, drawings)?,
        _ => {
            let why = "what is started has `cells`, `family` and `pins`, or `room` and `kind`";
            return Err(refused(StatusCode::BAD_REQUEST, why));
        }
    };
    let link = match start.link {
        Link::Ipc => LinkKind::Ipc,
        Link::Sim => LinkKind::Sim,
    };
    let overrides = Overrides { link, ..Overrides::default() };
    let origin = format!("{}.toml", start.name);
    let plan =
        read_text(&origin, &text, &overrides).map_err(|diagnostics| wrong(&diagnostics.to_string()))?;
    Ok((text, plan))
}

fn of_drawing(start: &Start, cells: &[Cell], family: &str) -> Result<String, Response> {
    let cells = checked(cells)?;
    let pairing = Pairing::pinned(&cells, &start.pins).map_err(|error| wrong(&error.to_string()))?;
    let standing = match pairing.split(Footing::Floor) {
        Split::Yes(chains) => chains,
        _ => Vec::new(),
    };
    let drawing =
        DrawnStructure { name: &start.name, cells: &cells, standing: &standing, why_not_standing: None };
    let families = families().all;
    let family = families.iter().find(|known| known.name() == family);
    let text = family.and_then(|family| family.scenario_of(&drawing));
    text.ok_or_else(|| wrong("no family of this name builds drawings"))?.map_err(|why| wrong(&why))
}

fn of_room(start: &Start, text: &str, drawings: &Drawings) -> Result<String, Response> {
    let room = read_room(text, &|name| drawings.read(name))?;
    let budget = Budget::of_steps(Arc::default(), LONGEST_ORDER);
    // Neither does `metamorph room --write` make a scenario of such a room.
    if let Some(violation) = first(&room) {
        return Err(wrong(&format!("the room violates a constraint: {}", violation.why)));
    }
    let (kind, origin) = (start.kind.unwrap_or(KindArg::Srs), format!("{}.toml", start.name));
    scenario_of(&room, kind, &origin, &|| budget.is_left()).map_err(|error| wrong(&error.text()))
}
