//! A plot as a file of its own: SVG with attributes instead of the style sheet of a page, which other programs ignore, in
//! the colours of print.

use maud::{Markup, html};

/// The attributes that stand for the classes of `document.css`.
const STYLES: [(&str, &str); 16] = [
    ("grid", "stroke=\"#d6dde4\" stroke-width=\"1\""),
    ("tick", "fill=\"#566373\" text-anchor=\"middle\""),
    ("label", "fill=\"#1b232d\" text-anchor=\"end\""),
    ("number", "fill=\"#1b232d\""),
    ("none", "fill=\"#566373\" font-style=\"italic\""),
    ("all", "stroke=\"#1f6fb2\" stroke-width=\"1\" stroke-opacity=\"0.55\""),
    ("range", "stroke=\"#1f6fb2\" stroke-width=\"2.5\" stroke-linecap=\"round\""),
    ("box", "fill=\"#b9d6ee\" stroke=\"#1f6fb2\" stroke-width=\"1\""),
    ("bar", "fill=\"#1f6fb2\""),
    ("median", "stroke=\"#1b232d\" stroke-width=\"2\""),
    ("dot", "fill=\"#1f6fb2\" stroke=\"#ffffff\" stroke-width=\"1.5\""),
    ("mean", "fill=\"#1b232d\" stroke=\"#ffffff\" stroke-width=\"1\""),
    ("decided", "fill=\"#f2d6b8\""),
    ("band", "fill=\"#b9d6ee\" fill-opacity=\"0.6\""),
    ("line", "fill=\"none\" stroke=\"#1f6fb2\" stroke-width=\"2\""),
    ("zero", "stroke=\"#1b232d\" stroke-width=\"1\""),
];

/// Returns a plot of `plots` as an SVG file; `description` says what it shows and how it was made. Returns `None` if there
/// is nothing to plot.
pub fn file(plot: Markup, description: &str) -> Option<String> {
    let text = plot.into_string();
    let (head, body) = text.strip_prefix("<svg ")?.split_once('>')?;
    let about = html! { desc { (description) } }.into_string();
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" {head} font-family=\"sans-serif\" font-size=\"12\">{about}\
         <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>{body}\n"
    );
    for (class, attributes) in STYLES {
        svg = svg.replace(&format!("class=\"{class}\""), attributes);
    }
    Some(svg)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plots::{Row, Shift, bars, boxes, intervals, shifts};
    use crate::statistics::{Rate, Spread};

    fn row<T>(value: T) -> Row<T> {
        Row { label: "a <b>".into(), begins: false, value }
    }

    #[test]
    fn plots_are_files_without_classes() {
        let shift = Shift { by: 0.1, low: -0.1, high: 0.3, conclusion: "~" };
        let plots = [
            intervals(&[row(Rate::wilson(1, 2)), row(None)], "rates"),
            boxes(&[row(Spread::of(&mut [1.0, 2.0, 5.0])), row(None)], "spreads"),
            bars(&[row(Some(3.0)), row(None)], "bars"),
            shifts(&[row(Some(shift)), row(None)], "shifts"),
        ];
        for plot in plots {
            let svg = file(plot, "made by \"a\" & <b>").expect("there are rows");
            assert!(!svg.contains("class="), "{svg}");
            let read = roxmltree::Document::parse(&svg).expect("it is XML");
            let about = read.descendants().find(|n| n.tag_name().name() == "desc").and_then(|n| n.text());
            assert_eq!(about, Some("made by \"a\" & <b>"));
            assert!(read.root_element().attribute("viewBox").is_some());
        }
        assert_eq!(file(boxes(&[row(None)], "nothing"), ""), None);
    }
}
