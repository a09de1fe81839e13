//! A generated scenario as a value: easy to reduce, and written as an ordinary scenario file. Faults are
//! listed one by one, so that single faults can be removed.
//!
//! Absent: generating one (`draw`) and reducing one (`shrink`).

use metamorph_families::generated::{Failing, GeneratedSwarm, cells};
use metamorph_processes::family::read_text;
use metamorph_protocol::defects::Defect;
use metamorph_protocol::ids::{HostId, ModuleId};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::time::Span;
use metamorph_scenario::diagnostics::Diagnostics;
use metamorph_scenario::{LinkKind, Overrides, Plan};
use metamorph_sim_bridge::director::faults::Fault;
use metamorph_sim_bridge::director::link_faults::LinkFault;
use metamorph_sim_bridge::director::rescue::Rescue;
use metamorph_sim_bridge::director::steering::Steering;
use std::fmt;

/// A scenario as a value.
#[derive(Clone, Debug)]
pub struct GeneratedScenario {
    /// Its description.
    pub description: String,
    /// The seed of the run.
    pub seed: u64,
    /// The modules and their goals.
    pub swarm: Box<dyn GeneratedSwarm>,
    /// How moves and connections fail.
    pub failing: Failing,
    /// The link.
    pub link: GeneratedLink,
    /// The faults.
    pub faults: Vec<GeneratedFault>,
    /// The help of the controller for modules that stand still.
    pub rescue: Rescue,
    /// The bounds for a standstill and for moves without progress, in seconds; `None` for the defaults.
    pub patience: Option<(u64, u64)>,
}

/// A link: times in milliseconds, probabilities in percent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GeneratedLink {
    /// The shortest and the longest delay.
    pub delay: (u64, u64),
    /// Messages lost.
    pub loss: u8,
    /// Messages duplicated.
    pub duplicate: u8,
    /// Messages reordered.
    pub reorder: u8,
    /// Messages damaged.
    pub corrupt: u8,
    /// End of all impairments but the delay.
    pub until: Option<u64>,
    /// Delays that half of the messages, 99 % and all do not exceed, in place of `delay`.
    pub quantiles: Option<[u64; 3]>,
    /// Bursts: the probabilities to begin and to end one, and of loss within.
    pub burst: Option<[u8; 3]>,
    /// The link of one module, if it is another one.
    pub own: Option<OwnLink>,
    /// The hosts, if there are several.
    pub hosts: Option<GeneratedHosts>,
}

/// Several hosts with equal blocks of modules, and the link between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GeneratedHosts {
    /// How many.
    pub count: u16,
    /// The shortest and the longest delay between them.
    pub delay: (u64, u64),
    /// Messages lost between them.
    pub loss: u8,
    /// After how long the modules of a host that is down start elsewhere; `None` if they have crashed.
    pub fence: Option<u64>,
}

/// The link between a module and all others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OwnLink {
    /// The module.
    pub module: u32,
    /// Whether only what it sends is meant.
    pub one_way: bool,
    /// The shortest and the longest delay.
    pub delay: (u64, u64),
    /// Messages lost.
    pub loss: u8,
}

impl OwnLink {
    /// Returns the link after module `gone` is removed and later ones are renumbered; `None` if it was that module's.
    pub fn without(self, gone: u32) -> Option<OwnLink> {
        let module = self.module - u32::from(self.module > gone);
        (self.module != gone).then_some(OwnLink { module, ..self })
    }
}

impl GeneratedLink {
    /// Returns true if it does more than delay messages.
    pub fn harms(&self) -> bool {
        let own = self.own.map_or(0, |own| own.loss);
        let between = self.hosts.map_or(0, |hosts| hosts.loss);
        self.burst.is_some()
            || [self.loss, self.duplicate, self.reorder, self.corrupt, own, between]
                .iter()
                .any(|evil| *evil > 0)
    }
    /// Returns the longest delay.
    pub fn longest(&self) -> u64 {
        let usual = self.quantiles.map_or(self.delay.1, |[_, _, all]| all);
        let between = self.hosts.map_or(0, |hosts| hosts.delay.1);
        usual.max(self.own.map_or(0, |own| own.delay.1)).max(between)
    }
}

