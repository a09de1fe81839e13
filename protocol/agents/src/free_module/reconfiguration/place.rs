//! Places of modules on the lattice, and their conversion from and to the configurations of planner and checker.

use metamorph_core::lattice::Cell;
use metamorph_core::only_message;
use metamorph_core::wire::{Decoder, Encoder, Field, WireError};
use metamorph_planning::assembly::checker::{Robot, robot};
use metamorph_planning::assembly::configuration::{Configuration, Module};
use metamorph_planning::assembly::tables::{Code, POSTURES, ROTATIONS, Rot, TABLES};
use metamorph_roombots::Kind;
use metamorph_roombots::posture::Posture;

/// Number of connectors of a module.
pub const CONNECTORS: usize = 10;

/// Where a module is, its joint values, and which of its connectors are closed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LatticePlace {
    /// The cell of the cube with C0X.
    pub cell: Cell,
    /// The rotation of the foot frame, by its number.
    pub rotation: Rot,
    /// The joint values, by their code.
    pub posture: Code,
    /// The closed connectors, by their numbers as bits.
    pub closed: u16,
}

impl LatticePlace {
    /// Returns the place of a module of a configuration.
    pub fn of(module: &Module) -> LatticePlace {
        let [x, y, z] = module.cell.map(i16::from);
        let (rotation, posture, closed) = (module.rotation, module.posture, module.held);
        LatticePlace { cell: Cell::new(x, y, z), rotation, posture, closed }
    }
    /// Returns the place of a module of the checker's world.
    pub fn of_robot(robot: &Robot, closed: u16) -> LatticePlace {
        let rotation = TABLES.rotations.iter().position(|r| *r == robot.foot.rotation);
        let normal = robot.foot.rotation.apply([0, 0, 1]);
        let [x, y, z] = [0, 1, 2].map(|i| (robot.foot.half[i] + normal[i]).div_euclid(2));
        LatticePlace {
            cell: Cell::new(x, y, z),
            rotation: rotation.expect("invariant: the table has all rotations") as u8,
            posture: robot.posture.code() as u8,
            closed,
        }
    }
    /// Returns the module as the checker sees it.
    pub fn robot(&self) -> Robot {
        let steps = [self.posture / 12, self.posture / 3 % 4, self.posture % 3];
        robot(self.cell.into(), TABLES.rotations[usize::from(self.rotation)], &steps)
    }
    /// Returns true if a connector is closed.
    pub fn is_closed(&self, connector: u8) -> bool {
        self.closed >> connector & 1 != 0
    }
    /// Returns the direction of a joint's axis, and a cell whose centre it goes through.
    pub fn axis(&self, joint: u8) -> ([i16; 3], Cell) {
        let t = &**TABLES;
        let hemisphere = t.hemisphere[usize::from(self.posture)][usize::from(joint)];
        let frame = t.rotations[usize::from(t.times(self.rotation, hemisphere))];
        let axis = frame.apply(if joint == 1 { [0, 0, 1] } else { [1, 1, 1] });
        let module = Module { rotation: self.rotation, posture: self.posture, ..Module::default() };
        let [x, y, z] = module.cells()[usize::from(joint == 2)].map(i16::from);
        (axis, Cell::new(self.cell.x + x, self.cell.y + y, self.cell.z + z))
    }
    /// Returns the joint values in degrees.
    pub fn degrees(&self) -> [i16; 3] {
        let all = Posture::from_code(Kind::Single, self.posture.into()).degrees();
        [0, 1, 2].map(|joint| all[joint])
    }
}

/// Returns the configuration of modules at these places, with the first at the origin; a connector holds if it is
/// closed. `None` if they are too many or too far apart for a configuration.
pub fn configuration(places: &[LatticePlace]) -> Option<Configuration> {
    let origin = places.first()?.cell;
    let module = |place: &LatticePlace| {
        let along = |a: i16, b: i16| i8::try_from(a - b).ok();
        let Cell { x, y, z } = place.cell;
        let cell = [along(x, origin.x)?, along(y, origin.y)?, along(z, origin.z)?];
        Some(Module { cell, rotation: place.rotation, posture: place.posture, held: place.closed })
    };
    Configuration::new(&places.iter().map(module).collect::<Option<Vec<_>>>()?)
}

impl Field for LatticePlace {
    fn put(&self, out: &mut Encoder) {
        (self.cell, self.rotation, self.posture).put(out);
        out.u16(self.closed);
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<LatticePlace, WireError> {
        let below = |value: u8, bound: usize, field| {
            if usize::from(value) < bound { Ok(value) } else { Err(WireError::Field(field)) }
        };
        Ok(LatticePlace {
            cell: from.cell()?,
            rotation: below(from.u8()?, ROTATIONS, "rotation")?,
            posture: below(from.u8()?, POSTURES, "posture")?,
            closed: connectors(from.u16()?)?,
        })
    }
}

only_message!(LatticePlace = 16);

/// Checks a set of connectors.
///
/// # Errors
/// Refuses connectors that a module does not have.
pub fn connectors(set: u16) -> Result<u16, WireError> {
    if set < 1 << CONNECTORS { Ok(set) } else { Err(WireError::Field("connectors")) }
}
