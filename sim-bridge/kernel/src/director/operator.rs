//! The scripted operator: a state machine that sees what a page shows of one or several swarms, notices those that make
//! no progress, thinks, and commands, one thing at a time. Its delays are drawn from its own random numbers.
//!
//! What it sees and which commands help is known by the family ([`Scene`]). It also keeps the log of the team, from which
//! [`TeamLog::measures`] follow.

use crate::director::faults::Fault;
use crate::director::steering::Steering;
use crate::director::team::{Interaction, TeamLog, UnitLog, Wait};
use metamorph_core::ids::ModuleId;
use metamorph_core::rng::Rng;
use metamorph_core::time::{Span, Time};
use std::collections::BTreeMap;

/// Visible state of one part of a swarm: a module, or a metamodule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// Its process lives.
    pub is_alive: bool,
    /// It has its place in the goal.
    pub is_done: bool,
    /// When it last moved, or came to its place.
    pub progress: Time,
    /// The one that it waits for.
    pub waits_for: Option<ModuleId>,
    /// It asks the operator what to do, or whether it is to continue by itself.
    pub asks: bool,
}

/// A swarm that moves and fills no place of its goal for this many windows is stuck as well.
const CIRCLES: u64 = 8;

/// An operator's view of one swarm.
pub trait Scene {
    /// Returns the number of its parts.
    fn parts(&self) -> usize;
    /// Returns what can be seen of a part.
    fn part(&self, id: ModuleId) -> Part;
    /// Returns when a place of the goal was last filled, or the goal was last changed.
    fn filled_at(&self) -> Time;
    /// Returns true if the run is over.
    fn is_over(&self) -> bool;
    /// Returns the distance to the unfilled places of the goal, for a choice by nearness.
    fn distance(&self, id: ModuleId) -> u64;
    /// Returns commands that help this part on, or others in its place; none if there are none. `rng` draws where several
    /// are as good. `level` is what it may command.
    fn remedy(&self, id: ModuleId, level: Level, lease: Span, rng: &mut Rng) -> Vec<Fault>;
}

/// How much modules decide for themselves (thesis E.4.1), and with it what an operator may command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Level {
    /// They decide everything; the goal is commanded, and nothing of single modules.
    Full,
    /// They decide what they are not commanded: also where they go, which places they take, and restarts.
    #[default]
    Shared,
    /// They stay where they are unless they are commanded to move, or released to decide for themselves.
    Safe,
    /// As `Safe`, and none is released.
    Teleoperation,
}

impl Level {
    /// All levels, with their names.
    pub const ALL: [(&'static str, Level); 4] = [
        ("full", Level::Full),
        ("shared", Level::Shared),
        ("safe", Level::Safe),
        ("teleoperation", Level::Teleoperation),
    ];

    /// The name in scenarios and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Level::Full => "full",
            Level::Shared => "shared",
            Level::Safe => "safe",
            Level::Teleoperation => "teleoperation",
        }
    }
    /// Returns true if modules stay where they are unless they are commanded to move.
    pub const fn holds_idle(self) -> bool {
        matches!(self, Level::Safe | Level::Teleoperation)
    }
}

/// Which of several stuck parts is examined first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Choice {
    /// The one that has been stuck for the longest time.
    #[default]
    LongestStuck,
    /// The one nearest to an unfilled place of the goal.
    Nearest,
    /// Any.
    Random,
}

impl Choice {
    /// All of them, with their names.
    pub const ALL: [(&'static str, Choice); 3] =
        [("longest-stuck", Choice::LongestStuck), ("nearest", Choice::Nearest), ("random", Choice::Random)];
}

/// The habits of a scripted operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Habits {
    /// The time between two looks.
    pub look: Span,
    /// The time between seeing and noticing, from and to.
    pub notice: (Span, Span),
    /// The time to think about one case.
    pub think: (Span, Span),
    /// The time to give one command.
    pub act: (Span, Span),
    /// Which case comes first.
    pub choice: Choice,
    /// The kind of commands.
    pub level: Level,
    /// A swarm without progress for this long is stuck.
    pub window: Span,
    /// How long commands hold.
    pub lease: Span,
}

impl Habits {
    /// Returns habits like those of a person, for swarms in which this long without progress is unusual.
    pub fn usual(window: Span) -> Habits {
        Habits {
            look: Span::secs(1),
            notice: (Span::millis(500), Span::secs(2)),
            think: (Span::secs(1), Span::secs(4)),
            act: (Span::millis(500), Span::millis(1500)),
            choice: Choice::default(),
            level: Level::default(),
            window,
            lease: window * 2,
        }
    }
}

/// Commands to one swarm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Act {
    /// The number of the swarm.
    pub swarm: usize,
    /// The command.
    pub command: Fault,
}

