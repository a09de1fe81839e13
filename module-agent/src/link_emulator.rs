//! The effects of a link on messages, applied by the sender: loss, duplication, delay, reordering, damage and
//! partitions, as [`LinkModel::carry`] draws them. Not here: the drawing itself.

use metamorph_protocol::counters::Class;
use metamorph_protocol::counters::Tally;
use metamorph_protocol::ids::{Incarnation, ModuleId, Port, Session};
use metamorph_protocol::link::{LinkChanges, LinkModel, LinkState};
use metamorph_protocol::rng::Rng;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::Frame;
use std::collections::BTreeMap;

/// Number of frames of one agent that may be held back at a time; more are counted as overflowed.
pub const HELD_LIMIT: usize = 4_096;

/// One frame on its way to the peer on a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DelayedFrame {
    /// The port it leaves by.
    pub port: Port,
    /// The peer.
    pub peer: ModuleId,
    /// The contact session it belongs to.
    pub session: Session,
    /// When the agent handed it over.
    pub handed: Time,
    /// Its class, for the counts.
    pub class: Class,
    /// The frame, damaged if the link damages it.
    pub frame: Frame,
    /// True if the link has damaged it.
    pub damaged: bool,
}

/// The links of one agent, one for each port.
#[derive(Debug)]
pub struct LinkEmulator {
    model: LinkModel,
    transparent: bool,
    from: ModuleId,
    ports: Vec<(Rng, LinkState)>,
    held: BTreeMap<(Time, u64), DelayedFrame>,
    count: u64,
}

impl LinkEmulator {
    /// Creates the links of one incarnation of an agent with `ports` ports, in the run of `seed`.
    pub fn new(
        model: LinkModel,
        seed: u64,
        from: ModuleId,
        incarnation: Incarnation,
        ports: usize,
    ) -> LinkEmulator {
        let stream = |port: usize| {
            let index = u64::from(from.0) << 32 | u64::from(incarnation.0) << 8 | port as u64;
            Rng::named(seed, "process link", index)
        };
        LinkEmulator {
            transparent: model.is_transparent(),
            model,
            from,
            ports: (0..ports).map(|p| (stream(p), LinkState::default())).collect(),
            held: BTreeMap::new(),
            count: 0,
        }
    }

    /// Takes a frame sent at `now`. Copies that pass at once go to `out`; the others are held back until they
    /// are due.
    pub fn carry(&mut self, now: Time, frame: DelayedFrame, tally: &mut Tally, out: &mut Vec<DelayedFrame>) {
        if self.transparent {
            out.push(frame);
            return;
        }
        // Invariant: the wait loop sends only by ports that exist.
        let (stream, state) = &mut self.ports[frame.port.index()];
        let fate = self.model.carry(now, self.from, frame.peer, stream, state);
        let counts = &mut tally[frame.class];
        if fate.arrivals[0].is_none() {
            counts.lost += 1;
        }
        if fate.arrivals[1].is_some() {
            counts.duplicated += 1;
        }
        for arrival in fate.arrivals.into_iter().flatten() {
            let mut frame = frame;
            if let Some(bit) = arrival.flipped_bit {
                frame.frame.flip(bit);
                frame.damaged = true;
            }
            if arrival.at <= now && self.held.is_empty() {
                out.push(frame);
            } else if self.held.len() < HELD_LIMIT {
                self.held.insert((arrival.at, self.count), frame);
                self.count += 1;
            } else {
                counts.overflowed += 1;
            }
        }
    }

    /// Changes what the links do. Frames under way keep the fate that was drawn.
    pub fn change(&mut self, changes: LinkChanges) {
        self.model.changes = changes;
        // A model that becomes transparent again has no delay, so nothing is held back that could be overtaken.
        self.transparent = self.model.is_transparent();
    }

    /// Returns true if a module is at home on another host, so that messages to it go through the hosts.
    pub fn crosses_hosts(&self, to: ModuleId) -> bool {
        self.model.hosts.as_ref().is_some_and(|hosts| hosts.between(self.from, to).is_some())
    }

    /// Resets a port for a new contact: frames of the old one no longer hold back later ones.
    pub fn reset(&mut self, port: Port) {
        if let Some((_, state)) = self.ports.get_mut(port.index()) {
            *state = LinkState::default();
        }
    }

