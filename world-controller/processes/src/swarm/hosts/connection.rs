//! A connection with another host: an opening and its answer are said on it, then it carries packets. Over a Unix socket,
//! or, with the cargo feature `hosts`, over a network.

use super::carrier::{CarrierEvent, Ends, ThreadedCarrier};
use super::messages::{Answer, Opening, write_opening};
#[cfg(feature = "hosts")]
use super::net;
use metamorph_protocol::ids::HostId;
use std::io;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::mpsc::SyncSender;

/// A connection.
pub enum Connection {
    /// A socket on this machine.
    Unix(UnixStream),
    /// The line to a host on another machine.
    #[cfg(feature = "hosts")]
    Net(Box<net::Line>),
}

impl Connection {
    /// Turns the connection into a carrier, see [`ThreadedCarrier::start`].
    ///
    /// # Errors
    /// If it cannot be set up.
    pub fn carry(
        self,
        from: HostId,
        number: u64,
        events: SyncSender<CarrierEvent>,
        owner: (&Path, u32),
    ) -> io::Result<ThreadedCarrier> {
        let ends = match self {
            Connection::Unix(stream) => Ends::unix(stream)?,
            #[cfg(feature = "hosts")]
            Connection::Net(line) => line.into_ends(),
        };
        ThreadedCarrier::start(ends, from, number, events, owner)
    }
}

/// Someone who has said an opening to this daemon, and waits for the answer.
pub enum Visitor {
    /// On a socket, which carries packets afterwards.
    Unix(UnixStream),
    /// On a network.
    #[cfg(feature = "hosts")]
    Net(net::Reply),
}

/// An opening, and who has said it.
pub type Incoming = (Opening, Visitor);

impl Visitor {
    /// Answers.
    ///
    /// # Errors
    /// If the connection fails.
    pub fn answer(&mut self, answer: Answer) -> io::Result<()> {
        match self {
            Visitor::Unix(stream) => write_opening(stream, &answer),
            #[cfg(feature = "hosts")]
            Visitor::Net(reply) => reply.say(answer),
        }
    }
}
