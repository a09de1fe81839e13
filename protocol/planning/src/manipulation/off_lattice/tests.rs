//! Changes of colour: grips off the lattice, motions to them, and a plan.

use super::arm::{Arm, Cube};
use super::change::{changes, grips, plan_with_change};
use super::connect::is_free_between;
use crate::manipulation::load::LoadLimits;
use crate::manipulation::scene::Scene;
use crate::manipulation::terrain::Terrain;
use crate::manipulation::transport::{Answer, TransportReason, plan};
use crate::manipulation::walking::WalkingGround;
use crate::manipulation::worlds::TransportWorld;
use metamorph_roombots::Kind;
use metamorph_roombots::database::Database;
use std::sync::Arc;

/// The counts of the model: grips of a cube at which nothing is touched, and their cells.
#[test]
fn some_grips_of_the_other_colour_touch_nothing() {
    for (is_other, free, cells) in [(false, 136, 19), (true, 32, 14)] {
        let found = grips(Kind::Srs, 0, is_other, 250);
        assert_eq!((found.free, found.cells), (free, cells), "{found:?}");
        assert!(found.free < found.solvable && found.solvable < found.candidates, "{found:?}");
    }
}

#[test]
fn a_cube_changes_its_colour() {
    let (database, cube) = (Arc::new(Database::build()), "cube".parse().unwrap());
    let scene = Scene::new(database, Kind::Srs, &cube, 250, LoadLimits::NOMINAL, Terrain::floor((12, 9)));
    let found = changes(&scene, 250, 1);
    assert!(!found.is_empty());
    let (held, radians) = (Arm::new(Kind::Srs, Cube::Held, 250, LoadLimits::NOMINAL), |p: u16| {
        scene.table().postures()[usize::from(p)].posture.radians()
    });
    for change in &found {
        assert!(change.lowering.windows(2).all(|w| is_free_between(&held, &w[0], &w[1])), "{change:?}");
        let beside = Arm::new(Kind::Srs, Cube::At(change.cell), 250, LoadLimits::NOMINAL);
        assert!(change.leaving.windows(2).all(|w| is_free_between(&beside, &w[0], &w[1])), "{change:?}");
        assert_eq!(change.lowering.last(), change.leaving.first());
        assert_eq!(
            (change.lowering[0].clone(), change.leaving.last().cloned()),
            (radians(change.from), Some(radians(change.to)))
        );
    }
    let world = TransportWorld::draw_of_other_colour(&scene, 1);
    let ground = WalkingGround::new(&scene, |connector| world.exists(connector));
    let task = world.task(500);
    assert_eq!(plan(&ground, &task), Answer::Infeasible(TransportReason::Colour));
    let plan = plan_with_change(&ground, &task, &found);
    assert!(plan.is_some_and(|p| p.after.connections() > 0 && p.before.connections() > 0));
}
