//! A swarm over several hosts, as the simulated link models it: the home of each module, what the links between hosts do,
//! and how far the clocks of hosts differ.
//!
//! Bodies, director and world are on [`HostId::CONTROLLER`]. What passes between them and the agents of another host
//! uses a stream: delayed, in order, without loss, and held back while the link between the two hosts is cut.

use super::{LinkModel, Partition};
use crate::ids::{HostId, ModuleId};
use crate::rng::Rng;
use crate::time::{Span, Time};
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
        Ok(Hosts { homes, clocks, links })
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
    /// Returns true if the module exists and is at home on this host.
    pub fn is_home(&self, id: ModuleId, host: HostId) -> bool {
        self.home_of(id) == Some(host)
    }
    /// Iterates over the modules of a host, in ascending order.
    pub fn modules(&self, host: HostId) -> impl Iterator<Item = ModuleId> {
        (0u32..).zip(&self.homes).filter(move |(_, home)| **home == host).map(|(i, _)| ModuleId(i))
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

    /// Cuts the link between two different hosts for a while.
    pub fn cut(&mut self, a: HostId, b: HostId, from: Time, until: Time) {
        let side = self.modules(a).collect();
        let index = link_index(a, b);
        self.links[index].partitions.push(Partition { from, until, side });
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
