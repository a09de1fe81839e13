//! The parts of a scenario of modules with a graph of contacts.

use super::contacts::{self, Contacts};
use super::{GraphFamily, GraphProtocol, GraphSwarm};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::time::Span;
use metamorph_scenario::bounds::Bounds;
use metamorph_scenario::definitions::{natural, said, table};
use metamorph_scenario::diagnostics::{At, Diagnostics, Place};
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::family::{
    DraftContext, FamilySchema, FamilySpec, Patience, RawSwarm, ScenarioFamily, Sections, Swarm,
};
use metamorph_scenario::raw::protocol_section;
use metamorph_scenario::table::Section;
use serde::Deserialize as _;
use serde_json::{Map, Value, json};
use std::fmt;
use std::sync::Arc;
use toml::de::DeValue;

/// The parts as written.
struct RawGraph<P: Agent> {
    contacts: Option<At<Contacts>>,
    setup: Option<Arc<P::Setup>>,
}

impl<P: Agent> fmt::Debug for RawGraph<P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RawGraph").field("contacts", &self.contacts).finish_non_exhaustive()
    }
}

/// Returns the parameters of a protocol with their defaults.
fn defaults<P: GraphProtocol>() -> Map<String, Value> {
    match serde_json::to_value(P::Setup::default()) {
        Ok(Value::Object(fields)) => fields,
        _ => Map::new(),
    }
}

/// Returns a value of a scenario as JSON; `None` if JSON has no such value.
fn as_json(value: &DeValue<'_>) -> Option<Value> {
    Some(match value {
        DeValue::String(text) => text.as_ref().into(),
        DeValue::Integer(n) => i64::from_str_radix(n.as_str(), n.radix()).ok()?.into(),
        DeValue::Float(n) => n.as_str().parse::<f64>().ok()?.into(),
        DeValue::Boolean(flag) => (*flag).into(),
        DeValue::Datetime(_) => return None,
        DeValue::Array(array) => array.iter().map(|one| as_json(one.get_ref())).collect::<Option<_>>()?,
        DeValue::Table(table) => {
            let fields =
                table.iter().map(|(key, one)| Some((key.get_ref().to_string(), as_json(one.get_ref())?)));
            Value::Object(fields.collect::<Option<_>>()?)
        }
    })
}

fn add_problem(place: impl Into<Place>, reason: String, fix: String, diagnostics: &mut Diagnostics) {
    diagnostics.add(place, ScenarioError::OfFamily { reason, fix });
}

/// Reads `[protocol]` into the setup of the agents. Each value is tried with the defaults of the others, so that an error has
/// its place.
fn setup<P: GraphProtocol>(others: &Sections<'_, '_>, diagnostics: &mut Diagnostics) -> Option<P::Setup> {
    let is_table = protocol_section(others.protocol, "", diagnostics).is_some();
    let table = others.protocol.filter(|_| is_table).map(|node| node.get_ref());
    let mut fields = defaults::<P>();
    let (known, usual) = (fields.keys().cloned().collect::<Vec<_>>().join(", "), fields.clone());
    let mut is_right = true;
    let given = match table {
        Some(DeValue::Table(table)) => table.iter().collect(),
        _ => Vec::new(),
    };
    for (key, node) in given {
        let name = key.get_ref().to_string();
        let value = as_json(node.get_ref());
        let problem = match (usual.contains_key(&name), &value) {
            (false, _) => {
                Some((Place::from(key.span()), format!("`{name}` is no parameter of this protocol")))
            }
            (true, None) => {
                Some((node.span().into(), format!("`{name}` has a value that no parameter takes")))
            }
            (true, Some(value)) => {
                let mut alone = usual.clone();
                alone.insert(name.clone(), value.clone());
                let error = P::Setup::deserialize(Value::Object(alone)).err();
                error.map(|error| (node.span().into(), format!("`{name}`: {error}")))
            }
        };
        match problem {
            Some((place, reason)) => {
                is_right = false;
                let fix = match usual.get(&name) {
                    Some(default) => format!("write a value like its default, {default}"),
                    None if known.is_empty() => "remove it; the protocol has no parameters".to_owned(),
                    None => format!("the parameters are {known}"),
                };
                add_problem(place, reason, fix, diagnostics);
            }
            None => drop(value.map(|value| fields.insert(name, value))),
        }
    }
    if fields.is_empty() {
        return Some(P::Setup::default()).filter(|_| is_right);
    }
    match P::Setup::deserialize(Value::Object(fields)) {
        Ok(setup) => Some(setup).filter(|_| is_right),
        Err(error) => {
            let fix = "correct the parameters together".to_owned();
            let place = others.protocol.map_or(Place::File, |node| node.span().into());
            add_problem(place, format!("[protocol]: {error}"), fix, diagnostics);
            None
        }
    }
}

