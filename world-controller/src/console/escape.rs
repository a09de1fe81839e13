//! Text that this program did not make (names in scenarios and journals, names of files, words of the
//! command line) on its way to a person: characters that play with a terminal are escaped, and what is
//! too long is cut. Absent: printing (see `terminal`, which escapes once more whatever it is given).

use serde::Serialize;
use std::borrow::Cow;
use std::fmt::Write;
use std::path::Path;

/// The most characters of a name that are shown.
const LONGEST_NAME: usize = 200;
/// The most characters of a path that are shown.
const LONGEST_PATH: usize = 400;

/// Whether a character is not itself printed, but changes what is: controls (C0 and C1), marks that
/// change the direction of text, other invisible marks, separators of lines, noncharacters.
pub fn is_control(c: char) -> bool {
    c.is_control()
        || matches!(c,
            '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}' | '\u{fdd0}'..='\u{fdef}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}'
            | '\u{e0000}'..='\u{e007f}')
}

/// The text with its control characters, except those that `keep` names, written as in Rust: `\u{1b}`.
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

/// Text from outside as a person reads it.
pub trait Shown {
    /// One line without control characters, cut if it is very long.
    fn shown(&self) -> String;
}

impl Shown for str {
    fn shown(&self) -> String {
        line(self, LONGEST_NAME)
    }
}

/// One line of at most `most` characters, with an ellipsis if there are more.
pub fn line(text: &str, most: usize) -> String {
    match text.char_indices().nth(most) {
        None => escape(text, |_| false).into_owned(),
        Some((end, _)) => escape(&text[..end], |_| false).into_owned() + "…",
    }
}

impl Shown for Path {
    /// The end of a path says more than its beginning.
    fn shown(&self) -> String {
        let text = self.to_string_lossy();
        match text.char_indices().rev().nth(LONGEST_PATH) {
            None => escape(&text, |_| false).into_owned(),
            Some((start, first)) => "…".to_owned() + &escape(&text[start + first.len_utf8()..], |_| false),
        }
    }
}

/// The name of a file in what is written to be passed on: as it was typed, if that is seen from the
/// working directory, and otherwise its last part. Where it lies on this machine is no business of others.
pub fn portable(path: &Path) -> String {
    let name = if path.is_absolute() { path.file_name().map_or(path, Path::new) } else { path };
    name.to_string_lossy().into_owned()
}

/// A value as JSON to be read by programs and people. Control characters stand as `\uXXXX`, so that the
/// text does no harm on a terminal and means the same.
pub fn json(value: &impl Serialize) -> String {
    let text = serde_json::to_string_pretty(value)
        .expect("invariant: what is written is made of plain values, text keys and finite numbers");
    let hostile = |c: char| is_control(c) && c != '\n';
    if !text.contains(hostile) {
        return text;
    }
    // Outside of texts JSON has no such characters.
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
