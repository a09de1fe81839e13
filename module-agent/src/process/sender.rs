//! The sending half of an agent process: messages to neighbours are sealed, passed through the link emulator,
//! gathered in bursts, and put into the peers' inboxes. Not here: the uplink ([`crate::process::uplink`]).

use crate::link_emulator::{DelayedFrame, LinkEmulator};
use crate::process::contacts::{Contacts, PortContact};
use crate::process::start::AgentError;
use crate::run_dir::counter_file::AgentCounters;
use crate::transport::shared_frame::SharedFrame;
use crate::transport::{Address, AgentKey, ConnectError, Link, SendStatus, Transport};
use metamorph_protocol::counters::{Class, Tally};
use metamorph_protocol::ids::{Port, PortSet, Session};
use metamorph_protocol::link::LinkChanges;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::{Channel, Frame, Header, Wire};

/// Number of frames gathered before they are sent.
pub const BURST: usize = 128;

/// How long an agent tries in vain to open a link before it ends (ns of real time). Memory and descriptors that other processes
/// give back soon are waited for; after that the agent would be silent, and look like one whose protocol stands still.
const IN_VAIN: u64 = 2_000_000_000;

/// The sending half of one incarnation of an agent.
#[derive(Debug)]
pub struct Sender {
    agent: AgentKey,
    emulator: LinkEmulator,
    burst: Vec<DelayedFrame>,
    sequence: u32,
    /// Since when no link could be opened, for want of memory or descriptors, and the last contact it was tried for.
    in_vain: Option<(u64, Port, Session)>,
    /// Neighbours of this host without an inbox, each once for a contact, that the controller has not heard of.
    unreached: Vec<AgentKey>,
}

impl Sender {
    /// Creates a sender whose links are emulated by `emulator`.
    pub fn new(agent: AgentKey, emulator: LinkEmulator) -> Sender {
        Sender { agent, emulator, burst: Vec::new(), sequence: 0, in_vain: None, unreached: Vec::new() }
    }

    /// Seals a message and gives it to the emulated link of a port.
    pub fn send<M: Wire, L>(
        &mut self,
        now: Time,
        (port, class, message): (Port, Class, &M),
        contacts: &Contacts<L>,
        tally: &mut Tally,
    ) {
        let counts = &mut tally[class];
        counts.sent += 1;
        counts.bytes += message.wire_len() as u64;
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        let Some(contact) = contacts.get(port) else {
            // The contact of the port has ended, or never began.
            counts.expired += 1;
            return;
        };
        let header = Header {
            channel: Channel::Peer,
            kind: message.kind(),
            class,
            port,
            incarnation: self.agent.1,
            source: self.agent.0,
            destination: contact.peer,
            session: contact.session.0,
            sequence,
        };
        let (peer, session) = (contact.peer, contact.session);
        let frame = DelayedFrame {
            port,
            peer,
            session,
            handed: now,
            class,
            frame: Frame::seal(header, message),
            damaged: false,
        };
        self.emulator.carry(now, frame, tally, &mut self.burst);
    }

    /// Changes what its links do to messages.
    pub fn change_links(&mut self, changes: LinkChanges) {
        self.emulator.change(changes);
    }

    /// Resets a port for a new contact: its link has no history.
    pub fn reset(&mut self, port: Port) {
        self.emulator.reset(port);
    }

    /// Gathers the frames that the link has held back until `now`.
    pub fn release(&mut self, now: Time) {
        self.emulator.release(now, &mut self.burst);
    }

    /// Returns when the link releases the next frame.
    pub fn next_due(&self) -> Time {
        self.emulator.next()
    }

    /// Returns the neighbours that were found without an inbox since the last call.
    pub fn take_unreached(&mut self) -> Vec<AgentKey> {
        std::mem::take(&mut self.unreached)
    }

    /// True if no frame is gathered.
    pub fn is_empty(&self) -> bool {
        self.burst.is_empty()
    }

    /// True if enough frames are gathered to be sent.
    pub fn is_full(&self) -> bool {
        self.burst.len() >= BURST
    }

    /// Drops the frames that the link holds back, and counts them as left.
    pub fn fall_silent(&mut self, counters: &mut AgentCounters) {
        for class in self.emulator.drain() {
            counters.left[class.index()] += 1;
        }
    }