impl<P: GraphProtocol> ScenarioFamily for GraphFamily<P> {
    fn name(&self) -> &'static str {
        P::NAME
    }
    fn needs_goal(&self) -> bool {
        false
    }
    fn read(
        &self,
        mut swarm: Section<'_, '_>,
        others: &Sections<'_, '_>,
        diagnostics: &mut Diagnostics,
    ) -> Box<dyn RawSwarm> {
        let contacts = contacts::read(&mut swarm, diagnostics);
        swarm.finish(diagnostics);
        let setup = setup::<P>(others, diagnostics).map(Arc::new);
        Box::new(RawGraph::<P> { contacts, setup })
    }
    fn schema(&self) -> FamilySchema {
        let parameters = defaults::<P>().into_iter().map(|(name, default)| {
            let described = format!("The field `{name}` of the protocol's setup.");
            (name, json!({ "description": described, "default": default }))
        });
        FamilySchema {
            swarm: table(
                &format!("Modules that {}.", P::ABOUT),
                &["family", "graph"],
                json!({
                    "family": { "const": P::NAME },
                    "graph": Contacts::schema(),
                    "failed_connections": said("Nothing connects here.", natural()),
                }),
            ),
            goal: table("There are none.", &[], json!({})),
            protocol: table("The parameters of the protocol.", &[], Value::Object(parameters.collect())),
            shapes: &[],
            definitions: Vec::new(),
        }
    }
    fn faults(&self) -> &'static [&'static str] {
        &["kill", "pause", "crash", "partition"]
    }
}

impl<P: GraphProtocol> RawSwarm for RawGraph<P> {
    fn time_step(&self) -> (&Option<At<Span>>, &'static str) {
        (&None, "move_time")
    }
    fn draft(&self, context: &DraftContext, diagnostics: &mut Diagnostics) -> Option<FamilySpec> {
        let At { value: contacts, place } = self.contacts.as_ref()?;
        let graph = contacts.graph(P::PORTS, context.seed);
        let graph = Arc::new(diagnostics.note(place, graph)?);
        let setup = Arc::clone(self.setup.as_ref()?);
        let repeat = P::repeat(&setup);
        // News goes from end to end and back, and is repeated until it has come through each contact.
        let (modules, contacts) = (graph.cells().len() as u64, graph.contacts().len() as u64);
        let messages = 4 * graph.reach(|_| true).unwrap_or(modules).max(1);
        let lost = repeat * context.passage.repeats(messages, contacts.max(1));
        let late = (context.usual_delay + context.passage.late) * messages;
        let swarm = GraphSwarm::<P> { contacts: self.contacts.as_ref()?.value.clone(), graph, setup };
        Some(FamilySpec {
            swarm: Some(Swarm::new(swarm)),
            modules: modules as usize,
            start_within: None,
            goals: vec!["the goal of the protocol".to_owned()],
            patience: Patience {
                bounds: Bounds {
                    stall: repeat * 4 + late + lost,
                    more_tries: context.passage.more_tries(1, contacts.max(1)),
                },
                livelock: 4,
                timeout: 10,
            },
        })
    }
}
