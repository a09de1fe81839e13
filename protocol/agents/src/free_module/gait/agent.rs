//! The agent of a free module: keeps the structure, and steps and tells its oscillators.

use super::body::{BodyPlace, BodyPose, JointTask, WalkStatus};
use super::link_state::LinkStates;
use super::message::{CONNECTORS, Docking, Follow, Gait, LinkState, PHASES, PhaseAt, WalkMessage, WalkOrder};
use super::rhythm::Rhythm;
use super::routes::Routes;
use super::{
    COMMAND_AGE, COMMAND_PERIOD, COMPARE, COMPARE_SOON, PHASE_AGE, PHASE_PERIOD, PHASE_REPEAT, StartPhases,
    WalkSetup,
};
use crate::free_module::network::{Morphology, Network};
use crate::free_module::oscillator::{Oscillator, Phase, STEP};
use crate::free_module::structure::{JOINTS, Joint};
use metamorph_core::agent::{Agent, Birth, Input, InputOf, Output, OutputOf, Summary};
use metamorph_core::counters::Class;
use metamorph_core::ids::{ModuleId, Port};
use metamorph_core::rng::Rng;
use metamorph_core::time::Time;
use std::collections::{BTreeMap, VecDeque};
use std::hash::Hasher;
use std::sync::Arc;

/// Link states sent at a time to a neighbour that knows others.
const REPAIR: usize = 8;

/// Knowledge about the neighbour at a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Neighbour {
    /// The hash of the link states that it knows.
    knows: Option<u64>,
    /// The last time that it was heard of; at first the time of the contact.
    heard: Time,
    /// The module whose link state was sent last to repair a difference.
    repaired: ModuleId,
}

/// A network in use.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Adopted {
    /// The hash of the link states that it was made from.
    of: u64,
    network: Network,
    routes: Routes,
    /// The tasks of the own joints.
    tasks: [JointTask; JOINTS as usize],
}

/// The agent of one free module.
#[derive(Debug)]
pub struct FreeModule {
    setup: Arc<WalkSetup>,
    id: ModuleId,
    rng: Rng,
    /// The modules that are docked while all contacts last.
    docking: Docking,
    neighbours: [Option<Neighbour>; CONNECTORS],
    own: LinkState,
    links: LinkStates,
    adopted: Adopted,
    /// A gait that has not begun.
    pending: Option<Gait>,
    rhythm: Option<Rhythm>,
    compare_at: Time,
    /// The next step of the oscillators, at a multiple of [`STEP`].
    step_at: Time,
    outputs: VecDeque<OutputOf<FreeModule>>,
}

impl FreeModule {
    /// Returns the network in use; empty before there is one.
    pub fn network(&self) -> &Network {
        &self.adopted.network
    }
    /// Returns the oscillators, once a gait has begun.
    pub fn oscillators(&self) -> Option<&[Oscillator; JOINTS as usize]> {
        self.rhythm.as_ref().map(Rhythm::oscillators)
    }
    /// Returns the phase of a joint's oscillator, counted from that of the gait: coupled oscillators are in lock if theirs
    /// are equal.
    pub fn phase(&self, joint: Joint, now: Time) -> Option<PhaseAt> {
        self.rhythm.as_ref()?.phase(joint, &self.adopted.network, now)
    }

    fn send(&mut self, port: Port, class: Class, message: WalkMessage) {
        self.outputs.push_back(Output::Send { port, class, message });
    }
    fn ports(&self) -> impl Iterator<Item = Port> + use<> {
        let there = self.neighbours.map(|n| n.is_some());
        (0..CONNECTORS as u8).filter(move |p| there[usize::from(*p)]).map(Port)
    }

    /// States what is docked now, and tells all neighbours.
    fn restate(&mut self, now: Time) {
        let mut docking = self.docking;
        for (docked, neighbour) in docking.0.iter_mut().zip(&self.neighbours) {
            *docked = docked.filter(|_| neighbour.is_some());
        }
        self.own = LinkState { number: self.own.number + 1, docking, ..self.own };
        self.learn(now, self.own, None);
    }

