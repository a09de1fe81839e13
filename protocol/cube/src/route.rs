//! A path over faces, taken by requests and searches.

use metamorph_core::lattice::Face;
use metamorph_core::wire::{Decoder, Encoder, Field, WireError};

/// The largest number of hops of a request.
pub const MAX_HOPS: usize = 26;

/// The faces by which a message leaves one module after the other, starting with the module that asks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Route {
    len: u8,
    hops: [u8; MAX_HOPS],
}

impl Route {
    /// Creates a route of at least one and at most [`MAX_HOPS`] hops.
    pub fn new(hops: &[Face]) -> Option<Route> {
        if hops.is_empty() || hops.len() > MAX_HOPS {
            return None;
        }
        let mut route = Route { len: hops.len() as u8, hops: [0; MAX_HOPS] };
        for (slot, face) in route.hops.iter_mut().zip(hops) {
            *slot = *face as u8;
        }
        Some(route)
    }
    /// Returns the number of hops.
    pub fn hop_count(&self) -> usize {
        self.len.into()
    }
    /// Returns the face to leave by on hop `i`.
    pub fn hop(&self, i: usize) -> Option<Face> {
        self.hops[..self.hop_count()].get(i).and_then(|f| Face::from_index(*f))
    }
    /// Iterates over the hops in order.
    pub fn faces(&self) -> impl Iterator<Item = Face> + '_ {
        (0..self.hop_count()).filter_map(|i| self.hop(i))
    }
    /// Returns this route with one more hop; `None` if it already has [`MAX_HOPS`].
    pub fn then(&self, face: Face) -> Option<Route> {
        let mut next = *self;
        *next.hops.get_mut(self.hop_count())? = face as u8;
        next.len += 1;
        Some(next)
    }
}

impl Field for Route {
    fn put(&self, out: &mut Encoder) {
        out.u8(self.len);
        let mut packed = 0u128;
        for (i, hop) in self.hops.iter().enumerate() {
            packed |= u128::from(*hop) << (3 * i);
        }
        for byte in &packed.to_le_bytes()[..10] {
            out.u8(*byte);
        }
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<Route, WireError> {
        let len = from.u8()?;
        let mut bytes = [0u8; 16];
        for byte in &mut bytes[..10] {
            *byte = from.u8()?;
        }
        let packed = u128::from_le_bytes(bytes);
        let mut hops = [0; MAX_HOPS];
        for (i, hop) in hops.iter_mut().enumerate() {
            *hop = (packed >> (3 * i) & 7) as u8;
        }
        let used = usize::from(len);
        let valid = (1..=MAX_HOPS).contains(&used)
            && hops[..used].iter().all(|h| *h < 6)
            && hops[used..].iter().all(|h| *h == 0)
            && packed >> (3 * MAX_HOPS) == 0;
        if valid { Ok(Route { len, hops }) } else { Err(WireError::Field("route")) }
    }
}
