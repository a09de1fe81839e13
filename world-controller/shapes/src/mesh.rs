//! Reads triangles from STL files, binary or text, and from OBJ files. Absent: whether the triangles enclose a solid
//! (see `voxel`).
//!
//! Text is read as bytes: only keywords and numbers count, so names and comments may have any encoding that
//! contains ASCII.

use super::comma_hint;
use super::error::{MAX_TRIANGLES, SolidError};
use metamorph_text::escape;
use metamorph_text::format::many;

/// Three corners, each with three coordinates.
pub type Triangle = [[f32; 3]; 3];

/// Bytes before the first triangle of a binary STL: a text of 80 bytes and a count.
const HEADER: usize = 84;
/// Bytes of a triangle in a binary STL.
const RECORD: usize = 50;
/// Bytes of wrong text shown at most.
const SHOWN: usize = 60;
/// Largest number of elements after `facet`: `normal` and three numbers.
const NORMAL_TOKENS: usize = 4;

/// Reads the triangles of an STL file, binary or text.
pub fn stl(file: &str, bytes: &[u8]) -> Result<Vec<Triangle>, SolidError> {
    let text = unmarked(bytes);
    let begins = |keyword: &[u8]| {
        let start = text.trim_ascii_start();
        start.get(..keyword.len()).is_some_and(|found| found.eq_ignore_ascii_case(keyword))
    };
    let count: Option<[u8; 4]> = bytes.get(80..HEADER).and_then(|count| count.try_into().ok());
    // Some programs begin a binary file with `solid`. Its count ends with a 0, which no text contains.
    if (begins(b"solid") || begins(b"facet")) && count.is_none_or(|count| count[3] != 0) {
        return stl_text(file, text);
    }
    let Some(count) = count else {
        return Err(SolidError::TooShort { file: file.to_owned(), bytes: bytes.len() });
    };
    if count.iter().all(|byte| byte.is_ascii_graphic() || byte.is_ascii_whitespace()) {
        let first = text.trim_ascii_start().split(|b| *b == b'\n').next().unwrap_or_default();
        let why = format!("expected `solid` or a binary STL, found \"{}\"", shown(first.trim_ascii_end()));
        return Err(SolidError::Syntax { file: file.to_owned(), line: 1, why });
    }
    let (promised, records) = (u32::from_le_bytes(count), bytes[HEADER..].chunks_exact(RECORD));
    if (records.len() as u64) < promised.into() {
        let (file, found, bytes) = (file.to_owned(), records.len() as u64, bytes.len() as u64);
        return Err(SolidError::Truncated { file, found, expected: promised.into(), bytes });
    }
    if promised as usize > MAX_TRIANGLES {
        return Err(SolidError::TooManyTriangles { file: file.to_owned(), found: promised.into() });
    }
    let triangles = records.take(promised as usize).map(|record| {
        // A normal of 12 bytes comes before the corners, and two bytes behind them.
        let number = |at: usize| {
            let at = 12 + at * 4;
            f32::from_le_bytes([record[at], record[at + 1], record[at + 2], record[at + 3]])
        };
        [0, 3, 6].map(|corner| [number(corner), number(corner + 1), number(corner + 2)])
    });
    finite(file, triangles.collect())
}

/// Reads a text STL. It may contain several solids.
fn stl_text(file: &str, text: &[u8]) -> Result<Vec<Triangle>, SolidError> {
    let mut tokens = Tokens { file, rest: text, line: 1 };
    let mut triangles = Vec::new();
    loop {
        match tokens.next().to_ascii_lowercase().as_slice() {
            b"" => return finite(file, triangles),
            b"solid" | b"endsolid" => tokens.skip_line(),
            b"facet" => triangles.push(tokens.facet()?),
            other => return Err(tokens.wrong("`facet` or `endsolid`", other)),
        }
        if triangles.len() > MAX_TRIANGLES {
            return Err(too_many(file, triangles.len()));
        }
    }
}

