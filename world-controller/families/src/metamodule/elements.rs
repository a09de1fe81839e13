//! The passive elements of a scenario: `[[swarm.element]]`, read and checked.

use super::error::MetamoduleError;
use metamorph_protocol::lattice::{Cell, Face};
use metamorph_protocol::manipulation::colour::colours_differ;
use metamorph_protocol::manipulation::element::{Element, cell_at, centre_of, moved};
use metamorph_protocol::manipulation::load::{LoadLimits, MAX_GRAMS};
use metamorph_protocol::manipulation::rest::rests;
use metamorph_protocol::metamodule::blueprint::Blueprint;
use metamorph_protocol::metamodule::elements::{Elements, MAX_ELEMENTS, PassiveElement};
use metamorph_protocol::metamodule::motions::Motions;
use metamorph_protocol::metamodule::params::{Floor, Strategy};
use metamorph_protocol::metamodule::pose::{Pose, to_frame};
use metamorph_protocol::roombots::grid::GridState;
use metamorph_protocol::roombots::lattice_pose::{LatticePose, LatticeRotation};
use metamorph_scenario::diagnostics::{At, Diagnostics, Place};
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::table::{Node, Read, Section, elements, wrong};
use toml::de::DeValue;

const ELEMENT: &str =
    "name = \"top\", shape = \"plate3x3\", mass = 0.5, at = { cell = [3, 2, 0] }, to = { cell = [8, 5, 4] }";
/// Default mass of an element in kilograms: its weight in the experiments.
pub const MASS: f64 = 0.25;
/// Default rotation of an element.
pub const TURN: &str = "z-up x-east";
/// Communication range that is needed besides the longest side of an element: two bodies reach four cells each.
const REACH: u16 = 9;

/// An element as written.
#[derive(Clone, Debug)]
pub struct RawElement {
    place: Place,
    name: String,
    shape: At<Shape>,
    grams: u32,
    at: At<Lying>,
    to: At<Goals>,
}

/// A shape, by name or by its cells.
#[derive(Clone, Debug)]
struct Shape(Element);

/// The places of an element at the goals of the swarm: one for all, or one for each.
#[derive(Clone, Debug)]
struct Goals(Vec<Lying>);

impl Read for Goals {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Goals> {
        match node.get_ref() {
            DeValue::Array(all) => {
                let all: Option<Vec<Lying>> = all.iter().map(|one| Lying::read(one, diagnostics)).collect();
                all.filter(|all| !all.is_empty()).map(Goals)
            }
            _ => Lying::read(node, diagnostics).map(|one| Goals(vec![one])),
        }
    }
}

/// The place of an element: where its cell (0, 0, 0) is, and how it is turned.
#[derive(Clone, Copy, Debug)]
struct Lying {
    cell: Cell,
    rotation: LatticeRotation,
}

impl Lying {
    fn cells(self, shape: &Element) -> Vec<Cell> {
        let at = LatticePose { rotation: self.rotation, half: [0; 3] };
        let [x, y, z] = centre_of(self.cell);
        let cell = |c: &Cell| {
            let [dx, dy, dz] = moved(at, [2 * c.x, 2 * c.y, 2 * c.z]);
            cell_at([x + dx, y + dy, z + dz])
        };
        let mut cells: Vec<Cell> = shape.cells().iter().map(cell).collect();
        cells.sort_unstable();
        cells
    }
}

/// Reads all `[[swarm.element]]` tables.
pub fn read(node: Option<&Node<'_>>, diagnostics: &mut Diagnostics) -> Vec<RawElement> {
    let Some(array) = node.and_then(|node| elements(node, "[[swarm.element]]", diagnostics)) else {
        return Vec::new();
    };
    if let (true, Some(node)) = (array.len() > MAX_ELEMENTS, node) {
        diagnostics.add(node.span(), MetamoduleError::TooManyElements(array.len()));
    }
    let tables = array.iter().take(MAX_ELEMENTS).enumerate();
    tables.filter_map(|(i, table)| read_element(i, table, diagnostics)).collect()
}

