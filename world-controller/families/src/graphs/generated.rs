//! Graphs of contacts drawn for exploration, and how they are made smaller.

use super::GraphProtocol;
use super::contacts::Contacts;
use crate::generated::{Dice, Failing, GeneratedSwarm, Smaller};
use metamorph_protocol::lattice::Cell;
use metamorph_scenario::family::Swarm;
use std::fmt;
use std::marker::PhantomData;

/// Largest number of modules that exploration draws.
const DRAWN_MAX: u64 = 40;

/// A drawn graph.
pub struct GraphDraft<P> {
    contacts: Contacts,
    protocol: PhantomData<fn() -> P>,
}

impl<P> Clone for GraphDraft<P> {
    fn clone(&self) -> Self {
        GraphDraft::of(self.contacts.clone())
    }
}

impl<P> fmt::Debug for GraphDraft<P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.contacts.fmt(f)
    }
}

impl<P> GraphDraft<P> {
    fn of(contacts: Contacts) -> GraphDraft<P> {
        GraphDraft { contacts, protocol: PhantomData }
    }
    /// Returns a graph of one module.
    pub fn smallest() -> GraphDraft<P> {
        GraphDraft::of(Contacts::Line(1))
    }
}

impl<P: GraphProtocol> GraphDraft<P> {
    /// Draws a graph that fits the ports of the agents.
    pub fn draw(dice: &mut Dice) -> GraphDraft<P> {
        let sides = |dice: &mut Dice| [dice.within(1, 6), dice.within(1, 6), 1];
        let drawn = match dice.within(0, 4) {
            0 => Contacts::Ring(dice.within(3, DRAWN_MAX)),
            1 => Contacts::Line(dice.within(1, DRAWN_MAX)),
            2 => Contacts::Grid { sides: sides(dice), is_torus: false },
            3 => Contacts::Grid { sides: sides(dice), is_torus: true },
            _ => Contacts::Random { modules: dice.within(1, DRAWN_MAX), degree: dice.within(2, 5) },
        };
        let fits = drawn.graph(P::PORTS, 0).is_ok();
        if fits { GraphDraft::of(drawn) } else { GraphDraft::smallest() }
    }
}

fn count(contacts: &Contacts) -> u64 {
    match contacts {
        Contacts::Ring(modules) | Contacts::Line(modules) | Contacts::Random { modules, .. } => *modules,
        Contacts::Grid { sides, .. } => sides.iter().product(),
        Contacts::Pairs(pairs) => pairs.iter().flatten().max().map_or(1, |last| u64::from(*last) + 1),
    }
}

/// Returns graphs with fewer modules or contacts, the smallest first.
fn smaller(contacts: &Contacts) -> Vec<Contacts> {
    let fewer = |modules: u64| [modules / 2, modules.saturating_sub(1)];
    match *contacts {
        Contacts::Ring(modules) => {
            let shorter = fewer(modules).into_iter().filter(|fewer| *fewer >= 3).map(Contacts::Ring);
            shorter.chain([Contacts::Line(modules)]).collect()
        }
        Contacts::Line(modules) => fewer(modules).into_iter().map(Contacts::Line).collect(),
        Contacts::Grid { sides: sides @ [x, y, z], is_torus } => {
            let narrower = (0..3).filter(|axis| sides[*axis] > 1).map(|axis| {
                let mut sides = sides;
                sides[axis] -= 1;
                Contacts::Grid { sides, is_torus }
            });
            let flat = is_torus.then_some(Contacts::Grid { sides, is_torus: false });
            narrower.chain(flat).chain([Contacts::Line(x * y * z)]).collect()
        }
        Contacts::Random { modules, degree } => {
            let fewer = fewer(modules).into_iter().map(|modules| Contacts::Random { modules, degree });
            let sparser = (degree > 2).then(|| Contacts::Random { modules, degree: degree - 1 });
            fewer.chain(sparser).chain([Contacts::Line(modules)]).collect()
        }
        Contacts::Pairs(_) => Vec::new(),
    }
}

impl<P: GraphProtocol> GeneratedSwarm for GraphDraft<P> {
    fn modules(&self) -> usize {
        count(&self.contacts) as usize
    }
    fn goal_cells(&self) -> usize {
        self.modules()
    }
    fn summary(&self) -> String {
        format!("{} modules {}", count(&self.contacts), self.contacts)
    }
    fn write(&self, f: &mut fmt::Formatter<'_>, _: Failing) -> fmt::Result {
        let graph = match &self.contacts {
            Contacts::Ring(modules) => format!("ring = {modules}"),
            Contacts::Line(modules) => format!("line = {modules}"),
            Contacts::Grid { sides, is_torus: false } => format!("grid = {sides:?}"),
            Contacts::Grid { sides, is_torus: true } => format!("torus = {sides:?}"),
            Contacts::Random { modules, degree } => {
                format!("random = {{ modules = {modules}, degree = {degree} }}")
            }
            Contacts::Pairs(pairs) => format!("contacts = {pairs:?}"),
        };
        writeln!(f, "family = \"{}\"\ngraph = {{ {graph} }}", P::NAME)
    }
    fn settle(&mut self, _: &Swarm) -> bool {
        false
    }
    fn smaller(&self) -> Vec<Smaller> {
        let modules = self.modules();
        let possible = smaller(&self.contacts).into_iter().filter(|contacts| count(contacts) > 0);
        possible
            .map(|contacts| {
                let gone = count(&contacts) as usize..modules;
                Smaller { swarm: Box::new(GraphDraft::<P>::of(contacts)), gone, replaced: false }
            })
            .collect()
    }
    fn obstacle(&self, _: &mut Dice) -> Option<Cell> {
        None
    }
}
