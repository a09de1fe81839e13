//! The command `plan` with a scenario: the structure of its metamodules and elements.

use crate::cli::runs;
use crate::console::command_error::Failure;
use crate::console::output::{Json, OutputError, Outputs};
use crate::console::terminal::{Channel, Paint};
use crate::family::metamodule::assembly::{AssemblyVerdict, assembly, text};
use crate::plan::{IMPOSSIBLE, PlanArgs, PlanError, UNDECIDED};
use crate::scenario::settings::Setting;
use crate::scenario::{LinkKind, Overrides};
use std::path::Path;

/// Plans the structure of a scenario, and returns the exit code.
pub fn plan(path: &Path, args: &PlanArgs) -> Result<u8, Failure> {
    let setting = |text: &String| Setting { option: "--set", text: text.clone() };
    let overrides = Overrides {
        link: LinkKind::Sim,
        seed: args.seed,
        settings: args.set.iter().map(setting).collect(),
        ..Overrides::default()
    };
    let plan = runs::plan(path, &overrides)?;
    let mut outputs = Outputs::new();
    outputs.reads("the scenario", Path::new(&plan.origin));
    plan.files.iter().for_each(|file| outputs.reads("a file that the scenario names,", file));
    let failed = |error: OutputError| Failure::from(PlanError::from(error));
    let json = Json::of(args.json.as_deref(), &mut outputs).map_err(failed)?;
    let channel = Channel::beside(json.is_out(), args.quiet);
    let answer = assembly(&plan, args.planner)?;
    json.write(&answer).map_err(failed)?;
    channel.say(&text(&answer, Paint::PLAIN));
    Ok(match answer.verdict {
        AssemblyVerdict::Plan => 0,
        AssemblyVerdict::Infeasible => IMPOSSIBLE,
        AssemblyVerdict::Undecided => UNDECIDED,
    })
}
