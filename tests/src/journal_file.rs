//! The frames of a journal's file, so that tests can damage it at a chosen place.

use std::ops::Range;

/// Returns the frames of a file: a length, a check sum and a record each.
pub fn frames(bytes: &[u8]) -> Vec<Range<usize>> {
    let mut at = 10;
    std::iter::from_fn(|| {
        let length = u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?) as usize;
        let frame = at..at + 12 + length;
        at = frame.end;
        Some(frame)
    })
    .collect()
}

/// Returns the first half of a file, cut within a frame: what ends with a whole frame says nothing of being cut.
///
/// # Panics
/// If the file has no frame.
pub fn half(bytes: &[u8]) -> &[u8] {
    let frames = frames(bytes);
    let middle = frames.get(frames.len() / 2).expect("a journal has frames");
    &bytes[..middle.end - 1]
}
