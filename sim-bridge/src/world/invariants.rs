//! What must hold in every run, one named check each.
//!
//! The checks are functions of plain values, so that each can be shown to fire on a made-up
//! violation; worlds and audits call them on the real thing. Sources: protocol specification,
//! invariants I1 to I8; thesis 4.1.2 for connectivity.

use metamorph_protocol::counters::Class;
use metamorph_protocol::counters::Tally;
use metamorph_protocol::cube::message::Rank;
use metamorph_protocol::ids::{ModuleId, Session};
use metamorph_protocol::lattice::{Cell, Face};
use metamorph_protocol::time::{Span, Time};
use serde::Serialize;
use std::fmt;

/// Something that must always hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Invariant {
    /// No two modules are in one cell.
    OneModulePerCell,
    /// The body without all movers is connected.
    BodyConnected,
    /// A mover has a support that stays, where it starts and where it lands.
    MoverSupported,
    /// A parent has the better rank in the forest, and knows its child.
    ParentDescends,
    /// A finalized module is the seed or touches another finalized module of its goal.
    FinalGrows,
    /// A module in reserve that moves has no children.
    MoverHasNoDependants,
    /// A move ends before the grants it rests on.
    MoveWithinLease,
    /// Following the attraction field of one version never leads in a circle.
    FieldLoopFree,
    /// A message is only taken in the contact session that exists.
    SessionCurrent,
    /// A cell is kept for one module at a time by each module that touches it.
    ReservedOnce,
    /// Message counts add up.
    MessagesBalance,
    /// A metamodule is attached to a connector of the floor by at least one end.
    Attached,
    /// A cell is locked by one metamodule at a time.
    OneHolderPerLock,
    /// Time goes on: at one instant there is an end to what modules hear, feel and are told.
    TimePasses,
}

impl Invariant {
    /// Every invariant.
    pub const ALL: [Invariant; 14] = [
        Invariant::OneModulePerCell,
        Invariant::BodyConnected,
        Invariant::MoverSupported,
        Invariant::ParentDescends,
        Invariant::FinalGrows,
        Invariant::MoverHasNoDependants,
        Invariant::MoveWithinLease,
        Invariant::FieldLoopFree,
        Invariant::SessionCurrent,
        Invariant::ReservedOnce,
        Invariant::MessagesBalance,
        Invariant::Attached,
        Invariant::OneHolderPerLock,
        Invariant::TimePasses,
    ];

    /// The name used in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Invariant::OneModulePerCell => "one-module-per-cell",
            Invariant::BodyConnected => "body-connected",
            Invariant::MoverSupported => "mover-supported",
            Invariant::ParentDescends => "parent-descends",
            Invariant::FinalGrows => "final-grows",
            Invariant::MoverHasNoDependants => "mover-has-no-dependants",
            Invariant::MoveWithinLease => "move-within-lease",
            Invariant::FieldLoopFree => "field-loop-free",
            Invariant::SessionCurrent => "session-current",
            Invariant::ReservedOnce => "reserved-once",
            Invariant::MessagesBalance => "messages-balance",
            Invariant::Attached => "attached",
            Invariant::OneHolderPerLock => "one-holder-per-lock",
            Invariant::TimePasses => "time-passes",
        }
    }
}

impl fmt::Display for Invariant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// An invariant that did not hold.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Violation {
    /// Which one.
    pub invariant: Invariant,
    /// When.
    pub at: Time,
    /// What was seen.
    pub what: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} at {}: {}", self.invariant, self.at, self.what)
    }
}

/// [`Invariant::ParentDescends`] for one child: its rank, its parent's rank, and whether the
/// parent has registered it.
pub fn parent_descends(child: Rank, parent: Rank, registered: bool) -> Result<(), String> {
    match (parent.is_above(child), registered) {
        (true, true) => Ok(()),
        (false, _) => Err(format!("{child} has a parent of {parent}")),
        (_, false) => Err(format!("the parent of {parent} has not registered its child")),
    }
}

/// [`Invariant::FinalGrows`] for one finalized module.
pub fn final_grows(is_seed: bool, final_neighbours: usize) -> Result<(), String> {
    if is_seed || final_neighbours > 0 { Ok(()) } else { Err("it touches no finalized module".into()) }
}

