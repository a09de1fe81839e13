//! The link model: what may happen to a message between two modules.
//!
//! Sans-IO and shared by the drivers: the simulator schedules the arrivals that [`LinkModel::carry`] returns,
//! and an agent process delays, drops or duplicates what it sends in the same way. Links keep their order
//! unless a message is drawn to be reordered.

mod between;
mod changes;
mod controller;
mod delays;
mod hosts;

pub use between::{Between, End};
pub use changes::LinkChanges;
pub use controller::ControllerLink;
pub use delays::{Burst, LinkState, MOST_QUANTILES, Quantiles, QuantilesError};
pub use hosts::{ClockOffset, HostChange, Hosts, HostsError, Lost};

use crate::ids::{HostId, ModuleId};
use crate::ratio::Ratio;
use crate::rng::Rng;
use crate::time::{Span, Time};
use alloc::sync::Arc;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

/// A split of the swarm into two sides that cannot talk to each other for a while.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Partition {
    /// The start.
    pub from: Time,
    /// The end: the first instant at which messages pass again.
    pub until: Time,
    /// The modules on one side, in ascending order; all others are on the other side.
    pub side: Vec<ModuleId>,
}

impl Partition {
    fn cuts(&self, now: Time, a: ModuleId, b: ModuleId) -> bool {
        let inside = |m| self.side.binary_search(&m).is_ok();
        (self.from..self.until).contains(&now) && inside(a) != inside(b)
    }
}

/// Delays and impairments of a link.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, Default)]
pub struct LinkModel {
    /// The shortest delay.
    pub delay_min: Span,
    /// The longest delay; delays are uniform between the two, unless there are quantiles.
    pub delay_max: Span,
    /// The distribution of delays, from the shortest to the longest; `None` if it is uniform.
    pub quantiles: Option<Arc<Quantiles>>,
    /// Probability that a message is lost.
    pub loss: Ratio,
    /// Probability that a message arrives twice.
    pub duplicate: Ratio,
    /// Probability that a message is delayed so long that later ones overtake it.
    pub reorder: Ratio,
    /// Probability that a bit of a message flips.
    pub corrupt: Ratio,
    /// Spells in which the link is worse; `None` if there are none.
    pub burst: Option<Arc<Burst>>,
    /// Links of their own between some modules: the first that fits a message has it.
    pub between: Vec<Between>,
    /// From this time on messages are delayed, but not lost, duplicated, reordered or damaged; partitions still
    /// apply. `None`: never.
    pub harmless_from: Option<Time>,
    /// Partitions, during which no message passes between the sides.
    pub partitions: Vec<Partition>,
    /// The hosts that modules run on; `None` if there is only one. Messages between two hosts have the fate that the
    /// link of these hosts draws.
    pub hosts: Option<Arc<Hosts>>,
    /// The delays of orders and reports; `None` if they take no time. Messages between modules do not use it.
    pub controller: Option<ControllerLink>,
    /// Changes of this model while the run is in progress. A run starts without any.
    #[serde(skip)]
    pub changes: LinkChanges,
}

/// One copy of a message under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// The time of arrival.
    pub at: Time,
    /// The bit that flips under way (see [`crate::wire::Frame::flip`]); `None` if the copy arrives undamaged.
    pub flipped_bit: Option<u64>,
}

/// The fate of one message: lost if there is no arrival, duplicated if there are two.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Delivery {
    /// The copies that arrive.
    pub arrivals: [Option<Arrival>; 2],
}

impl LinkModel {
    /// Returns true if messages pass at once and unimpaired, so that nothing needs to be drawn.
    pub fn is_transparent(&self) -> bool {
        self.delay_max == Span::ZERO
            && [self.loss, self.duplicate, self.reorder, self.corrupt].iter().all(|p| p.is_zero())
            && self.burst.is_none()
            && self.between.is_empty()
            && self.partitions.is_empty()
            && self.hosts.is_none()
            && self.changes.is_none()
    }

    /// Returns the clock that the agent of a module reads.
    pub fn clock(&self, id: ModuleId) -> ClockOffset {
        self.hosts.as_ref().map_or(ClockOffset::default(), |hosts| hosts.clock(hosts.home(id)))
    }

    /// Returns true if the process of a module can be started: its home is not down.
    pub fn has_place(&self, id: ModuleId) -> bool {
        self.hosts.as_ref().is_none_or(|hosts| !hosts.is_down(hosts.home(id)))
    }

