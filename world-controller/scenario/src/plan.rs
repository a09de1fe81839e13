//! Turns a scenario as written into a plan: what all families share. What belongs to one family is checked in
//! its own files.

use super::bounds::Passage;
use super::changes;
use super::commands;
use super::diagnostics::{At, Diagnostics};
use super::error::{LONGEST, SHORTEST, ScenarioError};
use super::family::{DraftContext, FamilySpec, Patience};
use super::fault_plan::{self, Bounds, HostCut, Planned};
use super::hosts::{RawHosts, worst};
use super::raw::{Raw, RawLink, default_delay};
use super::table::Delay;
use super::{LinkKind, Overrides, Plan, StagePlan};
use metamorph_core::ids::HostId;
use metamorph_core::link::{ControllerLink, Hosts, LinkModel, Partition};
use metamorph_core::ratio::Ratio;
use metamorph_core::time::{Span, Time};
use metamorph_kernel::director::progress::Stop;
use metamorph_text::format::{count, listed};
use std::sync::Arc;

/// Default scenario seconds per second on the process link.
pub const TIME_SCALE: f64 = 20.0;
/// Default time of a move of a cube or of a step of a joint.
pub const BEAT: Span = Span::secs(1);

/// The default of every probability in a scenario.
pub const NEVER: Ratio = Ratio::ZERO;
/// Modules of a partition listed in reports at most.
const LISTED: usize = 8;

/// Checks everything and creates the plan. Returns `None` only after reporting a problem.
pub fn make(raw: &Raw, overrides: &Overrides, diagnostics: &mut Diagnostics) -> Option<Plan> {
    let Some(swarm) = raw.swarm.as_deref() else {
        // Check the link all the same.
        link(raw, overrides.link, BEAT, diagnostics);
        time_scale(raw, diagnostics);
        return None;
    };
    let (time_step, key) = swarm.time_step();
    let time_step = bounded(time_step, key, SHORTEST, LONGEST, diagnostics).unwrap_or(BEAT);
    let (mut link, usual_delay) = link(raw, overrides.link, time_step, diagnostics);
    let Delay(_, usual) = default_delay(LinkKind::Sim, time_step);
    let within = raw.hosts.as_ref().map_or_else(|| link.clone(), |hosts| hosts.worst(&link));
    let lasting = raw.between.iter().filter(|between| between.lasts());
    let worst = worst(&within, lasting.map(|between| between.rates.over(&link)));
    let passage = Passage::of(&worst, usual_delay, usual);
    let speed = raw.time_scale.as_ref().map_or(TIME_SCALE, |scale| scale.value);
    let skew = raw.hosts.as_ref().map_or(Span::ZERO, |hosts| hosts.borne(speed));
    let context = DraftContext { time_step, usual_delay, passage, skew, seed: raw.seed };
    let draft = swarm.draft(&context, diagnostics)?;
    link.controller = raw.controller.as_ref().map(|c| c.compile(overrides.link, diagnostics));
    let mut stop = stop(raw, &draft.patience, link.controller.as_ref(), diagnostics);
    let mut faults = Vec::new();
    if draft.modules > 0 {
        let mut hosts = hosts(raw, overrides.link, &link, (speed, &draft), diagnostics);
        let timeout = stop.timeout.since(Time::ZERO);
        let swarm = draft.swarm.as_ref();
        let bounds = Bounds { modules: draft.modules, hosts: hosts.as_ref(), timeout, swarm };
        let mut compiled = fault_plan::compile(&raw.faults, &bounds, diagnostics);
        let commands = commands::check(&raw.commands, &bounds, diagnostics);
        compiled.planned.extend(commands.into_iter().map(Planned::Exactly));
        for HostCut { hosts: (a, b), from, until } in compiled.cuts {
            hosts.iter_mut().for_each(|hosts| hosts.cut(a, b, from, until));
        }
        let own = raw.between.iter().map(|between| between.compile(&link, draft.modules, diagnostics));
        link.between = own.collect();
        (faults, link.partitions) = (compiled.planned, compiled.partitions);
        link.hosts = hosts.map(Arc::new);
        let between =
            link.hosts.iter().flat_map(|hosts| hosts.links()).flat_map(|(_, link)| &link.partitions);
        let cuts = link.partitions.iter().chain(between);
        let own = link.between.iter().map(|between| between.until).filter(|until| *until != Time::NEVER);
        let ends = cuts.map(|cut| cut.until).chain(link.harmless_from).chain(own);
        stop.planned_until = ends.max().unwrap_or(Time::ZERO).min(stop.timeout);
    }
    swarm.check_end(stop.timeout.since(Time::ZERO), diagnostics);
    changes::check(&raw.changes, overrides.link, draft.modules, diagnostics);
    let operator = raw.operator.as_ref().map(|operator| operator.compile(diagnostics));
    let time_scale = time_scale(raw, diagnostics);
    if !diagnostics.is_empty() {
        return None;
    }
    Some(Plan {
        name: raw.name.clone(),
        description: raw.description.clone(),
        origin: String::new(),
        files: Vec::new(),
        names: Vec::new(),
        notes: Vec::new(),
        text: Arc::from(""),
        overrides: overrides.clone(),
        seed: raw.seed,
        swarm: draft.swarm?,
        stages: draft.goals.into_iter().map(|name| StagePlan { name }).collect(),
        link,
        failure: raw.failed_connections.as_ref().map_or(NEVER, |f| f.value),
        schedule: fault_plan::draw(&faults, raw.seed),
        faults: faults.into(),
        stop,
        changes: raw.changes.iter().map(|change| change.value).collect(),
        rescue: raw.rescue,
        operator,
        is_beyond: raw.stall.is_none() && draft.patience.bounds.is_beyond(),
        time_scale,
    })
}

