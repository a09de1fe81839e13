//! The command `diff`.

use metamorph_console::command::{CommandOf, Group};
use metamorph_experiments::diff::{DiffArgs, diff};

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph sweep swarm --seeds 0..200 --out forest
  metamorph sweep cycles.toml --seeds 0..200 --out cycles
  metamorph diff forest cycles
  metamorph diff forest cycles --at-least 5% --json diff.json
  metamorph diff forest cycles --by link.loss --plot forest.svg
  metamorph diff a.report.json b.report.json

Of sweeps, combinations with equal values are compared. Shares of outcomes have intervals of
Newcombe and Fisher's exact test; numbers of built runs have the shift of Hodges and Lehmann and the
test of Mann and Whitney. Probabilities are adjusted for the number of tests (Holm). Of reports,
fields that differ are listed, without those about the machine.

Exit codes:
  0  both could be compared, whether they differ or not
  1  the comparison could not be written
  2  the command line, a sweep or a report is wrong";

/// The command.
pub static COMMAND: CommandOf<DiffArgs> = CommandOf {
    name: "diff",
    group: Some(Group::Study),
    about: "Compare two sweeps, with intervals and tests, or two reports",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, _| Ok(diff(&args)?),
};
