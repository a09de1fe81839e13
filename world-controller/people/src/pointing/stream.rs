//! Samples of a tracker as lines of JSON, and what follows from each.

use super::dwell::{DWELL, Dwell, Rule};
use super::filter::Filter;
use super::ray::{Tile, tile};
use metamorph_protocol::time::{Span, Time};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The longest line in bytes.
pub const LONGEST: usize = 4096;
/// Largest distance of a sample from the origin along an axis, in metres.
const COORDINATE_MAX: f64 = 1000.0;

/// Why a line is refused.
#[derive(Debug, Error)]
pub enum SampleError {
    /// The line is too long, or no sample.
    #[error(
        "{0}\n  fix: write for example {{\"t\": 0.033, \"head\": [0, 0, 1.7], \"hand\": [0.5, 0.1, 1.3]}}"
    )]
    Form(String),
    /// A number that a tracker cannot mean.
    #[error(
        "`{0}` is {1}\n  fix: times are seconds from 0 on that do not decrease, positions metres below 1,000"
    )]
    Value(&'static str, f64),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Sample {
    t: f64,
    head: [f64; 3],
    hand: [f64; 3],
}

/// Interpretation of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pointed {
    /// The time of the sample in seconds.
    pub t: f64,
    /// The tile that is pointed at; none above the horizon.
    pub tile: Option<Tile>,
    /// How far the tile is selected: 0 to 1.
    pub charge: f64,
    /// True in the sample that selects it.
    pub selected: bool,
}

/// A track of samples.
#[derive(Debug)]
pub struct Track {
    filter: Filter,
    dwell: Dwell,
    now: Time,
}

impl Default for Track {
    fn default() -> Track {
        Track { filter: Filter::default(), dwell: Dwell::new(Rule::Charge), now: Time::ZERO }
    }
}

impl Track {
    /// Takes a line.
    ///
    /// # Errors
    /// If it is no sample, or its time or positions are out of range. Then the track is as before.
    pub fn line(&mut self, line: &[u8]) -> Result<Pointed, SampleError> {
        if line.len() > LONGEST {
            return Err(SampleError::Form(format!(
                "the line has {} bytes; {LONGEST} is the maximum",
                line.len()
            )));
        }
        let Sample { t, head, hand } =
            serde_json::from_slice(line).map_err(|e| SampleError::Form(e.to_string()))?;
        let seconds = Span::secs(1).0 as f64;
        let now = Time((t * seconds) as u64);
        if !(0.0..=1e9).contains(&t) || now < self.now {
            return Err(SampleError::Value("t", t));
        }
        for (name, position) in [("head", head), ("hand", hand)] {
            if let Some(x) = position.into_iter().find(|x| x.is_nan() || x.abs() >= COORDINATE_MAX) {
                return Err(SampleError::Value(name, x));
            }
        }
        self.now = now;
        let [a, b, c, d, e, f] = self.filter.next([head[0], head[1], head[2], hand[0], hand[1], hand[2]]);
        let tile = tile([a, b, c], [d, e, f]);
        let step = self.dwell.point(now, tile);
        let charge = step.held.0 as f64 / DWELL.0 as f64;
        Ok(Pointed { t, tile, charge, selected: step.is_selected })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_hand_selects_a_tile() {
        let mut track = Track::default();
        let pointed: Vec<Pointed> = (0..=24)
            .map(|i| {
                track
                    .line(
                        format!(
                            r#"{{"t": {}, "head": [0, 0, 1.7], "hand": [0.3, 0, 1.2]}}"#,
                            f64::from(i) / 10.0
                        )
                        .as_bytes(),
                    )
                    .unwrap()
            })
            .collect();
        assert!(pointed.iter().all(|p| p.tile == Some([9, 0])), "{pointed:?}");
        let selected: Vec<f64> = pointed.iter().filter(|p| p.selected).map(|p| p.t).collect();
        assert_eq!(selected, [2.0]);
    }

    #[test]
    fn wrong_lines_are_refused_and_change_nothing() {
        let mut track = Track::default();
        let good = r#"{"t": 1, "head": [0, 0, 1.7], "hand": [0.3, 0, 1.2]}"#;
        track.line(good.as_bytes()).unwrap();
        let long = format!("{good}{}", " ".repeat(LONGEST));
        for (line, what) in [
            ("", "EOF"),
            ("{", "EOF"),
            (r#"{"t": 2}"#, "missing field `head`"),
            (&good.replace("\"t\"", "\"x\""), "unknown field `x`"),
            (&good.replace('1', "-1"), "`t` is -1"),
            (&good.replace("\"t\": 1", "\"t\": 0.5"), "`t` is 0.5"),
            (&good.replace("1.7", "1e300"), "`head` is"),
            (&good.replace("1.2", "1e999"), "out of range"),
            (&long, "is the maximum"),
        ] {
            let error = track.line(line.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(what) && error.contains("fix: "), "{line}: {error}");
        }
        assert!(track.line(good.as_bytes()).is_ok());
    }
}
