//! The site builds without a warning, and its pages name no file that does not exist.

use metamorph_site::{book, links, root};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// What a build logs.
#[derive(Clone, Default)]
struct Logged(Arc<Mutex<Vec<u8>>>);

impl io::Write for Logged {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().extend(bytes);
        Ok(bytes.len())
    }
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn html_below(directory: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => html_below(&path, found),
            false if path.extension().is_some_and(|end| end == "html") => found.push(path),
            false => {}
        }
    }
}

/// Returns the local files that a page of the site names and that do not exist.
fn missing(page: &Path) -> Vec<String> {
    let text = fs::read_to_string(page).unwrap();
    let named = ["href=\"", "src=\""].into_iter().flat_map(|key| text.split(key).skip(1));
    let named = named.filter_map(|rest| rest.split('"').next()).filter_map(links::local);
    let gone = named.filter(|(path, _)| {
        !path.is_empty() && !path.starts_with("data:") && !page.parent().unwrap().join(path).exists()
    });
    gone.map(|(path, _)| format!("{}: {path}", page.display())).collect()
}

#[test]
fn the_site_builds_without_a_warning() {
    let logged = Logged::default();
    let writer = logged.clone();
    let subscriber = tracing_subscriber::fmt()
        .with_max_level(tracing::Level::WARN)
        .with_ansi(false)
        .with_writer(move || writer.clone())
        .finish();
    let directory = tempfile::tempdir().unwrap();
    let output = directory.path().join("site");
    tracing::subscriber::with_default(subscriber, || book::build(&root(), &output, None)).unwrap();
    let logged = String::from_utf8(logged.0.lock().unwrap().clone()).unwrap();
    assert_eq!(logged, "", "mdBook warns");
    let mut pages = Vec::new();
    html_below(&output, &mut pages);
    // The page for addresses that do not exist has absolute links.
    pages.retain(|page| !page.ends_with("404.html"));
    let missing: Vec<String> = pages.iter().flat_map(|page| missing(page)).collect();
    assert!(pages.len() > 30 && missing.is_empty(), "{missing:#?}");
    for page in
        ["index.html", "docs/gallery.html", "docs/reference/commands.html", "deploy/tutorial/index.html"]
    {
        assert!(output.join(page).exists(), "{page}");
    }
}
