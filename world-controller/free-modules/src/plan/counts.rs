//! Counts of the actions of a plan by kind.

use super::document::Counts;
use metamorph_protocol::assembly::action::Action;
use metamorph_protocol::assembly::order::Order;

/// Counts the actions of a plan; `order` says which of them may be carried out together.
pub fn counts(actions: &[Action], order: &Order) -> Counts {
    let Order { makespan, lifted, .. } = *order;
    let mut counts = Counts { actions: actions.len() as u32, makespan, lifted, ..Counts::default() };
    let mut pending = 0;
    for action in actions {
        pending += 1;
        match action {
            Action::Attach(_) => {
                counts.attachments += 1;
                counts.moves += 1;
                pending = 0;
            }
            Action::Detach(_) => counts.detachments += 1,
            Action::Turn { .. } => counts.turns += 1,
        }
    }
    counts.moves += u32::from(pending > 0);
    counts
}
