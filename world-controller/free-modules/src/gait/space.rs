//! The parameters of a network as a point in the unit box: amplitudes, offsets, and lags of a spanning tree.

use super::ask_tell::Point;
use metamorph_protocol::free_module::gait::message::Parameters;
use metamorph_protocol::free_module::network::{Lags, Morphology, Network, NetworkKind, NoOscillators, Role};
use metamorph_protocol::free_module::oscillator::{Angle, Phase};
use metamorph_protocol::free_module::structure::{Joint, Structure};
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// A gait: the parameters of every oscillator.
pub type Gait = BTreeMap<Joint, Parameters>;

/// Largest offset in degrees, unless a study says otherwise (the thesis gives no bounds).
pub const OFFSETS_DEG: f64 = 30.0;

/// Returns the largest amplitude of an articulation in radians (thesis table 7.1).
const fn largest(role: Option<Role>) -> f64 {
    match role {
        Some(Role::Spine) => 2.0 * PI / 3.0,
        Some(Role::Hip) => PI / 2.0,
        Some(Role::Knee | Role::Ankle) => PI / 6.0,
        None => PI,
    }
}

/// The parameters of a network.
#[derive(Clone, Debug)]
pub struct Space {
    network: Network,
    /// The largest amplitude of each group of oscillators.
    amplitudes: Vec<f64>,
    /// The largest offset in radians.
    offset: f64,
    /// The couplings whose lags are parameters.
    tree: Vec<(Joint, Joint)>,
}

impl Space {
    /// Returns the parameters of the network of a structure, with offsets of at most [`OFFSETS_DEG`].
    ///
    /// # Errors
    /// Refuses a structure in which no joint moves.
    pub fn of(structure: &Structure, kind: NetworkKind) -> Result<Space, NoOscillators> {
        Space::with_offsets(structure, kind, OFFSETS_DEG)
    }

    /// Returns the parameters of the network of a structure, with offsets of at most this many degrees.
    ///
    /// # Errors
    /// Refuses a structure in which no joint moves.
    pub fn with_offsets(
        structure: &Structure,
        kind: NetworkKind,
        offsets_deg: f64,
    ) -> Result<Space, NoOscillators> {
        let morphology = Morphology::of(structure);
        let network = morphology.network(kind)?;
        let roles = morphology.articulations(kind);
        let mut amplitudes = vec![PI; network.groups()];
        for (joint, group) in network.oscillators.iter().zip(&network.group) {
            amplitudes[*group] = largest(roles.get(joint).copied());
        }
        let couplings = network.couplings.iter().zip(&network.tree);
        let tree = couplings.filter(|(_, tree)| **tree).map(|(pair, _)| *pair).collect();
        Ok(Space { network, amplitudes, offset: PI / (180.0 / offsets_deg), tree })
    }

    /// Returns the number of parameters.
    pub fn dimensions(&self) -> usize {
        self.network.parameters(Lags::Tree)
    }
    /// Returns the number of amplitudes, which come first, and of offsets, which follow.
    pub fn groups(&self) -> usize {
        self.amplitudes.len()
    }
    /// Returns the joints with an oscillator.
    pub fn oscillators(&self) -> &[Joint] {
        &self.network.oscillators
    }

    /// Returns the gait of a point.
    pub fn gait(&self, point: &[f64]) -> Gait {
        let groups = self.amplitudes.len();
        let lags = &point[2 * groups..];
        let mut phases: BTreeMap<Joint, f64> = BTreeMap::new();
        for first in &self.network.oscillators {
            // One oscillator of each connected part has phase 0; those of the others follow by the lags.
            phases.entry(*first).or_insert(0.0);
            let mut grew = true;
            while grew {
                let before = phases.len();
                for ((a, b), lag) in self.tree.iter().zip(lags) {
                    let lag = lag - 0.5;
                    match (phases.get(a).copied(), phases.get(b).copied()) {
                        (Some(phase), None) => drop(phases.insert(*b, phase + lag)),
                        (None, Some(phase)) => drop(phases.insert(*a, phase - lag)),
                        _ => {}
                    }
                }
                grew = phases.len() > before;
            }
        }
        let oscillators = self.network.oscillators.iter().zip(&self.network.group);
        let parameters = |(joint, group): (&Joint, &usize)| {
            let amplitude = angle(point[*group] * self.amplitudes[*group]);
            let offset = angle((2.0 * point[groups + group] - 1.0) * self.offset);
            (*joint, Parameters { amplitude, offset, phase: phase(phases[joint]) })
        };
        oscillators.map(parameters).collect()
    }

