//! The command `plan` with a scenario: the structure of its metamodules and elements.

use crate::plan::{IMPOSSIBLE, PlanArgs, UNDECIDED};
use crate::runs;
use metamorph_console::output::{Json, Outputs};
use metamorph_console::terminal::Channel;
use metamorph_families::metamodule::assembly::{AssemblyVerdict, assembly, text};
use metamorph_scenario::settings::Setting;
use metamorph_scenario::{LinkKind, Overrides};
use metamorph_text::command_error::Failure;
use metamorph_text::paint::Paint;
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
    let json = Json::of(args.json.as_deref(), &mut outputs)?;
    let channel = Channel::beside(json.is_out(), args.quiet);
    let answer = assembly(&plan, args.planner)?;
    json.write(&answer)?;
    channel.say(&text(&answer, Paint::PLAIN));
    Ok(match answer.verdict {
        AssemblyVerdict::Plan => 0,
        AssemblyVerdict::Infeasible => IMPOSSIBLE,
        AssemblyVerdict::Undecided => UNDECIDED,
    })
}
