//! The oscillators of one agent, and what it has heard of those they are coupled with.

use super::message::{Gait, Parameters, PhaseAt};
use super::{PHASE_AGE, PHASE_REPEAT, WalkSetup};
use crate::free_module::network::Network;
use crate::free_module::oscillator::{Angle, Oscillator, Phase};
use crate::free_module::structure::{JOINTS, Joint};
use metamorph_core::ids::ModuleId;
use metamorph_core::time::{Span, Time};
use std::collections::BTreeMap;

/// Joints of a module, as an array length.
const N: usize = JOINTS as usize;
/// The largest error of extrapolating a phase from one that is known: 0.2 degrees, in 2^-32 turns.
const PHASE_ERROR: u32 = u32::MAX / 1800;
/// The largest difference of an amplitude from the angle that its receivers know, in the unit of [`Angle`].
const AMPLITUDE_ERROR: u32 = Angle::milliradians(10).0.unsigned_abs();

/// The gait of one agent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rhythm {
    module: ModuleId,
    gait: Gait,
    oscillators: [Oscillator; N],
    /// The newest phase of each other oscillator, of this epoch.
    heard: BTreeMap<Joint, PhaseAt>,
    /// The last message about each own oscillator, as its receivers know it.
    told: [Option<Told>; N],
}

/// State of an oscillator as its receivers know it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Told {
    /// The phase from which all later ones could be extrapolated.
    since: PhaseAt,
    /// The last time that a phase was sent.
    sent: Time,
}

impl Rhythm {
    /// Begins with these phases, which are counted from those of the gait; all amplitudes are 0.
    pub fn new(module: ModuleId, gait: Gait, phases: [Phase; N]) -> Rhythm {
        let oscillators = [0, 1, 2].map(|i| {
            let lag = gait.joints[i].unwrap_or_default().phase;
            Oscillator { phase: phases[i] + lag, ..Oscillator::default() }
        });
        Rhythm { module, gait, oscillators, heard: BTreeMap::new(), told: [None; N] }
    }
    /// Goes over to another gait. Amplitudes, offsets and phases move to it from where they are.
    pub fn change(&mut self, gait: Gait) {
        (self.gait, self.told) = (gait, [None; N]);
        // Phases heard are counted from those of the former gait.
        self.heard.clear();
    }

    /// Returns the number of the gait.
    pub fn epoch(&self) -> u16 {
        self.gait.epoch
    }
    /// Returns the oscillators.
    pub fn oscillators(&self) -> &[Oscillator; N] {
        &self.oscillators
    }
    /// Iterates over the joints that both network and gait give an oscillator.
    fn active<'a>(&'a self, network: &'a Network) -> impl Iterator<Item = (usize, Joint, Parameters)> + 'a {
        (0..N).filter_map(move |i| {
            let joint = Joint::new(self.module, i as u16);
            let there = network.oscillators.binary_search(&joint).is_ok();
            self.gait.joints[i].filter(|_| there).map(|parameters| (i, joint, parameters))
        })
    }

    /// Returns an oscillator's phase, counted from that of the gait, and amplitude.
    pub fn phase(&self, joint: Joint, network: &Network, now: Time) -> Option<PhaseAt> {
        let (i, oscillator, parameters) = self.active(network).find(|(_, j, _)| *j == joint)?;
        let Oscillator { phase, amplitude, .. } = self.oscillators[i];
        Some(PhaseAt { oscillator, phase: phase - parameters.phase, amplitude, at: now })
    }

    /// Takes a phase of another oscillator. Returns true if it is newer than what was known.
    pub fn hear(&mut self, phase: PhaseAt) -> bool {
        let known = self.heard.get(&phase.oscillator);
        let is_newer = known.is_none_or(|known| phase.at > known.at);
        if is_newer {
            self.heard.insert(phase.oscillator, phase);
        }
        is_newer
    }
    /// Forgets phases of oscillators that are not in the network.
    pub fn keep(&mut self, network: &Network) {
        self.heard.retain(|joint, _| network.oscillators.binary_search(joint).is_ok());
    }

