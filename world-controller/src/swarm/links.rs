//! The controller's links to its agents. Each costs descriptors, of which there are not enough for all
//! agents of a large swarm, so a link is opened when there is a message for it, and those that have not
//! been used for longest are closed. Messages that an agent has not taken would be lost with its link, so it
//! is asked first (`Process::leave`).
//!
//! Absent: links from agents to the controller, which stay open; and any limit for swarms that are small
//! enough to do without.

use crate::swarm::outcome::SwarmError;
use metamorph_module_agent::transport::{Address, AgentKey, ConnectError, Transport};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::rc::Rc;

/// Descriptors that the controller has open for each agent that is alive: its process, and the two
/// files of its reports.
const AGENT: u64 = 3;
/// Descriptors of one link to an agent.
const LINK: u64 = 10;
/// Descriptors of the controller itself.
const OWN: u64 = 256;
/// Links that a swarm of any size can have open at a time.
const FEWEST: u64 = 64;

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
    /// The agent has been asked what it has taken.
    pub fn ask(&mut self) {
        self.leaving = Some(Rc::clone(&self.open.leaving));
    }
    /// Whether it has been asked and has not answered.
    pub fn is_asked(&self) -> bool {
        self.leaving.is_some()
    }
    /// It has answered. Returns whether it had been asked.
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

/// How many links there are, and may be.
#[derive(Debug)]
pub struct Links {
    most: usize,
    counted: LinkCount,
}

impl Links {
    /// The limit that the descriptors left by `agents` agents allow.
    pub fn of(agents: u64) -> Links {
        let left = allowed().saturating_sub(OWN + agents * AGENT);
        Links { most: (left / LINK).max(FEWEST).min(agents) as usize, counted: LinkCount::default() }
    }

    /// Whether one more may be opened.
    pub fn has_room(&self) -> bool {
        self.open() < self.most
    }

    /// How many should be closed soon, so that there is room before it is needed.
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

fn allowed() -> u64 {
    getrlimit(Resource::Nofile).maximum.unwrap_or(u64::MAX)
}

/// The most descriptors that this process may open, and the modules of a run for which they are enough.
pub fn descriptor_limit() -> (u64, u64) {
    let allowed = allowed();
    (allowed, (allowed.saturating_sub(OWN + FEWEST * LINK) / AGENT).min(super::MODULE_LIMIT as u64))
}

/// Allows this process as many descriptors as the controller of `agents` agents needs, and as many as it
/// can use if there are.
pub fn raise_descriptor_limit(agents: u64) -> Result<(), SwarmError> {
    let (least, useful) = (OWN + agents * AGENT + FEWEST * LINK, OWN + agents * (AGENT + LINK));
    let limit = getrlimit(Resource::Nofile);
    let hard = limit.maximum.unwrap_or(u64::MAX);
    if hard < useful {
        // Privileged users may raise it; others go on with what they have.
        let raised = Rlimit { current: Some(useful), maximum: Some(useful) };
        match setrlimit(Resource::Nofile, raised) {
            Ok(()) => return Ok(()),
            Err(e) if hard < least => {
                return Err(SwarmError::Descriptors { needed: least, allowed: hard, why: e.into() });
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
