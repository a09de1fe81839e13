//! `[link.between_hosts]`: the hosts of a swarm, which modules are at home on each, and the links between hosts.
//! Absent: faults of hosts (`faults`).

use super::bounds::ONE;
use super::definitions::{Definitions, of, said, table, text};
use super::diagnostics::{At, Diagnostics, Place};
use super::error::{LONGEST, ScenarioError};
use super::placement;
use super::raw::RawLink;
use super::table::{Node, Read, Section, elements, span, wrong};
use metamorph_core::ids::{HostId, ModuleId};
use metamorph_core::link::{Burst, ClockOffset, Hosts, LinkModel, Lost};
use metamorph_core::time::{Span, Time};
use serde_json::json;
use std::iter::repeat_n;
use std::sync::Arc;
use thiserror::Error;
use toml::de::DeValue;

/// Largest number of hosts of one swarm.
pub const MAX_HOSTS: usize = 256;
/// How late a clock of another machine may be read (real time).
const READING: Span = Span::millis(1);
/// Time after which a host that is down counts as lost (scenario time), unless the scenario says otherwise.
const FENCE: Span = Span::secs(10);
/// Smallest time difference between clocks of several machines that protocols have to tolerate.
const LEAST_SKEW: Span = Span::millis(5);
const PAIR: &str = "hosts = [\"h1\", \"h2\"]";

/// A problem with the hosts of a scenario.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum HostsProblem {
    /// A name that is not that of a host.
    #[error("there is no host `{name}`; the swarm has {}", names(*hosts))]
    Unknown {
        /// The name.
        name: String,
        /// The number of hosts; 0 if the scenario does not divide the swarm among hosts.
        hosts: usize,
    },
    /// A link needs two ends.
    #[error("both ends are {0}")]
    SameHost(HostId),
    /// The numbers of modules per host do not add up.
    #[error("the hosts have {sum} modules together, and the swarm has {modules}; each host has at least one")]
    Sizes {
        /// The sum of the numbers.
        sum: u64,
        /// Modules of the swarm.
        modules: usize,
    },
    /// A clock is missing or one too many.
    #[error("{found} clocks are given for {hosts} hosts")]
    Clocks {
        /// Clocks given.
        found: usize,
        /// The number of hosts.
        hosts: usize,
    },
    /// The controller's clock is the reference.
    #[error("the clock of {} is the controller's, with which the others are compared", HostId::CONTROLLER)]
    Reference,
    /// A key that concerns what happens after the loss of a host, where nothing happens.
    #[error("`{0}` counts only if the modules of a lost host are started elsewhere")]
    NeedsElsewhere(&'static str),
    /// There is no host left for the modules of the others.
    #[error("all hosts are down at {0}, so that no host is left for the modules")]
    NoneLeft(Time),
    /// A host is killed while it is down.
    #[error("{0} is down already at {1}")]
    DownAlready(HostId, Time),
    /// The clocks differ by more than the protocol has time for.
    #[error(
        "clocks differ by up to {skew}; {most} is the maximum, a quarter of the time in which an action may start"
    )]
    Skew {
        /// The largest difference from the controller's clock.
        skew: Span,
        /// The maximum.
        most: Span,
        /// The largest `time_scale` that works, in thousandths, if `clock_error` leaves one.
        scale: Option<u64>,
    },
}

impl HostsProblem {
    /// Returns what to do about it.
    pub fn fix(&self) -> String {
        match self {
            HostsProblem::Unknown { hosts: 0, .. } => {
                "divide the swarm among hosts first, with\n    [link.between_hosts]\n    hosts = 3".into()
            }
            HostsProblem::Unknown { hosts, .. } => format!("name one of {}", names(*hosts)),
            HostsProblem::SameHost(_) => "name two different hosts".into(),
            HostsProblem::Sizes { .. } => {
                "write numbers that add up, or only how many hosts there are".into()
            }
            HostsProblem::Clocks { hosts, .. } => format!("write {hosts} times"),
            HostsProblem::Reference => "write `0s` as the first time".into(),
            HostsProblem::NeedsElsewhere(_) => {
                "add `lost = \"elsewhere\"` to [link.between_hosts], or remove the key".into()
            }
            HostsProblem::NoneLeft(_) => "let one of them come back before, with `until`".into(),
            HostsProblem::DownAlready(..) => "let it come back before, with `until`".into(),
            HostsProblem::Skew { scale: Some(thousandths), .. } => {
                let scale = *thousandths as f64 / 1_000.0;
                format!(
                    "lower `time_scale` to {scale} or less, make moves longer, or write a smaller `clock_error`"
                )
            }
            HostsProblem::Skew { scale: None, .. } => {
                "write smaller differences, or make moves longer".into()
            }
        }
    }
}