    /// Takes a link state, and passes news on to all neighbours but the one at this port.
    fn learn(&mut self, now: Time, link: LinkState, from: Option<Port>) {
        if self.links.learn(link) {
            self.compare_at = self.compare_at.min(now + COMPARE_SOON);
            for port in self.ports().filter(|p| Some(*p) != from) {
                self.send(port, Class::Connectivity, WalkMessage::LinkState(link));
            }
        }
    }

    /// Sends a neighbour that knows other link states a few of those known here.
    fn repair(&mut self, port: Port) {
        let Some(neighbour) = &mut self.neighbours[port.index()] else { return };
        let links: Vec<LinkState> = self.links.after(neighbour.repaired).take(REPAIR).copied().collect();
        if let Some(last) = links.last() {
            neighbour.repaired = last.module;
        }
        for link in links {
            self.send(port, Class::Connectivity, WalkMessage::LinkState(link));
        }
    }

    /// Goes over to the network of the structure that all neighbours know. One that was silent for long does not count.
    fn adopt(&mut self, now: Time) {
        let known = self.links.fingerprint();
        let agrees = |n: &Neighbour| n.knows == Some(known) || now.since(n.heard) > PHASE_AGE;
        if known == self.adopted.of || !self.neighbours.iter().flatten().all(agrees) {
            return;
        }
        let Some(structure) = self.links.structure() else { return };
        // Of a structure in which no joint moves there is no network.
        let morphology = Morphology::of(&structure);
        let network = morphology.network(self.setup.network).unwrap_or_default();
        let routes = Routes::of(&structure, &network, self.id);
        if let Some(rhythm) = &mut self.rhythm {
            rhythm.keep(&network);
        }
        let roles = morphology.articulations(self.setup.network);
        let tasks = [0, 1, 2].map(|j| Joint::new(self.id, j)).map(|joint| match roles.get(&joint) {
            _ if network.oscillators.binary_search(&joint).is_err() => JointTask::Locked,
            Some(role) => JointTask::Articulation(*role),
            None => JointTask::Oscillates,
        });
        self.adopted = Adopted { of: known, network, routes, tasks };
        self.outputs.push_back(Output::Report(WalkStatus { known, tasks }));
    }

    /// Tells all neighbours which link states are known here: often while some of them know others.
    fn compare(&mut self, now: Time) {
        self.adopt(now);
        self.ports().for_each(|port| self.tell_known(port));
        self.compare_at = now + if self.is_settled() { COMPARE } else { COMPARE_SOON };
    }

    fn is_settled(&self) -> bool {
        self.adopted.of == self.links.fingerprint()
    }

    fn tell_known(&mut self, port: Port) {
        let known = WalkMessage::Known { hash: self.links.fingerprint(), settled: self.is_settled() };
        self.send(port, Class::Liveness, known);
    }

    /// Takes what a neighbour knows. Helps it if that is something else, and answers if it waits for it.
    fn compared(&mut self, now: Time, port: Port, hash: u64, settled: bool) {
        if let Some(neighbour) = &mut self.neighbours[port.index()] {
            neighbour.knows = Some(hash);
        }
        if hash != self.links.fingerprint() {
            self.repair(port);
        }
        self.adopt(now);
        // One that waits for an answer itself asks anyway.
        if !settled && self.is_settled() {
            self.tell_known(port);
        }
    }

