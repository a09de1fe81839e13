//! Structures of metamodules and elements (thesis appendix B): in which order they are built.
//!
//! A structure has *items*: seats, each for one metamodule, and pieces, the elements. A [`removal`] search takes the
//! finished structure apart, bundle by bundle, so that what stands is stable at any time; reversed this is an order of
//! assembly. [`assembly`] carries that order out from where metamodules and elements are. A bundle that it cannot
//! place is not taken again, and the search begins again. [`isolation`] has the graphs of thesis B.3, and the order
//! of B.5, which asks no planner.

pub mod assembly;
pub mod isolation;
pub mod removal;
#[cfg(test)]
mod tests;

use super::carry::{CarryTable, held_by};
use super::contact::ElementSweeper;
use super::element::{Element, Grip};
use super::load::{LoadLimits, LoadTable, Peak, standing_peak};
use super::rest::rests;
use super::scene::{Foothold, Hold, NO_SET, Scene, hand_overs};
use super::terrain::{Terrain, world_cell};
use super::transport::TransportReason;
use super::walking::Body;
use crate::plan::and_or::Items;
use metamorph_core::lattice::{Cell, Face};
use metamorph_roombots::Kind;
use metamorph_roombots::database::Database;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The four cells of a metamodule in the structure, from the foot on.
pub type Seat = [Cell; 4];

/// An element of a structure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Its shape.
    pub shape: Element,
    /// Its mass in grams.
    pub grams: u32,
    /// The cells where it rests at the start, sorted.
    pub start: Vec<Cell>,
    /// The cells where it is in the end, sorted.
    pub goal: Vec<Cell>,
}

/// Data that all parts of a structure share.
#[derive(Clone, Debug)]
pub struct Site {
    /// The motions.
    pub database: Arc<Database>,
    /// The kind of the metamodules.
    pub kind: Kind,
    /// The floor.
    pub floor: Terrain,
    /// The limits of torque.
    pub limits: LoadLimits,
}

/// The grips that are examined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grips {
    /// Those of metamodules in seats, with the elements at their goals; all of an element that is not held there.
    OfSeats,
    /// All.
    All,
}

/// An element with the graphs of the floor for it.
pub struct Piece {
    part: Part,
    scene: Scene,
    /// By grip.
    loads: Vec<LoadTable>,
    /// All ways to hold it at its goal.
    holds: Vec<(Hold, u16)>,
    /// True if all grips and all hand-overs are known.
    is_complete: bool,
}

/// A structure, and all that metamodules can do with its parts.
pub struct Structure {
    site: Site,
    seats: Vec<Seat>,
    pieces: Vec<Piece>,
    /// For each seat the poses that fill it.
    fillings: Vec<Vec<Body>>,
}

/// Why a bundle cannot be taken away or placed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reason {
    /// No metamodule that stands then holds this piece.
    NotHeld(usize),
    /// This piece is too heavy for one that would hold it.
    TooHeavy(usize),
    /// The metamodule has no way out from among what stands.
    NoWayOut,
    /// The metamodule cannot carry the piece away.
    NoCarry,
    /// No further metamodule can take the piece away.
    NoCarrier,
    /// There is no transport from where the piece is at the start.
    Transport(TransportReason),
    /// No transport, or no walk, was found.
    NotFound,
    /// There are fewer metamodules than seats.
    TooFew,
}

impl Reason {
    /// Returns the name in answers.
    pub const fn name(self) -> &'static str {
        match self {
            Reason::NotHeld(_) => "not-held",
            Reason::TooHeavy(_) => "too-heavy",
            Reason::NoWayOut => "no-way-out",
            Reason::NoCarry => "no-carry",
            Reason::NoCarrier => "no-carrier",
            Reason::Transport(reason) => reason.name(),
            Reason::NotFound => "not-found",
            Reason::TooFew => "too-few",
        }
    }
}

