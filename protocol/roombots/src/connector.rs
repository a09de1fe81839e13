//! The ten connectors of a module, their frames and their labels.

use super::chain::{self, Pose};
use super::lattice_pose::LatticeRotation;
use super::{Kind, KinematicsError};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// A connector of a module (thesis 2.2). Only C0X and C3X carry an active mechanism.
///
/// The assignment of side faces to Y and Z is a convention; the thesis shows it in a figure only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
#[repr(u8)]
pub enum Connector {
    /// The end of hemisphere 0.
    C0X = 0,
    /// A side of hemisphere 0.
    C0Y = 1,
    /// A side of hemisphere 0.
    C0Z = 2,
    /// A side of hemisphere 1.
    C1Y = 3,
    /// A side of hemisphere 1.
    C1Z = 4,
    /// A side of hemisphere 2.
    C2Y = 5,
    /// A side of hemisphere 2.
    C2Z = 6,
    /// The end of hemisphere 3.
    C3X = 7,
    /// A side of hemisphere 3.
    C3Y = 8,
    /// A side of hemisphere 3.
    C3Z = 9,
}

use Connector::{C0X, C0Y, C0Z, C1Y, C1Z, C2Y, C2Z, C3X, C3Y, C3Z};

impl Connector {
    /// All connectors, by hemisphere.
    pub const ALL: [Connector; 10] = [C0X, C0Y, C0Z, C1Y, C1Z, C2Y, C2Z, C3X, C3Y, C3Z];

    /// Returns the hemisphere that it belongs to, 0..3.
    pub const fn hemisphere(self) -> usize {
        match self {
            C0X | C0Y | C0Z => 0,
            C1Y | C1Z => 1,
            C2Y | C2Z => 2,
            C3X | C3Y | C3Z => 3,
        }
    }
    /// Returns true if it can grip.
    pub const fn is_active(self) -> bool {
        matches!(self, C0X | C3X)
    }
    /// Its name.
    pub const fn name(self) -> &'static str {
        ["C0X", "C0Y", "C0Z", "C1Y", "C1Z", "C2Y", "C2Z", "C3X", "C3Y", "C3Z"][self as usize]
    }
    /// Returns the number, from 0, of the position in chapter 4.1 of the report, which counts left-back, left-end, left-up,
    /// left-down, left-front, right-front, right-down, right-end, right-up, right-back. These names hold
    /// for the posture with the middle joint at 180°, the report's default.
    pub const fn report_index(self) -> u8 {
        match self {
            C0Y => 0,
            C0X => 1,
            C0Z => 2,
            C1Z => 3,
            C1Y => 4,
            C2Y => 5,
            C2Z => 6,
            C3X => 7,
            C3Z => 8,
            C3Y => 9,
        }
    }
    /// Returns the corresponding connector of the module seen from its other end.
    pub const fn reversed(self) -> Connector {
        match self {
            C0X => C3X,
            C0Y => C3Z,
            C0Z => C3Y,
            C1Y => C2Z,
            C1Z => C2Y,
            C2Y => C1Z,
            C2Z => C1Y,
            C3X => C0X,
            C3Y => C0Z,
            C3Z => C0Y,
        }
    }
    /// Returns the frame of the connector in the frame of its hemisphere, without the shift to the plate: +z
    /// points into the module. C0X has the foot frame, C3X the head frame, and the connectors of a hemisphere
    /// follow each other by +120° about the diagonal.
    pub fn frame(self) -> LatticeRotation {
        let end = match self.hemisphere() {
            0 | 2 => LatticeRotation::IDENTITY,
            _ => LatticeRotation::FLIP,
        };
        let turns = match self {
            C0X | C3X => 0,
            C0Y | C1Y | C2Y | C3Y => 1,
            C0Z | C1Z | C2Z | C3Z => 2,
        };
        LatticeRotation::DIAGONAL.power(turns) * end
    }
}

/// Returns the report's label of a connection between two positions: `40 source + 4 target + rotation`,
/// rotation in quarter turns (report chapter 4.1).
pub const fn report_label(source: Connector, target: Connector, rotation: u8) -> u16 {
    40 * source.report_index() as u16 + 4 * target.report_index() as u16 + (rotation % 4) as u16
}

impl fmt::Display for Connector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A connector of a robot that may have two modules.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Site {
    /// 0 for the module at the foot, 1 for the second one.
    pub module: u8,
    /// The connector of that module.
    pub connector: Connector,
}

impl Site {
    /// Iterates over the connectors of a robot, in order.
    pub fn all(kind: Kind) -> impl Iterator<Item = Site> {
        (0..kind.modules() as u8)
            .flat_map(|module| Connector::ALL.map(|connector| Site { module, connector }))
    }
    /// Returns true if the connector is not used by the robot itself: all but C3X of the first and C0X of the
    /// second module of a metamodule.
    pub fn is_free(self, kind: Kind) -> bool {
        let joint = match self.module {
            0 => C3X,
            _ => C0X,
        };
        kind == Kind::Single || self.connector != joint
    }
}

