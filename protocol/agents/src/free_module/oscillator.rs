//! Phase oscillators in fixed point (thesis 7.1 to 7.3).
//!
//! ```text
//! dphi_i/dt = 2 pi nu + sum_j w r_j sin(phi_j - phi_i - psi_ij)
//! dr_i/dt   = a (A_i - r_i)        dx_i/dt = a (X_i - x_i)
//! theta_i   = r_i sin(phi_i) + x_i
//! ```
//!
//! The thesis prints the first one as a product of frequency and sum, with which oscillators in phase would stand still.
//! Offsets move as smoothly as amplitudes, which is our choice.
//!
//! Everything is integers, so that agents on all machines agree bit by bit: phases in 2^-32 turns, angles in 2^-20 rad,
//! rates in 2^-32 per second, and a table of sines that is computed when the program is compiled.

use metamorph_core::fields;
use metamorph_core::time::Span;
use serde::{Deserialize, Serialize};
use std::ops::{Add, Sub};

/// A phase in 2^-32 turns; it wraps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Phase(pub u32);

fields!(Phase { 0 });

impl Phase {
    /// Returns how far this phase is ahead of another, from half a turn behind to half a turn ahead, in 2^-32 turns.
    pub const fn ahead_of(self, other: Phase) -> i32 {
        self.0.wrapping_sub(other.0) as i32
    }
    /// Returns the phase after a time at this rate in turns.
    pub const fn after(self, time: Span, rate: Rate) -> Phase {
        // Invariant: a rate below 2^31 turns a second and a time below 2^64 ns fit into 128 bits.
        Phase(self.0.wrapping_add(over(rate.0 as i128, time) as u32))
    }
    /// Returns the sine in 2^-30, with an error below 10^-6.
    pub const fn sine(self) -> i32 {
        let quadrant = self.0 >> 30;
        let within = self.0 & 0x3FFF_FFFF;
        // The second and the fourth quadrant mirror the first and the third.
        let at = if quadrant & 1 == 0 { within } else { (1 << 30) - within };
        let (index, fraction) = ((at >> 20) as usize, (at & 0xF_FFFF) as i64);
        let low = SINES[index] as i64;
        let step = if fraction == 0 { 0 } else { SINES[index + 1] as i64 - low };
        let sine = (low + ((step * fraction) >> 20)) as i32;
        if quadrant < 2 { sine } else { -sine }
    }
}

impl Add for Phase {
    type Output = Phase;
    fn add(self, other: Phase) -> Phase {
        Phase(self.0.wrapping_add(other.0))
    }
}
impl Sub for Phase {
    type Output = Phase;
    fn sub(self, other: Phase) -> Phase {
        Phase(self.0.wrapping_sub(other.0))
    }
}

/// Number of parts of a quarter turn in the table of sines.
const QUARTER: usize = 1024;

/// The sines of a quarter turn in 2^-30.
static SINES: [i32; QUARTER + 1] = sines();

const fn sines() -> [i32; QUARTER + 1] {
    /// Pi in 2^-60.
    const PI: i128 = 3_622_009_729_038_561_421;
    let mut table = [0; QUARTER + 1];
    let mut k = 0;
    while k <= QUARTER {
        // The Taylor series in 2^-60; its terms are below 2, so that products stay below 2^123.
        let x = PI * k as i128 / (2 * QUARTER as i128);
        let square = (x * x) >> 60;
        let (mut term, mut sum, mut n) = (x, x, 1);
        while term != 0 {
            term = ((term * square) >> 60) / ((2 * n) * (2 * n + 1));
            sum += if n % 2 == 1 { -term } else { term };
            n += 1;
        }
        table[k] = ((sum + (1 << 29)) >> 30) as i32;
        k += 1;
    }
    table
}

/// An angle in 2^-20 rad.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Angle(pub i32);

fields!(Angle { 0 });

impl Angle {
    /// One radian.
    pub const RADIAN: Angle = Angle(1 << 20);
    /// Returns an angle in thousandths of a radian.
    pub const fn milliradians(n: i32) -> Angle {
        Angle((n as i64 * (1 << 20) / 1000) as i32)
    }
}

/// A number per second in 2^-32: turns for frequencies, 1 for rates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Rate(pub i64);

impl Rate {
    /// Returns a number of thousandths per second.
    pub const fn millis(n: i64) -> Rate {
        Rate((n << 32) / 1000)
    }
}

/// Returns a rate times a duration, rounded down.
const fn over(rate: i128, time: Span) -> i128 {
    (rate * time.0 as i128).div_euclid(1_000_000_000)
}

/// Parameters that all oscillators of a structure share.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Dynamics {
    /// Turns per second when locked.
    pub frequency: Rate,
    /// The weight of couplings: radians per second for an amplitude of one radian.
    pub weight: Rate,
    /// How fast amplitudes and offsets approach their targets, per second.
    pub approach: Rate,
}

