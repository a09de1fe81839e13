//! Watching a run: a world and a director with somebody who looks on and writes a scene. Works on
//! both links; what drivers and agents see is the same as without.

use super::scene::{Event, Scene};
use super::visible::Visible;
use crate::runnable::Runnable;
use metamorph_protocol::agent::{Agent, Class};
use metamorph_protocol::ids::{Incarnation, ModuleId, Revision};
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::direct::{Command, Direct};
use metamorph_sim_bridge::faults::Fault;
use metamorph_sim_bridge::invariants::Violation;
use metamorph_sim_bridge::sim::{Agents, Audited, Observer};
use metamorph_sim_bridge::world::{Sensed, World};
use std::sync::{Arc, Mutex, MutexGuard};

/// A scene that is written on one side and read on another.
#[derive(Clone, Debug)]
pub struct Shared(Arc<Mutex<Scene>>);

impl Shared {
    /// Shares a scene.
    pub fn new(scene: Scene) -> Shared {
        Shared(Arc::new(Mutex::new(scene)))
    }
    /// The scene. A reader that has panicked leaves it as it was.
    pub fn lock(&self) -> MutexGuard<'_, Scene> {
        self.0.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }
}

type AgentOf<W> = <W as World>::Agent;
type PerceptOf<W> = <AgentOf<W> as Agent>::Percept;
type ActionOf<W> = <AgentOf<W> as Agent>::Action;
type ReportOf<W> = <AgentOf<W> as Agent>::Report;
type OrderOf<W> = <AgentOf<W> as Agent>::Order;

/// A world that may be watched.
pub struct Watched<W: World> {
    /// The world.
    pub world: W,
    setup: Arc<<W::Agent as Agent>::Setup>,
    scene: Option<Shared>,
    now: Time,
}

impl<W: World> Watched<W> {
    /// A world, and the scene that is made of it, if any.
    pub fn new(world: W, setup: &Arc<<W::Agent as Agent>::Setup>, scene: Option<Shared>) -> Watched<W> {
        Watched { world, setup: Arc::clone(setup), scene, now: Time::ZERO }
    }
}

impl<W: World<Agent: Visible>> World for Watched<W> {
    type Agent = W::Agent;

    fn len(&self) -> usize {
        self.world.len()
    }
    fn place(&self, id: ModuleId) -> <W::Agent as Agent>::Place {
        self.world.place(id)
    }
    fn start(&mut self, now: Time, id: ModuleId, incarnation: Incarnation) {
        self.world.start(now, id, incarnation);
    }
    fn act(&mut self, now: Time, id: ModuleId, sensed: Revision, action: &ActionOf<W>) {
        if let Some(scene) = &self.scene
            && let Some(doing) = W::Agent::doing(&self.setup, &self.world.place(id), action)
        {
            scene.lock().asked(now, id, doing);
        }
        // What was asked at this moment is refused at this moment.
        self.now = now;
        self.world.act(now, id, sensed, action);
    }
    fn next_event(&self) -> Time {
        self.world.next_event()
    }
    fn advance(&mut self, now: Time) {
        self.now = now;
        self.world.advance(now);
    }
    fn poll(&mut self) -> Option<(ModuleId, Sensed<PerceptOf<W>>)> {
        let sensed = self.world.poll()?;
        if let (Some(scene), (id, Sensed::Percept(percept))) = (&self.scene, &sensed) {
            scene.lock().went(self.now, *id, W::Agent::fate(percept));
        }
        Some(sensed)
    }
}

impl<W: Audited<Agent: Visible>> Audited for Watched<W> {
    fn audit_agent(&self, now: Time, id: ModuleId, agents: &Agents<'_, W::Agent>, found: &mut Vec<Violation>) {
        self.world.audit_agent(now, id, agents, found);
    }
    fn audit_action(&self, now: Time, id: ModuleId, agents: &Agents<'_, W::Agent>, found: &mut Vec<Violation>) {
        self.world.audit_action(now, id, agents, found);
    }
    fn audit_all(&mut self, now: Time, agents: &Agents<'_, W::Agent>, found: &mut Vec<Violation>) {
        self.world.audit_all(now, agents, found);
    }
    fn take_violations(&mut self) -> Vec<Violation> {
        self.world.take_violations()
    }
}

