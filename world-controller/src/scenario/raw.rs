//! A scenario as it is written: typed values with their places, before anything is checked that
//! needs more than one of them.

use super::faults::{self, RawFault, Verb};
use super::flaw::{Flaw, MAX_GOALS, VERSION};
use super::problems::{At, Place, Problems};
use super::table::{Delay, Node, Section, delay, elements};
use super::{LinkKind, Overrides};
use metamorph_protocol::cube::params::Connectivity;
use metamorph_protocol::goal::Growth;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::shape::Shape;
use metamorph_protocol::time::Span;
use toml::de::DeTable;

/// A goal as written.
#[derive(Clone, Debug)]
pub struct RawGoal {
    /// What it is called.
    pub name: Option<String>,
    /// The shape; none if it could not be read.
    pub shape: Option<At<Shape>>,
    /// The cell to grow from.
    pub seed: Option<At<Cell>>,
    /// How it grows.
    pub growth: Growth,
}

/// A link as written.
#[derive(Clone, Debug, Default)]
pub struct RawLink {
    /// The shortest and the longest delay.
    pub delay: Option<At<Delay>>,
    /// The probability of loss.
    pub loss: Option<At<Ratio>>,
    /// The probability of duplication.
    pub duplicate: Option<At<Ratio>>,
    /// The probability of being overtaken.
    pub reorder: Option<At<Ratio>>,
    /// The probability of damage.
    pub corrupt: Option<At<Ratio>>,
}

/// A scenario as written, with what the command line changed.
#[derive(Clone, Debug)]
pub struct Raw {
    /// What it is called.
    pub name: Option<String>,
    /// What it shows.
    pub description: Option<String>,
    /// The seed of the run.
    pub seed: u64,
    /// Where the modules are at first; none if it could not be read.
    pub start: Option<At<Shape>>,
    /// How long a move takes.
    pub move_time: Option<At<Span>>,
    /// The probability that a move fails.
    pub failed_connections: Option<At<Ratio>>,
    /// What shall be built.
    pub goals: Vec<RawGoal>,
    /// The connectivity check.
    pub connectivity: Connectivity,
    /// Whether all that touch a cell are asked.
    pub co_owners: bool,
    /// The link.
    pub link: RawLink,
    /// Scenario seconds per second on the process link.
    pub time_scale: Option<At<f64>>,
    /// What is broken when.
    pub faults: Vec<RawFault>,
    /// The latest end.
    pub timeout: Option<At<Span>>,
    /// The bound for standing still.
    pub stall: Option<At<Span>>,
    /// The bound for moving without progress.
    pub livelock: Option<At<Span>>,
}

const GROWTH: [(&str, Growth); 2] = [("scaffold", Growth::Scaffold), ("solid", Growth::Solid)];
const CONNECTIVITY: [(&str, Connectivity); 3] = [
    ("forest", Connectivity::Forest),
    ("cycles", Connectivity::Cycles),
    ("gradient", Connectivity::Gradient),
];
/// Whether modules stay with a dead neighbour. Letting go of it could tear the body apart, so that
/// there is one policy so far; the key is there so that scenarios can say what they rely on.
const DEAD: [(&str, bool); 2] = [("hold", true), ("abandon", false)];
/// Strategies of the metamodule family; refused by name, so that nobody thinks they had an effect.
const STRATEGIES: [&str; 4] = ["greedy", "slope", "step", "negotiated"];
const START: &str = "start = { box = { min = [0, 0, 0], max = [5, 5, 0] } }";

