//! From one number to a scenario: world, start, goals, strategy, link and faults. Small worlds, because
//! what goes wrong among many goes wrong among few, where it can be understood.
//!
//! Kinds of faults are left out of a run at random, all together now and then: a fault that strikes
//! everywhere hides what only happens without it. Absent: the published connection gradient, which is
//! known to tear bodies when messages are late.

use super::draft::{
    Break, CubeDraft, CubeGoal, Draft, FaultDraft, LinkDraft, MetamoduleDraft, MetamoduleGoal, SwarmDraft,
};
use crate::scenario::{Plan, Swarm};
use metamorph_module_agent::Family;
use metamorph_protocol::cube::params::Connectivity;
use metamorph_protocol::goal::{Goal, Growth};
use metamorph_protocol::lattice::{Cell, Face};
use metamorph_protocol::metamodule::blueprint::{Seed, SeedOrder, box_of_four, chair_of_six};
use metamorph_protocol::metamodule::params::{Precedence, PrecedenceBy, Strategy, Teller};
use metamorph_protocol::rng::Stream;
use metamorph_protocol::roombots::Kind;
use std::collections::BTreeSet;

/// So often something is drawn again that cannot be run, such as more goals than a floor has room for.
const TRIES: u64 = 40;

/// The scenario of a seed, and what it reads as.
pub fn draw(seed: u64, family: Option<Family>) -> (Draft, Plan) {
    for attempt in 0..TRIES {
        let mut dice = Dice(Stream::named(seed, "explore", attempt));
        let family = family.unwrap_or_else(|| dice.pick(&[Family::Cube, Family::Metamodule]));
        if let Some(drawn) = complete(dice.draft(seed, family)) {
            return drawn;
        }
    }
    complete(Draft { seed, ..smallest(family.unwrap_or_default()) })
        .expect("invariant: the smallest scenario can be read, whatever its seed")
}

/// Reads a scenario, and writes down what its seed decides on.
fn complete(mut draft: Draft) -> Option<(Draft, Plan)> {
    let plan = draft.plan("explored.toml", None).ok()?;
    if let (SwarmDraft::Metamodules(m), Swarm::Metamodules(placed)) = (&mut draft.swarm, &plan.swarm)
        && m.start.is_err()
    {
        m.start = Ok(placed.poses.iter().map(|p| p.state).collect());
        let plan = draft.plan("explored.toml", None).ok()?;
        return Some((draft, plan));
    }
    Some((draft, plan))
}

/// Two modules, or one metamodule, with next to nothing to do.
fn smallest(family: Family) -> Draft {
    let swarm = match family {
        Family::Cube => SwarmDraft::Cubes(CubeDraft {
            start: vec![Cell::new(0, 0, 0), Cell::new(1, 0, 0)],
            goals: vec![CubeGoal {
                cells: vec![Cell::new(0, 0, 0), Cell::new(0, 0, 1)],
                seed: Cell::new(0, 0, 0),
                growth: Growth::Solid,
            }],
            connectivity: Connectivity::Forest,
            co_owners: true,
        }),
        Family::Metamodule => SwarmDraft::Metamodules(MetamoduleDraft {
            kind: Kind::Srs,
            side: 9,
            start: Err(1),
            goals: vec![(
                0,
                MetamoduleGoal { levels: vec![vec![upright(4, 4)]], order: SeedOrder::Circular },
            )],
            strategy: Strategy::Negotiated,
            teller: Teller::Controller,
            relocate: false,
            precedence: None,
            settled_repel: true,
        }),
    };
    let link = LinkDraft { delay: (10, 100), ..LinkDraft::default() };
    Draft {
        description: String::new(),
        seed: 0,
        swarm,
        failed_connections: 0,
        link,
        faults: Vec::new(),
        patience: None,
    }
}

fn upright(x: i16, y: i16) -> Seed {
    Seed { foot: (x, y), directions: [Face::Up; 3] }
}

/// The usual bounds are for links that are faster than moves, and for joints that turn: a cube whose moves
/// have failed again and again rests for 150 moves. Whoever among metamodules gets on no more does so soon,
/// and to watch it for longer is slow.
fn patience(draft: &Draft, family: Family) -> Option<(u64, u64)> {
    let fails = draft.failed_connections > 0;
    match (family, draft.link.delay.1) {
        (Family::Cube, 0..500) if !fails => None,
        (Family::Cube, 0..500) => Some((1_000, 4_000)),
        (Family::Cube, 500..1_000) => Some((1_000, 4_000)),
        (Family::Cube, _) => Some((3_000, 12_000)),
        (Family::Metamodule, 0..1_000) => Some((120, 1_000)),
        (Family::Metamodule, _) => Some((400, 2_000)),
    }
}

