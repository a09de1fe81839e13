//! A picture as PDF of one page: paths alone, also those of letters, so that nothing depends on the fonts of a reader, and printers
//! that ask for embedded fonts have none to ask for.

use super::palette::Rgb;
use super::picture::{Element, Picture, Stroke};
use super::raster::{letters, path, text_start};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use pdf_writer::types::{LineCapStyle, LineJoinStyle};
use pdf_writer::{Content, Filter, Finish, Name, Pdf, Rect, Ref, TextStr};
use std::collections::BTreeMap;
use std::io::{self, Write};
use tiny_skia::{Path, PathSegment, Point};

const CATALOG: Ref = Ref::new(1);
const PAGES: Ref = Ref::new(2);
const PAGE: Ref = Ref::new(3);
const CONTENT: Ref = Ref::new(4);
const INFORMATION: Ref = Ref::new(5);
/// Number of the first object that holds an opacity.
const FIRST_OPACITY: i32 = 6;

/// Returns a picture as the content of a PDF file. The page has the size of the picture.
///
/// # Errors
///
/// The content cannot be compressed.
pub fn pdf(picture: &Picture) -> io::Result<Vec<u8>> {
    let [width, height] = picture.size.map(|points| points as f32);
    let mut page = Page { content: Content::new(), opacities: BTreeMap::new() };
    page.begin(height);
    if let Some(background) = picture.background {
        page.fill(background);
        page.content.rect(0.0, 0.0, width, height).fill_nonzero();
    }
    picture.elements.iter().for_each(|element| page.draw(element));

    let mut pdf = Pdf::new();
    // First, so that the beginning of the file says which program made it.
    let mut information = pdf.document_info(INFORMATION);
    information
        .title(TextStr(&picture.title))
        .subject(TextStr(&picture.description))
        .creator(TextStr("metamorph"));
    information.finish();
    pdf.catalog(CATALOG).pages(PAGES);
    pdf.pages(PAGES).kids([PAGE]).count(1);
    let mut described = pdf.page(PAGE);
    described.media_box(Rect::new(0.0, 0.0, width, height)).parent(PAGES).contents(CONTENT);
    let mut resources = described.resources();
    let mut states = resources.ext_g_states();
    for (percent, number) in &page.opacities {
        states.pair(Name(state(*percent).as_bytes()), Ref::new(*number));
    }
    states.finish();
    resources.finish();
    described.finish();
    for (percent, number) in &page.opacities {
        let alpha = f32::from(*percent) / 100.0;
        pdf.ext_graphics(Ref::new(*number)).non_stroking_alpha(alpha).stroking_alpha(alpha);
    }
    let mut packed = ZlibEncoder::new(Vec::new(), Compression::best());
    packed.write_all(&page.content.finish())?;
    pdf.stream(CONTENT, &packed.finish()?).filter(Filter::FlateDecode);
    Ok(pdf.finish())
}

/// Returns the name of the state of an opacity in percent.
fn state(percent: u8) -> String {
    format!("A{percent}")
}

/// The content of the page.
struct Page {
    content: Content,
    /// The opacities in percent that occur, and the numbers of their states.
    opacities: BTreeMap<u8, i32>,
}

impl Page {
    /// Makes coordinates begin in the upper left corner.
    fn begin(&mut self, height: f32) {
        self.content.transform([1.0, 0.0, 0.0, -1.0, 0.0, height]);
        self.content.set_line_cap(LineCapStyle::RoundCap).set_line_join(LineJoinStyle::RoundJoin);
    }

    fn draw(&mut self, element: &Element) {
        match element {
            Element::Begin(..) | Element::End => {}
            Element::Path { pieces, fill, opacity, stroke } => {
                let Some(path) = path(pieces) else { return };
                let percent = (opacity * 100.0).round().clamp(0.0, 100.0) as u8;
                let is_clear = percent < 100;
                if is_clear {
                    self.content.save_state();
                    self.opacity(percent);
                }
                fill.iter().for_each(|fill| self.fill(*fill));
                stroke.iter().for_each(|stroke| self.stroke(stroke));
                self.trace(&path);
                match (fill, stroke) {
                    (Some(_), Some(_)) => self.content.fill_nonzero_and_stroke(),
                    (Some(_), None) => self.content.fill_nonzero(),
                    (None, Some(_)) => self.content.stroke(),
                    (None, None) => self.content.end_path(),
                };
                if is_clear {
                    self.content.restore_state();
                }
            }
            Element::Text { at, anchor, size, colour, text } => {
                let Some(path) = letters(text, text_start(text, *at, *anchor, *size), *size) else { return };
                self.fill(*colour);
                self.trace(&path);
                self.content.fill_nonzero();
            }
        }
    }

