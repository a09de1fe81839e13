//! The description of a walking structure, for `metamorph check`.

use super::{BODY, STRATEGY, Walk};
use metamorph_protocol::free_module::network::{Lags, Morphology};
use metamorph_sim_bridge::free_module::rapier::ENGINE;
use metamorph_text::escape::Shown;
use metamorph_text::format::many;
use std::fmt::Write;

/// Writes the description.
pub fn describe(out: &mut String, walk: &Walk) -> std::fmt::Result {
    let choice = &walk.choice;
    let modules = choice.structure.bound();
    let count = many(modules as u64, "free module");
    writeln!(out, "  swarm     {count}, numbered 0 to {}, body {BODY}, {ENGINE}", modules - 1)?;
    write!(out, "  start     {}, {} down, friction {}", walk.start.shown(), walk.down, walk.friction)?;
    if walk.slope_deg > 0.0 {
        write!(out, ", ground rises by {} degrees", walk.slope_deg)?;
    }
    writeln!(out)?;
    let morphology = Morphology::of(&choice.structure);
    if let Ok(network) = morphology.network(choice.network) {
        let oscillators = many(network.oscillators.len() as u64, "oscillator");
        let parameters = many(network.parameters(Lags::Tree) as u64, "parameter");
        writeln!(out, "  network   {}: {oscillators}, {parameters}", choice.network)?;
    }
    writeln!(out, "  goal      walk at least {}", walk.goal)?;
    let known = many(choice.known.len() as u64, "known gait");
    let learner = match choice.method {
        Some(method) => format!("then {method}, {} at most", many(choice.trials.into(), "gait")),
        None => "none is learnt".to_owned(),
    };
    writeln!(out, "  protocol  {STRATEGY}: {known}, {learner}, {} each", walk.trial)
}
