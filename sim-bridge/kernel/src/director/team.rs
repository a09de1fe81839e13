//! Costs of an operator: the log of a team of units and operators, and the measures that follow from it (thesis E.2).
//! Times are whole ticks of any unit; measures are in the same.

use std::collections::BTreeMap;

/// Log of one team.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TeamLog {
    /// The performance below which a unit counts as neglected.
    pub threshold: f64,
    /// How long it has to be below to count.
    pub window: u64,
    /// Interactions with one unit that are at most this far apart are one.
    pub gap: u64,
    /// The end of the log.
    pub end: u64,
    /// The units, by number.
    pub units: BTreeMap<u32, UnitLog>,
    /// The interactions, in the order of time.
    pub interactions: Vec<Interaction>,
    /// When units waited for others.
    pub waits: Vec<Wait>,
}

/// One unit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UnitLog {
    /// The performance, from 0 to 1, from these times on.
    pub performance: Vec<(u64, f64)>,
    /// When it had done what it is for.
    pub done: Option<u64>,
}

/// An interaction of an operator with a unit: from the first selection to the last command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interaction {
    /// The unit.
    pub unit: u32,
    /// Its beginning.
    pub from: u64,
    /// Its end.
    pub to: u64,
}

/// A time in which a unit waited for another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wait {
    /// The one that waits.
    pub unit: u32,
    /// The one that it waits for.
    pub on: u32,
    /// Its beginning.
    pub from: u64,
    /// Its end.
    pub to: u64,
}

/// The measures of a log.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measures {
    /// Neglect times, ascending; false for one whose end was not seen.
    pub neglect: Vec<(u64, bool)>,
    /// The first time at which at most half of the neglect times last, by Kaplan and Meier.
    pub neglect_median: Option<u64>,
    /// Their mean, restricted to the longest: the area under the curve.
    pub neglect_mean: Option<f64>,
    /// The mean interaction time.
    pub interaction_mean: Option<f64>,
    /// The number of interactions.
    pub interactions: u64,
    /// The mean time from the beginning of a neglected stretch to the interaction in it.
    pub wait_mean: Option<f64>,
    /// From the ends of interactions to the recovery of the unit, ascending.
    pub recovery: Vec<u64>,
    /// Interactions after which the unit did not recover before the next one.
    pub failed: u64,
    /// The time spent on others that a neglected unit waited for.
    pub occupied: u64,
    /// The same as a share of all neglect times. Above 1 if several wait for one.
    pub coordination_demand: Option<f64>,
    /// The share of its time that a unit demands of the operator.
    pub attention_demand: Option<f64>,
    /// How many units one operator can serve.
    pub fan_out: Option<u64>,
    /// The same, if waits count.
    pub fan_out_waiting: Option<u64>,
    /// The share of the time that interactions cover.
    pub intervention_share: f64,
}

impl TeamLog {
    /// Returns the measures.
    pub fn measures(&self) -> Measures {
        let interactions = self.joined();
        let mut found = Found::default();
        for (unit, log) in &self.units {
            let own: Vec<Interaction> = interactions.iter().copied().filter(|i| i.unit == *unit).collect();
            self.follow(*unit, log, &own, &mut found);
        }
        let occupied = found.intervals.iter().map(|i| self.occupied(*i, &interactions)).sum();
        let mut neglect: Vec<(u64, bool)> =
            found.intervals.iter().map(|i| (i.to - i.from, i.is_complete)).collect();
        // Of equal times those come first whose end was seen.
        neglect.sort_unstable_by_key(|(time, is_complete)| (*time, !is_complete));
        found.recovery.sort_unstable();
        let (neglect_median, neglect_mean) = kaplan_meier(&neglect);
        let interaction_mean = mean(interactions.iter().map(|i| i.to - i.from));
        let wait_mean = mean(found.waited.iter().copied());
        let all: u64 = neglect.iter().map(|(time, _)| time).sum();
        let fan_out = |busy: Option<f64>| {
            let (neglect, busy) = (neglect_mean?, busy.filter(|busy| *busy > 0.0)?);
            Some((neglect / busy).floor() as u64 + 1)
        };
        let with_wait = interaction_mean.zip(wait_mean).map(|(interaction, wait)| interaction + wait);
        let demand = |(interaction, neglect): (f64, f64)| interaction / (interaction + neglect);
        Measures {
            neglect_median,
            neglect_mean,
            interaction_mean,
            interactions: interactions.len() as u64,
            wait_mean,
            recovery: found.recovery,
            failed: found.failed,
            occupied,
            coordination_demand: (all > 0).then(|| occupied as f64 / all as f64),
            attention_demand: interaction_mean.zip(neglect_mean).map(demand),
            fan_out: fan_out(interaction_mean),
            fan_out_waiting: fan_out(with_wait),
            intervention_share: covered(&interactions) as f64 / self.end.max(1) as f64,
            neglect,
        }
    }

