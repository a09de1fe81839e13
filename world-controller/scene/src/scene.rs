//! The data of the page about a run: its beginning, its events and its end. Filled while a run is in progress
//! or from a recording, and read in pieces, so that a page can follow.
//!
//! Times are microseconds of scenario time. The layout is private to the page, which is in the same program.

use super::beginning::{Beginning, Heading, micros};
use super::bodies::ShownSwarm;
use super::elements::{ElementView, Elements};
use super::parts::Motion;
use super::visible::{ActionOutcome, FILLS, GoalView, ModuleView, Targets};
use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::Cell;
use metamorph_core::time::{Span, Time};
use metamorph_report::message_timeline::{Bin, Flow};
use metamorph_report::schema::Report;
use metamorph_scenario::LinkChange;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Number of events kept; the page says how many more there were.
const MOST_EVENTS: usize = 5_000_000;
/// Number of events sent at once.
const EVENTS_AT_ONCE: usize = 20_000;
/// Largest number of messages sent to the page at once for a module, the latest ones.
const LAST_MESSAGES: usize = 40;
/// Number of problems kept; the first ones are the most telling.
const MOST_TROUBLES: usize = 20;

/// An event of a run.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A motion that bodies will make; it takes the next free number.
    Motion(Motion),
    /// A body begins the motion of this number, with a description of its place afterwards.
    Does(ModuleId, u32, String),
    /// The action has failed for this reason, which is empty if none is known; the body is where it was before.
    Failed(ModuleId, &'static str),
    /// The body has refused the action, which therefore never began. Written only after an [`Event::Does`]:
    /// that is, if the refusal came later than the request, as it does with processes.
    Refused(ModuleId),
    /// A module reports its state.
    Tells(ModuleId, ModuleView),
    /// The process of a module has died.
    Died(ModuleId),
    /// It has been restarted, without its memory.
    Started(ModuleId),
    /// It has been stopped.
    Paused(ModuleId),
    /// It has been continued.
    Resumed(ModuleId),
    /// A fault of the schedule struck: the module, the fault, and its effect.
    Injected(Option<ModuleId>, String, String),
    /// The cells with a foreign object or a passive element in them, from now on.
    Obstacles(Vec<Cell>),
    /// The passive elements, from now on.
    Elements(Vec<ElementView>),
    /// The goal that is built from now on.
    Goal(GoalView),
}

fn told(at: u64, event: &Event) -> Value {
    match event {
        Event::Motion(motion) => json!(["d", at, motion.to_json()]),
        Event::Does(id, motion, to) => json!(["m", at, id, motion, to]),
        Event::Failed(id, why) => json!(["f", at, id, why]),
        Event::Refused(id) => json!(["r", at, id]),
        Event::Tells(id, s) => json!(["s", at, id, s.role, s.flags, s.place, s.waits_for]),
        Event::Died(id) => json!(["l", at, id, "dead"]),
        Event::Started(id) => json!(["l", at, id, "restarted"]),
        Event::Paused(id) => json!(["l", at, id, "paused"]),
        Event::Resumed(id) => json!(["l", at, id, "resumed"]),
        Event::Injected(id, what, effect) => json!(["x", at, id, what, effect]),
        Event::Obstacles(cells) => json!(["o", at, cells]),
        Event::Elements(all) => {
            let element = |e: &ElementView| json!([e.hold, e.cells]);
            json!(["e", at, all.iter().map(element).collect::<Vec<Value>>()])
        }
        Event::Goal(goal) => json!(["g", at, goal.number, goal.shift, goal.quarters]),
    }
}

/// A run, up to the present time.
#[derive(Clone, Debug)]
pub struct Scene {
    beginning: Beginning,
    events: Vec<(Time, Event)>,
    forgotten: u64,
    standings: Vec<Option<ModuleView>>,
    /// Actions requested at this moment and not refused so far, with their destinations.
    asked: Vec<(Time, ModuleId, Motion, String)>,
    /// The numbers of motions, by their JSON form.
    motions: BTreeMap<String, u32>,
    obstacles: BTreeSet<Cell>,
    /// The passive elements.
    elements: Elements,
    goal: Option<GoalView>,
    /// The current cell of the first part of each body.
    cells: Vec<Option<Cell>>,
    /// The number of actions in progress of each body that has any.
    moving: BTreeMap<ModuleId, u32>,
    /// Bodies whose requested action cannot be drawn, because they cannot do it.
    unseen: BTreeSet<ModuleId>,
    dead: BTreeSet<ModuleId>,
    flow: Flow,
    now: Time,
    /// The outcome of the run, from its journal.
    outcome: Option<String>,
    over: bool,
    report: Option<Report>,
    troubles: Vec<String>,
    /// Number of times that the scene was replaced.
    telling: u32,
    /// Beginnings and ends of partitions still to come.
    changes: VecDeque<LinkChange>,
}

