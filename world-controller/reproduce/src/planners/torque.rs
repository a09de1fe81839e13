//! The torque experiment of thesis 5.1.4: one metamodule crosses the floor under limits of torque.

use super::PlannerTable;
use crate::Experiment;
use metamorph_families::metamodule::motion_database;
use metamorph_processes::family::sources;
use metamorph_protocol::manipulation::torque_walk::{Estimate, MoveGraph};
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::grid::GridState;
use metamorph_protocol::roombots::torque::Limits;
use metamorph_text::format::count;

/// The published task: from (0, 0) to (12, 5) with the same connection class.
const TASK: (GridState, GridState) = (GridState::new(0, 0, 0), GridState::new(12, 5, 0));
/// Connectors along x and y. The thesis gives the sum of all planes only, 458.
const FLOOR: (i16, i16) = (20, 13);

const LIMITS: [(&str, Limits); 3] = [
    ("5/2.5 Nm", Limits::EXPERIMENT),
    ("4/2 Nm", Limits::EXPERIMENT_LOW),
    ("4.9/3.6 Nm (table 2.1)", Limits::NOMINAL),
];

const ESTIMATES: [(Estimate, &str); 4] = [
    (Estimate::Worst, "T^w"),
    (Estimate::Printed, "T^r as printed (force at the last pivot)"),
    (Estimate::Reasonable, "T^r with the force at the centre of mass"),
    (Estimate::Exact, "exact static torque"),
];

/// Makes the table.
pub fn table() -> PlannerTable {
    let mut table = PlannerTable::new(Experiment::Torque);
    let database = motion_database::database(sources());
    let row = |kind, estimate, limits| {
        let motions = database.table(kind);
        let moves = MoveGraph::new(motions, estimate, limits);
        let found = match moves.walk(motions, TASK.0, TASK.1, FLOOR) {
            Some(walk) => format!("{} moves, {}°", walk.moves, walk.degrees),
            None => "impossible".to_owned(),
        };
        let (postures, landings) = (count(moves.postures as u64), moves.landings.len());
        (found.clone(), format!("{found} ({postures} postures, {landings} landing states)"))
    };
    let mut printed = String::new();
    for kind in [Kind::Par, Kind::Srs] {
        table.row(format!("{kind}, no limit"), "", row(kind, Estimate::None, Limits::NOMINAL).1);
        for (estimate, name) in ESTIMATES {
            for (limits_name, limits) in LIMITS {
                let published = match (kind, estimate, limits_name) {
                    (Kind::Par, Estimate::Printed, "5/2.5 Nm") => "done; larger angular displacement",
                    (Kind::Par, Estimate::Printed, "4/2 Nm") => "done; more moves (figure 5.10, in words)",
                    _ => "",
                };
                let (found, ours) = row(kind, estimate, limits);
                if kind == Kind::Par && estimate == Estimate::Printed && limits_name != LIMITS[2].0 {
                    printed = format!(
                        "{printed}{}{limits_name}: {found}",
                        if printed.is_empty() { "" } else { ", " }
                    );
                }
                table.row(format!("{kind}, {name}, {limits_name}"), published, ours);
            }
        }
    }
    table.notes = vec![
        format!("with T^r as printed the published task of PAR is, at {printed}; it puts the force at the last pivot, so it is not below T^w"),
        "figure 5.10 in words: at the low limit more moves, smaller angular displacement. With exact torque the moves are equal at both limits, and the displacement rises; more moves appear with T^w only".to_owned(),
        "seven moves are the least: a stride changes |dx| + |dy| by at most 3 and by an odd number, and the offset is 17".to_owned(),
        "fewest moves, then least joint travel, from the upright posture; 20 × 13 connectors, since the thesis gives only the number of all connectors".to_owned(),
    ];
    table
}