    /// Takes a step of integration from `now`.
    pub fn step(&mut self, setup: &WalkSetup, network: &Network, now: Time) {
        // Joints without an oscillator go to 0, where they are locked.
        let mut next = self.oscillators;
        next.iter_mut().for_each(|o| o.step(&setup.dynamics, 0, Angle::default(), Angle::default()));
        for (i, joint, own) in self.active(network) {
            let coupled = network.couplings.iter().filter_map(|(a, b)| match joint {
                j if j == *a => Some(*b),
                j if j == *b => Some(*a),
                _ => None,
            });
            let pull = |other: Joint| {
                let other = self.at(other, setup, network, now)?;
                // Both phases are counted from those of the gait, so that the lag is that of this one.
                let lag = Phase::default() - own.phase;
                Some(self.oscillators[i].pull(&setup.dynamics, other.phase, other.amplitude, lag))
            };
            let pulls = coupled.filter_map(pull).sum();
            next[i] = self.oscillators[i];
            next[i].step(&setup.dynamics, pulls, own.amplitude, own.offset);
        }
        self.oscillators = next;
    }

    /// Lets all oscillators turn at their frequency for a time.
    pub fn coast(&mut self, setup: &WalkSetup, time: Span) {
        for oscillator in &mut self.oscillators {
            oscillator.phase = oscillator.phase.after(time, setup.dynamics.frequency);
        }
    }

    /// Returns another oscillator at a time: a joint of this module, or one heard of not too long ago.
    fn at(&self, joint: Joint, setup: &WalkSetup, network: &Network, now: Time) -> Option<PhaseAt> {
        if joint.module() == self.module {
            return self.phase(joint, network, now);
        }
        let heard = self.heard.get(&joint).filter(|p| now.since(p.at) <= PHASE_AGE)?;
        Some(extrapolated(heard, setup, now))
    }

    /// Returns the phases to be sent now, of oscillators that are coupled beyond this module.
    pub fn due(&mut self, setup: &WalkSetup, network: &Network, now: Time) -> Vec<PhaseAt> {
        let active: Vec<Joint> = self.active(network).map(|(_, joint, _)| joint).collect();
        let leaves = |joint: &Joint| {
            let ends = |a: Joint, b: Joint| a == *joint && b.module() != self.module;
            network.couplings.iter().any(|(a, b)| ends(*a, *b) || ends(*b, *a))
        };
        let phases = active.into_iter().filter(leaves).filter_map(|j| self.phase(j, network, now));
        let phases: Vec<PhaseAt> = phases.collect();
        phases.into_iter().filter(|phase| self.is_due(phase, setup, now)).collect()
    }

    /// Decides whether to send a phase now. A receiver may have lost all but the oldest of the last second, so a
    /// phase is sent until later ones could be extrapolated for that long, and then once in that time.
    fn is_due(&mut self, phase: &PhaseAt, setup: &WalkSetup, now: Time) -> bool {
        let told = &mut self.told[usize::from(phase.oscillator.within())];
        let foreseen = |told: &&mut Told| {
            let expected = extrapolated(&told.since, setup, now);
            phase.phase.ahead_of(expected.phase).unsigned_abs() <= PHASE_ERROR
                && phase.amplitude.0.abs_diff(expected.amplitude.0) <= AMPLITUDE_ERROR
        };
        let Some(told) = told.as_mut().filter(foreseen) else {
            *told = Some(Told { since: *phase, sent: now });
            return true;
        };
        let is_new = now.since(told.since.at) < PHASE_REPEAT;
        let is_due = !setup.predict || is_new || now.since(told.sent) >= PHASE_REPEAT;
        if is_due {
            told.sent = now;
        }
        is_due
    }

    /// Returns the state as numbers, for hashes.
    pub fn digest(&self, mut put: impl FnMut(u64)) {
        put(self.gait.epoch.into());
        for o in &self.oscillators {
            put(o.phase.0.into());
            put(o.amplitude.0 as u64);
            put(o.offset.0 as u64);
        }
        for p in self.heard.values().chain(self.told.iter().flatten().map(|t| &t.since)) {
            put(p.oscillator.0.into());
            put(p.phase.0.into());
            put(p.amplitude.0 as u64);
            put(p.at.0);
        }
    }
}

/// Returns a phase at a later time, if the oscillator turns at its frequency. Without time stamps it counts as of now.
fn extrapolated(from: &PhaseAt, setup: &WalkSetup, now: Time) -> PhaseAt {
    let age: Span = if now > from.at { now.since(from.at) } else { Span::ZERO };
    PhaseAt { phase: from.phase.after(age, setup.dynamics.frequency), at: now, ..*from }
}
