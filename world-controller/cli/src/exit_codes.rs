//! The exit codes of runs, as the help of several commands lists them.

/// Exit codes of runs.
pub const EXIT_CODES: &str = "\
Exit codes:
  0  built: every goal cell is filled (or the command succeeded)
  1  the program itself failed, for example because a file or standard output could not be written
  2  the command line or the scenario is wrong
  3  deadlock: no module can make progress and goal cells are unfilled
  4  livelock: modules move, but no goal cell is filled for longer than the scenario's bound
  5  timeout: the scenario's time limit was reached
  6  unsafe: an invariant broke, such as two modules in one cell
  7  aborted: stopped by Ctrl-C, SIGTERM or SIGHUP, or because shared memory ran short; the report,
     if the run had begun, is partial";

/// Continues the list of exit codes.
pub const JOURNAL_EXIT_CODES: &str = "
  8  a replay differs from the journal
  9  a journal is damaged: bytes were changed, or parts are missing or of another run";

/// Continues the list for a run that is resumed.
pub const DAMAGED_EXIT_CODE: &str = "
  9  the journal is damaged; the message says where and how";
