//! Decides if cubes at a standstill could have gone on: an exhaustive search over the arrangements that the
//! broken robot can reach, up to a bound. Broken modules stay broken.
//!
//! Four sets of rules are tried, from those of the protocol to those of any robot. Each allows every motion
//! that the one before allows. Within the first two the search asks whether one more goal cell could have
//! been filled; within the others, whether the goal could have been built. A search that ends without a plan
//! proves that there is none within its rules, because it covers every motion that the rules allow.
//! Simultaneous moves are covered by moves one after the other: each needs the body connected without all
//! movers.
//!
//! Not here: when and by which neighbour a module is recruited; only that the message can reach it at all.

use crate::director::proof::{Found, RuleSet};
use metamorph_protocol::lattice::{Cell, Face, Motion, MotionKind};
use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};

/// One module at a standstill.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModuleSnapshot {
    /// The cell of the module.
    pub cell: Cell,
    /// True if its process lives.
    pub alive: bool,
    /// True if its joints stick for good.
    pub stuck: bool,
    /// True if it is a walker: until it is finalized, no module moves over it or hears from it.
    pub walker: bool,
    /// True if it is part of the finalized structure.
    pub finalized: bool,
    /// True if it holds a broken module, or waits for one that does.
    pub pinned: bool,
}

/// The input of a search: the modules at a standstill, and the goal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StandstillSnapshot {
    /// All modules.
    pub modules: Vec<ModuleSnapshot>,
    /// The goal cells.
    pub goal: Vec<Cell>,
    /// The number of goal cells that are filled.
    pub filled: usize,
    /// True if only live modules need to stay connected without a module that leaves (connecting cycles).
    pub spared_by_live: bool,
}

/// Returns the widest set of rules within which it is proved that no plan exists. If nothing is proved, returns the
/// result of the search within the narrowest set. The search looks at no more than `bound` arrangements within the
/// two narrowest sets, and at far fewer within the others, which only widen the proof.
pub fn widest_proof(snapshot: &StandstillSnapshot, bound: usize) -> Result<RuleSet, Found> {
    let mut proved = None;
    for within in RuleSet::ALL {
        let bound = if within <= RuleSet::Called { bound } else { bound / 40 };
        match search(snapshot, within, bound) {
            // A goal that is impossible in principle is often easy to detect.
            Found::Impossible(_) if snapshot.is_short_of_modules() => return Ok(RuleSet::Anything),
            Found::Impossible(_) => proved = Some(within),
            other => return proved.ok_or(other),
        }
    }
    proved.ok_or(Found::Undecided)
}

/// Searches within the rules, arrangements nearest to the goal first.
pub fn search(snapshot: &StandstillSnapshot, within: RuleSet, bound: usize) -> Found {
    let state_space = StateSpace::new(snapshot, within);
    let start = state_space.movers.clone();
    if state_space.needs_live() && !state_space.is_enough(&start) && state_space.is_out_of_reach(&start) {
        return Found::Impossible(1);
    }
    let mut seen = BTreeSet::from([start.clone()]);
    let mut front = BinaryHeap::from([Reverse((state_space.distance(&start), 0, start))]);
    while let Some(Reverse((_, moves, at))) = front.pop() {
        if state_space.is_enough(&at) {
            return Found::Way(moves);
        }
        for next in state_space.moves(&at) {
            if seen.len() >= bound {
                return Found::Undecided;
            }
            if seen.insert(next.clone()) {
                front.push(Reverse((state_space.distance(&next), moves + 1, next)));
            }
        }
    }
    Found::Impossible(seen.len())
}

impl StandstillSnapshot {
    fn moves(&self, module: &ModuleSnapshot, within: RuleSet) -> bool {
        let stays = match within {
            RuleSet::Anything => false,
            RuleSet::Grown | RuleSet::Called => module.finalized,
            RuleSet::Held => module.finalized || module.pinned,
        };
        module.alive && !module.stuck && !stays
    }
    /// Returns true if fewer modules can move than there are goal cells without an immovable module in them.
    fn is_short_of_modules(&self) -> bool {
        let mut others = self.modules.iter().filter(|m| !self.moves(m, RuleSet::Anything));
        let held = others.clone().filter(|m| self.goal.contains(&m.cell)).count();
        self.modules.len() - others.by_ref().count() + held < self.goal.len()
    }
}