    /// Lets something happen to a host. Hosts of the model have room for any number of modules.
    pub fn change_host(&mut self, host: HostId, change: HostChange) {
        let Some(hosts) = self.hosts.as_mut().map(Arc::make_mut) else { return };
        match change {
            HostChange::Down => hosts.go_down(host),
            HostChange::Lost => drop(hosts.lose(host, |_| usize::MAX)),
            HostChange::Back => hosts.come_back(host),
        }
    }

    /// Returns the end of all partitions at `now`: `now` itself if there is none.
    fn healed_at(&self, now: Time) -> Time {
        let mut at = now;
        // Each partition is left at most once, since time only advances.
        while let Some(cut) = self.partitions.iter().find(|cut| (cut.from..cut.until).contains(&at)) {
            at = cut.until;
        }
        at
    }

    /// Returns the longest delay of a message that no later one overtakes, within a burst too.
    pub fn longest_delay(&self) -> Span {
        let within = self.burst.as_ref().and_then(|burst| burst.delay).map_or(Span::ZERO, |delay| delay.1);
        self.delay_max.max(within)
    }

    /// Draws the fate of a message sent at `now`, and advances the state of this direction of the link.
    pub fn carry(
        &self,
        now: Time,
        from: ModuleId,
        to: ModuleId,
        rng: &mut Rng,
        state: &mut LinkState,
    ) -> Delivery {
        let mut fate = Delivery { arrivals: [None, None] };
        if self.partitions.iter().any(|p| p.cuts(now, from, to)) || self.changes.cuts(from, to) {
            return fate;
        }
        if self.changes.loss.is_some_and(|loss| rng.chance(loss)) {
            return fate;
        }
        if let Some(between) = self.between.iter().find(|between| between.holds(now, from, to)) {
            return between.link.carry(now, from, to, rng, state);
        }
        if let Some(between) = self.hosts.as_deref().and_then(|hosts| hosts.between(from, to)) {
            // A cut between hosts concerns all that crosses.
            let is_cut = between.healed_at(now) != now;
            return if is_cut { fate } else { between.carry(now, from, to, rng, state) };
        }
        let harms = self.harmless_from.is_none_or(|at| now < at);
        let burst = self.burst.as_deref().filter(|_| harms);
        if let Some(burst) = burst {
            state.advance(burst, rng);
        }
        let burst = burst.filter(|_| state.in_burst);
        let loss = burst.map_or(self.loss, |burst| burst.loss);
        if harms && self.changes.loss.is_none() && rng.chance(loss) {
            return fate;
        }
        let within = burst.and_then(|burst| burst.delay);
        fate.arrivals[0] = Some(self.arrival(now, harms, within, rng, &mut state.last));
        if harms && rng.chance(self.duplicate) {
            fate.arrivals[1] = Some(self.arrival(now, harms, within, rng, &mut state.last));
        }
        fate
    }

    /// Draws a delay; `within` are the shortest and the longest within a burst.
    fn delay(&self, within: Option<(Span, Span)>, rng: &mut Rng) -> Span {
        let (min, max) = match (within, &self.quantiles) {
            (Some(within), _) => within,
            (None, Some(quantiles)) => return quantiles.draw(rng),
            (None, None) => (self.delay_min, self.delay_max),
        };
        min + Span(rng.below((max - min).0 + 1))
    }