    /// Sends the gathered frames, which the caller has already written to its counters as sent. Counts those
    /// that cannot be sent as overflowed or expired. `monotonic` is real time.
    ///
    /// # Errors
    /// If no link can be opened, for [`IN_VAIN`].
    pub fn flush<T: Transport>(
        &mut self,
        (now, monotonic): (Time, u64),
        contacts: &mut Contacts<T::Link>,
        transport: &mut T,
        tally: &mut Tally,
    ) -> Result<(), AgentError> {
        let mut touched = PortSet::default();
        for frame in self.burst.drain(..) {
            let counts = &mut tally[frame.class];
            let port = contacts.get_mut(frame.port).filter(|port| port.contact.session == frame.session);
            let Some(port) = port else {
                counts.expired += 1;
                continue;
            };
            let is_new = port.link.is_none();
            let link = match open(port, transport) {
                Ok(link) => {
                    self.in_vain = self.in_vain.filter(|_| !is_new);
                    link
                }
                Err(ConnectError::Unreachable(_)) => {
                    counts.expired += 1;
                    // Without a controller there is no way to another host, and a later one opens it again.
                    let is_beside = !self.emulator.crosses_hosts(port.contact.peer);
                    if is_beside && !std::mem::replace(&mut port.unreached, true) {
                        self.unreached.push((port.contact.peer, port.contact.peer_incarnation));
                    }
                    continue;
                }
                Err(e @ ConnectError::NoSlot(_)) => {
                    tracing::debug!("cannot reach module {} yet: {e}", frame.peer);
                    counts.overflowed += 1;
                    continue;
                }
                Err(cause) => {
                    tracing::debug!("cannot reach module {}: {cause}", frame.peer);
                    counts.overflowed += 1;
                    let since = self.in_vain.map_or(monotonic, |(since, ..)| since);
                    self.in_vain = Some((since, frame.port, frame.session));
                    if monotonic.saturating_sub(since) > IN_VAIN {
                        return Err(AgentError::Silenced { peer: frame.peer, cause });
                    }
                    continue;
                }
            };
            let shared = SharedFrame::new(&frame.frame, now).handed_over(frame.handed);
            match link.send(if frame.damaged { shared.damaged(frame.class) } else { shared }) {
                SendStatus::Sent => {
                    port.sent[frame.class.index()] += 1;
                    touched.insert(frame.port);
                }
                SendStatus::Full => {
                    counts.overflowed += 1;
                    touched.insert(frame.port);
                }
                SendStatus::Gone => counts.expired += 1,
            }
        }
        for port in touched.iter() {
            if let Some(link) = contacts.get_mut(port).and_then(|port| port.link.as_mut()) {
                link.flush();
            }
        }
        Ok(())
    }

    /// Tries again to open a link that could not be opened for [`IN_VAIN`]. An agent that has nothing more to send would
    /// otherwise stay cut off, and its swarm stand still without a fault of the protocol. `monotonic` is real time.
    ///
    /// # Errors
    /// If the link cannot be opened now, either.
    pub fn retry<T: Transport>(
        &mut self,
        monotonic: u64,
        contacts: &mut Contacts<T::Link>,
        transport: &mut T,
    ) -> Result<(), AgentError> {
        let Some((_, port, session)) =
            self.in_vain.take_if(|(since, ..)| monotonic.saturating_sub(*since) > IN_VAIN)
        else {
            return Ok(());
        };
        let Some(port) = contacts.get_mut(port).filter(|port| port.contact.session == session) else {
            return Ok(());
        };
        match open(port, transport) {
            Ok(_) | Err(ConnectError::Unreachable(_) | ConnectError::NoSlot(_)) => Ok(()),
            Err(cause) => Err(AgentError::Silenced { peer: port.contact.peer, cause }),
        }
    }
}

/// Returns the link to the peer on a port, opened on first use.
fn open<'a, T: Transport>(
    port: &'a mut PortContact<T::Link>,
    transport: &mut T,
) -> Result<&'a mut T::Link, ConnectError> {
    if port.link.is_none() {
        let to = Address::Agent((port.contact.peer, port.contact.peer_incarnation));
        port.link = Some(transport.connect(to)?);
    }
    // Invariant: it was just opened if it was not open before.
    port.link.as_mut().ok_or_else(|| ConnectError::Failed("the link is not open".into()))
}
