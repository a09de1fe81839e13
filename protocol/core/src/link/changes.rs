//! Changes of links while a run is in progress: another loss, and modules that are cut off from the others.

use crate::ids::ModuleId;
use crate::ratio::Ratio;
use crate::wire::{Decoder, Encoder, WireError};
use serde::{Deserialize, Serialize};

/// All that is changed at present. Nothing is by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct LinkChanges {
    /// The probability that a message between modules is lost, instead of that of the scenario.
    pub loss: Option<Ratio>,
    /// The first and the last of the modules that are cut off from all others.
    pub cut_off: Option<(ModuleId, ModuleId)>,
}

impl LinkChanges {
    /// Returns true if nothing is changed.
    pub fn is_none(&self) -> bool {
        *self == LinkChanges::default()
    }
    /// Returns true if no message passes between two modules.
    pub fn cuts(&self, a: ModuleId, b: ModuleId) -> bool {
        self.cut_off.is_some_and(|(first, last)| (first..=last).contains(&a) != (first..=last).contains(&b))
    }

    /// Writes the changes.
    pub fn encode(&self, out: &mut Encoder) {
        out.bool(self.loss.is_some());
        let loss = self.loss.unwrap_or_default();
        out.u32(loss.num());
        out.u32(loss.den());
        out.bool(self.cut_off.is_some());
        let (first, last) = self.cut_off.unwrap_or_default();
        out.u32(first.0);
        out.u32(last.0);
    }
    /// Reads changes.
    ///
    /// # Errors
    /// If they are none.
    pub fn decode(from: &mut Decoder<'_>) -> Result<LinkChanges, WireError> {
        let is_lossy = from.bool("loss")?;
        let loss = Ratio::new(from.u32()?, from.u32()?).ok_or(WireError::Field("loss"))?;
        let is_cut = from.bool("cut")?;
        let cut_off = (ModuleId(from.u32()?), ModuleId(from.u32()?));
        if (!is_lossy && loss != Ratio::ZERO) || (!is_cut && cut_off != <(ModuleId, ModuleId)>::default()) {
            return Err(WireError::Field("changes of links"));
        }
        Ok(LinkChanges { loss: is_lossy.then_some(loss), cut_off: is_cut.then_some(cut_off) })
    }
}

#[cfg(test)]
mod tests {
    use super::super::{LinkModel, LinkState};
    use super::*;
    use crate::rng::Rng;
    use crate::time::Time;

    fn lost(model: &LinkModel, to: u32) -> usize {
        let (mut rng, mut last) = (Rng::named(1, "link", 0), LinkState::default());
        let mut carry = |i| model.carry(Time(i), ModuleId(0), ModuleId(to), &mut rng, &mut last);
        (0..1_000).filter(|i| carry(*i).arrivals[0].is_none()).count()
    }

    #[test]
    fn losses_and_cuts_replace_what_the_model_says() {
        let half = Ratio::new(1, 2);
        let mut model = LinkModel { loss: Ratio::ONE, harmless_from: Some(Time(0)), ..LinkModel::default() };
        assert_eq!((lost(&model, 1), model.is_transparent()), (0, false));
        model.changes.loss = half;
        assert!((450..550).contains(&lost(&model, 1)));
        let model = LinkModel { loss: Ratio::ONE, ..LinkModel::default() };
        let changes = LinkChanges { loss: Some(Ratio::ZERO), cut_off: Some((ModuleId(1), ModuleId(3))) };
        let model = LinkModel { changes, ..model };
        let all: Vec<usize> = (1..5).map(|to| lost(&model, to)).collect();
        assert_eq!(all, [1_000, 1_000, 1_000, 0]);
        let changes = LinkChanges { cut_off: None, ..LinkChanges::default() };
        assert!(LinkModel { changes, ..LinkModel::default() }.is_transparent());
    }
}
