//! All solutions of the metamodule, by the Paden–Kahan sub-problems and a search over one angle.
//!
//! Thesis appendix A.2 derives a closed form: θ6 from an auxiliary problem (equations A.18–A.20),
//! then θ3, θ2, θ1, θ4, θ5 in turn (A.7–A.17). **As printed it does not hold.** θ6 cannot be found
//! first: no reading of A.18–A.20 solves random targets. The auxiliary points must lie off the axis
//! of their joint, but the orthogonal projection of q6 (the thesis's q̃6) onto the plane normal to axis 5 lies *on*
//! that axis, so A.17 leaves θ5 open; and A.9–A.12 subtract points where vectors are meant. What does
//! hold is the chain of sub-problems for a *given* θ6, which leaves one scalar equation f(θ6) = 0.
//! This file solves that equation.
//!
//! With c1..c4 the centres of the cubes and d1, d2, d3 the unit vectors between them: the target
//! fixes c4 and, with θ6, d3 and v = c3 − c1. Then
//!
//! * c2 is at distance 1 from c1 and c3 and on the circle that axis 1 allows: two choices
//!   (sub-problem 3 for θ1);
//! * axis 3 stands at 54.7° to d1 and d2: two choices (θ2 and θ3);
//! * axis 4 is axis 3 turned about d2 by the kind's quarter turns, and must stand at 54.7° to d3:
//!   this is f.
//!
//! The choices merge where a square root vanishes. f is therefore followed along the closed curves
//! that the merging choices form, with the parameter θ6 = m − r cos u, in which it is smooth: roots
//! at the merging points and close pairs of roots are not lost. A straight section (d1 = d2) leaves
//! axis 3 free and is a case of its own.

use crate::HALF_EDGE;
use crate::Kind;
use crate::chain::{Pose, diagonal, flip, rotation};
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::{PI, TAU};

/// Solves sub-problem 1: the angle that turns `from` into `to` about the unit axis through the origin. Zero
/// if one of them lies on the axis.
pub fn turn_about(axis: &Vector3<f64>, from: &Vector3<f64>, to: &Vector3<f64>) -> f64 {
    let u = from - axis * axis.dot(from);
    let w = to - axis * axis.dot(to);
    axis.dot(&u.cross(&w)).atan2(u.dot(&w))
}

/// Cosine of the angle between a diagonal axis and its neighbours in the chain.
const CONE: f64 = 0.577_350_269_189_625_8;
/// Number of samples per half turn of u.
const SAMPLES: usize = 64;
/// The largest angle in radians that the normal of the first bend turns by between two samples.
const MAX_TURN: f64 = 0.25;
/// The largest number of times that an interval of u is halved to stay within [`MAX_TURN`].
const MAX_DEPTH: u32 = 14;
/// The largest number of samples of a curve; only degenerate targets would need more.
const MAX_SAMPLES: usize = 4096;
/// Length of the bend below which its normal is not significant.
const NO_BEND: f64 = 1e-9;
/// Distance of f from zero at a sample that counts as zero: the target has a whole curve of postures.
const ZERO: f64 = 1e-13;

/// The signs that select one of the two choices of c2 and one of the two choices of axis 3.
#[derive(Clone, Copy, PartialEq)]
struct Sheet {
    c2: f64,
    axis: f64,
}

/// Which choices merge at the end of a range of θ6.
#[derive(Clone, Copy, PartialEq)]
enum Merge {
    C2,
    Axis,
}

impl Merge {
    fn other(self, s: Sheet) -> Sheet {
        match self {
            Merge::C2 => Sheet { c2: -s.c2, ..s },
            Merge::Axis => Sheet { axis: -s.axis, ..s },
        }
    }
}

/// The function a + b cos θ + c sin θ, as (a, b, c).
#[derive(Clone, Copy)]
struct Wave(f64, f64, f64);

impl Wave {
    fn at(self, (s, c): (f64, f64)) -> f64 {
        self.0 + self.1 * c + self.2 * s
    }
    fn slope(self, (s, c): (f64, f64)) -> f64 {
        self.2 * c - self.1 * s
    }
    /// Returns the angles at which the function is zero.
    fn zeros(self) -> Vec<f64> {
        let amplitude = self.1.hypot(self.2);
        let middle = self.2.atan2(self.1);
        if amplitude < 1e-12 || self.0.abs() > amplitude {
            return Vec::new();
        }
        let half = (-self.0 / amplitude).acos();
        vec![middle - half, middle + half]
    }
}

/// A range of θ6: its first and last angle, and which choices merge there; `None` if it is the whole circle.
type Range = (f64, f64, Option<[Merge; 2]>);

