//! Solids described by text, as the `<csg>` of VisibleSim has them: the part of OpenSCAD's language that its parser knows.
//!
//! Known are `cube`, `sphere`, `cylinder`, `torus`, moved by `translate`, `rotate`, `scale` and joined by `union`,
//! `intersection`, `difference`; numbers may be sums and products. `color` is ignored. Solids contain their
//! surface. As in VisibleSim, `rotate` turns around z first, then y, then x. Several solids side by side are their union, of
//! which VisibleSim takes the first. Absent: variables, modules and loops.

use super::COMMA_HINT;
use super::error::{MAX_CSG_DEPTH, MAX_CSG_PARTS};

/// A point or vector.
pub type Vector = [f64; 3];

/// The distance outside a surface, in cells, at which a point still counts as on it: more than rounding makes.
const SURFACE_DISTANCE: f64 = 1e-9;
/// Largest number of numbers between two parentheses.
const MAX_ARGUMENTS: usize = 16;
/// Characters of wrong text shown at most.
const SHOWN_CHARS: usize = 40;

/// A solid, with what it is made of.
#[derive(Clone, Debug, PartialEq)]
pub enum Solid {
    /// All points between two corners.
    Cube(Vector, Vector),
    /// All points within a radius.
    Sphere(f64),
    /// A cylinder or a part of a cone, along z.
    Cylinder {
        /// The lower end.
        low: f64,
        /// The distance of the ends.
        height: f64,
        /// The radii at the lower and the upper end.
        radii: [f64; 2],
    },
    /// A torus around z: the radius of the ring and that of its tube.
    Torus(f64, f64),
    /// A solid that has been moved.
    Moved(Motion, Box<Solid>),
    /// All points of at least one of them.
    Union(Vec<Solid>),
    /// All points of each of them.
    Intersection(Vec<Solid>),
    /// All points of the first that are in none of the others.
    Difference(Vec<Solid>),
}

/// A motion: first the matrix, then the vector.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// The inverse of the matrix.
    back: [Vector; 3],
    by: Vector,
    /// Two corners of a box around the moved solid, outside of which nothing needs to be computed.
    corners: Option<[Vector; 2]>,
}

/// Why a text describes no solid.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wrong {
    /// The byte.
    pub at: usize,
    /// The cause.
    pub why: Why,
}

/// A cause.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Why {
    /// It violates the language.
    Syntax(String),
    /// It uses a part of the language that is not supported.
    NotRead(String),
    /// It has too many parts of one kind: the kind and the maximum.
    TooMany(&'static str, usize),
}

impl Solid {
    /// Returns true if the point is in the solid or on its surface.
    pub fn contains(&self, [x, y, z]: Vector) -> bool {
        let within = |value: f64, low: f64, high: f64| {
            value >= low - SURFACE_DISTANCE && value <= high + SURFACE_DISTANCE
        };
        match self {
            Solid::Cube(low, high) => {
                [x, y, z].into_iter().zip(low).zip(high).all(|((c, l), h)| within(c, *l, *h))
            }
            Solid::Sphere(radius) => within(length(&[x, y, z]), 0.0, *radius),
            Solid::Cylinder { low, height, radii: [base, top] } => {
                let slope = if base == top { 0.0 } else { (z - low) * (top - base) / height };
                within(z, *low, low + height) && within(length(&[x, y]), 0.0, base + slope)
            }
            Solid::Torus(ring, tube) => within(length(&[length(&[x, y]) - ring, z]), 0.0, *tube),
            Solid::Moved(motion, solid) => {
                let near = |corners: &[Vector; 2]| Solid::Cube(corners[0], corners[1]).contains([x, y, z]);
                let [bx, by, bz] = motion.by;
                motion.corners.as_ref().is_some_and(near)
                    && solid.contains(times(&motion.back, [x - bx, y - by, z - bz]))
            }
            Solid::Union(solids) => solids.iter().any(|solid| solid.contains([x, y, z])),
            Solid::Intersection(solids) => {
                !solids.is_empty() && solids.iter().all(|solid| solid.contains([x, y, z]))
            }
            Solid::Difference(solids) => solids.split_first().is_some_and(|(first, others)| {
                first.contains([x, y, z]) && !others.iter().any(|solid| solid.contains([x, y, z]))
            }),
        }
    }

