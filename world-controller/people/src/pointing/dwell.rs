//! Selection of a tile by pointing at it for some time.

use super::ray::Tile;
use metamorph_protocol::time::{Span, Time};
use std::collections::BTreeMap;

/// Time for which a tile is pointed at before it is selected (thesis 9.2).
pub const DWELL: Span = Span::secs(2);
/// Time after which a tile that is not pointed at has lost its charge.
const AWAY: Span = Span::secs(1);
/// The longest time that counts between two samples: a tracker that stops selects nothing.
const GAP: Span = Span::millis(250);

/// The rule by which time on a tile is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// The thesis's: without a break.
    Strict,
    /// A tile is charged while it is pointed at, and drained at the same speed while another is.
    Charge,
}

#[derive(Clone, Copy, Debug)]
struct Charge {
    held: Span,
    last: Time,
}

/// The charges of all tiles.
#[derive(Clone, Debug)]
pub struct Dwell {
    rule: Rule,
    charges: BTreeMap<Tile, Charge>,
    /// The tile selected last, until another one is pointed at: it is not selected again meanwhile.
    taken: Option<Tile>,
    now: Option<Time>,
}

/// State of the tile that is pointed at, after a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// How long the tile that is pointed at has been held, at most [`DWELL`].
    pub held: Span,
    /// True if that tile is selected by this sample.
    pub is_selected: bool,
}

impl Dwell {
    /// Creates the charges, all empty.
    pub fn new(rule: Rule) -> Dwell {
        Dwell { rule, charges: BTreeMap::new(), taken: None, now: None }
    }

    /// Takes what is pointed at from the sample before until `now`.
    pub fn point(&mut self, now: Time, tile: Option<Tile>) -> Step {
        let since = self.now.replace(now).map_or(Span(0), |before| now.since(before)).min(GAP);
        let rule = self.rule;
        self.charges.retain(|other, charge| {
            if Some(*other) == tile {
                return true;
            }
            charge.held = match rule {
                Rule::Strict => Span(0),
                Rule::Charge => Span(charge.held.0.saturating_sub(since.0)),
            };
            charge.held > Span(0) && now.since(charge.last) < AWAY
        });
        let Some(tile) = tile else { return Step { held: Span(0), is_selected: false } };
        if self.taken == Some(tile) {
            return Step { held: DWELL, is_selected: false };
        }
        self.taken = None;
        let charge = self.charges.entry(tile).or_insert(Charge { held: Span(0), last: now });
        *charge = Charge { held: (charge.held + since).min(DWELL), last: now };
        let held = charge.held;
        let is_selected = held >= DWELL;
        if is_selected {
            self.charges.clear();
            self.taken = Some(tile);
        }
        Step { held, is_selected }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: Tile = [3, 4];
    const B: Tile = [3, 5];

    /// Returns the tiles selected while tiles are pointed at for some tenths of a second each.
    fn selected(rule: Rule, pointed: &[(Option<Tile>, u64)]) -> Vec<Tile> {
        let mut dwell = Dwell::new(rule);
        let mut now = Time::ZERO;
        let mut selected = Vec::new();
        for (tile, tenths) in pointed {
            for _ in 0..*tenths {
                now += Span::millis(100);
                selected.extend(tile.filter(|_| dwell.point(now, *tile).is_selected));
                if tile.is_none() {
                    dwell.point(now, None);
                }
            }
        }
        selected
    }

    #[test]
    fn a_tile_is_selected_after_two_seconds() {
        for rule in [Rule::Strict, Rule::Charge] {
            assert!(selected(rule, &[(Some(A), 20)]).is_empty());
            assert_eq!(selected(rule, &[(Some(A), 21)]), [A]);
            assert_eq!(selected(rule, &[(Some(A), 100)]), [A], "once only");
            assert_eq!(selected(rule, &[(Some(A), 21), (Some(B), 20), (Some(A), 21)]), [A, B, A]);
        }
    }

    #[test]
    fn a_charge_survives_a_glance_elsewhere_and_no_long_look() {
        let glance = [(Some(A), 15), (Some(B), 3), (Some(A), 9)];
        assert_eq!(selected(Rule::Charge, &glance), [A]);
        assert!(selected(Rule::Strict, &glance).is_empty());
        assert!(selected(Rule::Charge, &[(Some(A), 15), (None, 11), (Some(A), 10)]).is_empty());
    }
}