fn names(hosts: usize) -> String {
    match hosts {
        0 => "one host, which has no name".into(),
        1 => HostId::CONTROLLER.to_string(),
        _ => format!("{} to h{hosts}", HostId::CONTROLLER),
    }
}

/// How the modules are divided.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Division {
    /// Equal blocks of module numbers for this many hosts.
    Equal(u64),
    /// Blocks of module numbers with these sizes.
    Blocks(Vec<u64>),
}

impl Division {
    fn hosts(&self) -> usize {
        match self {
            Division::Equal(count) => usize::try_from(*count).unwrap_or(usize::MAX),
            Division::Blocks(sizes) => sizes.len(),
        }
    }

    /// Returns the number of modules on each host.
    fn sizes(&self, modules: usize) -> Vec<usize> {
        match self {
            Division::Equal(_) => {
                let hosts = self.hosts();
                (0..hosts).map(|i| modules / hosts + usize::from(i < modules % hosts)).collect()
            }
            Division::Blocks(sizes) => sizes.iter().map(|size| *size as usize).collect(),
        }
    }
}

/// Which modules are at home on which host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Placement {
    /// Blocks of module numbers.
    #[default]
    Blocks,
    /// Parts of the start with few contacts between them.
    Cut,
}

/// The words for the loss of a host, and whether its modules are started elsewhere.
const LOST: [(&str, bool); 2] = [("crash", false), ("elsewhere", true)];

const PLACEMENTS: [(&str, Placement); 2] = [("blocks", Placement::Blocks), ("cut", Placement::Cut)];

impl Placement {
    /// Returns the home of each module.
    fn homes(self, sizes: &[usize], contacts: Option<Vec<(ModuleId, ModuleId)>>) -> Vec<HostId> {
        match (self, contacts) {
            (Placement::Cut, Some(contacts)) => placement::cut(&contacts, sizes),
            // Invariant: there are fewer than 2^16 hosts.
            _ => (0u16..).zip(sizes).flat_map(|(host, size)| repeat_n(HostId(host), *size)).collect(),
        }
    }
}

impl Read for Division {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Division> {
        match node.get_ref() {
            DeValue::Array(array) => {
                let sizes = array.iter().map(|size| u64::read(size, diagnostics));
                Some(Division::Blocks(sizes.collect::<Option<_>>()?))
            }
            _ => u64::read(node, diagnostics).map(Division::Equal),
        }
    }
}

/// A time that may be negative.
struct Offset(ClockOffset);

impl Read for Offset {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Offset> {
        let DeValue::String(text) = node.get_ref() else {
            diagnostics.add(node.span(), wrong("a time", node.get_ref(), "\"-8ms\""));
            return None;
        };
        let (digits, sign) = text.strip_prefix('-').map_or((&**text, 1), |digits| (digits, -1));
        let value = diagnostics.note(&node.span().into(), span(digits))?;
        // A longer time is out of range in any case.
        Some(Offset(ClockOffset(sign * i64::try_from(value.0).unwrap_or(i64::MAX))))
    }
}

/// Two hosts by name, not checked yet.
pub type Pair = [At<String>; 2];

/// `[link.between_hosts]` as written.
#[derive(Clone, Debug)]
pub struct RawHosts {
    place: Place,
    division: Option<At<Division>>,
    placement: Placement,
    link: RawLink,
    skew: Option<At<Vec<ClockOffset>>>,
    clock_error: Option<At<Span>>,
    is_elsewhere: bool,
    fence: Option<At<Span>>,
    pairs: Vec<(Pair, RawLink)>,
}