    fn hear(&mut self, now: Time, from: Port, epoch: u16, phases: Vec<PhaseAt>) {
        let Some(rhythm) = self.rhythm.as_mut().filter(|r| r.epoch() == epoch) else { return };
        let network = &self.adopted.network;
        let mut onward = Vec::new();
        for phase in phases {
            let coupled = network.oscillators.binary_search(&phase.oscillator).is_ok();
            // A time stamp ahead of all clocks would hide every later one.
            let plausible = phase.at <= now + PHASE_REPEAT;
            if !coupled || !plausible || phase.oscillator.module() == self.id {
                continue;
            }
            let at = if self.setup.time_stamps { phase.at } else { now };
            if rhythm.hear(PhaseAt { at, ..phase }) {
                onward.push(phase);
            }
        }
        self.pass_on(epoch, &onward, Some(from));
    }

    /// Sends phases by their routes; those that leave by one port share frames.
    fn pass_on(&mut self, epoch: u16, phases: &[PhaseAt], from: Option<Port>) {
        let mut by_port: BTreeMap<Port, Vec<PhaseAt>> = BTreeMap::new();
        for phase in phases {
            for port in self.adopted.routes.onward(phase.oscillator).filter(|p| Some(*p) != from) {
                by_port.entry(port).or_default().push(*phase);
            }
        }
        for (port, phases) in by_port {
            for phases in phases.chunks(PHASES).map(<[PhaseAt]>::to_vec) {
                self.send(port, Class::Gait, WalkMessage::Phases { epoch, phases });
            }
        }
    }

    /// Begins a gait whose time has come, and steps the oscillators up to `now`.
    fn step(&mut self, now: Time) {
        if now.since(self.step_at) > PHASE_AGE {
            // The process was stopped: the oscillators continue alone, as others have seen them.
            let missed = (now.0 - self.step_at.0) / STEP.0;
            if let Some(rhythm) = &mut self.rhythm {
                rhythm.coast(&self.setup, STEP * missed);
            }
            self.step_at += STEP * missed;
        }
        while self.step_at <= now {
            let at = self.step_at;
            if let Some(gait) = self.pending.take_if(|gait| gait.start <= at) {
                self.begin(gait, at);
            } else if let Some(rhythm) = &mut self.rhythm {
                rhythm.step(&self.setup, &self.adopted.network, at - STEP);
            }
            self.step_at = at + STEP;
            self.tell_phases(at);
            self.move_body(at);
        }
    }

    fn tell_phases(&mut self, at: Time) {
        let Some(rhythm) = self.rhythm.as_mut().filter(|_| at.0.is_multiple_of(PHASE_PERIOD.0)) else {
            return;
        };
        let (epoch, due) = (rhythm.epoch(), rhythm.due(&self.setup, &self.adopted.network, at));
        self.pass_on(epoch, &due, None);
    }

    /// Commands the angles of the oscillators.
    fn move_body(&mut self, at: Time) {
        let Some(rhythm) = self.rhythm.as_ref().filter(|_| at.0.is_multiple_of(COMMAND_PERIOD.0)) else {
            return;
        };
        let angles = rhythm.oscillators().map(|o| o.angle());
        self.outputs.push_back(Output::Act(Follow { angles, not_after: at + COMMAND_AGE }));
    }

    fn begin(&mut self, gait: Gait, at: Time) {
        match &mut self.rhythm {
            Some(rhythm) => rhythm.change(gait),
            None => {
                let turned = Phase::default().after(at.since(gait.start), self.setup.dynamics.frequency);
                let phases = [(); JOINTS as usize].map(|()| match self.setup.start {
                    StartPhases::Locked => turned,
                    StartPhases::Random => Phase(self.rng.next_u64() as u32),
                });
                self.rhythm = Some(Rhythm::new(self.id, gait, phases));
            }
        }
    }

    /// Takes a gait that is newer than those known.
    fn order(&mut self, now: Time, gait: Gait) {
        let known = self.pending.map(|g| g.epoch).max(self.rhythm.as_ref().map(Rhythm::epoch));
        if known.is_some_and(|known| gait.epoch <= known) {
            return;
        }
        self.pending = Some(gait);
        if self.rhythm.is_none() {
            let from = Time(now.0.max(gait.start.0));
            self.step_at = Time(from.0.div_ceil(STEP.0).saturating_mul(STEP.0));
        }
    }
}

