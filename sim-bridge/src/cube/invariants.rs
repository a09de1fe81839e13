//! Invariants of all runs of cubes, besides those of all runs. Sources: protocol specification, invariants I1
//! to I8; thesis 4.1.2 for connectivity.

use metamorph_kernel::world::invariants::Invariant;
use metamorph_protocol::cube::message::Rank;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Face;
use std::fmt;

/// The body without all movers is connected.
pub const BODY_CONNECTED: Invariant = Invariant::new("body-connected");
/// A mover has a support that stays, at its start and at its destination.
pub const MOVER_SUPPORTED: Invariant = Invariant::new("mover-supported");
/// A parent has the better rank in the forest, and knows its child.
pub const PARENT_DESCENDS: Invariant = Invariant::new("parent-descends");
/// A finalized module is the seed or touches another finalized module of its goal.
pub const FINAL_GROWS: Invariant = Invariant::new("final-grows");
/// A module in reserve that moves has no children.
pub const MOVER_HAS_NO_DEPENDANTS: Invariant = Invariant::new("mover-has-no-dependants");
/// Following the attraction field of one version never leads in a circle.
pub const FIELD_LOOP_FREE: Invariant = Invariant::new("field-loop-free");
/// Each module keeps a cell for at most one other.
pub const RESERVED_ONCE: Invariant = Invariant::new("reserved-once");
/// A dead module, or one of those that hang together with it, touches a module that stays for it: it is finalized, or cannot
/// let go of it.
pub const DEAD_HELD: Invariant = Invariant::new("dead-held");
/// The holder of a dead module does not hang on it: it is finalized, or has the better rank.
pub const HOLDER_DESCENDS: Invariant = Invariant::new("holder-descends");
/// The best of all holders of a cluster of dead modules that have announced themselves, for one goal, stays.
pub const BEST_HOLDER_STAYS: Invariant = Invariant::new("best-holder-stays");
/// A module slides from a dead one onto a module that does not leave meanwhile.
pub const LANDING_STAYS: Invariant = Invariant::new("landing-stays");
/// In a closed epoch nothing moves but the called module.
pub const MOVES_ALONE: Invariant = Invariant::new("moves-alone");

/// Checks [`MOVES_ALONE`] for one mover, by the other modules that move.
pub fn moves_alone(others: &[ModuleId]) -> Result<(), String> {
    match others.first() {
        None => Ok(()),
        Some(other) => Err(format!("it moves in a closed epoch while module {other} moves")),
    }
}

/// Checks [`LANDING_STAYS`] for one slide: whether the module that it ends on waits for its turn until then.
pub fn landing_stays(stays: bool) -> Result<(), String> {
    if stays { Ok(()) } else { Err("it slides from a dead module onto one that may leave meanwhile".into()) }
}

/// Checks [`DEAD_HELD`] for one dead module, by the number of its neighbours that stay for it.
pub fn dead_held(holders: usize) -> Result<(), String> {
    if holders > 0 { Ok(()) } else { Err("no neighbour stays for it, and it is dead".into()) }
}

/// Checks [`HOLDER_DESCENDS`] for one holder: its rank, `None` if it is finalized, and the last rank of the
/// dead module, `None` if it was carried as a walker.
pub fn holder_descends(holder: Option<Rank>, dead: Option<Rank>) -> Result<(), String> {
    match (holder, dead) {
        (Some(holder), Some(dead)) if !holder.is_above(dead) => {
            Err(format!("it announces that it holds a dead module of {dead}, with {holder}"))
        }
        _ => Ok(()),
    }
}

/// Checks [`BEST_HOLDER_STAYS`] for the best holder of one cluster.
pub fn best_holder_stays(stays: bool) -> Result<(), String> {
    if stays { Ok(()) } else { Err("its best holder let go of it, and it is dead".into()) }
}

/// Checks [`PARENT_DESCENDS`] for one child: its rank, its parent's rank, and whether the parent has
/// registered it.
pub fn parent_descends(child: Rank, parent: Rank, registered: bool) -> Result<(), String> {
    match (parent.is_above(child), registered) {
        (true, true) => Ok(()),
        (false, _) => Err(format!("{child} has a parent of {parent}")),
        (_, false) => Err(format!("the parent of {parent} has not registered its child")),
    }
}

/// Checks [`FINAL_GROWS`] for one finalized module.
pub fn final_grows(is_seed: bool, final_neighbours: usize) -> Result<(), String> {
    if is_seed || final_neighbours > 0 { Ok(()) } else { Err("it touches no finalized module".into()) }
}

/// Checks [`MOVER_HAS_NO_DEPENDANTS`] for one mover in reserve.
pub fn mover_has_no_dependants(children: usize) -> Result<(), String> {
    if children == 0 { Ok(()) } else { Err(format!("it has {children} children")) }
}

/// Checks [`FIELD_LOOP_FREE`]: `next` leads from a node to its successor; a path of more than `bound` steps
/// is a circle.
pub fn field_loop_free<N: Copy + fmt::Debug>(
    start: N,
    bound: usize,
    next: impl Fn(N) -> Option<N>,
) -> Result<(), String> {
    let mut at = start;
    for _ in 0..bound {
        match next(at) {
            Some(n) => at = n,
            None => return Ok(()),
        }
    }
    Err(format!("more than {bound} steps from {start:?} without an end"))
}

