//! `[[change]]`: changes of a simulated run at its events.

use super::LinkKind;
use super::definitions::{Definitions, names, natural, of, one_of_its_keys, said, table};
use super::diagnostics::{At, Diagnostics, Place};
use super::error::ScenarioError;
use super::rescue::LEVELS;
use super::table::{Node, Section, elements};
use metamorph_kernel::kernel::change::{Change, ChangeKind};
use serde_json::json;

/// Largest number of changes.
const MAX_CHANGES: usize = 256;
/// The form of the option.
pub const FORM: &str = "KIND=VALUE@EVENTS";
const EXAMPLE: &str = "after = 48213\n    reseed = { links = 17 }";
const RESEED: &str = "reseed = { links = 17 }";
/// The kinds of change, as written.
const KINDS: [&str; 2] = ["reseed", "rescue"];
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
    let reseed = section.node("reseed").and_then(|node| read_reseed(node, diagnostics));
    section.finish(diagnostics);
    must_be_one(&kinds, node, diagnostics)?;
    Some(At { value: Change { after: after?.value, kind: reseed.or(rescue)? }, place: node.span().into() })
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

/// Refuses changes of a run of processes: its events have no numbers.
pub fn check(changes: &[At<Change>], link: LinkKind, diagnostics: &mut Diagnostics) {
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
        "rescue": said("How far the controller helps a swarm that stands still from there on. If left out, as before.", names(&LEVELS.map(|(name, _)| name))),
    });
    let about = "A change of a simulated run at one of its events. It has one kind.";
    let reseed = one_of_its_keys(table("Other random numbers; one of these.", &[], reseed));
    vec![("reseed", reseed), ("change", table(about, &["after"], change))]
}
