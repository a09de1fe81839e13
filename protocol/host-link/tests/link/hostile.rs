//! A link whose other end is hostile: it sends what it likes, with sound check sums, without the secret or with it. Nothing
//! panics, nothing is taken without proof, all bounds and counts hold.

use crate::pair::{Plain, WINDOW, config};
use metamorph_core::counters::Class;
use metamorph_core::ids::{HostId, Incarnation, ModuleId, Port};
use metamorph_core::lattice::Cell;
use metamorph_core::time::{Span, Time};
use metamorph_core::wire::{self, Frame, Header};
use metamorph_host_link::packet::{Ack, Content, Life, Packet, Proof, Run, Terms};
use metamorph_host_link::{Channel, HostLink, Output, Prover, STREAM_WINDOW};
use proptest::prelude::*;

/// The life of the hostile end; others that it claims are near it.
const LIFE: u64 = 2;

/// Next action of the hostile end.
#[derive(Clone, Debug)]
enum Act {
    Bytes(Vec<u8>),
    /// A packet with fields that mostly fit; `fits` repairs what would be refused at once.
    Packet {
        content: Content,
        life: u64,
        fits: bool,
    },
    /// Answers the latest greeting as an end that knows the secret does, with wrong terms in one case of four.
    Answer(u8),
    Pass(u64),
    Write(usize),
    Offer,
}

fn frame(sequence: u32) -> Frame {
    let header = Header {
        channel: wire::Channel::Peer,
        kind: 0,
        class: Class::ALL[sequence as usize % Class::ALL.len()],
        port: Port(0),
        incarnation: Incarnation(0),
        source: ModuleId(1),
        destination: ModuleId(0),
        session: 0,
        sequence,
    };
    Frame::seal(header, &Cell::default())
}

/// Numbers that are near zero, near the largest, or anywhere.
fn number() -> impl Strategy<Value = u64> {
    prop_oneof![4 => 0..40u64, 1 => (0..9u64).prop_map(|n| u64::MAX - n), 1 => any::<u64>()]
}

fn content() -> impl Strategy<Value = Content> {
    let terms = || {
        any::<(u8, u8)>().prop_map(|(program, build)| Terms {
            program: u32::from(program % 3),
            build: u64::from(build % 4),
            swarm: 3,
            room: 4,
        })
    };
    let bytes = || proptest::collection::vec(any::<u8>(), 0..60);
    let taken = proptest::collection::vec(0..30u64, Class::ALL.len());
    let ack = ((number(), number(), number(), number()), taken, any::<bool>(), (number(), number()));
    let ack = ack.prop_map(|((stream, bulk, expected, clock), taken, echoes, (echo, heard))| Ack {
        stream,
        bulk,
        expected,
        taken: taken.try_into().unwrap_or_default(),
        clock: Time(clock),
        echo: echoes.then_some((Time(echo), Time(heard))),
    });
    prop_oneof![
        (number(), terms()).prop_map(|(attempt, terms)| Content::Hello { attempt, terms }),
        (number(), number(), terms(), any::<Proof>()).prop_map(|(attempt, challenge, terms, proof)| {
            Content::Accept { attempt, challenge, terms, proof }
        }),
        (number(), any::<Proof>()).prop_map(|(challenge, proof)| Content::Confirm { challenge, proof }),
        (number(), 0..30u32)
            .prop_map(|(first, n)| Content::Frames { first, frames: (0..n).map(frame).collect() }),
        (number(), bytes()).prop_map(|(offset, bytes)| Content::Stream { offset, bytes }),
        (number(), bytes()).prop_map(|(offset, bytes)| Content::Bulk { offset, bytes }),
        ack.prop_map(Content::Ack),
        Just(Content::Bye),
    ]
}

fn act() -> impl Strategy<Value = Act> {
    prop_oneof![
        2 => proptest::collection::vec(any::<u8>(), 0..120).prop_map(Act::Bytes),
        8 => (content(), 0..3u64, prop::bool::weighted(0.8))
            .prop_map(|(content, life, fits)| Act::Packet { content, life: LIFE + life, fits }),
        3 => any::<u8>().prop_map(Act::Answer),
        2 => (1..1_500u64).prop_map(Act::Pass),
        1 => (1..200usize).prop_map(Act::Write),
        1 => Just(Act::Offer),
    ]
}

/// The honest end, and what it has said last.
struct Honest {
    link: HostLink<Plain>,
    now: Time,
    i: usize,
    /// The numbers of the latest hello or accept that it has sent.
    asked: u64,
    met: u64,
}