/// Checks [`RESERVED_ONCE`] for the reservations of one module.
pub fn reserved_once(reservations: &[(Face, ModuleId)]) -> Result<(), String> {
    for (i, (face, origin)) in reservations.iter().enumerate() {
        if let Some((_, other)) = reservations[..i].iter().find(|(f, o)| f == face && o != origin) {
            return Err(format!("the cell outside {face:?} is kept for {other} and for {origin}"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::world::CubeWorld;
    use metamorph_kernel::world::World;
    use metamorph_kernel::world::invariants::ONE_MODULE_PER_CELL;
    use metamorph_protocol::cube::body::Move;
    use metamorph_protocol::ids::Revision;
    use metamorph_protocol::lattice::{Cell, Motion, MotionKind};
    use metamorph_protocol::time::{Span, Time};

    #[test]
    fn parent_descends_fires() {
        let rank = |rooted, label| Rank { rooted: Time(rooted), label };
        assert!(parent_descends(rank(1, 3), rank(1, 2), true).is_ok());
        assert!(parent_descends(rank(1, 3), rank(2, 9), true).is_ok());
        assert!(parent_descends(rank(1, 3), rank(1, 3), true).is_err());
        assert!(parent_descends(rank(1, 3), rank(0, 2), true).is_err());
        assert!(parent_descends(rank(1, 3), rank(1, 2), false).is_err());
    }

    #[test]
    fn dead_held_fires() {
        assert!(dead_held(1).is_ok());
        assert!(dead_held(0).is_err());
    }

    #[test]
    fn best_holder_stays_fires() {
        assert!(best_holder_stays(true).is_ok());
        assert!(best_holder_stays(false).is_err());
    }

    #[test]
    fn landing_stays_fires() {
        assert!(landing_stays(true).is_ok());
        assert!(landing_stays(false).is_err());
    }

    #[test]
    fn holder_descends_fires() {
        let rank = |rooted, label| Some(Rank { rooted: Time(rooted), label });
        assert!(holder_descends(None, rank(2, 3)).is_ok() && holder_descends(rank(2, 3), None).is_ok());
        assert!(holder_descends(rank(2, 9), rank(1, 1)).is_ok());
        assert!(holder_descends(rank(1, 1), rank(2, 9)).is_err());
    }

    #[test]
    fn final_grows_fires() {
        assert!(final_grows(true, 0).is_ok() && final_grows(false, 1).is_ok());
        assert!(final_grows(false, 0).is_err());
    }

    #[test]
    fn mover_has_no_dependants_fires() {
        assert!(mover_has_no_dependants(0).is_ok());
        assert!(mover_has_no_dependants(1).is_err());
    }

    #[test]
    fn field_loop_free_fires() {
        assert!(field_loop_free(5u8, 10, |n| n.checked_sub(1)).is_ok());
        assert!(field_loop_free(5u8, 10, |n| Some((n + 1) % 3)).is_err());
    }

    #[test]
    fn reserved_once_fires() {
        let (a, b) = (ModuleId(1), ModuleId(2));
        assert!(reserved_once(&[(Face::Up, a), (Face::Up, a), (Face::Down, b)]).is_ok());
        assert!(reserved_once(&[(Face::Up, a), (Face::Down, b), (Face::Up, b)]).is_err());
    }

    fn world(cells: &[[i16; 3]]) -> CubeWorld {
        let cells: Vec<Cell> = cells.iter().copied().map(Cell::from).collect();
        CubeWorld::new(&cells, Span::secs(1), 1)
    }

    fn act(world: &mut CubeWorld, id: u32, kind: MotionKind, support: Face, heading: Face) {
        let motion = Motion { kind, support, heading };
        let revision = Revision((0..6).filter(|f| contact(world, id, *f)).count() as u32);
        world.act(Time(0), ModuleId(id), revision, &Move { motion, not_after: Time(9) });
    }

    fn contact(world: &CubeWorld, id: u32, face: u8) -> bool {
        Face::from_index(face).is_some_and(|f| world.contact(ModuleId(id), f).is_some())
    }

    fn fired(world: &mut CubeWorld) -> Vec<Invariant> {
        world.take_violations().into_iter().map(|v| v.invariant).collect()
    }

    #[test]
    fn one_module_per_cell_fires() {
        assert_eq!(fired(&mut world(&[[0, 0, 0], [0, 0, 0]])), [ONE_MODULE_PER_CELL]);
    }

    /// The middle of a row of three slides up: the outer two are disconnected.
    #[test]
    fn body_connected_fires() {
        let mut row = world(&[[0, 0, 0], [1, 0, 0], [2, 0, 0]]);
        row.check_connected(Time(0));
        act(&mut row, 1, MotionKind::Convex, Face::West, Face::Up);
        assert_eq!(fired(&mut row), [BODY_CONNECTED]);
        let mut apart = world(&[[0, 0, 0], [2, 0, 0]]);
        apart.check_connected(Time(0));
        assert_eq!(fired(&mut apart), [BODY_CONNECTED]);
    }

    /// A module moves over a neighbour that is moving itself.
    #[test]
    fn mover_supported_fires() {
        let mut stack = world(&[[0, 0, 0], [0, 0, 1], [1, 0, 0], [2, 0, 0]]);
        act(&mut stack, 3, MotionKind::Convex, Face::West, Face::Up);
        assert_eq!(fired(&mut stack), []);
        let mut pair = world(&[[0, 0, 0], [1, 0, 0], [1, 1, 0], [2, 0, 0]]);
        act(&mut pair, 1, MotionKind::Convex, Face::West, Face::Up);
        assert!(fired(&mut pair).contains(&BODY_CONNECTED));
        act(&mut pair, 3, MotionKind::Convex, Face::West, Face::South);
        assert!(fired(&mut pair).contains(&MOVER_SUPPORTED));
    }
}