/// The constant part of a search.
struct StateSpace {
    within: RuleSet,
    spared_by_live: bool,
    goal: Vec<Cell>,
    /// The number of goal cells that must be filled.
    enough: usize,
    /// The initial cells of the modules that can move.
    movers: Vec<Cell>,
    /// Cells of live modules that do not move.
    fixed_live: BTreeSet<Cell>,
    dead: BTreeSet<Cell>,
    /// Initial cells of walkers, which carry no module before they are finalized.
    walkers: BTreeSet<Cell>,
    /// Live modules of the finalized structure.
    roots: BTreeSet<Cell>,
}

impl StateSpace {
    fn new(snapshot: &StandstillSnapshot, within: RuleSet) -> StateSpace {
        let cells = |which: &dyn Fn(&ModuleSnapshot) -> bool| {
            snapshot.modules.iter().filter(|m| which(m)).map(|m| m.cell).collect::<BTreeSet<Cell>>()
        };
        StateSpace {
            within,
            spared_by_live: snapshot.spared_by_live,
            goal: snapshot.goal.clone(),
            enough: match within {
                RuleSet::Held | RuleSet::Called => snapshot.filled + 1,
                RuleSet::Grown | RuleSet::Anything => snapshot.goal.len(),
            },
            movers: cells(&|m| snapshot.moves(m, within)).into_iter().collect(),
            fixed_live: cells(&|m| m.alive && !snapshot.moves(m, within)),
            dead: cells(&|m| !m.alive),
            walkers: cells(&|m| m.walker),
            roots: cells(&|m| m.alive && m.finalized),
        }
    }

    /// Returns true if the rules let only live modules support others and hear of the goal.
    fn needs_live(&self) -> bool {
        matches!(self.within, RuleSet::Held | RuleSet::Called)
    }

    fn is_live(&self, at: &[Cell], cell: Cell) -> bool {
        at.binary_search(&cell).is_ok() || self.fixed_live.contains(&cell)
    }
    /// Returns true if others can move over the module in a cell, and hear from it: it has not left its
    /// initial cell, or is part of the finalized structure.
    fn carries(&self, at: &[Cell], grown: &BTreeSet<Cell>, cell: Cell) -> bool {
        let has_not_set_out = self.fixed_live.contains(&cell)
            || (at.binary_search(&cell).is_ok() && self.movers.binary_search(&cell).is_ok());
        (has_not_set_out && !self.walkers.contains(&cell)) || grown.contains(&cell)
    }
    fn is_taken(&self, at: &[Cell], cell: Cell) -> bool {
        self.is_live(at, cell) || self.dead.contains(&cell)
    }

    /// Returns the finalized structure, grown over live modules in goal cells.
    fn grown(&self, at: &[Cell]) -> BTreeSet<Cell> {
        spread(self.roots.iter().copied(), &|c| self.goal.contains(c) && self.is_live(at, *c))
    }

    /// Returns true if enough goal cells are filled. If only live modules support others, a cell counts only if it is
    /// part of the structure grown from the finalized one, or has a dead module in it.
    fn is_enough(&self, at: &[Cell]) -> bool {
        let grown = self.needs_live().then(|| self.grown(at));
        let is_filled = |c: &&Cell| match &grown {
            Some(grown) => self.dead.contains(c) || grown.contains(c),
            None => self.is_taken(at, **c),
        };
        self.goal.iter().filter(is_filled).count() >= self.enough
    }

    /// Returns true if no module comes to a goal cell that could be filled next, even if all others made way
    /// and carried at the same time. This detects most swarms that are cut off from the goal at once.
    fn is_out_of_reach(&self, at: &[Cell]) -> bool {
        let grown = self.grown(at);
        // This covers a goal cell that a module leaves, too.
        let heard = spread(grown.iter().copied(), &|c| self.carries(at, &grown, *c));
        let is_wall = |c: &Cell| self.fixed_live.contains(c) || self.dead.contains(c);
        let carries = |c: Cell| self.carries(at, &grown, c) || self.goal.contains(&c);
        let mut reached: BTreeSet<Cell> = at.iter().copied().collect();
        let mut front = at.to_vec();
        while let Some(from) = front.pop() {
            for motion in motions().filter(|m| heard.contains(&from.step(m.support))) {
                let to = motion.destination(from);
                let is_free = !is_wall(&to) && motion.corner(from).is_none_or(|c| !is_wall(&c));
                if is_free && carries(to.step(motion.landing_support())) && reached.insert(to) {
                    front.push(to);
                }
            }
        }
        let is_next = |c: &&Cell| {
            !self.is_taken(at, **c)
                && reached.contains(*c)
                && c.neighbours().iter().any(|n| grown.contains(n))
        };
        !self.goal.iter().any(|c| is_next(&c))
    }

