//! A run to look at: a page in the browser with the swarm in space and what happened over time.
//!
//! A [`scene::Scene`] is what a page needs to know of a run; `scribe` writes one from the records of a
//! run that goes on, on either link, or of its journal. `visible` says what each family has to say of itself, and `parts` of what bodies are made and how
//! they move; `bodies` holds those of a swarm. `access` decides who is let in, `server` hands out the
//! scene and the page, which is in the program (`page/`, plain JavaScript, no build step).
//!
//! Deliberately absent: a way to change a run from the page; it only looks.

pub mod access;
pub mod bodies;
pub mod export;
pub mod parts;
pub mod scene;
pub mod scene_builder;
pub mod server;
pub mod visible;