impl Raw {
    /// Reads the whole document and the options. Values that cannot be read are noted and left out.
    pub fn read(document: &DeTable<'_>, overrides: &Overrides, problems: &mut Problems) -> Raw {
        let mut top = Section::new(document, "the scenario", Place::File);
        match top.need::<i64>("version", "version = 1", problems) {
            Some(At { value, place }) if value > VERSION as i64 => {
                // Nothing else can be judged by the rules of this version.
                problems.add(place, Flaw::Newer { found: value });
                return Raw::empty(overrides);
            }
            Some(At { value, place }) if value < 1 => {
                let flaw = Flaw::Range {
                    what: "the version",
                    got: value.to_string(),
                    low: "1".into(),
                    high: VERSION.to_string(),
                };
                problems.add(place, flaw);
            }
            _ => {}
        }
        let mut raw = Raw::empty(overrides);
        raw.name = top.get("name", problems).map(|n| n.value);
        raw.description = top.get("description", problems).map(|d| d.value);
        let seed = top.get::<u64>("seed", problems).map_or(1, |s| s.value);
        raw.seed = overrides.seed.unwrap_or(seed);
        match top.node("swarm") {
            Some(node) => raw.read_swarm(node, problems),
            None => top.missing(
                "swarm",
                "[swarm]\n    start = { box = { min = [0, 0, 0], max = [5, 5, 0] } }",
                problems,
            ),
        }
        match top.node("goal") {
            Some(node) => raw.read_goals(node, problems),
            None => problems.add(Place::File, Flaw::NoGoal),
        }
        if let Some(node) = top.node("protocol") {
            raw.read_protocol(node, problems);
        }
        if let Some(node) = top.node("link") {
            raw.read_link(node, problems);
        }
        if let Some(node) = top.node("process") {
            raw.read_process(node, problems);
        }
        if let Some(node) = top.node("fault") {
            raw.faults = faults::read(node, problems);
        }
        if let Some(node) = top.node("stop") {
            raw.read_stop(node, problems);
        }
        top.finish(problems);
        raw.override_with(overrides, problems);
        raw
    }

    fn empty(overrides: &Overrides) -> Raw {
        Raw {
            name: None,
            description: None,
            seed: overrides.seed.unwrap_or(1),
            start: None,
            move_time: None,
            failed_connections: None,
            goals: Vec::new(),
            connectivity: Connectivity::default(),
            co_owners: true,
            link: RawLink::default(),
            time_scale: None,
            faults: Vec::new(),
            timeout: None,
            stall: None,
            livelock: None,
        }
    }

    fn read_swarm(&mut self, node: &Node<'_>, problems: &mut Problems) {
        let Some(mut section) = Section::of(node, "[swarm]", START, problems) else { return };
        if let Some(family) = section.get::<String>("family", problems) {
            match family.value.as_str() {
                "cube" => {}
                "metamodule" => {
                    let what = "the family `metamodule`".to_owned();
                    problems.add(family.place, Flaw::NotYet { what, instead: "write `family = \"cube\"`" });
                }
                _ => {
                    let flaw = Flaw::Name { what: "family", got: family.value, known: vec!["cube"] };
                    problems.add(family.place, flaw);
                }
            }
        }
        self.start = section.need("start", START, problems);
        self.move_time = section.get("move_time", problems);
        self.failed_connections = section.get("failed_connections", problems);
        section.finish(problems);
    }

    fn read_goals(&mut self, node: &Node<'_>, problems: &mut Problems) {
        let Some(array) = elements(node, "[[goal]]", problems) else { return };
        if array.is_empty() {
            problems.add(node.span(), Flaw::NoGoal);
        }
        if array.len() > MAX_GOALS {
            problems.add(node.span(), Flaw::TooManyGoals(array.len()));
        }
        let example = "shape = { sphere = { center = [0, 0, 2], radius = 3 } }";
        for goal in array.iter().take(MAX_GOALS) {
            let Some(mut section) = Section::of(goal, "[[goal]]", example, problems) else { continue };
            let raw = RawGoal {
                name: section.get("name", problems).map(|n| n.value),
                shape: section.need("shape", example, problems),
                seed: section.get("seed", problems),
                growth: section.choice("growth", "growth", &GROWTH, problems).unwrap_or_default(),
            };
            section.finish(problems);
            self.goals.push(raw);
        }
    }

