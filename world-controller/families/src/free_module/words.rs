//! Describes the inputs and outputs of a free module.

use crate::worded::{Worded, at, waiting};
use metamorph_protocol::free_module::reconfiguration::LatticeModule;
use metamorph_protocol::free_module::reconfiguration::message::{
    Failure, LatticeAction, LatticeBodyAction, LatticeOrder, LatticePercept, LatticeRefusal, LatticeStatus,
    StepName, StepResult,
};
use metamorph_protocol::free_module::reconfiguration::place::LatticePlace;
use metamorph_protocol::roombots::connector::Connector;
use metamorph_protocol::time::Time;
use metamorph_scene::visible::MISALIGNED;

fn body_action(body_action: LatticeBodyAction) -> String {
    let name = |connector: u8| Connector::ALL[usize::from(connector)];
    match body_action {
        LatticeBodyAction::Attach(connector) => format!("close {}", name(connector)),
        LatticeBodyAction::Detach(connector) => format!("open {}", name(connector)),
        LatticeBodyAction::Turn { joint, positive } => {
            let step = if joint == 1 { 90 } else { 120 };
            format!("turn joint {} by {}{step}°", joint + 1, if positive { "+" } else { "-" })
        }
    }
}

fn step(step: StepName) -> String {
    let again = if step.attempt > 0 { format!(", try {}", step.attempt + 1) } else { String::new() };
    format!("step {} of plan {}{again}", step.index, step.epoch)
}

fn result(result: StepResult) -> &'static str {
    match result {
        Ok(()) => "done",
        Err(Failure::Connection) => "the connector did not close",
        Err(Failure::Joint) => "the joint did not turn",
        Err(Failure::Blocked) => "another module is in the way",
        Err(Failure::Impossible) => "not possible",
        Err(Failure::Stale) => "planned for another state",
        Err(Failure::Late) => "too late",
    }
}

fn by(time: Time) -> String {
    if time == Time::NEVER { String::new() } else { format!(", by {}", at(time).trim_start()) }
}

impl Worded for LatticeModule {
    fn place(place: &LatticePlace) -> String {
        let [a, b, c] = place.degrees();
        let closed: Vec<&str> =
            Connector::ALL.into_iter().filter(|c| place.is_closed(*c as u8)).map(Connector::name).collect();
        let closed = if closed.is_empty() { "none".to_owned() } else { closed.join(" ") };
        format!("{}, joints at {a}°, {b}°, {c}°, closed: {closed}", place.cell)
    }
    fn action(action: &LatticeAction) -> String {
        format!("{} ({}){}", body_action(action.body_action), step(action.step), by(action.not_after))
    }
    fn percept(percept: &LatticePercept) -> String {
        match percept {
            LatticePercept::Done(place) => format!("is now at {}", LatticeModule::place(place)),
            LatticePercept::Failed => "has failed, and is where it was".to_owned(),
            LatticePercept::Misaligned => format!("has not connected: {MISALIGNED}"),
            LatticePercept::Carried(swing) => {
                format!("is carried by a turn of {}° about {}", swing.degrees, swing.pivot)
            }
            LatticePercept::Settled { place, moved: true } => {
                format!("was carried to {}", LatticeModule::place(place))
            }
            LatticePercept::Settled { moved: false, .. } => "was not carried after all".to_owned(),
            LatticePercept::Refused(why) => format!(
                "refuses: {}",
                match why {
                    LatticeRefusal::Blocked => "another module is in the way",
                    LatticeRefusal::Late => "it is too late",
                    LatticeRefusal::Stale => "the contacts have changed",
                    LatticeRefusal::Busy => "it acts or is carried",
                    LatticeRefusal::Impossible => "it cannot do that from where it is",
                }
            ),
        }
    }
    fn order(order: &LatticeOrder) -> String {
        match order {
            LatticeOrder::Hold { epoch } => format!("hold for plan {epoch}"),
            LatticeOrder::Step { step: name, body_action: what, not_after, .. } => {
                format!("{}: {}{}", step(*name), body_action(*what), by(*not_after))
            }
        }
    }
    fn report(s: &LatticeStatus) -> String {
        let last = s.last.map_or(String::new(), |(name, how)| format!(", {}: {}", step(name), result(how)));
        let does = if s.busy { "acting" } else { "resting" };
        format!(
            "{does} in plan {}{last}, at {}{}",
            s.epoch,
            LatticeModule::place(&s.place),
            waiting(s.waits_for)
        )
    }
}
