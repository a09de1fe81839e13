//! Commands that an operator gives to a run in progress, as an input of its director.

use crate::director::faults::{Fault, WorldFault};
use metamorph_core::time::Time;
use std::fmt;

/// The kind of [`DirectorPort::input`](super::port::DirectorPort::input) that is [`Commands`].
pub const COMMAND_INPUT: &str = "commands";

/// The largest number of commands that can be given together.
pub const MOST_COMMANDS: usize = 64;

/// Commands that are given together. They take effect at one time, in order, or none of them does.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Commands {
    /// The time of their effect.
    pub at: Time,
    /// The number of the operator; 0 is the program that steps a run.
    pub operator: u16,
    /// The commands. Each is a fault, or the end of one.
    pub faults: Vec<Fault>,
}

impl Commands {
    /// Reads commands as [`Display`](fmt::Display) writes them; `world` has the faults of the world that the family
    /// knows.
    ///
    /// # Errors
    /// Returns what is wrong with the text.
    pub fn parse(text: &str, world: &[&'static WorldFault]) -> Result<Commands, String> {
        let read = || {
            let (head, faults) = text.split_once(": ")?;
            let (at, operator) = head.strip_prefix("at ")?.split_once(" ns by operator ")?;
            Some((Time(at.parse().ok()?), operator.parse().ok()?, faults))
        };
        let (at, operator, faults) = read()
            .ok_or_else(|| format!("`{text}` is not of the form `at TIME ns by operator N: FAULT; FAULT`"))?;
        let faults =
            faults.split("; ").map(|fault| Fault::parse(fault, world)).collect::<Result<Vec<_>, _>>()?;
        match faults.len() {
            0..=MOST_COMMANDS => Ok(Commands { at, operator, faults }),
            n => Err(format!("{n} commands are too many; at most {MOST_COMMANDS} can be given together")),
        }
    }
}

impl fmt::Display for Commands {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "at {} ns by operator {}: ", self.at.0, self.operator)?;
        for (i, fault) in self.faults.iter().enumerate() {
            write!(f, "{}{fault}", if i == 0 { "" } else { "; " })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::director::faults::{Form, Target};
    use metamorph_core::ids::ModuleId;
    use metamorph_core::lattice::Cell;

    static WALL: WorldFault = WorldFault { name: "block", harms: true, form: Form::Cell, about: "a wall" };

    #[test]
    fn commands_are_read_as_they_are_written() {
        let cell = Target::Cell(Cell { x: 1, y: -2, z: 3 });
        let faults = vec![Fault::Kill(ModuleId(7)), Fault::Unstick(ModuleId(0)), Fault::World(&WALL, cell)];
        let commands = Commands { at: Time(2_000_000_001), operator: 3, faults };
        let text = "at 2000000001 ns by operator 3: kill 7; unstick 0; block [1, -2, 3]";
        assert_eq!(commands.to_string(), text);
        assert_eq!(Commands::parse(text, &[&WALL]), Ok(commands));
        assert!(
            Commands::parse(text, &[])
                .unwrap_err()
                .starts_with("`block [1, -2, 3]` is no fault; write one of")
        );
    }

    #[test]
    fn other_texts_are_refused() {
        let many = format!("at 1 ns by operator 1: kill 1{}", "; kill 1".repeat(MOST_COMMANDS));
        for text in [
            "",
            "kill 7",
            "at 1 ns by operator 1: ",
            "at 1 ns by operator 1: kill",
            "at 1 ns by operator 1: kill -1",
            "at 1 ns by operator 1: kill 1;kill 2",
            "at 1 ns by operator 1: block [1, 2]",
            "at 1 ns by operator 1: block [1, 2, 16384]",
            "at 1 ns by operator 65536: kill 1",
            "at -1 ns by operator 1: kill 1",
            "at 1 ns by operator 1: external 1",
            &many,
        ] {
            assert!(Commands::parse(text, &[&WALL]).is_err(), "{text}");
        }
    }
}