/// The elements of a text STL, between blanks.
struct Tokens<'a> {
    file: &'a str,
    rest: &'a [u8],
    /// The line of the last element, from 1.
    line: usize,
}

impl<'a> Tokens<'a> {
    /// Returns the next element, which is empty at the end.
    fn next(&mut self) -> &'a [u8] {
        let start = self.rest.trim_ascii_start();
        let blanks = &self.rest[..self.rest.len() - start.len()];
        let lone = |(i, byte): (usize, &u8)| *byte == b'\r' && blanks.get(i + 1) != Some(&b'\n');
        self.line += blanks.iter().enumerate().filter(|at| *at.1 == b'\n' || lone(*at)).count();
        let end = start.iter().position(u8::is_ascii_whitespace).unwrap_or(start.len());
        let (token, rest) = start.split_at(end);
        self.rest = rest;
        token
    }

    fn skip_line(&mut self) {
        let end = self.rest.iter().position(|byte| matches!(byte, b'\n' | b'\r'));
        self.rest = &self.rest[end.unwrap_or(self.rest.len())..];
    }

    /// Reads a facet behind its first keyword. Its normal follows from its corners.
    fn facet(&mut self) -> Result<Triangle, SolidError> {
        let mut token = self.next();
        for _ in 0..NORMAL_TOKENS {
            if token.eq_ignore_ascii_case(b"outer") {
                break;
            }
            token = self.next();
        }
        self.expect("outer", token)?;
        self.keyword("loop")?;
        let triangle = [self.corner()?, self.corner()?, self.corner()?];
        self.keyword("endloop")?;
        self.keyword("endfacet")?;
        Ok(triangle)
    }

    fn corner(&mut self) -> Result<[f32; 3], SolidError> {
        self.keyword("vertex")?;
        Ok([self.number()?, self.number()?, self.number()?])
    }

    fn number(&mut self) -> Result<f32, SolidError> {
        let token = self.next();
        number(token).ok_or_else(|| match self.wrong("a number such as 1.5", token) {
            SolidError::Syntax { file, line, why } => {
                SolidError::Syntax { file, line, why: why + comma_hint(token, 1) }
            }
            other => other,
        })
    }

    fn keyword(&mut self, keyword: &str) -> Result<(), SolidError> {
        let token = self.next();
        self.expect(keyword, token)
    }

    fn expect(&self, keyword: &str, token: &[u8]) -> Result<(), SolidError> {
        let found = token.eq_ignore_ascii_case(keyword.as_bytes());
        if found { Ok(()) } else { Err(self.wrong(&format!("`{keyword}`"), token)) }
    }

    fn wrong(&self, expected: &str, token: &[u8]) -> SolidError {
        let why = match token {
            b"" => format!("expected {expected}, but the file ends"),
            _ => format!("expected {expected}, found \"{}\"", shown(token)),
        };
        SolidError::Syntax { file: self.file.to_owned(), line: self.line, why }
    }
}

