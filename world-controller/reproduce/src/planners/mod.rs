//! Published results of planners and of networks of oscillators, beside ours: one table of figures each.

mod appendix_b;
mod graph_signature;
mod learning_curves;
mod network_parameters;
mod on_grid;
mod operated;
mod pairing;
mod planned;
mod reward_map;
mod study;
mod torque;
mod transport;

use super::{Experiment, Request};
use crate::error::ReproduceError;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::{Json, Outputs};
use metamorph_console::terminal::Channel;
use metamorph_experiments::sweep::SweepError;
use metamorph_free_modules::gait::document::GaitFile;
use metamorph_free_modules::gait::file;
use metamorph_people::room::study::{Session, read};
use metamorph_processes::family::sources;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::escape::Shown;
use metamorph_text::paint::Paint;
use metamorph_text::table::Table;
use serde::Serialize;

/// The version of the JSON output.
pub const SCHEMA: u32 = 1;

/// A published figure and ours.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the figure.
    pub what: String,
    /// As printed; empty if nothing is.
    pub published: String,
    /// As found here.
    pub ours: String,
}

/// The figures of an experiment.
#[derive(Clone, Debug, Serialize)]
pub struct PlannerTable {
    /// The name on the command line.
    pub name: String,
    /// Title of the table.
    pub title: String,
    /// The figures.
    pub rows: Vec<Row>,
    /// Remarks, among them the figures that could not be compared.
    pub notes: Vec<String>,
}

#[derive(Serialize)]
struct Document {
    schema: u32,
    version: String,
    planners: Vec<PlannerTable>,
}

impl PlannerTable {
    fn new(experiment: Experiment) -> PlannerTable {
        let (name, title) = (experiment.name().to_owned(), experiment.title().to_owned());
        PlannerTable { name, title, rows: Vec::new(), notes: Vec::new() }
    }
    fn row(&mut self, what: impl Into<String>, published: impl Into<String>, ours: impl Into<String>) {
        self.rows.push(Row { what: what.into(), published: published.into(), ours: ours.into() });
    }

    fn text(&self, paint: Paint) -> String {
        let mut table = Table::new(&["", "published", "ours"]);
        for row in &self.rows {
            table.whole_row(&[row.what.clone(), row.published.clone(), row.ours.clone()], Vec::new());
        }
        let notes: String = self.notes.iter().map(|note| format!("  - {note}\n")).collect();
        format!("{}\n\n{}\n{notes}", paint.strong(&self.title), table.text(paint))
    }
}

/// Runs the planners' experiments of a request, and returns the exit code.
pub fn reproduce(experiments: &[Experiment], request: &Request) -> Result<u8, ReproduceError> {
    let mut outputs = Outputs::new();
    let json = Json::of(request.json.as_deref(), &mut outputs)?;
    let gaits: Vec<GaitFile> = (request.gaits.iter())
        .map(|path| file::read(sources(), &format!("--gaits {}", path.shown()), path))
        .collect::<Result<_, _>>()?;
    let sessions: Vec<Session> = request.studies.iter().map(|path| read(path)).collect::<Result<_, _>>()?;
    let interrupt = Interrupt::listen().map_err(SweepError::Signals)?;
    interrupt.begin();
    let mut planners = Vec::new();
    for experiment in experiments {
        planners.push(match experiment {
            Experiment::OnGrid => on_grid::table(request.seeds, &interrupt),
            Experiment::RewardMap => reward_map::table(request.seeds, &interrupt),
            Experiment::Thesis7 => {
                let mut table = network_parameters::table();
                learning_curves::add(&mut table, &gaits);
                table
            }
            Experiment::Torque => torque::table(),
            Experiment::Transport => transport::table(request.seeds, &interrupt),
            Experiment::AppendixB => appendix_b::table(),
            Experiment::Study => study::table(&sessions),
            Experiment::Pairing => pairing::table(request.seeds, &interrupt),
            Experiment::Operated => operated::table(request, &interrupt)?,
            Experiment::Planned => planned::table(request, &interrupt)?,
            _ => graph_signature::table(request.seeds, &interrupt),
        });
        if interrupt.is_set() {
            return Ok(Outcome::Aborted.exit_code());
        }
    }
    let document =
        Document { schema: SCHEMA, version: metamorph_text::version::version().to_owned(), planners };
    json.write(&document)?;
    let channel = Channel::beside(json.is_out(), request.quiet);
    for table in &document.planners {
        channel.say(&table.text(channel.paint()));
    }
    Ok(0)
}
