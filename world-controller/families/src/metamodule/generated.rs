//! A randomly generated swarm of metamodules and its goals.

use super::Metamodules;
use crate::generated::{Dice, Failing, GeneratedSwarm, Smaller};
use metamorph_protocol::lattice::{Cell, Face};
use metamorph_protocol::metamodule::blueprint::{Seed, SeedOrder};
use metamorph_protocol::metamodule::params::{Precedence, SeedAuthority, Strategy};
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::grid::GridState;
use metamorph_protocol::time::Span;
use metamorph_scenario::family::Swarm;
use std::fmt;

/// A swarm of metamodules.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GeneratedMetamodules {
    /// The kind of all metamodules.
    pub kind: Kind,
    /// Connectors along each side of the floor.
    pub side: i16,
    /// The start places, or the number of metamodules if the places are still to be drawn.
    pub start: Result<Vec<GridState>, usize>,
    /// The goals with their start times in milliseconds; the first starts at 0.
    pub goals: Vec<(u64, MetamoduleGoal)>,
    /// The strategy of all metamodules.
    pub strategy: Strategy,
    /// Which instance opens seeds.
    pub seed_authority: SeedAuthority,
    /// True if an obstructed goal is moved.
    pub relocate: bool,
    /// Which of two metamodules close together goes first. `negotiated` has neither this nor `settled_repel`.
    pub precedence: Option<Precedence>,
    /// True if settled metamodules repel others.
    pub settled_repel: bool,
    /// A passive element.
    pub element: Option<GeneratedElement>,
}

/// A passive element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GeneratedElement {
    /// The name of its shape.
    pub shape: &'static str,
    /// Its mass in grams.
    pub grams: u32,
    /// Where its cell (0, 0, 0) lies at the start.
    pub at: Cell,
    /// Where that cell is in the end.
    pub to: Cell,
}

/// A goal of metamodules.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MetamoduleGoal {
    /// Its seeds, level by level.
    pub levels: Vec<Vec<Seed>>,
    /// The order in which the seeds of a level open.
    pub order: SeedOrder,
}

