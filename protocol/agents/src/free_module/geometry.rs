//! Structures in space: the pose of every module, whether rings close, and whether modules overlap.
//!
//! Lengths are in cells of 110 mm, angles in radians, unless a name says otherwise. Module frames are the foot frames of
//! [`roombots`](metamorph_roombots); the first module's is the outer frame.

use super::structure::{Connection, Structure};
use metamorph_core::ids::ModuleId;
use metamorph_roombots::body::{Body, bodies};
use metamorph_roombots::chain::{Pose, rotation, rotation_vector};
use metamorph_roombots::collision::{SHRINK, cubes_collide, overlap_depth};
use metamorph_roombots::connector::{Connector, Site, connector_pose};
use metamorph_roombots::lattice_pose::LatticeRotation;
use metamorph_roombots::{CELL_METRES, Kind};
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;
use thiserror::Error;

/// Millimetres of a cell.
const CELL_MM: f64 = CELL_METRES * 1000.0;
/// The largest gap of a ring that counts as closed, in millimetres.
pub const GAP_MM: f64 = 1.0;
/// The largest angle between the frames of a connection that closes a ring, in degrees.
pub const GAP_DEG: f64 = 1.0;

/// Why a structure cannot have these joint values.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum GeometryError {
    /// There are not three angles for every module.
    #[error("joint values for {given} modules, but there are {modules}")]
    Count {
        /// The number given.
        given: usize,
        /// The number of modules.
        modules: usize,
    },
    /// An angle is not a number, or beyond a turn.
    #[error("module {module}: q{joint} = {degrees} is not within -360..360 degrees")]
    Angle {
        /// The module.
        module: ModuleId,
        /// 1, 2 or 3.
        joint: usize,
        /// The value.
        degrees: f64,
    },
    /// A ring does not close.
    #[error(
        "connection {}-{} of modules {} and {}: the ring does not close, its connectors are {gap_mm:.1} mm and \
         {gap_deg:.1} degrees apart",
        connection.at, connection.to, connection.a, connection.b
    )]
    OpenRing {
        /// The connection.
        connection: Connection,
        /// Between the centres of the plates.
        gap_mm: f64,
        /// Between the frames.
        gap_deg: f64,
    },
    /// Two modules overlap.
    #[error("modules {first} and {second} overlap by {depth_mm:.1} mm")]
    Overlap {
        /// A module.
        first: ModuleId,
        /// Another one.
        second: ModuleId,
        /// How far they must shrink to come apart.
        depth_mm: f64,
    },
}

/// Returns the foot frames of all modules, by their joint values in degrees.
///
/// # Errors
/// Refuses angles that are not finite, rings that do not close within [`GAP_MM`] and [`GAP_DEG`], and modules that
/// overlap, and names the first of them.
pub fn place(
    structure: &Structure,
    joints_deg: &[[f64; 3]],
) -> Result<BTreeMap<ModuleId, Pose>, GeometryError> {
    if joints_deg.len() != structure.bound() {
        return Err(GeometryError::Count { given: joints_deg.len(), modules: structure.bound() });
    }
    for (m, angles) in joints_deg.iter().enumerate() {
        if let Some(j) = angles.iter().position(|a| !(-360.0..=360.0).contains(a)) {
            let module = ModuleId(m as u32);
            return Err(GeometryError::Angle { module, joint: j + 1, degrees: angles[j] });
        }
    }
    let angles: Vec<[f64; 3]> = joints_deg.iter().map(|q| q.map(f64::to_radians)).collect();
    let mut poses = BTreeMap::new();
    let mut reached: Vec<ModuleId> = structure.modules().take(1).collect();
    poses.extend(reached.iter().map(|m| (*m, Pose::identity())));
    while let Some(module) = reached.pop() {
        let ends = structure.connections().iter().flat_map(|c| [*c, c.reversed()]);
        for connection in ends.filter(|c| c.a == module) {
            let pose = beyond(&poses[&module], &connection, &angles);
            let known = poses.get(&connection.b).copied();
            match known {
                Some(known) => check_closed(&connection, &known, &pose)?,
                None => {
                    poses.insert(connection.b, pose);
                    reached.push(connection.b);
                }
            }
        }
    }
    check_apart(&poses, &angles)?;
    Ok(poses)
}

