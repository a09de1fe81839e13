//! A drawn scenario as a value: small enough to be taken apart, and written as an ordinary scenario
//! file. What is broken when is listed fault by fault, so that single faults can be left out.
//!
//! Absent: drawing one (`draw`) and taking one apart (`shrink`).

use crate::family::draft::{SwarmDraft, cells};
use crate::family::read_text;
use crate::scenario::problems::Problems;
use crate::scenario::{LinkKind, Overrides, Plan};
use metamorph_protocol::defects::Sabotage;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::time::Span;
use std::fmt;

/// A scenario as a value.
#[derive(Clone, Debug)]
pub struct Draft {
    /// What it shows.
    pub description: String,
    /// The seed of the run.
    pub seed: u64,
    /// What runs and what it builds.
    pub swarm: Box<dyn SwarmDraft>,
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
        self.swarm.modules()
    }
    /// The number of goal cells, or seeds, of all goals.
    pub fn goal_cells(&self) -> usize {
        self.swarm.goal_cells()
    }
    /// The plan to run, with a defect of the protocol if a test wants one.
    pub fn plan(&self, origin: &str, defect: Option<Sabotage>) -> Result<Plan, Problems> {
        let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
        let mut plan = read_text(origin, &self.to_string(), &overrides)?;
        plan.swarm = plan.swarm.with_defect(defect);
        Ok(plan)
    }
    /// One line about it.
    pub fn summary(&self) -> String {
        let (what, faults) = (self.swarm.summary(), self.faults.len());
        format!("{what}, {} goal cells, {faults} faults", self.goal_cells())
    }
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
        self.swarm.write(f, self.failed_connections)?;
        let LinkDraft { delay: (min, max), loss, duplicate, reorder, corrupt, until } = self.link;
        writeln!(f, "\n[link]\ndelay = \"{}..{}\"", Span::millis(min), Span::millis(max))?;
        for (key, percent) in
            [("loss", loss), ("duplicate", duplicate), ("reorder", reorder), ("corrupt", corrupt)]
        {
            if percent > 0 {
                writeln!(f, "{key} = \"{percent}%\"")?;
            }
        }
        if let Some(until) = until {
            writeln!(f, "until = \"{}\"", Span::millis(until))?;
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

impl fmt::Display for FaultDraft {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "\n[[fault]]")?;
        let at = Span::millis(self.at);
        let until = self.until.map(Span::millis);
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
