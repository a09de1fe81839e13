//! The frames of a journal file, and whether the end of a file is torn or damaged.
//!
//! A frame consists of the length of its content (4 bytes), the check sum of the previous frame (4), its own
//! check sum (4), and its content. A check sum is the CRC-32/ISO-HDLC of the length, the previous check sum
//! and the content, so it depends on everything in the file up to there: a frame that was removed, repeated,
//! moved or taken from another file is detected. Numbers are little endian.

use bincode::config::standard;
use serde::Serialize;
use std::io;

/// Size of the header of a frame in bytes.
pub const HEADER: usize = 12;

/// Largest number of bytes hashed in the search for a whole frame after the start of a broken one. The torn
/// end of a killed writer is shorter than one frame and takes far less.
const SEARCH: usize = 64 << 20;

/// The header of a frame.
#[derive(Clone, Copy, Debug)]
pub struct Header {
    /// Length of the content in bytes.
    pub length: usize,
    /// Check sum of the frame before.
    pub previous: u32,
    /// Check sum of this frame.
    pub sum: u32,
}

impl Header {
    /// Decodes a header.
    pub fn read(bytes: [u8; HEADER]) -> Header {
        let [a, b, c, d, e, f, g, h, i, j, k, l] = bytes;
        let [length, previous, sum] = [[a, b, c, d], [e, f, g, h], [i, j, k, l]].map(u32::from_le_bytes);
        Header { length: length as usize, previous, sum }
    }
    /// True if this is the check sum of a frame with this content.
    pub fn fits(&self, content: &[u8]) -> bool {
        sum(self.previous, content) == self.sum
    }
}

fn sum(previous: u32, content: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&(content.len() as u32).to_le_bytes());
    hasher.update(&previous.to_le_bytes());
    hasher.update(content);
    hasher.finalize()
}

/// Appends a frame and returns its check sum. Appends nothing if the content is longer than `longest`.
///
/// # Errors
/// If the content cannot be encoded, or is too long.
pub fn append<T: Serialize>(
    out: &mut Vec<u8>,
    previous: u32,
    content: &T,
    longest: usize,
) -> io::Result<u32> {
    let start = out.len();
    out.extend([0; HEADER]);
    let encoded = bincode::serde::encode_into_std_write(content, out, standard());
    let length = out.len() - start - HEADER;
    if encoded.is_err() || length > longest {
        out.truncate(start);
        encoded.map_err(io::Error::other)?;
        return Err(io::Error::other(format!("a frame of {length} bytes is too long")));
    }
    let sum = sum(previous, &out[start + HEADER..]);
    for (i, number) in [length as u32, previous, sum].into_iter().enumerate() {
        out[start + 4 * i..start + 4 * i + 4].copy_from_slice(&number.to_le_bytes());
    }
    Ok(sum)
}

/// True if the last bytes of a file are an incomplete frame, as a killed writer leaves it. If they contain a
/// whole frame, even one whose stored length is wrong, bytes were changed, and this is damage.
pub fn is_torn(rest: &[u8], longest: usize) -> bool {
    let Some((header, content)) = split(rest) else { return true };
    if header.length > longest || header.length <= content.len() || header.fits(content) {
        return false;
    }
    let mut budget = SEARCH;
    for at in 1..rest.len() {
        let Some((header, content)) = split(&rest[at..]) else { break };
        let Some(content) = content.get(..header.length) else { continue };
        if header.fits(content) || budget < content.len() {
            return false;
        }
        budget -= content.len();
    }
    true
}

fn split(bytes: &[u8]) -> Option<(Header, &[u8])> {
    let (header, content) = bytes.split_first_chunk()?;
    Some((Header::read(*header), content))
}
