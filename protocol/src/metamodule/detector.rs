//! Finding out among themselves that nobody can go on, without a controller. Off unless a scenario asks
//! for it.
//!
//! By the force field a metamodule without a better place does nothing until it hears something new: it
//! waits for **any** of those in hearing, not for one of them. So chasing edges for a circle would not do;
//! this is the diffusing computation of Chandy, Misra and Haas for that kind of waiting (1983). Whoever has
//! waited for long asks all in hearing; each that is passive asks on, once for a
//! wave, and answers when it has all answers. Whoever is not, does not answer, and the wave ends nowhere.
//!
//! Links lose, double and overtake, which the original does not allow. So a question and an answer count
//! only if the receiver has heard the latest state of the sender; a wave must have counted every
//! metamodule; and two waves must have counted the same number of *stirs*, of which every metamodule
//! makes one at least when it looks for something to do. Then nothing was begun between the two, nothing
//! is under way that could begin anything, and nothing will be, until something fails, comes back or is
//! told from outside. What is lost is asked and answered again.
//!
//! Deliberately absent: anything to do about it; `negotiated`, where whoever waits tries again after a
//! time, and so is never passive.

use super::message::{Counted, Message, Probe};
use super::params::Strategy;
use super::{Metamodule, Peer, Phase};
use crate::agent::Output;
use crate::counters::Class;
use crate::ids::{Incarnation, ModuleId, Port};
use crate::time::{Span, Time};
use std::collections::BTreeMap;

/// A wave as one metamodule sees it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Wave {
    number: u32,
    began: Time,
    /// Who asked first; nobody, if this is the one who wants to know.
    from: Option<Port>,
    /// Ports that have not answered, and when they are asked again.
    pending: u32,
    again: Time,
    counted: Counted,
    /// The own stirs when it came; later ones make it void.
    stirs: u32,
}

/// What a metamodule keeps of this.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Watch {
    /// How often it has stirred.
    stirs: u32,
    /// The number of its last wave.
    number: u32,
    /// When it asks, next.
    next: Time,
    /// The latest wave of each that has asked. At most one for each metamodule there is.
    waves: BTreeMap<ModuleId, Wave>,
    /// What its last complete wave has counted.
    last: Option<Counted>,
    /// It knows that nobody can go on.
    pub deadlocked: bool,
}

impl Watch {
    pub fn new(life: Incarnation) -> Watch {
        Watch {
            stirs: 0,
            // Waves of a later life come after those of an earlier one.
            number: u32::from(life.0) << 16,
            next: Time::NEVER,
            waves: BTreeMap::new(),
            last: None,
            deadlocked: false,
        }
    }

    /// When there is something to do.
    pub fn wake_at(&self) -> Time {
        self.waves.values().map(|w| w.again).fold(self.next, Time::min)
    }
}

/// So many times the time between two waves a wave lasts at most. Whoever starts again is silent for
/// longer, and so is not counted twice by one wave.
const LASTS: u64 = 2;

impl Metamodule {
    /// Whether it does nothing until it hears something new, and has heard of everybody in hearing.
    fn is_passive(&self) -> bool {
        let core = &self.core;
        let waits = matches!(core.phase, Phase::Idle { look_at: Time::NEVER });
        // The controller opens seeds some time after others were filled.
        let told = core.settled.is_some() || self.open() == self.goal().open(core.filled);
        waits
            && told
            && core.stuck.is_none()
            && self.setup.params.strategy != Strategy::Negotiated
            && !self.is_anybody_strange()
    }

    /// Ports of those who live.
    fn living(&self) -> u32 {
        let lives = |p: &Peer| p.state.is_some() && !p.condemned && !self.is_dead(p);
        let living = self.core.peers.iter().filter(|(_, p)| lives(p));
        living.fold(0, |mask, (port, _)| mask | 1 << port.0)
    }

    /// After every input: notes a stir, or asks if it has waited long enough.
    pub(super) fn tend_detector(&mut self, now: Time) {
        let Some(detector) = self.setup.params.detector else { return };
        let passive = self.is_passive();
        let done = self.core.settled.is_some() || self.core.filled.holds(self.goal().all());
        let watch = &mut self.core.watch;
        if !passive {
            watch.stirs = watch.stirs.wrapping_add(1);
            (watch.last, watch.deadlocked) = (None, false);
            watch.waves.values_mut().for_each(|w| w.again = Time::NEVER);
        }
        if !passive || done {
            watch.next = Time::NEVER;
        } else if watch.next == Time::NEVER {
            watch.next = now + detector.after;
        } else if now >= watch.next {
            watch.next = now + detector.after;
            // One who asks is enough: the one with the smallest number.
            let me = self.core.id;
            let lasts = |w: &Wave| now.since(w.began) <= detector.after * LASTS;
            let unfinished = |w: &Wave| w.pending != 0 && w.stirs == watch.stirs;
            let mut others = watch.waves.iter().filter(|(_, w)| lasts(w));
            if !others.any(|(id, w)| *id < me || (*id == me && unfinished(w))) {
                watch.number = watch.number.wrapping_add(1);
                let number = watch.number;
                self.enter(now, me, number, None);
            }
        }
        if now >= self.core.watch.wake_at() {
            self.ask_again(now, detector.after * LASTS);
        }
    }

