//! Messages between controller and daemons: the opening of a connection, then messages on the stream of the host link.
//! All of them are bincode, preceded by their length. Not here: packets, which `protocol` lays out.

use super::address::Address;
use super::parts::Stretch;
use bincode::config::standard;
use metamorph_module_agent::run_dir::counter_file::AgentCounters;
use metamorph_module_agent::transport::AgentKey;
use metamorph_module_agent::transport::shared_frame::SharedFrame;
use metamorph_protocol::counters::{Class, Tally};
use metamorph_protocol::ids::HostId;
use metamorph_protocol::latency::Latencies;
use metamorph_protocol::link::Hosts;
use metamorph_protocol::time::{Span, Time};
use metamorph_protocol::wire::Frame;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Read, Write};
use std::path::PathBuf;
use std::sync::Arc;

/// First bytes of an opening; the last one is the version of these messages.
const MAGIC: [u8; 8] = *b"MMHOSTS\x06";
/// Largest opening in bytes: it holds the swarm file, which has the same limit.
const OPENING_LIMIT: usize = 257 << 20;
/// Largest message on the stream in bytes.
pub const MESSAGE_LIMIT: usize = 1 << 20;

/// The first message on a connection.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Opening {
    /// From the controller: a share of a swarm.
    Serve(Box<Assignment>),
    /// From a controller that has taken over the run.
    Resume(Box<Resuming>),
    /// From the daemon of another host of the run.
    Join {
        /// The run.
        run: u64,
        /// The other host.
        from: HostId,
    },
    /// Requests the status of the host.
    Status,
    /// Remove what killed runs have left here.
    Clean,
}

/// Program, capacity and current work of a daemon.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HostStatus {
    /// The version of its program.
    pub version: String,
    /// The hash of its program.
    pub build: u64,
    /// The most modules that it takes.
    pub most: u32,
    /// The run that it serves, with the number of modules.
    pub serves: Option<(u64, u32)>,
    /// The number of killed runs that have left files.
    pub leftovers: u32,
}

/// A share of a swarm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Assignment {
    /// The number of the run.
    pub run: u64,
    /// The secret that the hosts of the run share.
    pub secret: [u64; 2],
    /// The hash of the controller's program.
    pub build: u64,
    /// The host that the daemon is.
    pub host: HostId,
    /// The homes of all modules.
    pub hosts: Arc<Hosts>,
    /// The number of modules of the swarm.
    pub count: u32,
    /// The addresses of the daemons of h2, h3, ...
    pub addresses: Vec<Address>,
    /// The family of the agents.
    pub family: String,
    /// The swarm file.
    pub swarm: Vec<u8>,
    /// The clock page of the run, for hosts on this machine; others get pages over the link.
    pub clock: PathBuf,
    /// How far a clock of another machine may be off (real time).
    pub clock_error: Span,
    /// The time after which a host counts as silent, and the one after which it counts as dead.
    pub silent_and_fence: (Span, Span),
    /// How long the daemon waits for another controller when this one has died on the same machine (real time); zero if no
    /// other can take over.
    pub patience: Span,
    /// True if agents log to the daemon's standard error.
    pub verbose: bool,
}

/// Opening message of a controller that has taken over a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Resuming {
    /// The number of the run.
    pub run: u64,
    /// The secret that the hosts of the run share.
    pub secret: [u64; 2],
    /// The host that the daemon is.
    pub host: HostId,
    /// The agents of that host that take part.
    pub agents: BTreeSet<AgentKey>,
    /// How many bytes of the journal of each agent of that host have arrived, if it is on another machine.
    pub collected: BTreeMap<AgentKey, u64>,
}

/// The answer to an opening.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Answer {
    /// The daemon serves the run, with this directory, and takes so many modules at most.
    Ready(PathBuf, u32),
    /// The daemon has turned to the controller that took over.
    Resumed {
        /// The agents asked for that live.
        present: Vec<AgentKey>,
        /// The latest incarnation of each module that was started there.
        latest: Vec<AgentKey>,
        /// The counters of the agents that have ended there.
        ended: Vec<(AgentKey, CountersOfAgent)>,
        /// The scenario time at which time stands still there.
        time: Time,
    },
    /// It does not, for this reason.
    Refused(String),
    /// The status of the daemon.
    Status(HostStatus),
    /// Description of the files that were removed.
    Cleaned(String),
}

