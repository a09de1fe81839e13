//! The `planned` strategy: the metamodule makes the moves that the world-controller orders, under locks as
//! always. Told that the plan is over, it decides for itself, as under `negotiated`.
//!
//! An order that comes late or does not fit the pose is not carried out, so it costs time, never safety. Without
//! a controller the metamodule stays where it is.

use super::context::{Context, Decision};
use super::negotiated::{Negotiated, ordered_move};
use crate::metamodule::message::Instruction;
use crate::metamodule::plan::Plan;
use crate::metamodule::pose::Load;
use crate::metamodule::view::View;
use metamorph_core::defects::Defect;
use metamorph_core::digest::Portable;
use metamorph_core::time::Time;
use std::hash::Hash;

/// The state of the strategy.
#[derive(Clone, Debug, Hash)]
pub(in crate::metamodule) struct Planned {
    /// The number of the instruction.
    number: u32,
    instruction: Instruction,
    /// How it decides while there is no plan.
    pub negotiated: Negotiated,
}

impl Planned {
    pub fn new() -> Planned {
        Planned { number: 0, instruction: Instruction::Stay, negotiated: Negotiated::new() }
    }

    /// Feeds the state into a hash; see `digest`.
    pub fn digest(&self, hasher: &mut Portable<'_>) {
        let Planned { number, instruction, negotiated } = self;
        (number, instruction).hash(hasher);
        negotiated.digest(hasher);
    }

    /// Decides what to do next. An order that cannot be carried out now is tried again when something around
    /// changes, or a grant ends.
    pub fn look(&mut self, cx: &mut Context<'_>, next_expiry: Time) -> Decision {
        match self.instruction {
            Instruction::Over => self.negotiated.look(cx, next_expiry),
            Instruction::Stay | Instruction::Handle { .. } => Decision::Wait(Time::NEVER),
            Instruction::Move { .. } => {
                let plan = ordered_move(cx.v, &self.negotiated, self.instruction);
                plan.map_or(Decision::Wait(next_expiry), Decision::Ask)
            }
        }
    }

    /// Returns the motion by which it grips an element or releases it, if that is ordered and fits the pose. It
    /// releases it only if another one is known to hold the element, or if it lies where it lay at the start; the
    /// body makes sure of that.
    pub fn handling(&self, v: View<'_>) -> Option<Plan> {
        let Instruction::Handle { mover, from, load } = self.instruction else { return None };
        let is_ready = mover == v.own.id && from == v.own.pose && v.now >= v.own.quarantine_until;
        let allowed = match load {
            Load::NONE => v.shares_element() || v.element_rests(),
            _ => v.own.pose.load == Load::NONE,
        };
        (is_ready && allowed).then(|| Plan::handle(from, load))
    }

    /// Starts over: there is another task, and the last instruction was for the one before.
    pub fn on_task(&mut self, cx: &mut Context<'_>) {
        self.instruction = Instruction::Stay;
        self.negotiated.on_task(cx);
    }

    /// Takes an instruction. Returns whether that is news.
    pub fn hear(&mut self, cx: &mut Context<'_>, number: u32, instruction: Instruction) -> bool {
        if number <= self.number && !cx.v.has(Defect::FollowOldPlans) {
            return false;
        }
        if self.instruction == Instruction::Over {
            self.negotiated.retire(cx);
        }
        (self.number, self.instruction) = (number, instruction);
        *cx.waiting_since = cx.v.now;
        true
    }
}