    /// Returns the cells whose modules can hear of an unfilled goal cell: those connected over live modules
    /// with a part of the finalized structure that touches one.
    fn heard(&self, at: &[Cell], grown: &BTreeSet<Cell>) -> BTreeSet<Cell> {
        let is_free = |c: &Cell| self.goal.contains(c) && !self.is_taken(at, *c);
        let starts = |c: &Cell| c.neighbours().iter().any(is_free);
        spread(grown.iter().copied().filter(starts), &|c| self.carries(at, grown, *c))
    }

    /// Returns the faces at which the distance to an unfilled goal cell can be known: distances spread along
    /// the surface, from live module to live module, and end where a dead module stands in a corner.
    fn surface(&self, at: &[Cell], grown: &BTreeSet<Cell>) -> BTreeSet<(Cell, Face)> {
        let carries = |c: Cell| self.carries(at, grown, c);
        let is_free = |c: Cell| self.goal.contains(&c) && !self.dead.contains(&c) && !grown.contains(&c);
        let mut front: Vec<(Cell, Face)> = grown
            .iter()
            .flat_map(|c| Face::ALL.map(|f| (*c, f)))
            .filter(|(c, f)| is_free(c.step(*f)))
            .collect();
        let mut reached: BTreeSet<(Cell, Face)> = front.iter().copied().collect();
        while let Some((cell, face)) = front.pop() {
            for heading in face.perpendicular() {
                let beside = cell.step(heading);
                let next = match (carries(beside), carries(beside.step(face))) {
                    (false, _) => (cell, heading),
                    (true, false) => (beside, face),
                    (true, true) => (beside.step(face), heading.opposite()),
                };
                let outside = next.0.step(next.1);
                if !carries(outside) && !self.dead.contains(&outside) && reached.insert(next) {
                    front.push(next);
                }
            }
        }
        reached
    }

    /// Returns true if a module that has not left its initial cell hears of an unfilled goal cell from its
    /// neighbours.
    fn is_attracted(
        &self,
        at: &[Cell],
        grown: &BTreeSet<Cell>,
        surface: &BTreeSet<(Cell, Face)>,
        from: Cell,
    ) -> bool {
        Face::ALL.into_iter().filter(|f| self.carries(at, grown, from.step(*f))).any(|support| {
            let by = from.step(support);
            support.perpendicular().into_iter().any(|heading| {
                surface.contains(&(by, heading)) || surface.contains(&(by.step(heading), support.opposite()))
            })
        })
    }

    /// Returns a heuristic: for each unfilled goal cell 4 plus the distance of the nearest module outside of the goal,
    /// or plus 100 if there is none.
    fn distance(&self, at: &[Cell]) -> u32 {
        let free = self.goal.iter().filter(|c| !self.is_taken(at, **c));
        let spare = || at.iter().filter(|c| !self.goal.contains(c));
        free.map(|goal| 4 + spare().map(|c| c.manhattan(*goal)).min().unwrap_or(100)).sum()
    }

    /// Returns every arrangement after one move.
    fn moves(&self, at: &[Cell]) -> Vec<Vec<Cell>> {
        let grown = if self.needs_live() { self.grown(at) } else { BTreeSet::new() };
        let heard = self.needs_live().then(|| (self.heard(at, &grown), self.surface(at, &grown)));
        let mut found = Vec::new();
        for (i, from) in at.iter().copied().enumerate() {
            // A module that has left its cell and hears of no target may still come to a place where it does.
            // That is assumed only where all modules in between live: behind dead ones only a random walk
            // finds the path.
            let has_set_out = self.movers.binary_search(&from).is_err() || self.walkers.contains(&from);
            let hears = |(heard, surface): &(BTreeSet<Cell>, BTreeSet<(Cell, Face)>)| {
                (heard.contains(&from) || from.neighbours().iter().any(|n| heard.contains(n)))
                    && (has_set_out || self.is_attracted(at, &grown, surface, from))
            };
            if heard.as_ref().is_some_and(|heard| !hears(heard)) {
                continue;
            }
            let mut rest = at.to_vec();
            rest.remove(i);
            let destinations: BTreeSet<Cell> = motions()
                .filter(|m| self.is_possible(&rest, &grown, from, *m))
                .map(|m| m.destination(from))
                .collect();
            if destinations.is_empty() || !self.holds_without(&rest, &grown, from) {
                continue;
            }
            for to in destinations {
                let mut next = rest.clone();
                let place = next.partition_point(|c| *c < to);
                next.insert(place, to);
                found.push(next);
            }
        }
        found
    }

