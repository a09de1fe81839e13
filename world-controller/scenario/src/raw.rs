//! A scenario as written: typed values with their places, before checks that need more than one of them.

use super::changes;
use super::commands::{self, RawCommands};
use super::controller_link::RawController;
use super::diagnostics::{At, Diagnostics, Place};
use super::error::{LONGEST, MAX_FILES, MAX_GOALS, ScenarioError, VERSION};
use super::family::{RawSwarm, SectionKind, Sections};
use super::faults::{self, RawFault, Verb};
use super::hosts::RawHosts;
use super::link_between::{self, RawBetween};
use super::link_burst::{self, LinkDelay};
use super::operator::RawOperator;
use super::packed_files::PackedFiles;
use super::rescue;
use super::table::{Delay, Node, Section, delay, elements};
use super::{LinkKind, Overrides};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use metamorph_core::link::{Burst, LinkModel, Quantiles};
use metamorph_core::ratio::Ratio;
use metamorph_core::time::{Span, Time};
use metamorph_kernel::director::rescue::Rescue;
use metamorph_kernel::kernel::change::Change;
use std::sync::Arc;
use toml::de::DeTable;

/// A link as written.
#[derive(Clone, Debug, Default)]
pub struct RawLink {
    /// The shortest and the longest delay.
    pub delay: Option<At<Delay>>,
    /// The distribution of delays, if it is not uniform.
    pub quantiles: Option<Arc<Quantiles>>,
    /// The probability of loss.
    pub loss: Option<At<Ratio>>,
    /// The probability of duplication.
    pub duplicate: Option<At<Ratio>>,
    /// The probability of reordering.
    pub reorder: Option<At<Ratio>>,
    /// The probability of damage.
    pub corrupt: Option<At<Ratio>>,
    /// Spells in which the link is worse.
    pub burst: Option<Arc<Burst>>,
    /// The end of all impairments but the delay.
    pub until: Option<At<Span>>,
}

impl RawLink {
    /// Returns the longest delay within a burst.
    fn longest_within(&self) -> Span {
        self.burst.as_ref().and_then(|burst| burst.delay).map_or(Span::ZERO, |delay| delay.1)
    }

    /// Reads the delay and the probabilities.
    pub fn read_rates(section: &mut Section<'_, '_>, diagnostics: &mut Diagnostics) -> RawLink {
        let delay: Option<At<LinkDelay>> = section.get("delay", diagnostics);
        let quantiles = delay.as_ref().and_then(|delay| delay.value.quantiles.clone());
        let burst = section.node("burst").and_then(|node| link_burst::read(node, diagnostics));
        RawLink {
            delay: delay.map(|delay| At { value: delay.value.range, place: delay.place }),
            quantiles,
            burst,
            loss: section.get("loss", diagnostics),
            duplicate: section.get("duplicate", diagnostics),
            reorder: section.get("reorder", diagnostics),
            corrupt: section.get("corrupt", diagnostics),
            until: None,
        }
    }

    /// Checks the delay of each link, and returns the longest of them and of `usual`.
    pub fn longest_delay<'l>(
        links: impl Iterator<Item = &'l RawLink>,
        usual: Span,
        diagnostics: &mut Diagnostics,
    ) -> Span {
        links.fold(usual, |longest, link| {
            let longest = longest.max(link.longest_within());
            let Some(At { value: Delay(_, max), place }) = &link.delay else { return longest };
            if *max > LONGEST {
                let (got, low, high) = (max.to_string(), Span::ZERO.to_string(), LONGEST.to_string());
                diagnostics.add(place.clone(), ScenarioError::Range { what: "the delay", got, low, high });
            }
            longest.max(*max)
        })
    }

    /// Returns a link with what is written here, and otherwise as `default`.
    pub fn over(&self, default: &LinkModel) -> LinkModel {
        let ratio = |written: &Option<At<Ratio>>, default| written.as_ref().map_or(default, |r| r.value);
        let Delay(delay_min, delay_max) =
            self.delay.as_ref().map_or(Delay(default.delay_min, default.delay_max), |delay| delay.value);
        // Quantiles of the default are those of its delay.
        let quantiles = if self.delay.is_some() { &self.quantiles } else { &default.quantiles };
        LinkModel {
            delay_min,
            delay_max,
            quantiles: quantiles.clone(),
            burst: self.burst.clone().or_else(|| default.burst.clone()),
            loss: ratio(&self.loss, default.loss),
            duplicate: ratio(&self.duplicate, default.duplicate),
            reorder: ratio(&self.reorder, default.reorder),
            corrupt: ratio(&self.corrupt, default.corrupt),
            harmless_from: self
                .until
                .as_ref()
                .map_or(default.harmless_from, |at| Some(Time::ZERO + at.value)),
            ..default.clone()
        }
    }
}

