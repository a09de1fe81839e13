//! How each family looks: poses and deeds of bodies, what modules report of themselves, what their
//! messages say. Adding a family means implementing [`Visible`].

use crate::report::message_timeline::{FAR, Said};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::cube::Cube;
use metamorph_protocol::cube::body::{Move, Percept as CubePercept};
use metamorph_protocol::cube::control::{Order as CubeOrder, Status as CubeStatus};
use metamorph_protocol::cube::message::{Ask, Denial, Entry, Message as CubeMessage};
use metamorph_protocol::cube::params::Setup as CubeSetup;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::Metamodule;
use metamorph_protocol::metamodule::message::{
    Action, Deed, Denial as LockDenial, Message as MetamoduleMessage, Order as MetamoduleOrder,
    Percept as MetamodulePercept, Status as MetamoduleStatus,
};
use metamorph_protocol::metamodule::params::Setup as MetamoduleSetup;
use metamorph_protocol::metamodule::pose::Pose;
use metamorph_protocol::time::Span;
use serde::Serialize;

/// Where a body is, as numbers that the page knows how to draw: of a cube its cell; of a metamodule
/// the connector, its quarter turns, the end that holds, whether both do, and the steps of its joints
/// seen from the end that holds.
pub type Stance = Vec<i16>;

/// Something a body does: how long, and what. Of a cube the kind of motion, the side of the support
/// and the heading; of a metamodule what it does, and the stance that follows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Doing {
    /// How long it takes.
    pub takes: Span,
    /// What it is.
    pub what: Vec<i16>,
}

/// What a module tells of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Standing {
    /// Its part: 0 in reserve or free, 1 wandering, 2 finalized or settled.
    pub role: u8,
    /// Bits: 1 attached, 2 immobile, 4 pinned by a dead one, 8 knows a way.
    pub flags: u8,
    /// The goal that it works for; the seed that it fills, if it is a settled metamodule.
    pub place: i32,
    /// Whom it waits for.
    pub waits_for: Option<ModuleId>,
}

/// How an action went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// As it should.
    Done,
    /// It was tried, and the body is where it was.
    Failed,
    /// It was not begun.
    Refused,
}

/// Agents that can be shown.
pub trait Visible: Agent {
    /// Where a body is.
    fn stance(setup: &Self::Setup, place: &Self::Place) -> Stance;
    /// What a body would do from there; none if it cannot.
    fn doing(setup: &Self::Setup, place: &Self::Place, action: &Self::Action) -> Option<Doing>;
    /// How an action went.
    fn fate(percept: &Self::Percept) -> Fate;
    /// What a report tells.
    fn standing(report: &Self::Report) -> Standing;
    /// What a message tells.
    fn said(message: &Self::Message) -> Said;
    /// How far it is to a target, in moves, from what an agent's summary tells; [`FAR`] if it knows of
    /// none.
    fn moves(gradient: Option<u32>) -> u16;
    /// Which goal an order opens, and how far that is moved.
    fn goal(order: &Self::Order) -> Option<(u16, (i16, i16))>;
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
                    (Denial::Occupied, None) => "turned down: occupied",
                    (Denial::Occupied, Some(_)) => "turned down: occupied by",
                    (Denial::Reserved, None) => "turned down: reserved",
                    (Denial::Reserved, Some(_)) => "turned down: reserved for",
                    (Denial::Busy, None) => "turned down: leaving",
                    (Denial::Busy, Some(_)) => "turned down: leaving is",
                    (Denial::Younger, None) => "turned down: another has waited longer",
                    (Denial::Younger, Some(_)) => "turned down: longer has waited",
                    (Denial::NoTerrain, _) => "turned down: no terrain",
                    (Denial::Quarantined, _) => "turned down: just restarted",
                })
            },
            CubeMessage::Release { origin, .. } => Said::about("released, by", *origin),
            CubeMessage::Search { id, .. } => Said::about("looking for a way around", id.origin),
            CubeMessage::Found { id, .. } => Said::about("found a way around", id.origin),
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

impl Visible for Metamodule {
    fn stance(setup: &MetamoduleSetup, p: &Pose) -> Stance {
        let joints = setup.motions.table().postures().get(usize::from(p.posture));
        let (class, end) = (i16::from(p.state.class), p.end as i16);
        let mut stance = vec![p.state.x, p.state.y, class, end, i16::from(p.both)];
        stance.extend(joints.into_iter().flat_map(|e| e.posture.steps().to_vec()).map(i16::from));
        stance
    }
    fn doing(setup: &MetamoduleSetup, from: &Pose, action: &Action) -> Option<Doing> {
        let (params, motions) = (&setup.params, &setup.motions);
        let (kind, takes, to) = match action.deed {
            Deed::Turn(number) => {
                let (posture, _) = motions.graph().step(from.posture, number)?;
                (0, params.turn_time, Pose { posture, ..*from })
            }
            Deed::Attach => (1, params.connect_time, Pose { both: true, ..*from }),
            Deed::Detach => (2, params.connect_time, Pose { both: false, ..motions.turned_around(*from)? }),
        };
        let what = std::iter::once(kind).chain(Metamodule::stance(setup, &to)).collect();
        Some(Doing { takes, what })
    }
    fn fate(percept: &MetamodulePercept) -> Fate {
        match percept {
            MetamodulePercept::Done(_) => Fate::Done,
            MetamodulePercept::Failed => Fate::Failed,
            MetamodulePercept::Refused(_) => Fate::Refused,
        }
    }
    fn standing(s: &MetamoduleStatus) -> Standing {
        let (role, place) = s.settled.map_or((0, -1), |seed| (2, i32::from(seed)));
        Standing { role, flags: 0, place, waits_for: s.waits_for }
    }
    fn said(message: &MetamoduleMessage) -> Said {
        match message {
            MetamoduleMessage::State(s) => {
                let far = s.claim.map_or(FAR, |c| c.cost.into());
                Said { distance: Some(if s.settled { 0 } else { far }), ..Said::of("state") }
            }
            MetamoduleMessage::Directive(_) => Said::of("leads: says who moves next"),
            MetamoduleMessage::Probe(_) => Said::of("asks whether anybody can go on"),
            MetamoduleMessage::Way(w) if w.legs().is_empty() => Said::of("is where it wants to be"),
            MetamoduleMessage::Way(_) => Said::of("tells its way"),
            MetamoduleMessage::Request { origin, .. } => Said::about("asks for a lock, for", *origin),
            MetamoduleMessage::Response { denial: None, .. } => Said::of("lock granted"),
            MetamoduleMessage::Response { denial: Some(why), .. } => Said::of(match why {
                LockDenial::Occupied => "lock refused: stands in the way",
                LockDenial::Held => "lock refused: is moving through",
                LockDenial::Younger => "lock refused: has waited longer",
                LockDenial::Quarantined => "lock refused: just restarted",
            }),
            MetamoduleMessage::Release { origin, .. } => Said::about("lock released, by", *origin),
        }
    }
    fn moves(gradient: Option<u32>) -> u16 {
        gradient.and_then(|strides| u16::try_from(strides).ok()).unwrap_or(FAR)
    }
    fn goal(order: &MetamoduleOrder) -> Option<(u16, (i16, i16))> {
        match order {
            MetamoduleOrder::Seeds { task, .. } => Some((task.goal.into(), task.shift)),
            MetamoduleOrder::Dead { .. }
            | MetamoduleOrder::Alive { .. }
            | MetamoduleOrder::Obstacle { .. } => None,
        }
    }
}
