//! The part of the report about hosts: which there were, and what crossed from one to another.

use metamorph_core::ids::HostId;
use metamorph_core::link::{HostChange, Hosts};
use metamorph_kernel::director::faults::{Fault, FaultRecord};
use metamorph_kernel::kernel::sim::{Crossed, Crossings};
use metamorph_scenario::Plan;
use metamorph_text::format::{bytes, count, many, whole_percent};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write;

/// The hosts of a swarm that is divided among several, and what crossed from one to another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HostsReport {
    /// The hosts; the first is the controller's.
    pub hosts: Vec<HostReport>,
    /// What crossed, by sender and receiver; pairs between which nothing crossed are left out.
    pub crossed: Vec<CrossedReport>,
}

/// One host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HostReport {
    /// Its name.
    pub name: String,
    /// Modules at home on it.
    pub modules: u64,
    /// How far its clock is ahead of the controller's; negative if it is behind.
    pub clock_s: f64,
    /// Time at which it was lost with all its processes; null if it was not.
    #[serde(default)]
    pub lost_s: Option<f64>,
    /// Why it counts as lost; null if it does not.
    #[serde(default)]
    pub lost_why: Option<String>,
}

/// What crossed from one host to another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CrossedReport {
    /// The host of the senders.
    pub from: String,
    /// The host of the receivers.
    pub to: String,
    /// Protocol messages of all classes.
    pub all: CrossedCounts,
    /// Protocol messages by class; classes of which none crossed are left out.
    pub by_class: BTreeMap<String, CrossedCounts>,
    /// Actions and reports, if `to` is the controller's host; percepts, contact changes and orders, if `from`
    /// is. They are not protocol messages.
    pub body_messages: u64,
}

/// Protocol messages that crossed, as the sender counts them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CrossedCounts {
    /// Handed to the link.
    pub sent: u64,
    /// Lost in transit, or cut off.
    pub lost: u64,
    /// Extra copies made in transit.
    pub duplicated: u64,
    /// Damaged in transit and refused.
    pub refused: u64,
    /// Bytes of the messages sent, headers included.
    pub bytes: u64,
}

impl HostsReport {
    /// Creates the report of a run with the faults that struck; `None` if there was one host only.
    pub fn of(plan: &Plan, struck: &[FaultRecord], crossings: &Crossings) -> Option<HostsReport> {
        let hosts = plan.link.hosts.as_deref()?;
        // Invariant: there are fewer than 2^16 hosts.
        let all = (0..hosts.len() as u16).map(HostId);
        Some(HostsReport {
            hosts: all.map(|host| self::host(hosts, struck, host)).collect(),
            crossed: crossings.iter().map(|(pair, crossed)| self::crossed(*pair, crossed)).collect(),
        })
    }

    /// Writes it as text; `total` is the number of protocol messages of the run.
    pub fn write(&self, out: &mut String, total: u64) -> std::fmt::Result {
        let sum = |of: fn(&CrossedReport) -> u64| self.crossed.iter().map(of).sum::<u64>();
        let sent = sum(|c| c.all.sent);
        writeln!(
            out,
            "  {} messages crossed between {} ({} of all), {} lost; {}; besides, {} to and from bodies",
            count(sent),
            many(self.hosts.len() as u64, "host"),
            whole_percent(sent, total),
            count(sum(|c| c.all.lost)),
            bytes(sum(|c| c.all.bytes)),
            count(sum(|c| c.body_messages))
        )
    }
}

fn host(hosts: &Hosts, struck: &[FaultRecord], host: HostId) -> HostReport {
    let lost = struck.iter().find(|record| record.fault == Fault::Host(host, HostChange::Lost));
    let why = lost.and_then(|record| record.effect.split_once(": "));
    HostReport {
        name: host.to_string(),
        modules: hosts.modules(host).count() as u64,
        clock_s: hosts.clock(host).0 as f64 / 1e9,
        lost_s: lost.map(|record| record.at.as_secs_f64()),
        lost_why: why.map(|(_, why)| why.to_owned()),
    }
}

fn crossed((from, to): (HostId, HostId), crossed: &Crossed) -> CrossedReport {
    let counts = |c: &metamorph_core::counters::Counts| CrossedCounts {
        sent: c.sent,
        lost: c.lost,
        duplicated: c.duplicated,
        refused: c.refused,
        bytes: c.bytes,
    };
    let classes = crossed.messages.iter().filter(|(_, c)| c.sent > 0);
    CrossedReport {
        from: from.to_string(),
        to: to.to_string(),
        all: counts(&crossed.messages.total()),
        by_class: classes.map(|(class, c)| (class.name().to_owned(), counts(c))).collect(),
        body_messages: crossed.body_messages,
    }
}