    /// Moves the frames due at `now` to `out`, in the order in which they are due.
    pub fn release(&mut self, now: Time, out: &mut Vec<DelayedFrame>) {
        while let Some(first) = self.held.first_entry() {
            if first.key().0 > now {
                break;
            }
            out.push(first.remove());
        }
    }

    /// Drops the frames held back, and returns their classes.
    pub fn drain(&mut self) -> impl Iterator<Item = Class> {
        std::mem::take(&mut self.held).into_values().map(|frame| frame.class)
    }

    /// Returns when the next frame is due.
    pub fn next(&self) -> Time {
        self.held.first_key_value().map_or(Time::NEVER, |((at, _), _)| *at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::lattice::Cell;
    use metamorph_protocol::time::Span;
    use metamorph_protocol::wire::{Channel, Header, Wire};

    fn frame(n: i16) -> DelayedFrame {
        let message = Cell::new(n, 0, 0);
        let (port, peer, session) = (Port(1), ModuleId(2), Session(3));
        let header = Header {
            channel: Channel::Peer,
            kind: message.kind(),
            class: Class::Seed,
            port,
            incarnation: Incarnation(0),
            source: ModuleId(0),
            destination: peer,
            session: session.0,
            sequence: n as u32,
        };
        DelayedFrame {
            handed: Time::ZERO,
            port,
            peer,
            session,
            class: Class::Seed,
            frame: Frame::seal(header, &message),
            damaged: false,
        }
    }
    fn links(model: LinkModel) -> LinkEmulator {
        LinkEmulator::new(model, 1, ModuleId(0), Incarnation(0), 6)
    }

    #[test]
    fn a_clear_link_passes_everything_at_once() {
        let (mut links, mut tally, mut out) = (links(LinkModel::default()), Tally::default(), vec![]);
        links.carry(Time(5), frame(1), &mut tally, &mut out);
        assert_eq!(out, [frame(1)]);
        assert_eq!((links.next(), tally), (Time::NEVER, Tally::default()));
    }

    #[test]
    fn changed_links_lose_frames_until_they_are_changed_back() {
        let (mut links, mut tally, mut out) = (links(LinkModel::default()), Tally::default(), vec![]);
        let cut = LinkChanges { cut_off: Some((ModuleId(0), ModuleId(0))), ..LinkChanges::default() };
        links.change(cut);
        links.carry(Time(5), frame(1), &mut tally, &mut out);
        assert_eq!((out.len(), tally[Class::Seed].lost), (0, 1));
        links.change(LinkChanges::default());
        links.carry(Time(6), frame(2), &mut tally, &mut out);
        assert_eq!(out, [frame(2)]);
    }

    #[test]
    fn delayed_frames_come_out_in_order_when_due() {
        let model = LinkModel { delay_min: Span(10), delay_max: Span(20), ..LinkModel::default() };
        let (mut links, mut tally, mut out) = (links(model), Tally::default(), vec![]);
        for n in 0..50 {
            links.carry(Time(n as u64), frame(n), &mut tally, &mut out);
        }
        assert!(out.is_empty() && links.next() >= Time(10));
        links.release(Time(100), &mut out);
        assert_eq!(out, (0..50).map(frame).collect::<Vec<_>>());
    }

    #[test]
    fn counts_add_up_even_when_too_much_is_held() {
        let half = "50%".parse().unwrap();
        let model = LinkModel {
            delay_max: Span::secs(1),
            loss: half,
            duplicate: half,
            corrupt: half,
            reorder: half,
            ..LinkModel::default()
        };
        let (mut links, mut tally, mut out) = (links(model), Tally::default(), vec![]);
        for _ in 0..10_000 {
            links.carry(Time::ZERO, frame(1), &mut tally, &mut out);
        }
        links.release(Time(500_000_000), &mut out);
        out.extend(links.drain().map(|class| DelayedFrame { class, damaged: false, ..frame(1) }));
        assert_eq!(links.next(), Time::NEVER);
        let c = tally[Class::Seed];
        assert!(c.overflowed > 0 && c.lost > 0 && c.duplicated > 0);
        assert_eq!(10_000 + c.duplicated, out.len() as u64 + c.lost + c.overflowed);
        assert!(out.iter().any(|p| p.damaged) && out.iter().all(|p| p.damaged == p.frame.open().is_err()));
    }
}
