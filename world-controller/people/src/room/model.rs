//! Rooms: a floor of connectors with walls, doors and a store, and the pieces that stand in it.

use super::constraint::Constraint;
use super::form::Form;
use metamorph_protocol::lattice::Cell;
use serde::Serialize;
use std::sync::Arc;

/// Length of the edge of a cell in metres.
pub const CELL_M: f64 = 0.11;
/// Largest length of a side of a room, in connectors.
pub const MAX_SIDE: i16 = 256;
/// Layers of a room at most.
pub const MAX_HEIGHT: i16 = 64;
/// Largest number of pieces of a room.
pub const MAX_PIECES: usize = 128;

/// A rectangle of connectors, both corners included.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Area {
    /// The corner with the smallest coordinates.
    pub min: (i16, i16),
    /// The corner with the largest.
    pub max: (i16, i16),
}

impl Area {
    /// Whether a connector is in it.
    pub fn has(&self, (x, y): (i16, i16)) -> bool {
        (self.min.0..=self.max.0).contains(&x) && (self.min.1..=self.max.1).contains(&y)
    }
}

/// A box of cells, both corners included.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Block {
    /// The corner with the smallest coordinates.
    pub min: Cell,
    /// The corner with the largest.
    pub max: Cell,
}

impl Block {
    /// Whether a cell is in it.
    pub fn has(&self, cell: Cell) -> bool {
        let within = |c: i16, low: i16, high: i16| (low..=high).contains(&c);
        within(cell.x, self.min.x, self.max.x)
            && within(cell.y, self.min.y, self.max.y)
            && within(cell.z, self.min.z, self.max.z)
    }
    /// All its cells.
    pub fn cells(&self) -> impl Iterator<Item = Cell> + use<> {
        let Block { min, max } = *self;
        (min.z..=max.z).flat_map(move |z| {
            (min.y..=max.y).flat_map(move |y| (min.x..=max.x).map(move |x| Cell::new(x, y, z)))
        })
    }
    /// The number of its cells.
    pub fn volume(&self) -> usize {
        let side = |low: i16, high: i16| usize::from(high.abs_diff(low)) + 1;
        side(self.min.x, self.max.x) * side(self.min.y, self.max.y) * side(self.min.z, self.max.z)
    }
}

/// The colours of pieces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Colour {
    /// Red.
    Red,
    /// Yellow.
    Yellow,
    /// Green.
    Green,
    /// Blue.
    #[default]
    Blue,
    /// Violet.
    Violet,
}

impl Colour {
    /// Its name in files.
    pub const fn name(self) -> &'static str {
        match self {
            Colour::Red => "red",
            Colour::Yellow => "yellow",
            Colour::Green => "green",
            Colour::Blue => "blue",
            Colour::Violet => "violet",
        }
    }
}

/// The colours by their names in files.
pub const COLOURS: [(&str, Colour); 5] = {
    use Colour::{Blue, Green, Red, Violet, Yellow};
    [
        (Red.name(), Red),
        (Yellow.name(), Yellow),
        (Green.name(), Green),
        (Blue.name(), Blue),
        (Violet.name(), Violet),
    ]
};

/// Where a piece stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct Placement {
    /// The corner of its rectangle with the smallest coordinates.
    pub at: (i16, i16),
    /// Quarter turns, counterclockwise seen from above.
    pub turn: u8,
}

impl Placement {
    /// Returns how far another placement is: connectors along x and y, and two for a quarter turn.
    pub fn distance(self, other: Placement) -> u32 {
        let turns = (4 + self.turn - other.turn) % 4;
        let along = u32::from(self.at.0.abs_diff(other.at.0)) + u32::from(self.at.1.abs_diff(other.at.1));
        along + 2 * u32::from(turns.min(4 - turns))
    }
}

/// A piece of furniture.
#[derive(Clone, Debug)]
pub struct Piece {
    /// Its name.
    pub name: String,
    /// Form of the piece.
    pub form: Arc<Form>,
    /// Where it stands.
    pub place: Placement,
    /// Its colour.
    pub colour: Colour,
}

impl Piece {
    /// Its cells in the room.
    pub fn cells(&self) -> impl Iterator<Item = Cell> + '_ {
        let (x, y) = self.place.at;
        self.form.turned(self.place.turn).cells.iter().map(move |c| Cell::new(c.x + x, c.y + y, c.z))
    }
    /// The connectors below its cells.
    pub fn columns(&self) -> impl Iterator<Item = (i16, i16)> + '_ {
        let (x, y) = self.place.at;
        self.form.turned(self.place.turn).columns.iter().map(move |c| (c.0 + x, c.1 + y))
    }
    /// The rectangle around them.
    pub fn area(&self) -> Area {
        let ((x, y), size) = (self.place.at, self.form.turned(self.place.turn).size);
        Area { min: (x, y), max: (x + size.0 - 1, y + size.1 - 1) }
    }
    /// Twice the middle of its rectangle.
    pub fn centre2(&self) -> (i32, i32) {
        let Area { min, max } = self.area();
        (i32::from(min.0) + i32::from(max.0), i32::from(min.1) + i32::from(max.1))
    }
    /// The middle of its rectangle, in cells.
    pub fn centre(&self) -> [f64; 2] {
        let (x, y) = self.centre2();
        [f64::from(x) / 2.0, f64::from(y) / 2.0]
    }
    /// Where its front looks: south if it is not turned.
    pub fn front(&self) -> (i32, i32) {
        [(0, -1), (1, 0), (0, 1), (-1, 0)][usize::from(self.place.turn % 4)]
    }
}

/// A room.
#[derive(Clone, Debug)]
pub struct Room {
    /// Its name.
    pub name: Option<String>,
    /// Connectors along x and y.
    pub size: (i16, i16),
    /// Layers of cells.
    pub height: i16,
    /// Connectors at the doors.
    pub doors: Vec<(i16, i16)>,
    /// Where nothing may stand or move: pillars, walls within the room.
    pub keep_out: Vec<Block>,
    /// Where free metamodules wait.
    pub store: Option<Area>,
    /// Metamodules that are left when all is built.
    pub spare: usize,
    /// Pieces in the room.
    pub pieces: Vec<Piece>,
    /// Constraints on the pieces, in addition to `inside` and `apart`.
    pub constraints: Vec<Constraint>,
}

impl Room {
    /// Whether a connector is on its floor.
    pub fn has(&self, (x, y): (i16, i16)) -> bool {
        (0..self.size.0).contains(&x) && (0..self.size.1).contains(&y)
    }
    /// Returns where all pieces stand.
    pub fn placements(&self) -> Vec<Placement> {
        self.pieces.iter().map(|piece| piece.place).collect()
    }
    /// Puts all pieces where a list says.
    pub fn place(&mut self, placements: &[Placement]) {
        for (piece, place) in self.pieces.iter_mut().zip(placements) {
            piece.place = *place;
        }
    }
    /// Returns the number of the piece of this name.
    pub fn find(&self, name: &str) -> Option<usize> {
        self.pieces.iter().position(|piece| piece.name == name)
    }
    /// The connectors below keep-out boxes.
    pub fn kept_out(&self) -> impl Iterator<Item = (i16, i16)> + '_ {
        let column = |block: &Block| Block { max: Cell { z: block.min.z, ..block.max }, ..*block };
        self.keep_out.iter().flat_map(move |block| column(block).cells()).map(|c| (c.x, c.y))
    }
}
