//! Forward and inverse kinematics, in degrees and cells.

use super::{Answer, RobotError};
use clap::{Args, ValueEnum};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::chain::{Chain, Pose, forward};
use metamorph_protocol::roombots::collision::contact;
use metamorph_protocol::roombots::connector::{Site, connector_pose};
use metamorph_protocol::roombots::grid::{GridState, landing};
use metamorph_protocol::roombots::inverse::levenberg_marquardt::{Options, solve_from_random_starts};
use metamorph_protocol::roombots::inverse::solve;
use metamorph_protocol::roombots::posture::Posture;
use metamorph_protocol::roombots::shape::Shape;
use metamorph_protocol::roombots::torque::{Limits, Load, torques};
use serde_json::{Value, json};
use std::fmt::Write;

#[derive(Args, Clone, Debug)]
pub struct FkArgs {
    /// single, PAR, SRS, PER or SRZ
    kind: Kind,
    /// Joint angles in degrees from the foot on: 3 for a module, 6 for a metamodule
    #[arg(required = true, allow_negative_numbers = true)]
    angles: Vec<f64>,
    /// Also print the pose of this connector, such as C1Y or 2:C3X; `all` for all of them
    #[arg(long)]
    connector: Option<String>,
    /// Mass on the head plate in kilograms, for the torques
    #[arg(long, default_value_t = 0.0)]
    payload: f64,
}

#[derive(Args, Clone, Debug)]
pub struct IkArgs {
    /// single, PAR, SRS, PER or SRZ
    kind: Kind,
    /// Head plate on the floor: cell and class, such as 2,1,3
    #[arg(long, value_name = "X,Y,CLASS", value_delimiter = ',', allow_hyphen_values = true)]
    grid: Option<Vec<i16>>,
    /// Pose of the head frame: the three rows of its 3×4 matrix, 12 numbers, lengths in cells
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true, conflicts_with = "grid")]
    matrix: Option<Vec<f64>>,
    /// The pose given by these joint angles in degrees
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true, conflicts_with_all = ["grid", "matrix"])]
    like: Option<Vec<f64>>,
    /// The solver
    #[arg(long, value_enum, default_value_t = Solver::All)]
    solver: Solver,
    /// Random starts of the damped solver
    #[arg(long, default_value_t = 10)]
    starts: u32,
    /// Seed of the random starts
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Solver {
    /// All solutions, from the structure of the chain
    All,
    /// One solution, by damped least squares
    Damped,
}

/// Converts degrees to the angles of the model.
pub fn radians(angles: &[f64]) -> Vec<f64> {
    angles.iter().map(|a| a.to_radians()).collect()
}

fn rows(pose: &Pose) -> [[f64; 4]; 3] {
    // Adding zero turns −0 into 0.
    pose.rows().map(|r| r.map(|x| x + 0.0))
}

fn write_rows(text: &mut String, pose: &Pose) {
    for r in rows(pose) {
        let _ = writeln!(text, "  {:10.6} {:10.6} {:10.6}   {:10.6}", r[0], r[1], r[2], r[3]);
    }
}

pub fn fk(args: &FkArgs) -> Result<Answer, RobotError> {
    let kind = args.kind;
    let q = radians(&args.angles);
    let head = forward(kind, &q)?;
    if !args.payload.is_finite() || args.payload < 0.0 {
        return Err(RobotError::Usage(format!(
            "--payload: {} is not a mass; write kilograms, 0 or more",
            args.payload
        )));
    }
    let mut text = format!("{kind}: head frame, rotation and position in cells of 0.11 m\n");
    write_rows(&mut text, &head);

    let touch = contact(kind, &q)?;
    let floor_mm = (touch.floor * 110.0 * 100.0).round() / 100.0 + 0.0;
    let floor = if touch.floor > 1e-6 {
        format!("{floor_mm} mm below the floor")
    } else {
        "above the floor".to_owned()
    };
    let own = if touch.own_body { "cubes overlap" } else { "cubes do not overlap" };
    let _ = writeln!(text, "{floor}, {own}");

    let on_lattice = write_lattice(&mut text, args);

    let load = Load { payload: args.payload, ..Load::floor() };
    let torques = torques(kind, &q, &load)?;
    text.push_str("static torque in Nm  exact  bound T^r  bound T^w  nominal\n");
    for (i, t) in torques.iter().enumerate() {
        let limit = Limits::NOMINAL.of(i);
        let mark = if t.exact > limit { "  too much" } else { "" };
        let _ = writeln!(
            text,
            "  joint {}           {:6.2} {:10.2} {:10.2} {limit:8.1}{mark}",
            i + 1,
            t.exact,
            t.reasonable,
            t.worst
        );
    }

    let connectors = write_connectors(&mut text, args, &q)?;
    let json = json!({
        "kind": kind, "joint_angles": args.angles, "head": rows(&head),
        "floor_penetration_mm": floor_mm.max(0.0), "self_collision": touch.own_body,
        "lattice": on_lattice,
        "torque_nm": torques.iter().map(|t| json!({
            "exact": t.exact, "reasonable": t.reasonable, "printed": t.printed, "worst": t.worst,
        })).collect::<Vec<_>>(),
        "connectors": connectors,
    });
    Ok(Answer::new(text, json))
}

