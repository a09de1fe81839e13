//! Which modules touch each other, by which ports, and where they are drawn: rings, lines, grids, tori, random graphs, lists of
//! contacts.

use metamorph_core::ids::{ModuleId, Port, PortSet};
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::rng::Rng;
use std::collections::{BTreeSet, VecDeque};
use thiserror::Error;

/// Distance in cells between modules that touch each other in a drawing, so that their contact can be seen.
const SPACING: i16 = 2;
/// Largest number of modules: a line of them in a drawing stays within [`Cell::LIMIT`].
pub const MODULES_MAX: usize = (Cell::LIMIT / SPACING) as usize + 1;

/// One end of a contact.
type End = (ModuleId, Port);

/// Modules that do not move, and their contacts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ContactGraph {
    cells: Vec<Cell>,
    contacts: Vec<[End; 2]>,
}

/// Why modules cannot touch each other so.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum GraphError {
    /// There are too few or too many modules.
    #[error("a graph of {0} modules; it has from {1} to {MODULES_MAX}")]
    Modules(u64, usize),
    /// A module touches itself.
    #[error("module {0} touches itself")]
    Loop(u32),
    /// Two modules touch each other twice.
    #[error("modules {0} and {1} touch each other twice")]
    Twice(u32, u32),
    /// A module has more contacts than ports.
    #[error("module {0} has {1} contacts, and modules of this protocol have {2} ports")]
    Ports(u32, usize, usize),
}

fn counted(modules: u64, least: usize) -> Result<u32, GraphError> {
    let fits = (least as u64..=MODULES_MAX as u64).contains(&modules);
    if fits { Ok(modules as u32) } else { Err(GraphError::Modules(modules, least)) }
}

fn on_line(modules: u32) -> impl Iterator<Item = [End; 2]> {
    (1..modules).map(|i| [(ModuleId(i - 1), Port(0)), (ModuleId(i), Port(1))])
}

/// Returns cells on a circle whose neighbours are at least [`SPACING`] apart.
fn circle(modules: u32) -> Vec<Cell> {
    let turn = std::f64::consts::TAU / f64::from(modules.max(1));
    let radius = f64::from(SPACING) / (2.0 * libm::sin(turn / 2.0)).max(f64::EPSILON);
    let radius = if modules < 3 { f64::from(SPACING) / 2.0 } else { radius };
    let at = |i: u32| {
        // The same on every machine.
        let (sin, cos) = libm::sincos(f64::from(i) * turn);
        Cell::new((radius * cos).round() as i16, (radius * sin).round() as i16, 0)
    };
    (0..modules).map(at).collect()
}

impl ContactGraph {
    /// Returns a ring of three or more modules. Port 0 leads to the next one, port 1 to the one before.
    ///
    /// # Errors
    /// If there are too few or too many.
    pub fn ring(modules: u64) -> Result<ContactGraph, GraphError> {
        let modules = counted(modules, 3)?;
        let closing = [(ModuleId(modules - 1), Port(0)), (ModuleId(0), Port(1))];
        Ok(ContactGraph { cells: circle(modules), contacts: on_line(modules).chain([closing]).collect() })
    }

    /// Returns a line of modules. Port 0 leads to the next one, port 1 to the one before.
    ///
    /// # Errors
    /// If there are none or too many.
    pub fn line(modules: u64) -> Result<ContactGraph, GraphError> {
        let modules = counted(modules, 1)?;
        let cells = (0..modules as i16).map(|x| Cell::new(x * SPACING, 0, 0)).collect();
        Ok(ContactGraph { cells, contacts: on_line(modules).collect() })
    }

