//! Probabilities as integer ratios, so that a draw is the same on every machine.

use alloc::borrow::ToOwned;
use alloc::string::String;
use alloc::string::ToString;
use core::fmt;
use core::str::FromStr;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use thiserror::Error;

/// A probability `num / den`, between 0 and 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Ratio {
    num: u32,
    den: u32,
}

/// Why a probability cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum RatioError {
    /// Not a number, a percentage or a fraction.
    #[error("`{0}` is not a probability; write `5%`, `0.05` or `1/20`")]
    Form(String),
    /// Below 0 or above 1.
    #[error("`{0}` is not between 0 and 1")]
    Range(String),
}

impl Ratio {
    /// Probability 0.
    pub const ZERO: Ratio = Ratio { num: 0, den: 1 };
    /// Probability 1.
    pub const ONE: Ratio = Ratio { num: 1, den: 1 };

    /// Returns `num / den`; `None` if that is not a probability.
    pub const fn new(num: u32, den: u32) -> Option<Ratio> {
        if den == 0 || num > den { None } else { Some(Ratio { num, den }) }
    }
    /// Returns the larger of two probabilities.
    pub fn larger(self, other: Ratio) -> Ratio {
        let is_less = u64::from(self.num) * u64::from(other.den) < u64::from(other.num) * u64::from(self.den);
        if is_less { other } else { self }
    }
    /// Returns the numerator.
    pub const fn num(self) -> u32 {
        self.num
    }
    /// Returns the denominator.
    pub const fn den(self) -> u32 {
        self.den
    }
    /// Returns true if the probability is 0.
    pub const fn is_zero(self) -> bool {
        self.num == 0
    }
}

impl Default for Ratio {
    fn default() -> Self {
        Ratio::ZERO
    }
}

/// Reads a decimal such as `12.5` as an integer and a power of ten.
fn decimal(text: &str) -> Option<(u64, u32)> {
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    if (whole.is_empty() && fraction.is_empty()) || fraction.len() > 7 {
        return None;
    }
    let digits: String = [whole, fraction].concat();
    if !digits.bytes().all(|b| b.is_ascii_digit()) {
        return None;
    }
    Some((digits.parse().ok()?, fraction.len() as u32))
}

impl FromStr for Ratio {
    type Err = RatioError;

    fn from_str(text: &str) -> Result<Ratio, RatioError> {
        let form = || RatioError::Form(text.to_owned());
        let range = || RatioError::Range(text.to_owned());
        let t = text.trim();
        if t.starts_with('-') {
            return Err(range());
        }
        let (num, den) = if let Some((n, d)) = t.split_once('/') {
            (n.trim().parse::<u64>().map_err(|_| form())?, d.trim().parse::<u64>().map_err(|_| form())?)
        } else if let Some(percent) = t.strip_suffix('%') {
            let (n, places) = decimal(percent.trim()).ok_or_else(form)?;
            (n, 100 * 10u64.pow(places))
        } else {
            let (n, places) = decimal(t).ok_or_else(form)?;
            (n, 10u64.pow(places))
        };
        if den == 0 || num > den {
            return Err(range());
        }
        let divisor = gcd(num, den);
        match (u32::try_from(num / divisor), u32::try_from(den / divisor)) {
            (Ok(num), Ok(den)) => Ok(Ratio { num, den }),
            _ => Err(form()),
        }
    }
}

fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a.max(1) } else { gcd(b, a % b) }
}

impl fmt::Display for Ratio {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.num, self.den) {
            (0, _) => f.write_str("0%"),
            (n, d) if 100 % d == 0 => write!(f, "{}%", n * (100 / d)),
            (n, d) => write!(f, "{n}/{d}"),
        }
    }
}

impl Serialize for Ratio {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        if s.is_human_readable() { s.collect_str(self) } else { (self.num, self.den).serialize(s) }
    }
}

impl<'de> Deserialize<'de> for Ratio {
    /// Reads text (`"5%"`), or a bare number (`0.05`) in formats for people.
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Ratio, D::Error> {
        use serde::de::Error;
        struct Visitor;
        impl serde::de::Visitor<'_> for Visitor {
            type Value = Ratio;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a probability such as \"5%\", 0.05 or \"1/20\"")
            }
            fn visit_str<E: Error>(self, v: &str) -> Result<Ratio, E> {
                v.parse().map_err(E::custom)
            }
            fn visit_f64<E: Error>(self, v: f64) -> Result<Ratio, E> {
                v.to_string().parse().map_err(E::custom)
            }
            fn visit_i64<E: Error>(self, v: i64) -> Result<Ratio, E> {
                v.to_string().parse().map_err(E::custom)
            }
        }
        if d.is_human_readable() {
            d.deserialize_any(Visitor)
        } else {
            let (num, den) = <(u32, u32)>::deserialize(d)?;
            Ratio::new(num, den).ok_or_else(|| D::Error::custom("not a probability"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_percent_decimal_and_fraction() {
        for (text, num, den) in
            [("5%", 1, 20), ("0.05", 1, 20), ("1/20", 1, 20), ("0", 0, 1), ("1", 1, 1), ("12.5 %", 1, 8)]
        {
            assert_eq!(text.parse::<Ratio>(), Ok(Ratio { num, den }), "{text}");
        }
        for text in ["-1%", "101%", "1/0", "3/2"] {
            assert!(matches!(text.parse::<Ratio>(), Err(RatioError::Range(_))), "{text}");
        }
        for text in ["", "five", "1e-3", "%", "0.123456789"] {
            assert!(matches!(text.parse::<Ratio>(), Err(RatioError::Form(_))), "{text}");
        }
    }
}
