//! The sessions of one host, and the lines over them: packets to and from one other host in one run. Callbacks of zenoh
//! only append to bounded queues; what does not fit is dropped, as on any network.

use super::keys::Keys;
use super::settings::{alive, endpoint, key, settings};
use crate::swarm::hosts::address::Address;
use crate::swarm::hosts::carrier::{Arrived, Ends, INCOMING};
use metamorph_protocol::host_link::packet::KIND_AT;
use metamorph_protocol::ids::HostId;
use std::collections::BTreeMap;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use thiserror::Error;
use zenoh::Wait;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::{Sample, SampleKind};

/// Number of the run of conversations that belong to none: openings, and questions.
pub const DOOR: u64 = 0;

/// Why a session cannot be opened.
#[derive(Debug, Error)]
pub enum SessionError {
    /// The settings are refused.
    #[error("zenoh refuses its settings: {0}")]
    Settings(zenoh::Error),
    /// The session cannot be opened.
    #[error("zenoh cannot be started: {0}")]
    Open(zenoh::Error),
}

/// Queues for what arrives, by run and sender, each with its number.
type Queues = BTreeMap<(u64, HostId), (u64, SyncSender<Arrived>)>;

/// Where packets go that arrive.
#[derive(Debug, Default)]
struct Routes(Mutex<Queues>);

impl Routes {
    fn lock(&self) -> MutexGuard<'_, Queues> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a packet. The access rules have compared the sender in its key with its certificate.
    fn take(&self, sample: &Sample) {
        let key = sample.key_expr().as_str();
        let mut parts = key.split('/').skip(1);
        let run = parts.next().and_then(|run| u64::from_str_radix(run, 16).ok());
        let from = parts.next().and_then(HostId::from_name);
        let (Some(run), Some(from)) = (run, from) else {
            tracing::warn!("a packet on the key `{key}` is refused: that is no key of a host");
            return;
        };
        let routes = self.lock();
        let Some((_, route)) = routes.get(&(run, from)) else {
            tracing::debug!("a packet from {from} of run {run:016x} is dropped: it is not served here");
            return;
        };
        let packet = Arrived::Packet(sample.payload().to_bytes().into_owned());
        if let Err(TrySendError::Full(_)) = route.try_send(packet) {
            tracing::debug!("a packet from {from} is dropped, since too many wait");
        }
    }

    /// Notes that the session with a host has ended.
    fn interrupt(&self, sample: &Sample) {
        let host = sample.key_expr().as_str().rsplit('/').next().and_then(HostId::from_name);
        if sample.kind() == SampleKind::Delete {
            for ((_, from), (_, route)) in self.lock().iter().filter(|((_, from), _)| Some(*from) == host) {
                tracing::info!("the session with {from} has ended");
                // A full queue means that the host is heard.
                let _ = route.try_send(Arrived::Interruption);
            }
        }
    }
}

/// The sessions of a host: one on which it listens, and one that connects to others.
pub struct Net {
    host: HostId,
    keys: Keys,
    routes: Arc<Routes>,
    listening: Option<zenoh::Session>,
    dialling: Mutex<Option<(Vec<String>, zenoh::Session)>>,
    /// Number of lines opened.
    opened: AtomicU64,
}

impl Net {
    /// Creates the sessions of a host that listens on an address, or on none.
    ///
    /// # Errors
    /// If the address is in use, or keys do not fit together.
    pub fn new(keys: Keys, listen: Option<&Address>) -> Result<Net, SessionError> {
        let routes = Arc::<Routes>::default();
        let listen: Vec<String> = listen.and_then(endpoint).into_iter().collect();
        let listening = (!listen.is_empty()).then(|| open(&keys, &listen, &[], &routes)).transpose()?;
        Ok(Net {
            host: keys.host,
            keys,
            routes,
            listening,
            dialling: Mutex::new(None),
            opened: AtomicU64::new(0),
        })
    }

    /// Returns this host.
    pub fn host(&self) -> HostId {
        self.host
    }
    /// Returns the keys of this host.
    pub fn keys(&self) -> &Keys {
        &self.keys
    }

    /// Connects to hosts, in place of those before. Returns without waiting for them.
    ///
    /// # Errors
    /// If keys do not fit together.
    pub fn dial(&self, addresses: &[Address]) -> Result<(), SessionError> {
        let endpoints: Vec<String> = addresses.iter().filter_map(endpoint).collect();
        let mut dialling = self.dialling.lock().unwrap_or_else(PoisonError::into_inner);
        if dialling.as_ref().is_none_or(|(before, _)| *before != endpoints) {
            *dialling = None;
            if !endpoints.is_empty() {
                let session = open(&self.keys, &[], &endpoints, &self.routes)?;
                *dialling = Some((endpoints, session));
            }
        }
        Ok(())
    }

