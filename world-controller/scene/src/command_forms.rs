//! Forms of the commands that a page can give: the verbs that a run knows, each with its parameters.

use metamorph_kernel::director::faults::{Form, WorldFault};
use metamorph_scenario::Plan;
use metamorph_scenario::family::ScenarioFamily;
use serde::Serialize;

/// A parameter of a command. The page writes it as the command's text has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Parameter {
    /// `[1, 2, 3]`.
    Cell,
    /// `[1, -2]`.
    Shift,
    /// `1`.
    Number,
    /// `20%`.
    Percent,
    /// `3..7`.
    Modules,
    /// `for 30s`.
    Lease,
    /// One of these.
    Words(&'static [&'static str]),
}

use Parameter::{Cell, Lease, Modules, Number, Percent, Shift, Words};

/// A command that can be given.
#[derive(Clone, Debug, Serialize)]
pub struct CommandForm {
    /// First words of the command's text.
    pub verb: &'static str,
    /// True if the number of a module follows.
    pub of_module: bool,
    /// Parameters in the order of the text.
    pub parameters: Vec<Parameter>,
    /// Short description of the effect.
    about: &'static str,
    /// Why the level of autonomy refuses it whatever its parameters are; none if it does not.
    pub refused: Option<String>,
}

type Row = (&'static str, &'static [Parameter], &'static str);

/// Faults of a process or a body, and their ends.
const OF_MODULE: [Row; 6] = [
    ("kill", &[], "the process ends; the body stays"),
    ("restart", &[], "the process starts again without its memory"),
    ("pause", &[], "the process stands still"),
    ("resume", &[], "the process goes on"),
    ("stick", &[], "the joint sticks: moves fail"),
    ("unstick", &[], "the joint is free again"),
];
/// Commands that steer a module. Each family knows some of them.
const STEERING: [Row; 5] = [
    ("hold", &[Lease], "it stays where it is"),
    ("goto", &[Cell, Lease], "it goes there and stays"),
    ("take", &[Number, Lease], "it fills this seed of the goal, counted from 0"),
    ("swap", &[Number], "it and this other one do what the other was commanded"),
    ("release", &[], "it decides for itself again"),
];
/// Faults of the links, and their ends.
const OF_LINKS: [Row; 4] = [
    ("loss", &[Percent, Lease], "that share of the messages is lost"),
    ("loss off", &[], "messages are lost as the scenario says"),
    ("partition", &[Modules, Lease], "no message passes between these modules and the others"),
    ("partition off", &[], "messages pass"),
];

/// Returns all commands to a run of this plan, those to one module first.
pub fn of(plan: &Plan, family: &dyn ScenarioFamily) -> Vec<CommandForm> {
    let form = |(verb, parameters, about): Row, of_module| CommandForm {
        verb,
        of_module,
        parameters: parameters.to_vec(),
        about,
        refused: None,
    };
    let steering = STEERING.into_iter().filter(|(verb, ..)| plan.swarm.steering().contains(verb));
    let to_module = OF_MODULE.into_iter().chain(steering).map(|row| form(row, true));
    let to_world =
        family.commanded_to_world().into_iter().filter(|kind| plan.swarm.heeds(kind)).map(of_world);
    let all = to_module.chain(to_world).chain(OF_LINKS.into_iter().map(|row| form(row, false)));
    let level = plan.operator.map(|operator| operator.level()).unwrap_or_default();
    all.map(|form| CommandForm { refused: plan.swarm.refused_at(level, form.verb), ..form }).collect()
}

fn of_world(kind: &'static WorldFault) -> CommandForm {
    let parameters = match kind.form {
        Form::Cell => vec![Cell],
        Form::Shift => vec![Shift],
        Form::Element | Form::Number => vec![Number],
        Form::Word(words) => vec![Words(words)],
        Form::Nothing => Vec::new(),
    };
    CommandForm { verb: kind.name, of_module: false, parameters, about: kind.about, refused: None }
}
