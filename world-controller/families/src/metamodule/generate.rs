//! Generates random swarms of metamodules and their goals.

use super::generated::{GeneratedElement, GeneratedMetamodules, MetamoduleGoal};
use crate::generated::Dice;
use metamorph_protocol::lattice::{Cell, Face};
use metamorph_protocol::metamodule::blueprint::{Seed, SeedOrder, box_of_four, chair_of_six};
use metamorph_protocol::metamodule::params::{Precedence, PrecedenceBy, SeedAuthority, Strategy};
use metamorph_protocol::roombots::Kind;

/// Returns one metamodule with a minimal goal.
pub fn smallest() -> GeneratedMetamodules {
    GeneratedMetamodules {
        kind: Kind::Srs,
        side: 9,
        start: Err(1),
        goals: vec![(0, MetamoduleGoal { levels: vec![vec![upright(4, 4)]], order: SeedOrder::Circular })],
        strategy: Strategy::Negotiated,
        seed_authority: SeedAuthority::Controller,
        relocate: false,
        precedence: None,
        settled_repel: true,
        element: None,
    }
}

/// Returns the bounds for a standstill and for moves without progress, in seconds. A metamodule that is stuck
/// is so early, and longer runs are slow. `delay` is the longest, in milliseconds.
pub fn patience(delay: u64) -> Option<(u64, u64)> {
    Some(if delay < 1_000 { (120, 1_000) } else { (400, 2_000) })
}

fn upright(x: i16, y: i16) -> Seed {
    Seed { foot: (x, y), directions: [Face::Up; 3] }
}

impl Dice {
    /// Draws a swarm of metamodules and its goals.
    pub fn metamodules(&mut self) -> GeneratedMetamodules {
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
        let mut draft = GeneratedMetamodules {
            kind: self.pick(&Kind::METAMODULES),
            side,
            start: Err(count),
            goals,
            strategy: if self.once_in(3) { self.pick(&Strategy::PUBLISHED) } else { Strategy::Negotiated },
            seed_authority: self.pick(&[SeedAuthority::Controller, SeedAuthority::Neighbours]),
            relocate: self.once_in(2),
            precedence: None,
            settled_repel: true,
            element: None,
        };
        // Drawn apart, so that everything else of a seed stays as it was before there was this strategy.
        if draft.strategy == Strategy::Negotiated && self.0.clone().below(4) == 0 {
            draft.strategy = Strategy::Planned;
        }
        if draft.strategy.is_published() {
            // The reading of the thesis in half of the runs, random values in the others.
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

    /// Draws a swarm of metamodules that hold an element in the air on the heads of upright ones.
    pub fn metamodules_with_element(&mut self) -> GeneratedMetamodules {
        // Where the upright ones stand below cell (0, 0, 0), and the sides of the element.
        let (shape, feet, sides): (_, &[(i16, i16)], _) = self.pick(&[
            ("cube", &[(0, 0)][..], (1, 1)),
            ("bar3", &[(0, 0), (2, 0)][..], (3, 1)),
            ("plate3x3", &[(0, 0), (2, 0), (2, 2), (0, 2)][..], (3, 3)),
        ]);
        let side = self.within(11, 14) as i16;
        let mut place = |reach: (i16, i16)| {
            let mut along = |reach: i16| self.within(1, (side - 1 - reach) as u64) as i16;
            (along(reach.0), along(reach.1))
        };
        let (goal, mut start) = (place(sides), place(sides));
        if (goal.0 + goal.1 + start.0 + start.1) % 2 != 0 {
            // A goal of the other colour is refused.
            start.0 -= 1;
        }
        let posts: Vec<Seed> = feet.iter().map(|(x, y)| upright(goal.0 + x, goal.1 + y)).collect();
        let count = posts.len() + self.pick(&[0, 1, 1, 2]);
        GeneratedMetamodules {
            kind: self.pick(&Kind::METAMODULES),
            side,
            start: Err(count),
            goals: vec![(0, MetamoduleGoal { levels: vec![posts], order: SeedOrder::Circular })],
            strategy: Strategy::Planned,
            seed_authority: SeedAuthority::Controller,
            relocate: false,
            precedence: None,
            settled_repel: true,
            element: Some(GeneratedElement {
                shape,
                grams: self.pick(&[100, 250, 500]),
                at: Cell::new(start.0, start.1, 0),
                to: Cell::new(goal.0, goal.1, 4),
            }),
        }
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
