//! Describes the inputs and outputs of an agent: one line per input, with its effects indented below.
//! Families implement [`Worded`].

use crate::visible::Visible;
use metamorph_protocol::agent::Summary;
use metamorph_protocol::agent::{Input, InputOf};
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::record::{Blob, Consumed, Emitted, Event, Record, Step};
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::{Wire, WireError};
use metamorph_text::format::listed;
use std::fmt::Write;

/// Agents whose inputs and outputs have a description.
pub trait Worded: Visible {
    /// Describes the place of a body.
    fn place(place: &Self::Place) -> String;
    /// Describes an action by words that continue "asks its body to".
    fn action(action: &Self::Action) -> String;
    /// Describes a percept by words that continue "its body".
    fn percept(percept: &Self::Percept) -> String;
    /// Describes an order of the controller.
    fn order(order: &Self::Order) -> String;
    /// Describes a report to the controller.
    fn report(report: &Self::Report) -> String;
}

/// Formats a time with microseconds, at a fixed width, so that times align.
pub fn at(time: Time) -> String {
    format!("{:>13.6} s", time.as_secs_f64())
}

/// Describes a record of an agent; a wake-up without effect is left out.
pub fn tell<A: Worded>(out: &mut String, setup: &A::Setup, record: &Record, incarnation: Incarnation) {
    // Writing to a string cannot fail.
    let _ = match &record.event {
        Event::Born { place } => {
            writeln!(
                out,
                "{}  starts as incarnation {incarnation} at {}",
                at(record.at),
                told(place, A::place)
            )
        }
        Event::State(summary) => writeln!(out, "{}  is now {}", at(record.at), state(summary)),
        Event::Step(step) if is_idle(step) => Ok(()),
        Event::Step(step) => write_step::<A>(out, setup, record.at, step),
        _ => Ok(()),
    };
}

/// Describes an input and what followed in one line, without the time; `None` for a wake-up without effect.
pub fn brief<A: Worded>(setup: &A::Setup, step: &Step) -> Option<String> {
    if is_idle(step) {
        return None;
    }
    let mut parts = vec![match input(&step.input) {
        Ok(taken) => taking::<A>(setup, &step.input, taken),
        Err(why) => why,
    }];
    for class in Class::ALL {
        let to: Vec<u32> =
            step.sent.iter().filter(|s| s.class == class).filter_map(|s| Some(s.to?.0)).collect();
        if !to.is_empty() {
            parts.push(format!("sends {class} to {}", listed(&to, to.len())));
        }
    }
    parts.extend(step.told.iter().filter_map(|said| match said {
        Emitted::Act { action, .. } => Some(format!("asks its body to {}", told(action, A::action))),
        Emitted::Report(_) => None,
    }));
    Some(parts.join("; "))
}

fn is_idle(step: &Step) -> bool {
    matches!(step.input, Consumed::Wake) && step.sent.is_empty() && step.told.is_empty()
}

fn write_step<A: Worded>(out: &mut String, setup: &A::Setup, time: Time, step: &Step) -> std::fmt::Result {
    let what = match input(&step.input) {
        Ok(taken) => taking::<A>(setup, &step.input, taken),
        Err(why) => why,
    };
    writeln!(out, "{}  {what}", at(time))?;
    let indent = " ".repeat(19);
    for (i, sent) in step.sent.iter().enumerate() {
        let to = sent.to.map_or("to no module".to_owned(), |id| format!("to {id}"));
        let number = step.first as usize + i;
        writeln!(out, "{indent}sends {} {to} by port {} (message {number})", sent.class, sent.port)?;
    }
    for said in &step.told {
        match said {
            Emitted::Act { action, .. } => {
                writeln!(out, "{indent}asks its body to {}", told(action, A::action))?
            }
            Emitted::Report(report) => writeln!(out, "{indent}reports: {}", told(report, A::report))?,
        }
    }
    Ok(())
}

fn taking<A: Worded>(setup: &A::Setup, recorded: &Consumed, taken: InputOf<A>) -> String {
    match (recorded, taken) {
        (Consumed::Message { name, class, .. }, Input::Message { message, .. }) => {
            format!(
                "hears from {}: {} ({class}, message {})",
                name.from,
                A::said(setup, &message),
                name.number
            )
        }
        (_, Input::Message { port, message }) => {
            format!("hears at port {port}: {}", A::said(setup, &message))
        }
        (_, Input::Contact { port, session: Some(session) }) => {
            format!("touches a neighbour at port {port} (session {})", session.0)
        }
        (_, Input::Contact { port, session: None }) => format!("touches nothing at port {port} any more"),
        (_, Input::Percept(percept)) => format!("its body {}", A::percept(&percept)),
        (_, Input::Order(order)) => format!("is told by the controller: {}", A::order(&order)),
        (_, Input::Wake) => "wakes".to_owned(),
    }
}

fn told<T: Wire>(blob: &Blob, words: fn(&T) -> String) -> String {
    blob.read().map_or_else(|e| format!("something that cannot be read: {e}"), |value| words(&value))
}

/// Describes the state of an agent.
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

/// Returns a clause that names the module being waited for, with a leading comma; empty if `on` is `None`.
pub fn waiting(on: Option<ModuleId>) -> String {
    on.map_or(String::new(), |id| format!(", waits for {id}"))
}

/// Converts a recorded input to an agent's input.
pub fn input<M: Wire, P: Wire, O: Wire>(taken: &Consumed) -> Result<Input<M, P, O>, String> {
    Ok(match taken {
        Consumed::Contact { port, session } => Input::Contact { port: *port, session: *session },
        Consumed::Message { port, message, .. } => Input::Message { port: *port, message: read(message)? },
        Consumed::Percept(percept) => Input::Percept(read(percept)?),
        Consumed::Order(order) => Input::Order(read(order)?),
        Consumed::Wake => Input::Wake,
    })
}

fn read<T: Wire>(blob: &Blob) -> Result<T, String> {
    blob.read().map_err(|e: WireError| format!("{blob:?} cannot be read: {e}"))
}
