//! What an agent takes in and puts out, in words: one line for each input, what followed indented below it.
//! Adding a family means implementing [`Worded`].

use super::engine::input;
use crate::console::format::listed;
use crate::record::journal::{Event, Record, Step, Taken, Told};
use crate::view::visible::Visible;
use metamorph_protocol::agent::Summary;
use metamorph_protocol::agent::{Input, InputOf};
use metamorph_protocol::cube::Cube;
use metamorph_protocol::cube::body::{Move, Percept as CubePercept, Refusal as CubeRefusal};
use metamorph_protocol::cube::control::{Order as CubeOrder, Status as CubeStatus};
use metamorph_protocol::cube::message::Role;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::lattice::{Cell, Face, MotionKind};
use metamorph_protocol::metamodule::Metamodule;
use metamorph_protocol::metamodule::blueprint::SeedSet;
use metamorph_protocol::metamodule::message::{
    Action, Deed, Order as MetamoduleOrder, Percept as MetamodulePercept, Refusal as MetamoduleRefusal,
    Status as MetamoduleStatus,
};
use metamorph_protocol::metamodule::pose::{End, Pose};
use metamorph_protocol::record::Blob;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::Wire;
use std::fmt::Write;

/// Agents whose inputs and outputs can be told.
pub trait Worded: Visible {
    /// Where a body is.
    fn place(place: &Self::Place) -> String;
    /// What a body is asked for, after "asks its body to".
    fn action(action: &Self::Action) -> String;
    /// How that went, after "its body".
    fn percept(percept: &Self::Percept) -> String;
    /// What the controller wants or tells.
    fn order(order: &Self::Order) -> String;
    /// What the controller is told.
    fn report(report: &Self::Report) -> String;
}

/// A time, always with microseconds, so that one stands below the other.
fn at(time: Time) -> String {
    format!("{:>13.6} s", time.as_secs_f64())
}

/// Tells a record of an agent; a wake-up after which it does nothing is left out.
pub fn tell<A: Worded>(out: &mut String, record: &Record, life: Incarnation) {
    // Writing to a string cannot fail.
    let _ = match &record.event {
        Event::Born { place } => {
            writeln!(out, "{}  begins life {life} at {}", at(record.at), told(place, A::place))
        }
        Event::State(summary) => writeln!(out, "{}  is now {}", at(record.at), state(summary)),
        Event::Step(step) if is_idle(step) => Ok(()),
        Event::Step(step) => write_step::<A>(out, record.at, step),
        _ => Ok(()),
    };
}

fn is_idle(step: &Step) -> bool {
    matches!(step.input, Taken::Wake) && step.sent.is_empty() && step.told.is_empty()
}

fn write_step<A: Worded>(out: &mut String, time: Time, step: &Step) -> std::fmt::Result {
    let what = match input(&step.input) {
        Ok(taken) => taking::<A>(&step.input, taken),
        Err(why) => why,
    };
    writeln!(out, "{}  {what}", at(time))?;
    let indent = " ".repeat(19);
    for (i, sent) in step.sent.iter().enumerate() {
        let to = sent.to.map_or("to nobody".to_owned(), |id| format!("to {id}"));
        let number = step.first as usize + i;
        writeln!(out, "{indent}sends {} {to} by port {} (message {number})", sent.class, sent.port)?;
    }
    for said in &step.told {
        match said {
            Told::Act { action, .. } => {
                writeln!(out, "{indent}asks its body to {}", told(action, A::action))?
            }
            Told::Report(report) => writeln!(out, "{indent}reports: {}", told(report, A::report))?,
        }
    }
    Ok(())
}

fn taking<A: Worded>(recorded: &Taken, taken: InputOf<A>) -> String {
    match (recorded, taken) {
        (Taken::Message { name, class, .. }, Input::Message { message, .. }) => {
            format!("hears from {}: {} ({class}, message {})", name.from, A::said(&message), name.number)
        }
        (_, Input::Message { port, message }) => format!("hears by port {port}: {}", A::said(&message)),
        (_, Input::Contact { port, session: Some(session) }) => {
            format!("touches a neighbour at port {port} (session {})", session.0)
        }
        (_, Input::Contact { port, session: None }) => format!("touches nobody at port {port} any more"),
        (_, Input::Percept(percept)) => format!("its body {}", A::percept(&percept)),
        (_, Input::Order(order)) => format!("is told by the controller: {}", A::order(&order)),
        (_, Input::Wake) => "wakes".to_owned(),
    }
}

fn told<T: Wire>(blob: &Blob, words: fn(&T) -> String) -> String {
    blob.read().map_or_else(|e| format!("something that cannot be read: {e}"), |value| words(&value))
}

/// What an agent is about.
pub fn state(s: &Summary) -> String {
    let mut text = format!("{}, {}", s.role, s.activity);
    let mut add = |name, value: Option<String>| {
        if let Some(value) = value {
            text += &format!(", {name} {value}");
        }
    };
    add("level", s.level.map(|v| v.to_string()));
    add("gradient", s.gradient.map(|v| v.to_string()));
    add("locked for", s.lock.map(|v| v.to_string()));
    add("waits for", s.waits_for.map(|v| v.to_string()));
    text
}

fn waiting(on: Option<ModuleId>) -> String {
    on.map_or(String::new(), |id| format!(", waits for {id}"))
}

