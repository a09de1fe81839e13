//! How a metamodule follows the commands of an operator: steering and tuning.

use super::agent::Metamodule;
use super::blueprint::Seed;
use super::phase::Phase;
use super::plan::{Aim, Plan};
use super::planning::paths::Route;
use super::steering::{Steered, Steering, upright};
use super::strategy::context::Decision;
use super::tuning::Tuning;
use super::view::View;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::time::{Span, Time};
use std::sync::Arc;

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

    /// Takes other parameters. What it asks for now is asked for under the ones before.
    pub(super) fn on_tuning(&mut self, now: Time, tuning: Tuning) {
        if !self.setup.params.strategy.is_published() {
            return;
        }
        self.setup = Arc::new(tuning.apply(&self.setup));
        self.tuned = Some(tuning);
        self.look_again(now);
    }
}

/// Returns the next motion towards a place: around all bodies as they stand, or else as far as it is free on the way
/// that only immovable ones bar. `None` if it is there, or cannot continue now.
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
