//! The hosts file of `--hosts FILE`: where the daemons of a run are. What the hosts do in a run is in the scenario.

use super::address::Address;
use metamorph_protocol::host_link::Timing;
use metamorph_protocol::ids::HostId;
use metamorph_protocol::time::Span;
use serde::Deserialize;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The version of hosts files.
const VERSION: u64 = 1;
/// Largest size of a hosts file in bytes.
const LIMIT: u64 = 1 << 20;
/// How far the clock of another machine may be off by default.
const CLOCK_ERROR: Span = Span::millis(5);
/// The shortest time of silence: four acknowledgements.
const SHORTEST: Span = Span::secs(1);
const LOCAL: &str = "local";
const EXAMPLE: &str = "\n    version = 1\n    [[host]]\n    name = \"h1\"\n    address = \"local\"\n    [[host]]\n    name = \"h2\"\n    address = \"unix:/run/user/1000/h2.sock\"";

/// Why a hosts file is invalid.
#[derive(Debug, Error)]
pub enum HostsFileError {
    /// It cannot be read.
    #[error("{0}: {1}\n  fix: give a number of hosts, or a file like{EXAMPLE}")]
    Read(PathBuf, io::Error),
    /// It is not TOML, or has unknown or missing keys.
    #[error("{0}: {1}  fix: write a file like{EXAMPLE}")]
    Syntax(PathBuf, toml::de::Error),
    /// Its content does not fit.
    #[error("{0}: {1}\n  fix: {2}")]
    Content(PathBuf, String, &'static str),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    version: u64,
    silent: Option<String>,
    fence: Option<String>,
    keys: Option<PathBuf>,
    clock_error: Option<String>,
    placement: Option<RawPlacement>,
    host: Vec<RawHost>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPlacement {
    by: Placement,
}

/// Which modules are at home on which host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Placement {
    /// Blocks of module numbers.
    Blocks,
    /// Parts of the start with few contacts between them.
    Cut,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawHost {
    name: String,
    address: String,
}

/// The hosts of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HostsFile {
    /// The addresses of the daemons of h2, h3, ...
    pub addresses: Vec<Address>,
    /// The placement, if the file says one.
    pub placement: Option<Placement>,
    /// The directory of this host's keys.
    pub keys: Option<PathBuf>,
    /// How far the clock of another machine may be off; `None` if all hosts are on this one.
    pub clock_error: Option<Span>,
    /// The times of the links.
    pub timing: Timing,
}

impl HostsFile {
    /// Reads a hosts file.
    ///
    /// # Errors
    /// If it cannot be read or is invalid.
    pub fn read(path: &Path) -> Result<HostsFile, HostsFileError> {
        let unreadable = |e| HostsFileError::Read(path.to_owned(), e);
        let size = fs::metadata(path).map_err(unreadable)?.len();
        if size > LIMIT {
            return Err(unreadable(io::Error::other(format!("{size} bytes; {LIMIT} is the maximum"))));
        }
        HostsFile::parse(path, &fs::read_to_string(path).map_err(unreadable)?)
    }