/// Writes the cells and the landing of a posture of the lattice, and returns them; null between postures.
fn write_lattice(text: &mut String, args: &FkArgs) -> Value {
    let kind = args.kind;
    let Ok(posture) = Posture::from_degrees(kind, &args.angles, 1e-9) else { return Value::Null };
    let placement = posture.placement();
    let cells: &[Cell] = &placement.cells[..kind.cubes()];
    let d = placement.directions;
    let shape = (kind != Kind::Single).then(|| Shape::of([d[0], d[1], d[2]])).flatten();
    let lands = landing(posture);
    let _ = write!(text, "cells {cells:?}");
    if let Some(shape) = shape {
        let _ = write!(text, ", shape {shape}");
    }
    if let Some(state) = lands {
        let _ = write!(text, ", head lands on {state}");
    }
    text.push('\n');
    json!({"cells": cells, "shape": shape.map(Shape::name), "landing": lands})
}

/// Writes the poses of the connectors asked for, and returns them.
fn write_connectors(text: &mut String, args: &FkArgs, q: &[f64]) -> Result<Vec<Value>, RobotError> {
    let kind = args.kind;
    let mut connectors = Vec::new();
    for site in sites(kind, args.connector.as_deref())? {
        let pose = connector_pose(kind, q, site)?;
        let n = -pose.rotation.column(2);
        let _ = writeln!(
            text,
            "{:6} at ({:.4}, {:.4}, {:.4}), outward normal ({:.4}, {:.4}, {:.4})",
            site.to_string(),
            pose.origin.x + 0.0,
            pose.origin.y + 0.0,
            pose.origin.z + 0.0,
            n.x + 0.0,
            n.y + 0.0,
            n.z + 0.0
        );
        connectors.push(json!({"connector": site.to_string(), "pose": rows(&pose)}));
    }
    Ok(connectors)
}

fn sites(kind: Kind, wanted: Option<&str>) -> Result<Vec<Site>, RobotError> {
    match wanted {
        None => Ok(Vec::new()),
        Some(all) if all.eq_ignore_ascii_case("all") => Ok(Site::all(kind).collect()),
        Some(name) => Ok(vec![name.parse()?]),
    }
}

fn target(args: &IkArgs) -> Result<Pose, RobotError> {
    if let Some(grid) = &args.grid {
        let [x, y, class] = grid[..] else {
            return Err(RobotError::Usage(format!(
                "--grid takes a cell and a class, such as 2,1,3, but there are {} numbers",
                grid.len()
            )));
        };
        let class = u8::try_from(class).ok().filter(|c| *c < 4).ok_or_else(|| {
            RobotError::Usage(format!("--grid: the class {class} is not one of 0, 1, 2, 3"))
        })?;
        return Ok(GridState::new(x.clamp(-99, 99), y.clamp(-99, 99), class).pose().into());
    }
    if let Some(m) = &args.matrix {
        if m.len() != 12 {
            return Err(RobotError::Usage(format!(
                "--matrix takes the three rows of a 3×4 matrix, 12 numbers, but there are {}",
                m.len()
            )));
        }
        return Ok(Pose::from_rows([0, 4, 8].map(|i| [m[i], m[i + 1], m[i + 2], m[i + 3]])));
    }
    if let Some(angles) = &args.like {
        return Ok(forward(args.kind, &radians(angles))?);
    }
    Err(RobotError::Usage(
        "specify the pose of the head: --grid X,Y,CLASS, --matrix with 12 numbers, or --like with joint angles"
            .to_owned(),
    ))
}

pub fn ik(args: &IkArgs) -> Result<Answer, RobotError> {
    let kind = args.kind;
    let target = target(args)?;
    let found = match args.solver {
        Solver::All => solve(kind, &target).map(|s| s.into_iter().map(|s| (s.q, s.residual)).collect()),
        Solver::Damped => damped(args, &target)?,
    };
    let solutions: Vec<(Vec<f64>, f64)> = match found {
        Ok(solutions) => solutions,
        Err(error) => {
            let failure = RobotError::from(error);
            if matches!(failure, RobotError::Kinematics(_)) {
                return Err(failure);
            }
            let json = json!({"kind": kind, "solutions": [], "reason": failure.to_string()});
            return Ok(Answer { text: String::new(), json, failure: Some(failure) });
        }
    };
    let mut text = format!("{kind}: {} solution(s), joint angles in degrees\n", solutions.len());
    let mut list = Vec::new();
    for (q, residual) in &solutions {
        let degrees: Vec<f64> = q.iter().map(|a| a.to_degrees()).collect();
        let touch = contact(kind, q)?;
        let mut notes = Vec::new();
        if touch.floor > 1e-6 {
            notes.push("below the floor");
        }
        if touch.own_body {
            notes.push("cubes overlap");
        }
        for a in &degrees {
            let _ = write!(text, "{:10.4}", a + 0.0);
        }
        let _ = writeln!(text, "   residual {residual:.0e}  {}", notes.join(", "));
        list.push(json!({
            "joint_angles": degrees, "residual": residual,
            "below_floor": touch.floor > 1e-6, "self_collision": touch.own_body,
        }));
    }
    Ok(Answer::new(text, json!({"kind": kind, "target": rows(&target), "solutions": list})))
}

type Found = Result<Vec<(Vec<f64>, f64)>, metamorph_protocol::roombots::inverse::InverseError>;

fn damped(args: &IkArgs, target: &Pose) -> Result<Found, RobotError> {
    target.checked(1e-6)?;
    let chain = Chain::of(args.kind);
    let mut stream = Rng::named(args.seed, "robot ik", 0);
    let starts = args.starts.clamp(1, 10_000);
    let outcome = solve_from_random_starts(&chain, target, starts, &mut stream, &Options::default());
    if outcome.reached {
        return Ok(Ok(vec![(outcome.q, outcome.residual)]));
    }
    Err(RobotError::OutOfReach(format!(
        "not reached from {starts} random starts, with a residual of {:.3} (cells and radians); the pose may be out of \
         reach, which `--solver all` decides",
        outcome.residual
    )))
}
