//! The carrier of packets between two daemons: a trait, and its implementation over Unix sockets. A carrier may lose
//! packets; the host link notices. Not here: what packets mean.

use crate::console::stopwatch::wait_until;
use metamorph_module_agent::transport::iceoryx::rendezvous::{self, ChannelError, Notifier, Rendezvous};
use metamorph_protocol::host_link::packet::MAX_PACKET;
use metamorph_protocol::ids::HostId;
use std::fmt::Debug;
use std::io::{self, BufReader, Read, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Number of packets that may wait to be sent. Further ones are dropped, as on a slow network.
const OUTGOING: usize = 64;
/// Number of packets that may wait to be taken by the owner of all carriers; further ones are dropped.
pub const INCOMING: usize = 256;
/// The longest wait at the end for packets that wait to be sent.
const LINGER: Duration = Duration::from_millis(200);

/// Sends packets to one other host. Dropping it ends the connection.
pub trait Carrier: Debug {
    /// Sends a packet, or drops it if too many wait.
    fn send(&mut self, packet: Vec<u8>);
}

/// What a carrier reports. `number` tells the carriers of one host apart.
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
    /// The connection has ended.
    Down {
        /// The other host.
        from: HostId,
        /// The carrier.
        number: u64,
    },
}

/// A carrier over a connected Unix socket, with a thread for each direction, so that a host that reads nothing stops
/// neither the agents of this host nor its other links.
#[derive(Debug)]
pub struct UnixCarrier {
    packets: Option<SyncSender<Vec<u8>>>,
    stream: UnixStream,
    threads: Vec<JoinHandle<()>>,
}

impl UnixCarrier {
    /// Starts a carrier for the owner of the wake-up channel in the run directory `root`.
    ///
    /// # Errors
    /// If the socket or a thread cannot be set up.
    pub fn start(
        stream: UnixStream,
        from: HostId,
        number: u64,
        events: SyncSender<CarrierEvent>,
        root: &Path,
    ) -> io::Result<UnixCarrier> {
        stream.set_read_timeout(None)?;
        stream.set_write_timeout(None)?;
        let (reading, writing, root) = (stream.try_clone()?, stream.try_clone()?, root.to_owned());
        let (packets, waiting) = sync_channel(OUTGOING);
        let mut carrier = UnixCarrier { packets: Some(packets), stream, threads: Vec::new() };
        let thread = |name: &str| std::thread::Builder::new().name(format!("{from} {name}"));
        let read = move || read(reading, from, number, &events, root);
        carrier.threads.push(thread("in").spawn(read)?);
        carrier.threads.push(thread("out").spawn(move || write(writing, &waiting))?);
        Ok(carrier)
    }
}

impl Carrier for UnixCarrier {
    fn send(&mut self, packet: Vec<u8>) {
        if let Some(packets) = &self.packets
            && let Err(TrySendError::Full(_)) = packets.try_send(packet)
        {
            tracing::debug!("a packet is dropped, since the other host reads too slowly");
        }
    }
}

impl Drop for UnixCarrier {
    fn drop(&mut self) {
        // The thread that writes ends once it has written what waits, unless the other end reads nothing.
        self.packets = None;
        wait_until(LINGER, || self.threads.last().is_none_or(|writer| writer.is_finished()));
        let _ = self.stream.shutdown(Shutdown::Both);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

fn write(mut stream: UnixStream, packets: &Receiver<Vec<u8>>) {
    while let Ok(packet) = packets.recv() {
        // Invariant: a packet is at most 60,000 bytes long.
        let mut bytes = (packet.len() as u32).to_le_bytes().to_vec();
        bytes.extend(packet);
        if let Err(e) = stream.write_all(&bytes) {
            tracing::debug!("the connection to another host has failed: {e}");
            let _ = stream.shutdown(Shutdown::Both);
            return;
        }
    }
}

fn read(stream: UnixStream, from: HostId, number: u64, events: &SyncSender<CarrierEvent>, root: PathBuf) {
    // A channel of iceoryx2 stays with its thread, so the bell is opened here.
    let bell = Bell::open(&root).inspect_err(|e| tracing::warn!("packets are taken late: {e}")).ok();
    let mut stream = BufReader::new(stream);
    loop {
        let read = packet(&mut stream);
        let is_over = read.is_err();
        let event = match read {
            Ok(packet) => CarrierEvent::Packet { from, number, packet },
            Err(e) => {
                tracing::debug!("the connection to {from} has ended: {e}");
                CarrierEvent::Down { from, number }
            }
        };
        match events.try_send(event) {
            Ok(()) => {}
            // The end must not be missed; packets may.
            Err(TrySendError::Full(event)) if is_over => drop(events.send(event)),
            Err(TrySendError::Full(_)) => tracing::debug!("a packet is dropped, since too many wait"),
            Err(TrySendError::Disconnected(_)) => return,
        }
        if let Some(bell) = &bell {
            bell.ring();
        }
        if is_over {
            return;
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
    fn open(root: &Path) -> Result<Bell, ChannelError> {
        let at = Rendezvous::join(root)?;
        let service = at.open_controller_bell(super::daemon::GENERATION)?;
        Ok(Bell { notifier: rendezvous::ring(&service)?, _service: service, _at: at })
    }
    fn ring(&self) {
        if let Err(e) = self.notifier.notify() {
            tracing::debug!("cannot ring the bell of this host: {e:?}");
        }
    }
}
