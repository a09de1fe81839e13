//! The places where an element rests on the floor, and the ways to hold it there: what a transport needs that puts the
//! element down on its way.

use super::rest::rests;
use super::scene::{Foothold, Hold, NO_SET};
use super::terrain::world_cell;
use super::walking::WalkingGround;
use metamorph_core::lattice::{Cell, Face};
use metamorph_roombots::lattice_pose::LatticeRotation;
use std::collections::{BTreeSet, HashMap};

/// The number of a place.
pub type Place = u16;

/// The places of an element on the floor of a ground.
pub struct Resting {
    places: Vec<Vec<Cell>>,
    index: HashMap<Vec<Cell>, Place>,
    /// By place, the ways to hold the element there: the hold and the posture.
    holds: Vec<Vec<(Hold, u16)>>,
    /// By hold, the places where it can put the element down, with the posture.
    of: HashMap<Hold, Vec<(Place, u16)>>,
}

/// A posture with an element that rests: grip, posture, and the cells of the element, seen from the foot.
type Lying = (u8, u16, Vec<Cell>);

impl Resting {
    /// Creates the places from these on: their holds are given.
    pub fn of_places(given: impl IntoIterator<Item = (Vec<Cell>, Vec<(Hold, u16)>)>) -> Resting {
        let mut resting =
            Resting { places: Vec::new(), index: HashMap::new(), holds: Vec::new(), of: HashMap::new() };
        for (cells, holds) in given {
            if let Some(place) = resting.place(&cells) {
                for (hold, posture) in &holds {
                    resting.of.entry(*hold).or_default().push((place, *posture));
                }
                resting.holds[usize::from(place)] = holds;
            }
        }
        resting
    }

    /// Adds all places where the element rests on the floor and is in none of the cells `fixed`.
    pub fn add_floor(&mut self, ground: &WalkingGround<'_>, fixed: &[Cell]) {
        let (scene, fixed): (_, BTreeSet<Cell>) = (ground.scene(), fixed.iter().copied().collect());
        let floor = scene.terrain().connectors().iter().filter(|c| c.normal == Face::Up);
        let floor: BTreeSet<Cell> = floor.map(|c| Cell::new(c.half[0] / 2, c.half[1] / 2, 0)).collect();
        let given = self.places.len();
        let mut known: HashMap<(LatticeRotation, i16), Vec<Lying>> = HashMap::new();
        for foothold in (0..scene.footholds().len() as Foothold).filter(|f| ground.exists(*f)) {
            let foot = world_cell(scene.pose(foothold), Cell::default());
            let lying = known.entry((scene.pose(foothold).rotation, foot.z));
            let lying = lying.or_insert_with(|| lying_at(ground, foothold, foot));
            for (grip, posture, cells) in lying.iter() {
                let set = scene.holding(foothold, *grip)[usize::from(*posture)];
                let cells: Vec<Cell> = cells.iter().map(|c| *c + foot).collect();
                let is_free = |c: &Cell| !fixed.contains(c) && (c.z > 0 || floor.contains(c));
                if set == NO_SET || !cells.iter().all(is_free) {
                    continue;
                }
                let hold = Hold { foothold, grip: *grip, set };
                // The holds of places that were given are complete.
                if let Some(place) = self.place(&cells).filter(|p| usize::from(*p) >= given) {
                    self.holds[usize::from(place)].push((hold, *posture));
                    self.of.entry(hold).or_default().push((place, *posture));
                }
            }
        }
    }

    /// Returns the number of the place with these cells, sorted. There are at most 65,535.
    fn place(&mut self, cells: &[Cell]) -> Option<Place> {
        if let Some(place) = self.index.get(cells) {
            return Some(*place);
        }
        let place = Place::try_from(self.places.len()).ok().filter(|p| *p < Place::MAX)?;
        self.places.push(cells.to_vec());
        self.holds.push(Vec::new());
        self.index.insert(cells.to_vec(), place);
        Some(place)
    }

    /// Returns the place with these cells, sorted; `None` if there is no such place.
    pub fn find(&self, cells: &[Cell]) -> Option<Place> {
        self.index.get(cells).copied()
    }
    /// Returns the ways to hold the element at a place.
    pub fn holds(&self, place: Place) -> &[(Hold, u16)] {
        self.holds.get(usize::from(place)).map_or(&[], Vec::as_slice)
    }
    /// Returns the places where a hold can put the element down, with the posture.
    pub fn places_of(&self, hold: &Hold) -> &[(Place, u16)] {
        self.of.get(hold).map_or(&[], Vec::as_slice)
    }
}

/// Returns the postures in which a metamodule at a foothold holds the element where it rests, the floor being endless.
fn lying_at(ground: &WalkingGround<'_>, foothold: Foothold, foot: Cell) -> Vec<Lying> {
    let scene = ground.scene();
    let mut all = Vec::new();
    for (grip, carry) in (0..).zip(scene.carry()) {
        for posture in carry.valid_postures() {
            let Some(cells) = scene.held(foothold, grip, posture) else { continue };
            if rests(&cells, |_| true) {
                let back = Cell::new(-foot.x, -foot.y, -foot.z);
                all.push((grip, posture, cells.iter().map(|c| *c + back).collect()));
            }
        }
    }
    all
}
