//! Describes the inputs and outputs of a cube.

use crate::worded::{Worded, at, waiting};
use metamorph_protocol::cube::Cube;
use metamorph_protocol::cube::body::{Move, Percept as CubePercept, Refusal as CubeRefusal};
use metamorph_protocol::cube::control::{Order as CubeOrder, Status as CubeStatus};
use metamorph_protocol::cube::message::Role;
use metamorph_protocol::cube::steering::Steering;
use metamorph_protocol::lattice::{Cell, Face, MotionKind};
use metamorph_protocol::time::Time;

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
            CubeOrder::Goal(opening) if opening.is_closed => {
                format!("goal {}: wait until the controller calls", opening.epoch)
            }
            CubeOrder::Goal(opening) => format!("goal {} is to be built", opening.epoch),
            CubeOrder::Condemn { port, finalized, .. } => {
                let was = if *finalized { ", and was finalized" } else { "" };
                format!("the neighbour at port {port} is dead{was}")
            }
            CubeOrder::Steer { steering, until } => match steering {
                Steering::Release => "an operator commands nothing any more".to_owned(),
                Steering::Hold => format!("an operator commands: stay until {until}"),
                Steering::GoTo(cell) => format!("an operator commands: go to {cell}, until {until}"),
            },
            CubeOrder::Call { until, way, .. } => {
                format!("it is called from {} to {}, until {until}", way.from(), way.to())
            }
            CubeOrder::Carry { mover, face, .. } => {
                format!("stay, and keep the cell at {} free for module {mover}", side(*face))
            }
            CubeOrder::Custody(of) => {
                format!("the dead module at {} is held by the one at {}", of.dead, of.holder.cell)
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
            (s.pinned, "holds a dead module"),
            (s.attracted, "knows a path to a target"),
        ];
        let flags: String = flags.iter().filter(|f| f.0).map(|f| format!(", {}", f.1)).collect();
        format!("{role} for goal {}{flags}{}", s.epoch, waiting(s.waits_for))
    }
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
