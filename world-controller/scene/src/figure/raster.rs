//! A picture as pixels, and as PNG.

use super::letters::{Piece, UNITS_PER_EM, letter};
use super::palette::Rgb;
use super::picture::{Anchor, At, Element, Picture, Stroke};
use std::io::{self, Write};
use tiny_skia::{FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, StrokeDash, Transform};

/// Number of pixels of a picture at most.
pub const MOST_PIXELS: u64 = 100_000_000;

/// Returns the width of a text of this size.
pub fn text_width(text: &str, size: f64) -> f64 {
    let units: u32 = text.chars().map(|c| u32::from(letter(c).advance)).sum();
    f64::from(units) * size / f64::from(UNITS_PER_EM)
}

/// Returns the left end of the base line of a text.
pub fn text_start(text: &str, at: At, anchor: Anchor, size: f64) -> At {
    let left = match anchor {
        Anchor::Start => 0.0,
        Anchor::Middle => text_width(text, size) / 2.0,
        Anchor::End => text_width(text, size),
    };
    [at[0] - left, at[1]]
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
                if let Some(path) = letters(text, text_start(text, *at, *anchor, *size), *size) {
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

/// Returns the path of some pieces; `None` if there is nothing to draw.
pub fn path(pieces: &[(Vec<At>, bool)]) -> Option<Path> {
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

/// Returns the outlines of a text from a point on its base line to the right.
pub fn letters(text: &str, [x, y]: At, size: f64) -> Option<Path> {
    let scale = size as f32 / f32::from(UNITS_PER_EM);
    let (mut left, base) = (x as f32, y as f32);
    let mut path = PathBuilder::new();
    for c in text.chars() {
        let letter = letter(c);
        let on_page = |[x, y]: [f32; 2]| (left + x * scale, base - y * scale);
        for piece in &letter.outline {
            match *piece {
                Piece::Begin(point) => {
                    path.close();
                    let (x, y) = on_page(point);
                    path.move_to(x, y);
                }
                Piece::Line(point) => {
                    let (x, y) = on_page(point);
                    path.line_to(x, y);
                }
                Piece::Curve(control, end) => {
                    let ((x1, y1), (x, y)) = (on_page(control), on_page(end));
                    path.quad_to(x1, y1, x, y);
                }
            }
        }
        left += f32::from(letter.advance) * scale;
    }
    path.close();
    path.finish()
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

    #[test]
    fn texts_have_a_width_and_an_outline() {
        assert!(text_width("MM", 7.0) > text_width("ii", 7.0));
        assert_eq!(text_width("", 7.0), 0.0);
        let bounds = letters("Ho", [3.0, 9.0], 7.0).unwrap().bounds();
        assert!(bounds.left() > 3.0 && bounds.right() < 3.0 + text_width("Ho", 7.0) as f32);
        assert!(bounds.top() > 2.0 && bounds.bottom() > 9.0, "o reaches below the base line");
        assert!(letters(" ", [0.0, 0.0], 7.0).is_none());
    }
}
