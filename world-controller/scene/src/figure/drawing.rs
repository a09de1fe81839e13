//! Draws a composition on a page: title, structure, and what explains them below it.

use super::camera::P;
use super::composition::{Composition, Extent, Meaning, Subject};
use super::legend::{STRIP, furniture, furniture_height};
use super::options::{ColorBy, Labels, Width};
use super::palette::{Rgb, State};
use super::picture::{Anchor, At, Element, Picture, Stroke};
use super::snapshot::{Process, Snapshot};
use super::solid::{Facet, Owner, Solid};
use crate::parts::{Part, Tone};
use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::Cell;
use metamorph_text::format::seconds;
use std::collections::BTreeMap;

/// Width of the space around the picture, in points.
pub const MARGIN: f64 = 4.0;
/// Height of titles, in points.
const TITLE: f64 = 8.0;
/// Height of a structure at most, in widths of the figure.
const TALLEST: f64 = 1.25;

/// The text that comes with a picture.
#[derive(Clone, Debug)]
pub struct Provenance {
    /// The title of the run.
    pub title: String,
    /// How the picture was made.
    pub description: String,
}

/// Where the structure is on the page.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// Points in the edge of a cell.
    pub scale: f64,
    /// The place of the lowest coordinates: left and bottom.
    corner: At,
    low: P,
}

impl Frame {
    /// Returns the place of a projected point.
    pub fn at(&self, [x, y]: P) -> At {
        [self.corner[0] + (x - self.low[0]) * self.scale, self.corner[1] - (y - self.low[1]) * self.scale]
    }
}

