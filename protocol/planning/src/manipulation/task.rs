//! The task of a transport: what is carried, by whom, from where to where.

use super::walking::Body;
use metamorph_core::lattice::Cell;

/// How many edges that cannot be carried out are taken out before the answer is [`Undecided`](super::transport::Answer::Undecided).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refutations {
    /// The first so many are taken out for where all metamodules stand then, those after them wherever metamodules stand.
    pub exact: usize,
    /// The number of all.
    pub most: usize,
}

impl Refutations {
    /// 200, all of them exact.
    pub const DEFAULT: Refutations = Refutations { exact: 200, most: 200 };
}

/// The transport of one element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Task {
    /// The metamodules.
    pub bodies: Vec<Body>,
    /// The cells of the element at the start, sorted.
    pub start: Vec<Cell>,
    /// The metamodule that holds it there, with its grip; `None` if it is at rest.
    pub held_by: Option<(u8, u8)>,
    /// The cells where a metamodule shall hold it.
    pub goal: Vec<Cell>,
    /// If given, the metamodule that holds it then must be in the cells of one of these, from the foot on.
    pub ends: Option<Vec<[Cell; 4]>>,
    /// The element may be put down on the floor on the way.
    pub puts_down: bool,
    /// The element rests at the goal in the end, and is not held. Then it may be put down on the way as well.
    pub rests: bool,
    /// Cells that nothing may enter, besides those behind the planes.
    pub fixed: Vec<Cell>,
    /// The weight of the lower bound in hundredths; 100 for a plan that is minimal in the relaxed graph.
    pub weight: u32,
    /// The edges that are taken out at most.
    pub refutations: Refutations,
}

impl Task {
    /// Creates the task to bring an element that is at rest to a goal, where any metamodule may hold it.
    pub fn new(bodies: Vec<Body>, start: Vec<Cell>, goal: Vec<Cell>, weight: u32) -> Task {
        Task {
            bodies,
            start,
            held_by: None,
            goal,
            ends: None,
            puts_down: false,
            rests: false,
            fixed: Vec::new(),
            weight,
            refutations: Refutations::DEFAULT,
        }
    }
}