impl Scene {
    /// Creates the scene of a run that has not begun.
    pub fn new(heading: Heading, swarm: &dyn ShownSwarm, messages: bool) -> Scene {
        let beginning = Beginning::of(&heading, swarm, messages);
        let width = Span(beginning.time_step * 1_000);
        let modules = beginning.start.len();
        Scene {
            flow: Flow::new(modules, width),
            cells: beginning.cells.clone(),
            motions: BTreeMap::new(),
            beginning,
            events: Vec::new(),
            forgotten: 0,
            standings: vec![None; modules],
            asked: Vec::new(),
            obstacles: BTreeSet::new(),
            elements: Elements::default(),
            goal: None,
            moving: BTreeMap::new(),
            unseen: BTreeSet::new(),
            dead: BTreeSet::new(),
            now: Time::ZERO,
            outcome: None,
            over: false,
            report: None,
            troubles: Vec::new(),
            telling: 0,
            changes: heading.changes.into(),
        }
    }

    /// Adds an event.
    pub fn note(&mut self, now: Time, event: Event) {
        self.reach(now);
        if let Event::Started(id) = event {
            self.dead.remove(&id);
        }
        self.push(now, event);
    }
    fn push(&mut self, at: Time, event: Event) {
        match self.events.len() {
            MOST_EVENTS => self.forgotten += 1,
            _ => self.events.push((at, event)),
        }
    }
    /// Advances the run to `now`, or not at all if that is past. Returns the present time.
    pub fn reach(&mut self, now: Time) -> Time {
        while self.changes.front().is_some_and(|change| change.at <= now)
            && let Some(LinkChange { at, name, effect }) = self.changes.pop_front()
        {
            self.push(at, Event::Injected(None, name.to_owned(), effect));
        }
        if now > self.now {
            self.begin_asked();
            let width = self.flow.width();
            if now.0 / width.0 > self.now.0 / width.0 {
                self.count();
            }
            self.now = now;
        }
        self.now
    }
    /// Begins the requested actions that were not refused at once.
    fn begin_asked(&mut self) {
        for (at, id, motion, to) in std::mem::take(&mut self.asked) {
            *self.moving.entry(id).or_default() += 1;
            let motion = self.number_of(at, motion);
            self.push(at, Event::Does(id, motion, to));
        }
    }
    /// Returns the number of a motion. Each motion is sent only once, as many bodies make the same ones.
    fn number_of(&mut self, at: Time, motion: Motion) -> u32 {
        let next = self.motions.len() as u32;
        let number = *self.motions.entry(motion.to_json().to_string()).or_insert(next);
        if number == next {
            self.push(at, Event::Motion(motion));
        }
        number
    }
    /// Counts the targets of the goal that are filled.
    fn count(&mut self) {
        let number = self.goal.map_or(0, |goal| goal.number);
        let Some(goal) = self.beginning.goals.get(usize::from(number)) else { return };
        let standings = self.standings.iter().flatten().filter(|s| s.role == FILLS);
        let (filled, all) = match self.beginning.targets {
            Targets::Groups(size) => {
                let targets: BTreeSet<i32> = standings.map(|s| s.place).collect();
                (targets.len(), goal.cells.len() / size)
            }
            Targets::Cells => {
                let fills = |i: usize| {
                    let id = ModuleId(i as u32);
                    // A dead body that is still on its way fills nothing.
                    let stands = self.dead.contains(&id) && !self.moving.contains_key(&id);
                    let is_final = |s: ModuleView| s.role == FILLS && s.place == i32::from(number);
                    stands || (!self.dead.contains(&id) && self.standings[i].is_some_and(is_final))
                };
                let inside = |(i, cell): &(usize, &Option<Cell>)| {
                    cell.is_some_and(|cell| goal.set.contains(&cell)) && fills(*i)
                };
                (self.cells.iter().enumerate().filter(inside).count(), goal.cells.len())
            }
        };
        self.flow.progress(self.now, filled as u64, all as u64);
    }
    /// Sets the cell of the first part of a body.
    pub fn placed(&mut self, id: ModuleId, cell: Option<Cell>) {
        if let Some(known) = self.cells.get_mut(id.index()) {
            *known = cell;
        }
    }
    /// Notes that the process of a module has died.
    pub fn died(&mut self, now: Time, id: ModuleId) {
        self.dead.insert(id);
        self.note(now, Event::Died(id));
    }
    /// Notes a requested action with its destination; `None` if the body cannot do it from its place.
    pub fn asked(&mut self, now: Time, id: ModuleId, begun: Option<(Motion, String)>) {
        self.reach(now);
        match begun {
            Some((motion, to)) => self.asked.push((now, id, motion, to)),
            None => {
                self.unseen.insert(id);
            }
        }
    }
    /// Notes the outcome of an action.
    pub fn went(&mut self, now: Time, id: ModuleId, fate: ActionOutcome) {
        self.reach(now);
        match fate {
            ActionOutcome::Done => {
                self.rests(id);
                self.flow.moved(now);
            }
            ActionOutcome::Carried => drop(self.rests(id)),
            ActionOutcome::Failed(why) => {
                self.rests(id);
                self.push(now, Event::Failed(id, why));
            }
            ActionOutcome::Refused => {
                // A body refuses before it begins, so the refusal is of the latest request.
                if let Some(i) = self.asked.iter().rposition(|(_, whose, ..)| *whose == id) {
                    self.asked.remove(i);
                } else if !self.unseen.remove(&id) && self.rests(id) {
                    self.push(now, Event::Refused(id));
                }
            }
        }
    }
    /// Ends one action of a body. Returns true if one was in progress.
    fn rests(&mut self, id: ModuleId) -> bool {
        let Some(doing) = self.moving.get_mut(&id) else { return false };
        *doing -= 1;
        if *doing == 0 {
            self.moving.remove(&id);
        }
        true
    }
    /// Notes the state that a module reports, unless it is unchanged.
    pub fn tells(&mut self, now: Time, id: ModuleId, standing: ModuleView) {
        let Some(last) = self.standings.get_mut(id.index()) else { return };
        if last.replace(standing) != Some(standing) {
            self.note(now, Event::Tells(id, standing));
        }
    }
    /// Notes a fault that struck a module or a cell.
    pub fn struck(&mut self, at: Time, id: Option<ModuleId>, cell: Option<Cell>, fault: &str, effect: &str) {
        self.note(at, Event::Injected(id, fault.to_owned(), effect.to_owned()));
        let dropped = fault.strip_prefix("drop ").and_then(|element| element.parse().ok());
        if dropped.is_some_and(|element| self.elements.fell(element, effect)) {
            return self.note_elements(at);
        }
        let Some(cell) = cell else { return };
        let changed = match fault.starts_with("unblock") {
            true => self.obstacles.remove(&cell),
            // No object comes into a cell with a body in it.
            false => effect.ends_with("the cell was free") && self.obstacles.insert(cell),
        };
        if changed {
            self.note_obstacles(at);
        }
    }
    /// Sets where the passive elements lie at the start, unless that is known.
    pub fn lay_out(&mut self, at: Time, elements: Vec<Vec<Cell>>) {
        if self.elements.lay_out(elements) {
            self.note_elements(at);
        }
    }
    /// Notes which passive element a module holds, and where it is.
    pub fn carried(&mut self, at: Time, id: ModuleId, held: Option<(usize, Vec<Cell>)>) {
        if self.elements.carried(id, held) {
            self.note_elements(at);
        }
    }
    fn note_elements(&mut self, at: Time) {
        self.note(at, Event::Elements(self.elements.all().to_vec()));
        self.note_obstacles(at);
    }
    /// Notes all cells with an obstacle or a passive element.
    fn note_obstacles(&mut self, at: Time) {
        let elements = self.elements.all().iter().flat_map(|element| &element.cells);
        let cells: BTreeSet<Cell> = self.obstacles.iter().chain(elements).copied().collect();
        self.note(at, Event::Obstacles(cells.into_iter().collect()));
    }
    /// Notes that another goal is built from now on.
    pub fn goal(&mut self, now: Time, goal: GoalView) {
        if self.goal.replace(goal) != Some(goal) {
            self.note(now, Event::Goal(goal));
        }
    }
    /// Returns the messages and the progress over time.
    pub fn flow(&mut self) -> &mut Flow {
        &mut self.flow
    }
    /// Adds a problem: a record that is missing or cannot be read.
    pub fn trouble(&mut self, what: String) {
        if self.troubles.len() < MOST_TROUBLES {
            self.troubles.push(what);
        }
    }
    /// Returns all problems kept.
    pub fn troubles(&self) -> &[String] {
        &self.troubles
    }
    /// Sets the outcome of the run, from its journal.
    pub fn ended(&mut self, outcome: &str) {
        self.outcome = Some(outcome.to_owned());
    }
    /// Ends the scene.
    pub fn end(&mut self, troubles: Vec<String>) {
        self.close(self.now);
        troubles.into_iter().for_each(|trouble| self.trouble(trouble));
    }
    /// Ends the scene with the report of the run.
    pub fn finish(&mut self, report: Report) {
        let end = Time((report.time.virtual_s * 1e9) as u64);
        self.close(self.now.max(end));
        self.report = Some(report);
    }
    fn close(&mut self, end: Time) {
        self.reach(end);
        self.begin_asked();
        self.count();
        self.flow.finish(end);
        self.over = true;
    }
    /// Makes this scene the replacement of another one of the same run.
    pub fn succeed(&mut self, other: &Scene) {
        self.telling = other.telling + 1;
    }
    /// Returns the width of the time bins, and their counts.
    pub fn bins(&self) -> (Span, &[Bin]) {
        (self.flow.width(), self.flow.bins())
    }

