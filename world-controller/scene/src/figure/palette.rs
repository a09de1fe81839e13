//! Colours of figures: those of Okabe and Ito for states, which readers with any colour vision tell apart, and
//! scales of even lightness for numbers.

use crate::elements::Hold;
use crate::visible;
use metamorph_core::counters::Class;
use std::fmt;

/// A colour: red, green, blue.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Rgb(pub u8, pub u8, pub u8);

impl fmt::Display for Rgb {
    /// Writes `#rrggbb`, or `#rgb` where that is the same.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Rgb(r, g, b) = *self;
        match [r, g, b].iter().all(|x| x % 17 == 0) {
            true => write!(f, "#{:x}{:x}{:x}", r / 17, g / 17, b / 17),
            false => write!(f, "#{r:02x}{g:02x}{b:02x}"),
        }
    }
}

impl Rgb {
    /// Returns the colour with this share of its brightness.
    pub fn shaded(self, share: f64) -> Rgb {
        let Rgb(r, g, b) = self;
        let channel = |x: u8| (f64::from(x) * share).round().clamp(0.0, 255.0) as u8;
        Rgb(channel(r), channel(g), channel(b))
    }
    /// Returns a mixture with this share of another colour.
    pub fn mixed(self, other: Rgb, share: f64) -> Rgb {
        let channel = |a: u8, b: u8| (f64::from(a) * (1.0 - share) + f64::from(b) * share).round() as u8;
        Rgb(channel(self.0, other.0), channel(self.1, other.1), channel(self.2, other.2))
    }
    /// Returns the brightness as it is seen, from 0 to 255.
    pub fn luminance(self) -> f64 {
        0.2126 * f64::from(self.0) + 0.7152 * f64::from(self.1) + 0.0722 * f64::from(self.2)
    }
}

/// The background and the colours of states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Theme {
    /// Colours on white
    Paper,
    /// Colours on a dark background, for slides
    Dark,
    /// Colours on no background
    Transparent,
    /// Shades of grey on white, for print without colours
    Grey,
}

/// The states of modules that have different colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum State {
    /// At its final place.
    Done,
    /// On its way.
    Active,
    /// Without a task.
    Idle,
    /// Waits for another module.
    Waiting,
    /// Its process is stopped.
    Paused,
    /// Its process has died.
    Dead,
    /// Not a module: a foreign object.
    Obstacle,
    /// A passive element that rests.
    Resting,
    /// A passive element that one module holds.
    Held,
    /// A passive element that several modules hold.
    Shared,
    /// A passive element that has fallen.
    Fallen,
}

impl From<Hold> for State {
    fn from(hold: Hold) -> State {
        match hold {
            Hold::Rests => State::Resting,
            Hold::Held => State::Held,
            Hold::Shared => State::Shared,
            Hold::Fallen => State::Fallen,
        }
    }
}

impl From<visible::Colour> for State {
    fn from(colour: visible::Colour) -> State {
        match colour {
            visible::Colour::Idle => State::Idle,
            visible::Colour::Active => State::Active,
            visible::Colour::Done => State::Done,
        }
    }
}

/// Colours for sets that only need to be distinguished, the strongest first.
const DISTINCT: [Rgb; 8] = [
    Rgb(0x00, 0x72, 0xb2),
    Rgb(0xe6, 0x9f, 0x00),
    Rgb(0x00, 0x9e, 0x73),
    Rgb(0xcc, 0x79, 0xa7),
    Rgb(0x56, 0xb4, 0xe9),
    Rgb(0xd5, 0x5e, 0x00),
    Rgb(0xf0, 0xe4, 0x42),
    Rgb(0x8a, 0x8f, 0x96),
];