    /// Returns the point of a gait, as far as it has the joints of this network; the middle of the box for the others.
    /// Values beyond the bounds are moved to them.
    pub fn point(&self, gait: &Gait) -> Point {
        let groups = self.amplitudes.len();
        let mut point = vec![0.5; self.dimensions()];
        // Backwards, so that the first member of a group decides.
        for (joint, group) in self.network.oscillators.iter().zip(&self.network.group).rev() {
            if let Some(parameters) = gait.get(joint) {
                point[*group] = radians(parameters.amplitude) / self.amplitudes[*group];
                point[groups + group] = radians(parameters.offset) / self.offset / 2.0 + 0.5;
            }
        }
        for ((a, b), lag) in self.tree.iter().zip(&mut point[2 * groups..]) {
            if let (Some(a), Some(b)) = (gait.get(a), gait.get(b)) {
                *lag = f64::from(b.phase.ahead_of(a.phase)) / TURN + 0.5;
            }
        }
        point.iter_mut().for_each(|x| *x = x.clamp(0.0, 1.0));
        point
    }
}

/// Number of units of a phase in a full turn.
const TURN: f64 = 4_294_967_296.0;

/// Returns an angle of radians.
pub fn angle(radians: f64) -> Angle {
    Angle((radians * f64::from(Angle::RADIAN.0)).round() as i32)
}
/// Returns the radians of an angle.
pub fn radians(angle: Angle) -> f64 {
    f64::from(angle.0) / f64::from(Angle::RADIAN.0)
}
/// Returns a phase of turns.
pub fn phase(turns: f64) -> Phase {
    Phase((turns * TURN).round() as i64 as u32)
}
/// Returns the turns of a phase, from 0 to 1.
pub fn turns(phase: Phase) -> f64 {
    f64::from(phase.0) / TURN
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gait::ask_tell::anywhere;
    use metamorph_protocol::free_module::named;
    use metamorph_protocol::ids::ModuleId;
    use metamorph_protocol::rng::Rng;

    /// Every point is a gait and comes back, in all networks, also without a body.
    #[test]
    fn points_and_gaits_go_there_and_back() {
        let mut rng = Rng::named(1, "test", 0);
        for name in named::NAMES {
            for dead in [None, Some(0), Some(2)] {
                let mut structure = named::structure(name).unwrap();
                dead.into_iter().for_each(|m| structure.set_passive(ModuleId(m)));
                for kind in NetworkKind::ALL {
                    let space = Space::of(&structure, kind).unwrap();
                    let point = anywhere(space.dimensions(), &mut rng);
                    let gait = space.gait(&point);
                    assert!(gait.keys().eq(space.oscillators()));
                    let back = space.point(&gait);
                    let off = point.iter().zip(&back).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                    assert!(off < 1e-5, "{name} {kind}, {dead:?} dead: {off}");
                }
            }
        }
    }

    #[test]
    fn bounds_are_those_of_the_thesis() {
        let space = Space::of(&named::structure("quad5-sym").unwrap(), NetworkKind::BlfSym).unwrap();
        assert_eq!(space.dimensions(), 14);
        let gait = space.gait(&[1.0; 14]);
        let of = |module, joint| radians(gait[&Joint::new(ModuleId(module), joint)].amplitude);
        let near = |a: f64, b: f64| (a - b).abs() < 1e-5;
        // q1 and q3 of the body are hips, q2 is the spine, and limbs have knees.
        assert!(near(of(0, 0), PI / 2.0) && near(of(0, 2), PI / 2.0) && near(of(0, 1), 2.0 * PI / 3.0));
        let knees: Vec<&Joint> = gait.keys().filter(|j| j.module() != ModuleId(0)).collect();
        assert!(knees.len() == 4 && knees.iter().all(|j| near(radians(gait[*j].amplitude), PI / 6.0)));
        assert!(gait.values().all(|p| near(radians(p.offset), OFFSETS_DEG.to_radians())));
        let full = Space::of(&named::structure("quad5-sym").unwrap(), NetworkKind::Fo).unwrap();
        assert!(full.gait(&vec![1.0; full.dimensions()]).values().all(|p| near(radians(p.amplitude), PI)));
    }
}
