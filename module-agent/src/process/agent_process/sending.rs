//! What comes out of an agent: actions and reports go to the controller, messages over the link model
//! to its neighbours.

use super::{AgentError, BURST, Driver};
use crate::link_emulator::Parcel;
use crate::transport::iceoryx::outbox::{Handed, Outbox};
use crate::transport::iceoryx::shared_frame::Packet;
use metamorph_protocol::agent::{Agent, Output, OutputOf};
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::Port;
use metamorph_protocol::runtime::Contact;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::{Channel, Frame, Header, Wire};

impl<A: Agent> Driver<'_, A> {
    pub(super) fn carry_out(&mut self, now: Time, output: OutputOf<A>) -> Result<(), AgentError> {
        match output {
            Output::Send { port, class, message } => self.send(now, port, class, &message),
            Output::Act(action) => {
                self.told += 1;
                self.uplink.push(Channel::Body, self.revision.0, &action);
            }
            Output::Report(report) => {
                self.told += 1;
                self.uplink.push(Channel::Control, 0, &report);
            }
        }
        if self.burst.len() >= BURST { self.send_burst(now) } else { Ok(()) }
    }

    fn send(&mut self, now: Time, port: Port, class: Class, message: &A::Message) {
        let counts = &mut self.account.tally[class];
        counts.sent += 1;
        counts.bytes += message.wire_len() as u64;
        let sequence = self.peer_sequence;
        self.peer_sequence = sequence.wrapping_add(1);
        let Some(contact) = self.contacts.get(port) else {
            // Nothing touches this port (any more).
            counts.expired += 1;
            return;
        };
        let header = Header {
            channel: Channel::Peer,
            kind: message.kind(),
            class,
            port,
            incarnation: self.args.incarnation,
            source: self.args.id,
            destination: contact.peer,
            session: contact.session.0,
            sequence,
        };
        let (peer, session) = (contact.peer, contact.session);
        let parcel =
            Parcel { port, peer, session, class, frame: Frame::seal(header, message), damaged: false };
        self.impair.carry(now, parcel, &mut self.account.tally, &mut self.burst);
    }

    /// Sends what has gathered. What is about to be seen by others is written down first; what
    /// could not be sent is written down before the next wait.
    pub(super) fn send_burst(&mut self, now: Time) -> Result<(), AgentError> {
        if self.burst.is_empty() {
            return Ok(());
        }
        self.write_down()?;
        let mut touched = 0u32;
        for parcel in std::mem::take(&mut self.burst) {
            let counts = &mut self.account.tally[parcel.class];
            let Some(way) = self.contacts.get_mut(parcel.port) else {
                counts.expired += 1;
                continue;
            };
            if way.contact.session != parcel.session {
                counts.expired += 1;
                continue;
            }
            if way.outbox.is_none() {
                let Contact { peer, peer_incarnation, .. } = way.contact;
                match Outbox::to_agent(&self.at, peer, peer_incarnation) {
                    Ok(outbox) => way.outbox = Some(outbox),
                    Err(e) if e.is_absent() => {
                        counts.expired += 1;
                        continue;
                    }
                    Err(e) => {
                        tracing::debug!("cannot reach module {peer}: {e}");
                        counts.overflowed += 1;
                        continue;
                    }
                }
            }
            let Some(outbox) = &mut way.outbox else { continue };
            let packet = Packet::new(&parcel.frame, now);
            let packet = if parcel.damaged { packet.damaged(parcel.class) } else { packet };
            match outbox.send_packet(packet) {
                // The shift is below 32: an agent has at most 32 ports.
                Handed::Over => {
                    way.handed[parcel.class.index()] += 1;
                    touched |= 1 << parcel.port.0;
                }
                Handed::Full => {
                    counts.overflowed += 1;
                    touched |= 1 << parcel.port.0;
                }
                Handed::Nobody => counts.expired += 1,
            }
        }
        for port in 0..A::PORTS as u8 {
            if touched & (1 << port) != 0
                && let Some(outbox) = self.contacts.get_mut(Port(port)).and_then(|w| w.outbox.as_mut())
            {
                outbox.flush();
            }
        }
        Ok(())
    }
}
