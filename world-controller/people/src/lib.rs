//! Experiments of the thesis with people (thesis 8, 9 and appendix E): `room` has rooms of furniture, `pointing` finds the tile
//! that a person points at, `studio` is the editor of drawings and rooms in the browser.

pub mod pointing;
pub mod room;
pub mod studio;
