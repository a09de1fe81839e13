//! Control messages between agent processes and the controller, about the life cycle of agents and their
//! contacts. Their bytes are part of the wire format.
//!
//! | kind | message | from | payload |
//! |---|---|---|---|
//! | 0 | hello | agent | pid (4) |
//! | 1 | begin | controller | kind of place (1), place |
//! | 2 | contact | controller | port (1), revision (4), present (1), then session (4), peer (4), its incarnation (2), its port (1) |
//! | 3 | stop | controller | |
//! | 4 | return | controller | |
//! | 5 | here | agent | told (4), expected (4) |
//! | 6 | leave | controller | |
//! | 7 | taken | agent | expected (4) |
//! | 8 | late | agent | since (8), by (8) |
//! | 9 | silent | agent | |
//! | 10 | end | controller | |
//! | 11 | links | controller | changed loss (1), numerator (4), denominator (4), cut (1), first (4), last (4) |
//! | 12 | unreached | agent | peer (4), its incarnation (2) |

use crate::clock::lateness::Late;
use metamorph_protocol::ids::{Incarnation, ModuleId, Port, Revision, Session};
use metamorph_protocol::link::LinkChanges;
use metamorph_protocol::runtime::Contact;
use metamorph_protocol::time::{Span, Time};
use metamorph_protocol::wire::{Decoder, Encoder, Wire, WireError};

/// A message about life cycle or contacts. `P` is the place of a body.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RuntimeMessage<P> {
    /// The agent's process is up and its inbox is open.
    Hello {
        /// Its process id.
        pid: u32,
    },
    /// The run begins, or continues for a restarted agent.
    Begin {
        /// The place of the body; at most 95 bytes on the wire.
        place: P,
    },
    /// The contact on a port changed.
    Contact {
        /// The port.
        port: Port,
        /// The count of contact changes of the body, this one included.
        revision: Revision,
        /// The other end of the port now.
        contact: Option<Contact>,
    },
    /// The run is over: the agent takes and sends nothing more, reports that it is silent, and counts the
    /// frames that still arrive. Said once more when all agents are silent, and answered again: then every link that is
    /// open has been found by its receiver.
    Stop,
    /// A new controller took over: read the lease again. Unauthenticated and unsequenced, so it is only a
    /// hint.
    Return,
    /// The agent has found the new controller.
    Here {
        /// Number of actions and reports that this incarnation has sent. All of them are in its part of the
        /// journal; it does not repeat those that no controller has taken.
        told: u32,
        /// The sequence number expected next from the controller.
        expected: u32,
    },
    /// The controller is about to close its link to the agent until its next message, and asks which messages
    /// have been taken. Unauthenticated and unsequenced.
    Leave,
    /// Answers [`RuntimeMessage::Leave`]: all messages before this sequence number have been taken.
    Consumed {
        /// The sequence number expected next from the controller.
        expected: u32,
    },
    /// An input was taken, or a wake-up came, too late: by more than half of what the run tolerates.
    Late(Late),
    /// The agent sends nothing more.
    Silent,
    /// All agents are silent: the process counts the rest of its inbox, and ends.
    End,
    /// From now on this is changed about its links, and nothing else.
    Links(LinkChanges),
    /// A neighbour at home on the same host has no inbox: it has ended, or its inbox was removed from outside. Said once for each contact.
    Unreached {
        /// The neighbour.
        peer: ModuleId,
        /// Its incarnation.
        incarnation: Incarnation,
    },
}

impl<P: Wire> Wire for RuntimeMessage<P> {
    fn kind(&self) -> u8 {
        match self {
            RuntimeMessage::Hello { .. } => 0,
            RuntimeMessage::Begin { .. } => 1,
            RuntimeMessage::Contact { .. } => 2,
            RuntimeMessage::Stop => 3,
            RuntimeMessage::Return => 4,
            RuntimeMessage::Here { .. } => 5,
            RuntimeMessage::Leave => 6,
            RuntimeMessage::Consumed { .. } => 7,
            RuntimeMessage::Late(_) => 8,
            RuntimeMessage::Silent => 9,
            RuntimeMessage::End => 10,
            RuntimeMessage::Links(_) => 11,
            RuntimeMessage::Unreached { .. } => 12,
        }
    }