/// The counters of an agent that has ended; `None` if it never started, or the reason why they cannot be read.
pub type CountersOfAgent = Result<Option<Box<Account>>, String>;

/// A message from the controller to a daemon.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToDaemon {
    /// Start an incarnation of an agent.
    Start(AgentKey),
    /// Send a signal to an agent.
    Signal(AgentKey, i32),
    /// Release what an agent held that has ended.
    Reap(AgentKey),
    /// Put a frame into the inbox of an agent.
    Frame(AgentKey, Sent),
    /// The controller's clock page, for hosts with a clock of their own.
    Clock(Vec<u8>),
    /// Another host is lost: messages to it have expired.
    Lost(HostId),
    /// From now on each module, by number, is at home there.
    Homes(Vec<HostId>),
    /// Another host that was lost has come back.
    Back(HostId),
    /// Report when no frame to another host is under way.
    Drain,
    /// Report what the host itself has counted.
    Account,
}

/// A message from a daemon to the controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToController {
    /// A frame from an agent.
    Frame(Sent),
    /// So many frames from the controller are in the inbox of this agent, or were dropped with it.
    Taken(AgentKey, u32),
    /// Scenario time stands still on the host, since the controller's clock is known to this only; or goes on again.
    Still(Option<Span>),
    /// An agent could not be started.
    SpawnFailed(AgentKey, String),
    /// An agent has ended.
    Exited {
        /// The agent.
        agent: AgentKey,
        /// How it ended.
        how: String,
        /// The signal that ended it.
        signal: Option<i32>,
        /// True if the operating system denied or took away what it needs.
        of_machine: bool,
        /// The end of its standard error.
        stderr_tail: String,
        /// Its counters.
        counters: CountersOfAgent,
    },
    /// An agent was stopped by a signal from outside.
    Stopped(AgentKey, i32),
    /// It was continued by a signal from outside.
    Continued(AgentKey),
    /// Part of the journal of an agent that another controller has just called: messages that the agent may have sent
    /// to the previous one.
    Journal(Stretch),
    /// No frame from this host to another is under way.
    Drained,
    /// Counters of the host itself, and of the protocol messages that it has sent to each other host.
    Account(Box<Account>, BTreeMap<HostId, Tally>),
}

/// A frame with the time at which it entered its first channel.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sent {
    frame: Vec<u8>,
    at: Time,
}

impl Sent {
    /// Wraps a frame.
    pub fn new(shared: &SharedFrame) -> Sent {
        Sent { frame: shared.frame().as_bytes().to_vec(), at: shared.sent() }
    }
    /// Returns the frame, sent at `healed` if it was sent before; `None` if it has the wrong length.
    pub fn shared(&self, healed: Time) -> Option<SharedFrame> {
        let bytes: [u8; Frame::SIZE] = self.frame.as_slice().try_into().ok()?;
        Some(SharedFrame::new(&Frame::from_bytes(bytes), self.at.max(healed)))
    }
}

/// Counters, as they cross to the controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Account {
    tally: Tally,
    left: [u64; Class::ALL.len()],
    loose: [u64; Class::ALL.len()],
    closed: bool,
    foreign: u64,
    wakes: u64,
    unrecorded: u64,
    latencies: Latencies,
}

impl From<AgentCounters> for Account {
    fn from(counters: AgentCounters) -> Account {
        let AgentCounters { tally, left, loose, closed, foreign, wakes, unrecorded, latencies } = counters;
        Account { tally, left, loose, closed, foreign, wakes, unrecorded, latencies }
    }
}

impl From<Account> for AgentCounters {
    fn from(account: Account) -> AgentCounters {
        let Account { tally, left, loose, closed, foreign, wakes, unrecorded, latencies } = account;
        AgentCounters { tally, left, loose, closed, foreign, wakes, unrecorded, latencies }
    }
}

