//! Plots over time as SVG in a page: stacked areas with a mark for each fault. Colours are the page's, by
//! class; scale and style are those of a sweep's plots.

use crate::plots::{Scale, WIDTH, place, tick};
use maud::{Markup, html};

/// One stacked series.
pub struct Layer {
    /// Name in the legend.
    pub name: &'static str,
    /// Class in the style sheet.
    pub class: &'static str,
    /// One value per bin.
    pub values: Vec<f64>,
}

/// An annotated time.
pub struct Mark {
    /// Time in seconds.
    pub at: f64,
    /// Description.
    pub text: String,
    /// True if it ended a fault.
    pub mends: bool,
}

const HEIGHT: f64 = 190.0;
/// Height of the margin above the plot, in pixels.
const TOP: f64 = 18.0;
/// Height of the margin below the plot, in pixels.
const BOTTOM: f64 = 24.0;
/// Width of the margin left of the plot, in pixels.
const LEFT: f64 = 64.0;
/// Width of the margin right of the plot, in pixels.
const RIGHT: f64 = 12.0;
/// Ratio to the usual value above which peaks are cut, so that the rest stays visible.
const PEAK_RATIO: f64 = 2.5;

/// Plots layers from bottom to top, until `end`; a bin is `width` seconds long.
pub fn areas(layers: &[Layer], width: f64, end: f64, marks: &[Mark], about: &str) -> Markup {
    let n = layers.iter().map(|l| l.values.len()).max().unwrap_or(0);
    let sum = |i: usize| layers.iter().filter_map(|l| l.values.get(i)).sum::<f64>();
    let mut sorted: Vec<f64> = (0..n).map(sum).collect();
    sorted.sort_by(f64::total_cmp);
    let highest = sorted.last().copied().unwrap_or(0.0);
    let usual = sorted.get(n * 97 / 100).copied().unwrap_or(0.0);
    let cut = usual > 0.0 && highest > PEAK_RATIO * usual;
    let high = if cut { usual * 1.25 } else { highest };
    let (times, values) = (Scale::over(0.0, end, LEFT), Scale::over(0.0, high, 0.0));
    let base = HEIGHT - BOTTOM;
    let x = |t: f64| LEFT + t.min(end) / end.max(1e-9) * (WIDTH - LEFT - RIGHT);
    let y = |v: f64| base - (v / values.high).min(1.0) * (base - TOP);
    let mut floor = vec![0.0; n];
    let drawn: Vec<(&Layer, String)> = layers
        .iter()
        .map(|layer| {
            let top: Vec<f64> = floor.iter().zip(&layer.values).map(|(below, value)| below + value).collect();
            let outline = outline(&floor, &top, |i, v| (x(i as f64 * width), y(v)));
            floor[..top.len()].copy_from_slice(&top);
            (layer, outline)
        })
        .collect();
    html! {
        svg viewBox=(format!("0 0 {WIDTH} {HEIGHT}")) role="img" aria-label=(about) {
            @for value in values.ticks() {
                line.grid x1=(place(LEFT)) x2=(place(WIDTH - RIGHT)) y1=(place(y(value))) y2=(place(y(value))) {}
                text.label x=(place(LEFT - 8.0)) y=(place(y(value) + 4.0)) { (tick(value)) }
            }
            @for value in times.ticks().filter(|t| *t <= end) {
                text.tick x=(place(x(value))) y=(place(HEIGHT - 7.0)) { (tick(value)) " s" }
            }
            @for (layer, outline) in &drawn {
                path class={ "area " (layer.class) } d=(outline) { title { (layer.name) } }
            }
            @if cut { text.note x=(place(LEFT + 6.0)) y=(place(TOP - 6.0)) { "peak " (tick(highest)) } }
            @for mark in marks {
                line class={ "mark" @if mark.mends { " mends" } } x1=(place(x(mark.at))) x2=(place(x(mark.at)))
                    y1=(place(TOP - 8.0)) y2=(place(base)) { title { (tick(mark.at)) " s: " (mark.text) } }
            }
        }
        @if layers.len() > 1 {
            ul.legend { @for layer in layers { li { i class=(layer.class) {} (layer.name) } } }
        }
    }
}

/// Returns a stepped path along the upper values and back along the lower ones.
fn outline(low: &[f64], high: &[f64], at: impl Fn(usize, f64) -> (f64, f64)) -> String {
    let corners = |values: &[f64]| -> Vec<(f64, f64)> {
        values.iter().enumerate().flat_map(|(i, v)| [at(i, *v), at(i + 1, *v)]).collect()
    };
    let mut points = corners(high);
    points.extend(corners(&low[..high.len()]).into_iter().rev());
    let text: Vec<String> = points.into_iter().map(|(x, y)| format!("{x:.1} {y:.1}")).collect();
    if text.is_empty() { String::new() } else { format!("M{}Z", text.join("L")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layer(class: &'static str, values: &[f64]) -> Layer {
        Layer { name: class, class, values: values.to_vec() }
    }

    #[test]
    fn layers_lie_on_each_other() {
        let text = outline(&[1.0, 1.0], &[3.0, 2.0], |i, v| (i as f64, v));
        assert_eq!(text, "M0.0 3.0L1.0 3.0L1.0 2.0L2.0 2.0L2.0 1.0L1.0 1.0L1.0 1.0L0.0 1.0Z");
        assert_eq!(outline(&[], &[], |i, v| (i as f64, v)), "");
    }

    #[test]
    fn a_single_peak_is_cut_and_told_and_texts_are_escaped() {
        let mut values = vec![10.0; 100];
        values[0] = 1_000.0;
        let marks = [Mark { at: 3.0, text: "kill <3>".into(), mends: false }];
        let text = areas(&[layer("a", &values), layer("b", &values)], 1.0, 100.0, &marks, "x").into_string();
        assert!(text.contains("peak 2,000") && text.contains("kill &lt;3&gt;"), "{text}");
        let empty = areas(&[layer("a", &[])], 1.0, 0.0, &[], "x").into_string();
        assert!(!empty.contains("NaN") && !empty.contains("inf"), "{empty}");
    }
}
