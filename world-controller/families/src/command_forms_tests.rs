//! Tests that every command form a page offers is a valid command of the run.

use crate::{families, of as family_of};
use metamorph_scenario::{Overrides, Plan};
use metamorph_scene::command_forms::Parameter::{Cell, Lease, Modules, Number, Percent, Shift, Words};
use metamorph_scene::command_forms::{CommandForm, of};
use metamorph_sim_bridge::director::faults::Fault;
use metamorph_text::sources::NoFiles;

fn plan(text: &str) -> Plan {
    let read = metamorph_scenario::read_text(families(&NoFiles), "forms.toml", text, &Overrides::default());
    read.unwrap_or_else(|problems| panic!("{problems}"))
}

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
    let plan = plan(scenario);
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
        let plan = plan(&text);
        let forms = of(&plan, family_of(&plan));
        let refusals: Vec<_> = forms.iter().filter_map(|f| Some((f.verb, f.refused.as_ref()?))).collect();
        assert_eq!(refusals.iter().map(|(verb, _)| *verb).collect::<Vec<_>>(), refused, "{level}");
        assert!(refusals.iter().all(|(_, why)| why.contains(level)), "{refusals:?}");
    }
}
