//! Scenario time as integer nanoseconds. Not here: any clock.

use alloc::borrow::ToOwned;
use alloc::format;
use alloc::string::String;
use core::fmt;
use core::ops::{Add, AddAssign, Div, Mul, Sub};
use core::str::FromStr;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use thiserror::Error;

/// An instant: nanoseconds since the start of the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Time(pub u64);

/// A duration in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Span(pub u64);

impl Time {
    /// The time at which a run starts.
    pub const ZERO: Time = Time(0);
    /// A time later than every instant of a run.
    pub const NEVER: Time = Time(u64::MAX);

    /// Returns the time since `earlier`, zero if `earlier` is later.
    pub const fn since(self, earlier: Time) -> Span {
        Span(self.0.saturating_sub(earlier.0))
    }

    /// Returns the time in seconds, for output.
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 / 1e9
    }
}

impl Span {
    /// A span of zero time.
    pub const ZERO: Span = Span(0);

    /// Returns a duration of `n` nanoseconds.
    pub const fn nanos(n: u64) -> Span {
        Span(n)
    }
    /// Returns a duration of `n` milliseconds.
    pub const fn millis(n: u64) -> Span {
        Span(n * 1_000_000)
    }
    /// Returns a duration of `n` seconds.
    pub const fn secs(n: u64) -> Span {
        Span(n * 1_000_000_000)
    }
    /// Returns the duration in seconds, for output.
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 / 1e9
    }
}

impl Add<Span> for Time {
    type Output = Time;
    fn add(self, span: Span) -> Time {
        Time(self.0.saturating_add(span.0))
    }
}
impl AddAssign<Span> for Time {
    fn add_assign(&mut self, span: Span) {
        *self = *self + span;
    }
}
impl Sub<Span> for Time {
    type Output = Time;
    fn sub(self, span: Span) -> Time {
        Time(self.0.saturating_sub(span.0))
    }
}
impl Add for Span {
    type Output = Span;
    fn add(self, other: Span) -> Span {
        Span(self.0.saturating_add(other.0))
    }
}
impl Sub for Span {
    type Output = Span;
    fn sub(self, other: Span) -> Span {
        Span(self.0.saturating_sub(other.0))
    }
}
impl Mul<u64> for Span {
    type Output = Span;
    fn mul(self, by: u64) -> Span {
        Span(self.0.saturating_mul(by))
    }
}
impl Div<u64> for Span {
    type Output = Span;
    fn div(self, by: u64) -> Span {
        Span(self.0 / by)
    }
}

/// Why a duration cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SpanError {
    /// A minus sign in front.
    #[error("`{0}` is negative; times start at 0s")]
    Negative(String),
    /// No unit, or an unknown one.
    #[error("`{0}` has no known unit; write a number and one of ns, us, ms, s, min, h, such as `1.5s`")]
    Unit(String),
    /// The part before the unit is not a decimal number.
    #[error("`{0}` does not start with a number; write for example `1.5s` or `200ms`")]
    Number(String),
    /// More than 2^64 − 1 nanoseconds, about 584 years.
    #[error("`{0}` is too long; the longest time is about 584 years")]
    TooLong(String),
}

impl FromStr for Span {
    type Err = SpanError;

    /// Reads `200ms`, `1.5s`, `2min`; exact, without floating point.
    fn from_str(text: &str) -> Result<Span, SpanError> {
        let owned = || text.to_owned();
        let trimmed = text.trim();
        if trimmed.starts_with('-') {
            return Err(SpanError::Negative(owned()));
        }
        let split = trimmed
            .find(|c: char| !c.is_ascii_digit() && c != '.')
            .ok_or_else(|| SpanError::Unit(owned()))?;
        let (number, unit) = trimmed.split_at(split);
        let nanos_per_unit: u64 = match unit.trim() {
            "ns" => 1,
            "us" | "µs" => 1_000,
            "ms" => 1_000_000,
            "s" => 1_000_000_000,
            "min" | "m" => 60_000_000_000,
            "h" => 3_600_000_000_000,
            _ => return Err(SpanError::Unit(owned())),
        };
        let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
        if (whole.is_empty() && fraction.is_empty()) || fraction.contains('.') {
            return Err(SpanError::Number(owned()));
        }
        let too_long = || SpanError::TooLong(owned());
        let digits = |s: &str| -> Result<u128, SpanError> {
            if s.is_empty() { Ok(0) } else { s.parse().map_err(|_| too_long()) }
        };
        // 18 digits of fraction are finer than a nanosecond of the longest unit.
        let fraction = &fraction[..fraction.len().min(18)];
        let scale = 10u128.pow(fraction.len() as u32);
        let total = digits(whole)?
            .checked_mul(nanos_per_unit.into())
            .and_then(|w| w.checked_add(digits(fraction).ok()? * u128::from(nanos_per_unit) / scale))
            .ok_or_else(too_long)?;
        u64::try_from(total).ok().filter(|n| *n < u64::MAX / 2).map(Span).ok_or_else(too_long)
    }
}

impl fmt::Display for Span {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let n = self.0;
        let (unit, name) = match n {
            0 => return f.write_str("0s"),
            _ if n >= 1_000_000_000 => (1_000_000_000, "s"),
            _ if n >= 1_000_000 => (1_000_000, "ms"),
            _ if n >= 1_000 => (1_000, "us"),
            _ => (1, "ns"),
        };
        write!(f, "{}", n / unit)?;
        if !n.is_multiple_of(unit) {
            let width = unit.ilog10() as usize;
            let fraction = format!("{:0width$}", n % unit);
            write!(f, ".{}", fraction.trim_end_matches('0'))?;
        }
        f.write_str(name)
    }
}

impl fmt::Display for Time {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Span(self.0).fmt(f)
    }
}

impl Serialize for Span {
    /// Writes text in formats for people (`"1.5s"`), nanoseconds in binary ones.
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        if s.is_human_readable() { s.collect_str(self) } else { self.0.serialize(s) }
    }
}
impl<'de> Deserialize<'de> for Span {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Span, D::Error> {
        if d.is_human_readable() {
            let text = String::deserialize(d)?;
            text.parse().map_err(serde::de::Error::custom)
        } else {
            u64::deserialize(d).map(Span)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_and_prints_exactly() {
        for (text, nanos, printed) in [
            ("0s", 0, "0s"),
            ("1.5s", 1_500_000_000, "1.5s"),
            ("200ms", 200_000_000, "200ms"),
            (" 2min ", 120_000_000_000, "120s"),
            ("0.000000001s", 1, "1ns"),
            ("1.000000001s", 1_000_000_001, "1.000000001s"),
            (".5ms", 500_000, "500us"),
        ] {
            assert_eq!(text.parse::<Span>().map(|s| s.0), Ok(nanos), "{text}");
            assert_eq!(Span(nanos).to_string(), printed);
            assert_eq!(printed.parse::<Span>(), Ok(Span(nanos)));
        }
    }

    #[test]
    fn errors_name_the_reason() {
        for (text, part) in [
            ("-2s", "negative"),
            ("2", "unit"),
            ("2 parsecs", "unit"),
            ("s", "number"),
            ("1.2.3s", "number"),
            ("99999999999999999999999h", "too long"),
            ("999999999999999999999999999999999999999999s", "too long"),
            ("340282366920938463463374607431768211.999us", "too long"),
            ("", "unit"),
        ] {
            let error = text.parse::<Span>().unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
