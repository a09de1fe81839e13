//! The carrier of packets between two daemons: a trait, and its implementation over connections with a thread for each
//! direction: Unix sockets here, networks in `net`. A carrier may lose
//! packets; the host link notices. Not here: what packets mean.

use metamorph_console::stopwatch::wait_until;
use metamorph_module_agent::transport::iceoryx::rendezvous::{self, ChannelError, Notifier, Rendezvous};
use metamorph_protocol::host_link::packet::MAX_PACKET;
use metamorph_protocol::ids::HostId;
use std::fmt::{self, Debug};
use std::io::{self, BufReader, Read, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Number of packets that may wait to be sent. Further ones are dropped, as on a slow network.
const OUTGOING: usize = 64;
/// Number of packets that may wait to be taken by the owner of all carriers; further ones are dropped.
pub const INCOMING: usize = 256;
/// Longest time to wait at the end for packets that are not sent yet.
const LINGER_MAX: Duration = Duration::from_millis(200);

/// Sends packets to one other host. Dropping it ends the connection.
pub trait Carrier: Debug {
    /// Sends a packet, or drops it if too many wait.
    fn send(&mut self, packet: Vec<u8>);
    /// Returns true if the connection has ended. What had arrived before is among the events.
    fn is_over(&self) -> bool;
}

/// An event on a carrier. `number` distinguishes the carriers of one host.
#[derive(Debug)]
pub enum CarrierEvent {
    /// A packet.
    Packet {
        /// The other host.
        from: HostId,
        /// The carrier.
        number: u64,
        /// The bytes.
        packet: Vec<u8>,
    },
    /// The other host cannot be heard at present; the carrier stays.
    Interrupted {
        /// The other host.
        from: HostId,
        /// The carrier.
        number: u64,
    },
}

/// Input from a connection.
#[derive(Debug)]
pub enum Arrived {
    /// A packet.
    Packet(Vec<u8>),
    /// The other end cannot be heard at present.
    #[cfg_attr(not(feature = "hosts"), allow(dead_code, reason = "a socket is connected or not"))]
    Interruption,
}

/// A connection to another host: each direction is used by a thread of its own.
pub struct Ends {
    /// Waits for what arrives next; an error ends the connection.
    pub receive: Box<dyn FnMut() -> io::Result<Arrived> + Send>,
    /// Sends a packet. It may take its time; an error ends the connection.
    pub send: Box<dyn FnMut(Vec<u8>) -> io::Result<()> + Send>,
    /// Ends the connection: both other functions then fail.
    pub stop: Arc<dyn Fn() + Send + Sync>,
}

impl Ends {
    /// Returns the ends of a connected Unix socket.
    ///
    /// # Errors
    /// If the socket cannot be set up.
    pub fn unix(stream: UnixStream) -> io::Result<Ends> {
        stream.set_read_timeout(None)?;
        stream.set_write_timeout(None)?;
        let (mut reading, mut writing) = (BufReader::new(stream.try_clone()?), stream.try_clone()?);
        let send = move |packet: Vec<u8>| {
            // Invariant: a packet is at most 60,000 bytes long.
            let mut bytes = (packet.len() as u32).to_le_bytes().to_vec();
            bytes.extend(packet);
            writing.write_all(&bytes)
        };
        Ok(Ends {
            receive: Box::new(move || packet(&mut reading).map(Arrived::Packet)),
            send: Box::new(send),
            stop: Arc::new(move || drop(stream.shutdown(Shutdown::Both))),
        })
    }
}

/// A carrier with a thread for each direction, so that a host that reads nothing stops neither the agents of this host
/// nor its other links.
pub struct ThreadedCarrier {
    packets: Option<SyncSender<Vec<u8>>>,
    stop: Arc<dyn Fn() + Send + Sync>,
    /// True once nothing more arrives. The end is no event, since events may have to wait for their owner, who may be waiting
    /// for the thread that reads.
    over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl ThreadedCarrier {
    /// Starts a carrier for the owner of the wake-up channel in a run directory: the controller of this generation.
    ///
    /// # Errors
    /// If a thread cannot be started.
    pub fn start(
        ends: Ends,
        from: HostId,
        number: u64,
        events: SyncSender<CarrierEvent>,
        owner: (&Path, u32),
    ) -> io::Result<ThreadedCarrier> {
        let Ends { receive, send, stop } = ends;
        let (packets, waiting) = sync_channel(OUTGOING);
        let owner = (owner.0.to_owned(), owner.1);
        let over = Arc::new(AtomicBool::new(false));
        let (stopping, ended) = (Arc::clone(&stop), Arc::clone(&over));
        let mut carrier = ThreadedCarrier { packets: Some(packets), stop, over, threads: Vec::new() };
        let thread = |name: &str| std::thread::Builder::new().name(format!("{from} {name}"));
        let read = move || read(receive, from, number, &events, &ended, owner);
        carrier.threads.push(thread("in").spawn(read)?);
        carrier.threads.push(thread("out").spawn(move || write(send, &waiting, &*stopping))?);
        Ok(carrier)
    }
}

impl fmt::Debug for ThreadedCarrier {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ThreadedCarrier").finish_non_exhaustive()
    }
}

impl Carrier for ThreadedCarrier {
    fn send(&mut self, packet: Vec<u8>) {
        if let Some(packets) = &self.packets
            && let Err(TrySendError::Full(_)) = packets.try_send(packet)
        {
            tracing::debug!("a packet is dropped, since the other host reads too slowly");
        }
    }

    fn is_over(&self) -> bool {
        self.over.load(Ordering::Acquire)
    }
}

impl Drop for ThreadedCarrier {
    fn drop(&mut self) {
        // The thread that writes ends once it has written what waits, unless the other end reads nothing.
        self.packets = None;
        wait_until(LINGER_MAX, || self.threads.last().is_none_or(|writer| writer.is_finished()));
        (self.stop)();
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

fn write(
    mut send: impl FnMut(Vec<u8>) -> io::Result<()>,
    packets: &Receiver<Vec<u8>>,
    stop: &(dyn Fn() + Send + Sync),
) {
    while let Ok(packet) = packets.recv() {
        if let Err(e) = send(packet) {
            tracing::debug!("the connection to another host has failed: {e}");
            return stop();
        }
    }
}

fn read(
    mut receive: impl FnMut() -> io::Result<Arrived>,
    from: HostId,
    number: u64,
    events: &SyncSender<CarrierEvent>,
    over: &AtomicBool,
    (root, generation): (PathBuf, u32),
) {
    // A channel of iceoryx2 stays with its thread, so the bell is opened here.
    let bell =
        Bell::open(&root, generation).inspect_err(|e| tracing::warn!("packets are taken late: {e}")).ok();
    let ring = || bell.iter().for_each(Bell::ring);
    loop {
        let event = match receive() {
            Ok(Arrived::Packet(packet)) => CarrierEvent::Packet { from, number, packet },
            Ok(Arrived::Interruption) => CarrierEvent::Interrupted { from, number },
            Err(e) => {
                tracing::debug!("the connection to {from} has ended: {e}");
                over.store(true, Ordering::Release);
                return ring();
            }
        };
        match events.try_send(event) {
            Ok(()) => ring(),
            Err(TrySendError::Full(_)) => tracing::debug!("a packet is dropped, since too many wait"),
            Err(TrySendError::Disconnected(_)) => return,
        }
    }
}

fn packet(stream: &mut impl Read) -> io::Result<Vec<u8>> {
    let mut length = [0; 4];
    stream.read_exact(&mut length)?;
    let length = u32::from_le_bytes(length) as usize;
    if length > MAX_PACKET {
        let what = format!("a packet of {length} bytes; {MAX_PACKET} is the maximum");
        return Err(io::Error::new(io::ErrorKind::InvalidData, what));
    }
    let mut packet = vec![0; length];
    stream.read_exact(&mut packet)?;
    Ok(packet)
}

/// The means to wake the owner of the carriers, which waits at the inbox of its host.
struct Bell {
    notifier: Notifier,
    _service: rendezvous::Wakes,
    _at: Rendezvous,
}

impl Bell {
    fn open(root: &Path, generation: u32) -> Result<Bell, ChannelError> {
        let at = Rendezvous::join(root)?;
        let service = at.open_controller_bell(generation)?;
        Ok(Bell { notifier: rendezvous::ring(&service)?, _service: service, _at: at })
    }
    fn ring(&self) {
        if let Err(e) = self.notifier.notify() {
            tracing::debug!("cannot ring the bell of this host: {e:?}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_console::stopwatch::wait_until;

    /// A connection that has ended although its owner, frozen, has taken nothing for long, is given up all the same.
    #[test]
    fn a_full_queue_keeps_no_carrier_from_ending() {
        let (events, taken) = sync_channel(INCOMING);
        let mut left = INCOMING + 10;
        let receive = move || match left.checked_sub(1) {
            Some(less) => {
                left = less;
                Ok(Arrived::Packet(vec![0]))
            }
            None => Err(io::ErrorKind::UnexpectedEof.into()),
        };
        let ends = Ends { receive: Box::new(receive), send: Box::new(|_| Ok(())), stop: Arc::new(|| ()) };
        let directory = tempfile::tempdir().unwrap();
        let owner = (directory.path(), 0);
        let carrier = ThreadedCarrier::start(ends, HostId(1), 1, events, owner).unwrap();
        let minute = Duration::from_secs(60);
        assert!(wait_until(minute, || carrier.is_over()));
        let (ended, is_dropped) = sync_channel(1);
        std::thread::spawn(move || {
            drop(carrier);
            ended.send(())
        });
        is_dropped.recv_timeout(minute).unwrap();
        assert_eq!(taken.try_iter().count(), INCOMING);
    }
}