    /// Returns a rectangle or a box of modules, numbered along z, then y, then x. Ports are faces: 0 east (+x), 1 west, 2 north
    /// (+y), 3 south, 4 up, 5 down. If it is a torus, modules on opposite sides touch each other, too, if there are three or more
    /// in a row.
    ///
    /// # Errors
    /// If there are none or too many.
    pub fn grid(sides: [u64; 3], is_torus: bool) -> Result<ContactGraph, GraphError> {
        let modules = sides.iter().fold(1u64, |all, side| all.saturating_mul(*side));
        counted(modules, 1)?;
        let [x, y, z] = sides;
        let id = |[i, j, k]: [u64; 3]| ModuleId(((i * y + j) * z + k) as u32);
        let (mut cells, mut contacts) = (Vec::new(), Vec::new());
        for (i, j, k) in (0..x).flat_map(|i| (0..y).flat_map(move |j| (0..z).map(move |k| (i, j, k)))) {
            cells.push(Cell::new(i as i16 * SPACING, j as i16 * SPACING, k as i16 * SPACING));
            for (axis, towards) in [Face::East, Face::North, Face::Up].into_iter().enumerate() {
                let mut next = [i, j, k];
                next[axis] = (next[axis] + 1) % sides[axis];
                if next[axis] != 0 || is_torus && sides[axis] > 2 {
                    let ports = [towards, towards.opposite()].map(|face| Port(face as u8));
                    contacts.push([(id([i, j, k]), ports[0]), (id(next), ports[1])]);
                }
            }
        }
        Ok(ContactGraph { cells, contacts })
    }

    /// Returns a connected random graph with `degree` contacts for each module on average: a random tree and further contacts,
    /// each between two modules with a free port that do not touch each other. A tree has almost two; with few free ports there
    /// may be fewer contacts than asked for.
    ///
    /// # Errors
    /// If there are none or too many modules, or more than two with fewer than two ports each.
    pub fn random(modules: u64, degree: u64, ports: usize, seed: u64) -> Result<ContactGraph, GraphError> {
        let modules = counted(modules, 1)?;
        let mut rng = Rng::named(seed, "contacts", 0);
        let ports = ports.min(PortSet::CAPACITY);
        let mut degrees = vec![0usize; modules as usize];
        let mut found = BTreeSet::new();
        let mut connect = |a: u32, b: u32, degrees: &mut Vec<usize>| {
            let pair = (a.min(b), a.max(b));
            let is_free = |i: u32| degrees[i as usize] < ports;
            if a != b && is_free(a) && is_free(b) && found.insert(pair) {
                degrees[a as usize] += 1;
                degrees[b as usize] += 1;
                return true;
            }
            false
        };
        for i in 1..modules {
            let start = rng.below(i.into()) as u32;
            let mut others = (0..i).map(|offset| (start + offset) % i);
            // With two ports each, one of a tree always has a free one.
            if !others.any(|other| connect(other, i, &mut degrees)) {
                return Err(GraphError::Ports(start, ports + 1, ports));
            }
        }
        // No module has more contacts than ports.
        let wanted = u64::from(modules) * degree.min(ports as u64) / 2;
        // Most pairs are free unless the graph is almost complete.
        let mut tries = 10 * wanted;
        let mut contacts = u64::from(modules.saturating_sub(1));
        while contacts < wanted && tries > 0 {
            tries -= 1;
            let [a, b] = [(); 2].map(|()| rng.below(modules.into()) as u32);
            contacts += u64::from(connect(a, b, &mut degrees));
        }
        ContactGraph::of_contacts(found.into_iter().map(|(a, b)| [a, b]), ports)
    }

