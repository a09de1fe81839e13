//! The view of a run: a page in the browser with the swarm in space and its events over time.
//!
//! A [`scene::Scene`] holds everything that the page shows of a run; `scene_builder` fills one from the
//! records of a run in progress, on either link, or from its journal. `visible` is what a family implements
//! to be shown; `parts` are rigid parts of bodies and their motions; `bodies` holds those of a swarm.
//! `figure` draws moments of a run without a browser. `access` checks requests; `server` serves the scene and the page, which is in the program (`page/`, plain
//! JavaScript, no build step).
//!
//! Not here, on purpose: changing a run from the page.

pub mod access;
pub mod bodies;
pub mod export;
pub mod figure;
pub mod parts;
pub mod scene;
pub mod scene_builder;
pub mod server;
pub mod visible;
