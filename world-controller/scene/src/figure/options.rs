//! The options of a figure, as they are typed.

use super::camera::Camera;
use super::palette::Theme;
use metamorph_core::lattice::Cell;
use metamorph_core::time::{Span, Time};
use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

/// Points in a millimetre.
const POINTS_PER_MM: f64 = 72.0 / 25.4;

/// Content and appearance of a figure.
#[derive(Clone, Debug)]
pub struct Style {
    /// The camera.
    pub camera: Camera,
    /// The width of the figure.
    pub width: Width,
    /// Pixels in an inch.
    pub dpi: u32,
    /// Which modules are drawn.
    pub only: Only,
    /// The planes beyond which cells are removed.
    pub sections: Vec<Section>,
    /// Meaning of the colours of modules.
    pub color: ColorBy,
    /// How the goal is drawn.
    pub goal: GoalStyle,
    /// Whether the directions x, y and z are drawn.
    pub axes: bool,
    /// Whether a scale bar is drawn.
    pub scale: bool,
    /// Whether colours are explained.
    pub legend: bool,
    /// The title; `{t}` stands for the time.
    pub title: Option<String>,
    /// Labels on modules.
    pub labels: Labels,
    /// The lines that are drawn between modules.
    pub links: BTreeSet<Links>,
    /// Background and colours.
    pub theme: Theme,
}

/// A moment of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moment {
    /// A scenario time.
    At(Time),
    /// A share of the run, in hundredths of a percent.
    Share(u64),
}

impl Moment {
    /// The end of the run.
    pub const END: Moment = Moment::Share(10_000);

    /// Returns the time in a run that ended at `end`; `None` if that is later.
    pub fn within(self, end: Time) -> Option<Time> {
        match self {
            Moment::At(at) => (at <= end).then_some(at),
            Moment::Share(share) => Some(Time((u128::from(end.0) * u128::from(share) / 10_000) as u64)),
        }
    }
}

impl FromStr for Moment {
    type Err = String;

    fn from_str(text: &str) -> Result<Moment, String> {
        if text == "end" {
            return Ok(Moment::END);
        }
        if let Some(percent) = text.strip_suffix('%') {
            let percent = percent.parse::<f64>().ok().filter(|p| (0.0..=100.0).contains(p));
            let percent = percent.ok_or("a share of the run is from 0% to 100%")?;
            return Ok(Moment::Share((percent * 100.0).round() as u64));
        }
        let span: Span = text.parse().map_err(|error| format!("{error}, or `50%` of the run, or `end`"))?;
        Ok(Moment::At(Time::ZERO + span))
    }
}

impl fmt::Display for Moment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Moment::At(at) => at.fmt(f),
            Moment::Share(10_000) => f.write_str("end"),
            Moment::Share(share) => write!(f, "{}%", *share as f64 / 100.0),
        }
    }
}

/// The width of a figure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Width {
    /// In millimetres.
    Millimetres(f64),
    /// In pixels.
    Pixels(u32),
}

impl Width {
    /// Returns the width in points.
    pub fn points(self, dpi: u32) -> f64 {
        match self {
            Width::Millimetres(mm) => mm * POINTS_PER_MM,
            Width::Pixels(pixels) => f64::from(pixels) / f64::from(dpi) * 72.0,
        }
    }
}

impl FromStr for Width {
    type Err = String;

    fn from_str(text: &str) -> Result<Width, String> {
        let wrong = || "a width is 20mm to 2000mm or 100px to 20000px".to_owned();
        if let Some(mm) = text.strip_suffix("mm") {
            let mm = mm.parse::<f64>().ok().filter(|mm| (20.0..=2000.0).contains(mm));
            return mm.map(Width::Millimetres).ok_or_else(wrong);
        }
        let pixels = text.strip_suffix("px").and_then(|px| px.parse::<u32>().ok());
        pixels.filter(|px| (100..=20_000).contains(px)).map(Width::Pixels).ok_or_else(wrong)
    }
}

impl fmt::Display for Width {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Width::Millimetres(mm) => write!(f, "{mm}mm"),
            Width::Pixels(pixels) => write!(f, "{pixels}px"),
        }
    }
}

/// Which modules are drawn.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Only {
    /// All.
    All,
    /// Those in cells of the goal.
    Goal,
    /// Those in cells of a level of the goal.
    Level(u16),
    /// These.
    Modules(BTreeSet<u32>),
}

impl FromStr for Only {
    type Err = String;

    fn from_str(text: &str) -> Result<Only, String> {
        let wrong = || "name `all`, `goal`, `level=N`, or modules: `modules=1,4,7..9`".to_owned();
        let number = |text: &str| text.trim().parse::<u32>().map_err(|_| wrong());
        match (text, text.split_once('=')) {
            ("all", _) => Ok(Only::All),
            ("goal", _) => Ok(Only::Goal),
            (_, Some(("level", level))) => level.trim().parse().map(Only::Level).map_err(|_| wrong()),
            (_, Some(("modules", list))) => {
                let mut modules = BTreeSet::new();
                for item in list.split(',') {
                    match item.split_once("..") {
                        None => drop(modules.insert(number(item)?)),
                        Some((from, to)) => {
                            let (from, to) = (number(from)?, number(to)?);
                            if from > to || to - from > 1_000_000 {
                                return Err(wrong());
                            }
                            modules.extend(from..=to);
                        }
                    }
                }
                Ok(Only::Modules(modules))
            }
            _ => Err(wrong()),
        }
    }
}

