//! Commands of operators as written in `[[command]]` tables, which `metamorph export --commands` makes of the commands of
//! a run.

use super::definitions::{Definitions, of, or, said, table};
use super::diagnostics::{At, Diagnostics};
use super::error::ScenarioError;
use super::family::ScenarioFamily;
use super::fault_plan::Bounds;
use super::table::{Node, Read, Section, elements};
use metamorph_core::time::{Span, Time};
use metamorph_kernel::director::commands::{Commands, MOST_COMMANDS};
use metamorph_kernel::director::faults::{Fault, Origin, Scheduled, WorldFault};
use serde_json::json;
use std::fmt::Write;

/// Number of the operator of commands whose table names none.
const OPERATOR: u64 = 1;
const EXAMPLE: &str = "at = \"2s\"\ndo = [\"kill 3\"]";

/// Commands that are given together, as written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawCommands {
    at: At<Span>,
    operator: u16,
    faults: Vec<At<Fault>>,
}

/// Reads all `[[command]]` tables.
pub fn read(node: &Node<'_>, family: &dyn ScenarioFamily, diagnostics: &mut Diagnostics) -> Vec<RawCommands> {
    let array = elements(node, "[[command]]", diagnostics);
    let tables = array.into_iter().flat_map(|a| a.iter());
    tables.filter_map(|table| read_one(table, family, diagnostics)).collect()
}

fn read_one(
    node: &Node<'_>,
    family: &dyn ScenarioFamily,
    diagnostics: &mut Diagnostics,
) -> Option<RawCommands> {
    let mut section = Section::of(node, "[[command]]", EXAMPLE, diagnostics)?;
    let at = section.need("at", "at = \"2s\"", diagnostics);
    let operator = section.get::<u64>("operator", diagnostics).map_or(Some(OPERATOR as u16), |operator| {
        let range = || ScenarioError::Range {
            what: "the number of the operator",
            got: operator.value.to_string(),
            low: "0".into(),
            high: u16::MAX.to_string(),
        };
        diagnostics.note(&operator.place, u16::try_from(operator.value).map_err(|_| range()))
    });
    let world = family.commanded_to_world();
    let faults = match section.node("do") {
        None => {
            section.missing("do", "do = [\"kill 3\"]", diagnostics);
            None
        }
        Some(list) => elements(list, "[\"kill 3\"]", diagnostics).and_then(|list| {
            if list.is_empty() || list.len() > MOST_COMMANDS {
                let range = ScenarioError::Range {
                    what: "the number of commands given together",
                    got: list.len().to_string(),
                    low: "1".into(),
                    high: MOST_COMMANDS.to_string(),
                };
                diagnostics.add(section.place().clone(), range);
                return None;
            }
            let faults: Vec<_> =
                list.iter().filter_map(|node| read_command(node, &world, diagnostics)).collect();
            (faults.len() == list.len()).then_some(faults)
        }),
    };
    section.finish(diagnostics);
    Some(RawCommands { at: at?, operator: operator?, faults: faults? })
}

fn read_command(
    node: &Node<'_>,
    world: &[&'static WorldFault],
    diagnostics: &mut Diagnostics,
) -> Option<At<Fault>> {
    let text = String::read(node, diagnostics)?;
    let fault = Fault::parse(&text, world).map_err(ScenarioError::Command);
    diagnostics.note(&node.span().into(), fault).map(|fault| At::new(fault, node.span()))
}

/// Checks the modules and the times of all commands.
pub fn check(commands: &[RawCommands], bounds: &Bounds<'_>, diagnostics: &mut Diagnostics) -> Vec<Scheduled> {
    let mut checked = Vec::new();
    for RawCommands { at, operator, faults } in commands {
        let at = bounds.time(at, diagnostics);
        for fault in faults {
            for id in fault.value.modules() {
                bounds.module(&At::new(u64::from(id.0), fault.place.clone()), diagnostics);
            }
            checked.push(Scheduled { at, fault: fault.value, by: Origin::Operator(*operator) });
        }
    }
    checked
}

/// Writes commands as `[[command]]` tables, with their exact times.
pub fn write(all: &[Commands]) -> String {
    let mut out = String::new();
    for Commands { at, operator, faults } in all {
        let (whole, rest) = (at.since(Time::ZERO).0 / 1_000_000_000, at.0 % 1_000_000_000);
        let faults: Vec<String> = faults.iter().map(|fault| format!("\"{fault}\"")).collect();
        // Writing to a string cannot fail.
        let _ = write!(
            out,
            "\n[[command]]\nat = \"{whole}.{rest:09}s\"\noperator = {operator}\ndo = [{}]\n",
            faults.join(", ")
        );
    }
    out
}

/// Returns the definitions of commands, for the JSON schema.
pub fn schema() -> Definitions {
    let command = json!({
        "type": "string",
        "pattern": concat!(
            r"^\s*((kill|pause|resume|restart|stick|unstick|release) \d+|(goto|take|hold|swap) \d+ ?.*",
            r"|(loss|partition|tune|goal\.set|goal\.turn|goal\.order) .+|(block|unblock|goal\.move) \[.*\]",
            r"|goal\.drop|drop \d+)\s*$",
        ),
    });
    vec![(
        "command",
        table(
            "Commands of an operator, given together.",
            &["at", "do"],
            json!({
                "at": said("When they are given.", of("time")),
                "operator": said("The number of the operator who gives them.", or(OPERATOR, json!({ "type": "integer", "minimum": 0, "maximum": u16::MAX }))),
                "do": said(
                    "Each is a fault of a module or of a cell, the end of one, or what a module or the goal is to do, such as \
                     `kill 3` or `goto 3 [4, 5, 0] for 30s`.",
                    json!({ "type": "array", "minItems": 1, "maxItems": MOST_COMMANDS, "items": command }),
                ),
            }),
        ),
    )]
}