/// Reads the triangles of an OBJ file. Polygons become fans; all elements but `v` and `f` are ignored.
pub fn obj(file: &str, bytes: &[u8]) -> Result<Vec<Triangle>, SolidError> {
    let text = unmarked(bytes);
    let newline = if text.contains(&b'\n') { b'\n' } else { b'\r' };
    let mut lines = text.split(|byte| *byte == newline).zip(1..);
    let mut corners: Vec<[f32; 3]> = Vec::new();
    // Triangles, with the lines of their faces.
    let mut faces: Vec<(usize, [usize; 3])> = Vec::new();
    let mut tokens = Vec::new();
    while let Some((text, line)) = lines.next() {
        tokens.clear();
        let mut continued = split_line(text, &mut tokens);
        if !matches!(tokens.first(), Some(&(b"v" | b"f"))) {
            continue;
        }
        while continued && tokens.len() <= MAX_TRIANGLES {
            continued = lines.next().is_some_and(|(text, _)| split_line(text, &mut tokens));
        }
        let wrong = |why: String| SolidError::Syntax { file: file.to_owned(), line, why };
        if tokens[0] == b"v" {
            let corner = || Some([number(tokens.get(1)?)?, number(tokens.get(2)?)?, number(tokens.get(3)?)?]);
            corners.push(corner().ok_or_else(|| {
                let found = tokens.join(&b' ');
                let hint = comma_hint(&found, 1);
                wrong(format!("expected three numbers of a position, found \"{}\"{hint}", shown(&found)))
            })?);
            continue;
        }
        let mut of_face = tokens[1..].iter().map(|token| {
            let position = token.split(|byte| *byte == b'/').next().and_then(number::<i64>);
            let place = match position {
                Some(n @ 1..) => usize::try_from(n - 1).ok(),
                Some(n @ ..=-1) => corners.len().checked_sub(n.unsigned_abs() as usize),
                _ => None,
            };
            place.ok_or_else(|| wrong(format!("there is no corner \"{}\" of a face", shown(token))))
        });
        // Faces of one or two corners have no surface.
        let (Some(first), Some(second)) = (of_face.next(), of_face.next()) else { continue };
        let (first, mut before) = (first?, second?);
        for corner in of_face {
            let corner = corner?;
            faces.push((line, [first, before, corner]));
            before = corner;
            if faces.len() > MAX_TRIANGLES {
                return Err(too_many(file, faces.len()));
            }
        }
    }
    let triangle = |(line, face): (usize, [usize; 3])| {
        let [a, b, c] = face.map(|corner| {
            corners.get(corner).copied().ok_or_else(|| {
                let (n, known) = (corner as u64 + 1, many(corners.len() as u64, "corner"));
                let why = format!("there is no corner {n} of a face; the file has {known}");
                SolidError::Syntax { file: file.to_owned(), line, why }
            })
        });
        Ok([a?, b?, c?])
    };
    finite(file, faces.into_iter().map(triangle).collect::<Result<_, _>>()?)
}

/// Appends the elements of a line without its comment. Returns whether the next line continues it.
fn split_line<'a>(line: &'a [u8], tokens: &mut Vec<&'a [u8]>) -> bool {
    let text = line.split(|byte| *byte == b'#').next().unwrap_or_default().trim_ascii_end();
    let inner = text.strip_suffix(b"\\");
    let split = inner.unwrap_or(text).split(u8::is_ascii_whitespace).filter(|token| !token.is_empty());
    // One element more than the largest face has.
    tokens.extend(split.take(MAX_TRIANGLES + 4));
    inner.is_some()
}

fn number<N: std::str::FromStr>(text: impl AsRef<[u8]>) -> Option<N> {
    std::str::from_utf8(text.as_ref()).ok()?.parse().ok()
}

