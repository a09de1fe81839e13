//! An operator's view of a swarm of metamodules, the commands that resolve a standstill, and the scripted operator of
//! a run.

use super::view::View;
use crate::metamodule::faults::GOAL_MOVED;
use crate::metamodule::relocation::clear_places;
use metamorph_kernel::director::faults::{Fault, Target};
use metamorph_kernel::director::monitor::RunMonitor;
use metamorph_kernel::director::operator::{Level, Part, Scene};
use metamorph_kernel::director::steering::Steering;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::Seed;
use metamorph_protocol::metamodule::message::Order;
use metamorph_protocol::metamodule::motions::Sweep;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::metamodule::planning::nearby::Nearby;
use metamorph_protocol::metamodule::planning::paths::{Ground, Route};
use metamorph_protocol::metamodule::pose::Pose;
use metamorph_protocol::metamodule::steering::upright;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::time::{Span, Time};
use std::collections::BTreeSet;

/// Number of places that are drawn from when a goal is moved or a metamodule sent away.
const CHOICES: usize = 8;

/// An operator's view of a swarm of metamodules.
pub struct Picture<'a> {
    view: View<'a>,
    filled_at: Time,
    has_ended: bool,
}

/// The floor with what stands on it.
struct Floor<'a> {
    picture: &'a Picture<'a>,
    /// Metamodules that can move and have no place yet.
    free: Vec<(ModuleId, Pose)>,
    /// Cells of all others and of obstacles.
    fixed: Vec<Cell>,
    /// The places that may be filled now.
    open: Vec<(u8, Seed)>,
}

impl Scene for Picture<'_> {
    fn parts(&self) -> usize {
        self.view.members.known().len()
    }
    fn part(&self, id: ModuleId) -> Part {
        let known = self.view.members.known()[id.index()];
        let status = known.status.filter(|_| known.alive);
        let fills = status.and_then(|s| s.settled).filter(|seed| self.view.goal.filled().has(*seed));
        Part {
            is_alive: known.alive,
            is_done: fills.is_some(),
            progress: known.progress,
            waits_for: status.and_then(|s| s.waits_for),
            asks: self.view.setup.params.strategy == Strategy::Negotiated && status.is_some_and(|s| s.stuck),
        }
    }
    fn filled_at(&self) -> Time {
        self.filled_at
    }
    fn is_over(&self) -> bool {
        let View { setup, goal, .. } = self.view;
        self.has_ended || (goal.is_filled(setup) && goal.is_last())
    }
    fn distance(&self, id: ModuleId) -> u64 {
        let at = self.view.world.pose(id).foot();
        let to = self.view.goal.unfilled(self.view.setup).map(|(_, seed)| apart(at, seed.foot));
        u64::from(to.min().unwrap_or(u16::MAX))
    }
    fn remedy(&self, id: ModuleId, level: Level, lease: Span, rng: &mut Rng) -> Vec<Fault> {
        let floor = Floor::new(self, id);
        let dead = self.view.members.dead().first().copied();
        match level {
            Level::Full => self.move_goal(rng).into_iter().collect(),
            Level::Safe | Level::Teleoperation => match dead {
                Some(dead) => vec![Fault::Restart(dead)],
                None => (floor.take(lease))
                    .or_else(|| floor.clear_path(lease))
                    .or_else(|| floor.send_away(id, lease, rng))
                    .unwrap_or_default(),
            },
            Level::Shared => match dead {
                Some(dead) => vec![Fault::Restart(dead)],
                None => (floor.take(lease))
                    .or_else(|| self.is_barred().then(|| self.move_goal(rng).map(|f| vec![f])).flatten())
                    .or_else(|| floor.clear_path(lease))
                    .or_else(|| floor.send_away(id, lease, rng))
                    .or_else(|| self.move_goal(rng).map(|fault| vec![fault]))
                    .unwrap_or_default(),
            },
        }
    }
}

fn apart(a: (i16, i16), b: (i16, i16)) -> u16 {
    a.0.abs_diff(b.0).max(a.1.abs_diff(b.1))
}