impl fmt::Display for GeneratedLink {
    /// Writes the table `[link]`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let GeneratedLink { delay: (min, max), loss, duplicate, reorder, corrupt, until, .. } = *self;
        match self.quantiles.map(|all| all.map(Span::millis)) {
            None => writeln!(f, "\n[link]\ndelay = \"{}..{}\"", Span::millis(min), Span::millis(max))?,
            Some([half, most, all]) => writeln!(
                f,
                "\n[link]\ndelay = {{ quantiles = [[\"50%\", \"{half}\"], [\"99%\", \"{most}\"], [\"100%\", \"{all}\"]] }}"
            )?,
        }
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
        if let Some([enter, leave, loss]) = self.burst {
            writeln!(f, "burst = {{ enter = \"{enter}%\", leave = \"{leave}%\", loss = \"{loss}%\" }}")?;
        }
        if let Some(OwnLink { module, one_way, delay: (min, max), loss }) = self.own {
            let (min, max) = (Span::millis(min), Span::millis(max));
            writeln!(f, "\n[[link.between]]\nmodules = [{module}, \"any\"]\none_way = {one_way}")?;
            writeln!(f, "delay = \"{min}..{max}\"\nloss = \"{loss}%\"")?;
        }
        if let Some(GeneratedHosts { count, delay: (min, max), loss, fence }) = self.hosts {
            let (min, max) = (Span::millis(min), Span::millis(max));
            writeln!(
                f,
                "\n[link.between_hosts]\nhosts = {count}\ndelay = \"{min}..{max}\"\nloss = \"{loss}%\""
            )?;
            if let Some(fence) = fence.map(Span::millis) {
                writeln!(f, "lost = \"elsewhere\"\nfence = \"{fence}\"")?;
            }
        }
        Ok(())
    }
}

/// A fault: times in milliseconds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GeneratedFault {
    /// The kind of fault and its target.
    pub what: Break,
    /// Start of the fault.
    pub at: u64,
    /// End of the fault, if there is one. Stopped processes and cut links always have one.
    pub until: Option<u64>,
}

/// A kind of fault and its target.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Break {
    /// The process of a module dies.
    Kill(u32),
    /// The process of a module dies and is restarted.
    Restart(u32),
    /// The process of a module is stopped for a while.
    Pause(u32),
    /// The joints of a module stick.
    Stick(u32),
    /// These modules are cut off from the others for a while.
    Partition(Vec<u32>),
    /// A foreign object is in a cell.
    Obstacle(Cell),
    /// An element is dropped.
    Drop(u16),
    /// A host goes down, and may come back.
    KillHost(u16),
    /// An operator commands this, and at the end that, if there is an end.
    Command(Fault, Option<Fault>),
}

impl Break {
    /// Returns the key of `[[fault]]` that stands for it.
    pub const fn key(&self) -> &'static str {
        match self {
            Break::Kill(_) => "kill",
            Break::Restart(_) => "restart",
            Break::Pause(_) => "pause",
            Break::Stick(_) => "stick",
            Break::Partition(_) => "partition",
            Break::Obstacle(_) => "obstacle",
            Break::Drop(_) => "drop",
            Break::KillHost(_) => "kill_host",
            Break::Command(..) => "command",
        }
    }
    /// Returns the same fault with module `other` instead of `of`.
    pub fn instead(&self, of: u32, other: u32) -> Break {
        let one = |id: &u32| if *id == of { other } else { *id };
        match self {
            Break::Kill(id) => Break::Kill(one(id)),
            Break::Restart(id) => Break::Restart(one(id)),
            Break::Pause(id) => Break::Pause(one(id)),
            Break::Stick(id) => Break::Stick(one(id)),
            Break::Command(fault, end) => {
                let one = |fault: Fault| with_modules(fault, |id| Some(ModuleId(one(&id.0))));
                Break::Command(one(*fault).unwrap_or(*fault), end.and_then(one))
            }
            Break::Partition(side) if side.contains(&other) => self.clone(),
            Break::Partition(side) => Break::Partition(side.iter().map(one).collect()),
            Break::Obstacle(cell) => Break::Obstacle(*cell),
            Break::Drop(element) => Break::Drop(*element),
            Break::KillHost(host) => Break::KillHost(*host),
        }
    }
    /// Returns the same fault after module `gone` is removed and later ones are renumbered; `None` if only
    /// that module was concerned.
    pub fn without(&self, gone: u32) -> Option<Break> {
        let up = |id: &u32| (*id != gone).then_some(*id - u32::from(*id > gone));
        Some(match self {
            Break::Kill(id) => Break::Kill(up(id)?),
            Break::Restart(id) => Break::Restart(up(id)?),
            Break::Pause(id) => Break::Pause(up(id)?),
            Break::Stick(id) => Break::Stick(up(id)?),
            Break::Command(Fault::Links(LinkFault::Partition(first, last, lease)), end) => {
                // The last one takes the place of the module that is gone, if that is the last.
                let (first, last) = (first.0 - u32::from(first.0 > gone), last.0 - u32::from(last.0 >= gone));
                let side = (first <= last).then_some((ModuleId(first), ModuleId(last)))?;
                Break::Command(Fault::Links(LinkFault::Partition(side.0, side.1, *lease)), *end)
            }
            Break::Command(fault, end) => {
                let up = |fault: Fault| with_modules(fault, |id| up(&id.0).map(ModuleId));
                Break::Command(up(*fault)?, end.and_then(up))
            }
            Break::Partition(side) => {
                let side: Vec<u32> = side.iter().filter_map(up).collect();
                Break::Partition((!side.is_empty()).then_some(side)?)
            }
            Break::Obstacle(cell) => Break::Obstacle(*cell),
            Break::Drop(element) => Break::Drop(*element),
            Break::KillHost(host) => Break::KillHost(*host),
        })
    }
}

