//! The places of errors, and their display: `file:line:column: reason`, the line itself with
//! a caret, and the fix.

use super::error::{MAX_FILES, ScenarioError};
use super::family::{Families, SectionKind};
use super::packed_files::{PackedFiles, PackedSources};
use super::shipped::resolve;
use metamorph_text::escape::{Shown, is_control, line};
use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Largest number of problems shown; the rest is counted.
const SHOWN_MAX: usize = 20;
/// Characters of a reason shown at most.
const LONGEST: usize = 1_000;
/// Columns of a source line shown at most.
const WIDTH: usize = 160;

/// The place of a problem.
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
    /// The place.
    pub place: Place,
}

impl<T> At<T> {
    /// Combines a value with its place.
    pub fn new(value: T, place: impl Into<Place>) -> At<T> {
        At { value, place: place.into() }
    }
}

/// One problem of a scenario.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Its place.
    pub place: Place,
    /// The error.
    pub scenario_error: ScenarioError,
}

/// The scenario that is read.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Source {
    origin: Box<str>,
    text: Box<str>,
    /// The families that it may name.
    families: Families,
    /// Notes about the other files that it names, which can be used all the same.
    notes: Vec<String>,
    /// The files that it has itself.
    packed: PackedFiles,
}

/// All problems of one scenario; never empty when returned as an error.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostics {
    source: Box<Source>,
    /// The options that set values, by the offset past the end of the text that stands for the option's
    /// place.
    options: BTreeMap<usize, String>,
    /// Other files that the scenario has named so far, with their paths.
    files: Vec<(String, PathBuf)>,
    /// The family of the scenario, once that is known.
    family: &'static str,
    list: Vec<Problem>,
}

impl Diagnostics {
    /// Creates an empty list for a text from the file `origin` that may name these families.
    pub fn new(families: Families, origin: &str, text: &str) -> Diagnostics {
        Diagnostics {
            source: Box::new(Source {
                origin: origin.into(),
                text: text.into(),
                families,
                notes: Vec::new(),
                packed: PackedFiles::default(),
            }),
            options: BTreeMap::new(),
            files: Vec::new(),
            family: "",
            list: Vec::new(),
        }
    }
    /// Attributes problems at this offset behind the end of the text to an option.
    pub fn option_at(&mut self, start: usize, option: String) -> Place {
        self.options.insert(start, option.clone());
        Place::Option(option)
    }
    /// Sets the files that the scenario has itself; before any is named.
    pub fn set_packed(&mut self, packed: PackedFiles) {
        self.source.packed = packed;
    }
    /// Returns the source of files that the scenario names.
    pub fn sources(&self) -> PackedSources<'_> {
        PackedSources { packed: &self.source.packed, others: self.source.families.sources }
    }
    /// Resolves the path of a file that the scenario names: one that it has itself, or relative to the scenario.
    pub fn file(&mut self, name: &str) -> Result<PathBuf, ScenarioError> {
        if self.files.len() >= MAX_FILES {
            return Err(ScenarioError::TooManyFiles);
        }
        let packed = self.source.packed.path_of(name);
        let path = packed.unwrap_or_else(|| resolve(&self.source.origin, name));
        self.files.push((name.to_owned(), path.clone()));
        Ok(path)
    }
    /// Returns the files named so far, with their paths.
    pub fn files(&self) -> &[(String, PathBuf)] {
        &self.files
    }
    /// Notes what is worth knowing about a file although it can be used.
    pub fn remark(&mut self, note: String) {
        if !self.source.notes.contains(&note) {
            self.source.notes.push(note);
        }
    }
    /// Returns the notes so far, each once.
    pub fn notes(&self) -> &[String] {
        &self.source.notes
    }
    /// Creates a single problem with a file whose text is not known.
    pub fn of_file(origin: &str, scenario_error: ScenarioError) -> Diagnostics {
        let mut diagnostics = Diagnostics::new(Families::NONE, origin, "");
        diagnostics.add(Place::File, scenario_error);
        diagnostics
    }
    /// Returns the families that the scenario may name.
    pub fn families(&self) -> Families {
        self.source.families
    }
    /// Returns the name of the scenario's family.
    pub fn family(&self) -> &'static str {
        self.family
    }
    /// Sets the scenario's family.
    pub fn set_family(&mut self, family: &'static str) {
        self.family = family;
    }
    /// Returns the other family for which this key is valid in this section.
    pub fn owner_of(&self, section: SectionKind, key: &str) -> Option<&'static str> {
        self.source.families.owner(section, key, self.family)
    }
    /// Adds a problem.
    pub fn add(&mut self, place: impl Into<Place>, scenario_error: impl Into<ScenarioError>) {
        let mut place = place.into();
        if let Place::Text { start, .. } = place
            && let Some(option) = self.options.get(&start)
        {
            place = Place::Option(option.clone());
        }
        self.list.push(Problem { place, scenario_error: scenario_error.into() });
    }
    /// Returns the value, or adds the error.
    pub fn note<T, F: Into<ScenarioError>>(&mut self, place: &Place, result: Result<T, F>) -> Option<T> {
        result.map_err(|scenario_error| self.add(place.clone(), scenario_error)).ok()
    }
    /// Returns true if there is no problem so far.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }
    /// Returns the problems found so far.
    pub fn list(&self) -> &[Problem] {
        &self.list
    }
    /// Sorts the problems by place; call before handing them out.
    #[must_use]
    pub fn sorted(mut self) -> Diagnostics {
        self.list.sort_by(|a, b| a.place.cmp(&b.place));
        self
    }

    fn write(&self, f: &mut fmt::Formatter<'_>, problem: &Problem) -> fmt::Result {
        // Reasons quote the input, whatever it contains.
        let scenario_error = line(&problem.scenario_error.to_string(), LONGEST);
        match &problem.place {
            Place::File => writeln!(f, "{}: {scenario_error}", self.origin())?,
            Place::Option(option) => writeln!(f, "{}: {scenario_error}", option.shown())?,
            Place::Text { start, end } => self.write_excerpt(f, *start, *end, &scenario_error)?,
        }
        write!(f, "  fix: {}", problem.scenario_error.fix())
    }

    fn origin(&self) -> String {
        Path::new(&*self.source.origin).shown()
    }

    fn write_excerpt(
        &self,
        f: &mut fmt::Formatter<'_>,
        start: usize,
        end: usize,
        scenario_error: &str,
    ) -> fmt::Result {
        let start = floor(&self.source.text, start);
        let line_start = self.source.text[..start].rfind('\n').map_or(0, |i| i + 1);
        let whole = self.source.text[line_start..].lines().next().unwrap_or("");
        let number = self.source.text[..line_start].matches('\n').count() + 1;
        let before = self.source.text[line_start..start].chars().count();
        writeln!(f, "{}:{number}:{}: {scenario_error}", self.origin(), before + 1)?;
        // Tabs and control characters would shift the caret or reach the terminal.
        let shown: String = whole.chars().take(WIDTH).map(|c| if is_control(c) { ' ' } else { c }).collect();
        let marked =
            self.source.text[start..floor(&self.source.text, end).max(start)].lines().next().unwrap_or("");
        let room = shown.chars().count().saturating_sub(before).max(1);
        let carets = marked.chars().count().clamp(1, room);
        let gutter = number.to_string().len();
        writeln!(f, "  {number} | {shown}")?;
        writeln!(f, "  {:gutter$} | {:before$}{:^<carets$}", "", "", "", before = before.min(WIDTH))
    }
}