impl GeneratedSwarm for GeneratedMetamodules {
    fn modules(&self) -> usize {
        self.start.as_ref().map_or_else(|n| *n, Vec::len)
    }
    fn goal_cells(&self) -> usize {
        self.goals.iter().flat_map(|(_, g)| &g.levels).map(Vec::len).sum()
    }
    fn summary(&self) -> String {
        let element = self.element.as_ref().map_or_else(String::new, |e| format!(" with a {}", e.shape));
        format!("{} metamodules {}, {}{element}", self.modules(), self.kind.name(), self.strategy.name())
    }
    fn settle(&mut self, swarm: &Swarm) -> bool {
        let (true, Some(placed)) = (self.start.is_err(), swarm.of::<Metamodules>()) else { return false };
        self.start = Ok(placed.poses.iter().map(|p| p.state).collect());
        true
    }
    fn obstacle(&self, dice: &mut Dice) -> Option<Cell> {
        let mut along = || dice.0.below(self.side as u64) as i16;
        let (x, y) = (along(), along());
        Some(Cell::new(x, y, dice.0.below(4) as i16))
    }
    fn elements(&self) -> u16 {
        u16::from(self.element.is_some())
    }
    fn write(&self, f: &mut fmt::Formatter<'_>, failing: Failing) -> fmt::Result {
        let last = self.side - 1;
        writeln!(f, "family = \"metamodule\"\nkind = \"{}\"", self.kind.name())?;
        writeln!(f, "floor = {{ min = [0, 0], max = [{last}, {last}] }}")?;
        match &self.start {
            Err(count) => writeln!(f, "count = {count}\nstart = \"random\"")?,
            Ok(places) => {
                let place = |s: &GridState| format!("{{ at = [{}, {}], class = {} }}", s.x, s.y, s.class);
                let places: Vec<String> = places.iter().map(place).collect();
                writeln!(f, "start = [{}]", places.join(", "))?;
            }
        }
        failing.write(f, true)?;
        if let Some(GeneratedElement { shape, grams, at, to }) = &self.element {
            let kilograms = f64::from(*grams) / 1000.0;
            writeln!(f, "\n[[swarm.element]]\nshape = \"{shape}\"\nmass = {kilograms}")?;
            writeln!(f, "at = {{ cell = [{}, {}, {}] }}", at.x, at.y, at.z)?;
            writeln!(f, "to = {{ cell = [{}, {}, {}] }}", to.x, to.y, to.z)?;
        }
        for (i, (at, goal)) in self.goals.iter().enumerate() {
            writeln!(f, "\n[[goal]]")?;
            if i > 0 {
                writeln!(f, "at = \"{}\"", Span::millis(*at))?;
            }
            let seed = |s: &Seed| {
                let faces = s.directions.map(|d| format!("\"{}\"", face_name(d))).join(", ");
                format!("{{ foot = [{}, {}], directions = [{faces}] }}", s.foot.0, s.foot.1)
            };
            let level = |l: &Vec<Seed>| format!("[{}]", l.iter().map(seed).collect::<Vec<_>>().join(", "));
            let levels: Vec<String> = goal.levels.iter().map(level).collect();
            writeln!(f, "levels = [{}]\norder = \"{}\"", levels.join(", "), goal.order.name())?;
        }
        let seed_authority = match self.seed_authority {
            SeedAuthority::Controller => "controller",
            SeedAuthority::Neighbours => "neighbours",
        };
        writeln!(
            f,
            "\n[protocol]\nstrategy = \"{}\"\nseed_authority = \"{seed_authority}\"",
            self.strategy.name()
        )?;
        writeln!(f, "relocate = {}", self.relocate)?;
        if !self.strategy.is_published() {
            return Ok(());
        }
        match self.precedence {
            None => writeln!(f, "precedence = \"off\"")?,
            Some(p) => {
                writeln!(f, "precedence = {{ within = {}, by = \"{}\" }}", p.within, p.by.name())?;
            }
        }
        writeln!(f, "settled_repel = {}", self.settled_repel)
    }
    fn smaller(&self) -> Vec<Smaller> {
        let (metamodules, mut found) = (self, Vec::new());
        let mut add = |m: GeneratedMetamodules, gone| {
            found.push(Smaller { swarm: Box::new(m), gone, replaced: false });
        };
        for goal in (0..metamodules.goals.len()).filter(|_| metamodules.goals.len() > 1) {
            let mut fewer = metamodules.clone();
            fewer.goals.remove(goal);
            add(fewer, 0..0);
        }
        let mut fewer_seeds = Vec::new();
        for (i, (_, goal)) in metamodules.goals.iter().enumerate() {
            for (j, level) in goal.levels.iter().enumerate() {
                for seed in 0..level.len() {
                    let mut fewer = metamodules.clone();
                    fewer.goals[i].1.levels[j].remove(seed);
                    fewer.goals[i].1.levels.retain(|l| !l.is_empty());
                    fewer_seeds.push(fewer);
                }
            }
        }
        let places = metamodules.start.as_ref().map_or(0, Vec::len);
        // With one seed less, one more metamodule can be removed.
        for fewer in [metamodules.clone()].iter().chain(&fewer_seeds) {
            for id in 0..places {
                let mut fewer = fewer.clone();
                if let Ok(places) = &mut fewer.start {
                    places.remove(id);
                }
                add(fewer, id..id + 1);
            }
        }
        fewer_seeds.into_iter().for_each(|fewer| add(fewer, 0..0));
        if metamodules.element.is_some() {
            add(GeneratedMetamodules { element: None, ..metamodules.clone() }, 0..0);
        }
        if metamodules.relocate {
            add(GeneratedMetamodules { relocate: false, ..metamodules.clone() }, 0..0);
        }
        if metamodules.seed_authority != SeedAuthority::Controller {
            add(
                GeneratedMetamodules { seed_authority: SeedAuthority::Controller, ..metamodules.clone() },
                0..0,
            );
        }
        found
    }
}

/// Returns the name of a direction in scenarios.
pub const fn face_name(face: Face) -> &'static str {
    match face {
        Face::Up => "up",
        Face::Down => "down",
        Face::North => "north",
        Face::South => "south",
        Face::East => "east",
        Face::West => "west",
    }
}
