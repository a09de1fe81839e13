//! A picture as pixels, and as PNG.

use super::palette::Rgb;
use super::picture::{Anchor, At, Element, Picture, Stroke};
use std::io::{self, Write};
use tiny_skia::{FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, StrokeDash, Transform};
use ttf_parser::{Face, OutlineBuilder};

/// Number of pixels of a picture at most.
pub const MOST_PIXELS: u64 = 100_000_000;

/// The font of texts: a part of DejaVu Sans (`font-licence.txt`).
static FONT: &[u8] = include_bytes!("font.ttf");

fn font() -> Face<'static> {
    Face::parse(FONT, 0).expect("invariant: the font in the program is whole, as a test shows")
}

/// Returns the width of a text of this size.
pub fn text_width(text: &str, size: f64) -> f64 {
    let font = font();
    let units: u32 = text.chars().map(|c| advance(&font, c)).sum();
    f64::from(units) * size / f64::from(font.units_per_em())
}

fn advance(font: &Face<'_>, c: char) -> u32 {
    font.glyph_hor_advance(font.glyph_index(c).unwrap_or_default()).unwrap_or(0).into()
}

/// Returns the number of pixels of a picture along both sides.
pub fn pixels(picture: &Picture, dpi: u32) -> [u32; 2] {
    picture.size.map(|points| ((points / 72.0 * f64::from(dpi)).round() as u32).max(1))
}

/// Draws a picture; `None` if it is too large.
pub fn draw(picture: &Picture, dpi: u32) -> Option<Pixmap> {
    let [width, height] = pixels(picture, dpi);
    if u64::from(width) * u64::from(height) > MOST_PIXELS {
        return None;
    }
    let mut pixmap = Pixmap::new(width, height)?;
    if let Some(Rgb(r, g, b)) = picture.background {
        pixmap.fill(tiny_skia::Color::from_rgba8(r, g, b, 255));
    }
    let scale = dpi as f32 / 72.0;
    let transform = Transform::from_scale(scale, scale);
    let font = font();
    for element in &picture.elements {
        match element {
            Element::Begin(..) | Element::End => {}
            Element::Path { pieces, fill, opacity, stroke } => {
                let Some(path) = path(pieces) else { continue };
                if let Some(fill) = fill {
                    pixmap.fill_path(&path, &paint(*fill, *opacity), FillRule::Winding, transform, None);
                }
                if let Some(stroke) = stroke {
                    pixmap.stroke_path(
                        &path,
                        &paint(stroke.colour, *opacity),
                        &line(*stroke),
                        transform,
                        None,
                    );
                }
            }
            Element::Text { at, anchor, size, colour, text } => {
                let left = match anchor {
                    Anchor::Start => 0.0,
                    Anchor::Middle => text_width(text, *size) / 2.0,
                    Anchor::End => text_width(text, *size),
                };
                if let Some(path) = letters(&font, text, [at[0] - left, at[1]], *size) {
                    pixmap.fill_path(&path, &paint(*colour, 1.0), FillRule::Winding, transform, None);
                }
            }
        }
    }
    Some(pixmap)
}

fn paint(Rgb(r, g, b): Rgb, opacity: f64) -> Paint<'static> {
    let mut paint = Paint::default();
    paint.set_color_rgba8(r, g, b, (opacity * 255.0).round() as u8);
    paint
}

fn line(stroke: Stroke) -> tiny_skia::Stroke {
    let dash = stroke.dash.map(|dash| dash as f32);
    tiny_skia::Stroke {
        width: stroke.width as f32,
        line_cap: LineCap::Round,
        line_join: LineJoin::Round,
        dash: dash.and_then(|dash| StrokeDash::new(vec![dash, dash], 0.0)),
        ..tiny_skia::Stroke::default()
    }
}

fn path(pieces: &[(Vec<At>, bool)]) -> Option<Path> {
    let mut path = PathBuilder::new();
    for (points, closed) in pieces {
        for (i, [x, y]) in points.iter().map(|p| p.map(|x| x as f32)).enumerate() {
            match i {
                0 => path.move_to(x, y),
                _ => path.line_to(x, y),
            }
        }
        if *closed {
            path.close();
        }
    }
    path.finish()
}

/// The outlines of glyphs on a page.
struct Letters {
    path: PathBuilder,
    left: f32,
    base: f32,
    scale: f32,
}

impl Letters {
    fn at(&self, x: f32, y: f32) -> (f32, f32) {
        (self.left + x * self.scale, self.base - y * self.scale)
    }
}

impl OutlineBuilder for Letters {
    fn move_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.at(x, y);
        self.path.move_to(x, y);
    }
    fn line_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.at(x, y);
        self.path.line_to(x, y);
    }
    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let ((x1, y1), (x, y)) = (self.at(x1, y1), self.at(x, y));
        self.path.quad_to(x1, y1, x, y);
    }
    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let ((x1, y1), (x2, y2), (x, y)) = (self.at(x1, y1), self.at(x2, y2), self.at(x, y));
        self.path.cubic_to(x1, y1, x2, y2, x, y);
    }
    fn close(&mut self) {
        self.path.close();
    }
}

fn letters(font: &Face<'_>, text: &str, [x, y]: At, size: f64) -> Option<Path> {
    let scale = size as f32 / f32::from(font.units_per_em());
    let mut letters = Letters { path: PathBuilder::new(), left: x as f32, base: y as f32, scale };
    for c in text.chars() {
        let glyph = font.glyph_index(c).unwrap_or_default();
        font.outline_glyph(glyph, &mut letters);
        letters.left += advance(font, c) as f32 * scale;
    }
    letters.path.finish()
}

/// Writes a picture as PNG, with its resolution and how it was made.
///
/// # Errors
///
/// The picture cannot be written.
pub fn png(picture: &Picture, dpi: u32, pixmap: &Pixmap, out: impl Write) -> io::Result<()> {
    let mut encoder = png::Encoder::new(out, pixmap.width(), pixmap.height());
    let opaque = picture.background.is_some();
    encoder.set_color(if opaque { png::ColorType::Rgb } else { png::ColorType::Rgba });
    encoder.set_compression(png::Compression::High);
    let per_metre = (f64::from(dpi) / 0.0254).round() as u32;
    let unit = png::Unit::Meter;
    encoder.set_pixel_dims(Some(png::PixelDimensions { xppu: per_metre, yppu: per_metre, unit }));
    encoder.add_itxt_chunk("Title".to_owned(), picture.title.clone())?;
    encoder.add_itxt_chunk("Description".to_owned(), picture.description.clone())?;
    let mut data = Vec::with_capacity(pixmap.pixels().len() * 4);
    for pixel in pixmap.pixels() {
        let colour = pixel.demultiply();
        data.extend([colour.red(), colour.green(), colour.blue()]);
        if !opaque {
            data.push(colour.alpha());
        }
    }
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&data)?;
    writer.finish()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The letters of names and units are in the font.
    #[test]
    fn the_font_has_the_letters_that_titles_use() {
        let font = font();
        for c in ('!'..='~').chain("°µ×–…−äéñøß≤≥λπ→\u{fffd}".chars()) {
            let glyph = font.glyph_index(c).unwrap_or_else(|| panic!("{c} is not in the font"));
            assert_ne!(glyph.0, 0, "{c}");
        }
        assert!(text_width("MM", 7.0) > text_width("ii", 7.0));
        assert_eq!(text_width("", 7.0), 0.0);
        assert!(
            letters(&font, "a \u{1f600}", [0.0, 0.0], 7.0).is_some(),
            "unknown letters are drawn as a box"
        );
    }
}