    /// Returns the graph with these contacts. Each takes the next free port at either end; the largest number decides how many
    /// modules there are.
    ///
    /// # Errors
    /// If there are too many modules, one touches itself or another twice, or has more contacts than ports.
    pub fn of_contacts(
        pairs: impl IntoIterator<Item = [u32; 2]>,
        ports: usize,
    ) -> Result<ContactGraph, GraphError> {
        let (mut contacts, mut next, mut seen) = (Vec::new(), Vec::<usize>::new(), BTreeSet::new());
        for pair @ [a, b] in pairs {
            if a == b {
                return Err(GraphError::Loop(a));
            }
            if !seen.insert((a.min(b), a.max(b))) {
                return Err(GraphError::Twice(a, b));
            }
            counted(u64::from(a.max(b)) + 1, 1)?;
            next.resize(next.len().max(a.max(b) as usize + 1), 0);
            contacts.push(pair.map(|id| {
                let port = &mut next[id as usize];
                *port += 1;
                (ModuleId(id), Port((*port - 1).min(u8::MAX.into()) as u8))
            }));
        }
        let modules = next.len().max(1) as u32;
        let graph = ContactGraph { cells: circle(modules), contacts };
        graph.fits(ports).map(|()| graph)
    }

    /// Checks that modules with this number of ports can have these contacts.
    ///
    /// # Errors
    /// If one would need more.
    pub fn fits(&self, ports: usize) -> Result<(), GraphError> {
        let widest = self.contacts.iter().flatten().max_by_key(|(_, port)| port.0);
        match widest {
            Some((id, port)) if port.index() >= ports => {
                let degree = self.contacts.iter().flatten().filter(|(end, _)| end == id).count();
                Err(GraphError::Ports(id.0, degree.max(port.index() + 1), ports))
            }
            _ => Ok(()),
        }
    }

    /// Returns where modules are drawn, by number.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }
    /// Returns all contacts, each with both ends.
    pub fn contacts(&self) -> &[[(ModuleId, Port); 2]] {
        &self.contacts
    }

    /// Returns the modules at both ends of each contact.
    pub fn pairs(&self) -> Vec<(ModuleId, ModuleId)> {
        self.contacts.iter().map(|[(a, _), (b, _)]| (*a, *b)).collect()
    }

    /// Returns the neighbours of each module.
    pub fn neighbours(&self) -> Vec<Vec<ModuleId>> {
        let mut neighbours = vec![Vec::new(); self.cells.len()];
        for (a, b) in self.pairs() {
            neighbours[a.index()].push(b);
            neighbours[b.index()].push(a);
        }
        neighbours
    }