fn side(face: Face) -> &'static str {
    match face {
        Face::East => "+x",
        Face::West => "-x",
        Face::North => "+y",
        Face::South => "-y",
        Face::Up => "+z",
        Face::Down => "-z",
    }
}

impl Worded for Cube {
    fn place(cell: &Cell) -> String {
        cell.to_string()
    }
    fn action(Move { motion, not_after }: &Move) -> String {
        let (heading, support) = (side(motion.heading), side(motion.support));
        let how = match motion.kind {
            MotionKind::Slide => format!("slide to {heading} along its neighbour at {support}"),
            MotionKind::Convex => format!("go to {heading} around the edge of its neighbour at {support}"),
        };
        if *not_after == Time::NEVER { how } else { format!("{how}, by {}", at(*not_after).trim_start()) }
    }
    fn percept(percept: &CubePercept) -> String {
        match percept {
            CubePercept::Arrived(cell) => format!("has arrived at {cell}"),
            CubePercept::Failed => "has failed to move, and is where it was".to_owned(),
            CubePercept::Refused(why) => format!(
                "refuses to move: {}",
                match why {
                    CubeRefusal::Blocked => "a cell is taken or a support missing",
                    CubeRefusal::Late => "it is too late",
                    CubeRefusal::Stale => "contacts have changed",
                    CubeRefusal::Moving => "it is moving",
                }
            ),
        }
    }
    fn order(order: &CubeOrder) -> String {
        match order {
            CubeOrder::Goal { epoch } => format!("goal {epoch} is to be built"),
            CubeOrder::Condemn { port, finalized, .. } => {
                let was = if *finalized { ", and was finalized" } else { "" };
                format!("the neighbour at port {port} is dead{was}")
            }
        }
    }
    fn report(s: &CubeStatus) -> String {
        let role = match s.role {
            Role::Reserve => "in reserve",
            Role::Walker => "wandering",
            Role::Final => "finalized",
        };
        let flags = [
            (s.attached, "attached"),
            (s.immobile, "cannot move"),
            (s.pinned, "holds a dead one"),
            (s.attracted, "knows a way"),
        ];
        let flags: String = flags.iter().filter(|f| f.0).map(|f| format!(", {}", f.1)).collect();
        format!("{role} for goal {}{flags}{}", s.epoch, waiting(s.waits_for))
    }
}

fn seeds(set: SeedSet) -> String {
    let seeds: Vec<u32> = set.iter().map(u32::from).collect();
    if seeds.is_empty() { "none".to_owned() } else { listed(&seeds, seeds.len()) }
}

impl Worded for Metamodule {
    fn place(pose: &Pose) -> String {
        let end = match (pose.both, pose.end) {
            (true, _) => "on both ends",
            (false, End::Foot) => "on its foot",
            (false, End::Head) => "on its head",
        };
        let (x, y) = pose.foot();
        let turned = u16::from(pose.state.class) * 90;
        format!("({x}, {y}), turned {turned}°, {end}, in posture {}", pose.posture)
    }
    fn action(Action { deed, not_after }: &Action) -> String {
        let how = match deed {
            Deed::Turn(step) => format!("turn a joint (step {step} of its posture)"),
            Deed::Attach => "grip with its free end".to_owned(),
            Deed::Detach => "let go with one end".to_owned(),
        };
        if *not_after == Time::NEVER { how } else { format!("{how}, by {}", at(*not_after).trim_start()) }
    }
    fn percept(percept: &MetamodulePercept) -> String {
        match percept {
            MetamodulePercept::Done(pose) => format!("is now at {}", Metamodule::place(pose)),
            MetamodulePercept::Failed => "has failed, and is where it was".to_owned(),
            MetamodulePercept::Refused(why) => format!(
                "refuses: {}",
                match why {
                    MetamoduleRefusal::Blocked => "something is in the way",
                    MetamoduleRefusal::Late => "it is too late",
                    MetamoduleRefusal::Stale => "the neighbourhood has changed",
                    MetamoduleRefusal::Busy => "it is acting",
                    MetamoduleRefusal::Impossible => "it cannot do that from where it is",
                }
            ),
        }
    }
    fn order(order: &MetamoduleOrder) -> String {
        match order {
            MetamoduleOrder::Seeds { task, open, filled } => format!(
                "goal {}, moved by {:?}: open seeds {}, filled {}",
                task.goal,
                task.shift,
                seeds(*open),
                seeds(*filled)
            ),
            MetamoduleOrder::Dead { id, pose } => format!("{id} is dead, at {}", Metamodule::place(pose)),
            MetamoduleOrder::Alive { id } => format!("{id} lives again"),
            MetamoduleOrder::Obstacle { cell, there: true } => format!("something foreign is at {cell}"),
            MetamoduleOrder::Obstacle { cell, there: false } => {
                format!("nothing foreign is at {cell} any more")
            }
        }
    }
    fn report(s: &MetamoduleStatus) -> String {
        let does = s.settled.map_or("free".to_owned(), |seed| format!("settled in seed {seed}"));
        let barred =
            if s.barred.is_empty() { String::new() } else { format!(", no way to {}", seeds(s.barred)) };
        let stuck = if s.deadlocked { ", nobody can go on" } else { "" };
        format!("{does}, at {}{barred}{stuck}{}", Metamodule::place(&s.pose), waiting(s.waits_for))
    }
}
