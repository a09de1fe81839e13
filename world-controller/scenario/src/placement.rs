//! Homes by a cut of the contacts at the start: recursive bisection, so that few messages cross between hosts. Deterministic
//! on every machine. Not here: how many modules each host gets.

use metamorph_core::ids::{HostId, ModuleId};
use std::collections::{BTreeSet, VecDeque};
use std::ops::Range;

/// Smoothing steps of the vector by which a part is halved.
const STEPS: usize = 400;
/// Largest number of passes of improvement after each bisection.
const PASSES_MAX: usize = 8;
/// Number of exchanges in a row that make a cut worse before a pass ends.
const WORSENING_MAX: usize = 64;

/// Returns the home of each module: host i gets `sizes[i]` of them, which add up to the number of modules.
pub fn cut(contacts: &[(ModuleId, ModuleId)], sizes: &[usize]) -> Vec<HostId> {
    let modules = sizes.iter().sum();
    let mut neighbours = vec![Vec::new(); modules];
    for (a, b) in contacts {
        neighbours[a.index()].push(b.index());
        neighbours[b.index()].push(a.index());
    }
    let mut graph = Graph { neighbours, home: vec![0; modules] };
    graph.divide((0..modules).collect(), 0..sizes.len(), sizes);
    // Invariant: there are fewer than 2^16 hosts.
    graph.home.into_iter().map(|home| HostId(home as u16)).collect()
}

struct Graph {
    neighbours: Vec<Vec<usize>>,
    /// The first of the hosts that each module is divided among.
    home: Vec<usize>,
}

impl Graph {
    /// Divides modules among a range of hosts.
    fn divide(&mut self, part: Vec<usize>, hosts: Range<usize>, sizes: &[usize]) {
        if hosts.len() < 2 {
            return;
        }
        let middle = hosts.start + hosts.len() / 2;
        let first: usize = sizes[hosts.start..middle].iter().sum();
        let smoothed = self.along_the_longer_side(&part);
        // The numbers of modules run along the start, so that blocks of them are slices.
        let candidates = [part.clone(), smoothed].map(|order| self.improved(&order, first));
        let best = candidates.into_iter().min_by_key(|(crossing, _)| *crossing);
        // Invariant: there are two candidates.
        let Some((_, near)) = best else { return };
        let (near, far): (Vec<usize>, Vec<usize>) =
            part.into_iter().partition(|module| near.contains(module));
        far.iter().for_each(|module| self.home[*module] = middle);
        self.divide(near, hosts.start..middle, sizes);
        self.divide(far, middle..hosts.end, sizes);
    }

    /// Returns the neighbours of a module within its part.
    fn within(&self, module: usize) -> impl Iterator<Item = usize> {
        let home = self.home[module];
        self.neighbours[module].iter().copied().filter(move |other| self.home[*other] == home)
    }

    /// Returns the modules of a part along its longer side: distances from a module at the edge, smoothed, which leaves
    /// the slowest oscillation of the graph.
    fn along_the_longer_side(&self, part: &[usize]) -> Vec<usize> {
        let far = |from| self.distances(part, from);
        let edge = far(part[0]).into_iter().max_by_key(|(module, d)| (*d, *module)).map_or(part[0], |m| m.0);
        let mut value = vec![0.0; self.home.len()];
        for (module, distance) in far(edge) {
            value[module] = f64::from(distance);
        }
        let degree = part.iter().map(|module| self.within(*module).count()).max().unwrap_or(0).max(1) as f64;
        let mut next = value.clone();
        for _ in 0..STEPS {
            let mean = part.iter().map(|module| value[*module]).sum::<f64>() / part.len() as f64;
            let mut largest = 0.0_f64;
            for module in part {
                let own = value[*module];
                let pull: f64 = self.within(*module).map(|other| value[other] - own).sum();
                next[*module] = own - mean + pull / (2.0 * degree);
                largest = largest.max(next[*module].abs());
            }
            if largest < f64::MIN_POSITIVE {
                break;
            }
            part.iter().for_each(|module| value[*module] = next[*module] / largest);
        }
        let mut order = part.to_vec();
        order.sort_by(|a, b| value[*a].total_cmp(&value[*b]).then(a.cmp(b)));
        order
    }

    /// Returns the modules of a part with their distances from one of them; unconnected ones come last.
    fn distances(&self, part: &[usize], from: usize) -> Vec<(usize, u32)> {
        let mut seen: BTreeSet<usize> = BTreeSet::from([from]);
        let (mut found, mut queue) = (Vec::new(), VecDeque::from([(from, 0)]));
        while let Some((module, distance)) = queue.pop_front() {
            found.push((module, distance));
            queue.extend(
                self.within(module).filter(|other| seen.insert(*other)).map(|other| (other, distance + 1)),
            );
        }
        let last = found.last().map_or(0, |(_, distance)| *distance);
        let apart = part.iter().filter(|module| !seen.contains(module)).map(|module| (*module, last + 1));
        found.extend(apart.collect::<Vec<_>>());
        found
    }

