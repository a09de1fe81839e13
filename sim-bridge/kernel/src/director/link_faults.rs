//! Commands that change the links between modules for a while, as text and as data: messages are lost, and modules are cut
//! off from the others.

use crate::director::steering::{LEASE, read_lease, write_lease};
use metamorph_core::ids::ModuleId;
use metamorph_core::link::LinkChanges;
use metamorph_core::ratio::Ratio;
use metamorph_core::time::Span;
use std::fmt;

/// A change of the links.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LinkFault {
    /// Messages are lost with this probability.
    Loss(Ratio, Span),
    /// They are lost as the scenario says.
    LossEnds,
    /// No message passes between these modules, from the first to the last, and all others.
    Partition(ModuleId, ModuleId, Span),
    /// Messages pass.
    PartitionEnds,
}

impl LinkFault {
    /// The verbs.
    pub const VERBS: [&str; 2] = ["loss", "partition"];

    /// Reads a command without its verb, such as `loss` and `5% for 30s`. `None` if it is none.
    pub fn parse(verb: &str, rest: &str) -> Option<LinkFault> {
        let rest = rest.trim();
        let (what, lease) = match rest.split_once("for ") {
            Some((what, lease)) => (what.trim(), read_lease(lease)?),
            None => (rest, LEASE),
        };
        match (verb, rest) {
            ("loss", "off") => Some(LinkFault::LossEnds),
            ("partition", "off") => Some(LinkFault::PartitionEnds),
            ("loss", _) => Some(LinkFault::Loss(what.parse().ok()?, lease)),
            ("partition", _) => {
                let (first, last) = what.split_once("..").unwrap_or((what, what));
                let (first, last) = (first.trim().parse().ok()?, last.trim().parse().ok()?);
                (first <= last).then_some(LinkFault::Partition(ModuleId(first), ModuleId(last), lease))
            }
            _ => None,
        }
    }
    /// The verb.
    pub const fn verb(self) -> &'static str {
        match self {
            LinkFault::Loss(..) | LinkFault::LossEnds => "loss",
            LinkFault::Partition(..) | LinkFault::PartitionEnds => "partition",
        }
    }
    /// Returns the module with the largest number that it names.
    pub const fn last_module(self) -> Option<ModuleId> {
        match self {
            LinkFault::Partition(_, last, _) => Some(last),
            _ => None,
        }
    }
    /// Returns what ends it, and after how long; `None` if it is an end.
    pub const fn end(self) -> Option<(LinkFault, Span)> {
        match self {
            LinkFault::Loss(_, lease) => Some((LinkFault::LossEnds, lease)),
            LinkFault::Partition(_, _, lease) => Some((LinkFault::PartitionEnds, lease)),
            LinkFault::LossEnds | LinkFault::PartitionEnds => None,
        }
    }
    /// Changes the links, and returns what it did.
    pub fn apply(self, links: &mut LinkChanges) -> String {
        match self {
            LinkFault::Loss(loss, _) => {
                links.loss = Some(loss);
                format!("{loss} of the messages are lost")
            }
            LinkFault::LossEnds => {
                links.loss = None;
                "messages are lost as the scenario says".to_owned()
            }
            LinkFault::Partition(first, last, _) => {
                links.cut_off = Some((first, last));
                format!("modules {first} to {last} are cut off from the others")
            }
            LinkFault::PartitionEnds => {
                links.cut_off = None;
                "no module is cut off by a command".to_owned()
            }
        }
    }
}

/// Writes what follows the verb, without a blank before it.
impl fmt::Display for LinkFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            LinkFault::Loss(loss, lease) => write!(f, "{loss}").and_then(|()| write_lease(f, lease)),
            LinkFault::Partition(first, last, lease) => {
                write!(f, "{first}..{last}").and_then(|()| write_lease(f, lease))
            }
            LinkFault::LossEnds | LinkFault::PartitionEnds => f.write_str("off"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_of_links_are_read_as_they_are_written() {
        let third = Ratio::new(1, 3).unwrap();
        let all = [
            LinkFault::Loss(third, Span::secs(30)),
            LinkFault::Loss(Ratio::ONE, Span(1_500_000_001)),
            LinkFault::LossEnds,
            LinkFault::Partition(ModuleId(3), ModuleId(7), Span::secs(600)),
            LinkFault::PartitionEnds,
        ];
        for fault in all {
            assert_eq!(LinkFault::parse(fault.verb(), &fault.to_string()), Some(fault));
        }
        let one = LinkFault::Partition(ModuleId(3), ModuleId(3), LEASE);
        assert_eq!(LinkFault::parse("partition", "3"), Some(one));
    }

    #[test]
    fn other_texts_are_refused() {
        for (verb, rest) in [
            ("loss", ""),
            ("loss", "5"),
            ("loss", "-5%"),
            ("loss", "5% for 601s"),
            ("loss", "off for 3s"),
            ("partition", ""),
            ("partition", "7..3"),
            ("partition", "[1, 2]"),
            ("partition", "1..4294967296"),
            ("delay", "5%"),
        ] {
            assert_eq!(LinkFault::parse(verb, rest), None, "{verb} {rest}");
        }
    }
}
