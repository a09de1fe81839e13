//! The curve as a figure for a paper.

use super::answer::{Answer, PointReport};
use maud::{Markup, html};
use metamorph_report::plots::{Scale, WIDTH, place, tick};

/// Height of the figure, in pixels.
const HEIGHT: f64 = 240.0;
/// Height of the margin above the plot, in pixels.
const TOP: f64 = 22.0;
/// Height of the margin below the plot, in pixels.
const BOTTOM: f64 = 28.0;
/// Width of the margin left of the plot, in pixels.
const LEFT: f64 = 64.0;
/// Width of the margin right of the plot, in pixels.
const RIGHT: f64 = 16.0;

/// Draws the shares along the run with their intervals, and the interval in which the end was decided.
pub fn figure(answer: &Answer, about: &str) -> Markup {
    let end = answer.since_s.max(f64::MIN_POSITIVE);
    let x = |at: f64| LEFT + (at / end).min(1.0) * (WIDTH - LEFT - RIGHT);
    let y = |share: f64| HEIGHT - BOTTOM - share * (HEIGHT - TOP - BOTTOM);
    let points = all(answer);
    let line: Vec<String> =
        points.iter().map(|p| format!("{:.1} {:.1}", x(p.at_s), y(p.share.rate))).collect();
    let upper = points.iter().map(|p| (p.at_s, p.share.high));
    let lower = points.iter().rev().map(|p| (p.at_s, p.share.low));
    let band: Vec<String> =
        upper.chain(lower).map(|(at, share)| format!("{:.1} {:.1}", x(at), y(share))).collect();
    let times = Scale::over(0.0, end, LEFT);
    let counted = match answer.sought.as_str() {
        "built" => "share of futures that are built".to_owned(),
        invariant => format!("share of futures that break {invariant}"),
    };
    html! {
        svg viewBox=(format!("0 0 {WIDTH} {HEIGHT}")) role="img" aria-label=(about) {
            text.number x=(place(LEFT)) y=(place(TOP - 5.0)) { (counted) }
            @for percent in [0.0, 25.0, 50.0, 75.0, 100.0] {
                @let at = place(y(percent / 100.0));
                line.grid x1=(place(LEFT)) x2=(place(WIDTH - RIGHT)) y1=(at) y2=(at) {}
                text.label x=(place(LEFT - 8.0)) y=(place(y(percent / 100.0) + 4.0)) { (percent) " %" }
            }
            @for value in times.ticks().filter(|t| *t <= end) {
                text.tick x=(place(x(value))) y=(place(HEIGHT - 8.0)) { (tick(value)) " s" }
            }
            @if let (Some(before), Some(after)) = (&answer.before, &answer.after) {
                @let (from, until) = (x(before.at_s), x(after.at_s));
                rect.decided x=(place(from - 1.0)) width=(place(until - from + 2.0)) y=(place(TOP)) height=(place(HEIGHT - TOP - BOTTOM)) {
                    title { "decided here" }
                }
            }
            @if !band.is_empty() {
                path.band d=(format!("M{}Z", band.join("L"))) {}
                path.line d=(format!("M{}", line.join("L"))) {}
            }
            @for p in &points {
                circle.dot cx=(place(x(p.at_s))) cy=(place(y(p.share.rate))) r="3.5" {}
            }
        }
    }
}

/// Returns the points of the curve and of the interval, in their order in time.
fn all(answer: &Answer) -> Vec<&PointReport> {
    let mut points: Vec<&PointReport> =
        answer.curve.iter().chain(&answer.before).chain(&answer.after).collect();
    // Of the same past, the one with more futures.
    points.sort_by_key(|point| (point.events, std::cmp::Reverse(point.of)));
    points.dedup_by_key(|point| point.events);
    points
}
