//! The view of a run: a page in the browser with the swarm in space and its events over time, and exports for other viewers.
//!
//! The page shows a scene of `metamorph_scene`. `request` is a figure that is asked for, by a command line or by the page;
//! `saved` draws those that the page saves. `access` checks requests, `http` answers them; `server` has the scene and the
//! page, which is in the program (`page/`, plain JavaScript, no build step). `export` writes recordings and structures for
//! other viewers.
//!
//! `metrics_server` serves the metrics of a run or a daemon on an address of their own.
//!
//! The page only looks, unless the run was started with `--control`: then `control` takes commands from a page that holds
//! the second secret.

pub mod access;
pub mod control;
pub mod control_client;
pub mod export;
pub mod http;
pub mod metrics_server;
mod mp4;
pub mod request;
pub mod saved;
pub mod server;
