//! The schedule of hosts that go down where modules of a lost host are started elsewhere: the deaths of processes, the loss
//! of the host after its fence, the restarts, and its return. All follow from the scenario, since hosts of a scenario have
//! room for any number of modules.

use metamorph_core::ids::{HostId, ModuleId};
use metamorph_core::link::{HostChange, Hosts};
use metamorph_core::time::{Span, Time};
use metamorph_kernel::director::faults::{Fault, Origin, Scheduled};

/// Time between the starts of two agents (scenario time): a machine starts one after another, and protocols tell restarts apart
/// by their times.
const START: Span = Span::millis(1);

/// A time for which a host is down.
#[derive(Clone, Debug)]
pub struct Outage {
    /// The host.
    pub host: HostId,
    /// When it goes down.
    pub begin: Time,
    /// When it comes back; `None` if it does not.
    pub end: Option<Time>,
}

/// Why a schedule of outages is impossible: of the outage with the number `of`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Impossible {
    /// The number of the outage.
    pub of: usize,
    /// The host.
    pub host: HostId,
    /// When it goes down.
    pub at: Time,
    /// True if no other host is left then; otherwise it is down already.
    pub is_last: bool,
}

/// Returns the schedule of these outages, each host of which counts as lost after `fence`.
///
/// # Errors
/// Returns the first outage that is impossible.
pub fn schedule(outages: &[Outage], hosts: &Hosts, fence: Span) -> Result<Vec<Scheduled>, Impossible> {
    let mut changes: Vec<(Time, HostChange, HostId, usize)> = Vec::new();
    for (of, Outage { host, begin, end }) in outages.iter().enumerate() {
        let lost_at = *begin + fence;
        changes.push((*begin, HostChange::Down, *host, of));
        if end.is_none_or(|end| end > lost_at) {
            changes.push((lost_at, HostChange::Lost, *host, of));
        }
        changes.extend(end.map(|end| (end, HostChange::Back, *host, of)));
    }
    // At one instant, hosts come back first, so that there is room.
    let order = |change: &HostChange| match change {
        HostChange::Back => 0,
        HostChange::Lost => 1,
        HostChange::Down => 2,
    };
    changes.sort_by_key(|(at, change, ..)| (*at, order(change)));
    let (mut planned, mut hosts, mut lost) = (Vec::new(), hosts.clone(), Vec::new());
    for (at, change, host, of) in changes {
        let mut plan = |fault, by| planned.push(Scheduled { at, fault, by });
        let restarts = |modules: Vec<ModuleId>| {
            let times = std::iter::successors(Some(at), |at| Some(*at + START));
            times.zip(modules).map(|(at, id)| Scheduled {
                at,
                fault: Fault::Restart(id),
                by: Origin::External,
            })
        };
        let event = Fault::Host(host, change);
        match change {
            HostChange::Down => {
                let is_down = hosts.is_down(host);
                hosts.go_down(host);
                // Invariant: there are fewer than 2^16 hosts.
                let is_last = (0..hosts.len() as u16).all(|other| hosts.is_down(HostId(other)));
                if is_down || is_last {
                    return Err(Impossible { of, host, at, is_last: !is_down });
                }
                plan(event, Origin::Scenario);
                hosts.modules(host).for_each(|id| plan(Fault::Kill(id), Origin::Scenario));
            }
            HostChange::Lost => {
                let moved = hosts.lose(host, |_| usize::MAX);
                lost.push(host);
                plan(event, Origin::External);
                planned.extend(restarts(moved));
            }
            HostChange::Back => {
                hosts.come_back(host);
                plan(event, Origin::External);
                let is_lost = lost.iter().position(|other| *other == host).map(|i| lost.swap_remove(i));
                // One that comes back before it counts as lost has its modules still.
                let stayed = hosts.modules(host).filter(|_| is_lost.is_none()).collect();
                planned.extend(restarts(stayed));
            }
        }
    }
    Ok(planned)
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_core::link::{ClockOffset, LinkModel};

    /// Returns the schedule of outages (host, begin, end) in seconds of six modules on three hosts, with a fence of 10 s.
    fn planned(outages: &[(u16, u64, Option<u64>)]) -> Result<Vec<String>, Impossible> {
        let homes = [0, 0, 1, 1, 2, 2].map(HostId).to_vec();
        let links = vec![LinkModel::default(); 3];
        let hosts = Hosts::new(homes, vec![ClockOffset::default(); 3], links).unwrap();
        let time = |s| Time::ZERO + Span::secs(s);
        let outage = |(host, begin, end): &(u16, u64, Option<u64>)| Outage {
            host: HostId(*host),
            begin: time(*begin),
            end: end.map(time),
        };
        let outages: Vec<Outage> = outages.iter().map(outage).collect();
        let planned = schedule(&outages, &hosts, Span::secs(10))?;
        Ok(planned.iter().map(|s| format!("{} {}", s.at.as_secs_f64(), s.fault)).collect())
    }

    #[test]
    fn a_lost_host_starts_elsewhere_after_its_fence() {
        let events = planned(&[(1, 5, None)]).unwrap();
        let expected =
            ["5 down h2", "5 kill 2", "5 kill 3", "15 lost h2", "15 restart 2", "15.001 restart 3"];
        assert_eq!(events, expected);
    }

    /// Module 2 is on the first host and module 3 on the third when that is lost, too.
    #[test]
    fn modules_that_have_moved_are_lost_with_their_new_home() {
        let events = planned(&[(1, 5, None), (2, 20, Some(40))]).unwrap();
        let expected = [
            "20 down h3",
            "20 kill 3",
            "20 kill 4",
            "20 kill 5",
            "30 lost h3",
            "30 restart 3",
            "30.001 restart 4",
            "30.002 restart 5",
            "40 back h3",
        ];
        assert_eq!(events[6..], expected);
    }

    #[test]
    fn a_host_that_is_back_in_time_keeps_its_modules() {
        let events = planned(&[(1, 5, Some(15)), (1, 20, None)]).unwrap();
        let expected =
            ["5 down h2", "5 kill 2", "5 kill 3", "15 back h2", "15 restart 2", "15.001 restart 3"];
        assert_eq!(events[..6], expected);
    }

    #[test]
    fn the_loss_of_all_hosts_and_double_outages_are_refused() {
        let refused = |outages| planned(outages).map_err(|e| (e.of, e.is_last)).map(|_| ());
        assert_eq!(refused(&[(0, 5, None), (1, 6, None), (2, 7, None)]), Err((2, true)));
        assert_eq!(refused(&[(0, 5, None), (1, 6, Some(7)), (2, 7, None)]), Ok(()));
        assert_eq!(refused(&[(1, 5, None), (1, 30, None)]), Err((1, false)));
    }
}
