//! Disassembly by AND/OR search: in which order a structure can be taken apart, or a proof that it cannot.
//!
//! A set of items that stand is an OR node: one of its bundles has to leave next. A bundle is an AND node: there must be a
//! way out for it, and what then stands must come apart, too. The search goes depth first, and remembers the sets that
//! failed. The assembly is the reverse (S. Bonardi, EPFL thesis, 2014, B.4).

use std::collections::BTreeMap;

/// A set of at most 64 items, one bit each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Items(pub u64);

impl Items {
    /// The largest number of items.
    pub const MAX: usize = 64;

    /// Returns the set of the first `n` items; of [`Items::MAX`] for a larger `n`.
    pub const fn first(n: usize) -> Items {
        if n >= Items::MAX { Items(u64::MAX) } else { Items((1 << n) - 1) }
    }
    /// Returns the set of one item; the empty set from [`Items::MAX`] on.
    pub const fn one(item: usize) -> Items {
        if item < Items::MAX { Items(1 << item) } else { Items(0) }
    }
    /// Returns true if the item is in the set.
    pub const fn has(self, item: usize) -> bool {
        item < Items::MAX && self.0 >> item & 1 == 1
    }
    /// Returns the items of either set.
    pub const fn with(self, other: Items) -> Items {
        Items(self.0 | other.0)
    }
    /// Returns the items that are not in the other set.
    pub const fn without(self, other: Items) -> Items {
        Items(self.0 & !other.0)
    }
    /// Returns true if all items of the other set are in this one.
    pub const fn holds(self, other: Items) -> bool {
        other.0 & !self.0 == 0
    }
    /// Returns the number of items.
    pub const fn len(self) -> usize {
        self.0.count_ones() as usize
    }
    /// Returns true if there is none.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
    /// Iterates over the items, ascending.
    pub fn iter(self) -> impl Iterator<Item = usize> {
        (0..Items::MAX).filter(move |item| self.has(*item))
    }
}

/// Why a bundle cannot leave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RemovalRefusal<R> {
    /// The reason.
    pub reason: R,
    /// True if it is proved that the bundle cannot leave; false if no way was found.
    pub is_proved: bool,
}

/// A structure that is to be taken apart.
pub trait Removals {
    /// How a bundle leaves.
    type Departure: Clone;
    /// Why a bundle cannot leave.
    type Reason: Clone;

    /// Returns the bundles of these items that may leave at all, in the order of trying. None is empty.
    fn bundles(&self, standing: Items) -> Vec<Items>;
    /// Returns how a bundle of `standing` leaves.
    ///
    /// # Errors
    /// If it cannot, or no way was found.
    fn remove(
        &mut self,
        standing: Items,
        bundle: Items,
    ) -> Result<Self::Departure, RemovalRefusal<Self::Reason>>;
}

/// A bundle that leaves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Removal<W> {
    /// The items that stand before, the bundle included.
    pub standing: Items,
    /// The items that leave.
    pub bundle: Items,
    /// How.
    pub way: W,
}

/// A set from which nothing can leave.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stuck<R> {
    /// The smallest such set that was found.
    pub standing: Items,
    /// Each of its bundles, with the reason.
    pub refusals: Vec<(Items, RemovalRefusal<R>)>,
}

/// The answer of the search.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Disassembly<W, R> {
    /// A sequence of removals after which nothing stands.
    Sequence(Vec<Removal<W>>),
    /// There is none; all sets that can be reached were examined.
    Impossible(Stuck<R>),
    /// None was found, but it is not proved that there is none.
    Undecided(Option<Stuck<R>>),
}

/// An OR node on the path from the root.
struct Node<W> {
    standing: Items,
    bundles: std::vec::IntoIter<Items>,
    /// The removal that leads to the next node.
    leaves: Option<(Items, W)>,
    /// True if all failures below are proved.
    is_proved: bool,
}

/// Takes `whole` apart, and examines at most `limit` bundles for that.
pub fn disassemble<S: Removals>(
    structure: &mut S,
    whole: Items,
    limit: usize,
) -> Disassembly<S::Departure, S::Reason> {
    let node = |structure: &S, standing: Items| Node {
        standing,
        bundles: structure.bundles(standing).into_iter(),
        leaves: None,
        is_proved: true,
    };
    // Sets that failed, and whether that is proved.
    let mut failed: BTreeMap<Items, bool> = BTreeMap::new();
    let mut stuck: Option<Stuck<S::Reason>> = None;
    let mut refusals: Vec<Vec<(Items, RemovalRefusal<S::Reason>)>> = vec![Vec::new()];
    let mut path = vec![node(structure, whole)];
    let mut examined = 0;
    while let Some(at) = path.last_mut() {
        if at.standing.is_empty() {
            path.pop();
            let step = |node: Node<S::Departure>| {
                let (bundle, way) = node.leaves?;
                Some(Removal { standing: node.standing, bundle, way })
            };
            return Disassembly::Sequence(path.into_iter().filter_map(step).collect());
        }
        let Some(bundle) = at.bundles.next() else {
            // Nothing leaves in the end: the node before has to try another bundle.
            let (standing, is_proved) = (at.standing, at.is_proved);
            let (directly, examined_here) = (refusals.pop().unwrap_or_default(), structure.bundles(standing));
            let nothing_leaves = directly.len() == examined_here.len();
            if nothing_leaves && stuck.as_ref().is_none_or(|s| standing.len() < s.standing.len()) {
                stuck = Some(Stuck { standing, refusals: directly });
            }
            failed.insert(standing, is_proved);
            path.pop();
            if let Some(before) = path.last_mut() {
                before.is_proved &= is_proved;
            }
            continue;
        };
        let (standing, rest) = (at.standing, at.standing.without(bundle));
        if let Some(is_proved) = failed.get(&rest) {
            at.is_proved &= is_proved;
            continue;
        }
        if examined == limit {
            return Disassembly::Undecided(stuck);
        }
        examined += 1;
        match structure.remove(standing, bundle) {
            Ok(way) => {
                at.leaves = Some((bundle, way));
                path.push(node(structure, rest));
                refusals.push(Vec::new());
            }
            Err(refusal) => {
                at.is_proved &= refusal.is_proved;
                if let Some(list) = refusals.last_mut() {
                    list.push((bundle, refusal));
                }
            }
        }
    }
    match (failed.get(&whole), stuck) {
        (Some(true), Some(stuck)) => Disassembly::Impossible(stuck),
        (_, stuck) => Disassembly::Undecided(stuck),
    }
}

