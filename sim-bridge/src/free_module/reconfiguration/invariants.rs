//! Invariants of all runs of free modules on the lattice, besides those of all runs.

use metamorph_kernel::world::invariants::Invariant;
use metamorph_protocol::ids::ModuleId;
use std::collections::BTreeSet;

/// Connections that both sides hold keep all modules in one piece.
pub const ONE_CONNECTED_BODY: Invariant = Invariant::new("one-connected-body");
/// Both sides of a connection are closed, or both are open, or the connection is pending.
pub const CONNECTION_SIDES_AGREE: Invariant = Invariant::new("connection-sides-agree");
/// No joint turns while a module on its moving side has a pending action or connection.
pub const NO_TURN_WHILE_PENDING: Invariant = Invariant::new("no-turn-while-pending");
/// Every living module on the moving side of a turn keeps still for it.
pub const BRANCH_LOCKED: Invariant = Invariant::new("branch-locked");
/// A module carries out an action of a plan at most once.
pub const ONCE_PER_EPOCH: Invariant = Invariant::new("once-per-epoch");
/// An action of a plan is confirmed after it was carried out, and after those that must precede it.
pub const CONFIRMED_IN_ORDER: Invariant = Invariant::new("confirmed-in-order");

/// Checks [`CONNECTION_SIDES_AGREE`] for a connector and the one that it faces, `None` if it faces nothing.
pub fn connection_sides_agree(closed: bool, partner: Option<bool>, is_pending: bool) -> Result<(), String> {
    match (closed, partner) {
        (true, None) => Err("a closed connector faces nothing".into()),
        (true, Some(false)) | (false, Some(true)) if !is_pending => {
            Err("one side is closed and the other is not".into())
        }
        _ => Ok(()),
    }
}

/// Checks [`NO_TURN_WHILE_PENDING`]: `pending` are the modules with a pending action or connection.
pub fn no_turn_while_pending(moving: &[usize], pending: &BTreeSet<usize>) -> Result<(), String> {
    match moving.iter().find(|m| pending.contains(m)) {
        None => Ok(()),
        Some(module) => Err(format!("module {module} moves and has a pending action")),
    }
}

/// Checks [`BRANCH_LOCKED`]: for each module on the moving side, whether it keeps still.
pub fn branch_locked(mut moving: impl Iterator<Item = (ModuleId, bool)>) -> Result<(), String> {
    match moving.find(|(_, is_still)| !is_still) {
        None => Ok(()),
        Some((id, _)) => Err(format!("module {id} has not granted the lock")),
    }
}

/// Checks [`ONCE_PER_EPOCH`]: `is_first` is true if the module has not carried out this action before.
pub fn once_per_epoch(is_first: bool) -> Result<(), String> {
    if is_first { Ok(()) } else { Err("it has been carried out before".into()) }
}

/// Checks [`CONFIRMED_IN_ORDER`] for an action.
pub fn confirmed_in_order(is_done: bool, missing: Option<usize>) -> Result<(), String> {
    match (is_done, missing) {
        (false, _) => Err("it is confirmed but has not been carried out".into()),
        (true, Some(before)) => Err(format!("action {before} must precede it and is not confirmed")),
        (true, None) => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connection_sides_agree_fires() {
        assert!(connection_sides_agree(true, Some(true), false).is_ok());
        assert!(connection_sides_agree(false, None, false).is_ok());
        assert!(connection_sides_agree(true, Some(false), true).is_ok());
        assert!(connection_sides_agree(true, Some(false), false).is_err());
        assert!(connection_sides_agree(true, None, true).is_err());
    }

    #[test]
    fn no_turn_while_pending_fires() {
        assert!(no_turn_while_pending(&[1, 2], &BTreeSet::from([0, 3])).is_ok());
        assert!(no_turn_while_pending(&[1, 2], &BTreeSet::from([2])).is_err());
    }

    #[test]
    fn branch_locked_fires() {
        let moving = |stills: [bool; 2]| branch_locked((0..).map(ModuleId).zip(stills));
        assert!(moving([true, true]).is_ok() && moving([true, false]).is_err());
    }

    #[test]
    fn once_per_epoch_fires() {
        assert!(once_per_epoch(true).is_ok() && once_per_epoch(false).is_err());
    }

    #[test]
    fn confirmed_in_order_fires() {
        assert!(confirmed_in_order(true, None).is_ok());
        assert!(confirmed_in_order(true, Some(3)).is_err() && confirmed_in_order(false, None).is_err());
    }
}
