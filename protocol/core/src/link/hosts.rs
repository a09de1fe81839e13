//! A swarm over several hosts, as the simulated link models it: the home of each module, what the links between hosts do,
//! and how far the clocks of hosts differ.
//!
//! Bodies, director and world are on [`HostId::CONTROLLER`]. What passes between them and the agents of another host
//! uses a stream: delayed, in order, without loss, and held back while the link between the two hosts is cut.

use super::{LinkModel, Partition};
use crate::ids::{HostId, ModuleId};
use crate::rng::Rng;
use crate::time::{Span, Time};
use alloc::collections::BTreeSet;
use alloc::vec;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// How far the clock of a host is ahead of the controller's, in nanoseconds; negative if it is behind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ClockOffset(pub i64);

impl ClockOffset {
    /// Returns what the host's clock shows at time `at` of the controller's clock. A clock that is behind shows zero
    /// until it starts.
    pub fn local(self, at: Time) -> Time {
        if at == Time::NEVER { at } else { Time(at.0.saturating_add_signed(self.0)) }
    }

    /// Returns the time of the controller's clock at which the host's clock shows `at`.
    pub fn global(self, at: Time) -> Time {
        ClockOffset(self.0.saturating_neg()).local(at)
    }
}

/// The consequence of the loss of a host for its modules.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Lost {
    /// They have crashed.
    #[default]
    Crash,
    /// They are started on other hosts, without their memory.
    Elsewhere {
        /// How long nothing is heard of a host before it counts as lost (scenario time), on the simulated link.
        fence: Span,
    },
}

/// An event of a host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum HostChange {
    /// It is down: no process can be started there.
    Down,
    /// It counts as lost: its modules are at home on other hosts from now on.
    Lost,
    /// It has come back: processes can be started there.
    Back,
}

/// Why a set of hosts is invalid.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum HostsError {
    /// A swarm has at least one host.
    #[error("there is no host")]
    None,
    /// A module has a home that does not exist.
    #[error("module {0} is at home on {1}, which is not one of the hosts")]
    Home(ModuleId, HostId),
    /// The number of links is not that of the pairs of hosts.
    #[error("{found} links are given for {pairs} pairs of hosts")]
    Links {
        /// The number of pairs of hosts.
        pairs: usize,
        /// The number of links given.
        found: usize,
    },
    /// The controller's clock differs from itself.
    #[error("the clock of {} is the controller's and has no offset", HostId::CONTROLLER)]
    Reference,
}

/// The hosts of a swarm.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hosts {
    homes: Vec<HostId>,
    clocks: Vec<ClockOffset>,
    /// The link of each pair of hosts, in the order of [`Hosts::pairs`].
    links: Vec<LinkModel>,
    lost: Lost,
    /// The hosts that are down at present; a run starts without any.
    #[serde(skip)]
    down: BTreeSet<HostId>,
}

impl Hosts {
    /// Creates hosts from the home of each module, the clock of each host, and the link of each pair of hosts in the
    /// order of [`Hosts::pairs`].
    ///
    /// # Errors
    /// If the parts do not fit together.
    pub fn new(
        homes: Vec<HostId>,
        clocks: Vec<ClockOffset>,
        links: Vec<LinkModel>,
    ) -> Result<Hosts, HostsError> {
        let first = clocks.first().ok_or(HostsError::None)?;
        if *first != ClockOffset::default() {
            return Err(HostsError::Reference);
        }
        if let Some(i) = homes.iter().position(|home| home.index() >= clocks.len()) {
            // Invariant: a swarm has fewer than 2^32 modules.
            return Err(HostsError::Home(ModuleId(i as u32), homes[i]));
        }
        let pairs = Hosts::pairs(clocks.len()).count();
        if links.len() != pairs {
            return Err(HostsError::Links { pairs, found: links.len() });
        }
        Ok(Hosts { homes, clocks, links, lost: Lost::Crash, down: BTreeSet::new() })
    }

    /// Sets the consequence of the loss of a host.
    #[must_use]
    pub fn with_lost(self, lost: Lost) -> Hosts {
        Hosts { lost, ..self }
    }

    /// Returns the consequence of the loss of a host.
    pub fn lost(&self) -> Lost {
        self.lost
    }