/// Counts of an operator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OperatorCounts {
    /// Commands given.
    pub commands: u64,
    /// Those of them that a rule refused.
    pub refused: u64,
    /// Cases in which no command helped.
    pub helpless: u64,
    /// Cases noticed, and the sum of the delays since they began.
    pub noticed: u64,
    /// The sum of these delays.
    pub notice_delay: Span,
    /// The time for which the belief which swarms are stuck was compared with the truth, weighted by the agreement
    /// (Jaccard), in nanoseconds.
    pub aware: u64,
    /// The time for which it was compared.
    pub compared: u64,
    /// Requests of swarms.
    pub requests: u64,
    /// Those that ended after a command to the swarm.
    pub answered: u64,
    /// Commands to swarms that asked nothing at the time.
    pub unasked: u64,
}

#[derive(Clone, Debug)]
enum Phase {
    Looking,
    Thinking { swarm: usize, part: ModuleId, from: Time, until: Time },
    Acting { swarm: usize, part: ModuleId, from: Time, until: Time, left: Vec<Fault> },
}

/// The operator's knowledge of one swarm.
#[derive(Clone, Debug, Default)]
struct Watched {
    /// When it was noticed, or will be, that the swarm is stuck.
    noticed: Option<Time>,
    /// Not before this time: the last commands are to have their effect, or there was nothing to be done.
    again: Time,
    /// Whether the swarm was stuck at the last observation.
    is_stuck: bool,
    is_over: bool,
    /// Of a swarm that asks: whether it has been commanded anything since.
    asks: Option<bool>,
}

fn random(seed: u64) -> Rng {
    Rng::named(seed, "operator", 0)
}

/// A scripted operator.
#[derive(Clone, Debug)]
pub struct Operator {
    habits: Habits,
    rng: Rng,
    phase: Phase,
    look_at: Time,
    observed: Time,
    swarms: Vec<Watched>,
    counts: OperatorCounts,
    log: TeamLog,
    /// The log of the parts of the swarm, if there is one swarm only.
    parts: TeamLog,
    /// Since when parts have waited for others.
    waits: BTreeMap<u32, (u32, Time)>,
}

impl Operator {
    /// Draws from another seed from now on.
    pub fn reseed(&mut self, seed: u64) {
        self.rng = random(seed);
    }

    /// Creates an operator of this many swarms. All that it draws follows from `seed`.
    pub fn new(habits: Habits, swarms: usize, seed: u64) -> Operator {
        // A swarm is productive if any part of it is.
        let log = TeamLog {
            threshold: f64::MIN_POSITIVE,
            window: habits.window.0,
            gap: Span::secs(5).0,
            ..TeamLog::default()
        };
        Operator {
            habits,
            rng: random(seed),
            phase: Phase::Looking,
            look_at: Time::ZERO,
            observed: Time::ZERO,
            swarms: vec![Watched::default(); swarms],
            counts: OperatorCounts::default(),
            parts: TeamLog { threshold: 0.5, ..log.clone() },
            log,
            waits: BTreeMap::new(),
        }
    }

    /// Returns the habits.
    pub fn habits(&self) -> &Habits {
        &self.habits
    }
    /// Returns when it last saw the swarms.
    pub fn seen(&self) -> Time {
        self.observed
    }
    /// Returns the counts so far.
    pub fn counts(&self) -> OperatorCounts {
        self.counts
    }
    /// Notes that a rule has refused a command.
    pub fn refused(&mut self) {
        self.counts.refused += 1;
    }
    /// Returns the log of the swarms up to a time.
    pub fn log(&self, end: Time) -> TeamLog {
        TeamLog { end: end.0, ..self.log.clone() }
    }
    /// Returns the log of the parts of a single swarm up to a time.
    pub fn log_of_parts(&self, end: Time) -> TeamLog {
        let open = self.waits.iter().map(|(unit, (on, from))| Wait {
            unit: *unit,
            on: *on,
            from: from.0,
            to: end.0.max(from.0),
        });
        let waits = self.parts.waits.iter().copied().chain(open).collect();
        TeamLog { end: end.0, waits, ..self.parts.clone() }
    }
    /// Returns when it wants to look or act next.
    pub fn wake_at(&self) -> Time {
        match &self.phase {
            Phase::Looking => self.look_at,
            Phase::Thinking { until, .. } | Phase::Acting { until, .. } => *until,
        }
    }
    /// Returns true if it attends to this swarm, so that the swarm is not at its end yet.
    pub fn attends(&self, swarm: usize) -> bool {
        match self.phase {
            Phase::Looking => false,
            Phase::Thinking { swarm: other, .. } | Phase::Acting { swarm: other, .. } => other == swarm,
        }
    }