impl RawHosts {
    /// Reads the table.
    pub fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<RawHosts> {
        let mut section = Section::of(node, "[link.between_hosts]", "hosts = 3", diagnostics)?;
        let division = section.need("hosts", "hosts = 3", diagnostics);
        let placement =
            section.choice("placement", "placement", &PLACEMENTS, diagnostics).unwrap_or_default();
        let link = RawLink::read_rates(&mut section, diagnostics);
        let skew = section.node("skew").and_then(|node| {
            let clocks = elements(node, "skew = [\"0s\", \"12ms\"]", diagnostics)?;
            let clocks = clocks.iter().map(|clock| Offset::read(clock, diagnostics).map(|o| o.0));
            Some(At::new(clocks.collect::<Option<Vec<_>>>()?, node.span()))
        });
        let clock_error = section.get("clock_error", diagnostics);
        let is_elsewhere = section.choice("lost", "lost", &LOST, diagnostics).unwrap_or_default();
        let fence: Option<At<Span>> = section.get("fence", diagnostics);
        if let Some(At { place, .. }) = fence.as_ref().filter(|_| !is_elsewhere) {
            diagnostics.add(place.clone(), HostsProblem::NeedsElsewhere("fence"));
        }
        let pairs =
            section.node("pair").and_then(|node| elements(node, "[[link.between_hosts.pair]]", diagnostics));
        let pairs = pairs.into_iter().flat_map(|array| array.iter());
        let pairs = pairs.filter_map(|node| read_pair(node, diagnostics)).collect();
        section.finish(diagnostics);
        let place = node.span().into();
        Some(RawHosts { place, division, placement, link, skew, clock_error, is_elsewhere, fence, pairs })
    }

    /// Returns the place of the table.
    pub fn place(&self) -> &Place {
        &self.place
    }

    /// Iterates over the links between hosts, as written.
    pub fn links(&self) -> impl Iterator<Item = &RawLink> {
        std::iter::once(&self.link).chain(self.pairs.iter().map(|(_, link)| link))
    }

    /// Returns a link that is as bad as the worst of all, within hosts and between them.
    pub fn worst(&self, within: &LinkModel) -> LinkModel {
        let between = self.link.over(within);
        let pairs = self.pairs.iter().map(|(_, link)| link.over(&between));
        worst(within, pairs.chain([between.clone()]))
    }

    /// Returns the largest difference of a clock from the controller's.
    pub fn skew(&self) -> Span {
        let clocks = self.skew.iter().flat_map(|skew| &skew.value);
        Span(clocks.map(|clock| clock.0.unsigned_abs()).max().unwrap_or(0))
    }

    /// Returns the scenario time by which clocks of several machines may differ at `speed`: both of two clocks may be off,
    /// and are read up to [`READING`] late.
    fn uncertainty(&self, speed: f64) -> Span {
        let Some(At { value, .. }) = self.clock_error else { return Span::ZERO };
        // The speed is bounded, and thousandths are precise enough.
        let thousandths = (speed * 1_000.0).round().clamp(1.0, 1e9) as u64;
        ((value.min(LONGEST) + READING) * 2 * thousandths / 1_000).max(LEAST_SKEW)
    }

    /// Returns the difference of clocks that protocols have to bear.
    pub fn borne(&self, speed: f64) -> Span {
        self.skew() + self.uncertainty(speed)
    }

    /// Returns the largest speed, in thousandths, at which clocks of several machines differ by at most `most`.
    fn largest_scale(&self, most: Span) -> Option<u64> {
        let room = most.0.checked_sub(self.skew().0)?;
        let per_speed = (self.clock_error.as_ref()?.value.min(LONGEST) + READING).0 * 2;
        let thousandths = u64::try_from(u128::from(room) * 1_000 / u128::from(per_speed)).ok()?;
        (room >= LEAST_SKEW.0 && thousandths > 0).then_some(thousandths)
    }

    /// Checks that actions can start in time although clocks differ; `start_within` is the time they have otherwise.
    pub fn check_skew(&self, speed: f64, start_within: Span, diagnostics: &mut Diagnostics) {
        let (skew, most) = (self.borne(speed), start_within / 4);
        let place = self.skew.as_ref().map(|skew| &skew.place);
        let place = place.or(self.clock_error.as_ref().map(|error| &error.place));
        if let Some(place) = place.filter(|_| skew > most) {
            let scale = self.largest_scale(most);
            diagnostics.add(place.clone(), HostsProblem::Skew { skew, most, scale });
        }
    }

