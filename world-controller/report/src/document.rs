//! Shared by all pages: a self-contained HTML document with one style, and figures with captions.

use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Content security policy: only inline styles, nothing loaded.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'";
const STYLE: &str = include_str!("document.css");

/// Returns a complete document around a body.
pub fn document(title: &str, body: Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                meta name="generator" content="metamorph";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body { (body) }
        }
    };
    page.into_string() + "\n"
}

/// Returns a plot with its caption.
pub fn figure(plot: Markup, caption: Markup) -> Markup {
    html! { figure { figcaption { (caption) } div.wide { (plot) } } }
}
