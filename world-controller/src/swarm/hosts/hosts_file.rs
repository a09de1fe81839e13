//! The hosts file of `--hosts FILE`: where the daemons of a run are. What the hosts do in a run is in the scenario.

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
/// The longest path of a socket in bytes.
const PATH_LIMIT: usize = 107;
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
    host: Vec<RawHost>,
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
    /// The sockets of the daemons of h2, h3, ...
    pub sockets: Vec<PathBuf>,
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
        let time = |key, text: &Option<String>, default: Span| match text.as_deref().map(str::parse::<Span>) {
            None => Ok(default),
            Some(Ok(time)) if time >= SHORTEST => Ok(time),
            Some(Ok(time)) => Err(bad(format!("`{key}` is {time}; {SHORTEST} is the minimum"), "write more")),
            Some(Err(e)) => Err(bad(format!("`{key}`: {e}"), "write a time such as \"2s\"")),
        };
        let default = Timing::default();
        let silent = time("silent", &raw.silent, default.silent)?;
        let fence = time("fence", &raw.fence, default.fence)?;
        if fence < silent * 2 {
            let what = format!("`fence` is {fence} and `silent` {silent}");
            return Err(bad(what, "make `fence` at least twice as long as `silent`"));
        }
        let mut sockets = Vec::new();
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
                sockets.push(socket(address).ok_or_else(|| {
                    let what = format!("the address of {name} is `{address}`");
                    bad(
                        what,
                        "write `unix:` and the absolute path of a socket, of at most 107 bytes; other machines cannot be reached yet",
                    )
                })?);
            }
        }
        if sockets.is_empty() {
            return Err(bad("there is one host at most".into(), "name at least two hosts"));
        }
        if let Some(twice) = (1..sockets.len()).find(|i| sockets[..*i].contains(&sockets[*i])) {
            let what = format!("two hosts have the address {}", sockets[twice].display());
            return Err(bad(what, "start a daemon for each host, each with a socket of its own"));
        }
        Ok(HostsFile { sockets, timing: Timing { silent, fence, ..default } })
    }

    /// Returns the number of hosts.
    pub fn count(&self) -> usize {
        self.sockets.len() + 1
    }
}

fn socket(address: &str) -> Option<PathBuf> {
    let path = Path::new(address.strip_prefix("unix:")?);
    (path.is_absolute() && path.as_os_str().len() <= PATH_LIMIT).then(|| path.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<HostsFile, String> {
        HostsFile::parse(Path::new("hosts.toml"), text).map_err(|e| e.to_string())
    }

    const GOOD: &str = "version = 1\nsilent = \"1s\"\nfence = \"3s\"\n[[host]]\nname = \"h1\"\naddress = \"local\"\n[[host]]\nname = \"h2\"\naddress = \"unix:/run/h2\"\n";

    #[test]
    fn a_hosts_file_names_sockets_and_times() {
        let file = parse(GOOD).unwrap();
        assert_eq!((file.count(), file.sockets), (2, vec![PathBuf::from("/run/h2")]));
        assert_eq!((file.timing.silent, file.timing.fence), (Span::secs(1), Span::secs(3)));
    }

    #[test]
    fn each_mistake_is_named_with_its_fix() {
        let cases = [
            ("version = 1", "version = 2", "version 2"),
            ("version = 1", "version = 1\nkeys = \"k\"", "unknown field `keys`"),
            ("\"h2\"", "\"h3\"", "host `h3` is in the place of `h2`"),
            ("unix:/run/h2", "10.0.0.2:7447", "other machines cannot be reached yet"),
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
        assert!(parse(&twice).unwrap_err().contains("two hosts have the address"));
        assert!(parse("version = 1\nhost = []").unwrap_err().contains("at least two hosts"));
    }
}
