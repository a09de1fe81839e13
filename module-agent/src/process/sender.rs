//! The sending half of an agent process: messages to neighbours are sealed, passed through the link emulator,
//! gathered in bursts, and put into the peers' inboxes. Not here: the uplink ([`crate::process::uplink`]).

use crate::link_emulator::{DelayedFrame, LinkEmulator};
use crate::process::contacts::{Contacts, PortContact};
use crate::process::start::AgentError;
use crate::run_dir::counter_file::AgentCounters;
use crate::transport::shared_frame::SharedFrame;
use crate::transport::{Address, AgentKey, ConnectError, Link, SendStatus, Transport};
use metamorph_protocol::counters::{Class, Tally};
use metamorph_protocol::ids::{Port, PortSet};
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
    /// Since when links could not be opened, for want of memory or descriptors; `None` if all could.
    in_vain: Option<u64>,
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
    pub fn flush<T: Transport>(
        &mut self,
        (now, monotonic): (Time, u64),
        contacts: &mut Contacts<T::Link>,
        transport: &mut T,
        tally: &mut Tally,
    ) {
        let mut touched = PortSet::default();
        for frame in self.burst.drain(..) {
            let counts = &mut tally[frame.class];
            let port = contacts.get_mut(frame.port).filter(|port| port.contact.session == frame.session);
            let Some(port) = port else {
                counts.expired += 1;
                continue;
            };
            let is_new = port.link.is_none();
            port.refused = false;
            let link = match open(port, transport) {
                Ok(link) => {
                    // Others may still be refused: they have as long again.
                    self.in_vain = self.in_vain.map(|since| if is_new { monotonic } else { since });
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
                    self.in_vain.get_or_insert(monotonic);
                    port.refused = true;
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
    }

    /// Tries again to open the links that could not be opened, after [`IN_VAIN`], also if there is nothing to send: the agent
    /// would stay cut off, and its swarm stand still without a fault of the protocol. `monotonic` is real time.
    ///
    /// # Errors
    /// If one cannot be opened now, either.
    pub fn retry<T: Transport>(
        &mut self,
        monotonic: u64,
        contacts: &mut Contacts<T::Link>,
        transport: &mut T,
    ) -> Result<(), AgentError> {
        if self.in_vain.is_none_or(|since| monotonic.saturating_sub(since) <= IN_VAIN) {
            return Ok(());
        }
        for port in contacts.iter_mut().filter(|port| port.refused) {
            match open(port, transport) {
                Ok(_) | Err(ConnectError::Unreachable(_) | ConnectError::NoSlot(_)) => port.refused = false,
                Err(cause) => return Err(AgentError::Silenced { peer: port.contact.peer, cause }),
            }
        }
        self.in_vain = None;
        Ok(())
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::TransportError;
    use metamorph_protocol::ids::{Incarnation, ModuleId, Revision, Session};
    use metamorph_protocol::lattice::Cell;
    use metamorph_protocol::link::LinkModel;
    use metamorph_protocol::runtime::Contact;
    use std::time::Duration;

    #[derive(Debug)]
    struct Open;

    impl Link for Open {
        fn send(&mut self, _: SharedFrame) -> SendStatus {
            SendStatus::Sent
        }
        fn flush(&mut self) {}
    }

    /// Opens links to modules with numbers from `least` on, and refuses others.
    struct Refusing {
        least: u32,
    }

    impl Transport for Refusing {
        type Link = Open;
        fn connect(&mut self, to: Address) -> Result<Open, ConnectError> {
            match to {
                Address::Agent((id, _)) if id.0 >= self.least => Ok(Open),
                _ => Err(ConnectError::Failed("no descriptor is left".into())),
            }
        }
        fn receive(&mut self) -> Result<Option<SharedFrame>, TransportError> {
            Ok(None)
        }
        fn wait(&mut self, _: Duration) -> Result<(), TransportError> {
            Ok(())
        }
    }

    struct Case {
        sender: Sender,
        contacts: Contacts<Open>,
        transport: Refusing,
        tally: Tally,
    }

    impl Case {
        /// Creates the sender of a module that touches the modules 1 and 2 on its ports 1 and 2.
        fn new() -> Case {
            let agent = (ModuleId(0), Incarnation(0));
            let emulator = LinkEmulator::new(LinkModel::default(), 1, agent.0, agent.1, 6);
            let mut contacts = Contacts::new(6, false);
            for peer in [1, 2] {
                let (peer_incarnation, peer_port) = (Incarnation(0), Port(0));
                let contact =
                    Contact { session: Session(peer), peer: ModuleId(peer), peer_incarnation, peer_port };
                contacts.change(Port(peer as u8), Revision(peer), Some(contact));
            }
            let (sender, transport) = (Sender::new(agent, emulator), Refusing { least: u32::MAX });
            Case { sender, contacts, transport, tally: Tally::default() }
        }
        fn send(&mut self, port: u8, monotonic: u64) {
            let message = (Port(port), Class::Seed, &Cell::default());
            self.sender.send(Time::ZERO, message, &self.contacts, &mut self.tally);
            self.sender.release(Time::NEVER);
            let now = (Time::ZERO, monotonic);
            self.sender.flush(now, &mut self.contacts, &mut self.transport, &mut self.tally);
        }
        /// Returns the neighbour for which the agent gives up.
        fn silenced(&mut self, monotonic: u64) -> Option<u32> {
            match self.sender.retry(monotonic, &mut self.contacts, &mut self.transport) {
                Err(AgentError::Silenced { peer, .. }) => Some(peer.0),
                _ => None,
            }
        }
    }

    #[test]
    fn a_refused_link_is_tried_again_though_nothing_more_is_sent() {
        let mut case = Case::new();
        case.send(1, 0);
        assert_eq!((case.silenced(IN_VAIN), case.silenced(IN_VAIN + 1)), (None, Some(1)));
        case.transport.least = 0;
        assert_eq!(case.silenced(IN_VAIN + 1), None);
        // It is open now.
        case.transport.least = u32::MAX;
        assert_eq!(case.silenced(3 * IN_VAIN), None);
    }

    /// The contact that was refused last ends, and another link is opened: the first contact stays cut off all the same.
    #[test]
    fn every_refused_link_is_tried_again() {
        let mut case = Case::new();
        case.send(1, 0);
        case.send(2, 1);
        case.contacts.change(Port(2), Revision(3), None);
        assert_eq!(case.silenced(IN_VAIN + 1), Some(1));

        let mut case = Case::new();
        case.send(1, 0);
        case.transport.least = 2;
        case.send(2, 1);
        assert_eq!((case.silenced(IN_VAIN + 1), case.silenced(IN_VAIN + 2)), (None, Some(1)));
    }

    #[test]
    fn a_contact_that_has_ended_is_not_tried_again() {
        let mut case = Case::new();
        case.send(1, 0);
        case.contacts.change(Port(1), Revision(3), None);
        assert_eq!(case.silenced(3 * IN_VAIN), None);
        // A later refusal has its own time.
        case.send(2, 3 * IN_VAIN);
        assert_eq!((case.silenced(4 * IN_VAIN), case.silenced(4 * IN_VAIN + 1)), (None, Some(2)));
    }
}