    /// Returns the hosts. Links have the rates of `within` unless the scenario says otherwise.
    pub fn compile(
        &self,
        within: &LinkModel,
        modules: usize,
        contacts: impl FnOnce() -> Option<Vec<(ModuleId, ModuleId)>>,
        diagnostics: &mut Diagnostics,
    ) -> Option<Hosts> {
        let At { value: division, place } = self.division.as_ref()?;
        let (hosts, most) = (division.hosts(), MAX_HOSTS.min(modules));
        if !(1..=most).contains(&hosts) {
            let (got, low, high) = (hosts.to_string(), "1".into(), most.to_string());
            let what = "the number of hosts";
            diagnostics.add(place.clone(), ScenarioError::Range { what, got, low, high });
            return None;
        }
        if let Division::Blocks(sizes) = division {
            let sum = sizes.iter().fold(0u64, |sum, size| sum.saturating_add(*size));
            if sum != modules as u64 || sizes.contains(&0) {
                diagnostics.add(place.clone(), HostsProblem::Sizes { sum, modules });
                return None;
            }
        }
        let clocks = self.clocks(hosts, diagnostics)?;
        let between = self.link.over(&LinkModel { partitions: Vec::new(), hosts: None, ..within.clone() });
        let mut links: Vec<LinkModel> = Hosts::pairs(hosts).map(|_| between.clone()).collect();
        for (pair, raw) in &self.pairs {
            let (a, b) = pair_of(pair, hosts, diagnostics)?;
            let index = Hosts::pairs(hosts).position(|(low, high)| (low, high) == (a.min(b), a.max(b)));
            // Invariant: the hosts exist and differ.
            links[index?] = raw.over(&between);
        }
        let contacts = if self.placement == Placement::Cut { contacts() } else { None };
        let homes = self.placement.homes(&division.sizes(modules), contacts);
        let fence = self.fence.as_ref().map_or(FENCE, |fence| fence.value);
        let lost = if self.is_elsewhere { Lost::Elsewhere { fence } } else { Lost::Crash };
        Hosts::new(homes, clocks, links).ok().map(|hosts| hosts.with_lost(lost))
    }

    fn clocks(&self, hosts: usize, diagnostics: &mut Diagnostics) -> Option<Vec<ClockOffset>> {
        let Some(At { value: clocks, place }) = &self.skew else {
            return Some(vec![ClockOffset::default(); hosts]);
        };
        let problem = if clocks.len() != hosts {
            HostsProblem::Clocks { found: clocks.len(), hosts }
        } else if clocks.first() != Some(&ClockOffset::default()) {
            HostsProblem::Reference
        } else {
            return Some(clocks.clone());
        };
        diagnostics.add(place.clone(), problem);
        None
    }
}

/// Returns a link that is as bad as the worst of these.
pub fn worst(first: &LinkModel, others: impl Iterator<Item = LinkModel>) -> LinkModel {
    others.fold(first.clone(), |worst, link| LinkModel {
        loss: worst.loss.larger(link.loss),
        reorder: worst.reorder.larger(link.reorder),
        corrupt: worst.corrupt.larger(link.corrupt),
        burst: [&worst.burst, &link.burst].into_iter().flatten().max_by_key(lost_within).cloned(),
        ..worst
    })
}

/// Returns the part of the messages within bursts that are lost, in units of 1/[`ONE`].
fn lost_within(burst: &&Arc<Burst>) -> u64 {
    u64::from(burst.loss.num()) * ONE / u64::from(burst.loss.den())
}

