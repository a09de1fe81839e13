//! Structures given by their connectors, and their conversion from and to those given by cells.

use super::document::{ConnectedStructure, ConnectionEntry, StructureFile};
use super::error::PlanError;
use super::input::{Structured, of_document};
use metamorph_protocol::assembly::configuration::{Configuration, MAX_MODULES};
use metamorph_protocol::assembly::shape::Shape;
use metamorph_protocol::assembly::structure::StructureError;
use metamorph_protocol::free_module::geometry::place as place_modules;
use metamorph_protocol::free_module::lattice;
use metamorph_protocol::free_module::structure::{Connection, Structure};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::posture::Posture;

/// A structure with the joint values of its modules.
#[derive(Clone, Debug)]
pub struct Connected {
    /// The structure.
    pub structure: Structure,
    /// Joint values in degrees, if they are given.
    pub joints_deg: Option<Vec<[f64; 3]>>,
}

/// Interprets a structure file of either form as modules with connectors.
///
/// # Errors
/// Refuses one by cells without poses, since it leaves open which connectors hold, and joint values with which rings
/// stay open or modules overlap. Without joint values a structure with rings is not checked for that.
pub fn connected(place: &str, file: &StructureFile) -> Result<Connected, PlanError> {
    match file {
        StructureFile::Connected(document) => read(place, document),
        StructureFile::Cells(document) => match of_document(place, document)? {
            Structured::Configuration(configuration) => Ok(of_configuration(&configuration)),
            Structured::Shape(_) => Err(PlanError::option(
                place,
                "modules given by cells alone leave open which connectors hold",
                "write `foot_rotation` and `joints_deg` of every module, or `connections` instead of `joined`",
            )),
        },
    }
}

fn read(place: &str, document: &ConnectedStructure) -> Result<Connected, PlanError> {
    let connection = |c: &ConnectionEntry| Connection {
        a: ModuleId(c.a),
        at: c.at,
        b: ModuleId(c.b),
        to: c.to,
        rotation: c.rotation,
    };
    let connections: Vec<Connection> = document.connections.iter().map(connection).collect();
    let structure = Structure::new(document.modules, &connections)
        .map_err(|error| PlanError::Connections { place: place.to_owned(), error })?;
    let has_ring = structure.connections().len() >= document.modules;
    let wrong = |error| PlanError::Geometry { place: place.to_owned(), error };
    match &document.joints_deg {
        Some(joints) => drop(place_modules(&structure, joints).map_err(wrong)?),
        None if has_ring => {}
        None => drop(place_modules(&structure, &vec![[0.0; 3]; document.modules]).map_err(wrong)?),
    }
    Ok(Connected { structure, joints_deg: document.joints_deg.clone() })
}

fn of_configuration(configuration: &Configuration) -> Connected {
    let degrees = |m: &metamorph_protocol::assembly::configuration::Module| {
        let steps = [m.posture / 12, m.posture / 3 % 4, m.posture % 3];
        let all = Posture::from_steps(Kind::Single, &steps).expect("invariant: three joints").degrees();
        [0, 1, 2].map(|i| f64::from(all[i]))
    };
    Connected {
        structure: lattice::structure(configuration).expect("invariant: a configuration is connected"),
        joints_deg: Some(configuration.modules().iter().map(degrees).collect()),
    }
}

/// Interprets a structure by connectors for planning: with joint values a configuration, without a shape with all joints
/// at 0.
pub fn structured(place: &str, document: &ConnectedStructure) -> Result<Structured, PlanError> {
    let Connected { structure, joints_deg } = read(place, document)?;
    let wrong = |error| PlanError::Geometry { place: place.to_owned(), error };
    let n = document.modules;
    if n > MAX_MODULES {
        let error = StructureError::TooMany(n);
        return Err(PlanError::Structure { place: place.to_owned(), error });
    }
    let angles = joints_deg.clone().unwrap_or_else(|| vec![[0.0; 3]; n]);
    // A ring without joint values is checked here, with all joints at 0.
    place_modules(&structure, &angles).map_err(wrong)?;
    let mut postures = Vec::new();
    for (i, q) in angles.iter().enumerate() {
        let posture = Posture::from_degrees(Kind::Single, q, 1e-6).map_err(|error| {
            PlanError::option(
                place,
                format!("module {i}: {error}"),
                "plan with joints at multiples of 120 and 90 degrees",
            )
        })?;
        postures.push(posture.code() as u8);
    }
    let configuration = lattice::configuration(&structure, &postures);
    let configuration = configuration.expect("invariant: a structure of at most 16 modules, all there");
    Ok(match joints_deg {
        Some(_) => Structured::Configuration(configuration),
        None => Structured::Shape(Shape::of(&configuration)),
    })
}
