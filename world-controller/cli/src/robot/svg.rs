//! Draws a posture: its cubes with their halves, plates and connectors, the cells it fills and the grid it
//! stands on.

use super::poses::radians;
use super::{Answer, RobotError};
use clap::Args;
use metamorph_console::output::Outputs;
use metamorph_console::output_kind::OutputKind;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::roombots::body::{Body, bodies, plate_radius};
use metamorph_protocol::roombots::chain::{Pose, hemispheres};
use metamorph_protocol::roombots::connector::{Connector, Site, connector_pose};
use metamorph_protocol::roombots::sweep::{GRAZE_DEPTH, entry_depth};
use metamorph_protocol::roombots::{HALF_EDGE, Kind, OUTER_RADIUS};
use metamorph_text::escape::Shown;
use serde_json::json;
use std::collections::BTreeSet;
use std::f64::consts::{PI, TAU};
use std::fmt::Write;
use std::path::PathBuf;

#[derive(Args, Clone, Debug)]
pub struct SvgArgs {
    /// single, PAR, SRS, PER or SRZ
    kind: Kind,
    /// Joint angles in degrees from the foot on: 3 for a module, 6 for a metamodule
    #[arg(required = true, allow_negative_numbers = true)]
    angles: Vec<f64>,
    /// Write the drawing to this file instead of standard output
    #[arg(long)]
    out: Option<PathBuf>,
}

pub fn answer(args: &SvgArgs) -> Result<Answer, RobotError> {
    let q = radians(&args.angles);
    let angles = args.angles.iter().map(|a| format!("{a}°")).collect::<Vec<_>>().join("  ");
    let picture = draw(args.kind, &q, &format!("{}   {angles}", args.kind))?;
    let cells: Vec<Cell> = cells(&bodies(args.kind, &q)?).into_iter().collect();
    let json = json!({"kind": args.kind, "joint_angles": args.angles, "cells": cells, "svg": picture});
    match &args.out {
        None => Ok(Answer::new(picture, json)),
        Some(path) => {
            Outputs::new().writes("--out", path, OutputKind::Picture)?.write(&picture)?;
            Ok(Answer::new(format!("drawn to {}\n", path.shown()), json))
        }
    }
}

type V = [f64; 3];

