//! Published results of planners and of networks of oscillators, beside ours: one table of figures each.

mod appendix_b;
mod decided;
mod graph_signature;
mod gripping;
mod learning_curves;
mod network_parameters;
mod on_grid;
mod operated;
mod pairing;
mod planned;
mod reward_map;
mod sample;
mod stoy;
mod study;
mod torque;
mod transport;
pub mod trials;

use super::{Experiment, Request};
use crate::error::ReproduceError;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::{Json, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_console::terminal::Channel;
use metamorph_experiments::sweep::SweepError;
use metamorph_free_modules::gait::document::GaitFile;
use metamorph_free_modules::gait::file;
use metamorph_people::room::study::{Session, read};
use metamorph_processes::family::sources;
use metamorph_report::plot_file;
use metamorph_report::plots;
use metamorph_report::statistics::{Discrepancy, Observed, Rate, fisher};
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::escape::Shown;
use metamorph_text::format::{count, percent};
use metamorph_text::paint::Paint;
use metamorph_text::table::Table;
use sample::Ratios;
use serde::Serialize;

/// The version of the JSON output.
pub const SCHEMA: u32 = 2;

/// A published figure, or a target, and ours.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Row {
    /// Name of the figure.
    pub what: String,
    /// As printed in the source; empty if nothing is.
    pub published: String,
    /// A target of this project, where the source has no figure.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub target: String,
    /// As found here.
    pub ours: String,
    /// Number of independent trials that our figure comes from; left out if it does not come from a sample.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub n: Option<u64>,
    /// The 95 % interval of our figure.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub interval: String,
    /// The probability of a difference from the published figure that is at least as large, if both have one source.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub p: Option<f64>,
}

impl Row {
    /// Tests our share against published counts of successes and trials, by Fisher's exact test.
    fn against(&mut self, ours: (u64, u64), published: (u64, u64)) {
        self.p = fisher(published, ours);
    }
    /// Tests our share against a published one whose number of trials is not given, by the exact binomial test.
    fn against_share(&mut self, (successes, trials): (u64, u64), expected: f64) {
        self.p = Discrepancy::of(&[Observed { successes, trials, expected }]).map(|d| d.p);
    }
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
    /// Shares to be plotted.
    #[serde(skip)]
    pub plotted: Vec<plots::Row<Option<Rate>>>,
}

#[derive(Serialize)]
struct Document {
    schema: u32,
    version: String,
    planners: Vec<PlannerTable>,
}

