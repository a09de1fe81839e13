//! Decides if cubes at a standstill could have continued: an exhaustive search over the arrangements that the
//! broken robot can reach, up to a bound. Broken modules stay broken.
//!
//! Four sets of rules are tried, from those of the protocol to those of any robot. Each allows every motion
//! that the one before allows. Within the first two the search asks whether one more goal cell could have
//! been filled; within the others, whether the goal could have been built. A search that ends without a plan
//! proves that there is none within its rules, because it covers every motion that the rules allow.
//! Simultaneous moves are covered by moves one after the other: each needs the body connected without all
//! movers. A plan within the rules of the protocol can be carried out by calls ([`plan`]).

mod arrangements;

use metamorph_kernel::director::proof::{Found, RuleSet};
use metamorph_protocol::lattice::{Cell, Face, Motion, MotionKind};
use std::collections::{BTreeSet, VecDeque};

/// One module at a standstill.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModuleSnapshot {
    /// The cell of the module.
    pub cell: Cell,
    /// True if its process lives.
    pub alive: bool,
    /// True if its joints stick permanently.
    pub stuck: bool,
    /// True if it is a walker: until it is finalized, no module moves over it.
    pub walker: bool,
    /// True if it is part of the finalized structure, or was when it died.
    pub finalized: bool,
    /// True if it is dead and a finalized module holds it, so that it starts goal cells beside it.
    pub held_for_good: bool,
    /// True if it holds a broken module, or waits for one that does.
    pub pinned: bool,
    /// True if it has no place in the forest of parents, so that it leaves only from the end of a branch.
    pub unattached: bool,
}

#[cfg(test)]
impl ModuleSnapshot {
    /// A live module at the origin, with nothing to keep it.
    pub(super) const LIVE: ModuleSnapshot = ModuleSnapshot {
        cell: Cell::new(0, 0, 0),
        alive: true,
        stuck: false,
        walker: false,
        finalized: false,
        held_for_good: false,
        pinned: false,
        unattached: false,
    };
}

/// The input of a search: the modules at a standstill, and the goal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StandstillSnapshot {
    /// All modules.
    pub modules: Vec<ModuleSnapshot>,
    /// The goal cells.
    pub goal: Vec<Cell>,
    /// The goal cell from which growth starts.
    pub seed: Cell,
    /// The number of goal cells that are filled.
    pub filled: usize,
    /// True if only live modules need to stay connected without a module that leaves (connecting cycles).
    pub spared_by_live: bool,
}

/// Returns the widest set of rules within which it is proved that no plan exists. If nothing is proved, returns the
/// result of the search within the narrowest set. The search examines no more than `bound` arrangements within the
/// two narrowest sets, and at far fewer within the others, which only widen the proof.
pub fn widest_proof(snapshot: &StandstillSnapshot, bound: usize) -> Result<RuleSet, Found> {
    let mut proved = None;
    for within in RuleSet::ALL {
        let bound = if within <= RuleSet::Carried { bound } else { bound / 40 };
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
    arrangements::search(snapshot, within, bound).0
}

/// One move of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PlannedMove {
    /// The cell of the module that moves.
    pub from: Cell,
    /// The motion.
    pub motion: Motion,
    /// True if the module that it lands on is finalized, or was when it died.
    pub lands_on_fixed: bool,
    /// True if it goes from a dead module onto another one, which it cannot ask for consent.
    pub is_unasked: bool,
}

/// Returns a plan that fills one more goal cell by the rules of the protocol, if one is found among at most `bound`
/// arrangements. It is empty if the cell needs no move.
pub fn plan(snapshot: &StandstillSnapshot, bound: usize) -> Option<Vec<PlannedMove>> {
    let (found, plan) = arrangements::search(snapshot, RuleSet::Held, bound);
    matches!(found, Found::Way(_)).then_some(plan)
}

/// Returns a plan that fills the whole goal by the rules of any robot, if one is found among at most `bound` arrangements.
pub fn plan_of_any_robot(snapshot: &StandstillSnapshot, bound: usize) -> Option<Vec<PlannedMove>> {
    let (found, plan) = arrangements::search(snapshot, RuleSet::Anything, bound);
    matches!(found, Found::Way(_)).then_some(plan)
}

impl StandstillSnapshot {
    fn moves(&self, module: &ModuleSnapshot, within: RuleSet) -> bool {
        let stays = match within {
            RuleSet::Anything => false,
            RuleSet::Grown | RuleSet::Carried => module.finalized,
            RuleSet::Held => module.finalized || module.pinned,
        };
        module.alive && !module.stuck && !stays
    }
    /// Returns the goal cells that hold neither a finalized module nor a dead one.
    pub(super) fn unfilled(&self) -> Vec<Cell> {
        let fills = |m: &&ModuleSnapshot| m.finalized || !m.alive;
        let filled: BTreeSet<Cell> = self.modules.iter().filter(fills).map(|m| m.cell).collect();
        self.goal.iter().copied().filter(|c| !filled.contains(c)).collect()
    }
    /// Returns true if fewer modules can move than there are goal cells without an immovable module in them.
    fn is_short_of_modules(&self) -> bool {
        let mut others = self.modules.iter().filter(|m| !self.moves(m, RuleSet::Anything));
        let held = others.clone().filter(|m| self.goal.contains(&m.cell)).count();
        self.modules.len() - others.by_ref().count() + held < self.goal.len()
    }
}

