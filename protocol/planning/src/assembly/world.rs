//! A configuration as the checker sees it, in the terms of the Roombots model alone, and what is wrong with it.

use metamorph_core::lattice::Cell;
use metamorph_roombots::Kind;
use metamorph_roombots::connector::Connector;
use metamorph_roombots::lattice_pose::{LatticePose, LatticeRotation};
use metamorph_roombots::posture::Posture;
use siphasher::sip::SipHasher13;
use std::collections::BTreeSet;
use std::hash::Hasher;
use thiserror::Error;

/// A connector of a module.
pub type Place = (usize, Connector);

/// A module as the checker sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Robot {
    /// The foot frame; its origin is the plate of C0X.
    pub foot: LatticePose,
    /// The joint values.
    pub posture: Posture,
}

/// A configuration as the checker sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct World {
    /// The modules.
    pub robots: Vec<Robot>,
    /// The connections, the smaller place first.
    pub held: BTreeSet<(Place, Place)>,
}

/// Why an action is not possible.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum Refusal {
    /// There is no such module.
    #[error("there is no module {0}")]
    NoModule(usize),
    /// The connectors do not face each other.
    #[error("{} and {} do not face each other", name(.0), name(.1))]
    NotFacing(Place, Place),
    /// A connector is part of another connection already.
    #[error("{} is connected already", name(.0))]
    InUse(Place),
    /// The model has no such connection.
    #[error("neither {} nor {} is an active connector", name(.0), name(.1))]
    Passive(Place, Place),
    /// There is no such connection.
    #[error("{} and {} are not connected", name(.0), name(.1))]
    NotHeld(Place, Place),
    /// The structure would fall apart.
    #[error("module {0} would no longer be connected with module 0")]
    Parted(usize),
    /// A joint is part of a loop.
    #[error("joint {joint} of module {module} is locked by a loop", joint = .1 + 1, module = .0)]
    Locked(usize, usize),
    /// Two modules would share a cell.
    #[error("modules {0} and {1} would share the cell {2}")]
    Collision(usize, usize, Cell),
    /// Two modules touch on the way.
    #[error("modules {0} and {1} touch during the turn")]
    Touch(usize, usize),
    /// A module is below the floor.
    #[error("module {0} is below the floor")]
    BelowFloor(usize),
    /// A module goes into the floor on the way.
    #[error("module {0} goes into the floor during the turn")]
    IntoFloor(usize),
    /// A joint bears more than it can.
    #[error(
        "joint {joint} of module {module} bears {torque} Nm, more than it can",
        joint = .joint + 1,
        torque = f64::from(*.millis) / 1000.0
    )]
    Overloaded {
        /// The module.
        module: usize,
        /// The joint, from 0.
        joint: usize,
        /// The torque in mNm.
        millis: u32,
    },
}

fn name((module, connector): &Place) -> String {
    format!("{connector} of module {module}")
}

impl Robot {
    /// Returns the frames of its hemispheres.
    pub(super) fn hemispheres(&self) -> [LatticeRotation; 4] {
        let placement = self.posture.placement();
        [0, 1, 2, 3].map(|h| self.foot.rotation * placement.rotations[h])
    }
    /// Returns the centres of its cubes, in half cells.
    pub(super) fn centres(&self) -> [[i16; 3]; 2] {
        let placement = self.posture.placement();
        [0, 1].map(|c| {
            let cell = placement.cells[c];
            let half = [2 * cell.x, 2 * cell.y, 2 * cell.z + 1];
            self.foot.compose(LatticePose { rotation: LatticeRotation::IDENTITY, half }).half
        })
    }
    /// Returns the centre of a connector's plate and its outward normal.
    fn plate(&self, connector: Connector) -> ([i16; 3], [i16; 3]) {
        let frame = self.hemispheres()[connector.hemisphere()] * connector.frame();
        let normal = frame.apply([0, 0, -1]);
        let centre = self.centres()[connector.hemisphere() / 2];
        ([0, 1, 2].map(|i| centre[i] + normal[i]), normal)
    }
}

impl World {
    /// Returns a number that two worlds share exactly if they are the same but for a rigid motion of the whole.
    pub fn fingerprint(&self) -> u64 {
        let mut hasher = SipHasher13::new_with_keys(0, 0);
        let root = self.robots.first().map_or(LatticePose::IDENTITY, |r| r.foot.inverse());
        for robot in &self.robots {
            let pose = root.compose(robot.foot);
            let rows = pose.rotation.rows().concat();
            rows.iter().for_each(|x| hasher.write_i8(*x));
            pose.half.iter().for_each(|x| hasher.write_u16(x.rem_euclid(4096) as u16));
            hasher.write(robot.posture.steps());
        }
        for ((a, c), (b, d)) in &self.held {
            hasher.write(&[*a as u8, *c as u8, *b as u8, *d as u8]);
        }
        hasher.finish()
    }

    /// Refuses a world in which modules overlap, or connections do not meet or do not hold it together.
    pub fn check(&self) -> Result<(), Refusal> {
        self.apart()?;
        for (a, b) in &self.held {
            self.facing(*a, *b)?;
        }
        self.whole()
    }

