//! A look at the daemons of a hosts file without a run: whether each is reached, what it offers, how well its clock is
//! known; and the removal of what killed runs have left there.

use super::address::Address;
use super::hosts_file::HostsFile;
use super::messages::{Answer, HostStatus, Opening};
use super::reach::{MEETING, Reach, ReachError};
use crate::swarm::links::all_open;
use metamorph_protocol::ids::HostId;
use metamorph_protocol::time::Span;
use std::path::Path;
use std::time::Duration;

/// Time for which clock stamps are exchanged with each host.
const MEASURING: Duration = Duration::from_millis(600);

/// The daemons of a hosts file.
pub struct Survey<'a> {
    file: &'a HostsFile,
    reach: Reach,
    build: u64,
}

impl<'a> Survey<'a> {
    /// Opens the way to the daemons.
    ///
    /// # Errors
    /// If keys are missing, or the program has no links between machines.
    pub fn new(file: &'a HostsFile, build: u64) -> Result<Survey<'a>, ReachError> {
        let reach = Reach::new(&file.addresses, file.keys.as_deref(), build)?;
        Ok(Survey { file, reach, build })
    }

    fn hosts(&self) -> impl Iterator<Item = (HostId, &Address)> {
        (1u16..).map(HostId).zip(&self.file.addresses)
    }

    /// Asks each host what it is and does. `modules` has the number of modules of each, from h1 on. Returns a line for each
    /// host, and whether all of them can take part.
    pub fn check(&self, modules: &[usize]) -> (Vec<String>, bool) {
        let mut all = true;
        let lines = self.hosts().map(|(host, address)| {
            let wanted = modules.get(host.index()).copied().unwrap_or(0);
            let found = self.reach.ask(host, address, &Opening::Status, MEASURING, MEETING);
            let (text, is_fit) = match found {
                Err(e) => (e.to_string(), false),
                Ok(reached) => match reached.answer {
                    Answer::Status(status) => {
                        let problem = self.problem(&status, wanted, reached.clock_error);
                        let text = describe(&status, reached.clock_error);
                        match problem {
                            None => (format!("{host} at {address}: {text}"), true),
                            Some(problem) => (format!("{host} at {address}: {text}\n  {problem}"), false),
                        }
                    }
                    _ => (format!("{host} at {address}: it answers something else"), false),
                },
            };
            all &= is_fit;
            text
        });
        (lines.collect(), all)
    }

    /// Returns why a host cannot take part.
    fn problem(&self, status: &HostStatus, wanted: usize, clock_error: Option<Span>) -> Option<String> {
        let bound = self.file.clock_error;
        if status.build != self.build {
            return Some(
                "it runs another build of the program\n  fix: run the same program on all hosts".into(),
            );
        }
        if let Some((run, _)) = status.serves {
            return Some(format!(
                "it serves run {run:016x}\n  fix: wait for its end, or start a further daemon"
            ));
        }
        if wanted > status.most as usize {
            return Some(format!(
                "{wanted} modules are at home there, and it has room for {}\n  fix: start it with `--most {wanted}` where {} files may be open (ulimit -Hn, or LimitNOFILE of the service), or divide the swarm otherwise",
                status.most,
                all_open(wanted as u64)
            ));
        }
        match (clock_error, bound) {
            (Some(error), Some(bound)) if error > bound => Some(format!(
                "its clock is known to {error} only, and `clock_error` is {bound}\n  fix: write a larger `clock_error`, and lower `time_scale` if the scenario is then refused"
            )),
            _ => None,
        }
    }

    /// Has each host remove what killed runs have left there. Returns a line for each, and whether all have answered.
    pub fn clean(&self) -> (Vec<String>, bool) {
        let mut all = true;
        let lines = self.hosts().map(|(host, address)| {
            match self
                .reach
                .ask(host, address, &Opening::Clean, Duration::ZERO, MEETING)
                .map(|reached| reached.answer)
            {
                Ok(Answer::Cleaned(done)) => format!("{host}: {done}"),
                Ok(_) => {
                    all = false;
                    format!("{host}: it answers something else")
                }
                Err(e) => {
                    all = false;
                    e.to_string()
                }
            }
        });
        (lines.collect(), all)
    }
}

/// Describes one daemon.
///
/// # Errors
/// If it is not reached.
pub fn status(
    host: HostId,
    address: &Address,
    keys: Option<&Path>,
    build: u64,
) -> Result<String, ReachError> {
    let before = (1..host.0).map(|_| address.clone());
    let addresses: Vec<Address> = before.chain([address.clone()]).collect();
    let reach = Reach::new(&addresses, keys, build)?;
    let reached = reach.ask(host, address, &Opening::Status, Duration::ZERO, MEETING)?;
    Ok(match reached.answer {
        Answer::Status(status) => describe(&status, None),
        _ => "it answers something else".to_owned(),
    })
}

fn describe(status: &HostStatus, clock_error: Option<Span>) -> String {
    let HostStatus { version, most, serves, leftovers, .. } = status;
    let doing = match serves {
        Some((run, modules)) => {
            format!("serves {modules} modules of run {run:016x}, room for {}", most.saturating_sub(*modules))
        }
        None => format!("serves no run, room for {most} modules"),
    };
    let clock = clock_error.map(|error| format!("; its clock is known to {error}")).unwrap_or_default();
    let left = match leftovers {
        0 => String::new(),
        n => format!("; {n} killed runs have left files there (metamorph clean --hosts FILE)"),
    };
    format!("metamorph {version}, {doing}{clock}{left}")
}