    fn read_protocol(&mut self, node: &Node<'_>, problems: &mut Problems) {
        let Some(mut section) = Section::of(node, "[protocol]", "connectivity = \"forest\"", problems) else {
            return;
        };
        let connectivity = section.choice("connectivity", "connectivity", &CONNECTIVITY, problems);
        self.connectivity = connectivity.unwrap_or_default();
        let dead = section.node("dead").map(|node| node.span());
        if let (Some(false), Some(place)) =
            (section.choice("dead", "policy for dead modules", &DEAD, problems), dead)
        {
            let what = "letting go of dead modules".to_owned();
            problems.add(place, Flaw::NotYet { what, instead: "write `dead = \"hold\"`, or leave it out" });
        }
        self.co_owners = section.get("co_owners", problems).is_none_or(|c| c.value);
        if let Some(strategy) = section.get::<String>("strategy", problems) {
            let flaw = if STRATEGIES.contains(&strategy.value.as_str()) {
                Flaw::NotYet {
                    what: format!("the strategy `{}`, which belongs to metamodules,", strategy.value),
                    instead: "remove it; cubes choose with `connectivity` and `co_owners`",
                }
            } else {
                Flaw::Name { what: "strategy", got: strategy.value, known: STRATEGIES.to_vec() }
            };
            problems.add(strategy.place, flaw);
        }
        section.finish(problems);
    }

    fn read_link(&mut self, node: &Node<'_>, problems: &mut Problems) {
        let Some(mut section) = Section::of(node, "[link]", "loss = \"5%\"", problems) else { return };
        self.link = RawLink {
            delay: section.get("delay", problems),
            loss: section.get("loss", problems),
            duplicate: section.get("duplicate", problems),
            reorder: section.get("reorder", problems),
            corrupt: section.get("corrupt", problems),
        };
        section.finish(problems);
    }

    fn read_process(&mut self, node: &Node<'_>, problems: &mut Problems) {
        let Some(mut section) = Section::of(node, "[process]", "time_scale = 20", problems) else { return };
        self.time_scale = section.get("time_scale", problems);
        section.finish(problems);
    }

    fn read_stop(&mut self, node: &Node<'_>, problems: &mut Problems) {
        let Some(mut section) = Section::of(node, "[stop]", "timeout = \"1000s\"", problems) else { return };
        self.timeout = section.get("timeout", problems);
        self.stall = section.get("stall", problems);
        self.livelock = section.get("livelock", problems);
        section.finish(problems);
    }

    /// The command line has the last word; its faults come on top of the scenario's.
    fn override_with(&mut self, overrides: &Overrides, problems: &mut Problems) {
        for (verb, name, texts) in [
            (Verb::Kill, "--kill", &overrides.kill),
            (Verb::Pause, "--pause", &overrides.pause),
            (Verb::Restart, "--restart", &overrides.restart),
        ] {
            self.faults.extend(texts.iter().filter_map(|t| faults::read_option(verb, name, t, problems)));
        }
        for (name, text, target) in [
            ("--loss", &overrides.loss, &mut self.link.loss),
            ("--dup", &overrides.duplicate, &mut self.link.duplicate),
            ("--reorder", &overrides.reorder, &mut self.link.reorder),
        ] {
            if let Some(text) = text {
                let place = Place::Option(format!("{name} {text}"));
                *target = problems.note(&place, text.parse::<Ratio>()).map(|ratio| At::new(ratio, place));
            }
        }
        if let Some(text) = &overrides.delay {
            let place = Place::Option(format!("--delay {text}"));
            self.link.delay =
                problems.note(&place, delay(text)).map(|(min, max)| At::new(Delay(min, max), place));
        }
        if let Some(text) = &overrides.time_scale {
            let place = Place::Option(format!("--time-scale {text}"));
            match text.parse::<f64>() {
                Ok(scale) => self.time_scale = Some(At::new(scale, place)),
                Err(_) => problems.add(place, Flaw::Form(text.clone(), "X, a number such as 20")),
            }
        }
    }
}

/// The delay of messages if the scenario names none: on the simulated link from a hundredth to a
/// tenth of a move; on the process link only the real one.
pub fn default_delay(link: LinkKind, move_time: Span) -> Delay {
    match link {
        LinkKind::Sim => Delay(move_time / 100, move_time / 10),
        LinkKind::Ipc => Delay(Span::ZERO, Span::ZERO),
    }
}
