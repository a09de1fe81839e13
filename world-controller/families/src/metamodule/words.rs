//! Describes the inputs and outputs of a metamodule.

use crate::worded::{Worded, at, waiting};
use metamorph_protocol::metamodule::Metamodule;
use metamorph_protocol::metamodule::blueprint::{SeedSet, Task};
use metamorph_protocol::metamodule::message::{
    Action, BodyAction, Instruction, MoveEnd, Order as MetamoduleOrder, Percept as MetamodulePercept,
    Refusal as MetamoduleRefusal, Status as MetamoduleStatus,
};
use metamorph_protocol::metamodule::pose::{End, Load, Pose};
use metamorph_protocol::metamodule::steering::Steering;
use metamorph_protocol::time::Time;
use metamorph_scene::visible::MISALIGNED;
use metamorph_text::format::listed;

impl Worded for Metamodule {
    fn place(pose: &Pose) -> String {
        let end = match (pose.both, pose.end) {
            (true, _) => "on both ends",
            (false, End::Foot) => "on its foot",
            (false, End::Head) => "on its head",
        };
        let (x, y) = pose.foot();
        let turned = u16::from(pose.state.class) * 90;
        let holds = if pose.load == Load::NONE { "" } else { ", with an element" };
        format!("({x}, {y}), turned {turned}°, {end}, in posture {}{holds}", pose.posture)
    }
    fn action(Action { body_action, not_after }: &Action) -> String {
        let how = match body_action {
            BodyAction::Turn(step) => format!("turn a joint (step {step} of its posture)"),
            BodyAction::Attach => "grip with its free end".to_owned(),
            BodyAction::Detach => "release one end".to_owned(),
            BodyAction::Grip(_) => "grip an element with its free end".to_owned(),
            BodyAction::LetGo => "let go of its element".to_owned(),
        };
        if *not_after == Time::NEVER { how } else { format!("{how}, by {}", at(*not_after).trim_start()) }
    }
    fn percept(percept: &MetamodulePercept) -> String {
        match percept {
            MetamodulePercept::Done(pose) => format!("is now at {}", Metamodule::place(pose)),
            MetamodulePercept::Failed => "has failed, and is where it was".to_owned(),
            MetamodulePercept::Misaligned => format!("has not connected: {MISALIGNED}"),
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
            MetamoduleOrder::Seeds { task, open, filled } => {
                format!("{}: open seeds {}, filled {}", goal(task), seeds(*open), seeds(*filled))
            }
            MetamoduleOrder::Dead { id, pose } => format!("{id} is dead, at {}", Metamodule::place(pose)),
            MetamoduleOrder::Alive { id } => format!("{id} was restarted"),
            MetamoduleOrder::Obstacle { cell, there: true } => format!("an obstacle is at {cell}"),
            MetamoduleOrder::Obstacle { cell, there: false } => {
                format!("the obstacle at {cell} is gone")
            }
            MetamoduleOrder::Steer { steering, until } => match steering {
                Steering::Release => "an operator commands nothing any more".to_owned(),
                Steering::Hold => format!("an operator commands: stay until {until}"),
                Steering::GoTo((x, y)) => format!("an operator commands: go to [{x}, {y}, 0], until {until}"),
                Steering::Take(seed) => format!("an operator commands: fill seed {seed}, until {until}"),
            },
            MetamoduleOrder::Tune(tuning) => format!(
                "from now on: strategy {}, repulsion {} thousandths, precedence {}",
                tuning.strategy.name(),
                tuning.repulsion.strength,
                tuning.precedence.map_or("off", |precedence| precedence.by.name())
            ),
            MetamoduleOrder::Instruct { instruction: Instruction::Over, .. } => {
                "decide for yourself".to_owned()
            }
            MetamoduleOrder::Instruct { instruction: Instruction::Stay, .. } => "stay".to_owned(),
            MetamoduleOrder::Instruct { number, instruction: Instruction::Handle { from, load, .. } } => {
                let what = if *load == Load::NONE { "let go of" } else { "grip" };
                format!("order {number}: from {} {what} an element", Metamodule::place(from))
            }
            MetamoduleOrder::Instruct {
                number,
                instruction: Instruction::Move { from, posture, end, .. },
            } => {
                let then = match end {
                    MoveEnd::Rests => "",
                    MoveEnd::Lands => " and land",
                    MoveEnd::Settles => " and settle",
                };
                format!("order {number}: from {} turn to posture {posture}{then}", Metamodule::place(from))
            }
        }
    }
    fn report(s: &MetamoduleStatus) -> String {
        let does = s.settled.map_or("free".to_owned(), |seed| format!("settled in seed {seed}"));
        let unreachable = if s.unreachable.is_empty() {
            String::new()
        } else {
            format!(", no path to {}", seeds(s.unreachable))
        };
        let stuck = if s.deadlocked { ", deadlock detected" } else { "" };
        format!("{does}, at {}{unreachable}{stuck}{}", Metamodule::place(&s.pose), waiting(s.waits_for))
    }
}

fn goal(task: &Task) -> String {
    if task.is_dropped {
        return "no goal".to_owned();
    }
    let order = task.order.map(|order| format!(", {}", order.name())).unwrap_or_default();
    let turned = match task.quarters {
        0 => String::new(),
        quarters => format!(", turned {}°", u16::from(quarters) * 90),
    };
    let moved = match task.shift {
        (0, 0) => String::new(),
        shift => format!(", moved by {shift:?}"),
    };
    format!("goal {}{order}{turned}{moved}", task.goal)
}

fn seeds(set: SeedSet) -> String {
    let seeds: Vec<u32> = set.iter().map(u32::from).collect();
    if seeds.is_empty() { "none".to_owned() } else { listed(&seeds, seeds.len()) }
}