    /// Halves a part after its first modules in some order, and improves that by exchanges (Kernighan and Lin, 1970).
    /// Returns the number of contacts that cross, and the first half.
    fn improved(&self, order: &[usize], first: usize) -> (u64, BTreeSet<usize>) {
        let mut near: Vec<bool> = vec![false; self.home.len()];
        order[..first].iter().for_each(|module| near[*module] = true);
        for _ in 0..PASSES_MAX {
            if self.pass(order, &mut near) == 0 {
                break;
            }
        }
        let crosses =
            |module: &usize| self.within(*module).filter(|o| near[*o] != near[*module]).count() as u64;
        let crossing = order.iter().map(crosses).sum::<u64>() / 2;
        (crossing, order.iter().copied().filter(|module| near[*module]).collect())
    }

    /// Returns the number of crossing contacts that moving a module to the other half saves.
    fn gain(&self, module: usize, near: &[bool]) -> i64 {
        self.within(module).map(|other| if near[other] == near[module] { -1 } else { 1 }).sum()
    }

    /// Exchanges modules in pairs, each once, and keeps the best state on the way. Returns what it has saved.
    fn pass(&self, part: &[usize], near: &mut [bool]) -> i64 {
        let mut sides = [BTreeSet::new(), BTreeSet::new()];
        for module in part {
            sides[usize::from(near[*module])].insert((self.gain(*module, near), *module));
        }
        let (mut sum, mut best, mut moved, mut kept) = (0, 0, Vec::new(), 0);
        while let (Some(a), Some(b)) = (sides[0].last().copied(), sides[1].last().copied()) {
            // The exchange of neighbours saves two less than each alone, so the gain of the second is computed again.
            for module in [a.1, b.1] {
                let gain = self.gain(module, near);
                sides[usize::from(near[module])].remove(&(gain, module));
                for other in self.within(module).collect::<Vec<_>>() {
                    let before = (self.gain(other, near), other);
                    let side = &mut sides[usize::from(near[other])];
                    if side.remove(&before) {
                        let change = if near[other] == near[module] { 2 } else { -2 };
                        side.insert((before.0 + change, other));
                    }
                }
                near[module] = !near[module];
                sum += gain;
                moved.push(module);
            }
            if sum > best {
                (best, kept) = (sum, moved.len());
            } else if moved.len() - kept > 2 * WORSENING_MAX {
                break;
            }
        }
        moved[kept..].iter().for_each(|module| near[*module] = !near[*module]);
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The contacts of a slab of cubes, numbered along z, then y, then x.
    fn slab(x: u32, y: u32, z: u32) -> Vec<(ModuleId, ModuleId)> {
        let id = |i: u32, j: u32, k: u32| ModuleId((i * y + j) * z + k);
        let mut contacts = Vec::new();
        for i in 0..x {
            for j in 0..y {
                for k in 0..z {
                    let ahead = [(i + 1, j, k), (i, j + 1, k), (i, j, k + 1)];
                    let inside = ahead.into_iter().filter(|(a, b, c)| *a < x && *b < y && *c < z);
                    contacts.extend(inside.map(|(a, b, c)| (id(i, j, k), id(a, b, c))));
                }
            }
        }
        contacts
    }

    fn crossing(contacts: &[(ModuleId, ModuleId)], homes: &[HostId]) -> usize {
        contacts.iter().filter(|(a, b)| homes[a.index()] != homes[b.index()]).count()
    }

    #[test]
    fn a_slab_on_four_hosts_becomes_two_by_two_tiles() {
        let contacts = slab(20, 20, 2);
        let homes = cut(&contacts, &[200; 4]);
        for host in 0..4 {
            assert_eq!(homes.iter().filter(|home| **home == HostId(host)).count(), 200);
        }
        let blocks: Vec<HostId> = (0..800_u16).map(|i| HostId(i / 200)).collect();
        // Two straight cuts of 20 by 2; three with blocks.
        assert_eq!((crossing(&contacts, &homes), crossing(&contacts, &blocks)), (80, 120));
        assert_eq!(homes, cut(&contacts, &[200; 4]));
    }

    #[test]
    fn sizes_are_kept_and_contacts_may_be_missing() {
        let homes = cut(&slab(9, 5, 1), &[7, 1, 30, 7]);
        for (host, size) in [7, 1, 30, 7].into_iter().enumerate() {
            assert_eq!(homes.iter().filter(|home| home.index() == host).count(), size);
        }
        let apart = cut(&[], &[2, 3]);
        assert_eq!(apart, [0, 0, 1, 1, 1].map(HostId));
    }
}