/// The geometry of one question.
struct Problem {
    kind: Kind,
    /// R6: the rotation of the last hemisphere.
    last: Matrix3<f64>,
    /// The component of z at right angles to axis 1, and the same turned by 90° about axis 1.
    across: Vector3<f64>,
    beside: Vector3<f64>,
    /// v = c3 − c1 = v0 + vc cos θ6 + vs sin θ6
    v0: Vector3<f64>,
    vc: Vector3<f64>,
    vs: Vector3<f64>,
    /// |v|²/2, which is 1 + d1·d2.
    h: Wave,
    /// The triangle of sub-problem 3: β cos θ1 + γ sin θ1 = α.
    alpha: Wave,
    beta: Wave,
    gamma: Wave,
}

/// One point of a curve.
struct Point {
    d1: Vector3<f64>,
    d2: Vector3<f64>,
    d3: Vector3<f64>,
    /// Unit normal of the bend between d1 and d2.
    normal: Vector3<f64>,
    axis3: Vector3<f64>,
    f: f64,
}

impl Problem {
    fn new(kind: Kind, target: &Pose) -> Problem {
        let w = diagonal();
        let last = target.rotation * flip();
        let c4 = target.origin - last.column(2) * HALF_EDGE;
        let z = Vector3::z();
        let across = z - w * CONE;
        let beside = w.cross(&z);
        // d3 = R6 C(−θ6) z
        let v0 = c4 - Vector3::new(0.0, 0.0, HALF_EDGE) - last * w * CONE;
        let (vc, vs) = (-(last * across), last * beside);
        let wave = |u: &Vector3<f64>| Wave(u.dot(&v0), u.dot(&vc), u.dot(&vs));
        let square = v0.norm_squared() + vc.norm_squared();
        let h = Wave(square / 2.0, v0.dot(&vc), v0.dot(&vs));
        let along = wave(&(w * CONE));
        let alpha = Wave(h.0 - along.0, h.1 - along.1, h.2 - along.2);
        let (beta, gamma) = (wave(&across), wave(&beside));
        Problem { kind, last, across, beside, v0, vc, vs, h, alpha, beta, gamma }
    }

    /// Returns a value that is positive where there are two choices of c2.
    fn c2_margin(&self, t: f64) -> f64 {
        let sc = t.sin_cos();
        self.beta.at(sc).powi(2) + self.gamma.at(sc).powi(2) - self.alpha.at(sc).powi(2)
    }
    fn c2_margin_slope(&self, t: f64) -> f64 {
        let sc = t.sin_cos();
        let d = |w: Wave| 2.0 * w.at(sc) * w.slope(sc);
        d(self.beta) + d(self.gamma) - d(self.alpha)
    }
    /// Returns a value that is positive where there are two choices of axis 3: bends of up to 109.47° are
    /// possible.
    fn axis_margin(&self, t: f64) -> f64 {
        self.h.at(t.sin_cos()) - 2.0 / 3.0
    }

    fn d3(&self, t: f64) -> Vector3<f64> {
        self.last * (rotation(&diagonal(), -t) * Vector3::z())
    }
    fn axis4(&self, d2: &Vector3<f64>, axis3: &Vector3<f64>) -> Vector3<f64> {
        match self.kind.quarter_turns() {
            0 => *axis3,
            1 => d2 * CONE + d2.cross(axis3),
            2 => d2 * (2.0 * CONE) - axis3,
            _ => d2 * CONE - d2.cross(axis3),
        }
    }

    fn at(&self, t: f64, sheet: Sheet) -> Point {
        let sc = t.sin_cos();
        let v = self.v0 + self.vc * sc.1 + self.vs * sc.0;
        let (alpha, beta, gamma) = (self.alpha.at(sc), self.beta.at(sc), self.gamma.at(sc));
        let square = (beta * beta + gamma * gamma).max(1e-300);
        // The root vanishes where the choices merge.
        let root = sheet.c2 * (beta * beta + gamma * gamma - alpha * alpha).max(0.0).sqrt();
        let cosine = (alpha * beta - gamma * root) / square;
        let sine = (alpha * gamma + beta * root) / square;
        let d1 = diagonal() * CONE + self.across * cosine + self.beside * sine;
        let d2 = v - d1;
        let h = self.h.at(sc).max(1e-12);
        let cross = d1.cross(&v);
        let length = cross.norm();
        let normal = if length > NO_BEND { cross / length } else { Vector3::zeros() };
        let out = (1.0 - 2.0 / (3.0 * h)).max(0.0).sqrt();
        let axis3 = v * (CONE / h) + normal * (sheet.axis * out);
        let d3 = self.d3(t);
        let f = self.axis4(&d2, &axis3).dot(&d3) - CONE;
        Point { d1, d2, d3, normal, axis3, f }
    }

