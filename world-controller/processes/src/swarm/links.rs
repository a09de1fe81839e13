//! The controller's links to its agents. Each costs descriptors, too many for all agents of a large swarm, so
//! a link is opened when there is a message for it, and those unused for longest are closed. Closing a link
//! loses the messages that its agent has not taken yet, so the agent is asked first (`Process::leave`).
//!
//! Not here: links from agents to the controller, which stay open. Swarms small enough to keep all links open
//! have no limit. Daemons close none, and take no more agents than that permits.

use metamorph_module_agent::transport::{Address, AgentKey, ConnectError, Transport};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::io;
use std::rc::Rc;
use thiserror::Error;

/// Number of descriptors that the controller holds for each live agent: its process, and the two files of its
/// reports.
const AGENT: u64 = 3;
/// Number of descriptors of one link to an agent.
const LINK: u64 = 10;
/// Number of descriptors of the controller itself.
const OWN: u64 = 256;
/// Number of links that may be open at a time however few descriptors the agents leave.
const FEWEST: u64 = 64;

/// The most modules of one run on one machine; pids and descriptors run out soon after.
pub const MODULE_LIMIT: usize = 16_000;

/// One link to an agent.
#[derive(Debug)]
pub struct AgentLink<L> {
    /// The sending end.
    pub link: L,
    /// When it was last used, in nanoseconds of CLOCK_MONOTONIC.
    pub used: u64,
    leaving: Option<Rc<()>>,
    open: LinkCount,
}

impl<L> AgentLink<L> {
    /// Notes that the agent has been asked which messages it has taken.
    pub fn ask(&mut self) {
        self.leaving = Some(Rc::clone(&self.open.leaving));
    }
    /// True if the agent has been asked and has not answered.
    pub fn is_asked(&self) -> bool {
        self.leaving.is_some()
    }
    /// Notes an answer of the agent. Returns true if it had been asked.
    pub fn answer(&mut self) -> bool {
        self.leaving.take().is_some()
    }
}

/// Each link holds a clone, so that the number of clones is the number of links.
#[derive(Clone, Debug, Default)]
struct LinkCount {
    open: Rc<()>,
    leaving: Rc<()>,
}

/// The number of links, and its limit.
#[derive(Debug)]
pub struct Links {
    most: usize,
    counted: LinkCount,
}

impl Links {
    /// Returns the limit that the descriptors left by `agents` agents allow.
    pub fn of(agents: u64) -> Links {
        let left = allowed().saturating_sub(OWN + agents * AGENT);
        Links { most: (left / LINK).max(FEWEST).min(agents) as usize, counted: LinkCount::default() }
    }

    /// True if one more link may be opened.
    pub fn has_room(&self) -> bool {
        self.open() < self.most
    }

    /// Returns the number of links to close soon, so that there is room before it is needed.
    pub fn too_many(&self, agents: usize) -> usize {
        let staying = self.open() - (Rc::strong_count(&self.counted.leaving) - 1 - self.open());
        if agents <= self.most || staying * 4 < self.most * 3 { 0 } else { staying - self.most / 2 }
    }

    fn open(&self) -> usize {
        Rc::strong_count(&self.counted.open) - 1
    }

    /// Opens the link to one incarnation of an agent.
    pub fn open_to<T: Transport>(
        &self,
        transport: &mut T,
        agent: AgentKey,
    ) -> Result<AgentLink<T::Link>, ConnectError> {
        let link = transport.connect(Address::Agent(agent))?;
        Ok(AgentLink { link, used: 0, leaving: None, open: self.counted.clone() })
    }
}

/// Too few file descriptors are allowed.
#[derive(Debug, Error)]
#[error(
    "this swarm needs {needed} open files, but only {allowed} are allowed, and asking for more was refused ({why}); raise the hard limit (ulimit -Hn, or LimitNOFILE of the service) or use fewer modules"
)]
pub struct TooFewDescriptors {
    /// The number needed.
    needed: u64,
    /// The hard limit.
    allowed: u64,
    /// Why it could not be raised.
    why: io::Error,
}

fn allowed() -> u64 {
    getrlimit(Resource::Nofile).maximum.unwrap_or(u64::MAX)
}

/// Returns the most descriptors that this process may open, and the number of modules for which they suffice.
pub fn descriptor_limit() -> (u64, u64) {
    let allowed = allowed();
    (allowed, (allowed.saturating_sub(OWN + FEWEST * LINK) / AGENT).min(MODULE_LIMIT as u64))
}

/// Returns the number of descriptors without which the controller of so many agents does not start.
pub fn descriptors_needed(agents: u64) -> u64 {
    OWN + agents * AGENT + FEWEST * LINK
}

/// Raises the limit of descriptors of this process to what the controller of `agents` agents can use.
///
/// # Errors
/// If the limit stays below what it needs.
pub fn raise_descriptor_limit(agents: u64) -> Result<(), TooFewDescriptors> {
    raise(descriptors_needed(agents), all_open(agents))
}

/// Raises the limit of descriptors as far as `agents` agents of a daemon can use it, and returns the number of agents for
/// which it suffices. A daemon keeps all links open, since frames of other hosts arrive at any time.
pub fn room_of_daemon(agents: u64) -> u64 {
    // If the limit cannot be raised, the current one bounds the number of agents.
    let _ = raise(0, all_open(agents));
    room_within(allowed()).min(agents)
}

/// Returns the number of descriptors with which all links to so many agents stay open.
pub fn all_open(agents: u64) -> u64 {
    OWN + agents * (AGENT + LINK)
}

/// Returns the number of agents to which all links stay open with so many descriptors.
fn room_within(descriptors: u64) -> u64 {
    descriptors.saturating_sub(OWN) / (AGENT + LINK)
}

/// Raises the limit to `useful` descriptors, or as far as it goes.
fn raise(least: u64, useful: u64) -> Result<(), TooFewDescriptors> {
    let limit = getrlimit(Resource::Nofile);
    let hard = limit.maximum.unwrap_or(u64::MAX);
    if hard < useful {
        // Privileged users may raise the hard limit; for others it stays.
        let raised = Rlimit { current: Some(useful), maximum: Some(useful) };
        match setrlimit(Resource::Nofile, raised) {
            Ok(()) => return Ok(()),
            Err(e) if hard < least => {
                return Err(TooFewDescriptors { needed: least, allowed: hard, why: e.into() });
            }
            Err(e) => tracing::debug!("at most {hard} open files, since raising that was refused: {e}"),
        }
    }
    if limit.current.is_some_and(|current| current < hard) {
        let raised = Rlimit { current: limit.maximum, maximum: limit.maximum };
        if let Err(e) = setrlimit(Resource::Nofile, raised) {
            tracing::warn!("the limit of open files could not be raised: {e}");
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_daemon_has_room_for_agents_whose_links_all_fit() {
        for agents in [0, 1, 1_518, 16_000] {
            assert_eq!(room_within(all_open(agents)), agents);
            assert_eq!(room_within(all_open(agents) + AGENT + LINK - 1), agents);
        }
        assert_eq!((room_within(0), room_within(20_000)), (0, 1_518));
        assert!(room_of_daemon(3) == 3, "a few agents always fit");
    }
}
