//! The search core of all planners: shortest paths in spaces too large to be written down.
//!
//! A [`Space`] gives states, exact packed keys, successors and an admissible lower bound. The engines find plans in it:
//!
//! * [`search::Search`] is A* with bounded memory, or, if weights are given, an anytime search with falling weights
//!   (ARA*, Likhachev et al. 2003). When memory ends it continues with iterative deepening from its frontier (after
//!   Bu and Korf 2019).
//! * [`bidirectional::Bidirectional`] searches from both ends, if there is one goal state.
//! * [`levels::Levels`] counts states by their distance from a start.
//! * [`beam::Beam`] finds plans where an exact search would take too much work.
//! * [`portfolio::Portfolio`] lets beam search and A* work in turn.
//! * [`incremental::DStarLite`] repairs a path where edges change.
//! * [`and_or::disassemble`] takes structures apart: an AND/OR search over subsets.
//!
//! Everything is sans-IO, in integers and deterministic: engines are driven in slices of work by
//! their callers, who own progress, cancelling and time limits; the same space, weights and limits give the same plan
//! with the same number of expansions on every machine. A goal is called impossible only after every state has
//! been expanded.

pub mod and_or;
pub mod beam;
pub mod bidirectional;
mod deepening;
pub mod incremental;
pub mod levels;
pub mod portfolio;
mod queue;
pub mod search;
pub mod table;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

/// The cost of an action or a plan, in the unit of the objective.
pub type Cost = u32;

/// The largest cost of a plan; a search does not go beyond it and says so.
pub const MAX_COST: Cost = 0x7ffe;

/// A space to search: states, actions and a lower bound of what is left to do.
pub trait Space {
    /// A state, unpacked.
    type State: Clone;
    /// An action.
    type Action: Copy;

    /// Returns the number of bytes of a key.
    fn key_width(&self) -> usize;
    /// Writes the key of a state: equal for two states exactly if plans may take one for the other.
    fn key(&self, state: &Self::State, key: &mut [u8]);
    /// Returns a state with this key.
    fn state(&self, key: &[u8]) -> Self::State;
    /// Visits all successors of a state. Their keys and costs depend on the state's key only; if actions can be undone,
    /// this holds in both directions.
    fn expand(&self, state: &Self::State, visit: &mut impl FnMut(Self::Action, Cost, &Self::State));
    /// Returns a lower bound of the cost of a plan from here; `None` if the goal certainly cannot be reached. The bound
    /// need not be consistent: states are opened again when a better path to them is found.
    fn lower(&self, state: &Self::State) -> Option<Cost>;
    /// Returns true if this is a goal. The lower bound is then 0.
    fn is_goal(&self, state: &Self::State) -> bool;
    /// Returns an estimate of how far the goal is. It need not be a bound, and only orders states of equal bounds.
    fn guide(&self, state: &Self::State) -> u32 {
        let _ = state;
        0
    }
    /// Returns the class of a state; a beam search keeps few states of each, so that it sees many classes.
    fn class(&self, state: &Self::State) -> u64 {
        let mut key = vec![0; self.key_width()];
        self.key(state, &mut key);
        table::hash(&key)
    }
    /// Returns the bytes that the space itself keeps.
    fn bytes(&self) -> usize {
        0
    }
}

/// Resources that a search may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// The largest number of bytes kept.
    pub memory: usize,
    /// The largest number of expansions.
    pub work: u64,
}

impl Limits {
    /// The least memory that a search is started with, in bytes: 16 MiB.
    pub const LEAST_MEMORY: usize = 16 << 20;
}

/// How far a search is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Progress {
    /// Proven lower bound of the cost of every plan.
    pub lower: Cost,
    /// Cost of the best plan so far.
    pub upper: Option<Cost>,
    /// The number of expansions; a state that is expanded again counts again.
    pub expanded: u64,
    /// Successors generated.
    pub generated: u64,
    /// States kept.
    pub kept: u64,
    /// Bytes kept.
    pub bytes: u64,
}

/// A path of states, by their keys from the start on, and what is known about its cost.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Path {
    /// The keys, that of the start first.
    pub keys: Vec<Vec<u8>>,
    /// The cost.
    pub cost: Cost,
}

/// The exhausted resource.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Resource {
    /// The bytes of [`Limits`].
    Memory,
    /// The expansions of [`Limits`].
    Work,
    /// The cost [`MAX_COST`].
    Cost,
}

/// The end of a search.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// A path, which is optimal if its cost is the lower bound.
    Solved {
        /// The path.
        path: Path,
        /// The proven lower bound of the cost of every path.
        lower: Cost,
    },
    /// No path exists: all states that can be reached have been expanded, or refuted by their lower bound.
    Impossible {
        /// The number of these states.
        states: u64,
    },
    /// A limit was reached.
    OutOf {
        /// The limit.
        resource: Resource,
        /// The best path so far.
        best: Option<Path>,
        /// The proven lower bound.
        lower: Cost,
    },
}

/// Result of a slice of work.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// There is more to do.
    Running,
    /// The search has ended.
    Done(Outcome),
}

/// Returns the actions along a path of keys, as they apply to `start`, whose key is the first one; `None` if the keys
/// are no path of the space.
pub fn actions<S: Space>(space: &S, start: &S::State, keys: &[Vec<u8>]) -> Option<Vec<S::Action>> {
    let mut state = start.clone();
    let mut key = vec![0; space.key_width()];
    space.key(&state, &mut key);
    if keys.first() != Some(&key) {
        return None;
    }
    let mut actions = Vec::new();
    for wanted in &keys[1..] {
        let mut next: Option<(Cost, S::Action, S::State)> = None;
        space.expand(&state, &mut |action, cost, to| {
            if next.as_ref().is_none_or(|n| cost < n.0) {
                space.key(to, &mut key);
                if key == *wanted {
                    next = Some((cost, action, to.clone()));
                }
            }
        });
        let (_, action, to) = next?;
        actions.push(action);
        state = to;
    }
    Some(actions)
}
