//! `metamorph why`: when the end of a run was decided, and by which event.
//!
//! A simulated run is copied at points along its course, and each copy continues with other random numbers of its links. The share
//! of such futures that are built falls to nothing along a run that ends in a standstill; where it falls most, the standstill was
//! decided. `subject` carries the run out and says what is explained, `futures` counts futures, `search` finds the interval,
//! `start` asks what of a start decides, `decision` which inputs of the `past` do; `answer` is the result as JSON, `text` in words, `figure` as a picture.
//!
//! *Invariant.* The answer does not depend on the number of threads, and on the clock only if it says that it was cut short.

pub mod answer;
mod decision;
mod error;
mod figure;
pub mod futures;
mod past;
mod search;
pub mod start;
mod subject;
mod text;

use answer::Answer;
pub use error::WhyError;
use futures::{Futures, Question, Reseeded};
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::{Json, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::Channel;
use metamorph_processes::family;
use metamorph_report::plot_file;
use metamorph_scenario::Plan;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::rescue::Rescue;
use search::Decided;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Duration;

/// The arguments of `metamorph why`.
pub struct WhyRequest {
    /// The run.
    pub plan: Plan,
    /// The number of the standstill to be explained, from 1; `None` for the end of the run.
    pub standstill: Option<usize>,
    /// The help of the controller in futures; `None` if it is that of the run.
    pub rescue: Option<Rescue>,
    /// The real time after which the search ends.
    pub budget: Duration,
    /// Number of threads.
    pub jobs: NonZeroUsize,
    /// The destination of the answer as JSON.
    pub json: Option<PathBuf>,
    /// The destination of the figure.
    pub plot: Option<PathBuf>,
    /// True to print errors only.
    pub quiet: bool,
}

/// Answers the request, and returns the exit code: 0 if there is an answer.
///
/// # Errors
/// The run was built, was stopped, or the answer cannot be written.
pub fn why(request: &WhyRequest) -> Result<u8, WhyError> {
    let interrupt = Interrupt::listen().map_err(WhyError::Signals)?;
    interrupt.begin();
    let mut outputs = Outputs::new();
    let json = Json::of(request.json.as_deref(), &mut outputs)?;
    let plot = request
        .plot
        .as_deref()
        .map(|file| outputs.writes("--plot", file, OutputKind::Picture))
        .transpose()?;
    let since = Stopwatch::start();
    let stop = || interrupt.is_set() || since.elapsed() >= request.budget;
    let answer = answer(request, &|| interrupt.is_set(), &stop)?;
    let channel = Channel::beside(json.is_out(), request.quiet);
    channel.say(&text::text(&answer, channel.paint()));
    if let Some(plot) = plot {
        let about = format!(
            "{}, seed {}: share of futures that end as {}. Made by metamorph {}.",
            answer.scenario,
            answer.seed,
            answer.sought,
            env!("CARGO_PKG_VERSION")
        );
        plot.write(plot_file::file(figure::figure(&answer, &about), &about).unwrap_or_default())?;
    }
    json.write(&answer)?;
    Ok(if interrupt.is_set() { Outcome::Aborted.exit_code() } else { 0 })
}

/// Returns the answer. `aborted` ends the run that is explained, `stop` the search.
pub fn answer(
    request: &WhyRequest,
    aborted: &dyn Fn() -> bool,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Answer, WhyError> {
    let subject = subject::examine(&request.plan, request.standstill, aborted)?;
    let question =
        Question { sought: subject.sought.clone(), rescue: request.rescue, jobs: request.jobs, stop };
    let mut futures = Futures::new(&subject.plan, subject.since, &question, Reseeded::Links);
    let mut found = search::search(&mut futures, subject.direction());
    let start = match found.decided {
        Decided::AtStart => {
            let first = found.curve.first().map(|point| point.tally).unwrap_or_default();
            let start = start::ask(&subject, &first, &question);
            found.is_cut_short |= start.is_none();
            start
        }
        _ => None,
    };
    let event = match &found.decided {
        Decided::Instant(before, _) => {
            let records = family::recorded_events(&subject.plan, before.events + 1, 1);
            Some(records.iter().map(|(_, records)| family::told(&subject.plan, records)).collect())
        }
        _ => None,
    };
    let decision = match found.is_cut_short {
        false => decision::decide(&subject, &question, &futures, &found.decided),
        true => None,
    };
    found.is_cut_short |=
        decision.as_ref().map_or(found.decided.ends().is_some(), |decision| decision.is_cut_short);
    Ok(Answer::new(&subject, &found, start, event, decision, request.rescue))
}
