//! The form of a piece: its cells, and the metamodules that fill them, in four rotations.

use metamorph_protocol::lattice::{Cell, Face};
use metamorph_protocol::metamodule::blueprint::{Seed, box_of_four, chair_of_six};
use metamorph_protocol::pairing::pins::Pin;
use metamorph_protocol::pairing::split::{Footing, NoSplit, Split};
use metamorph_protocol::pairing::{Pairing, PairingError};
use thiserror::Error;

/// Cells of a piece at most.
pub const MAX_CELLS: usize = 512;

/// The pieces that are known by name, with their seeds.
pub const SHAPES: [(&str, Library); 2] = [("box", box_of_four), ("chair", chair_of_six)];
type Library = fn(i16, i16) -> Vec<Vec<Seed>>;

/// Why cells are no piece.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum FormError {
    /// Too many.
    #[error("a piece has at most {MAX_CELLS} cells, this one has {0}")]
    TooMany(usize),
    /// The cells are no structure.
    #[error(transparent)]
    Pairing(#[from] PairingError),
    /// The cells are no metamodules.
    #[error("metamodules do not make this piece: {0}")]
    Split(&'static str),
}

/// A form in one of its turns: its smallest coordinates are 0.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Turned {
    /// Its cells, in ascending order of (z, y, x).
    pub cells: Vec<Cell>,
    /// The connectors below them, each once.
    pub columns: Vec<(i16, i16)>,
    /// Connectors along x and y.
    pub size: (i16, i16),
    /// The metamodules that fill it, level by level.
    pub levels: Vec<Vec<Seed>>,
}

/// The form of a piece in its four rotations.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Form {
    turns: [Turned; 4],
    /// Layers of cells.
    pub height: i16,
}

impl Form {
    /// A form of the thesis.
    pub fn library(make: Library) -> Form {
        Form::of_levels(make(0, 0))
    }
    /// A form whose cells are to be split into metamodules; the cells of each pin are in one module.
    ///
    /// # Errors
    /// Refuses cells that are no structure, or that metamodules do not make.
    pub fn of_cells(cells: &[Cell], pins: &[Pin]) -> Result<Form, FormError> {
        if cells.len() > MAX_CELLS {
            return Err(FormError::TooMany(cells.len()));
        }
        let floor = cells.iter().map(|c| c.z).min().unwrap_or(0);
        let lowered = |c: Cell| Cell { z: c.z - floor, ..c };
        let standing: Vec<Cell> = cells.iter().copied().map(lowered).collect();
        let pins: Vec<Pin> = pins.iter().map(|pin| pin.map(lowered)).collect();
        let chains = match Pairing::pinned(&standing, &pins)?.split(Footing::Floor) {
            Split::Yes(chains) => chains,
            Split::No(reason) => return Err(FormError::Split(why(&reason))),
            Split::Undecided => return Err(FormError::Split("the search for a split has ended without one")),
        };
        let seeds: Option<Vec<Seed>> = chains.into_iter().map(seed).collect();
        // Invariant: a standing chain has an end in the lowest layer, and its cells share faces.
        seeds.map(|seeds| Form::of_levels(vec![seeds])).ok_or(FormError::Split("a chain does not stand"))
    }

    fn of_levels(levels: Vec<Vec<Seed>>) -> Form {
        let turned = |turn| Turned::of(&levels, turn);
        let turns = [turned(0), turned(1), turned(2), turned(3)];
        let height = turns[0].cells.iter().map(|c| c.z + 1).max().unwrap_or(0);
        Form { turns, height }
    }
    /// The form after some quarter turns.
    pub fn turned(&self, turn: u8) -> &Turned {
        &self.turns[usize::from(turn % 4)]
    }
    /// The number of metamodules.
    pub fn metamodules(&self) -> usize {
        self.turns[0].levels.iter().map(Vec::len).sum()
    }
}

impl Turned {
    fn of(levels: &[Vec<Seed>], turn: u8) -> Turned {
        let levels: Vec<Vec<Seed>> =
            levels.iter().map(|level| level.iter().map(|s| turned(*s, turn)).collect()).collect();
        let all = || levels.iter().flatten().flat_map(Seed::cells);
        let (x, y) = (all().map(|c| c.x).min().unwrap_or(0), all().map(|c| c.y).min().unwrap_or(0));
        let mut cells: Vec<Cell> = all().map(|c| Cell::new(c.x - x, c.y - y, c.z)).collect();
        cells.sort_unstable_by_key(|c| (c.z, c.y, c.x));
        let mut columns: Vec<(i16, i16)> = cells.iter().map(|c| (c.x, c.y)).collect();
        columns.sort_unstable();
        columns.dedup();
        let most = |along: fn(&Cell) -> i16| cells.iter().map(along).max().unwrap_or(0) + 1;
        let size = (most(|c| c.x), most(|c| c.y));
        let levels = levels.into_iter().map(|level| {
            level.into_iter().map(|s| Seed { foot: (s.foot.0 - x, s.foot.1 - y), ..s }).collect()
        });
        Turned { levels: levels.collect(), cells, columns, size }
    }
}