impl Dynamics {
    /// Frequency and weight of thesis 7.3: 0.2 Hz and 2. The thesis does not give the rate; ours is 2 per second.
    pub const THESIS: Dynamics =
        Dynamics { frequency: Rate::millis(200), weight: Rate::millis(2000), approach: Rate::millis(2000) };
}

/// The step of integration (explicit Euler): 10 ms.
pub const STEP: Span = Span::millis(10);

/// The state of an oscillator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Oscillator {
    /// The phase.
    pub phase: Phase,
    /// The amplitude.
    pub amplitude: Angle,
    /// The offset.
    pub offset: Angle,
}

impl Oscillator {
    /// Returns the angle that the joint is to have.
    pub const fn angle(&self) -> Angle {
        let swing = (self.amplitude.0 as i64 * self.phase.sine() as i64) >> 30;
        Angle((swing + self.offset.0 as i64) as i32)
    }

    /// Returns how much an oscillator with this phase and amplitude pulls this one, in 2^-32 rad/s. A lag is the phase of
    /// the other one less that of this one when locked.
    pub fn pull(&self, dynamics: &Dynamics, phase: Phase, amplitude: Angle, lag: Phase) -> i64 {
        let sine = i128::from((phase - self.phase - lag).sine());
        // 2^-32 * 2^-20 * 2^-30, to 2^-32.
        ((i128::from(dynamics.weight.0) * i128::from(amplitude.0) * sine) >> 50) as i64
    }

    /// Takes a [`STEP`] towards these amplitude and offset, with the sum of all pulls.
    pub fn step(&mut self, dynamics: &Dynamics, pulls: i64, amplitude: Angle, offset: Angle) {
        /// One turn per radian, in 2^-32.
        const TURNS: i128 = 683_565_275;
        let turns = Rate(dynamics.frequency.0 + ((i128::from(pulls) * TURNS) >> 32) as i64);
        self.phase = self.phase.after(STEP, turns);
        let approached = |from: Angle, to: Angle| {
            let rate = (i128::from(dynamics.approach.0) * (i128::from(to.0) - i128::from(from.0))) >> 32;
            Angle(from.0 + over(rate, STEP) as i32)
        };
        self.amplitude = approached(self.amplitude, amplitude);
        self.offset = approached(self.offset, offset);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use siphasher::sip::SipHasher13;
    use std::f64::consts::TAU;
    use std::hash::Hasher;

    /// The table is part of what agents agree on.
    #[test]
    fn the_table_of_sines_is_held_by_a_hash() {
        let mut hasher = SipHasher13::new();
        SINES.iter().for_each(|s| hasher.write(&s.to_le_bytes()));
        assert_eq!((SINES[0], SINES[512], SINES[1024]), (0, 759_250_125, 1 << 30));
        assert_eq!(hasher.finish(), 9_317_714_800_641_053_224);
    }

    #[test]
    fn sines_are_exact_to_a_millionth() {
        for k in 0..1_000_000_u32 {
            let phase = Phase(k.wrapping_mul(2_654_435_761));
            let exact = (f64::from(phase.0) / 2f64.powi(32) * TAU).sin();
            let found = f64::from(phase.sine()) / 2f64.powi(30);
            assert!((found - exact).abs() < 1e-6, "{phase:?}: {found}, {exact}");
        }
        for quarter in 0..4 {
            assert_eq!(Phase(quarter << 30).sine(), [0, 1 << 30, 0, -(1 << 30)][quarter as usize]);
        }
    }

    #[test]
    fn phases_wrap() {
        let almost = Phase(u32::MAX);
        assert_eq!(Phase(0).ahead_of(almost), 1);
        assert_eq!(almost.ahead_of(Phase(0)), -1);
        let second = Phase(5).after(Span::secs(5), Rate::millis(200));
        assert!(second.ahead_of(Phase(5)).abs() < 10, "0.2 Hz for 5 s is a turn: {second:?}");
    }

    /// The equation as printed, a product, would leave locked oscillators where they are.
    #[test]
    fn locked_oscillators_turn_at_their_frequency() {
        let mut pair = [Oscillator { amplitude: Angle::RADIAN, ..Oscillator::default() }; 2];
        for _ in 0..500 {
            let pulls = [0, 1]
                .map(|i| pair[i].pull(&Dynamics::THESIS, pair[1 - i].phase, pair[1 - i].amplitude, Phase(0)));
            for (one, pull) in pair.iter_mut().zip(pulls) {
                one.step(&Dynamics::THESIS, pull, Angle::RADIAN, Angle::default());
            }
        }
        assert!(pair[0].phase.ahead_of(Phase(0)).abs() < 1_000, "a turn in 5 s: {pair:?}");
        assert_eq!(pair[0], pair[1]);
    }
}