    fn encode(&self, out: &mut Encoder) {
        match self {
            RuntimeMessage::Hello { pid } => out.u32(*pid),
            RuntimeMessage::Begin { place } => {
                out.u8(place.kind());
                place.encode(out);
            }
            RuntimeMessage::Contact { port, revision, contact } => {
                out.u8(port.0);
                out.u32(revision.0);
                out.bool(contact.is_some());
                if let Some(c) = contact {
                    out.u32(c.session.0);
                    out.u32(c.peer.0);
                    out.u16(c.peer_incarnation.0);
                    out.u8(c.peer_port.0);
                }
            }
            RuntimeMessage::Stop
            | RuntimeMessage::Return
            | RuntimeMessage::Leave
            | RuntimeMessage::Silent
            | RuntimeMessage::End => {}
            RuntimeMessage::Late(late) => {
                out.u64(late.since.0);
                out.u64(late.by.0);
            }
            RuntimeMessage::Consumed { expected } => out.u32(*expected),
            RuntimeMessage::Links(changes) => changes.encode(out),
            RuntimeMessage::Unreached { peer, incarnation } => {
                out.u32(peer.0);
                out.u16(incarnation.0);
            }
            RuntimeMessage::Here { told, expected } => {
                out.u32(*told);
                out.u32(*expected);
            }
        }
    }

    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<RuntimeMessage<P>, WireError> {
        match kind {
            0 => Ok(RuntimeMessage::Hello { pid: from.u32()? }),
            1 => {
                let kind = from.u8()?;
                Ok(RuntimeMessage::Begin { place: P::decode(kind, from)? })
            }
            2 => {
                let (port, revision) = (Port(from.u8()?), Revision(from.u32()?));
                let contact = if from.bool("present")? {
                    Some(Contact {
                        session: Session(from.u32()?),
                        peer: ModuleId(from.u32()?),
                        peer_incarnation: Incarnation(from.u16()?),
                        peer_port: Port(from.u8()?),
                    })
                } else {
                    None
                };
                Ok(RuntimeMessage::Contact { port, revision, contact })
            }
            3 => Ok(RuntimeMessage::Stop),
            4 => Ok(RuntimeMessage::Return),
            5 => Ok(RuntimeMessage::Here { told: from.u32()?, expected: from.u32()? }),
            6 => Ok(RuntimeMessage::Leave),
            7 => Ok(RuntimeMessage::Consumed { expected: from.u32()? }),
            8 => Ok(RuntimeMessage::Late(Late { since: Time(from.u64()?), by: Span(from.u64()?) })),
            9 => Ok(RuntimeMessage::Silent),
            10 => Ok(RuntimeMessage::End),
            11 => Ok(RuntimeMessage::Links(LinkChanges::decode(from)?)),
            12 => Ok(RuntimeMessage::Unreached {
                peer: ModuleId(from.u32()?),
                incarnation: Incarnation(from.u16()?),
            }),
            _ => Err(WireError::Kind(kind)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::counters::Class;
    use metamorph_protocol::lattice::Cell;
    use metamorph_protocol::ratio::Ratio;
    use metamorph_protocol::wire::{CONTROLLER, Channel, Frame, HEADER, Header};
    use proptest::prelude::*;

    fn seal(message: &RuntimeMessage<Cell>) -> Frame {
        let header = Header {
            channel: Channel::Runtime,
            kind: message.kind(),
            class: Class::World,
            port: Port(0),
            incarnation: Incarnation(0),
            source: CONTROLLER,
            destination: ModuleId(1),
            session: 0,
            sequence: 0,
        };
        Frame::seal(header, message)
    }

    /// Both ends must agree on these bytes.
    #[test]
    fn golden_bytes() {
        let contact = Contact {
            session: Session(0x01020304),
            peer: ModuleId(9),
            peer_incarnation: Incarnation(2),
            peer_port: Port(5),
        };
        let (port, revision) = (Port(3), Revision(7));
        let late = Late { since: Time(0x0102), by: Span(3) };
        let links = LinkChanges { loss: Ratio::new(1, 20), cut_off: Some((ModuleId(3), ModuleId(0x0107))) };
        let cases: [(RuntimeMessage<Cell>, u8, &[u8]); 14] = [
            (RuntimeMessage::Hello { pid: 0x0A0B }, 0, &[0x0B, 0x0A, 0, 0]),
            (RuntimeMessage::Begin { place: Cell::new(1, -1, 2) }, 1, &[0, 1, 0, 0xFF, 0xFF, 2, 0]),
            (
                RuntimeMessage::Contact { port, revision, contact: Some(contact) },
                2,
                &[3, 7, 0, 0, 0, 1, 4, 3, 2, 1, 9, 0, 0, 0, 2, 0, 5],
            ),
            (RuntimeMessage::Contact { port, revision, contact: None }, 2, &[3, 7, 0, 0, 0, 0]),
            (RuntimeMessage::Stop, 3, &[]),
            (RuntimeMessage::Return, 4, &[]),
            (RuntimeMessage::Here { told: 0x0102, expected: 3 }, 5, &[2, 1, 0, 0, 3, 0, 0, 0]),
            (RuntimeMessage::Leave, 6, &[]),
            (RuntimeMessage::Consumed { expected: 0x0203 }, 7, &[3, 2, 0, 0]),
            (RuntimeMessage::Late(late), 8, &[2, 1, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0]),
            (RuntimeMessage::Silent, 9, &[]),
            (
                RuntimeMessage::Unreached { peer: ModuleId(0x0201), incarnation: Incarnation(3) },
                12,
                &[1, 2, 0, 0, 3, 0],
            ),
            (RuntimeMessage::End, 10, &[]),
            (RuntimeMessage::Links(links), 11, &[1, 1, 0, 0, 0, 20, 0, 0, 0, 1, 3, 0, 0, 0, 7, 1, 0, 0]),
        ];
        for (message, kind, payload) in cases {
            let frame = seal(&message);
            assert_eq!(&frame.as_bytes()[HEADER..HEADER + payload.len()], payload, "{message:?}");
            assert_eq!(frame.wire_len(), HEADER + payload.len());
            assert_eq!(frame.open().map(|h| h.kind), Ok(kind));
            assert_eq!(frame.message(), Ok(message));
        }
    }

    proptest! {
        /// Arbitrary bytes in shared memory are read or refused, without a panic.
        #[test]
        fn garbage_never_panics(bytes in proptest::collection::vec(any::<u8>(), Frame::SIZE)) {
            let array: [u8; Frame::SIZE] = bytes.try_into().unwrap();
            let _ = Frame::from_bytes(array).message::<RuntimeMessage<Cell>>();
        }
    }
}
