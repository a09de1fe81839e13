//! Messages of a host link to its owner: states, outputs, and the results of inputs.

use super::packet::{Life, PacketError, Terms};
use metamorph_core::wire::Frame;
use thiserror::Error;

/// The state of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    /// The carrier is not open.
    Down,
    /// The other end has not been reached yet.
    Greeting,
    /// Frames and streams pass.
    Up,
    /// The other end has not been heard for a while; streams wait, and frames are lost.
    Silent,
    /// The other end counts as dead (guardian), or this one has to stop (ward). For good, as far as these two lives are
    /// concerned.
    Fenced,
    /// One of the ends has said goodbye.
    Closed,
}

/// One of the two streams.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Channel {
    /// The conversation between controller and agents, and of the daemons.
    Stream,
    /// Journals and ledgers, which get what the stream leaves.
    Bulk,
}

/// An output of a link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Output {
    /// A packet for the carrier.
    Packet(Vec<u8>),
    /// A frame from the other end.
    Frame(Frame),
    /// The next bytes of a stream from the other end.
    Bytes(Channel, Vec<u8>),
    /// The link is in another state.
    Changed(State),
    /// The link is up with another life of the other host, which makes this offer. What an earlier life had not
    /// acknowledged is gone.
    Met(Life, Terms),
}

/// Result of offering a frame to a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Offered {
    /// It will be sent.
    Queued,
    /// Too many are under way.
    Overflowed,
    /// The other end is silent.
    Lost,
    /// There is no other end.
    Expired,
}

/// Why a packet is not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Refused {
    /// It cannot be read.
    #[error(transparent)]
    Malformed(#[from] PacketError),
    /// It is from another host or run, or for another.
    #[error("the packet is of another run or between other hosts")]
    Foreign,
    /// It is from or for a life that is not, or no longer, part of the link.
    #[error("the packet is from or for an earlier life of a host")]
    OtherLife,
    /// The link has ended: the other host counts as dead, this one has to stop, or one of them has said goodbye.
    #[error(
        "the packet is of a host whose link has ended: it was silent for too long, or one of the two has said goodbye"
    )]
    Ended,
    /// The hosts do not run the same program on the same swarm.
    #[error("the hosts do not agree: {0}")]
    Terms(&'static str),
    /// The sender does not know the secret of the run.
    #[error("the proof is wrong")]
    Proof,
    /// The packet answers no greeting that is open.
    #[error("the packet answers no open greeting")]
    Unasked,
    /// A greeting goes the wrong way.
    #[error("the greeting is the part of the other end")]
    WrongWay,
    /// It contradicts what has been sent.
    #[error("the packet contradicts what has been sent")]
    Impossible,
}