impl Agent for FreeModule {
    type Setup = WalkSetup;
    type Place = BodyPlace;
    type Message = WalkMessage;
    type Action = Follow;
    type Percept = BodyPose;
    type Order = WalkOrder;
    type Report = WalkStatus;

    /// The number of ports: one for each connector.
    const PORTS: usize = CONNECTORS;

    fn new(setup: &Arc<WalkSetup>, birth: Birth<BodyPlace>, now: Time) -> FreeModule {
        let Birth { id, incarnation, place, seed, .. } = birth;
        let own = LinkState { module: id, incarnation, number: 0, docking: Docking::default() };
        FreeModule {
            setup: Arc::clone(setup),
            id,
            rng: Rng::named(seed, "free module", (u64::from(id.0) << 16) | u64::from(incarnation.0)),
            docking: place.docking,
            neighbours: [None; CONNECTORS],
            own,
            links: LinkStates::default(),
            adopted: Adopted::default(),
            pending: None,
            rhythm: None,
            compare_at: now + COMPARE_SOON,
            step_at: Time::NEVER,
            outputs: VecDeque::new(),
        }
    }

    fn handle(&mut self, now: Time, input: InputOf<FreeModule>) {
        match input {
            Input::Contact { port, session } => {
                let neighbour = Neighbour { knows: None, heard: now, repaired: self.id };
                self.neighbours[port.index()] = session.map(|_| neighbour);
                self.restate(now);
            }
            Input::Message { port, message } => {
                if let Some(neighbour) = &mut self.neighbours[port.index()] {
                    neighbour.heard = now;
                }
                match message {
                    WalkMessage::LinkState(link) if link.module == self.id => {}
                    WalkMessage::LinkState(link) => self.learn(now, link, Some(port)),
                    WalkMessage::Known { hash, settled } => self.compared(now, port, hash, settled),
                    WalkMessage::Phases { epoch, phases } => self.hear(now, port, epoch, phases),
                }
            }
            Input::Order(WalkOrder::Gait(gait)) => self.order(now, gait),
            Input::Order(WalkOrder::Dead { module, incarnation }) => {
                if self.links.bury(module, incarnation) {
                    self.compare_at = self.compare_at.min(now + COMPARE_SOON);
                }
            }
            // Bodies tell where they are for those that watch; gaits do not depend on it.
            Input::Wake | Input::Percept(_) => {}
        }
        if now >= self.compare_at {
            self.compare(now);
        }
        self.step(now);
    }

    fn poll(&mut self) -> Option<OutputOf<FreeModule>> {
        self.outputs.pop_front()
    }

    fn wake_at(&self) -> Time {
        self.compare_at.min(self.step_at)
    }

    fn summary(&self, _: Time) -> Summary {
        let activity = match &self.rhythm {
            Some(rhythm) => format!("walking by gait {}", rhythm.epoch()),
            None => "resting".to_owned(),
        };
        Summary { role: self.adopted.tasks.map(JointTask::name).join(", "), activity, ..Summary::default() }
    }

    fn reseed(&mut self, seed: u64) {
        self.rng = Rng::named(seed, "free module, reseeded", self.id.0.into());
    }

    fn digest(&self, hasher: &mut dyn Hasher) {
        let mut put = |n: u64| hasher.write(&n.to_le_bytes());
        put(self.links.fingerprint());
        put(self.adopted.of);
        for neighbour in &self.neighbours {
            put(neighbour.is_some().into());
            put(neighbour.and_then(|n| n.knows).unwrap_or_default());
            put(neighbour.map_or(0, |n| n.heard.0));
        }
        put(self.pending.map_or(0, |g| u64::from(g.epoch) + 1));
        if let Some(rhythm) = &self.rhythm {
            rhythm.digest(put);
        }
    }
}
