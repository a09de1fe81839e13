//! `[controller]`: how far the controller helps a swarm that stands still.

use super::definitions::{Definitions, one_of, said, table};
use super::diagnostics::Diagnostics;
use super::table::{Node, Section};
use metamorph_kernel::director::rescue::Rescue;
use serde_json::json;

/// The levels, by their names.
pub(super) const LEVELS: [(&str, Rescue); 3] = [
    (Rescue::Plans.name(), Rescue::Plans),
    (Rescue::Calls.name(), Rescue::Calls),
    (Rescue::Off.name(), Rescue::Off),
];

/// Reads the table.
pub fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Rescue> {
    let mut section = Section::of(node, "[controller]", "rescue = \"off\"", diagnostics)?;
    let rescue = section.choice("rescue", "rescue", &LEVELS, diagnostics);
    section.finish(diagnostics);
    rescue
}

/// Returns the definition of the table, for the JSON schema.
pub fn schema() -> Definitions {
    let rescue = said(
        "How far the controller helps a broken swarm of cubes that stands still: not at all, by calling single modules, or \
         also by moving one module after the other by a plan. Other families have no rescue.",
        one_of(&LEVELS),
    );
    vec![(
        "controller",
        table("What the controller does besides measuring.", &[], json!({ "rescue": rescue })),
    )]
}