fn add(a: V, b: V, times: f64) -> V {
    [0, 1, 2].map(|i| a[i] + b[i] * times)
}
fn dot(a: V, b: V) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
fn cross(a: V, b: V) -> V {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
fn unit(a: V) -> V {
    let n = dot(a, a).sqrt();
    if n > 1e-9 { a.map(|x| x / n) } else { [1.0, 0.0, 0.0] }
}
fn column(pose: &Pose, c: usize) -> V {
    pose.rows().map(|r| r[c])
}

/// A parallel projection, seen from the front right and above.
struct View {
    right: V,
    up: V,
    eye: V,
}

/// Pixels per cell.
const SCALE: f64 = 110.0;
/// Number of points of a circle.
const CIRCLE_POINTS: u32 = 40;

impl View {
    fn new() -> View {
        let (azimuth, height) = (-62f64.to_radians(), 24f64.to_radians());
        let ((sa, ca), (sh, ch)) = (azimuth.sin_cos(), height.sin_cos());
        View { right: [-sa, ca, 0.0], up: [-sh * ca, -sh * sa, ch], eye: [ch * ca, ch * sa, sh] }
    }
    fn at(&self, p: V) -> (f64, f64) {
        (dot(p, self.right) * SCALE, -dot(p, self.up) * SCALE)
    }
}

struct Drawing {
    view: View,
    body: String,
    low: (f64, f64),
    high: (f64, f64),
}

impl Drawing {
    fn include(&mut self, p: V) -> (f64, f64) {
        let (x, y) = self.view.at(p);
        self.low = (self.low.0.min(x), self.low.1.min(y));
        self.high = (self.high.0.max(x), self.high.1.max(y));
        (x, y)
    }
    fn line(&mut self, a: V, b: V, class: &str) {
        let ((x1, y1), (x2, y2)) = (self.include(a), self.include(b));
        let _ = writeln!(
            self.body,
            r#"<line class="{class}" x1="{x1:.1}" y1="{y1:.1}" x2="{x2:.1}" y2="{y2:.1}"/>"#
        );
    }
    fn polygon(&mut self, points: impl IntoIterator<Item = V>, class: &str) {
        let mut list = String::new();
        for p in points {
            let (x, y) = self.include(p);
            let _ = write!(list, "{x:.1},{y:.1} ");
        }
        let _ = writeln!(self.body, r#"<polygon class="{class}" points="{}"/>"#, list.trim_end());
    }
    fn label(&mut self, p: V, text: &str) {
        let (x, y) = self.include(p);
        let _ = writeln!(self.body, r#"<text x="{x:.1}" y="{:.1}">{text}</text>"#, y + 4.0);
    }
    fn circle(&mut self, centre: V, a: V, b: V, radius: f64, class: &str) {
        let point = |i: u32| {
            let (s, c) = (TAU * f64::from(i) / f64::from(CIRCLE_POINTS)).sin_cos();
            add(add(centre, a, radius * c), b, radius * s)
        };
        self.polygon((0..CIRCLE_POINTS).map(point), class);
    }
}

/// Returns the cells that the cubes enter by more than 2.2 mm.
fn cells(bodies: &[Body]) -> BTreeSet<Cell> {
    let mut all = BTreeSet::new();
    for body in bodies {
        let near = [body.centre.x, body.centre.y, body.centre.z - HALF_EDGE].map(|x| x.round() as i16);
        for offset in 0..27i16 {
            let [x, y, z] =
                [near[0] + offset % 3 - 1, near[1] + offset / 3 % 3 - 1, near[2] + offset / 9 - 1];
            let mut centre = body.centre;
            (centre.x, centre.y, centre.z) = (x.into(), y.into(), f64::from(z) + HALF_EDGE);
            if entry_depth(body, &centre, GRAZE_DEPTH).is_some() {
                all.insert(Cell::new(x, y, z));
            }
        }
    }
    all
}

/// Returns a complete SVG document.
fn draw(kind: Kind, q: &[f64], title: &str) -> Result<String, RobotError> {
    let bodies = bodies(kind, q)?;
    let halves = hemispheres(kind, q)?;
    let cells = cells(&bodies);
    let far = f64::MAX;
    let mut d = Drawing { view: View::new(), body: String::new(), low: (far, far), high: (-far, -far) };

    let range = |of: fn(&Cell) -> i16| {
        let low = cells.iter().map(of).min().unwrap_or(0).min(0);
        let high = cells.iter().map(of).max().unwrap_or(0).max(0);
        (low, high)
    };
    floor(&mut d, range(|c| c.x), range(|c| c.y));
    for cell in &cells {
        wireframe(&mut d, *cell);
    }

    let mut order: Vec<usize> = (0..bodies.len()).collect();
    let depth = |i: &usize| dot(column(&halves[2 * i], 3), d.view.eye);
    order.sort_by(|a, b| depth(a).total_cmp(&depth(b)));
    for cube in order {
        draw_cube(&mut d, kind, q, cube, &halves)?;
    }

    let margin = 30.0;
    let (x, y) = (d.low.0 - margin, d.low.1 - margin - 30.0);
    let (w, h) = ((d.high.0 - x + margin).max(460.0), d.high.1 - y + margin + 20.0);
    let mut svg = format!(
        r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="{x:.0} {y:.0} {w:.0} {h:.0}" width="{w:.0}" height="{h:.0}">
<title>{title}</title>
<style>
text {{ font: 12px sans-serif; text-anchor: middle; fill: #1c2430 }}
.head {{ font: bold 15px sans-serif; text-anchor: start }}
.note {{ font: 12px sans-serif; text-anchor: start; fill: #5a6573 }}
.floor {{ stroke: #c9d1da; stroke-width: 1 }}
.port {{ fill: #e3e8ee; stroke: #c9d1da }}
.cell {{ stroke: #7b8794; stroke-width: 1; stroke-dasharray: 4 4 }}
polygon {{ stroke: #28323f; stroke-width: 1.2; stroke-linejoin: round }}
.m1-lower {{ fill: #9fc3ea }} .m1-upper {{ fill: #cfe2f7 }}
.m2-lower {{ fill: #f2bd84 }} .m2-upper {{ fill: #f9e0c4 }}
.plate {{ fill: #ffffff; fill-opacity: .82 }}
.active {{ fill: #8fd3a0; fill-opacity: .92 }}
.inner {{ fill: #8b95a1; fill-opacity: .8 }}
</style>
<rect x="{x:.0}" y="{y:.0}" width="{w:.0}" height="{h:.0}" fill="#fbfcfd"/>
"##
    );
    let left = x + 16.0;
    let _ = writeln!(svg, r#"<text class="head" x="{left:.0}" y="{:.0}">{title}</text>"#, y + 26.0);
    svg.push_str(&d.body);
    let _ = writeln!(
        svg,
        r#"<text class="note" x="{left:.0}" y="{:.0}">green: active connector, dashed: cell entered</text>"#,
        y + h - 14.0
    );
    svg.push_str("</svg>\n");
    Ok(svg)
}

fn floor(d: &mut Drawing, x: (i16, i16), y: (i16, i16)) {
    let (x0, x1) = (f64::from(x.0) - 0.5, f64::from(x.1) + 0.5);
    let (y0, y1) = (f64::from(y.0) - 0.5, f64::from(y.1) + 0.5);
    for i in x.0..=x.1 + 1 {
        let at = f64::from(i) - 0.5;
        d.line([at, y0, 0.0], [at, y1, 0.0], "floor");
    }
    for j in y.0..=y.1 + 1 {
        let at = f64::from(j) - 0.5;
        d.line([x0, at, 0.0], [x1, at, 0.0], "floor");
    }
    for i in x.0..=x.1 {
        for j in y.0..=y.1 {
            let centre = [i.into(), j.into(), 0.0];
            d.circle(centre, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0.12, "port");
        }
    }
}

fn wireframe(d: &mut Drawing, cell: Cell) {
    let corner = |i: u8| {
        let side = |bit: u8| f64::from(i >> bit & 1) - 0.5;
        [f64::from(cell.x) + side(0), f64::from(cell.y) + side(1), f64::from(cell.z) + side(2) + 0.5]
    };
    for i in 0..8u8 {
        for bit in 0..3 {
            if i >> bit & 1 == 0 {
                d.line(corner(i), corner(i | 1 << bit), "cell");
            }
        }
    }
}

fn draw_cube(d: &mut Drawing, kind: Kind, q: &[f64], cube: usize, halves: &[Pose]) -> Result<(), RobotError> {
    let (lower, upper) = (&halves[2 * cube], &halves[2 * cube + 1]);
    let centre = column(lower, 3);
    let module = cube / 2;
    let eye = d.view.eye;
    d.circle(centre, d.view.right, d.view.up, OUTER_RADIUS, &format!("m{}-lower", module + 1));

    // The visible part of the upper half: along the cut, then back along the outline.
    let axis = unit(add(add(column(lower, 0), column(lower, 1), 1.0), column(lower, 2), 1.0));
    let edge = unit(cross(axis, eye));
    let towards = |v: V, to: V| if dot(v, to) < 0.0 { v.map(|x| -x) } else { v };
    let front = towards(cross(axis, edge), eye);
    let rim = towards(cross(eye, edge), axis);
    let arc = |from: f64, side: V| {
        (0..=CIRCLE_POINTS / 2).map(move |i| {
            let (s, c) = (PI * f64::from(i) / f64::from(CIRCLE_POINTS / 2)).sin_cos();
            add(add(centre, edge, from * c * OUTER_RADIUS), side, s * OUTER_RADIUS)
        })
    };
    d.polygon(arc(1.0, front).chain(arc(-1.0, rim)), &format!("m{}-upper", module + 1));

    // Plates, those facing away most first.
    let mut plates: Vec<(V, V, V, String, &str)> = Vec::new();
    for (half, sign) in [(lower, -1.0), (upper, 1.0)] {
        for c in 0..3 {
            let normal = column(half, c).map(|x| x * sign);
            if dot(normal, eye) > 0.0 {
                let plate = (normal, column(half, (c + 1) % 3), column(half, (c + 2) % 3));
                plates.push((plate.0, plate.1, plate.2, String::new(), "inner"));
            }
        }
    }
    for connector in Connector::ALL {
        if connector.hemisphere() / 2 != cube % 2 {
            continue;
        }
        let site = Site { module: module as u8, connector };
        let outward = column(&connector_pose(kind, q, site)?, 2).map(|x| -x);
        if let Some(plate) = plates.iter_mut().find(|p| dot(p.0, outward) > 1.0 - 1e-6) {
            plate.3 = connector.name().to_owned();
            plate.4 = if connector.is_active() { "active" } else { "plate" };
        }
    }
    plates.sort_by(|a, b| dot(a.0, eye).total_cmp(&dot(b.0, eye)));
    for (normal, a, b, name, class) in plates {
        let middle = add(centre, normal, HALF_EDGE);
        d.circle(middle, a, b, plate_radius(), class);
        if dot(normal, eye) > 0.25 {
            d.label(middle, &name);
        }
    }
    Ok(())
}
