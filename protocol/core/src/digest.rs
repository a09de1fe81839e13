//! Hashes of state that are the same on every machine and build: numbers are hashed as little-endian bytes
//! of a fixed width, lengths and discriminants as 64 bits. (Slices of wider numbers are hashed as they lie in
//! memory, which is the same on all little-endian machines.)
//!
//! `#[derive(Hash)]` alone hashes native bytes, lengths as `usize`, and fields in the order of their
//! declaration. So a digest of an agent or a world names its fields by hand, in a fixed order, and hashes
//! them through [`Portable`]. It leaves out what follows from the rest: caches, dirty flags, wake-up times,
//! and outputs.

use core::hash::Hasher;

/// Size of the buffer in bytes: one long write is faster than many short ones.
const GATHERED: usize = 512;

/// A hasher that encodes numbers in the same way on every machine, and passes them on to another hasher.
pub struct Portable<'a> {
    to: &'a mut dyn Hasher,
    gathered: [u8; GATHERED],
    /// Bytes of `gathered` in use.
    used: usize,
}

impl<'a> Portable<'a> {
    /// Creates a hasher in front of `to`; the last bytes are passed on when it is dropped.
    pub fn new(to: &'a mut dyn Hasher) -> Portable<'a> {
        Portable { to, gathered: [0; GATHERED], used: 0 }
    }

    fn flush(&mut self) {
        self.to.write(&self.gathered[..self.used]);
        self.used = 0;
    }

    #[inline]
    fn put<const N: usize>(&mut self, bytes: [u8; N]) {
        if self.used + N > GATHERED {
            self.flush();
        }
        self.gathered[self.used..self.used + N].copy_from_slice(&bytes);
        self.used += N;
    }
}

impl Drop for Portable<'_> {
    fn drop(&mut self) {
        self.flush();
    }
}

impl Hasher for Portable<'_> {
    /// Returns the hash of the bytes passed on so far; bytes that are still in the buffer are left out.
    fn finish(&self) -> u64 {
        self.to.finish()
    }
    #[inline]
    fn write(&mut self, bytes: &[u8]) {
        self.flush();
        self.to.write(bytes);
    }
    #[inline]
    fn write_u8(&mut self, n: u8) {
        self.put([n]);
    }
    #[inline]
    fn write_u16(&mut self, n: u16) {
        self.put(n.to_le_bytes());
    }
    #[inline]
    fn write_u32(&mut self, n: u32) {
        self.put(n.to_le_bytes());
    }
    #[inline]
    fn write_u64(&mut self, n: u64) {
        self.put(n.to_le_bytes());
    }
    #[inline]
    fn write_u128(&mut self, n: u128) {
        self.put(n.to_le_bytes());
    }
    #[inline]
    fn write_usize(&mut self, n: usize) {
        self.write_u64(n as u64);
    }
    #[inline]
    fn write_i8(&mut self, n: i8) {
        self.put(n.to_le_bytes());
    }
    #[inline]
    fn write_i16(&mut self, n: i16) {
        self.put(n.to_le_bytes());
    }
    #[inline]
    fn write_i32(&mut self, n: i32) {
        self.put(n.to_le_bytes());
    }
    #[inline]
    fn write_i64(&mut self, n: i64) {
        self.put(n.to_le_bytes());
    }
    #[inline]
    fn write_i128(&mut self, n: i128) {
        self.put(n.to_le_bytes());
    }
    #[inline]
    fn write_isize(&mut self, n: isize) {
        self.write_i64(n as i64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::hash::Hash;

    /// Stores the bytes it is given.
    #[derive(Default)]
    struct Bytes(Vec<u8>);

    impl Hasher for Bytes {
        fn finish(&self) -> u64 {
            0
        }
        fn write(&mut self, bytes: &[u8]) {
            self.0.extend_from_slice(bytes);
        }
    }

    #[test]
    fn numbers_have_one_form() {
        let mut bytes = Bytes::default();
        let mut portable = Portable::new(&mut bytes);
        (1u8, 2u16, 3u32, -2i16, 4usize, Some(5u16)).hash(&mut portable);
        drop(portable);
        let length = [4, 0, 0, 0, 0, 0, 0, 0];
        let some = [1, 0, 0, 0, 0, 0, 0, 0, 5, 0];
        assert_eq!(bytes.0, [&[1, 2, 0, 3, 0, 0, 0, 0xFE, 0xFF][..], &length, &some].concat());
    }

    /// Bytes are neither lost nor reordered when the buffer is passed on.
    #[test]
    fn buffered_bytes_arrive_in_order() {
        let (mut bytes, mut expected) = (Bytes::default(), Vec::new());
        let mut portable = Portable::new(&mut bytes);
        for n in 0..300u64 {
            (n as u8).hash(&mut portable);
            n.hash(&mut portable);
            portable.write(&[9; 5]);
            n.hash(&mut portable);
            expected.extend([&[n as u8][..], &n.to_le_bytes(), &[9; 5], &n.to_le_bytes()].concat());
        }
        drop(portable);
        assert_eq!(bytes.0, expected);
    }
}