    /// Returns the ranges of θ6 in which c2 and axis 3 exist, and the angles at which a range may be a single
    /// point.
    fn ranges(&self) -> (Vec<Range>, Vec<f64>) {
        /// Number of samples by which the zeros of the slope are bracketed: between them the margin is monotonic.
        const COARSE: usize = 96;
        let step = TAU / COARSE as f64;
        let slope = |t: f64| self.c2_margin_slope(t);
        let mut turning = Vec::new();
        // Avoids the angles at which symmetric targets turn, where rounding would decide the sign.
        let angles: Vec<f64> = (0..COARSE).map(|i| 0.012_345 + i as f64 * step).collect();
        let falling: Vec<bool> = angles.iter().map(|t| slope(*t) < 0.0).collect();
        for (i, a) in angles.iter().enumerate() {
            if falling[i] != falling[(i + 1) % COARSE] {
                turning.push(bisect(*a, a + step, slope));
            }
        }
        let mut ends: Vec<(f64, Merge)> = Vec::new();
        for (i, a) in turning.iter().enumerate() {
            let b = turning.get(i + 1).copied().unwrap_or(turning[0] + TAU);
            if (self.c2_margin(*a) < 0.0) != (self.c2_margin(b) < 0.0) {
                ends.push((bisect(*a, b, |t| self.c2_margin(t)).rem_euclid(TAU), Merge::C2));
            }
        }
        let axis = Wave(self.h.0 - 2.0 / 3.0, self.h.1, self.h.2);
        ends.extend(axis.zeros().into_iter().map(|t| (t.rem_euclid(TAU), Merge::Axis)));
        ends.sort_by(|a, b| a.0.total_cmp(&b.0));
        let inside = |t: f64| self.c2_margin(t) > 0.0 && self.axis_margin(t) > 0.0;
        let mut ranges = Vec::new();
        if ends.is_empty() {
            if inside(0.0) {
                ranges.push((0.0, TAU, None));
            }
        } else {
            for (i, (a, left)) in ends.iter().enumerate() {
                let (b, right) = match ends.get(i + 1) {
                    Some((b, m)) => (*b, *m),
                    None => (ends[0].0 + TAU, ends[0].1),
                };
                if b > *a && inside((a + b) / 2.0) {
                    ranges.push((*a, b, Some([*left, right])));
                }
            }
        }
        let touching = turning.into_iter().filter(|t| self.c2_margin(*t).abs() < 1e-9).collect();
        (ranges, touching)
    }

    /// Returns the joint angles of a point: θ1..θ5 each by sub-problem 1.
    fn joints(&self, t: f64, p: &Point) -> Vec<f64> {
        let (w, z) = (diagonal(), Vector3::z());
        let q1 = turn_about(&w, &z, &p.d1);
        let r1 = rotation(&w, q1);
        let q2 = turn_about(&z, &w, &r1.tr_mul(&p.axis3));
        let r2 = r1 * rotation(&z, q2);
        let q3 = turn_about(&w, &z, &r2.tr_mul(&p.d2));
        let turn = f64::from(self.kind.quarter_turns()) * PI / 2.0;
        let r3 = r2 * rotation(&w, q3) * rotation(&z, turn);
        let q4 = turn_about(&w, &z, &r3.tr_mul(&p.d3));
        let r4 = r3 * rotation(&w, q4);
        // A point off axis 5: axis 6 itself.
        let q5 = turn_about(&z, &w, &r4.tr_mul(&(self.last * w)));
        vec![q1, q2, q3, q4, q5, t]
    }
}

/// Offers every root as a vector of joint angles; the caller checks and improves it.
pub fn candidates(kind: Kind, target: &Pose, offer: &mut impl FnMut(Vec<f64>)) {
    let problem = Problem::new(kind, target);
    let (ranges, touching) = problem.ranges();
    for (a, b, ends) in ranges {
        for curve in curves(a, b, ends) {
            roots_of(&problem, &curve, offer);
        }
    }
    for t in touching {
        for sheet in [Sheet { c2: 1.0, axis: 1.0 }, Sheet { c2: 1.0, axis: -1.0 }] {
            let p = problem.at(t, sheet);
            if p.f.abs() < 1e-6 {
                offer(problem.joints(t, &p));
            }
        }
    }
    straight(&problem, offer);
}