    /// Returns two corners of a box around the solid; those of the first one where others only take away.
    pub fn corners(&self) -> Option<[Vector; 2]> {
        match self {
            Solid::Cube(low, high) => Some([*low, *high]),
            Solid::Sphere(radius) => Some([[-radius; 3], [*radius; 3]]),
            Solid::Cylinder { low, height, radii: [base, top] } => {
                let radius = base.max(*top);
                Some([[-radius, -radius, *low], [radius, radius, low + height]])
            }
            Solid::Torus(ring, tube) => {
                let radius = ring + tube;
                Some([[-radius, -radius, -tube], [radius, radius, *tube]])
            }
            Solid::Moved(motion, _) => motion.corners,
            Solid::Union(solids) => solids.iter().filter_map(Solid::corners).reduce(around),
            Solid::Intersection(solids) | Solid::Difference(solids) => solids.first()?.corners(),
        }
    }
}

impl Motion {
    fn new(matrix: [Vector; 3], back: [Vector; 3], by: Vector, solid: &Solid) -> Motion {
        let moved = |ends: [Vector; 2]| {
            let corners = (0..8usize).map(|corner| {
                let turned = times(&matrix, [0, 1, 2].map(|axis| ends[corner >> axis & 1][axis]));
                let moved = [0, 1, 2].map(|axis| turned[axis] + by[axis]);
                [moved, moved]
            });
            corners.reduce(around)
        };
        Motion { back, by, corners: solid.corners().and_then(moved) }
    }
}

/// Returns the corners of the box around two boxes.
fn around([low, high]: [Vector; 2], [other_low, other_high]: [Vector; 2]) -> [Vector; 2] {
    let axes = [0, 1, 2];
    [axes.map(|axis| low[axis].min(other_low[axis])), axes.map(|axis| high[axis].max(other_high[axis]))]
}

fn length(vector: &[f64]) -> f64 {
    vector.iter().map(|c| c * c).sum::<f64>().sqrt()
}

fn times(matrix: &[Vector; 3], vector: Vector) -> Vector {
    matrix.map(|row| row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2])
}

/// Returns a matrix with this diagonal.
fn diagonal([x, y, z]: Vector) -> [Vector; 3] {
    [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]]
}

/// Returns the matrix that turns by these degrees around z, then y, then x.
fn rotation([x, y, z]: Vector) -> [Vector; 3] {
    let ([sx, cx], [sy, cy], [sz, cz]) = (sine_and_cosine(x), sine_and_cosine(y), sine_and_cosine(z));
    [
        [cy * cz, -cy * sz, sy],
        [cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -sx * cy],
        [sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy],
    ]
}

/// Returns sine and cosine of an angle in degrees; exactly those of quarter turns.
fn sine_and_cosine(degrees: f64) -> [f64; 2] {
    match degrees.rem_euclid(360.0) {
        0.0 => [0.0, 1.0],
        90.0 => [1.0, 0.0],
        180.0 => [0.0, -1.0],
        270.0 => [-1.0, 0.0],
        other => [libm::sin(other.to_radians()), libm::cos(other.to_radians())],
    }
}

/// Returns the rows of a matrix as its columns.
fn transposed(matrix: &[Vector; 3]) -> [Vector; 3] {
    [0, 1, 2].map(|column| [0, 1, 2].map(|row| matrix[row][column]))
}

/// Reads a solid, with the number of its parts. Several solids are their union.
pub fn parse(text: &str) -> Result<(Solid, u64), Wrong> {
    let mut parser = Parser { text, at: 0, parts: 0, depth: 0 };
    let mut solids = Vec::new();
    while parser.peek().is_some() {
        solids.push(parser.solid()?);
    }
    if solids.is_empty() {
        return Err(parser.expected("a solid such as `cube([4, 4, 2])`"));
    }
    Ok((Solid::Union(solids), parser.parts as u64 + 1))
}

struct Parser<'a> {
    text: &'a str,
    /// The byte read next.
    at: usize,
    /// Solids so far.
    parts: usize,
    /// Solids and parentheses around this place.
    depth: usize,
}

/// The arguments of a solid or a motion.
struct Arguments<'a> {
    /// The byte where the keyword begins.
    at: usize,
    keyword: &'a str,
    numbers: Vec<f64>,
    named: Vec<(&'a str, f64)>,
    center: bool,
}

