//! The state of a run at one moment, made from its scene: bodies where they are, in motion too.

use crate::bodies::ShownSwarm;
use crate::elements::Hold;
use crate::parts::{Motion, Part};
use crate::scene::{Event, Scene};
use crate::visible::{GoalView, ModuleView};
use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::Cell;
use metamorph_core::time::Time;
use metamorph_report::message_timeline::{Edge, FAR};
use std::collections::BTreeMap;

/// The state of a module's process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Process {
    /// It runs.
    #[default]
    Alive,
    /// It has been stopped.
    Paused,
    /// It has died.
    Dead,
}

/// A module at a moment.
#[derive(Clone, Debug)]
pub struct Body {
    /// Its parts, where they are.
    pub parts: Vec<Part>,
    /// True while it carries out an action.
    pub moving: bool,
    /// Its latest report.
    pub view: Option<ModuleView>,
    /// Its process.
    pub process: Process,
}

/// A run at a moment.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// The time.
    pub at: Time,
    /// All modules.
    pub bodies: Vec<Body>,
    /// The cells with a foreign object in them.
    pub obstacles: Vec<Cell>,
    /// Of these, the cells of passive elements.
    pub elements: BTreeMap<Cell, Hold>,
    /// The cells of the goal with their levels, in the goal's order.
    pub goal: Vec<(Cell, u16)>,
    /// The number of cells that the goal's shape has besides.
    pub omitted: usize,
    /// The distance of each module to a target, in moves; `None` if it knows of none.
    pub gradient: Vec<Option<u16>>,
    /// The messages that each module has sent and received so far.
    pub messages: Vec<u64>,
    /// The length of a time bin, in seconds.
    pub bin: f64,
    /// The messages of the time bin of the moment.
    pub edges: Vec<Edge>,
    /// Modules with those that they have promised to stay for.
    pub locks: BTreeMap<ModuleId, ModuleId>,
}

impl Body {
    /// Returns the middle of its parts.
    pub fn middle(&self) -> [f64; 3] {
        let sum: nalgebra::Vector3<f64> = self.parts.iter().map(Part::centre).sum();
        (sum / self.parts.len().max(1) as f64).into()
    }
}

impl Snapshot {
    /// Returns the level of the goal's cell that the first part of a body is in.
    pub fn level(&self, levels: &BTreeMap<Cell, u16>, id: usize) -> Option<u16> {
        levels.get(&self.bodies.get(id)?.parts.first()?.cell()).copied()
    }
    /// Returns the cells of the goal with their levels, by cell.
    pub fn levels(&self) -> BTreeMap<Cell, u16> {
        self.goal.iter().copied().collect()
    }
}

struct Course {
    /// The parts before the motion in progress.
    parts: Vec<Part>,
    /// The beginning and the number of that motion.
    doing: Option<(Time, usize)>,
    view: Option<ModuleView>,
    process: Process,
}

/// A position in a scene, from which later moments can be reached.
pub struct Playback<'s> {
    scene: &'s Scene,
    next: usize,
    motions: Vec<&'s Motion>,
    courses: Vec<Course>,
    obstacles: Vec<Cell>,
    elements: BTreeMap<Cell, Hold>,
    goal: GoalView,
    bin: usize,
    messages: Vec<u64>,
}

