//! Why a swarm of cubes stands still: judged on the ground truth; the agents' own reports show what they wait
//! for.

use crate::cube::reachability::{ModuleSnapshot, StandstillSnapshot, motions};
use crate::cube::reasons::{HEARS_OF_NO_TARGET, HOLDS_DEAD, IMMOBILE, PINNED, UNATTACHED};
use crate::cube::registrar::Registrar;
use crate::cube::world::CubeWorld;
use metamorph_kernel::director::outcome::{Stall, Waiter};
use metamorph_kernel::director::reason::Why;
use metamorph_kernel::director::reason::{BLOCKED, MATERIAL_EXHAUSTED, NO_ACTIVE_TARGET, NO_PATH, NO_SPARE};
use metamorph_protocol::cube::control::Status;
use metamorph_protocol::cube::epoch::Epoch;
use metamorph_protocol::cube::message::Role;
use metamorph_protocol::cube::params::{Connectivity, Setup};
use metamorph_protocol::goal::Goal;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::time::Time;
use petgraph::algo::tarjan_scc;
use petgraph::graph::DiGraph;
use std::collections::{BTreeMap, BTreeSet};

/// The controller's knowledge of a module.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Known {
    /// True if its process lives.
    pub alive: bool,
    /// True if it has been restarted, and has lost its memory.
    pub restarted: bool,
    /// Its last report.
    pub status: Option<Status>,
}

impl Known {
    pub(crate) fn is_final(&self, epoch: Epoch) -> bool {
        self.status.is_some_and(|s| s.role == Role::Final && s.epoch == epoch)
    }
    /// True if it is in reserve and has no place in the forest of parents.
    fn is_unattached(&self) -> bool {
        self.status.is_some_and(|s| s.role == Role::Reserve && !s.attached)
    }
    fn is_walker(&self) -> bool {
        self.status.is_some_and(|s| s.role == Role::Walker)
    }
}

/// The goal that is built in an epoch, and what is known of the modules that build it.
#[derive(Clone, Copy)]
pub(super) struct Building<'a> {
    pub goal: &'a Goal,
    pub connectivity: Connectivity,
    pub epoch: Epoch,
    known: &'a [Known],
    registrar: &'a Registrar,
}