    /// Sees the swarms as they are, and returns the commands that it gives now.
    pub fn step(&mut self, now: Time, scenes: &[&dyn Scene]) -> Vec<Act> {
        self.observe(now, scenes);
        let mut acts = Vec::new();
        if now < self.wake_at() {
            return acts;
        }
        match std::mem::replace(&mut self.phase, Phase::Looking) {
            Phase::Looking => self.look(now, scenes),
            Phase::Thinking { swarm, part, from, .. } => self.decide(now, scenes, (swarm, part, from)),
            Phase::Acting { swarm, part, from, mut left, .. } => {
                if !scenes[swarm].is_over() && !left.is_empty() {
                    self.counts.commands += 1;
                    match &mut self.swarms[swarm].asks {
                        Some(is_answered) => *is_answered = true,
                        None => self.counts.unasked += 1,
                    }
                    acts.push(Act { swarm, command: left.remove(0) });
                }
                if left.is_empty() || scenes[swarm].is_over() {
                    self.end(now, (swarm, part, from), self.habits.window);
                } else {
                    let until = now + self.draw(self.habits.act);
                    self.phase = Phase::Acting { swarm, part, from, until, left };
                }
            }
        }
        acts
    }

    fn draw(&mut self, range: (Span, Span)) -> Span {
        draw(&mut self.rng, range)
    }

    /// Notes what has changed since the last step.
    fn observe(&mut self, now: Time, scenes: &[&dyn Scene]) {
        let window = self.habits.window;
        let passed = now.since(self.observed).0;
        let (mut both, mut either) = (0u64, 0u64);
        for watched in self.swarms.iter().filter(|w| !w.is_over) {
            let believed = watched.noticed.is_some_and(|at| at <= now);
            both += u64::from(believed && watched.is_stuck);
            either += u64::from(believed || watched.is_stuck);
        }
        self.counts.compared += passed;
        self.counts.aware += (passed * both).checked_div(either).unwrap_or(passed);
        self.observed = now;
        for (swarm, scene) in scenes.iter().enumerate() {
            if self.swarms[swarm].is_over {
                continue;
            }
            let parts = (0..scene.parts() as u32).map(|id| scene.part(ModuleId(id)));
            let last = parts.filter(|part| part.is_alive || part.is_done).map(|part| part.progress).max();
            let last = last.unwrap_or(Time::ZERO);
            let unit = self.log.units.entry(swarm as u32).or_default();
            note(unit, last, now, window);
            if scene.is_over() {
                unit.done = Some(now.0);
            }
            let watched = &mut self.swarms[swarm];
            watched.is_over = scene.is_over();
            let asks = !watched.is_over && asking(*scene).is_some();
            match (watched.asks, asks) {
                (None, true) => {
                    self.counts.requests += 1;
                    watched.asks = Some(false);
                }
                (Some(is_answered), false) => {
                    self.counts.answered += u64::from(is_answered);
                    watched.asks = None;
                }
                _ => {}
            }
            let since = (last + window).min(scene.filled_at() + window * CIRCLES);
            let since = if asks { since.min(now) } else { since };
            watched.is_stuck = !watched.is_over && since <= now;
            if !watched.is_stuck {
                watched.noticed = None;
            } else if watched.noticed.is_none() {
                // It is seen at the next look.
                let at = self.look_at.max(now) + draw(&mut self.rng, self.habits.notice);
                watched.noticed = Some(at);
                self.counts.noticed += 1;
                self.counts.notice_delay = self.counts.notice_delay + at.since(since);
            }
        }
        if let [scene] = scenes {
            self.observe_parts(now, *scene);
        }
    }

