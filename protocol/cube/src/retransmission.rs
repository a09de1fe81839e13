//! Retransmission hop by hop: what a search sends over a face is repeated until the neighbour there has acknowledged it.
//!
//! A search goes over many hops and back. If it were repeated only from its origin, a route of twelve hops would be found
//! once in two hundred searches where a fifth of all messages is lost. Repeated on each hop, it takes as long as the hops
//! that lose a message are repeated.
//!
//! Messages over one face are numbered. The receiver acknowledges each of them, also one that comes again, and takes it
//! once. Numbers begin at 0 with every session of a contact.

use super::message::Message;
use alloc::collections::VecDeque;
use alloc::vec::Vec;
use core::hash::{Hash, Hasher};
use metamorph_core::lattice::Face;
use metamorph_core::time::{Span, Time};

/// The largest number of messages over one face that wait to be acknowledged.
const MOST_UNHEARD: usize = 32;
/// The number of times that a message is sent, if it is never acknowledged.
const MOST_SENT: u8 = 8;
/// The number of the latest messages of a neighbour among which one that comes again is recognized.
const WINDOW: u16 = 64;

/// A message that waits to be acknowledged.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Unheard {
    number: u16,
    message: Message,
    again: Time,
    sent: u8,
}

/// The messages of the present session over one face, in both directions.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Exchange {
    face: Face,
    /// The number of the next message.
    next: u16,
    unheard: VecDeque<Unheard>,
    /// The number after the latest one that has been heard.
    expected: u16,
    /// Bit `i`: the message `i + 1` before `expected` has been heard.
    heard: u64,
}

/// The messages under way between this module and its neighbours that are repeated.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub(super) struct Retransmission {
    /// In the order of their first message; a module that takes part in no search has none.
    exchanges: Vec<Exchange>,
}

impl Hash for Retransmission {
    /// Without searches the hash of a module is that of one which knows none.
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        self.exchanges.iter().for_each(|exchange| exchange.hash(hasher));
    }
}

impl Retransmission {
    fn with(&mut self, face: Face) -> &mut Exchange {
        let known = self.exchanges.iter().position(|e| e.face == face);
        let index = known.unwrap_or_else(|| {
            let unheard = VecDeque::new();
            self.exchanges.push(Exchange { face, next: 0, unheard, expected: 0, heard: 0 });
            self.exchanges.len() - 1
        });
        &mut self.exchanges[index]
    }

    /// Forgets a face whose contact has begun or ended.
    pub fn on_contact(&mut self, face: Face) {
        self.exchanges.retain(|e| e.face != face);
    }

    /// Returns the message to send over a face, which `numbered` makes, and keeps it to be sent again at `again`.
    pub fn send(&mut self, face: Face, again: Time, numbered: impl FnOnce(u16) -> Message) -> Message {
        let exchange = self.with(face);
        let number = exchange.next;
        exchange.next = number.wrapping_add(1);
        if exchange.unheard.len() == MOST_UNHEARD {
            exchange.unheard.pop_front();
        }
        let message = numbered(number);
        exchange.unheard.push_back(Unheard { number, message, again, sent: 1 });
        message
    }

    /// Takes note that the neighbour on a face has heard a message.
    pub fn on_heard(&mut self, face: Face, number: u16) {
        let exchange = self.exchanges.iter_mut().find(|e| e.face == face);
        exchange.into_iter().for_each(|e| e.unheard.retain(|u| u.number != number));
    }

    /// Takes note of a message of the neighbour on a face. Returns false if it has been heard before.
    pub fn hear(&mut self, face: Face, number: u16) -> bool {
        let exchange = self.with(face);
        let ahead = number.wrapping_sub(exchange.expected);
        if ahead < u16::MAX / 2 {
            let steps = u32::from(ahead) + 1;
            exchange.heard = exchange.heard.checked_shl(steps).unwrap_or(0) | 1;
            exchange.expected = number.wrapping_add(1);
            return true;
        }
        let back = exchange.expected.wrapping_sub(number) - 1;
        // A message older than the window has been sent for the last time long ago.
        let bit = if back < WINDOW { 1u64 << back } else { return false };
        let is_new = exchange.heard & bit == 0;
        exchange.heard |= bit;
        is_new
    }

    /// Repeats what is due; `send` sends a message over a face. What has been sent [`MOST_SENT`] times is given up.
    pub fn tend(&mut self, now: Time, interval: Span, mut send: impl FnMut(Face, Message)) {
        for Exchange { face, unheard, .. } in &mut self.exchanges {
            unheard.retain(|u| now < u.again || u.sent < MOST_SENT);
            for u in unheard.iter_mut().filter(|u| now >= u.again) {
                (u.sent, u.again) = (u.sent + 1, now + interval);
                send(*face, u.message);
            }
        }
    }

    /// Returns when the next message is repeated or given up.
    pub fn due(&self) -> Time {
        let all = self.exchanges.iter().flat_map(|e| &e.unheard);
        all.map(|u| u.again).min().unwrap_or(Time::NEVER)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FACE: Face = Face::East;

    fn numbered(number: u16) -> Message {
        Message::Heard { number }
    }

    /// Each message is taken once, whatever the order and however often it comes, also where numbers begin again at 0.
    #[test]
    fn messages_are_taken_once() {
        for first in [0, u16::MAX - 5] {
            let mut receiver = Retransmission::default();
            if first > 0 {
                // The numbers before have been heard.
                (0..3).for_each(|i| _ = receiver.hear(FACE, i * (u16::MAX / 3)));
                assert!(receiver.hear(FACE, first - 1));
            }
            let number = |i: u16| first.wrapping_add(i);
            for (i, is_new) in
                [(0, true), (0, false), (3, true), (1, true), (3, false), (1, false), (9, true), (2, true)]
            {
                assert_eq!(receiver.hear(FACE, number(i)), is_new, "{first} + {i}");
            }
            assert!(receiver.hear(FACE, number(9 + WINDOW)));
            assert!(!receiver.hear(FACE, number(9)), "older than the window");
        }
    }

    /// A message is repeated until it is acknowledged, and a limited number of times.
    #[test]
    fn what_is_not_acknowledged_is_repeated() {
        let mut sender = Retransmission::default();
        let (step, mut now) = (Span(10), Time::ZERO);
        for _ in 0..2 {
            sender.send(FACE, now + step, numbered);
        }
        sender.on_heard(FACE, 0);
        let mut repeated = Vec::new();
        while sender.due() != Time::NEVER {
            now = sender.due();
            sender.tend(now, step, |_, message| repeated.push(message));
        }
        assert_eq!(repeated, [Message::Heard { number: 1 }; MOST_SENT as usize - 1]);
        assert_eq!(now, Time::ZERO + step * u64::from(MOST_SENT));
        for _ in 0..2 * MOST_UNHEARD {
            sender.send(FACE, now, numbered);
        }
        assert_eq!(sender.exchanges[0].unheard.len(), MOST_UNHEARD);
        sender.on_contact(FACE);
        assert_eq!(sender, Retransmission::default());
    }
}
