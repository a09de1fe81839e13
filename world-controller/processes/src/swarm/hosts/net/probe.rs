//! Diagnosis of a daemon that cannot be reached: a TLS handshake of its own, since zenoh says "timeout" whatever the
//! reason. Nothing is sent after the handshake.

use super::keys::{Keys, common_name};
use crate::swarm::hosts::address::Address;
use metamorph_protocol::ids::HostId;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use rustls::{AlertDescription, CertificateError, ClientConfig, ClientConnection, RootCertStore};
use std::io::{self, ErrorKind, Read};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// Longest time to wait for a connection, and for each step of the handshake.
const WAIT_MAX: Duration = Duration::from_secs(3);
/// Longest time that a daemon that refuses this host's certificate takes to say so.
const VERDICT_MAX: Duration = Duration::from_millis(500);

/// Fault in the connection to a daemon.
#[derive(Debug, Error)]
pub enum Fault {
    /// The name of the machine is unknown.
    #[error("its address cannot be resolved: {0}")]
    Name(io::Error),
    /// Nothing listens there, or the network does not lead there.
    #[error("no connection: {0}\n  fix: start its daemon, or open the port in firewalls")]
    Connect(io::Error),
    /// Nothing is heard in time.
    #[error(
        "nothing is heard from there for {} s\n  fix: check that the machine and its daemon run and are not stopped, and that the network leads there",
        WAIT_MAX.as_secs()
    )]
    Silent,
    /// The other end does not speak TLS.
    #[error("what listens there does not speak TLS\n  fix: check address and port")]
    Plain,
    /// Its certificate is of another authority.
    #[error("its certificate is of another authority\n  fix: copy keys of one `--make-keys` to all hosts")]
    Authority,
    /// Its certificate has expired, or is not valid yet.
    #[error("its certificate is not valid now\n  fix: make new keys, or set its clock")]
    Expired,
    /// Its certificate does not have the address.
    #[error("its certificate does not have this address\n  fix: make keys with the addresses of hosts.toml")]
    Address,
    /// Its certificate is that of another host.
    #[error(
        "its certificate is that of `{0}`\n  fix: check addresses in hosts.toml, and the daemon's --name"
    )]
    Host(String),
    /// It does not take the certificate of this host.
    #[error(
        "it refuses the certificate of this host: {0}\n  fix: copy keys of one `--make-keys` to all hosts"
    )]
    Verdict(&'static str),
    /// The keys of this host do not work.
    #[error("the keys of this host cannot be used: {0}")]
    Keys(String),
    /// Something else.
    #[error("the TLS handshake fails: {0}")]
    Other(String),
}

/// Makes a connection to a daemon, up to the end of the TLS handshake.
///
/// # Errors
/// Returns what is wrong.
pub fn probe(keys: &Keys, host: HostId, address: &Address) -> Result<(), Fault> {
    let Address::Net { machine, port } = address else { return Ok(()) };
    let targets = (machine.as_str(), *port).to_socket_addrs().map_err(Fault::Name)?;
    let nowhere = io::Error::new(ErrorKind::NotFound, "it has no address");
    let mut connected = Err(nowhere);
    for target in targets {
        connected = TcpStream::connect_timeout(&target, WAIT_MAX);
        if connected.is_ok() {
            break;
        }
    }
    let mut stream = connected.map_err(unconnected)?;
    let name = ServerName::try_from(machine.clone()).map_err(|e| Fault::Other(e.to_string()))?;
    let mut tls =
        ClientConnection::new(Arc::new(config(keys)?), name).map_err(|e| Fault::Other(e.to_string()))?;
    stream.set_read_timeout(Some(WAIT_MAX)).map_err(Fault::Connect)?;
    while tls.is_handshaking() {
        tls.complete_io(&mut stream).map_err(fault)?;
    }
    let named = tls.peer_certificates().and_then(|all| all.first()).and_then(common_name);
    if named.as_deref() != Some(&host.to_string()) {
        return Err(Fault::Host(named.unwrap_or_default()));
    }
    // With TLS 1.3 the daemon judges this host's certificate only now.
    stream.set_read_timeout(Some(VERDICT_MAX)).map_err(Fault::Connect)?;
    match rustls::Stream::new(&mut tls, &mut stream).read(&mut [0]) {
        Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => Ok(()),
        Err(e) if e.get_ref().is_some_and(|e| e.is::<rustls::Error>()) => Err(fault(e)),
        // It waits for zenoh's first message.
        _ => Ok(()),
    }
}

fn config(keys: &Keys) -> Result<ClientConfig, Fault> {
    let unusable = |e: rustls::pki_types::pem::Error| Fault::Keys(e.to_string());
    let mut roots = RootCertStore::empty();
    for root in CertificateDer::pem_file_iter(&keys.authority).map_err(unusable)? {
        roots.add(root.map_err(unusable)?).map_err(|e| Fault::Keys(e.to_string()))?;
    }
    let chain = CertificateDer::pem_file_iter(&keys.certificate).map_err(unusable)?;
    let chain = chain.collect::<Result<Vec<_>, _>>().map_err(unusable)?;
    let key = PrivateKeyDer::from_pem_file(&keys.key).map_err(unusable)?;
    // Another crate of the program may have chosen a provider for all; this handshake needs none of that.
    ClientConfig::builder_with_provider(Arc::new(rustls::crypto::ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|e| Fault::Keys(e.to_string()))?
        .with_root_certificates(roots)
        .with_client_auth_cert(chain, key)
        .map_err(|e| Fault::Keys(e.to_string()))
}

/// Returns the reason behind an error of the handshake.
fn fault(error: io::Error) -> Fault {
    let tls = error.get_ref().and_then(|e| e.downcast_ref::<rustls::Error>());
    match tls {
        Some(rustls::Error::InvalidMessage(_)) => Fault::Plain,
        Some(rustls::Error::InvalidCertificate(why)) => match why {
            CertificateError::Expired
            | CertificateError::ExpiredContext { .. }
            | CertificateError::NotValidYet
            | CertificateError::NotValidYetContext { .. } => Fault::Expired,
            CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. } => {
                Fault::Address
            }
            CertificateError::UnknownIssuer | CertificateError::BadSignature => Fault::Authority,
            why => Fault::Other(format!("{why:?}")),
        },
        Some(rustls::Error::AlertReceived(alert)) => Fault::Verdict(match alert {
            AlertDescription::UnknownCA | AlertDescription::DecryptError => "it is of another authority",
            AlertDescription::CertificateExpired => "it is not valid now",
            AlertDescription::CertificateRequired => "there is none",
            _ => "its certificate is not accepted",
        }),
        Some(other) => Fault::Other(other.to_string()),
        None if error.kind() == ErrorKind::UnexpectedEof => Fault::Plain,
        None => unconnected(error),
    }
}

/// Returns the reason behind an error of the connection below TLS.
fn unconnected(error: io::Error) -> Fault {
    match error.kind() {
        ErrorKind::WouldBlock | ErrorKind::TimedOut => Fault::Silent,
        _ => Fault::Connect(error),
    }
}
