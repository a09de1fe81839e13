//! Faults as written, in `[[fault]]` tables and options such as `--kill 3@2s`. Absent: checking and injecting them.

use super::definitions::{Definitions, fault, for_good, natural, of, or, said, table};
use super::diagnostics::{At, Diagnostics, Place};
use super::error::ScenarioError;
use super::family::{ScenarioFamily, SectionKind, WorldFaultKind, fault_keys};
use super::hosts::{self, Pair};
use super::table::{Node, Read, Section, Window, elements, span, span_range};
use metamorph_core::ids::HostId;
use metamorph_core::ratio::Ratio;
use metamorph_core::time::Span;
use metamorph_kernel::director::faults::{Target, WorldFault};
use serde_json::json;

/// A fault that hits named modules.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verb {
    /// The process is killed; the body stays.
    Kill,
    /// The process is stopped, and continued later.
    Pause,
    /// The process is killed and restarted without its memory.
    Restart,
    /// The joint sticks, for a time or permanently.
    Stick,
}

/// The number of modules that crash at random.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Amount {
    /// This share of the swarm, rounded down.
    Fraction(Ratio),
    /// This many.
    Count(u64),
}

/// One fault as written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RawFault {
    /// Named modules.
    Named {
        /// The kind of fault.
        verb: Verb,
        /// The modules.
        modules: Vec<At<u64>>,
        /// Start of the fault.
        from: At<Span>,
        /// End of the fault.
        until: Option<At<Span>>,
    },
    /// Modules drawn at random are killed at random times.
    Crashes {
        /// The number of modules.
        amount: Amount,
        /// The earliest and the latest time.
        window: At<Window>,
        /// Where it is written.
        place: Place,
    },
    /// The world is hit.
    World {
        /// The kind of fault, and that of its end.
        kinds: (&'static WorldFault, Option<&'static WorldFault>),
        /// Part of the world or the goal that is hit.
        target: At<Target>,
        /// Start of the fault.
        from: At<Span>,
        /// End of the fault.
        until: Option<At<Span>>,
    },
    /// A host is hit: all processes on it.
    Host {
        /// The kind of fault.
        verb: Verb,
        /// The host.
        host: At<String>,
        /// Start of the fault.
        from: At<Span>,
        /// End of the fault.
        until: Option<At<Span>>,
    },
    /// Nothing passes between two hosts.
    Cut {
        /// The hosts.
        hosts: Pair,
        /// Start of the fault.
        from: At<Span>,
        /// End of the fault.
        until: At<Span>,
    },
    /// Modules are cut off from the others.
    Partition {
        /// The modules on one side.
        modules: Vec<At<u64>>,
        /// Start of the fault.
        from: At<Span>,
        /// End of the fault.
        until: At<Span>,
    },
}

/// The kinds of fault that every family may have.
pub const KINDS: &[&str] =
    &["kill", "pause", "restart", "stick", "crash", "partition", "kill_host", "pause_host", "cut"];

const VERBS: [(&str, Verb); 4] =
    [("kill", Verb::Kill), ("pause", Verb::Pause), ("restart", Verb::Restart), ("stick", Verb::Stick)];

const HOST_VERBS: [(&str, Verb); 2] = [("kill_host", Verb::Kill), ("pause_host", Verb::Pause)];

/// Reads all `[[fault]]` tables.
pub fn read(node: &Node<'_>, family: &dyn ScenarioFamily, diagnostics: &mut Diagnostics) -> Vec<RawFault> {
    let array = elements(node, "[[fault]]", diagnostics);
    array
        .into_iter()
        .flat_map(|a| a.iter())
        .filter_map(|fault| read_one(fault, family, diagnostics))
        .collect()
}