    fn observe_parts(&mut self, now: Time, scene: &dyn Scene) {
        for id in 0..scene.parts() as u32 {
            let part = scene.part(ModuleId(id));
            let unit = self.parts.units.entry(id).or_default();
            if unit.done.is_some() {
                continue;
            }
            note(unit, part.progress, now, self.habits.window);
            if part.is_done || scene.is_over() {
                unit.done = Some(now.0);
            }
            let on = part.waits_for.map(|on| on.0).filter(|_| part.is_alive && !part.is_done);
            match (self.waits.get(&id).copied(), on) {
                (Some((before, _)), Some(on)) if before == on => {}
                (before, on) => {
                    if let Some((before, from)) = before {
                        self.parts.waits.push(Wait { unit: id, on: before, from: from.0, to: now.0 });
                        self.waits.remove(&id);
                    }
                    if let Some(on) = on {
                        self.waits.insert(id, (on, now));
                    }
                }
            }
        }
    }

    /// Chooses a case, or looks again later.
    fn look(&mut self, now: Time, scenes: &[&dyn Scene]) {
        self.look_at = now + self.habits.look;
        let is_case = |w: &&(usize, &Watched)| {
            !w.1.is_over && w.1.noticed.is_some_and(|noticed| noticed <= now) && now >= w.1.again
        };
        let swarms = self.swarms.iter().enumerate();
        let Some((swarm, _)) = swarms.filter(|w| is_case(&w)).min_by_key(|(_, w)| w.noticed) else { return };
        let scene = scenes[swarm];
        let stuck: Vec<(ModuleId, Part)> = (0..scene.parts() as u32)
            .map(|id| (ModuleId(id), scene.part(ModuleId(id))))
            .filter(|(_, part)| !part.is_done)
            .collect();
        let asked = asking(scene).map(|id| (id, scene.part(id)));
        let chosen = asked.or_else(|| match self.habits.choice {
            Choice::LongestStuck => stuck.iter().min_by_key(|(_, part)| part.progress).copied(),
            Choice::Nearest => stuck.iter().min_by_key(|(id, _)| scene.distance(*id)).copied(),
            Choice::Random => {
                let n = self.rng.below(stuck.len().max(1) as u64) as usize;
                stuck.get(n).copied()
            }
        });
        let Some((part, _)) = chosen else { return };
        let until = now + self.draw(self.habits.think);
        self.phase = Phase::Thinking { swarm, part, from: now, until };
    }

    /// Decides what to command, after having thought.
    fn decide(&mut self, now: Time, scenes: &[&dyn Scene], case: (usize, ModuleId, Time)) {
        let (swarm, part, from) = case;
        let Habits { level, lease, .. } = self.habits;
        let mut remedy = match scenes[swarm].is_over() {
            true => Vec::new(),
            false => scenes[swarm].remedy(part, level, lease, &mut self.rng),
        };
        if remedy.is_empty() && scenes[swarm].part(part).asks && level == Level::Shared {
            // It need not wait any longer.
            remedy = vec![Fault::Steer(part, Steering::Release)];
        }
        if remedy.is_empty() {
            self.counts.helpless += 1;
            return self.end(now, case, self.habits.window);
        }
        let until = now + self.draw(self.habits.act);
        self.phase = Phase::Acting { swarm, part, from, until, left: remedy };
    }

    /// Ends an interaction; the swarm is left alone for a while.
    fn end(&mut self, now: Time, (swarm, part, from): (usize, ModuleId, Time), rest: Span) {
        let interaction = |unit| Interaction { unit, from: from.0, to: now.0 };
        self.log.interactions.push(interaction(swarm as u32));
        self.parts.interactions.push(interaction(part.0));
        let watched = &mut self.swarms[swarm];
        (watched.again, watched.noticed) = (now + rest, None);
        (self.phase, self.look_at) = (Phase::Looking, now + self.habits.look);
    }
}

/// Returns the part of a swarm that asks.
fn asking(scene: &dyn Scene) -> Option<ModuleId> {
    (0..scene.parts() as u32).map(ModuleId).find(|id| scene.part(*id).asks)
}

/// Draws a time, both ends included.
fn draw(rng: &mut Rng, (from, to): (Span, Span)) -> Span {
    from + Span(rng.below((to.0.saturating_sub(from.0)).saturating_add(1)))
}

/// Notes the performance of a unit that made its last progress at `last`.
fn note(unit: &mut UnitLog, last: Time, now: Time, window: Span) {
    let ends = last + window;
    match unit.performance.last().copied() {
        None => unit.performance.push((0, 1.0)),
        Some((at, performance)) if performance <= 0.0 && last.0 > at => {
            unit.performance.push((last.0.max(at), 1.0));
        }
        _ => {}
    }
    let is_productive = unit.performance.last().is_some_and(|(_, performance)| *performance > 0.0);
    if is_productive && ends <= now {
        unit.performance.push((ends.0, 0.0));
    }
}