/// Returns the nearest character boundary at or before a byte.
fn floor(text: &str, at: usize) -> usize {
    let mut at = at.min(text.len());
    while !text.is_char_boundary(at) {
        at -= 1;
    }
    at
}

impl fmt::Display for Diagnostics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, problem) in self.list.iter().take(SHOWN_MAX).enumerate() {
            if i > 0 {
                write!(f, "\n\n")?;
            }
            self.write(f, problem)?;
        }
        match self.list.len().saturating_sub(SHOWN_MAX) {
            0 => Ok(()),
            more => write!(f, "\n\n… and {more} more"),
        }
    }
}

impl std::error::Error for Diagnostics {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_at_the_place() {
        let mut diagnostics = Diagnostics::new(Families::NONE, "a.toml", "version = 1\nfoö = 2 # é\n");
        diagnostics.add(12..16, ScenarioError::NoGoal);
        diagnostics
            .add(Place::Option("--kill 9@1s".into()), ScenarioError::NoSuchModule { module: 9, last: 3 });
        let shown = diagnostics.to_string();
        assert!(shown.contains("a.toml:2:1: the scenario has no"), "{shown}");
        assert!(shown.contains("  2 | foö = 2 # é\n    | ^^^\n"), "{shown}");
        assert!(shown.contains("--kill 9@1s: there is no module 9; the swarm has modules 0 to 3"), "{shown}");
        assert!(shown.contains("fix: name a module from 0 to 3"), "{shown}");
    }

    #[test]
    fn survives_places_outside_the_text() {
        for (start, end) in [(0, 0), (3, 900), (900, 901), (1, 2), (2, 1)] {
            let mut diagnostics = Diagnostics::new(Families::NONE, "a.toml", "é");
            diagnostics.add(Place::Text { start, end }, ScenarioError::NoGoal);
            assert!(diagnostics.to_string().contains("a.toml:1:"));
        }
    }
}
