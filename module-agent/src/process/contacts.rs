//! The contact on each port with its link, and whether a frame from a peer belongs to it.
//!
//! A peer may learn of a new contact and use it before this process has learnt of it. Frames of
//! sessions that are not known yet wait here, a bounded number for a bounded time; frames of sessions that
//! have ended never count for a later contact.

use crate::transport::INBOX_DEPTH;
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::{Port, Revision, Session};
use metamorph_protocol::runtime::Contact;
use metamorph_protocol::wire::{Frame, Header};
use std::collections::VecDeque;

/// Frames that may wait for their contact.
pub const EARLY_LIMIT: usize = 64;
/// Ended sessions that are remembered. A frame of one forgotten waits and then expires, too.
const ENDED_LIMIT: usize = 64;
/// How long a frame waits for its contact, in nanoseconds of real time; a busy machine may take seconds
/// to tell of one.
const EARLY_NANOS: u64 = 10_000_000_000;

/// The contact on one port, with the link to the peer once something has been sent.
#[derive(Debug)]
pub struct PortContact<L> {
    /// The other end.
    pub contact: Contact,
    /// The link to the peer, opened on first use.
    pub link: Option<L>,
    /// Messages sent over it, by class.
    pub sent: [u64; Class::ALL.len()],
}

/// Where a frame from a peer belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// To the current contact of this port.
    Here(Port),
    /// To a contact that is not known yet.
    Early,
    /// To a contact that has ended.
    Ended,
    /// To a current contact, but its source is no end of it.
    Impostor,
}

/// All contacts of one agent.
#[derive(Debug)]
pub struct Contacts<L> {
    ports: Vec<Option<PortContact<L>>>,
    revision: Revision,
    ended: VecDeque<Session>,
    early: VecDeque<(u64, Header, Frame)>,
    loose: [u64; Class::ALL.len()],
}

impl<L> Contacts<L> {
    /// No contact on any of `ports` ports.
    pub fn new(ports: usize) -> Contacts<L> {
        Contacts {
            ports: std::iter::repeat_with(|| None).take(ports).collect(),
            revision: Revision(0),
            ended: VecDeque::new(),
            early: VecDeque::new(),
            loose: [0; Class::ALL.len()],
        }
    }

    /// Messages by class that may have been lost with a link that was closed when its contact ended: a
    /// receiver that has not looked since the link was opened does not find it any more.
    pub fn loose(&self) -> [u64; Class::ALL.len()] {
        self.loose
    }

    /// The last contact change that the agent knows of.
    pub fn revision(&self) -> Revision {
        self.revision
    }

    /// Whether there is such a port.
    pub fn has_port(&self, port: Port) -> bool {
        port.index() < self.ports.len()
    }

    /// The contact on a port now.
    pub fn get(&self, port: Port) -> Option<&Contact> {
        self.ports.get(port.index())?.as_ref().map(|p| &p.contact)
    }

    /// The contact on a port now, with the link to the peer.
    pub fn get_mut(&mut self, port: Port) -> Option<&mut PortContact<L>> {
        self.ports.get_mut(port.index())?.as_mut()
    }

    /// Changes the contact on a port that exists, as of `revision`. Returns the frames that waited for it, in
    /// order.
    pub fn change(
        &mut self,
        port: Port,
        revision: Revision,
        contact: Option<Contact>,
    ) -> Vec<(Header, Frame)> {
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
        self.ports[port.index()] = Some(PortContact { contact, link: None, sent: [0; Class::ALL.len()] });
        let (now, later): (VecDeque<_>, VecDeque<_>) = std::mem::take(&mut self.early)
            .into_iter()
            .partition(|(_, header, _)| header.session == contact.session.0);
        self.early = later;
        now.into_iter().map(|(_, header, frame)| (header, frame)).collect()
    }

    /// Finds out where a frame from a peer belongs.
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

    /// Keeps a frame until its contact is known. Returns the class of the one that is dropped for it, if the
    /// limit is reached.
    pub fn keep(&mut self, monotonic: u64, header: Header, frame: Frame) -> Option<Class> {
        let gone = if self.early.len() == EARLY_LIMIT { self.early.pop_front() } else { None };
        self.early.push_back((monotonic, header, frame));
        gone.map(|(_, header, _)| header.class)
    }

    /// Drops one frame that has waited too long and returns its class; at [`u64::MAX`] all have.
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
    use metamorph_protocol::wire::Channel;

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
    fn frame(session: u32) -> (Header, Frame) {
        (header(session), Frame::seal(header(session), &Cell::default()))
    }

    #[test]
    fn frames_belong_to_their_session_and_to_no_other() {
        let mut contacts = Contacts::<()>::new(6);
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
        let mut contacts = Contacts::<()>::new(6);
        for session in [5, 6, 5] {
            let (h, f) = frame(session);
            assert_eq!(contacts.keep(0, h, f), None);
        }
        assert_eq!(contacts.change(Port(0), Revision(1), Some(contact(5))), [frame(5), frame(5)]);
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
        let mut contacts = Contacts::<()>::new(1);
        contacts.change(Port(0), Revision(1), Some(contact(5)));
        contacts.change(Port(0), Revision(1), Some(contact(5)));
        assert_eq!(contacts.place(&header(5)), Place::Here(Port(0)));
    }
}
