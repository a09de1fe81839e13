//! A picture as a list of paths and texts, in points (1/72 inch) from the upper left corner; and as SVG.
//!
//! Coordinates are hundredths of a point, so that the bytes are the same on every machine.

use super::palette::Rgb;
use std::fmt::Write;

/// A point of the page: to the right, and down.
pub type At = [f64; 2];

/// Width of a line, in points, and whether it is dashed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// Its colour.
    pub colour: Rgb,
    /// Its width in points.
    pub width: f64,
    /// The length of dashes and gaps in points; `None` for a solid line.
    pub dash: Option<f64>,
}

impl Stroke {
    /// Returns a solid line.
    pub fn solid(colour: Rgb, width: f64) -> Stroke {
        Stroke { colour, width, dash: None }
    }
}

/// Where a text begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// At its left end.
    Start,
    /// In the middle.
    Middle,
    /// At its right end.
    End,
}

/// An element of a picture.
#[derive(Clone, Debug, PartialEq)]
pub enum Element {
    /// Begins a group, with the identity and the attributes of its SVG element.
    Begin(String, Vec<(&'static str, String)>),
    /// Ends a group.
    End,
    /// A path of straight lines.
    Path {
        /// The pieces: their points, and whether the last one is joined to the first.
        pieces: Vec<(Vec<At>, bool)>,
        /// The colour inside.
        fill: Option<Rgb>,
        /// The opacity of all of it.
        opacity: f64,
        /// The line.
        stroke: Option<Stroke>,
    },
    /// A line of text.
    Text {
        /// The end of its base line that the anchor names.
        at: At,
        /// The anchor.
        anchor: Anchor,
        /// The height of letters in points.
        size: f64,
        /// Its colour.
        colour: Rgb,
        /// The text, of one line.
        text: String,
    },
}

/// A picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Width and height in points.
    pub size: [f64; 2],
    /// The width in an SVG, with its unit.
    pub width: String,
    /// The background.
    pub background: Option<Rgb>,
    /// Title of the picture, as plain text.
    pub title: String,
    /// How it was made.
    pub description: String,
    /// The elements, from back to front.
    pub elements: Vec<Element>,
}

impl Picture {
    /// Adds a polygon or a line.
    pub fn path(&mut self, points: Vec<At>, fill: Option<Rgb>, stroke: Option<Stroke>) {
        let closed = fill.is_some();
        self.elements.push(Element::Path { pieces: vec![(points, closed)], fill, opacity: 1.0, stroke });
    }
    /// Adds a text.
    pub fn text(&mut self, at: At, anchor: Anchor, size: f64, colour: Rgb, text: &str) {
        self.elements.push(Element::Text { at, anchor, size, colour, text: text.to_owned() });
    }