/// Returns the pose of `connection.b` by that of `connection.a`.
fn beyond(a: &Pose, connection: &Connection, angles: &[[f64; 3]]) -> Pose {
    let turn = rotation(&Vector3::z(), FRAC_PI_2 * f64::from(connection.rotation));
    let rotation = LatticeRotation::FLIP.matrix() * turn;
    let across = Pose { rotation, origin: Vector3::zeros() };
    let from = connector(connection.at, &angles[connection.a.index()]);
    let to = connector(connection.to, &angles[connection.b.index()]);
    a.compose(&from).compose(&across).compose(&to.inverse())
}

/// Returns the frame of a connector in that of its module: +z into the module.
fn connector(connector: Connector, q: &[f64; 3]) -> Pose {
    let site = Site { module: 0, connector };
    connector_pose(Kind::Single, q, site).expect("invariant: three finite angles of a single module")
}

fn check_closed(connection: &Connection, known: &Pose, pose: &Pose) -> Result<(), GeometryError> {
    let gap_mm = (known.origin - pose.origin).norm() * CELL_MM;
    let gap_deg = rotation_vector(&(known.rotation.transpose() * pose.rotation)).norm().to_degrees();
    if gap_mm > GAP_MM || gap_deg > GAP_DEG {
        return Err(GeometryError::OpenRing { connection: *connection, gap_mm, gap_deg });
    }
    Ok(())
}

fn check_apart(poses: &BTreeMap<ModuleId, Pose>, angles: &[[f64; 3]]) -> Result<(), GeometryError> {
    let mut placed: Vec<(ModuleId, Body)> = Vec::new();
    for (module, pose) in poses {
        let own = bodies(Kind::Single, &angles[module.index()]);
        let own = own.expect("invariant: three finite angles of a single module");
        let own: Vec<Body> = own.iter().map(|body| moved(body, pose)).collect();
        for (other, theirs) in &placed {
            let hit = own.iter().find(|body| cubes_collide(body, theirs, SHRINK));
            if let Some(body) = hit {
                let depth_mm = overlap_depth(body, theirs) * CELL_MM;
                return Err(GeometryError::Overlap { first: *other, second: *module, depth_mm });
            }
        }
        placed.extend(own.into_iter().map(|body| (*module, body)));
    }
    Ok(())
}

