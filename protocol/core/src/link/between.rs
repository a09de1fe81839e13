//! Links of their own between some modules.

use super::LinkModel;
use crate::ids::ModuleId;
use crate::time::Time;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

/// Modules at one end of a link: these, in ascending order, or any if there are none.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct End(pub Vec<ModuleId>);

impl End {
    fn has(&self, id: ModuleId) -> bool {
        self.0.is_empty() || self.0.binary_search(&id).is_ok()
    }
}

/// A link between some modules that differs from that of the others.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Between {
    /// The modules at both ends. If it is one way, messages from the first to the second are meant.
    pub ends: [End; 2],
    /// True if the other direction is not meant.
    pub one_way: bool,
    /// The start.
    pub from: Time,
    /// The end: the first instant at which it does not hold any more.
    pub until: Time,
    /// Its delays and impairments.
    pub link: LinkModel,
}

impl Between {
    /// Returns true if a message sent at `now` takes this link.
    pub fn holds(&self, now: Time, from: ModuleId, to: ModuleId) -> bool {
        let [a, b] = &self.ends;
        let is_way = |from, to| a.has(from) && b.has(to);
        (self.from..self.until).contains(&now) && (is_way(from, to) || !self.one_way && is_way(to, from))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::LinkState;
    use crate::rng::Rng;
    use crate::time::Span;

    fn delayed(ms: u64) -> LinkModel {
        LinkModel { delay_min: Span::millis(ms), delay_max: Span::millis(ms), ..LinkModel::default() }
    }

    fn between(ends: [&[u32]; 2], one_way: bool, ms: u64) -> Between {
        let ends = ends.map(|end| End(end.iter().copied().map(ModuleId).collect()));
        Between { ends, one_way, from: Time(10), until: Time(20), link: delayed(ms) }
    }

    /// The first link that fits holds, while it lasts and in the directions that it is for; partitions of modules cut it, too.
    #[test]
    fn the_first_that_fits_holds() {
        let all = vec![between([&[0], &[1, 2]], true, 1), between([&[0], &[]], false, 2)];
        let mut model = LinkModel { between: all, ..delayed(9) };
        let takes = |model: &LinkModel, now, from, to| {
            let (mut rng, mut state) = (Rng::named(1, "link", 0), LinkState::default());
            let fate = model.carry(Time(now), ModuleId(from), ModuleId(to), &mut rng, &mut state);
            fate.arrivals[0].map(|arrival| arrival.at.since(Time(now)).0 / 1_000_000)
        };
        assert_eq!([9, 10, 19, 20].map(|now| takes(&model, now, 0, 1)), [Some(9), Some(1), Some(1), Some(9)]);
        assert_eq!(
            [(1, 0), (0, 3), (3, 0), (1, 2)].map(|(a, b)| takes(&model, 10, a, b)),
            [Some(2), Some(2), Some(2), Some(9)]
        );
        assert!(
            !LinkModel { delay_max: Span::ZERO, delay_min: Span::ZERO, ..model.clone() }.is_transparent()
        );
        let side = vec![ModuleId(0)];
        model.partitions.push(super::super::Partition { from: Time(0), until: Time(30), side });
        assert_eq!(takes(&model, 10, 0, 1), None);
    }
}
