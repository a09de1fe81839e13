//! `[[change]]`: changes of a simulated run at its events.

use super::LinkKind;
use super::definitions::{Definitions, names, natural, of, one_of_its_keys, said, table, text};
use super::diagnostics::{At, Diagnostics, Place};
use super::error::ScenarioError;
use super::rescue::LEVELS;
use super::table::{Node, Section, elements};
use metamorph_core::ids::ModuleId;
use metamorph_core::record::MessageName;
use metamorph_core::time::Span;
use metamorph_kernel::kernel::change::{Change, ChangeKind, message};
use serde_json::json;

/// Largest number of changes.
const MAX_CHANGES: usize = 256;
/// The form of the option.
pub const FORM: &str = "KIND=VALUE@EVENTS";
const EXAMPLE: &str = "after = 48213\n    reseed = { links = 17 }";
const SLEEP: &str = "sleep = { module = 7, for = \"1s\" }";
/// The form of the name of a message.
pub const MESSAGE: &str = "MODULE.INCARNATION.NUMBER";
const RESEED: &str = "reseed = { links = 17 }";
/// The kinds of change, as written.
const KINDS: [&str; 4] = ["reseed", "rescue", "lose", "sleep"];
/// The streams that may be reseeded, as written.
const STREAMS: [&str; 2] = ["links", "all"];

/// Reads all of them.
pub fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Vec<At<Change>> {
    let Some(all) = elements(node, "[[change]]", diagnostics) else { return Vec::new() };
    if all.len() > MAX_CHANGES {
        let (got, low, high) = (all.len().to_string(), "0".to_owned(), MAX_CHANGES.to_string());
        let what = "the number of [[change]]";
        diagnostics.add(node.span(), ScenarioError::Range { what, got, low, high });
        return Vec::new();
    }
    all.iter().filter_map(|node| read_one(node, diagnostics)).collect()
}

fn read_one(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<At<Change>> {
    let mut section = Section::of(node, "[[change]]", EXAMPLE, diagnostics)?;
    let after = section.need::<u64>("after", "after = 48213", diagnostics);
    let kinds = section.present(&KINDS);
    let rescue = section.choice("rescue", "rescue", &LEVELS, diagnostics).map(ChangeKind::Rescue);
    let lose = section.get::<String>("lose", diagnostics).and_then(|text| read_lost(&text, diagnostics));
    let sleep = section.node("sleep").and_then(|node| read_sleep(node, diagnostics));
    let reseed = section.node("reseed").and_then(|node| read_reseed(node, diagnostics));
    section.finish(diagnostics);
    must_be_one(&kinds, node, diagnostics)?;
    Some(At {
        value: Change { after: after?.value, kind: reseed.or(rescue).or(lose).or(sleep)? },
        place: node.span().into(),
    })
}

fn read_lost(text: &At<String>, diagnostics: &mut Diagnostics) -> Option<ChangeKind> {
    let name = message(&text.value);
    if name.is_none() {
        let error = ScenarioError::Form(text.value.clone(), MESSAGE);
        diagnostics.add(text.place.clone(), error);
    }
    name.map(ChangeKind::Lose)
}

fn read_sleep(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<ChangeKind> {
    let mut section = Section::of(node, "sleep", SLEEP, diagnostics)?;
    let module = section.need::<u64>("module", "module = 7", diagnostics);
    let span = section.need::<Span>("for", "for = \"1s\"", diagnostics);
    section.finish(diagnostics);
    // A module that the swarm does not have is refused with the swarm.
    Some(ChangeKind::Sleep(ModuleId(u32::try_from(module?.value).unwrap_or(u32::MAX)), span?.value))
}

fn read_reseed(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<ChangeKind> {
    let mut section = Section::of(node, "reseed", RESEED, diagnostics)?;
    let kinds = section.present(&STREAMS);
    let links = section.get::<u64>("links", diagnostics).map(|number| ChangeKind::Links(number.value));
    let all = section.get::<u64>("all", diagnostics).map(|number| ChangeKind::All(number.value));
    section.finish(diagnostics);
    must_be_one(&kinds, node, diagnostics)?;
    links.or(all)
}

/// Returns `None` after reporting that there is none of some keys, or that there are several.
fn must_be_one(present: &[&str], node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<()> {
    let names = match present {
        [_] => return Some(()),
        [] => "none".to_owned(),
        several => several.join(" and "),
    };
    diagnostics.add(node.span(), ScenarioError::OneChange(names));
    None
}

/// Reads the option `--change links=17@48213`.
pub fn read_option(text: &str, diagnostics: &mut Diagnostics) -> Option<At<Change>> {
    let place = Place::Option(format!("--change {text}"));
    match text.parse() {
        Ok(value) => Some(At { value, place }),
        Err(_) => {
            diagnostics.add(place, ScenarioError::Form(text.to_owned(), FORM));
            None
        }
    }
}

/// Refuses changes of modules that the swarm does not have, and changes of a run of processes: its events have no numbers.
pub fn check(changes: &[At<Change>], link: LinkKind, modules: usize, diagnostics: &mut Diagnostics) {
    for At { value, place } in changes {
        let (ChangeKind::Lose(MessageName { from: id, .. }) | ChangeKind::Sleep(id, _)) = value.kind else {
            continue;
        };
        if id.index() >= modules && modules > 0 {
            let (module, last) = (id.0.into(), modules - 1);
            diagnostics.add(place.clone(), ScenarioError::NoSuchModule { module, last });
        }
    }
    if let Some(first) = changes.first().filter(|_| link == LinkKind::Ipc) {
        let what = "a change at an event in a run of processes".to_owned();
        let instead = "simulate it with `--link sim`, or remove the change";
        diagnostics.add(first.place.clone(), ScenarioError::NotYet { what, instead });
    }
}

/// Returns the definitions, for the JSON schema.
pub fn schema() -> Definitions {
    let reseed = json!({
        "links": said("New streams for links only: those between modules, to other hosts and to the controller.", natural()),
        "all": said(
            "New streams for all that draws as a run proceeds: links, agents, joints and connections that fail, a scripted operator.",
            natural(),
        ),
    });
    let change = json!({
        "after": said("The number of events of the simulator before it.", natural()),
        "reseed": said("Other random numbers from there on, selected by a number. If left out, the same.", of("reseed")),
        "lose": said(
            "The message that does not arrive, such as 7.0.213: its sender, the incarnation of that, and the number among its messages. If \
             left out, none.",
            text(),
        ),
        "sleep": said("The process that does not run for a while; what it should handle waits. If left out, none.", of("sleep")),
        "rescue": said("How far the controller helps a swarm that stands still from there on. If left out, as before.", names(&LEVELS.map(|(name, _)| name))),
    });
    let about = "A change of a simulated run at one of its events. It has one kind.";
    let reseed = one_of_its_keys(table("Other random numbers; one of these.", &[], reseed));
    let sleep = json!({
        "module": said("The module.", natural()),
        "for": said("For how long.", of("time")),
    });
    let sleep = table("A process that does not run for a while.", &["module", "for"], sleep);
    vec![("reseed", reseed), ("sleep", sleep), ("change", table(about, &["after"], change))]
}
