//! The address of a host's daemon: a socket on this machine, or a machine and port on a network. Not here: how a
//! connection is made.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use thiserror::Error;

/// The longest path of a socket in bytes.
const PATH_LIMIT: usize = 107;
/// The longest name of a machine in bytes, as in the domain name system.
const NAME_LIMIT: usize = 253;

/// Where a daemon listens.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Address {
    /// A Unix socket on this machine.
    Unix(PathBuf),
    /// A machine, by address or name, and a port: reached with mutual TLS only.
    Net {
        /// The address or name, as certificates have it.
        machine: String,
        /// The port.
        port: u16,
    },
}

/// Why a text is no address.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum AddressError {
    /// The path of a socket is not usable.
    #[error("the path of a socket is absolute and at most {PATH_LIMIT} bytes long")]
    Path,
    /// Neither a socket nor a machine with a port.
    #[error("an address is `unix:/PATH`, or a machine with a port such as `10.0.0.2:7447`")]
    Form,
}

impl Address {
    /// Returns the address of a socket.
    ///
    /// # Errors
    /// If its path is relative or too long.
    pub fn unix(path: &Path) -> Result<Address, AddressError> {
        let fits = path.is_absolute() && path.as_os_str().len() <= PATH_LIMIT;
        if fits { Ok(Address::Unix(path.to_owned())) } else { Err(AddressError::Path) }
    }
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Address, AddressError> {
        if let Some(path) = text.strip_prefix("unix:") {
            return Address::unix(Path::new(path));
        }
        let (machine, port) = text.rsplit_once(':').ok_or(AddressError::Form)?;
        let port = port.parse().ok().filter(|port| *port > 0).ok_or(AddressError::Form)?;
        let machine = machine.strip_prefix('[').and_then(|m| m.strip_suffix(']')).unwrap_or(machine);
        let fits = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | ':' | '_');
        let is_name = !machine.is_empty() && machine.len() <= NAME_LIMIT && machine.chars().all(fits);
        let is_address = machine.parse::<std::net::IpAddr>().is_ok();
        if !is_name || (machine.contains(':') && !is_address) {
            return Err(AddressError::Form);
        }
        Ok(Address::Net { machine: machine.to_owned(), port })
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Address::Unix(path) => write!(f, "unix:{}", path.display()),
            Address::Net { machine, port } if machine.contains(':') => write!(f, "[{machine}]:{port}"),
            Address::Net { machine, port } => write!(f, "{machine}:{port}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_as_they_are_written() {
        for text in ["unix:/run/h2.sock", "10.0.0.2:7447", "[::1]:7447", "rack-3.lab:80"] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), text);
        }
        let wrong =
            ["", "h2", "unix:h2", "10.0.0.2", "10.0.0.2:0", "10.0.0.2:70000", ":7447", "a b:1", "a:b:1"];
        for text in wrong {
            assert!(text.parse::<Address>().is_err(), "{text}");
        }
    }
}