    /// Returns the number of modules.
    pub fn modules(&self) -> usize {
        self.standings.len()
    }
    /// Returns the events in the order of time.
    pub fn events(&self) -> &[(Time, Event)] {
        &self.events
    }
    /// Returns the number of events that were too many to keep.
    pub fn forgotten(&self) -> u64 {
        self.forgotten
    }
    /// Returns the present time; of a finished run, its end.
    pub fn now(&self) -> Time {
        self.now
    }
    /// Returns true if the run is over.
    pub fn is_over(&self) -> bool {
        self.over
    }
    /// Returns the trace hash of the run, from its report.
    pub fn trace_hash(&self) -> Option<String> {
        self.report.as_ref()?.trace_hash.clone()
    }
    /// Returns the cells of a goal with their levels, where it is described.
    pub fn goal_cells(&self, goal: u16) -> &[(i16, i16, i16, u16)] {
        self.beginning.goals.get(usize::from(goal)).map_or(&[], |goal| &goal.cells)
    }

    /// Returns the number of cells that a goal's shape has besides the goal's.
    pub fn omitted(&self, goal: u16) -> usize {
        self.beginning.goals.get(usize::from(goal)).map_or(0, |goal| goal.omitted)
    }

    /// Returns the beginning.
    pub fn beginning(&self) -> Value {
        json!(self.beginning)
    }

