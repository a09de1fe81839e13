//! The reach of metamodules: whether they get from the store to the places of all pieces, and in which order pieces can
//! be built.
//!
//! Motions can be reversed, so a metamodule can be put in place while others stand exactly if it can leave while they
//! stand. What can leave while some pieces stand can leave while fewer do: taking away whatever can leave finds an
//! order if there is one, and no choice has to be taken back.

use super::constraint::{Constraint, Found, Rule, Violation, violation};
use super::model::{Area, Block, Piece, Room};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::Seed;
use metamorph_protocol::metamodule::motions::Motions;
use metamorph_protocol::metamodule::params::Floor;

/// A piece in the order of building.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stage {
    /// The piece.
    pub piece: usize,
    /// Its places in the room, level by level: a level needs those before it.
    pub levels: Vec<Vec<Seed>>,
}

/// Why there is no order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Blocked {
    /// The pieces of which none can be the last one; empty if the room has no store.
    pub pieces: Vec<usize>,
    /// The first places of theirs that cannot be reached while the others stand.
    pub cells: Vec<Cell>,
}

/// Finds the order in which the pieces can be built from the store.
///
/// # Errors
/// If there is none, with the pieces that block each other.
pub fn order(room: &Room, motions: &Motions) -> Result<Vec<Stage>, Blocked> {
    order_while(room, motions, &|| true)
}

/// Finds the order in which the pieces can be built, while `going` holds: afterwards nothing leaves any more, so that
/// the answer says nothing.
///
/// # Errors
/// If there is none.
pub fn order_while(room: &Room, motions: &Motions, going: &dyn Fn() -> bool) -> Result<Vec<Stage>, Blocked> {
    let store = room.store.ok_or(Blocked { pieces: Vec::new(), cells: Vec::new() })?;
    let (x, y) = room.size;
    let of = Disassembly { room, motions, store, floor: Floor { min: (0, 0), max: (x - 1, y - 1) }, going };
    let mut standing: Vec<usize> = (0..room.pieces.len()).collect();
    // The nearest to the store is built last, if it can be.
    standing.sort_by_key(|p| (from_store(&room.pieces[*p], store), *p));
    let mut stages = Vec::new();
    while !standing.is_empty() {
        let mut cells = Vec::new();
        let last = standing.iter().enumerate().find_map(|(i, piece)| {
            let others = standing.iter().filter(|other| *other != piece);
            let stage = of.take_away(*piece, others.copied());
            stage.map_err(|seed| cells.extend(seed.cells())).ok().map(|stage| (i, stage))
        });
        match last {
            Some((i, stage)) => {
                standing.remove(i);
                stages.push(stage);
            }
            None => {
                standing.sort_unstable();
                return Err(Blocked { pieces: standing, cells });
            }
        }
    }
    stages.reverse();
    Ok(stages)
}

/// Returns the violations of all `reach` constraints.
pub fn check(room: &Room, motions: &Motions) -> Vec<Violation> {
    check_while(room, motions, &|| true)
}

/// Returns the violations of all `reach` constraints, if they are known before `going` no longer holds.
pub fn check_while(room: &Room, motions: &Motions, going: &dyn Fn() -> bool) -> Vec<Violation> {
    let all = room.constraints.iter().enumerate();
    let asked: Vec<(usize, &Constraint)> = all.filter(|(_, c)| c.rule == Rule::Reach).collect();
    let blocked = asked.first().and_then(|_| order_while(room, motions, going).err());
    let Some(blocked) = blocked.filter(|_| going()) else { return Vec::new() };
    let names: Vec<&str> = blocked.pieces.iter().map(|p| room.pieces[*p].name.as_str()).collect();
    let why = match &names[..] {
        [] => "the room has no store for metamodules to come from".to_owned(),
        [one] => format!("metamodules do not reach all places of {one} from the store"),
        _ => format!("none of these can be built last, as the others are in the way: {}", names.join(", ")),
    };
    let found = || Found { movers: blocked.pieces.clone(), cells: blocked.cells.clone(), why: why.clone() };
    asked.into_iter().map(|(i, constraint)| violation(room, Some(i + 1), constraint, found())).collect()
}

/// Returns the distance of a piece from the store, in connectors along x and y.
fn from_store(piece: &Piece, store: Area) -> u32 {
    let Area { min, max } = piece.area();
    let along = |low: i16, high: i16, from: i16, until: i16| {
        u32::from(low.saturating_sub(until).max(from.saturating_sub(high)).max(0).unsigned_abs())
    };
    along(min.0, max.0, store.min.0, store.max.0) + along(min.1, max.1, store.min.1, store.max.1)
}

struct Disassembly<'a> {
    room: &'a Room,
    motions: &'a Motions,
    store: Area,
    floor: Floor,
    going: &'a dyn Fn() -> bool,
}

impl Disassembly<'_> {
    /// Takes a piece away while others stand: its levels from the last to the first, of each whatever can leave. The
    /// error is the first place that nothing can leave.
    fn take_away(&self, piece: usize, others: impl Iterator<Item = usize>) -> Result<Stage, Seed> {
        let kept_out = self.room.keep_out.iter().flat_map(Block::cells);
        let fixed: Vec<Cell> =
            others.flat_map(|p| self.room.pieces[p].cells().collect::<Vec<_>>()).chain(kept_out).collect();
        let declared = seeds(&self.room.pieces[piece]);
        let mut levels = Vec::new();
        for (i, level) in declared.iter().enumerate().rev() {
            let below: Vec<Cell> = declared[..i].iter().flatten().flat_map(Seed::cells).collect();
            let mut left = level.clone();
            while !left.is_empty() {
                let leaves = |seed: &Seed| {
                    let beside = left.iter().filter(|other| *other != seed).flat_map(Seed::cells);
                    let taken: Vec<Cell> = fixed.iter().chain(&below).copied().chain(beside).collect();
                    let may_go_on = (self.going)();
                    may_go_on
                        && self.motions.distances(self.floor, *seed, &taken).reach(|at| self.store.has(at))
                };
                let step: Vec<Seed> = left.iter().copied().filter(leaves).collect();
                match step.is_empty() {
                    true => return Err(left[0]),
                    false => left.retain(|seed| !step.contains(seed)),
                }
                levels.push(step);
            }
        }
        levels.reverse();
        Ok(Stage { piece, levels })
    }
}

/// The places of a piece's metamodules in the room.
fn seeds(piece: &Piece) -> Vec<Vec<Seed>> {
    let (x, y) = piece.place.at;
    let placed = |seed: &Seed| Seed { foot: (seed.foot.0 + x, seed.foot.1 + y), ..*seed };
    piece
        .form
        .turned(piece.place.turn)
        .levels
        .iter()
        .map(|level| level.iter().map(placed).collect())
        .collect()
}
