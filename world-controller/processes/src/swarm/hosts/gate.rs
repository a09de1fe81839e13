//! The gate through which a daemon is reached: it listens on a Unix socket, or on a network with mutual TLS, and hands
//! on connections whose opening has arrived. Not here: the answers to openings.

use super::address::Address;
use super::connection::{Connection, Incoming, Visitor};
use super::daemon::{DaemonError, DaemonOptions};
use super::messages::read_opening;
#[cfg(feature = "hosts")]
use super::net;
use metamorph_protocol::ids::HostId;
use std::io;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
#[cfg(feature = "hosts")]
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

/// Longest time that a new connection may take to send its opening.
const OPENING_MAX: Duration = Duration::from_secs(30);
/// Largest number of openings that wait.
const WAITING_MAX: usize = 16;

/// Where a daemon is reached.
pub struct Gate {
    /// Who has said what it wants.
    pub incoming: Receiver<Incoming>,
    _socket: Option<Socket>,
    #[cfg(feature = "hosts")]
    net: Option<Arc<net::Net>>,
}

impl Gate {
    /// Begins to listen.
    ///
    /// # Errors
    /// If the address cannot be used, or keys are missing.
    pub fn open(options: &DaemonOptions) -> Result<Gate, DaemonError> {
        let (sender, incoming) = sync_channel(WAITING_MAX);
        match &options.address {
            Address::Unix(path) => {
                let listener = bind(path).map_err(|e| DaemonError::Listen(path.clone(), e))?;
                let socket = Some(Socket(path.clone()));
                let thread = std::thread::Builder::new().name("connections".into());
                thread.spawn(move || accept(&listener, &sender)).map_err(DaemonError::Thread)?;
                Ok(Gate {
                    incoming,
                    _socket: socket,
                    #[cfg(feature = "hosts")]
                    net: None,
                })
            }
            #[cfg(feature = "hosts")]
            Address::Net { .. } => {
                let (host, keys) = options.identity.as_ref().ok_or(DaemonError::NoIdentity)?;
                let keys = net::Keys::read(keys, *host).map_err(DaemonError::Keys)?;
                let net = net::Net::new(keys, Some(&options.address)).map_err(DaemonError::Session)?;
                let net = Arc::new(net);
                let (door, build, room) = (Arc::clone(&net), options.build, options.most);
                let (knocks, knocking) = sync_channel::<net::Knock>(WAITING_MAX);
                let serve = move || {
                    if let Err(e) = net::serve(&door, build, room, &knocks) {
                        tracing::error!("nothing more is taken from the network: {e}");
                    }
                };
                let hand_on = move || {
                    while let Ok((opening, reply)) = knocking.recv() {
                        if sender.send((opening, Visitor::Net(reply))).is_err() {
                            return;
                        }
                    }
                };
                let thread = |name: &str| std::thread::Builder::new().name(name.into());
                thread("door").spawn(serve).map_err(DaemonError::Thread)?;
                thread("openings").spawn(hand_on).map_err(DaemonError::Thread)?;
                Ok(Gate { incoming, _socket: None, net: Some(net) })
            }
            #[cfg(not(feature = "hosts"))]
            Address::Net { .. } => Err(DaemonError::NotBuilt),
        }
    }

    /// Prepares the way to other hosts of a run. Sockets need nothing.
    ///
    /// # Errors
    /// If there can be no session with them.
    pub fn prepare(&self, own: HostId, addresses: &[Address]) -> io::Result<()> {
        #[cfg(feature = "hosts")]
        if let Some(net) = &self.net {
            let above = addresses.get(own.index()..).unwrap_or_default();
            return net.dial(above).map_err(|e| io::Error::other(e.to_string()));
        }
        let _ = (own, addresses);
        Ok(())
    }

    /// Returns the connection with another host of a run, if it can be had without dialling it.
    ///
    /// # Errors
    /// If there is no session with it.
    pub fn line(&self, run: u64, host: HostId) -> io::Result<Option<Connection>> {
        #[cfg(feature = "hosts")]
        if let Some(net) = &self.net {
            return Ok(Some(Connection::Net(Box::new(net.line(run, host)?))));
        }
        let _ = (run, host);
        Ok(None)
    }
}

/// Creates the socket, in place of one that a killed daemon has left.
fn bind(path: &Path) -> io::Result<UnixListener> {
    UnixListener::bind(path).or_else(|e| {
        let refused = |e: io::Error| e.kind() == io::ErrorKind::ConnectionRefused;
        if e.kind() != io::ErrorKind::AddrInUse || !UnixStream::connect(path).is_err_and(refused) {
            return Err(e);
        }
        std::fs::remove_file(path)?;
        UnixListener::bind(path)
    })
}

/// The file of the socket, which goes with the daemon.
struct Socket(PathBuf);

impl Drop for Socket {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Accepts connections. Each may take its time without holding up the others.
fn accept(listener: &UnixListener, sender: &SyncSender<Incoming>) {
    for stream in listener.incoming() {
        let sender = sender.clone();
        let open = move |mut stream: UnixStream| -> io::Result<()> {
            stream.set_read_timeout(Some(OPENING_MAX))?;
            let opening = read_opening(&mut stream)?;
            // Fails only at the daemon's end.
            let _ = sender.send((opening, Visitor::Unix(stream)));
            Ok(())
        };
        let opened = stream.and_then(|stream| {
            let thread = std::thread::Builder::new().name("opening".into());
            thread.spawn(move || {
                if let Err(e) = open(stream) {
                    tracing::warn!("a connection is refused: {e}");
                }
            })
        });
        if let Err(e) = opened {
            tracing::warn!("a connection cannot be accepted: {e}");
        }
    }
}