/// Returns text without its byte order mark.
fn unmarked(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

fn shown(text: &[u8]) -> String {
    let text = String::from_utf8_lossy(&text[..text.len().min(SHOWN * 4)]);
    escape::line(&text, SHOWN)
}

fn too_many(file: &str, found: usize) -> SolidError {
    SolidError::TooManyTriangles { file: file.to_owned(), found: found as u64 }
}

fn finite(file: &str, triangles: Vec<Triangle>) -> Result<Vec<Triangle>, SolidError> {
    if triangles.is_empty() {
        return Err(SolidError::Empty(file.to_owned()));
    }
    match triangles.iter().position(|t| t.as_flattened().iter().any(|c| !c.is_finite())) {
        Some(i) => Err(SolidError::NotFinite { file: file.to_owned(), triangle: i + 1 }),
        None => Ok(triangles),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FACET: &str = "facet normal 0 0 1\n outer loop\nvertex 0 0 0\n vertex 1 0 0\n vertex 0 1.5e0 0\n endloop\nendfacet\n";
    const TRIANGLE: Triangle = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.5, 0.0]];

    fn binary(header: &str, triangles: usize, behind: &[u8]) -> Vec<u8> {
        let mut bytes = format!("{header:80}").into_bytes();
        bytes.extend((triangles as u32).to_le_bytes());
        for _ in 0..triangles {
            bytes.extend([0; 12]);
            bytes.extend(TRIANGLE.as_flattened().iter().flat_map(|c| c.to_le_bytes()));
            bytes.extend([7; 2]);
        }
        [&bytes, behind].concat()
    }

    #[test]
    fn stl_is_text_or_binary_whatever_it_begins_with() {
        let solid = format!("solid part\n{FACET}endsolid part\n");
        let cases: [(&str, Vec<u8>, usize); 13] = [
            ("as written", solid.clone().into(), 1),
            ("behind blanks", format!(" \n\t{solid}").into(), 1),
            ("behind a mark", format!("\u{feff}{solid}").into(), 1),
            ("capitals", solid.to_uppercase().into(), 1),
            ("line ends", solid.replace('\n', "\r\n").into(), 1),
            ("old line ends", solid.replace('\n', "\r").into(), 1),
            ("Latin-1", [b"solid f\xfcr\n", FACET.as_bytes(), b"endsolid f\xfcr"].concat(), 1),
            ("two solids", solid.repeat(2).into(), 2),
            ("no name, no end", format!("solid\n{FACET}").into(), 1),
            ("no solid", FACET.repeat(2).into(), 2),
            ("no numbers of the normal", solid.replace("0 0 1\n", "nan -nan(ind) 1,0\n").into(), 1),
            ("binary", binary("a part", 3, &[]), 3),
            ("binary that begins with solid, with bytes behind it", binary("solid part", 3, b"behind"), 3),
        ];
        for (name, bytes, triangles) in cases {
            assert_eq!(stl("a.stl", &bytes), Ok(vec![TRIANGLE; triangles]), "{name}");
        }
    }

    #[test]
    fn wrong_stl_is_shown_with_its_line() {
        let solid = format!("solid part\n{FACET}endsolid part\n");
        for (text, error) in [
            (
                solid.replace("1.5e0", "1,5"),
                "a.stl:6: expected a number such as 1.5, found \"1,5\"; a point is wanted, not a decimal comma",
            ),
            (solid.replace("1.5e0", "1,5").replace('\n', "\r\n"), "a.stl:6: "),
            (solid.replace("1.5e0", "1,5").replace('\n', "\r"), "a.stl:6: "),
            (solid.replace("endloop", "vertex 1 1 1"), "a.stl:7: expected `endloop`, found \"vertex\""),
            (solid.replace("outer", "inner"), "a.stl:3: expected `outer`, found \"inner\""),
            (
                solid.replace("vertex 1 0 0", "vertex 1 0"),
                "a.stl:6: expected a number such as 1.5, found \"vertex\"",
            ),
            (
                solid[..solid.find("vertex 1").unwrap()].to_owned(),
                "a.stl:5: expected `vertex`, but the file ends",
            ),
            (
                solid.replace("endsolid", "\u{1b}[31mred"),
                "a.stl:9: expected `facet` or `endsolid`, found \"\\u{1b}[31mred\"",
            ),
            (format!("solid{}", " ".repeat(200)), "there is no triangle"),
            ("hello ".repeat(99), "a.stl:1: expected `solid` or a binary STL, found \"hello hello"),
            ("hello".to_owned(), "the file has 5 bytes"),
        ] {
            let found = stl("a.stl", text.as_bytes()).unwrap_err().to_string();
            assert!(found.contains(error), "{text}: {found}");
        }
    }

    #[test]
    fn obj_is_read_with_what_programs_write_into_it() {
        let corners = "v 0 0 0\nv 1 0 0\nv 0 1.5 0\n";
        let cases: [(&str, Vec<u8>); 15] = [
            ("as written", format!("{corners}f 1 2 3\n").into()),
            ("behind a mark", format!("\u{feff}{corners}f 1 2 3").into()),
            ("line ends", format!("{corners}f 1 2 3\n").replace('\n', "\r\n").into()),
            ("old line ends", format!("{corners}f 1 2 3\n").replace('\n', "\r").into()),
            ("Latin-1", [b"# f\xfcr\no f\xfcr\n", corners.as_bytes(), b"f 1 2 3 # \xfc"].concat()),
            ("continued", format!("{corners}f 1 \\\n 2\\ \r\n\t3\n").into()),
            ("a continued position", format!("v 0 \\\n0 0\n{}f 1 2 3", &corners[8..]).into()),
            ("comments", format!("#\\\n{corners}#f 1 2 3\nf 1 2 3#4\n # f 1 2 3 \\\n").into()),
            ("a comment that ends in a backslash", format!("# C:\\parts\\\n{corners}f 1 2 3").into()),
            ("lines and points", format!("{corners}l 1 2 3\np 1 2 3\nl 1 2 3 1 \\\n2\nf 1 2 3\n").into()),
            ("faces without a surface", format!("{corners}f\nf 1\nf 1 2\nf 1 2 3\n").into()),
            ("from the end", format!("{corners}f -3 -2/9/9 -1//9\n").into()),
            ("before its corners", format!("f 1 2 3\n{corners}").into()),
            ("colours", format!("{}f 1 2 3", corners.replace("0\n", "0 1 0.5 0.5\n")).into()),
            ("ends in a backslash", format!("{corners}f 1 2 3 \\").into()),
        ];
        for (name, bytes) in cases {
            assert_eq!(obj("a.obj", &bytes), Ok(vec![TRIANGLE]), "{name}");
        }
        assert_eq!(obj("a.obj", format!("{corners}v 1 1 0\nf 1 2 4 3\n").as_bytes()).unwrap().len(), 2);
    }

    #[test]
    fn wrong_obj_is_shown_with_its_line() {
        let corners = "v 0 0 0\nv 1 0 0\nv 0 1.5 0\n";
        for (text, error) in [
            (
                corners.replace("1.5", "1,5"),
                "a.obj:3: expected three numbers of a position, found \"v 0 1,5 0\"; a point is wanted, not a decimal comma",
            ),
            (
                format!("{corners}v 1 \\\n2\n"),
                "a.obj:4: expected three numbers of a position, found \"v 1 2\"",
            ),
            (format!("{corners}f 1 2 x/1\n"), "a.obj:4: there is no corner \"x/1\" of a face"),
            (format!("{corners}f 1 2 0\n"), "a.obj:4: there is no corner \"0\""),
            (format!("{corners}f 1 2 -4\n"), "a.obj:4: there is no corner \"-4\""),
            (format!("{corners}f 1 2 \u{1b}\n"), "a.obj:4: there is no corner \"\\u{1b}\""),
            (
                format!("{corners}\nf 1 2 9\n"),
                "a.obj:5: there is no corner 9 of a face; the file has 3 corners",
            ),
            (
                format!("{corners}f 1 2 9223372036854775807"),
                "a.obj:4: there is no corner 9223372036854775807",
            ),
            (format!("{corners}f 1 2 -9223372036854775808"), "a.obj:4: there is no corner"),
            (format!("{corners}l 1 2 3\n"), "there is no triangle"),
            (format!("{corners}f{}\n", " 1 2".repeat(MAX_TRIANGLES)), "triangles; 2000000 is the maximum"),
            (format!("{corners}v 1e99 0 0\nf 1 2 4\n"), "a corner of triangle 1 is not a finite number"),
        ] {
            let found = obj("a.obj", text.as_bytes()).unwrap_err().to_string();
            assert!(found.contains(error), "{}: {found}", &text[..text.len().min(99)]);
        }
    }
}
