//! Counts of what bodies of metamodules have done.

/// Counts of the bodies' actions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ActionCounts {
    /// Actions begun.
    pub started: u64,
    /// Steps of joints completed.
    pub turns: u64,
    /// Moves: all actions between two connections are one (thesis 5.1.4), so this counts connections made.
    pub moves: u64,
    /// Ends detached.
    pub released: u64,
    /// Actions that failed: stuck joints and failed connections.
    pub failed: u64,
    /// Actions refused because of another body.
    pub blocked: u64,
    /// Actions refused because they came too late.
    pub late: u64,
    /// Actions refused because the neighbourhood had changed.
    pub stale: u64,
    /// Actions refused because the body was not able to, or was busy.
    pub impossible: u64,
    /// Grips of elements.
    pub grips: u64,
    /// Elements released.
    pub let_go: u64,
    /// Elements released while another metamodule held on.
    pub hand_overs: u64,
    /// Steps of joints with an element.
    pub carries: u64,
    /// Refusals to let an element go that would have fallen.
    pub drops_prevented: u64,
    /// Refusals of steps over the limits of torque.
    pub overloads_prevented: u64,
    /// Elements dropped by a fault.
    pub drops: u64,
    /// Of these, those that fell on a metamodule.
    pub drops_on_bodies: u64,
    /// Dropped elements that were picked up again.
    pub recovered: u64,
    /// The largest number of elements that were held, and not at their goals, at a time.
    pub under_way_at_most: u64,
}