impl Theme {
    /// Returns the background; `None` if there is none.
    pub fn background(self) -> Option<Rgb> {
        match self {
            Theme::Paper | Theme::Grey => Some(Rgb(0xff, 0xff, 0xff)),
            Theme::Dark => Some(Rgb(0x14, 0x18, 0x1f)),
            Theme::Transparent => None,
        }
    }
    /// Returns the colour of text and lines.
    pub fn ink(self) -> Rgb {
        match self {
            Theme::Dark => Rgb(0xe6, 0xea, 0xf0),
            _ => Rgb(0x22, 0x22, 0x22),
        }
    }
    /// Returns the colour of what should stay in the background.
    pub fn faint(self) -> Rgb {
        match self {
            Theme::Dark => Rgb(0x44, 0x4d, 0x5c),
            _ => Rgb(0xcc, 0xcc, 0xcc),
        }
    }
    /// Returns the colour of modules that have none.
    pub fn plain(self) -> Rgb {
        Rgb(0xd9, 0xde, 0xe4)
    }
    /// Returns the colour of a state.
    pub fn state(self, state: State) -> Rgb {
        if self == Theme::Grey {
            let grey = match state {
                State::Done => 0x6a,
                State::Active => 0xff,
                State::Idle => 0xc8,
                State::Waiting => 0xe4,
                State::Paused => 0x9a,
                State::Dead => 0x2b,
                State::Obstacle => 0x48,
                State::Resting => 0xd6,
                State::Held => 0xba,
                State::Shared => 0x84,
                State::Fallen => 0x10,
            };
            return Rgb(grey, grey, grey);
        }
        match state {
            State::Done => Rgb(0x00, 0x72, 0xb2),
            State::Active => Rgb(0xe6, 0x9f, 0x00),
            State::Idle => Rgb(0xb4, 0xc0, 0xcb),
            State::Waiting => Rgb(0xd5, 0x5e, 0x00),
            State::Paused => Rgb(0xcc, 0x79, 0xa7),
            State::Dead => Rgb(0x2b, 0x2b, 0x2b),
            State::Obstacle => Rgb(0x7d, 0x74, 0x68),
            State::Resting => Rgb(0xe3, 0xc9, 0x9b),
            State::Held => Rgb(0xb9, 0x86, 0x4b),
            State::Shared => Rgb(0x8a, 0x5a, 0x2b),
            State::Fallen => Rgb(0xb0, 0x1e, 0x28),
        }
    }
    /// Returns a colour for a member of a set.
    pub fn distinct(self, member: usize) -> Rgb {
        self.printed(DISTINCT[member % DISTINCT.len()])
    }
    /// Returns the colour of a class of messages.
    pub fn class(self, class: Class) -> Rgb {
        let colour = match class {
            Class::Gradient => Rgb(0x44, 0x77, 0xaa),
            Class::Seed => Rgb(0x22, 0x88, 0x33),
            Class::Connectivity => Rgb(0xaa, 0x33, 0x77),
            Class::Negotiation => Rgb(0xee, 0x88, 0x33),
            Class::World => Rgb(0x8b, 0x98, 0xa5),
            Class::Liveness => Rgb(0xc3, 0xcc, 0xd4),
            Class::Gait => Rgb(0x66, 0xcc, 0xee),
        };
        self.printed(colour)
    }
    /// Returns a colour as the theme prints it.
    fn printed(self, colour: Rgb) -> Rgb {
        match self {
            Theme::Grey => {
                let grey = colour.luminance().round() as u8;
                Rgb(grey, grey, grey)
            }
            _ => colour,
        }
    }
    /// Returns the colour of a share, from 0 to 1, of a scale.
    pub fn scale(self, scale: Scale, share: f64) -> Rgb {
        if self == Theme::Grey {
            let grey = (0x30 as f64 + share * 200.0).round() as u8;
            return Rgb(grey, grey, grey);
        }
        let gradient = match scale {
            Scale::Viridis => colorous::VIRIDIS,
            Scale::Cividis => colorous::CIVIDIS,
        };
        let colour = gradient.eval_continuous(share.clamp(0.0, 1.0));
        Rgb(colour.r, colour.g, colour.b)
    }
}

/// A scale of colours for numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// For levels and distances.
    Viridis,
    /// For counts.
    Cividis,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_differ_in_every_theme() {
        let states = [
            State::Done,
            State::Active,
            State::Idle,
            State::Waiting,
            State::Paused,
            State::Dead,
            State::Obstacle,
            State::Resting,
            State::Held,
            State::Shared,
            State::Fallen,
        ];
        for theme in [Theme::Paper, Theme::Dark, Theme::Transparent, Theme::Grey] {
            for (i, a) in states.iter().enumerate() {
                for b in &states[..i] {
                    assert_ne!(theme.state(*a), theme.state(*b), "{theme:?}");
                }
            }
        }
        assert_eq!(Rgb(0xff, 0x00, 0x88).to_string(), "#f08");
        assert_eq!(Rgb(0x00, 0x72, 0xb2).to_string(), "#0072b2");
    }
}