impl<'a> Parser<'a> {
    fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    fn wrong<T>(&self, at: usize, why: Why) -> Result<T, Wrong> {
        Err(Wrong { at, why })
    }

    /// Returns the error for something else than expected at this place.
    fn expected(&mut self, expected: &str) -> Wrong {
        self.blanks();
        let shown: String = self.rest().chars().take(SHOWN_CHARS).collect();
        let shown = shown.split(['\n', '\r']).next().unwrap_or_default();
        let found = if shown.is_empty() { "the end".to_owned() } else { format!("\"{shown}\"") };
        Wrong { at: self.at, why: Why::Syntax(format!("expected {expected}, found {found}")) }
    }

    /// Skips blanks and comments.
    fn blanks(&mut self) {
        loop {
            let rest = self.rest().trim_start();
            let end = match rest.get(..2) {
                Some("//") => rest.find(['\n', '\r']).unwrap_or(rest.len()),
                Some("/*") => rest.find("*/").map_or(rest.len(), |end| end + 2),
                _ => 0,
            };
            self.at = self.text.len() - rest.len() + end;
            if end == 0 {
                return;
            }
        }
    }

    /// Returns the next character behind blanks, separators and the mark for a preview, if there is one.
    fn peek(&mut self) -> Option<char> {
        self.blanks();
        while [';', ',', '#'].into_iter().any(|mark| self.accept(mark)) {}
        self.rest().chars().next()
    }

    /// Skips a character if it is next.
    fn accept(&mut self, wanted: char) -> bool {
        self.blanks();
        let found = self.rest().starts_with(wanted);
        self.at += if found { wanted.len_utf8() } else { 0 };
        found
    }

    fn expect(&mut self, wanted: char) -> Result<(), Wrong> {
        if self.accept(wanted) { Ok(()) } else { Err(self.expected(&format!("`{wanted}`"))) }
    }

