//! Kinds of output files, and how an existing file is recognized as one that this program wrote.
//!
//! A command replaces only files that it would have written itself, so that `--journal my.toml` does not replace a
//! scenario. Files are recognized by their content, not their name: a name is what is mistyped.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// The number of bytes at the beginning of a file by which it is recognized.
const HEAD: u64 = 4096;
/// The first keys of the JSON documents that commands write.
const FIRST_KEYS: [&[u8]; 5] = [b"schema", b"format", b"verdict", b"shapes", b"shared_labels"];

/// Whether files of any kind may be replaced.
static FORCED: AtomicBool = AtomicBool::new(false);

/// Allows this process to replace files of any kind: the option `--force`.
pub fn replace_any_file() {
    FORCED.store(true, Ordering::Relaxed);
}

/// A kind of output file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputKind {
    /// Anything: files in a directory that belongs to this program.
    Any,
    /// A table with a header of lower-case names.
    Csv,
    /// A page.
    Html,
    /// A journal of a run.
    Journal,
    /// A document in JSON.
    Json,
    /// A manual page.
    Manual,
    /// A database of motions of Roombots.
    MotionDatabase,
    /// A picture as SVG, PDF, PNG, GIF, APNG or MP4.
    Picture,
}

impl OutputKind {
    /// Returns the kind in words, with its article.
    pub fn name(self) -> &'static str {
        match self {
            OutputKind::Any => "a file",
            OutputKind::Csv => "a table",
            OutputKind::Html => "a page",
            OutputKind::Journal => "a journal",
            OutputKind::Json => "a JSON document",
            OutputKind::Manual => "a manual page",
            OutputKind::MotionDatabase => "a motion database",
            OutputKind::Picture => "a picture",
        }
    }

    /// Returns true if an existing file may be replaced by one of this kind: it is empty, this program wrote it with the same
    /// kind, or the user forces it.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn may_replace(self, path: &Path) -> io::Result<bool> {
        if self == OutputKind::Any || FORCED.load(Ordering::Relaxed) {
            return Ok(true);
        }
        let mut head = Vec::new();
        File::open(path)?.take(HEAD).read_to_end(&mut head)?;
        Ok(head.is_empty() || self.begins(&head))
    }

    /// Returns true if a file that this program wrote with this kind can begin in this way.
    fn begins(self, head: &[u8]) -> bool {
        let has = |mark: &[u8]| head.windows(mark.len()).any(|part| part == mark);
        match self {
            OutputKind::Any => true,
            OutputKind::Csv => head.split(|byte| *byte == b'\n').next().is_some_and(is_header),
            OutputKind::Html => head.starts_with(b"<!DOCTYPE html>") && has(b"content=\"metamorph\""),
            OutputKind::Journal => head.starts_with(b"MMJOURNL"),
            OutputKind::Json => first_key(head).is_some_and(|key| {
                // A structure that was recognised begins with its name, as do many documents of others.
                FIRST_KEYS.contains(&key) || key == b"name" && has(b"\"chiral\":")
            }),
            OutputKind::Manual => head.starts_with(b".ie ") && has(b".TH metamorph"),
            OutputKind::MotionDatabase => head.starts_with(b"MMRBDB"),
            OutputKind::Picture => {
                let is_bitmap = head.starts_with(b"\x89PNG\r\n") || head.starts_with(b"GIF8");
                let is_film = head.get(4..8) == Some(b"ftyp");
                let is_page = head.starts_with(b"%PDF-") && has(b"/Creator (metamorph)");
                is_bitmap || is_film || is_page || head.starts_with(b"<svg")
            }
        }
    }
}

/// Returns true if a line consists of two or more names such as `moves_total`, separated by commas.
fn is_header(line: &[u8]) -> bool {
    let is_name = |name: &[u8]| {
        !name.is_empty() && name.iter().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || *b == b'_')
    };
    line.contains(&b',') && line.trim_ascii_end().split(|byte| *byte == b',').all(is_name)
}

/// Returns the first key of a JSON object.
fn first_key(head: &[u8]) -> Option<&[u8]> {
    let inside = head.trim_ascii_start().strip_prefix(b"{")?.trim_ascii_start().strip_prefix(b"\"")?;
    inside.split(|byte| *byte == b'"').next()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_files_of_the_same_kind_are_replaced() {
        use OutputKind::{Csv, Html, Journal, Json, Picture};
        let files: [(&[u8], &[OutputKind]); 14] = [
            (b"", &[Csv, Html, Journal, Json, Picture]),
            (b"MMJOURNL\x0d\0", &[Journal]),
            (b"version = 1\n[swarm]\n", &[]),
            (b"# Notes, for later\n", &[]),
            (b"{\n  \"schema\": 1,\n", &[Json]),
            (b"{\"name\": \"a-package\", \"version\": \"1.0.0\"}", &[]),
            (b"{\n  \"name\": \"line:3\",\n  \"chiral\": false\n}", &[Json]),
            (b"module,moves,sent_bytes\n0,1,2\n", &[Csv]),
            (b"Name,Surname\n", &[]),
            (b"<!DOCTYPE html><html><head><meta name=\"generator\" content=\"metamorph\">", &[Html]),
            (b"<!DOCTYPE html><title>Home</title>", &[]),
            (b"%PDF-1.7\n5 0 obj\n<<\n  /Creator (metamorph)\n>>", &[Picture]),
            (b"%PDF-1.7\n5 0 obj\n<<\n  /Title (My thesis)\n>>", &[]),
            (b"<svg xmlns=\"http://www.w3.org/2000/svg\">", &[Picture]),
        ];
        let file = tempfile::NamedTempFile::new().unwrap();
        for (content, kinds) in files {
            std::fs::write(file.path(), content).unwrap();
            for kind in [Csv, Html, Journal, Json, Picture] {
                let may = kind.may_replace(file.path()).unwrap();
                assert_eq!(may, kinds.contains(&kind), "{kind:?}: {}", String::from_utf8_lossy(content));
            }
        }
    }
}
