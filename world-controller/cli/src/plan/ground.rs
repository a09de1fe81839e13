//! Reads how a structure stands: `--floor`, `--gravity`, `--hold` and `--up`.

use super::{PlanArgs, Up};
use metamorph_free_modules::plan::PlanError;
use metamorph_free_modules::plan::document::GroundEntry;
use metamorph_protocol::assembly::configuration::Configuration;
use metamorph_protocol::assembly::ground::{Fall, Ground, held_at, rotated};
use metamorph_protocol::assembly::tables::{Rot, TABLES};

/// Returns the start as it stands and what it stands on, both in the terms of a plan file and of the planner's rules;
/// `None` in free assembly.
pub fn standing(
    args: &PlanArgs,
    start: &Configuration,
) -> Result<Option<(Configuration, GroundEntry, Ground)>, PlanError> {
    if !args.floor && !args.gravity {
        return match (&args.hold, args.up) {
            (None, Up::Z) => Ok(None),
            (hold, _) => {
                let place = if hold.is_some() { "--hold" } else { "--up" };
                let reason = "in free assembly nothing is held, and no direction is up";
                Err(PlanError::option(place, reason, "add --floor or --gravity"))
            }
        };
    }
    let (module, head) = held(args.hold.as_deref().unwrap_or("0"), start.len())?;
    let raised = rotated(start, to_up(args.up));
    let start = held_at(&raised, module, head).expect("invariant: the module exists");
    let lowest = start.modules().iter().flat_map(|m| m.cells()).map(|c| c[2]).min();
    let ground = Ground { floor: lowest.filter(|_| args.floor), gravity: args.gravity };
    ground.check(&start).map_err(|fall| {
        let fix = match fall {
            Fall::Overloaded { .. } => {
                "hold it nearer to its middle by --hold, turn it by --up, or add --floor"
            }
            Fall::NotHeld | Fall::BelowFloor(_) => "hold another module by --hold",
        };
        PlanError::option("--from", format!("the start does not stand: {fall}"), fix)
    })?;
    Ok(Some((start, GroundEntry { module, head, floor: args.floor, gravity: args.gravity }, ground)))
}

fn held(text: &str, modules: usize) -> Result<(usize, bool), PlanError> {
    let wrong = |reason: String| {
        let fix = format!("write a module from 0 to {}, such as 0 or 0:head", modules - 1);
        PlanError::option(&format!("--hold {text}"), reason, fix)
    };
    let (number, head) = match text.split_once(':') {
        None => (text, false),
        Some((number, "head")) => (number, true),
        Some((_, other)) => return Err(wrong(format!("a module has no end `{other}`"))),
    };
    let module: usize = number.parse().map_err(|_| wrong("this is not a number".to_owned()))?;
    if module < modules { Ok((module, head)) } else { Err(wrong("there is no such module".to_owned())) }
}

/// Returns a rotation that takes a direction to +z.
fn to_up(up: Up) -> Rot {
    let direction = match up {
        Up::X => [1, 0, 0],
        Up::NegativeX => [-1, 0, 0],
        Up::Y => [0, 1, 0],
        Up::NegativeY => [0, -1, 0],
        Up::Z => [0, 0, 1],
        Up::NegativeZ => [0, 0, -1],
    };
    let number = TABLES.rotations.iter().position(|r| r.apply(direction) == [0, 0, 1]);
    number.expect("invariant: some rotation takes any axis to any other") as Rot
}