impl<'s> Playback<'s> {
    /// Returns the beginning of a scene.
    pub fn new(scene: &'s Scene, swarm: &dyn ShownSwarm) -> Playback<'s> {
        let course = |(parts, _)| Course { parts, doing: None, view: None, process: Process::Alive };
        let courses: Vec<Course> = swarm.start().into_iter().map(course).collect();
        Playback {
            scene,
            next: 0,
            motions: Vec::new(),
            messages: vec![0; courses.len()],
            courses,
            obstacles: Vec::new(),
            elements: BTreeMap::new(),
            goal: GoalView::default(),
            bin: 0,
        }
    }

    /// Goes on to `at`, which must not be before the last one, and returns the state there.
    pub fn advance(&mut self, at: Time) -> Snapshot {
        let events = self.scene.events();
        while let Some((_, event)) = events.get(self.next).filter(|(time, _)| *time <= at) {
            self.take(event);
            self.next += 1;
        }
        let (width, bins) = self.scene.bins();
        let until = ((at.0 / width.0.max(1)) as usize + 1).min(bins.len());
        for edge in bins[self.bin..until].iter().flat_map(|bin| &bin.edges) {
            let count = edge.counts.iter().map(|n| u64::from(*n)).sum::<u64>();
            for id in [edge.from, edge.to] {
                if let Some(messages) = self.messages.get_mut(id.index()) {
                    *messages += count;
                }
            }
        }
        self.bin = until;
        let present = until.checked_sub(1).and_then(|last| bins.get(last));
        let known = present.map_or(&[][..], |bin| &bin.gradient);
        let gradient = |i: usize| known.get(i).copied().filter(|distance| *distance != FAR);
        Snapshot {
            at,
            bodies: self.courses.iter().map(|course| self.body(course, at)).collect(),
            obstacles: self.obstacles.clone(),
            elements: self.elements.clone(),
            goal: self.goal_cells(),
            omitted: self.scene.omitted(self.goal.number),
            gradient: (0..self.courses.len()).map(gradient).collect(),
            messages: self.messages.clone(),
            bin: width.as_secs_f64(),
            edges: present.map_or_else(Vec::new, |bin| bin.edges.clone()),
            locks: present.into_iter().flat_map(|bin| bin.locks.iter().copied()).collect(),
        }
    }

    fn take(&mut self, event: &'s Event) {
        if let Event::Motion(motion) = event {
            self.motions.push(motion);
        }
        match event {
            Event::Does(id, motion, _) => {
                self.settle(*id);
                let begin = self.scene.events()[self.next].0;
                self.of(*id, |course| course.doing = Some((begin, *motion as usize)));
            }
            Event::Failed(id, _) | Event::Refused(id) => self.of(*id, |course| course.doing = None),
            Event::Tells(id, view) => self.of(*id, |course| course.view = Some(*view)),
            Event::Died(id) => self.of(*id, |course| course.process = Process::Dead),
            Event::Started(id) | Event::Resumed(id) => self.of(*id, |course| course.process = Process::Alive),
            Event::Paused(id) => self.of(*id, |course| course.process = Process::Paused),
            Event::Obstacles(cells) => self.obstacles.clone_from(cells),
            Event::Elements(all) => {
                let cells = all.iter().flat_map(|e| e.cells.iter().map(move |cell| (*cell, e.hold)));
                self.elements = cells.collect();
            }
            Event::Goal(goal) => self.goal = *goal,
            Event::Motion(_) | Event::Injected(..) => {}
        }
    }

    fn of(&mut self, id: ModuleId, change: impl FnOnce(&mut Course)) {
        if let Some(course) = self.courses.get_mut(id.index()) {
            change(course);
        }
    }

    /// Puts a body where its last motion has taken it.
    fn settle(&mut self, id: ModuleId) {
        let Some(course) = self.courses.get_mut(id.index()) else { return };
        if let Some((_, motion)) = course.doing.take()
            && let Some(motion) = self.motions.get(motion)
        {
            motion.carry(&mut course.parts, 1.0);
        }
    }

    fn body(&self, course: &Course, at: Time) -> Body {
        let mut parts = course.parts.clone();
        let mut moving = false;
        if let Some((begin, motion)) = course.doing
            && let Some(motion) = self.motions.get(motion)
        {
            let fraction = at.since(begin).as_secs_f64() / motion.takes.as_secs_f64().max(1e-9);
            motion.carry(&mut parts, fraction.min(1.0));
            moving = fraction < 1.0;
        }
        Body { parts, moving, view: course.view, process: course.process }
    }

    fn goal_cells(&self) -> Vec<(Cell, u16)> {
        let cells = self.scene.goal_cells(self.goal.number).iter();
        cells.map(|(x, y, z, level)| (self.goal.place((*x, *y, *z)), *level)).collect()
    }
}
