//! Moving pictures: GIF and APNG with one palette, in which a frame holds only what has changed.

use super::picture::Picture;
use super::raster::pixels;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, Write};
use tiny_skia::Pixmap;

/// Number of colours of the palette; one more number stands for what has not changed.
const COLOURS: usize = 255;
/// The number of the colour that is transparent.
const SAME: u8 = 255;

/// The format of a moving picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Graphics Interchange Format.
    Gif,
    /// Animated Portable Network Graphics.
    Apng,
}

type Colour = [u8; 3];

/// Returns the colour of every pixel, which is opaque.
fn colours(pixmap: &Pixmap) -> impl Iterator<Item = Colour> {
    pixmap.pixels().iter().map(|p| [p.red(), p.green(), p.blue()])
}

/// Counts colours, to choose the palette from.
#[derive(Debug, Default)]
pub struct Census {
    counts: BTreeMap<Colour, u64>,
}

impl Census {
    /// Counts the colours of a frame.
    pub fn add(&mut self, pixmap: &Pixmap) {
        let mut run: Option<(Colour, u64)> = None;
        for colour in colours(pixmap) {
            match &mut run {
                Some((same, n)) if *same == colour => *n += 1,
                _ => {
                    if let Some((colour, n)) = run.replace((colour, 1)) {
                        *self.counts.entry(colour).or_default() += n;
                    }
                }
            }
        }
        if let Some((colour, n)) = run {
            *self.counts.entry(colour).or_default() += n;
        }
    }

    /// Chooses the palette: pictures are flat, so the most frequent colour of each small cube of colours stands
    /// for it, and the most frequent cubes are chosen.
    pub fn palette(&self) -> Palette {
        let mut cubes: BTreeMap<Colour, (u64, Colour, u64)> = BTreeMap::new();
        for (colour, n) in &self.counts {
            let cube = cubes.entry(colour.map(|x| x >> 4)).or_insert((0, *colour, 0));
            cube.0 += n;
            if *n > cube.2 {
                (cube.1, cube.2) = (*colour, *n);
            }
        }
        let mut chosen: Vec<(u64, Colour)> = cubes.into_values().map(|(n, colour, _)| (n, colour)).collect();
        chosen.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
        chosen.truncate(COLOURS);
        Palette { colours: chosen.into_iter().map(|(_, colour)| colour).collect(), known: BTreeMap::new() }
    }
}

/// The colours of all frames.
#[derive(Debug)]
pub struct Palette {
    colours: Vec<Colour>,
    known: BTreeMap<Colour, u8>,
}

impl Palette {
    /// Returns the number of the nearest colour.
    fn number(&mut self, colour: Colour) -> u8 {
        if let Some(number) = self.known.get(&colour) {
            return *number;
        }
        let away = |other: &Colour| -> i32 {
            let squares = colour.iter().zip(other).map(|(a, b)| i32::from(*a) - i32::from(*b)).map(|d| d * d);
            squares.sum()
        };
        let nearest = self.colours.iter().enumerate().min_by_key(|(_, other)| away(other));
        let number = nearest.map_or(0, |(i, _)| i as u8);
        self.known.insert(colour, number);
        number
    }
    fn frame(&mut self, pixmap: &Pixmap) -> Vec<u8> {
        colours(pixmap).map(|colour| self.number(colour)).collect()
    }
    fn bytes(&self) -> Vec<u8> {
        let mut bytes = self.colours.concat();
        bytes.resize(256 * 3, 0);
        bytes
    }
}

/// The part of a frame that has changed.
struct Changed {
    left: u16,
    top: u16,
    width: u16,
    height: u16,
    /// Numbers of colours, line by line; [`SAME`] where nothing has changed.
    data: Vec<u8>,
}

/// Returns what has changed; of a frame like the one before, one pixel.
fn changed(before: Option<&[u8]>, frame: &[u8], size: [u32; 2]) -> Changed {
    let [width, height] = size.map(|x| x as usize);
    let Some(before) = before else {
        return Changed { left: 0, top: 0, width: width as u16, height: height as u16, data: frame.to_vec() };
    };
    let differs = |x: usize, y: usize| before[y * width + x] != frame[y * width + x];
    let rows = |y: &usize| (0..width).any(|x| differs(x, *y));
    let (top, bottom) = ((0..height).find(rows).unwrap_or(0), (0..height).rev().find(rows).unwrap_or(0));
    let columns = |x: &usize| (top..=bottom).any(|y| differs(*x, y));
    let (left, right) = ((0..width).find(columns).unwrap_or(0), (0..width).rev().find(columns).unwrap_or(0));
    let mut data = Vec::with_capacity((right - left + 1) * (bottom - top + 1));
    for y in top..=bottom {
        data.extend((left..=right).map(|x| if differs(x, y) { frame[y * width + x] } else { SAME }));
    }
    let [left, top, width, height] = [left, top, right - left + 1, bottom - top + 1].map(|x| x as u16);
    Changed { left, top, width, height, data }
}