/// Returns the command with other modules; `None` if one of them has none. A partition keeps its modules.
fn with_modules(fault: Fault, other: impl Fn(ModuleId) -> Option<ModuleId>) -> Option<Fault> {
    Some(match fault {
        Fault::Kill(id) => Fault::Kill(other(id)?),
        Fault::Pause(id) => Fault::Pause(other(id)?),
        Fault::Resume(id) => Fault::Resume(other(id)?),
        Fault::Restart(id) => Fault::Restart(other(id)?),
        Fault::Stick(id) => Fault::Stick(other(id)?),
        Fault::Unstick(id) => Fault::Unstick(other(id)?),
        Fault::Steer(id, Steering::Swap(with)) => Fault::Steer(other(id)?, Steering::Swap(other(with)?)),
        Fault::Steer(id, steering) => Fault::Steer(other(id)?, steering),
        Fault::External(id) => Fault::External(other(id)?),
        Fault::Links(_) | Fault::World(..) | Fault::Host(..) => fault,
    })
}

impl GeneratedScenario {
    /// Returns the number of modules.
    pub fn modules(&self) -> usize {
        self.swarm.modules()
    }
    /// Returns the number of goal cells or seeds of all goals.
    pub fn goal_cells(&self) -> usize {
        self.swarm.goal_cells()
    }
    /// Creates the plan, with a defect of the protocol if a test wants one.
    pub fn plan(&self, origin: &str, defect: Option<Defect>) -> Result<Plan, Diagnostics> {
        let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
        let mut plan = read_text(origin, &self.to_string(), &overrides)?;
        plan.swarm = plan.swarm.with_defect(defect);
        Ok(plan)
    }
    /// Returns a description of one line.
    pub fn summary(&self) -> String {
        let (what, faults) = (self.swarm.summary(), self.faults.len());
        format!("{what}, {} goal cells, {faults} faults", self.goal_cells())
    }
}

impl fmt::Display for GeneratedScenario {
    /// Writes the scenario file.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "version = 1")?;
        if !self.description.is_empty() {
            // TOML basic strings use the escapes of JSON strings.
            writeln!(f, "description = {}", serde_json::Value::from(self.description.as_str()))?;
        }
        writeln!(f, "seed = {}\n\n[swarm]", self.seed)?;
        self.swarm.write(f, self.failing)?;
        self.link.fmt(f)?;
        if self.rescue != Rescue::default() {
            writeln!(f, "\n[controller]\nrescue = \"{}\"", self.rescue)?;
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

impl fmt::Display for GeneratedFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at = Span::millis(self.at);
        let until = self.until.map(Span::millis);
        if let Break::Command(command, end) = &self.what {
            writeln!(f, "\n[[command]]\nat = \"{at}\"\ndo = [\"{command}\"]")?;
            let mut end = end.iter().zip(until);
            return end
                .try_for_each(|(end, at)| writeln!(f, "\n[[command]]\nat = \"{at}\"\ndo = [\"{end}\"]"));
        }
        writeln!(f, "\n[[fault]]")?;
        let end = until.map_or(String::new(), |u| format!("until = \"{u}\"\n"));
        match &self.what {
            Break::Kill(id) => writeln!(f, "kill = {id}\nat = \"{at}\""),
            Break::Restart(id) => writeln!(f, "restart = {id}\nat = \"{at}\""),
            Break::Pause(id) => write!(f, "pause = {id}\nfrom = \"{at}\"\n{end}"),
            Break::Stick(id) => write!(f, "stick = {id}\nat = \"{at}\"\n{end}"),
            Break::Obstacle(cell) => write!(f, "obstacle = {}\nat = \"{at}\"\n{end}", cells(&[*cell])),
            Break::Drop(element) => writeln!(f, "drop = {element}\nat = \"{at}\""),
            Break::KillHost(host) => write!(f, "kill_host = \"{}\"\nat = \"{at}\"\n{end}", HostId(*host)),
            // Written above.
            Break::Command(..) => Ok(()),
            Break::Partition(side) => {
                let until = until.unwrap_or_default();
                writeln!(f, "partition = {{ modules = {side:?}, from = \"{at}\", until = \"{until}\" }}")
            }
        }
    }
}
