//! The point at which a ray from the head over the hand meets the floor.

/// Length of the edge of a tile in metres: that of a cell of Roombots.
pub const TILE: f64 = 0.11;
/// Largest distance from the hand, in metres, at which a ray meets the floor: tiles farther away are seen too flat to
/// be distinguished.
const DISTANCE_MAX: f64 = 20.0;

/// A tile of the floor: its centre is at 0.11 m times these numbers.
pub type Tile = [i32; 2];

/// Returns the tile that is pointed at: positions in metres in a right-handed frame with z up and the floor at z = 0.
/// `None` if the ray does not go down, or meets the floor more than 20 m from the hand.
pub fn tile(head: [f64; 3], hand: [f64; 3]) -> Option<Tile> {
    let down = head[2] - hand[2];
    if down <= 0.0 || hand[2] < 0.0 {
        return None;
    }
    let along = hand[2] / down;
    let point = [0, 1].map(|i| hand[i] + (hand[i] - head[i]) * along);
    let far = libm::hypot(point[0] - hand[0], point[1] - hand[1]);
    // A number that is no number is not near either.
    (far <= DISTANCE_MAX).then(|| point.map(|x| libm::round(x / TILE) as i32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_meets_the_tile_below_its_point() {
        let cases = [
            ([-0.8404, 0.9294, 1.7105], [-0.0714, 0.984, 1.2268], Some([17, 10])),
            ([-0.3832, -0.7758, 1.6648], [-0.0085, -0.5477, 1.124], Some([7, -1])),
            ([0.0, 0.0, 1.7], [0.6, 0.0, 1.7], None),
            ([0.0, 0.0, 1.7], [0.6, 0.0, 1.8], None),
            ([0.0, 0.0, 1.7], [0.6, 0.0, 1.68], None),
            ([0.0, 0.0, 1.7], [0.0, 0.0, 1.1], Some([0, 0])),
            ([f64::NAN, 0.0, 1.7], [0.0, 0.0, 1.1], None),
        ];
        for (head, hand, expected) in cases {
            assert_eq!(tile(head, hand), expected, "{head:?} {hand:?}");
        }
    }
}
