//! Distributed deadlock detection: finds out, without a controller, that no metamodule can continue. Off unless a
//! scenario asks for it.
//!
//! Under a force-field strategy, a metamodule without a better place does nothing until it hears something new: it
//! waits for **any** neighbour in range, not for a particular one. So following wait-for edges to find a cycle would
//! not be enough; this is the diffusing computation of Chandy, Misra and Haas (1983) for that kind of waiting. A
//! metamodule that has waited for long starts a wave: it asks all neighbours in range. Each passive one asks its own
//! neighbours, once per wave, and answers when all of them have answered. One that is not passive does not answer, so
//! the wave does not complete.
//!
//! Links lose, duplicate and reorder messages, which the original does not allow. So a question or an answer counts
//! only if the receiver has heard the latest state of the sender; a wave must have counted every metamodule; and two
//! waves in a row must have counted the same number of *stirs*. A metamodule counts at least one stir whenever it
//! looks for something to do. Two equal counts show that nothing was begun between the waves, that no message is under
//! way that could cause anything to begin, and that nothing will begin until something fails, restarts or is ordered
//! from outside. Lost questions and answers are repeated.
//!
//! Not here: resolving a deadlock; and `negotiated`, where a metamodule that waits tries again after a time, and so
//! is never passive.

use super::message::{Counted, Message, Probe};
use super::outbox::Outbox;
use super::phase::Phase;
use super::view::View;
use metamorph_core::counters::Class;
use metamorph_core::ids::{Incarnation, ModuleId, Port, PortSet};
use metamorph_core::time::{Span, Time};
use std::collections::BTreeMap;

/// The longest duration of a wave, in multiples of the time between two waves. A metamodule that restarts is silent
/// for longer than that, and so is not counted twice by one wave.
const LASTS: u64 = 2;

/// A wave as one metamodule sees it. The digest hashes its fields in this order.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Wave {
    number: u32,
    began: Time,
    /// The port that asked first; `None` at the initiator.
    from: Option<Port>,
    /// Ports that have not answered, and when they are asked again.
    pending: PortSet,
    again: Time,
    counted: Counted,
    /// This metamodule's stirs when it entered the wave; if it has stirred since, the wave is void.
    stirs: u32,
}

/// The waves that a metamodule takes part in. The digest hashes its fields in this order.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct DeadlockDetector {
    /// How often the metamodule has stirred.
    stirs: u32,
    /// The number of its last wave.
    number: u32,
    /// When it begins the next one.
    next: Time,
    /// The latest wave of each initiator. At most one for each metamodule there is.
    waves: BTreeMap<ModuleId, Wave>,
    /// The result of its last complete wave.
    last: Option<Counted>,
    /// True if it has found out that no metamodule can continue.
    pub deadlocked: bool,
}

/// Whether a metamodule does nothing until it hears something new, and has heard all in range.
fn is_passive(v: View<'_>, phase: &Phase) -> bool {
    let own = v.own;
    // The controller opens seeds some time after others were filled.
    let told = own.settled.is_some() || v.open() == v.goal().open(own.filled);
    phase.is_waiting()
        && told
        && own.stuck.is_none()
        && v.params().strategy.is_published()
        && !v.any_unheard()
}

/// Ports of the neighbours that live.
fn living(v: View<'_>) -> PortSet {
    let heard = v.neighbours.iter().filter_map(|(port, n)| Some((port, n, n.state?)));
    let living = heard.filter(|(_, n, s)| !n.certified_dead && !v.neighbours.is_dead(s.id));
    living.map(|(port, _, _)| port).collect()
}

impl DeadlockDetector {
    pub fn new(incarnation: Incarnation) -> DeadlockDetector {
        DeadlockDetector {
            stirs: 0,
            // Waves of a later incarnation come after those of an earlier one.
            number: u32::from(incarnation.0) << 16,
            next: Time::NEVER,
            waves: BTreeMap::new(),
            last: None,
            deadlocked: false,
        }
    }

    /// Returns when the next wave begins or the next question is repeated.
    pub fn due(&self) -> Time {
        self.waves.values().map(|w| w.again).fold(self.next, Time::min)
    }

