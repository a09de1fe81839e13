//! Colours of text for the terminal: painted text carries placeholders, which become colour codes when it is printed.
//! Absent: printing, and the question whether a terminal shows colours.

use crate::escape::escape;

/// Placeholders for colour codes until text is printed: noncharacters, so that no colour can come from
/// outside.
const MARKS: [(char, &str); 4] =
    [(GOOD, "\x1b[1;32m"), (BAD, "\x1b[1;31m"), (STRONG, "\x1b[1m"), (PLAIN, "\x1b[0m")];
const GOOD: char = '\u{fdd0}';
const BAD: char = '\u{fdd1}';
const STRONG: char = '\u{fdd2}';
const PLAIN: char = '\u{fdd3}';

/// Whether text is coloured, and how wide tables may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Paint {
    on: bool,
    /// Characters of a line.
    width: usize,
}

impl Paint {
    /// No colours, tables of any width.
    pub const PLAIN: Paint = Paint { on: false, width: usize::MAX };

    /// Colours, tables of any width.
    pub const COLOURED: Paint = Paint { on: true, width: usize::MAX };

    /// Returns the same for lines of so many characters.
    pub fn within(self, width: usize) -> Paint {
        Paint { width, ..self }
    }
    /// Returns the number of characters of a line, which tables are folded to.
    pub fn width(self) -> usize {
        self.width
    }

    fn wrap(self, mark: char, text: &str) -> String {
        if self.on { format!("{mark}{text}{PLAIN}") } else { text.to_owned() }
    }
    /// Escapes the text, inserts the colour codes, and terminates the last line.
    pub fn finish(self, text: &str) -> String {
        let is_mark = |c: char| self.on && MARKS.iter().any(|(mark, _)| *mark == c);
        let mut text = escape(text, |c| matches!(c, '\n' | '\t') || is_mark(c)).into_owned();
        if self.on {
            text = MARKS.iter().fold(text, |text, (mark, code)| text.replace(*mark, code));
        }
        if !text.ends_with('\n') {
            text.push('\n');
        }
        text
    }
    /// Paints text that reports success.
    pub fn good(self, text: &str) -> String {
        self.wrap(GOOD, text)
    }
    /// Paints text that reports a failure.
    pub fn bad(self, text: &str) -> String {
        self.wrap(BAD, text)
    }
    /// Paints a heading.
    pub fn strong(self, text: &str) -> String {
        self.wrap(STRONG, text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_our_colours_reach_a_terminal() {
        let on = Paint::COLOURED;
        let hostile = "a\x1b[2Jb\u{9b}31mc\u{202e}d\n";
        let escaped = "a\\u{1b}[2Jb\\u{9b}31mc\\u{202e}d\n";
        for paint in [on, Paint::PLAIN] {
            assert_eq!(paint.finish(hostile), escaped);
        }
        assert_eq!(on.finish(&on.good("built")), "\x1b[1;32mbuilt\x1b[0m\n");
        assert_eq!(Paint::PLAIN.finish(&Paint::PLAIN.bad("no")), "no\n");
        assert_eq!(Paint::PLAIN.finish("a\u{fdd0}b"), "a\\u{fdd0}b\n");
    }
}
