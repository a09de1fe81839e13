//! Builds the site: copies the pages that `docs/SUMMARY.md` names, adapts their links, and lets mdBook make HTML of
//! them.

use crate::links::{self, Link, SUMMARY, pages};
use mdbook_driver::MDBook;
use mdbook_driver::config::Config;
use mdbook_driver::errors::{Error, Result};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Returns the path of a page or a file on the site.
fn on_site(path: &Path) -> PathBuf {
    // mdBook makes `index.html` of a README and does not adapt the links to it.
    match path.file_name().is_some_and(|name| name == "README.md") {
        true => path.with_file_name("index.md"),
        false => path.to_owned(),
    }
}

/// Returns a relative path from the page at `from` to `to`.
fn relative(from: &Path, to: &Path) -> String {
    let from: Vec<_> = from.parent().unwrap_or(Path::new("")).components().collect();
    let to: Vec<_> = to.components().collect();
    let common = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
    let up = from[common..].iter().map(|_| "..".to_owned());
    let down = to[common..].iter().map(|part| part.as_os_str().to_string_lossy().into_owned());
    up.chain(down).collect::<Vec<_>>().join("/")
}

/// Adapts the links of a page at `page` for the site, where it is at `place`. Links to other files of the
/// repository lead to `repository`, or become plain text.
fn adapted(
    text: &str,
    page: &Path,
    place: &Path,
    pages: &BTreeSet<PathBuf>,
    repository: Option<&str>,
) -> String {
    let mut adapted = String::new();
    let mut done = 0;
    for Link { range, destination, image } in links::links(text) {
        let Some((path, anchor)) = links::local(&destination).filter(|(path, _)| !path.is_empty()) else {
            continue;
        };
        let source = &text[range.clone()];
        let Some((label, _)) = source.split_once(&format!("]({destination}")) else { continue };
        let Some(target) = links::resolve(page, path) else { continue };
        let anchor = anchor.map_or_else(String::new, |anchor| format!("#{anchor}"));
        let whole = |to: &str| format!("{label}]({to}{anchor})");
        let new = match (image || pages.contains(&target), repository) {
            (true, _) => whole(&relative(place, &on_site(&target))),
            (false, Some(repository)) => {
                whole(&format!("{}/{}", repository.trim_end_matches('/'), target.display()))
            }
            (false, None) => label.trim_start_matches('[').to_owned(),
        };
        adapted.push_str(&text[done..range.start]);
        adapted.push_str(&new);
        done = range.end;
    }
    adapted.push_str(&text[done..]);
    adapted
}

/// Copies pages and images to a directory, as mdBook reads them.
fn stage(root: &Path, directory: &Path, repository: Option<&str>) -> Result<()> {
    let pages: BTreeSet<PathBuf> = pages(root)?.into_iter().collect();
    let write = |place: &Path, bytes: &[u8]| -> Result<()> {
        let path = directory.join(place);
        fs::create_dir_all(path.parent().unwrap_or(directory))?;
        Ok(fs::write(path, bytes)?)
    };
    let summary = Path::new("SUMMARY.md");
    let listed = pages.iter().cloned().chain([PathBuf::from(SUMMARY)]);
    for page in listed {
        let text = fs::read_to_string(root.join(&page))
            .map_err(|error| Error::msg(format!("{SUMMARY} names {}: {error}", page.display())))?;
        let place = if page == Path::new(SUMMARY) { summary.to_owned() } else { on_site(&page) };
        write(&place, adapted(&text, &page, &place, &pages, repository).as_bytes())?;
        for image in links::links(&text).into_iter().filter(|link| link.image) {
            let local = links::local(&image.destination).and_then(|(path, _)| links::resolve(&page, path));
            if let Some(path) = local {
                write(&path, &fs::read(root.join(&path))?)?;
            }
        }
    }
    Ok(())
}

/// Builds the site of the repository at `root` into `output`, which is replaced.
///
/// # Errors
/// If a page cannot be read or the site cannot be written.
pub fn build(root: &Path, output: &Path, repository: Option<&str>) -> Result<()> {
    let source = tempfile::tempdir()?;
    stage(root, &source.path().join("src"), repository)?;
    let mut config = Config::default();
    config.book.title = Some("Metamorph".to_owned());
    config.book.language = Some("en".to_owned());
    config.build.build_dir = output.to_owned();
    config.build.create_missing = false;
    config.set("output.html.no-section-label", true)?;
    MDBook::load_with_config(source.path(), config)?.build()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_follow_the_pages() {
        let pages = BTreeSet::from(["README.md", "docs/a.md"].map(PathBuf::from));
        let page = Path::new("docs/b.md");
        let text = "[r](../README.md#x) [s](../src/lib.rs) ![i](i.svg) [w](https://example.org) [h](#h)";
        let adapted = |to| adapted(text, page, page, &pages, to);
        assert_eq!(adapted(None), "[r](../index.md#x) s ![i](i.svg) [w](https://example.org) [h](#h)");
        assert!(adapted(Some("https://example.org/r/")).contains("[s](https://example.org/r/src/lib.rs)"));
        assert_eq!(relative(Path::new("SUMMARY.md"), Path::new("docs/a.md")), "docs/a.md");
    }
}
