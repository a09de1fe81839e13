//! Faults as data. A fault schedule is a value of its own, separate from the run that it is injected into, so
//! that it can be printed, repeated and shrunk.

use crate::director::link_faults::LinkFault;
use crate::director::steering::{LONGEST_LEASE, Steering, read_cell, read_shift};
use metamorph_core::ids::{HostId, ModuleId};
use metamorph_core::lattice::Cell;
use metamorph_core::link::HostChange;
use metamorph_core::time::Time;
use std::fmt;
use std::str::FromStr;

/// A fault of the world that only some families know, such as an obstacle that appears. The family's director
/// injects it; everything else needs only what is here.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct WorldFault {
    /// The name used in reports.
    pub name: &'static str,
    /// True if it makes things worse, rather than ending another fault.
    pub harms: bool,
    /// The form of its argument.
    pub form: Form,
    /// A short description of its effect.
    pub about: &'static str,
}

/// Form of the argument of a [`WorldFault`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Form {
    /// Where.
    Cell,
    /// By how far.
    Shift,
    /// Which passive element, by its number.
    Element,
    /// Which one, by its number.
    Number,
    /// One of these words.
    Word(&'static [&'static str]),
    /// Nothing.
    Nothing,
}

/// The argument of a [`WorldFault`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Target {
    /// A cell.
    Cell(Cell),
    /// A distance along x and y.
    Shift(i16, i16),
    /// A passive element, by its number.
    Element(u16),
    /// A number.
    Number(u16),
    /// A word.
    Word(&'static str),
    /// There is only one.
    Nothing,
}

impl Target {
    fn parse(form: Form, text: &str) -> Option<Target> {
        let text = text.trim();
        match form {
            Form::Cell => read_cell(text).map(Target::Cell),
            Form::Shift => read_shift(text).map(|(x, y)| Target::Shift(x, y)),
            Form::Element => text.parse().ok().map(Target::Element),
            Form::Number => text.parse().ok().map(Target::Number),
            Form::Word(words) => words.iter().find(|word| **word == text).map(|word| Target::Word(word)),
            Form::Nothing => text.is_empty().then_some(Target::Nothing),
        }
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Target::Cell(cell) => cell.fmt(f),
            Target::Shift(x, y) => write!(f, "[{x}, {y}]"),
            Target::Element(element) => element.fmt(f),
            Target::Number(number) => number.fmt(f),
            Target::Word(word) => f.write_str(word),
            Target::Nothing => Ok(()),
        }
    }
}

/// One fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Fault {
    /// The process is killed. The body stays, as an obstacle.
    Kill(ModuleId),
    /// The process is stopped.
    Pause(ModuleId),
    /// A stopped process continues.
    Resume(ModuleId),
    /// A dead process is restarted without its memory; a living one is killed first.
    Restart(ModuleId),
    /// The joint sticks: moves fail from now on.
    Stick(ModuleId),
    /// The joint is free again.
    Unstick(ModuleId),
    /// An operator tells a module what to do; only some families obey, and no schedule of a scenario contains this but as a
    /// command.
    Steer(ModuleId, Steering),
    /// Links change their impairments; every family has it.
    Links(LinkFault),
    /// Something happens to the world that only some families know.
    World(&'static WorldFault, Target),
    /// A process was killed, stopped or continued from outside the run; no schedule contains this.
    External(ModuleId),
    /// A host goes down, counts as lost, or comes back. Of a scenario it is planned beside the deaths of its processes; no
    /// command contains this.
    Host(HostId, HostChange),
}