    fn is_possible(&self, rest: &[Cell], grown: &BTreeSet<Cell>, from: Cell, motion: Motion) -> bool {
        let carries = |cell: Cell| {
            if self.needs_live() { self.carries(rest, grown, cell) } else { self.is_taken(rest, cell) }
        };
        let to = motion.destination(from);
        carries(from.step(motion.support))
            && carries(to.step(motion.landing_support()))
            && !self.is_taken(rest, to)
            && motion.corner(from).is_none_or(|c| !self.is_taken(rest, c))
    }

    /// Returns true if the neighbours of a cell are connected without the module that leaves it.
    fn holds_without(&self, rest: &[Cell], grown: &BTreeSet<Cell>, from: Cell) -> bool {
        let together = |counts: &dyn Fn(&Cell) -> bool| {
            let beside: Vec<Cell> = from.neighbours().into_iter().filter(|c| counts(c)).collect();
            if beside.len() < 2 {
                return true;
            }
            let reached = spread(beside.first().copied().into_iter(), counts);
            beside.iter().all(|c| reached.contains(c))
        };
        let by_live = self.within == RuleSet::Held && self.spared_by_live;
        together(&|c| self.is_taken(rest, *c))
            && (!by_live || together(&|c| *c != from && self.carries(rest, grown, *c)))
    }
}

/// Returns `from` and the cells connected with it through cells that `counts` accepts.
fn spread(from: impl Iterator<Item = Cell>, counts: &dyn Fn(&Cell) -> bool) -> BTreeSet<Cell> {
    let mut reached: BTreeSet<Cell> = from.collect();
    let mut front: Vec<Cell> = reached.iter().copied().collect();
    while let Some(at) = front.pop() {
        front.extend(at.neighbours().into_iter().filter(|c| counts(c) && reached.insert(*c)));
    }
    reached
}