impl Subject<'_> {
    /// Draws a picture. All pictures with the same extent have the same size and place.
    pub fn draw(
        &self,
        snapshot: &Snapshot,
        composition: &Composition,
        extent: &Extent,
        provenance: &Provenance,
    ) -> Picture {
        let style = self.style;
        let width = style.width.points(style.dpi);
        let title = style.title.as_ref().map(|t| t.replace("{t}", &seconds(snapshot.at.as_secs_f64())));
        let [low, high] = extent.plane.unwrap_or([[0.0; 2], [1.0; 2]]);
        let [across, up] = [0, 1].map(|i| (high[i] - low[i]).max(1.0));
        let inner = width - 2.0 * MARGIN;
        let scale = (inner / across).min(width * TALLEST / up);
        let top = MARGIN + if title.is_some() { TITLE * 1.6 } else { 0.0 };
        let bottom = top + up * scale;
        let left = MARGIN + (inner - (high[0] - low[0]) * scale) / 2.0;
        let frame = Frame { scale, corner: [left, bottom], low };
        let strip = furniture_height(self, extent, width);
        let mut picture = Picture {
            size: [width, bottom + strip + MARGIN],
            width: match style.width {
                Width::Millimetres(_) => style.width.to_string(),
                Width::Pixels(pixels) => pixels.to_string(),
            },
            background: style.theme.background(),
            title: title.clone().unwrap_or_else(|| provenance.title.clone()),
            description: provenance.description.clone(),
            elements: Vec::new(),
        };
        if let Some(title) = &title {
            picture.text([width / 2.0, MARGIN + TITLE], Anchor::Middle, TITLE, style.theme.ink(), title);
        }
        self.floor(&mut picture, &frame, extent);
        self.solids(&mut picture, &frame, snapshot, composition, extent.most.unwrap_or(0));
        self.goal(&mut picture, &frame, composition);
        self.draw_links(&mut picture, &frame, &self.links(snapshot, composition), snapshot.bin);
        furniture(self, &mut picture, &frame, extent, bottom + STRIP);
        picture
    }

    fn floor(&self, picture: &mut Picture, frame: &Frame, extent: &Extent) {
        let Some([low, high]) = self.floor_shown(extent) else { return };
        let at = |x: f64, y: f64| frame.at(self.view.project([x, y, 0.0]));
        let lines = |from: f64, to: f64| (0..=(to - from).round() as i32).map(move |i| from + f64::from(i));
        let across = lines(low[0], high[0]).map(|x| (vec![at(x, low[1]), at(x, high[1])], false));
        let along = lines(low[1], high[1]).map(|y| (vec![at(low[0], y), at(high[0], y)], false));
        let pieces = across.chain(along).collect();
        let stroke = Some(Stroke::solid(self.style.theme.faint(), 0.35));
        picture.elements.push(Element::Path { pieces, fill: None, opacity: 1.0, stroke });
    }

    fn goal(&self, picture: &mut Picture, frame: &Frame, composition: &Composition) {
        if composition.goal.is_empty() {
            return;
        }
        let course = |points: &Vec<P>| (points.iter().map(|p| frame.at(*p)).collect(), false);
        let pieces = composition.goal.iter().map(course).collect();
        let stroke = self.outline((0.09 * frame.scale).clamp(0.5, 0.9));
        picture.elements.push(Element::Begin("goal".to_owned(), Vec::new()));
        picture.elements.push(Element::Path { pieces, fill: None, opacity: 0.75, stroke: Some(stroke) });
        picture.elements.push(Element::End);
    }

    /// Returns the line around the goal.
    pub fn outline(&self, width: f64) -> Stroke {
        Stroke { colour: self.style.theme.ink(), width, dash: Some(3.0 * width) }
    }

    fn solids(
        &self,
        picture: &mut Picture,
        frame: &Frame,
        snapshot: &Snapshot,
        composition: &Composition,
        most: u64,
    ) {
        let levels = snapshot.levels();
        let mut drawn: BTreeMap<u32, u32> = BTreeMap::new();
        let labelled = self.labelled(composition);
        for i in &composition.order {
            let solid = &composition.solids[*i];
            let (id, attributes, fill, opacity, state) = match solid.owner {
                Owner::Module(id) => {
                    let meaning = self.meaning(snapshot, &levels, id.index());
                    let nth = drawn.entry(id.0).and_modify(|n| *n += 1).or_insert(1);
                    let name = if *nth == 1 { format!("m{id}") } else { format!("m{id}-{nth}") };
                    let state = match meaning {
                        Meaning::State(state) => Some(state),
                        _ => None,
                    };
                    let colour = toned(self.colour(meaning, most), solid.tone);
                    (name, self.attributes(snapshot, id.index()), colour, 1.0, state)
                }
                Owner::Obstacle(cell) => (
                    cell_name("obstacle", cell),
                    Vec::new(),
                    self.style.theme.state(State::Obstacle),
                    1.0,
                    None,
                ),
                Owner::Element(cell, hold) => {
                    (cell_name("element", cell), Vec::new(), self.style.theme.state(hold.into()), 1.0, None)
                }
                Owner::Goal(cell) => {
                    (cell_name("goal", cell), Vec::new(), self.style.theme.plain(), 0.35, None)
                }
            };
            picture.elements.push(Element::Begin(id, attributes));
            for facet in &solid.facets {
                self.facet(picture, frame, facet, fill, opacity);
            }
            // A number takes the place of a mark.
            if let Some(id) = labelled.get(i) {
                self.label(picture, frame, solid, *id, fill);
            } else if let Some(state) = state {
                self.mark(picture, frame, solid, state, fill);
            }
            picture.elements.push(Element::End);
        }
    }

    /// Returns the solids that numbers are written on: the nearest one of each module.
    fn labelled(&self, composition: &Composition) -> BTreeMap<usize, ModuleId> {
        let nearest: BTreeMap<u32, usize> = match self.style.labels {
            Labels::Off => BTreeMap::new(),
            Labels::Ids => {
                let owner = |i: &usize| match composition.solids[*i].owner {
                    Owner::Module(id) => Some((id.0, *i)),
                    Owner::Obstacle(_) | Owner::Element(..) | Owner::Goal(_) => None,
                };
                composition.order.iter().filter_map(owner).collect()
            }
        };
        nearest.into_iter().map(|(id, solid)| (solid, ModuleId(id))).collect()
    }

    fn attributes(&self, snapshot: &Snapshot, id: usize) -> Vec<(&'static str, String)> {
        let Some(body) = snapshot.bodies.get(id) else { return Vec::new() };
        let role = body.view.and_then(|view| self.words.roles.get(usize::from(view.role)));
        let mut attributes = Vec::new();
        if let Some(role) = role {
            attributes.push(("data-role", role.name.to_owned()));
        }
        match body.process {
            Process::Alive => {}
            Process::Paused => attributes.push(("data-process", "paused".to_owned())),
            Process::Dead => attributes.push(("data-process", "dead".to_owned())),
        }
        if let Some(Cell { x, y, z }) = body.parts.first().map(Part::cell) {
            attributes.push(("data-cell", format!("{x} {y} {z}")));
        }
        if self.style.color != ColorBy::State
            && let Meaning::Number(n) = self.meaning(snapshot, &snapshot.levels(), id)
        {
            attributes.push(("data-value", n.to_string()));
        }
        attributes
    }

    fn facet(&self, picture: &mut Picture, frame: &Frame, facet: &Facet, fill: Rgb, opacity: f64) {
        let points: Vec<At> = facet.points.iter().map(|p| frame.at(*p)).collect();
        let fill = fill.shaded(facet.shade);
        let line = Stroke::solid(edge(fill), (0.045 * frame.scale).clamp(0.12, 0.45));
        let pieces = vec![(points.clone(), true)];
        picture.elements.push(Element::Path { pieces, fill: Some(fill), opacity, stroke: Some(line) });
        if facet.cut
            && let [a, b, c, d] = points[..]
        {
            // Lines across the face, from two sides to the other two.
            let between = |from: At, to: At, t: f64| [0, 1].map(|i| from[i] + (to[i] - from[i]) * t);
            let thirds = [1.0 / 3.0, 2.0 / 3.0, 1.0];
            let first = thirds.iter().map(|t| (vec![between(a, b, *t), between(a, d, *t)], false));
            let second = thirds[..2].iter().map(|t| (vec![between(b, c, *t), between(d, c, *t)], false));
            let stroke = Some(Stroke::solid(edge(fill), line.width));
            let pieces = first.chain(second).collect();
            picture.elements.push(Element::Path { pieces, fill: None, opacity: 1.0, stroke });
        }
    }

    /// Draws the sign of a state, so that it does not depend on colours.
    fn mark(&self, picture: &mut Picture, frame: &Frame, solid: &Solid, state: State, fill: Rgb) {
        let facets = solid.facets.iter().filter(|facet| facet.points.len() == 4 || solid.dome.is_some());
        let Some(facet) = facets.max_by(|a, b| a.shade.total_cmp(&b.shade)) else { return };
        let points: Vec<At> = facet.points.iter().map(|p| frame.at(*p)).collect();
        let [u, v] = match points[..] {
            [a, b, c, _] => [[b[0] - a[0], b[1] - a[1]], [c[0] - b[0], c[1] - b[1]]],
            _ => [[frame.scale * 0.7, 0.0], [0.0, frame.scale * 0.7]],
        };
        let n = points.len() as f64;
        let middle = [0, 1].map(|i| points.iter().map(|p| p[i]).sum::<f64>() / n);
        sign(picture, state, middle, [u, v], (0.13 * frame.scale).clamp(0.35, 1.6), fill);
    }

    /// Writes the number of a module on its brightest face, under what is painted later.
    fn label(&self, picture: &mut Picture, frame: &Frame, solid: &Solid, id: ModuleId, fill: Rgb) {
        let Some(facet) = solid.facets.iter().max_by(|a, b| a.shade.total_cmp(&b.shade)) else { return };
        let size = (0.36 * frame.scale).clamp(1.5, 7.0);
        let n = facet.points.len() as f64;
        let [x, y] = frame.at([0, 1].map(|i| facet.points.iter().map(|p| p[i]).sum::<f64>() / n));
        let colour = on(fill.shaded(facet.shade));
        picture.text([x, y + 0.36 * size], Anchor::Middle, size, colour, &id.to_string());
    }
}

