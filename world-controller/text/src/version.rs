//! The version of the program, with the commit that it was built from.

use std::sync::OnceLock;

static VERSION: OnceLock<String> = OnceLock::new();

/// States the commit that the program was built from, as `git describe` names it. Only the first call counts, so a program
/// makes it before anything else.
///
/// The crate of the program knows the commit; if this one read it, each commit would build everything again.
pub fn set_commit(commit: &str) {
    if !commit.is_empty() {
        VERSION.get_or_init(|| format!("{}+{commit}", env!("CARGO_PKG_VERSION")));
    }
}

/// Returns the version of the program as [Semantic Versioning 2.0](https://semver.org/spec/v2.0.0.html) writes it: after a plus
/// sign the commit, and `.changed` if files differed from it. Without [`set_commit`] it is the version alone.
pub fn version() -> &'static str {
    VERSION.get().map_or(env!("CARGO_PKG_VERSION"), String::as_str)
}
