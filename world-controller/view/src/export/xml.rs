//! Numbers and poses as they stand in XML files of robots.

use nalgebra::Isometry3;

/// Returns numbers with nine decimals at most, separated by blanks.
pub fn numbers(numbers: &[f64]) -> String {
    let one = |n: &f64| {
        let text = format!("{n:.9}");
        match text.trim_end_matches('0').trim_end_matches('.') {
            "-0" => "0".to_owned(),
            short => short.to_owned(),
        }
    };
    numbers.iter().map(one).collect::<Vec<_>>().join(" ")
}

/// Returns the position of a pose, and its roll, pitch and yaw.
pub fn pose_numbers(pose: &Isometry3<f64>) -> [f64; 6] {
    let at = pose.translation.vector;
    let (roll, pitch, yaw) = pose.rotation.euler_angles();
    [at.x, at.y, at.z, roll, pitch, yaw]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        assert_eq!(numbers(&[0.0, -1e-12, 0.11, -2.5, 1e-7, 100.0]), "0 0 0.11 -2.5 0.0000001 100");
    }
}