    fn arrival(
        &self,
        now: Time,
        harms: bool,
        within: Option<(Span, Span)>,
        rng: &mut Rng,
        last: &mut Time,
    ) -> Arrival {
        let drawn = now + self.delay(within, rng);
        let at = if harms && rng.chance(self.reorder) {
            // Held back by up to four times the longest delay, so that several later messages can pass.
            let hold = self.longest_delay().0.max(1_000_000) * 4;
            drawn + Span(1 + rng.below(hold))
        } else {
            *last = drawn.max(*last);
            *last
        };
        let flipped_bit = (harms && rng.chance(self.corrupt)).then(|| rng.next_u64());
        Arrival { at, flipped_bit }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn carry_all(model: &LinkModel, n: u64) -> Vec<Delivery> {
        let (mut rng, mut last) = (Rng::named(1, "link", 0), LinkState::default());
        (0..n).map(|i| model.carry(Time(i * 1_000), ModuleId(0), ModuleId(1), &mut rng, &mut last)).collect()
    }

    #[test]
    fn keeps_order_unless_told_otherwise() {
        let mut model = LinkModel { delay_max: Span::millis(5), ..LinkModel::default() };
        let times = |model: &LinkModel| -> Vec<Time> {
            carry_all(model, 1_000).iter().flat_map(|f| f.arrivals).flatten().map(|a| a.at).collect()
        };
        assert!(times(&model).is_sorted());
        model.reorder = "10%".parse().unwrap();
        assert!(!times(&model).is_sorted());
    }

    #[test]
    fn impairs_as_often_as_configured() {
        let tenth: Ratio = "10%".parse().unwrap();
        let model = LinkModel { loss: tenth, duplicate: tenth, corrupt: tenth, ..LinkModel::default() };
        let fates = carry_all(&model, 10_000);
        let count = |f: &dyn Fn(&Delivery) -> bool| fates.iter().filter(|x| f(x)).count();
        assert!((850..1_150).contains(&count(&|f| f.arrivals[0].is_none())));
        assert!((750..1_050).contains(&count(&|f| f.arrivals[1].is_some())));
        assert!((750..1_050).contains(&count(&|f| f.arrivals[0].is_some_and(|a| a.flipped_bit.is_some()))));
    }

    /// Losses come in bursts of the length and at the distances that are given.
    #[test]
    fn losses_come_in_bursts() {
        let [enter, leave, loss] = ["1%", "10%", "100%"].map(|p| p.parse().unwrap());
        let delay = Some((Span::millis(7), Span::millis(9)));
        let bursts = |loss| LinkModel {
            delay_max: Span::millis(1),
            burst: Some(Arc::new(Burst { enter, leave, loss, delay })),
            ..LinkModel::default()
        };
        let lost: Vec<bool> =
            carry_all(&bursts(loss), 100_000).iter().map(|f| f.arrivals[0].is_none()).collect();
        let (runs, all) =
            (lost.windows(2).filter(|w| !w[0] && w[1]).count(), lost.iter().filter(|l| **l).count());
        assert!((8_200..10_000).contains(&all) && (820..1_000).contains(&runs), "{all} in {runs} bursts");
        let within = bursts(Ratio::ZERO);
        let late = |f: &Delivery, i: u64| f.arrivals[0].unwrap().at.since(Time(i * 1_000)) >= Span::millis(6);
        let all = carry_all(&within, 10_000);
        assert!((0..).zip(&all).any(|(i, f)| late(f, i)) && (0..).zip(&all).any(|(i, f)| !late(f, i)));
        let ended = LinkModel { harmless_from: Some(Time::ZERO), ..bursts(loss) };
        assert!(carry_all(&ended, 1_000).iter().all(|f| f.arrivals[0].is_some()));
    }

    #[test]
    fn impairments_end_at_harmless_from() {
        let always: Ratio = "100%".parse().unwrap();
        let model = LinkModel { loss: always, harmless_from: Some(Time(500_000)), ..LinkModel::default() };
        let lost = carry_all(&model, 1_000).iter().filter(|f| f.arrivals[0].is_none()).count();
        assert_eq!(lost, 500);
        let doubled = LinkModel { loss: Ratio::ZERO, duplicate: always, corrupt: always, ..model };
        let after = &carry_all(&doubled, 1_000)[500..];
        let clean =
            |f: &Delivery| f.arrivals[1].is_none() && f.arrivals[0].is_some_and(|a| a.flipped_bit.is_none());
        assert!(after.iter().all(clean));
    }

    #[test]
    fn a_partition_cuts_between_its_sides_while_it_lasts() {
        let cut = Partition { from: Time(10), until: Time(20), side: vec![ModuleId(0), ModuleId(2)] };
        let model = LinkModel { partitions: vec![cut], ..LinkModel::default() };
        let (mut rng, mut last) = (Rng::named(1, "link", 0), LinkState::default());
        let mut passes = |at, a, b| {
            model.carry(Time(at), ModuleId(a), ModuleId(b), &mut rng, &mut last).arrivals[0].is_some()
        };
        assert!(passes(9, 0, 1) && !passes(10, 0, 1) && !passes(19, 1, 2) && passes(20, 0, 1));
        assert!(passes(15, 0, 2) && passes(15, 1, 3));
    }
}
