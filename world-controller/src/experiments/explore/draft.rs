//! A drawn scenario as a value: small enough to be taken apart, and written as an ordinary scenario
//! file. What is broken when is listed fault by fault, so that single faults can be left out.
//!
//! Absent: drawing one (`draw`) and taking one apart (`shrink`).

use crate::scenario::problems::Problems;
use crate::scenario::{LinkKind, Overrides, Plan, Swarm, read_text};
use metamorph_protocol::cube::params::Connectivity;
use metamorph_protocol::defects::Sabotage;
use metamorph_protocol::goal::Growth;
use metamorph_protocol::lattice::{Cell, Face};
use metamorph_protocol::metamodule::blueprint::{Seed, SeedOrder};
use metamorph_protocol::metamodule::params::{Precedence, Strategy, Teller};
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::grid::GridState;
use metamorph_protocol::time::Span;
use std::fmt;
use std::sync::Arc;

/// A scenario as a value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Draft {
    /// What it shows.
    pub description: String,
    /// The seed of the run.
    pub seed: u64,
    /// What runs and what it builds.
    pub swarm: SwarmDraft,
    /// How often a move or connection fails, in percent.
    pub failed_connections: u8,
    /// What is done to messages.
    pub link: LinkDraft,
    /// What is broken when.
    pub faults: Vec<FaultDraft>,
    /// The bounds for standing still and for moving without progress, in seconds, if they are not the
    /// usual ones.
    pub patience: Option<(u64, u64)>,
}

/// What belongs to one family.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SwarmDraft {
    /// Cubes.
    Cubes(CubeDraft),
    /// Metamodules.
    Metamodules(MetamoduleDraft),
}

/// A swarm of cubes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CubeDraft {
    /// Where the modules are at first, in ascending order: their numbers are their places here.
    pub start: Vec<Cell>,
    /// What is built, one after the other; never empty.
    pub goals: Vec<CubeGoal>,
    /// The connectivity check.
    pub connectivity: Connectivity,
    /// Whether all neighbours of a cell are asked for it.
    pub co_owners: bool,
}

/// A goal of cubes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CubeGoal {
    /// Its cells in ascending order.
    pub cells: Vec<Cell>,
    /// Where it begins.
    pub seed: Cell,
    /// How it grows.
    pub growth: Growth,
}

/// A swarm of metamodules.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MetamoduleDraft {
    /// What they are made of.
    pub kind: Kind,
    /// Connectors along each side of the floor.
    pub side: i16,
    /// Where they stand at first; none if that is still to be drawn, for so many.
    pub start: Result<Vec<GridState>, usize>,
    /// What is built, and from when on, in milliseconds; the first from the beginning.
    pub goals: Vec<(u64, MetamoduleGoal)>,
    /// How they decide.
    pub strategy: Strategy,
    /// Who says which seeds are open.
    pub teller: Teller,
    /// Whether a goal that something is in the way of is moved.
    pub relocate: bool,
    /// Which of two close together goes first. `negotiated` has neither this nor the next.
    pub precedence: Option<Precedence>,
    /// Whether settled ones push.
    pub settled_repel: bool,
}

/// A goal of metamodules.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MetamoduleGoal {
    /// Its seeds, level by level.
    pub levels: Vec<Vec<Seed>>,
    /// Which seed of a level comes when.
    pub order: SeedOrder,
}

/// A link: times in milliseconds, probabilities in percent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkDraft {
    /// The shortest and the longest delay.
    pub delay: (u64, u64),
    /// How many messages are lost.
    pub loss: u8,
    /// How many come twice.
    pub duplicate: u8,
    /// How many are overtaken.
    pub reorder: u8,
    /// How many are damaged.
    pub corrupt: u8,
    /// When all that but the delay ends.
    pub until: Option<u64>,
}

impl LinkDraft {
    /// Whether it does more than delay messages.
    pub fn harms(&self) -> bool {
        [self.loss, self.duplicate, self.reorder, self.corrupt].iter().any(|evil| *evil > 0)
    }
}

/// A fault: times in milliseconds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FaultDraft {
    /// What breaks.
    pub what: Break,
    /// When it breaks.
    pub at: u64,
    /// When it is whole again, if it ever is. Stopped processes and cut links always are.
    pub until: Option<u64>,
}

/// What breaks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Break {
    /// The process of a module dies.
    Kill(u32),
    /// It dies and is started again.
    Restart(u32),
    /// It is stopped for a while.
    Pause(u32),
    /// Its joints stick.
    Stick(u32),
    /// These cannot talk to the others for a while.
    Partition(Vec<u32>),
    /// Something foreign is in a cell.
    Obstacle(Cell),
}

