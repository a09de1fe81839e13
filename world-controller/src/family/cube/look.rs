//! The display of cubes: places of bodies, states that modules report, contents of messages.

use super::Cubes;
use crate::report::message_timeline::{FAR, Said};
use crate::view::scene::Appearance;
use crate::view::visible::{Doing, Fate, Stance, Standing, Visible};
use metamorph_protocol::cube::Cube;
use metamorph_protocol::cube::body::{Move, Percept as CubePercept};
use metamorph_protocol::cube::control::{Order as CubeOrder, Status as CubeStatus};
use metamorph_protocol::cube::message::{Ask, Denial, Entry, Message as CubeMessage};
use metamorph_protocol::cube::params::Setup as CubeSetup;
use metamorph_protocol::lattice::Cell;

/// Returns the appearance of a plan at its start.
pub fn appearance(Cubes { cells, setup }: &Cubes) -> Appearance {
    let goals = setup.goals.iter();
    let goals = goals.map(|goal| goal.cells().map(|c| (c.x, c.y, c.z, goal.level(c))).collect());
    Appearance {
        start: cells.iter().map(|c| Cube::stance(setup, c)).collect(),
        goals: goals.collect(),
        floor: None,
        body: None,
        time_step: setup.params.move_time,
    }
}

impl Visible for Cube {
    fn stance(_: &CubeSetup, cell: &Cell) -> Stance {
        <[i16; 3]>::from(*cell).to_vec()
    }
    fn doing(setup: &CubeSetup, _: &Cell, Move { motion, .. }: &Move) -> Option<Doing> {
        let what = vec![motion.kind as i16, motion.support as i16, motion.heading as i16];
        Some(Doing { takes: setup.params.move_time, what })
    }
    fn fate(percept: &CubePercept) -> Fate {
        match percept {
            CubePercept::Arrived(_) => Fate::Done,
            CubePercept::Failed => Fate::Failed,
            CubePercept::Refused(_) => Fate::Refused,
        }
    }
    fn standing(s: &CubeStatus) -> Standing {
        let flags = [s.attached, s.immobile, s.pinned, s.attracted];
        let flags = flags.into_iter().rev().fold(0, |bits, flag| bits << 1 | u8::from(flag));
        Standing { role: s.role as u8, flags, place: s.epoch.into(), waits_for: s.waits_for }
    }
    fn said(message: &CubeMessage) -> Said {
        match message {
            CubeMessage::Beacon(b) => {
                let known = b.field.iter().filter(|e| e.is_known()).map(|e| e.moves()).min();
                Said { distance: Some(known.unwrap_or(FAR)), ..Said::of("beacon") }
            }
            CubeMessage::Request { id, ask: Ask::Lock, .. } => Said::about("stay, for", id.origin),
            CubeMessage::Request { id, ask: Ask::Reserve(_), .. } => {
                Said::about("keep a cell free, for", id.origin)
            }
            CubeMessage::Response { id, denial: None, .. } => Said::about("granted, to", id.origin),
            CubeMessage::Response { denial: Some(why), blocker, .. } => Said {
                whom: *blocker,
                ..Said::of(match (why, blocker) {
                    (Denial::Occupied, None) => "denied: occupied",
                    (Denial::Occupied, Some(_)) => "denied: occupied by",
                    (Denial::Reserved, None) => "denied: reserved",
                    (Denial::Reserved, Some(_)) => "denied: reserved for",
                    (Denial::Busy, None) => "denied: leaving",
                    (Denial::Busy, Some(_)) => "denied: leaving is",
                    (Denial::Younger, None) => "denied: another has waited longer",
                    (Denial::Younger, Some(_)) => "denied: waiting longer is",
                    (Denial::NoTerrain, _) => "denied: no support",
                    (Denial::Quarantined, _) => "denied: just restarted",
                })
            },
            CubeMessage::Release { origin, .. } => Said::about("released, by", *origin),
            CubeMessage::Search { id, .. } => Said::about("looks for a path around", id.origin),
            CubeMessage::Found { id, .. } => Said::about("found a path around", id.origin),
        }
    }
    fn moves(gradient: Option<u32>) -> u16 {
        let moves = gradient.map(|distance| distance / u32::from(Entry::MOVE));
        moves.and_then(|moves| u16::try_from(moves).ok()).unwrap_or(FAR)
    }
    fn goal(order: &CubeOrder) -> Option<(u16, (i16, i16))> {
        match order {
            CubeOrder::Goal { epoch } => Some((*epoch, (0, 0))),
            CubeOrder::Condemn { .. } => None,
        }
    }
}