/// [`Invariant::Attached`] for one metamodule: the ends that grip, each with whether it lies on a
/// connector.
pub fn attached(grips: &[bool]) -> Result<(), String> {
    match (grips.is_empty(), grips.iter().all(|on| *on)) {
        (true, _) => Err("no end grips".into()),
        (_, false) => Err("an end grips where there is no connector".into()),
        _ => Ok(()),
    }
}

/// [`Invariant::OneHolderPerLock`] for two metamodules: the cells that each holds locked, `mine` sorted.
pub fn one_holder_per_lock(mine: &[Cell], mut theirs: impl Iterator<Item = Cell>) -> Result<(), String> {
    match theirs.find(|c| mine.binary_search(c).is_ok()) {
        Some(cell) => Err(format!("both hold {cell}")),
        None => Ok(()),
    }
}

/// [`Invariant::MoverHasNoDependants`] for one mover in reserve.
pub fn mover_has_no_dependants(children: usize) -> Result<(), String> {
    if children == 0 { Ok(()) } else { Err(format!("it has {children} children")) }
}

/// [`Invariant::MoveWithinLease`]: until when the grantor of the landing stays, if it granted.
pub fn move_within_lease(now: Time, move_time: Span, granted_until: Option<Time>) -> Result<(), String> {
    match granted_until {
        Some(until) if now + move_time <= until => Ok(()),
        Some(until) => Err(format!("the move ends at {}, the grant at {until}", now + move_time)),
        None => Err("the landing has granted nothing".into()),
    }
}

/// [`Invariant::FieldLoopFree`]: `next` leads from a node to its successor; a path of more than
/// `bound` steps is a circle.
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

/// [`Invariant::SessionCurrent`] for a message taken in a session.
pub fn session_current(taken_in: Session, real: Option<Session>) -> Result<(), String> {
    if real == Some(taken_in) {
        Ok(())
    } else {
        Err(format!("a message of session {taken_in} was taken while {real:?} holds"))
    }
}

/// At one instant modules are handed this much each, on average, and no more.
const MOST_AT_ONCE: u64 = 1_000;

/// [`Invariant::TimePasses`] for the inputs that so many modules have been handed at one instant. Where
/// messages take no time, two who answer each other would go on for ever.
pub fn time_passes(inputs: u64, modules: usize) -> Result<(), String> {
    if inputs <= MOST_AT_ONCE * modules as u64 {
        return Ok(());
    }
    Err(format!(
        "{modules} modules had {inputs} inputs at one instant; what they do takes no time and has no end"
    ))
}

/// [`Invariant::ReservedOnce`] for the reservations of one module.
pub fn reserved_once(reservations: &[(Face, ModuleId)]) -> Result<(), String> {
    for (i, (face, origin)) in reservations.iter().enumerate() {
        if let Some((_, other)) = reservations[..i].iter().find(|(f, o)| f == face && o != origin) {
            return Err(format!("the cell outside {face:?} is kept for {other} and for {origin}"));
        }
    }
    Ok(())
}

/// A count for each class of messages.
pub type PerClass = [u64; Class::ALL.len()];

