//! Plots as SVG in a page: rates with intervals, spreads as boxes, values as bars. One row per item, labels
//! to the left, numbers on hovering. Colours are the page's, by class.

use crate::statistics::{Rate, Spread};
use maud::{Markup, html};
use metamorph_text::format::number;
use metamorph_text::format::percent;

/// A row of a plot.
#[derive(Clone, Debug)]
pub struct Row<T> {
    /// Its label.
    pub label: String,
    /// True if a group of rows begins here: extra space above.
    pub begins: bool,
    /// The value drawn.
    pub value: T,
}

/// Width of every plot, in pixels.
pub const WIDTH: f64 = 860.0;
/// Width of the labels at most, in pixels.
const LABELS: f64 = 300.0;
/// Space for numbers on the right, in pixels.
const NUMBERS: f64 = 150.0;
/// Height of a row, in pixels.
const ROW: f64 = 22.0;
/// Space between groups, in pixels.
const GAP: f64 = 10.0;
/// Approximate width of a letter, in pixels.
const LETTER: f64 = 6.6;
/// Characters of a label shown at most.
const LONGEST: usize = 44;

/// A linear scale with ticks.
pub struct Scale {
    /// The lowest value.
    pub low: f64,
    /// The highest value.
    pub high: f64,
    step: f64,
    left: f64,
}

impl Scale {
    /// Creates a scale over these values, with round numbers at both ends.
    pub fn over(low: f64, high: f64, left: f64) -> Scale {
        let step = step(high - low);
        let (low, high) = ((low / step).floor() * step, (high / step).ceil() * step);
        Scale { low, high: if high > low { high } else { low + step }, step, left }
    }
    fn at(&self, value: f64) -> f64 {
        self.left + (value - self.low) / (self.high - self.low) * (WIDTH - NUMBERS - self.left)
    }
    /// Returns round values at equal distances, both ends included.
    pub fn ticks(&self) -> impl Iterator<Item = f64> {
        let n = ((self.high - self.low) / self.step).round() as u32;
        (0..=n).map(|i| self.low + f64::from(i) * self.step)
    }
}

/// Returns 1, 2 or 5 times a power of ten, so that there are four to ten steps.
fn step(range: f64) -> f64 {
    if range <= 0.0 {
        return 1.0;
    }
    let power = 10f64.powf((range / 4.0).log10().floor());
    [5.0, 2.0].into_iter().map(|n| n * power).find(|step| *step <= range / 4.0).unwrap_or(power)
}

/// Draws the frame with ticks, and in each row the result of `draw` for its value and height.
fn plot<T>(
    rows: &[Row<T>],
    scale: &Scale,
    about: &str,
    tick: impl Fn(f64) -> String,
    draw: impl Fn(&T, f64) -> Markup,
) -> Markup {
    let mut y = ROW;
    let places: Vec<f64> = rows
        .iter()
        .enumerate()
        .map(|(i, row)| {
            y += if row.begins && i > 0 { GAP } else { 0.0 };
            let middle = y + ROW / 2.0;
            y += ROW;
            middle
        })
        .collect();
    html! {
        svg viewBox=(format!("0 0 {WIDTH} {:.0}", y + 8.0)) role="img" aria-label=(about) {
            @for value in scale.ticks() {
                @let x = place(scale.at(value));
                line.grid x1=(x) x2=(x) y1=(place(ROW)) y2=(place(y)) {}
                text.tick x=(x) y=(place(ROW - 7.0)) { (tick(value)) }
            }
            @for (row, y) in rows.iter().zip(places) {
                text.label x=(place(scale.left - 10.0)) y=(place(y + 4.0)) { (cut(&row.label)) }
                (draw(&row.value, y))
            }
        }
    }
}

