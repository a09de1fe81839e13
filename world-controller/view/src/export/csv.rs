//! The figures of a recorded run as tables: each module, the course of time, and the latencies of messages.

use metamorph_console::output::{Output, OutputError, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_processes::record::journal::{Consumed, Event as Recorded, Journal, JournalFailure, Step, Who};
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::latency::{Histogram, Latencies};
use metamorph_protocol::time::{Span, Time};
use metamorph_protocol::wire::HEADER;
use metamorph_report::message_timeline::Bin;
use metamorph_scene::scene::{Event, Scene};
use metamorph_text::escape::Shown;
use std::collections::BTreeMap;
use std::path::Path;

/// Number of classes of messages.
const CLASSES: usize = Class::ALL.len();

/// The figures of one module.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModuleFigures {
    /// Messages handed to its links, by class.
    pub sent: [u64; CLASSES],
    /// Messages that came to its agent, by class.
    pub received: [u64; CLASSES],
    /// Bytes of the messages that came to its agent, headers included.
    pub received_bytes: u64,
    /// Actions that its body began: moves of cubes, turns of joints.
    pub actions: u64,
    /// Those of them that failed.
    pub failed: u64,
    /// Actions that its body refused after it had begun them.
    pub refused: u64,
    /// Deaths of its process.
    pub deaths: u64,
    /// Latencies of the messages that came to its agent.
    pub latency: Histogram,
}

/// The figures of a run that a journal holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figures {
    /// Those of each module.
    pub modules: Vec<ModuleFigures>,
    /// Messages sent in each time bin of the scene, by class.
    pub sent: Vec<[u64; CLASSES]>,
    /// Latencies of the messages that came to agents.
    pub latencies: Latencies,
}

impl Figures {
    /// Reads the figures of a journal; `scene` is that of its run. Times are those of the records: on processes a message is
    /// handed in when the agent takes it, and agents on hosts have clocks of their own.
    ///
    /// # Errors
    /// If the journal cannot be read.
    pub fn read(file: &Path, scene: &Scene) -> Result<Figures, JournalFailure> {
        let mut figures = Figures::default();
        let mut sent_at: BTreeMap<(ModuleId, Incarnation), Vec<Time>> = BTreeMap::new();
        let (width, bins) = scene.bins();
        figures.modules.resize_with(scene.modules(), ModuleFigures::default);
        figures.sent = vec![[0; CLASSES]; bins.len()];
        for record in Journal::open(file)? {
            let record = record?;
            let (Who::Agent(id, incarnation), Recorded::Step(step)) = (record.who, record.event) else {
                continue;
            };
            let own = sent_at.entry((id, incarnation)).or_default();
            own.extend(step.sent.iter().map(|_| record.at));
            // Agents of a run of processes may be slightly ahead of the controller's records.
            let bin = (record.at.0 / width.0.max(1)) as usize;
            let bin = bin.min(figures.sent.len().saturating_sub(1));
            let counts =
                [figures.modules.get_mut(id.index()).map(|m| &mut m.sent), figures.sent.get_mut(bin)];
            for counts in counts.into_iter().flatten() {
                step.sent.iter().for_each(|sent| counts[sent.class.index()] += 1);
            }
            figures.hear(id, record.at, &step, &sent_at);
        }
        for (_, event) in scene.events() {
            let (Event::Does(id, ..) | Event::Failed(id, _) | Event::Refused(id) | Event::Died(id)) = event
            else {
                continue;
            };
            let Some(module) = figures.modules.get_mut(id.index()) else { continue };
            match event {
                Event::Does(..) => module.actions += 1,
                Event::Failed(..) => module.failed += 1,
                Event::Refused(_) => module.refused += 1,
                _ => module.deaths += 1,
            }
        }
        Ok(figures)
    }

    fn hear(
        &mut self,
        id: ModuleId,
        at: Time,
        step: &Step,
        sent_at: &BTreeMap<(ModuleId, Incarnation), Vec<Time>>,
    ) {
        let Consumed::Message { class, name, message, .. } = &step.input else { return };
        let sent = sent_at.get(&(name.from, name.incarnation)).and_then(|all| all.get(name.number as usize));
        let latency = sent.map(|sent| at.since(*sent));
        if let Some(latency) = latency {
            self.latencies[*class].record(latency);
        }
        let Some(module) = self.modules.get_mut(id.index()) else { return };
        module.received[class.index()] += 1;
        module.received_bytes += (HEADER + message.bytes.len()) as u64;
        latency.into_iter().for_each(|latency| module.latency.record(latency));
    }
}

