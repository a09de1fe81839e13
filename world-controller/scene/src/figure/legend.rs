//! The legend, in a strip below the picture: the directions x, y and z, a scale bar, and the colours.

use super::camera::P;
use super::composition::{Extent, Subject};
use super::drawing::{Frame, MARGIN, sign};
use super::links::LinkKind;
use super::options::ColorBy;
use super::palette::{Rgb, State};
use super::picture::{Anchor, At, Element, Picture, Stroke};
use super::raster::text_width;
use crate::visible::Colour;
use metamorph_text::format::count;

/// Height of the space between the structure and the strip, in points.
pub const STRIP: f64 = 4.0;
/// Height of letters, in points.
const TEXT: f64 = 6.5;
/// Height of a line of the legend, in points.
const LINE: f64 = 10.0;
/// Length of the edge of a patch of colour, in points.
const PATCH: f64 = 6.5;
/// Length of a line in the legend, in points.
const LINE_LONG: f64 = 13.0;
/// Length of the axes, in points.
const AXIS: f64 = 13.0;
/// Width of the part of the strip with the axes, in points.
const AXES: f64 = 44.0;
/// Height of the part of the strip with the axes, in points.
const AXES_HIGH: f64 = 28.0;
/// Height of the scale bar with its text, in points.
const BAR_HIGH: f64 = 13.0;
/// Length of the scale of colours, in points.
const COLOURS: f64 = 90.0;
/// Largest number of members of a set that are explained.
const MEMBERS_MAX: usize = 12;

/// An entry of the legend.
enum Entry {
    /// A patch of colour with the sign of a state, and what it says.
    Patch(Rgb, Option<State>, String),
    /// A line, and what it says.
    Line(Stroke, String),
    /// A scale of colours from 0 to a number, and what it says.
    Scale(u64, String),
}

impl Entry {
    fn width(&self) -> f64 {
        match self {
            Entry::Patch(.., text) => PATCH + 3.0 + text_width(text, TEXT) + 9.0,
            Entry::Line(_, text) => LINE_LONG + 3.0 + text_width(text, TEXT) + 9.0,
            Entry::Scale(most, text) => {
                COLOURS + text_width(&count(*most), TEXT) + text_width(&format!("{text} 0"), TEXT) + 15.0
            }
        }
    }
}

fn entries(subject: &Subject<'_>, extent: &Extent) -> Vec<Entry> {
    if !subject.style.legend {
        return Vec::new();
    }
    let theme = subject.style.theme;
    let mut entries = Vec::new();
    let number = |text: &str| extent.most.map(|most| Entry::Scale(most, text.to_owned()));
    match subject.style.color {
        ColorBy::State => {}
        ColorBy::Level => entries.extend(number("level")),
        ColorBy::Gradient => {
            entries.extend(number(&format!("{} to a {}", subject.words.distance[1], subject.words.target)));
        }
        ColorBy::Messages => entries.extend(number("messages (logarithmic)")),
        ColorBy::Seed | ColorBy::Module | ColorBy::Locks => {
            let what = if subject.style.color == ColorBy::Seed { subject.words.target } else { "module" };
            let members = extent.members.iter().take(MEMBERS_MAX);
            entries.extend(members.map(|m| Entry::Patch(theme.distinct(*m), None, format!("{what} {m}"))));
            if extent.members.len() > MEMBERS_MAX {
                entries.push(Entry::Patch(theme.plain(), None, "…".to_owned()));
            }
        }
        ColorBy::None => {}
    }
    if extent.without && subject.style.color != ColorBy::None {
        entries.push(Entry::Patch(theme.plain(), None, "none".to_owned()));
    }
    entries.extend(extent.states.iter().map(|state| {
        let role = |colour| {
            let role = subject.words.roles.iter().find(|role| role.colour == colour);
            role.map_or("", |role| role.legend)
        };
        let text = match state {
            State::Done => role(Colour::Done),
            State::Active => role(Colour::Active),
            State::Idle => role(Colour::Idle),
            State::Waiting => "waiting",
            State::Paused => "paused",
            State::Dead => "dead",
            State::Obstacle => "obstacle",
            State::Resting => "element",
            State::Held => "element, held",
            State::Shared => "element, held by several",
            State::Fallen => "element, fallen",
        };
        Entry::Patch(theme.state(*state), Some(*state), text.to_owned())
    }));
    entries.extend(extent.goal.iter().map(|goal| Entry::Line(subject.outline(0.7), goal.clone())));
    entries.extend(extent.classes.iter().map(|class| {
        let colour = subject.link_colour(LinkKind::Messages { class: *class, count: 0 });
        Entry::Line(Stroke::solid(colour, 1.4), class.name().to_owned())
    }));
    let waits = || Stroke::solid(subject.link_colour(LinkKind::Wait), 0.9);
    entries.extend(extent.waits.then(|| Entry::Line(waits(), "waits for".to_owned())));
    entries
}