fn invalid(what: impl Into<String>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what.into())
}

/// Writes an opening or the answer to one.
///
/// # Errors
/// If the message is too large, or the connection fails.
pub fn write_opening<M: Serialize>(to: &mut impl Write, message: &M) -> io::Result<()> {
    let body = bincode::serde::encode_to_vec(message, standard()).map_err(io::Error::other)?;
    if body.len() > OPENING_LIMIT {
        return Err(invalid(format!("{} bytes are more than {OPENING_LIMIT}", body.len())));
    }
    to.write_all(&MAGIC)?;
    // Invariant: the limit is below 2^32.
    to.write_all(&(body.len() as u32).to_le_bytes())?;
    to.write_all(&body)
}

/// Reads an opening or the answer to one.
///
/// # Errors
/// If the connection fails, or the other end is no host of this version.
pub fn read_opening<M: DeserializeOwned>(from: &mut impl Read) -> io::Result<M> {
    let (mut magic, mut length) = ([0; 8], [0; 4]);
    from.read_exact(&mut magic)?;
    if magic[..7] != MAGIC[..7] {
        return Err(invalid("the other end is not a host of metamorph"));
    }
    if magic != MAGIC {
        let (theirs, ours) = (magic[7], MAGIC[7]);
        return Err(invalid(format!("the other end speaks version {theirs}; this program speaks {ours}")));
    }
    from.read_exact(&mut length)?;
    let length = u32::from_le_bytes(length) as usize;
    if length > OPENING_LIMIT {
        return Err(invalid(format!("an opening of {length} bytes; {OPENING_LIMIT} is the maximum")));
    }
    // The memory grows with what arrives, not with what is announced.
    let mut body = Vec::new();
    from.take(length as u64).read_to_end(&mut body)?;
    decode(&body).ok_or_else(|| invalid("the opening cannot be read"))
}

/// Takes a whole opening off the bytes heard so far, or the answer to one.
///
/// # Errors
/// If they are not the beginning of an opening.
#[cfg_attr(not(feature = "hosts"), allow(dead_code, reason = "sockets are read until an opening is whole"))]
pub fn whole_opening<M: DeserializeOwned>(heard: &mut Vec<u8>) -> io::Result<Option<M>> {
    let before = MAGIC.len() + 4;
    let Some(length) = heard.get(MAGIC.len()..before).and_then(|bytes| bytes.try_into().ok()) else {
        return Ok(None);
    };
    let whole = before + u32::from_le_bytes(length) as usize;
    if heard[..MAGIC.len()] == MAGIC && whole <= OPENING_LIMIT && heard.len() < whole {
        return Ok(None);
    }
    let mut rest = heard.as_slice();
    let message = read_opening(&mut rest)?;
    let used = heard.len() - rest.len();
    heard.drain(..used);
    Ok(Some(message))
}

fn decode<M: DeserializeOwned>(bytes: &[u8]) -> Option<M> {
    let read = bincode::serde::decode_from_slice(bytes, standard().with_limit::<OPENING_LIMIT>());
    read.ok().filter(|(_, used)| *used == bytes.len()).map(|(message, _)| message)
}

/// Appends a message to the bytes of a stream.
pub fn push<M: Serialize>(stream: &mut Vec<u8>, message: &M) {
    match bincode::serde::encode_to_vec(message, standard()) {
        Ok(body) if body.len() <= MESSAGE_LIMIT => {
            stream.extend((body.len() as u32).to_le_bytes());
            stream.extend(body);
        }
        // Invariant: the largest message is a few kilobytes long.
        Ok(_) | Err(_) => tracing::error!("a message to another host cannot be encoded"),
    }
}

