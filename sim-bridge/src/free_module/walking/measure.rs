//! How fast a structure walks and turns: samples of its centre of mass in the plane, and of how far it has turned.

use metamorph_protocol::time::{Span, Time};
use std::collections::VecDeque;

/// The time over which the speed is measured: two periods of the oscillators.
pub const WINDOW: Span = Span::secs(10);
/// The time over which the path is measured: a period. Swings within a period do not lengthen it.
const PATH_WINDOW: Span = Span::secs(5);

/// Where the centre of mass was.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sample {
    at: Time,
    /// In metres.
    place: [f32; 2],
    /// In radians, counter-clockwise seen from above.
    turned: f64,
}

/// The way that a structure has gone.
#[derive(Clone, Debug, Default)]
pub struct Measure {
    first: Option<Sample>,
    recent: VecDeque<Sample>,
    /// The end of the last complete period.
    path_end: Option<Sample>,
    path_mm: f64,
    /// Where modules were last, and how far the structure has turned since the first sample.
    modules: Vec<[f32; 2]>,
    turned: f64,
}

/// Returns the angle in radians by which points have turned about their centre: that of the best fit.
fn turn(before: &[[f32; 2]], after: &[[f32; 2]]) -> f64 {
    let centre = |points: &[[f32; 2]]| {
        [0, 1].map(|i| points.iter().map(|p| f64::from(p[i])).sum::<f64>() / points.len().max(1) as f64)
    };
    let (from, to) = (centre(before), centre(after));
    let (mut sine, mut cosine) = (0.0, 0.0);
    for (a, b) in before.iter().zip(after) {
        let a = [0, 1].map(|i| f64::from(a[i]) - from[i]);
        let b = [0, 1].map(|i| f64::from(b[i]) - to[i]);
        sine += a[0] * b[1] - a[1] * b[0];
        cosine += a[0] * b[0] + a[1] * b[1];
    }
    libm::atan2(sine, cosine)
}

impl Measure {
    /// Adds a sample: the centre of mass, and the places of all modules. Times must not go back. Samples older than `keep`
    /// are forgotten.
    pub fn add(&mut self, at: Time, place: [f32; 2], modules: Vec<[f32; 2]>, keep: Span) {
        self.turned += turn(&self.modules, &modules);
        self.modules = modules;
        let sample = Sample { at, place, turned: self.turned };
        self.first.get_or_insert(sample);
        let last = *self.path_end.get_or_insert(sample);
        if at.since(last.at) >= PATH_WINDOW {
            self.path_mm += distance_mm(last, sample);
            self.path_end = Some(sample);
        }
        self.recent.push_back(sample);
        while self.recent.get(1).is_some_and(|second| at.since(second.at) >= keep) {
            self.recent.pop_front();
        }
    }

    /// Returns how the structure has moved from a time on; `None` without samples that far back.
    pub fn since(&self, from: Time) -> Option<Movement> {
        let (last, oldest) = (self.recent.back()?, self.recent.front()?);
        let begin = self.recent.iter().rev().take_while(|s| s.at >= from).last()?;
        let seconds = last.at.since(begin.at).as_secs_f64();
        (oldest.at <= from && seconds > 0.0).then(|| Movement {
            velocity_mm_s: displacement_mm(*begin, *last).map(|mm| mm / seconds),
            turn_deg_s: (last.turned - begin.turned).to_degrees() / seconds,
        })
    }
    /// Returns how it has moved over the last [`WINDOW`], once that long has been measured.
    pub fn recent(&self) -> Option<Movement> {
        let last = self.recent.back()?;
        let long_enough = last.at.since(self.first?.at) >= WINDOW;
        long_enough.then(|| self.since(Time(last.at.0.saturating_sub(WINDOW.0))))?
    }
    /// Returns how far the structure has turned since the first sample, in degrees, counter-clockwise seen from above.
    pub fn turned_deg(&self) -> f64 {
        self.turned.to_degrees()
    }
    /// Returns the distance from the first place, and the length of the path, in mm.
    pub fn distance_and_path_mm(&self) -> (f64, f64) {
        let ends = self.first.zip(self.recent.back().copied());
        (ends.map_or(0.0, |(first, last)| distance_mm(first, last)), self.path_mm)
    }
    /// Returns the time since the first sample.
    pub fn time(&self) -> Span {
        let ends = self.first.zip(self.recent.back());
        ends.map_or(Span::ZERO, |(first, last)| last.at.since(first.at))
    }
}

fn displacement_mm(a: Sample, b: Sample) -> [f64; 2] {
    [0, 1].map(|i| 1000.0 * (f64::from(b.place[i]) - f64::from(a.place[i])))
}
fn distance_mm(a: Sample, b: Sample) -> f64 {
    let [x, y] = displacement_mm(a, b);
    (x * x + y * y).sqrt()
}

/// A mean movement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Movement {
    /// In the plane.
    pub velocity_mm_s: [f64; 2],
    /// Counter-clockwise seen from above.
    pub turn_deg_s: f64,
}

impl Movement {
    /// Returns the speed in any direction.
    pub fn speed(&self) -> f64 {
        let [x, y] = self.velocity_mm_s;
        (x * x + y * y).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Time {
        Time::ZERO + Span::millis(millis)
    }

    /// A square of modules about a place, turned by an angle.
    fn modules([x, y]: [f32; 2], turned: f64) -> Vec<[f32; 2]> {
        (0..4)
            .map(|i| {
                let angle = turned + std::f64::consts::FRAC_PI_2 * f64::from(i);
                [x + libm::cos(angle) as f32, y + libm::sin(angle) as f32]
            })
            .collect()
    }

    /// 20 mm/s to the north for 20 s while turning at 9 degrees a second, then standing still.
    #[test]
    fn speed_turn_and_path_are_those_of_the_window() {
        let mut measure = Measure::default();
        for tick in 0..=400_u64 {
            let moving = tick.min(200) as f32;
            let place = [1.0, 0.002 * moving];
            let turned = f64::from(0.9 * moving).to_radians();
            measure.add(at(100 * tick), place, modules(place, turned), Span::secs(15));
            let near = |found: Option<Movement>, share: f64| {
                found.is_some_and(|found| {
                    let [x, y] = found.velocity_mm_s;
                    let off = [x, y - 20.0 * share, found.turn_deg_s - 9.0 * share];
                    off.iter().all(|off| off.abs() < 0.01)
                })
            };
            match tick {
                0..100 => assert_eq!(measure.recent(), None, "{tick}"),
                100..=200 => assert!(near(measure.recent(), 1.0), "{tick}"),
                250 => assert!(near(measure.recent(), 0.5) && near(measure.since(at(24_000)), 0.0)),
                300.. => assert!(near(measure.recent(), 0.0), "{tick}"),
                _ => {}
            }
        }
        assert_eq!(measure.since(at(1_000)), None, "forgotten");
        let (distance, path) = measure.distance_and_path_mm();
        assert!((distance - 400.0).abs() < 0.1 && (path - 400.0).abs() < 0.1, "{distance} {path}");
        assert!((measure.turned_deg() - 180.0).abs() < 0.1, "{}", measure.turned_deg());
        assert_eq!(measure.time(), Span::secs(40));
    }
}
