//! zenoh on one thread. Its TLS link lets two threads read and write one rustls connection without a lock
//! (<https://github.com/eclipse-zenoh/zenoh/issues/2557>): of 38 daemons whose controller was killed one crashed. Its threads
//! can only be chosen by an environment variable, before the first session.

use metamorph_console::terminal::print_error;
use std::env;
use std::os::unix::process::CommandExt;
use std::process::Command;

/// The variable in which zenoh looks for its threads.
const VARIABLE: &str = "ZENOH_RUNTIME";
/// Everything that reads, writes or closes a connection has the one thread of `rx`.
const THREADS: &str =
    "(rx: (worker_threads: 1), tx: (handover: rx), net: (handover: rx), acc: (handover: rx))";

/// Starts this program again, as the same process, with zenoh on one thread. Returns if it is so already, if the user has
/// chosen otherwise, or if that fails. Programs that are started by this one inherit it.
pub fn keep_zenoh_on_one_thread() {
    let mut args = env::args_os();
    let (Some(name), Ok(program)) = (args.next(), env::current_exe()) else { return };
    if env::var_os(VARIABLE).is_none() {
        let error = Command::new(program).arg0(name).args(args).env(VARIABLE, THREADS).exec();
        print_error(&format!(
            "note: zenoh has several threads, since the program cannot start itself: {error}"
        ));
    }
}