fn read_element(i: usize, node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<RawElement> {
    let mut section = Section::of(node, "[[swarm.element]]", ELEMENT, diagnostics)?;
    let name = section.get("name", diagnostics).map_or_else(|| format!("element {}", i + 1), |n| n.value);
    let shape = section.need("shape", "shape = \"plate3x3\"", diagnostics);
    let mass = section.get("mass", diagnostics).unwrap_or_else(|| At::new(MASS, Place::File));
    let at = section.need("at", "at = { cell = [3, 2, 0] }", diagnostics);
    let to = section.need("to", "to = { cell = [8, 5, 4] }", diagnostics);
    let place = section.place().clone();
    section.finish(diagnostics);
    let grams = (mass.value * 1000.0).round();
    if !(1.0..=f64::from(MAX_GRAMS)).contains(&grams) {
        let (what, got) = ("the mass in kilograms", mass.value.to_string());
        let (low, high) = ("0.001".into(), (MAX_GRAMS / 1000).to_string());
        diagnostics.add(mass.place, ScenarioError::Range { what, got, low, high });
        return None;
    }
    Some(RawElement { place, name, shape: shape?, grams: grams as u32, at: at?, to: to? })
}

impl Read for Shape {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Shape> {
        let found = match node.get_ref() {
            DeValue::String(name) => name.parse(),
            DeValue::Array(cells) => {
                let cells: Option<Vec<Cell>> = cells.iter().map(|c| Cell::read(c, diagnostics)).collect();
                Element::new(cells?)
            }
            other => {
                diagnostics.add(node.span(), wrong("a name or a list of cells", other, "\"plate3x3\""));
                return None;
            }
        };
        match found {
            Ok(element) => Some(Shape(element)),
            Err(error) => {
                diagnostics.add(node.span(), MetamoduleError::Element(error));
                None
            }
        }
    }
}

impl Read for Lying {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Lying> {
        let mut section = Section::of(node, "the place of an element", "{ cell = [3, 2, 0] }", diagnostics)?;
        let cell = section.need::<Cell>("cell", "cell = [3, 2, 0]", diagnostics);
        let turn = section
            .get::<String>("turn", diagnostics)
            .unwrap_or_else(|| At::new(TURN.to_owned(), Place::File));
        section.finish(diagnostics);
        let Some(rotation) = rotation(&turn.value) else {
            diagnostics.add(turn.place, MetamoduleError::ElementTurn(turn.value));
            return None;
        };
        Some(Lying { cell: cell?.value, rotation })
    }
}

/// Returns the rotation that turns z and x into two directions: `z-up x-east`.
fn rotation(text: &str) -> Option<LatticeRotation> {
    let (z, x) = text.split_once(' ')?;
    let face = |name: &str| super::scenario::FACES.iter().find(|(n, _)| *n == name).map(|(_, face)| *face);
    let (z, x) = (face(z.strip_prefix("z-")?)?, face(x.strip_prefix("x-")?)?);
    LatticeRotation::all().find(|r| r.face(Face::Up) == z && r.face(Face::East) == x)
}

/// Parameters of the swarm that the checks of elements depend on.
pub struct Surroundings<'a> {
    pub floor: Floor,
    pub goals: &'a [Blueprint],
    pub motions: &'a Motions,
    pub strategy: Strategy,
    pub communication_range: u16,
}

