//! Goals of a walking structure: its speed, how long, and where to.

use super::measure::Movement;
use metamorph_protocol::time::Span;
use std::fmt;

/// A goal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// How long it walks.
    pub time: Span,
    /// Its least speed in mm/s, over [`WINDOW`](super::measure::WINDOW).
    pub speed_mm_s: f64,
    /// The direction in which it walks, in degrees from +x towards +y; `None` for any.
    pub heading_deg: Option<f64>,
    /// How fast it turns at least in degrees a second, counter-clockwise seen from above; `None` for any way.
    pub turn_deg_s: Option<f64>,
}

impl Goal {
    /// Returns a goal without a direction.
    pub const fn anywhere(time: Span, speed_mm_s: f64) -> Goal {
        Goal { time, speed_mm_s, heading_deg: None, turn_deg_s: None }
    }

    /// Returns the speed of a movement that counts: in the direction asked for, and no more than the share of the turn that
    /// was asked for.
    pub fn speed(&self, movement: &Movement) -> f64 {
        let speed = match self.heading_deg {
            Some(degrees) => along(movement.velocity_mm_s, degrees),
            None => movement.speed(),
        };
        match self.turn_deg_s {
            Some(turn) => speed.min(self.speed_mm_s * movement.turn_deg_s / turn),
            None => speed,
        }
    }

    /// Returns the speed that a gait must have, where a direction is asked for: gaits that were learnt without it tell
    /// nothing about what can be reached.
    pub fn least(&self) -> Option<f64> {
        (self.heading_deg.is_some() || self.turn_deg_s.is_some()).then_some(self.speed_mm_s)
    }
}

/// Returns the part of a vector in a direction in degrees from +x towards +y.
pub fn along([x, y]: [f64; 2], degrees: f64) -> f64 {
    let heading = degrees.to_radians();
    x * libm::cos(heading) + y * libm::sin(heading)
}

impl fmt::Display for Goal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} mm/s", self.speed_mm_s)?;
        if let Some(heading) = self.heading_deg {
            write!(f, " towards {heading} degrees")?;
        }
        if let Some(turn) = self.turn_deg_s {
            write!(f, " while turning at {turn} degrees a second")?;
        }
        write!(f, " for {}", self.time)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_asked_for_counts() {
        let anywhere = Goal::anywhere(Span::secs(10), 10.0);
        let north = Movement { velocity_mm_s: [0.0, 20.0], turn_deg_s: 2.0 };
        let near = |goal: Goal, speed: f64| {
            let found = goal.speed(&north);
            assert!((found - speed).abs() < 1e-9, "{goal}: {found}, not {speed}");
        };
        near(anywhere, 20.0);
        for (heading, speed) in [(90.0, 20.0), (0.0, 0.0), (-90.0, -20.0), (30.0, 10.0)] {
            near(Goal { heading_deg: Some(heading), ..anywhere }, speed);
        }
        for (turn, speed) in [(1.0, 20.0), (2.0, 10.0), (4.0, 5.0), (-4.0, -5.0)] {
            near(Goal { turn_deg_s: Some(turn), ..anywhere }, speed);
        }
        assert_eq!(
            (anywhere.least(), Goal { turn_deg_s: Some(1.0), ..anywhere }.least()),
            (None, Some(10.0))
        );
    }
}