    /// Opens the line to another host in a run, in place of the one before. A host is dialled by those with a lower
    /// number.
    ///
    /// # Errors
    /// If there is no session for it.
    pub fn line(&self, run: u64, to: HostId) -> io::Result<Line> {
        let dialling = self.dialling.lock().unwrap_or_else(PoisonError::into_inner);
        let session = match to > self.host {
            true => dialling.as_ref().map(|(_, session)| session),
            false => self.listening.as_ref(),
        };
        let missing =
            || io::Error::new(io::ErrorKind::NotConnected, format!("there is no session with {to}"));
        let session = session.ok_or_else(missing)?;
        let (sender, incoming) = sync_channel(INCOMING);
        let name = format!("{run:016x}");
        let publisher = |service: &str, priority, express| {
            session
                .declare_publisher(key(&name, &self.host.to_string(), &to.to_string(), service))
                .congestion_control(CongestionControl::Drop)
                .priority(priority)
                .express(express)
                .wait()
                .map_err(|e| io::Error::other(e.to_string()))
        };
        let publishers = [
            publisher("a", Priority::InteractiveHigh, true)?,
            publisher("p", Priority::Data, false)?,
            publisher("s", Priority::DataHigh, false)?,
            publisher("b", Priority::Background, false)?,
        ];
        let number = self.opened.fetch_add(1, Ordering::Relaxed);
        self.routes.lock().insert((run, to), (number, sender));
        let route = Route { run, to, number, routes: Arc::clone(&self.routes) };
        Ok(Line { route, publishers, incoming })
    }
}

fn open(
    keys: &Keys,
    listen: &[String],
    connect: &[String],
    routes: &Arc<Routes>,
) -> Result<zenoh::Session, SessionError> {
    let text = settings(keys, listen, connect).to_string();
    let config = zenoh::Config::from_json5(&text).map_err(SessionError::Settings)?;
    let session = zenoh::open(config).wait().map_err(SessionError::Open)?;
    let own = keys.host.to_string();
    let (packets, tokens) = (Arc::clone(routes), Arc::clone(routes));
    let subscriber = session.declare_subscriber(key("*", "*", &own, "*"));
    let subscriber = subscriber.callback(move |sample| packets.take(&sample));
    subscriber.background().wait().map_err(SessionError::Open)?;
    let watch = session.liveliness().declare_subscriber(alive("*"));
    let watch = watch.callback(move |sample| tokens.interrupt(&sample));
    watch.background().wait().map_err(SessionError::Open)?;
    let token = session.liveliness().declare_token(alive(&own)).wait().map_err(SessionError::Open)?;
    // It goes with the session.
    std::mem::forget(token);
    Ok(session)
}

/// The place of a line among the queues. Dropping it removes its queue, unless another line has replaced it.
struct Route {
    run: u64,
    to: HostId,
    number: u64,
    routes: Arc<Routes>,
}

impl Route {
    fn close(&self) {
        let mut routes = self.routes.lock();
        if routes.get(&(self.run, self.to)).is_some_and(|(number, _)| *number == self.number) {
            routes.remove(&(self.run, self.to));
        }
    }
}

impl Drop for Route {
    fn drop(&mut self) {
        self.close();
    }
}

/// Packets to and from one other host in one run. Dropping it ends it.
pub struct Line {
    route: Route,
    publishers: [Publisher<'static>; 4],
    incoming: Receiver<Arrived>,
}

impl Line {
    /// Puts a packet: what it is decides how urgent it is. The network may lose it.
    ///
    /// # Errors
    /// If the session has ended.
    pub fn put(&self, packet: Vec<u8>) -> io::Result<()> {
        put(&self.publishers, packet)
    }

    /// Returns what arrives next, or nothing if nothing does for so long.
    pub fn receive(&self, patience: Duration) -> Option<Arrived> {
        self.incoming.recv_timeout(patience).ok()
    }

    /// Returns the two directions, each for a thread.
    pub fn into_ends(self) -> Ends {
        let Line { route, publishers, incoming } = self;
        let ended = || io::Error::new(io::ErrorKind::UnexpectedEof, "the line was closed");
        Ends {
            receive: Box::new(move || incoming.recv().map_err(|_| ended())),
            send: Box::new(move |packet| put(&publishers, packet)),
            stop: Arc::new(move || route.close()),
        }
    }
}

fn put([urgent, frames, stream, bulk]: &[Publisher<'static>; 4], packet: Vec<u8>) -> io::Result<()> {
    let publisher = match packet.get(KIND_AT) {
        Some(4) => frames,
        Some(5) => stream,
        // A goodbye does not overtake what was said before.
        Some(6 | 8) => bulk,
        _ => urgent,
    };
    publisher.put(packet).wait().map_err(|e| io::Error::other(e.to_string()))
}