/// A scenario as written, with the overrides of the command line.
#[derive(Debug)]
pub struct Raw {
    /// Its name.
    pub name: Option<String>,
    /// Its description.
    pub description: Option<String>,
    /// The seed of the run.
    pub seed: u64,
    /// The family's part; `None` if it could not be read.
    pub swarm: Option<Box<dyn RawSwarm>>,
    /// The probability that a move or a connection fails.
    pub failed_connections: Option<At<Ratio>>,
    /// The link.
    pub link: RawLink,
    /// Links of their own between some modules.
    pub between: Vec<RawBetween>,
    /// The link of orders and reports, if they take time.
    pub controller: Option<RawController>,
    /// The hosts, if the swarm is divided among several.
    pub hosts: Option<RawHosts>,
    /// Scenario seconds per second on the process link.
    pub time_scale: Option<At<f64>>,
    /// The faults.
    pub faults: Vec<RawFault>,
    /// The commands of operators.
    pub commands: Vec<RawCommands>,
    /// The operator.
    pub operator: Option<RawOperator>,
    /// The changes of the run.
    pub changes: Vec<At<Change>>,
    /// How far the controller helps a swarm that stands still.
    pub rescue: Rescue,
    /// The time-out of the run.
    pub timeout: Option<At<Span>>,
    /// The bound for a standstill.
    pub stall: Option<At<Span>>,
    /// The bound for moves without progress.
    pub livelock: Option<At<Span>>,
}

/// Default seed of a run.
pub const SEED: u64 = 1;
/// An example of a file that is part of the scenario.
const FILE: &str = "[[file]]\n    name = \"shape.stl\"\n    text = '''...'''";
const SWARM: &str = "[swarm]\n    start = { box = { min = [0, 0, 0], max = [5, 5, 0] } }";

impl Raw {
    /// Reads the whole document and the options. Invalid values are reported and left out. `elsewhere` returns a key of a family
    /// with the section that has it, such as `link.loss`.
    pub fn read(
        document: &DeTable<'_>,
        overrides: &Overrides,
        elsewhere: impl Fn(&str, &str) -> Option<String>,
        diagnostics: &mut Diagnostics,
    ) -> Raw {
        let mut top = Section::new(document, "the scenario", Place::File);
        match top.need::<i64>("version", "version = 1", diagnostics) {
            Some(At { value, place }) if value > VERSION as i64 => {
                // The rules of this version do not apply to the rest.
                diagnostics.add(place, ScenarioError::Newer { found: value });
                return Raw::empty(overrides);
            }
            Some(At { value, place }) if value < 1 => {
                let scenario_error = ScenarioError::Range {
                    what: "the version",
                    got: value.to_string(),
                    low: "1".into(),
                    high: VERSION.to_string(),
                };
                diagnostics.add(place, scenario_error);
            }
            _ => {}
        }
        // Before the sections that name files.
        if let Some(node) = top.node("file") {
            let packed = packed_files(node, diagnostics);
            diagnostics.set_packed(packed);
        }
        let mut raw = Raw::empty(overrides);
        raw.name = top.get("name", diagnostics).map(|n| n.value);
        raw.description = top.get("description", diagnostics).map(|d| d.value);
        let seed = top.get::<u64>("seed", diagnostics).map_or(SEED, |s| s.value);
        raw.seed = overrides.seed.unwrap_or(seed);
        let swarm = top.node("swarm");
        let others = Sections { goals: top.node("goal"), protocol: top.node("protocol") };
        if swarm.is_none() {
            top.missing("swarm", SWARM, diagnostics);
        }
        let families = diagnostics.families();
        let mut family = families.all[0];
        if let Some(mut section) = swarm.and_then(|node| Section::of(node, "[swarm]", SWARM, diagnostics)) {
            let known: Vec<_> = families.all.iter().map(|family| (family.name(), *family)).collect();
            family = section.choice("family", "family", &known, diagnostics).unwrap_or(family);
            diagnostics.set_family(family.name());
            section.differs_between_families(SectionKind::Swarm);
            raw.failed_connections = section.get("failed_connections", diagnostics);
            raw.swarm = Some(family.read(section, &others, diagnostics));
        }
        match others.goals {
            None if family.needs_goal() => diagnostics.add(Place::File, ScenarioError::NoGoal),
            Some(goals) if !family.needs_goal() => {
                diagnostics.add(goals.span(), ScenarioError::GoalOfProtocol(family.name()));
            }
            _ => {}
        }
        if let Some(node) = top.node("link") {
            raw.read_link(node, diagnostics);
        }
        if let Some(node) = top.node("process") {
            raw.read_process(node, diagnostics);
        }
        if let Some(node) = top.node("fault") {
            raw.faults = faults::read(node, family, diagnostics);
        }
        if let Some(node) = top.node("command") {
            raw.commands = commands::read(node, family, diagnostics);
        }
        if let Some(node) = top.node("operator") {
            raw.operator = RawOperator::read(node, diagnostics);
            let place = raw.operator.iter().find(|_| !family.is_operated()).map(|raw| raw.place.clone());
            if let Some(place) = place {
                let what = format!("an operator of the family `{}`", family.name());
                let instead = "remove [operator], and give commands by the page or in [[command]]";
                diagnostics.add(place, ScenarioError::NotYet { what, instead });
            }
        }
        if let Some(node) = top.node("controller") {
            raw.rescue = rescue::read(node, diagnostics).unwrap_or_default();
        }
        if let Some(node) = top.node("change") {
            raw.changes = changes::read(node, diagnostics);
        }
        if let Some(node) = top.node("stop") {
            raw.read_stop(node, diagnostics);
        }
        let family = diagnostics.family();
        top.finish_with(diagnostics, |key| elsewhere(key, family));
        raw.override_with(overrides, diagnostics);
        raw
    }