    /// Returns the interactions with short gaps closed.
    fn joined(&self) -> Vec<Interaction> {
        let mut joined: Vec<Interaction> = Vec::new();
        for next in &self.interactions {
            let last = joined.iter_mut().rev().find(|i| i.unit == next.unit);
            match last.filter(|last| next.from.saturating_sub(last.to) <= self.gap) {
                Some(last) => last.to = last.to.max(next.to),
                None => joined.push(*next),
            }
        }
        joined
    }

    /// Follows one unit from interaction to interaction.
    fn follow(&self, unit: u32, log: &UnitLog, own: &[Interaction], found: &mut Found) {
        let end = log.done.unwrap_or(self.end).min(self.end);
        let below = log.stretches(self.threshold, end);
        let long: Vec<(u64, u64)> =
            below.iter().copied().filter(|(from, to)| to - from >= self.window).collect();
        let mut starts = vec![(0, own.first().map_or(end, |i| i.from.min(end)))];
        for (i, interaction) in own.iter().enumerate().filter(|(_, i)| i.from < end) {
            let in_it = long.iter().find(|(from, to)| (*from..*to).contains(&interaction.from));
            found.waited.push(in_it.map_or(0, |(from, _)| interaction.from - from));
            let next = own.get(i + 1).map_or(end, |next| next.from.min(end));
            let is_below = below.iter().find(|(from, to)| (*from..*to).contains(&interaction.to));
            let recovered = is_below.map_or(interaction.to, |(_, to)| *to);
            if recovered < next {
                found.recovery.push(recovered - interaction.to);
                starts.push((recovered, next));
            } else {
                found.failed += 1;
            }
        }
        for (from, until) in starts {
            let failed = long.iter().map(|(start, _)| *start).find(|start| *start >= from && *start < until);
            let to = failed.unwrap_or(until);
            found.intervals.push(Interval { unit, from, to, is_complete: failed.is_some() });
        }
    }

    /// Returns the time in a neglect interval in which the operator was busy with a unit that this one waited for.
    fn occupied(&self, interval: Interval, interactions: &[Interaction]) -> u64 {
        let own = self.waits.iter().filter(|wait| wait.unit == interval.unit);
        let busy = |wait: &Wait| -> u64 {
            let others = interactions.iter().filter(|i| i.unit == wait.on);
            let overlap = |i: &Interaction| {
                let from = i.from.max(wait.from).max(interval.from);
                i.to.min(wait.to).min(interval.to).saturating_sub(from)
            };
            others.map(overlap).sum()
        };
        own.map(busy).sum()
    }
}

impl UnitLog {
    /// Returns the stretches below a threshold, up to `end`.
    fn stretches(&self, threshold: f64, end: u64) -> Vec<(u64, u64)> {
        let mut stretches: Vec<(u64, u64)> = Vec::new();
        for (i, (from, performance)) in self.performance.iter().enumerate() {
            let to = self.performance.get(i + 1).map_or(end, |(at, _)| *at).min(end);
            if *performance >= threshold || *from >= to {
                continue;
            }
            match stretches.last_mut().filter(|last| last.1 == *from) {
                Some(last) => last.1 = to,
                None => stretches.push((*from, to)),
            }
        }
        stretches
    }
}

/// A neglect time of a unit.
#[derive(Clone, Copy)]
struct Interval {
    unit: u32,
    from: u64,
    to: u64,
    is_complete: bool,
}

#[derive(Default)]
struct Found {
    intervals: Vec<Interval>,
    waited: Vec<u64>,
    recovery: Vec<u64>,
    failed: u64,
}

fn mean(all: impl Iterator<Item = u64>) -> Option<f64> {
    let (sum, count) = all.fold((0u64, 0u64), |(sum, count), one| (sum + one, count + 1));
    (count > 0).then(|| sum as f64 / count as f64)
}

/// Returns the time that at least one interaction covers.
fn covered(interactions: &[Interaction]) -> u64 {
    let mut all: Vec<(u64, u64)> = interactions.iter().map(|i| (i.from, i.to)).collect();
    all.sort_unstable();
    let add = |(sum, until): (u64, u64), (from, to): (u64, u64)| {
        (sum + to.saturating_sub(from.max(until)), until.max(to))
    };
    all.into_iter().fold((0, 0), add).0
}

/// Returns the median and the restricted mean of times, some of which are lower bounds only (false), in ascending
/// order.
pub fn kaplan_meier(times: &[(u64, bool)]) -> (Option<u64>, Option<f64>) {
    let (mut surviving, mut area, mut last, mut median) = (1.0, 0.0, 0, None);
    for (i, (time, is_complete)) in times.iter().enumerate() {
        area += surviving * (time - last) as f64;
        last = *time;
        // Those of one time are taken one after the other, which gives the same product.
        if *is_complete {
            let at_risk = times.len() - i;
            surviving *= 1.0 - 1.0 / at_risk as f64;
            if surviving <= 0.5 {
                median = median.or(Some(*time));
            }
        }
    }
    (median, (!times.is_empty()).then_some(area))
}