/// [`Invariant::MessagesBalance`]: what was sent in each class has met one fate each, or is under way.
pub fn messages_balance(tally: &Tally, under_way: &PerClass) -> Result<(), String> {
    let left = |class| tally[class].in_flight();
    match Class::ALL.into_iter().find(|class| left(*class) != under_way[class.index()] as i64) {
        None => Ok(()),
        Some(class) => Err(format!(
            "{} {class} messages are unaccounted for, {} are under way",
            left(class),
            under_way[class.index()]
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::world::CubeWorld;
    use crate::world::World;
    use metamorph_protocol::cube::body::Move;
    use metamorph_protocol::ids::Revision;
    use metamorph_protocol::lattice::{Cell, Motion, MotionKind};

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
    fn move_within_lease_fires() {
        assert!(move_within_lease(Time(5), Span(5), Some(Time(10))).is_ok());
        assert!(move_within_lease(Time(6), Span(5), Some(Time(10))).is_err());
        assert!(move_within_lease(Time(6), Span(5), None).is_err());
    }

    #[test]
    fn field_loop_free_fires() {
        assert!(field_loop_free(5u8, 10, |n| n.checked_sub(1)).is_ok());
        assert!(field_loop_free(5u8, 10, |n| Some((n + 1) % 3)).is_err());
    }

    #[test]
    fn session_current_fires() {
        assert!(session_current(Session(1), Some(Session(1))).is_ok());
        assert!(session_current(Session(1), Some(Session(2))).is_err());
        assert!(session_current(Session(1), None).is_err());
    }

    #[test]
    fn reserved_once_fires() {
        let (a, b) = (ModuleId(1), ModuleId(2));
        assert!(reserved_once(&[(Face::Up, a), (Face::Up, a), (Face::Down, b)]).is_ok());
        assert!(reserved_once(&[(Face::Up, a), (Face::Down, b), (Face::Up, b)]).is_err());
    }

    #[test]
    fn time_passes_fires() {
        assert!(time_passes(3_000, 3).is_ok());
        assert!(time_passes(3_001, 3).is_err());
    }

    #[test]
    fn attached_fires() {
        assert!(attached(&[true]).is_ok() && attached(&[true, true]).is_ok());
        assert!(attached(&[]).is_err() && attached(&[true, false]).is_err());
    }

    #[test]
    fn one_holder_per_lock_fires() {
        let [a, b, c] = [0, 1, 2].map(|x| Cell::new(x, 0, 0));
        assert!(one_holder_per_lock(&[a, b], [c].into_iter()).is_ok());
        assert!(one_holder_per_lock(&[a, b], [c, b].into_iter()).is_err());
    }

    #[test]
    fn messages_balance_fires() {
        let mut tally = Tally::default();
        tally[Class::Seed].sent = 3;
        tally[Class::Gradient].delivered = 2;
        // All classes together add up, and neither does for itself.
        let under_way = |seed, gradient| {
            let mut of = [0; Class::ALL.len()];
            (of[Class::Seed.index()], of[Class::Gradient.index()]) = (seed, gradient);
            of
        };
        assert!(messages_balance(&tally, &under_way(1, 0)).is_err());
        tally[Class::Gradient].sent = 2;
        assert!(messages_balance(&tally, &under_way(3, 0)).is_ok());
        assert!(messages_balance(&tally, &under_way(2, 0)).is_err());
        assert!(messages_balance(&tally, &under_way(2, 1)).is_err());
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
        assert_eq!(fired(&mut world(&[[0, 0, 0], [0, 0, 0]])), [Invariant::OneModulePerCell]);
    }

    /// The middle of a row of three slides up: the outer two are no longer connected.
    #[test]
    fn body_connected_fires() {
        let mut row = world(&[[0, 0, 0], [1, 0, 0], [2, 0, 0]]);
        row.check_connected(Time(0));
        act(&mut row, 1, MotionKind::Convex, Face::West, Face::Up);
        assert_eq!(fired(&mut row), [Invariant::BodyConnected]);
        let mut apart = world(&[[0, 0, 0], [2, 0, 0]]);
        apart.check_connected(Time(0));
        assert_eq!(fired(&mut apart), [Invariant::BodyConnected]);
    }

    /// A module leaves over a neighbour that is itself on its way.
    #[test]
    fn mover_supported_fires() {
        let mut stack = world(&[[0, 0, 0], [0, 0, 1], [1, 0, 0], [2, 0, 0]]);
        act(&mut stack, 3, MotionKind::Convex, Face::West, Face::Up);
        assert_eq!(fired(&mut stack), []);
        let mut pair = world(&[[0, 0, 0], [1, 0, 0], [1, 1, 0], [2, 0, 0]]);
        act(&mut pair, 1, MotionKind::Convex, Face::West, Face::Up);
        assert!(fired(&mut pair).contains(&Invariant::BodyConnected));
        act(&mut pair, 3, MotionKind::Convex, Face::West, Face::South);
        assert!(fired(&mut pair).contains(&Invariant::MoverSupported));
    }
}
