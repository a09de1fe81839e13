//! The view of a run: a page in the browser with the swarm in space and its events over time.
//!
//! A [`scene::Scene`] holds everything that the page shows of a run; `scene_builder` fills one from the
//! records of a run in progress, on either link, or from its journal. `visible` is what a family implements
//! to be shown; `parts` are rigid parts of bodies and their motions; `bodies` holds those of a swarm.
//! `figure` draws moments of a run without a browser; `saved` draws those that the page saves. `access` checks
//! requests, `http` answers them; `server` has the scene and the page, which is in the program (`page/`, plain JavaScript, no build
//! step).
//!
//! The page only looks, unless the run was started with `--control`: then `control` takes commands from a page that holds
//! the second secret, and `command_forms` says what can be commanded.

pub mod access;
pub mod beginning;
pub mod bodies;
pub mod command_forms;
pub mod control;
pub mod elements;
pub mod export;
pub mod figure;
pub mod http;
pub mod parts;
pub mod saved;
pub mod scene;
pub mod scene_builder;
pub mod server;
pub mod visible;
