//! Queries about the colour of cells: that no lattice motion changes it, and that motions between the lattice postures do.

use super::elements::{element, metamodule};
use super::{Answer, RobotError};
use clap::Args;
use metamorph_protocol::manipulation::colour::{ACTIONS, RandomWalks};
use metamorph_protocol::manipulation::load::LoadLimits;
use metamorph_protocol::manipulation::off_lattice::change::{changes, grips, plan_with_change};
use metamorph_protocol::manipulation::scene::Scene;
use metamorph_protocol::manipulation::terrain::Terrain;
use metamorph_protocol::manipulation::walking::WalkingGround;
use metamorph_protocol::manipulation::worlds::TransportWorld;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::database::Database;
use metamorph_text::format::{count, percent};
use serde_json::json;
use std::fmt::Write;
use std::sync::Arc;

/// Weight of the cube in grams, as in the experiments.
const GRAMS: u32 = 250;
/// The floor of the experiments, in connectors.
const FLOOR: (i16, i16) = (20, 13);
/// Weight of the lower bound of transports, in hundredths.
const WEIGHT: u32 = 500;
/// Seed of the motions off the lattice.
const SEED: u64 = 1;

#[derive(Args, Clone, Debug)]
pub struct ColourArgs {
    /// Random walks with lattice angles
    #[arg(long, required_unless_present = "off_lattice")]
    lattice: bool,
    /// Number of walks
    #[arg(long, default_value_t = 1_000_000, value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    walks: u64,
    /// Plans for a cube whose goal has the other colour, with one grip between the lattice postures
    #[arg(long, conflicts_with = "lattice")]
    off_lattice: bool,
    /// Number of such tasks
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(0..=100_000))]
    tasks: u64,
    /// PAR, SRS, PER or SRZ, for such tasks
    #[arg(long, default_value = "SRS", value_parser = metamodule)]
    kind: Kind,
}

/// Answers a question about colours.
pub fn colour(database: impl FnOnce() -> Database, args: &ColourArgs) -> Result<Answer, RobotError> {
    if args.off_lattice { off_lattice(database(), args) } else { lattice(args) }
}

/// Counts grips off the lattice, finds motions to them, and plans tasks with them.
fn off_lattice(database: Database, args: &ColourArgs) -> Result<Answer, RobotError> {
    let (kind, cube) = (args.kind, element("cube")?);
    let mut text = format!("{kind} with a cube of {GRAMS} g\n\n");
    let _ = writeln!(text, "height  colour  poses  solvable  free  cells");
    let mut rows = Vec::new();
    for (height, is_other) in [(0, false), (0, true), (1, false), (1, true)] {
        let (found, colour) = (grips(kind, height, is_other, GRAMS), if is_other { "other" } else { "foot" });
        let _ = writeln!(
            text,
            "{height:>6}  {colour:>6}  {:>5}  {:>8}  {:>4}  {:>5}",
            found.candidates, found.solvable, found.free, found.cells
        );
        rows.push(json!({
            "height": height, "other_colour": is_other, "poses": found.candidates,
            "solvable": found.solvable, "free": found.free, "cells": found.cells,
        }));
    }
    let floor = Terrain::floor(FLOOR);
    let scene = Scene::new(Arc::new(database), kind, &cube, GRAMS, LoadLimits::NOMINAL, floor);
    let found = changes(&scene, GRAMS, SEED);
    let cells: Vec<String> = found.iter().map(|c| c.cell.to_string()).collect();
    let _ = writeln!(
        text,
        "\nmotions to {} cells of the other colour on the floor, and away again: {}",
        found.len(),
        cells.join(", ")
    );
    let solved = |seed: &u64| {
        let world = TransportWorld::draw_of_other_colour(&scene, *seed);
        let ground = WalkingGround::new(&scene, |connector| world.exists(connector));
        plan_with_change(&ground, &world.task(WEIGHT), &found).is_some()
    };
    let planned = (0..args.tasks).filter(solved).count() as u64;
    let _ = writeln!(
        text,
        "{} of {} tasks planned with one change ({})",
        count(planned),
        count(args.tasks),
        percent(planned as f64 / args.tasks.max(1) as f64)
    );
    let json = json!({
        "kind": kind, "grips": rows, "cells": cells, "tasks": args.tasks, "planned": planned,
    });
    Ok(Answer::new(text, json))
}

/// Looks for a change of colour in random walks. One is a failure.
fn lattice(args: &ColourArgs) -> Result<Answer, RobotError> {
    let names = ["cube", "bar2", "L3", "plate3x3"];
    let mut walks = Vec::new();
    for name in names {
        let element = element(name)?;
        walks.extend(Kind::METAMODULES.map(|kind| RandomWalks::new(kind, element.clone())));
    }
    let changes: usize = (0..args.walks).map(|seed| walks[seed as usize % walks.len()].changes(seed)).sum();
    let text = format!(
        "{} random walks of {ACTIONS} actions by all kinds with {}: {changes} cells changed colour\n",
        count(args.walks),
        names.join(", ")
    );
    let json = json!({ "walks": args.walks, "actions": ACTIONS, "elements": names, "changes": changes });
    let mut answer = Answer::new(text, json);
    if changes > 0 {
        answer.failure = Some(RobotError::Colour(changes));
    }
    Ok(answer)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lattice_walks_change_no_colour() {
        let args = ColourArgs { lattice: true, walks: 1000, off_lattice: false, tasks: 0, kind: Kind::Srs };
        let walks = colour(|| unreachable!("walks need no database"), &args).unwrap();
        assert!(walks.failure.is_none() && walks.text.contains(": 0 cells"), "{}", walks.text);
    }
}