/// Returns true if cells are connected with each other through cells that `counts` accepts. It stops when they have met, so that
/// a small loop costs little in a large body.
pub(super) fn are_together(cells: &[Cell], counts: &dyn Fn(&Cell) -> bool) -> bool {
    let mut reached: BTreeSet<Cell> = cells.first().copied().into_iter().collect();
    let mut front: VecDeque<Cell> = reached.iter().copied().collect();
    let mut missing = cells.len().saturating_sub(1);
    while missing > 0 {
        let Some(at) = front.pop_front() else { return false };
        for next in at.neighbours() {
            if counts(&next) && reached.insert(next) {
                missing -= usize::from(cells.contains(&next));
                front.push_back(next);
            }
        }
    }
    true
}

/// Returns `from` and the cells connected with it through cells that `counts` accepts.
pub(super) fn spread(from: impl Iterator<Item = Cell>, counts: &dyn Fn(&Cell) -> bool) -> BTreeSet<Cell> {
    let mut reached: BTreeSet<Cell> = from.collect();
    let mut front: Vec<Cell> = reached.iter().copied().collect();
    while let Some(at) = front.pop() {
        front.extend(at.neighbours().into_iter().filter(|c| counts(c) && reached.insert(*c)));
    }
    reached
}

/// Iterates over all motions of a cube.
pub(super) fn motions() -> impl Iterator<Item = Motion> {
    Face::ALL.into_iter().flat_map(|support| {
        support.perpendicular().into_iter().flat_map(move |heading| {
            [MotionKind::Slide, MotionKind::Convex].map(|kind| Motion { kind, support, heading })
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: i16, y: i16, z: i16) -> ModuleSnapshot {
        ModuleSnapshot { cell: Cell::new(x, y, z), ..ModuleSnapshot::LIVE }
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
        StandstillSnapshot { modules: modules.to_vec(), seed: goal[0], goal, filled, spared_by_live: false }
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
        // A stuck walker carries no module.
        let stuck = ModuleSnapshot { stuck: true, walker: true, ..at(1, 0, 0) };
        let cut_off = snapshot(&[root(0, 0, 0), stuck, at(2, 0, 0)], &tower);
        assert_eq!(widest_proof(&cut_off, 1_000), Ok(RuleSet::Carried));
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

    /// The end of a row goes over the dead middle: around its corner, and on to the finalized module.
    #[test]
    fn plans_lead_over_the_dead() {
        let tower = [[0, 0, 0], [0, 0, 1]];
        let row = snapshot(&[root(0, 0, 0), dead(1, 0, 0), at(2, 0, 0)], &tower);
        let steps = [
            PlannedMove {
                from: Cell::new(2, 0, 0),
                motion: Motion { kind: MotionKind::Convex, support: Face::West, heading: Face::Up },
                lands_on_fixed: false,
                is_unasked: false,
            },
            PlannedMove {
                from: Cell::new(1, 0, 1),
                motion: Motion { kind: MotionKind::Slide, support: Face::Down, heading: Face::West },
                lands_on_fixed: true,
                is_unasked: true,
            },
        ];
        assert_eq!(plan(&row, 1_000), Some(steps.to_vec()));
        // From a dead module it steps onto one that may leave, which the controller asks for consent.
        let apart = snapshot(&[root(0, 0, 0), at(1, 0, 0), dead(2, 0, 0), at(3, 0, 0)], &tower);
        let unasked = plan(&apart, 1_000).unwrap().into_iter().filter(|step| step.is_unasked);
        assert_eq!(unasked.map(|step| step.lands_on_fixed).collect::<Vec<bool>>(), [false]);
        // A dead module in a goal cell starts the next one if a finalized module holds it.
        let goal = [[0, 0, 0], [1, 0, 0], [2, 0, 0]];
        for held_for_good in [false, true] {
            let dead = ModuleSnapshot { held_for_good, ..dead(1, 0, 0) };
            let row = snapshot(&[root(0, 0, 0), dead, at(1, 0, 1)], &goal);
            assert_eq!(plan(&row, 1_000).map(|p| p.len()), held_for_good.then_some(1));
        }
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
                cells.iter().map(|c| ModuleSnapshot { cell: *c, ..ModuleSnapshot::LIVE }).collect();
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