impl Break {
    /// The modules it names.
    pub fn modules(&self) -> &[u32] {
        match self {
            Break::Kill(id) | Break::Restart(id) | Break::Pause(id) | Break::Stick(id) => {
                std::slice::from_ref(id)
            }
            Break::Partition(side) => side,
            Break::Obstacle(_) => &[],
        }
    }
    /// The same about another module.
    pub fn instead(&self, of: u32, other: u32) -> Break {
        let one = |id: &u32| if *id == of { other } else { *id };
        match self {
            Break::Kill(id) => Break::Kill(one(id)),
            Break::Restart(id) => Break::Restart(one(id)),
            Break::Pause(id) => Break::Pause(one(id)),
            Break::Stick(id) => Break::Stick(one(id)),
            Break::Partition(side) if side.contains(&other) => self.clone(),
            Break::Partition(side) => Break::Partition(side.iter().map(one).collect()),
            Break::Obstacle(cell) => Break::Obstacle(*cell),
        }
    }
    /// The same after a module is gone and those behind it have moved up; none if it was about that one.
    pub fn without(&self, gone: u32) -> Option<Break> {
        let up = |id: &u32| (*id != gone).then_some(*id - u32::from(*id > gone));
        Some(match self {
            Break::Kill(id) => Break::Kill(up(id)?),
            Break::Restart(id) => Break::Restart(up(id)?),
            Break::Pause(id) => Break::Pause(up(id)?),
            Break::Stick(id) => Break::Stick(up(id)?),
            Break::Partition(side) => {
                let side: Vec<u32> = side.iter().filter_map(up).collect();
                Break::Partition((!side.is_empty()).then_some(side)?)
            }
            Break::Obstacle(cell) => Break::Obstacle(*cell),
        })
    }
}

impl Draft {
    /// The number of modules.
    pub fn modules(&self) -> usize {
        match &self.swarm {
            SwarmDraft::Cubes(cubes) => cubes.start.len(),
            SwarmDraft::Metamodules(m) => m.start.as_ref().map_or_else(|n| *n, Vec::len),
        }
    }
    /// The number of goal cells, or seeds, of all goals.
    pub fn goal_cells(&self) -> usize {
        match &self.swarm {
            SwarmDraft::Cubes(cubes) => cubes.goals.iter().map(|g| g.cells.len()).sum(),
            SwarmDraft::Metamodules(m) => m.goals.iter().flat_map(|(_, g)| &g.levels).map(Vec::len).sum(),
        }
    }
    /// The plan to run, with a defect of the protocol if a test wants one.
    pub fn plan(&self, origin: &str, sabotage: Option<Sabotage>) -> Result<Plan, Problems> {
        let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
        let mut plan = read_text(origin, &self.to_string(), &overrides)?;
        match &mut plan.swarm {
            Swarm::Cubes(cubes) => Arc::make_mut(&mut cubes.setup).params.sabotage = sabotage,
            Swarm::Metamodules(m) => Arc::make_mut(&mut m.setup).params.sabotage = sabotage,
        }
        Ok(plan)
    }
    /// One line about it.
    pub fn summary(&self) -> String {
        let what = match &self.swarm {
            SwarmDraft::Cubes(c) => {
                format!("{} cubes, {}", c.start.len(), name_of(c.connectivity))
            }
            SwarmDraft::Metamodules(m) => {
                format!("{} metamodules {}, {}", self.modules(), m.kind.name(), m.strategy.name())
            }
        };
        format!("{what}, {} goal cells, {} faults", self.goal_cells(), self.faults.len())
    }
}

/// The name used in scenarios.
pub const fn name_of(connectivity: Connectivity) -> &'static str {
    match connectivity {
        Connectivity::Forest => "forest",
        Connectivity::Cycles => "cycles",
        Connectivity::Gradient => "gradient",
    }
}

/// The name of a direction in a scenario.
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

fn cells(cells: &[Cell]) -> String {
    let all: Vec<String> = cells.iter().map(|c| format!("[{}, {}, {}]", c.x, c.y, c.z)).collect();
    all.join(", ")
}

fn span(millis: u64) -> Span {
    Span::millis(millis)
}