/// Takes the next whole message off the bytes of a stream.
///
/// # Errors
/// If they hold no message.
pub fn pop<M: DeserializeOwned>(stream: &mut Vec<u8>) -> io::Result<Option<M>> {
    let Some(length) = stream.first_chunk::<4>().map(|b| u32::from_le_bytes(*b) as usize) else {
        return Ok(None);
    };
    if length > MESSAGE_LIMIT {
        return Err(invalid(format!("a message of {length} bytes; {MESSAGE_LIMIT} is the maximum")));
    }
    if stream.len() < 4 + length {
        return Ok(None);
    }
    let message = decode(&stream[4..4 + length]).ok_or_else(|| invalid("a message cannot be read"))?;
    stream.drain(..4 + length);
    Ok(Some(message))
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::ids::{Incarnation, ModuleId};

    const AGENT: AgentKey = (ModuleId(7), Incarnation(1));

    #[test]
    fn messages_come_out_as_they_went_in_whatever_the_pieces() {
        let said = [ToDaemon::Start(AGENT), ToDaemon::Signal(AGENT, 9), ToDaemon::Drain, ToDaemon::Account];
        let mut bytes = Vec::new();
        said.iter().for_each(|message| push(&mut bytes, message));
        let (mut stream, mut heard) = (Vec::new(), Vec::new());
        for byte in bytes {
            stream.push(byte);
            while let Some(message) = pop::<ToDaemon>(&mut stream).unwrap() {
                heard.push(message);
            }
        }
        assert_eq!((heard.as_slice(), stream.is_empty()), (said.as_slice(), true));
    }

    #[test]
    fn malformed_bytes_are_refused_and_claim_no_memory() {
        let mut long = (MESSAGE_LIMIT as u32 + 1).to_le_bytes().to_vec();
        assert!(pop::<ToDaemon>(&mut long).unwrap_err().to_string().contains("maximum"));
        let mut unknown = vec![1, 0, 0, 0, 0xFF];
        assert!(pop::<ToDaemon>(&mut unknown).is_err());
        // A byte too many behind a whole message.
        let mut trailing = vec![2, 0, 0, 0, 9, 0];
        assert!(pop::<ToDaemon>(&mut trailing).is_err());
        let mut opening = Vec::new();
        write_opening(&mut opening, &Opening::Join { run: 3, from: HostId(1) }).unwrap();
        let read = |bytes: &[u8]| read_opening::<Opening>(&mut &*bytes);
        assert_eq!(read(&opening).unwrap(), Opening::Join { run: 3, from: HostId(1) });
        for (at, what) in [(0, "not a host"), (7, "version"), (11, "maximum")] {
            let mut bad = opening.clone();
            bad[at] = 0xEE;
            assert!(read(&bad).unwrap_err().to_string().contains(what), "byte {at}");
        }
        for length in 0..opening.len() {
            assert!(read(&opening[..length]).is_err(), "{length} bytes");
        }
    }

    /// Whatever arrives is refused, waits for more, or is an opening; nothing panics, and no memory is claimed for what is
    /// only announced.
    #[test]
    fn openings_of_hostile_bytes_never_panic() {
        use metamorph_protocol::rng::Rng;
        for seed in 0..20_000 {
            let mut rng = Rng::named(seed, "hostile openings", 0);
            let body: Vec<u8> = (0..rng.below(200)).map(|_| rng.below(256) as u8).collect();
            let announced = rng.below(1 << 32) as u32;
            let mut heard = match rng.below(3) {
                0 => body,
                1 => [&MAGIC[..], &announced.to_le_bytes(), &body].concat(),
                _ => [&MAGIC[..], &(body.len() as u32).to_le_bytes(), &body].concat(),
            };
            let before = heard.len();
            let _ = whole_opening::<Opening>(&mut heard);
            assert!(heard.len() <= before && heard.capacity() < 1 << 16, "seed {seed}");
            let _ = pop::<ToController>(&mut heard.clone());
            let _ = pop::<ToDaemon>(&mut heard);
        }
    }

    #[test]
    fn an_opening_is_taken_once_it_is_whole() {
        let mut bytes = Vec::new();
        write_opening(&mut bytes, &Opening::Status).unwrap();
        write_opening(&mut bytes, &Opening::Clean).unwrap();
        let (mut heard, mut said) = (Vec::new(), Vec::new());
        for byte in bytes {
            heard.push(byte);
            said.extend(whole_opening::<Opening>(&mut heard).unwrap());
        }
        assert_eq!((said, heard.len()), (vec![Opening::Status, Opening::Clean], 0));
    }
}
