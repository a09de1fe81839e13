//! Invariants of all runs of metamodules, besides those of all runs.

use metamorph_kernel::world::invariants::Invariant;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::{ModuleId, Port};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::manipulation::load::{LoadLimits, Peak};
use metamorph_protocol::metamodule::Metamodule;

/// A metamodule is attached to a connector of the floor by at least one end.
pub const ATTACHED: Invariant = Invariant::new("attached");
/// A cell is locked by one metamodule at a time.
pub const ONE_HOLDER_PER_LOCK: Invariant = Invariant::new("one-holder-per-lock");

/// Any two metamodules within communication range have a link. Two without one would not ask each other for locks.
pub const LINK_FOR_EACH_IN_RANGE: Invariant = Invariant::new("link-for-each-in-range");

/// An element is held by the latches of attached metamodules, each of which has it where it is, or it rests.
pub const ELEMENT_HELD: Invariant = Invariant::new("element-held");
/// No cell of an element is in a body, in another element or in an obstacle.
pub const ELEMENT_SPACE: Invariant = Invariant::new("element-space");
/// No joint of a holder turns while an element has two holders.
pub const CLOSED_CHAIN: Invariant = Invariant::new("closed-chain");
/// The cells of an element keep their number and their colours.
pub const ELEMENT_COLOUR: Invariant = Invariant::new("element-colour");
/// No joint exceeds its torque with an element.
pub const TORQUE: Invariant = Invariant::new("torque");

/// Checks [`ELEMENT_HELD`]: for each holder, whether it is attached and has the element where it is.
pub fn element_held(holders: &[bool], rests: bool) -> Result<(), String> {
    match holders {
        [] if !rests => Err("no metamodule holds it, and it does not rest".into()),
        _ if !holders.iter().all(|in_place| *in_place) => Err("a holder has let go or is elsewhere".into()),
        _ => Ok(()),
    }
}

/// Checks [`ELEMENT_SPACE`] for the cells of an element, and those of everything else.
pub fn element_space(element: &[Cell], mut others: impl Iterator<Item = Cell>) -> Result<(), String> {
    match others.find(|c| element.contains(c)) {
        Some(cell) => Err(format!("something else is in {cell}")),
        None => Ok(()),
    }
}

/// Checks [`CLOSED_CHAIN`]: the number of holders of an element, and how many of them turn.
pub fn closed_chain(holders: usize, turning: usize) -> Result<(), String> {
    if holders > 1 && turning > 0 { Err(format!("{turning} of {holders} holders turn")) } else { Ok(()) }
}

/// Checks [`ELEMENT_COLOUR`]: the number of cells, and of those of odd colour, at the start and now.
pub fn element_colour(start: (usize, usize), now: (usize, usize)) -> Result<(), String> {
    let text = |(all, odd)| format!("{all} cells, {odd} of them odd");
    if start == now { Ok(()) } else { Err(format!("{} at the start, now {}", text(start), text(now))) }
}

/// Checks [`TORQUE`] for a step with an element; `None` if there is no such step.
pub fn torque(peak: Option<Peak>, limits: LoadLimits) -> Result<(), String> {
    match peak {
        None => Err("turns into a posture that its element cannot follow".into()),
        Some(peak) if !peak.within(limits) => {
            Err(format!("{} and {} µNm on outer and middle joints", peak.outer, peak.middle))
        }
        Some(_) => Ok(()),
    }
}

/// Checks [`LINK_FOR_EACH_IN_RANGE`] for two metamodules that have come into range: the free port of each, if both have
/// one, which it returns.
pub fn link_for_each_in_range(
    id: ModuleId,
    peer: ModuleId,
    free: Option<(Port, Port)>,
) -> Result<(Port, Port), String> {
    let ports = Metamodule::PORTS;
    free.ok_or_else(|| {
        format!("{id} and {peer} are in range, and all {ports} ports of one of them are in use")
    })
}