/// A closed curve: pieces of half a turn of u each, on which θ6 runs over the range and back.
struct Curve {
    middle: f64,
    radius: f64,
    sheets: Vec<Sheet>,
    whole_circle: bool,
}

impl Curve {
    fn length(&self) -> f64 {
        if self.whole_circle { TAU } else { PI * self.sheets.len() as f64 }
    }
    fn place(&self, u: f64) -> (f64, Sheet) {
        if self.whole_circle {
            return (u, self.sheets[0]);
        }
        let u = u.rem_euclid(self.length());
        let piece = ((u / PI) as usize).min(self.sheets.len() - 1);
        (self.middle - self.radius * u.cos(), self.sheets[piece])
    }
}

fn curves(a: f64, b: f64, ends: Option<[Merge; 2]>) -> Vec<Curve> {
    let all = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)].map(|(c2, axis)| Sheet { c2, axis });
    let (middle, radius) = ((a + b) / 2.0, (b - a) / 2.0);
    let Some([left, right]) = ends else {
        return all.map(|s| Curve { middle, radius, sheets: vec![s], whole_circle: true }).into();
    };
    let mut used: Vec<Sheet> = Vec::new();
    let mut curves = Vec::new();
    for first in all {
        if used.contains(&first) {
            continue;
        }
        let mut sheets = Vec::new();
        let mut sheet = first;
        // Forth on one sheet, back on the one it merges with, until the first comes again.
        loop {
            sheets.extend([sheet, right.other(sheet)]);
            sheet = left.other(right.other(sheet));
            if sheet == first {
                break;
            }
        }
        used.extend(&sheets);
        curves.push(Curve { middle, radius, sheets, whole_circle: false });
    }
    curves
}

struct Sample {
    u: f64,
    f: f64,
    normal: Vector3<f64>,
    axis: f64,
}

fn roots_of(problem: &Problem, curve: &Curve, offer: &mut impl FnMut(Vec<f64>)) {
    let sample = |u: f64| {
        let (t, sheet) = curve.place(u);
        let p = problem.at(t, sheet);
        Sample { u, f: p.f, normal: p.normal, axis: sheet.axis }
    };
    let mut offer_at = |u: f64| {
        let (t, sheet) = curve.place(u);
        offer(problem.joints(t, &problem.at(t, sheet)));
    };
    let f = |u: f64| {
        let (t, sheet) = curve.place(u);
        problem.at(t, sheet).f
    };
    let count = (curve.length() / PI).round() as usize * SAMPLES;
    let step = curve.length() / count as f64;
    let mut samples = vec![sample(0.0)];
    for i in 1..=count {
        let next = sample(i as f64 * step);
        refine(&mut samples, next, &sample, MAX_DEPTH);
    }
    let n = samples.len();
    for i in 0..n - 1 {
        let (a, b) = (&samples[i], &samples[i + 1]);
        if a.f.abs() < ZERO {
            offer_at(a.u);
        }
        if (a.f < 0.0) != (b.f < 0.0) {
            offer_at(regula_falsi((a.u, a.f), (b.u, b.f), f));
            continue;
        }
        // A close pair of roots or a double root: |f| has a minimum near zero at b.
        let c = if i + 2 < n { &samples[i + 2] } else { &samples[1] };
        let c_u = if i + 2 < n { c.u } else { c.u + curve.length() };
        if (c.f < 0.0) != (b.f < 0.0) || b.f.abs() > a.f.abs() || b.f.abs() > c.f.abs() {
            continue;
        }
        let drop = (a.f.abs() + c.f.abs()) / 2.0 - b.f.abs();
        if b.f.abs() > 2.0 * drop + 1e-6 {
            continue;
        }
        let sign = b.f.signum();
        let (u, least) = minimum(a.u, c_u, |u| sign * f(u));
        if least < 0.0 {
            offer_at(regula_falsi((a.u, a.f), (u, sign * least), f));
            offer_at(regula_falsi((u, sign * least), (c_u, c.f), f));
        } else if least < 1e-7 {
            offer_at(u);
        }
    }
}

/// Adds samples before `next` until the bend normal turns little between two.
fn refine(samples: &mut Vec<Sample>, next: Sample, sample: &impl Fn(f64) -> Sample, depth: u32) {
    let last = samples.last().expect("the first sample is there from the start");
    // Only axis 3 matters: it changes side where the choices of axis 3 merge.
    let turn = (last.normal * last.axis).dot(&(next.normal * next.axis));
    let merged = last.axis != next.axis;
    let unknown = last.normal == Vector3::zeros() || next.normal == Vector3::zeros();
    let turns = !merged && !unknown && turn < MAX_TURN.cos();
    if turns && depth > 0 && samples.len() < MAX_SAMPLES {
        let middle = sample((last.u + next.u) / 2.0);
        refine(samples, middle, sample, depth - 1);
        refine(samples, next, sample, depth - 1);
    } else {
        samples.push(next);
    }
}

