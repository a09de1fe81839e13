//! Which actions of a plan must come after which.
//!
//! Two turns are independent if the parts that they move have no module in common and cannot reach the same
//! cell. An attachment or a detachment changes what turns move, so its order relative to all other actions is
//! kept.

use super::action::{Action, Rules};
use super::configuration::{Configuration, Links, at_hemispheres};
use super::tables::sub;

/// The order of a plan.
pub struct Order {
    /// For each action, the actions that must be done before it, except those that follow from others in the
    /// list.
    pub after: Vec<Vec<usize>>,
    /// Actions one after another if independent ones are carried out together.
    pub makespan: u32,
    /// Cubes lifted, summed over all turns; of each turn those of the smaller side.
    pub lifted: u32,
}

/// Modules and cells that a turn moves.
struct Moved {
    modules: u16,
    cubes: u32,
    /// The box of cells that the part may reach.
    low: [i16; 3],
    high: [i16; 3],
}

/// Determines the order of a plan. Its actions must be possible one after another.
pub fn of(rules: &Rules, start: &Configuration, actions: &[Action]) -> Order {
    let (mut at, mut lifted) = (*start, 0);
    let mut moved: Vec<Option<Moved>> = Vec::new();
    for action in actions {
        let part = part(&at, *action);
        lifted += part.as_ref().map_or(0, |p| p.cubes);
        moved.push(part);
        at = rules.apply(&at, *action).expect("invariant: plans are possible");
    }
    let mut after: Vec<Vec<usize>> = Vec::new();
    let mut before: Vec<Vec<bool>> = Vec::new();
    let mut depth: Vec<u32> = Vec::new();
    for i in 0..actions.len() {
        let (mut known, mut direct, mut deepest) = (vec![false; i], Vec::new(), 0);
        for j in (0..i).rev() {
            // On the ground two turns at once may bear more than one after the other.
            let free = rules.ground.is_none() && independent(moved[i].as_ref(), moved[j].as_ref());
            if known[j] || free {
                continue;
            }
            direct.push(j);
            deepest = deepest.max(depth[j]);
            known[j] = true;
            before[j].iter().enumerate().for_each(|(k, b)| known[k] |= b);
        }
        direct.reverse();
        after.push(direct);
        before.push(known);
        depth.push(deepest + 1);
    }
    Order { after, makespan: depth.into_iter().max().unwrap_or(0), lifted }
}

fn independent(a: Option<&Moved>, b: Option<&Moved>) -> bool {
    let (Some(a), Some(b)) = (a, b) else { return false };
    a.modules & b.modules == 0 && (0..3).any(|i| a.high[i] < b.low[i] || b.high[i] < a.low[i])
}

/// Returns what a turn moves: the smaller side.
fn part(at: &Configuration, action: Action) -> Option<Moved> {
    let Action::Turn { module, joint, .. } = action else { return None };
    let connections = at.connections();
    let links = Links::of(at.len(), connections.iter().copied());
    let sides = at_hemispheres(&links, &connections, module);
    let split = usize::from(joint) + 1;
    let [front, behind] = [&sides[..split], &sides[split..]].map(|s| s.iter().fold(0, |all, m| all | m));
    let own = at.modules()[usize::from(module)].cells();
    // Cubes of the module itself that are beyond the joint, seen from either side.
    let cubes = |set: u16, own: u32| 2 * set.count_ones() + own;
    let front_cubes = cubes(front, u32::from(joint > 0));
    let behind_cubes = cubes(behind, u32::from(joint < 2));
    let (set, cubes) =
        if front_cubes <= behind_cubes { (front, front_cubes) } else { (behind, behind_cubes) };
    let pivot = own[usize::from(joint == 2)];
    let far = at.modules().iter().enumerate().filter(|(i, _)| set & 1 << i != 0 || *i == usize::from(module));
    let squares = far.flat_map(|(_, m)| m.cells()).map(|c| {
        let d = sub(c, pivot).map(i32::from);
        d.iter().map(|x| x * x).sum::<i32>()
    });
    // A cube reaches 0.58 cells from its centre, so one cell beyond the distance is enough.
    let reach = squares.max().unwrap_or(0).isqrt() as i16 + 1;
    let corner = |sign: i16| [0, 1, 2].map(|i| i16::from(pivot[i]) + sign * reach);
    Some(Moved { modules: set | 1 << module, cubes, low: corner(-1), high: corner(1) })
}
