//! The way from the controller's host to the daemons of others: an opening is said to one, and its answer returned with
//! what the conversation has shown. Used to begin runs, to check hosts and to clean them.

use super::address::Address;
use super::connection::Connection;
use super::messages::{Answer, Opening, read_opening, write_opening};
#[cfg(feature = "hosts")]
use super::net;
use metamorph_protocol::ids::HostId;
use metamorph_protocol::time::Span;
use std::io;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
#[cfg(feature = "hosts")]
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// Longest time to wait for an answer.
const ANSWER_WAIT_MAX: Duration = Duration::from_secs(30);
/// Longest time to wait for a daemon on a network to be heard, when nothing is urgent.
pub const MEETING: Duration = Duration::from_secs(10);

/// Why a daemon is not reached.
#[derive(Debug, Error)]
pub enum ReachError {
    /// The socket of a daemon on this machine does not work.
    #[error("{0} cannot be reached at {1}: {2}\n  fix: start `metamorph host --listen {path}` there", path = .1.display())]
    Socket(HostId, PathBuf, io::Error),
    /// This program has no links between machines.
    #[error(
        "{0} is on another machine ({1}), and this program is built without links between machines\n  fix: build it with `cargo build --release --features hosts`"
    )]
    NotBuilt(HostId, Address),
    /// The keys cannot be used.
    #[cfg(feature = "hosts")]
    #[error(transparent)]
    Keys(#[from] net::KeysError),
    /// There are no keys.
    #[cfg(feature = "hosts")]
    #[error(
        "hosts on other machines need keys\n  fix: write `keys = \"DIRECTORY\"` in the hosts file; `metamorph host --make-keys` makes one"
    )]
    NoKeys,
    /// The session cannot be opened.
    #[cfg(feature = "hosts")]
    #[error(transparent)]
    Session(#[from] net::SessionError),
    /// A connection to a daemon cannot be made.
    #[cfg(feature = "hosts")]
    #[error("{0} cannot be reached at {1}: {2}")]
    Fault(HostId, Address, net::Fault),
    /// The connection is made, but the daemon says nothing, or the wrong thing.
    #[cfg(feature = "hosts")]
    #[error("{0} at {1} does not take part: {2}\n  fix: {fix}", fix = fix(.2))]
    Visit(HostId, Address, net::VisitError),
}

#[cfg(feature = "hosts")]
fn fix(error: &net::VisitError) -> &'static str {
    use metamorph_protocol::host_link::Refused;
    match error {
        net::VisitError::Refused(Refused::Proof) => "copy the file `token` of one `--make-keys` to all hosts",
        net::VisitError::Refused(Refused::Terms(_)) => "run the same program on all hosts",
        _ => "look at its log; its --name has to be that of the hosts file",
    }
}

/// Result of contacting a daemon.
pub struct Reached {
    /// Its answer.
    pub answer: Answer,
    /// The connection, if it stays; on a network it is opened by the run.
    pub stream: Option<UnixStream>,
    /// How far its clock may be off the one of this host after correction; `None` if it is the same clock.
    pub clock_error: Option<Span>,
}

/// The way to daemons.
pub struct Reach {
    build: u64,
    #[cfg(feature = "hosts")]
    net: Option<Arc<net::Net>>,
}

impl Reach {
    /// Opens the way to daemons at these addresses, of h2, h3, ...
    ///
    /// # Errors
    /// If keys are missing, or the program has no links between machines.
    pub fn new(addresses: &[Address], keys: Option<&Path>, build: u64) -> Result<Reach, ReachError> {
        let away = (1u16..).map(HostId).zip(addresses).find(|(_, a)| matches!(a, Address::Net { .. }));
        let Some((host, address)) = away else {
            return Ok(Reach {
                build,
                #[cfg(feature = "hosts")]
                net: None,
            });
        };
        #[cfg(feature = "hosts")]
        {
            let _ = (host, address);
            let keys = net::Keys::read(keys.ok_or(ReachError::NoKeys)?, HostId::CONTROLLER)?;
            let net = net::Net::new(keys, None)?;
            net.dial(addresses)?;
            Ok(Reach { build, net: Some(Arc::new(net)) })
        }
        #[cfg(not(feature = "hosts"))]
        {
            let _ = keys;
            Err(ReachError::NotBuilt(host, address.clone()))
        }
    }

    /// Says an opening to a daemon. `measure` is how long clock stamps are exchanged afterwards. On a network the daemon has to
    /// be heard within `meeting`.
    ///
    /// # Errors
    /// If there is no answer.
    pub fn ask(
        &self,
        host: HostId,
        address: &Address,
        opening: &Opening,
        measure: Duration,
        meeting: Duration,
    ) -> Result<Reached, ReachError> {
        match address {
            Address::Unix(path) => {
                let stream = UnixStream::connect(path);
                let failed = |e| ReachError::Socket(host, path.clone(), e);
                Reach::ask_on(stream.map_err(failed)?, opening).map_err(failed)
            }
            #[cfg(not(feature = "hosts"))]
            Address::Net { .. } => {
                let _ = (self.build, measure, meeting);
                Err(ReachError::NotBuilt(host, address.clone()))
            }
            #[cfg(feature = "hosts")]
            Address::Net { .. } => self.visit(host, address, opening, measure, meeting),
        }
    }

    /// Says an opening on a socket.
    ///
    /// # Errors
    /// If the connection fails.
    pub fn ask_on(mut stream: UnixStream, opening: &Opening) -> io::Result<Reached> {
        stream.set_read_timeout(Some(ANSWER_WAIT_MAX))?;
        write_opening(&mut stream, opening)?;
        let answer = read_opening(&mut stream)?;
        Ok(Reached { answer, stream: Some(stream), clock_error: None })
    }

    #[cfg(feature = "hosts")]
    fn visit(
        &self,
        host: HostId,
        address: &Address,
        opening: &Opening,
        measure: Duration,
        meeting: Duration,
    ) -> Result<Reached, ReachError> {
        let net = self.net.as_ref().ok_or(ReachError::NoKeys)?;
        // First, since it names the reason; zenoh would keep trying.
        net::probe(net.keys(), host, address).map_err(|e| ReachError::Fault(host, address.clone(), e))?;
        let failed = |e| ReachError::Visit(host, address.clone(), e);
        let mut visit = net::Visit::begin(net, host, self.build, meeting).map_err(failed)?;
        let answer = visit.ask(opening, ANSWER_WAIT_MAX).map_err(failed)?;
        let clock = visit.clock(measure).map_err(failed)?;
        let clock_error = clock.map(|clock| Span(clock.error()));
        Ok(Reached { answer, stream: None, clock_error })
    }

    /// Returns the connection of a run to a daemon, after it has said that it is ready.
    ///
    /// # Errors
    /// If there is no session with it.
    pub fn connection(&self, run: u64, host: HostId, stream: Option<UnixStream>) -> io::Result<Connection> {
        match stream {
            Some(stream) => Ok(Connection::Unix(stream)),
            #[cfg(feature = "hosts")]
            None if self.net.is_some() => {
                let line = self.net.as_ref().map(|net| net.line(run, host)).transpose()?;
                let line = line.ok_or_else(|| io::Error::from(io::ErrorKind::NotConnected))?;
                Ok(Connection::Net(Box::new(line)))
            }
            None => {
                let what = format!("there is no way to {host} for run {run:016x}");
                Err(io::Error::new(io::ErrorKind::NotConnected, what))
            }
        }
    }
}

impl std::fmt::Debug for Reach {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Reach").field("build", &self.build).finish_non_exhaustive()
    }
}