/// Seeds below this one draw what they always have.
const LASTING_FROM: u64 = 1 << 32;

/// Whether what harms messages goes on for ever: in one of four runs in which something does. The usual
/// bounds count with what the link does, but not with moves that fail again and again.
fn lasts(draft: &Draft) -> bool {
    let drawn = || Stream::named(draft.seed, "explore, lasting harm", 0).below(4) == 0;
    draft.seed >= LASTING_FROM && draft.link.harms() && draft.failed_connections == 0 && drawn()
}

/// What is drawn from.
struct Dice(Stream);

impl Dice {
    /// From `low` to `high`, both included.
    fn within(&mut self, low: u64, high: u64) -> u64 {
        low + self.0.below(high - low + 1)
    }
    fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.0.below(of.len() as u64) as usize]
    }
    /// Once in `n`.
    fn once_in(&mut self, n: u64) -> bool {
        self.0.below(n) == 0
    }

    fn draft(&mut self, seed: u64, family: Family) -> Draft {
        let swarm = match family {
            Family::Cube => SwarmDraft::Cubes(self.cubes()),
            Family::Metamodule => SwarmDraft::Metamodules(self.metamodules()),
        };
        let mut draft = Draft {
            description: String::new(),
            seed,
            swarm,
            failed_connections: 0,
            link: self.link(),
            faults: Vec::new(),
            patience: None,
        };
        if !self.once_in(6) {
            if self.once_in(3) {
                draft.failed_connections = self.pick(&[2, 10, 30]);
            }
            draft.faults = self.faults(&draft);
        }
        draft.link.until = self.end_of_harm(&draft);
        draft.patience = patience(&draft, family);
        if lasts(&draft) {
            // Bounds for that follow from the link.
            (draft.link.until, draft.patience) = (None, None);
        }
        draft
    }

    fn link(&mut self) -> LinkDraft {
        let delay = match self.0.below(10) {
            0 => (0, 0),
            1 => (1, 10),
            2 => (500, 500),
            3 => (0, 3000),
            4 | 5 => (10, 800),
            _ => (10, 100),
        };
        // Each evil is there in one run of three.
        let mut percent = |of: &[u8]| if self.once_in(3) { self.pick(of) } else { 0 };
        LinkDraft {
            delay,
            loss: percent(&[1, 5, 20]),
            duplicate: percent(&[2, 20]),
            reorder: percent(&[2, 20]),
            corrupt: percent(&[1, 5]),
            until: None,
        }
    }

    /// What harms messages is a fault like others: it ends with the last of them, or later. Delays stay.
    fn end_of_harm(&mut self, draft: &Draft) -> Option<u64> {
        let least = self.pick(&[10_000, 60_000, 150_000, 600_000]);
        draft.link.harms().then(|| draft.faults.iter().map(|f| f.until.unwrap_or(f.at)).fold(least, u64::max))
    }

    fn faults(&mut self, draft: &Draft) -> Vec<FaultDraft> {
        let (modules, mut faults) = (draft.modules() as u64, Vec::new());
        let most = modules.div_ceil(4).min(4);
        let horizon = self.pick(&[5_000, 20_000, 60_000, 150_000]);
        // A kind is left out in half of the runs.
        let kinds = self.0.below(64);
        for kind in (0..6).filter(|kind| kinds >> kind & 1 == 1) {
            for _ in 0..self.within(1, most) {
                let id = self.0.below(modules) as u32;
                let at = self.within(0, horizon / 10) * 10;
                let until = at + self.pick(&[500, 3_000, 15_000, 60_000, 200_000]);
                let (what, until) = match kind {
                    0 => (Break::Kill(id), None),
                    1 => (Break::Restart(id), None),
                    2 => (Break::Pause(id), Some(until)),
                    3 => (Break::Stick(id), Some(until).filter(|_| !self.once_in(3))),
                    4 => {
                        let side: Vec<u32> = (0..modules as u32).filter(|_| self.once_in(3)).collect();
                        let side = if side.is_empty() { vec![id] } else { side };
                        (Break::Partition(side), Some(until))
                    }
                    _ => match &draft.swarm {
                        SwarmDraft::Cubes(_) => continue,
                        SwarmDraft::Metamodules(m) => {
                            let along = |dice: &mut Dice| dice.0.below(m.side as u64) as i16;
                            let cell = Cell::new(along(self), along(self), self.0.below(4) as i16);
                            (Break::Obstacle(cell), Some(until).filter(|_| !self.once_in(4)))
                        }
                    },
                };
                faults.push(FaultDraft { what, at, until });
            }
        }
        if self.once_in(4) {
            self.storm(modules, &mut faults);
        }
        faults
    }

    /// Many processes stop for longer than a lease, or start again, while there is most to do: what rests
    /// on time, and on what was promised before, is only needed then.
    fn storm(&mut self, modules: u64, faults: &mut Vec<FaultDraft>) {
        let (restarts, lasts) = (self.pick(&[0, 1, 4]), self.pick(&[9_000, 15_000, 55_000]));
        for _ in 0..self.within(4, 12) {
            let (id, at) = (self.0.below(modules) as u32, self.within(0, 3_000) * 10);
            faults.push(match self.0.below(4) < restarts {
                true => FaultDraft { what: Break::Restart(id), at, until: None },
                false => FaultDraft { what: Break::Pause(id), at, until: Some(at + lasts) },
            });
        }
    }

    /// A block that is thick enough to have an inside, which must be filled before it is closed.
    fn thick(&mut self) -> CubeDraft {
        let (modules, sides) = (self.within(29, 36) as usize, self.pick(&[[3, 3, 3], [4, 3, 3], [3, 5, 3]]));
        let start = self.blob(Cell::new(0, 0, 0), modules, true);
        let seed = start[self.0.below(modules as u64) as usize];
        let corner = sides.map(|side| if self.once_in(2) { 0 } else { self.0.below(side) as i16 });
        let mut cells = Vec::new();
        for (x, y) in (0..sides[0] as i16).flat_map(|x| (0..sides[1] as i16).map(move |y| (x, y))) {
            let cell = |z| Cell::new(seed.x + x - corner[0], seed.y + y - corner[1], seed.z + z - corner[2]);
            cells.extend((0..sides[2] as i16).map(cell));
        }
        let goals = vec![CubeGoal { cells, seed, growth: Growth::Solid }];
        CubeDraft { start, goals, connectivity: Connectivity::Forest, co_owners: true }
    }

    fn cubes(&mut self) -> CubeDraft {
        if self.once_in(100) {
            return self.thick();
        }
        let modules = match self.0.below(10) {
            0..=2 => self.within(2, 4),
            3..=7 => self.within(4, 10),
            _ => self.within(8, 24),
        } as usize;
        let flat = self.once_in(2);
        let start = self.blob(Cell::new(0, 0, 0), modules, flat);
        let mut goals: Vec<CubeGoal> = Vec::new();
        for _ in 0..if self.once_in(6) { 2 } else { 1 } {
            // A later goal begins where the one before has left somebody.
            let filled = match goals.last() {
                None => start.clone(),
                Some(goal) => Goal::compile(&goal.cells, goal.seed, goal.growth)
                    .map_or_else(|_| vec![goal.seed], |g| g.cells().collect()),
            };
            let seed = filled[self.0.below(filled.len() as u64) as usize];
            goals.push(self.cube_goal(seed, modules));
        }
        CubeDraft {
            start,
            goals,
            connectivity: self.pick(&[Connectivity::Forest, Connectivity::Forest, Connectivity::Cycles]),
            co_owners: !self.once_in(3),
        }
    }

    fn cube_goal(&mut self, seed: Cell, modules: usize) -> CubeGoal {
        let size = self.within(1 + u64::from(modules > 2), modules as u64) as usize;
        if self.once_in(3) {
            let flat = self.once_in(2);
            return CubeGoal { cells: self.blob(seed, size, flat), seed, growth: Growth::Solid };
        }
        // A box around the seed; scaffolds fill about half of it.
        let growth = self.pick(&[Growth::Scaffold, Growth::Solid]);
        let sides = [0; 3].map(|_| self.within(1, 5) as i16);
        let corner = sides.map(|side| self.0.below(side as u64) as i16);
        let mut cells = Vec::new();
        for x in 0..sides[0] {
            for y in 0..sides[1] {
                let column = (0..sides[2]).map(|z| Cell::new(x, y, z));
                cells.extend(column.map(|c| {
                    Cell::new(seed.x + c.x - corner[0], seed.y + c.y - corner[1], seed.z + c.z - corner[2])
                }));
            }
        }
        CubeGoal { cells, seed, growth }
    }

    /// Connected cells around one.
    fn blob(&mut self, from: Cell, size: usize, flat: bool) -> Vec<Cell> {
        let mut cells = BTreeSet::from([from]);
        let mut list = vec![from];
        // Straight on from the latest cell makes lines, from any cell makes clumps.
        let straight = self.once_in(3);
        let faces = if flat { &Face::ALL[..4] } else { &Face::ALL[..] };
        while list.len() < size {
            let last = straight && !self.once_in(4);
            let at = if last { list[list.len() - 1] } else { self.pick(&list) };
            let next = at.step(self.pick(faces));
            if cells.insert(next) {
                list.push(next);
            }
        }
        cells.into_iter().collect()
    }

    fn metamodules(&mut self) -> MetamoduleDraft {
        let mut goals = Vec::new();
        let side = self.within(7, 13) as i16;
        let mut at = 0;
        for i in 0..if self.once_in(5) { 2 } else { 1 } {
            if i > 0 {
                at += self.within(100, 12_000) * 10;
            }
            goals.push((at, self.metamodule_goal(side)));
        }
        let seeds = goals.iter().map(|(_, g)| g.levels.iter().map(Vec::len).sum::<usize>());
        let count = seeds.max().unwrap_or(0) + self.pick(&[0, 0, 1, 2, 4]);
        let mut draft = MetamoduleDraft {
            kind: self.pick(&Kind::METAMODULES),
            side,
            start: Err(count),
            goals,
            strategy: if self.once_in(3) { self.pick(&Strategy::PUBLISHED) } else { Strategy::Negotiated },
            teller: self.pick(&[Teller::Controller, Teller::Neighbours]),
            relocate: self.once_in(2),
            precedence: None,
            settled_repel: true,
        };
        if draft.strategy != Strategy::Negotiated {
            // The reading of the thesis in half of them, anything else in the others.
            draft.precedence = draft.strategy.precedence();
            if self.once_in(2) {
                let by = self.pick(&PrecedenceBy::ALL);
                let within = self.within(1, 9) as u16;
                draft.precedence = self.pick(&[None, Some(Precedence { within, by })]);
                draft.settled_repel = self.once_in(2);
            }
        }
        draft
    }

    fn metamodule_goal(&mut self, side: i16) -> MetamoduleGoal {
        // Room for the chair, three by four, and one cell around it.
        let (x, y) =
            (self.within(1, side as u64 - 4) as i16, self.within(1, (side as u64 - 5).max(1)) as i16);
        let levels = match self.0.below(8) {
            0 | 1 => box_of_four(x, y),
            2 => chair_of_six(x, y),
            _ => {
                let posts = self.within(1, 3);
                let foot = |dice: &mut Dice| dice.within(1, side as u64 - 2) as i16;
                let post = |dice: &mut Dice| upright(foot(dice), foot(dice));
                if self.once_in(3) {
                    (0..posts).map(|_| vec![post(self)]).collect()
                } else {
                    vec![(0..posts).map(|_| post(self)).collect()]
                }
            }
        };
        MetamoduleGoal { levels, order: self.pick(&SeedOrder::ALL) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smallest_can_always_be_run() {
        for family in [Family::Cube, Family::Metamodule] {
            assert!((0..20).all(|seed| complete(Draft { seed, ..smallest(family) }).is_some()), "{family:?}");
        }
    }

    /// One seed is one scenario, and what is drawn is what is read.
    #[test]
    fn a_seed_decides_on_everything() {
        let mut texts = BTreeSet::new();
        for seed in 0..60 {
            let (draft, plan) = draw(seed, None);
            assert_eq!(draft, draw(seed, None).0);
            assert_eq!((plan.seed, plan.swarm.len()), (seed, draft.modules()));
            let harms = |f: &FaultDraft| !matches!(f.what, Break::Partition(_));
            let events: usize =
                draft.faults.iter().filter(|f| harms(f)).map(|f| 1 + usize::from(f.until.is_some())).sum();
            assert_eq!(plan.schedule.len(), events, "{draft}");
            texts.insert(draft.to_string());
        }
        assert_eq!(texts.len(), 60);
    }

    /// Harm that lasts is drawn, with the bounds that follow from it, and earlier seeds draw none.
    #[test]
    fn harm_may_last() {
        let lasting = |seed: u64| {
            let (draft, plan) = draw(seed, Some(Family::Cube));
            let lasts = draft.link.harms() && draft.link.until.is_none();
            assert!(!lasts || (draft.patience.is_none() && plan.link.harmless_from.is_none()), "{draft}");
            lasts
        };
        assert!((0..200).all(|seed| !lasting(seed)));
        assert!((LASTING_FROM..LASTING_FROM + 200).filter(|seed| lasting(*seed)).count() > 10);
    }
}
