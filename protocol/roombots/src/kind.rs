//! The five kinematic structures: a single module, and the four ways to join two of them.

use super::KinematicsError;
use metamorph_core::names;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// A single module or a type of metamodule (thesis 2.2.4 and figure 2.5).
///
/// In a metamodule C3X of the first module holds C0X of the second, which is turned by
/// [`Kind::quarter_turns`] about the outward normal of C3X. The sign that tells SRS from SRZ is a
/// convention: the thesis shows it in a figure only, and the two are mirror images.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
#[repr(u8)]
pub enum Kind {
    /// One module with three joints.
    Single = 0,
    /// Parallel: all diagonal axes parallel in the zero posture.
    Par = 1,
    /// Shear-S: the second module turned by 90°.
    Srs = 2,
    /// Perpendicular: turned by 180°.
    Per = 3,
    /// Shear-Z: turned by 270°.
    Srz = 4,
}

names!(Kind { Single => "single", Par => "PAR", Srs => "SRS", Per => "PER", Srz => "SRZ" });

impl Kind {
    /// The four metamodules.
    pub const METAMODULES: [Kind; 4] = [Kind::Par, Kind::Srs, Kind::Per, Kind::Srz];

    /// Returns the kind with this number, if there is one.
    pub fn from_index(index: u8) -> Option<Kind> {
        Kind::ALL.get(usize::from(index)).copied()
    }
    /// Returns the number of modules.
    pub const fn modules(self) -> usize {
        if matches!(self, Kind::Single) { 1 } else { 2 }
    }
    /// Returns the number of joints.
    pub const fn joints(self) -> usize {
        3 * self.modules()
    }
    /// Returns the number of cubes, which is the number of cells filled on the lattice.
    pub const fn cubes(self) -> usize {
        2 * self.modules()
    }
    /// Returns the quarter turns of the second module; 0 for a single module.
    pub const fn quarter_turns(self) -> u8 {
        match self {
            Kind::Single | Kind::Par => 0,
            Kind::Srs => 1,
            Kind::Per => 2,
            Kind::Srz => 3,
        }
    }
    /// Returns the mirror image of this kind.
    pub const fn mirrored(self) -> Kind {
        match self {
            Kind::Srs => Kind::Srz,
            Kind::Srz => Kind::Srs,
            other => other,
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Kind {
    type Err = KinematicsError;

    fn from_str(text: &str) -> Result<Kind, KinematicsError> {
        Kind::ALL
            .into_iter()
            .find(|k| k.name().eq_ignore_ascii_case(text.trim()))
            .ok_or_else(|| KinematicsError::UnknownKind(text.to_owned()))
    }
}