    fn name(&mut self) -> &'a str {
        self.blanks();
        let rest = self.rest();
        let end = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_' && c != '$');
        let word = &rest[..end.unwrap_or(rest.len())];
        self.at += word.len();
        word
    }

    /// Reads something one level further inside.
    fn inside<T>(&mut self, read: impl FnOnce(&mut Self) -> Result<T, Wrong>) -> Result<T, Wrong> {
        if self.depth == MAX_CSG_DEPTH {
            return self.wrong(self.at, Why::TooMany("levels in one another", MAX_CSG_DEPTH));
        }
        self.depth += 1;
        let result = read(self);
        self.depth -= 1;
        result
    }

    /// Reads one solid with all that moves it.
    fn solid(&mut self) -> Result<Solid, Wrong> {
        self.peek();
        self.parts += 1;
        if self.parts > MAX_CSG_PARTS {
            return self.wrong(self.at, Why::TooMany("solids", MAX_CSG_PARTS));
        }
        let at = self.at;
        let keyword = self.name();
        match keyword {
            "" => Err(self.expected("a solid such as `cube([4, 4, 2])`")),
            "cube" | "sphere" | "cylinder" | "torus" => self.arguments(at, keyword)?.primitive(),
            "union" | "intersection" | "difference" => {
                self.arguments(at, keyword)?.numbers(&[0])?;
                let solids = self.inside(Self::children)?;
                Ok(match keyword {
                    "union" => Solid::Union(solids),
                    "intersection" => Solid::Intersection(solids),
                    _ => Solid::Difference(solids),
                })
            }
            "translate" | "rotate" | "scale" | "color" => {
                let arguments = self.arguments(at, keyword)?;
                let solids = self.inside(Self::children)?;
                arguments.moved(Solid::Union(solids))
            }
            other => {
                let other: String = other.chars().take(SHOWN_CHARS).collect();
                self.wrong(at, Why::NotRead(format!("`{other}` of <csg>")))
            }
        }
    }

    /// Reads the solids between braces, or one without them.
    fn children(&mut self) -> Result<Vec<Solid>, Wrong> {
        self.peek();
        if !self.accept('{') {
            return Ok(vec![self.solid()?]);
        }
        let mut solids = Vec::new();
        while self.peek().is_some_and(|next| next != '}') {
            solids.push(self.solid()?);
        }
        self.expect('}')?;
        Ok(solids)
    }

    fn arguments(&mut self, at: usize, keyword: &'a str) -> Result<Arguments<'a>, Wrong> {
        let mut arguments = Arguments { at, keyword, numbers: Vec::new(), named: Vec::new(), center: false };
        self.expect('(')?;
        while !self.accept(')') {
            self.argument(&mut arguments)?;
            if arguments.numbers.len() + arguments.named.len() > MAX_ARGUMENTS {
                return self.wrong(at, Why::TooMany("numbers between two parentheses", MAX_ARGUMENTS));
            }
            if !self.accept(',') {
                self.expect(')')?;
                break;
            }
        }
        Ok(arguments)
    }

    /// Reads a number, a vector, `true` or `false`, each perhaps with a name.
    fn argument(&mut self, arguments: &mut Arguments<'a>) -> Result<(), Wrong> {
        self.blanks();
        let at = self.at;
        let word = self.name();
        let name = if self.accept('=') { Some(word) } else { None };
        if name.is_none() {
            self.at = at;
        }
        let value = self.at;
        match (self.name(), name) {
            (flag @ ("true" | "false"), None | Some("center")) => {
                arguments.center = flag == "true";
                return Ok(());
            }
            _ => self.at = value,
        }
        match name {
            Some(name) if name != "size" => arguments.named.push((name, self.sum()?)),
            _ if self.accept('[') => {
                while !self.accept(']') {
                    arguments.numbers.push(self.sum()?);
                    if !self.accept(',') {
                        self.expect(']')?;
                        break;
                    }
                    if arguments.numbers.len() > MAX_ARGUMENTS {
                        break;
                    }
                }
            }
            _ => arguments.numbers.push(self.sum()?),
        }
        Ok(())
    }

    /// Reads numbers that are added and multiplied.
    fn sum(&mut self) -> Result<f64, Wrong> {
        self.blanks();
        let at = self.at;
        let mut sum = self.product()?;
        loop {
            if self.accept('+') {
                sum += self.product()?;
            } else if self.accept('-') {
                sum -= self.product()?;
            } else if sum.is_finite() {
                return Ok(sum);
            } else {
                return self.wrong(at, Why::Syntax("a number of <csg> is not finite".to_owned()));
            }
        }
    }

    fn product(&mut self) -> Result<f64, Wrong> {
        let mut product = self.factor()?;
        loop {
            if self.accept('*') {
                product *= self.factor()?;
            } else if self.accept('/') {
                product /= self.factor()?;
            } else {
                return Ok(product);
            }
        }
    }

    fn factor(&mut self) -> Result<f64, Wrong> {
        let mut sign = 1.0;
        while self.accept('-') {
            sign = -sign;
        }
        if self.accept('(') {
            let sum = self.inside(Self::sum)?;
            self.expect(')')?;
            return Ok(sign * sum);
        }
        let rest = self.rest();
        let mut before = ' ';
        let end = rest.find(|c: char| {
            let exponent = matches!(c, 'e' | 'E') || matches!((before, c), ('e' | 'E', '+' | '-'));
            before = c;
            !(c.is_ascii_digit() || c == '.' || exponent)
        });
        let number = &rest[..end.unwrap_or(rest.len())];
        let value: f64 = number.parse().map_err(|_| self.expected("a number such as 1.5"))?;
        self.at += number.len();
        Ok(sign * value)
    }
}

