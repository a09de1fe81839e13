//! What a page must ask for before it can give a command: the verbs that a run knows, each with its parameters.

use crate::scenario::Plan;
use crate::scenario::family::ScenarioFamily;
use metamorph_sim_bridge::director::faults::{Form, WorldFault};
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
    /// What its text begins with.
    verb: &'static str,
    /// True if the number of a module follows.
    of_module: bool,
    /// What follows after that.
    parameters: Vec<Parameter>,
    /// What it does, in a few words.
    about: &'static str,
    /// Why the level of autonomy refuses it whatever its parameters are; none if it does not.
    refused: Option<String>,
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
/// What steers a module, of which a family knows some.
const STEERING: [Row; 5] = [
    ("hold", &[Lease], "it stays where it is"),
    ("goto", &[Cell, Lease], "it goes there and stays"),
    ("take", &[Number, Lease], "it fills this seed of the goal, counted from 0"),
    ("swap", &[Number], "it and this other one do what the other was commanded"),
    ("release", &[], "it decides for itself again"),
];
/// What befalls the links.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::family::{of as family_of, read_text};
    use crate::scenario::Overrides;
    use metamorph_sim_bridge::director::faults::Fault;

    /// Returns the text of a command with some parameters.
    fn text(form: &CommandForm) -> String {
        let mut text = form.verb.to_owned();
        let module = form.of_module.then(|| "3".to_owned());
        let given = form.parameters.iter().map(|parameter| match parameter {
            Cell => "[1, 2, 0]".to_owned(),
            Shift => "[1, -2]".to_owned(),
            Number => "1".to_owned(),
            Percent => "20%".to_owned(),
            Modules => "3..7".to_owned(),
            Lease => "for 30s".to_owned(),
            Words(words) => words[0].to_owned(),
        });
        module.into_iter().chain(given).for_each(|part| text += &format!(" {part}"));
        text
    }

    fn verbs(scenario: &str) -> Vec<&'static str> {
        let plan = read_text("forms.toml", scenario, &Overrides::default()).unwrap_or_else(|e| panic!("{e}"));
        let family = family_of(&plan);
        let forms = of(&plan, family);
        for form in &forms {
            let read = Fault::parse(&text(form), &family.commanded_to_world());
            assert!(read.is_ok(), "{read:?}");
        }
        forms.iter().map(|form| form.verb).collect()
    }

    #[test]
    fn what_a_page_offers_is_a_command_of_the_run() {
        let cubes = "version = 1\n[swarm]\nstart = { box = { min = [0, 0, 0], max = [3, 3, 0] } }\n\
            [[goal]]\nseed = [0, 0, 0]\nshape = { box = { min = [0, 0, 0], max = [3, 1, 1] } }\n";
        let own = ["kill", "restart", "pause", "resume", "stick", "unstick"];
        let links = ["loss", "loss off", "partition", "partition off"];
        assert_eq!(verbs(cubes), [&own[..], &["hold", "goto", "release"], &links].concat());
        let metamodules = |strategy: &str| {
            format!(
                "version = 1\n[swarm]\nfamily = \"metamodule\"\nkind = \"SRS\"\ncount = 5\n\
                 floor = {{ min = [0, 0], max = [12, 12] }}\n[[goal]]\nshape = {{ box = [5, 5] }}\n\
                 [protocol]\nstrategy = \"{strategy}\"\n"
            )
        };
        let steered = [&own[..], &["hold", "goto", "take", "swap", "release"]].concat();
        let world = ["block", "unblock", "goal.move", "goal.set"];
        let last = ["goal.turn", "goal.order", "goal.drop"];
        assert_eq!(verbs(&metamodules("negotiated")), [&steered[..], &world, &last, &links].concat());
        assert_eq!(verbs(&metamodules("slope")), [&steered[..], &world, &["tune"], &last, &links].concat());
        assert_eq!(verbs(&metamodules("planned")), [&own[..], &world[..3], &last[..2], &links].concat());
    }

    #[test]
    fn what_the_level_refuses_is_named() {
        let goals = ["goal.move", "goal.set", "tune", "goal.turn", "goal.order", "goal.drop"];
        let steered = ["hold", "goto", "take", "swap"];
        for (level, refused) in [
            ("shared", [].to_vec()),
            ("full", [&steered[..], &["release"]].concat()),
            ("safe", goals.to_vec()),
            ("teleoperation", [&["release"], &goals[..]].concat()),
        ] {
            let text = format!(
                "version = 1\n[swarm]\nfamily = \"metamodule\"\nkind = \"SRS\"\ncount = 5\n\
                 floor = {{ min = [0, 0], max = [12, 12] }}\n[[goal]]\nshape = {{ box = [5, 5] }}\n\
                 [protocol]\nstrategy = \"slope\"\n[operator]\nkind = \"person\"\nlevel = \"{level}\"\n"
            );
            let plan =
                read_text("levels.toml", &text, &Overrides::default()).unwrap_or_else(|e| panic!("{e}"));
            let forms = of(&plan, family_of(&plan));
            let refusals: Vec<_> = forms.iter().filter_map(|f| Some((f.verb, f.refused.as_ref()?))).collect();
            assert_eq!(refusals.iter().map(|(verb, _)| *verb).collect::<Vec<_>>(), refused, "{level}");
            assert!(refusals.iter().all(|(_, why)| why.contains(level)), "{refusals:?}");
        }
    }
}