    /// Iterates over the pairs of `count` hosts: (h1, h2), (h1, h3), (h2, h3), (h1, h4), ...
    pub fn pairs(count: usize) -> impl Iterator<Item = (HostId, HostId)> {
        // Invariant: there are fewer than 2^16 hosts.
        (0..count as u16).flat_map(|b| (0..b).map(move |a| (HostId(a), HostId(b))))
    }

    /// Returns the number of hosts.
    pub fn len(&self) -> usize {
        self.clocks.len()
    }
    /// Returns true if there are no hosts; valid values have some.
    pub fn is_empty(&self) -> bool {
        self.clocks.is_empty()
    }
    /// Returns the home of a module.
    pub fn home(&self, id: ModuleId) -> HostId {
        self.homes[id.index()]
    }
    /// Returns the home of a module; `None` if there is no such module.
    pub fn home_of(&self, id: ModuleId) -> Option<HostId> {
        self.homes.get(id.index()).copied()
    }
    /// Returns the home of each module, by number.
    pub fn homes(&self) -> &[HostId] {
        &self.homes
    }
    /// Gives each module a home, by number.
    ///
    /// # Errors
    /// If a home does not exist. Nothing has changed then.
    pub fn set_homes(&mut self, homes: Vec<HostId>) -> Result<(), HostsError> {
        let there = Hosts::new(homes, self.clocks.clone(), self.links.clone())?;
        self.homes = there.homes;
        Ok(())
    }
    /// Returns true if the module exists and is at home on this host.
    pub fn is_home(&self, id: ModuleId, host: HostId) -> bool {
        self.home_of(id) == Some(host)
    }
    /// Iterates over the modules of a host, in ascending order.
    pub fn modules(&self, host: HostId) -> impl Iterator<Item = ModuleId> {
        (0u32..).zip(&self.homes).filter(move |(_, home)| **home == host).map(|(i, _)| ModuleId(i))
    }
    /// Returns true if a host is down: no module can be started there.
    pub fn is_down(&self, host: HostId) -> bool {
        self.down.contains(&host)
    }

    /// Notes that a host is down. Its modules stay at home there until it counts as lost.
    pub fn go_down(&mut self, host: HostId) {
        self.down.insert(host);
    }

    /// Notes that a host has come back: modules can be started there.
    pub fn come_back(&mut self, host: HostId) {
        self.down.remove(&host);
    }

    /// Gives each module of a lost host another home: the host with the fewest modules that is not down and has room, and of
    /// several the first. `room` is the number of modules that a host takes. A module for which there is no room stays at
    /// home on the lost host. Returns the modules that have moved.
    pub fn lose(&mut self, host: HostId, room: impl Fn(HostId) -> usize) -> Vec<ModuleId> {
        self.go_down(host);
        let mut sizes = vec![0; self.len()];
        self.homes.iter().for_each(|home| sizes[home.index()] += 1);
        let mut moved = Vec::new();
        for id in self.modules(host).collect::<Vec<_>>() {
            // Invariant: there are fewer than 2^16 hosts.
            let all = (0..self.len() as u16).map(HostId);
            let takes = |other: &HostId| !self.is_down(*other) && sizes[other.index()] < room(*other);
            let Some(to) = all.filter(takes).min_by_key(|other| sizes[other.index()]) else { break };
            self.homes[id.index()] = to;
            sizes[to.index()] += 1;
            moved.push(id);
        }
        moved
    }

    /// Returns the clock of a host.
    pub fn clock(&self, host: HostId) -> ClockOffset {
        self.clocks[host.index()]
    }
    /// Returns the largest difference of a clock from the controller's.
    pub fn skew(&self) -> Span {
        Span(self.clocks.iter().map(|clock| clock.0.unsigned_abs()).max().unwrap_or(0))
    }

    /// Returns the link between two different hosts.
    pub fn link(&self, a: HostId, b: HostId) -> &LinkModel {
        &self.links[link_index(a, b)]
    }
    /// Iterates over the links, with the hosts of each.
    pub fn links(&self) -> impl Iterator<Item = ((HostId, HostId), &LinkModel)> {
        Hosts::pairs(self.len()).zip(&self.links)
    }

    /// Returns true if the link between two different hosts is cut at `now`.
    pub fn is_cut(&self, a: HostId, b: HostId, now: Time) -> bool {
        self.link(a, b).healed_at(now) != now
    }