impl<'a> Building<'a> {
    /// Creates the view of an epoch.
    pub fn of(setup: &'a Setup, epoch: Epoch, known: &'a [Known], registrar: &'a Registrar) -> Building<'a> {
        // Invariant: the epoch only advances while there is a next goal.
        let goal = &setup.goals[usize::from(epoch.goal())];
        Building { goal, connectivity: setup.params.connectivity_in(epoch), epoch, known, registrar }
    }

    /// Returns the reason for a standstill.
    pub fn diagnose(&self, world: &mut CubeWorld, since: Time) -> Stall {
        let Building { goal, connectivity, epoch, known, .. } = *self;
        let filled = |cell: Cell| {
            world
                .body_at(cell)
                .is_some_and(|id| known[id.index()].is_final(epoch) || !known[id.index()].alive)
        };
        let unfilled: Vec<Cell> = goal.cells().filter(|c| !filled(*c)).collect();
        // An unfilled cell that has waited long enough is started by any live finalized neighbour.
        let starts = |id: ModuleId| known[id.index()].alive && known[id.index()].is_final(epoch);
        let targets: BTreeSet<Cell> = unfilled
            .iter()
            .copied()
            .filter(|c| c.neighbours().into_iter().filter_map(|n| world.body_at(n)).any(starts))
            .collect();
        let spare: Vec<ModuleId> = (0..known.len())
            .filter(|i| known[*i].alive && !known[*i].is_final(epoch))
            .map(|i| ModuleId(i as u32))
            // One that cannot move may be in its goal cell already.
            .filter(|id| !world.is_stuck(*id) || goal.contains(world.cell(*id)))
            .collect();
        let mut stall = Stall {
            since,
            reason: NO_PATH,
            text: "",
            open: unfilled.iter().map(|cell| (*cell).into()).collect(),
            wait_cycle: wait_cycle(known),
            waiting: Vec::new(),
            detected: None,
            proof: None,
        };
        stall.reason = if spare.is_empty() && !unfilled.is_empty() {
            NO_SPARE
        } else if spare.len() < unfilled.len() {
            stall.waiting = spare.iter().map(|id| waiter(known, *id)).take(20).collect();
            MATERIAL_EXHAUSTED
        } else if targets.is_empty() {
            NO_ACTIVE_TARGET
        } else {
            let with_a_path = walkers_with_a_path(world, known, &spare, &targets);
            let may_leave = |id: &ModuleId| {
                connectivity != Connectivity::Cycles
                    || known[id.index()].is_walker()
                    || is_spared(world, known, *id)
            };
            let is_free = |id: &ModuleId| !is_pinned(world, known, *id) && may_leave(id);
            stall.waiting = with_a_path.iter().map(|id| waiter(known, *id)).take(20).collect();
            if with_a_path.iter().any(is_free) {
                BLOCKED
            } else if !with_a_path.is_empty() {
                PINNED
            } else {
                NO_PATH
            }
        };
        stall.text = stall.reason.text;
        stall
    }

    /// Returns the state of the swarm as the input of a reachability search.
    pub fn snapshot(&self, world: &CubeWorld) -> StandstillSnapshot {
        let Building { goal, epoch, known, registrar, .. } = *self;
        // A holder that has been restarted may not know that it is finalized.
        let stays_final = |id: ModuleId| !known[id.index()].alive || known[id.index()].is_final(epoch);
        let is_final_still = |holder: Cell| world.body_at(holder).is_some_and(stays_final);
        let mut snapshot = self.bodies(world);
        for (id, module) in (0..).map(ModuleId).zip(&mut snapshot.modules) {
            let of = &known[id.index()];
            module.held_for_good = !of.alive && registrar.held_for_good_by(id).is_some_and(is_final_still);
            // A module restarted in a goal cell may have been finalized: it stays.
            let is_lost = of.restarted && !of.is_walker() && goal.contains(module.cell);
            module.pinned = of.alive && (is_pinned(world, known, id) || is_lost);
        }
        snapshot
    }

    /// Returns the same without what holds modules in place: enough for a search by the rules of any robot.
    pub fn bodies(&self, world: &CubeWorld) -> StandstillSnapshot {
        let Building { goal, connectivity, epoch, known, .. } = *self;
        let modules = (0..known.len() as u32).map(ModuleId).map(|id| {
            let of = &known[id.index()];
            ModuleSnapshot {
                cell: world.cell(id),
                alive: of.alive,
                stuck: world.is_stuck(id),
                walker: of.is_walker(),
                // The dead module in the seed cell is the root.
                finalized: of.is_final(epoch) || (!of.alive && world.cell(id) == goal.seed()),
                unattached: of.is_unattached(),
                held_for_good: false,
                pinned: false,
            }
        });
        let fills = |id: ModuleId| known[id.index()].is_final(epoch) || !known[id.index()].alive;
        StandstillSnapshot {
            modules: modules.collect(),
            filled: goal.cells().filter(|c| world.body_at(*c).is_some_and(fills)).count(),
            goal: goal.cells().collect(),
            seed: goal.seed(),
            spared_by_live: connectivity == Connectivity::Cycles,
        }
    }
}

/// Returns true if the live neighbours of a module are connected without it over live modules, and each dead one with one of
/// these.
fn is_spared(world: &CubeWorld, known: &[Known], id: ModuleId) -> bool {
    let around = |of: ModuleId| {
        let bodies = world.cell(of).neighbours().into_iter().filter_map(|n| world.body_at(n));
        bodies.filter(|n| *n != id)
    };
    let is_alive = |n: &ModuleId| known[n.index()].alive;
    let beside = |of: ModuleId| around(of).filter(is_alive);
    let mut front: Vec<ModuleId> = beside(id).take(1).collect();
    let mut reached: BTreeSet<ModuleId> = front.iter().copied().collect();
    while let Some(at) = front.pop() {
        front.extend(beside(at).filter(|n| reached.insert(*n)));
    }
    let is_held = |n: ModuleId| {
        if is_alive(&n) { reached.contains(&n) } else { beside(n).any(|m| reached.contains(&m)) }
    };
    around(id).count() < 2 || around(id).all(is_held)
}

fn waiter(known: &[Known], module: ModuleId) -> Waiter {
    let on = waits_for(known, module);
    let is_dead = |id: ModuleId| known.get(id.index()).is_some_and(|k| !k.alive);
    let why = match known.get(module.index()).and_then(|k| k.status) {
        None => Why::UNKNOWN,
        Some(s) if s.immobile => IMMOBILE,
        Some(s) if s.role == Role::Reserve && !s.attached => UNATTACHED,
        Some(s) if s.pinned => HOLDS_DEAD,
        Some(_) if on.is_some_and(is_dead) => Why::WAITS_FOR_DEAD,
        Some(_) if on.is_some() => Why::WAITS,
        Some(s) if !s.attracted => HEARS_OF_NO_TARGET,
        Some(_) => Why::UNKNOWN,
    };
    Waiter { module, on, why }
}

fn waits_for(known: &[Known], id: ModuleId) -> Option<ModuleId> {
    known.get(id.index())?.status?.waits_for
}

/// Returns true if a module is pinned by one that cannot move any more: itself, or one that it waits for, directly or
/// through others.
fn is_pinned(world: &CubeWorld, known: &[Known], id: ModuleId) -> bool {
    let (mut front, mut seen) = (vec![id], BTreeSet::from([id]));
    while let Some(at) = front.pop() {
        let Some(k) = known.get(at.index()) else { continue };
        // Outside the forest of parents, only the end of a branch leaves.
        let touched =
            || world.cell(at).neighbours().into_iter().filter(|c| world.body_at(*c).is_some()).count();
        let is_lost = k.is_unattached() && touched() > 1;
        if !k.alive || world.is_stuck(at) || is_lost || k.status.is_some_and(|s| s.pinned || s.immobile) {
            return true;
        }
        front.extend(waits_for(known, at).filter(|n| seen.insert(*n)));
    }
    false
}

/// Returns the modules that wait for each other in a circle.
fn wait_cycle(known: &[Known]) -> Vec<ModuleId> {
    let mut graph = DiGraph::<ModuleId, ()>::new();
    let nodes: Vec<_> = (0..known.len()).map(|i| graph.add_node(ModuleId(i as u32))).collect();
    for (i, k) in known.iter().enumerate().filter(|(_, k)| k.alive) {
        if let Some(other) = k.status.and_then(|s| s.waits_for).and_then(|o| nodes.get(o.index())) {
            graph.add_edge(nodes[i], *other, ());
        }
    }
    let mut cycle: Vec<ModuleId> = tarjan_scc(&graph)
        .into_iter()
        .find(|part| part.len() > 1)
        .map(|part| part.into_iter().map(|n| graph[n]).collect())
        .unwrap_or_default();
    cycle.sort_unstable();
    cycle
}

/// Returns the spare modules that could walk over the surface to a target, if all others stood still and
/// walkers made room.
fn walkers_with_a_path(
    world: &mut CubeWorld,
    known: &[Known],
    spare: &[ModuleId],
    targets: &BTreeSet<Cell>,
) -> Vec<ModuleId> {
    let reach = {
        let is_support = |cell: Cell| {
            let carries = |id: ModuleId| {
                let k = &known[id.index()];
                !(k.alive && k.is_walker())
            };
            world.body_at(cell).is_some_and(carries)
        };
        // A walker's cell counts as free: it could make room.
        let free = |cell: Cell| {
            world.body_at(cell).is_none_or(|id| {
                let k = &known[id.index()];
                k.alive && k.is_walker()
            })
        };
        surface(targets, &is_support, &free)
    };
    spare
        .iter()
        .copied()
        .filter(|id| {
            let from = world.cell(*id);
            let steps = |world: &CubeWorld| {
                motions().any(|m| {
                    let to = m.destination(from);
                    let support = |c: Cell| world.body_at(c).is_some_and(|s| s != *id);
                    reach.contains(&to)
                        && support(from.step(m.support))
                        && support(to.step(m.landing_support()))
                        && m.corner(from).is_none_or(|c| world.body_at(c).is_none())
                })
            };
            (reach.contains(&from) || steps(world)) && world.is_removable(*id)
        })
        .collect()
}

/// Returns every free cell from which a walker could come to a target. Motions can be undone, so this
/// searches from the targets outwards.
fn surface(
    targets: &BTreeSet<Cell>,
    is_support: &dyn Fn(Cell) -> bool,
    free: &dyn Fn(Cell) -> bool,
) -> BTreeSet<Cell> {
    let mut seen: BTreeMap<Cell, ()> = targets.iter().filter(|c| free(**c)).map(|c| (*c, ())).collect();
    let mut front: Vec<Cell> = seen.keys().copied().collect();
    while let Some(at) = front.pop() {
        for m in motions() {
            let to = m.destination(at);
            let possible = free(to)
                && is_support(at.step(m.support))
                && is_support(to.step(m.landing_support()))
                && m.corner(at).is_none_or(free);
            if possible && seen.insert(to, ()).is_none() {
                front.push(to);
            }
        }
    }
    seen.into_keys().collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use metamorph_kernel::director::reason::Reason;
    use metamorph_protocol::goal::Growth;
    use metamorph_protocol::lattice::Face;
    use metamorph_protocol::time::Span;

    /// Returns a report of an attached module in the first epoch.
    pub fn status(role: Role, wants: u8, waits_for: Option<u32>, pinned: bool) -> Status {
        Status {
            epoch: Epoch::first(0),
            role,
            attached: true,
            immobile: false,
            pinned,
            attracted: true,
            wants,
            subtree: 1,
            prevented: 0,
            waits_for: waits_for.map(ModuleId),
            carries: None,
            custody: [Time::ZERO; 6],
            confirmed: Time::ZERO,
        }
    }

    /// Checks the reason for a swarm on the ground: bodies, what is known of them, and the goal.
    fn check(bodies: &[[i16; 3]], known: &[(bool, Status)], goal: &[[i16; 3]], expected: Reason) -> Stall {
        let cells = |list: &[[i16; 3]]| {
            let mut cells: Vec<Cell> = list.iter().copied().map(Cell::from).collect();
            cells.sort_unstable();
            cells
        };
        let bodies: Vec<Cell> = bodies.iter().copied().map(Cell::from).collect();
        let seed = Cell::from(goal[0]);
        let goal = Goal::compile(&cells(goal), seed, Growth::Solid).unwrap();
        let known: Vec<Known> = known
            .iter()
            .map(|(alive, s)| Known { alive: *alive, restarted: false, status: Some(*s) })
            .collect();
        let mut world = CubeWorld::new(&bodies, Span::secs(1), 1);
        let building = Building {
            goal: &goal,
            connectivity: Connectivity::Forest,
            epoch: Epoch::first(0),
            known: &known,
            registrar: &Registrar::default(),
        };
        let stall = building.diagnose(&mut world, Time::ZERO);
        assert_eq!(stall.reason, expected, "{stall:?}");
        stall
    }

    const UP_MASK: u8 = Face::Up.bit();

    #[test]
    fn names_each_reason() {
        let root = status(Role::Final, UP_MASK, None, false);
        let spare = status(Role::Reserve, 0, None, false);
        let row = [[0, 0, 0], [1, 0, 0], [2, 0, 0]];
        let tower = [[0, 0, 0], [0, 0, 1]];
        check(&row, &[(true, root), (true, spare), (true, spare)], &tower, BLOCKED);
        check(&row, &[(true, root), (false, spare), (false, spare)], &tower, NO_SPARE);
        let mast = [[0, 0, 0], [0, 0, 1], [0, 0, 2]];
        let left = check(&row, &[(true, root), (true, spare), (false, spare)], &mast, MATERIAL_EXHAUSTED);
        assert_eq!(left.waiting.iter().map(|w| w.module.0).collect::<Vec<_>>(), [1]);
        check(&row, &[(false, root), (true, spare), (true, spare)], &tower, NO_ACTIVE_TARGET);
        // The end of the row could walk over the dead middle.
        check(&row, &[(true, root), (false, spare), (true, spare)], &tower, BLOCKED);
        let pinned = status(Role::Reserve, 0, Some(1), true);
        check(&row, &[(true, root), (true, spare), (true, pinned)], &tower, PINNED);
        let bent = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [2, 1, 0]];
        let states = [(true, root), (false, spare), (true, spare), (true, spare), (true, spare)];
        check(&bent, &states, &[[0, 0, 0], [0, 0, 1], [0, 1, 0]], BLOCKED);
        let states = [(true, root), (false, spare), (true, spare), (false, spare), (true, spare)];
        check(&bent, &states, &[[0, 0, 0], [0, 0, 1]], BLOCKED);
        // The only spare module is the one that holds the body together.
        let bridge = [[0, 0, 0], [1, 0, 0], [2, 0, 0]];
        let seed_end = status(Role::Final, UP_MASK, None, false);
        check(&bridge, &[(true, seed_end), (true, spare), (true, root)], &tower, NO_PATH);
    }

    #[test]
    fn lists_the_waiting_modules() {
        let root = status(Role::Final, UP_MASK, None, false);
        let (a, b) = (status(Role::Reserve, 0, Some(2), false), status(Role::Reserve, 0, Some(1), false));
        let row = [[0, 0, 0], [1, 0, 0], [2, 0, 0]];
        let stall = check(&row, &[(true, root), (true, a), (true, b)], &[[0, 0, 0], [0, 0, 1]], BLOCKED);
        assert_eq!(stall.wait_cycle, [ModuleId(1), ModuleId(2)]);
        // The module in the middle holds the row together, and so has no path.
        assert_eq!(stall.waiting, [Waiter { module: ModuleId(2), on: Some(ModuleId(1)), why: Why::WAITS }]);
    }
}