impl Piece {
    fn new(site: &Site, part: Part, seats: &[Seat], grips: Grips, sweeper: &mut ElementSweeper) -> Piece {
        let table = site.database.table(site.kind);
        let all = part.shape.grips();
        let of_seats: Vec<&Grip> = all.iter().filter(|g| is_of_seats(site, &part, seats, g)).collect();
        let used = if grips == Grips::All || of_seats.is_empty() { all.iter().collect() } else { of_seats };
        let carry: Vec<CarryTable> =
            used.iter().map(|grip| CarryTable::new(&site.database, site.kind, grip, sweeper)).collect();
        let loads: Vec<LoadTable> =
            carry.iter().map(|carry| LoadTable::new(table, carry, Face::Down)).collect();
        let within = |(grip, (carry, loads)): (u8, (&CarryTable, &LoadTable))| {
            let steps = 0..carry.steps().len();
            let steps = steps.map(|step| loads.peak(step, part.grams).within(site.limits));
            ((grip, Face::Down), steps.collect())
        };
        let within = (0..).zip(carry.iter().zip(&loads)).map(within).collect();
        // Tables of hand-overs grow with the square of the number of grips.
        let handovers = match all.len() {
            1 => hand_overs(table, &part.shape, &carry),
            _ => BTreeMap::new(),
        };
        let is_complete = all.len() == 1;
        let scene =
            Scene::of_tables(Arc::clone(&site.database), carry, within, handovers, site.floor.clone());
        let holds = match loads.is_empty() {
            true => Vec::new(),
            false => scene.holds_at(&part.goal),
        };
        Piece { part, scene, loads, holds, is_complete }
    }

    /// Returns the element.
    pub fn part(&self) -> &Part {
        &self.part
    }

    /// Returns the torques of a metamodule that stands in a hold.
    fn standing(&self, hold: Hold, posture: u16) -> Peak {
        let carry = &self.scene.carry()[usize::from(hold.grip)];
        standing_peak(self.scene.table(), carry, Face::Down, posture, self.part.grams)
    }
}

/// Returns true if a metamodule in a seat has this grip of the element at its goal.
fn is_of_seats(site: &Site, part: &Part, seats: &[Seat], grip: &Grip) -> bool {
    let table = site.database.table(site.kind);
    let feet = site.floor.footholds();
    let holds = |seat: &Seat| {
        let here = feet.iter().filter(|foot| world_cell(**foot, Cell::default()) == seat[0]);
        here.into_iter().any(|foot| {
            table.postures().iter().any(|entry| {
                let placement = entry.posture.placement();
                let fills = placement.cells.iter().zip(seat).all(|(c, s)| world_cell(*foot, *c) == *s);
                fills
                    && held_by(&placement, grip).is_some_and(|cells| {
                        let mut cells: Vec<Cell> = cells.iter().map(|c| world_cell(*foot, *c)).collect();
                        cells.sort_unstable();
                        cells == part.goal
                    })
            })
        })
    };
    seats.iter().any(holds)
}

impl Structure {
    /// Creates a structure of these seats and elements; `None` if there is no element, or there are too many items.
    pub fn new(site: Site, seats: Vec<Seat>, parts: Vec<Part>, grips: Grips) -> Option<Structure> {
        if parts.is_empty() || seats.len() + parts.len() > Items::MAX {
            return None;
        }
        let mut sweeper = ElementSweeper::new();
        let pieces: Vec<Piece> =
            parts.into_iter().map(|part| Piece::new(&site, part, &seats, grips, &mut sweeper)).collect();
        let mut structure = Structure { site, seats, pieces, fillings: Vec::new() };
        structure.fillings = (0..structure.seats.len()).map(|seat| structure.find_fillings(seat)).collect();
        Some(structure)
    }

    fn find_fillings(&self, seat: usize) -> Vec<Body> {
        let (scene, cells) = (self.scene(), &self.seats[seat]);
        let feet = (0..scene.footholds().len() as Foothold)
            .filter(|f| world_cell(scene.pose(*f), Cell::default()) == cells[0]);
        let postures = 0..scene.table().postures().len() as u16;
        let all = feet.flat_map(|foothold| postures.clone().map(move |posture| Body { foothold, posture }));
        let is_valid = |b: &Body| scene.empty(b.foothold)[usize::from(b.posture)] != NO_SET;
        all.filter(|b| is_valid(b) && scene.body(b.foothold, b.posture) == *cells).collect()
    }

