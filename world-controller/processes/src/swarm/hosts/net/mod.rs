//! Links between machines, over zenoh with mutual TLS (cargo feature `hosts`).
//!
//! zenoh carries packets and may lose them: what has to arrive is numbered and acknowledged by the host link. Keys are
//! `mm/RUN/FROM/TO/SERVICE`; certificates say who may put and hear what. Not here: what packets mean.

pub mod bench;
mod door;
mod keys;
mod one_thread;
mod probe;
mod session;
mod settings;

pub use door::{Knock, Reply, Visit, VisitError, serve};
pub use keys::{Keys, KeysError, make, renew};
pub use one_thread::keep_zenoh_on_one_thread;
pub use probe::{Fault, probe};
pub use session::{Line, Net, SessionError};

const _: () = assert!(
    matches!(option_env!("TLS_LINGER_TIMEOUT"), Some(seconds) if matches!(seconds.as_bytes(), b"1")),
    "links between machines need the environment variable TLS_LINGER_TIMEOUT=1 when they are built: without it a machine that \
     falls silent silences the others for 10 s; .cargo/config.toml sets it for builds in this repository"
);