/// Checks the elements, and generates their tables.
pub fn checked(
    raw: &[RawElement],
    around: &Surroundings<'_>,
    diagnostics: &mut Diagnostics,
) -> Option<Elements> {
    let Some(first) = raw.first() else { return Some(Elements::NONE) };
    if around.strategy != Strategy::Planned {
        diagnostics.add(first.place.clone(), MetamoduleError::ElementStrategy(around.strategy.name()));
    }
    let heads: Vec<Vec<Pose>> = around.goals.iter().map(|goal| heads(goal, around)).collect();
    let seeds = |goal: &Blueprint| goal.seeds().iter().flat_map(|s| s.cells()).collect::<Vec<Cell>>();
    let mut starts: Vec<Cell> = Vec::new();
    let mut ends: Vec<Vec<Cell>> = around.goals.iter().map(seeds).collect();
    let mut all = Vec::new();
    for element in raw {
        let shape = &element.shape.value.0;
        let start = element.at.value.cells(shape);
        let goals: Vec<Vec<Cell>> = element.to.value.0.iter().map(|to| to.cells(shape)).collect();
        let name = || element.name.clone();
        let mut complain = |place: &Place, error| diagnostics.add(place.clone(), error);
        if goals.len() != 1 && goals.len() != ends.len() {
            let (places, goals) = (goals.len(), ends.len());
            complain(&element.to.place, MetamoduleError::ElementGoals { places, goals });
        }
        if let Some(cell) = start.iter().find(|c| starts.contains(*c)) {
            complain(&element.at.place, MetamoduleError::ElementOverlap { name: name(), cell: *cell });
        }
        for (goal, taken) in goals.iter().cycle().zip(&ends) {
            if let Some(cell) = goal.iter().find(|c| taken.contains(*c)) {
                complain(&element.to.place, MetamoduleError::ElementOverlap { name: name(), cell: *cell });
            }
        }
        for cells in &goals {
            if let Some(cell) = cells.iter().find(|c| c.z < 0) {
                complain(&element.to.place, MetamoduleError::ElementBelowFloor { name: name(), cell: *cell });
            }
            if colours_differ(&start, cells) {
                complain(&element.to.place, MetamoduleError::ElementColour(name()));
            }
        }
        if let Some(cell) = start.iter().find(|c| c.z < 0) {
            complain(&element.at.place, MetamoduleError::ElementBelowFloor { name: name(), cell: *cell });
        }
        if !rests(&start, |c| around.floor.has(c.x, c.y)) {
            complain(&element.at.place, MetamoduleError::ElementNoRest(name()));
        }
        let side = |of: fn(&Cell) -> i16| {
            let values = shape.cells().iter().map(of);
            values.clone().max().unwrap_or(0) - values.min().unwrap_or(0) + 1
        };
        let longest = side(|c| c.x).max(side(|c| c.y)).max(side(|c| c.z)).unsigned_abs();
        let needed = REACH + longest;
        if around.communication_range < needed {
            complain(&element.place, MetamoduleError::ElementRange { name: name(), needed });
        }
        starts.extend(&start);
        ends.iter_mut().zip(goals.iter().cycle()).for_each(|(ends, goal)| ends.extend(goal));
        all.push(PassiveElement { name: name(), shape: shape.clone(), grams: element.grams, start, goals });
    }
    if !diagnostics.is_empty() {
        return None;
    }
    let made =
        Elements::new(around.motions.database(), around.motions.kind(), all, &heads, LoadLimits::NOMINAL);
    let made = diagnostics.note(&first.place, made.map_err(MetamoduleError::from))?;
    for (i, element) in raw.iter().enumerate() {
        let goals = 0..around.goals.len() as u8;
        let is_up = |goal: &u8| {
            let cells = made.all()[i].goal(*goal);
            made.lies(i, *goal) && !rests(cells, |c| around.floor.has(c.x, c.y))
        };
        if goals.clone().any(|goal| is_up(&goal)) {
            let name = made.all()[i].name.clone();
            diagnostics.add(element.to.place.clone(), MetamoduleError::ElementNoHead(name));
        }
    }
    Some(made)
}

/// Returns the poses in which metamodules fill the seeds of a goal.
fn heads(goal: &Blueprint, around: &Surroundings<'_>) -> Vec<Pose> {
    let mut poses = Vec::new();
    for seed in goal.seeds() {
        for class in 0..4 {
            let state = GridState::new(seed.foot.0, seed.foot.1, class);
            let chain = around.motions.chain_of(seed.cells().map(|c| to_frame(state, c)));
            let filling = chain.map_or(&[][..], |chain| around.motions.filling(chain));
            poses.extend(filling.iter().map(|posture| Pose::standing(state, *posture)));
        }
    }
    poses
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_are_two_directions() {
        assert_eq!(rotation(TURN), Some(LatticeRotation::IDENTITY));
        assert!(rotation("z-down x-north").is_some());
        for wrong in ["z-up x-down", "z-up", "up east", "z-top x-east", ""] {
            assert_eq!(rotation(wrong), None, "{wrong}");
        }
    }
}