    /// Returns the number of contacts on the way from the first of these modules to the one farthest from it, over those modules
    /// alone; `None` if not all can be reached, and 0 if there are none.
    pub fn reach(&self, has: impl Fn(ModuleId) -> bool) -> Option<u64> {
        let neighbours = self.neighbours();
        let all = || (0..self.cells.len() as u32).map(ModuleId).filter(|id| has(*id));
        let mut distance: Vec<Option<u64>> = vec![None; self.cells.len()];
        let mut queue = VecDeque::from_iter(all().next());
        queue.iter().for_each(|id| distance[id.index()] = Some(0));
        while let Some(id) = queue.pop_front() {
            let next = distance[id.index()].map(|steps| steps + 1);
            for neighbour in neighbours[id.index()].iter().filter(|neighbour| has(**neighbour)) {
                if distance[neighbour.index()].is_none() {
                    distance[neighbour.index()] = next;
                    queue.push_back(*neighbour);
                }
            }
        }
        all().map(|id| distance[id.index()]).try_fold(0, |far, steps| Some(far.max(steps?)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn degrees(graph: &ContactGraph) -> Vec<usize> {
        graph.neighbours().iter().map(Vec::len).collect()
    }

    #[test]
    fn shapes_have_their_contacts() {
        let ring = ContactGraph::ring(50).expect("50 are enough");
        assert_eq!((ring.contacts().len(), ring.reach(|_| true)), (50, Some(25)));
        assert!(degrees(&ring).iter().all(|degree| *degree == 2));
        assert_eq!(ring.reach(|id| ![5, 30].contains(&id.0)), None);
        assert_eq!(ContactGraph::line(4).expect("4 are enough").reach(|_| true), Some(3));
        let grid = ContactGraph::grid([4, 3, 1], false).expect("12 are enough");
        assert_eq!((grid.contacts().len(), grid.reach(|_| true)), (17, Some(5)));
        let torus = ContactGraph::grid([4, 3, 1], true).expect("12 are enough");
        assert_eq!((torus.contacts().len(), degrees(&torus)), (24, vec![4; 12]));
        // Two in a row touch once.
        assert_eq!(ContactGraph::grid([2, 2, 1], true), ContactGraph::grid([2, 2, 1], false));
    }

    #[test]
    fn random_graphs_are_connected_and_repeat() {
        for seed in 0..20 {
            for (modules, degree, ports) in [(1, 3, 4), (2, 4, 2), (40, 4, 6), (40, 9, 4), (30, 0, 2)] {
                let draw = || ContactGraph::random(modules, degree, ports, seed);
                let graph = draw().unwrap_or_else(|error| panic!("seed {seed}: {error}"));
                assert!(
                    graph.reach(|_| true).is_some() && graph.fits(ports).is_ok(),
                    "seed {seed}: {graph:?}"
                );
                assert_eq!(Ok(graph), draw());
            }
        }
        let graph = ContactGraph::random(40, 4, 6, 1).expect("40 are enough");
        assert_eq!(graph.contacts().len(), 80);
    }

    /// Two modules in one cell could not be told apart in a drawing.
    #[test]
    fn modules_are_drawn_apart() {
        for modules in (3..300).chain([5_000, MODULES_MAX as u64]) {
            let ring = ContactGraph::ring(modules).expect("there are enough");
            let cells: BTreeSet<Cell> = ring.cells().iter().copied().collect();
            assert_eq!(cells.len() as u64, modules);
        }
    }

    /// The cells of the largest graphs are such that messages can name them.
    #[test]
    fn the_largest_graphs_are_in_range() {
        let most = MODULES_MAX as u64;
        let line = ContactGraph::line(most).expect("it is not too long");
        let grid = ContactGraph::grid([1, most, 1], true).expect("it is not too long");
        let ring = ContactGraph::ring(most).expect("it is not too long");
        assert!([line, grid, ring].iter().all(|graph| graph.cells().iter().all(|cell| cell.in_range())));
        assert_eq!(ContactGraph::line(most + 1), Err(GraphError::Modules(most + 1, 1)));
    }

    /// However many contacts are asked for, there are at most as many as ports, and the work is bounded.
    #[test]
    fn degrees_are_bounded_by_the_ports() {
        let graph = ContactGraph::random(30, u64::MAX, 4, 1).expect("30 are enough");
        assert!(
            degrees(&graph).iter().all(|degree| *degree <= 4) && graph.contacts().len() > 50,
            "{graph:?}"
        );
        assert_eq!(ContactGraph::random(2, 1, 1, 1).map(|graph| graph.contacts().len()), Ok(1));
        assert!(matches!(ContactGraph::random(3, 1, 1, 1), Err(GraphError::Ports(_, 2, 1))));
    }

    #[test]
    fn impossible_graphs_are_refused() {
        assert_eq!(ContactGraph::ring(2), Err(GraphError::Modules(2, 3)));
        assert_eq!(ContactGraph::line(0), Err(GraphError::Modules(0, 1)));
        assert_eq!(ContactGraph::grid([u64::MAX, 2, 1], false), Err(GraphError::Modules(u64::MAX, 1)));
        assert_eq!(ContactGraph::of_contacts([[1, 1]], 4), Err(GraphError::Loop(1)));
        assert_eq!(ContactGraph::of_contacts([[1, 0], [0, 1]], 4), Err(GraphError::Twice(0, 1)));
        let star = (1..=5).map(|i| [0, i]);
        assert_eq!(ContactGraph::of_contacts(star, 4), Err(GraphError::Ports(0, 5, 4)));
        assert_eq!(ContactGraph::of_contacts([[0, 10_000]], 4), Err(GraphError::Modules(10_001, 1)));
    }
}
