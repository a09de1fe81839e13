//! Commands of an operator that steer one module, as text and as data. Each holds for a while and then ends by itself.

use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::Cell;
use metamorph_core::time::Span;
use std::fmt;

/// The time for which a command holds if it names none.
pub const LEASE: Span = Span::secs(60);
/// The longest time that a command can hold.
pub const LONGEST_LEASE: Span = Span::secs(600);
/// Largest number of places of a goal.
const PLACES_MAX: u8 = 128;

/// A command of an operator to a module.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Steering {
    /// It goes to this cell and stays there.
    GoTo(Cell, Span),
    /// It fills this place of the goal, by its number from 0.
    Take(u8, Span),
    /// It stays where it is.
    Hold(Span),
    /// It and this other module do what the other one was commanded, as long as that holds.
    Swap(ModuleId),
    /// It decides for itself again.
    Release,
}

impl Steering {
    /// The verbs.
    pub const VERBS: [&str; 5] = ["goto", "take", "hold", "swap", "release"];

    /// Reads a command without the module, such as `goto` and `[4, 5, 0] for 30s`. `None` if it is none.
    pub fn parse(verb: &str, rest: &str) -> Option<Steering> {
        let (what, lease) = match rest.trim().split_once("for ") {
            Some((what, lease)) => (what.trim(), read_lease(lease)?),
            None => (rest.trim(), LEASE),
        };
        match verb {
            "goto" => Some(Steering::GoTo(read_cell(what)?, lease)),
            "take" => Some(Steering::Take(what.parse().ok().filter(|seed| *seed < PLACES_MAX)?, lease)),
            "hold" if what.is_empty() => Some(Steering::Hold(lease)),
            "swap" => Some(Steering::Swap(ModuleId(rest.trim().parse().ok()?))),
            "release" if rest.trim().is_empty() => Some(Steering::Release),
            _ => None,
        }
    }
    /// The verb.
    pub const fn verb(self) -> &'static str {
        match self {
            Steering::GoTo(..) => "goto",
            Steering::Take(..) => "take",
            Steering::Hold(_) => "hold",
            Steering::Swap(_) => "swap",
            Steering::Release => "release",
        }
    }
}

/// Writes what follows the module, with its blank.
impl fmt::Display for Steering {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Steering::GoTo(cell, span) => write!(f, " {cell}").and_then(|()| write_lease(f, span)),
            Steering::Take(seed, span) => write!(f, " {seed}").and_then(|()| write_lease(f, span)),
            Steering::Hold(span) => write_lease(f, span),
            Steering::Swap(other) => write!(f, " {other}"),
            Steering::Release => Ok(()),
        }
    }
}

/// Writes how long a command holds, with a blank before it.
pub fn write_lease(f: &mut fmt::Formatter<'_>, lease: Span) -> fmt::Result {
    match lease.0 % 1_000_000_000 {
        0 => write!(f, " for {}s", lease.0 / 1_000_000_000),
        _ => write!(f, " for {}ns", lease.0),
    }
}

/// Reads a cell, `[1, 2, 3]`.
pub fn read_cell(text: &str) -> Option<Cell> {
    let [x, y, z] = read_numbers(text)?;
    Some(Cell { x, y, z })
}

/// Reads a distance along x and y, `[1, -2]`.
pub fn read_shift(text: &str) -> Option<(i16, i16)> {
    let [x, y] = read_numbers(text)?;
    Some((x, y))
}

fn read_numbers<const N: usize>(text: &str) -> Option<[i16; N]> {
    let inside = text.trim().strip_prefix('[')?.strip_suffix(']')?;
    let numbers: Result<Vec<i16>, _> = inside.split(',').map(|n| n.trim().parse()).collect();
    let numbers: [i16; N] = numbers.ok()?.try_into().ok()?;
    let is_near = |n: &i16| n.unsigned_abs() <= Cell::LIMIT.unsigned_abs();
    numbers.iter().all(is_near).then_some(numbers)
}

/// Reads a time from a nanosecond to the longest lease, in whole seconds or nanoseconds.
pub fn read_lease(text: &str) -> Option<Span> {
    let text = text.trim();
    let nanoseconds = match text.strip_suffix("ns") {
        Some(number) => number.parse::<u64>().ok()?,
        None => text.strip_suffix('s')?.parse::<u64>().ok()?.checked_mul(1_000_000_000)?,
    };
    Some(Span(nanoseconds)).filter(|lease| (Span(1)..=LONGEST_LEASE).contains(lease))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steering_is_read_as_it_is_written() {
        let cell = Cell { x: 4, y: -5, z: 0 };
        let all = [
            Steering::GoTo(cell, Span::secs(30)),
            Steering::Take(31, Span(1_500_000_001)),
            Steering::Hold(LONGEST_LEASE),
            Steering::Swap(ModuleId(5)),
            Steering::Release,
        ];
        for steering in all {
            assert_eq!(Steering::parse(steering.verb(), &steering.to_string()), Some(steering));
        }
        assert_eq!(Steering::parse("hold", ""), Some(Steering::Hold(LEASE)));
    }

    #[test]
    fn other_texts_are_refused() {
        for (verb, rest) in [
            ("goto", "4 5"),
            ("goto", "[4, 5]"),
            ("goto", "[4, 5, 16384]"),
            ("goto", "[4, 5, 0] for 601s"),
            ("goto", "[4, 5, 0] for 0s"),
            ("goto", "[4, 5, 0] for ever"),
            ("goto", "[4, 5, 0] for 18446744073709551615s"),
            ("take", "128"),
            ("take", ""),
            ("hold", "3"),
            ("swap", ""),
            ("swap", "5 for 3s"),
            ("release", "now"),
            ("stay", ""),
        ] {
            assert_eq!(Steering::parse(verb, rest), None, "{verb} {rest}");
        }
    }
}
