//! Where flaws were found, and how they are shown: `file:line:column: reason`, the line itself with
//! a caret, and the fix.

use super::family::{Families, SectionKind};
use super::flaw::{Flaw, MAX_FILES};
use crate::console::escape::{Shown, is_control, line};
use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// At most this many problems are shown; the rest is counted.
const SHOWN: usize = 20;
/// The most characters of a reason that are shown.
const LONGEST: usize = 1_000;
/// Longer lines are cut for display.
const WIDTH: usize = 160;

/// Where something is written.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Place {
    /// The file as a whole.
    File,
    /// These bytes of the scenario's text.
    Text {
        /// The first byte.
        start: usize,
        /// The byte after the last.
        end: usize,
    },
    /// A command-line option, as typed.
    Option(String),
}

impl From<Range<usize>> for Place {
    fn from(span: Range<usize>) -> Place {
        Place::Text { start: span.start, end: span.end }
    }
}

/// A value and where it is written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct At<T> {
    /// The value.
    pub value: T,
    /// Where.
    pub place: Place,
}

impl<T> At<T> {
    /// A value written at a place.
    pub fn new(value: T, place: impl Into<Place>) -> At<T> {
        At { value, place: place.into() }
    }
}

/// One thing that is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Where.
    pub place: Place,
    /// What.
    pub flaw: Flaw,
}

/// Everything found wrong with one scenario; never empty when returned as an error.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problems {
    origin: Box<str>,
    text: Box<str>,
    /// Values that came from options lie behind the end of the text, at these places.
    options: BTreeMap<usize, String>,
    /// Other files that the scenario has named so far.
    files: Vec<PathBuf>,
    families: Families,
    /// The family of the scenario, once that is known.
    family: &'static str,
    list: Vec<Problem>,
}

