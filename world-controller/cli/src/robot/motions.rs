//! Queries of the motion database.

use super::{Answer, RobotError};
use clap::Args;
use metamorph_console::output::Outputs;
use metamorph_console::output_kind::OutputKind;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::database::{CellSet, Database, Direction, Table, Transition, VERSION};
use metamorph_protocol::roombots::posture::Posture;
use metamorph_protocol::roombots::shape::Shape;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

#[derive(Args, Clone, Debug)]
pub struct MovesArgs {
    /// single, PAR, SRS, PER or SRZ
    kind: Kind,
    /// Show the shortest plan to this shape: I, L, S, U or 3D-S
    #[arg(long)]
    to: Option<String>,
    /// Start of the plan: lattice angles in degrees, separated by commas; default: all zero
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true, requires = "to")]
    from: Vec<f64>,
}

/// Lists the shapes of a kind, or of all metamodules.
pub fn shapes(database: &Database, kind: Option<Kind>) -> Answer {
    let kinds = kind.map_or(Kind::METAMODULES.to_vec(), |k| vec![k]);
    let mut text = String::from("kind   shape  postures  cell chains  example of joint angles\n");
    let mut list = Vec::new();
    for kind in kinds {
        let table = database.table(kind);
        for shape in Shape::ALL {
            let chains: Vec<_> = table.chains().iter().filter(|c| c.shape == shape).collect();
            let postures: usize = chains.iter().map(|c| c.postures.len()).sum();
            let first = chains.iter().flat_map(|c| &c.postures).min();
            let example = first.map(|p| table.postures()[usize::from(*p)].posture.degrees());
            let shown = example.as_ref().map_or("never with lattice angles".to_owned(), |q| format!("{q:?}"));
            let _ = writeln!(
                text,
                "{kind:6} {shape:5}  {postures:8}  {:11}  {shown}",
                chains.len(),
                kind = kind.name(),
                shape = shape.name()
            );
            list.push(json!({
                "kind": kind, "shape": shape.name(), "postures": postures,
                "cell_chains": chains.iter().map(|c| &c.cells).collect::<Vec<_>>(),
                "example": example,
            }));
        }
    }
    Answer::new(text, json!({"shapes": list}))
}

/// Lists the landings and steps of a kind, or a plan to a shape.
pub fn moves(database: &Database, args: &MovesArgs) -> Result<Answer, RobotError> {
    let table = database.table(args.kind);
    match &args.to {
        None => Ok(listing(table)),
        Some(name) => way(database, table, name, &args.from),
    }
}

fn listing(table: &Table) -> Answer {
    let kind = table.kind();
    let main = table.postures().iter().filter(|p| p.main).count();
    let strict = table.strict_steps().count();
    let mut text = format!(
        "{kind}: {} postures above the floor, {main} of them connected by {strict} strict steps \
         ({} with 3.2 mm of plate in the floor)\n\n",
        table.postures().len(),
        table.steps().len(),
    );
    let _ = writeln!(text, "{} landings of the head, (dx, dy, class): joint angles", table.landings().len());
    let mut landings = Vec::new();
    for landing in table.landings() {
        let degrees: Vec<Vec<i16>> =
            landing.postures.iter().map(|p| table.postures()[usize::from(*p)].posture.degrees()).collect();
        let _ = writeln!(text, "{:12}  {degrees:?}", landing.state.to_string());
        landings.push(json!({"state": landing.state, "joint_angles": degrees}));
    }
    let mut pairs: BTreeMap<(Shape, Shape), usize> = BTreeMap::new();
    for step in table.strict_steps() {
        let shape = |p: u16| table.chains()[usize::from(table.postures()[usize::from(p)].chain)].shape;
        let (a, b) = (shape(step.from), shape(step.to));
        *pairs.entry((a.min(b), a.max(b))).or_default() += 1;
    }
    text.push_str("\nstrict steps by shape before and after (either way)\n");
    for ((a, b), n) in &pairs {
        let _ = writeln!(text, "{:>4} - {:4} {n:5}", a.name(), b.name());
    }
    let by_pair: Vec<Value> =
        pairs.iter().map(|((a, b), n)| json!({"shapes": [a.name(), b.name()], "steps": n})).collect();
    let json = json!({
        "kind": kind, "postures": table.postures().len(), "main_postures": main,
        "strict_steps": strict, "steps": table.steps().len(),
        "landings": landings, "strict_steps_by_shapes": by_pair,
    });
    Answer::new(text, json)
}

