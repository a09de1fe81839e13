//! Composition of a figure from a snapshot: the chosen solids in painter's order, the goal, and the colour of each
//! module.

use super::camera::{P, View};
use super::links::LinkKind;
use super::options::{ColorBy, GoalStyle, Only, Style};
use super::order::painters_order;
use super::outline::{joined, outline};
use super::palette::{Rgb, Scale, State};
use super::snapshot::{Body, Process, Snapshot};
use super::solid::{Filled, Owner, Solid, filled_cell, of_cell, of_part};
use crate::parts::Part;
use crate::visible::{Colour, FILLS, Floor, Words};
use metamorph_core::counters::Class;
use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::Cell;
use metamorph_text::format::count;
use std::collections::{BTreeMap, BTreeSet};

/// A run as figures see it.
pub struct Subject<'a> {
    /// Content and appearance of the figure.
    pub style: &'a Style,
    /// The projection of its camera.
    pub view: View,
    /// The words of the family.
    pub words: &'static Words,
    /// The floor; `None` if bodies stand on each other.
    pub floor: Option<Floor>,
    /// Contacts that do not follow from the places of bodies.
    pub contacts: Vec<(ModuleId, ModuleId)>,
}

/// Properties that all pictures of a figure share, so that an animation stays still.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Extent {
    /// The lowest and the highest projected coordinates.
    pub plane: Option<[P; 2]>,
    /// The lowest and the highest cells with anything in them.
    pub cells: Option<[[i16; 3]; 2]>,
    /// The states that occur.
    pub states: BTreeSet<State>,
    /// The members of sets that occur, for colours that only tell apart.
    pub members: BTreeSet<usize>,
    /// The largest number on the scale of colours.
    pub most: Option<u64>,
    /// True if a module has no number, or belongs to no set.
    pub without: bool,
    /// The classes of drawn messages.
    pub classes: BTreeSet<Class>,
    /// The goal that is outlined, in words.
    pub goal: Option<String>,
    /// True if a module waits for another one, and that is drawn.
    pub waits: bool,
}

/// Meaning of a module's colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meaning {
    /// Its state.
    State(State),
    /// A number on a scale.
    Number(u64),
    /// Which member of a set it is.
    Member(usize),
    /// Nothing.
    Nothing,
}

/// The solids of a picture.
pub struct Composition {
    /// All that is seen.
    pub solids: Vec<Solid>,
    /// Their numbers from back to front.
    pub order: Vec<usize>,
    /// The outline of the goal.
    pub goal: Vec<Vec<P>>,
    /// The number of modules that were chosen.
    pub modules: usize,
}

impl Extent {
    fn point(&mut self, [x, y]: P) {
        let [low, high] = self.plane.unwrap_or([[x, y]; 2]);
        self.plane = Some([[low[0].min(x), low[1].min(y)], [high[0].max(x), high[1].max(y)]]);
    }
    fn cell(&mut self, cell: Cell) {
        let cell = <[i16; 3]>::from(cell);
        let [low, high] = self.cells.unwrap_or([cell; 2]);
        let with = |f: fn(i16, i16) -> i16, a: [i16; 3]| [0, 1, 2].map(|i| f(a[i], cell[i]));
        self.cells = Some([with(i16::min, low), with(i16::max, high)]);
    }
    /// Extends it by a picture.
    pub fn add(&mut self, subject: &Subject<'_>, snapshot: &Snapshot, composition: &Composition) {
        let points = composition.solids.iter().flat_map(|s| &s.facets).flat_map(|f| &f.points);
        points.chain(composition.goal.iter().flatten()).for_each(|point| self.point(*point));
        if !composition.goal.is_empty() {
            self.goal = Some(match (snapshot.goal.len(), snapshot.omitted) {
                (_, 0) => "goal".to_owned(),
                (cells, omitted) => {
                    let shape = count((cells + omitted) as u64);
                    format!("goal ({} of the {shape} cells of the shape)", count(cells as u64))
                }
            });
        }
        for link in subject.links(snapshot, composition) {
            match link.kind {
                LinkKind::Contact => {}
                LinkKind::Messages { class, .. } => drop(self.classes.insert(class)),
                LinkKind::Wait => self.waits = true,
            }
        }
        let levels = snapshot.levels();
        for solid in &composition.solids {
            match solid.owner {
                Owner::Module(id) => match subject.meaning(snapshot, &levels, id.index()) {
                    Meaning::State(state) => drop(self.states.insert(state)),
                    Meaning::Number(n) => self.most = Some(self.most.map_or(n, |most| most.max(n))),
                    Meaning::Member(member) => drop(self.members.insert(member)),
                    Meaning::Nothing => self.without = true,
                },
                Owner::Obstacle(_) => drop(self.states.insert(State::Obstacle)),
                Owner::Element(_, hold) => drop(self.states.insert(hold.into())),
                Owner::Goal(_) => {}
            }
        }
        let parts = snapshot.bodies.iter().flat_map(|b| &b.parts).map(Part::cell);
        parts.chain(snapshot.goal.iter().map(|(cell, _)| *cell)).for_each(|cell| self.cell(cell));
    }
    /// Extends it by the floor, which begins and ends where there is something on it.
    pub fn add_floor(&mut self, subject: &Subject<'_>) {
        let Some([low, high]) = subject.floor_shown(self) else { return };
        for (x, y) in [(low[0], low[1]), (low[0], high[1]), (high[0], low[1]), (high[0], high[1])] {
            self.point(subject.view.project([x, y, 0.0]));
        }
    }
}