/// The files of the tables, in a directory.
pub struct Tables {
    modules: Output,
    time: Output,
    latency: Output,
}

impl Tables {
    /// Creates the directory, if it does not exist, and registers the files, which may exist.
    ///
    /// # Errors
    /// If the directory cannot be created or a file not be written.
    pub fn new(directory: &Path, outputs: &mut Outputs) -> Result<Tables, OutputError> {
        std::fs::create_dir_all(directory).map_err(|error| OutputError::Unwritable {
            name: format!("--csv {}", directory.shown()),
            error,
            fix: "name a directory that can be written, or a new one",
        })?;
        let mut file = |name: &str| outputs.writes("--csv", &directory.join(name), OutputKind::Csv);
        Ok(Tables { modules: file("modules.csv")?, time: file("time.csv")?, latency: file("latency.csv")? })
    }

    /// Writes the tables of the run that a journal holds; `scene` is its scene.
    ///
    /// # Errors
    /// If the journal cannot be read, or a file not be written.
    pub fn write(&self, journal: &Path, scene: &Scene) -> Result<(), super::ExportError> {
        let figures = Figures::read(journal, scene)?;
        self.modules.write(modules(&figures.modules))?;
        self.time.write(time(&figures.sent, scene.bins(), scene.now()))?;
        self.latency.write(latency(&figures.latencies))?;
        Ok(())
    }
}

/// Joins the cells of lines. Numbers and names of classes need no quotes.
fn lines(head: Vec<String>, rows: impl Iterator<Item = Vec<String>>) -> String {
    std::iter::once(head).chain(rows).map(|cells| cells.join(",") + "\n").collect()
}

fn of_classes(prefix: &str) -> impl Iterator<Item = String> {
    Class::ALL.into_iter().map(move |class| format!("{prefix}_{class}"))
}

fn names(all: &[&str]) -> Vec<String> {
    all.iter().map(|name| (*name).to_owned()).collect()
}

fn seconds(span: Option<Span>) -> String {
    span.map_or(String::new(), |span| span.as_secs_f64().to_string())
}

fn modules(all: &[ModuleFigures]) -> String {
    let mut head = names(&["module", "actions", "failed", "refused", "deaths"]);
    head.extend(of_classes("sent").chain(of_classes("received")));
    head.extend(names(&["received_bytes", "latency_p50_s", "latency_p99_s"]));
    let row = |(id, m): (usize, &ModuleFigures)| {
        let counts = [id as u64, m.actions, m.failed, m.refused, m.deaths];
        let counts = counts.into_iter().chain(m.sent).chain(m.received).chain([m.received_bytes]);
        let latencies = [500, 990].map(|per_mille| seconds(m.latency.quantile(per_mille)));
        counts.map(|n| n.to_string()).chain(latencies).collect()
    };
    lines(head, all.iter().enumerate().map(row))
}

fn time(sent: &[[u64; CLASSES]], (width, bins): (Span, &[Bin]), end: Time) -> String {
    let mut head = names(&["until_s", "filled", "goal", "actions"]);
    head.extend(of_classes("sent").chain(of_classes("delivered")));
    let row = |(i, (bin, sent)): (usize, (&Bin, &[u64; CLASSES]))| {
        let until = Time((i as u64 + 1).saturating_mul(width.0)).min(end);
        let counts = [bin.filled, bin.goal, bin.moves].into_iter().chain(*sent).chain(bin.totals);
        std::iter::once(until.as_secs_f64().to_string()).chain(counts.map(|n| n.to_string())).collect()
    };
    lines(head, bins.iter().zip(sent).enumerate().map(row))
}

fn latency(latencies: &Latencies) -> String {
    let rows = latencies.iter().flat_map(|(class, histogram)| {
        histogram.cells().map(move |(least, greatest, n)| {
            vec![class.to_string(), seconds(Some(least)), seconds(Some(greatest)), n.to_string()]
        })
    });
    lines(names(&["class", "least_s", "greatest_s", "messages"]), rows)
}