/// A column of the text: its heading, and its cell in a row.
type Column = (&'static str, fn(&Row) -> String);

impl PlannerTable {
    fn new(experiment: Experiment) -> PlannerTable {
        let (name, title) = (experiment.name().to_owned(), experiment.title().to_owned());
        PlannerTable { name, title, rows: Vec::new(), notes: Vec::new(), plotted: Vec::new() }
    }
    fn row(
        &mut self,
        what: impl Into<String>,
        published: impl Into<String>,
        ours: impl Into<String>,
    ) -> &mut Row {
        let row = Row { what: what.into(), published: published.into(), ours: ours.into(), ..Row::default() };
        self.rows.push(row);
        // Invariant: it was just added.
        self.rows.last_mut().expect("the row was added")
    }
    /// Adds a share of successes in trials, with its interval by Wilson.
    fn share(&mut self, what: impl Into<String>, published: impl Into<String>, ours: (u64, u64)) -> &mut Row {
        let rate = Rate::wilson(ours.0, ours.1);
        let row = self.row(what, published, rate.map_or("no trial".to_owned(), |r| percent(r.rate)));
        row.n = Some(ours.1);
        row.interval = rate.map_or(String::new(), |r| format!("{} to {}", percent(r.low), percent(r.high)));
        row
    }
    /// Adds a ratio of sums over trials, with its interval by the bootstrap.
    fn ratio(&mut self, what: impl Into<String>, published: impl Into<String>, ours: &Ratios) -> &mut Row {
        let row = self.row(what, published, format!("{:.2}", ours.ratio()));
        row.n = Some(ours.len());
        row.interval = ours.interval().map_or(String::new(), |[low, high]| format!("{low:.2} to {high:.2}"));
        row
    }

    fn text(&self, paint: Paint) -> String {
        // Columns that say nothing are left out.
        let columns: [Column; 6] = [
            ("published", |r| r.published.clone()),
            ("target of this project", |r| r.target.clone()),
            ("ours", |r| r.ours.clone()),
            ("n", |r| r.n.map_or(String::new(), count)),
            ("95 % interval", |r| r.interval.clone()),
            ("p", |r| r.p.map_or(String::new(), |p| format!("{p:.3}"))),
        ];
        let says = |of: &fn(&Row) -> String| self.rows.iter().any(|row| !of(row).is_empty());
        let columns: Vec<_> = columns.into_iter().filter(|(_, of)| says(of)).collect();
        let heads: Vec<&str> = [""].into_iter().chain(columns.iter().map(|(name, _)| *name)).collect();
        let mut table = Table::new(&heads);
        for row in &self.rows {
            let cells = columns.iter().map(|(_, of)| of(row));
            table.whole_row(&[row.what.clone()].into_iter().chain(cells).collect::<Vec<_>>(), Vec::new());
        }
        let notes: String = self.notes.iter().map(|note| format!("  - {note}\n")).collect();
        format!("{}\n\n{}\n{notes}", paint.strong(&self.title), table.text(paint))
    }
}

/// Says what an interrupted command has left.
fn interrupted(request: &Request) -> String {
    match &request.out {
        Some(dir) => format!(
            "  interrupted: the table has the trials so far, which are kept in {}; the same command continues",
            dir.shown()
        ),
        None => "  interrupted: the table has the trials so far".to_owned(),
    }
}

/// Runs the planners' experiments of a request, and returns the exit code.
pub fn reproduce(experiments: &[Experiment], request: &Request) -> Result<u8, ReproduceError> {
    let mut outputs = Outputs::new();
    let json = Json::of(request.json.as_deref(), &mut outputs)?;
    let plot = request
        .plot
        .as_deref()
        .map(|file| outputs.writes("--plot", file, OutputKind::Picture))
        .transpose()?;
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
            Experiment::Stoy => stoy::table(request, &interrupt)?,
            Experiment::Why => decided::table(request, &interrupt)?,
            Experiment::Gripping => gripping::table(),
            Experiment::Torque => torque::table(),
            Experiment::Transport => transport::table(request, &interrupt)?,
            Experiment::AppendixB => appendix_b::table(),
            Experiment::Study => study::table(&sessions),
            Experiment::Pairing => pairing::table(request.seeds, &interrupt),
            Experiment::Operated => operated::table(request, &interrupt)?,
            Experiment::Planned => planned::table(request, &interrupt)?,
            _ => graph_signature::table(request.seeds, &interrupt),
        });
        if interrupt.is_set() {
            break;
        }
    }
    let document =
        Document { schema: SCHEMA, version: metamorph_text::version::version().to_owned(), planners };
    json.write(&document)?;
    if let (Some(plot), [table]) = (plot, &*document.planners) {
        let about = format!("{}. Made by metamorph {}.", table.title, env!("CARGO_PKG_VERSION"));
        plot.write(plot_file::file(plots::intervals(&table.plotted, &about), &about).unwrap_or_default())?;
    }
    let channel = Channel::beside(json.is_out(), request.quiet);
    for table in &document.planners {
        channel.say(&table.text(channel.paint()));
    }
    if interrupt.is_set() {
        channel.say(&interrupted(request));
        return Ok(Outcome::Aborted.exit_code());
    }
    Ok(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What stands beside ours is either printed in the source or called a target, and a share has its interval and test.
    #[test]
    fn a_table_has_the_columns_that_its_rows_fill() {
        let mut table = PlannerTable::new(Experiment::Operated);
        table.row("built", "", "90 %").target = "at least 95 %".to_owned();
        let head = |table: &PlannerTable| {
            let text = table.text(Paint::PLAIN);
            text.lines().find(|line| line.contains("ours")).unwrap().to_owned()
        };
        assert!(head(&table).contains("target of this project"), "{}", head(&table));
        assert!(
            !head(&table).contains("published") && !head(&table).contains("interval"),
            "{}",
            head(&table)
        );
        table.share("reached", "70 % of 300", (60, 100)).against((60, 100), (210, 300));
        let row = &table.rows[1];
        assert_eq!((row.ours.as_str(), row.n), ("60.0%", Some(100)));
        assert!(row.interval.starts_with("50.2") && row.interval.ends_with("69.1%"), "{}", row.interval);
        assert!((row.p.unwrap() - 0.084).abs() < 0.01, "{:?}", row.p);
        assert!(head(&table).contains("95 % interval"), "{}", head(&table));
    }
}
