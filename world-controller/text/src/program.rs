//! This program, as others start and name it: programs of users that embed the commands have other names, and may be scripts.

use std::ffi::OsString;
use std::sync::OnceLock;

static NAME: OnceLock<String> = OnceLock::new();
static LEADING: OnceLock<Vec<OsString>> = OnceLock::new();

/// Names the program in the commands that it prints; the first call counts.
pub fn set_name(name: &str) {
    NAME.get_or_init(|| name.to_owned());
}

/// Returns the name of the program.
pub fn name() -> &'static str {
    NAME.get().map_or("metamorph", String::as_str)
}

/// Sets the arguments that come before the command when this program starts itself again, such as the script of an interpreter;
/// the first call counts.
pub fn set_leading(arguments: Vec<OsString>) {
    LEADING.get_or_init(|| arguments);
}

/// Returns the arguments of a command with which this program starts itself again.
pub fn again(command: impl IntoIterator<Item = OsString>) -> Vec<OsString> {
    LEADING.get().into_iter().flatten().cloned().chain(command).collect()
}