/// Plots rates with their intervals, from 0 to 1.
pub fn intervals(rows: &[Row<Option<Rate>>], about: &str) -> Markup {
    let scale = Scale { low: 0.0, high: 1.0, step: 0.25, left: left(rows) };
    let tick = |share| format!("{:.0} %", share * 100.0);
    plot(rows, &scale, about, tick, |rate, y| {
        let Some(Rate { rate, low, high }) = *rate else { return nothing(&scale, y) };
        let text = format!("{} ({} to {})", percent(rate), percent(low), percent(high));
        html! {
            g {
                title { (text) }
                line.range x1=(place(scale.at(low))) x2=(place(scale.at(high))) y1=(place(y)) y2=(place(y)) {}
                circle.dot cx=(place(scale.at(rate))) cy=(place(y)) r="4.5" {}
                text.number x=(place(WIDTH - NUMBERS + 12.0)) y=(place(y + 4.0)) { (percent(rate)) }
            }
        }
    })
}

/// Plots spreads: a line from minimum to maximum, a thicker one from 5 % to 95 %, a box from the first to the
/// third quartile, a stroke at the median, and a dot at the mean.
pub fn boxes(rows: &[Row<Option<Spread>>], about: &str) -> Markup {
    let spreads = || rows.iter().filter_map(|row| row.value);
    let low = spreads().map(|s| s.min).fold(f64::INFINITY, f64::min);
    let high = spreads().map(|s| s.max).fold(f64::NEG_INFINITY, f64::max);
    if low > high {
        return html! { p.none { "No run was built." } };
    }
    // Start at zero if the lowest value is near it.
    let scale = Scale::over(if low < high / 3.0 { 0.0 } else { low }, high, left(rows));
    plot(rows, &scale, about, tick, |spread, y| {
        let Some(s) = *spread else { return nothing(&scale, y) };
        let x = |value| place(scale.at(value));
        let text = format!(
            "mean {}, median {}, middle half {} to {}, 5 % to 95 % {} to {}, all {} to {}",
            number(s.mean),
            number(s.median),
            number(s.q1),
            number(s.q3),
            number(s.p5),
            number(s.p95),
            number(s.min),
            number(s.max)
        );
        html! {
            g {
                title { (text) }
                line.all x1=(x(s.min)) x2=(x(s.max)) y1=(place(y)) y2=(place(y)) {}
                line.range x1=(x(s.p5)) x2=(x(s.p95)) y1=(place(y)) y2=(place(y)) {}
                rect.box x=(x(s.q1)) y=(place(y - 6.0)) height="12" rx="2"
                    width=(place((scale.at(s.q3) - scale.at(s.q1)).max(1.0))) {}
                line.median x1=(x(s.median)) x2=(x(s.median)) y1=(place(y - 6.0)) y2=(place(y + 6.0)) {}
                circle.mean cx=(x(s.mean)) cy=(place(y)) r="3" {}
                text.number x=(place(WIDTH - NUMBERS + 12.0)) y=(place(y + 4.0)) {
                    (number(s.median)) " (" (number(s.mean)) ")"
                }
            }
        }
    })
}

/// A difference as a share, with its interval.
#[derive(Clone, Debug)]
pub struct Shift {
    /// The difference.
    pub by: f64,
    /// The lower end of its interval.
    pub low: f64,
    /// The upper end.
    pub high: f64,
    /// The conclusion, in a word.
    pub conclusion: &'static str,
}

