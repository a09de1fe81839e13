//! Faults that have passed every check, and their schedule for a seed.

use super::diagnostics::{At, Diagnostics};
use super::error::ScenarioError;
use super::family::Swarm;
use super::faults::{Amount, RawFault, Verb};
use super::hosts::{self, HostsProblem};
use super::outages::{self, Impossible, Outage};
use super::table::Window;
use metamorph_core::ids::{HostId, ModuleId};
use metamorph_core::link::{Hosts, Lost, Partition};
use metamorph_core::rng::Rng;
use metamorph_core::time::{Span, Time};
use metamorph_kernel::director::faults::{Fault, Schedule, Scheduled};

/// The properties of the run that faults are checked against.
pub struct Bounds<'h> {
    /// The number of modules.
    pub modules: usize,
    /// The hosts, if there are several.
    pub hosts: Option<&'h Hosts>,
    /// The latest end of the run.
    pub timeout: Span,
    /// The swarm, if it could be read: it knows what of its world can be hit.
    pub swarm: Option<&'h Swarm>,
}

/// A fault that has passed every check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Planned {
    /// A fault with known time and target.
    At(Time, Fault),
    /// A fault that is due after all others of its time: a command of an operator, or what an outage of a host consists of.
    Exactly(Scheduled),
    /// Crashes drawn with the seed of the run.
    Crashes {
        /// Number of crashes.
        count: usize,
        /// Number of modules.
        of: usize,
        /// The earliest time.
        from: Span,
        /// The end of the interval, exclusive.
        until: Span,
    },
}

/// Returns the schedule of faults for this seed.
pub fn draw(planned: &[Planned], seed: u64) -> Schedule {
    let (mut schedule, mut commands, mut draws) = (Vec::new(), Vec::new(), 0);
    for fault in planned {
        match *fault {
            Planned::At(at, fault) => schedule.push((at, fault)),
            Planned::Exactly(scheduled) => commands.push(scheduled),
            Planned::Crashes { count, of, from, until } => {
                let mut stream = Rng::named(seed, "crashes", draws);
                draws += 1;
                for id in draw_modules(of, count, &mut stream) {
                    let at = Time::ZERO + from + Span(stream.below((until - from).0));
                    schedule.push((at, Fault::Kill(id)));
                }
            }
        }
    }
    let mut schedule = Schedule::new(schedule);
    // A command comes after what else is due at its time, as if it had been given during the run.
    commands.into_iter().for_each(|command| schedule.insert(0, command));
    schedule
}

impl Bounds<'_> {
    fn host_count(&self) -> usize {
        self.hosts.map_or(0, Hosts::len)
    }

    /// Returns the module of a number, if there is one.
    pub fn module(&self, id: &At<u64>, diagnostics: &mut Diagnostics) -> Option<ModuleId> {
        if id.value < self.modules as u64 {
            // Invariant: a swarm has fewer than 2^32 modules.
            return Some(ModuleId(id.value as u32));
        }
        let scenario_error =
            ScenarioError::NoSuchModule { module: id.value, last: self.modules.saturating_sub(1) };
        diagnostics.add(id.place.clone(), scenario_error);
        None
    }

    /// Returns the time of a fault, which must not be after the end of the run.
    pub fn time(&self, at: &At<Span>, diagnostics: &mut Diagnostics) -> Time {
        if at.value > self.timeout {
            let scenario_error = ScenarioError::AfterTheEnd { at: at.value, timeout: self.timeout };
            diagnostics.add(at.place.clone(), scenario_error);
        }
        Time::ZERO + at.value
    }

    fn span(
        &self,
        from: &At<Span>,
        until: Option<&At<Span>>,
        diagnostics: &mut Diagnostics,
    ) -> (Time, Option<Time>) {
        match until {
            None => (self.time(from, diagnostics), None),
            Some(until) => {
                let (from, until) = self.window(from, until, diagnostics);
                (from, Some(until))
            }
        }
    }

    fn window(&self, from: &At<Span>, until: &At<Span>, diagnostics: &mut Diagnostics) -> (Time, Time) {
        if from.value >= until.value {
            let scenario_error = ScenarioError::Order { from: from.value, until: until.value };
            diagnostics.add(until.place.clone(), scenario_error);
        }
        (self.time(from, diagnostics), self.time(until, diagnostics))
    }
}

/// A time in which nothing passes between two hosts.
pub struct HostCut {
    /// The hosts, which are different.
    pub hosts: (HostId, HostId),
    /// The start.
    pub from: Time,
    /// The end.
    pub until: Time,
}

/// Faults that have passed every check.
#[derive(Default)]
pub struct Compiled {
    /// Faults of processes, bodies and the world.
    pub planned: Vec<Planned>,
    /// Partitions between modules.
    pub partitions: Vec<Partition>,
    /// Cuts between hosts.
    pub cuts: Vec<HostCut>,
}