fn motions() -> impl Iterator<Item = Motion> {
    Face::ALL.into_iter().flat_map(|support| {
        support.perpendicular().into_iter().flat_map(move |heading| {
            [MotionKind::Slide, MotionKind::Convex].map(|kind| Motion { kind, support, heading })
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIVE: ModuleSnapshot = ModuleSnapshot {
        cell: Cell::new(0, 0, 0),
        alive: true,
        stuck: false,
        walker: false,
        finalized: false,
        pinned: false,
    };

    fn at(x: i16, y: i16, z: i16) -> ModuleSnapshot {
        ModuleSnapshot { cell: Cell::new(x, y, z), ..LIVE }
    }
    fn root(x: i16, y: i16, z: i16) -> ModuleSnapshot {
        ModuleSnapshot { finalized: true, ..at(x, y, z) }
    }
    fn dead(x: i16, y: i16, z: i16) -> ModuleSnapshot {
        ModuleSnapshot { alive: false, ..at(x, y, z) }
    }
    fn snapshot(modules: &[ModuleSnapshot], goal: &[[i16; 3]]) -> StandstillSnapshot {
        let goal: Vec<Cell> = goal.iter().copied().map(Cell::from).collect();
        let filled = modules.iter().filter(|m| goal.contains(&m.cell) && (m.finalized || !m.alive)).count();
        StandstillSnapshot { modules: modules.to_vec(), goal, filled, spared_by_live: false }
    }

    #[test]
    fn finds_a_plan_where_there_is_one() {
        let row = snapshot(&[root(0, 0, 0), at(1, 0, 0), at(2, 0, 0)], &[[0, 0, 0], [0, 0, 1]]);
        // The end of the row goes over the middle: two moves.
        assert_eq!(search(&row, RuleSet::Held, 1_000), Found::Way(2));
        assert_eq!(widest_proof(&row, 1_000), Err(Found::Way(2)));
        assert_eq!(search(&row, RuleSet::Held, 2), Found::Undecided);
    }

    #[test]
    fn a_mover_can_make_way_for_another() {
        // The module above the root is a walker; the goal is its cell and one beside.
        let stack = [root(0, 0, 0), at(0, 0, 1), at(0, 0, 2)];
        let tower = snapshot(&stack, &[[0, 0, 0], [1, 0, 0], [0, 0, 1]]);
        assert!(matches!(search(&tower, RuleSet::Held, 1_000), Found::Way(_)));
    }

    #[test]
    fn names_the_rules_within_which_no_plan_exists() {
        let tower = [[0, 0, 0], [0, 0, 1]];
        // No module is left.
        let few = snapshot(&[root(0, 0, 0), dead(1, 0, 0)], &tower);
        assert_eq!(widest_proof(&few, 1_000), Ok(RuleSet::Anything));
        // The end could go over the dead middle, but no message reaches it; and the structure beside it,
        // where no cell is unfilled, does not tell of cells elsewhere.
        let cut_off = snapshot(&[root(0, 0, 0), dead(1, 0, 0), at(2, 0, 0)], &tower);
        assert_eq!(widest_proof(&cut_off, 1_000), Ok(RuleSet::Called));
        let row = [root(0, 0, 0), dead(1, 0, 0), root(2, 0, 0), at(3, 0, 0)];
        let cut_off = snapshot(&row, &[[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, 1]]);
        assert_eq!(widest_proof(&cut_off, 1_000), Ok(RuleSet::Called));
        // A stuck walker on its path does not let it pass either.
        let stuck = ModuleSnapshot { stuck: true, walker: true, ..at(1, 0, 0) };
        let cut_off = snapshot(&[root(0, 0, 0), stuck, at(2, 0, 0)], &tower);
        assert_eq!(widest_proof(&cut_off, 1_000), Ok(RuleSet::Called));
        // The end holds a dead module.
        let holds = ModuleSnapshot { pinned: true, ..at(1, 0, 0) };
        let side = [root(0, 0, 0), holds, dead(1, 1, 0), root(0, 1, 0)];
        let pinned = snapshot(&side, &[[0, 0, 0], [0, 1, 0], [0, 0, 1]]);
        assert_eq!(widest_proof(&pinned, 1_000), Ok(RuleSet::Held));
        // The bridge is the finalized structure: taking it down would allow the rest to be built, but growth
        // does not.
        let bridge = [root(0, 0, 0), root(1, 0, 0), dead(2, 0, 0)];
        let built = snapshot(&bridge, &[[1, 0, 0], [1, 0, 1]]);
        assert_eq!(widest_proof(&built, 1_000), Ok(RuleSet::Grown));
    }

    /// Distances go along the surface and end where a dead module stands in a corner, though a walker gets past.
    #[test]
    fn distances_end_at_the_dead() {
        let arm = [at(0, -2, -2), at(0, -1, -2), at(0, -1, -1), at(0, -1, 0), at(0, 0, -2), at(0, 0, 0)];
        let arm =
            arm.into_iter().chain([at(0, 1, -1), at(0, 1, 0)]).map(|m| ModuleSnapshot { pinned: true, ..m });
        let dead = [dead(-1, -1, -2), dead(0, -2, -1), dead(1, -1, 0), dead(0, 0, -1), dead(1, -2, -1)];
        let standstill = |walker| {
            let end = ModuleSnapshot { walker, ..at(1, -1, -2) };
            let modules: Vec<ModuleSnapshot> = arm.clone().chain(dead).chain([root(1, 1, -1), end]).collect();
            search(&snapshot(&modules, &[[1, 1, -1], [1, 2, -1]]), RuleSet::Held, 1_000)
        };
        assert_eq!(standstill(true), Found::Way(4));
        assert_eq!(standstill(false), Found::Impossible(1));
    }

    /// A plan that is impossible within wider rules is impossible within narrower ones: on every small
    /// example.
    #[test]
    fn wider_rules_allow_more() {
        use metamorph_protocol::rng::Rng;
        let mut impossible = 0;
        for seed in 0..300 {
            let mut random = Rng::named(seed, "plight", 0);
            let mut cells = vec![Cell::new(0, 0, 0)];
            while cells.len() < 5 {
                let from = cells[random.below(cells.len() as u64) as usize];
                let next = from.step(Face::ALL[random.below(6) as usize]);
                if !cells.contains(&next) {
                    cells.push(next);
                }
            }
            let mut modules: Vec<ModuleSnapshot> =
                cells.iter().map(|c| ModuleSnapshot { cell: *c, ..LIVE }).collect();
            modules[0].finalized = true;
            for module in &mut modules[1..] {
                module.alive = random.below(3) > 0;
                module.pinned = random.below(4) == 0;
                module.stuck = random.below(6) == 0;
            }
            let goal: Vec<[i16; 3]> = (0..=random.below(3)).map(|z| [0, 0, z as i16]).collect();
            let snapshot =
                StandstillSnapshot { spared_by_live: random.below(2) == 0, ..snapshot(&modules, &goal) };
            let found = RuleSet::ALL.map(|w| search(&snapshot, w, 20_000));
            for pair in found.chunks(2) {
                if let [narrow, Found::Impossible(_)] = pair {
                    assert!(matches!(narrow, Found::Impossible(_)), "{snapshot:?} {found:?}");
                    impossible += 1;
                }
            }
        }
        assert!(impossible > 50, "{impossible}");
    }
}