/// Draws the sign of a state on a parallelogram with this middle and these edges; most states have none.
pub fn sign(picture: &mut Picture, state: State, middle: At, [u, v]: [At; 2], width: f64, fill: Rgb) {
    let at = |x: f64, y: f64| [0, 1].map(|i| middle[i] + x * u[i] + y * v[i]);
    let lines = match state {
        State::Dead => vec![[at(-0.25, -0.25), at(0.25, 0.25)], [at(-0.25, 0.25), at(0.25, -0.25)]],
        State::Paused => vec![[at(-0.13, -0.25), at(-0.13, 0.25)], [at(0.13, -0.25), at(0.13, 0.25)]],
        State::Waiting => vec![[at(-0.22, 0.0), at(-0.2, 0.0)], [at(0.2, 0.0), at(0.22, 0.0)]],
        State::Fallen => vec![[at(-0.2, 0.2), at(0.2, 0.2)]],
        State::Done
        | State::Active
        | State::Idle
        | State::Obstacle
        | State::Resting
        | State::Held
        | State::Shared => return,
    };
    let stroke = Some(Stroke::solid(on(fill), width));
    let pieces = lines.into_iter().map(|line| (line.into(), false)).collect();
    picture.elements.push(Element::Path { pieces, fill: None, opacity: 1.0, stroke });
}

/// Returns a colour that is seen on another one.
fn on(fill: Rgb) -> Rgb {
    if fill.luminance() < 110.0 { Rgb(0xff, 0xff, 0xff) } else { Rgb(0x11, 0x11, 0x11) }
}

/// Returns the colour of the edges of a face.
fn edge(fill: Rgb) -> Rgb {
    if fill.luminance() < 60.0 { fill.mixed(Rgb(0xff, 0xff, 0xff), 0.35) } else { fill.shaded(0.55) }
}

fn toned(colour: Rgb, tone: Tone) -> Rgb {
    match tone {
        Tone::Plain => colour,
        Tone::Light => colour.mixed(Rgb(0xff, 0xff, 0xff), 0.3),
    }
}

fn cell_name(what: &str, Cell { x, y, z }: Cell) -> String {
    format!("{what}-{x}-{y}-{z}")
}
