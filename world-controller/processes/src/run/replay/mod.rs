//! `metamorph replay`: re-executes a journal and says whether everything matched the records, or where it
//! first differed; shows the history of one agent, or the state at some time. `engine` re-executes records;
//! `recover` does it for a resuming controller. Absent: reading files (`journal`).

mod engine;
mod recover;

pub use engine::{Done, Engine};
pub use recover::{RecoverError, Recovered, recover};

use crate::record::journal::{Damage, HeadError, Journal, JournalFailure, Record, Who, plan_of};
use metamorph_families::runnable::{AgentOf, Runnable};
use metamorph_families::worded::{self, Worded};
use metamorph_protocol::counters::Tally;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::Time;
use metamorph_scenario::Plan;
use metamorph_scenario::family::Families;
use metamorph_text::command_error::{BAD_USAGE, CommandError};
use metamorph_text::escape::Shown;
use metamorph_text::format::digits;
use metamorph_text::format::{count, many, seconds};
use std::fmt::Write as _;
use std::path::PathBuf;
use thiserror::Error;

/// Options of a replay.
#[derive(Clone, Debug)]
pub struct Request {
    /// Path of the journal.
    pub file: PathBuf,
    /// Stop after all records of this time.
    pub until: Option<Time>,
    /// Show the history of this agent.
    pub agent: Option<ModuleId>,
}

/// The reason why a journal cannot be replayed.
#[derive(Debug, Error)]
pub enum ReplayError {
    /// It cannot be read.
    #[error(transparent)]
    Journal(#[from] JournalFailure),
    /// Its scenario cannot be read.
    #[error("{0}\n  fix: use the program that wrote the journal")]
    Head(#[from] HeadError),
    /// There is no such module.
    #[error("--agent {0}: the run has modules 0 to {1} only")]
    NoSuchAgent(ModuleId, u32),
}

impl CommandError for ReplayError {
    fn exit_code(&self) -> u8 {
        match self {
            ReplayError::Journal(error) => error.exit_code(),
            _ => BAD_USAGE,
        }
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

/// The first place where a replay differs from its journal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// The number of the record, from 1.
    pub number: u64,
    /// Time of the record.
    pub at: Time,
    /// Writer of the record.
    pub who: Who,
    /// Description of the difference.
    pub what: String,
}

/// The result of a replay.
#[derive(Clone, Debug)]
pub struct Replayed {
    /// Number of items executed, by kind.
    pub done: Done,
    /// The first difference.
    pub difference: Option<Difference>,
    /// The damage that the replay ended at, if any.
    pub damage: Option<Damage>,
    /// Gaps in the files.
    pub troubles: Vec<String>,
    /// Messages sent and delivered, counted by the agents.
    pub tally: Tally,
    /// The recorded outcome; `None` if it was not reached.
    pub ended: Option<String>,
    /// The hashes of all agents, if all could be followed, and of the world, as in reports.
    pub hashes: (Option<u64>, u64),
    /// The requested history or state, as text.
    pub shown: String,
}

/// Opens a journal, and checks the request against its plan.
pub fn open(families: Families, request: &Request) -> Result<(Plan, Journal), ReplayError> {
    let journal = Journal::open(&request.file).map_err(JournalFailure::from)?;
    let plan = plan_of(families, journal.head())?;
    if let Some(id) = request.agent.filter(|id| id.index() >= plan.swarm.len()) {
        return Err(ReplayError::NoSuchAgent(id, plan.swarm.len().saturating_sub(1) as u32));
    }
    Ok((plan, journal))
}

/// Replays a journal.
pub fn run<R: Runnable>(swarm: &R, plan: &Plan, journal: &mut Journal, request: &Request) -> Replayed
where
    AgentOf<R>: Worded,
{
    let mut engine = Engine::new(swarm, plan);
    let mut shown = String::new();
    let (mut difference, mut damage) = (None, None);
    for record in journal.by_ref() {
        let record = match record {
            Ok(record) => record,
            Err(found) => {
                damage = Some(found);
                break;
            }
        };
        if request.until.is_some_and(|until| record.at > until) {
            break;
        }
        if let Who::Agent(id, incarnation) = record.who
            && request.agent == Some(id)
        {
            worded::tell::<AgentOf<R>>(&mut shown, swarm.setup(), &record, incarnation);
        }
        if let Err(what) = engine.carry_out(&record) {
            let (number, Record { at, who, .. }) = (engine.done().records, record);
            difference = Some(Difference { number, at, who, what });
            break;
        }
    }
    if request.until.is_some() && request.agent.is_none() {
        for (id, alive, place, summary) in engine.modules() {
            let about =
                if alive { summary.map(worded::state).unwrap_or_default() } else { "dead".to_owned() };
            let place = <AgentOf<R> as Worded>::place(&place);
            let _ = writeln!(shown, "module {id} at {place}: {about}");
        }
    }
    Replayed {
        done: engine.done(),
        difference,
        damage,
        troubles: journal.troubles(),
        tally: engine.tally(),
        ended: engine.ended().map(|(outcome, _)| outcome.clone()),
        hashes: engine.hashes(),
        shown,
    }
}

/// Formats the result for people.
pub fn text(plan: &Plan, replayed: &Replayed) -> String {
    let Replayed { done, difference, damage, troubles, tally, ended, hashes: (agents, world), shown } =
        replayed;
    let mut text = shown.clone();
    let total = tally.total();
    let _ = writeln!(
        text,
        "{}, {}, link {}, seed {}: {} up to {}",
        plan.title().shown(),
        many(plan.swarm.len() as u64, "module"),
        plan.overrides.link.name(),
        plan.seed,
        many(done.records, "record"),
        seconds(done.until.as_secs_f64())
    );
    let _ = writeln!(
        text,
        "carried out: {} of agents, started {}, {} of the controller; {} sent, {} delivered",
        many(done.steps, "input"),
        many(done.incarnations, "time"),
        many(done.controller, "record"),
        many(total.sent, "message"),
        count(total.delivered)
    );
    let agents = agents.map_or("not all followed".to_owned(), digits);
    let _ = writeln!(text, "state there: agents {agents}, world {}", digits(*world));
    for trouble in troubles {
        let _ = writeln!(text, "note: {trouble}");
    }
    if done.unchecked > 0 {
        let _ = writeln!(
            text,
            "note: not checked, because their causes are missing: {}",
            many(done.unchecked, "record")
        );
    }
    let verdict = match (difference, ended) {
        (None, _) if damage.is_some() => "identical states up to the damage in the journal".to_owned(),
        (Some(Difference { number, at, who, what }), _) => {
            format!("different: record {}, at {at}, {who}: {what}", count(*number))
        }
        (None, Some(outcome)) => format!("identical states and counts; the run ended {outcome}"),
        (None, None) => "identical states up to the end of the journal".to_owned(),
    };
    text + &verdict
}
