//! A run to look at: a page in the browser with the swarm in space and what happened over time.
//!
//! A [`scene::Scene`] is what a page needs to know of a run; `watch` fills one while a run goes on,
//! on either link, without having any effect on it. `flow` counts messages between modules over
//! time, `visible` says how each family looks. `gate` decides who is let in, `server` hands out the
//! scene and the page, which is in the program (`page/`, plain JavaScript, no build step).
//!
//! Deliberately absent: a way to change a run from the page; it only looks.

pub mod flow;
pub mod gate;
pub mod scene;
pub mod server;
pub mod visible;
pub mod watch;