impl Honest {
    fn new(i: usize) -> Honest {
        let mut link = HostLink::new(config(i, 1, None), Plain);
        let now = Time(1_000_000_000);
        link.carrier_up(now);
        let mut honest = Honest { link, now, i, asked: 0, met: 0 };
        honest.poll();
        honest
    }

    /// Takes outputs. Returns the numbers of frames and bytes that were taken.
    fn poll(&mut self) -> u64 {
        let mut taken = 0;
        while let Some(output) = self.link.poll() {
            match output {
                Output::Packet(bytes) => match Packet::decode(&bytes).map(|packet| packet.content) {
                    Ok(Content::Hello { attempt, .. }) => self.asked = attempt,
                    Ok(Content::Accept { challenge, .. }) => self.asked = challenge,
                    Ok(_) => {}
                    Err(e) => panic!("an honest end has sent a bad packet: {e}"),
                },
                Output::Met(..) => self.met += 1,
                Output::Frame(frame) => {
                    assert!(frame.open().is_ok(), "a damaged frame was taken");
                    taken += 1;
                }
                Output::Bytes(_, bytes) => taken += bytes.len() as u64,
                Output::Changed(_) => {}
            }
        }
        let window = STREAM_WINDOW;
        assert!(self.link.counts().balance(), "the counts of frames do not add up");
        assert!(self.link.open_frames() <= WINDOW);
        assert!(self.link.open_bytes(Channel::Stream) <= window);
        taken
    }

    fn packet(&self, content: Content, life: u64) -> Packet {
        let (from, to) = (HostId(1 - self.i as u16), HostId(self.i as u16));
        Packet { from, to, run: Run(7), life: Life(life), peer_life: self.link.life(), content }
    }

    fn act(&mut self, act: Act, knows_the_secret: bool) {
        match act {
            Act::Bytes(bytes) => {
                let _ = self.link.receive(self.now, &bytes);
            }
            Act::Packet { content, life, fits } => {
                let mut packet = self.packet(content, life);
                if !fits {
                    packet.run = Run(8);
                }
                let _ = self.link.receive(self.now, &packet.encode());
            }
            Act::Answer(kind) if knows_the_secret => {
                let terms =
                    Terms { program: 1 + u32::from(kind.is_multiple_of(4)), build: 2, swarm: 3, room: 4 };
                let them = (HostId(1 - self.i as u16), Life(LIFE));
                let us = (HostId(self.i as u16), self.link.life());
                let proof = Plain.prove(Run(7), them, us, self.asked);
                let content = match self.i {
                    0 => Content::Accept { attempt: self.asked, challenge: 5, terms, proof },
                    _ => Content::Confirm { challenge: self.asked, proof },
                };
                let packet = self.packet(content, LIFE);
                let _ = self.link.receive(self.now, &packet.encode());
            }
            Act::Answer(_) => {}
            Act::Pass(ms) => {
                self.now += Span::millis(ms);
                self.link.wake(self.now);
            }
            Act::Write(length) => {
                let _ = self.link.write(self.now, Channel::Stream, &vec![7; length]);
            }
            Act::Offer => {
                let _ = self.link.offer(self.now, &frame(3));
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2_000, failure_persistence: None, ..ProptestConfig::default() })]

    /// Without the secret nothing is taken, and no link comes up.
    #[test]
    fn without_the_secret_nothing_is_taken(
        i in 0..2usize,
        acts in proptest::collection::vec(act(), 0..80),
    ) {
        let mut honest = Honest::new(i);
        for act in acts {
            honest.act(act, false);
            prop_assert_eq!((honest.poll(), honest.met), (0, 0));
        }
    }

    /// With it, a hostile end does what it likes with its own frames and bytes, and breaks nothing else.
    #[test]
    fn with_the_secret_bounds_and_counts_hold(
        i in 0..2usize,
        acts in proptest::collection::vec(act(), 0..120),
    ) {
        let mut honest = Honest::new(i);
        for act in acts {
            honest.act(act, true);
            honest.poll();
        }
    }
}

/// The generator reaches what it is for: links come up with the secret, and frames and bytes are taken.
#[test]
fn hostile_ends_get_through_with_the_secret() {
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;
    let mut runner = TestRunner::deterministic();
    let (mut met, mut taken) = (0, 0);
    for round in 0..300 {
        let acts =
            proptest::collection::vec(act(), 120).new_tree(&mut runner).expect("it has values").current();
        let mut honest = Honest::new(round % 2);
        for act in acts {
            honest.act(act, true);
            taken += honest.poll();
        }
        met += honest.met;
    }
    assert!(met > 100 && taken > 300, "{met} links came up, {taken} frames and bytes were taken");
}
