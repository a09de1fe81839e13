//! The key `graph` of `[swarm]`: which modules touch each other, as written.

use metamorph_scenario::definitions::{natural, one_of_its_keys, said, table, text};
use metamorph_scenario::diagnostics::{At, Diagnostics};
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::table::{Node, Read, Section, elements};
use metamorph_sim_bridge::world::contact_graph::{ContactGraph, GraphError, MODULES_MAX};
use metamorph_text::sources::Sources;
use serde_json::{Value, json};
use std::fmt;
use std::sync::Arc;

/// Largest size of a file of contacts, in bytes.
const FILE_MAX: u64 = 4 << 20;
/// The kinds of graphs, by the keys that name them.
const KINDS: [&str; 7] = ["ring", "line", "grid", "torus", "random", "contacts", "file"];
const EXAMPLE: &str = "graph = { ring = 50 }";
const RANDOM: &str = "random = { modules = 50, degree = 4 }";
const GRID: &str = "grid = [10, 10]";

/// The graph of a scenario, from which the contacts follow.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Contacts {
    /// Each module touches the next one, and the last one the first.
    Ring(u64),
    /// Each module touches the next one.
    Line(u64),
    /// Modules in a rectangle or a box; on a torus opposite sides touch.
    Grid {
        /// Modules along x, y and z.
        sides: [u64; 3],
        /// Whether opposite sides touch.
        is_torus: bool,
    },
    /// Drawn by the seed of the run.
    Random {
        /// The number of modules.
        modules: u64,
        /// The average number of contacts of a module.
        degree: u64,
    },
    /// Pairs of modules.
    Pairs(Arc<[[u32; 2]]>),
}

impl fmt::Display for Contacts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Contacts::Ring(_) => f.write_str("in a ring"),
            Contacts::Line(_) => f.write_str("in a line"),
            Contacts::Grid { sides: [x, y, z], is_torus } => {
                let kind = if *is_torus { "on a torus" } else { "in a grid" };
                write!(f, "{kind} of {x} × {y}")?;
                if *z > 1 { write!(f, " × {z}") } else { Ok(()) }
            }
            Contacts::Random { degree, .. } => write!(f, "with {degree} random contacts on average"),
            Contacts::Pairs(_) => f.write_str("with contacts of their own"),
        }
    }
}

fn problem(reason: impl Into<String>, fix: impl Into<String>) -> ScenarioError {
    ScenarioError::OfFamily { reason: reason.into(), fix: fix.into() }
}

impl Contacts {
    /// Returns true if the seed of the run decides the contacts.
    pub fn is_drawn(&self) -> bool {
        matches!(self, Contacts::Random { .. })
    }

    /// Returns the graph for modules with this number of ports.
    ///
    /// # Errors
    /// If there are too few or too many modules, or one would need more ports.
    pub fn graph(&self, ports: usize, seed: u64) -> Result<ContactGraph, ScenarioError> {
        let graph = match self {
            Contacts::Ring(modules) => ContactGraph::ring(*modules),
            Contacts::Line(modules) => ContactGraph::line(*modules),
            Contacts::Grid { sides, is_torus } => ContactGraph::grid(*sides, *is_torus),
            Contacts::Random { modules, degree } => ContactGraph::random(*modules, *degree, ports, seed),
            Contacts::Pairs(pairs) => ContactGraph::of_contacts(pairs.iter().copied(), ports),
        };
        let graph = graph.and_then(|graph| graph.fits(ports).map(|()| graph));
        graph.map_err(|error| {
            let fix = match &error {
                GraphError::Modules(..) => "name another number of modules",
                GraphError::Loop(_) => "let each contact name two modules",
                GraphError::Twice(..) => "name each pair once",
                GraphError::Ports(..) => "give modules fewer contacts, or the agent more `PORTS`",
            };
            problem(error.to_string(), fix)
        })
    }

    /// Returns the JSON schema of the key.
    pub fn schema() -> Value {
        let count = || json!({ "type": "integer", "minimum": 1, "maximum": MODULES_MAX });
        let sides = || json!({ "type": "array", "items": count(), "minItems": 2, "maxItems": 3 });
        let pair = json!({ "type": "array", "items": natural(), "minItems": 2, "maxItems": 2 });
        let random = table(
            "A connected graph that the seed of the run draws.",
            &["modules", "degree"],
            json!({
                "modules": said("The number of modules.", count()),
                "degree": said("The average number of contacts of a module.", natural()),
            }),
        );
        one_of_its_keys(table(
            "Which modules touch each other.",
            &[],
            json!({
                "ring": said("Number of modules in a ring, three or more.", count()),
                "line": said("Number of modules in a line.", count()),
                "grid": said("Modules along x and y, and z. Ports are 0 east, 1 west, 2 north, 3 south, 4 up, 5 down.", sides()),
                "torus": said("As `grid`, and opposite sides touch.", sides()),
                "random": random,
                "contacts": said("Pairs of modules that touch.", json!({ "type": "array", "items": pair })),
                "file": said("A text file with a pair of modules in each line, as networkx writes edge lists.", text()),
            }),
        ))
    }
}

