//! The inputs of agents with vector clocks, as a log for ShiViz (Beschastnikh, Wang, Brun and Ernst, CACM 59, 2016), which draws the
//! happens-before order of a run: a line for each module, an arrow for each message.

use super::{ExportArgs, ExportError};
use metamorph_console::output::Outputs;
use metamorph_processes::record::journal::{Event, Journal, JournalFailure, Step, Who, plan_of};
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::record::{Consumed, MessageName};
use metamorph_protocol::time::Time;
use metamorph_scenario::Plan;
use metamorph_scenario::family::Families;
use metamorph_text::escape::Shown;
use metamorph_text::format::many;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;
use std::rc::Rc;

/// The first line of a log: how the viewer reads the others. The second one would separate several runs.
const EXPRESSION: &str = r"(?<at>\S+) s: (?<event>.*)\n(?<host>\S+) (?<clock>{.*})";
/// Largest number of inputs in a log. The viewer draws all at once.
const INPUTS_MAX: usize = 20_000;
/// Largest size of a log in bytes. Clocks of many modules are long.
const BYTES_MAX: usize = 64 << 20;

/// A module in one incarnation: a process of its own to the viewer.
type Host = (ModuleId, Incarnation);
/// A vector clock: of each host the number of its inputs that an input follows from.
type Clock = BTreeMap<Host, u32>;

/// The log so far.
#[derive(Default)]
struct Log {
    text: String,
    inputs: usize,
    /// The present clock of each host.
    clocks: BTreeMap<Host, Clock>,
    /// Of each message that was sent the clock of its sender then.
    sent: BTreeMap<MessageName, Rc<Clock>>,
}

impl Log {
    /// Adds an input.
    fn add(&mut self, at: Time, host: Host, step: &Step, what: &str) {
        let heard = match &step.input {
            // A message arrives once or twice, or never.
            Consumed::Message { name, .. } => self.sent.get(name).cloned(),
            _ => None,
        };
        let clock = self.clocks.entry(host).or_default();
        for (other, inputs) in heard.iter().flat_map(|clock| clock.iter()) {
            let known = clock.entry(*other).or_default();
            *known = (*known).max(*inputs);
        }
        *clock.entry(host).or_default() += 1;
        if !step.sent.is_empty() {
            let clock = Rc::new(clock.clone());
            let (from, incarnation) = host;
            for number in (step.first..).take(step.sent.len()) {
                self.sent.insert(MessageName { from, incarnation, number }, Rc::clone(&clock));
            }
        }
        let inputs: Vec<String> = clock.iter().map(|(host, n)| format!("\"{}\":{n}", name(*host))).collect();
        // Writing to a string cannot fail.
        let _ =
            writeln!(self.text, "{:.6} s: {what}\n{} {{{}}}", at.as_secs_f64(), name(host), inputs.join(","));
        self.inputs += 1;
    }
}

fn name((id, incarnation): Host) -> String {
    match incarnation {
        Incarnation(0) => format!("module-{id}"),
        incarnation => format!("module-{id}.{incarnation}"),
    }
}

/// Writes the inputs of agents of the run that a journal holds, or of a part of it. Returns what was written, in words. `brief` describes
/// an input in one line, or returns `None` for one that is left out.
///
/// # Errors
/// If the journal cannot be read, there are too many inputs or none, or the file cannot be written.
pub fn export_shiviz(
    args: &ExportArgs,
    file: &Path,
    families: Families,
    brief: impl Fn(&Plan, &Step) -> Option<String>,
) -> Result<String, ExportError> {
    let output = Outputs::new().creates("--shiviz", file)?;
    let (from, until) = args.during.unwrap_or((Time::ZERO, Time::NEVER));
    let journal = Journal::open(&args.journal).map_err(JournalFailure::from)?;
    let plan = plan_of(families, journal.head())?;
    let mut log = Log::default();
    for record in journal {
        let record = record.map_err(JournalFailure::from)?;
        let (Who::Agent(id, incarnation), Event::Step(step)) = (record.who, &record.event) else { continue };
        if record.at < from || record.at > until {
            continue;
        }
        let Some(what) = brief(&plan, step) else { continue };
        if log.inputs == INPUTS_MAX || log.text.len() > BYTES_MAX {
            return Err(ExportError::TooManyInputs { inputs: log.inputs, from, until: record.at });
        }
        log.add(record.at, (id, incarnation), step, &what);
    }
    if log.inputs == 0 {
        return Err(ExportError::NoInput);
    }
    output.write(format!("{EXPRESSION}\n\n{}", log.text))?;
    let (inputs, modules) = (many(log.inputs as u64, "input"), many(log.clocks.len() as u64, "module"));
    Ok(format!("{}: {inputs} of {modules}\n", file.shown()))
}