impl<'a> Picture<'a> {
    pub(super) fn new(view: View<'a>, monitor: &RunMonitor<Order>) -> Picture<'a> {
        Picture { view, filled_at: monitor.last_gain(), has_ended: monitor.outcome().is_some() }
    }

    /// Returns true if something immovable is in a place of the goal.
    fn is_barred(&self) -> bool {
        self.view.is_seed_blocked(&self.view.foreign())
    }

    /// Returns the command that moves the goal to another place that is clear.
    fn move_goal(&self, rng: &mut Rng) -> Option<Fault> {
        let task = self.view.goal.task();
        let mut places = clear_places(self.view.setup, task, &self.view.foreign());
        let (x, y) = task.shift;
        places.retain(|place| *place != (x, y));
        let place = pick(&places[..places.len().min(CHOICES)], rng)?;
        let by = Target::Shift(place.0.checked_sub(x)?, place.1.checked_sub(y)?);
        Some(Fault::World(&GOAL_MOVED, by))
    }
}

fn pick<T: Copy>(all: &[T], rng: &mut Rng) -> Option<T> {
    all.get(rng.below(all.len().max(1) as u64) as usize).copied()
}

impl<'a> Floor<'a> {
    /// Sees the floor; the metamodule `first` is considered first.
    fn new(picture: &'a Picture<'a>, first: ModuleId) -> Floor<'a> {
        let View { setup, world, members, goal } = picture.view;
        let (mut free, mut fixed) = (Vec::new(), Vec::from_iter(world.obstacles().iter().copied()));
        for (id, known) in members.iter() {
            let is_free = known.alive && known.status.is_some_and(|s| s.settled.is_none());
            if is_free && !world.is_stuck(id) && !world.pose(id).both {
                free.push((id, world.pose(id)));
            } else {
                fixed.extend(world.cells(id));
            }
        }
        free.sort_by_key(|(id, _)| (*id != first, *id));
        let open = goal.open(setup);
        let open = open.iter().filter_map(|seed| Some((seed, setup.seed(goal.task(), seed)?)));
        Floor { picture, free, fixed, open: open.collect() }
    }
    fn ground<'b>(&'b self, taken: &'b [Cell]) -> Ground<'b> {
        let setup = self.picture.view.setup;
        Ground { motions: &setup.motions, floor: setup.floor, taken }
    }
    /// Returns the cells of all but one.
    fn others(&self, one: ModuleId) -> Vec<Cell> {
        let bodies = self.free.iter().filter(|(id, _)| *id != one);
        let cells = bodies.flat_map(|(_, pose)| self.picture.view.setup.motions.cells(*pose));
        self.fixed.iter().copied().chain(cells).collect()
    }
    fn take_command(id: ModuleId, seed: u8, lease: Span) -> Fault {
        Fault::Steer(id, Steering::Take(seed, lease))
    }

    /// A metamodule that has a way to an open place, around all others as they stand, takes it: the one with the shortest.
    fn take(&self, lease: Span) -> Option<Vec<Fault>> {
        let mut best: Option<(usize, ModuleId, u8)> = None;
        for (id, pose) in &self.free {
            let others = self.others(*id);
            for (number, seed) in &self.open {
                let most = best.map_or(usize::MAX, |(steps, _, _)| steps.saturating_sub(1));
                let route = self.ground(&others).to_seed(*pose, *seed, &self.fixed, most);
                if let Some(route) = route.filter(|route| best.is_none_or(|b| route.steps.len() < b.0)) {
                    best = Some((route.steps.len(), *id, *number));
                }
            }
        }
        best.map(|(_, id, seed)| vec![Floor::take_command(id, seed, lease)])
    }