impl fmt::Display for Site {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.module > 0 {
            write!(f, "{}:", self.module + 1)?;
        }
        self.connector.fmt(f)
    }
}

impl FromStr for Site {
    type Err = KinematicsError;

    /// Reads `C1Y` and `2:C3X`.
    fn from_str(text: &str) -> Result<Site, KinematicsError> {
        let unknown = || KinematicsError::UnknownConnector(text.to_owned());
        let (module, name) = match text.trim().split_once(':') {
            None => (0, text.trim()),
            Some(("1", name)) => (0, name),
            Some(("2", name)) => (1, name),
            Some(_) => return Err(unknown()),
        };
        let connector =
            Connector::ALL.into_iter().find(|c| c.name().eq_ignore_ascii_case(name)).ok_or_else(unknown)?;
        Ok(Site { module, connector })
    }
}

/// Returns the pose of a connector: origin in the centre of its plate, +z into the module.
pub fn connector_pose(kind: Kind, q: &[f64], site: Site) -> Result<Pose, KinematicsError> {
    if usize::from(site.module) >= kind.modules() {
        return Err(KinematicsError::NoSecondModule);
    }
    let all = chain::hemispheres(kind, q)?;
    let body = &all[4 * usize::from(site.module) + site.connector.hemisphere()];
    let rotation = body.rotation * site.connector.frame().matrix();
    Ok(Pose { rotation, origin: body.origin - rotation.column(2) * super::HALF_EDGE })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// The outward normals of the zero posture; C0X and C3X carry the foot and the head frame.
    #[test]
    fn normals_of_the_zero_posture() {
        let expected = [
            (C0X, [0, 0, -1]),
            (C0Y, [-1, 0, 0]),
            (C0Z, [0, -1, 0]),
            (C1Y, [1, 0, 0]),
            (C1Z, [0, 1, 0]),
            (C2Y, [-1, 0, 0]),
            (C2Z, [0, -1, 0]),
            (C3X, [0, 0, 1]),
            (C3Y, [1, 0, 0]),
            (C3Z, [0, 1, 0]),
        ];
        for (connector, normal) in expected {
            let pose = connector_pose(Kind::Single, &[0.0; 3], Site { module: 0, connector }).unwrap();
            assert_eq!(-pose.rotation.column(2), Vector3::from(normal.map(f64::from)), "{connector}");
        }
        let q = [0.3, -1.0, 2.0];
        let site = |connector| Site { module: 0, connector };
        let foot = connector_pose(Kind::Single, &q, site(C0X)).unwrap();
        assert!(foot.error_to(&Pose::identity()).norm() < 1e-12);
        let head = connector_pose(Kind::Single, &q, site(C3X)).unwrap();
        assert!(head.error_to(&chain::forward(Kind::Single, &q).unwrap()).norm() < 1e-12);
    }

    /// Seen from the head, the module with reversed joints has its connectors in the same places.
    #[test]
    fn reversal_maps_connectors_onto_connectors() {
        let q = [0.7, -0.4, 1.9];
        let back = [1.9, -0.4, 0.7];
        let head = chain::forward(Kind::Single, &q).unwrap();
        for connector in Connector::ALL {
            let here = connector_pose(Kind::Single, &q, Site { module: 0, connector }).unwrap();
            let there =
                connector_pose(Kind::Single, &back, Site { module: 0, connector: connector.reversed() });
            let error = head.compose(&there.unwrap()).origin - here.origin;
            assert!(error.norm() < 1e-12, "{connector}: {error}");
            assert_eq!(connector.reversed().reversed(), connector);
        }
    }

    #[test]
    fn names_and_labels() {
        assert_eq!("2:c3x".parse(), Ok(Site { module: 1, connector: C3X }));
        assert_eq!("2:C3X".parse::<Site>().unwrap().to_string(), "2:C3X");
        for bad in ["C4X", "3:C0X", "", "C1X"] {
            assert!(matches!(bad.parse::<Site>(), Err(KinematicsError::UnknownConnector(_))), "{bad}");
        }
        // The example of report chapter 4.1: left-up to right-end with half a turn.
        assert_eq!(report_label(C0Z, C3X, 2), 110);
        let mut indices = Connector::ALL.map(Connector::report_index);
        indices.sort_unstable();
        assert_eq!(indices, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]);
        let wrong = connector_pose(Kind::Single, &[0.0; 3], Site { module: 1, connector: C0X }).unwrap_err();
        assert_eq!(wrong, KinematicsError::NoSecondModule);
    }
}
