//! Commands of an operator to one metamodule: go to a connector, fill a seed, stay. They replace the strategy for a
//! while, and nothing else: every motion needs the same locks as any other, and requests of others are answered.

use super::agent::Metamodule;
use super::blueprint::{MAX_SEEDS, Seed};
use super::phase::Phase;
use super::plan::{Aim, Plan};
use super::planning::paths::Route;
use super::strategy::Decision;
use super::view::View;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::time::{Span, Time};
use metamorph_core::wire::{Decoder, Encoder, WireError};

/// The most seeds, as the number that a command carries.
const SEEDS: i16 = MAX_SEEDS as i16;

/// What a metamodule is commanded to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Steering {
    /// It decides for itself again.
    Release,
    /// It stays where it is.
    Hold,
    /// It goes to this connector, stands up there, and stays.
    GoTo((i16, i16)),
    /// It fills this seed. It waits beside the goal until the seed is open.
    Take(u8),
}

impl Steering {
    pub(super) fn encode(self, out: &mut Encoder) {
        let (kind, a, b) = match self {
            Steering::Release => (0, 0, 0),
            Steering::Hold => (1, 0, 0),
            Steering::GoTo((x, y)) => (2, x, y),
            Steering::Take(seed) => (3, i16::from(seed), 0),
        };
        out.u8(kind);
        out.u16(a as u16);
        out.u16(b as u16);
    }
    pub(super) fn decode(from: &mut Decoder<'_>) -> Result<Steering, WireError> {
        let (kind, a, b) = (from.u8()?, from.u16()? as i16, from.u16()? as i16);
        let far = |c: i16| c.unsigned_abs() > Cell::LIMIT.unsigned_abs();
        match (kind, a, b) {
            (0, 0, 0) => Ok(Steering::Release),
            (1, 0, 0) => Ok(Steering::Hold),
            (2, x, y) if !far(x) && !far(y) => Ok(Steering::GoTo((x, y))),
            (3, seed @ 0..SEEDS, 0) => Ok(Steering::Take(seed as u8)),
            _ => Err(WireError::Field("steering")),
        }
    }
}

/// A command and the end of its lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Steered {
    pub steering: Steering,
    pub until: Time,
}

/// Returns the place that a metamodule fills when it stands upright on a connector.
pub fn upright(foot: (i16, i16)) -> Seed {
    Seed { foot, directions: [Face::Up; 3] }
}

impl Metamodule {
    /// Takes a command. A settled metamodule stays what it is.
    pub(super) fn on_steering(&mut self, now: Time, steering: Steering, until: Time) {
        if self.own.settled.is_some() {
            return;
        }
        hit(CoveragePoint::MetaSteered);
        if steering == Steering::Release {
            self.policy.on_answer();
        }
        let is_over = steering == Steering::Release || until <= now;
        self.own.steered = if is_over { None } else { Some(Steered { steering, until }) };
        // It neither claims a seed nor has others plan with it meanwhile.
        self.retire(now);
        self.requester.waiting_since = now;
        if matches!(self.phase, Phase::Asking(_)) {
            self.stop(now, Span::ZERO);
        }
    }

    /// Decides what to do next by the command; `None` if there is none, or if its lease has ended.
    pub(super) fn steer(&mut self, now: Time, next_expiry: Time) -> Option<Decision> {
        let Steered { steering, until } = self.own.steered?;
        let is_over = now >= until || matches!(steering, Steering::Take(seed) if self.own.filled.has(seed));
        if is_over {
            self.own.steered = None;
            return None;
        }
        let v = self.view(now);
        let next = match steering {
            Steering::Release | Steering::Hold => None,
            Steering::GoTo(foot) => next_motion(v, upright(foot), None),
            Steering::Take(seed) => {
                v.setup.seed(v.own.task, seed).and_then(|s| next_motion(v, s, Some(seed)))
            }
        };
        Some(next.map_or(Decision::Wait(next_expiry.min(until)), Decision::Ask))
    }
}

/// Returns the next motion towards a place: around all bodies as they stand, or else as far as it is free on the way
/// that only immovable ones bar. `None` if it is there, or cannot go on now.
fn next_motion(v: View<'_>, place: Seed, seed: Option<u8>) -> Option<Plan> {
    let (mut fixed, mut taken) = (v.fixed(), Vec::new());
    for (_, state) in v.neighbours.states() {
        let stays = v.stays(state) || v.neighbours.is_dead(state.id);
        let cells = v.setup.occupied(state.pose);
        if stays { fixed.extend(cells) } else { taken.extend(cells) }
    }
    taken.extend(v.locks.cells(v.setup));
    taken.extend(&fixed);
    let (ground, pose) = (v.ground(&taken), v.own.pose);
    let around = ground.to_seed(pose, place, &fixed, usize::MAX);
    let Route { steps, last } =
        around.or_else(|| v.ground(&fixed).to_seed(pose, place, &fixed, usize::MAX))?;
    let (posture, aim) = match (steps.first(), last?, seed) {
        (Some(posture), _, _) => (*posture, Aim::Land),
        (None, last, Some(seed)) if v.open().has(seed) => (last, Aim::Settle(seed)),
        (None, last, None) if last != pose.posture => (last, Aim::Shift),
        (None, ..) => return None,
    };
    if aim == Aim::Land {
        ground.landed(pose, posture)?;
    }
    Plan::to(&ground, pose, posture, aim)
}