fn way(database: &Database, table: &Table, name: &str, from: &[f64]) -> Result<Answer, RobotError> {
    let kind = table.kind();
    let shape = Shape::ALL.into_iter().find(|s| s.name().eq_ignore_ascii_case(name)).ok_or_else(|| {
        RobotError::Usage(format!("`{name}` is not a shape; write one of I, L, S, U, 3D-S"))
    })?;
    let start = if from.is_empty() { Posture::zero(kind) } else { Posture::from_degrees(kind, from, 1e-6)? };
    let Some(id) = table.find(start) else {
        return Err(RobotError::Usage(format!(
            "--from: {:?} puts a cube below the floor; start from a posture above it",
            start.degrees()
        )));
    };
    let Some(way) = table.path_to_shape(id, shape) else {
        return Err(RobotError::OutOfReach(format!(
            "{kind} cannot take shape {shape} from {:?} by strict steps; `metamorph robot shapes {kind}` \
             lists its shapes",
            start.degrees()
        )));
    };
    Ok(describe(database, table, &way, shape))
}

fn describe(database: &Database, table: &Table, way: &Transition, shape: Shape) -> Answer {
    let degrees = |p: u16| table.postures()[usize::from(p)].posture.degrees();
    let cells = |set: &CellSet| -> Vec<Cell> { database.resolve(set).collect() };
    let mut text =
        format!("{} steps to shape {shape}, starting at {:?}\n", way.steps.len(), degrees(way.postures[0]));
    let mut steps = Vec::new();
    for ((i, direction), to) in way.steps.iter().zip(&way.postures[1..]) {
        let step = &table.steps()[usize::from(*i)];
        let size = if step.joint % 3 == 1 { 90 } else { 120 };
        let by = if *direction == Direction::Forward { size } else { -size };
        let _ = writeln!(text, "joint {} by {by:4}°  to {:?}", step.joint + 1, degrees(*to));
        steps.push(json!({
            "joint": step.joint + 1, "by_degrees": by, "to": degrees(*to),
            "core": cells(&step.core), "graze": cells(&step.graze),
        }));
    }
    let (core, graze) = (cells(&way.core), cells(&way.graze));
    let _ = writeln!(text, "cells that must be free: {core:?}\ncells it grazes: {graze:?}");
    let json = json!({
        "kind": table.kind(), "shape": shape.name(), "from": degrees(way.postures[0]),
        "steps": steps, "core": core, "graze": graze,
    });
    Answer::new(text, json)
}

/// Describes the contents of the database, and writes its bytes if asked to.
pub fn database_summary(database: &Database, out: Option<PathBuf>) -> Result<Answer, RobotError> {
    let bytes = database.to_bytes();
    if let Some(path) = &out {
        Outputs::new().writes("--out", path, OutputKind::MotionDatabase)?.write(&bytes)?;
    }
    let mut text = format!(
        "motion database version {VERSION}: {} bytes, {} cells\n",
        bytes.len(),
        database.cells().len()
    );
    text.push_str("kind    postures  main  strict steps  steps  cell chains  landings\n");
    let mut kinds = Vec::new();
    for kind in Kind::ALL {
        let t = database.table(kind);
        let main = t.postures().iter().filter(|p| p.main).count();
        let strict = t.strict_steps().count();
        let (postures, steps, chains, landings) =
            (t.postures().len(), t.steps().len(), t.chains().len(), t.landings().len());
        let _ = writeln!(
            text,
            "{:6} {postures:9} {main:5} {strict:13} {steps:6} {chains:12} {landings:9}",
            kind.name()
        );
        kinds.push(json!({
            "kind": kind, "postures": postures, "main": main, "strict_steps": strict,
            "steps": steps, "cell_chains": chains, "landings": landings,
        }));
    }
    let json =
        json!({"version": VERSION, "bytes": bytes.len(), "cells": database.cells().len(), "kinds": kinds});
    Ok(Answer::new(text, json))
}
