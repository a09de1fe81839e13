//! Keeps the contact on each port with its link, and finds the contact that a frame from a peer belongs to.
//!
//! A peer may learn of a new contact and use it before this process has learnt of it. Frames of sessions not
//! known yet wait here, a bounded number for a bounded time; frames of ended sessions never count for a later
//! contact.

use crate::transport::shared_frame::SharedFrame;
use crate::transport::{EGRESS_DEPTH, INBOX_DEPTH};
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::{Port, Revision, Session};
use metamorph_protocol::runtime::Contact;
use metamorph_protocol::wire::Header;
use std::collections::VecDeque;

/// Number of frames that may wait for their contact.
pub const EARLY_LIMIT: usize = 64;
/// Number of ended sessions remembered. A frame of a forgotten one waits and then expires as well.
const ENDED_LIMIT: usize = 64;
/// How long a frame waits for its contact (ns of real time); a busy machine may take seconds to announce one.
const EARLY_NANOS: u64 = 10_000_000_000;

/// The contact on one port.
#[derive(Debug)]
pub struct PortContact<L> {
    /// The other end.
    pub contact: Contact,
    /// The link to the peer, opened on first use.
    pub link: Option<L>,
    /// Number of messages sent over the link, by class.
    pub sent: [u64; Class::ALL.len()],
    /// True if it was found that the peer has no inbox.
    pub unreached: bool,
    /// True if the link could not be opened when it was last tried, for want of memory or descriptors.
    pub refused: bool,
}

/// The contact that a frame from a peer belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// The current contact on this port.
    Here(Port),
    /// A contact not known yet.
    Early,
    /// An ended contact.
    Ended,
    /// A current contact, but the frame is not from its peer.
    Impostor,
}

/// All contacts of one agent.
#[derive(Debug)]
pub struct Contacts<L> {
    ports: Vec<Option<PortContact<L>>>,
    revision: Revision,
    ended: VecDeque<Session>,
    early: VecDeque<(u64, Header, SharedFrame)>,
    loose: [u64; Class::ALL.len()],
    is_divided: bool,
}

impl<L> Contacts<L> {
    /// Creates a table of `ports` ports without contacts, of an agent of a swarm that is on several hosts if `is_divided`.
    pub fn new(ports: usize, is_divided: bool) -> Contacts<L> {
        Contacts {
            ports: std::iter::repeat_with(|| None).take(ports).collect(),
            revision: Revision(0),
            ended: VecDeque::new(),
            early: VecDeque::new(),
            loose: [0; Class::ALL.len()],
            is_divided,
        }
    }

    /// Returns, by class, how many messages may have been lost at most because their link was closed when its
    /// contact ended: a receiver that has not read its inbox since the link was opened cannot read them.
    pub fn loose(&self) -> [u64; Class::ALL.len()] {
        self.loose
    }

    /// Notes that another controller forwards frames for agents of other hosts from now on: what its predecessor had not
    /// taken is lost. Which contacts those are is not known here, so all count. Returns the same as [`Contacts::loose`].
    pub fn redirect(&mut self) -> [u64; Class::ALL.len()] {
        for port in self.ports.iter().flatten().filter(|_| self.is_divided) {
            for (loose, sent) in self.loose.iter_mut().zip(port.sent) {
                *loose += sent.min(EGRESS_DEPTH as u64);
            }
        }
        self.loose
    }

    /// Returns the revision of the last contact change that the agent knows of.
    pub fn revision(&self) -> Revision {
        self.revision
    }

    /// True if there is such a port.
    pub fn has_port(&self, port: Port) -> bool {
        port.index() < self.ports.len()
    }

    /// Returns the current contact on a port.
    pub fn get(&self, port: Port) -> Option<&Contact> {
        self.ports.get(port.index())?.as_ref().map(|p| &p.contact)
    }

    /// Returns the current contact on a port, with the link to the peer.
    pub fn get_mut(&mut self, port: Port) -> Option<&mut PortContact<L>> {
        self.ports.get_mut(port.index())?.as_mut()
    }

