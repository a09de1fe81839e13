//! The documentation of Metamorph: the pages that are made from the program itself, the check of links, and the
//! site, an mdBook.
//!
//! The pages of the site are those that `docs/SUMMARY.md` names, at the paths that they have in the repository, so
//! that a page is read the same on the site and in the repository.

#[cfg(feature = "book")]
pub mod book;
pub mod crates;
pub mod documents;
pub mod exit_codes;
pub mod formats;
pub mod gallery;
pub mod invariants;
pub mod links;
pub mod metrics;
pub mod notices;
pub mod reference;
pub mod schema_page;

use std::io;
use std::path::{Path, PathBuf};

/// Returns the root of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Returns the pages that are made from the program, as a whole or in part, with their paths in the repository.
///
/// # Errors
/// If a page or a source cannot be read, or a part of a page cannot be made.
pub fn generated() -> io::Result<Vec<(PathBuf, String)>> {
    let mut whole = vec![
        ("gallery.md".to_owned(), gallery::page()),
        ("reference/commands.md".to_owned(), reference::commands()),
        ("reference/exit-codes.md".to_owned(), exit_codes::page()),
    ];
    whole.extend(reference::documents());
    let mut pages: Vec<(PathBuf, String)> =
        whole.into_iter().map(|(path, text)| (Path::new("docs").join(path), text)).collect();
    for path in links::pages(&root())? {
        if pages.iter().any(|(whole, _)| *whole == path) {
            continue;
        }
        let text = std::fs::read_to_string(root().join(&path))?;
        let filled = documents::filled(&root(), &text)
            .map_err(|error| io::Error::other(format!("{}: {error}", path.display())))?;
        pages.extend(filled.map(|text| (path, text)));
    }
    Ok(pages)
}

/// Writes the generated pages and parts of pages.
///
/// # Errors
/// If a page cannot be made or written.
pub fn generate(root: &Path) -> io::Result<()> {
    for (path, text) in generated()? {
        let path = root.join(path);
        std::fs::create_dir_all(path.parent().unwrap_or(root))?;
        std::fs::write(path, text)?;
    }
    Ok(())
}