/// Returns, for each step of the assembly that reverses `sequence`, the steps that must be done before, ascending. Two
/// steps may be done in either order if each bundle can also leave while the other one is in the other state.
pub fn precedence<S: Removals>(structure: &mut S, sequence: &[Removal<S::Departure>]) -> Vec<Vec<usize>> {
    let steps: Vec<(Items, Items)> = sequence.iter().rev().map(|r| (r.standing, r.bundle)).collect();
    let mut after = Vec::with_capacity(steps.len());
    for (j, (standing, bundle)) in steps.iter().enumerate() {
        let must_wait = |i: &usize| {
            let (earlier_standing, earlier) = steps[*i];
            structure.remove(standing.without(earlier), *bundle).is_err()
                || structure.remove(earlier_standing.with(*bundle), earlier).is_err()
        };
        after.push((0..j).filter(must_wait).collect());
    }
    after
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// Items that leave one by one, each after those that lie on it.
    struct Pile {
        on: Vec<Items>,
        proves: bool,
        asked: usize,
    }

    impl Removals for Pile {
        type Departure = ();
        type Reason = usize;

        fn bundles(&self, standing: Items) -> Vec<Items> {
            standing.iter().map(Items::one).collect()
        }
        fn remove(&mut self, standing: Items, bundle: Items) -> Result<(), RemovalRefusal<usize>> {
            self.asked += 1;
            let item = bundle.iter().next().unwrap();
            let below = standing.iter().find(|other| self.on[*other].has(item));
            match below {
                Some(_) if !standing.without(bundle).is_empty() => {
                    Err(RemovalRefusal { reason: item, is_proved: self.proves })
                }
                _ => Ok(()),
            }
        }
    }

    /// `on[i]` are the items that i lies on.
    fn pile(on: &[&[usize]], proves: bool) -> Pile {
        let set = |items: &&[usize]| items.iter().fold(Items::default(), |s, i| s.with(Items::one(*i)));
        Pile { on: on.iter().map(set).collect(), proves, asked: 0 }
    }

    #[test]
    fn a_pile_is_taken_apart_from_above() {
        // 2 lies on 0 and 1, 3 on 2.
        let mut pile = pile(&[&[], &[], &[0, 1], &[2]], true);
        let Disassembly::Sequence(found) = disassemble(&mut pile, Items::first(4), 100) else {
            panic!("it comes apart")
        };
        let order: Vec<usize> = found.iter().map(|r| r.bundle.iter().next().unwrap()).collect();
        assert_eq!(order, [3, 2, 0, 1]);
        assert_eq!(found[1].standing, Items::first(3));
        // In the assembly the two at the bottom are independent of each other.
        let after = precedence(&mut pile, &found);
        assert_eq!(after, [vec![], vec![], vec![0, 1], vec![2]]);
    }

    #[test]
    fn a_ring_cannot_be_taken_apart_and_the_smallest_set_is_named() {
        // 0, 1 and 2 lie on each other, 3 on 0.
        let ring = [&[2][..], &[0], &[1], &[0]];
        let mut proving = pile(&ring, true);
        let Disassembly::Impossible(stuck) = disassemble(&mut proving, Items::first(4), 100) else {
            panic!("it cannot come apart")
        };
        assert_eq!(stuck.standing, Items::first(3));
        let reasons: BTreeSet<usize> = stuck.refusals.iter().map(|(_, r)| r.reason).collect();
        assert_eq!(reasons, BTreeSet::from([0, 1, 2]));
        // Without proofs, or with too little work, it is undecided.
        let undecided = disassemble(&mut pile(&ring, false), Items::first(4), 100);
        assert!(matches!(undecided, Disassembly::Undecided(Some(_))));
        assert!(matches!(disassemble(&mut proving, Items::first(4), 2), Disassembly::Undecided(_)));
    }

    #[test]
    fn failed_sets_are_examined_once() {
        // A ring of three, with five more items that may leave in any order.
        let on: Vec<&[usize]> = vec![&[2], &[0], &[1], &[], &[], &[], &[], &[]];
        let mut pile = pile(&on, true);
        assert!(matches!(disassemble(&mut pile, Items::first(8), 10_000), Disassembly::Impossible(_)));
        // 2^5 sets, each with at most 8 bundles.
        assert!(pile.asked <= 32 * 8, "{}", pile.asked);
    }
}
