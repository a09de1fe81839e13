//! The controller's ways to its agents. Each costs descriptors, of which there are not enough for all
//! agents of a large swarm, so ways are opened when there is something to say, and those that have not
//! been used for longest are closed. What an agent has not taken would be lost with its way, so it is
//! asked first (`Process::leave`).
//!
//! Absent: ways from agents to the controller, which stay open; and any limit for swarms that are small
//! enough to do without.

use crate::swarm::outcome::SwarmError;
use metamorph_module_agent::transport::iceoryx::outbox::Outbox;
use metamorph_module_agent::transport::iceoryx::rendezvous::{ChannelError, Rendezvous};
use metamorph_protocol::ids::{Incarnation, ModuleId};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::rc::Rc;

/// Descriptors that the controller has open for each agent as long as it lives: its process, and the two
/// files of its reports.
const AGENT: u64 = 3;
/// Descriptors of one way to an agent.
const LINK: u64 = 10;
/// Descriptors of the controller itself.
const OWN: u64 = 256;
/// Ways that a swarm of any size can have open at a time.
const FEWEST: u64 = 64;

/// One way to an agent.
#[derive(Debug)]
pub struct Link {
    /// What goes this way.
    pub outbox: Outbox,
    /// When it was last used, in nanoseconds of CLOCK_MONOTONIC.
    pub used: u64,
    leaving: Option<Rc<()>>,
    open: Counted,
}

impl Link {
    /// The agent has been asked what it has taken.
    pub fn ask(&mut self) {
        self.leaving = Some(Rc::clone(&self.open.leaving));
    }
    /// Whether it has been asked and has not answered.
    pub fn is_asked(&self) -> bool {
        self.leaving.is_some()
    }
    /// It has answered; whether it had been asked.
    pub fn answer(&mut self) -> bool {
        self.leaving.take().is_some()
    }
}

/// Each way holds a clone, so that they count themselves.
#[derive(Clone, Debug, Default)]
struct Counted {
    open: Rc<()>,
    leaving: Rc<()>,
}

/// How many ways there are, and may be.
#[derive(Debug)]
pub struct Links {
    most: usize,
    counted: Counted,
}

impl Links {
    /// As many as descriptors are left by `agents` agents.
    pub fn of(agents: u64) -> Links {
        let left = allowed().saturating_sub(OWN + agents * AGENT);
        Links { most: (left / LINK).max(FEWEST).min(agents) as usize, counted: Counted::default() }
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

    /// Opens the way to one life of an agent.
    pub fn open_to(&self, at: &Rendezvous, id: ModuleId, life: Incarnation) -> Result<Link, ChannelError> {
        let outbox = Outbox::to_agent(at, id, life)?;
        Ok(Link { outbox, used: 0, leaving: None, open: self.counted.clone() })
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
        // Allowed to whoever may raise limits; others go on with what they have.
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
