//! An election: modules agree on a leader, the living one with the lowest number.
//!
//! Every module tells its neighbours the lowest number it has heard of, repeatedly, because messages
//! get lost. Not here: detecting that the leader has died, which is left to the reader.

use metamorph_protocol::agent::{Agent, Birth, Input, InputOf, Output, OutputOf};
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::{ModuleId, Port};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::time::{Span, Time};
use metamorph_protocol::wire::{Decoder, Encoder, Never, Wire, WireError};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::hash::Hasher;
use std::sync::Arc;

/// Constant parameters that all modules share.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Setup {
    /// The time between two repetitions of what a module knows.
    pub repeat: Span,
}

impl Default for Setup {
    fn default() -> Setup {
        Setup { repeat: Span::millis(500) }
    }
}

/// The message between modules, and the report to the controller: the lowest number heard of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lowest(pub ModuleId);

impl Wire for Lowest {
    fn kind(&self) -> u8 {
        0
    }
    fn encode(&self, out: &mut Encoder) {
        out.u32(self.0.0);
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Lowest, WireError> {
        if kind == 0 { Ok(Lowest(ModuleId(from.u32()?))) } else { Err(WireError::Kind(kind)) }
    }
}

/// The agent of one module. Its whole state is integers, so it behaves the same on every machine.
#[derive(Debug)]
pub struct Leader {
    setup: Arc<Setup>,
    lowest: ModuleId,
    touched: [bool; 6],
    wake_at: Time,
    outputs: VecDeque<OutputOf<Leader>>,
}

impl Agent for Leader {
    type Setup = Setup;
    type Place = Cell;
    type Message = Lowest;
    type Action = Never;
    type Percept = Never;
    type Order = Never;
    type Report = Lowest;
    /// Number of faces of a cube.
    const PORTS: usize = 6;

    fn new(setup: &Arc<Setup>, birth: Birth<Cell>, now: Time) -> Leader {
        Leader {
            setup: Arc::clone(setup),
            lowest: birth.id,
            touched: [false; 6],
            wake_at: now + setup.repeat,
            outputs: VecDeque::from([Output::Report(Lowest(birth.id))]),
        }
    }

    fn handle(&mut self, now: Time, input: InputOf<Leader>) {
        match input {
            Input::Contact { port, session } => {
                self.touched[port.index()] = session.is_some();
                self.tell(port);
            }
            Input::Message { message: Lowest(heard), .. } if heard < self.lowest => {
                self.lowest = heard;
                self.outputs.push_back(Output::Report(Lowest(heard)));
                self.tell_all();
            }
            Input::Message { .. } => {}
            Input::Wake => {
                self.wake_at = now + self.setup.repeat;
                self.tell_all();
            }
            Input::Percept(never) | Input::Order(never) => match never {},
        }
    }

    fn poll(&mut self) -> Option<OutputOf<Leader>> {
        self.outputs.pop_front()
    }

    fn wake_at(&self) -> Time {
        self.wake_at
    }

    fn digest(&self, hasher: &mut dyn Hasher) {
        hasher.write_u32(self.lowest.0);
        hasher.write_u64(self.wake_at.0);
        for touched in self.touched {
            hasher.write_u8(touched.into());
        }
    }
}

impl Leader {
    /// Returns the lowest number that it has heard of.
    pub fn lowest(&self) -> ModuleId {
        self.lowest
    }

    fn tell(&mut self, port: Port) {
        if self.touched[port.index()] {
            let message = Lowest(self.lowest);
            self.outputs.push_back(Output::Send { port, class: Class::Seed, message });
        }
    }

    fn tell_all(&mut self) {
        for port in 0..6 {
            self.tell(Port(port));
        }
    }
}
