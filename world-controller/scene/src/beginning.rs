//! The beginning of a scene: what is known of a run before it begins.
//!
//! The layout is private to the page. [`VERSION`] is raised when it changes; the page does not compare it.

use super::bodies::ShownSwarm;
use super::command_forms::CommandForm;
use super::parts::{Part, Shape};
use super::visible::{Floor, Stage, Targets, Words};
use metamorph_core::counters::Class;
use metamorph_core::ids::{HostId, ModuleId};
use metamorph_core::lattice::Cell;
use metamorph_core::link::{Hosts, LinkModel, Partition};
use metamorph_core::time::Time;
use metamorph_scenario::{LinkChange, Plan};
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::HashSet;
use std::sync::Arc;

/// Version of the layout; raised on every change.
pub const VERSION: u32 = 7;

/// Description of a run as a whole.
#[derive(Clone, Debug)]
pub struct Heading {
    /// The title.
    pub title: String,
    /// The description, if any.
    pub description: Option<String>,
    /// The seed; `None` if nothing is drawn.
    pub seed: Option<u64>,
    /// The name of the link; [`PLANNED`] if nothing runs.
    pub link: &'static str,
    /// The command that repeats it.
    pub repeat: String,
    /// The names of the goals, and of each the number of cells of its shape that its growth leaves out.
    pub goals: Vec<(String, usize)>,
    /// The partitions.
    pub partitions: Vec<Partition>,
    /// Beginnings and ends of partitions, by time.
    pub changes: Vec<LinkChange>,
    /// The hosts, if there are several.
    pub hosts: Option<Arc<Hosts>>,
    /// Commands that the run accepts.
    pub commands: Vec<CommandForm>,
}

/// In place of the name of a link: a plan that is shown without a run.
pub const PLANNED: &str = "plan";

impl Heading {
    /// Returns the heading of a run of this plan, which cannot be commanded.
    pub fn of(plan: &Plan) -> Heading {
        Heading {
            title: plan.title(),
            description: plan.description.as_ref().map(|d| d.trim().to_owned()),
            seed: Some(plan.seed),
            link: plan.overrides.link.name(),
            repeat: plan.repeat_with(),
            goals: (0..).zip(&plan.stages).map(|(i, s)| (s.name.clone(), plan.swarm.omitted(i))).collect(),
            partitions: plan.link.partitions.clone(),
            changes: plan.link_changes(),
            hosts: plan.link.hosts.clone().filter(|hosts| hosts.len() > 1),
            commands: Vec::new(),
        }
    }
}

/// The beginning of a run.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Beginning {
    version: u32,
    title: String,
    description: Option<String>,
    words: &'static Words,
    seed: Option<u64>,
    link: &'static str,
    repeat: String,
    classes: Vec<&'static str>,
    pub(super) time_step: u64,
    /// The shapes of all parts.
    shapes: Vec<Shape>,
    /// Of each body a description of its place, and its parts.
    pub(super) start: Vec<Value>,
    /// The cell of the first part of each body.
    #[serde(skip)]
    pub(super) cells: Vec<Option<Cell>>,
    /// The goals in order.
    pub(super) goals: Vec<Goal>,
    #[serde(skip)]
    pub(super) targets: Targets,
    floor: Option<Floor>,
    /// Contacts that are drawn as lines.
    contacts: Vec<(ModuleId, ModuleId)>,
    /// Partitions: the modules cut off from the others, and the beginning and end.
    partitions: Vec<(Vec<u32>, u64, u64)>,
    /// The hosts; `None` if there is one only.
    hosts: Option<ShownHosts>,
    /// True if messages between modules are recorded.
    messages: bool,
    /// How long a module that asks the operator waits for an answer; `None` if none asks.
    answer_within: Option<u64>,
    commands: Vec<CommandForm>,
}

/// The hosts of a run.
#[derive(Clone, Debug, Serialize)]
struct ShownHosts {
    /// Their names, in the order of their numbers.
    names: Vec<String>,
    /// The number of the home of each module.
    homes: Vec<u16>,
    /// When the link of two hosts is cut.
    cuts: Vec<(u16, u16, u64, u64)>,
}