/// Checks [`ATTACHED`] for one metamodule: for each end that grips, whether it lies on a connector.
pub fn attached(grips: &[bool]) -> Result<(), String> {
    match (grips.is_empty(), grips.iter().all(|on| *on)) {
        (true, _) => Err("no end grips".into()),
        (_, false) => Err("an end grips where there is no connector".into()),
        _ => Ok(()),
    }
}

/// The cells that one metamodule holds locked, with the box around them: most cells of others lie outside.
#[derive(Debug)]
pub struct HeldCells {
    cells: Vec<Cell>,
    min: Cell,
    max: Cell,
}

impl HeldCells {
    /// Collects cells; `None` if there are none.
    pub fn of(mut held: impl Iterator<Item = Cell>) -> Option<HeldCells> {
        let first = held.next()?;
        let mut cells = Vec::with_capacity(128);
        cells.push(first);
        cells.extend(held);
        let fold = |pick: fn(i16, i16) -> i16| {
            cells.iter().fold(first, |a, c| Cell::new(pick(a.x, c.x), pick(a.y, c.y), pick(a.z, c.z)))
        };
        let (min, max) = (fold(i16::min), fold(i16::max));
        Some(HeldCells { cells, min, max })
    }
    fn has(&self, cell: Cell) -> bool {
        let HeldCells { cells, min, max } = self;
        let is_within = |at: i16, min: i16, max: i16| min <= at && at <= max;
        is_within(cell.x, min.x, max.x)
            && is_within(cell.y, min.y, max.y)
            && is_within(cell.z, min.z, max.z)
            && cells.contains(&cell)
    }
}

/// Checks [`ONE_HOLDER_PER_LOCK`] for two metamodules: the cells that each holds locked.
pub fn one_holder_per_lock(mine: &HeldCells, mut theirs: impl Iterator<Item = Cell>) -> Result<(), String> {
    match theirs.find(|cell| mine.has(*cell)) {
        Some(cell) => Err(format!("both hold {cell}")),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attached_fires() {
        assert!(attached(&[true]).is_ok() && attached(&[true, true]).is_ok());
        assert!(attached(&[]).is_err() && attached(&[true, false]).is_err());
    }

    #[test]
    fn link_for_each_in_range_fires() {
        let (a, b) = (ModuleId(0), ModuleId(1));
        assert_eq!(link_for_each_in_range(a, b, Some((Port(3), Port(4)))), Ok((Port(3), Port(4))));
        assert!(link_for_each_in_range(a, b, None).is_err());
    }

    #[test]
    fn invariants_of_elements_fire() {
        assert!(element_held(&[true], false).is_ok() && element_held(&[], true).is_ok());
        assert!(element_held(&[], false).is_err() && element_held(&[true, false], true).is_err());
        let [a, b, c] = [0, 1, 2].map(|x| Cell::new(x, 0, 0));
        assert!(element_space(&[a, b], [c].into_iter()).is_ok());
        assert!(element_space(&[a, b], [c, b].into_iter()).is_err());
        assert!(closed_chain(1, 1).is_ok() && closed_chain(2, 0).is_ok() && closed_chain(2, 1).is_err());
        assert!(element_colour((9, 4), (9, 4)).is_ok() && element_colour((9, 4), (9, 5)).is_err());
        let peak = |outer| Some(Peak { outer, middle: 0 });
        assert!(torque(peak(LoadLimits::NOMINAL.outer), LoadLimits::NOMINAL).is_ok());
        assert!(torque(peak(LoadLimits::NOMINAL.outer + 1), LoadLimits::NOMINAL).is_err());
        assert!(torque(None, LoadLimits::NOMINAL).is_err());
    }

    #[test]
    fn one_holder_per_lock_fires() {
        let [a, b, c] = [0, 1, 2].map(|x| Cell::new(x, 0, 0));
        let mine = HeldCells::of([b, a].into_iter()).unwrap();
        assert!(one_holder_per_lock(&mine, [c].into_iter()).is_ok());
        assert!(one_holder_per_lock(&mine, [c, b].into_iter()).is_err());
        assert!(HeldCells::of([].into_iter()).is_none());
    }
}