    /// Notes a stir, or begins a wave if the metamodule has waited long enough. To be called after every
    /// input.
    pub fn tend(&mut self, v: View<'_>, phase: &Phase, out: &mut Outbox) {
        let Some(detector) = v.params().detector else { return };
        let now = v.now;
        let passive = is_passive(v, phase);
        let done = v.own.settled.is_some() || v.own.filled.holds(v.goal().all());
        if !passive {
            self.stirs = self.stirs.wrapping_add(1);
            (self.last, self.deadlocked) = (None, false);
            self.waves.values_mut().for_each(|w| w.again = Time::NEVER);
        }
        if !passive || done {
            self.next = Time::NEVER;
        } else if self.next == Time::NEVER {
            self.next = now + detector.after;
        } else if now >= self.next {
            self.next = now + detector.after;
            // One initiator is enough: the one with the smallest number.
            let me = v.own.id;
            let lasts = |w: &Wave| now.since(w.began) <= detector.after * LASTS;
            let unfinished = |w: &Wave| !w.pending.is_empty() && w.stirs == self.stirs;
            let mut others = self.waves.iter().filter(|(_, w)| lasts(w));
            if !others.any(|(id, w)| *id < me || (*id == me && unfinished(w))) {
                self.number = self.number.wrapping_add(1);
                self.enter(v, out, me, self.number, None);
            }
        }
        if now >= self.due() {
            self.ask_again(v, out, detector.after * LASTS);
        }
    }

    fn ask_again(&mut self, v: View<'_>, out: &mut Outbox, lasts: Span) {
        let (now, again) = (v.now, v.now + v.params().resend);
        for (initiator, wave) in self.waves.iter_mut().filter(|(_, w)| now >= w.again) {
            let over = now.since(wave.began) > lasts;
            wave.again = if over { Time::NEVER } else { again };
            if !over {
                question(out, *initiator, wave.number, wave.pending);
            }
        }
    }

    /// Enters a wave: asks all live neighbours except the one that asked first.
    fn enter(&mut self, v: View<'_>, out: &mut Outbox, initiator: ModuleId, number: u32, from: Option<Port>) {
        let mut pending = living(v);
        from.iter().for_each(|port| pending.remove(*port));
        let counted = Counted { metamodules: 1, stirs: self.stirs };
        let (began, again) = (v.now, v.now + v.params().resend);
        let wave = Wave { number, began, from, pending, again, counted, stirs: self.stirs };
        self.waves.insert(initiator, wave);
        question(out, initiator, number, pending);
        self.end_wave(v, out, initiator);
    }

    pub fn on_probe(&mut self, v: View<'_>, phase: &Phase, out: &mut Outbox, port: Port, probe: Probe) {
        let Probe { initiator, wave: number, sequence, answer } = probe;
        let heard = v.neighbours.get(port).and_then(|n| n.state);
        let up_to_date = heard.is_some_and(|s| s.sequence == sequence);
        let exists = v.params().detector.is_some_and(|d| initiator.0 < d.metamodules.into());
        if !exists || !up_to_date || !is_passive(v, phase) {
            return;
        }
        let stirs = self.stirs;
        let known = self.waves.get_mut(&initiator).filter(|w| w.number >= number);
        match (known, answer) {
            (None, None) => self.enter(v, out, initiator, number, Some(port)),
            (Some(w), None) => {
                // The one that asked first gets what was counted here, when that is complete; all others
                // get nothing, so that each metamodule is counted once.
                let first = w.from == Some(port);
                let answer = if first { w.counted } else { Counted::default() };
                if w.number == number && w.stirs == stirs && (!first || w.pending.is_empty()) {
                    send(out, port, initiator, number, Some(answer));
                }
            }
            (Some(w), Some(counted)) => {
                let asked = w.pending.contains(port);
                if w.number == number && w.stirs == stirs && asked {
                    w.pending.remove(port);
                    w.counted = w.counted.and(counted);
                    self.end_wave(v, out, initiator);
                }
            }
            (None, Some(_)) => {}
        }
    }

    /// Ends a wave if all that were asked have answered: sends the answer back or, at the initiator, compares the count
    /// with that of the wave before.
    fn end_wave(&mut self, v: View<'_>, out: &mut Outbox, initiator: ModuleId) {
        let Some(detector) = v.params().detector else { return };
        let complete = self.waves.get_mut(&initiator).filter(|w| w.pending.is_empty());
        let Some(wave) = complete else { return };
        wave.again = Time::NEVER;
        let (number, counted, began) = (wave.number, wave.counted, wave.began);
        if let Some(back) = wave.from {
            return send(out, back, initiator, number, Some(counted));
        }
        let all = usize::from(counted.metamodules) + v.neighbours.dead.len();
        // One that restarted in the meantime could have been counted twice.
        if all == usize::from(detector.metamodules) && v.now.since(began) <= detector.after * LASTS {
            let before = self.last.replace(counted);
            self.deadlocked |= before == Some(counted);
        }
    }
}

fn question(out: &mut Outbox, initiator: ModuleId, wave: u32, pending: PortSet) {
    for port in pending.iter() {
        send(out, port, initiator, wave, None);
    }
}

fn send(out: &mut Outbox, port: Port, initiator: ModuleId, wave: u32, answer: Option<Counted>) {
    let probe = Probe { initiator, wave, sequence: out.sequence(), answer };
    out.send(port, Class::Seed, Message::Probe(probe));
}