impl fmt::Display for Only {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Only::All => f.write_str("all"),
            Only::Goal => f.write_str("goal"),
            Only::Level(level) => write!(f, "level={level}"),
            Only::Modules(modules) => {
                let list: Vec<String> = modules.iter().map(u32::to_string).collect();
                write!(f, "modules={}", list.join(","))
            }
        }
    }
}

/// A plane between cells; what is beyond it is removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Section {
    axis: usize,
    /// True if larger coordinates are kept.
    above: bool,
    /// The last coordinate kept.
    last: i16,
}

impl Section {
    /// Returns true if a cell is kept.
    pub fn keeps(self, cell: Cell) -> bool {
        let at = <[i16; 3]>::from(cell)[self.axis];
        if self.above { at >= self.last } else { at <= self.last }
    }
}

impl FromStr for Section {
    type Err = String;

    fn from_str(text: &str) -> Result<Section, String> {
        let wrong = || "a section names what is kept: `x<11`, `y>=2` or `z<=3`".to_owned();
        let axis = ["x", "y", "z"].into_iter().position(|axis| text.starts_with(axis)).ok_or_else(wrong)?;
        let rest = &text[1..];
        let signs = [("<=", false, 0), (">=", true, 0), ("<", false, -1), (">", true, 1)];
        let (sign, above, by) =
            signs.into_iter().find(|(sign, ..)| rest.starts_with(sign)).ok_or_else(wrong)?;
        let last: i16 = rest[sign.len()..].trim().parse().map_err(|_| wrong())?;
        Ok(Section { axis, above, last: last.checked_add(by).ok_or_else(wrong)? })
    }
}

impl fmt::Display for Section {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}{}", ["x", "y", "z"][self.axis], if self.above { ">=" } else { "<=" }, self.last)
    }
}

/// What the colours of modules mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum ColorBy {
    /// Roles, waiting, paused and dead modules
    State,
    /// The level of the goal's cell that a module is in
    Level,
    /// The distance to a target that a module knows of, in moves
    Gradient,
    /// The messages that a module has sent and received so far
    Messages,
    /// The module that a module has promised to stay for
    Locks,
    /// The seed that a module fills, or the goal that it has built
    Seed,
    /// The module, by its number
    Module,
    /// Nothing
    None,
}

/// How the goal is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum GoalStyle {
    /// Its outline, dashed
    Outline,
    /// The cells that are not filled, as glass
    Ghost,
    /// Not at all
    Off,
}

/// What is written on modules.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Labels {
    /// Nothing
    Off,
    /// Their numbers
    Ids,
}

/// Lines between modules.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Links {
    /// Modules side by side
    Contacts,
    /// Messages that arrive in the time bin of the moment: wider if more, in the colour of the most frequent class
    Messages,
    /// From a module to the one that it waits for
    Waits,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn printed<T: FromStr<Err = String> + fmt::Display>(text: &str) -> String {
        text.parse::<T>().unwrap_or_else(|error| panic!("{text}: {error}")).to_string()
    }

    #[test]
    fn options_are_read_and_printed_alike() {
        for text in ["85mm", "1600px", "12.5mm".replace("12", "92").as_str()] {
            assert_eq!(printed::<Width>(text), text);
        }
        for text in ["all", "goal", "level=3", "modules=1,4,7,8,9"] {
            assert_eq!(printed::<Only>(text), text);
        }
        assert_eq!(printed::<Only>("modules=1,4,7..9"), "modules=1,4,7,8,9");
        let sections = [("x<11", "x<=10"), ("y>=-2", "y>=-2"), ("z<=3", "z<=3"), ("z>0", "z>=1")];
        assert!(sections.iter().all(|(typed, shown)| printed::<Section>(typed) == *shown));
        for text in ["2s", "50%", "end"] {
            assert_eq!(printed::<Moment>(text), text);
        }
    }

    #[test]
    fn wrong_options_say_what_is_possible() {
        let errors = [
            "1m".parse::<Width>().map(drop),
            "0px".parse::<Width>().map(drop),
            "nanmm".parse::<Width>().map(drop),
            "modules=".parse::<Only>().map(drop),
            "modules=9..1".parse::<Only>().map(drop),
            "level".parse::<Only>().map(drop),
            "w<1".parse::<Section>().map(drop),
            "x=1".parse::<Section>().map(drop),
            "x<-32768".parse::<Section>().map(drop),
            "é".parse::<Section>().map(drop),
            "101%".parse::<Moment>().map(drop),
            "5".parse::<Moment>().map(drop),
        ];
        for error in errors {
            assert!(error.unwrap_err().len() > 10);
        }
    }

    #[test]
    fn moments_are_within_the_run() {
        let end = Time(10_000_000_000);
        assert_eq!("50%".parse::<Moment>().unwrap().within(end), Some(Time(5_000_000_000)));
        assert_eq!(Moment::END.within(end), Some(end));
        assert_eq!("10s".parse::<Moment>().unwrap().within(end), Some(end));
        assert_eq!("10.1s".parse::<Moment>().unwrap().within(end), None);
    }
}
