//! Prepares text from outside the program (names in scenarios and journals, file names, command-line words)
//! for display: escapes control characters and truncates long text. Absent: printing (see `terminal`, which
//! escapes its input again).

use serde::Serialize;
use std::borrow::Cow;
use std::fmt::Write;
use std::path::Path;

/// Largest number of characters shown of a name.
const LONGEST_NAME: usize = 200;
/// Largest number of characters shown of a path.
const LONGEST_PATH: usize = 400;

/// Returns true if `c` is invisible or changes how other text is displayed: controls (C0 and C1), direction
/// marks, other invisible marks, line separators, noncharacters.
pub fn is_control(c: char) -> bool {
    c.is_control()
        || matches!(c,
            '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}' | '\u{fdd0}'..='\u{fdef}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}'
            | '\u{e0000}'..='\u{e007f}')
}

/// Escapes control characters as in Rust (`\u{1b}`), except those that `keep` accepts.
pub fn escape(text: &str, keep: impl Fn(char) -> bool) -> Cow<'_, str> {
    let hostile = |c: char| is_control(c) && !keep(c);
    if !text.contains(hostile) {
        return Cow::Borrowed(text);
    }
    let escaped = text.chars().fold(String::with_capacity(text.len() + 16), |mut out, c| {
        // Writing to a string cannot fail.
        let _ = match c {
            '\n' | '\r' | '\t' if hostile(c) => write!(out, "{}", c.escape_default()),
            _ if hostile(c) => write!(out, "{}", c.escape_unicode()),
            _ => out.write_char(c),
        };
        out
    });
    Cow::Owned(escaped)
}

/// Text from outside, made fit for display.
pub trait Shown {
    /// Returns one line without control characters, truncated if very long.
    fn shown(&self) -> String;
}

impl Shown for str {
    fn shown(&self) -> String {
        line(self, LONGEST_NAME)
    }
}

/// Returns one line of at most `most` characters, with an ellipsis if text was cut.
pub fn line(text: &str, most: usize) -> String {
    match text.char_indices().nth(most) {
        None => escape(text, |_| false).into_owned(),
        Some((end, _)) => escape(&text[..end], |_| false).into_owned() + "…",
    }
}

impl Shown for Path {
    /// Keeps the end of a path, which says more than its beginning.
    fn shown(&self) -> String {
        let text = self.to_string_lossy();
        match text.char_indices().rev().nth(LONGEST_PATH) {
            None => escape(&text, |_| false).into_owned(),
            Some((start, first)) => "…".to_owned() + &escape(&text[start + first.len_utf8()..], |_| false),
        }
    }
}

/// Returns a file's name for output that is passed on: the path as typed if it is relative, otherwise its
/// last part, so that the output does not reveal the directories of this machine.
pub fn portable(path: &Path) -> String {
    let name = if path.is_absolute() { path.file_name().map_or(path, Path::new) } else { path };
    name.to_string_lossy().into_owned()
}

/// Formats a value as JSON for programs and terminals: control characters are written as `\uXXXX`.
pub fn json(value: &impl Serialize) -> String {
    let text = serde_json::to_string_pretty(value)
        .expect("invariant: the value consists of plain values, text keys and finite numbers");
    let hostile = |c: char| is_control(c) && c != '\n';
    if !text.contains(hostile) {
        return text;
    }
    // JSON contains such characters only inside strings.
    text.chars().fold(String::with_capacity(text.len() + 16), |mut out, c| {
        if hostile(c) {
            for unit in c.encode_utf16(&mut [0; 2]) {
                // Writing to a string cannot fail.
                let _ = write!(out, "\\u{unit:04x}");
            }
        } else {
            out.push(c);
        }
        out
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_escaped_and_the_rest_is_kept() {
        for (text, shown) in [
            ("chair", "chair"),
            ("Stühle, 椅子, 🪑", "Stühle, 椅子, 🪑"),
            ("a\x1b[31mb", r"a\u{1b}[31mb"),
            ("a\nb\tc\rd", r"a\nb\tc\rd"),
            ("\u{9b}2J", r"\u{9b}2J"),
            ("\u{202e}txt.exe", r"\u{202e}txt.exe"),
            ("\u{2066}\u{7f}\0", r"\u{2066}\u{7f}\u{0}"),
        ] {
            assert_eq!(text.shown(), shown);
            assert_eq!(Path::new(text).shown(), shown);
            assert_eq!(serde_json::from_str::<String>(&json(&text)).unwrap(), text);
            assert!(!json(&text).contains(is_control), "{text:?}");
        }
        assert_eq!(escape("a\nb\x07", |c| c == '\n'), "a\nb\\u{7}");
    }

    #[test]
    fn long_text_is_cut() {
        let long = "é".repeat(10_000);
        assert_eq!(long.shown(), "é".repeat(LONGEST_NAME) + "…");
        assert_eq!("é".repeat(LONGEST_NAME).shown(), "é".repeat(LONGEST_NAME));
        let path = format!("/{}/end.toml", "d/".repeat(1_000));
        let shown = Path::new(&path).shown();
        assert!(shown.starts_with('…') && shown.ends_with("/end.toml"), "{shown}");
        assert_eq!(shown.chars().count(), LONGEST_PATH + 1);
    }

    #[test]
    fn what_is_passed_on_names_no_directory_of_this_machine() {
        for (path, name) in
            [("/home/me/a.toml", "a.toml"), ("b/a.toml", "b/a.toml"), ("../a.toml", "../a.toml"), ("/", "/")]
        {
            assert_eq!(portable(Path::new(path)), name);
        }
    }
}
