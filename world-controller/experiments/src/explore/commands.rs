//! Draws commands of an operator to the swarm of a generated scenario.

use super::generated_scenario::{Break, GeneratedFault, GeneratedScenario};
use metamorph_families::generated::Dice;
use metamorph_processes::family::Family;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::time::Span;
use metamorph_sim_bridge::director::faults::{Fault, Form, Target, WorldFault};
use metamorph_sim_bridge::director::link_faults::LinkFault;
use metamorph_sim_bridge::director::steering::Steering;

/// Number of the first seed that may draw commands. Smaller seeds draw the same scenarios as before these were added.
pub const COMMANDS_FROM: u64 = 1 << 33;
/// Number of the first seed that may draw every command, for every family. Smaller ones draw four that steer
/// metamodules.
pub const ALL_COMMANDS_FROM: u64 = 1 << 34;
/// Number of the first seed that may draw the commands about goals that were added last.
pub const GOALS_FROM: u64 = 1 << 35;
/// The names of these commands.
const ADDED: [&str; 3] = ["goal.turn", "goal.order", "goal.drop"];

/// Commands of a run at most, where four are drawn and where all are.
const MOST: (u64, u64) = (4, 8);

/// Draws commands, in half of the runs.
pub fn draw(draft: &GeneratedScenario, family: &dyn Family) -> Vec<GeneratedFault> {
    let all = draft.seed >= ALL_COMMANDS_FROM;
    let mut dice = Dice(Rng::named(draft.seed, "explore, commands", 0));
    if draft.seed < COMMANDS_FROM || !(all || family.is_operated()) || dice.once_in(2) {
        return Vec::new();
    }
    let horizon = dice.pick(&[5_000, 20_000, 60_000]);
    if !all {
        return (0..1 + draft.seed % MOST.0).map(|_| steered(&mut dice, draft, horizon)).collect();
    }
    let (kinds, mut world) = (1 + dice.0.below(15), family.commanded_to_world());
    world.retain(|kind| draft.seed >= GOALS_FROM || !ADDED.contains(&kind.name));
    let mut commands: Vec<GeneratedFault> = Vec::new();
    for _ in 0..dice.within(1, MOST.1) {
        // Each kind is left out in half of the runs.
        let kind = dice.pick(&[0, 0, 1, 2, 3]);
        if kinds >> kind & 1 == 0 {
            continue;
        }
        let at = dice.within(1, horizon / 10) * 10;
        let (what, end) = match kind {
            0 => (steering(&mut dice, draft), None),
            1 => process(&mut dice, draft),
            2 => (links(&mut dice, draft), None),
            _ => match to_world(&mut dice, draft, &world, &commands) {
                Some(fault) => (fault, None),
                None => continue,
            },
        };
        let until = end.map(|_| at + dice.pick(&[500, 3_000, 15_000, 60_000]));
        commands.push(GeneratedFault { what: Break::Command(what, end), at, until });
    }
    commands
}

fn module(dice: &mut Dice, draft: &GeneratedScenario) -> ModuleId {
    ModuleId(dice.0.below(draft.modules() as u64) as u32)
}

fn lease(dice: &mut Dice) -> Span {
    Span::secs(dice.pick(&[1, 5, 20, 60]))
}

/// Draws one of the commands that were drawn first.
fn steered(dice: &mut Dice, draft: &GeneratedScenario, horizon: u64) -> GeneratedFault {
    let (id, lease) = (module(dice, draft), lease(dice));
    let steering = match dice.0.below(6) {
        0 | 1 => Steering::Hold(lease),
        2 => Steering::Take(seed(dice, draft), lease),
        3 => Steering::Release,
        _ => {
            let mut side = || dice.within(0, 12) as i16;
            Steering::GoTo(Cell { x: side(), y: side(), z: 0 }, lease)
        }
    };
    let at = dice.within(1, horizon / 10) * 10;
    GeneratedFault { what: Break::Command(Fault::Steer(id, steering), None), at, until: None }
}

fn seed(dice: &mut Dice, draft: &GeneratedScenario) -> u8 {
    dice.0.below(draft.goal_cells().clamp(1, 32) as u64) as u8
}

/// Draws what one module is to do; some will be refused.
fn steering(dice: &mut Dice, draft: &GeneratedScenario) -> Fault {
    let (id, lease) = (module(dice, draft), lease(dice));
    let steering = match dice.0.below(8) {
        0 | 1 => Steering::Hold(lease),
        2 => Steering::Take(seed(dice, draft), lease),
        3 => Steering::Release,
        4 => Steering::Swap(module(dice, draft)),
        _ => {
            let mut side = || dice.within(0, 14) as i16 - 2;
            let (x, y) = (side(), side());
            Steering::GoTo(Cell { x, y, z: dice.pick(&[0, 0, 0, 1]) }, lease)
        }
    };
    Fault::Steer(id, steering)
}