/// Writes a moving picture that repeats endlessly. `draw` is called with the number of each frame, first
/// for their colours and then to write them.
///
/// # Errors
///
/// A frame cannot be drawn or written.
pub fn write<E: From<io::Error>>(
    format: Format,
    first: &Picture,
    dpi: u32,
    frames: u32,
    fps: u32,
    mut draw: impl FnMut(u32) -> Result<Pixmap, E>,
    out: impl Write,
) -> Result<(), E> {
    let mut census = Census::default();
    for frame in 0..frames {
        census.add(&draw(frame)?);
    }
    let mut palette = census.palette();
    let size = pixels(first, dpi);
    let mut writer = match format {
        Format::Gif => Writer::Gif(gif(out, size, &palette, first)?),
        Format::Apng => Writer::Apng(apng(out, size, &palette, first, frames, fps)?),
    };
    let mut before: Option<Vec<u8>> = None;
    for frame in 0..frames {
        let numbers = palette.frame(&draw(frame)?);
        writer.frame(changed(before.as_deref(), &numbers, size), fps)?;
        before = Some(numbers);
    }
    writer.finish()?;
    Ok(())
}

enum Writer<W: Write> {
    Gif(gif::Encoder<W>),
    Apng(png::Writer<W>),
}

fn gif<W: Write>(out: W, size: [u32; 2], palette: &Palette, first: &Picture) -> io::Result<gif::Encoder<W>> {
    let [width, height] = size.map(|x| x as u16);
    let mut encoder = gif::Encoder::new(out, width, height, &palette.bytes()).map_err(io::Error::other)?;
    encoder.set_repeat(gif::Repeat::Infinite).map_err(io::Error::other)?;
    // A comment consists of blocks of at most 255 bytes.
    let blocks: Vec<&[u8]> = first.description.as_bytes().chunks(255).collect();
    encoder.write_raw_extension(gif::AnyExtension(0xfe), &blocks).map_err(io::Error::other)?;
    Ok(encoder)
}

fn apng<W: Write>(
    out: W,
    [width, height]: [u32; 2],
    palette: &Palette,
    first: &Picture,
    frames: u32,
    fps: u32,
) -> io::Result<png::Writer<W>> {
    let mut encoder = png::Encoder::new(out, width, height);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_palette(palette.bytes());
    let mut opacity = vec![255; 256];
    opacity[usize::from(SAME)] = 0;
    encoder.set_trns(opacity);
    encoder.set_compression(png::Compression::High);
    encoder.set_animated(frames, 0)?;
    encoder.set_frame_delay(1, fps as u16)?;
    encoder.set_blend_op(png::BlendOp::Over)?;
    encoder.add_itxt_chunk("Title".to_owned(), first.title.clone())?;
    encoder.add_itxt_chunk("Description".to_owned(), first.description.clone())?;
    Ok(encoder.write_header()?)
}

impl<W: Write> Writer<W> {
    fn frame(&mut self, changed: Changed, fps: u32) -> io::Result<()> {
        let Changed { left, top, width, height, data } = changed;
        match self {
            Writer::Gif(encoder) => {
                let frame = gif::Frame {
                    left,
                    top,
                    width,
                    height,
                    delay: (100.0 / f64::from(fps)).round() as u16,
                    dispose: gif::DisposalMethod::Keep,
                    transparent: Some(SAME),
                    buffer: Cow::Owned(data),
                    ..gif::Frame::default()
                };
                encoder.write_frame(&frame).map_err(io::Error::other)
            }
            Writer::Apng(writer) => {
                writer.reset_frame_position()?;
                writer.set_frame_dimension(width.into(), height.into())?;
                writer.set_frame_position(left.into(), top.into())?;
                Ok(writer.write_image_data(&data)?)
            }
        }
    }

    fn finish(self) -> io::Result<()> {
        match self {
            Writer::Gif(encoder) => encoder.into_inner().map_err(io::Error::other)?.flush(),
            Writer::Apng(writer) => Ok(writer.finish()?),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_hold_what_has_changed() {
        let before = [0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0];
        let mut frame = before;
        (frame[5], frame[6]) = (2, 3);
        let Changed { left, top, width, height, data } = changed(Some(&before), &frame, [4, 3]);
        assert_eq!(((left, top), (width, height), data), ((1, 1), (2, 1), vec![2, 3]));
        frame[0] = 7;
        let Changed { width, height, data, .. } = changed(Some(&before), &frame, [4, 3]);
        assert_eq!(((width, height), data), ((3, 2), vec![7, SAME, SAME, SAME, 2, 3]));
        assert_eq!(changed(Some(&before), &before, [4, 3]).data, [SAME], "nothing has changed");
        assert_eq!(changed(None, &before, [4, 3]).data, before);
    }

    #[test]
    fn palettes_have_the_most_frequent_colours() {
        let mut pixmap = Pixmap::new(40, 40).unwrap();
        pixmap.fill(tiny_skia::Color::from_rgba8(0, 0x72, 0xb2, 255));
        let mut census = Census::default();
        census.add(&pixmap);
        let mut palette = census.palette();
        assert_eq!((palette.colours.clone(), palette.number([0, 0x70, 0xb0])), (vec![[0, 0x72, 0xb2]], 0));
        // Never the number that stands for no change, however many colours there are.
        for i in 0..4096u32 {
            let colour = [i >> 8, i >> 4 & 15, i & 15].map(|x| (x * 17) as u8);
            census.counts.insert(colour, 1);
        }
        let mut palette = census.palette();
        assert_eq!(palette.colours.len(), COLOURS);
        assert!((0..=255).all(|x| palette.number([x, 255 - x, x / 2]) != SAME));
    }
}