/// Checks all faults.
pub fn compile(faults: &[RawFault], bounds: &Bounds<'_>, diagnostics: &mut Diagnostics) -> Compiled {
    let mut compiled = Compiled::default();
    let Compiled { planned, partitions, cuts } = &mut compiled;
    let (mut outages, mut places) = (Vec::new(), Vec::new());
    for fault in faults {
        match fault {
            RawFault::Named { verb, modules, from, until } => {
                let (begin, end) = bounds.span(from, until.as_ref(), diagnostics);
                let modules = modules.iter().filter_map(|id| bounds.module(id, diagnostics));
                planned.extend(modules.flat_map(|id| events(*verb, id, begin, end)));
            }
            RawFault::Host { verb, host, from, until } => {
                let (begin, end) = bounds.span(from, until.as_ref(), diagnostics);
                let host = hosts::host_of(host, bounds.host_count(), diagnostics).zip(bounds.hosts);
                let Some((id, hosts)) = host else { continue };
                match (verb, hosts.lost()) {
                    (Verb::Kill, Lost::Elsewhere { .. }) => {
                        outages.push(Outage { host: id, begin, end });
                        places.push(from.place.clone());
                        continue;
                    }
                    (Verb::Kill, Lost::Crash) if until.is_some() => {
                        let place = until.as_ref().map(|until| until.place.clone());
                        let problem = HostsProblem::NeedsElsewhere("until");
                        place.into_iter().for_each(|place| diagnostics.add(place, problem.clone()));
                    }
                    _ => {}
                }
                planned.extend(hosts.modules(id).flat_map(|id| events(*verb, id, begin, end)));
            }
            RawFault::Cut { hosts, from, until } => {
                let (from, until) = bounds.window(from, until, diagnostics);
                let pair = hosts::pair_of(hosts, bounds.host_count(), diagnostics);
                cuts.extend(pair.map(|hosts| HostCut { hosts, from, until }));
            }
            RawFault::World { kinds: (first, second), target, from, until } => {
                let (begin, end) = bounds.span(from, until.as_ref(), diagnostics);
                if let Some(error) = bounds.swarm.and_then(|swarm| swarm.no_target(&target.value)) {
                    diagnostics.add(target.place.clone(), error);
                }
                planned.push(Planned::At(begin, Fault::World(first, target.value)));
                let end = end.zip(*second);
                planned.extend(end.map(|(at, end)| Planned::At(at, Fault::World(end, target.value))));
            }
            RawFault::Crashes { amount, window, place } => {
                let Window(from, until) = window.value;
                if from >= until {
                    diagnostics.add(window.place.clone(), ScenarioError::Order { from, until });
                    continue;
                }
                bounds.time(&At::new(until, window.place.clone()), diagnostics);
                let count = match amount {
                    Amount::Fraction(f) => bounds.modules as u64 * u64::from(f.num()) / u64::from(f.den()),
                    Amount::Count(n) => *n,
                };
                if count > bounds.modules as u64 {
                    let scenario_error = ScenarioError::Range {
                        what: "the number of crashes",
                        got: count.to_string(),
                        low: "0".into(),
                        high: bounds.modules.to_string(),
                    };
                    diagnostics.add(place.clone(), scenario_error);
                    continue;
                }
                planned.push(Planned::Crashes { count: count as usize, of: bounds.modules, from, until });
            }
            RawFault::Partition { modules, from, until } => {
                let (from, until) = bounds.window(from, until, diagnostics);
                let mut side: Vec<_> =
                    modules.iter().filter_map(|id| bounds.module(id, diagnostics)).collect();
                side.sort_unstable();
                side.dedup();
                partitions.push(Partition { from, until, side });
            }
        }
    }
    if let Some((hosts, Lost::Elsewhere { fence })) = bounds.hosts.map(|hosts| (hosts, hosts.lost())) {
        match outages::schedule(&outages, hosts, fence) {
            Ok(events) => planned.extend(events.into_iter().map(Planned::Exactly)),
            Err(Impossible { of, host, at, is_last }) => {
                let problem =
                    if is_last { HostsProblem::NoneLeft(at) } else { HostsProblem::DownAlready(host, at) };
                diagnostics.add(places[of].clone(), problem);
            }
        }
    }
    compiled
}

/// Returns what happens to a module: the fault, and its end if it has one.
fn events(verb: Verb, id: ModuleId, begin: Time, end: Option<Time>) -> impl Iterator<Item = Planned> {
    let (first, second) = match verb {
        Verb::Kill => (Fault::Kill(id), None),
        Verb::Pause => (Fault::Pause(id), Some(Fault::Resume(id))),
        Verb::Restart => (Fault::Restart(id), None),
        Verb::Stick => (Fault::Stick(id), Some(Fault::Unstick(id))),
    };
    let ends = end.zip(second).map(|(at, fault)| Planned::At(at, fault));
    std::iter::once(Planned::At(begin, first)).chain(ends)
}

/// Draws `count` different modules (Fisher-Yates shuffle, stopped early).
fn draw_modules(modules: usize, count: usize, stream: &mut Rng) -> Vec<ModuleId> {
    let mut ids: Vec<u32> = (0..modules as u32).collect();
    for i in 0..count {
        let other = i + stream.below((modules - i) as u64) as usize;
        ids.swap(i, other);
    }
    ids.into_iter().take(count).map(ModuleId).collect()
}