/// Returns the hosts, if the scenario divides the swarm among several.
fn hosts(
    raw: &Raw,
    kind: LinkKind,
    link: &LinkModel,
    (speed, draft): (f64, &FamilySpec),
    diagnostics: &mut Diagnostics,
) -> Option<Hosts> {
    let hosts = raw.hosts.as_ref()?;
    if kind == LinkKind::Ipc && hosts.skew() > Span::ZERO {
        let what = "a run of processes with clocks that differ".to_owned();
        let instead = "simulate it with `--link sim`, or remove `skew`";
        diagnostics.add(hosts.place().clone(), ScenarioError::NotYet { what, instead });
    }
    if let Some(start_within) = draft.start_within {
        hosts.check_skew(speed, start_within, diagnostics);
    }
    let contacts = || draft.swarm.as_ref().and_then(|swarm| swarm.contacts());
    hosts.compile(link, draft.modules, contacts, diagnostics)
}

fn bounded(
    span: &Option<At<Span>>,
    what: &'static str,
    low: Span,
    high: Span,
    diagnostics: &mut Diagnostics,
) -> Option<Span> {
    let At { value, place } = span.as_ref()?;
    if (low..=high).contains(value) {
        return Some(*value);
    }
    let scenario_error =
        ScenarioError::Range { what, got: value.to_string(), low: low.to_string(), high: high.to_string() };
    diagnostics.add(place.clone(), scenario_error);
    None
}

/// Returns the end conditions of the run.
fn stop(
    raw: &Raw,
    patience: &Patience,
    controller: Option<&ControllerLink>,
    diagnostics: &mut Diagnostics,
) -> Stop {
    // A move under `planned`: the order, the report that it is made, and as much for the plan before it.
    let orders = controller.map_or(Span::ZERO, |link| link.usual_longest() * 4);
    let long = Span(u64::MAX / 4);
    let mut get = |span, what, default| bounded(span, what, Span(1), long, diagnostics).unwrap_or(default);
    let stall = get(&raw.stall, "stall", patience.bounds.stall + orders);
    let livelock = get(&raw.livelock, "livelock", stall * patience.livelock);
    let timeout = get(&raw.timeout, "timeout", livelock * patience.timeout);
    Stop { timeout: Time::ZERO + timeout, stall, livelock, planned_until: Time::ZERO }
}

fn link(raw: &Raw, kind: LinkKind, time_step: Span, diagnostics: &mut Diagnostics) -> (LinkModel, Span) {
    let written = raw.link.delay.as_ref().map(|d| d.value);
    let Delay(delay_min, delay_max) = written.unwrap_or_else(|| default_delay(kind, time_step));
    let Delay(_, usual) = written.unwrap_or_else(|| default_delay(LinkKind::Sim, time_step));
    let own = raw.between.iter().map(|between| &between.rates);
    let links = std::iter::once(&raw.link).chain(own).chain(raw.hosts.iter().flat_map(RawHosts::links));
    let longest = RawLink::longest_delay(links, usual, diagnostics);
    let default = LinkModel { delay_min, delay_max, ..LinkModel::default() };
    (raw.link.over(&default), longest)
}

fn time_scale(raw: &Raw, diagnostics: &mut Diagnostics) -> f64 {
    let Some(At { value, place }) = &raw.time_scale else { return TIME_SCALE };
    let (low, high) = (0.001, 10_000.0);
    if !(low..=high).contains(value) {
        let (low, high) = (low.to_string(), high.to_string());
        diagnostics.add(
            place.clone(),
            ScenarioError::Range { what: "time_scale", got: value.to_string(), low, high },
        );
    }
    *value
}

/// A planned change of the links, as reports describe it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LinkChange {
    /// Time of the change.
    pub at: Time,
    /// Its name.
    pub name: &'static str,
    /// The modules concerned.
    pub effect: String,
}

impl Plan {
    /// Returns beginnings and ends of partitions, by time. Partitions are a property of the link and not in
    /// the schedule of faults; reports list both.
    pub fn link_changes(&self) -> Vec<LinkChange> {
        let modules = self.swarm.len();
        let of_cut = |cut: &Partition| {
            let side: Vec<u32> = cut.side.iter().map(|id| id.0).collect();
            let who = if side.len() == 1 { "module" } else { "modules" };
            let who = format!("{who} {}", listed(&side, LISTED));
            let others = match modules - side.len() {
                1 => "the other one".to_owned(),
                others => format!("the other {}", count(others as u64)),
            };
            let from = format!("{who} cut off from {others}");
            let until = format!("{who} no longer cut off");
            [
                LinkChange { at: cut.from, name: "partition", effect: from },
                LinkChange { at: cut.until, name: "heal", effect: until },
            ]
        };
        let of_hosts = |((a, b), cut): ((HostId, HostId), &Partition)| {
            let from = format!("{a} and {b} cut off from each other");
            let until = format!("{a} and {b} no longer cut off from each other");
            [
                LinkChange { at: cut.from, name: "partition", effect: from },
                LinkChange { at: cut.until, name: "heal", effect: until },
            ]
        };
        let links = self.link.hosts.iter().flat_map(|hosts| hosts.links());
        let between = links.flat_map(|(pair, link)| link.partitions.iter().map(move |cut| (pair, cut)));
        let cuts = self.link.partitions.iter().flat_map(of_cut);
        let mut changes: Vec<LinkChange> = cuts.chain(between.flat_map(of_hosts)).collect();
        changes.sort_by_key(|change| change.at);
        changes
    }
}