    fn opacity(&mut self, percent: u8) {
        let next = FIRST_OPACITY + self.opacities.len() as i32;
        self.opacities.entry(percent).or_insert(next);
        self.content.set_parameters(Name(state(percent).as_bytes()));
    }

    fn fill(&mut self, colour: Rgb) {
        let [r, g, b] = parts(colour);
        self.content.set_fill_rgb(r, g, b);
    }

    fn stroke(&mut self, stroke: &Stroke) {
        let [r, g, b] = parts(stroke.colour);
        self.content.set_stroke_rgb(r, g, b).set_line_width(hundredths(stroke.width as f32));
        match stroke.dash {
            Some(dash) => self.content.set_dash_pattern([hundredths(dash as f32); 2], 0.0),
            None => self.content.set_dash_pattern([], 0.0),
        };
    }

    fn trace(&mut self, path: &Path) {
        let mut last = Point::zero();
        for segment in path.segments() {
            match segment {
                PathSegment::MoveTo(point) => {
                    self.content.move_to(hundredths(point.x), hundredths(point.y));
                    last = point;
                }
                PathSegment::LineTo(point) => {
                    self.content.line_to(hundredths(point.x), hundredths(point.y));
                    last = point;
                }
                PathSegment::QuadTo(control, end) => {
                    // PDF has cubic curves only; this one is the same.
                    let towards = |from: Point| {
                        Point::from_xy(
                            from.x + (control.x - from.x) * 2.0 / 3.0,
                            from.y + (control.y - from.y) * 2.0 / 3.0,
                        )
                    };
                    self.curve(towards(last), towards(end), end);
                    last = end;
                }
                PathSegment::CubicTo(first, second, end) => {
                    self.curve(first, second, end);
                    last = end;
                }
                PathSegment::Close => {
                    self.content.close_path();
                }
            }
        }
    }

    fn curve(&mut self, first: Point, second: Point, end: Point) {
        let [[a, b], [c, d], [e, f]] =
            [first, second, end].map(|point| [hundredths(point.x), hundredths(point.y)]);
        self.content.cubic_to(a, b, c, d, e, f);
    }
}

fn parts(Rgb(r, g, b): Rgb) -> [f32; 3] {
    [r, g, b].map(|part| thousandths(f32::from(part) / 255.0))
}

/// Rounds a length in points to what an SVG has, too, so that the file is small.
fn hundredths(x: f32) -> f32 {
    (x * 100.0).round() / 100.0
}

fn thousandths(x: f32) -> f32 {
    (x * 1000.0).round() / 1000.0
}

#[cfg(test)]
mod tests {
    use super::super::picture::Anchor;
    use super::*;
    use flate2::read::ZlibDecoder;
    use std::io::Read;

    /// Returns the operators of the page.
    fn content(pdf: &[u8]) -> String {
        let begin = pdf.windows(7).position(|part| part == b"stream\n").unwrap() + 7;
        let mut text = String::new();
        ZlibDecoder::new(&pdf[begin..]).read_to_string(&mut text).unwrap();
        text
    }

    #[test]
    fn a_page_has_the_size_the_paths_and_where_they_come_from() {
        let mut picture = Picture {
            size: [100.0, 50.0],
            width: "100pt".to_owned(),
            background: Some(Rgb(255, 255, 255)),
            title: "swarm, at 2 s".to_owned(),
            description: "metamorph render swarm (ü)".to_owned(),
            elements: Vec::new(),
        };
        picture.path(vec![[0.0, 0.0], [10.0, 0.0], [10.0, 5.0]], Some(Rgb(255, 0, 0)), None);
        let line = Stroke { colour: Rgb(0, 0, 0), width: 0.5, dash: Some(2.0) };
        picture.elements.push(Element::Path {
            pieces: vec![(vec![[1.0, 1.0], [2.0, 2.0]], false)],
            fill: None,
            opacity: 0.4,
            stroke: Some(line),
        });
        picture.text([5.0, 40.0], Anchor::Start, 7.0, Rgb(0, 0, 0), "o");
        let pdf = pdf(&picture).unwrap();
        assert!(
            pdf.starts_with(b"%PDF-") && pdf == super::pdf(&picture).unwrap(),
            "the same bytes each time"
        );
        let text = String::from_utf8_lossy(&pdf);
        for part in ["/MediaBox [0 0 100 50]", "/Count 1", "swarm, at 2 s", "/ca 0.4", "/Creator"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let content = content(&pdf);
        for part in
            ["1 0 0 -1 0 50 cm", "1 0 0 rg\n0 0 m\n10 0 l\n10 5 l\nh\nf", "/A40 gs", "[2 2] 0 d", " c\n"]
        {
            assert!(content.contains(part), "{part}: {content}");
        }
        assert!(!content.contains("Tj"), "letters are paths");
    }
}