/// Plots differences with their intervals, and a line at zero (a forest plot); `None` if there is nothing that they could
/// be shares of.
pub fn shifts(rows: &[Row<Option<Shift>>], about: &str) -> Markup {
    let ends = || rows.iter().filter_map(|row| row.value.as_ref()).flat_map(|s| [s.low, s.high]);
    let scale = Scale::over(ends().fold(0.0, f64::min), ends().fold(0.0, f64::max), left(rows));
    let signed = |share: f64| format!("{}{}", if share < 0.0 { "−" } else { "+" }, percent(share.abs()));
    plot(rows, &scale, about, signed, |shift, y| {
        let Some(Shift { by, low, high, conclusion }) = shift else {
            return html! { text.none x=(place(scale.left + 6.0)) y=(place(y + 4.0)) { "0 in A" } };
        };
        html! {
            g {
                title { (signed(*by)) " (" (signed(*low)) " to " (signed(*high)) "), " (conclusion) }
                line.zero x1=(place(scale.at(0.0))) x2=(place(scale.at(0.0)))
                    y1=(place(y - ROW / 2.0)) y2=(place(y + ROW / 2.0)) {}
                line.range x1=(place(scale.at(*low))) x2=(place(scale.at(*high))) y1=(place(y)) y2=(place(y)) {}
                circle.dot cx=(place(scale.at(*by))) cy=(place(y)) r="4.5" {}
                text.number x=(place(WIDTH - NUMBERS + 12.0)) y=(place(y + 4.0)) {
                    (signed(*by)) " " (conclusion)
                }
            }
        }
    })
}

/// Plots values as bars from zero.
pub fn bars(rows: &[Row<Option<f64>>], about: &str) -> Markup {
    let high = rows.iter().filter_map(|row| row.value).fold(0.0, f64::max);
    let scale = Scale::over(0.0, high, left(rows));
    plot(rows, &scale, about, tick, |value, y| {
        let Some(value) = *value else { return nothing(&scale, y) };
        html! {
            g {
                title { (number(value)) }
                rect.bar x=(place(scale.left)) y=(place(y - 7.0)) height="14" rx="2"
                    width=(place(scale.at(value) - scale.left)) {}
                text.number x=(place(scale.at(value) + 6.0)) y=(place(y + 4.0)) { (number(value)) }
            }
        }
    })
}

/// Formats a tick, as short as possible.
pub fn tick(value: f64) -> String {
    number(value).trim_end_matches(".0").to_owned()
}

fn nothing(scale: &Scale, y: f64) -> Markup {
    html! { text.none x=(place(scale.left + 6.0)) y=(place(y + 4.0)) { "none was built" } }
}

fn left<T>(rows: &[Row<T>]) -> f64 {
    let longest = rows.iter().map(|row| row.label.chars().count().min(LONGEST)).max().unwrap_or(0);
    (longest as f64 * LETTER + 14.0).clamp(40.0, LABELS)
}

fn cut(label: &str) -> String {
    match label.chars().count() {
        0..=LONGEST => label.to_owned(),
        _ => label.chars().take(LONGEST - 1).chain(['…']).collect(),
    }
}

/// Formats a coordinate to a tenth of a pixel.
pub fn place(x: f64) -> String {
    format!("{x:.1}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_few() {
        for (low, high) in
            [(0.0, 1.0), (6_800.0, 8_273.0), (0.0, 3e6), (35.0, 35.0), (0.001, 0.002), (97.0, 103.0)]
        {
            let scale = Scale::over(low, high, 100.0);
            let ticks: Vec<f64> = scale.ticks().collect();
            assert!((2..=11).contains(&ticks.len()), "{low} {high}: {ticks:?}");
            assert!(ticks[0] <= low && ticks[ticks.len() - 1] >= high - 1e-9, "{low} {high}: {ticks:?}");
            assert!(scale.at(low) >= 100.0 && scale.at(high) <= WIDTH - NUMBERS + 1e-6);
        }
        assert_eq!(step(100.0), 20.0);
        assert_eq!(step(39.0), 5.0);
    }

    #[test]
    fn what_is_drawn_is_escaped_and_what_is_not_there_is_said() {
        fn row<T>(label: &str, value: T) -> Row<T> {
            Row { label: label.into(), begins: false, value }
        }
        let text =
            intervals(&[row("a<b", Rate::wilson(1, 2)), row("c", None)], "rates \"by\" name").into_string();
        assert!(
            text.contains("a&lt;b") && text.contains("none was built") && text.contains("&quot;by&quot;"),
            "{text}"
        );
        assert!(boxes(&[row("c", None)], "moves").into_string().contains("No run was built"));
    }
}