fn read_one(node: &Node<'_>, family: &dyn ScenarioFamily, diagnostics: &mut Diagnostics) -> Option<RawFault> {
    let mut section = Section::of(node, "[[fault]]", "kill = 3\nat = \"2s\"", diagnostics)?;
    section.differs_between_families(SectionKind::Fault);
    let world: Vec<_> = family
        .world_faults()
        .iter()
        .filter_map(|kind| section.node(kind.key).map(|target| (kind, target)))
        .collect();
    let named: Vec<_> = VERBS
        .iter()
        .filter(|(key, _)| family.faults().contains(key))
        .filter_map(|(key, verb)| Some((*verb, section.node(key)?)))
        .collect();
    let hosts: Vec<_> =
        HOST_VERBS.iter().filter_map(|(key, verb)| Some((*verb, section.node(key)?))).collect();
    let cut = section.node("cut");
    let crash = section.node("crash");
    let partition = section.node("partition");
    if let Some(controller) = section.node("controller") {
        let what = "a fault of the controller itself".to_owned();
        let instead = "remove it; to end the controller, kill the process of `metamorph run`, and go on with `metamorph resume`";
        diagnostics.add(controller.span(), ScenarioError::NotYet { what, instead });
        return None;
    }
    let fault = match (&named[..], &hosts[..], cut, crash, partition, &world[..]) {
        ([(verb, modules)], [], None, None, None, []) => {
            read_named(*verb, modules, &mut section, diagnostics)
        }
        ([], [(verb, host)], None, None, None, []) => read_host(*verb, host, &mut section, diagnostics),
        ([], [], Some(hosts), None, None, []) => read_cut(hosts, &mut section, diagnostics),
        ([], [], None, Some(crash), None, []) => read_crashes(crash, diagnostics),
        ([], [], None, None, Some(partition), []) => read_partition(partition, diagnostics),
        ([], [], None, None, None, [(kind, target)]) => read_world(kind, target, &mut section, diagnostics),
        _ => {
            ask_for_times(&mut section);
            let kinds = fault_keys(family);
            let (place, present) = (section.place().clone(), section.present(&kinds));
            let names = if present.is_empty() { "nothing".into() } else { present.join(" and ") };
            if !section.finish(diagnostics) {
                diagnostics.add(place, ScenarioError::OneVerb { names, kinds });
            }
            return None;
        }
    };
    section.finish(diagnostics);
    fault
}

/// Marks the keys that depend on the kind of fault as read, so that a table without exactly one kind is not
/// also reported for unknown keys.
fn ask_for_times(section: &mut Section<'_, '_>) {
    for key in ["at", "from", "until", "memory"] {
        section.node(key);
    }
}

fn read_named(
    verb: Verb,
    modules: &Node<'_>,
    section: &mut Section<'_, '_>,
    diagnostics: &mut Diagnostics,
) -> Option<RawFault> {
    let modules = module_list(modules, diagnostics);
    if verb == Verb::Restart
        && let Some(memory) = section.get::<bool>("memory", diagnostics).filter(|m| m.value)
    {
        let what = "a restart with memory".to_owned();
        let instead = "leave `memory` out: the module comes back without its memory and asks around";
        diagnostics.add(memory.place, ScenarioError::NotYet { what, instead });
    }
    let (from, until) = read_times(verb, section, diagnostics)?;
    Some(RawFault::Named { verb, modules: modules?, from, until })
}

/// Reads the times that a kind of fault needs.
fn read_times(
    verb: Verb,
    section: &mut Section<'_, '_>,
    diagnostics: &mut Diagnostics,
) -> Option<(At<Span>, Option<At<Span>>)> {
    let (from, until) = match verb {
        Verb::Kill | Verb::Restart => (section.need("at", "at = \"2s\"", diagnostics), None),
        Verb::Pause => {
            let from = section.need("from", "from = \"1s\"", diagnostics);
            (from, Some(section.need("until", "until = \"3s\"", diagnostics)?))
        }
        Verb::Stick => {
            let from = section.need("at", "at = \"2s\"", diagnostics);
            (from, section.get("until", diagnostics))
        }
    };
    Some((from?, until))
}

fn read_host(
    verb: Verb,
    host: &Node<'_>,
    section: &mut Section<'_, '_>,
    diagnostics: &mut Diagnostics,
) -> Option<RawFault> {
    let name = String::read(host, diagnostics).map(|name| At::new(name, host.span()));
    let (from, until) = match (verb, read_times(verb, section, diagnostics)?) {
        (Verb::Kill, (from, _)) => (from, section.get("until", diagnostics)),
        (_, times) => times,
    };
    Some(RawFault::Host { verb, host: name?, from, until })
}

