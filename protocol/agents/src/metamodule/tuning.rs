//! Parameters of the published strategies that a command can change while a run is in progress. Nothing that is safe
//! depends on them: they say which motion is asked for, and every motion needs the same locks.

use super::params::{Params, Precedence, PrecedenceBy, Repulsion, Strategy};
use super::setup::Setup;
use metamorph_core::wire::{Decoder, Encoder, Field, WireError};

/// All of these parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Tuning {
    /// One of the published strategies.
    pub strategy: Strategy,
    /// How neighbours push.
    pub repulsion: Repulsion,
    /// Which of two metamodules close together goes first.
    pub precedence: Option<Precedence>,
    /// Whether settled metamodules push like others.
    pub settled_repel: bool,
}

impl Tuning {
    /// Returns the present values; `None` under a strategy that has none of them.
    pub fn of(params: &Params) -> Option<Tuning> {
        let Params { strategy, repulsion, precedence, settled_repel, .. } = *params;
        strategy.is_published().then_some(Tuning { strategy, repulsion, precedence, settled_repel })
    }
    /// Returns a setup with these values.
    pub fn apply(self, setup: &Setup) -> Setup {
        let Tuning { strategy, repulsion, precedence, settled_repel } = self;
        let params = Params { strategy, repulsion, precedence, settled_repel, ..setup.params };
        Setup { params, ..setup.clone() }
    }
}

impl Field for Tuning {
    fn put(&self, out: &mut Encoder) {
        // Invariant: it is one of them.
        let strategy = Strategy::PUBLISHED.iter().position(|s| *s == self.strategy).unwrap_or_default();
        out.u8(strategy as u8);
        let Repulsion { strength, decay, range } = self.repulsion;
        [strength, decay, range].iter().for_each(|number| out.u16(*number));
        let (within, by) = match self.precedence {
            None => (0, 0),
            Some(Precedence { within, by: PrecedenceBy::SeedDistance }) => (within, 1),
            Some(Precedence { within, by: PrecedenceBy::Id }) => (within, 2),
        };
        out.u8(by);
        out.u16(within);
        out.bool(self.settled_repel);
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<Tuning, WireError> {
        let strategy = Strategy::PUBLISHED.get(usize::from(from.u8()?)).copied();
        let repulsion = Repulsion { strength: from.u16()?, decay: from.u16()?, range: from.u16()? };
        let precedence = match (from.u8()?, from.u16()?) {
            (0, 0) => None,
            (1, within) => Some(Precedence { within, by: PrecedenceBy::SeedDistance }),
            (2, within) => Some(Precedence { within, by: PrecedenceBy::Id }),
            _ => return Err(WireError::Field("precedence")),
        };
        let strategy = strategy.ok_or(WireError::Field("strategy"))?;
        Ok(Tuning { strategy, repulsion, precedence, settled_repel: from.bool("settled_repel")? })
    }
}
