//! The agents of free modules that walk: each runs the oscillators of its own three joints.
//!
//! Agents tell each other what is docked at their connectors ([`link_state`]); every one computes body, limbs and network
//! from the same set. Phases travel along shortest routes ([`routes`]) to all oscillators that are coupled, with the time
//! they were taken at, and receivers extrapolate. The controller gives each agent the parameters of its own oscillators.
//!
//! Clocks are common: a skew of s seconds is a lag error of 72 s degrees at 0.2 Hz.

pub mod agent;
pub mod body;
pub mod link_state;
pub mod message;
pub mod rhythm;
pub mod routes;

pub use agent::FreeModule;

use super::network::NetworkKind;
use super::oscillator::Dynamics;
use metamorph_core::time::Span;
use serde::{Deserialize, Serialize};

/// Constant parameters that all agents of a structure share.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WalkSetup {
    /// Frequency, weight and rate of the oscillators.
    pub dynamics: Dynamics,
    /// The network.
    pub network: NetworkKind,
    /// The phases at the start of a gait.
    pub start: StartPhases,
    /// Send a phase only if receivers extrapolate it wrongly, and at least every second.
    pub predict: bool,
    /// Extrapolate from the time stamp of a phase; false takes it as of its arrival, for comparison.
    pub time_stamps: bool,
}

impl WalkSetup {
    /// Returns the usual setup with this network.
    pub const fn new(network: NetworkKind) -> WalkSetup {
        let dynamics = Dynamics::THESIS;
        WalkSetup { dynamics, network, start: StartPhases::Locked, predict: true, time_stamps: true }
    }
}

/// The phases at the start of a gait.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StartPhases {
    /// Those of the gait.
    Locked,
    /// Drawn by each agent.
    Random,
}

/// The time between two checks of whether a phase has to be sent.
pub const PHASE_PERIOD: Span = Span::millis(100);
/// The longest time without sending a phase.
pub const PHASE_REPEAT: Span = Span::secs(1);
/// The time after which a phase is no longer coupled; the oscillator continues alone.
pub const PHASE_AGE: Span = Span::secs(2);
/// The time between two commands to the body: 20 ms.
pub const COMMAND_PERIOD: Span = Span::millis(20);
/// The time for which a body follows a command if no other one comes.
pub const COMMAND_AGE: Span = Span::millis(200);
/// The time between two comparisons of link states with neighbours while they differ.
pub const COMPARE_SOON: Span = Span::millis(100);
/// The time between two comparisons while they agree.
pub const COMPARE: Span = Span::secs(1);
