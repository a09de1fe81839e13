//! The display of metamodules: places of bodies, states that modules report, contents of messages.

use super::Metamodules;
use crate::report::message_timeline::{FAR, Said};
use crate::view::scene::Appearance;
use crate::view::visible::{Doing, Fate, Stance, Standing, Visible};
use metamorph_protocol::metamodule::Metamodule;
use metamorph_protocol::metamodule::blueprint::Task;
use metamorph_protocol::metamodule::message::{
    Action, Deed, Denial as LockDenial, Message as MetamoduleMessage, Order as MetamoduleOrder,
    Percept as MetamodulePercept, Status as MetamoduleStatus,
};
use metamorph_protocol::metamodule::params::Setup as MetamoduleSetup;
use metamorph_protocol::metamodule::pose::Pose;
use metamorph_protocol::roombots::{HALF_EDGE, OUTER_RADIUS};

/// Returns the appearance of a plan at its start.
pub fn appearance(Metamodules { poses, setup, .. }: &Metamodules) -> Appearance {
    let goals = (0..setup.goals.len() as u8).map(|goal| {
        let blueprint = setup.goal(Task { goal, ..Task::default() });
        let mut seeds = blueprint.seeds().iter();
        let mut cells = Vec::new();
        for (level, seeds_of_it) in blueprint.levels().iter().enumerate() {
            let of_level = seeds.by_ref().take(usize::from(*seeds_of_it)).flat_map(|s| s.cells());
            cells.extend(of_level.map(|c| (c.x, c.y, c.z, level as u16)));
        }
        cells
    });
    Appearance {
        start: poses.iter().map(|p| Metamodule::stance(setup, p)).collect(),
        goals: goals.collect(),
        floor: Some(setup.floor),
        body: Some((setup.motions.kind().quarter_turns(), OUTER_RADIUS, HALF_EDGE)),
        time_step: setup.params.turn_time,
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
            MetamoduleMessage::Call(_) => Said::of("coordinates: names the next to move"),
            MetamoduleMessage::Probe(_) => Said::of("probes for a deadlock"),
            MetamoduleMessage::Way(w) if w.legs().is_empty() => Said::of("is at its destination"),
            MetamoduleMessage::Way(_) => Said::of("announces its plan"),
            MetamoduleMessage::Request { origin, .. } => Said::about("asks for a lock, for", *origin),
            MetamoduleMessage::Response { denial: None, .. } => Said::of("lock granted"),
            MetamoduleMessage::Response { denial: Some(why), .. } => Said::of(match why {
                LockDenial::Occupied => "lock refused: blocks the path",
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
