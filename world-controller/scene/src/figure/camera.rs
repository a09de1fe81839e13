//! The camera of a figure: a parallel projection, in which lengths in the plane of the picture can be measured.
//!
//! The azimuth turns the eye about z, from the front (the eye at −y, x to the right) towards the side (the eye at
//! +x, y to the right); the elevation raises it above the horizon.

use std::fmt;
use std::str::FromStr;

/// A point or direction in space, in edges of a cell.
pub type V = [f64; 3];
/// A point of the picture, in edges of a cell: to the right, and up.
pub type P = [f64; 2];

/// Returns the scalar product.
pub fn dot(a: V, b: V) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A direction to look from, in hundredths of a degree, so that equal cameras are equal in every digit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Camera {
    azimuth: i32,
    elevation: i32,
}

/// The cameras that have names: azimuth and elevation in hundredths of a degree.
const NAMED: [(&str, i32, i32); 5] = [
    ("iso", 3_000, 2_400),
    ("true-iso", 4_500, 3_526),
    ("front", 0, 0),
    ("side", 9_000, 0),
    ("top", 0, 9_000),
];

impl FromStr for Camera {
    type Err = String;

    fn from_str(text: &str) -> Result<Camera, String> {
        if let Some((_, azimuth, elevation)) = NAMED.into_iter().find(|(name, ..)| *name == text) {
            return Ok(Camera { azimuth, elevation });
        }
        let wrong = || {
            let names: Vec<&str> = NAMED.iter().map(|(name, ..)| *name).collect();
            format!("name one of {}, or an azimuth and an elevation in degrees: 30,24", names.join(", "))
        };
        let (azimuth, elevation) = text.split_once(',').ok_or_else(wrong)?;
        let hundredths = |text: &str| match text.trim().parse::<f64>() {
            Ok(degrees) if degrees.abs() <= 360.0 => Ok((degrees * 100.0).round() as i32),
            _ => Err(wrong()),
        };
        let camera = Camera { azimuth: hundredths(azimuth)?, elevation: hundredths(elevation)? };
        if camera.elevation.abs() > 9_000 {
            return Err("the elevation is from -90 to 90 degrees".to_owned());
        }
        Ok(camera)
    }
}

impl fmt::Display for Camera {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let own = (self.azimuth, self.elevation);
        match NAMED.iter().find(|(_, azimuth, elevation)| (*azimuth, *elevation) == own) {
            Some((name, ..)) => f.write_str(name),
            None => write!(f, "{},{}", f64::from(own.0) / 100.0, f64::from(own.1) / 100.0),
        }
    }
}

impl Camera {
    /// Returns the projection.
    pub fn view(self) -> View {
        // Sines that are the same on every machine, and exact where the page expects zeros and ones.
        let sin_cos = |hundredths: i32| match hundredths.rem_euclid(36_000) {
            0 => (0.0, 1.0),
            9_000 => (1.0, 0.0),
            18_000 => (0.0, -1.0),
            27_000 => (-1.0, 0.0),
            other => libm::sincos(f64::from(other) / 100.0 * std::f64::consts::PI / 180.0),
        };
        let ((sa, ca), (se, ce)) = (sin_cos(self.azimuth), sin_cos(self.elevation));
        View { right: [ca, sa, 0.0], up: [-sa * se, ca * se, ce], eye: [sa * ce, -ca * ce, se] }
    }
}

/// A parallel projection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The direction that is to the right in the picture.
    pub right: V,
    /// The direction that is up in the picture.
    pub up: V,
    /// The direction from the picture to the eye.
    pub eye: V,
}

impl View {
    /// Projects a point.
    pub fn project(&self, point: V) -> P {
        [dot(point, self.right), dot(point, self.up)]
    }
    /// Returns how near to the eye a point is.
    pub fn nearness(&self, point: V) -> f64 {
        dot(point, self.eye)
    }
    /// Returns true if a face with this normal is turned to the eye.
    pub fn faces(&self, normal: V) -> bool {
        dot(normal, self.eye) > 1e-9
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn named_cameras_look_along_the_axes() {
        let eye = |text: &str| text.parse::<Camera>().unwrap().view();
        assert_eq!(eye("front").eye, [0.0, -1.0, 0.0]);
        assert_eq!(eye("front").project([1.0, 5.0, 2.0]), [1.0, 2.0]);
        assert_eq!(eye("side").project([7.0, 1.0, 2.0]), [1.0, 2.0]);
        assert_eq!(eye("top").project([1.0, 2.0, 9.0]), [1.0, 2.0]);
        let iso = eye("true-iso");
        let lengths = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| {
            let [x, y] = iso.project(axis);
            (x * x + y * y).sqrt()
        });
        assert!(lengths.iter().all(|l| (l - lengths[0]).abs() < 1e-4), "{lengths:?}");
    }

    #[test]
    fn cameras_are_read_and_printed_alike() {
        for text in ["iso", "true-iso", "front", "side", "top", "12.5,-30"] {
            assert_eq!(text.parse::<Camera>().unwrap().to_string(), text);
        }
        assert_eq!("30,24".parse::<Camera>(), "iso".parse());
        for text in ["", "iso2", "1", "1,2,3", "nan,0", "0,91", "1e9,0"] {
            assert!(text.parse::<Camera>().is_err(), "{text}");
        }
    }
}