    /// Those in the way of one to an open place step aside, and it takes the place: the case with the fewest.
    fn clear_path(&self, lease: Span) -> Option<Vec<Fault>> {
        let mut best: Option<Vec<Fault>> = None;
        for (id, pose) in &self.free {
            for (number, seed) in &self.open {
                let Some(route) = self.ground(&self.fixed).to_seed(*pose, *seed, &self.fixed, usize::MAX)
                else {
                    continue;
                };
                let mut way = self.swept(*pose, &route);
                way.extend(seed.cells());
                let in_way = self.free.iter().filter(|(other, body)| {
                    *other != *id
                        && self.picture.view.setup.motions.cells(*body).iter().any(|c| way.contains(c))
                });
                let aside = in_way.map(|(other, body)| self.aside(*other, *body, &way, lease));
                let Some(mut commands) = aside.collect::<Option<Vec<Fault>>>() else { continue };
                commands.push(Floor::take_command(*id, *number, lease));
                if best.as_ref().is_none_or(|best| commands.len() < best.len()) {
                    best = Some(commands);
                }
            }
        }
        best
    }

    /// Sends a metamodule to a connector out of a way and of the goal: the nearest to which it has a way now.
    fn aside(&self, id: ModuleId, pose: Pose, way: &BTreeSet<Cell>, lease: Span) -> Option<Fault> {
        let others = self.others(id);
        let ground = self.ground(&others);
        let route = Nearby::new(&ground, pose).find(|to| {
            let foot = to.foot();
            let place = upright(foot);
            let cells = place.cells();
            let is_upright = self.picture.view.setup.motions.cells(to) == cells;
            is_upright
                && to.foot() != pose.foot()
                && self.is_clear(foot)
                && !cells.iter().any(|c| way.contains(c))
        })?;
        let mut at = pose;
        for posture in &route.steps {
            at = ground.landed(at, *posture)?;
        }
        let (x, y) = at.foot();
        Some(Fault::Steer(id, Steering::GoTo(Cell { x, y, z: 0 }, lease)))
    }

    /// Sends a metamodule to any connector that it can reach.
    fn send_away(&self, id: ModuleId, lease: Span, rng: &mut Rng) -> Option<Vec<Fault>> {
        let (id, pose) = *self.free.iter().find(|(free, _)| *free == id).or_else(|| self.free.first())?;
        let others = self.others(id);
        let floor = self.picture.view.setup.floor;
        let mut places = Vec::new();
        for _ in 0..CHOICES * 8 {
            let side =
                |from: i16, to: i16, rng: &mut Rng| from + rng.below(u64::from(from.abs_diff(to)) + 1) as i16;
            places.push((side(floor.min.0, floor.max.0, rng), side(floor.min.1, floor.max.1, rng)));
        }
        let reachable = |foot: &(i16, i16)| {
            let ground = self.ground(&others);
            self.is_clear(*foot) && ground.to_seed(pose, upright(*foot), &self.fixed, usize::MAX).is_some()
        };
        let (x, y) = places.into_iter().filter(|place| *place != pose.foot()).find(reachable)?;
        Some(vec![Fault::Steer(id, Steering::GoTo(Cell { x, y, z: 0 }, lease))])
    }

    /// Returns true for a connector that is not beside an unfilled place of the goal.
    fn is_clear(&self, foot: (i16, i16)) -> bool {
        let View { setup, goal, .. } = self.picture.view;
        goal.unfilled(setup).flat_map(|(_, seed)| seed.cells()).all(|cell| apart((cell.x, cell.y), foot) > 1)
    }

    /// Returns the cells that a route sweeps.
    fn swept(&self, from: Pose, route: &Route) -> BTreeSet<Cell> {
        let ground = self.ground(&self.fixed);
        let (graph, mut at, mut cells) = (ground.motions.graph(), from, BTreeSet::new());
        for (i, posture) in route.steps.iter().copied().chain(route.last).enumerate() {
            let Some(path) = graph.path(at.posture, posture, ground.taken_at(at)) else { break };
            cells.extend(ground.motions.swept(at.state, Sweep(path.swept)));
            if i < route.steps.len() {
                let Some(landed) = ground.landed(at, posture) else { break };
                at = landed;
            }
        }
        cells
    }
}
