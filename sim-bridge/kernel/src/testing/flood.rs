//! The smallest useful agent: module 0 floods its distance in hops; every other takes the first message,
//! passes it on once to all other neighbours, and reports. The cost of a run is almost only that of the
//! driver, which this measures.
//!
//! The number of messages is `2E − (N − 1)`. On links whose delays differ by less than one part in the number
//! of hops, the first message takes a shortest path, and distances are exact.

use crate::director::port::DirectorPort;
use crate::world::World;
use metamorph_core::agent::{Agent, Birth, Input, InputOf, Output, OutputOf};
use metamorph_core::counters::Class;
use metamorph_core::ids::{ModuleId, Port};
use metamorph_core::lattice::Cell;
use metamorph_core::runtime::Command;
use metamorph_core::time::Time;
use metamorph_core::wire::{Decoder, Encoder, HEADER, Never, Wire, WireError};
use std::hash::Hasher;
use std::sync::Arc;

/// The distance of the sender from the start of the flood.
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
    /// Faces with a contact, and faces still to be told, a bit each.
    faces: u8,
    untold: u8,
    unreported: bool,
}

/// The number of hops of a module that the flood has not reached.
const UNKNOWN: u32 = u32::MAX;

impl Flooded {
    /// Returns the distance, once it is known.
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
    type Report = Hops;

    /// The number of ports: one for each face.
    const PORTS: usize = 6;

    fn new(_: &Arc<()>, birth: Birth<Cell>, _now: Time) -> Flooded {
        let begins = birth.id == ModuleId(0);
        Flooded { hops: if begins { 0 } else { UNKNOWN }, faces: 0, untold: 0, unreported: begins }
    }

    fn handle(&mut self, _now: Time, input: InputOf<Flooded>) {
        match input {
            Input::Contact { port, session } => {
                let bit = 1 << port.0;
                (self.faces, self.untold) = (self.faces & !bit, self.untold & !bit);
                if session.is_some() {
                    self.faces |= bit;
                    // A module that knows its distance tells every new neighbour.
                    self.untold |= if self.hops == UNKNOWN { 0 } else { bit };
                }
            }
            Input::Message { port, message } if self.hops == UNKNOWN => {
                self.hops = message.0 + 1;
                self.untold = self.faces & !(1 << port.0);
                self.unreported = true;
            }
            Input::Message { .. } | Input::Wake => {}
            Input::Percept(never) | Input::Order(never) => match never {},
        }
    }

    fn poll(&mut self) -> Option<OutputOf<Flooded>> {
        if self.untold == 0 {
            return std::mem::take(&mut self.unreported).then_some(Output::Report(Hops(self.hops)));
        }
        let port = Port(self.untold.trailing_zeros() as u8);
        self.untold &= self.untold - 1;
        Some(Output::Send { port, class: Class::Gradient, message: Hops(self.hops) })
    }

    fn wake_at(&self) -> Time {
        Time::NEVER
    }

    fn digest(&self, hasher: &mut dyn Hasher) {
        hasher.write_u32(self.hops);
    }
}

/// A director that only counts reports; the run ends when no event is left.
#[derive(Debug, Default)]
pub struct Onlooker {
    /// The number of modules that know their distance.
    pub know: u64,
}

impl<W: World<Agent = Flooded>> DirectorPort<W> for Onlooker {
    fn report(&mut self, _: Time, _: ModuleId, _: Hops) {
        self.know += 1;
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
    use crate::kernel::sim::{Sim, SimConfig};
    use crate::kernel::still_world::StillWorld;
    use metamorph_core::link::LinkModel;
    use metamorph_core::time::Span;

    #[test]
    fn each_module_learns_the_distance_and_tells_it_once() {
        // A lone module receives no message, and so never reports.
        for sides in [[2, 1, 1], [2, 2, 2], [5, 5, 5], [2, 9, 5]] {
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
            let world = StillWorld::<Flooded>::new(sides);
            let (modules, contacts) = (world.len() as u64, world.contacts());
            let mut sim = Sim::new(config, world, Onlooker::default());
            assert!(sim.run_until(Time(Span::secs(1_000).0)));
            let counts = sim.tally()[Class::Gradient];
            let expected = 2 * contacts - (modules - 1);
            assert_eq!((counts.sent, counts.delivered, counts.in_flight()), (expected, expected, 0));
            assert_eq!((sim.violations().1, sim.director().know), (0, modules));
            for (id, agent) in sim.agents().iter() {
                let far = sim.world().place(id).manhattan(Cell::new(0, 0, 0));
                assert_eq!(agent.hops(), Some(far), "{id}");
            }
        }
    }
}
