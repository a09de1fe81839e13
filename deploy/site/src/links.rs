//! Links and headings of Markdown pages, and the list of the pages.

use pulldown_cmark::{Event, Options, Parser, Tag, TagEnd};
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::ops::Range;
use std::path::{Component, Path, PathBuf};

/// Path of the list of pages.
pub const SUMMARY: &str = "docs/SUMMARY.md";

/// Returns the pages of the site, as paths in the repository, in the order of the list.
///
/// # Errors
/// If the list cannot be read.
pub fn pages(root: &Path) -> io::Result<Vec<PathBuf>> {
    let text = fs::read_to_string(root.join(SUMMARY))?;
    let named = links(&text).into_iter().filter_map(|link| {
        let (path, _) = local(&link.destination)?;
        resolve(Path::new(SUMMARY), path)
    });
    Ok(named.collect())
}

/// A link or an image of a page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Link {
    /// Where it is in the text, from its first bracket to its last.
    pub range: Range<usize>,
    /// Destination of the link as written.
    pub destination: String,
    /// True for an image.
    pub image: bool,
}

fn events(text: &str) -> impl Iterator<Item = (Event<'_>, Range<usize>)> {
    Parser::new_ext(text, Options::ENABLE_TABLES | Options::ENABLE_STRIKETHROUGH).into_offset_iter()
}

/// Returns the links of a page, in their order.
pub fn links(text: &str) -> Vec<Link> {
    let link = |(event, range)| match event {
        Event::Start(Tag::Link { dest_url, .. }) => {
            Some(Link { range, destination: dest_url.into_string(), image: false })
        }
        Event::Start(Tag::Image { dest_url, .. }) => {
            Some(Link { range, destination: dest_url.into_string(), image: true })
        }
        _ => None,
    };
    events(text).filter_map(link).collect()
}

/// Returns the anchors of a page: those of its headings, as mdBook and repositories on the web make them, and those
/// written as `<a id="...">`.
pub fn anchors(text: &str) -> Vec<String> {
    let mut anchors = Vec::new();
    let mut times: BTreeMap<String, usize> = BTreeMap::new();
    let mut heading: Option<String> = None;
    for (event, _) in events(text) {
        match event {
            Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
            Event::Text(part) | Event::Code(part) => {
                if let Some(heading) = &mut heading {
                    heading.push_str(&part);
                }
            }
            Event::End(TagEnd::Heading(_)) => {
                let anchor = anchor(&heading.take().unwrap_or_default());
                let before = times.entry(anchor.clone()).or_default();
                anchors.push(if *before == 0 { anchor } else { format!("{anchor}-{before}") });
                *before += 1;
            }
            Event::InlineHtml(html) | Event::Html(html) => {
                let ids = html.split("id=\"").skip(1).filter_map(|rest| rest.split('"').next());
                anchors.extend(ids.map(str::to_owned));
            }
            _ => {}
        }
    }
    anchors
}

/// Returns the anchor of a heading.
pub fn anchor(heading: &str) -> String {
    let kept = heading.trim().chars().filter_map(|c| match c {
        ' ' => Some('-'),
        c if c.is_alphanumeric() || c == '-' || c == '_' => Some(c),
        _ => None,
    });
    kept.flat_map(char::to_lowercase).collect()
}

/// Splits a destination into path and anchor; `None` for an address of the web.
pub fn local(destination: &str) -> Option<(&str, Option<&str>)> {
    if destination.contains("://") || destination.starts_with("mailto:") {
        return None;
    }
    let (path, anchor) = destination.split_once('#').map_or((destination, None), |(p, a)| (p, Some(a)));
    Some((path, anchor))
}

/// Returns the path that a link of the page at `page` names, both relative to the repository. `None` if it leads out
/// of the repository.
pub fn resolve(page: &Path, path: &str) -> Option<PathBuf> {
    if path.is_empty() {
        return Some(page.to_owned());
    }
    let mut resolved = page.parent().unwrap_or(Path::new("")).to_owned();
    for component in Path::new(path).components() {
        match component {
            Component::ParentDir if !resolved.pop() => return None,
            Component::ParentDir | Component::CurDir => {}
            Component::Normal(part) => resolved.push(part),
            Component::RootDir | Component::Prefix(_) => return None,
        }
    }
    Some(resolved)
}

/// Returns what is wrong with the links of a page of the repository.
pub fn dead(root: &Path, page: &Path, text: &str) -> Vec<String> {
    let mut dead = Vec::new();
    for link in links(text) {
        let Some((path, wanted)) = local(&link.destination) else { continue };
        let named = resolve(page, path).map(|path| root.join(path)).filter(|path| path.exists());
        let found = match (named, wanted) {
            _ if path.is_empty() => {
                wanted.is_some_and(|wanted| anchors(text).iter().any(|anchor| anchor == wanted))
            }
            (Some(file), Some(wanted)) if file.extension().is_some_and(|end| end == "md") => {
                let text = std::fs::read_to_string(file).unwrap_or_default();
                anchors(&text).iter().any(|anchor| anchor == wanted)
            }
            (named, _) => named.is_some(),
        };
        if !found {
            dead.push(format!("{}: {}", page.display(), link.destination));
        }
    }
    dead
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_found_and_resolved() {
        let text = "# A `b`, c\n\n[x](y.md#z) `[no](no.md)` ![p](q.svg)\n\n# A b c\n";
        let found: Vec<(String, bool)> =
            links(text).into_iter().map(|link| (link.destination, link.image)).collect();
        assert_eq!(found, [("y.md#z".to_owned(), false), ("q.svg".to_owned(), true)]);
        assert_eq!(anchors(text), ["a-b-c", "a-b-c-1"]);
        let page = Path::new("docs/a/b.md");
        assert_eq!(resolve(page, "../c.md"), Some(PathBuf::from("docs/c.md")));
        assert_eq!(resolve(page, "../../d"), Some(PathBuf::from("d")));
        assert_eq!(resolve(page, "../../../d"), None);
        assert_eq!(local("https://example.org/#x"), None);
    }

    #[test]
    fn dead_links_are_found() {
        let root = crate::root();
        let page = Path::new("docs/x.md");
        let dead = |text: &str| dead(&root, page, text);
        let page_of_words = "[a](glossary.md) [b](../README.md#licence) [c](#here)\n\n# Here";
        assert_eq!(dead(page_of_words), [""; 0]);
        assert_eq!(dead("[a](none.md)"), ["docs/x.md: none.md"]);
        assert_eq!(dead("[a](../README.md#none)"), ["docs/x.md: ../README.md#none"]);
        assert_eq!(dead("[a](#there)\n\n# Here"), ["docs/x.md: #there"]);
        assert_eq!(dead("[a](../../etc)"), ["docs/x.md: ../../etc"]);
    }
}