    fn parse(path: &Path, text: &str) -> Result<HostsFile, HostsFileError> {
        let raw: Raw = toml::from_str(text).map_err(|e| HostsFileError::Syntax(path.to_owned(), e))?;
        let bad = |what: String, fix| HostsFileError::Content(path.to_owned(), what, fix);
        if raw.version != VERSION {
            let what = format!("version {}; this program reads version {VERSION}", raw.version);
            return Err(bad(what, "write `version = 1`"));
        }
        let time = |key, text: &Option<String>, least: Span, default: Span| match text
            .as_deref()
            .map(str::parse::<Span>)
        {
            None => Ok(default),
            Some(Ok(time)) if time >= least => Ok(time),
            Some(Ok(time)) => Err(bad(format!("`{key}` is {time}; {least} is the minimum"), "write more")),
            Some(Err(e)) => Err(bad(format!("`{key}`: {e}"), "write a time such as \"2s\"")),
        };
        let default = Timing::default();
        let silent = time("silent", &raw.silent, SHORTEST, default.silent)?;
        let fence = time("fence", &raw.fence, SHORTEST, default.fence)?;
        if fence < silent * 2 {
            let what = format!("`fence` is {fence} and `silent` {silent}");
            return Err(bad(what, "make `fence` at least twice as long as `silent`"));
        }
        let mut addresses = Vec::new();
        for (RawHost { name, address }, number) in raw.host.iter().zip(0u16..) {
            let expected = HostId(number).to_string();
            if *name != expected {
                let what = format!("host `{name}` is in the place of `{expected}`");
                return Err(bad(what, "call the hosts h1, h2, h3, ..., in this order"));
            }
            if (address == LOCAL) != (number == 0) {
                let what = format!("the address of {name} is `{address}`");
                return Err(bad(
                    what,
                    "write `local` for h1, where the controller is, and for no other host",
                ));
            }
            if number > 0 {
                addresses.push(address.parse::<Address>().map_err(|e| {
                    let what = format!("the address of {name} is `{address}`: {e}");
                    bad(what, "write `unix:` and the absolute path of a socket, or a machine and a port")
                })?);
            }
        }
        if addresses.is_empty() {
            return Err(bad("there is one host at most".into(), "name at least two hosts"));
        }
        if let Some(twice) = (1..addresses.len()).find(|i| addresses[..*i].contains(&addresses[*i])) {
            let what = format!("two hosts have the address {}", addresses[twice]);
            return Err(bad(what, "start a daemon for each host, each with an address of its own"));
        }
        let is_away = |address: &&Address| matches!(address, Address::Net { .. });
        let away = addresses.iter().filter(is_away).count();
        if away > 0 && away < addresses.len() {
            let what = "some hosts have sockets and others are on a network".to_owned();
            return Err(bad(what, "give all hosts addresses on the network, such as 127.0.0.1:7448"));
        }
        if away > 0 && raw.keys.is_none() {
            let what = "hosts on a network need keys".to_owned();
            return Err(bad(what, "write `keys = \"DIRECTORY\"`; `metamorph host --make-keys` makes one"));
        }
        let clock_error = time("clock_error", &raw.clock_error, Span::ZERO, CLOCK_ERROR)?;
        // The directory is named as seen from the file.
        let beside = path.parent().unwrap_or(Path::new(""));
        Ok(HostsFile {
            addresses,
            placement: raw.placement.map(|placement| placement.by),
            keys: raw.keys.map(|keys| beside.join(keys)),
            clock_error: (away > 0).then_some(clock_error),
            timing: Timing { silent, fence, ..default },
        })
    }

    /// Returns the number of hosts.
    pub fn count(&self) -> usize {
        self.addresses.len() + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<HostsFile, String> {
        HostsFile::parse(Path::new("hosts.toml"), text).map_err(|e| e.to_string())
    }

    const GOOD: &str = "version = 1\nsilent = \"1s\"\nfence = \"3s\"\n[[host]]\nname = \"h1\"\naddress = \"local\"\n[[host]]\nname = \"h2\"\naddress = \"unix:/run/h2\"\n";

    #[test]
    fn a_hosts_file_names_addresses_and_times() {
        let file = parse(GOOD).unwrap();
        assert_eq!((file.count(), &file.addresses[..]), (2, &[Address::Unix("/run/h2".into())][..]));
        assert_eq!((file.keys, file.clock_error), (None, None));
        assert_eq!((file.timing.silent, file.timing.fence), (Span::secs(1), Span::secs(3)));
    }

    #[test]
    fn each_mistake_is_named_with_its_fix() {
        let cases = [
            ("version = 1", "version = 2", "version 2"),
            ("version = 1", "version = 1\nkey = \"k\"", "unknown field `key`"),
            ("\"h2\"", "\"h3\"", "host `h3` is in the place of `h2`"),
            ("unix:/run/h2", "10.0.0.2:7447", "need keys"),
            ("unix:/run/h2", "10.0.0.2", "a machine with a port"),
            ("unix:/run/h2", "unix:h2", "absolute"),
            ("unix:/run/h2", "local", "`local` for h1"),
            ("\"local\"", "\"unix:/run/h1\"", "`local` for h1"),
            ("\"3s\"", "\"1500ms\"", "twice as long"),
            ("\"1s\"", "\"10ms\"", "is the minimum"),
            ("\"1s\"", "\"soon\"", "`silent`"),
        ];
        for (from, to, what) in cases {
            let error = parse(&GOOD.replacen(from, to, 1)).unwrap_err();
            assert!(error.contains(what) && error.contains("fix: "), "{error}");
        }
        let twice = format!("{GOOD}[[host]]\nname = \"h3\"\naddress = \"unix:/run/h2\"\n");
        let mixed = GOOD.replacen("1\n", "1\nkeys = \"k\"\n", 1)
            + "[[host]]\nname = \"h3\"\naddress = \"10.0.0.3:7447\"\n";
        assert!(parse(&mixed).unwrap_err().contains("some hosts have sockets"));
        assert!(parse(&twice).unwrap_err().contains("two hosts have the address"));
        let away = GOOD.replace("unix:/run/h2", "10.0.0.2:7447").replacen("1\n", "1\nkeys = \"k\"\n", 1);
        let away = HostsFile::parse(Path::new("/etc/mm/hosts.toml"), &away).unwrap();
        assert_eq!(away.keys, Some(PathBuf::from("/etc/mm/k")));
        assert_eq!(away.clock_error, Some(CLOCK_ERROR));
        assert!(parse("version = 1\nhost = []").unwrap_err().contains("at least two hosts"));
    }
}
