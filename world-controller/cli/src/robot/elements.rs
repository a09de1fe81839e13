//! Queries about passive elements: what a metamodule carries, hands over, and can never do on the lattice.

use super::{Answer, RobotError};
use clap::Args;
use metamorph_protocol::lattice::Face;
use metamorph_protocol::manipulation::carry::CarryTable;
use metamorph_protocol::manipulation::element::Element;
use metamorph_protocol::manipulation::handover::HandoverTable;
use metamorph_protocol::manipulation::load::{LoadLimits, LoadTable, MAX_GRAMS};
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::database::Database;
use metamorph_text::format::count;
use serde_json::{Map, json};
use std::collections::BTreeSet;
use std::fmt::Write;

/// Masses that are shown unless one is given, in grams. The last is that of a module.
const MASSES: [u32; 5] = [250, 500, 750, 1000, 1400];

#[derive(Args, Clone, Debug)]
pub struct CarryArgs {
    /// PAR, SRS, PER or SRZ
    #[arg(value_parser = metamodule)]
    kind: Kind,
    /// cube, bar2, bar3, L3, plate2x2, plate3x3, plateNxM or module
    #[arg(long)]
    element: String,
    /// Mass of the element in kilograms; default: 0.25, 0.5, 0.75, 1 and 1.4
    #[arg(long, value_parser = grams)]
    mass: Option<u32>,
}

#[derive(Args, Clone, Debug)]
pub struct HandoverArgs {
    /// PAR, SRS, PER or SRZ
    #[arg(value_parser = metamodule)]
    kind: Kind,
}

pub(super) fn metamodule(text: &str) -> Result<Kind, String> {
    match text.parse() {
        Ok(Kind::Single) => {
            Err("a single module carries nothing; write one of PAR, SRS, PER, SRZ".to_owned())
        }
        Ok(kind) => Ok(kind),
        Err(_) => Err("write one of PAR, SRS, PER, SRZ".to_owned()),
    }
}

fn grams(text: &str) -> Result<u32, String> {
    let grams = text.parse::<f64>().map(|kilograms| kilograms * 1000.0);
    match grams {
        Ok(g) if (0.0..=f64::from(MAX_GRAMS)).contains(&g) => Ok(g.round() as u32),
        _ => Err(format!("a mass is a number of kilograms from 0 to {}", MAX_GRAMS / 1000)),
    }
}

pub(super) fn element(name: &str) -> Result<Element, RobotError> {
    name.parse().map_err(|e| RobotError::Usage(format!("--element: {e}")))
}

fn kilograms(grams: u32) -> String {
    let text = format!("{}", f64::from(grams) / 1000.0);
    if text.contains('.') { text } else { format!("{text}.0") }
}

/// Lists the postures in which a kind of metamodule carries an element on an open floor, in the best grip.
pub fn carry(database: &Database, args: &CarryArgs) -> Result<Answer, RobotError> {
    let (kind, table) = (args.kind, database.table(args.kind));
    let tables = CarryTable::all(database, kind, &element(&args.element)?);
    let best = CarryTable::best(&tables);
    let best = best.ok_or_else(|| RobotError::Usage("--element: it has no port".to_owned()))?;
    let main = best.main_set();
    let loads = LoadTable::new(table, best, Face::Down);
    let masses = args.mass.map_or(MASSES.to_vec(), |grams| vec![grams]);
    let mut text = format!(
        "{kind} with {}: {} grips; the best one is {}\n{} of {} postures without collision, {} of them \
         connected by {} strict steps\n\n",
        args.element,
        tables.len(),
        best.grip(),
        count(best.valid() as u64),
        count(table.postures().len() as u64),
        count(main.len() as u64),
        count(best.steps().len() as u64),
    );
    let _ = writeln!(text, "mass [kg]  connected within 4.9 / 3.6 Nm");
    let mut within = Map::new();
    for grams in masses {
        let passes = |step: usize| loads.peak(step, grams).within(LoadLimits::NOMINAL);
        let size = best.connected(|_| true, passes).first().map_or(0, Vec::len);
        let _ = writeln!(text, "{:>9}  {size}", kilograms(grams));
        within.insert(kilograms(grams), json!(size));
    }
    let heights: Vec<i16> = main.iter().filter_map(|p| best.held(*p)?.iter().map(|c| c.z).min()).collect();
    let by_height: Vec<usize> = (0..=heights.iter().copied().max().unwrap_or(0))
        .map(|z| heights.iter().filter(|h| **h == z).count())
        .collect();
    let places: BTreeSet<_> = main.iter().filter_map(|p| best.held(*p)).collect();
    let _ = writeln!(
        text,
        "\n{} places of the element; postures by the height of its lowest cell: {by_height:?}",
        places.len()
    );
    let json = json!({
        "element": args.element, "kind": kind, "grips": tables.len(), "best_grip": best.grip().to_string(),
        "valid": best.valid(), "main": main.len(), "strict_steps": best.steps().len(),
        "main_within_torque": within, "places": places.len(), "lowest_cell_height": by_height,
        "swept_cells": best.cells().len(),
    });
    Ok(Answer::new(text, json))
}

/// Counts the pairs of postures in which one metamodule hands a cube to another of its kind.
pub fn handover(database: &Database, args: &HandoverArgs) -> Result<Answer, RobotError> {
    let cube = element("cube")?;
    let tables = CarryTable::all(database, args.kind, &cube);
    let carry = &tables[0];
    let found = HandoverTable::new(database.table(args.kind), &cube, carry, carry);
    let text = format!(
        "{}: {} pairs of postures hold a cube at different ports, the receiver's foot on the same floor or on a wall \
         above it\n{} of them do not collide\n{} relative foot poses, {} of them on the same floor\n",
        args.kind,
        count(found.examined),
        count(found.free() as u64),
        count(found.pairs.len() as u64),
        count(found.same_floor() as u64),
    );
    let json = json!({
        "kind": args.kind, "element": "cube", "pairs": found.examined, "free": found.free(),
        "foot_poses": found.pairs.len(), "on_the_same_floor": found.same_floor(),
    });
    Ok(Answer::new(text, json))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_have_the_counts_of_the_model() {
        let database = Database::build();
        let ask = |element: &str, mass| {
            carry(&database, &CarryArgs { kind: Kind::Srs, element: element.into(), mass })
        };
        let json = ask("cube", Some(500)).unwrap().json;
        assert_eq!((&json["main"], &json["main_within_torque"]), (&json!(854), &json!({"0.5": 830})));
        assert_eq!(json["lowest_cell_height"], json!([242, 312, 204, 80, 16]));
        assert!(ask("bar3", None).unwrap().text.contains("1.4  514"));
        assert!(matches!(ask("ball", None), Err(RobotError::Usage(text)) if text.contains("plateNxM")));
    }

    #[test]
    fn masses_and_kinds_are_checked() {
        assert_eq!(grams("0.5"), Ok(500));
        assert_eq!(kilograms(1000), "1.0");
        assert_eq!(kilograms(250), "0.25");
        for bad in ["-1", "NaN", "21", "heavy", "inf"] {
            assert!(grams(bad).unwrap_err().contains("from 0 to 20"), "{bad}");
        }
        assert_eq!(metamodule("srs"), Ok(Kind::Srs));
        assert!(metamodule("single").is_err() && metamodule("x").is_err());
    }
}
