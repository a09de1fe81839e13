//! The hosts file of `--hosts FILE`: where the daemons of a run are. What the hosts do in a run is in the scenario.

use super::address::Address;
use metamorph_console::files::Files;
use metamorph_protocol::host_link::Timing;
use metamorph_protocol::ids::HostId;
use metamorph_protocol::time::Span;
use metamorph_text::sources::Sources;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The version of hosts files.
pub const VERSION: u64 = 1;
/// Largest size of a hosts file in bytes.
const LIMIT: u64 = 1 << 20;
/// Default time by which the clock of another machine may be off.
const CLOCK_ERROR: Span = Span::millis(5);
/// Time for which zenoh's thread waits in the `close` of a connection whose other end is silent: links between machines are built
/// with it (`TLS_LINGER_TIMEOUT`). Meanwhile no other host is heard.
const CLOSING: Span = Span::secs(1);
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
    by: Option<Placement>,
    modules: Option<BTreeMap<String, String>>,
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
    ssh: Option<String>,
}

/// The hosts of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HostsFile {
    /// The addresses of the daemons of h2, h3, ...
    pub addresses: Vec<Address>,
    /// The machines of h2, h3, ... as `ssh` knows them, where the file says so.
    pub ssh: Vec<Option<String>>,
    /// The placement, if the file says one.
    pub placement: Option<Placement>,
    /// The number of modules of each host, if the file says which ones they have.
    pub sizes: Option<Vec<u64>>,
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
        let bytes = Files.read_argument(path, LIMIT).map_err(unreadable)?;
        let text = String::from_utf8(bytes).map_err(|error| unreadable(io::Error::other(error)))?;
        HostsFile::parse(path, &text)
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
        let mut addresses: Vec<Address> = Vec::new();
        for (RawHost { name, address, .. }, number) in raw.host.iter().zip(0u16..) {
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
        // All hosts but two may fall silent at once, and the last one must not count as dead meanwhile.
        let least = silent * 2 + CLOSING * (addresses.len() as u64 - 1);
        if away > 0 && fence < least {
            let what = format!(
                "`fence` is {fence}, and {} hosts that fall silent keep the others from being heard for up to {CLOSING} each",
                addresses.len() - 1
            );
            return Err(bad(
                what,
                "make `fence` at least twice as long as `silent`, and 1 s longer for each host but two",
            ));
        }
        if away > 0 && raw.keys.is_none() {
            let what = "hosts on a network need keys".to_owned();
            return Err(bad(what, "write `keys = \"DIRECTORY\"`; `metamorph host --make-keys` makes one"));
        }
        let names = raw.host.iter().map(|host| host.name.as_str());
        let (placement, sizes) = placement(raw.placement, names).map_err(|(what, fix)| bad(what, fix))?;
        let clock_error = time("clock_error", &raw.clock_error, Span::ZERO, CLOCK_ERROR)?;
        // The directory is named as seen from the file.
        let beside = path.parent().unwrap_or(Path::new(""));
        Ok(HostsFile {
            addresses,
            ssh: raw.host.into_iter().skip(1).map(|host| host.ssh).collect(),
            placement,
            sizes,
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

/// Returns the placement, and the numbers of modules of hosts if that is given; or what is wrong, and what to do about it.
#[allow(clippy::type_complexity, reason = "read in one place")]
fn placement<'h>(
    raw: Option<RawPlacement>,
    hosts: impl Iterator<Item = &'h str>,
) -> Result<(Option<Placement>, Option<Vec<u64>>), (String, &'static str)> {
    const RANGES: &str = "write a range for each host, such as { h1 = \"0..1999\", h2 = \"2000..5999\" }";
    match raw {
        None => Ok((None, None)),
        Some(RawPlacement { by: by @ Some(_), modules: None }) => Ok((by, None)),
        Some(RawPlacement { by: None, modules: Some(modules) }) => {
            let sizes = sizes(hosts, &modules).map_err(|what| (what, RANGES))?;
            Ok((Some(Placement::Blocks), Some(sizes)))
        }
        Some(_) => Err(("`[placement]` has not one key".into(), "write either `by` or `modules`")),
    }
}

/// Returns the numbers of modules of hosts that have these ranges of modules, both ends included.
fn sizes<'h>(
    hosts: impl Iterator<Item = &'h str>,
    modules: &BTreeMap<String, String>,
) -> Result<Vec<u64>, String> {
    let (mut next, mut sizes) = (0_u64, Vec::new());
    for host in hosts {
        let text = modules.get(host).ok_or_else(|| format!("`modules` says nothing of {host}"))?;
        let ends =
            text.split_once("..").and_then(|(a, b)| Some((a.parse::<u64>().ok()?, b.parse::<u64>().ok()?)));
        let (first, last) = ends.filter(|(first, last)| first <= last).ok_or_else(|| {
            format!("the modules of {host} are `{text}`, which is no range with a first and a last number")
        })?;
        if first != next {
            return Err(format!("the modules of {host} begin with {first} instead of {next}"));
        }
        next = last.saturating_add(1);
        sizes.push(next - first);
    }
    match modules.keys().find(|name| {
        modules.len() > sizes.len() && HostId::from_name(name).is_none_or(|id| id.index() >= sizes.len())
    }) {
        Some(name) => Err(format!("`modules` names {name}, which is none of the hosts")),
        None => Ok(sizes),
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
    fn modules_are_placed_by_ranges() {
        let with = |modules: &str| {
            parse(&GOOD.replacen("[[host]]", &format!("[placement]\n{modules}\n[[host]]"), 1))
        };
        let file = with("modules = { h1 = \"0..9\", h2 = \"10..41\" }").unwrap();
        assert_eq!((file.placement, file.sizes), (Some(Placement::Blocks), Some(vec![10, 32])));
        assert_eq!(with("by = \"cut\"").unwrap().placement, Some(Placement::Cut));
        let cases = [
            ("by = \"cut\"\nmodules = {}", "has not one key"),
            ("", "has not one key"),
            ("modules = { h1 = \"0..9\" }", "says nothing of h2"),
            ("modules = { h1 = \"0..9\", h2 = \"11..41\" }", "begin with 11 instead of 10"),
            ("modules = { h1 = \"9..0\", h2 = \"10..41\" }", "no range"),
            ("modules = { h1 = \"0-9\", h2 = \"10..41\" }", "no range"),
            ("modules = { h1 = \"0..9\", h2 = \"10..41\", h3 = \"42..43\" }", "names h3"),
        ];
        for (modules, what) in cases {
            let error = with(modules).unwrap_err();
            assert!(error.contains(what) && error.contains("fix: "), "{error}");
        }
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
