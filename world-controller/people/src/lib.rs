//! Experiments of the thesis with people (thesis 8, 9 and appendix E): `room` has rooms of furniture, `pointing` finds the tile
//! that a person points at, `studio` is the editor of drawings and rooms in the browser.

pub mod pointing;
pub mod room;
pub mod studio;

use metamorph_console::command::{Command, CommandOf, Group};

/// The commands of this crate, for `install` of the command line.
pub const COMMANDS: &[&dyn Command] = &[&STUDIO, &ROOM, &POINT];

static STUDIO: CommandOf<studio::StudioArgs> = CommandOf {
    name: "studio",
    group: Some(Group::Look),
    about: "Draw a structure of cubes or furnish a room in the browser, start what builds it, command it",
    after_help: || studio::EXAMPLES.to_owned(),
    execute: |args, call| Ok(studio::studio(&args, call.interrupt)?),
};

static ROOM: CommandOf<room::RoomArgs> = CommandOf {
    name: "room",
    group: Some(Group::Study),
    about: "Check a room with furniture against its constraints, put it right, measure it, or write the scenario that builds it",
    after_help: || room::EXAMPLES.to_owned(),
    execute: |args, _| Ok(room::room(&args)?),
};

static POINT: CommandOf<pointing::PointArgs> = CommandOf {
    name: "point",
    group: Some(Group::Study),
    about: "Find the floor tile that a tracked person points at",
    after_help: || pointing::EXAMPLES.to_owned(),
    execute: |args, _| pointing::point(&args).map(|()| 0).map_err(Into::into),
};