fn read_cut(
    hosts: &Node<'_>,
    section: &mut Section<'_, '_>,
    diagnostics: &mut Diagnostics,
) -> Option<RawFault> {
    let hosts = hosts::read_names(hosts, diagnostics);
    let from = section.need("from", "from = \"5s\"", diagnostics);
    let until = section.need("until", "until = \"9s\"", diagnostics);
    Some(RawFault::Cut { hosts: hosts?, from: from?, until: until? })
}

/// Reads one module or several.
fn module_list(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Vec<At<u64>>> {
    match node.get_ref().as_array() {
        None => Some(vec![At::new(u64::read(node, diagnostics)?, node.span())]),
        Some(array) => {
            array.iter().map(|n| u64::read(n, diagnostics).map(|id| At::new(id, n.span()))).collect()
        }
    }
}

fn read_crashes(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<RawFault> {
    let example = "{ fraction = \"5%\", between = \"0s..60s\" }";
    let mut section = Section::of(node, "crash", example, diagnostics)?;
    let count = section.get::<u64>("count", diagnostics).map(|c| Amount::Count(c.value));
    let amount = match count {
        Some(_) => count,
        None => section.need("fraction", "fraction = \"5%\"", diagnostics).map(|f| Amount::Fraction(f.value)),
    };
    let window = section.need("between", "between = \"0s..60s\"", diagnostics);
    section.finish(diagnostics);
    Some(RawFault::Crashes { amount: amount?, window: window?, place: node.span().into() })
}

fn read_world(
    kind: &'static WorldFaultKind,
    target: &Node<'_>,
    section: &mut Section<'_, '_>,
    diagnostics: &mut Diagnostics,
) -> Option<RawFault> {
    let from = section.need("at", "at = \"2s\"", diagnostics);
    let until = kind.end.and_then(|_| section.get("until", diagnostics));
    let target = (kind.target)(target, diagnostics).map(|read| At::new(read, target.span()));
    Some(RawFault::World { kinds: (kind.begin, kind.end), target: target?, from: from?, until })
}

fn read_partition(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<RawFault> {
    let example = "{ modules = [1, 2, 3], from = \"5s\", until = \"10s\" }";
    let mut section = Section::of(node, "partition", example, diagnostics)?;
    let modules = match section.node("modules") {
        Some(modules) => module_list(modules, diagnostics),
        None => {
            section.missing("modules", "modules = [1, 2, 3]", diagnostics);
            None
        }
    };
    let from = section.need("from", "from = \"5s\"", diagnostics);
    let until = section.need("until", "until = \"10s\"", diagnostics);
    section.finish(diagnostics);
    Some(RawFault::Partition { modules: modules?, from: from?, until: until? })
}

/// Reads an option such as `--kill 3@2s` or `--pause 2@1s..3s`. A name such as `h2` instead of the number stands for all
/// modules of that host.
pub fn read_option(verb: Verb, name: &str, text: &str, diagnostics: &mut Diagnostics) -> Option<RawFault> {
    let place = Place::Option(format!("{name} {text}"));
    let form = if verb == Verb::Pause { "ID@T..T" } else { "ID@T" };
    let has_host = HOST_VERBS.iter().any(|(_, of_hosts)| *of_hosts == verb);
    let is_target = |id: &str| id.parse::<u64>().is_ok() || (has_host && HostId::from_name(id).is_some());
    let parsed = text
        .split_once('@')
        .map(|(id, times)| (id.trim(), times))
        .filter(|(id, _)| is_target(id))
        .ok_or_else(|| ScenarioError::Form(text.to_owned(), form));
    let (id, times) = diagnostics.note(&place, parsed)?;
    let (from, until) = match verb {
        Verb::Pause => {
            let window = span_range(times).map_err(|scenario_error| match scenario_error {
                ScenarioError::Form(..) => ScenarioError::Form(text.to_owned(), form),
                other => other,
            });
            let (from, until) = diagnostics.note(&place, window)?;
            (from, Some(At::new(until, place.clone())))
        }
        _ => (diagnostics.note(&place, span(times))?, None),
    };
    let from = At::new(from, place.clone());
    Some(match id.parse() {
        Ok(id) => RawFault::Named { verb, modules: vec![At::new(id, place)], from, until },
        Err(_) => RawFault::Host { verb, host: At::new(id.to_owned(), place), from, until },
    })
}

/// Reads the option `--partition 1,2,3@5s..10s`.
pub fn read_partition_option(text: &str, diagnostics: &mut Diagnostics) -> Option<RawFault> {
    let place = Place::Option(format!("--partition {text}"));
    let wrong = || ScenarioError::Form(text.to_owned(), "ID,ID@T..T");
    let parts = text.split_once('@').ok_or_else(wrong);
    let (modules, times) = diagnostics.note(&place, parts)?;
    let modules: Result<Vec<u64>, _> =
        modules.split(',').map(|id| id.trim().parse().map_err(|_| wrong())).collect();
    let modules = diagnostics.note(&place, modules)?;
    let window = span_range(times).map_err(|error| match error {
        ScenarioError::Form(..) => wrong(),
        other => other,
    });
    let (from, until) = diagnostics.note(&place, window)?;
    let at = |id| At::new(id, place.clone());
    let (from, until) = (At::new(from, place.clone()), At::new(until, place.clone()));
    Some(RawFault::Partition { modules: modules.into_iter().map(at).collect(), from, until })
}

/// Returns the definitions of the faults that every family may have, for the JSON schema.
pub fn schema() -> Definitions {
    vec![
        ("kill", fault("A process is killed; its body stays.", "kill", &["at"], json!({}))),
        ("pause", fault("A process is stopped for a while.", "pause", &["from", "until"], json!({}))),
        (
            "restart",
            fault(
                "A process is started again without its memory.",
                "restart",
                &["at"],
                json!({ "memory": said("Whether it has its memory.", or(false, json!({ "const": false }))) }),
            ),
        ),
        ("stick", fault("A joint sticks.", "stick", &["at"], json!({ "until": for_good() }))),
        (
            "crash",
            fault(
                "Modules drawn at random are killed.",
                "crash",
                &[],
                json!({ "crash": said("How many, and when.", of("crashes")) }),
            ),
        ),
        (
            "crashes",
            table(
                "How many, and when.",
                &["between"],
                json!({
                    "count": said("If left out, `fraction` says it.", natural()),
                    "fraction": said("Of all modules; if left out, `count` says it.", of("probability")),
                    "between": said("The times between which each dies at a time of its own.", of("window")),
                }),
            ),
        ),
        (
            "kill_host",
            fault(
                "All processes of a host are killed.",
                "kill_host",
                &["at"],
                json!({
                    "kill_host": said("The host.", of("host")),
                    "until": said(
                        "When it comes back, with lost = \"elsewhere\". If left out, never.",
                        of("time"),
                    ),
                }),
            ),
        ),
        (
            "pause_host",
            fault(
                "All processes of a host are stopped for a while.",
                "pause_host",
                &["from", "until"],
                json!({ "pause_host": said("The host.", of("host")) }),
            ),
        ),
        (
            "cut",
            fault(
                "Nothing passes between two hosts.",
                "cut",
                &["from", "until"],
                json!({ "cut": said("The two hosts.", of("two-hosts")) }),
            ),
        ),
        (
            "partition",
            fault(
                "Modules are cut off.",
                "partition",
                &[],
                json!({ "partition": said("The modules, and when.", of("sides")) }),
            ),
        ),
        (
            "sides",
            table(
                "The modules, and when.",
                &["modules", "from", "until"],
                json!({
                    "modules": said("The modules on one side; all others are on the other.", of("modules")),
                    "from": said("When it begins.", of("time")),
                    "until": said("When it ends.", of("time")),
                }),
            ),
        ),
    ]
}