fn numbers(node: &Node<'_>, example: &'static str, diagnostics: &mut Diagnostics) -> Option<Vec<u64>> {
    let array = elements(node, example, diagnostics)?;
    array.iter().map(|number| u64::read(number, diagnostics)).collect()
}

fn sides(node: &Node<'_>, is_torus: bool, diagnostics: &mut Diagnostics) -> Option<Contacts> {
    match numbers(node, GRID, diagnostics)?[..] {
        [x, y] => Some(Contacts::Grid { sides: [x, y, 1], is_torus }),
        [x, y, z] => Some(Contacts::Grid { sides: [x, y, z], is_torus }),
        _ => {
            diagnostics.add(node.span(), problem("a grid has two or three sides", format!("write {GRID}")));
            None
        }
    }
}

fn random(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Contacts> {
    let mut section = Section::of(node, "random", RANDOM, diagnostics)?;
    let modules = section.need("modules", "modules = 50", diagnostics);
    let degree = section.need("degree", "degree = 4", diagnostics);
    section.finish(diagnostics);
    Some(Contacts::Random { modules: modules?.value, degree: degree?.value })
}

fn pairs(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Contacts> {
    const PAIRS: &str = "contacts = [[0, 1], [1, 2]]";
    let array = elements(node, PAIRS, diagnostics)?;
    let mut pairs = Vec::new();
    for one in array.iter() {
        let found = numbers(one, PAIRS, diagnostics)?;
        let ids: Vec<u32> = found.iter().filter_map(|id| u32::try_from(*id).ok()).collect();
        match (found.len(), &ids[..]) {
            (2, [a, b]) => pairs.push([*a, *b]),
            _ => {
                let reason = "a contact is between two modules, named by their numbers";
                diagnostics.add(one.span(), problem(reason, format!("write {PAIRS}")));
                return None;
            }
        }
    }
    Some(Contacts::Pairs(pairs.into()))
}

/// Reads a list of edges: two numbers in each line; comments begin with `#`. networkx writes `{}` behind them.
fn parse(text: &str) -> Result<Vec<[u32; 2]>, ScenarioError> {
    let mut pairs = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let words: Vec<&str> = line.split('#').next().unwrap_or("").split_whitespace().collect();
        let ids: Vec<u32> = words.iter().take(2).filter_map(|word| word.parse().ok()).collect();
        match (&words[..], &ids[..]) {
            ([], _) => {}
            ([_, _] | [_, _, "{}"], [a, b]) => pairs.push([*a, *b]),
            _ => {
                let shown: String = line.chars().take(40).collect();
                let reason = format!("line {number} of the file is `{shown}`");
                return Err(problem(reason, "write two numbers of modules in each line, such as `0 1`"));
            }
        }
    }
    Ok(pairs)
}

fn file(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Contacts> {
    let name = String::read(node, diagnostics)?;
    let place = node.span().into();
    let path = diagnostics.file(&name);
    let path = diagnostics.note(&place, path)?;
    let bytes = diagnostics.sources().read(&path, FILE_MAX);
    let pairs = bytes
        .map_err(|error| problem(format!("{name}: {error}"), "name a file that can be read"))
        .and_then(|bytes| {
            String::from_utf8(bytes)
                .map_err(|_| problem(format!("{name} is not text"), "name a list of edges"))
        })
        .and_then(|text| parse(&text));
    let pairs = diagnostics.note(&place, pairs)?;
    Some(Contacts::Pairs(pairs.into()))
}

/// Reads the key `graph` of `[swarm]`.
pub fn read(swarm: &mut Section<'_, '_>, diagnostics: &mut Diagnostics) -> Option<At<Contacts>> {
    let Some(node) = swarm.node("graph") else {
        swarm.missing("graph", EXAMPLE, diagnostics);
        return None;
    };
    let mut section = Section::of(node, "graph", EXAMPLE, diagnostics)?;
    let given = section.present(&KINDS);
    let mut of_kind = |key: &'static str, diagnostics: &mut Diagnostics| {
        let node = section.node(key)?;
        match key {
            "ring" => u64::read(node, diagnostics).map(Contacts::Ring),
            "line" => u64::read(node, diagnostics).map(Contacts::Line),
            "grid" => sides(node, false, diagnostics),
            "torus" => sides(node, true, diagnostics),
            "random" => random(node, diagnostics),
            "contacts" => pairs(node, diagnostics),
            _ => file(node, diagnostics),
        }
    };
    let found = KINDS.map(|key| of_kind(key, diagnostics)).into_iter().flatten().next();
    section.finish(diagnostics);
    if given.len() != 1 {
        let (reason, fix) = (format!("a graph is one of {}", KINDS.join(", ")), format!("write {EXAMPLE}"));
        diagnostics.add(node.span(), problem(reason, fix));
        return None;
    }
    found.map(|contacts| At::new(contacts, node.span()))
}