impl ShownHosts {
    fn of(hosts: &Hosts, modules: usize) -> ShownHosts {
        // Invariant: there are fewer than 2^16 hosts.
        let names = (0..hosts.len() as u16).map(|host| HostId(host).to_string()).collect();
        let homes = (0..modules as u32).filter_map(|id| Some(hosts.home_of(ModuleId(id))?.0)).collect();
        let cut = |((a, b), link): ((HostId, HostId), &LinkModel)| {
            let cuts = link.partitions.iter().map(move |p| (a.0, b.0, micros(p.from), micros(p.until)));
            cuts.collect::<Vec<_>>()
        };
        ShownHosts { names, homes, cuts: hosts.links().flat_map(cut).collect() }
    }
}

#[derive(Clone, Debug, Serialize)]
pub(super) struct Goal {
    name: String,
    /// The cells with their levels.
    pub(super) cells: Vec<(i16, i16, i16, u16)>,
    /// The number of cells that its shape has besides.
    pub(super) omitted: usize,
    #[serde(skip)]
    pub(super) set: HashSet<Cell>,
}

impl Goal {
    fn new((name, omitted): (String, usize), cells: Vec<(i16, i16, i16, u16)>) -> Goal {
        let set = cells.iter().map(|(x, y, z, _)| Cell::new(*x, *y, *z)).collect();
        Goal { name, cells, omitted, set }
    }
}

/// Returns a time in the unit of the page.
pub(super) fn micros(t: Time) -> u64 {
    t.0 / 1_000
}

impl Beginning {
    /// Returns the beginning of a run. `messages` is true if messages will be recorded.
    pub(super) fn of(heading: &Heading, swarm: &dyn ShownSwarm, messages: bool) -> Beginning {
        let Stage { time_step, goals, targets, floor, contacts } = swarm.stage();
        let bodies = swarm.start();
        let mut shapes = Vec::new();
        let start = bodies.iter().map(|(parts, whereabouts)| started(parts, whereabouts, &mut shapes));
        let names = heading.goals.iter().cloned();
        let cut = |p: &Partition| (p.side.iter().map(|id| id.0).collect(), micros(p.from), micros(p.until));
        Beginning {
            version: VERSION,
            title: heading.title.clone(),
            description: heading.description.clone(),
            words: swarm.words(),
            seed: heading.seed,
            link: heading.link,
            repeat: heading.repeat.clone(),
            classes: Class::ALL.into_iter().map(Class::name).collect(),
            time_step: time_step.0 / 1_000,
            start: start.collect(),
            shapes,
            cells: bodies.iter().map(|(parts, _)| parts.first().map(Part::cell)).collect(),
            goals: names.zip(goals).map(|(goal, cells)| Goal::new(goal, cells)).collect(),
            targets,
            floor,
            contacts,
            partitions: heading.partitions.iter().map(cut).collect(),
            hosts: heading.hosts.as_deref().map(|hosts| ShownHosts::of(hosts, bodies.len())),
            messages,
            answer_within: swarm.answer_within().map(|span| span.0 / 1_000),
            commands: heading.commands.clone(),
        }
    }
}

/// Returns a body at the start as a JSON array: a description of its place, and for each part an array of the
/// number of its shape, its tone, its centre, and its rotation unless that is the identity. New shapes are added
/// to `shapes`.
fn started(parts: &[Part], whereabouts: &str, shapes: &mut Vec<Shape>) -> Value {
    let mut told = vec![json!(whereabouts)];
    for part in parts {
        let shape = shapes.iter().position(|known| *known == part.shape).unwrap_or_else(|| {
            shapes.push(part.shape);
            shapes.len() - 1
        });
        let [x, y, z] = part.centre().into();
        let turned: &[f64] = match part.pose.rotation.coords.as_slice() {
            [0.0, 0.0, 0.0, _] => &[],
            turned => turned,
        };
        let mut numbers = vec![json!(shape), json!(part.tone as u8), json!(x), json!(y), json!(z)];
        numbers.extend(turned.iter().map(|q| json!(q)));
        told.push(numbers.into());
    }
    told.into()
}