    /// Returns twice the height of its lowest cube's bottom, in cells.
    pub fn lowest(&self) -> i16 {
        self.robots.iter().flat_map(|r| r.centres()).map(|c| c[2] - 1).min().unwrap_or(0)
    }
    /// Returns the connector that faces a connector.
    pub fn partner(&self, of: Place) -> Option<Place> {
        let all = (0..self.robots.len()).flat_map(|m| Connector::ALL.map(|c| (m, c)));
        all.into_iter().find(|other| self.facing(of, *other).is_ok())
    }
    /// Returns the other modules behind a joint; `None` if a loop locks it.
    pub fn moving_side(&self, module: usize, joint: usize) -> Option<Vec<usize>> {
        let behind = self.flood((module, joint + 1), Some((module, joint)));
        let others = (0..self.robots.len()).filter(|m| *m != module && behind.contains(&(*m, 0)));
        (!behind.contains(&(module, joint))).then(|| others.collect())
    }
    /// Returns the box of cells, in half cells, that the modules of a turn can reach, with `moving` those behind the joint.
    pub fn reach(&self, module: usize, joint: usize, moving: &[usize]) -> [[i16; 3]; 2] {
        let pivot = self.robots[module].centres()[usize::from(joint == 2)];
        let cubes = moving.iter().chain([&module]).flat_map(|m| self.robots[*m].centres());
        let square = |c: [i16; 3]| (0..3).map(|i| i32::from(c[i] - pivot[i]).pow(2)).sum::<i32>();
        // A cube reaches 0.58 cells from its centre, so one cell beyond the distance is enough.
        let reach = cubes.map(square).max().unwrap_or(0).isqrt() as i16 + 3;
        [pivot.map(|x| x - reach), pivot.map(|x| x + reach)]
    }

    pub(super) fn robot(&self, module: usize) -> Result<&Robot, Refusal> {
        self.robots.get(module).ok_or(Refusal::NoModule(module))
    }
    pub(super) fn facing(&self, a: Place, b: Place) -> Result<(), Refusal> {
        let (plate_a, normal_a) = self.robot(a.0)?.plate(a.1);
        let (plate_b, normal_b) = self.robot(b.0)?.plate(b.1);
        let meet = a.0 != b.0 && plate_a == plate_b && normal_a == normal_b.map(|x| -x);
        if meet { Ok(()) } else { Err(Refusal::NotFacing(a, b)) }
    }
    /// Refuses a world in which modules overlap.
    pub fn apart(&self) -> Result<(), Refusal> {
        let mut filled: Vec<([i16; 3], usize)> = Vec::new();
        for (i, robot) in self.robots.iter().enumerate() {
            for centre in robot.centres() {
                if let Some((_, other)) = filled.iter().find(|(c, _)| *c == centre) {
                    let [x, y, z] = centre.map(|h| h.div_euclid(2));
                    return Err(Refusal::Collision(*other, i, Cell::new(x, y, z)));
                }
                filled.push((centre, i));
            }
        }
        Ok(())
    }
    /// Refuses a world that is not in one piece.
    pub fn whole(&self) -> Result<(), Refusal> {
        let reached = self.flood((0, 0), None);
        let lost = (0..self.robots.len()).find(|m| !reached.contains(&(*m, 0)));
        lost.map_or(Ok(()), |m| Err(Refusal::Parted(m)))
    }
    /// Returns the hemispheres connected with `from` when the joint `without` (module and joint) is cut.
    pub(super) fn flood(
        &self,
        from: (usize, usize),
        without: Option<(usize, usize)>,
    ) -> BTreeSet<(usize, usize)> {
        let mut reached = BTreeSet::from([from]);
        let mut edge = vec![from];
        while let Some((m, h)) = edge.pop() {
            let mut next = Vec::new();
            // Joint j is between the hemispheres j and j + 1.
            if h > 0 && without != Some((m, h - 1)) {
                next.push((m, h - 1));
            }
            if h < 3 && without != Some((m, h)) {
                next.push((m, h + 1));
            }
            for ((a, c), (b, d)) in &self.held {
                let ends = [(*a, c.hemisphere()), (*b, d.hemisphere())];
                if ends[0] == (m, h) {
                    next.push(ends[1]);
                }
                if ends[1] == (m, h) {
                    next.push(ends[0]);
                }
            }
            edge.extend(next.into_iter().filter(|n| reached.insert(*n)));
        }
        reached
    }
}

/// Returns a module at a lattice pose given by the cell of its first cube.
pub fn robot(cell: [i16; 3], rotation: LatticeRotation, steps: &[u8; 3]) -> Robot {
    let normal = rotation.apply([0, 0, 1]);
    let half = [0, 1, 2].map(|i| 2 * cell[i] - normal[i]);
    let posture = Posture::from_steps(Kind::Single, steps).expect("invariant: a module has three joints");
    Robot { foot: LatticePose { rotation, half }, posture }
}