fn read_pair(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<(Pair, RawLink)> {
    let mut section = Section::of(node, "[[link.between_hosts.pair]]", PAIR, diagnostics)?;
    let hosts = match section.node("hosts") {
        Some(hosts) => read_names(hosts, diagnostics),
        None => {
            section.missing("hosts", PAIR, diagnostics);
            None
        }
    };
    let link = RawLink::read_rates(&mut section, diagnostics);
    section.finish(diagnostics);
    Some((hosts?, link))
}

/// Reads the names of two hosts.
pub fn read_names(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Pair> {
    let names = elements(node, PAIR, diagnostics)?;
    let names =
        names.iter().map(|name| String::read(name, diagnostics).map(|text| At::new(text, name.span())));
    let names: Vec<_> = names.collect::<Option<_>>()?;
    let pair = Pair::try_from(names);
    if pair.is_err() {
        let (expected, found) = ("the names of two hosts", "a list of another length");
        diagnostics.add(node.span(), ScenarioError::Kind { expected, found, example: PAIR });
    }
    pair.ok()
}

/// Returns the host with this name; `hosts` is the number of hosts.
pub fn host_of(name: &At<String>, hosts: usize, diagnostics: &mut Diagnostics) -> Option<HostId> {
    let host = HostId::from_name(&name.value).filter(|host| host.index() < hosts);
    if host.is_none() {
        let text = name.value.chars().take(40).collect();
        diagnostics.add(name.place.clone(), HostsProblem::Unknown { name: text, hosts });
    }
    host
}

/// Returns two different hosts; `hosts` is the number of hosts.
pub fn pair_of(pair: &Pair, hosts: usize, diagnostics: &mut Diagnostics) -> Option<(HostId, HostId)> {
    let [a, b] = pair.each_ref().map(|name| host_of(name, hosts, diagnostics));
    let (a, b) = (a?, b?);
    if a == b {
        diagnostics.add(pair[1].place.clone(), HostsProblem::SameHost(a));
        return None;
    }
    Some((a, b))
}

/// Adds the keys of every link to those of one, for the JSON schema.
pub fn rates(mut own: serde_json::Value, otherwise: &str) -> serde_json::Value {
    let rate = |kind| said(&format!("If left out, as {otherwise}."), of(kind));
    own["delay"] = rate("link-delay");
    own["burst"] = rate("burst");
    for key in ["loss", "duplicate", "reorder", "corrupt"] {
        own[key] = rate("probability");
    }
    own
}

/// Returns the definitions of the hosts, for the JSON schema.
pub fn schema() -> Definitions {
    let sizes =
        json!({ "type": "array", "items": { "type": "integer", "minimum": 1 }, "maxItems": MAX_HOSTS });
    let number = json!({ "type": "integer", "minimum": 1, "maximum": MAX_HOSTS });
    vec![
        (
            "host",
            said("The name of a host: h1, h2 and so on.", json!({ "type": "string", "pattern": "^h[1-9]" })),
        ),
        ("two-hosts", json!({ "type": "array", "items": of("host"), "minItems": 2, "maxItems": 2 })),
        (
            "between_hosts",
            table(
                "The hosts that the simulated swarm is divided among, and the links between them.",
                &["hosts"],
                rates(
                    json!({
                        "hosts": said(
                            "How many, each with an equal block of module numbers; or the number of modules on each.",
                            json!({ "anyOf": [number, sizes] }),
                        ),
                        "placement": said(
                            "Which modules are on which host: blocks of module numbers, or parts of the start with few \
                             contacts between them (cut). Default: blocks.",
                            json!({ "enum": ["blocks", "cut"] }),
                        ),
                        "skew": said(
                            "How far the clock of each host is ahead of that of h1, such as 12ms or -8ms. If left \
                             out, all clocks agree.",
                            json!({ "type": "array", "items": text() }),
                        ),
                        "clock_error": said(
                            "How far the clock of another machine may be off (real time); set by the hosts file. If left \
                             out, there is one clock.",
                            of("time"),
                        ),
                        "lost": said(
                            "The modules of a host that is lost: they have crashed (crash), or start on other hosts \
                             without their memory (elsewhere). Default: crash.",
                            json!({ "enum": ["crash", "elsewhere"] }),
                        ),
                        "fence": said(
                            "How long a host is down before it counts as lost, on the simulated link; between machines \
                             the hosts file says it. Only with lost = \"elsewhere\". Default: 10s.",
                            of("time"),
                        ),
                        "pair": said(
                            "Links of two hosts that differ from the others. If left out, all are alike.",
                            json!({ "type": "array", "items": of("host-pair") }),
                        ),
                    }),
                    "within a host",
                ),
            ),
        ),
        (
            "host-pair",
            table(
                "The link of two hosts.",
                &["hosts"],
                rates(json!({ "hosts": said("The two hosts.", of("two-hosts")) }), "between the other hosts"),
            ),
        ),
    ]
}