    fn empty(overrides: &Overrides) -> Raw {
        Raw {
            name: None,
            description: None,
            seed: overrides.seed.unwrap_or(SEED),
            swarm: None,
            failed_connections: None,
            link: RawLink::default(),
            between: Vec::new(),
            controller: None,
            hosts: None,
            time_scale: None,
            faults: Vec::new(),
            commands: Vec::new(),
            operator: None,
            changes: Vec::new(),
            rescue: Rescue::default(),
            timeout: None,
            stall: None,
            livelock: None,
        }
    }

    fn read_link(&mut self, node: &Node<'_>, diagnostics: &mut Diagnostics) {
        let Some(mut section) = Section::of(node, "[link]", "loss = \"5%\"", diagnostics) else { return };
        self.link = RawLink::read_rates(&mut section, diagnostics);
        self.link.until = section.get("until", diagnostics);
        self.between =
            section.node("between").map_or_else(Vec::new, |node| link_between::read(node, diagnostics));
        self.controller = section.node("controller").and_then(|node| RawController::read(node, diagnostics));
        self.hosts = section.node("between_hosts").and_then(|node| RawHosts::read(node, diagnostics));
        section.finish(diagnostics);
    }

    fn read_process(&mut self, node: &Node<'_>, diagnostics: &mut Diagnostics) {
        let Some(mut section) = Section::of(node, "[process]", "time_scale = 20", diagnostics) else {
            return;
        };
        self.time_scale = section.get("time_scale", diagnostics);
        section.finish(diagnostics);
    }

    fn read_stop(&mut self, node: &Node<'_>, diagnostics: &mut Diagnostics) {
        let Some(mut section) = Section::of(node, "[stop]", "timeout = \"1000s\"", diagnostics) else {
            return;
        };
        self.timeout = section.get("timeout", diagnostics);
        self.stall = section.get("stall", diagnostics);
        self.livelock = section.get("livelock", diagnostics);
        section.finish(diagnostics);
    }

    /// Applies the overrides of the command line; its faults are added to the scenario's.
    fn override_with(&mut self, overrides: &Overrides, diagnostics: &mut Diagnostics) {
        for (verb, name, texts) in [
            (Verb::Kill, "--kill", &overrides.kill),
            (Verb::Pause, "--pause", &overrides.pause),
            (Verb::Restart, "--restart", &overrides.restart),
        ] {
            self.faults.extend(texts.iter().filter_map(|t| faults::read_option(verb, name, t, diagnostics)));
        }
        let partitions = overrides.partition.iter();
        self.faults.extend(partitions.filter_map(|text| faults::read_partition_option(text, diagnostics)));
        let changes = overrides.change.iter();
        self.changes.extend(changes.filter_map(|text| changes::read_option(text, diagnostics)));
        for (name, text, target) in [
            ("--loss", &overrides.loss, &mut self.link.loss),
            ("--dup", &overrides.duplicate, &mut self.link.duplicate),
            ("--reorder", &overrides.reorder, &mut self.link.reorder),
        ] {
            if let Some(text) = text {
                let place = Place::Option(format!("{name} {text}"));
                *target = diagnostics.note(&place, text.parse::<Ratio>()).map(|ratio| At::new(ratio, place));
            }
        }
        if let Some(text) = &overrides.delay {
            let place = Place::Option(format!("--delay {text}"));
            self.link.quantiles = None;
            self.link.delay =
                diagnostics.note(&place, delay(text)).map(|(min, max)| At::new(Delay(min, max), place));
        }
        if let Some(text) = &overrides.time_scale {
            let place = Place::Option(format!("--time-scale {text}"));
            match text.parse::<f64>() {
                Ok(scale) => self.time_scale = Some(At::new(scale, place)),
                Err(_) => diagnostics.add(place, ScenarioError::Form(text.clone(), "X, a number such as 20")),
            }
        }
    }
}