    /// Returns the current contacts, with the links to the peers.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut PortContact<L>> {
        self.ports.iter_mut().flatten()
    }

    /// Changes the contact on an existing port, as of `revision`. Returns the frames that waited for the new
    /// contact, in the order in which they came.
    pub fn change(
        &mut self,
        port: Port,
        revision: Revision,
        contact: Option<Contact>,
    ) -> Vec<(Header, SharedFrame)> {
        self.revision = revision;
        let old = self.ports[port.index()].take();
        if let Some(old) = old {
            if contact == Some(old.contact) {
                self.ports[port.index()] = Some(old);
                return Vec::new();
            }
            if self.ended.len() == ENDED_LIMIT {
                self.ended.pop_front();
            }
            self.ended.push_back(old.contact.session);
            for (loose, sent) in self.loose.iter_mut().zip(old.sent) {
                *loose += sent.min(INBOX_DEPTH as u64);
            }
        }
        let Some(contact) = contact else { return Vec::new() };
        self.ports[port.index()] = Some(PortContact {
            contact,
            link: None,
            sent: [0; Class::ALL.len()],
            unreached: false,
            refused: false,
        });
        let (now, later): (VecDeque<_>, VecDeque<_>) = std::mem::take(&mut self.early)
            .into_iter()
            .partition(|(_, header, _)| header.session == contact.session.0);
        self.early = later;
        now.into_iter().map(|(_, header, frame)| (header, frame)).collect()
    }

    /// Returns the contact that a frame from a peer belongs to.
    pub fn place(&self, header: &Header) -> Place {
        let session = Session(header.session);
        for (i, port) in self.ports.iter().enumerate() {
            let Some(PortContact { contact, .. }) = port else { continue };
            if contact.session == session {
                let fits = contact.peer == header.source
                    && contact.peer_incarnation == header.incarnation
                    && contact.peer_port == header.port;
                return if fits { Place::Here(Port(i as u8)) } else { Place::Impostor };
            }
        }
        if self.ended.contains(&session) { Place::Ended } else { Place::Early }
    }

    /// Keeps a frame until its contact is known. If [`EARLY_LIMIT`] frames wait already, drops the oldest and
    /// returns its class.
    pub fn keep(&mut self, monotonic: u64, header: Header, frame: SharedFrame) -> Option<Class> {
        let gone = if self.early.len() == EARLY_LIMIT { self.early.pop_front() } else { None };
        self.early.push_back((monotonic, header, frame));
        gone.map(|(_, header, _)| header.class)
    }

    /// Drops the oldest waiting frame if it has waited too long, and returns its class. At [`u64::MAX`],
    /// every frame has waited too long.
    pub fn expire(&mut self, monotonic: u64) -> Option<Class> {
        let (since, header, _) = self.early.front()?;
        if monotonic.saturating_sub(*since) < EARLY_NANOS {
            return None;
        }
        let class = header.class;
        self.early.pop_front();
        Some(class)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::ids::{Incarnation, ModuleId};
    use metamorph_protocol::lattice::Cell;
    use metamorph_protocol::time::Time;
    use metamorph_protocol::wire::{Channel, Frame};

    fn contact(session: u32) -> Contact {
        Contact {
            session: Session(session),
            peer: ModuleId(7),
            peer_incarnation: Incarnation(1),
            peer_port: Port(4),
        }
    }
    fn header(session: u32) -> Header {
        Header {
            channel: Channel::Peer,
            kind: 0,
            class: Class::Seed,
            port: Port(4),
            incarnation: Incarnation(1),
            source: ModuleId(7),
            destination: ModuleId(0),
            session,
            sequence: 0,
        }
    }
    fn frame(session: u32) -> (Header, SharedFrame) {
        let frame = Frame::seal(header(session), &Cell::default());
        (header(session), SharedFrame::new(&frame, Time::ZERO))
    }

    #[test]
    fn frames_belong_to_their_session_and_to_no_other() {
        let mut contacts = Contacts::<()>::new(6, false);
        assert_eq!(contacts.place(&header(5)), Place::Early);
        contacts.change(Port(2), Revision(1), Some(contact(5)));
        assert_eq!(contacts.place(&header(5)), Place::Here(Port(2)));
        assert_eq!(contacts.place(&Header { source: ModuleId(8), ..header(5) }), Place::Impostor);
        assert_eq!(contacts.place(&Header { port: Port(0), ..header(5) }), Place::Impostor);
        contacts.change(Port(2), Revision(1), Some(contact(6)));
        assert_eq!(contacts.place(&header(5)), Place::Ended);
        contacts.change(Port(2), Revision(1), None);
        assert_eq!(contacts.place(&header(6)), Place::Ended);
    }

    #[test]
    fn early_frames_wait_in_order_for_a_bounded_time() {
        let mut contacts = Contacts::<()>::new(6, false);
        for session in [5, 6, 5] {
            let (h, f) = frame(session);
            assert_eq!(contacts.keep(0, h, f), None);
        }
        let taken = contacts.change(Port(0), Revision(1), Some(contact(5)));
        let taken: Vec<(Header, Frame)> =
            taken.iter().map(|(header, shared)| (*header, shared.frame())).collect();
        let (header, shared) = frame(5);
        assert_eq!(taken, [(header, shared.frame()); 2]);
        assert_eq!(contacts.expire(EARLY_NANOS - 1), None);
        assert_eq!(contacts.expire(EARLY_NANOS), Some(Class::Seed));
        assert_eq!(contacts.expire(EARLY_NANOS), None);
        for n in 0..EARLY_LIMIT as u32 + 3 {
            let (h, f) = frame(100 + n);
            assert_eq!(contacts.keep(0, h, f).is_some(), n >= EARLY_LIMIT as u32);
        }
    }

    #[test]
    fn saying_the_same_again_changes_nothing() {
        let mut contacts = Contacts::<()>::new(1, false);
        contacts.change(Port(0), Revision(1), Some(contact(5)));
        contacts.change(Port(0), Revision(1), Some(contact(5)));
        assert_eq!(contacts.place(&header(5)), Place::Here(Port(0)));
    }
}
