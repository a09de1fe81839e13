//! Lines between modules: contacts, messages and what modules wait for. They are drawn over the structure, from the
//! centre of one module to that of the other.

use super::camera::V;
use super::composition::{Composition, Subject};
use super::drawing::Frame;
use super::options::Links;
use super::palette::Rgb;
use super::picture::{At, Element, Picture, Stroke};
use super::snapshot::{Process, Snapshot};
use super::solid::Owner;
use metamorph_core::counters::Class;
use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::{Cell, Face};
use std::collections::{BTreeMap, BTreeSet};

/// Distance of messages from the line between the centres, to the right of their direction, in edges of a cell.
const ASIDE: f64 = 0.09;
/// Length of the head of an arrow, in edges of a cell.
const HEAD: f64 = 0.34;

/// Meaning of a line between modules.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LinkKind {
    /// Modules are side by side.
    Contact,
    /// Messages are sent.
    Messages {
        /// The class of most of them.
        class: Class,
        /// Their number in the time bin.
        count: u64,
    },
    /// The first module waits for the second one.
    Wait,
}

/// A line between the centres of two modules.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// Meaning of the line.
    pub kind: LinkKind,
    /// Where it begins.
    from: V,
    /// Where it ends.
    to: V,
}

/// Returns the pairs of modules with parts in adjacent cells.
fn contacts(snapshot: &Snapshot, drawn: &BTreeMap<ModuleId, V>) -> BTreeSet<[ModuleId; 2]> {
    let parts =
        drawn.keys().flat_map(|id| snapshot.bodies[id.index()].parts.iter().map(|part| (part.cell(), *id)));
    let cells: BTreeMap<Cell, ModuleId> = parts.collect();
    let pairs = cells.iter().flat_map(|(cell, id)| {
        let others = Face::ALL.into_iter().filter_map(|face| cells.get(&cell.step(face)));
        others.filter(move |other| *other > id).map(move |other| [*id, *other])
    });
    pairs.collect()
}

impl Subject<'_> {
    /// Returns the lines between drawn modules.
    pub fn links(&self, snapshot: &Snapshot, composition: &Composition) -> Vec<Link> {
        let wanted = |links: Links| self.style.links.contains(&links);
        if self.style.links.is_empty() && self.contacts.is_empty() {
            return Vec::new();
        }
        let drawn: BTreeMap<ModuleId, V> = composition
            .solids
            .iter()
            .filter_map(|solid| match solid.owner {
                Owner::Module(id) => Some((id, snapshot.bodies.get(id.index())?.middle())),
                Owner::Obstacle(_) | Owner::Element(..) | Owner::Goal(_) => None,
            })
            .collect();
        let link = |kind: LinkKind, from: ModuleId, to: ModuleId| {
            Some(Link { kind, from: *drawn.get(&from)?, to: *drawn.get(&to)? })
        };
        let mut links = Vec::new();
        links.extend(self.contacts.iter().filter_map(|(a, b)| link(LinkKind::Contact, *a, *b)));
        if wanted(Links::Contacts) && self.contacts.is_empty() {
            links.extend(
                contacts(snapshot, &drawn).into_iter().filter_map(|[a, b]| link(LinkKind::Contact, a, b)),
            );
        }
        if wanted(Links::Messages) {
            links.extend(snapshot.edges.iter().filter_map(|edge| {
                let counts = Class::ALL.into_iter().zip(edge.counts);
                // The first of the most frequent classes.
                let (class, _) = counts.rev().max_by_key(|(_, n)| *n).filter(|(_, n)| *n > 0)?;
                let count = edge.counts.iter().map(|n| u64::from(*n)).sum();
                link(LinkKind::Messages { class, count }, edge.from, edge.to)
            }));
        }
        if wanted(Links::Waits) {
            let alive = (0..).map(ModuleId).zip(&snapshot.bodies).filter(|(_, b)| b.process != Process::Dead);
            links.extend(alive.filter_map(|(id, body)| link(LinkKind::Wait, id, body.view?.waits_for?)));
        }
        links
    }

    /// Draws the lines. `seconds` is the length of a time bin.
    pub fn draw_links(&self, picture: &mut Picture, frame: &Frame, links: &[Link], seconds: f64) {
        if links.is_empty() {
            return;
        }
        picture.elements.push(Element::Begin("links".to_owned(), Vec::new()));
        let ends = |link: &Link| [link.from, link.to].map(|point| frame.at(self.view.project(point)));
        let contacts = links.iter().filter(|link| link.kind == LinkKind::Contact).map(ends).collect();
        self.lines(picture, contacts, (0.09 * frame.scale).clamp(0.4, 1.4), self.style.theme.ink());
        for link in links {
            let [from, to] = ends(link);
            let colour = self.link_colour(link.kind);
            match link.kind {
                LinkKind::Contact => {}
                LinkKind::Messages { count, .. } => {
                    let often = libm::log2(1.0 + count as f64 / seconds.max(1e-9));
                    let width = (0.05 + 0.09 * (often / 5.0).min(1.0)) * frame.scale;
                    let stroke = Some(Stroke::solid(colour, width.clamp(0.3, 2.5)));
                    let pieces = vec![(aside([from, to], ASIDE * frame.scale).into(), false)];
                    picture.elements.push(Element::Path { pieces, fill: None, opacity: 0.9, stroke });
                }
                LinkKind::Wait => self.arrow(picture, frame, [from, to], colour),
            }
        }
        picture.elements.push(Element::End);
    }

    /// Returns the colour of a line.
    pub fn link_colour(&self, kind: LinkKind) -> Rgb {
        match kind {
            LinkKind::Contact | LinkKind::Wait => self.style.theme.ink(),
            LinkKind::Messages { class, .. } => self.style.theme.class(class),
        }
    }

    /// Draws lines with one border around all of them, so that they are seen on all colours.
    fn lines(&self, picture: &mut Picture, lines: Vec<[At; 2]>, width: f64, colour: Rgb) {
        if lines.is_empty() {
            return;
        }
        let border = self.style.theme.background().unwrap_or(Rgb(0xff, 0xff, 0xff));
        for (colour, width) in [(border, width * 2.0), (colour, width)] {
            let pieces = lines.iter().map(|ends| (ends.to_vec(), false)).collect();
            let stroke = Some(Stroke::solid(colour, width));
            picture.elements.push(Element::Path { pieces, fill: None, opacity: 1.0, stroke });
        }
    }

    fn arrow(&self, picture: &mut Picture, frame: &Frame, [from, to]: [At; 2], colour: Rgb) {
        let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
        let length = dx.hypot(dy);
        let head = (HEAD * frame.scale).clamp(1.5, 6.0).min(0.6 * length);
        if head < 0.5 {
            // The camera looks along it.
            return;
        }
        let (x, y) = (dx / length, dy / length);
        let neck = [to[0] - x * head, to[1] - y * head];
        self.lines(picture, vec![[from, neck]], (0.08 * frame.scale).clamp(0.35, 1.2), colour);
        let side = 0.4 * head;
        let points =
            vec![to, [neck[0] - y * side, neck[1] + x * side], [neck[0] + y * side, neck[1] - x * side]];
        let border = self.style.theme.background().unwrap_or(Rgb(0xff, 0xff, 0xff));
        picture.path(points, Some(colour), Some(Stroke::solid(border, 0.25)));
    }
}

/// Returns a line moved to the right of its direction.
fn aside([from, to]: [At; 2], by: f64) -> [At; 2] {
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let length = dx.hypot(dy).max(1e-9);
    // The page's second axis points down.
    [from, to].map(|[x, y]| [x - dy / length * by, y + dx / length * by])
}