impl Fault {
    /// Returns the module that it hits; `None` if it hits the world.
    pub const fn module(self) -> Option<ModuleId> {
        Some(match self {
            Fault::Kill(id)
            | Fault::Pause(id)
            | Fault::Resume(id)
            | Fault::Restart(id)
            | Fault::Stick(id)
            | Fault::Unstick(id)
            | Fault::Steer(id, _)
            | Fault::External(id) => id,
            Fault::World(..) | Fault::Links(_) | Fault::Host(..) => return None,
        })
    }
    /// Returns all modules that it names: at most two.
    pub fn modules(self) -> impl Iterator<Item = ModuleId> {
        let other = match self {
            Fault::Steer(_, Steering::Swap(other)) => Some(other),
            Fault::Links(fault) => fault.last_module(),
            _ => None,
        };
        self.module().into_iter().chain(other)
    }
    /// Returns true if it makes things worse, rather than ending another fault.
    pub const fn harms(self) -> bool {
        match self {
            Fault::World(kind, _) => kind.harms,
            Fault::Links(fault) => fault.end().is_some(),
            Fault::Host(_, change) => !matches!(change, HostChange::Back),
            _ => !matches!(self, Fault::Resume(_) | Fault::Unstick(_) | Fault::Steer(..)),
        }
    }
}

impl Fault {
    /// Reads a fault as [`Display`](fmt::Display) writes it, such as `kill 7`; `world` has the faults of the world that
    /// the family knows, such as `block [1, 2, 3]`.
    ///
    /// # Errors
    /// Returns what is wrong with the text, and how to write it.
    pub fn parse(text: &str, world: &[&'static WorldFault]) -> Result<Fault, String> {
        let form = || {
            let verbs = VERBS.iter().copied().chain(Steering::VERBS).chain(LinkFault::VERBS);
            let verbs = verbs.chain(world.iter().map(|kind| kind.name));
            let verbs: Vec<&str> = verbs.collect();
            let verbs = verbs.join(", ");
            format!("`{text}` is no fault; write one of {verbs}, and what it hits, such as `kill 7`")
        };
        let is_alone = |kind: &&&'static WorldFault| kind.form == Form::Nothing && kind.name == text.trim();
        if let Some(kind) = world.iter().find(is_alone) {
            return Ok(Fault::World(kind, Target::Nothing));
        }
        let (verb, target) = text.trim().split_once(' ').ok_or_else(form)?;
        if let Some(kind) = world.iter().find(|kind| kind.name == verb) {
            let how = || match kind.form {
                Form::Word(words) => {
                    format!("`{text}` is no command; write `{verb}` and one of {}", words.join(", "))
                }
                Form::Number => {
                    format!("`{text}` is no command; write `{verb}` and a number, such as `{verb} 1`")
                }
                Form::Nothing => format!("`{text}` is no command; write `{verb}` alone"),
                Form::Cell | Form::Shift | Form::Element => form(),
            };
            return Ok(Fault::World(kind, Target::parse(kind.form, target).ok_or_else(how)?));
        }
        if LinkFault::VERBS.contains(&verb) {
            let how = || {
                format!(
                    "`{text}` is no command; write `loss 5% for 30s`, `partition 3..7 for 30s`, `loss off` or `partition off`, \
                     for at most {LONGEST_LEASE}"
                )
            };
            return Ok(Fault::Links(LinkFault::parse(verb, target).ok_or_else(how)?));
        }
        if Steering::VERBS.contains(&verb) {
            let (id, rest) = target.trim().split_once(' ').unwrap_or((target.trim(), ""));
            let id = ModuleId(id.parse().map_err(|_| form())?);
            let how = || {
                format!(
                    "`{text}` is no command; write `goto 3 [4, 5, 0] for 30s`, `take 3 0`, `hold 3 for 30s`, `swap 3 5` or \
                     `release 3`, for at most {LONGEST_LEASE}"
                )
            };
            return Ok(Fault::Steer(id, Steering::parse(verb, rest).ok_or_else(how)?));
        }
        let id = ModuleId(target.trim().parse().map_err(|_| form())?);
        Ok(match verb {
            "kill" => Fault::Kill(id),
            "pause" => Fault::Pause(id),
            "resume" => Fault::Resume(id),
            "restart" => Fault::Restart(id),
            "stick" => Fault::Stick(id),
            "unstick" => Fault::Unstick(id),
            _ => return Err(form()),
        })
    }
}

/// The verbs of faults that hit a module.
const VERBS: [&str; 6] = ["kill", "pause", "resume", "restart", "stick", "unstick"];

impl FromStr for Fault {
    type Err = String;