impl Problems {
    /// No problem yet, in a text from a file of this name that may name these families.
    pub fn new(families: Families, origin: &str, text: &str) -> Problems {
        Problems {
            origin: origin.into(),
            text: text.into(),
            options: BTreeMap::new(),
            files: Vec::new(),
            families,
            family: "",
            list: Vec::new(),
        }
    }
    /// From now on, what is wrong at this place behind the end of the text is wrong with this option.
    pub fn option_at(&mut self, start: usize, option: String) -> Place {
        self.options.insert(start, option.clone());
        Place::Option(option)
    }
    /// The path of another file that the scenario names, seen from the directory of the scenario.
    pub fn file(&mut self, name: &str) -> Result<PathBuf, Flaw> {
        if self.files.len() >= MAX_FILES {
            return Err(Flaw::TooManyFiles);
        }
        let path = Path::new(&*self.origin).parent().unwrap_or(Path::new("")).join(name);
        self.files.push(path.clone());
        Ok(path)
    }
    /// The files that were named so far.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }
    /// A single problem with a file whose text is not known.
    pub fn of_file(origin: &str, flaw: Flaw) -> Problems {
        let mut problems = Problems::new(Families(&[]), origin, "");
        problems.add(Place::File, flaw);
        problems
    }
    /// The families that the scenario may name.
    pub fn families(&self) -> Families {
        self.families
    }
    /// The name of the family of the scenario.
    pub fn family(&self) -> &'static str {
        self.family
    }
    /// The scenario is of this family.
    pub fn set_family(&mut self, family: &'static str) {
        self.family = family;
    }
    /// The other family in whose scenarios this key means something in this section.
    pub fn owner_of(&self, section: SectionKind, key: &str) -> Option<&'static str> {
        self.families.owner(section, key, self.family)
    }
    /// Notes a flaw.
    pub fn add(&mut self, place: impl Into<Place>, flaw: impl Into<Flaw>) {
        let mut place = place.into();
        if let Place::Text { start, .. } = place
            && let Some(option) = self.options.get(&start)
        {
            place = Place::Option(option.clone());
        }
        self.list.push(Problem { place, flaw: flaw.into() });
    }
    /// The value, or the flaw noted.
    pub fn note<T, F: Into<Flaw>>(&mut self, place: &Place, result: Result<T, F>) -> Option<T> {
        result.map_err(|flaw| self.add(place.clone(), flaw)).ok()
    }
    /// Whether nothing is wrong so far.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }
    /// What is wrong, in the order of the text.
    pub fn list(&self) -> &[Problem] {
        &self.list
    }
    /// Puts the problems in the order of the text; call before handing them out.
    #[must_use]
    pub fn sorted(mut self) -> Problems {
        self.list.sort_by(|a, b| a.place.cmp(&b.place));
        self
    }

    fn write(&self, f: &mut fmt::Formatter<'_>, problem: &Problem) -> fmt::Result {
        // Flaws quote what is wrong, whatever that is.
        let flaw = line(&problem.flaw.to_string(), LONGEST);
        match &problem.place {
            Place::File => writeln!(f, "{}: {flaw}", self.origin())?,
            Place::Option(option) => writeln!(f, "{}: {flaw}", option.shown())?,
            Place::Text { start, end } => self.write_excerpt(f, *start, *end, &flaw)?,
        }
        write!(f, "  fix: {}", problem.flaw.fix())
    }

    fn origin(&self) -> String {
        Path::new(&*self.origin).shown()
    }

    fn write_excerpt(&self, f: &mut fmt::Formatter<'_>, start: usize, end: usize, flaw: &str) -> fmt::Result {
        let start = floor(&self.text, start);
        let line_start = self.text[..start].rfind('\n').map_or(0, |i| i + 1);
        let whole = self.text[line_start..].lines().next().unwrap_or("");
        let number = self.text[..line_start].matches('\n').count() + 1;
        let before = self.text[line_start..start].chars().count();
        writeln!(f, "{}:{number}:{}: {flaw}", self.origin(), before + 1)?;
        // Tabs and control characters would shift the caret, or play with the terminal.
        let shown: String = whole.chars().take(WIDTH).map(|c| if is_control(c) { ' ' } else { c }).collect();
        let marked = self.text[start..floor(&self.text, end).max(start)].lines().next().unwrap_or("");
        let room = shown.chars().count().saturating_sub(before).max(1);
        let carets = marked.chars().count().clamp(1, room);
        let gutter = number.to_string().len();
        writeln!(f, "  {number} | {shown}")?;
        writeln!(f, "  {:gutter$} | {:before$}{:^<carets$}", "", "", "", before = before.min(WIDTH))
    }
}

/// The nearest character boundary at or before a byte.
fn floor(text: &str, at: usize) -> usize {
    let mut at = at.min(text.len());
    while !text.is_char_boundary(at) {
        at -= 1;
    }
    at
}

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, problem) in self.list.iter().take(SHOWN).enumerate() {
            if i > 0 {
                write!(f, "\n\n")?;
            }
            self.write(f, problem)?;
        }
        match self.list.len().saturating_sub(SHOWN) {
            0 => Ok(()),
            more => write!(f, "\n\n… and {more} more"),
        }
    }
}

impl std::error::Error for Problems {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_at_the_place() {
        let mut problems = Problems::new(crate::family::families(), "a.toml", "version = 1\nfoö = 2 # é\n");
        problems.add(12..16, Flaw::NoGoal);
        problems.add(Place::Option("--kill 9@1s".into()), Flaw::NoSuchModule { module: 9, last: 3 });
        let shown = problems.to_string();
        assert!(shown.contains("a.toml:2:1: the scenario has no"), "{shown}");
        assert!(shown.contains("  2 | foö = 2 # é\n    | ^^^\n"), "{shown}");
        assert!(shown.contains("--kill 9@1s: there is no module 9; the swarm has modules 0 to 3"), "{shown}");
        assert!(shown.contains("fix: name a module from 0 to 3"), "{shown}");
    }

    #[test]
    fn survives_places_outside_the_text() {
        for (start, end) in [(0, 0), (3, 900), (900, 901), (1, 2), (2, 1)] {
            let mut problems = Problems::new(crate::family::families(), "a.toml", "é");
            problems.add(Place::Text { start, end }, Flaw::NoGoal);
            assert!(problems.to_string().contains("a.toml:1:"));
        }
    }
}