/// The place of each entry: from the left, and the number of its line.
fn lines(entries: &[Entry], left: f64, width: f64) -> Vec<(f64, usize)> {
    let (mut x, mut line) = (left, 0);
    let place = |entry: &Entry| {
        if x > left && x + entry.width() > width - MARGIN + 9.0 {
            (x, line) = (left, line + 1);
        }
        let place = (x, line);
        x += entry.width();
        place
    };
    entries.iter().map(place).collect()
}

fn left(subject: &Subject<'_>) -> f64 {
    if subject.style.axes { AXES } else { MARGIN }
}

/// Returns the height of the strip.
pub fn furniture_height(subject: &Subject<'_>, extent: &Extent, width: f64) -> f64 {
    let entries = entries(subject, extent);
    let legend =
        lines(&entries, left(subject), width).last().map_or(0.0, |(_, line)| (*line + 1) as f64 * LINE);
    let bar = if subject.style.scale { BAR_HIGH } else { 0.0 };
    let axes = if subject.style.axes { AXES_HIGH } else { 0.0 };
    let high = (legend + bar).max(axes);
    if high > 0.0 { high + STRIP } else { 0.0 }
}

/// Draws the strip, whose upper edge is at `top`.
pub fn furniture(subject: &Subject<'_>, picture: &mut Picture, frame: &Frame, extent: &Extent, top: f64) {
    let width = picture.size[0];
    if subject.style.axes {
        axes(subject, picture, top);
    }
    if subject.style.scale {
        bar(subject, picture, frame.scale, [width - MARGIN, top]);
    }
    let entries = entries(subject, extent);
    let top = top + if subject.style.scale { BAR_HIGH } else { 0.0 };
    for (entry, (x, line)) in entries.iter().zip(lines(&entries, left(subject), width)) {
        let y = top + line as f64 * LINE;
        match entry {
            Entry::Patch(colour, state, text) => patch(subject, picture, [x, y], (*colour, *state), text),
            Entry::Line(stroke, text) => stroke_sample(subject, picture, [x, y], *stroke, text),
            Entry::Scale(most, text) => colours(subject, picture, [x, y], *most, text),
        }
    }
}

fn rectangle([x, y]: At, width: f64, height: f64) -> Vec<At> {
    vec![[x, y], [x + width, y], [x + width, y + height], [x, y + height]]
}

fn stroke_sample(subject: &Subject<'_>, picture: &mut Picture, [x, y]: At, stroke: Stroke, text: &str) {
    let middle = y + PATCH / 2.0;
    picture.path(vec![[x, middle], [x + LINE_LONG, middle]], None, Some(stroke));
    let at = [x + LINE_LONG + 3.0, y + TEXT * 0.88];
    picture.text(at, Anchor::Start, TEXT, subject.style.theme.ink(), text);
}

fn patch(
    subject: &Subject<'_>,
    picture: &mut Picture,
    [x, y]: At,
    (colour, state): (Rgb, Option<State>),
    text: &str,
) {
    let ink = subject.style.theme.ink();
    picture.path(rectangle([x, y], PATCH, PATCH), Some(colour), Some(Stroke::solid(ink, 0.3)));
    if let Some(state) = state {
        let middle = [x + PATCH / 2.0, y + PATCH / 2.0];
        sign(picture, state, middle, [[PATCH, 0.0], [0.0, PATCH]], 0.13 * PATCH, colour);
    }
    picture.text([x + PATCH + 3.0, y + TEXT * 0.88], Anchor::Start, TEXT, ink, text);
}

