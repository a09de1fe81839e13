//! The documentation of Metamorph: the pages that are made from the program itself, the check of links, and the
//! site, an mdBook.
//!
//! The pages of the site are those that `docs/SUMMARY.md` names, at the paths that they have in the repository, so
//! that a page is read the same on the site and in the repository.

#[cfg(feature = "book")]
pub mod book;
pub mod exit_codes;
pub mod gallery;
pub mod links;
pub mod reference;
pub mod schema_page;

use std::io;
use std::path::{Path, PathBuf};

/// Returns the root of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Returns the pages that are made from the program, with their paths in `docs/`.
pub fn generated() -> Vec<(String, String)> {
    let mut pages = vec![
        ("gallery.md".to_owned(), gallery::page()),
        ("reference/commands.md".to_owned(), reference::commands()),
        ("reference/exit-codes.md".to_owned(), exit_codes::page()),
    ];
    pages.extend(reference::documents());
    pages
}

/// Writes the generated pages.
///
/// # Errors
/// If a file cannot be written.
pub fn generate(docs: &Path) -> io::Result<()> {
    for (path, text) in generated() {
        let path = docs.join(path);
        std::fs::create_dir_all(path.parent().unwrap_or(docs))?;
        std::fs::write(path, text)?;
    }
    Ok(())
}