    fn ask_again(&mut self, now: Time, lasts: Span) {
        let again = now + self.setup.params.resend;
        let mut due = Vec::new();
        for (initiator, wave) in self.core.watch.waves.iter_mut().filter(|(_, w)| now >= w.again) {
            let over = now.since(wave.began) > lasts;
            wave.again = if over { Time::NEVER } else { again };
            if !over {
                due.push((*initiator, wave.number, wave.pending));
            }
        }
        due.into_iter().for_each(|(initiator, number, pending)| self.question(initiator, number, pending));
    }

    /// Takes part in a wave: asks everybody but the one who asked.
    fn enter(&mut self, now: Time, initiator: ModuleId, number: u32, from: Option<Port>) {
        let pending = self.living() & !from.map_or(0, |p| 1 << p.0);
        let stirs = self.core.watch.stirs;
        let counted = Counted { metamodules: 1, stirs };
        let again = now + self.setup.params.resend;
        let wave = Wave { number, began: now, from, pending, again, counted, stirs };
        self.core.watch.waves.insert(initiator, wave);
        self.question(initiator, number, pending);
        self.end_wave(now, initiator);
    }

    fn question(&mut self, initiator: ModuleId, number: u32, pending: u32) {
        for port in (0..u32::BITS as u8).filter(|p| pending >> p & 1 == 1).map(Port) {
            self.probe(port, initiator, number, None);
        }
    }

    fn probe(&mut self, port: Port, initiator: ModuleId, wave: u32, answer: Option<Counted>) {
        let message = Message::Probe(Probe { initiator, wave, sequence: self.core.sequence, answer });
        self.out.push_back(Output::Send { port, class: Class::Seed, message });
    }

    pub(super) fn on_probe(&mut self, now: Time, port: Port, probe: Probe) {
        let Probe { initiator, wave: number, sequence, answer } = probe;
        let heard = self.core.peers.iter().find(|(p, _)| *p == port).and_then(|(_, p)| p.state);
        let up_to_date = heard.is_some_and(|s| s.sequence == sequence);
        let exists = self.setup.params.detector.is_some_and(|d| initiator.0 < d.metamodules.into());
        if !exists || !up_to_date || !self.is_passive() {
            return;
        }
        let stirs = self.core.watch.stirs;
        let known = self.core.watch.waves.get_mut(&initiator);
        let known = known.filter(|w| w.number >= number);
        match (known, answer) {
            (None, None) => self.enter(now, initiator, number, Some(port)),
            (Some(w), None) => {
                // Whoever asked first gets what was counted here, when that is complete; everybody else
                // gets nothing, so that all are counted once.
                let first = w.from == Some(port);
                let answer = if first { w.counted } else { Counted::default() };
                if w.number == number && w.stirs == stirs && !(first && w.pending != 0) {
                    self.probe(port, initiator, number, Some(answer));
                }
            }
            (Some(w), Some(counted)) => {
                let asked = w.pending & 1 << port.0 != 0;
                if w.number == number && w.stirs == stirs && asked {
                    w.pending &= !(1 << port.0);
                    w.counted = w.counted.and(counted);
                    self.end_wave(now, initiator);
                }
            }
            (None, Some(_)) => {}
        }
    }

    /// Answers, or concludes, if everybody asked has answered.
    fn end_wave(&mut self, now: Time, initiator: ModuleId) {
        let Some(detector) = self.setup.params.detector else { return };
        let complete = self.core.watch.waves.get_mut(&initiator).filter(|w| w.pending == 0);
        let Some(wave) = complete else { return };
        wave.again = Time::NEVER;
        let (number, counted, began) = (wave.number, wave.counted, wave.began);
        if let Some(back) = wave.from {
            return self.probe(back, initiator, number, Some(counted));
        }
        let everybody = usize::from(counted.metamodules) + self.core.dead.len();
        // Somebody who started again in the meantime could have been counted twice.
        if everybody == usize::from(detector.metamodules) && now.since(began) <= detector.after * LASTS {
            let before = self.core.watch.last.replace(counted);
            self.core.watch.deadlocked |= before == Some(counted);
        }
    }
}