fn colours(subject: &Subject<'_>, picture: &mut Picture, [x, y]: At, most: u64, text: &str) {
    let ink = subject.style.theme.ink();
    let steps = 30;
    let each = COLOURS / f64::from(steps);
    let begin = format!("{text} 0");
    let first = text_width(&begin, TEXT) + 3.0;
    let low = y + TEXT * 0.88;
    picture.text([x, low], Anchor::Start, TEXT, ink, &begin);
    for i in 0..steps {
        let share = (f64::from(i) + 0.5) / f64::from(steps);
        let colour = subject.style.theme.scale(subject.scale(), share);
        // A little too wide, so that no background is seen between two steps.
        let wide = if i + 1 == steps { each } else { each + 0.2 };
        picture.path(rectangle([x + first + f64::from(i) * each, y], wide, PATCH), Some(colour), None);
    }
    let stroke = Some(Stroke::solid(ink, 0.3));
    let mut frame = rectangle([x + first, y], COLOURS, PATCH);
    frame.push([x + first, y]);
    picture.path(frame, None, stroke);
    picture.text([x + first + COLOURS + 3.0, low], Anchor::Start, TEXT, ink, &count(most));
}

/// Draws the directions, each as long as a length in it looks.
fn axes(subject: &Subject<'_>, picture: &mut Picture, top: f64) {
    let ink = subject.style.theme.ink();
    let ends: Vec<(P, &str)> = [("x", [1.0, 0.0, 0.0]), ("y", [0.0, 1.0, 0.0]), ("z", [0.0, 0.0, 1.0])]
        .into_iter()
        .map(|(name, axis)| (subject.view.project(axis), name))
        .filter(|([x, y], _)| x.hypot(*y) > 0.12)
        .collect();
    let low = |i: usize| ends.iter().map(|(p, _)| p[i]).fold(0.0, f64::min);
    let label = 5.0;
    let origin = [MARGIN + label - low(0) * AXIS, top + AXES_HIGH - label + low(1) * AXIS];
    picture.elements.push(Element::Begin("axes".to_owned(), Vec::new()));
    for ([x, y], name) in ends {
        let end = [origin[0] + x * AXIS, origin[1] - y * AXIS];
        picture.path(vec![origin, end], None, Some(Stroke::solid(ink, 0.7)));
        let long = x.hypot(y);
        let at = [end[0] + x / long * label, end[1] - y / long * label + TEXT * 0.3];
        picture.text(at, Anchor::Middle, TEXT, ink, name);
    }
    picture.elements.push(Element::End);
}

/// Draws the scale bar, with its upper right corner at a place: a round number of cells.
fn bar(subject: &Subject<'_>, picture: &mut Picture, scale: f64, [right, top]: At) {
    let ink = subject.style.theme.ink();
    let cells = [1u32, 2, 5, 10, 20, 50, 100, 200, 500];
    let cells = cells.into_iter().rev().find(|n| f64::from(*n) * scale <= 70.0).unwrap_or(1);
    let length = f64::from(cells) * scale;
    let text = if cells == 1 { "1 cell".to_owned() } else { format!("{cells} cells") };
    let room = text_width(&text, TEXT) + 4.0;
    let y = top + 4.0;
    let left = right - room - length;
    let pieces = vec![
        (vec![[left, y - 2.0], [left, y + 2.0]], false),
        (vec![[left, y], [left + length, y]], false),
        (vec![[left + length, y - 2.0], [left + length, y + 2.0]], false),
    ];
    let stroke = Some(Stroke::solid(ink, 0.7));
    picture.elements.push(Element::Begin("scale".to_owned(), Vec::new()));
    picture.elements.push(Element::Path { pieces, fill: None, opacity: 1.0, stroke });
    picture.text([right, y + TEXT * 0.36], Anchor::End, TEXT, ink, &text);
    picture.elements.push(Element::End);
}