/// A director that may be watched.
pub struct WatchedDirector<R: Runnable> {
    /// The director.
    pub brain: R::Director,
    scene: Option<Shared>,
    struck: usize,
    counted: Option<Time>,
    width: Span,
}

impl<R: Runnable> WatchedDirector<R> {
    /// A director, and the scene that is made of what it does, if any.
    pub fn new(brain: R::Director, scene: Option<Shared>) -> WatchedDirector<R> {
        let width = scene.as_ref().map_or(Span(1), |s| s.lock().bins().0);
        WatchedDirector { brain, scene, struck: 0, counted: None, width }
    }

    fn note(&self, now: Time, event: impl FnOnce() -> Event) {
        if let Some(scene) = &self.scene {
            scene.lock().note(now, event());
        }
    }

    /// Faults that have struck, and how far the run has come.
    fn look(&mut self, now: Time) {
        let Some(scene) = &self.scene else { return };
        let mut scene = scene.lock();
        scene.reach(now);
        let struck = R::struck(&self.brain);
        for s in &struck[self.struck..] {
            let cell = match s.fault {
                Fault::Block(cell) | Fault::Unblock(cell) => Some(cell),
                _ => None,
            };
            scene.struck(s.at, s.fault.module(), cell, &s.fault.to_string(), &s.effect);
        }
        self.struck = struck.len();
        if self.counted.is_none_or(|at| now.since(at) * 2 >= self.width) {
            self.counted = Some(now);
            let progress = R::progress(&self.brain);
            scene.flow().progress(now, progress.filled as u64, progress.goal as u64);
        }
    }
}

impl<R: Runnable> Direct<Watched<R::World>> for WatchedDirector<R> {
    fn report(&mut self, now: Time, id: ModuleId, report: ReportOf<R::World>) {
        if let Some(scene) = &self.scene {
            scene.lock().tells(now, id, AgentOf::<R::World>::standing(&report));
        }
        self.brain.report(now, id, report);
    }
    fn died(&mut self, now: Time, id: ModuleId) {
        self.note(now, || Event::Died(id));
        self.brain.died(now, id);
    }
    fn started(&mut self, now: Time, id: ModuleId) {
        if now > Time::ZERO {
            self.note(now, || Event::Started(id));
        }
        self.brain.started(now, id);
    }
    fn wake(&mut self, now: Time, world: &mut Watched<R::World>) {
        self.brain.wake(now, &mut world.world);
        self.look(now);
    }
    fn wake_at(&self) -> Time {
        self.brain.wake_at()
    }
    fn poll(&mut self) -> Option<Command<OrderOf<R::World>>> {
        let command = self.brain.poll()?;
        if let Some(scene) = &self.scene {
            let mut scene = scene.lock();
            let now = scene.now();
            match &command {
                Command::Pause(id) => scene.note(now, Event::Paused(*id)),
                Command::Resume(id) => scene.note(now, Event::Resumed(*id)),
                Command::Order(_, order) => {
                    if let Some((goal, shift)) = AgentOf::<R::World>::goal(order) {
                        scene.goal(now, goal, shift);
                    }
                }
                _ => {}
            }
        }
        Some(command)
    }
}

/// Looks on at the messages of a simulation.
pub struct Listener(pub Shared);

impl<A: Visible> Observer<A> for Listener {
    fn delivered(&mut self, now: Time, from: ModuleId, to: ModuleId, class: Class, message: &A::Message) {
        self.0.lock().flow().delivered(now, from, to, class, A::said(from, to, message));
    }
}
