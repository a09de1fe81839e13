//! How fast a structure walks: samples of its centre of mass in the plane.

use metamorph_protocol::time::{Span, Time};
use std::collections::VecDeque;

/// The time over which the speed is measured: two periods of the oscillators.
pub const WINDOW: Span = Span::secs(10);
/// The time over which the path is measured: a period. Swings within a period do not lengthen it.
const STRIDE: Span = Span::secs(5);

/// Where the centre of mass was.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sample {
    at: Time,
    /// In metres.
    place: [f32; 2],
}

/// The way that a structure has gone.
#[derive(Clone, Debug, Default)]
pub struct Measure {
    first: Option<Sample>,
    recent: VecDeque<Sample>,
    /// The end of the last complete stride.
    stride: Option<Sample>,
    path_mm: f64,
}

impl Measure {
    /// Adds a sample. Times must not go back. Those older than `keep` are forgotten.
    pub fn add(&mut self, at: Time, place: [f32; 2], keep: Span) {
        let sample = Sample { at, place };
        self.first.get_or_insert(sample);
        let last = *self.stride.get_or_insert(sample);
        if at.since(last.at) >= STRIDE {
            self.path_mm += distance_mm(last, sample);
            self.stride = Some(sample);
        }
        self.recent.push_back(sample);
        while self.recent.get(1).is_some_and(|second| at.since(second.at) >= keep) {
            self.recent.pop_front();
        }
    }

    /// Returns the speed from a time on in mm/s; `None` without samples that far back.
    pub fn speed_since(&self, from: Time) -> Option<f64> {
        let (last, oldest) = (self.recent.back()?, self.recent.front()?);
        let begin = self.recent.iter().rev().take_while(|s| s.at >= from).last()?;
        let time = last.at.since(begin.at).as_secs_f64();
        (oldest.at <= from && time > 0.0).then(|| distance_mm(*begin, *last) / time)
    }
    /// Returns the speed over the last [`WINDOW`] in mm/s, once that long has been measured.
    pub fn speed(&self) -> Option<f64> {
        let last = self.recent.back()?;
        let long_enough = last.at.since(self.first?.at) >= WINDOW;
        long_enough.then(|| self.speed_since(Time(last.at.0.saturating_sub(WINDOW.0))))?
    }
    /// Returns the distance from the first place, and the length of the path, in mm.
    pub fn way_mm(&self) -> (f64, f64) {
        let ends = self.first.zip(self.recent.back().copied());
        (ends.map_or(0.0, |(first, last)| distance_mm(first, last)), self.path_mm)
    }
    /// Returns the time since the first sample.
    pub fn time(&self) -> Span {
        let ends = self.first.zip(self.recent.back());
        ends.map_or(Span::ZERO, |(first, last)| last.at.since(first.at))
    }
}

fn distance_mm(a: Sample, b: Sample) -> f64 {
    let metres = [0, 1].map(|i| f64::from(b.place[i]) - f64::from(a.place[i]));
    1000.0 * (metres[0] * metres[0] + metres[1] * metres[1]).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Time {
        Time::ZERO + Span::millis(millis)
    }

    /// 20 mm/s to the north for 20 s, then standing still.
    #[test]
    fn speed_and_path_are_those_of_the_window() {
        let mut measure = Measure::default();
        for tick in 0..=400_u64 {
            let y = 0.002 * tick.min(200) as f32;
            measure.add(at(100 * tick), [1.0, y], Span::secs(15));
            let near = |found: Option<f64>, mm_s: f64| found.is_some_and(|v| (v - mm_s).abs() < 0.01);
            match tick {
                0..100 => assert_eq!(measure.speed(), None, "{tick}"),
                100..=200 => assert!(near(measure.speed(), 20.0), "{tick}"),
                250 => assert!(near(measure.speed(), 10.0) && near(measure.speed_since(at(24_000)), 0.0)),
                300.. => assert!(near(measure.speed(), 0.0), "{tick}"),
                _ => {}
            }
        }
        assert_eq!(measure.speed_since(at(1_000)), None, "forgotten");
        let (distance, path) = measure.way_mm();
        assert!((distance - 400.0).abs() < 0.1 && (path - 400.0).abs() < 0.1, "{distance} {path}");
        assert_eq!(measure.time(), Span::secs(40));
    }
}