    /// Returns the events from number `from` on, as many as are sent at once, and the totals of the time bins
    /// from number `bin` on. If `width`, the reader's width of a bin in microseconds, is outdated, returns
    /// the totals of all bins.
    pub fn since(&self, from: usize, bin: usize, width: u64) -> Value {
        let from = from.min(self.events.len());
        let until = (from + EVENTS_AT_ONCE).min(self.events.len());
        let events: Vec<Value> =
            self.events[from..until].iter().map(|(at, e)| told(micros(*at), e)).collect();
        let present = self.flow.width().0 / 1_000;
        let first = if width == present { bin.min(self.flow.bins().len()) } else { 0 };
        let total = |b: &Bin| json!([b.totals, b.moves, b.filled, b.goal]);
        json!({
            "events": events,
            "next": until,
            "more": until < self.events.len(),
            "forgotten": self.forgotten,
            "now": micros(self.now),
            "width": present,
            "first": first,
            "totals": self.flow.bins()[first..].iter().map(total).collect::<Vec<_>>(),
            "over": self.over,
            "report": self.report,
            "outcome": self.report.as_ref().map(|r| &r.outcome).or(self.outcome.as_ref()),
            "troubles": self.troubles,
            "telling": self.telling,
        })
    }

    /// Returns the messages between modules in at most `count` time bins, from number `first` on.
    pub fn talk(&self, first: usize, count: usize) -> Value {
        let bins = self.flow.bins();
        let first = first.min(bins.len());
        let until = first.saturating_add(count).min(bins.len());
        let flat = |b: &Bin| -> Vec<u32> {
            b.edges.iter().flat_map(|e| [e.from.0, e.to.0].into_iter().chain(e.counts)).collect()
        };
        let locks = |b: &Bin| -> Vec<u32> { b.locks.iter().flat_map(|(h, o)| [h.0, o.0]).collect() };
        let bin = |b: &Bin| json!({ "edges": flat(b), "gradient": b.gradient, "locks": locks(b) });
        json!({
            "width": self.flow.width().0 / 1_000,
            "first": first,
            "bins": bins[first..until].iter().map(bin).collect::<Vec<_>>(),
        })
    }