    /// Reads a fault that hits a module, as [`Display`](fmt::Display) writes it: `kill 7`.
    fn from_str(text: &str) -> Result<Fault, String> {
        Fault::parse(text, &[])
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Fault::Kill(id) => write!(f, "kill {id}"),
            Fault::Pause(id) => write!(f, "pause {id}"),
            Fault::Resume(id) => write!(f, "resume {id}"),
            Fault::Restart(id) => write!(f, "restart {id}"),
            Fault::Stick(id) => write!(f, "stick {id}"),
            Fault::Unstick(id) => write!(f, "unstick {id}"),
            Fault::Steer(id, steering) => write!(f, "{} {id}{steering}", steering.verb()),
            Fault::World(kind, Target::Nothing) => f.write_str(kind.name),
            Fault::World(kind, target) => write!(f, "{} {target}", kind.name),
            Fault::Links(fault) => write!(f, "{} {fault}", fault.verb()),
            Fault::External(id) => write!(f, "external {id}"),
            Fault::Host(host, HostChange::Down) => write!(f, "down {host}"),
            Fault::Host(host, HostChange::Lost) => write!(f, "lost {host}"),
            Fault::Host(host, HostChange::Back) => write!(f, "back {host}"),
        }
    }
}

/// The origin of a fault.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Origin {
    /// The `[[fault]]` tables of the scenario.
    #[default]
    Scenario,
    /// A command of this operator. Operator 0 is the program that steps a run.
    Operator(u16),
    /// Something outside the run, such as the system.
    External,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Origin::Scenario => f.write_str("scenario"),
            Origin::Operator(n) => write!(f, "operator {n}"),
            Origin::External => f.write_str("external"),
        }
    }
}

/// A fault and its visible effect at the moment of injection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FaultRecord {
    /// The time.
    pub at: Time,
    /// The fault.
    pub fault: Fault,
    /// Its origin.
    pub by: Origin,
    /// The state of the module or of the world.
    pub effect: String,
}

/// A fault of a schedule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scheduled {
    /// When it is due.
    pub at: Time,
    /// The fault.
    pub fault: Fault,
    /// Its origin.
    pub by: Origin,
}

/// A schedule of faults in the order of time.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Schedule {
    faults: Vec<Scheduled>,
}

impl Schedule {
    /// Creates a schedule of these faults of a scenario; those of one instant keep their order.
    pub fn new(faults: Vec<(Time, Fault)>) -> Schedule {
        let scheduled = |(at, fault)| Scheduled { at, fault, by: Origin::Scenario };
        let mut faults: Vec<Scheduled> = faults.into_iter().map(scheduled).collect();
        faults.sort_by_key(|scheduled| scheduled.at);
        Schedule { faults }
    }
    /// Adds a fault at the end of those that are due at or before its time, but not before the index `first`.
    pub fn insert(&mut self, first: usize, scheduled: Scheduled) {
        let after = first + self.faults[first..].partition_point(|other| other.at <= scheduled.at);
        self.faults.insert(after, scheduled);
    }
    /// Adds what ends a fault by itself, before all that is due at its time, but not before the index `first`: whether
    /// that was scheduled earlier or later makes no difference.
    pub fn insert_end(&mut self, first: usize, scheduled: Scheduled) {
        let before = first + self.faults[first..].partition_point(|other| other.at < scheduled.at);
        self.faults.insert(before, scheduled);
    }
    /// Removes one such end, from the index `first` on.
    pub fn remove_end(&mut self, first: usize, at: Time, fault: Fault) {
        let is_end = |other: &Scheduled| other.at == at && other.fault == fault;
        if let Some(index) = self.faults.iter().skip(first).position(is_end) {
            self.faults.remove(first + index);
        }
    }
    /// Iterates over the faults in order.
    pub fn iter(&self) -> impl Iterator<Item = &Scheduled> {
        self.faults.iter()
    }
    /// Returns the number of faults.
    pub fn len(&self) -> usize {
        self.faults.len()
    }
    /// Returns true if there are no faults.
    pub fn is_empty(&self) -> bool {
        self.faults.is_empty()
    }
    /// Returns the fault with this index in the order.
    pub fn get(&self, i: usize) -> Option<Scheduled> {
        self.faults.get(i).copied()
    }
}