impl Subject<'_> {
    /// Returns the corners of the floor that is drawn.
    pub fn floor_shown(&self, extent: &Extent) -> Option<[P; 2]> {
        let (floor, [low, high]) = (self.floor?, extent.cells?);
        if self.view.eye[2] < 0.0 {
            return None;
        }
        let corner = |f: fn(f64, f64) -> f64, edge: [i16; 2], cell: [i16; 3], by: f64| {
            [0, 1].map(|i| f(f64::from(edge[i]) + by / 2.0, f64::from(cell[i]) + by * 1.5))
        };
        Some([corner(f64::max, floor.min, low, -1.0), corner(f64::min, floor.max, high, 1.0)])
    }

    /// Returns what is seen of a snapshot.
    pub fn compose(&self, snapshot: &Snapshot) -> Composition {
        let levels = snapshot.levels();
        let keeps = |cell: Cell| self.style.sections.iter().all(|section| section.keeps(cell));
        let chosen = |i: usize| match &self.style.only {
            Only::All => true,
            Only::Goal => snapshot.level(&levels, i).is_some(),
            Only::Level(level) => snapshot.level(&levels, i) == Some(*level),
            Only::Modules(modules) => modules.contains(&(i as u32)),
        };
        let bodies: Vec<(ModuleId, &Body)> = snapshot
            .bodies
            .iter()
            .enumerate()
            .filter(|(i, _)| chosen(*i))
            .map(|(i, body)| (ModuleId(i as u32), body))
            .collect();
        let mut filled = Filled::default();
        let cells = bodies.iter().flat_map(|(_, body)| &body.parts).filter_map(filled_cell);
        for cell in cells.chain(snapshot.obstacles.iter().copied()) {
            if keeps(cell) {
                filled.drawn.insert(cell)
            } else {
                filled.cut.insert(cell)
            };
        }
        let parts = bodies.iter().flat_map(|(id, body)| body.parts.iter().map(|part| (*id, part)));
        let parts = parts.filter(|(_, part)| keeps(part.cell()));
        let mut solids: Vec<Solid> = parts.map(|(id, part)| of_part(&self.view, id, part, &filled)).collect();
        let obstacles = snapshot.obstacles.iter().filter(|cell| keeps(**cell));
        solids.extend(obstacles.map(|cell| {
            let owner = snapshot.elements.get(cell).map(|hold| Owner::Element(*cell, *hold));
            of_cell(&self.view, owner.unwrap_or(Owner::Obstacle(*cell)), *cell, &filled)
        }));
        let modules: BTreeSet<u32> = solids
            .iter()
            .filter_map(|s| match s.owner {
                Owner::Module(id) => Some(id.0),
                _ => None,
            })
            .collect();
        if self.style.goal == GoalStyle::Ghost {
            self.add_ghosts(snapshot, filled, keeps, &mut solids);
        }
        let goal = match self.style.goal {
            GoalStyle::Outline => {
                let goal: BTreeSet<Cell> = levels.keys().copied().filter(|cell| keeps(*cell)).collect();
                joined(&outline(&self.view, &goal))
            }
            GoalStyle::Ghost | GoalStyle::Off => Vec::new(),
        };
        Composition { order: painters_order(&self.view, &solids), solids, goal, modules: modules.len() }
    }

    /// Adds the cells of the goal that nothing is in.
    fn add_ghosts(
        &self,
        snapshot: &Snapshot,
        mut filled: Filled,
        keeps: impl Fn(Cell) -> bool,
        solids: &mut Vec<Solid>,
    ) {
        let taken: BTreeSet<Cell> = snapshot.bodies.iter().flat_map(|b| &b.parts).map(Part::cell).collect();
        let free = |cell: &Cell| !taken.contains(cell) && keeps(*cell);
        let ghosts: Vec<Cell> = snapshot.levels().into_keys().filter(free).collect();
        filled.cut.clear();
        filled.drawn.extend(&ghosts);
        solids.extend(ghosts.iter().map(|cell| of_cell(&self.view, Owner::Goal(*cell), *cell, &filled)));
    }

    /// Returns the state of a module.
    pub fn state(&self, body: &Body) -> State {
        match body.process {
            Process::Dead => return State::Dead,
            Process::Paused => return State::Paused,
            Process::Alive => {}
        }
        if body.view.is_some_and(|view| view.waits_for.is_some()) {
            return State::Waiting;
        }
        self.role(body).into()
    }

    fn role(&self, body: &Body) -> Colour {
        let told = body.view.map_or(0, |view| view.role);
        let role = self.words.moving_role.filter(|_| body.moving).unwrap_or(told);
        self.words.roles.get(usize::from(role)).map_or(Colour::Idle, |role| role.colour)
    }

    /// Returns what the colour of a module says.
    pub fn meaning(&self, snapshot: &Snapshot, levels: &BTreeMap<Cell, u16>, id: usize) -> Meaning {
        let Some(body) = snapshot.bodies.get(id) else { return Meaning::Nothing };
        let number = |n: Option<u16>| n.map_or(Meaning::Nothing, |n| Meaning::Number(n.into()));
        match self.style.color {
            ColorBy::State => Meaning::State(self.state(body)),
            ColorBy::Level => number(snapshot.level(levels, id)),
            ColorBy::Gradient => number(snapshot.gradient.get(id).copied().flatten()),
            ColorBy::Messages => Meaning::Number(snapshot.messages.get(id).copied().unwrap_or(0)),
            ColorBy::Seed => match body.view.filter(|view| view.role == FILLS) {
                Some(view) => Meaning::Member(view.place.max(0) as usize),
                None => Meaning::Nothing,
            },
            ColorBy::Locks => {
                let own = ModuleId(id as u32);
                let holds = snapshot.locks.values().any(|owner| *owner == own).then_some(own);
                let owner = snapshot.locks.get(&own).copied().or(holds);
                owner.map_or(Meaning::Nothing, |owner| Meaning::Member(owner.index()))
            }
            ColorBy::Module => Meaning::Member(id),
            ColorBy::None => Meaning::Nothing,
        }
    }

    /// Returns the scale of colours.
    pub fn scale(&self) -> Scale {
        if self.style.color == ColorBy::Messages { Scale::Cividis } else { Scale::Viridis }
    }

    /// Returns the place of a number on the scale: linear, but logarithmic for messages.
    pub fn share(&self, n: u64, most: u64) -> f64 {
        let height = |n: u64| match self.style.color {
            ColorBy::Messages => libm::log(n as f64 + 1.0),
            _ => n as f64,
        };
        if most == 0 { 0.0 } else { height(n) / height(most) }
    }

    /// Returns the colour of a meaning.
    pub fn colour(&self, meaning: Meaning, most: u64) -> Rgb {
        let theme = self.style.theme;
        match meaning {
            Meaning::State(state) => theme.state(state),
            Meaning::Number(n) => theme.scale(self.scale(), self.share(n, most)),
            Meaning::Member(member) => theme.distinct(member),
            Meaning::Nothing => theme.plain(),
        }
    }
}