    /// Returns the picture as SVG, with attributes instead of a style sheet, which some programs ignore.
    pub fn svg(&self) -> String {
        let mut out = String::with_capacity(64 * self.elements.len() + 1024);
        let [w, h] = self.size.map(hundredths);
        // Writing to a string cannot fail.
        let _ = writeln!(
            out,
            r#"<svg xmlns="http://www.w3.org/2000/svg" width="{}" viewBox="0 0 {} {}" stroke-linejoin="round" stroke-linecap="round" font-family="DejaVu Sans, Verdana, sans-serif">"#,
            self.width,
            Number(w),
            Number(h)
        );
        let (title, description) = (escaped(&self.title), escaped(&self.description));
        let _ = writeln!(out, "<title>{title}</title>\n<desc>{description}</desc>");
        if let Some(background) = self.background {
            let _ = writeln!(out, r#"<path d="M0 0h{}v{}H0z" fill="{background}"/>"#, Number(w), Number(h));
        }
        self.elements.iter().for_each(|element| element.svg(&mut out));
        out.push_str("</svg>\n");
        out
    }
}

impl Element {
    fn svg(&self, out: &mut String) {
        let _ = match self {
            Element::Begin(id, attributes) => {
                let _ = write!(out, r#"<g id="{}""#, escaped(id));
                for (name, value) in attributes {
                    let _ = write!(out, r#" {name}="{}""#, escaped(value));
                }
                writeln!(out, ">")
            }
            Element::End => writeln!(out, "</g>"),
            Element::Path { pieces, fill, opacity, stroke } => {
                out.push_str(r#"<path d=""#);
                pieces.iter().for_each(|(points, closed)| course(out, points, *closed));
                out.push('"');
                let _ = match fill {
                    Some(fill) => write!(out, r#" fill="{fill}""#),
                    None => write!(out, r#" fill="none""#),
                };
                if *opacity < 1.0 {
                    let _ = write!(out, r#" opacity="{}""#, Number(hundredths(*opacity)));
                }
                if let Some(Stroke { colour, width, dash }) = stroke {
                    let width = Number(hundredths(*width));
                    let _ = write!(out, r#" stroke="{colour}" stroke-width="{width}""#);
                    if let Some(dash) = dash {
                        let _ = write!(out, r#" stroke-dasharray="{}""#, Number(hundredths(*dash)));
                    }
                }
                writeln!(out, "/>")
            }
            Element::Text { at, anchor, size, colour, text } => {
                let anchor = match anchor {
                    Anchor::Start => "",
                    Anchor::Middle => r#" text-anchor="middle""#,
                    Anchor::End => r#" text-anchor="end""#,
                };
                let [x, y] = at.map(|x| Number(hundredths(x)));
                let size = Number(hundredths(*size));
                writeln!(
                    out,
                    r#"<text x="{x}" y="{y}" font-size="{size}"{anchor} fill="{colour}">{}</text>"#,
                    escaped(text)
                )
            }
        };
    }
}

/// Writes a course of straight lines: the first point, then differences.
fn course(out: &mut String, points: &[At], closed: bool) {
    let mut last: Option<[i64; 2]> = None;
    for point in points {
        let [x, y] = point.map(hundredths);
        let _ = match last {
            None => write!(out, "M{} {}", Number(x), Number(y)),
            Some([a, b]) if [a, b] == [x, y] => Ok(()),
            Some([_, b]) if b == y => write!(out, "H{}", Number(x)),
            Some([a, _]) if a == x => write!(out, "V{}", Number(y)),
            Some([a, b]) => write!(out, "l{} {}", Number(x - a), Number(y - b)),
        };
        last = Some([x, y]);
    }
    if closed {
        out.push('z');
    }
}

fn hundredths(x: f64) -> i64 {
    (x * 100.0).round() as i64
}

/// A number of hundredths, in as few characters as possible.
struct Number(i64);

impl std::fmt::Display for Number {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (sign, whole, rest) = (if self.0 < 0 { "-" } else { "" }, self.0.abs() / 100, self.0.abs() % 100);
        match (whole, rest) {
            (_, 0) => write!(f, "{sign}{whole}"),
            (0, _) if rest % 10 == 0 => write!(f, "{sign}.{}", rest / 10),
            (0, _) => write!(f, "{sign}.{rest:02}"),
            _ if rest % 10 == 0 => write!(f, "{sign}{whole}.{}", rest / 10),
            _ => write!(f, "{sign}{whole}.{rest:02}"),
        }
    }
}

/// Returns a text for XML: no markup, and no characters that XML forbids.
pub fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\t' | '\n' => out.push(' '),
            c if metamorph_text::escape::is_control(c) => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_exact() {
        let written = |x: f64| Number(hundredths(x)).to_string();
        let all = [0.0, -0.001, 0.5, -0.25, 12.0, -3.1, 7.05, 123.456].map(written);
        assert_eq!(all, ["0", "0", ".5", "-.25", "12", "-3.1", "7.05", "123.46"]);
    }

    /// Differences are between rounded points, so that rounding does not add up.
    #[test]
    fn courses_return_to_where_they_began() {
        let mut out = String::new();
        let points: Vec<At> = (0..7).map(|i| [f64::from(i) / 3.0, f64::from(i * i) / 7.0]).collect();
        course(&mut out, &points, true);
        assert_eq!(out, "M0 0l.33 .14l.34 .43l.33 .72l.33 1l.34 1.28l.33 1.57z");
    }

    #[test]
    fn hostile_texts_stay_texts() {
        let picture = Picture {
            size: [10.0, 5.0],
            width: "10mm".to_owned(),
            background: None,
            title: "</title><script>alert(1)</script>".to_owned(),
            description: "a\u{1b}[31m\u{0}\"&\n".to_owned(),
            elements: vec![
                Element::Begin("m\"1".to_owned(), vec![("data-role", "<x>".to_owned())]),
                Element::End,
            ],
        };
        let svg = picture.svg();
        let document = roxmltree::Document::parse(&svg).unwrap();
        let text =
            |name| document.descendants().find(|n| n.has_tag_name(name)).and_then(|n| n.text()).unwrap();
        assert_eq!(text("title"), "</title><script>alert(1)</script>");
        assert_eq!(text("desc"), "a\u{fffd}[31m\u{fffd}\"& ");
        let group = document.descendants().find(|n| n.has_tag_name("g")).unwrap();
        assert_eq!((group.attribute("id"), group.attribute("data-role")), (Some("m\"1"), Some("<x>")));
    }
}
