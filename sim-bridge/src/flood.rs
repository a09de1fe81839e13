//! The smallest useful agent: one module floods its distance in hops, every other takes the first
//! word it hears and passes it on once to everybody else. What is left of a run's cost is the
//! kernel's, which is what this is for.
//!
//! On links whose delays differ by less than one part in the number of hops, the first word comes
//! over a shortest way, so distances are exact and the number of messages is `2E − (N − 1)`.

use crate::direct::{Command, Direct};
use crate::world::World;
use metamorph_protocol::agent::{Agent, Birth, Class, Input, InputOf, Output, OutputOf};
use metamorph_protocol::ids::{ModuleId, Port};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::{Decoder, Encoder, HEADER, Never, Wire, WireError};
use std::hash::Hasher;
use std::sync::Arc;

/// How far the sender is from where the flood began.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hops(pub u32);

impl Wire for Hops {
    fn kind(&self) -> u8 {
        0
    }
    fn encode(&self, out: &mut Encoder) {
        out.u32(self.0);
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Hops, WireError> {
        if kind == 0 { Ok(Hops(from.u32()?)) } else { Err(WireError::Kind(kind)) }
    }
    fn wire_len(&self) -> usize {
        HEADER + 4
    }
}

/// A module of the flood.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flooded {
    hops: u32,
    /// Faces that touch somebody, and faces still to be told, a bit each.
    faces: u8,
    untold: u8,
    begins: bool,
}

const UNKNOWN: u32 = u32::MAX;

impl Flooded {
    /// The distance, once it is known.
    pub fn hops(&self) -> Option<u32> {
        (self.hops != UNKNOWN).then_some(self.hops)
    }
}

impl Agent for Flooded {
    type Setup = ();
    type Place = Cell;
    type Message = Hops;
    type Action = Never;
    type Percept = Never;
    type Order = Never;
    type Report = Never;

    const PORTS: usize = 6;

    fn new(_: &Arc<()>, birth: Birth<Cell>, _now: Time) -> Flooded {
        Flooded { hops: UNKNOWN, faces: 0, untold: 0, begins: birth.id == ModuleId(0) }
    }

    fn handle(&mut self, _now: Time, input: InputOf<Flooded>) {
        match input {
            Input::Contact { port, session } => {
                let bit = 1 << port.0;
                self.faces = if session.is_some() { self.faces | bit } else { self.faces & !bit };
            }
            Input::Message { port, message } if self.hops == UNKNOWN => {
                self.hops = message.0 + 1;
                self.untold = self.faces & !(1 << port.0);
            }
            Input::Wake if self.begins => {
                (self.hops, self.untold, self.begins) = (0, self.faces, false);
            }
            Input::Message { .. } | Input::Wake => {}
            Input::Percept(never) | Input::Order(never) => match never {},
        }
    }

    fn poll(&mut self) -> Option<OutputOf<Flooded>> {
        let port = Port(u8::try_from(self.untold.trailing_zeros()).ok().filter(|p| *p < 8)?);
        self.untold &= self.untold - 1;
        Some(Output::Send { port, class: Class::Gradient, message: Hops(self.hops) })
    }

    fn wake_at(&self) -> Time {
        if self.begins { Time::ZERO } else { Time::NEVER }
    }

    fn digest(&self, hasher: &mut dyn Hasher) {
        hasher.write_u32(self.hops);
    }
}

/// A controller that wants nothing; the run ends when nothing is left to happen.
pub struct Onlooker;

impl<W: World<Agent = Flooded>> Direct<W> for Onlooker {
    fn report(&mut self, _: Time, _: ModuleId, report: Never) {
        match report {}
    }
    fn died(&mut self, _: Time, _: ModuleId) {}
    fn started(&mut self, _: Time, _: ModuleId) {}
    fn wake(&mut self, _: Time, _: &mut W) {}
    fn wake_at(&self) -> Time {
        Time::NEVER
    }
    fn poll(&mut self) -> Option<Command<Never>> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::{Sim, SimConfig};
    use crate::still_world::StillWorld;
    use metamorph_protocol::link::LinkModel;
    use metamorph_protocol::time::Span;

    #[test]
    fn everybody_learns_the_distance_and_tells_it_once() {
        for side in [1, 2, 5, 9] {
            let link = LinkModel {
                delay_min: Span::millis(100),
                delay_max: Span::millis(101),
                ..LinkModel::default()
            };
            let config = SimConfig {
                setup: Arc::new(()),
                link,
                seed: 1,
                audit_every: Span::secs(1),
                ignore_sessions: false,
            };
            let world = StillWorld::<Flooded>::new(side);
            let (modules, contacts) = (world.len() as u64, world.contacts());
            let mut sim = Sim::new(config, world, Onlooker);
            assert!(sim.run_until(Time(Span::secs(1_000).0)));
            let counts = sim.tally()[Class::Gradient];
            let expected = 2 * contacts - (modules - 1);
            assert_eq!((counts.sent, counts.delivered, counts.in_flight()), (expected, expected, 0));
            assert_eq!(sim.violations().1, 0);
            for (id, agent) in sim.agents().iter() {
                let far = sim.world().place(id).manhattan(Cell::new(0, 0, 0));
                assert_eq!(agent.hops(), Some(far), "{id}");
            }
        }
    }
}