fn moved(body: &Body, pose: &Pose) -> Body {
    let normals = body.normals.map(|n| pose.rotation * n);
    Body { centre: pose.point(&body.centre), normals, ..*body }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::free_module::named;
    use metamorph_roombots::connector::Connector::{C0X, C3X};

    fn line(rotation: u8) -> Structure {
        let (a, b) = (ModuleId(0), ModuleId(1));
        Structure::new(2, &[Connection { a, at: C3X, b, to: C0X, rotation }]).unwrap()
    }

    /// Two modules end to end are where the kinematics of a metamodule has them, in any posture and of any kind.
    #[test]
    fn two_modules_are_a_metamodule() {
        use metamorph_roombots::chain::{forward, hemispheres};
        let q = [10.0, -25.0, 40.0, 5.0, 60.0, -15.0];
        let radians = q.map(f64::to_radians);
        for kind in [Kind::Par, Kind::Srs, Kind::Per, Kind::Srz] {
            let poses =
                place(&line(kind.quarter_turns()), &[[q[0], q[1], q[2]], [q[3], q[4], q[5]]]).unwrap();
            let first_of_second = hemispheres(kind, &radians).unwrap()[4];
            let found = &poses[&ModuleId(1)];
            assert!((found.rotation - first_of_second.rotation).amax() < 1e-12, "{kind:?}");
            let head = found.compose(&forward(Kind::Single, &radians[3..]).unwrap());
            assert!(head.error_to(&forward(kind, &radians).unwrap()).norm() < 1e-12, "{kind:?}");
        }
    }

    /// A connection says the same from both of its ends.
    #[test]
    fn a_connection_is_the_same_from_both_ends() {
        let angles = [[0.3, -0.8, 1.1], [-0.5, 0.2, 0.9]];
        for at in Connector::ALL {
            for to in Connector::ALL {
                for rotation in 0..4 {
                    let c = Connection { a: ModuleId(0), at, b: ModuleId(1), to, rotation };
                    let there = beyond(&Pose::identity(), &c, &angles);
                    let back = beyond(&there, &c.reversed(), &angles);
                    assert!(back.error_to(&Pose::identity()).norm() < 1e-12, "{c:?}");
                }
            }
        }
    }

    #[test]
    fn quadrupeds_are_flat_and_do_not_overlap() {
        for name in ["quad5-sym", "quad5-unsym", "quad9", "tripod4"] {
            let structure = named::structure(name).unwrap();
            let poses = place(&structure, &vec![[0.0; 3]; structure.bound()]).unwrap();
            assert!(poses.values().all(|p| p.origin.y.abs() < 1e-12), "{name}: {poses:?}");
        }
    }

    #[test]
    fn errors_name_the_place() {
        let zero = [[0.0; 3]; 2];
        assert_eq!(place(&line(0), &zero[..1]), Err(GeometryError::Count { given: 1, modules: 2 }));
        let wrong = place(&line(0), &[[0.0; 3], [0.0, f64::NAN, 0.0]]).unwrap_err();
        assert!(wrong.to_string().starts_with("module 1: q2 = NaN"), "{wrong}");
        let ring = named::structure("struct10").unwrap();
        let open = place(&ring, &[[0.0; 3]; 10]).unwrap_err();
        assert!(matches!(open, GeometryError::OpenRing { gap_mm, .. } if gap_mm > 100.0), "{open}");
    }

    /// Limbs at neighbouring connectors of a cube meet when they bend towards each other.
    #[test]
    fn limbs_that_bend_towards_each_other_overlap() {
        let bent = |rotation, sign: f64| {
            let second = Connection { rotation, ..join(0, Connector::C0Y, 2) };
            let structure = Structure::new(3, &[join(0, C0X, 1), second]).unwrap();
            place(&structure, &[[0.0; 3], [-120.0, 0.0, 0.0], [sign * 120.0, 0.0, 0.0]])
        };
        let all: Vec<_> = (0..4).flat_map(|k| [bent(k, -1.0), bent(k, 1.0)]).collect();
        let hit = |r: &&Result<_, _>| matches!(r, Err(GeometryError::Overlap { first: ModuleId(1), second: ModuleId(2), depth_mm }) if *depth_mm > 10.0);
        assert_eq!(
            (all.iter().filter(hit).count(), all.iter().filter(|r| r.is_ok()).count()),
            (2, 6),
            "{all:?}"
        );
    }

    /// With every module of its ring bent by a quarter turn, the ring of struct10 closes and its limbs are apart.
    #[test]
    fn a_bent_ring_closes() {
        let ring = named::structure("struct10").unwrap();
        let mut joints = [[0.0; 3]; 10];
        joints[..4].fill([-120.0, 90.0, 0.0]);
        assert!(place(&ring, &joints).is_ok());
        joints[3][1] += 1.5;
        let open = place(&ring, &joints).unwrap_err();
        assert!(
            matches!(open, GeometryError::OpenRing { gap_deg, .. } if (1.0..2.0).contains(&gap_deg)),
            "{open}"
        );
    }

    fn join(a: u32, at: Connector, b: u32) -> Connection {
        Connection { a: ModuleId(a), at, b: ModuleId(b), to: C0X, rotation: 0 }
    }
}