impl Arguments<'_> {
    fn wrong<T>(&self, why: String) -> Result<T, Wrong> {
        Err(Wrong { at: self.at, why: Why::Syntax(why) })
    }

    /// Returns the numbers, of which there must be one of these counts.
    fn numbers(&self, counts: &[usize]) -> Result<&[f64], Wrong> {
        if let Some((name, _)) = self.named.first() {
            let why = Why::NotRead(format!("`{name}` of `{}` in <csg>", self.keyword));
            return Err(Wrong { at: self.at, why });
        }
        if counts.contains(&self.numbers.len()) {
            return Ok(&self.numbers);
        }
        let expected: Vec<String> = counts.iter().map(usize::to_string).collect();
        let point = if self.numbers.len() > 1 { COMMA_HINT } else { "" };
        let (keyword, found) = (self.keyword, self.numbers.len());
        self.wrong(format!("expected {} numbers of `{keyword}`, found {found}{point}", expected.join(" or ")))
    }

    /// Returns three numbers; one stands for three equal ones.
    fn vector(&self) -> Result<Vector, Wrong> {
        match *self.numbers(&[1, 3])? {
            [x, y, z] => Ok([x, y, z]),
            ref one => Ok([one[0]; 3]),
        }
    }

    /// Takes the first of these names that is there; a name that begins with `d` is a diameter.
    fn take(&mut self, names: &[&str]) -> Option<f64> {
        let (found, value) =
            names.iter().find_map(|name| self.named.iter().find(|(n, _)| n == name)).copied()?;
        Some(if found.starts_with('d') { value / 2.0 } else { value })
    }

    fn primitive(mut self) -> Result<Solid, Wrong> {
        let half = if self.center { 0.5 } else { 0.0 };
        match self.keyword {
            "cube" => {
                let size = self.vector()?;
                let low = size.map(|side| -side * half);
                Ok(Solid::Cube(low, [0, 1, 2].map(|axis| low[axis] + size[axis])))
            }
            "torus" => {
                let numbers = self.numbers(&[2])?;
                Ok(Solid::Torus(numbers[0], numbers[1]))
            }
            "sphere" => {
                let named = self.take(&["r", "d"]);
                self.named.retain(|(name, _)| !["r", "d"].contains(name));
                self.numbers.extend(named);
                Ok(Solid::Sphere(self.numbers(&[1])?[0]))
            }
            _ => self.cylinder(half),
        }
    }

    /// Reads height and radius, or height and both radii, in this order or by their names.
    fn cylinder(mut self, half: f64) -> Result<Solid, Wrong> {
        let mut of_place = std::mem::take(&mut self.numbers).into_iter();
        let height = self.take(&["h"]).or_else(|| of_place.next());
        let base = self.take(&["r1", "d1", "r", "d"]).or_else(|| of_place.next());
        let top = self.take(&["r2", "d2", "r", "d"]).or_else(|| of_place.next()).or(base);
        self.numbers = [height, base, top].into_iter().flatten().chain(of_place).collect();
        self.named.retain(|(name, _)| !["h", "r", "r1", "r2", "d", "d1", "d2"].contains(name));
        let numbers = self.numbers(&[3])?;
        let height = numbers[0];
        Ok(Solid::Cylinder { low: -height * half, height, radii: [numbers[1], numbers[2]] })
    }

    fn moved(&self, solid: Solid) -> Result<Solid, Wrong> {
        let one = diagonal([1.0; 3]);
        let (forth, back, by) = match self.keyword {
            "translate" => (one, one, self.vector()?),
            "rotate" => {
                let matrix = rotation(self.vector()?);
                (matrix, transposed(&matrix), [0.0; 3])
            }
            "scale" => {
                let scale = self.vector()?;
                if scale.contains(&0.0) {
                    return self.wrong("a `scale` of 0 leaves no solid".to_owned());
                }
                (diagonal(scale), diagonal(scale.map(f64::recip)), [0.0; 3])
            }
            _ => return Ok(solid),
        };
        Ok(Solid::Moved(Motion::new(forth, back, by, &solid), Box::new(solid)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the number of whole points from -9 to 9 in a solid, and the low corner of its box.
    fn read(text: &str) -> Result<(usize, Vector), String> {
        let (solid, _) = parse(text).map_err(|wrong| format!("{}: {:?}", wrong.at, wrong.why))?;
        let all = || (-9..=9).map(f64::from);
        let points = all().flat_map(|x| all().flat_map(move |y| all().map(move |z| [x, y, z])));
        let low = solid.corners().map_or([0.0; 3], |[low, _]| low.map(|c| (c * 1e6).round() / 1e6 + 0.0));
        Ok((points.filter(|point| solid.contains(*point)).count(), low))
    }

    #[test]
    fn solids_contain_the_points_up_to_their_surface() {
        for (text, points, low) in [
            ("cube([2, 1, 0]);", 6, [0.0; 3]),
            ("cube([2, 2, 2], true)", 27, [-1.0; 3]),
            ("cube(2, center = true)", 27, [-1.0; 3]),
            ("cube(size = [2, 2, 2], center = true)", 27, [-1.0; 3]),
            ("cube(2, 1, 1, false);", 12, [0.0; 3]),
            ("sphere(1);", 7, [-1.0; 3]),
            ("sphere(d = 2);", 7, [-1.0; 3]),
            ("cylinder(2, 1);", 15, [-1.0, -1.0, 0.0]),
            ("cylinder(2, 1, true);", 15, [-1.0; 3]),
            ("cylinder(h = 2, r = 1, center = true);", 15, [-1.0; 3]),
            ("cylinder(1, 1, 0);", 6, [-1.0, -1.0, 0.0]),
            ("cylinder(h = 1, d1 = 2, d2 = 0);", 6, [-1.0, -1.0, 0.0]),
            ("cylinder(0, 1, 1);", 5, [-1.0, -1.0, 0.0]),
            ("torus(2, 0.5);", 12, [-2.5, -2.5, -0.5]),
            ("translate([1, 2, -(1 + 2) * 2 / 3]) cube(0);", 1, [1.0, 2.0, -2.0]),
            ("rotate([0, 0, 90]) cube([3, 1, 0]);", 8, [-1.0, 0.0, 0.0]),
            ("rotate([90, 0, 90]) translate([1, 0, 0]) cube(0);", 1, [0.0, 0.0, 1.0]),
            ("rotate([0, 0, 45]) cube([4, 4, 0], true);", 13, [-2.828427, -2.828427, 0.0]),
            ("scale([2, 1, 1]) cube([1, 1, 0]);", 6, [0.0; 3]),
            ("scale(0.1) cube([10 * 3, 0, 0]);", 4, [0.0; 3]),
            ("color([1, 0, 0]); cube(0);", 1, [0.0; 3]),
            ("union() { cube(0); translate([3, 0, 0]) #cube(0); };", 2, [0.0; 3]),
            ("union() { cube(0), cube(0) }", 1, [0.0; 3]),
            ("translate([1, 0, 0]) { cube(0); sphere(1); }", 7, [0.0, -1.0, -1.0]),
            ("cube(0); translate([3, 0, 0]) cube(0);", 2, [0.0; 3]),
            ("difference() { cube(2); // all but a corner\n cube(0); }", 26, [0.0; 3]),
            ("intersection() { cube(2); /* a face */ translate([2, 0, 0]) cube(2); }", 9, [0.0; 3]),
            ("intersection() {}", 0, [0.0; 3]),
        ] {
            assert_eq!(read(text), Ok((points, low)), "{text}");
        }
    }

    #[test]
    fn wrong_text_is_shown_with_its_place() {
        let deep = "translate([1, 0, 0]) ".repeat(MAX_CSG_DEPTH + 1);
        let parentheses = format!("cube({}", "(".repeat(MAX_CSG_DEPTH + 1));
        for (text, error) in [
            ("", "0: Syntax(\"expected a solid such as"),
            ("pyramid(3);", "0: NotRead(\"`pyramid` of <csg>\")"),
            ("cube(1); for (i = [0:3]) cube(i);", "9: NotRead(\"`for` of <csg>\")"),
            ("w = 3; cube(w);", "0: NotRead(\"`w` of <csg>\")"),
            ("sphere(w);", "7: Syntax(\"expected a number such as 1.5, found \\\"w);"),
            ("sphere(2, $fn = 9);", "`$fn` of `sphere` in <csg>"),
            ("cube([1,5, 2,5, 3,5]);", "expected 1 or 3 numbers of `cube`, found 6; a point is wanted"),
            ("sphere(1,5);", "expected 1 numbers of `sphere`, found 2; a point is wanted"),
            ("cylinder(3);", "expected 3 numbers of `cylinder`, found 1"),
            ("union() { cube(1);", "expected `}`, found the end"),
            ("translate([1, 2, 3])", "expected a solid such as"),
            ("scale([1, 0, 1]) cube(1);", "a `scale` of 0"),
            ("cube(1 / 0);", "5: Syntax(\"a number of <csg> is not finite"),
            (&deep, "TooMany(\"levels in one another\", 64)"),
            (&parentheses, "TooMany(\"levels in one another\", 64)"),
            (&"cube(1);".repeat(MAX_CSG_PARTS + 1), "TooMany(\"solids\", 10000)"),
            (&format!("cube([{}", "1,".repeat(99)), "TooMany(\"numbers between two parentheses\", 16)"),
        ] {
            let found = read(text).unwrap_err();
            assert!(found.contains(error), "{}: {found}", &text[..text.len().min(60)]);
        }
    }
}