/// Reads the files that the scenario has itself, at most the allowed number.
fn packed_files(node: &Node<'_>, diagnostics: &mut Diagnostics) -> PackedFiles {
    let mut files = PackedFiles::default();
    for node in elements(node, FILE, diagnostics).into_iter().flat_map(|all| all.iter()) {
        if files.count() >= MAX_FILES {
            diagnostics.add(node.span(), ScenarioError::TooManyFiles);
            break;
        }
        let Some((name, content)) = packed_file(node, diagnostics) else { continue };
        if !files.add(name.clone(), content) {
            diagnostics.add(node.span(), ScenarioError::FileTwice(name));
        }
    }
    files
}

/// Decodes Base64 after RFC 4648, in which white space has no meaning; `None` if it is none.
fn decoded(text: &str) -> Option<Vec<u8>> {
    let digits: Vec<u8> = text.bytes().filter(|byte| !byte.is_ascii_whitespace()).collect();
    STANDARD.decode(digits).ok()
}

fn packed_file(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<(String, Vec<u8>)> {
    let mut section = Section::of(node, "[[file]]", FILE, diagnostics)?;
    let name = section.need::<String>("name", "name = \"shape.stl\"", diagnostics);
    let text = section.get::<String>("text", diagnostics);
    let encoded = section.get::<String>("base64", diagnostics);
    let place = section.place().clone();
    section.finish(diagnostics);
    let content = match (text, encoded) {
        (Some(text), None) => text.value.into_bytes(),
        (None, Some(encoded)) => {
            let decoded = decoded(&encoded.value).ok_or(ScenarioError::NotBase64);
            diagnostics.note(&encoded.place, decoded)?
        }
        (text, _) => {
            let found = if text.is_some() { "both" } else { "neither" };
            let expected = "one of `text` and `base64`";
            diagnostics.add(place, ScenarioError::Kind { expected, found, example: FILE });
            return None;
        }
    };
    Some((name?.value, content))
}

/// Returns the `[[goal]]` tables, at most the allowed number.
pub fn goal_sections<'d, 'i>(
    node: Option<&'d Node<'i>>,
    example: &'static str,
    diagnostics: &mut Diagnostics,
) -> Vec<Section<'d, 'i>> {
    let Some(array) = node.and_then(|node| elements(node, "[[goal]]", diagnostics)) else {
        return Vec::new();
    };
    let place = || node.map_or(Place::File, |node| node.span().into());
    if array.is_empty() {
        diagnostics.add(place(), ScenarioError::NoGoal);
    }
    if array.len() > MAX_GOALS {
        diagnostics.add(place(), ScenarioError::TooManyGoals(array.len()));
    }
    let goals = array.iter().take(MAX_GOALS);
    let mut sections: Vec<_> =
        goals.filter_map(|goal| Section::of(goal, "[[goal]]", example, diagnostics)).collect();
    sections.iter_mut().for_each(|section| section.differs_between_families(SectionKind::Goal));
    sections
}

/// Returns the `[protocol]` table, if there is one.
pub fn protocol_section<'d, 'i>(
    node: Option<&'d Node<'i>>,
    example: &'static str,
    diagnostics: &mut Diagnostics,
) -> Option<Section<'d, 'i>> {
    let mut section = Section::of(node?, "[protocol]", example, diagnostics)?;
    section.differs_between_families(SectionKind::Protocol);
    Some(section)
}

/// Returns the default delay: on the simulated link from a hundredth to a tenth of a move; on the process
/// link none besides the real one.
pub fn default_delay(link: LinkKind, move_time: Span) -> Delay {
    match link {
        LinkKind::Sim => Delay(move_time / 100, move_time / 10),
        LinkKind::Ipc => Delay(Span::ZERO, Span::ZERO),
    }
}