    /// Cuts the link between two different hosts for a while. All messages that would cross are concerned, so the partition
    /// has no sides.
    pub fn cut(&mut self, a: HostId, b: HostId, from: Time, until: Time) {
        self.links[link_index(a, b)].partitions.push(Partition { from, until, side: Vec::new() });
    }

    /// Returns the link that messages between two modules cross; `None` if both are at home on one host.
    pub fn between(&self, from: ModuleId, to: ModuleId) -> Option<&LinkModel> {
        let (a, b) = (self.home(from), self.home(to));
        (a != b).then(|| self.link(a, b))
    }

    /// Draws when the stream between the controller's host and `host`, another one, delivers what is sent at `now`.
    /// `last` is the latest delivery in this direction so far.
    pub fn stream(&self, host: HostId, now: Time, rng: &mut Rng, last: &mut Time) -> Time {
        let link = self.link(HostId::CONTROLLER, host);
        let drawn = link.healed_at(now) + link.delay(None, rng);
        *last = drawn.max(*last);
        *last
    }
}

/// Returns the index of a pair of different hosts in the order of [`Hosts::pairs`].
fn link_index(a: HostId, b: HostId) -> usize {
    let (low, high) = (a.min(b).index(), a.max(b).index());
    high * high.saturating_sub(1) / 2 + low
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::LinkState;
    use alloc::sync::Arc;

    const HOMES: [HostId; 4] = [HostId(0), HostId(1), HostId(2), HostId(1)];

    fn delayed(ms: u64) -> LinkModel {
        LinkModel { delay_min: Span::millis(ms), delay_max: Span::millis(ms), ..LinkModel::default() }
    }

    fn hosts(links: Vec<LinkModel>) -> Hosts {
        let clocks = [0, 5, -5].map(ClockOffset).to_vec();
        Hosts::new(HOMES.to_vec(), clocks, links).unwrap()
    }

    #[test]
    fn each_pair_of_hosts_has_its_link() {
        let hosts = hosts(vec![delayed(1), delayed(2), delayed(3)]);
        let delay = |a, b| hosts.between(ModuleId(a), ModuleId(b)).map(|link| link.delay_max);
        assert_eq!(delay(0, 1), Some(Span::millis(1)));
        assert_eq!(delay(2, 0), Some(Span::millis(2)));
        assert_eq!((delay(1, 2), delay(2, 3)), (Some(Span::millis(3)), Some(Span::millis(3))));
        assert_eq!(delay(1, 3), None);
        assert_eq!(hosts.modules(HostId(1)).collect::<Vec<_>>(), [ModuleId(1), ModuleId(3)]);
        assert_eq!(hosts.skew(), Span(5));
    }

    /// The link of a pair replaces the one within a host, and partitions of modules apply to both.
    #[test]
    fn messages_take_the_link_of_their_hosts() {
        let cut = Partition { from: Time(10), until: Time(20), side: vec![ModuleId(0)] };
        let hosts = Arc::new(hosts(vec![delayed(1), delayed(2), delayed(3)]));
        let model = LinkModel { partitions: vec![cut], hosts: Some(hosts), ..delayed(9) };
        let mut rng = Rng::named(1, "link", 0);
        let mut takes = |now, from, to| {
            let mut last = LinkState::default();
            let fate = model.carry(Time(now), ModuleId(from), ModuleId(to), &mut rng, &mut last);
            fate.arrivals[0].map(|arrival| arrival.at.since(Time(now)))
        };
        assert_eq!(takes(0, 0, 1), Some(Span::millis(1)));
        assert_eq!(takes(0, 3, 1), Some(Span::millis(9)));
        assert_eq!(takes(10, 0, 1), None);
        assert_eq!(takes(10, 2, 1), Some(Span::millis(3)));
    }

    #[test]
    fn a_stream_keeps_its_order_and_waits_for_the_end_of_a_cut() {
        let cut = |from, until| Partition { from: Time(from), until: Time(until), side: vec![ModuleId(0)] };
        let wide = LinkModel { delay_min: Span(10), delay_max: Span(1_000), ..LinkModel::default() };
        let torn = LinkModel { partitions: vec![cut(600, 900), cut(100, 700)], ..delayed(0) };
        let hosts = hosts(vec![wide, torn, delayed(0)]);
        let (mut rng, mut last) = (Rng::named(1, "hosts", 0), Time::ZERO);
        let times: Vec<Time> =
            (0..500).map(|i| hosts.stream(HostId(1), Time(i), &mut rng, &mut last)).collect();
        assert!(times.is_sorted() && times[0] >= Time(10));
        let mut at = |now| hosts.stream(HostId(2), Time(now), &mut rng, &mut Time::ZERO.clone());
        assert_eq!([99, 100, 899, 900].map(&mut at), [Time(99), Time(900), Time(900), Time(900)]);
    }

    #[test]
    fn modules_of_a_lost_host_move_to_the_emptiest_with_room() {
        let before = hosts(vec![delayed(1), delayed(2), delayed(3)]);
        let homes = |hosts: &Hosts| (0..4).map(|id| hosts.home(ModuleId(id)).0).collect::<Vec<_>>();
        let lose = |room: [usize; 3], down: &[u16]| {
            let mut hosts = before.clone();
            down.iter().for_each(|host| hosts.go_down(HostId(*host)));
            let moved = hosts.lose(HostId(1), |host| room[host.index()]);
            (moved.iter().map(|id| id.0).collect::<Vec<_>>(), homes(&hosts))
        };
        assert_eq!(lose([9, 9, 9], &[]), (vec![1, 3], vec![0, 0, 2, 2]));
        assert_eq!(lose([1, 9, 9], &[]), (vec![1, 3], vec![0, 2, 2, 2]));
        assert_eq!(lose([1, 9, 2], &[]), (vec![1], vec![0, 2, 2, 1]));
        assert_eq!(lose([9, 9, 9], &[0]), (vec![1, 3], vec![0, 2, 2, 2]));
        assert_eq!(lose([9, 9, 9], &[0, 2]), (vec![], vec![0, 1, 2, 1]));
        let mut hosts = before.clone();
        hosts.lose(HostId(1), |_| 9);
        hosts.come_back(HostId(1));
        assert_eq!((hosts.lose(HostId(2), |_| 9).len(), homes(&hosts)), (2, vec![0, 0, 1, 1]));
    }

    #[test]
    fn a_cut_concerns_modules_that_have_moved() {
        let mut hosts = hosts(vec![delayed(1), delayed(2), delayed(3)]);
        hosts.cut(HostId(0), HostId(2), Time(10), Time(20));
        hosts.lose(HostId(1), |_| 9);
        let model = LinkModel { hosts: Some(Arc::new(hosts)), ..LinkModel::default() };
        let mut rng = Rng::named(1, "link", 0);
        let mut arrives = |now, from, to| {
            let fate =
                model.carry(Time(now), ModuleId(from), ModuleId(to), &mut rng, &mut LinkState::default());
            fate.arrivals[0].is_some()
        };
        // Modules 0 and 1 are on the first host, 2 and 3 on the third.
        assert_eq!(
            [arrives(9, 1, 3), arrives(10, 1, 3), arrives(10, 3, 1), arrives(20, 1, 3)],
            [true, false, false, true]
        );
        assert_eq!([arrives(10, 0, 1), arrives(10, 2, 3)], [true, true]);
    }

    #[test]
    fn clocks_are_converted_both_ways() {
        let (ahead, behind) = (ClockOffset(5), ClockOffset(-5));
        assert_eq!((ahead.local(Time(10)), behind.local(Time(10))), (Time(15), Time(5)));
        assert_eq!((ahead.global(Time(15)), behind.global(Time(5))), (Time(10), Time(10)));
        assert_eq!((behind.local(Time(2)), behind.global(Time(0))), (Time(0), Time(5)));
        assert_eq!((ahead.local(Time::NEVER), behind.global(Time::NEVER)), (Time::NEVER, Time::NEVER));
    }

    #[test]
    fn parts_that_do_not_fit_are_refused() {
        let new = |home, clock, links| {
            Hosts::new(vec![HostId(home)], vec![ClockOffset(clock), ClockOffset(0)], vec![delayed(0); links])
        };
        assert!(new(1, 0, 1).is_ok());
        assert_eq!(new(2, 0, 1), Err(HostsError::Home(ModuleId(0), HostId(2))));
        assert_eq!(new(1, 0, 2), Err(HostsError::Links { pairs: 1, found: 2 }));
        assert_eq!(new(1, 3, 1), Err(HostsError::Reference));
        assert_eq!(Hosts::new(vec![], vec![], vec![]), Err(HostsError::None));
    }
}