impl fmt::Display for Draft {
    /// As a scenario file.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "version = 1")?;
        if !self.description.is_empty() {
            // A basic string of TOML escapes what a string of JSON escapes.
            writeln!(f, "description = {}", serde_json::Value::from(self.description.as_str()))?;
        }
        writeln!(f, "seed = {}\n\n[swarm]", self.seed)?;
        match &self.swarm {
            SwarmDraft::Cubes(cubes) => cubes.write(f, self.failed_connections)?,
            SwarmDraft::Metamodules(metamodules) => metamodules.write(f, self.failed_connections)?,
        }
        let LinkDraft { delay: (min, max), loss, duplicate, reorder, corrupt, until } = self.link;
        writeln!(f, "\n[link]\ndelay = \"{}..{}\"", span(min), span(max))?;
        for (key, percent) in
            [("loss", loss), ("duplicate", duplicate), ("reorder", reorder), ("corrupt", corrupt)]
        {
            if percent > 0 {
                writeln!(f, "{key} = \"{percent}%\"")?;
            }
        }
        if let Some(until) = until {
            writeln!(f, "until = \"{}\"", span(until))?;
        }
        self.faults.iter().try_for_each(|fault| fault.fmt(f))?;
        match self.patience {
            Some((stall, livelock)) => {
                writeln!(f, "\n[stop]\nstall = \"{stall}s\"\nlivelock = \"{livelock}s\"")
            }
            None => Ok(()),
        }
    }
}

impl CubeDraft {
    fn write(&self, f: &mut fmt::Formatter<'_>, failed: u8) -> fmt::Result {
        writeln!(f, "start = {{ cells = [{}] }}", cells(&self.start))?;
        if failed > 0 {
            writeln!(f, "failed_connections = \"{failed}%\"")?;
        }
        for goal in &self.goals {
            let growth = match goal.growth {
                Growth::Scaffold => "scaffold",
                Growth::Solid => "solid",
            };
            writeln!(f, "\n[[goal]]\nshape = {{ cells = [{}] }}", cells(&goal.cells))?;
            writeln!(f, "seed = {}\ngrowth = \"{growth}\"", cells(&[goal.seed]))?;
        }
        writeln!(f, "\n[protocol]\nconnectivity = \"{}\"", name_of(self.connectivity))?;
        writeln!(f, "co_owners = {}", self.co_owners)
    }
}

impl MetamoduleDraft {
    fn write(&self, f: &mut fmt::Formatter<'_>, failed: u8) -> fmt::Result {
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
        if failed > 0 {
            writeln!(f, "failed_connections = \"{failed}%\"")?;
        }
        for (i, (at, goal)) in self.goals.iter().enumerate() {
            writeln!(f, "\n[[goal]]")?;
            if i > 0 {
                writeln!(f, "at = \"{}\"", span(*at))?;
            }
            let seed = |s: &Seed| {
                let faces = s.directions.map(|d| format!("\"{}\"", face_name(d))).join(", ");
                format!("{{ foot = [{}, {}], directions = [{faces}] }}", s.foot.0, s.foot.1)
            };
            let level = |l: &Vec<Seed>| format!("[{}]", l.iter().map(seed).collect::<Vec<_>>().join(", "));
            let levels: Vec<String> = goal.levels.iter().map(level).collect();
            writeln!(f, "levels = [{}]\norder = \"{}\"", levels.join(", "), goal.order.name())?;
        }
        let teller = match self.teller {
            Teller::Controller => "controller",
            Teller::Neighbours => "neighbours",
        };
        writeln!(f, "\n[protocol]\nstrategy = \"{}\"\nteller = \"{teller}\"", self.strategy.name())?;
        writeln!(f, "relocate = {}", self.relocate)?;
        if self.strategy == Strategy::Negotiated {
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
}

impl fmt::Display for FaultDraft {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "\n[[fault]]")?;
        let at = span(self.at);
        let until = self.until.map(span);
        let end = until.map_or(String::new(), |u| format!("until = \"{u}\"\n"));
        match &self.what {
            Break::Kill(id) => writeln!(f, "kill = {id}\nat = \"{at}\""),
            Break::Restart(id) => writeln!(f, "restart = {id}\nat = \"{at}\""),
            Break::Pause(id) => write!(f, "pause = {id}\nfrom = \"{at}\"\n{end}"),
            Break::Stick(id) => write!(f, "stick = {id}\nat = \"{at}\"\n{end}"),
            Break::Obstacle(cell) => write!(f, "obstacle = {}\nat = \"{at}\"\n{end}", cells(&[*cell])),
            Break::Partition(side) => {
                let until = until.unwrap_or_default();
                writeln!(f, "partition = {{ modules = {side:?}, from = \"{at}\", until = \"{until}\" }}")
            }
        }
    }
}