/// Solves a straight first section, d1 = d2: axis 3 may stand anywhere around it.
fn straight(problem: &Problem, offer: &mut impl FnMut(Vec<f64>)) {
    // |v| = 2, the largest value: a zero or a touching maximum.
    let wave = Wave(problem.h.0 - 2.0, problem.h.1, problem.h.2);
    let mut angles = wave.zeros();
    let amplitude = wave.1.hypot(wave.2);
    if (wave.0 + amplitude).abs() < 1e-9 {
        angles.push(wave.2.atan2(wave.1));
    }
    for t in angles {
        let sc = t.sin_cos();
        let d = ((problem.v0 + problem.vc * sc.1 + problem.vs * sc.0) / 2.0).normalize();
        if (d.dot(&diagonal()) - CONE).abs() > 1e-7 {
            continue;
        }
        let d3 = problem.d3(t);
        let e1 = if d.x.abs() < 0.8 { d.cross(&Vector3::x()) } else { d.cross(&Vector3::y()) }.normalize();
        let e2 = d.cross(&e1);
        let around = |psi: f64| {
            let axis3 = d * CONE + (e1 * psi.cos() + e2 * psi.sin()) * (2f64 / 3.0).sqrt();
            let f = problem.axis4(&d, &axis3).dot(&d3) - CONE;
            Point { d1: d, d2: d, d3, normal: Vector3::zeros(), axis3, f }
        };
        // f is a wave in psi.
        let (f0, f1, f2) = (around(0.0).f, around(PI / 2.0).f, around(PI).f);
        let mean = (f0 + f2) / 2.0;
        let wave = Wave(mean, (f0 - f2) / 2.0, f1 - mean);
        let amplitude = wave.1.hypot(wave.2);
        let psis = if amplitude < 1e-9 && wave.0.abs() < 1e-9 {
            // The next section is straight as well and all joints turn freely.
            (0..24).map(|i| f64::from(i) * PI / 12.0).collect()
        } else if wave.0.abs() > amplitude && wave.0.abs() < amplitude * (1.0 + 1e-9) {
            vec![(-wave.0 * wave.2).atan2(-wave.0 * wave.1)]
        } else {
            wave.zeros()
        };
        for psi in psis {
            offer(problem.joints(t, &around(psi)));
        }
    }
}

fn bisect(mut a: f64, mut b: f64, f: impl Fn(f64) -> f64) -> f64 {
    let negative = f(a) < 0.0;
    for _ in 0..60 {
        let middle = (a + b) / 2.0;
        if (f(middle) < 0.0) == negative { a = middle } else { b = middle }
    }
    (a + b) / 2.0
}

/// Finds a root between two values of different sign (Illinois variant of the false position).
fn regula_falsi(mut a: (f64, f64), mut b: (f64, f64), f: impl Fn(f64) -> f64) -> f64 {
    for _ in 0..60 {
        if a.1 == b.1 || (b.0 - a.0).abs() < 1e-14 {
            break;
        }
        let u = (a.0 * b.1 - b.0 * a.1) / (b.1 - a.1);
        let value = f(u);
        if value.abs() < 1e-15 {
            return u;
        }
        if (value < 0.0) == (b.1 < 0.0) {
            a.1 /= 2.0;
        } else {
            a = b;
        }
        b = (u, value);
    }
    b.0
}

/// Finds a minimum between `a` and `b` by golden section; stops as soon as it is below zero.
fn minimum(mut a: f64, mut b: f64, f: impl Fn(f64) -> f64) -> (f64, f64) {
    /// The golden ratio less one.
    const GOLDEN_RATIO: f64 = 0.618_033_988_749_895;
    let (mut x, mut y) = (b - GOLDEN_RATIO * (b - a), a + GOLDEN_RATIO * (b - a));
    let (mut fx, mut fy) = (f(x), f(y));
    for _ in 0..48 {
        if fx < 0.0 {
            return (x, fx);
        }
        if fy < 0.0 {
            return (y, fy);
        }
        if fx < fy {
            (b, y, fy) = (y, x, fx);
            x = b - GOLDEN_RATIO * (b - a);
            fx = f(x);
        } else {
            (a, x, fx) = (x, y, fy);
            y = a + GOLDEN_RATIO * (b - a);
            fy = f(y);
        }
    }
    if fx < fy { (x, fx) } else { (y, fy) }
}