/// Draws what befalls a process or a body, and its end.
fn process(dice: &mut Dice, draft: &GeneratedScenario) -> (Fault, Option<Fault>) {
    let id = module(dice, draft);
    match dice.0.below(4) {
        0 => (Fault::Kill(id), None),
        1 => (Fault::Restart(id), None),
        2 => (Fault::Pause(id), Some(Fault::Resume(id))),
        _ => (Fault::Stick(id), Some(Fault::Unstick(id)).filter(|_| !dice.once_in(3))),
    }
}

/// Draws what befalls the links.
fn links(dice: &mut Dice, draft: &GeneratedScenario) -> Fault {
    let lease = lease(dice);
    Fault::Links(match dice.0.below(6) {
        0 => LinkFault::LossEnds,
        1 => LinkFault::PartitionEnds,
        2 | 3 => {
            let percent = dice.pick(&[5, 20, 50, 100]);
            LinkFault::Loss(Ratio::new(percent, 100).unwrap_or(Ratio::ONE), lease)
        }
        _ => {
            let (one, other) = (module(dice, draft), module(dice, draft));
            LinkFault::Partition(one.min(other), one.max(other), lease)
        }
    })
}

/// Draws what befalls the world or the goal; `None` if there is nothing that it could hit.
fn to_world(
    dice: &mut Dice,
    draft: &GeneratedScenario,
    world: &[&'static WorldFault],
    before: &[GeneratedFault],
) -> Option<Fault> {
    let kind = *world.get(dice.0.below(world.len().max(1) as u64) as usize)?;
    let target = match kind.form {
        Form::Cell if kind.harms => Target::Cell(draft.swarm.obstacle(dice)?),
        // A command that ends a fault takes the cell of the latest fault that was drawn before.
        Form::Cell => before.iter().rev().find_map(|fault| match fault.what {
            Break::Command(Fault::World(_, target @ Target::Cell(_)), _) => Some(target),
            _ => None,
        })?,
        Form::Shift => {
            let mut along = || dice.within(0, 6) as i16 - 3;
            Target::Shift(along(), along())
        }
        // One more than there are, to be refused.
        Form::Element => Target::Element(dice.0.below(u64::from(draft.swarm.elements()) + 1) as u16),
        Form::Number => Target::Number(dice.0.below(3) as u16),
        Form::Word(words) => Target::Word(dice.pick(words)),
        Form::Nothing => Target::Nothing,
    };
    Some(Fault::World(kind, target))
}

#[cfg(test)]
mod tests {
    use super::super::draw::draw;
    use super::*;
    use metamorph_processes::family::all;
    use std::collections::BTreeSet;

    fn commands(seed: u64, family: &'static dyn Family) -> Vec<Fault> {
        let (draft, _) = draw(seed, Some(family));
        let begun = draft.faults.iter().filter_map(|fault| match fault.what {
            Break::Command(fault, _) => Some(fault),
            _ => None,
        });
        begun.collect()
    }

    /// Commands are drawn for families that obey them, and smaller seeds draw none.
    #[test]
    fn operators_may_command() {
        let metamodules = all().iter().copied().find(|family| family.is_operated()).unwrap();
        let has_commands = |seed: u64| !commands(seed, metamodules).is_empty();
        assert!((0..100).all(|seed| !has_commands(seed)));
        assert!((COMMANDS_FROM..COMMANDS_FROM + 100).filter(|seed| has_commands(*seed)).count() > 20);
    }

    /// Later seeds draw every command of the family.
    #[test]
    fn every_command_is_drawn() {
        let own = [
            "kill",
            "restart",
            "pause",
            "stick",
            "goto",
            "take",
            "hold",
            "swap",
            "release",
            "loss",
            "partition",
        ];
        for family in all().iter().copied().filter(|family| family.is_drawn()) {
            let world = family.commanded_to_world();
            let verbs: BTreeSet<&str> = own.into_iter().chain(world.iter().map(|kind| kind.name)).collect();
            let seeds = GOALS_FROM..GOALS_FROM + 400;
            let drawn: Vec<String> =
                seeds.flat_map(|seed| commands(seed, family)).map(|fault| fault.to_string()).collect();
            let drawn: BTreeSet<&str> = drawn.iter().filter_map(|text| text.split(' ').next()).collect();
            assert_eq!(drawn, verbs, "{}", family.name());
        }
    }
}
