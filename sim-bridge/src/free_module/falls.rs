//! Falls: how often the body of a structure turned upside down.

use super::physics::Placed;
use metamorph_protocol::free_module::limbs::partition;
use metamorph_protocol::free_module::structure::Structure;
use metamorph_protocol::ids::ModuleId;

/// The two hemispheres of a module between which its main joint is.
const INNER: [usize; 2] = [1, 2];

/// The direction upwards in the frame of a hemisphere.
pub type Up = [f32; 3];

/// Returns the direction upwards in the frame of a hemisphere: the third row of its rotation.
pub fn up(placed: &Placed) -> Up {
    let [x, y, z, w] = placed.rotation;
    [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)]
}

/// Counts falls. A structure has fallen when both inner hemispheres of a module of its body point down that pointed up at the
/// start, and has got up again when all of them point up. Structures without a body do not fall.
#[derive(Clone, Debug)]
pub struct Falls {
    /// Modules of the body, and what was up at the start.
    body: Vec<(ModuleId, [Up; 2])>,
    is_down: bool,
    count: u32,
}

impl Falls {
    /// Begins with the directions at the start.
    pub fn new(structure: &Structure, up: impl Fn(ModuleId, usize) -> Up) -> Falls {
        let parts = partition(structure);
        let body = parts.cyclic.iter().chain(&parts.linear);
        let body = body.map(|module| (*module, INNER.map(|h| up(*module, h)))).collect();
        Falls { body, is_down: false, count: 0 }
    }

    /// Takes the directions at another time.
    pub fn look(&mut self, up: impl Fn(ModuleId, usize) -> Up) {
        let points_down = |(module, start): &(ModuleId, [Up; 2])| {
            let dot = |a: &Up, b: Up| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
            [0, 1].map(|i| dot(&start[i], up(*module, INNER[i])) < 0.0)
        };
        let down: Vec<[bool; 2]> = self.body.iter().map(points_down).collect();
        if self.is_down {
            self.is_down = down.iter().flatten().any(|is_down| *is_down);
        } else if down.contains(&[true; 2]) {
            self.is_down = true;
            self.count += 1;
        }
    }

    /// Returns the number of falls.
    pub fn count(&self) -> u32 {
        self.count
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::free_module::named;

    const UP: Up = [0.0, 0.0, 1.0];
    const DOWN: Up = [0.0, 0.0, -1.0];

    #[test]
    fn the_direction_upwards_is_that_of_the_rotation() {
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let of = |rotation| up(&Placed { position: [0.0; 3], rotation });
        let near = |a: Up, b: Up| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(near(of([0.0, 0.0, 0.0, 1.0]), UP));
        assert!(near(of([1.0, 0.0, 0.0, 0.0]), DOWN));
        // After a quarter turn about x, y of the frame points up.
        assert!(near(of([half, 0.0, 0.0, half]), [0.0, 1.0, 0.0]));
    }

    /// A fall counts once until the structure has got up, and limbs may point anywhere.
    #[test]
    fn a_body_upside_down_is_a_fall() {
        let mut falls = Falls::new(&named::structure("quad5-sym").unwrap(), |_, _| UP);
        let body = |first, second| {
            move |module: ModuleId, h: usize| match (module, h) {
                (ModuleId(0), 1) => first,
                (ModuleId(0), 2) => second,
                _ => DOWN,
            }
        };
        for (first, second, count) in [
            (UP, UP, 0),
            (DOWN, UP, 0),
            (DOWN, DOWN, 1),
            (UP, DOWN, 1),
            (DOWN, DOWN, 1),
            (UP, UP, 1),
            (DOWN, DOWN, 2),
        ] {
            falls.look(body(first, second));
            assert_eq!(falls.count(), count);
        }
    }
}