    /// Returns the graphs of the floor, which are the same for all pieces but for what is carried.
    fn scene(&self) -> &Scene {
        &self.pieces[0].scene
    }
    /// Returns the limits of torque, and what the parts have in common.
    pub fn site(&self) -> &Site {
        &self.site
    }
    /// Returns the seats.
    pub fn seats(&self) -> &[Seat] {
        &self.seats
    }
    /// Returns the pieces.
    pub fn pieces(&self) -> &[Piece] {
        &self.pieces
    }
    /// Returns the number of the foothold with this pose of the foot, if it is on the floor.
    pub fn foothold(&self, pose: metamorph_roombots::lattice_pose::LatticePose) -> Option<Foothold> {
        (0..).zip(self.scene().footholds()).find(|(_, p)| **p == pose).map(|(i, _)| i)
    }
    /// Returns all items: the seats, then the pieces.
    pub fn whole(&self) -> Items {
        Items::first(self.seats.len() + self.pieces.len())
    }
    /// Returns the item that a piece is.
    pub fn item_of(&self, piece: usize) -> usize {
        self.seats.len() + piece
    }
    /// Returns the seats of a set of items.
    pub fn seats_in(&self, items: Items) -> impl Iterator<Item = usize> + use<> {
        let n = self.seats.len();
        items.iter().filter(move |i| *i < n)
    }
    /// Returns the pieces of a set of items.
    pub fn pieces_in(&self, items: Items) -> impl Iterator<Item = usize> + use<> {
        let n = self.seats.len();
        items.iter().filter(move |i| *i >= n).map(move |i| i - n)
    }
    /// Returns the cells of items that stand at their goals.
    fn cells_of(&self, items: Items) -> impl Iterator<Item = Cell> + '_ {
        let seats = self.seats_in(items).flat_map(|seat| self.seats[seat]);
        seats.chain(self.pieces_in(items).flat_map(|piece| self.pieces[piece].part.goal.iter().copied()))
    }

    /// Returns the ways in which a metamodule in a seat holds a piece at its goal.
    fn holds(&self, piece: usize, seat: usize) -> impl Iterator<Item = (Hold, u16)> + '_ {
        let (scene, cells) = (self.scene(), self.seats[seat]);
        let all = self.pieces[piece].holds.iter().copied();
        all.filter(move |(hold, posture)| scene.body(hold.foothold, *posture) == cells)
    }
    /// Returns the ways in which a metamodule in a seat holds a piece at its goal within the limits of torque.
    fn holds_within(&self, piece: usize, seat: usize) -> impl Iterator<Item = (Hold, u16)> + '_ {
        let within = move |(hold, posture): &(Hold, u16)| {
            self.pieces[piece].standing(*hold, *posture).within(self.site.limits)
        };
        self.holds(piece, seat).filter(within)
    }
    /// Returns true if the head of a metamodule in a seat faces a port of a piece at its goal.
    pub fn is_bond(&self, piece: usize, seat: usize) -> bool {
        self.holds(piece, seat).next().is_some()
    }

    /// Returns true if a piece rests on the floor at its goal.
    fn lies(&self, piece: usize) -> bool {
        let floor = self.site.floor.connectors();
        rests(&self.pieces[piece].part.goal, |c| floor.iter().any(|g| g.half == [2 * c.x, 2 * c.y, 0]))
    }

    /// Checks that a set of items stands: each piece rests or is held by a metamodule in a seat, and no metamodule that holds it would
    /// exceed its limits of torque if it held it alone. Seats stand on the floor.
    ///
    /// # Errors
    /// If it does not stand, with the reason.
    pub fn stable(&self, items: Items) -> Result<(), Reason> {
        for piece in self.pieces_in(items) {
            let holders: Vec<usize> =
                self.seats_in(items).filter(|seat| self.is_bond(piece, *seat)).collect();
            if holders.is_empty() && !self.lies(piece) {
                return Err(Reason::NotHeld(piece));
            }
            if holders.iter().any(|seat| self.holds_within(piece, *seat).next().is_none()) {
                return Err(Reason::TooHeavy(piece));
            }
        }
        Ok(())
    }
}