    /// Returns the latest messages of a module up to the time `at`, in microseconds.
    pub fn messages(&self, id: ModuleId, at: u64) -> Value {
        // Up to the end of the microsecond that the page names.
        let at = Time(at.saturating_mul(1_000).saturating_add(999));
        json!({ "messages": self.flow.last_of(id, at, LAST_MESSAGES) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parts::Part;
    use crate::shared::Shared;
    use crate::visible::{Colour, Role, Stage, Words};
    use metamorph_core::link::Partition;
    use metamorph_core::record::Blob;
    use metamorph_kernel::kernel::recording::Log;

    /// Bodies without parts.
    struct Bodiless(usize);

    impl ShownSwarm for Bodiless {
        fn words(&self) -> &'static Words {
            &Words {
                module: "Module",
                modules: "modules",
                target: "cell",
                targets: "cells",
                distance: ["move", "moves"],
                actions: "moves",
                levels: ["first", "last"],
                roles: [Role { name: "a", colour: Colour::Idle, legend: "a", about: "a" }; 3],
                moving_role: None,
                scale: 1.0,
                scale_among_messages: None,
            }
        }
        fn stage(&self) -> Stage {
            Stage {
                time_step: Span::secs(1),
                goals: Vec::new(),
                targets: Targets::Cells,
                floor: None,
                contacts: Vec::new(),
            }
        }
        fn answer_within(&self) -> Option<Span> {
            None
        }
        fn start(&self) -> Vec<(Vec<Part>, String)> {
            vec![(Vec::new(), String::new()); self.0]
        }
        fn parts(&self, _place: &Blob) -> Option<Vec<Part>> {
            None
        }
        fn scribe(self: Box<Self>, _scene: Shared) -> Log {
            unreachable!("nothing is recorded")
        }
    }

    fn kinds(scene: &Scene) -> Vec<String> {
        let told = scene.since(0, 0, 0);
        let events = told["events"].as_array().expect("a list");
        events.iter().map(|e| format!("{} {}", e[0].as_str().unwrap_or("?"), e[2])).collect()
    }

    /// A refusal undoes the refused action, also when it is delayed.
    #[test]
    fn what_is_refused_has_not_happened() {
        let (from, until) = (Time(2_000_000_000), Time(4_000_000_000));
        let partition = Partition { side: [ModuleId(1)].into(), from, until };
        let changes = [(from, "partition"), (until, "partition ends")];
        let changes = changes.map(|(at, name)| LinkChange { at, name, effect: String::new() });
        let heading = Heading {
            title: String::new(),
            description: None,
            seed: None,
            link: "sim",
            repeat: String::new(),
            goals: Vec::new(),
            partitions: vec![partition],
            changes: changes.into(),
            hosts: None,
            commands: Vec::new(),
        };
        let mut scene = Scene::new(heading, &Bodiless(4), false);
        let at = |millis: u64| Time(millis * 1_000_000);
        let motion = Motion { takes: Span::secs(1), name: "slides".into(), segments: Vec::new() };
        let doing = || Some((motion.clone(), String::from("there")));
        // At once, then later, then later during another action; and one that cannot be drawn.
        scene.asked(at(100), ModuleId(1), doing());
        scene.went(at(100), ModuleId(1), ActionOutcome::Refused);
        scene.asked(at(200), ModuleId(2), doing());
        scene.went(at(201), ModuleId(2), ActionOutcome::Refused);
        scene.asked(at(300), ModuleId(3), doing());
        scene.asked(at(301), ModuleId(3), doing());
        scene.went(at(302), ModuleId(3), ActionOutcome::Refused);
        scene.asked(at(303), ModuleId(3), None);
        scene.went(at(304), ModuleId(3), ActionOutcome::Refused);
        scene.went(at(1_300), ModuleId(3), ActionOutcome::Done);
        assert!(scene.moving.is_empty());
        // A partition is an event at its time.
        scene.reach(at(3_000));
        // A motion is sent once, before the first body that begins it.
        let events = ["d [1000000,\"slides\",[]]", "m 2", "r 2", "m 3", "m 3", "r 3", "x null"];
        assert_eq!(kinds(&scene), events);
    }
}