/// Turns a seed about the origin, counterclockwise seen from above.
fn turned(seed: Seed, turn: u8) -> Seed {
    let quarter = |s: Seed| Seed {
        foot: (-s.foot.1, s.foot.0),
        directions: s.directions.map(|face| match face {
            Face::East => Face::North,
            Face::North => Face::West,
            Face::West => Face::South,
            Face::South => Face::East,
            upright => upright,
        }),
    };
    (0..turn % 4).fold(seed, |s, _| quarter(s))
}

/// A chain of cells as the place of a metamodule: from the end that stands on the floor.
fn seed(mut chain: [Cell; 4]) -> Option<Seed> {
    if chain[0].z != 0 {
        chain.reverse();
    }
    let face = Cell::face_to;
    let directions = [face(chain[0], chain[1])?, face(chain[1], chain[2])?, face(chain[2], chain[3])?];
    (chain[0].z == 0).then_some(Seed { foot: (chain[0].x, chain[0].y), directions })
}

fn why(reason: &NoSplit) -> &'static str {
    match reason {
        NoSplit::Count(_) => "the number of its cells is not a multiple of four",
        NoSplit::Unpaired(_) => "some of its cells have no partner",
        NoSplit::TooHigh(_) => "it is more than four layers high",
        NoSplit::TooFewFeet { .. } => "it has too few cells in its lowest layer, where metamodules stand",
        NoSplit::Exhausted => "every split was tried",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_turns_are_none_and_keep_the_seeds_on_the_cells() {
        let chair = Form::library(chair_of_six);
        assert_eq!((chair.metamodules(), chair.height), (6, 4));
        for turn in 0..4 {
            let form = chair.turned(turn);
            let mut filled: Vec<Cell> = form.levels.iter().flatten().flat_map(Seed::cells).collect();
            filled.sort_unstable_by_key(|c| (c.z, c.y, c.x));
            assert_eq!(filled, form.cells, "turn {turn}");
            assert_eq!(form.size, if turn % 2 == 0 { (3, 4) } else { (4, 3) });
            assert!(form.cells.iter().all(|c| c.x >= 0 && c.y >= 0));
        }
        assert_eq!(Turned::of(&chair.turned(3).levels, 1), *chair.turned(0));
        // The back, the only part four layers high, is at the north, and turns west.
        let back = |turn| {
            chair.turned(turn).cells.iter().filter(|c| c.z == 3).map(|c| (c.x, c.y)).collect::<Vec<_>>()
        };
        assert_eq!((back(0), back(1)), (vec![(0, 3), (2, 3)], vec![(0, 0), (0, 2)]));
    }

    #[test]
    fn drawings_become_metamodules_or_say_why_not() {
        let tower = |n: i16| (0..n).map(|z| Cell::new(5, -7, z + 2)).collect::<Vec<_>>();
        let form = Form::of_cells(&tower(4), &[]).unwrap();
        assert_eq!(form.turned(0).levels, [[Seed { foot: (0, 0), directions: [Face::Up; 3] }]]);
        for (cells, why) in [(tower(5), "multiple of four"), (tower(8), "four layers high")] {
            let error = Form::of_cells(&cells, &[]).unwrap_err().to_string();
            assert!(error.contains(why), "{error}");
        }
        let inner = [Cell::new(5, -7, 3), Cell::new(5, -7, 4)];
        assert!(
            matches!(Form::of_cells(&tower(4), &[inner]), Err(FormError::Split(why)) if why.contains("no partner"))
        );
        let apart = [Cell::new(0, 0, 0), Cell::new(9, 0, 0)];
        assert!(matches!(
            Form::of_cells(&apart, &[]),
            Err(FormError::Pairing(PairingError::Disconnected { .. }))
        ));
        assert_eq!(Form::of_cells(&vec![Cell::new(0, 0, 0); 513], &[]), Err(FormError::TooMany(513)));
    }
}
