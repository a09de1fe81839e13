//! The scene of a run: all that pictures of it show, and figures that are drawn of it.
//!
//! A [`scene::Scene`] holds everything that a picture shows of a run; a family fills one from the records of a run in
//! progress, on either link, or from its journal, and `shared` shares it. `visible` is the vocabulary by which a family is
//! shown; `parts` are rigid parts of bodies and their motions; `bodies` is the interface of a swarm to be shown. `command_forms` says which commands a run takes. `figure` draws moments of a run as SVG and as pixels, without a
//! browser. Nothing here asks the operating system.

pub mod beginning;
pub mod bodies;
pub mod command_forms;
pub mod elements;
pub mod figure;
pub mod parts;
pub mod scene;
pub mod shared;
pub mod visible;
